"""The clip and the moment on which pictures and pages open, and the side from which they show a character."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.commands.view import view_file
from skinbake.freshness.baked_views import sound_views
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import RANDOM, read_clips
from skinbake.measure.scene import Scene
from tests.support.models import bake, edited

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


def test_of_equal_clips_the_first_is_shown(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        content["animations"] *= 3

    assert opened(edited(TUBE, tmp_path, change))[0] == 0


def matrices_of(path: Path, folder: Path) -> Float64Array:
    """Return the joint matrices (J, 4, 4) of a file as it is drawn at the first key of its clip."""
    bake(path, folder / "baked.glb")
    document = read_document(str(folder / "baked.glb"))
    (draw,), (clip,) = Scene(document, sound_views(document)).shown(), read_clips(document)
    matrices: Float64Array = draw.at(clip, np.array([BENT])).matrices[0]
    return matrices


@pytest.mark.parametrize(
    ("extensions", "turned"),
    [
        ({"VRM": {"specVersion": "0.0"}}, True),
        ({"VRM": {}}, True),
        ({"VRMC_vrm": {"specVersion": "1.0"}}, False),
        ({"VRMC_vrm": {"specVersion": "1.0"}, "VRM": {}}, False),
        ({"VRM": None}, False),
        ([], False),
    ],
)
def test_characters_of_vrm_0_are_turned_to_the_camera(
    tmp_path: Path, extensions: object, turned: bool
) -> None:
    plain = matrices_of(edited(TUBE, tmp_path, lambda content: None), tmp_path)
    path = edited(TUBE, tmp_path, lambda content: content.update(extensions=extensions))
    sides = (-1, 1, -1, 1) if turned else (1, 1, 1, 1)
    assert np.array_equal(matrices_of(path, tmp_path), plain * np.array(sides)[:, None])


@pytest.mark.parametrize(
    ("hidden", "more", "shown"),
    [
        ([(0, 1), (1, 0), (1, 1)], [], {(0, 0)}),
        ([(0, 1)], [(1, 0)], {(0, 0), (1, 0)}),
        ([(1, 0)], [(1, 1)], {(0, 0), (1, 2)}),
        ([(0, 1), (1, 0)], [(1, 1)], {(0, 0), (1, 2)}),
    ],
)
def test_only_pairs_of_mesh_and_skin_that_the_shown_scene_has_are_drawn(
    tmp_path: Path,
    hidden: list[tuple[int, int]],
    more: list[tuple[int, int]],
    shown: set[tuple[int, int]],
) -> None:
    """The first joints of both skins are 0 and 2. Another scene has the hidden pairs.

    If both skins draw both meshes, these are one surface.
    """

    def change(content: JsonObject) -> None:
        content["meshes"] *= 2
        [skin] = content["skins"]
        content["skins"].append({**skin, "joints": skin["joints"][::-1]})
        roots = content["scenes"][0]["nodes"]
        for pairs in (more, hidden):
            first = len(content["nodes"])
            content["nodes"] += [{"mesh": mesh, "skin": number} for mesh, number in pairs]
            content["scenes"].append({"nodes": [*roots, *range(first, first + len(pairs))]})
        content["scene"] = 1

    bake(edited(TUBE, tmp_path, change), tmp_path / "baked.glb")
    document = read_document(str(tmp_path / "baked.glb"))
    draws = Scene(document, sound_views(document)).shown()
    drawn = {
        (view.source.mesh, int(draw.skeleton.joints[0])) for draw in draws for view in draw.surface.views
    }
    assert drawn == shown
