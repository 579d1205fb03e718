"""Bake by compiled loops, bake in numpy, and verify: all three read odd surfaces alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from skinbake.choices import Weighting
from skinbake.freshness.staleness import compare
from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.gradients.baker import slots_of_surface
from skinbake.gradients.influences import weight_field
from skinbake.gradients.surface import concatenate_fields
from skinbake.gradients.weld import rigid_parts_apart, weld
from skinbake.truth.mesh import weld_classes, with_rigid_parts
from skinbake.truth.operator import expected_alpha_beta, gradient_operator, is_sound
from tests.support.kernels import use_numpy
from tests.support.labels import as_met
from tests.support.odd_surfaces import odd_rig, odd_surface, rough_sheet

SEEDS = range(60)
Frame = tuple[Float64Array, Float64Array]


def joined(parts: Sequence[SkinnedPrimitive], name: str) -> Float64Array:
    return np.concatenate([getattr(part, name) for part in parts])


@pytest.mark.slow
@pytest.mark.parametrize("crease", [0.0, 15.0, 60.0, 180.0])
def test_verify_welds_what_bake_welds(crease: float) -> None:
    for seed in SEEDS:
        parts = odd_surface(seed)
        field = concatenate_fields([weight_field(part)[0] for part in parts])
        positions, normals = joined(parts, "positions"), joined(parts, "normals")
        found = weld(positions, normals, field, crease_angle=np.radians(crease))
        assert as_met(found) == as_met(weld_classes(parts, crease_angle_degrees=crease)), seed


@pytest.mark.slow
def test_verify_finds_the_rigid_parts_that_bake_finds() -> None:
    """In primitives that share points, each moved by one of two joints; a part may be one triangle."""
    apart = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        points, bound = random.normal(size=(20, 3)), random.integers(0, 2, 20)
        most = random.choice([1.0, 0.99, 0.995, 0.98], 20, p=[0.6, 0.2, 0.1, 0.1])
        shares = np.stack([most, 1.0 - most], axis=1).astype(np.float32)
        parts = []
        for _ in range(3):
            own = random.permutation(20)[: random.integers(6, 20)]
            triangles = random.integers(0, len(own) - 2, (random.integers(2, 10), 3))
            weights, normals = shares[own], np.tile([0.0, 0.0, 1.0], (len(own), 1))
            joints = np.stack([bound[own], 1 - bound[own]], axis=1)
            parts.append(SkinnedPrimitive(points[own], normals, None, joints, weights, triangles))
        starts = np.cumsum([0, *(len(part.positions) for part in parts)])
        ends, field = starts[1:].tolist(), concatenate_fields([weight_field(part)[0] for part in parts])
        triangles = np.concatenate(
            [part.triangles + start for part, start in zip(parts, starts[:-1], strict=True)]
        )
        triangles = triangles[is_sound(joined(parts, "positions"), triangles)]
        welded = weld_classes(parts)
        found = rigid_parts_apart(welded, triangles, field, ends)
        assert as_met(found) == as_met(with_rigid_parts(welded, parts, triangles)), seed
        apart += int(found.max() - welded.max())
    assert apart > 50


def baked(
    parts: Sequence[SkinnedPrimitive], frame: Frame, weighting: Weighting, rig: Rig | None = None
) -> Float64Array:
    """Return α and β (V, 2 K − 2) side by side."""
    slots = slots_of_surface(parts, frame, weighting=weighting, crease_angle=np.radians(15.0), rig=rig)
    return np.concatenate([np.hstack(pair) for pair in slots]).astype(np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("weighting", list(Weighting))
def test_verify_expects_what_bake_stores(weighting: Weighting, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in SEEDS:
        parts = odd_surface(seed)
        operator = gradient_operator(parts, weighting=weighting)
        tangents, bitangents = np.random.default_rng(seed).normal(size=(2, len(operator.positions), 3))
        frames = [(tangents[rows], bitangents[rows]) for rows in operator.slices]
        found = expected_alpha_beta(operator, parts, frames)
        expected = np.concatenate([np.hstack([alpha[:, 1:], beta[:, 1:]]) for alpha, beta in found])
        # Gradients that cancel leave rounding.
        scale = np.maximum(np.abs(expected).max(axis=1), 1e-3 * operator.reach())[:, None]
        frame = tangents, bitangents
        assert (np.abs(baked(parts, frame, weighting) - expected) <= 1e-6 * scale).all(), seed
        with monkeypatch.context() as patch:
            use_numpy(patch)
            assert (np.abs(baked(parts, frame, weighting) - expected) <= 1e-6 * scale).all(), seed


@pytest.mark.parametrize(
    "seeds",
    [range(45, 60), *(pytest.param(range(n, n + 100), marks=pytest.mark.slow) for n in range(100, 600, 100))],
)
def test_loops_and_numpy_fit_alike_whatever_the_pose(seeds: range, monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in seeds:
        parts, rig = [rough_sheet(seed)], odd_rig(seed)
        normals = unit_normals(joined(parts, "normals").astype(np.float32))
        tangents, bitangents = frame_from_normal(normals)
        frame = tangents.astype(np.float64), bitangents.astype(np.float64)
        found = baked(parts, frame, Weighting.MAX, rig)
        with monkeypatch.context() as patch:
            use_numpy(patch)
            expected = baked(parts, frame, Weighting.MAX, rig)
        # The tolerance of verify's freshness.
        reach = gradient_operator(parts, weighting=Weighting.MAX).reach()
        compared = compare((found, found), (expected, expected), reach=reach)
        assert compared.agrees, f"seed {seed}, vertex {compared.worst}: off by {compared.largest:.3g}"
