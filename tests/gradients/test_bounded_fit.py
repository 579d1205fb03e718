"""A fit changes no gradient by more than a multiple of what the surface has around the vertex."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gradients import fit, fit_rules
from skinbake.gradients.baker import bake_primitives
from tests.gradients.tubes import BRANCHES, CHAIN, SETTINGS, bent, steepest_slopes, tube
from tests.support.kernels import use_numpy

MOST = 3.0
"""The number of docs/reference/gradients.md."""

SLACK = 1.0 + 1e-4
"""Both fits are stored in float32."""


@dataclass(frozen=True)
class Case:
    """A tube, flattened to needles, in some unit, far from the origin, with pivots on its vertices."""

    seed: int
    parents: tuple[int, ...] = BRANCHES
    pivots: str = "near a vertex"
    flat: float = 1.0
    unit: float = 1.0
    far: float = 0.0
    bent: float = 0.0

    def made(self) -> tuple[SkinnedPrimitive, Rig]:
        primitive, rig = tube(seed=self.seed, parents=self.parents)
        random = np.random.default_rng(self.seed)
        points = primitive.positions * [self.flat, 1.0, 1.0] * self.unit + self.far
        points = points.astype(np.float32)
        pivots = points[random.integers(0, len(points), len(rig.pivots))].astype(np.float64)
        if self.pivots != "on vertices":
            pivots[:] = pivots[0]
        if self.pivots == "near a vertex":
            pivots += 1e-6 * self.unit * random.normal(size=pivots.shape)
        rig = replace(rig, pivots=pivots)
        rig = bent(rig, np.radians(self.bent)) if self.bent else rig
        return replace(primitive, positions=points), rig


CASES = [
    *(Case(seed, parents) for seed in range(4) for parents in (BRANCHES, CHAIN)),
    *(Case(seed, pivots=pivots) for seed in range(4) for pivots in ("on a vertex", "on vertices")),
    *(Case(1, flat=flat) for flat in (1e-2, 1e-4)),
    *(Case(2, unit=unit) for unit in (1e-3, 1e4)),
    *(Case(3, far=far) for far in (100.0, 1e4)),
    Case(4, bent=20.0),
    Case(5, CHAIN, unit=0.01, far=1.0, bent=20.0),
]


def pairs(alpha: FloatArray, beta: FloatArray) -> Float64Array:
    """Return α and β of all slots, (V, K, 2)."""
    found = np.stack([alpha, beta], axis=2).astype(np.float64)
    return np.concatenate([-found.sum(axis=1, keepdims=True), found], axis=1)


def fitted(primitive: SkinnedPrimitive, rig: Rig | None) -> Float64Array:
    ((baked, _),) = bake_primitives([primitive], SETTINGS, rig)
    return pairs(baked.alpha, baked.beta)


def lengths(slots: Float64Array) -> Float64Array:
    return np.asarray(np.linalg.norm(slots, axis=2).max(axis=1))


@pytest.fixture(params=["loops", "numpy"])
def _kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "numpy":
        use_numpy(monkeypatch)


@pytest.mark.slow
@pytest.mark.usefixtures("_kernel")
@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_fit_stays_within_three_times_the_steepest_slope_or_gradient(case: Case) -> None:
    primitive, rig = case.made()
    gradients = fitted(primitive, None)
    change = lengths(fitted(primitive, rig) - gradients)
    assert (change <= SLACK * MOST * np.maximum(steepest_slopes(primitive), lengths(gradients))).all()


@pytest.mark.usefixtures("_kernel")
@pytest.mark.parametrize("case", CASES[:8], ids=str)
def test_what_is_too_long_is_shortened_in_its_direction_and_the_rest_stays(
    case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    primitive, rig = case.made()
    gradients, bounded = fitted(primitive, None), fitted(primitive, rig)
    for module in (fit, fit_rules):
        monkeypatch.setattr(module, "BOUNDED", 1e30)
    free = fitted(primitive, rig)
    most = MOST * np.maximum(steepest_slopes(primitive), lengths(gradients))
    long = lengths(free - gradients) > most
    assert long.any()
    assert np.array_equal(bounded[~long], free[~long])
    found, whole = bounded - gradients, free - gradients
    share = (most / np.maximum(lengths(whole), most))[:, None, None]
    assert (np.abs(found - share * whole).max(axis=(1, 2)) <= 1e-4 * most)[long].all()
