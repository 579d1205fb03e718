"""The few targets of many changes: the solver, and what it leaves."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from skinbake.correctives.principal import gram, leading, refined


def test_leading_vectors_are_those_of_lapack() -> None:
    factors = np.random.default_rng(1).normal(size=(40, 12)) * np.linspace(5, 0.1, 12)
    matrix = factors @ factors.T
    values, vectors = leading(matrix, 4)
    expected, of_lapack = np.linalg.eigh(matrix)
    assert values == pytest.approx(expected[::-1][:4], rel=1e-9)
    assert np.abs((vectors * of_lapack[:, ::-1][:, :4]).sum(axis=0)) == pytest.approx(1.0, abs=1e-9)
    assert (vectors[np.abs(vectors).argmax(axis=0), np.arange(4)] > 0).all()


def test_a_matrix_of_few_samples_has_all_its_vectors() -> None:
    values, vectors = leading(np.diag([1.0, 3.0]), 2)
    assert values.tolist() == [3.0, 1.0]
    assert vectors == pytest.approx(np.array([[0.0, 1.0], [1.0, 0.0]]))


def test_products_of_samples_are_the_same_bits_in_any_order_of_vertices() -> None:
    generator = np.random.default_rng(2)
    changes = generator.normal(size=(7, 3000, 2)).astype(np.float32)
    areas = generator.random(3000)
    order = generator.permutation(3000)
    first, second = gram(changes, areas), gram(changes[:, order], areas[order])
    assert first.tobytes() == second.tobytes()
    exact = np.einsum("ivc,jvc,v->ij", changes.astype(float), changes.astype(float), areas)
    assert first / first[0, 0] == pytest.approx(exact / exact[0, 0], abs=1e-5)


def test_a_missing_change_is_no_change_of_zero() -> None:
    generator = np.random.default_rng(3)
    weights, targets = generator.normal(size=(20, 1)), generator.normal(size=(1, 50, 2)) * 0.1
    changes = np.einsum("rk,kvc->rvc", weights, targets).astype(np.float32)
    missing = changes.copy()
    missing[3:9, :10] = np.nan
    start = leading(gram(missing, np.ones(50)), 1)[1]
    found = refined(missing, None, np.ones(50), np.full(20, 1 / 20), start)
    assert np.einsum("kvc,rk->rvc", *found) == pytest.approx(changes, abs=1e-4)


def test_vectors_that_stand_apart_settle_after_few_calls() -> None:
    """Each mesh of a file asks for them; 60 rounds made 160,000 calls."""
    random = np.random.default_rng(8)
    turned = np.linalg.qr(random.normal(size=(33, 33)))[0]
    matrix = (turned * 10.0 ** -np.arange(33)) @ turned.T
    events: list[str] = []
    sys.setprofile(lambda _frame, event, _argument: events.append(event))
    try:
        leading(matrix + matrix.T, 4)
    finally:
        sys.setprofile(None)
    assert sum(event.endswith("call") for event in events) < 20_000
