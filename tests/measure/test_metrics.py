from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.measure.tally import ErrorSummary, ErrorTally
from skinbake.truth import kernel
from skinbake.truth.areas import vertex_areas
from tests.support.whole_fields import angular_errors, summarise


def test_vertex_areas_are_a_third_of_each_triangle() -> None:
    positions = np.array(
        [[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 2], [np.nan, 0, 0], [8, 8, 8]], dtype=np.float32
    )
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [1, 1, 2]], dtype=np.uint16)
    assert vertex_areas(positions, triangles) == pytest.approx([5 / 3, 5 / 3, 1.0, 2 / 3, 0.0, 0.0])


@pytest.mark.parametrize(
    ("measured", "degrees"),
    [
        ([1.0, 0.0, 0.0], 0.0),
        ([7.0, 0.0, 0.0], 0.0),
        ([3.0, 3.0, 0.0], 45.0),
        ([0.0, 0.0, 1e-9], 90.0),
        ([-2.0, 0.0, 0.0], 180.0),
        ([1.0, 1e-12, 0.0], 5.729577951308232e-11),
        ([-1.0, 0.0, 1e-12], 180.0),
        ([0.0, 0.0, 0.0], np.nan),
        ([np.nan, 1.0, 0.0], np.nan),
        ([np.inf, 1.0, 0.0], np.nan),
    ],
)
def test_angles(measured: list[float], degrees: float) -> None:
    expected = np.array([[[2.0, 0.0, 0.0]]])
    found = angular_errors(np.array([[measured]]), expected)
    assert found.shape == (1, 1)
    assert found[0, 0] == pytest.approx(degrees, rel=1e-12, abs=0.0, nan_ok=True)
    assert angular_errors(expected, np.array([[measured]]))[0, 0] == pytest.approx(
        degrees, rel=1e-12, nan_ok=True
    )


def test_float32_normals_are_compared_in_float64() -> None:
    near = np.array([[1.0, 1e-5, 0.0]], dtype=np.float32)
    assert angular_errors(near, np.eye(3, dtype=np.float32)[:1])[0] == pytest.approx(
        np.degrees(1e-5), rel=1e-6
    )


def test_a_summary_by_hand() -> None:
    errors = np.array([[1.0, 2.0, 10.0], [3.0, 4.0, 20.0]])
    # The weights by error: 1:6, 2:3, 3:6, 4:3, 10:1, 20:1, together 20: 95 % are reached at 10, 99 % at 20.
    # From 8 to 16 a bin is a sixteenth wide, and the one of 10 ends at the next sixteenth.
    assert summarise(errors, np.array([6.0, 3.0, 1.0])) == ErrorSummary(
        mean=(6 * 1 + 3 * 2 + 10 + 6 * 3 + 3 * 4 + 20) / 20,
        p95=10.0625,
        p99=20.0,
        max=20.0,
        worst_pose=1,
        worst_vertex=2,
        samples=6,
        undefined=0,
        weight=20.0,
    )


def test_percentiles_of_equal_weights_are_counted_up_to_the_end_of_their_bin() -> None:
    errors = np.random.default_rng(0).permutation(np.arange(1.0, 1001.0)).reshape(10, 100)
    summary = summarise(errors, np.full(100, 0.1))
    assert summary is not None
    # From 512 to 1024 a bin is 4 wide, from 32 to 64 a quarter.
    assert (summary.p95, summary.p99, summary.max) == (952.0, 992.0, 1000.0)
    assert summary.mean == pytest.approx(500.5)
    assert errors[summary.worst_pose, summary.worst_vertex] == 1000.0
    # Here the rounded sum of 57 areas of 60 falls short of 95 % of the sum of all.
    summary = summarise(np.arange(1.0, 61.0)[None], np.full(60, 0.7))
    assert summary is not None
    assert (summary.p95, summary.p99) == (57.25, 60.0)


def test_a_large_area_moves_the_percentile() -> None:
    errors = np.array([[1.0, 2.0, 3.0]])
    summary = summarise(errors, np.array([1.0, 8.0, 200.0]))
    assert summary is not None
    assert (summary.p95, summary.p99) == (3.0, 3.0)
    summary = summarise(np.array([[3.0, 1.0, 2.0]]), np.array([2.0, 1.0, 97.0]))
    assert summary is not None
    assert (summary.p95, summary.p99) == (2.0 + 1 / 64, 3.0)


def test_what_is_masked_or_has_no_area_does_not_count() -> None:
    errors = np.array([[1.0, 90.0, np.nan, 2.0], [1.0, 3.0, 70.0, 80.0]])
    valid = np.array([[True, True, False, True], [True, True, False, False]])
    summary = summarise(errors, np.array([1.0, 0.0, 1.0, 1.0]), valid=valid)
    assert summary is not None
    assert summary.mean == pytest.approx(4 / 3)
    assert (summary.p95, summary.p99, summary.max) == (2.0, 2.0, 2.0)
    assert (summary.worst_pose, summary.worst_vertex) == (0, 3)
    assert (summary.samples, summary.undefined) == (3, 0)


