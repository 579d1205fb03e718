"""The stored pose of a rig: the joint matrices of the nodes as the file stores them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fixtures.builder import JsonObject
from skinbake.geometry.rig import Rig
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.skins import rig_of_mesh
from tests.support.models import edited

MODEL = "bent_tube.glb"


def rig(path: Path) -> Rig:
    return rig_of_mesh(read_document(str(path)), 0)[0]


def joint(content: JsonObject, number: int) -> JsonObject:
    found: JsonObject = content["nodes"][content["skins"][0]["joints"][number]]
    return found


def turn(degrees: float) -> list[float]:
    """Return a turn about z as glTF stores it."""
    half = np.radians(degrees) / 2.0
    return [0.0, 0.0, float(np.sin(half)), float(np.cos(half))]


@pytest.mark.parametrize(("degrees", "counts"), [(0.0, False), (0.95, False), (1.05, True), (90.0, True)])
def test_a_joint_turned_by_over_a_degree_is_a_stored_pose(
    degrees: float, counts: bool, tmp_path: Path
) -> None:
    path = edited(MODEL, tmp_path, lambda content: joint(content, 1).update(rotation=turn(degrees)))
    assert (len(rig(path).poses) == 1) == counts


@pytest.mark.parametrize(("scale", "counts"), [(1.013, False), (1.016, True), (-1.0, True)])
def test_a_joint_scaled_by_over_1_4_percent_is_a_stored_pose(
    scale: float, counts: bool, tmp_path: Path
) -> None:
    path = edited(MODEL, tmp_path, lambda content: joint(content, 1).update(scale=[scale] * 3))
    assert (len(rig(path).poses) == 1) == counts


def test_joints_turned_and_scaled_together_are_no_stored_pose(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        joint(content, 0).update(rotation=turn(70.0), scale=[3.0, 3.0, 3.0], translation=[1.0, 2.0, 3.0])

    assert len(rig(edited(MODEL, tmp_path, change)).poses) == 0


def test_matrices_of_the_stored_pose_move_the_joints_where_the_nodes_are(tmp_path: Path) -> None:
    straight = rig(edited(MODEL, tmp_path / "other", lambda content: None))
    path = edited(MODEL, tmp_path, lambda content: joint(content, 1).update(rotation=turn(90.0)))
    bent = rig(path)
    points = np.concatenate([straight.pivots, np.ones((len(straight.pivots), 1))], axis=1)
    moved = np.einsum("jab,jb->ja", bent.poses[0], points)
    # The turned joint stays where it was. The next one goes around it by a right angle, about z.
    assert np.allclose(moved[:2], straight.pivots[:2], atol=1e-6)
    x, y, z = straight.pivots[2] - straight.pivots[1]
    assert np.allclose(moved[2] - moved[1], [-y, x, z], atol=1e-6)


def test_a_matrix_past_float32_is_none(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        joint(content, 0).update(scale=[1e20, 1e20, 1e20])
        joint(content, 1).update(rotation=turn(90.0), translation=[1e20, 0.0, 0.0])

    (found,) = rig(edited(MODEL, tmp_path, change)).poses
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
