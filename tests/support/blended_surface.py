"""The analytic surface with blend weights, and where it lies between linear blending and dual quaternions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skinbake.skinning.rest import RestPrimitive
from tests.support import analytic
from tests.support.analytic import Array
from tests.support.analytic_rest import rest_primitive
from tests.support.stretched_joints import blend_about_the_vertex, stretched_joints

RIGID = "rigid"


def blend_weights(u: Array, v: Array) -> Array:
    """From 0.1 to 0.9, and varying as fast as skin weights do: (V,)."""
    return np.asarray(0.5 + 0.4 * np.sin(2 * u + v))


def blended_rest(surface: analytic.Sample) -> RestPrimitive:
    """The surface with blend weights, and their derivatives along t0 and b0 as analysis gives them."""
    along, around = analytic.derivatives(surface.u, surface.v)
    slope = 0.4 * np.cos(2 * surface.u + surface.v)
    frame = np.stack([along, around, surface.normals], axis=1)
    sides = np.stack([2 * slope, slope, np.zeros_like(slope)], axis=1)
    gradient = np.linalg.solve(frame, sides[:, :, None])[:, :, 0]
    blend = [blend_weights(surface.u, surface.v)]
    blend += [np.einsum("vi,vi->v", gradient, axis) for axis in (surface.tangents, surface.bitangents)]
    return replace(rest_primitive(surface), blend=np.stack(blend, axis=1))


def blended_surface(bend: str, stretch: str, pivots: np.ndarray) -> tuple[Array, analytic.Surface]:
    """Joint matrices (1, 3, 4, 4), and the surface that they move, by definitions of the oracle's own.

    stretch is RIGID or one of STRETCHES; pivots (V,) is each vertex's slot 0.
    """
    if stretch == RIGID:
        matrices = analytic.joint_matrices(bend)
        dual = analytic.dual_quaternion_blend(analytic.joint_dual_quaternions(bend), pivots)
    else:
        matrices, quaternions = stretched_joints(bend, stretch)
        dual = blend_about_the_vertex(matrices, quaternions, pivots)
    linear = analytic.linear_blend(matrices)

    def posed(u: Array, v: Array) -> Array:
        given, weight = (analytic.positions(u, v), analytic.weights(u, v)), blend_weights(u, v)[:, None]
        between: Array = (1 - weight) * linear(*given) + weight * dual(*given)
        return between

    return matrices[None], posed
