"""The counted multiply-adds against the paper's figures, typed in from its pseudo-code."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from skinbake.skinning.counting import (
    Count,
    Tally,
    VertexBytes,
    cost_table,
    multiply_adds,
    vertex_bytes,
)
from skinbake.skinning.rest import Algorithm

# Right margin of the supplemental material's pseudo-code, line by line, n being the paper's N_max.
PAPER: dict[Algorithm, Callable[[int], list[int]]] = {
    Algorithm.LBS_STANDARD: lambda n: [12 * n, 12, 9, 9, 9],
    Algorithm.LBS_DIRECT: lambda n: [12 * n, 9 * n, 9 * n, 31, 12, 9, 9, 9],
    Algorithm.LBS_ACCURATE: lambda n: [
        9 * n,
        9 * n,
        3 * (n - 1),
        9 + 3 * (n - 1),
        9 + 3 * (n - 1),
        6,
        3 * (n - 1),
    ],
    Algorithm.DQS_STANDARD: lambda n: [12 * n, 13, 27, 18, 18, 18],
    Algorithm.DQS_ACCURATE: lambda n: [
        12 * n,
        13,
        27,
        24 * n,
        3 * (n - 1),
        18 + 3 * (n - 1),
        18 + 3 * (n - 1),
        6,
    ],
}


@pytest.mark.parametrize("influences", range(1, 9))
@pytest.mark.parametrize("algorithm", PAPER)
def test_every_line_costs_what_the_paper_says(algorithm: Algorithm, influences: int) -> None:
    expected = dict(enumerate(PAPER[algorithm](influences), start=1))
    assert multiply_adds(algorithm, influences) == expected


def test_totals_at_four_influences_are_those_of_the_paper_s_table() -> None:
    totals = {int(algorithm): cost.multiply_adds for algorithm, cost in cost_table(4).items()}
    assert [totals[number] for number in range(1, 6)] == [87, 190, 132, 142, 253]
    assert totals[6] <= 290


@pytest.mark.parametrize("influences", range(1, 9))
def test_algorithm_6_costs_what_its_docstring_says(influences: int) -> None:
    assert sum(multiply_adds(Algorithm.DQS_EXACT, influences).values()) == 36 * influences + 118


@pytest.mark.parametrize("influences", range(1, 9))
def test_algorithm_6_charges_alpha_and_beta_to_lines_of_their_own(influences: int) -> None:
    """Each rate is a sum of N − 1 dual quaternions, of 8 entries each."""
    lines = multiply_adds(Algorithm.DQS_EXACT, influences)
    assert lines[5] == lines[6] == 8 * (influences - 1)
    assert lines[7] == lines[8]


def test_algorithm_6_is_cheaper_than_5_from_six_influences_on() -> None:
    gains = [
        cost_table(n)[Algorithm.DQS_ACCURATE].multiply_adds - cost_table(n)[Algorithm.DQS_EXACT].multiply_adds
        for n in range(1, 9)
    ]
    assert np.sign(gains).tolist() == [-1, -1, -1, -1, 0, 1, 1, 1]


def counted(formula: Callable[[Count, Count, Count], object]) -> int:
    tally = Tally()
    tally.mark(1)
    formula(Count(tally), Count(tally), Count(tally))
    return tally.lines[1]


@pytest.mark.parametrize(
    ("formula", "cost"),
    [
        (lambda a, b, c: a * b, 1),
        (lambda a, b, c: a + b, 1),
        (lambda a, b, c: a * b + c, 1),
        (lambda a, b, c: c - a * b, 1),
        (lambda a, b, c: a * b - b * c, 2),
        (lambda a, b, c: (a + b) + c, 2),
        (lambda a, b, c: (a * b + c) + c, 2),
        (lambda a, b, c: 2.0 * a + 1.0, 1),
        (lambda a, b, c: 1.0 / a, 1),
        (lambda a, b, c: a.reciprocal_root(), 1),
        (lambda a, b, c: a.sign() * b, 0),
        (lambda a, b, c: a.sign() * (a * b) + c, 1),
    ],
)
def test_rules_of_the_counting_scalar(formula: Callable[[Count, Count, Count], object], cost: int) -> None:
    assert counted(formula) == cost


def test_a_product_fuses_with_one_addition_only() -> None:
    def twice(a: Count, b: Count, c: Count) -> None:
        product = a * b
        _ = product + c
        _ = product + c

    def both(a: Count, b: Count, c: Count) -> None:
        left, right = a * b, b * c
        _ = left + right
        _ = right + c

    assert counted(twice) == 2
    assert counted(both) == 3


def test_a_product_does_not_fuse_across_lines() -> None:
    tally = Tally()
    tally.mark(1)
    product = Count(tally) * Count(tally)
    tally.mark(2)
    _ = product + Count(tally)
    assert tally.lines == {1: 1, 2: 1}


def test_bytes_at_four_influences() -> None:
    """40 of position, normal, tangent and 20 of influences; a[s] 3 floats a slot, α and β 3 floats each."""
    found = {int(algorithm): vertex_bytes(algorithm, 4) for algorithm in Algorithm}
    plain = 12 + 12 + 16 + 4 + 16
    added = {1: 0, 2: 48, 3: 24, 4: 0, 5: 24, 6: 24}
    assert found == {number: VertexBytes(plain, extra) for number, extra in added.items()}
    assert found[3].total == 84


@pytest.mark.parametrize("algorithm", [Algorithm.LBS_ACCURATE, Algorithm.DQS_ACCURATE, Algorithm.DQS_EXACT])
def test_a_vertex_of_one_influence_has_no_derivatives_to_store(algorithm: Algorithm) -> None:
    assert vertex_bytes(algorithm, 1).added == 0