def test_a_missing_normal_counts_as_the_worst_there_is() -> None:
    errors = np.array([[1.0, 2.0], [np.nan, 3.0]])
    summary = summarise(errors, np.array([1.0, 1.0]))
    assert summary is not None
    assert (summary.max, summary.worst_pose, summary.worst_vertex) == (180.0, 1, 0)
    assert summary.mean == pytest.approx(46.5)
    assert summary.undefined == 1


def test_the_first_of_equal_worst_samples_is_named() -> None:
    summary = summarise(np.zeros((2, 3)), np.array([0.0, 1.0, 1.0]))
    assert summary is not None
    assert (summary.max, summary.worst_pose, summary.worst_vertex) == (0.0, 0, 1)


def test_samples_that_do_not_count_have_no_summary() -> None:
    assert summarise(np.ones((2, 2)), np.zeros(2)) is None
    assert summarise(np.ones((1, 2)), np.ones(2), valid=np.zeros((1, 2), dtype=bool)) is None
    assert summarise(np.zeros((0, 2)), np.ones(2)) is None


def percentile(errors: npt.NDArray[np.float64], weights: npt.NDArray[np.float64], share: float) -> float:
    """The smallest error such that all that are not larger have the share of the weight: one by one."""
    return min(
        float(value)
        for value in errors
        if weights[errors <= value].sum() >= share * weights.sum() * (1 - 1e-9)
    )


@pytest.mark.parametrize("seed", range(12))
def test_a_tally_of_blocks_is_that_of_the_samples_one_by_one(seed: int) -> None:
    """Few values, so that there are ties; areas that go with the errors or against them; gaps."""
    rng = np.random.default_rng(seed)
    poses, count = 40, 30
    errors = np.round(rng.gamma(1.0, 3.0, (poses, count)), seed % 3).astype(np.float32).astype(np.float64)
    areas = rng.random(count) * np.exp((seed % 5 - 2.0) * errors.mean(axis=0))
    areas[rng.random(count) < 0.1] = 0.0
    valid = rng.random((poses, count)) < (0.2 if seed % 4 == 0 else 0.9)
    errors[rng.random((poses, count)) < 0.01] = np.nan
    tally = ErrorTally()
    corners = [(pose, vertex) for pose in range(0, poses, 7) for vertex in range(0, count, 8)]
    for place in rng.permutation(len(corners)):
        pose, vertex = corners[place]
        rows, columns = slice(pose, pose + 7), slice(vertex, vertex + 8)
        block = kernel.count_errors(errors[rows, columns], areas[columns], valid[rows, columns])
        tally.take(block, (2, pose, vertex))
    summary = tally.summary()
    assert summary is not None
    counted = valid & (areas > 0.0)
    values = np.where(np.isnan(errors), 180.0, errors)[counted]
    weights = np.broadcast_to(areas, errors.shape)[counted]
    for found, share in ((summary.p95, 0.95), (summary.p99, 0.99)):
        exact = percentile(values, weights, share)
        assert exact <= found <= exact * (1.0 + 1 / 128)
    assert summary.mean == pytest.approx((values * weights).sum() / weights.sum(), rel=1e-12)
    assert summary.max == values.max()
    worst = np.flatnonzero(counted & (np.where(np.isnan(errors), 180.0, errors) == values.max()))[0]
    assert (summary.worst_pose, summary.worst_vertex) == divmod(int(worst), count)
    assert summary.worst_part == 2
    assert summary.samples == counted.sum()
    assert summary.undefined == (np.isnan(errors) & counted).sum()


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
def test_percentiles_of_lengths_of_any_scale_are_at_most_a_128th_too_large(scale: float) -> None:
    rng = np.random.default_rng(9)
    values = (scale * rng.gamma(1.0, 3.0, (50, 200))).astype(np.float32).astype(np.float64)
    areas = rng.exponential(1.0, 200)
    summary = summarise(values, areas)
    assert summary is not None
    weights = np.broadcast_to(areas, values.shape)
    for found, share in ((summary.p95, 0.95), (summary.p99, 0.99)):
        exact = percentile(values.ravel(), weights.ravel(), share)
        if scale == 1e-12:  # below the first bin: nothing that anyone sees
            assert found == 0.0
        elif scale == 1e12:  # above the last one
            assert found == summary.max
        else:
            assert exact <= found <= exact * (1.0 + 1 / 128)


def test_of_parts_with_the_same_worst_error_the_first_is_named() -> None:
    tally = ErrorTally()
    for part in (3, 1, 2):
        tally.take(kernel.count_errors(np.array([[0.0, 5.0]]), np.ones(2)), (part, 4, 7))
    summary = tally.summary()
    assert summary is not None
    assert (summary.worst_part, summary.worst_pose, summary.worst_vertex) == (1, 4, 8)
