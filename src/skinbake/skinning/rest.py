"""The six algorithms by number, their options, and their input: a primitive at rest with weight gradients."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from skinbake.choices import Baseline
from skinbake.geometry.skinned import BoolArray, FloatArray, IntArray
from skinbake.skinning.components import cross, dot

FloatT = TypeVar("FloatT", bound="np.floating[Any]")


def all_slots(others: npt.NDArray[FloatT]) -> npt.NDArray[FloatT]:
    """Return derivatives of the weights of all slots (V, K, …) from those of slots 1 … K − 1.

    Slot 0 has minus the sum of the others, because the weights of a vertex sum to 1 everywhere.
    """
    return np.concatenate([-others.sum(axis=1, keepdims=True), others], axis=1)


class Algorithm(IntEnum):
    """1–5 of Tarini et al. 2014 (supplemental material), and 6 of ``dqs.exact``.

    1–3 are linear blend skinning, 4–6 dual quaternion skinning. These have two forms: of rigid joints
    (``dqs``), and of joints that scale, shear or mirror (``dqs_scaled``). The standard lighting of 1 and 4 is
    called approximated in the paper.
    """

    LBS_STANDARD = 1
    LBS_DIRECT = 2
    LBS_ACCURATE = 3
    DQS_STANDARD = 4
    DQS_ACCURATE = 5
    DQS_EXACT = 6

    @property
    def uses_dual_quaternions(self) -> bool:
        """Tell whether it is dual quaternion skinning."""
        return self >= Algorithm.DQS_STANDARD


class Options(NamedTuple):
    """The options of an algorithm: a cap for 3, 5 and 6 (None is off), a baseline for 1.

    With ``normal_map``, algorithms 3, 5 and 6 give what a normal map needs beside the normal, too.
    """

    cap: float | None = None
    baseline: Baseline = Baseline.BLENDED
    normal_map: bool = False


@dataclass(frozen=True, slots=True)
class RestPrimitive:
    """A skinned primitive at rest, in mesh space, with the derivatives of its weights.

    positions, normals, tangents (t0), bitangents (b0) are (V, 3) floating. The frame is assumed to be
    orthonormal. joints (V, K) are integers below the J of the poses. weights (V, K) sum to one. alpha, beta
    (V, K − 1) are ∇w · t0 and ∇w · b0 of slots 1 … K − 1, in 1 / length unit of POSITION. gradients (V, K, 3)
    is ∇w of every slot for algorithm 2, or None to compute them from alpha and beta. sides (V,) is the
    handedness of the frame where the normals are not those of the frame, else None. lengths (V,) are those of
    t0 at rest where t and b are its images under morph targets, else None. blend (V, 3) are the blend weight
    b, ∂b/∂t0 and ∂b/∂b0 (``blended``), None for zeros. sums (V,) are the lengths of the normals that morph
    targets add up to, to which engines add further targets; None for 1.
    """

    positions: FloatArray
    normals: FloatArray
    tangents: FloatArray
    bitangents: FloatArray
    joints: IntArray
    weights: FloatArray
    alpha: FloatArray
    beta: FloatArray
    gradients: FloatArray | None = None
    sides: FloatArray | None = None
    lengths: FloatArray | None = None
    blend: FloatArray | None = None
    sums: FloatArray | None = None

    def rows(self, part: slice | IntArray) -> RestPrimitive:
        """Return some of the vertices."""
        arrays: dict[str, Any] = {one.name: getattr(self, one.name) for one in fields(self)}
        some = {name: own[part] for name, own in arrays.items() if own is not None}
        return replace(self, **some)

    def summed_normals(self, part: slice) -> FloatArray:
        """Return the normals (B, 3) of some vertices as morph targets add them up, not of length 1."""
        normals = self.normals[part]
        return normals if self.sums is None else normals * self.sums[part, None]

    def weight_gradients(self) -> FloatArray:
        """Return ∇w (V, K, 3): as given, otherwise α t0 + β b0; slot 0 has minus the sum of the others.

        Along n0 the computed gradient is zero: no tangent of the surface has this direction.
        """
        if self.gradients is not None:
            return self.gradients
        others = (
            self.alpha[:, :, None] * self.tangents[:, None, :]
            + self.beta[:, :, None] * self.bitangents[:, None, :]
        )
        return all_slots(others)

    def handedness(self) -> FloatArray:
        """Return the sign (V,) of (t0 × b0) · n0: −1 if the frame is mirrored, 1 also if it is flat.

        t' × b' points along the normal of an unmirrored frame and against that of a mirrored one.
        """
        if self.sides is not None:
            return self.sides
        # For very small arrays, numpy's own cross product would take most of the time.
        volume = dot(cross(tuple(self.tangents.T), tuple(self.bitangents.T)), tuple(self.normals.T))
        return np.where(volume < 0, -1.0, 1.0)

    def tangent_lengths(self) -> FloatArray:
        """Return |t0| at rest (V,). Where TANGENT itself is morphed, the length of the sum stands for it."""
        if self.lengths is not None:
            return self.lengths
        return np.asarray(np.linalg.norm(self.tangents.astype(np.float64), axis=1))

    def joints_in_use(self, joint_count: int) -> BoolArray:
        """Tell which of the joints (J,) have a weight or a weight derivative at any vertex."""
        derivative = (self.alpha != 0) | (self.beta != 0)
        active = self.weights != 0
        active[:, 1:] |= derivative
        active[:, 0] |= derivative.any(axis=1)
        used = np.zeros(joint_count, dtype=np.bool_)
        used[self.joints[active]] = True
        return used
