"""Morphed characters in ``skinbake verify``: fixtures with targets and weights added, byte by byte."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.choices import FrameChoice, PoseKind
from skinbake.errors import InputError
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.measure import measured
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.poses import PoseRequest, draws_of, pose_set
from skinbake.truth.truths import Truths
from tests.support.baked_files import Editable, baked, source, verify
from tests.support.baking import bake_settings
from tests.support.morphed_files import morphed, with_tangents
from tests.support.straightforward import Character, duff, unit

Floats = npt.NDArray[np.floating[Any]]
JsonObject = dict[str, Any]


def animate_weights(path: Path, weights: object, *, clip: int | None = 0, node: int = 0) -> Path:
    """Add a LINEAR channel of weights, keys × targets, over the first half second; clip None makes one."""
    file = Editable(path)
    values = np.array(weights, dtype=np.float32)
    times = file.add(np.linspace(0, 0.5, len(values), dtype=np.float32)[:, None])
    if clip is None:
        file.content.setdefault("animations", []).append({"name": "talk", "samplers": [], "channels": []})
    animation = file.content["animations"][-1 if clip is None else clip]
    animation["samplers"].append({"input": times, "output": file.add(values.reshape(-1, 1))})
    target = {"node": node, "path": "weights"}
    animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})
    return file.write(path)


def tube(folder: Path, **changes: Any) -> Path:
    """The bent tube, baked, with two targets that nothing moves."""
    path = baked(source("bent_tube.glb"), folder)
    return morphed(path, path, **changes)


def lbs(path: Path, *options: str) -> JsonObject:
    answer = verify(path, "--method", "lbs", *options)
    assert answer.exit_code == 0, answer.messages
    found: JsonObject = answer.file["normals_by_tangents"]["lbs"]
    return found


@pytest.mark.slow
def test_the_figures_are_those_of_a_straightforward_computation(tmp_path: Path) -> None:
    path = animate_weights(tube(tmp_path), [[0.0, 1.0], [1.0, 0.2], [0.3, 0.0]])
    found = lbs(path, "--samples", "3")
    character = Character.read(path)
    times = character.middles(3)
    errors = [character.errors(time) for time in times]
    for lighting, place in (("standard", 0), ("accurate", 1)):
        each = np.stack([one[place] for one in errors])
        valid = np.isfinite(each)
        areas = np.where(valid, errors[0][2], 0.0)
        mean = np.average(np.where(valid, each, 0.0), weights=areas)
        # α and β are float32 here and there; n0 is float32 there only.
        assert found[lighting]["mean"] == pytest.approx(mean, rel=1e-5)
    assert found["gain"] > 3
    unmorphed = lbs(baked(source("bent_tube.glb"), tmp_path), "--samples", "3")
    assert abs(found["standard"]["mean"] / unmorphed["standard"]["mean"] - 1) > 0.01


@pytest.mark.slow
def test_morphs_are_counted_and_told(tmp_path: Path) -> None:
    assert verify(baked(source("bent_tube.glb"), tmp_path)).file["morphs"] is None
    path = tube(tmp_path, targets=3)
    assert verify(path).file["morphs"] == {"targets": 3, "moving": 0}
    animate_weights(path, [[0.0, 0.5, 0.0], [0.0, 1.0, 0.0]])
    assert verify(path).file["morphs"] == {"targets": 3, "moving": 1}
    assert verify(path, "--poses", "random:8").file["morphs"] == {"targets": 3, "moving": 3}


@pytest.mark.slow
def test_weights_of_zero_are_the_file_without_them_bit_for_bit(tmp_path: Path) -> None:
    plain = verify(baked(source("bent_tube.glb"), tmp_path), "--samples", "5").file["normals_by_tangents"]
    path = tube(tmp_path)
    assert verify(path, "--samples", "5").file["normals_by_tangents"] == plain
    animate_weights(path, [[0.0, 0.0], [0.0, 0.0]])
    assert verify(path, "--samples", "5").file["normals_by_tangents"] == plain


@pytest.mark.parametrize("name", ["bent_tube.glb", "mirrored_tangent.glb", "two_primitives.glb"])
def test_where_skinning_is_the_identity_every_lighting_gives_the_morphed_normals(
    name: str, tmp_path: Path
) -> None:
    """At rest these fixtures are unskinned; the weights at rest are the node's."""
    path = baked(source(name), tmp_path)
    plain = verify(path, "--poses", "rest")
    mesh_node = next(n for n, node in enumerate(Editable(path).content["nodes"]) if "mesh" in node)
    assert mesh_node == 0
    path = morphed(path, path, weights=[0.9, -0.4])
    answer = verify(path, "--poses", "rest")
    assert answer.exit_code == 0, answer.messages
    assert answer.file["morphs"]["moving"] == 2
    for figures in answer.file["normals_by_tangents"].values():
        for lighting, figure in figures.items():
            if lighting != "gain":
                assert figure["max"] < 1e-4
    for check in plain.file["checks"]:
        assert check["outcome"] != "failed"


