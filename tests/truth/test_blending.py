"""Algorithms 1–3 in matrix form, against the same algorithms line by line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.choices import Baseline
from skinbake.geometry.skinned import Float64Array, IntArray
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.truth import blending
from skinbake.truth.blending import BlendedPrimitive, blended_blocks
from tests.support.replay import replay

ALGORITHMS = (Algorithm.LBS_STANDARD, Algorithm.LBS_DIRECT, Algorithm.LBS_ACCURATE)
JOINTS, VERTICES = 200, 23


def surface(slots: int, seed: int = 0) -> RestPrimitive:
    """Vertices without order: frames of both hands, joints twice at a vertex, weights of 0, narrow types."""
    rng = np.random.default_rng(seed)
    frames = np.linalg.qr(rng.normal(size=(VERTICES, 3, 3)))[0]
    weights = rng.random((VERTICES, slots)) * (rng.random((VERTICES, slots)) < 0.8)
    weights[:, 0] += 0.1
    return RestPrimitive(
        positions=rng.normal(size=(VERTICES, 3)),
        normals=frames[:, 0],
        tangents=frames[:, 1],
        bitangents=frames[:, 2],
        joints=rng.choice([3, 90, 150, JOINTS - 1], (VERTICES, slots)).astype(np.uint8),
        weights=weights / weights.sum(axis=1, keepdims=True),
        alpha=rng.normal(size=(VERTICES, slots - 1)),
        beta=rng.normal(size=(VERTICES, slots - 1)),
    )


def rows_of(rest: RestPrimitive, part: slice | IntArray) -> RestPrimitive:
    names = ("positions", "normals", "tangents", "bitangents", "joints", "weights", "alpha", "beta")
    return replace(rest, **{name: getattr(rest, name)[part] for name in names})


def joint_matrices(poses: int) -> Float64Array:
    """Affine matrices with shear and mirrors."""
    rng = np.random.default_rng(1)
    matrices = np.tile(np.eye(4), (poses, JOINTS, 1, 1))
    matrices[..., :3, :] += 0.7 * rng.normal(size=(poses, JOINTS, 3, 4))
    return matrices


@pytest.mark.slow
@pytest.mark.parametrize("poses", [1, 2, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize("slots", [1, 4, 8])
@pytest.mark.parametrize("baseline", list(Baseline))
@pytest.mark.parametrize("cap", [None, 0.4])
def test_matrix_form_is_what_the_lines_compute(
    poses: int, slots: int, baseline: Baseline, cap: float | None
) -> None:
    rest, matrices = surface(slots), joint_matrices(poses)
    authored = replace(rest, normals=surface(slots, 2).normals)
    found = BlendedPrimitive(
        rest, matrices, Options(cap, baseline), direct=lambda part: rows_of(authored, part)
    )
    for pose, part in (
        (slice(0, poses), slice(0, VERTICES)),
        (slice(poses // 2, poses // 2 + 1), slice(3, 9)),
        (slice(poses // 3, poses), slice(VERTICES - 1, VERTICES)),
    ):
        for algorithm, normals in zip(ALGORITHMS, found.normals(ALGORITHMS, pose, part), strict=True):
            start = authored if algorithm is Algorithm.LBS_DIRECT else rest
            expected = replay(algorithm, start, matrices, cap=cap, baseline=baseline)
            assert np.stack(normals, axis=2) == pytest.approx(
                expected.normals[pose, part], rel=1e-9, abs=1e-12
            )
            positions = found.positions(pose, part).transpose(2, 1, 0)
            assert positions == pytest.approx(expected.positions[pose, part], rel=1e-12, abs=1e-12)


def test_where_the_jacobian_is_singular_the_cofactors_are_left() -> None:
    rest, matrices = surface(1), np.zeros((1, JOINTS, 4, 4))
    matrices[..., :2, :2] = np.eye(2)
    (normals,) = BlendedPrimitive(rest, matrices, Options(), direct=lambda part: rows_of(rest, part)).normals(
        (Algorithm.LBS_DIRECT,), slice(0, 1), slice(0, VERTICES)
    )
    expected = np.zeros((1, VERTICES, 3))
    expected[..., 2] = rest.normals[:, 2]
    assert np.stack(normals, axis=2) == pytest.approx(expected)


def test_only_vertices_of_joints_of_scale_0_alone_have_no_side() -> None:
    rest, matrices = surface(4), joint_matrices(2)
    rest.joints[0] = 3
    matrices[1, 3, :3, :3] = 0.0
    matrices[:, 7, 0, 0] = np.inf  # of a joint that is not in use
    hidden = ((rest.joints == 3) | (rest.weights == 0.0)).all(axis=1)
    with np.errstate(invalid="ignore"):
        sides = blending.sides_of([rest], matrices)
    assert sides is not None and hidden.any()
    np.testing.assert_array_equal(np.isnan(sides), [0 * hidden, hidden])


def test_algorithm_2_has_to_be_prepared_for() -> None:
    plain = BlendedPrimitive(surface(4), joint_matrices(1), Options())
    with pytest.raises(ValueError, match="algorithm 2"):
        plain.normals((Algorithm.LBS_DIRECT,), slice(0, 1), slice(0, 1))


def test_blocks_cover_every_vertex_in_every_pose_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blending, "CHUNK_SAMPLES", 100)
    monkeypatch.setattr(blending, "CHUNK_POSES", 3)
    monkeypatch.setattr(blending, "BLOCK_SAMPLES", 13)
    seen = np.zeros((11, VERTICES), dtype=int)
    for pose, part, (one, other) in blended_blocks((surface(2), surface(2, 1)), joint_matrices(11)):
        seen[pose, part] += 1
        assert seen[pose, part].size <= 13
        assert not np.allclose(one.positions(pose, part), other.positions(pose, part))
    assert (seen == 1).all()
