"""Dual quaternions of joints that scale, against Blender's *Preserve Volume*."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.blender.running import outside_python, require_blender
from tests.support.characters import Array
from tests.support.replay import replay

pytestmark = pytest.mark.slow

FLOAT32 = 2e-6
"""Of points 3 from the origin, which Blender has in float32."""


@pytest.fixture(scope="module")
def blender(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("volume")
    subprocess.run(
        [require_blender(), Path(__file__).parent / "preserve_volume.py", folder / "found.json"],
        check=True,
        timeout=300,
        env=outside_python(),
    )
    return json.loads((folder / "found.json").read_text(encoding="utf-8"))


def distances(found: dict[str, Any], algorithm: Algorithm) -> Array:
    """Return how far an algorithm takes each point from where Blender takes it."""
    points, weights = np.array(found["points"]), np.array(found["weights"])
    frame = np.repeat(np.eye(3)[:, None], len(points), axis=1)
    none = np.zeros((len(points), weights.shape[1] - 1))
    rest = RestPrimitive(
        positions=points,
        normals=frame[2],
        tangents=frame[0],
        bitangents=frame[1],
        joints=np.repeat(np.arange(weights.shape[1])[None], len(points), axis=0),
        weights=weights / weights.sum(axis=1, keepdims=True),
        alpha=none,
        beta=none,
    )
    moved = replay(algorithm, rest, np.array(found["joints"])[None]).positions[0]
    return np.asarray(np.linalg.norm(moved - found["posed"], axis=1))


@pytest.mark.parametrize("kind", ["none", "uniform", "along its axes"])
def test_joints_that_scale_along_their_axes_move_points_as_blender_does(blender: Any, kind: str) -> None:
    assert distances(blender[kind], Algorithm.DQS_EXACT).max() < FLOAT32
    assert distances(blender[kind], Algorithm.LBS_ACCURATE).max() > 0.05


@pytest.mark.parametrize("kind", ["mirrored", "sheared"])
def test_blender_takes_another_rotation_out_of_joints_that_shear_or_mirror(blender: Any, kind: str) -> None:
    """As the documentation says: it keeps the direction of the bone, and no mirror."""
    assert distances(blender[kind], Algorithm.DQS_EXACT).max() > 0.01
