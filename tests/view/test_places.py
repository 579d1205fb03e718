"""Where a bake shows, on the page: where it opens, the list of places, and one lighting at a time."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from fixtures.make_fixtures import FOLDER
from skinbake.commands import where_it_shows
from skinbake.commands.view import view_file
from tests.support import browser
from tests.support.models import edited
from tests.view.pages import normals, picture, shown, take

pytestmark = pytest.mark.slow

TUBE = FOLDER / "bent_tube.glb"
SHOWN = """(() => ({
    clip: application.clip.name, time: application.time, playing: application.isPlaying,
    target: application.camera.target, eye: [...application.camera.eye], message: message.textContent,
    places: [...document.querySelectorAll('#places-list button')].map(({ textContent }) => textContent),
    hidden: places.hidden,
}))"""


@pytest.fixture
def browsing() -> Iterator[browser.Page]:
    """Open the page of a fixture, for each test anew: it changes what is shown."""
    with shown(TUBE) as page:
        yield page


def test_the_page_opens_close_up_where_the_bake_shows_most(browsing: browser.Page) -> None:
    """The normals that the page draws differ by more around the point it looks at than anywhere else."""
    page = browsing
    found = page.call(SHOWN)
    assert (found["clip"], found["playing"], found["hidden"]) == ("bend", False, False)
    assert found["time"] == pytest.approx(0.5, abs=0.08)
    first = found["places"][0]
    words = re.fullmatch(r"([\d.]+)° → ([\d.]+)°, \u2068bend\u2069 at 0\.\d\d s", first)
    assert words is not None, first
    assert float(words[1]) > 10 * float(words[2])
    assert found["message"] == f"Here {words[1]}° → {words[2]}°"
    standard, accurate = (
        normals(page, lighting, clip=0, time=found["time"]) for lighting in ("standard", "fitted")
    )
    positions = np.array(
        page.call("(() => [...application.scene.positions(application.scene.parts[0], 1)])")
    ).reshape(-1, 3)
    apart = np.degrees(np.arccos(np.clip((standard * accurate).sum(axis=1), -1, 1)))
    far = np.linalg.norm(positions - found["target"], axis=1)
    close = far < 0.12 * np.linalg.norm(np.ptp(positions, axis=0))
    assert 20 < close.sum() < len(far) / 4
    assert apart[close].mean() > 2 * apart.mean()
    assert far[apart > 0.8 * apart.max()].min() < 0.08 * np.linalg.norm(np.ptp(positions, axis=0))
    # It faces the camera.
    looking = np.array(found["eye"]) - found["target"]
    looking /= np.linalg.norm(looking)
    assert (accurate[close] @ looking).max() > 0.9


def test_each_place_is_another_view_of_the_model(browsing: browser.Page) -> None:
    count = len(browsing.call(SHOWN)["places"])
    assert 2 <= count <= 5
    views = []
    for number in range(count):
        browsing.call(f"(() => document.querySelectorAll('#places-list button')[{number}].click())")
        found = browsing.call(SHOWN)
        assert found["places"][number].startswith(found["message"].removeprefix("Here "))
        views.append(found["target"])
    apart = [np.linalg.norm(np.subtract(a, b)) for i, a in enumerate(views) for b in views[:i]]
    assert min(apart) > 0.3
    browsing.call("(() => home.click())")
    assert browsing.call(SHOWN)["message"] == ""


def test_one_lighting_is_shown_alone_by_key_and_by_button(browsing: browser.Page) -> None:
    """What one lighting draws on its side of the divider, it draws everywhere when it is alone."""
    page = browsing
    page.call(
        """(() => {
            document.querySelector('#places-list button').click();
            application.stopMeasuring();
            document.querySelector('input[value=normals]').click();
            application.setSplit(0.5);
            canvas.focus();
        })"""
    )
    seen = {"both": picture(page)}
    for key in "ab":
        page.press(key)
        seen[key] = picture(page)
        hidden = page.call(
            """(() => ['.side-left', '.side-right'].map((side) =>
                getComputedStyle(document.querySelector(side)).visibility))"""
        )
        assert hidden == (["visible", "hidden"] if key == "a" else ["hidden", "visible"])
    middle = seen["both"].shape[1] // 2
    assert np.array_equal(seen["both"][:, : middle - 2], seen["a"][:, : middle - 2])
    assert np.array_equal(seen["both"][:, middle + 2 :], seen["b"][:, middle + 2 :])
    assert np.abs(seen["a"].astype(int) - seen["b"]).max() > 40
    page.press("b")
    assert np.array_equal(picture(page), seen["both"])
    for key in "ba":  # the button goes from one to the other
        page.call(
            "(() => flip.click())" if key == "a" else "(() => { application.setSplit(1); flip.click(); })"
        )
        assert np.array_equal(picture(page), seen[key])
    page.call("(() => { application.setSplit(0.5); document.querySelector('input[value=shaded]').click(); })")


def test_a_dropped_file_has_no_places(browsing: browser.Page) -> None:
    take(browsing, FOLDER / "seam.glb")
    assert browsing.call(SHOWN)["hidden"] is True


def test_a_file_without_clips_opens_on_a_place_in_random_poses(tmp_path: Path) -> None:
    """The CPU draws the same poses, though it makes their numbers by itself."""
    path = edited("bent_tube.glb", tmp_path, lambda content: content.pop("animations"))
    with shown(path) as page:
        found = page.call(SHOWN)
        drawn = normals(page, "standard", clip=0, time=found["time"])
    assert (found["clip"], found["playing"]) == ("Random poses", False)
    assert 0.2 < found["time"] < 8.8  # at 0 and 9 s it rests
    words = re.match(r"([\d.]+)° → ([\d.]+)°", found["places"][0])
    assert words is not None
    assert float(words[1]) > 5 * float(words[2])
    skinbake.bake(path, path)
    [posed] = skinbake.normals(path, time=found["time"])
    assert posed.clip is None
    assert np.abs(drawn - posed.normals["standard"]).max() < 2e-4  # 0.01°
    assert posed.time == skinbake.normals(path)[0].time


def places(path: Path) -> list[dict[str, Any]]:
    """Return the places in the page of a file."""
    given = re.search(
        rb'<script type="application/json" id="given">(.*?)</script>', view_file(str(path)).page
    )
    assert given is not None
    found: list[dict[str, Any]] = json.loads(given[1])["places"]
    return found


def test_places_of_vrm_0_lie_where_those_of_the_same_character_do(tmp_path: Path) -> None:
    """It is searched as it stands before the camera, and shown as it stands in the file."""
    turned = edited("bent_tube.glb", tmp_path, lambda content: content.update(extensions={"VRM": {}}))
    first, other = (places(path)[0] for path in (TUBE, turned))
    assert first["words"] == other["words"]
    assert other["middle"] == pytest.approx(first["middle"], abs=0.05)  # the same side, at its angle
    assert np.dot(other["towards"], first["towards"]) > 0.95


def test_where_triangles_are_too_many_some_vertices_find_much_the_same_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    every = places(TUBE)[0]
    monkeypatch.setattr(where_it_shows, "TESTS", 1 << 11)
    some = places(TUBE)[0]
    assert some["middle"] == pytest.approx(every["middle"], abs=0.3)
    assert np.dot(some["towards"], every["towards"]) > 0.8
    angles = [[float(one) for one in re.findall(r"[\d.]+", found["words"])] for found in (every, some)]
    assert angles[1][0] == pytest.approx(angles[0][0], rel=0.2)
    assert angles[1][0] > 10 * angles[1][1]


def test_a_place_is_found_in_the_moments_that_the_bytes_of_a_file_afford(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A mesh that many skins draw has many vertices in each moment, and few bytes."""
    every, moments = places(TUBE), []
    posed = where_it_shows._Search.moments

    def counted(search: Any, clip: Any, times: Any) -> Any:
        moments.extend(times)
        return posed(search, clip, times)

    monkeypatch.setattr(where_it_shows._Search, "moments", counted)
    places(TUBE)
    assert len(moments) > 20
    moments.clear()
    monkeypatch.setattr(where_it_shows, "LOOKS_FREE", 0)
    monkeypatch.setattr(where_it_shows, "LOOKS_A_BYTE", 0)
    [first, *_] = places(TUBE)
    assert len(moments) == 1
    assert first["middle"] == pytest.approx(every[0]["middle"], abs=0.5)


def test_clips_may_have_one_name(tmp_path: Path) -> None:
    """The second shows most. The first moves one joint of two, by other keys."""

    def change(content: dict[str, Any]) -> None:
        [clip] = content["animations"]
        samplers = [{**clip["samplers"][0], "output": clip["samplers"][1]["output"]}]
        content["animations"] = [{**clip, "samplers": samplers, "channels": clip["channels"][:1]}, clip]

    assert places(edited("bent_tube.glb", tmp_path, change))[0]["clip"] == 1
