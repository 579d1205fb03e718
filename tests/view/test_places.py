"""Two panes of one view: where the page opens, its places, equal pixels, and the other lighting on a key."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import skinbake
from fixtures.make_fixtures import FOLDER
from skinbake.commands.view import view_file
from tests.support import browser, corpus
from tests.support.models import edited
from tests.view.pages import normals, picture, shown, take

pytestmark = pytest.mark.slow

TUBE = FOLDER / "bent_tube.glb"
WORDS = re.compile(
    r"(?P<joint>.+), (?P<clip>.+) (?P<time>[\d.]+) s: (?P<standard>[\d.]+)° → (?P<baked>[\d.]+)°"
)
SHOWN = """(() => ({
    clip: application.clip.name, time: application.time, playing: application.isPlaying,
    target: application.camera.target, distance: application.camera.distance, here: here.textContent,
    places: [...document.querySelectorAll('#places-list button')].map(({ textContent }) => textContent),
    hidden: places.hidden, rings: document.querySelectorAll('.ring:not([hidden])').length,
}))"""


@pytest.fixture
def browsing() -> Iterator[browser.Page]:
    """Open the page of a fixture, for each test anew: it changes what is shown."""
    with shown(TUBE) as page:
        page.call("(() => application.stopMeasuring())")
        yield page


def panes(page: browser.Page) -> tuple[npt.NDArray[np.int_], npt.NDArray[np.int_]]:
    """Return the pixels of the panes that lie beside each other."""
    seen = picture(page).astype(int)
    half = seen.shape[1] // 2
    return seen[:, :half], seen[:, seen.shape[1] - half :]


def test_the_page_opens_on_the_whole_figure_with_a_ring_where_the_bake_shows_most(
    browsing: browser.Page,
) -> None:
    """The normals of both lightings differ more inside the ring than outside."""
    found = browsing.call(SHOWN)
    assert (found["clip"], found["playing"], found["hidden"], found["rings"]) == ("bend", False, False, 2)
    assert found["time"] == pytest.approx(0.5, abs=0.08)
    words = WORDS.fullmatch(found["places"][0])
    assert words is not None, found["places"]
    assert found["here"] == found["places"][0]
    assert float(words["standard"]) > 8 * float(words["baked"])
    standard, accurate = (
        normals(browsing, lighting, clip=0, time=found["time"]) for lighting in ("standard", "fitted")
    )
    positions, middle, matrix, rings = browsing.call(
        """(() => {
            const { camera, scene, place } = application;
            application.draw();
            const box = canvas.getBoundingClientRect();
            const rings = [...document.querySelectorAll('.ring')].map((ring) => {
                const { left, width, top, height } = ring.getBoundingClientRect();
                return [left + width / 2 - box.left, top + height / 2 - box.top];
            });
            const [w, h] = camera.size;
            return [[...scene.positions(scene.parts[0], 1)], scene.positionOf(place), camera.projected(w / h),
                { rings, w, h, wide: box.width }];
        })"""
    )
    points = np.array(positions).reshape(-1, 3)
    apart = np.degrees(np.arccos(np.clip((standard * accurate).sum(axis=1), -1, 1)))
    far = np.linalg.norm(points - middle, axis=1)
    close = far < 0.12 * np.linalg.norm(np.ptp(points, axis=0))
    assert apart[close].mean() > 2 * apart.mean()
    places = np.column_stack([points, np.ones(len(points))]) @ np.array(matrix).reshape(4, 4)
    assert np.abs(places[:, :2] / places[:, 3:]).max() < 1, "all of the figure is in the pane"
    at = np.array([*middle, 1.0]) @ np.array(matrix).reshape(4, 4)
    x, y = (0.5 + at[0] / at[3] / 2) * rings["w"], (0.5 - at[1] / at[3] / 2) * rings["h"]
    assert rings["rings"][0] == pytest.approx([x, y], abs=2)
    assert rings["rings"][1][0] - rings["rings"][0][0] == pytest.approx(rings["wide"] / 2, abs=2)


def test_a_click_on_a_place_goes_there_and_another_one_back(browsing: browser.Page) -> None:
    count = len(browsing.call(SHOWN)["places"])
    assert 2 <= count <= 5
    middles = []
    for number in range(count):
        click = f"(() => document.querySelectorAll('#places-list button')[{number}].click())"
        browsing.call(click)
        near = browsing.call(SHOWN)
        assert near["here"] == near["places"][number]
        assert near["rings"] == 2 or near["distance"]
        middles.append(near["target"])
        browsing.call(click)
        whole = browsing.call(SHOWN)
        assert whole["distance"] > 2 * near["distance"]
        assert (whole["time"], whole["here"]) == (near["time"], near["here"])
    apart = [np.linalg.norm(np.subtract(a, b)) for i, a in enumerate(middles) for b in middles[:i]]
    assert min(apart) > 0.3


@pytest.mark.parametrize("size", [(1281, 800), (390, 844)], ids=["beside", "above"])
def test_two_panes_show_the_same_pixels_where_both_lightings_are_the_same(
    browsing: browser.Page, size: tuple[int, int]
) -> None:
    browsing.show_as(*size, "light")
    # The page must have its new size before it draws.
    browsing.call("(async () => { for (let i = 0; i < 3; i++) await new Promise(requestAnimationFrame); })")
    for mode in ("shaded", "reflections", "normals", "error"):
        differ = []
        for lighting in ("standard", "fitted"):
            browsing.call(
                """((mode, lighting) => {
                    application.stopMeasuring();
                    document.querySelector(`input[value=${mode}]`).click();
                    right.value = lighting;
                    application.chooseSides();
                    application.resize();
                })""",
                mode,
                lighting,
            )
            seen = picture(browsing).astype(int)
            if size[0] > size[1]:
                half = seen.shape[1] // 2
                first, second = seen[:, :half], seen[:, seen.shape[1] - half :]
            else:
                half = seen.shape[0] // 2
                first, second = seen[:half], seen[seen.shape[0] - half :]
            assert (first[..., 3] > 200).mean() > 0.02
            differ.append(int((first != second).any(axis=2).sum()))
        assert differ[0] == 0, mode
        assert differ[1] > 100, mode
    assert browsing.messages() == []


def test_while_a_is_held_the_first_pane_shows_the_other_lighting_and_all_else_stands_still(
    browsing: browser.Page,
) -> None:
    page = browsing
    page.call("(() => { moving.click(); application.play(true); canvas.focus(); })")
    page.call("(() => new Promise((done) => setTimeout(done, 300)))")
    state = "(() => [application.time, application.turn, application.camera.eye, left.value])"
    page.call("(() => canvas.dispatchEvent(new KeyboardEvent('keydown', { key: 'a', bubbles: true })))")
    begun = page.call(state)
    held = panes(page)
    page.call("(() => new Promise((done) => setTimeout(done, 300)))")
    assert page.call(state) == begun
    assert begun[3] == "fitted"
    assert np.array_equal(*held)
    again = panes(page)
    assert np.array_equal(held[0], again[0])
    page.call("(() => application.play(false))")
    page.call("(() => canvas.dispatchEvent(new KeyboardEvent('keyup', { key: 'a', bubbles: true })))")
    page.call("((time) => application.seek(time, true))", begun[0])
    after = panes(page)
    assert np.array_equal(after[1], held[1]), "the other pane is as it was"
    assert not np.array_equal(after[0], held[0])
    assert page.call(state)[3] == "standard"


def test_playing_moves_both_panes(browsing: browser.Page) -> None:
    before = panes(browsing)
    browsing.call("(() => application.seek(application.clip.start, true))")
    after = panes(browsing)
    for one, other in zip(before, after, strict=True):
        assert (one != other).any(axis=2).mean() > 0.01


def test_the_figure_fits_the_pane_after_a_resize_until_the_camera_is_moved(browsing: browser.Page) -> None:
    widen = """(async (size) => {
        while (innerWidth !== size) await new Promise(requestAnimationFrame);
        application.resize();
        const { camera } = application;
        return [camera.distance, camera.shown && camera.fitting(camera.shown)];
    })"""
    found = []
    for size in ((1280, 800), (600, 1000)):
        browsing.show_as(*size, "light")
        found.append(browsing.call(widen, size[0]))
    assert found[0][0] == pytest.approx(found[0][1])
    assert found[1][0] == pytest.approx(found[1][1])
    assert found[1][0] > 1.05 * found[0][0]
    browsing.call("(() => canvas.focus())")
    browsing.press("ArrowLeft")
    browsing.show_as(1280, 800, "light")
    assert browsing.call(widen, 1280) == [found[1][0], None]


def test_a_dropped_file_has_no_places(browsing: browser.Page) -> None:
    take(browsing, FOLDER / "seam.glb")
    found = browsing.call(SHOWN)
    assert (found["hidden"], found["rings"]) == (True, 0)


def test_a_file_without_clips_opens_on_a_place_in_random_poses(tmp_path: Path) -> None:
    """The CPU draws the same poses, though it makes their numbers by itself."""
    path = edited("bent_tube.glb", tmp_path, lambda content: content.pop("animations"))
    with shown(path) as page:
        found = page.call(SHOWN)
        drawn = normals(page, "standard", clip=0, time=found["time"])
    assert (found["clip"], found["playing"]) == ("Random poses", False)
    assert 0.2 < found["time"] < 8.8  # at 0 and 9 s it rests
    words = WORDS.fullmatch(found["places"][0])
    assert words is not None
    assert float(words["standard"]) > 5 * float(words["baked"])
    skinbake.bake(path, path)
    [posed] = skinbake.normals(path, time=found["time"])
    assert posed.clip is None
    assert np.abs(drawn - posed.normals["standard"]).max() < 2e-4  # 0.01°
    assert posed.time == skinbake.normals(path)[0].time


def test_a_place_is_found_where_equal_skins_draw_a_mesh_each() -> None:
    path = corpus.model("asset-generator/Animation_Skin/Animation_Skin_07.gltf")
    with shown(path) as page:
        assert page.call(SHOWN)["rings"] == 2
        skins = page.call("(() => application.scene.parts.map(({ skin }) => skin))")
        assert page.messages() == []
    assert skins == [0, 1]
    found = {(place["mesh"], place["skin"]) for place in places(path)}
    assert (1, 1) in found
    assert found <= {(0, 0), (1, 1)}


def places(path: Path) -> list[dict[str, Any]]:
    """Return the places in the page of a file."""
    given = re.search(
        rb'<script type="application/json" id="given">(.*?)</script>', view_file(str(path)).page
    )
    assert given is not None
    found: list[dict[str, Any]] = json.loads(given[1])["places"]
    return found


def test_places_of_vrm_0_are_those_of_the_same_character(tmp_path: Path) -> None:
    turned = edited("bent_tube.glb", tmp_path, lambda content: content.update(extensions={"VRM": {}}))
    assert places(TUBE) == places(turned)


def test_clips_may_have_one_name(tmp_path: Path) -> None:
    """The second shows most. The first moves one joint of two, by other keys."""

    def change(content: dict[str, Any]) -> None:
        [clip] = content["animations"]
        samplers = [{**clip["samplers"][0], "output": clip["samplers"][1]["output"]}]
        content["animations"] = [{**clip, "samplers": samplers, "channels": clip["channels"][:1]}, clip]

    assert places(edited("bent_tube.glb", tmp_path, change))[0]["clip"] == 1
