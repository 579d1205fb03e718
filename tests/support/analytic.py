"""An analytic skinned surface and its skinned normals by finite differences: the oracle of the tests.

A bumpy, slightly bent tube along x with three joints. Positions and weights are smooth functions of two
parameters, u along the tube and v around it, so that tangents and weight gradients are exact. The skinned
truth is the cross product of finite differences of the skinned positions over u and v. Nothing here uses
``skinbake``: dual quaternions are Hamilton products, motions are composed from axes and angles, never read
back from matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Skinning = Callable[[Array, Array], Array]
Surface = Callable[[Array, Array], Array]

LENGTH = 3.0
CENTRES = np.array([0.3, 1.5, 2.7])
PIVOTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [2.0, 0.0, 0.1]])
# Axes and degrees of the first three bends are fitted to the errors that algorithms 4 and 5 had on another
# surface. The fourth also slides its joints along their axes: joints that only turn
# about shared pivots keep a mix's real part at right angles to its dual part, which hides a term of
# the derivative.
AXES = np.array([[-0.7, 1.5, 1.2], [-1.1, 0.0, -0.1], [0.3, 0.1, -0.4]])
BENDS = {
    "mild": (38.0, 47.0, 12.0),
    "medium": (69.0, 82.0, 76.0),
    "strong": (62.0, 84.0, 128.0),
    "screw": (40.0, 60.0, 70.0),
}
SLIDES = {"screw": (0.0, 1.0, -0.9)}
REACH = 0.75
RADIUS = 0.55


@dataclass(frozen=True)
class Sample:
    """The surface at V parameters: an orthonormal frame, tangential gradients (V, 3, 3), slot = joint."""

    u: Array
    v: Array
    positions: Array
    normals: Array
    tangents: Array
    bitangents: Array
    weights: Array
    gradients: Array

    @property
    def alpha(self) -> Array:
        """∇w · t0 of slots 1 and 2, (V, 2)."""
        along: Array = np.einsum("vki,vi->vk", self.gradients, self.tangents)[:, 1:]
        return along

    @property
    def beta(self) -> Array:
        """∇w · b0 of slots 1 and 2, (V, 2)."""
        along: Array = np.einsum("vki,vi->vk", self.gradients, self.bitangents)[:, 1:]
        return along


def positions(u: Array, v: Array) -> Array:
    """X(u, v), (V, 3)."""
    radius = RADIUS * (1 + 0.12 * np.sin(3 * v + 2 * u))
    return np.stack(
        [u + 0.1 * np.cos(v), 0.15 * np.sin(1.3 * u) + radius * np.cos(v), radius * np.sin(v)], axis=-1
    )


def derivatives(u: Array, v: Array) -> tuple[Array, Array]:
    """∂X/∂u and ∂X/∂v, (V, 3) each."""
    radius = RADIUS * (1 + 0.12 * np.sin(3 * v + 2 * u))
    slope = RADIUS * 0.12 * np.cos(3 * v + 2 * u)
    along = np.stack(
        [np.ones_like(u), 0.195 * np.cos(1.3 * u) + 2 * slope * np.cos(v), 2 * slope * np.sin(v)], axis=-1
    )
    around = np.stack(
        [
            -0.1 * np.sin(v),
            3 * slope * np.cos(v) - radius * np.sin(v),
            3 * slope * np.sin(v) + radius * np.cos(v),
        ],
        axis=-1,
    )
    return along, around


def weights(u: Array, v: Array) -> Array:
    """Three weights that sum to one, (V, 3): Gaussians along the tube, leaning with v, normalised."""
    reach = (u + 0.2 * np.sin(v))[:, None] - CENTRES
    bump = np.exp(-((reach / REACH) ** 2))
    weight: Array = bump / bump.sum(axis=1, keepdims=True)
    return weight


def weight_derivatives(u: Array, v: Array) -> tuple[Array, Array]:
    """∂w/∂u and ∂w/∂v, (V, 3) each."""
    reach = (u + 0.2 * np.sin(v))[:, None] - CENTRES
    logarithmic = -2 * reach / REACH**2
    weight = weights(u, v)
    along = weight * (logarithmic - np.sum(weight * logarithmic, axis=1, keepdims=True))
    return along, along * (0.2 * np.cos(v))[:, None]


def sample(u: Array, v: Array) -> Sample:
    """Evaluate the surface, its outward frame and its weight gradients at parameters (V,) each."""
    along, around = derivatives(u, v)
    outward = np.cross(around, along)
    normals = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    tangents = along / np.linalg.norm(along, axis=1, keepdims=True)
    # The tangential gradient solves ∇w · X_u = w_u, ∇w · X_v = w_v, ∇w · n = 0.
    frame = np.stack([along, around, normals], axis=1)
    w_u, w_v = weight_derivatives(u, v)
    gradients = np.linalg.solve(frame, np.stack([w_u, w_v, np.zeros_like(w_u)], axis=1))
    return Sample(
        u,
        v,
        positions(u, v),
        normals,
        tangents,
        np.cross(normals, tangents),
        weights(u, v),
        np.swapaxes(gradients, 1, 2),
    )


def grid(columns: int, rows: int, *, jitter: float = 0.0, seed: int = 0) -> tuple[Array, Array]:
    """Parameters of columns × rows points, moved by up to ``jitter`` cells, but never off the two ends."""
    rng = np.random.default_rng(seed)
    column, row = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    shift = jitter * rng.uniform(-1, 1, (2, columns, rows))
    shift[0, [0, -1]] = 0
    u = (column + shift[0]) * LENGTH / (columns - 1)
    v = (row + shift[1]) * 2 * np.pi / rows
    return u.ravel(), v.ravel()


def triangles(columns: int, rows: int, *, seed: int = 0) -> npt.NDArray[np.int64]:
    """Triangles (T, 3) of the grid, closed around v, wound outward, each cell cut along a random diagonal."""
    rng = np.random.default_rng(seed)
    faces = []
    for column in range(columns - 1):
        for row in range(rows):
            a, b = column * rows + row, column * rows + (row + 1) % rows
            c, d = a + rows, b + rows
            faces += [[a, b, c], [b, d, c]] if rng.random() < 0.5 else [[a, b, d], [a, d, c]]
    return np.array(faces)


def hamilton(a: Array, b: Array) -> Array:
    """The quaternion product a b, (..., 4), scalar part first."""
    scalar = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    vector = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([scalar, vector], axis=-1)


def conjugate(q: Array) -> Array:
    """q*, (..., 4)."""
    return np.concatenate([q[..., :1], -q[..., 1:]], axis=-1)


def pure(vector: Array) -> Array:
    """A vector as a quaternion (0, v), (..., 4)."""
    return np.concatenate([np.zeros_like(vector[..., :1]), vector], axis=-1)


def rotation_matrix(axis: Array, angle: float) -> Array:
    """Rodrigues' formula, (3, 3)."""
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: Array = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    return rotation


