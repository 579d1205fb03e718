from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from skinbake.freshness.comparison import RELATIVE_TOLERANCE, Comparison, compare

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
    assert comparison.mostly_agrees
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


@pytest.mark.parametrize(
    "factors", [(1.01, 1.0), (1.0, 0.5), (1.01, 1.01), (-1.0, -1.0), (2.0, 3.0), (0.0, 0.0)]
)
def test_factors_of_alpha_and_of_beta_are_found(factors: tuple[float, float]) -> None:
    alpha, beta = entries()
    comparison = compared((factors[0] * alpha, factors[1] * beta), (alpha, beta))
    assert comparison.factors == pytest.approx(factors, abs=1e-9)
    assert not comparison.reordered


def test_one_vertex_alone_is_no_factor() -> None:
    alpha, beta = entries()
    changed = alpha.copy()
    changed[5] *= -1
    comparison = compared((changed, beta), (alpha, beta))
    assert (comparison.differing, comparison.worst, comparison.factors) == (1, 5, None)
    assert not comparison.reordered


def test_swapped_slots_are_reordered_slot_0_included() -> None:
    alpha, beta = entries()
    swapped = [part[:, [1, 0, 2]] for part in (alpha, beta)]
    assert compared((swapped[0], swapped[1]), (alpha, beta)).reordered
    with_pivot = [np.column_stack([-part.sum(axis=1), part[:, 1:]]) for part in (alpha, beta)]
    assert compared((with_pivot[0], with_pivot[1]), (alpha, beta)).reordered


def test_alpha_negated_between_two_joints_is_not_two_slots_swapped() -> None:
    """α = (−a, a) of a vertex between two joints, negated, holds the same numbers; its β tells."""
    alpha, beta = entries(slots=1)
    comparison = compared((-alpha, beta), (alpha, beta))
    assert not comparison.reordered
    assert comparison.factors == pytest.approx((-1.0, 1.0))


def test_a_rescaled_mesh_is_recognised_through_noise_other_slots_and_other_frames() -> None:
    rng = np.random.default_rng(5)
    alpha, beta = entries(400)
    angle = rng.uniform(0, 2 * np.pi, 400)[:, None]
    turned = np.cos(angle) * alpha - np.sin(angle) * beta, np.sin(angle) * alpha + np.cos(angle) * beta
    found = [1.33 * part[:, [2, 0, 1]] * rng.normal(1.0, 0.02, part.shape) for part in turned]
    comparison = compared((found[0], found[1]), (alpha, beta))
    assert comparison.rescaled == pytest.approx(1.33, rel=0.02)
    assert comparison.resorted
    assert comparison.factors is None
    assert not comparison.reordered


@pytest.mark.parametrize(
    ("share", "edited", "resorted"), [(0.05, 0.0, False), (0.2, 0.0, True), (0.2, 0.3, False)]
)
def test_slots_are_re_sorted_if_that_explains_half_of_the_vertices_that_differ_and_a_tenth_of_all(
    share: float, edited: float, resorted: bool
) -> None:
    wanted = entries()
    found = [part.copy() for part in wanted]
    swapped, others = round(200 * share), round(200 * edited)
    for part in found:
        part[:swapped] = part[:swapped, [1, 2, 0]]
        part[swapped : swapped + others] *= 5.0
    assert compared((found[0], found[1]), wanted).resorted == resorted


def test_what_was_not_rescaled_or_re_sorted_is_not_said_to_be() -> None:
    comparison = compared(entries(seed=1), entries(seed=2))
    assert comparison.rescaled is None
    assert not comparison.resorted
    assert not comparison.reordered
    assert comparison.factors is None
    assert not comparison.mostly_agrees


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
    assert comparison.factors is None
