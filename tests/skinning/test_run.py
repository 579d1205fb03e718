"""How a replay is cut into blocks, and how they lie in memory, changes no number."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.skinning.rest import Algorithm
from tests.support import analytic_rest
from tests.support import replay as replaying
from tests.support.replay import replay

VECTORS = ("positions", "normals", "tangents", "bitangents")


@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_many_poses_are_as_many_single_ones(algorithm: Algorithm, dtype: type) -> None:
    rest = analytic_rest.rest_primitive(analytic_rest.sample())
    poses = np.concatenate([analytic_rest.poses()] * 6)
    poses[:, :, :3] *= np.linspace(0.5, 2.0, len(poses))[:, None, None, None]
    together = replay(algorithm, rest, poses, dtype=dtype)
    for number, pose in enumerate(poses):
        alone = replay(algorithm, rest, pose[None], dtype=dtype)
        for name in VECTORS:
            assert getattr(together, name).dtype == dtype
            assert np.array_equal(getattr(together, name)[number], getattr(alone, name)[0]), name


@pytest.mark.parametrize("algorithm", [Algorithm.LBS_DIRECT, Algorithm.DQS_EXACT])
def test_small_blocks_change_nothing(algorithm: Algorithm, monkeypatch: pytest.MonkeyPatch) -> None:
    rest = analytic_rest.rest_primitive(analytic_rest.sample())
    poses = np.concatenate([analytic_rest.poses()] * 6)
    whole = replay(algorithm, rest, poses)
    monkeypatch.setattr(replaying, "BLOCK_BYTES", 8 * 100)
    monkeypatch.setattr(replaying, "BLOCK_POSES", 7)
    pieces = replay(algorithm, rest, poses)
    for name in VECTORS:
        assert np.array_equal(getattr(whole, name), getattr(pieces, name)), name