def _chain(bend: str) -> list[tuple[Array, Array, float, Array]]:
    """Axis, pivot, degrees and translation of each joint against its parent."""
    slides = SLIDES.get(bend, (0.0, 0.0, 0.0))
    along = [slide * axis / np.linalg.norm(axis) for slide, axis in zip(slides, AXES, strict=True)]
    return list(zip(AXES, PIVOTS, BENDS[bend], along, strict=True))


def joint_matrices(bend: str) -> Array:
    """The chain of three joints, each turned about its pivot by the bend's angle, then slid: (3, 4, 4)."""
    matrices = []
    parent = np.eye(4)
    for axis, pivot, degrees, slide in _chain(bend):
        local = np.eye(4)
        local[:3, :3] = rotation_matrix(axis, np.radians(degrees))
        local[:3, 3] = pivot - local[:3, :3] @ pivot + slide
        parent = parent @ local
        matrices.append(parent)
    return np.array(matrices)


def joint_dual_quaternions(bend: str) -> Array:
    """The same chain as unit dual quaternions (3, 8), from half angles."""
    result = []
    parent = np.array([1.0, 0, 0, 0, 0, 0, 0, 0])
    for axis, pivot, degrees, slide in _chain(bend):
        half = np.radians(degrees) / 2
        real = np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])
        turned = hamilton(hamilton(real, pure(pivot)), conjugate(real))[1:]
        dual = 0.5 * hamilton(pure(pivot - turned + slide), real)
        parent = np.concatenate(
            [hamilton(parent[:4], real), hamilton(parent[:4], dual) + hamilton(parent[4:], real)]
        )
        result.append(parent)
    return np.array(result)


def linear_blend(matrices: Array) -> Skinning:
    """Linear blend skinning by matrices (3, 4, 4)."""

    def skinned(points: Array, weight: Array) -> Array:
        moved = np.einsum("kij,vj->vki", matrices[:, :3, :3], points) + matrices[:, :3, 3]
        blended: Array = np.einsum("vk,vki->vi", weight, moved)
        return blended

    return skinned


def dual_quaternion_blend(dual_quaternions: Array, pivots: npt.NDArray[np.int64]) -> Skinning:
    """Dual quaternion skinning by unit dual quaternions (3, 8); pivots (V,) is each vertex's slot 0."""

    def skinned(points: Array, weight: Array) -> Array:
        cosines = dual_quaternions[:, :4] @ dual_quaternions[:, :4].T
        signs = np.where(cosines[pivots] < 0, -1.0, 1.0)
        blend = (weight * signs) @ dual_quaternions
        blend = blend / np.linalg.norm(blend[:, :4], axis=1, keepdims=True)
        real, dual = blend[:, :4], blend[:, 4:]
        turned = hamilton(hamilton(real, pure(points)), conjugate(real))
        moved: Array = (turned + 2 * hamilton(dual, conjugate(real)))[:, 1:]
        return moved

    return skinned


def skinned_normals(
    u: Array, v: Array, skinning: Skinning, *, step: float = 1e-3, surface: Surface = positions
) -> Array:
    """The outward unit normals (V, 3) of the skinned surface, by differences of fourth order.

    With steps of 1e-3 truncation and rounding are both near 1e-12 of the tangents.
    """

    def skinned(u: Array, v: Array) -> Array:
        return skinning(surface(u, v), weights(u, v))

    along, around = differences(u, v, skinned, step=step)
    normal = np.cross(around, along)
    unit: Array = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return unit


def differences(u: Array, v: Array, surface: Surface, *, step: float = 1e-3) -> tuple[Array, Array]:
    """∂/∂u and ∂/∂v of a surface, (V, 3) each, by differences of fourth order."""

    def at(du: float, dv: float) -> Array:
        return surface(u + du, v + dv)

    along = 8 * (at(step, 0) - at(-step, 0)) - (at(2 * step, 0) - at(-2 * step, 0))
    around = 8 * (at(0, step) - at(0, -step)) - (at(0, 2 * step) - at(0, -2 * step))
    return along / (12 * step), around / (12 * step)


def degrees_between(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> Array:
    """Angles in degrees between vectors (..., 3) of any length, accurate also near 0 and 180."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    a = a / np.linalg.norm(a, axis=-1, keepdims=True)
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    sine, cosine = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
    angles: Array = np.degrees(2 * np.arctan2(sine, cosine))
    return angles
