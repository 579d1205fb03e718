"""What a scene draws: its surfaces, the skins that draw them, and their poses, alike for all who ask."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.freshness.baked_views import sound_views
from skinbake.freshness.staleness import surface_operator
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.measure.scene import Scene
from skinbake.truth.poses import PoseRequest
from tests.support.models import bake, edited

TUBE = "bent_tube.glb"
BENT = 0.5
"""The time of the clip "bend" at which it bends the tube by 90°, its most."""


def scene_of(path: Path, folder: Path, **options: object) -> Scene:
    """Bake a file, and return its scene with the operators of the bake."""
    bake(path, folder / "baked.glb", **options)
    document = read_document(str(folder / "baked.glb"))
    return Scene.of_bakes(document, sound_views(document))


def test_a_draw_has_the_same_pose_measured_and_shown(tmp_path: Path) -> None:
    scene = scene_of(edited(TUBE, tmp_path, lambda content: None), tmp_path)
    clips = read_clips(scene.document)
    (measured,), (shown,) = scene.measured(clips, PoseRequest(samples=5)), scene.shown()
    times = np.array(measured.poses.times, dtype=np.float64)
    assert len(np.unique(times)) == 5
    assert np.array_equal(shown.at(clips[0], times).matrices, measured.matrices)
    assert shown.matrices.shape == (1, *measured.matrices.shape[1:])  # at rest


def test_all_skins_draw_the_arrays_of_one_surface(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        [skin] = content["skins"]
        content["skins"].append({**skin, "joints": skin["joints"][::-1]})
        content["nodes"].append({"mesh": 0, "skin": 1})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    scene = scene_of(edited(TUBE, tmp_path, change), tmp_path)
    for draws in (scene.measured(read_clips(scene.document), PoseRequest()), scene.shown()):
        assert [draw.skin for draw in draws] == [0, 1]
        assert draws[0].surface is draws[1].surface


@pytest.mark.parametrize(("crease", "serves"), [(15.0, True), (60.0, False)])
def test_an_operator_of_a_bake_serves_again_with_the_settings_of_the_truths(
    tmp_path: Path, crease: float, serves: bool
) -> None:
    bake(edited(TUBE, tmp_path, lambda content: None), tmp_path / "baked.glb", crease_angle=crease)
    document = read_document(str(tmp_path / "baked.glb"))
    views = sound_views(document)
    operator = surface_operator(document, views)
    (surface,) = Scene.of_bakes(document, views, [operator]).surfaces
    assert (surface.operator is operator) is serves


def matrices_of(path: Path, folder: Path) -> Float64Array:
    """Return the joint matrices (J, 4, 4) of a file as it is drawn at the first key of its clip."""
    scene = scene_of(path, folder)
    (draw,), (clip,) = scene.shown(), read_clips(scene.document)
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

    draws = scene_of(edited(TUBE, tmp_path, change), tmp_path).shown()
    drawn = {
        (view.source.mesh, int(draw.skeleton.joints[0])) for draw in draws for view in draw.surface.views
    }
    assert drawn == shown
