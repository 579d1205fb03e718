"""The clip and the moment on which pages open."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from fixtures.builder import JsonObject
from skinbake.commands.view import view_file
from skinbake.gltf.reading.clips import RANDOM
from tests.support.models import edited

TUBE = "bent_tube.glb"
STRAIGHT, BENT = 0.0, 0.5
"""Times of the clip "bend": at 0.5 s it bends the tube by 90°, its most."""


def opened(path: Path) -> tuple[int, float]:
    """Return the number of the animation and the time on which the page of a file opens."""
    given = re.search(rb'"places":\[\{"clip":(-?\d+),"time":([\d.e-]+)', view_file(str(path)).page)
    assert given is not None
    return int(given[1]), float(given[2])


def held(time: float, name: str = "RESET") -> Callable[[JsonObject], JsonObject]:
    """Return a function that makes a clip which holds the pose of a time of the clip "bend"."""

    def made(content: JsonObject) -> JsonObject:
        clip = copy.deepcopy(content["animations"][-1])
        for sampler in clip["samplers"]:
            key = round(time * 24)
            for member, size in (("input", 4), ("output", 16)):
                accessor = copy.deepcopy(content["accessors"][sampler[member]])
                accessor["count"] = 1
                accessor.pop("min", None), accessor.pop("max", None)
                accessor["byteOffset"] = accessor.get("byteOffset", 0) + size * key
                sampler[member] = len(content["accessors"])
                if member == "input":
                    accessor |= {"min": [key / 24], "max": [key / 24]}
                content["accessors"].append(accessor)
        return {**clip, "name": name}

    return made


def empty(content: JsonObject) -> JsonObject:
    return {"name": "empty", "channels": [], "samplers": []}


@pytest.mark.slow
@pytest.mark.parametrize(
    "first", [[held(STRAIGHT)], [empty, held(STRAIGHT)], [held(STRAIGHT, f"{n}") for n in range(45)], []]
)
def test_the_clip_that_bends_is_shown_where_it_bends_most(
    tmp_path: Path, first: list[Callable[[JsonObject], JsonObject]]
) -> None:
    def change(content: JsonObject) -> None:
        content["animations"] = [*(clip(content) for clip in first), *content["animations"]]

    number, time = opened(edited(TUBE, tmp_path, change))
    assert number == len(first)
    assert abs(time - BENT) < 0.08  # it may show more a little before or after, seen from elsewhere


@pytest.mark.slow
@pytest.mark.parametrize(("more", "number"), [([], RANDOM), ([held(BENT)], RANDOM), ([empty, None], 3)])
def test_random_poses_are_shown_if_all_clips_stand_still(
    tmp_path: Path, more: list[Callable[[JsonObject], JsonObject] | None], number: int
) -> None:
    """The clip of None is the one that moves."""

    def change(content: JsonObject) -> None:
        clips = [held(STRAIGHT)(content), held(BENT)(content)]
        (moving,) = content["animations"]
        content["animations"] = [*clips, *(moving if one is None else one(content) for one in more)]

    assert opened(edited(TUBE, tmp_path, change))[0] == number


@pytest.mark.slow
def test_of_equal_clips_the_first_is_shown(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        content["animations"] *= 3

    assert opened(edited(TUBE, tmp_path, change))[0] == 0
