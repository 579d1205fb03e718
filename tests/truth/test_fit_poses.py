"""The poses to which a bake is fitted: how many, which, and made how often."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.truth.fit_poses import ANIMATIONS, BETWEEN, CLIP_POSES, posed_rig
from skinbake.truth.poses import PoseRequest, moving_clips, pose_set
from tests.support.baked_files import Editable

TUBE, TWO_SKINS = FOLDER / "bent_tube.glb", FOLDER / "shared_accessors.gltf"


def with_clips(folder: Path, count: int) -> Document:
    """Return the bent tube with its clip so many times."""
    file = Editable(TUBE)
    clips = file.content.pop("animations")
    if count:
        file.content["animations"] = [copy.deepcopy(clips[0]) for _ in range(count)]
    return read_document(str(file.write(folder / f"{count}.glb")))


def rig(document: Document, *sources: str) -> Rig:
    found = posed_rig(document, skinned_sources(document)[0], sources)
    assert found is not None
    return found


@pytest.mark.parametrize("count", range(1, 40))
def test_verify_measures_no_pose_that_the_fit_takes(tmp_path: Path, count: int) -> None:
    document = with_clips(tmp_path, count)
    clips = moving_clips(document, 0, read_clips(document))
    measured = pose_set(document, 0, clips, PoseRequest()).times
    each = -(-CLIP_POSES // min(count, CLIP_POSES))
    taken = pose_set(document, 0, clips[:1], PoseRequest(samples=each, offset=BETWEEN)).times
    first, others = ({round(float(time or 0.0), 6) for time in times} for times in (measured, taken))
    assert not first & others
    assert max(others) < clips[0].duration


@pytest.mark.parametrize("count", [1, 2, 3, 10, 11, 12, 40, 401])
def test_any_number_of_clips_has_as_many_poses(tmp_path: Path, count: int) -> None:
    found = rig(with_clips(tmp_path, count)).poses
    assert len(found) == CLIP_POSES
    assert len(np.unique(found.reshape(CLIP_POSES, -1), axis=0)) == -(-CLIP_POSES // min(count, CLIP_POSES))


def test_samples_lie_evenly_inside_a_clip(tmp_path: Path) -> None:
    document = with_clips(tmp_path, 1)
    (clip,) = read_clips(document)
    times = np.array(pose_set(document, 0, [clip], PoseRequest(samples=5, offset=0.25)).times, float)
    length = clip.duration - clip.start
    np.testing.assert_allclose(times, clip.start + length * np.array([0.05, 0.25, 0.45, 0.65, 0.85]))


def test_clips_of_other_nodes_take_no_poses_from_the_joints(tmp_path: Path) -> None:
    alone = read_document(str(TUBE))
    file = Editable(TUBE)
    file.content["nodes"].append({"name": "door"})
    (clip,) = file.content["animations"]
    other = copy.deepcopy(clip)
    for channel in other["channels"]:
        channel["target"]["node"] = len(file.content["nodes"]) - 1
    file.content["animations"] += [other] * 19
    crowded = read_document(str(file.write(tmp_path / "doors.glb")))
    assert rig(crowded).fingerprint == rig(alone).fingerprint


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 100])
@pytest.mark.parametrize("path", [TUBE, TWO_SKINS], ids=["one skin", "two skins"])
def test_random_poses_are_as_many_as_asked_for(path: Path, count: int) -> None:
    assert len(rig(read_document(str(path)), f"random:{count}").poses) == count


def test_a_file_without_clips_is_fitted_to_turns_alone_and_says_so_if_asked_for_clips(tmp_path: Path) -> None:
    document = with_clips(tmp_path, 0)
    assert len(rig(document).poses) == 0
    assert not list(document.notices)
    assert len(rig(document, ANIMATIONS).poses) == 0
    (notice,) = document.notices
    assert "no clip moves its joints: α/β are fitted to turns" in notice.message


def test_the_numbers_of_poses_are_those_of_float32() -> None:
    poses = rig(read_document(str(TUBE))).poses
    assert np.array_equal(poses, poses.astype(np.float32))


def test_clips_are_read_once_for_all_meshes() -> None:
    document = read_document(str(TUBE))
    first, second = (read_clips(document) for _ in range(2))
    assert first and all(one is other for one, other in zip(first, second, strict=True))
    [some] = read_clips(document, [0])
    assert some is first[0] and some.number == 0
    other = read_clips(document.edited(json={**document.json, "animations": []}))
    assert not other and first


def test_samples_do_not_count_where_no_clip_is_sampled(tmp_path: Path) -> None:
    """24 random poses replace clips, however many samples of a clip were asked for."""
    document = with_clips(tmp_path, 0)
    assert len(pose_set(document, 0, (), PoseRequest(samples=100_000_000)).times) == 24


def test_skins_that_differ_in_their_bind_poses_share_what_a_clip_moves(tmp_path: Path) -> None:
    file = Editable(TUBE)
    file.content["skins"].append({"joints": file.content["skins"][0]["joints"]})
    path = str(file.write(tmp_path / "two.glb"))

    def posed(document: Document, skin: int) -> tuple[Float64Array, float]:
        """Return the joint matrices of a skin in its clip, and the steps that they took."""
        before, clips = document.budget.taken.steps, moving_clips(document, skin, read_clips(document))
        matrices = pose_set(document, skin, clips, PoseRequest(samples=8)).joint_matrices
        return matrices, document.budget.taken.steps - before

    document = read_document(path)
    first, _ = posed(document, 0)
    second, steps = posed(document, 1)
    alone, steps_alone = posed(read_document(path), 1)
    assert np.array_equal(second, alone) and not np.allclose(first, second)
    assert steps <= steps_alone - Cost.SAMPLED_CLIP.steps
