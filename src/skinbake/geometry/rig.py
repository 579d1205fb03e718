"""The joints of a skin as a rig: which joint carries which, and where each one turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import BoolArray, Float64Array

NO_PARENT = -1


@dataclass(frozen=True, slots=True)
class Rig:
    """The hierarchy of J joints, in mesh space.

    parents (J,) int32 is the joint that carries each joint, −1 for none. Nodes between two joints are left
    out. pivots (J, 3) is the point about which each joint turns, NaN if it has none.
    """

    parents: npt.NDArray[np.int32]
    pivots: Float64Array

    @property
    def ranks(self) -> npt.NDArray[np.int32]:
        """Return an order (J,) in which every joint comes after the joint that carries it."""
        depths, above = np.zeros(len(self.parents), dtype=np.int32), self.parents
        while (above != NO_PARENT).any():
            depths += above != NO_PARENT
            above = np.where(above == NO_PARENT, NO_PARENT, self.parents[above])
        ranks = np.empty(len(depths), dtype=np.int32)
        ranks[np.argsort(depths, kind="stable")] = np.arange(len(depths))
        return ranks

    def carriers(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Return each joint and all joints that carry it, in rows like CSR: joints (N,), offsets (J + 1,)."""
        lines = self.lines_of_descent().T
        return np.nonzero(lines)[1], np.concatenate([[0], np.cumsum(lines.sum(axis=1))])

    def lines_of_descent(self) -> BoolArray:
        """Return a mask (J, J): whether joint j is joint i, or carries it, at [j, i]."""
        joints = np.arange(len(self.parents))
        mask, above = np.eye(len(joints), dtype=np.bool_), self.parents
        while (above != NO_PARENT).any():
            held = above != NO_PARENT
            mask[above[held], joints[held]] = True
            above = np.where(held, self.parents[above], NO_PARENT)
        return mask

    def with_joints(self, count: int) -> Rig:
        """Return the rig with at least so many joints. Further joints stand apart, and do not turn."""
        more = max(0, count - len(self.parents))
        return Rig(
            np.pad(self.parents, (0, more), constant_values=NO_PARENT),
            np.pad(self.pivots, ((0, more), (0, 0)), constant_values=np.nan),
        )
