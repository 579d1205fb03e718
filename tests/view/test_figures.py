"""The figures beside the model: the truth with the smaller gain is the one that counts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.commands.verify import verify_file
from skinbake.measure.options import VerifyOptions
from tests.support import browser
from tests.support.command_line import invoke
from tests.support.models import bake, edited, sheet, write_model
from tests.view.pages import shown

pytestmark = pytest.mark.slow


def headings(page: browser.Page) -> list[str]:
    """Return the headings beside the model that can be seen."""
    found: list[str] = page.call(
        """(() => [...document.querySelectorAll('aside h2')]
            .filter((heading) => heading.offsetHeight > 0).map((heading) => heading.textContent.trim()))"""
    )
    return found


def test_a_page_without_figures_or_model_has_no_table_and_no_chart(tmp_path: Path) -> None:
    flat = write_model(tmp_path / "flat.glb", [sheet(POSITION=np.zeros((20, 3), np.float32))])
    bake(flat, tmp_path / "baked.glb")
    (tmp_path / "empty.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
    for name, expected in (
        ("baked.glb", ["Mean error over the clip", "Checks passed", "Where it gets worse"]),
        ("empty.gltf", ["Checks not baked", "Notes"]),
    ):
        report, scratch = tmp_path / f"{name}.html", tmp_path / f"{name}.profile"
        invoke("verify", tmp_path / name, "--poses", "rest", "--html", report)
        scratch.mkdir()
        with browser.opened_file(report, scratch) as page:
            assert sorted(headings(page)) == sorted(expected)


def test_a_page_that_cannot_draw_its_model_has_no_controls(tmp_path: Path) -> None:
    """Twelve influences: the figures are there, and nothing that a reader could press in vain."""
    weights = np.tile(np.array([0.2, 0.1, 0.05, 0.05], np.float32), (20, 1))
    joints = np.tile(np.arange(4, dtype=np.uint8), (20, 1))
    sets: dict[str, Any] = {}
    for number in range(3):
        sets |= {f"JOINTS_{number}": joints + 4 * number, f"WEIGHTS_{number}": weights}
    sets["WEIGHTS_2"] = weights / 2
    write_model(tmp_path / "twelve.glb", [sheet(**sets)], joints=12)
    bake(tmp_path / "twelve.glb", tmp_path / "baked.glb")
    with shown(tmp_path / "baked.glb") as page:
        words, seen = page.call(
            """(() => [message.textContent, [...document.querySelectorAll('body *')]
                .filter((element) => element.tabIndex >= 0 && element.offsetHeight > 0)
                .map(({ id }) => id)])"""
        )
    assert words.startswith("The model cannot be shown: it has 12 influences")
    assert seen == ["table"], "it scrolls where it is too wide"


def test_the_headline_is_the_verdict_and_the_gain_by_triangles_comes_first() -> None:
    verdict = verify_file(str(FOLDER / "bent_tube.glb"), VerifyOptions())
    assert not verdict.by_truth, "the fixture is not baked: the page bakes it"
    with shown(FOLDER / "bent_tube.glb") as page:
        headline, words, table = page.call(
            """(() => [gain.textContent, document.getElementById('gain-words').textContent,
                [...document.querySelectorAll('#table tbody tr')].slice(0, 2).map((row) =>
                    [...row.querySelectorAll('td')].map((cell) => Number(cell.textContent)))])"""
        )
    (by_triangles, *_), (triangles, *_) = table
    assert headline == "Clear gain"
    found = re.match(
        r"Accurate lighting is off by (.*)° in the mean, standard lighting by (.*)°: "
        r"a gain of (\d\d\.\d\d)× by triangles, of \d\d\.\d\d× by tangents\. By triangles: ",
        words,
    )
    assert found is not None, words
    assert found.groups()[:2] == (f"{triangles:.2f}", f"{by_triangles:.2f}")
    assert float(found[3]) == pytest.approx(by_triangles / triangles, rel=0.05)


def test_the_headline_of_dual_quaternions_has_its_degrees_in_the_table(tmp_path: Path) -> None:
    report, scratch = tmp_path / "report.html", tmp_path / "profile"
    bake(FOLDER / "seam.glb", tmp_path / "baked.glb")
    invoke("verify", tmp_path / "baked.glb", "--method", "dqs", "--html", report)
    scratch.mkdir()
    with browser.opened_file(report, scratch) as page:
        words, table = page.call(
            """(() => [document.getElementById('gain-words').textContent,
                [...document.querySelectorAll('#table tbody tr')].map((row) =>
                    [...row.querySelectorAll('th, td')].map((cell) => cell.textContent))])"""
        )
    assert [name for name, *_ in table] == [
        f"Dual quaternions, {how}" for how in ("standard", "accurate", "exact")
    ]
    sentence = (
        r"off by ([\d.]+)° in the mean, standard lighting by ([\d.]+)°, with dual quaternions: .*? by (\w+)"
    )
    found = re.search(sentence, words)
    assert found is not None, words
    mean = {"triangles": 1, "tangents": 3}[found[3]]
    assert (table[1][mean], table[0][mean]) == (found[1], found[2])


def test_a_name_does_not_turn_the_words_after_it_around(tmp_path: Path) -> None:
    """Hebrew runs from right to left. A browser puts the number after it to its left, unless it is told."""

    def rename(content: dict[str, Any]) -> None:
        content["meshes"][0]["name"] = "שלום"

    with shown(edited("two_primitives.glb", tmp_path, rename)) as page:
        name, number = page.call(
            """(() => {
                const { firstChild: text } = document.querySelector('#primitives-table tbody th');
                const left = (at) => {
                    const range = document.createRange();
                    range.setStart(text, at);
                    range.setEnd(text, at + 1);
                    return range.getBoundingClientRect().left;
                };
                return [left(text.data.indexOf('ש')), left(text.data.indexOf('0'))];
            })"""
        )
    assert number > name


def test_a_long_name_leaves_room_for_the_figures(tmp_path: Path) -> None:
    def rename(content: dict[str, Any]) -> None:
        content["meshes"][0]["name"] = "SK_Hero_Outfit_Winter_Coat_LOD0_Mesh_Part_03_Collar_And_Sleeves"

    with shown(edited("two_primitives.glb", tmp_path, rename)) as page:
        page.show_as(1280, 800, "light")
        wide, room = page.call(
            """(() => ['scrollWidth', 'clientWidth'].map((one) =>
                document.getElementById('primitives-table')[one]))"""
        )
    assert wide <= room


def test_primitives_have_the_figures_by_triangles() -> None:
    with shown(FOLDER / "two_primitives.glb") as page:
        rows, given, words = page.call(
            """(() => [
                [...document.querySelectorAll('#primitives-table tbody td')].map((cell) => cell.textContent),
                JSON.parse(document.getElementById('given').textContent).primitives,
                primitives.textContent,
            ])"""
        )
    assert len(given) == 2
    expected = []
    for primitive in given:
        own = primitive["normals_by_triangles"]["lbs"]
        expected += [f"{own[name]['mean']:.2f}" for name in ("standard", "accurate")]
        assert own["gain"] < 0.98 * primitive["normals_by_tangents"]["lbs"]["gain"], "told apart"
    assert [text for text in rows if not text.endswith("×")] == expected
    assert "by triangles" in words
    assert "by tangents" not in words