def test_bake_is_that_of_the_mesh_without_targets_whatever_their_weights(tmp_path: Path) -> None:
    plain = Editable(baked(source("bent_tube.glb"), tmp_path))
    folder = tmp_path / "morphed"
    folder.mkdir()
    moved = morphed(source("bent_tube.glb"), tmp_path / "moved.glb", weights=[1.0, 0.5])
    found = Editable(baked(moved, folder))
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        assert np.array_equal(found.array(name), plain.array(name))
    assert found.metadata()["digest"] == plain.metadata()["digest"]


def test_targets_that_change_after_a_bake_make_it_no_staler(tmp_path: Path) -> None:
    path = tube(tmp_path)
    file = Editable(path)
    file.stored(file.primitive()["targets"][0]["POSITION"])[:] *= 2.0
    assert verify(file.write(path)).failed == []


@pytest.mark.slow
def test_lbs_and_dqs_share_morphed_surfaces_that_are_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = morphed(baked(source("mirrored_tangent.glb"), tmp_path), tmp_path / "moved.glb", targets=1)
    made = []

    def counted(truth: Truths, surfaces: Sequence[RestPrimitive]) -> Truths:
        made.append(surfaces)
        return moved(truth, surfaces)

    moved = Truths.moved
    monkeypatch.setattr(Truths, "moved", counted)
    shared = verify(path).file["normals_by_tangents"]
    once = len(made)
    assert set(shared) == {"lbs", "dqs"}
    assert once > 10
    monkeypatch.setattr(measured, "MORPHED_BYTES", 0)
    assert verify(path).file["normals_by_tangents"] == shared
    assert len(made) == 3 * once


# The tangent frame


@pytest.mark.slow
def test_the_morphed_fixture_is_better_lit_in_either_frame(tmp_path: Path) -> None:
    for frame in (FrameChoice.TANGENT, FrameChoice.NORMAL):
        path = baked(source("morphed_sheet.glb"), tmp_path, bake_settings(frame=frame))
        answer = verify(path)
        assert answer.exit_code == 0, answer.messages
        assert answer.file["morphs"] == {"targets": 2, "moving": 2}
        # 15 and 18, measured; 0.5 where the frame stays as it is at rest.
        assert answer.file["normals_by_tangents"]["lbs"]["gain"] > 12


@pytest.mark.slow
def test_targets_of_tangents_carry_the_tangent_frame(tmp_path: Path) -> None:
    path = morphed(baked(source("mirrored_tangent.glb"), tmp_path), tmp_path / "moved.glb", targets=1)
    by_normal = lbs(path)["accurate"]["mean"]
    # A turn that the positions do not make is a wrong tangent: only a tangent that is read can do harm.
    by_tangent = lbs(with_tangents(path, 0.8))["accurate"]["mean"]
    assert by_tangent > 1.3 * by_normal


@pytest.mark.slow
def test_targets_of_tangents_do_not_touch_the_normal_frame(tmp_path: Path) -> None:
    path = baked(source("mirrored_tangent.glb"), tmp_path, bake_settings(frame=FrameChoice.NORMAL))
    path = morphed(path, tmp_path / "moved.glb", targets=1)
    before = lbs(path)
    assert lbs(with_tangents(path, 0.8)) == before


# Which weights


