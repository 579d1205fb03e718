"""The analytic surface as the replay takes it, with any joint in slot 0."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skinbake.skinning.rest import RestPrimitive
from tests.support import analytic

COLUMNS, ROWS = 24, 20


def sample() -> analytic.Sample:
    """Points all over the tube, off any symmetry."""
    return analytic.sample(*analytic.grid(COLUMNS, ROWS, jitter=0.3, seed=7))


def slots(surface: analytic.Sample, *, heaviest_first: bool = True) -> npt.NDArray[np.int64]:
    """The joint of each slot, (V, 3): by falling weight as files have it, or 0, 1, 2."""
    if heaviest_first:
        return np.argsort(-surface.weights, axis=1, kind="stable")
    return np.tile(np.arange(3), (len(surface.u), 1))


def rest_primitive(surface: analytic.Sample, joints: npt.NDArray[np.int64] | None = None) -> RestPrimitive:
    """The rest surface with exact gradients, in the order of slots."""
    order = slots(surface) if joints is None else joints
    gradients = np.take_along_axis(surface.gradients, order[:, :, None], axis=1)
    return RestPrimitive(
        positions=surface.positions,
        normals=surface.normals,
        tangents=surface.tangents,
        bitangents=surface.bitangents,
        joints=order,
        weights=np.take_along_axis(surface.weights, order, axis=1),
        alpha=np.einsum("vki,vi->vk", gradients, surface.tangents)[:, 1:],
        beta=np.einsum("vki,vi->vk", gradients, surface.bitangents)[:, 1:],
    )


def poses() -> analytic.Array:
    """The four bends as poses, (4, 3, 4, 4)."""
    return np.array([analytic.joint_matrices(bend) for bend in analytic.BENDS])
