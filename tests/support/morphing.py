"""Analytic morph targets of the analytic tube: their differential is known, and what a file keeps of it.

A target displaces X(u, v) by a smooth function of u and v. A file has the displacement, the difference of the
unit normals and that of the unit tangents between weight 0 and weight 1, and nothing in between. Nothing here
uses the code that carries frames.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from skinbake.geometry.morphs import Differences, MorphTarget, MorphTargets
from tests.support import analytic
from tests.support.analytic import Array, Sample, Surface

Displacement = Callable[[Array, Array], Array]


def _outward(u: Array, v: Array) -> Array:
    along, around = analytic.derivatives(u, v)
    return unit(np.cross(around, along))


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) at length 1."""
    normalised: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return normalised


def bulge(u: Array, v: Array) -> Array:
    """Bumps along the normal, like muscles: 0.25 high on a radius of 0.55."""
    return (0.25 * np.sin(2.2 * u) * np.cos(2 * v))[:, None] * _outward(u, v)


def inflate(u: Array, v: Array) -> Array:
    """A thicker tube: it stretches around far more than along."""
    return (0.18 + 0.12 * np.sin(1.7 * u + v))[:, None] * _outward(u, v)


def _turned(u: Array, v: Array, angles: Array, pivot: Array, axes: tuple[int, int]) -> Array:
    """Turn each point about a pivot by its own angle, in the plane of two axes."""
    arm = analytic.positions(u, v) - pivot
    turned = arm.copy()
    first, second = axes
    turned[:, first] = np.cos(angles) * arm[:, first] - np.sin(angles) * arm[:, second]
    turned[:, second] = np.sin(angles) * arm[:, first] + np.cos(angles) * arm[:, second]
    return turned - arm


def bend(u: Array, v: Array) -> Array:
    """A tube bent by 60° over its length."""
    return _turned(u, v, np.radians(60) * u / analytic.LENGTH, np.zeros(3), (0, 1))


def jaw(u: Array, v: Array) -> Array:
    """A jaw that opens: one half turns by 35° about a pivot, over a short hinge."""
    angles = np.radians(35) / (1 + np.exp(-(u - 1.5) / 0.25))
    return _turned(u, v, angles, np.array([1.4, -0.3, 0.0]), (0, 1))


def twist(u: Array, v: Array) -> Array:
    """A tube wrung by 60° over its length."""
    return _turned(u, v, np.radians(60) * u / analytic.LENGTH, np.zeros(3), (1, 2))


def stretch(u: Array, v: Array) -> Array:
    """Longer by 30 %, thinner by 15 %."""
    return analytic.positions(u, v) * [0.3, -0.15, -0.15]


def mixture(u: Array, v: Array) -> Array:
    """Four of them at once, at less than half their size."""
    return 0.45 * (bulge(u, v) + bend(u, v) + twist(u, v) + stretch(u, v))


DISPLACEMENTS: dict[str, Displacement] = {
    found.__name__: found for found in (bulge, inflate, bend, jaw, twist, stretch, mixture)
}


def morphed_surface(displacement: Displacement, weight: float) -> Surface:
    """X + w · displacement, as glTF morphs: exactly linear in the weight."""

    def surface(u: Array, v: Array) -> Array:
        moved: Array = analytic.positions(u, v) + weight * displacement(u, v)
        return moved

    return surface


def images(sample: Sample, surface: Surface, *vectors: Array) -> list[Array]:
    """Tangent vectors (V, 3) of the rest surface under the differential of the morph."""
    along, around = analytic.derivatives(sample.u, sample.v)
    to = analytic.differences(sample.u, sample.v, surface)
    # v = a X_u + b X_v, and its image is a Y_u + b Y_v.
    basis = np.stack([along, around, sample.normals], axis=2)
    found = []
    for vector in vectors:
        shares = np.linalg.solve(basis, vector[:, :, None])[:, :2, 0]
        found.append(shares[:, :1] * to[0] + shares[:, 1:] * to[1])
    return found


def normals(sample: Sample, surface: Surface) -> Array:
    """The outward unit normals of a morphed surface, (V, 3)."""
    along, around = analytic.differences(sample.u, sample.v, surface)
    return unit(np.cross(around, along))


def target(sample: Sample, displacement: Displacement, *, tangents: bool = False) -> MorphTargets:
    """The one target that an exporter would write, its tangents those of the sample's frame."""
    surface = morphed_surface(displacement, 1.0)
    turned = unit(images(sample, surface, sample.tangents)[0])
    one = MorphTarget(
        Differences.of(displacement(sample.u, sample.v)),
        Differences.of(normals(sample, surface) - sample.normals),
        Differences.of(turned - sample.tangents),
    )
    return MorphTargets((one,), tangents)


def true_normals(sample: Sample, surface: Surface, bend_name: str) -> Array:
    """The unit normals (V, 3) of the morphed and then skinned surface, by finite differences."""
    skinning = analytic.linear_blend(analytic.joint_matrices(bend_name))
    found: Array = partial(analytic.skinned_normals, surface=surface)(sample.u, sample.v, skinning)
    return found
