"""Where a bake shows, and where it gets worse: places of a tube that bends by 90° at half a second."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import skinbake
from fixtures.make_fixtures import FOLDER
from skinbake.commands.shown import baked_in_memory, followed, spots_in_clips
from skinbake.commands.verify import verify_document
from skinbake.freshness.baked_views import sound_views
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.scenes import shown_by
from skinbake.measure.options import VerifyOptions
from skinbake.measure.places import WORSE, readable, spots_of
from skinbake.measure.scene import Scene
from skinbake.truth.poses import PoseRequest
from tests.support.models import edited


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("places") / "tube.glb"
    skinbake.bake(FOLDER / "bent_tube.glb", path)
    return path


def read(path: Path) -> Document:
    return read_document(str(path))


def test_the_first_place_is_where_the_normals_of_a_dump_improve_most(tube: Path) -> None:
    spots = verify_document(read(tube), VerifyOptions(finds_places=True)).spots
    assert spots is not None
    first = spots.shows[0]
    assert (first.clip, first.number) == ("bend", 0)
    assert first.time == pytest.approx(0.5, abs=0.08)
    [posed] = skinbake.normals(tube, clip="bend", time=first.time)
    truth = posed.truths["triangles"]
    cosines = [(posed.normals[one] * truth).sum(axis=1) for one in ("standard", "accurate")]
    standard, accurate = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    far = np.linalg.norm(posed.positions - posed.positions[first.vertex], axis=1)
    near = far < 1.5 * first.radius
    assert 10 < near.sum() < len(far) / 4
    assert (standard - accurate)[near].mean() > 2 * (standard - accurate).mean()
    assert first.standard == pytest.approx(standard[near].mean(), rel=0.35)
    assert first.standard > 10 * first.baked
    assert spots.worse == ()


def test_places_are_apart_and_named_by_a_joint_and_a_moment(tube: Path) -> None:
    spots = verify_document(read(tube), VerifyOptions(finds_places=True)).spots
    assert spots is not None
    assert 2 <= len(spots.shows) <= 5
    rest = read(tube)
    (view,) = sound_views(rest)
    middles = [view.now.positions[one.vertex] for one in spots.shows]
    size = np.linalg.norm(np.ptp(view.now.positions, axis=0))
    apart = [np.linalg.norm(a - b) for i, a in enumerate(middles) for b in middles[:i]]
    assert min(apart) > 0.05 * size
    names = {readable(node.name or "") for node in rest.asset.nodes}
    assert all(one.joint in names for one in spots.shows)
    assert spots.shows[0].where.endswith(f"bend {spots.shows[0].time:.2f} s")


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("mixamorig:LeftArm_012", "left arm"),
        ("mixamorig_RightUpLeg", "right up leg"),
        ("DEF-upper_arm.L", "left upper arm"),
        ("Bip01 R Forearm_07", "right forearm"),
        ("Bone_01", "bone 01"),
        ("Skeleton_torso_joint_1", "torso 1"),
        ("b_Tail02_013", "tail02"),
        ("joint0", "joint0"),
        ("spine.003", "spine 003"),
        ("_12", "12"),
        ("左腕", "左腕"),
        ("", ""),
    ],
)
def test_a_joint_is_named_as_people_read_it(name: str, shown: str) -> None:
    assert readable(name) == shown


def test_a_bake_with_the_wrong_sign_has_places_where_it_gets_worse(tube: Path) -> None:
    document = read(tube)
    scene = Scene(document, sound_views(document))
    [clip] = read_clips(document)
    draws = scene.shown()
    for draw in draws:
        wrong = [replace(one, alpha=-one.alpha, beta=-one.beta) for one in draw.surface.rest]
        draw.surface.__dict__["rest"] = wrong
    times = np.linspace(0.0, 0.5, 5)
    found = spots_of([draw.at(clip, times) for draw in draws])
    assert found.worse
    assert all(one.baked - one.standard > WORSE for one in found.worse)


def test_meshes_of_equal_skins_are_shown_together(tmp_path: Path) -> None:
    """Some exporters write a skin for each mesh."""

    def draw_twice(content: JsonObject) -> None:
        (mesh,) = content["meshes"]
        content["meshes"].append(mesh)
        content["skins"] += content["skins"]
        content["nodes"].append({"mesh": 1, "skin": 1})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    document = baked_in_memory(read(edited("bent_tube.glb", tmp_path, draw_twice)))
    scene = Scene(document, sound_views(document))
    (draw,) = scene.shown()  # equal skins are one
    assert [view.source.place.mesh for view in draw.surface.views] == [0, 1]
    spots = spots_in_clips(scene).shows
    assert np.isfinite([next(followed(spot, [draw])) for spot in spots]).all()
    assert shown_by(document, 0, [0, 1]) == {0: 0, 1: 1}


def test_a_mesh_of_another_scene_has_no_place(tmp_path: Path) -> None:
    def add_scene(content: JsonObject) -> None:
        (mesh,) = content["meshes"]
        content["meshes"].append(mesh)
        content["nodes"].append({"mesh": 1, "skin": 0})
        content["scenes"].append({"nodes": [len(content["nodes"]) - 1]})

    document = baked_in_memory(read(edited("bent_tube.glb", tmp_path, add_scene)))
    scene = Scene(document, sound_views(document))
    (draw,) = scene.measured(read_clips(document), PoseRequest())
    assert len(draw.surface.views) == 2
    spots = spots_in_clips(scene).shows
    assert {spot.place.mesh for spot in spots} == {0}


def test_a_clip_that_stands_still_has_no_place(tube: Path) -> None:
    document = read(tube)
    scene = Scene(document, sound_views(document))
    [clip] = read_clips(document)
    for times, count in ((np.full(5, 0.5), 0), (np.linspace(0.0, 0.5, 5), 1)):
        found = spots_of([draw.at(clip, times) for draw in scene.shown()])
        assert bool(found.shows) == bool(count)
