"""The poses to which a bake is fitted: how many, which, and made how often."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.errors import Place
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.pose_fit.poses import ANIMATIONS, BETWEEN, CLIP_POSES, poses_to_fit
from skinbake.truth.poses import PoseRequest, joint_clips, pose_set
from tests.support.baked_files import Editable

TUBE, TWO_SKINS = FOLDER / "bent_tube.glb", FOLDER / "shared_accessors.gltf"
PLACE = Place("a file")


def with_clips(folder: Path, count: int) -> Document:
    """Return the bent tube with its clip so many times."""
    file = Editable(TUBE)
    (clip,) = file.content["animations"]
    file.content["animations"] = [copy.deepcopy(clip) for _ in range(count)]
    return read_document(str(file.write(folder / f"{count}.glb")))


@pytest.mark.parametrize("count", range(1, 40))
def test_verify_measures_no_pose_that_the_fit_takes(tmp_path: Path, count: int) -> None:
    """verify samples N clips from end to end, 60 poses in all, or 3 of each."""
    document = with_clips(tmp_path, count)
    clips = joint_clips(document, 0, read_clips(document))
    measured = pose_set(document, 0, clips, PoseRequest()).times
    each = max(3, 61 // count)
    taken = pose_set(document, 0, clips, PoseRequest(samples=each, offset=BETWEEN)).times
    assert len(taken) == each * count
    first, others = ({round(float(time or 0.0), 6) for time in times} for times in (measured, taken))
    assert not first & others
    assert max(others) < clips[0].duration


@pytest.mark.parametrize(("count", "each"), [(2, 30), (40, 3), (400, 3), (401, 2), (1201, 1)])
def test_very_many_clips_have_fewer_poses_each(tmp_path: Path, count: int, each: int) -> None:
    document = with_clips(tmp_path, count)
    group = poses_to_fit(document, 0, [ANIMATIONS], PLACE).groups[0]
    assert len(group.joint_matrices) == each * count


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
    found, wanted = (poses_to_fit(one, 0, [ANIMATIONS], PLACE) for one in (crowded, alone))
    assert len(found.groups[0].joint_matrices) == CLIP_POSES
    assert found.fingerprint == wanted.fingerprint


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 100])
@pytest.mark.parametrize("path", [TUBE, TWO_SKINS], ids=["one skin", "two skins"])
def test_random_poses_are_as_many_as_asked_for(path: Path, count: int) -> None:
    (group,) = poses_to_fit(read_document(str(path)), 0, [f"random:{count}"], PLACE).groups
    assert len(group.joint_matrices) == count


def test_the_notice_counts_the_random_poses_that_replace_clips(tmp_path: Path) -> None:
    file = Editable(TUBE)
    del file.content["animations"]
    document = read_document(str(file.write(tmp_path / "still.glb")))
    found = poses_to_fit(document, 0, [ANIMATIONS], PLACE)
    (notice,) = document.notices
    assert f"{len(found.groups[0].joint_matrices)} random poses" in notice.message


def test_meshes_of_one_skin_share_their_poses() -> None:
    document = read_document(str(TUBE))
    first, second = (poses_to_fit(document, 0, [ANIMATIONS], PLACE) for _ in range(2))
    assert first.groups is second.groups
    assert poses_to_fit(document, 0, ["random:60"], PLACE).groups is not first.groups


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
    file = Editable(TUBE)
    del file.content["animations"]
    document = read_document(str(file.write(tmp_path / "still.glb")))
    assert len(pose_set(document, 0, (), PoseRequest(samples=100_000_000)).times) == 24