def test_nodes_that_share_a_mesh_have_weights_of_their_own(tmp_path: Path) -> None:
    document = read_document(str(source("shared_accessors.gltf")))
    clips = read_clips(document)
    draws = draws_of(document, 0, clips)
    assert draws == [(0, 0), (1, 3)]
    found = [pose_set(document, skin, clips, PoseRequest(), node) for skin, node in draws]
    assert [np.unique(np.asarray(poses.morph_weights)).tolist() for poses in found] == [[0.25], [0.5]]


def test_nodes_of_one_skin_and_equal_weights_are_one_draw(tmp_path: Path) -> None:
    file = Editable(tube(tmp_path, weights=[0.0, 0.5]))
    nodes = file.content["nodes"]
    first = len(nodes)
    nodes += [dict(nodes[0], weights=weights) for weights in ([0.0, 0.5], [0.5, 0.0], [0.5, 0.0])]
    path = file.write(tmp_path / "twins.glb")
    document = read_document(str(path))
    assert draws_of(document, 0, read_clips(document)) == [(0, 0), (0, first + 1)]
    animate_weights(path, [[0.0, 0.0], [1.0, 0.0]], node=first)
    document = read_document(str(path))
    assert draws_of(document, 0, read_clips(document)) == [(0, 0), (0, first), (0, first + 1)]


def point(path: Path, pointer: str) -> Path:
    """Let the last channel of the last clip name its target by a pointer of KHR_animation_pointer."""
    file = Editable(path)
    extensions = {"KHR_animation_pointer": {"pointer": pointer}}
    target = {"path": "pointer", "extensions": extensions}
    file.content["animations"][-1]["channels"][-1]["target"] = target
    return file.write(path)


@pytest.mark.parametrize("pointer", ["/meshes/0/weights", "/nodes/0/weights"])
def test_a_pointer_to_weights_moves_them_as_a_channel_with_a_node_does(pointer: str, tmp_path: Path) -> None:
    path = animate_weights(tube(tmp_path), [[0.0, 1.0], [1.0, 0.2]])
    wanted = sampled(path).morph_weights
    assert np.ptp(wanted, axis=0).min() > 0.5
    assert np.array_equal(sampled(point(path, pointer)).morph_weights, wanted)


def test_weights_of_a_mesh_move_its_nodes_that_have_none_of_their_own(tmp_path: Path) -> None:
    file = Editable(tube(tmp_path))
    nodes = file.content["nodes"]
    first = len(nodes)
    nodes += [dict(nodes[0]), dict(nodes[0], weights=[0.5, 0.0]), {"mesh": 0}]
    path = animate_weights(file.write(tmp_path / "three.glb"), [[0.0, 0.0], [1.0, 0.25]])
    document = read_document(str(point(path, "/meshes/0/weights")))
    clips = read_clips(document)
    draws = draws_of(document, 0, clips)
    assert draws == [(0, 0), (0, first), (0, first + 1)]
    found = [pose_set(document, skin, clips, PoseRequest(), node).morph_weights for skin, node in draws]
    highest = [weights.max(axis=0).tolist() for weights in found if weights is not None]
    assert highest == [[1.0, 0.25], [1.0, 0.25], [0.5, 0.0]]


@pytest.mark.parametrize("pointer", ["/meshes/00/weights", "/meshes/0/primitives/0"])
def test_a_pointer_to_something_else_of_a_mesh_moves_nothing(pointer: str, tmp_path: Path) -> None:
    path = animate_weights(tube(tmp_path), [[0.0, 1.0], [1.0, 0.2]])
    assert not np.asarray(sampled(point(path, pointer)).morph_weights).any()


def test_a_pointer_to_a_mesh_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = point(animate_weights(tube(tmp_path), [[0.0, 1.0], [1.0, 0.2]]), "/meshes/1/weights")
    with pytest.raises(InputError, match='the pointer "/meshes/1/weights": "mesh" is 1, but the file has 1'):
        sampled(path)


def sampled(path: Path, **request: Any) -> Any:
    document = read_document(str(path))
    return pose_set(document, 0, read_clips(document), PoseRequest(**request), 0)


def test_weights_are_sampled_at_the_times_of_the_joints(tmp_path: Path) -> None:
    path = animate_weights(tube(tmp_path, weights=[0.0, 0.7]), [[0.0, 1.0], [1.0, 0.0]])
    poses = sampled(path, samples=5)
    # The clip lasts 23 / 24 s, the weights stop at half a second.
    times = np.array(poses.times)
    assert times == pytest.approx(23 / 24 * np.array([0.1, 0.3, 0.5, 0.7, 0.9]))
    share = np.minimum(times / 0.5, 1.0)
    assert poses.morph_weights == pytest.approx(np.stack([share, 1 - share], axis=1), abs=1e-7)
    assert np.ptp(poses.joint_matrices, axis=0).max() > 0.1


