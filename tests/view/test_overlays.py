"""What is in the picture: all of the model, and the legend of errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from tests.support import browser
from tests.support.baked_files import Editable
from tests.support.models import sheet, write_model
from tests.view.pages import shown, take

pytestmark = pytest.mark.slow

TUBE = FOLDER / "bent_tube.glb"


@pytest.fixture(scope="module")
def browsing() -> Iterator[browser.Page]:
    """Open the page of a fixture in mode ``error``."""
    with shown(TUBE) as page:
        page.call("(() => document.querySelector('input[value=error]').click())")
        yield page


@pytest.mark.parametrize("size", [(1280, 800), (390, 844)], ids=str)
def test_the_numbers_of_the_legend_stand_at_their_colours(
    browsing: browser.Page, size: tuple[int, int]
) -> None:
    browsing.show_as(*size, "light")
    browsing.call("(() => { application.stopMeasuring(); application.setLegend(20); })")
    ramp, first, middle, last = browsing.call(
        """(() => ['.ramp', '.ticks :first-child', '#legend-middle', '#legend-end'].map((chosen) => {
            const range = document.createRange();
            const element = document.querySelector(chosen);
            element.firstChild ? range.selectNodeContents(element) : range.selectNode(element);
            const { left, right } = range.getBoundingClientRect();
            return [left, right];
        }))"""
    )
    assert first[0] == pytest.approx(ramp[0], abs=1)
    assert sum(middle) / 2 == pytest.approx(sum(ramp) / 2, abs=1)
    assert last[1] == pytest.approx(ramp[1], abs=1)


def test_the_legend_names_the_colour_of_what_is_not_skinned(browsing: browser.Page, tmp_path: Path) -> None:
    hidden = "(() => document.getElementById('legend-unknown').hidden)"
    file = Editable(TUBE)
    take(browsing, TUBE)
    assert browsing.call(hidden) is True
    file.content["nodes"].append({"mesh": 0, "translation": [2, 0, 0]})
    file.content["scenes"][0]["nodes"].append(len(file.content["nodes"]) - 1)
    take(browsing, file.write(tmp_path / "beside.glb"))
    assert browsing.call(hidden) is False
    assert browsing.call("(() => document.getElementById('legend-unknown').textContent)") == "Not skinned"


@pytest.mark.parametrize(("doubled", "is_whole"), [("all of it", True), ("a corner", False)])
def test_what_has_no_true_normal_has_no_error_and_a_colour_with_a_name(
    browsing: browser.Page, tmp_path: Path, doubled: str, is_whole: bool
) -> None:
    """A triangle that is there twice, once for each side, shows no side of the surface."""
    flat = sheet()
    triangles = np.asarray(flat.indices).reshape(-1, 3)
    twice = triangles if doubled == "all of it" else triangles[(triangles == 0).any(axis=1)]
    assert 0 < len(twice) < len(triangles) or is_whole
    doubled_sheet = replace(flat, indices=np.concatenate([triangles, twice[:, ::-1]]))
    take(browsing, write_model(tmp_path / "doubled.glb", [doubled_sheet]))
    legend, reading, points = browsing.call(
        """(async () => {
            const { clip, measures } = application;
            application.stopMeasuring();
            application.measure(clip);
            const { lines } = measures.get(clip);
            const wait = () => new Promise((done) => setTimeout(done, 20));
            while (lines.standard.includes(undefined)) await wait();
            application.draw();
            const unknown = document.getElementById('legend-unknown');
            const drawn = [...document.querySelectorAll('#chart polyline')];
            return [
                unknown.hidden ? '' : unknown.textContent,
                document.getElementById('left-error').textContent,
                drawn.reduce((sum, line) => sum + line.points.length, 0),
            ];
        })"""
    )
    assert legend == "No true normal"
    assert (reading == "no true normals") == is_whole
    assert (points == 0) == is_whole


def test_a_reading_waits_for_the_samples_around_its_time(browsing: browser.Page) -> None:
    """The mean at the start of a clip, often 0°, is not the mean at its end."""
    take(browsing, TUBE)
    found = browsing.call(
        """(() => {
            application.stopMeasuring();
            const { chart } = application;
            const at = (means) => {
                chart.set({ start: 0, end: 4 }, [0, 1, 2, 3, 4], { standard: means }, ['standard'], {});
                return [0.5, 2.5, 4].map((time) => String(chart.at('standard', time)));
            };
            const none = undefined;
            return [[0, none, none, none, none], [0, none, 2, none, 6], [null, none, 2, none, null]].map(at);
        })"""
    )
    assert found == [["undefined"] * 3, ["0.5", "3", "6"], ["2", "2", "null"]]


def test_a_character_on_a_large_stage_fills_the_picture_until_all_is_shown(
    browsing: browser.Page, tmp_path: Path
) -> None:
    """The stage is the tube, thirty times as large and without its skin."""
    look = """(() => {
        application.stopMeasuring();
        application.seek(application.clip.end, true);
        application.applyPose();
        const { camera, scene } = application;
        const [width, height] = camera.size;
        return [camera.projected(width / height), scene.parts.map((part) => [...scene.positions(part, 1)])];
    })"""
    file = Editable(TUBE)
    file.content["nodes"].append({"mesh": 0, "scale": [30, 30, 30]})
    file.content["scenes"][0]["nodes"].append(len(file.content["nodes"]) - 1)
    take(browsing, TUBE)
    alone = extents(*browsing.call(look))
    take(browsing, file.write(tmp_path / "stage.glb"))
    assert extents(*browsing.call(look))[0] == pytest.approx(alone[0], rel=1e-3)
    browsing.call("(() => document.getElementById('home').click())")
    character, stage = extents(*browsing.call(look))
    assert character < 0.1
    assert 0.5 < stage < 1
    radius, distance = browsing.call(
        "(() => { const { camera, scene } = application; camera.zoom(1e-9); "
        "return [scene.bounds(scene.parts.slice(0, 1)).radius, camera.distance]; })"
    )
    assert distance == pytest.approx(0.02 * radius)


def extents(matrix: list[float], parts: list[list[float]]) -> list[float]:
    """Return how wide and high each part is on the screen, as a share of half of it."""
    found = []
    for positions in parts:
        points = np.array(positions).reshape(-1, 3)
        places = np.column_stack([points, np.ones(len(points))]) @ np.array(matrix).reshape(4, 4)
        flat = places[:, :2] / places[:, 3:]
        found.append(float(np.ptp(flat, axis=0).max() / 2))
    return found


def test_the_whole_model_is_seen_over_its_clip(browsing: browser.Page, tmp_path: Path) -> None:
    """It bends to one side and then to the other: at the ends and in the middle it is upright."""
    file = Editable(TUBE)
    animation = file.content["animations"][0]
    animation["channels"] = [{"sampler": 0, "target": {"node": 1, "path": "rotation"}}]
    count = file.content["accessors"][animation["samplers"][0]["input"]]["count"]
    half = np.sin(np.linspace(0, 2 * np.pi, count)) * np.pi / 4
    turns = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1).astype(np.float32)
    animation["samplers"][0]["output"] = file.add(turns)
    take(browsing, file.write(tmp_path / "bending.glb"))
    matrix, positions = browsing.call(
        """(() => {
            const { camera, clip, scene } = application;
            const [width, height] = camera.size;
            const every = Array.from({ length: 17 }, (_, i) => {
                scene.pose(clip, clip.start + (i / 16) * (clip.end - clip.start));
                return [...scene.positions(scene.parts[0], 1)];
            });
            return [camera.projected(width / height), every.flat()];
        })"""
    )
    points = np.array(positions).reshape(-1, 3)
    places = np.column_stack([points, np.ones(len(points))]) @ np.array(matrix).reshape(4, 4)
    farthest = np.abs(places[:, :2] / places[:, 3:]).max()
    assert 0.5 < farthest < 1
