"""A rigid part keeps its normals where a bending part of another material meets it at its rim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.support.baked_files import AnyArray, verify
from tests.support.cutting import cut_into_meshes
from tests.support.gltf_reading import read
from tests.support.models import Part, baked, write_model

SIDES = 16
RIM = 1.0
"""Where head and neck meet along x, and the joint of the head is."""


def tube(start: float, end: float, weights: Sequence[float]) -> Part:
    """Make a tube about x of evenly spaced rings, with the weight of the second joint at each."""
    rings = len(weights)
    angles = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    normals = np.tile(np.stack([np.zeros(SIDES), np.cos(angles), np.sin(angles)], axis=1), (rings, 1))
    at, share = np.repeat([np.linspace(start, end, rings), weights], SIDES, axis=1)
    here = np.arange((rings - 1) * SIDES).reshape(-1, SIDES)
    beside = np.roll(here, -1, axis=1)
    triangles = np.stack([here, beside, here + SIDES, beside, beside + SIDES, here + SIDES], axis=-1)
    return Part(
        {
            "POSITION": (0.5 * normals + at[:, None] * [1.0, 0.0, 0.0]).astype(np.float32),
            "NORMAL": normals.astype(np.float32),
            "JOINTS_0": np.tile(np.array([0, 1, 0, 0], np.uint8), (len(at), 1)),
            "WEIGHTS_0": np.stack([1.0 - share, share, 0.0 * at, 0.0 * at], axis=1).astype(np.float32),
        },
        triangles.reshape(-1, 3),
    )


def player(path: Path, head: Sequence[float]) -> Path:
    """Write a neck that bends, and a head of another material that begins at its last ring."""
    return write_model(path, [tube(-1.0, RIM, [0.0, 0.0, 0.0, 0.0, 1.0]), tube(RIM, 3.0, head)])


def slopes(path: Path, primitive: int) -> AnyArray:
    """Return α and β of the rings of a primitive: (rings, sides × 6)."""
    model = read(path)
    found = [model.attribute(f"_SKINBAKE_{name}_0", 0, primitive) for name in ("ALPHA", "BETA")]
    return np.hstack(found).reshape(-1, 6 * SIDES)


@pytest.mark.parametrize("gradients", ["fitted", "surface"])
@pytest.mark.parametrize("weld", ["mesh", "skin"])
def test_a_rigid_head_has_no_slopes_at_its_rim(gradients: str, weld: str, tmp_path: Path) -> None:
    """Its true normals are known without a truth: those at rest, turned by the joint that moves all of it."""
    source = player(tmp_path / "player.glb", [1.0, 1.0, 1.0])
    path = baked(source, tmp_path / "baked.glb", gradients=gradients, weld=weld).path
    assert not slopes(path, 1).any()
    assert np.abs(slopes(path, 0)[-1]).max() > 1.0


def test_traces_of_another_joint_leave_a_head_rigid(tmp_path: Path) -> None:
    source = player(tmp_path / "player.glb", [1.0, 0.995, 1.0])
    path = baked(source, tmp_path / "baked.glb", gradients="surface").path
    assert 0.0 < np.abs(slopes(path, 1)[0]).max() < 0.01
    assert verify(path).exit_code == 0


@pytest.mark.parametrize("meshes", [1, 2])
def test_verify_knows_the_normals_of_a_rigid_head(meshes: int, tmp_path: Path) -> None:
    """Correctives, too, are fitted to these truths."""
    path = player(tmp_path / "player.glb", [1.0, 1.0, 1.0])
    if meshes == 2:
        path = cut_into_meshes(path, tmp_path / "cut.glb")
    baked(path, tmp_path / "baked.glb", weld="skin")
    answer = verify(tmp_path / "baked.glb", "--method", "lbs")
    assert answer.exit_code == 0
    neck, head = answer.file["primitives"]
    for truth in ("normals_by_triangles", "normals_by_tangents"):
        assert neck[truth]["lbs"]["standard"]["max"] > 5.0
        assert head[truth]["lbs"]["standard"]["max"] < 1e-5
        assert head[truth]["lbs"]["accurate"]["max"] < 1e-5


def test_a_seam_in_a_smooth_body_stays_welded_where_one_side_is_rigid_near_it(tmp_path: Path) -> None:
    source = player(tmp_path / "body.glb", [1.0, 1.0, 0.5])
    path = baked(source, tmp_path / "baked.glb", gradients="surface").path
    assert np.abs(slopes(path, 1)[0]).max() > 0.5
    assert np.array_equal(slopes(path, 0)[-1], slopes(path, 1)[0])
