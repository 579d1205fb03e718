"""The joints of a skin as a rig: which joint carries which, and where each one turns."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skinbake.geometry.poses import fingerprint
from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray, bincount

NO_PARENT = -1

NO_CHAIN = -1

LONG_CHAIN = 6
"""The number of joints from which on a chain is long. They curl together, as those of tails and ropes do.

Limbs, fingers and spines of characters are shorter chains: they end where a joint carries several others.
"""


@dataclass(frozen=True)
class Rig:
    """The hierarchy of J joints, in mesh space.

    parents (J,) int32 is the joint that carries each joint, −1 for none. Nodes between two joints are left
    out. pivots (J, 3) is the point about which each joint turns, NaN if it has none. poses (P, J, 3, 4) are
    the upper rows of joint matrices, NaN for a joint that has none: poses of clips, and the pose in which the
    nodes are stored unless that is the bind pose.
    """

    parents: npt.NDArray[np.int32]
    pivots: Float64Array
    poses: Float64Array = field(default_factory=lambda: np.empty((0, 0, 3, 4)))

    @property
    def ranks(self) -> npt.NDArray[np.int32]:
        """Return an order (J,) in which every joint comes after the joint that carries it."""
        ranks = np.empty(len(self.parents), dtype=np.int32)
        ranks[np.argsort(self.depths, kind="stable")] = np.arange(len(ranks))
        return ranks

    @property
    def depths(self) -> npt.NDArray[np.int32]:
        """Return the number of joints (J,) that carry each joint.

        Each round doubles the length of the steps, so that a long chain takes few rounds.
        """
        above = self.parents
        depths: npt.NDArray[np.int32] = (above != NO_PARENT).astype(np.int32)
        while (above != NO_PARENT).any():
            held = above != NO_PARENT
            depths += np.where(held, depths[above], 0).astype(np.int32)
            above = np.where(held, above[above], NO_PARENT)
        return depths

    @property
    def chains(self) -> npt.NDArray[np.int32]:
        """Return the first joint (J,) of the long chain to which each joint belongs, −1 for none.

        A chain goes on where a joint carries exactly one other.
        """
        held = self.parents != NO_PARENT
        children = bincount(self.parents[held], minlength=len(self.parents))
        goes_on = held & (children[self.parents] == 1)
        first = np.where(goes_on, self.parents, np.arange(len(self.parents), dtype=np.int32))
        while not np.array_equal(first, further := first[first]):
            first = further
        lengths = bincount(first, minlength=len(first))
        return np.where(lengths[first] >= LONG_CHAIN, first, NO_CHAIN).astype(np.int32)

    @cached_property
    def digest(self) -> str:
        """Return a short digest of hierarchy and pivots. float32 decides: a tool may write matrices again."""
        state = hashlib.sha256(self.parents.astype("<i4").tobytes())
        with np.errstate(over="ignore"):  # a matrix that is nearly singular has its pivot past all floats
            pivots = self.pivots.astype("<f4")
        state.update((pivots + np.float32(0.0)).tobytes())
        return state.hexdigest()[:16]

    @cached_property
    def fingerprint(self) -> tuple[float, ...]:
        """Return the fingerprint of the poses."""
        return fingerprint([self.poses])

    def with_joints(self, count: int) -> Rig:
        """Return the rig with at least so many joints. Further joints stand apart, and do not turn."""
        more = max(0, count - len(self.parents))
        return Rig(
            np.pad(self.parents, (0, more), constant_values=NO_PARENT),
            np.pad(self.pivots, ((0, more), (0, 0)), constant_values=np.nan),
            np.pad(self.poses, ((0, 0), (0, more), (0, 0), (0, 0)), constant_values=np.nan),
        )


class Lineage:
    """The lines of descent of a rig. They take J log J: a mask of all pairs would take J².

    A root is added above all joints: number J, of depth −1. Each joint has a *span*: places in an order in
    which all that it carries follow it at once. It carries another joint if its span holds the other's start.

        joint 5, added    span 0 … 5
        └ 0               1 … 5
          └ 1             2 … 5
            ├ 2           3 … 4    holds 4, so 2 carries 3
            │ └ 3         4 … 4
            └ 4           5 … 5    2 does not carry 4: 3 … 4 does not hold 5
    """

    def __init__(self, rig: Rig) -> None:
        self.root = len(rig.parents)
        self.depths = np.append(rig.depths, -1)
        parents = np.append(np.where(rig.parents == NO_PARENT, self.root, rig.parents), self.root)
        # The size of each span, from the leaves up: every joint comes after its parent in this order.
        above, (first, *others) = parents.tolist(), np.argsort(self.depths, kind="stable").tolist()
        sizes, free, starts = [1] * len(above), [0] * len(above), [0] * len(above)
        for joint in reversed(others):
            sizes[above[joint]] += sizes[joint]
        # Then their places, from the root down: children one after the other, behind their parent.
        free[first] = 1
        for joint in others:
            starts[joint] = free[above[joint]]
            free[above[joint]] += sizes[joint]
            free[joint] = starts[joint] + 1
        # The ends are one past the last place.
        self._starts, self._ends = np.array(starts), np.array(starts) + np.array(sizes)
        # The joint 1, 2, 4, … steps up.
        self._steps = [parents]
        while (self._steps[-1] != self.root).any():
            self._steps.append(self._steps[-1][self._steps[-1]])

    def carries(self, above: IntArray, joints: IntArray) -> BoolArray:
        """Tell whether each joint of ``above`` is the joint of ``joints``, or carries it."""
        starts = self._starts[joints]
        inside: BoolArray = (self._starts[above] <= starts) & (starts < self._ends[above])
        return inside

    def lowest_above(self, groups: IntArray, joints: IntArray, count: int) -> IntArray:
        """Return for each of ``count`` groups the lowest joint that is, or carries, all its joints.

        groups (N,) names the group of each of the joints (N,). A group without joints has the root.
        """
        first, last = np.full(count, self.root), np.zeros(count, dtype=np.int64)
        np.minimum.at(first, groups, self._starts[joints])
        np.maximum.at(last, groups, self._starts[joints])
        # A joint that carries the first and the last of a group carries all between them.
        at_start = np.argsort(self._starts)
        lowest, other = at_start[np.minimum(first, last)], at_start[last]
        # So go up from the first by ever shorter steps, as long as no joint there carries the last. The next
        # one does.
        for step in reversed(self._steps):
            lowest = np.where(self.carries(step[lowest], other), lowest, step[lowest])
        found: IntArray = np.where(self.carries(lowest, other), lowest, self._steps[0][lowest])
        return found

    def upwards(self, joints: IntArray, lengths: IntArray) -> tuple[IntArray, IntArray]:
        """Return the joints of N ways up the rig: rows and joints (M,), ordered by rows.

        The way of row i begins with joints[i], and has lengths[i] joints.
        """
        rows = np.flatnonzero(lengths > 0)
        found = [(rows, joints[rows])]
        while len(rows):
            more = lengths[rows] > len(found)
            rows, above = rows[more], self._steps[0][found[-1][1][more]]
            found.append((rows, above))
        every, passed = (np.concatenate(pieces) for pieces in zip(*found, strict=True))
        order = np.argsort(every, kind="stable")
        return every[order], passed[order]
