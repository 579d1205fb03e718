from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.freshness.staleness import RELATIVE_TOLERANCE, Comparison, compare

Pair = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]


def entries(count: int = 200, slots: int = 3, seed: int = 0) -> Pair:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, slots)), rng.normal(size=(count, slots))


def compared(found: Pair, wanted: Pair) -> Comparison:
    return compare(found, wanted)


def test_rounding_to_float32_agrees() -> None:
    alpha, beta = entries()
    comparison = compared((alpha.astype(np.float32).astype(float), beta), (alpha, beta))
    assert comparison.agrees
    assert 0 < comparison.largest < 1e-6


@pytest.mark.parametrize(("excess", "agrees"), [(0.5, True), (2.0, False)])
def test_the_tolerance_is_relative_to_the_vertex(excess: float, agrees: bool) -> None:
    alpha, beta = entries()
    alpha[7] *= 1e-3
    beta[7] *= 1e-3
    # The largest entry of a vertex may be slot 0's, which is not stored.
    largest = max(np.abs(np.append(part[7], part[7].sum())).max() for part in (alpha, beta))
    changed = alpha.copy()
    changed[7, 1] += excess * RELATIVE_TOLERANCE * largest
    comparison = compared((changed, beta), (alpha, beta))
    assert comparison.agrees is agrees
    assert comparison.worst == 7


def test_noise_where_a_weight_is_constant_agrees_only_within_its_reach() -> None:
    """Where all weights are constant both sides are rounding: found 0, recomputed 1e-17."""
    noise = 1e-17 * entries()[0], 1e-17 * entries(seed=1)[1]
    zero = np.zeros((200, 3)), np.zeros((200, 3))
    assert not compare(zero, noise).agrees
    assert compare(zero, noise, reach=np.ones(200)).agrees
    real = noise[0].copy(), noise[1]
    real[0][3, 0] = 1e-6
    assert compare(zero, real, reach=np.ones(200)).worst == 3
    assert not compare(zero, real, reach=np.ones(200)).agrees


def test_one_vertex_alone_differs() -> None:
    alpha, beta = entries()
    changed = alpha.copy()
    changed[5] *= -1
    comparison = compared((changed, beta), (alpha, beta))
    assert (comparison.differing, comparison.worst) == (1, 5)


def test_no_vertex_at_all_agrees() -> None:
    assert compared(entries(count=0), entries(count=0)).agrees


def test_a_vertex_past_float32_differs_and_hides_no_other() -> None:
    stored = entries()
    alpha, beta = (values.copy() for values in stored)
    alpha[0, 0], beta[1, 1] = np.inf, np.nan
    alpha[2] *= 1.5
    comparison = compared(stored, (alpha, beta))
    assert comparison.differing == 3
    assert comparison.worst == 0