def test_a_clip_of_weights_alone_counts_beside_one_that_moves_joints(tmp_path: Path) -> None:
    path = animate_weights(tube(tmp_path, weights=[0.0, 0.7]), [[0.0, 1.0], [1.0, 0.0]], clip=None)
    poses = sampled(path, samples=2)
    assert poses.clips == ("bend", "bend", "talk", "talk")
    assert poses.morph_weights == pytest.approx(
        np.array([[0, 0.7], [0, 0.7], [0.25, 0.75], [0.75, 0.25]]), abs=1e-12
    )
    assert np.array_equal(poses.joint_matrices[2], poses.joint_matrices[3])


def test_a_file_whose_clips_only_morph_gets_random_poses(tmp_path: Path) -> None:
    file = Editable(tube(tmp_path))
    del file.content["animations"]
    path = animate_weights(file.write(tmp_path / "talk.glb"), [[0.0, 1.0], [1.0, 0.0]], clip=None)
    assert sampled(path).clips[0] == "random pose 0"


def test_random_poses_move_two_targets_at_a_time_and_turn_joints_as_without(tmp_path: Path) -> None:
    path = tube(tmp_path, targets=5, weights=[0, 0, 0, 0, 3.0])
    poses = sampled(path, kind=PoseKind.RANDOM, samples=200, seed=4)
    weights = poses.morph_weights
    at_rest = weights == [0, 0, 0, 0, 3.0]
    assert ((~at_rest).sum(axis=1) == 2).all()
    assert weights[~at_rest].min() >= 0.0
    assert weights[~at_rest].max() <= 1.0
    # 80 of 200 for each: four standard deviations are 28.
    assert np.abs((~at_rest).sum(axis=0) - 80).max() < 28
    assert np.array_equal(weights, sampled(path, kind=PoseKind.RANDOM, samples=200, seed=4).morph_weights)
    assert not np.array_equal(weights, sampled(path, kind=PoseKind.RANDOM, samples=200, seed=5).morph_weights)
    document = read_document(str(path))
    unmorphed = pose_set(document, 0, [], PoseRequest(kind=PoseKind.RANDOM, samples=200, seed=4))
    assert np.array_equal(poses.joint_matrices, unmorphed.joint_matrices)
    assert unmorphed.morph_weights is None


# Broken files


@pytest.mark.slow
def test_a_broken_target_is_refused_where_it_moves_and_only_there(tmp_path: Path) -> None:
    path = tube(tmp_path)
    file = Editable(path)
    file.primitive()["targets"][1]["NORMAL"] = file.primitive()["attributes"]["JOINTS_0"]
    file.write(path)
    assert verify(path).exit_code == 0
    animate_weights(path, [[0.0, 0.0], [0.0, 1.0]])
    answer = verify(path)
    assert answer.exit_code == 3
    assert 'mesh 0 "tube", primitive 0, NORMAL of morph target 1: it has 4 components' in answer.messages


def test_tangents_that_cancel_leave_the_frame_to_the_normal(tmp_path: Path) -> None:
    path = baked(source("mirrored_tangent.glb"), tmp_path)
    path = with_tangents(morphed(path, tmp_path / "moved.glb", targets=1, weights=[1.0]), 0.1)
    file = Editable(path)
    rest = file.array("TANGENT")[:, :3]
    file.stored(file.primitive()["targets"][0]["TANGENT"])[:] = -rest
    answer = verify(file.write(path), "--method", "lbs", "--poses", "rest")
    assert answer.exit_code == 0, answer.messages
    assert answer.file["normals_by_tangents"]["lbs"]["accurate"]["max"] < 1e-4


def test_the_oracle_carries_frames_as_rotations_do() -> None:
    normals = unit(np.random.default_rng(1).normal(size=(9, 3)))
    tangents, bitangents = duff(normals)
    assert np.cross(tangents, bitangents) == pytest.approx(normals, abs=1e-12)
