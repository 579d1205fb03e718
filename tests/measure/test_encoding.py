"""The angle that an encoding adds, on surfaces whose normals are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skinbake.measure.costs import EncodedPrimitive, added_error
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.blending import BLOCK_SAMPLES

ROUNDING = 2.0**-22
"""Relative: angles are kept as float32."""


def flat(alpha: list[float], lift: list[float]) -> EncodedPrimitive:
    """Return vertices at the origin, between a joint at rest and one that a pose lifts along the normal.

    t' = x + α lift z and b' = y, so that the normal turns by atan(α lift).
    """
    count, poses = len(alpha), len(lift)
    rows = np.eye(3)[[0, 1, 2]]
    surface = RestPrimitive(
        positions=np.zeros((count, 3)),
        normals=np.tile(rows[2], (count, 1)),
        tangents=np.tile(rows[0], (count, 1)),
        bitangents=np.tile(rows[1], (count, 1)),
        joints=np.tile([0, 1], (count, 1)),
        weights=np.full((count, 2), 0.5),
        alpha=np.array(alpha)[:, None],
        beta=np.zeros((count, 1)),
    )
    matrices = np.tile(np.eye(4), (poses, 2, 1, 1))
    matrices[:, 1, 2, 3] = lift
    return EncodedPrimitive(surface, surface.alpha, surface.beta, np.ones(count), matrices)


def test_the_angle_is_that_between_the_two_normals() -> None:
    item = replace(flat([1.5], [2.0]), alpha=np.array([[1.0]]))
    found = added_error([item])
    assert found is not None
    expected = np.degrees(np.arctan(3.0) - np.arctan(2.0))
    assert (found.mean, found.p99) == pytest.approx((expected, expected), rel=ROUNDING)


def test_equal_numbers_add_nothing() -> None:
    found = added_error([flat([0.3, -0.7, 2.0], [0.0, 1.0, 5.0])])
    assert found is not None
    assert (found.mean, found.p99) == (0.0, 0.0)


def test_vertices_weigh_by_their_area_and_poses_alike() -> None:
    """One vertex in a hundred parts of the area is off: by 45° in one pose, by nothing in the other."""
    item = replace(flat([1.0, 0.0], [0.0, 1.0]), alpha=np.zeros((2, 1)), areas=np.array([1.0, 99.0]))
    found = added_error([item])
    assert found is not None
    assert found.mean == pytest.approx(45.0 / 200, rel=ROUNDING)
    assert found.p99 == 0.0
    found = added_error([replace(item, areas=np.array([3.0, 97.0]))])
    assert found is not None
    assert found.p99 == pytest.approx(45.0, rel=ROUNDING)


def test_primitives_and_blocks_of_poses_count_together() -> None:
    poses = 5
    many = flat([1.0] * (BLOCK_SAMPLES // 2), [1.0] * poses)
    few = replace(flat([0.0], [1.0]), areas=np.array([float(len(many.areas))]))
    whole = replace(many, alpha=np.zeros_like(many.alpha))
    found = added_error([whole, few])
    assert found is not None
    # The one vertex has as much area as all others together, and one pose where they have five.
    assert found.mean == pytest.approx(45.0 * poses / (poses + 1), rel=ROUNDING)


def test_without_an_area_or_a_normal_there_is_no_figure() -> None:
    item = flat([1.0], [1.0])
    assert added_error([]) is None
    assert added_error([replace(item, areas=np.zeros(1))]) is None
    gone = replace(item.primitive, tangents=np.zeros((1, 3)), alpha=np.zeros((1, 1)))
    assert added_error([replace(item, primitive=gone, alpha=np.zeros((1, 1)))]) is None


def test_a_normal_that_only_the_stored_numbers_lose_counts_as_upside_down() -> None:
    """t' = 0 where α lifts the frame by −T t: the joint moves along −x."""
    item = flat([1.0], [0.0])
    item.joint_matrices[0, 1, 0, 3] = -1.0
    found = added_error([replace(item, alpha=np.array([[0.5]]))])
    assert found is not None
    assert found.mean == 180.0
