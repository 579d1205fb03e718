"""Surfaces as skins draw them in poses, as arrays: what every room that poses them shares.

A surface has its primitives from a file, or from a bake that is not written yet. What follows from them is
made when it is first asked for, and once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from skinbake.choices import USUAL_TRUTHS, Truth
from skinbake.errors import Place
from skinbake.freshness.baked_views import BakedView, rest_primitive
from skinbake.geometry.skinned import BoolArray, Float64Array
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import Clip, clip_poses, clip_weights
from skinbake.gltf.reading.scenes import faces_backward
from skinbake.gltf.reading.skins import Skeleton, read_skeleton, rest_pose
from skinbake.skinning.components import Vector
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.threads import Threads
from skinbake.truth.areas import RestAreas
from skinbake.truth.blending import BlendedPrimitive, sides_of
from skinbake.truth.operator import GradientOperator
from skinbake.truth.poses import PoseSet
from skinbake.truth.truths import Truths, VertexBlock, truths_at_rest

if TYPE_CHECKING:
    from skinbake.freshness.corrective_freshness import PlayedCorrectives
    from skinbake.truth.morphing import Morphing

Found = TypeVar("Found")

HALF_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])
"""A turn of the whole scene around the vertical."""

POSES = 32
"""The poses in work at a time where true normals are all that is asked for."""


class Surface:
    """The baked primitives that the truths take as one surface, whoever draws them.

    views are the primitives as the document stores them, or as it will. welded gives the operator of the
    truths over all of them. correctives are the file's own, if it has any. moving are the morph targets that
    move it, None for those with a weight in the poses.
    """

    def __init__(
        self,
        document: Document,
        views: Sequence[BakedView],
        welded: Callable[[], GradientOperator],
        correctives: PlayedCorrectives | None = None,
        moving: Sequence[int] | None = None,
    ) -> None:
        self.document, self.views, self.correctives = document, views, correctives
        self._welded, self._moving = welded, moving
        self._targets: tuple[list[int], Morphing] | None = None

    @property
    def place(self) -> Place:
        """The mesh of the first primitive."""
        return self.views[0].source.place._replace(primitive=None)

    @cached_property
    def rest(self) -> list[RestPrimitive]:
        """The primitives before skinning, in the order of the views."""
        return [rest_primitive(view) for view in self.views]

    @cached_property
    def vertices(self) -> int:
        """The number of vertices of all primitives."""
        return sum(len(view.now.positions) for view in self.views)

    @cached_property
    def operator(self) -> GradientOperator:
        """The operator of the truths over all primitives. Raises InputError if it takes too much memory."""
        return self._welded()

    @cached_property
    def changes(self) -> list[Float64Array]:
        """The changes (K, V, 3) of unit normals by the correctives, by primitive."""
        assert self.correctives is not None
        return self.correctives.of_views(self.views)

    def morphing(self, weights: Float64Array | None) -> Morphing | None:
        """Return the targets that move in P poses of weights (P, N); None if none does.

        Targets whose weight is 0 in every pose are not read. Raises InputError if one of the others is
        broken. A search poses a surface some hundred times, mostly by the same targets: they are read once.
        """
        moving = self._moving
        if weights is None or not (weights.any() if moving is None else moving):
            return None
        moving = np.flatnonzero(weights.any(axis=0)).tolist() if moving is None else list(moving)
        if self._targets is None or self._targets[0] != moving:
            from skinbake.measure.morphing import moving_targets  # most models have no targets
            from skinbake.truth.morphing import Morphing

            counts = [len(view.now.positions) for view in self.views]
            frames = [view.note.frame for view in self.views]
            sources = [view.source for view in self.views]
            read = moving_targets(self.document, sources, counts, moving, frames)
            self._targets = moving, Morphing(*read, weights[:, moving])
        return replace(self._targets[1], weights=weights[:, moving])


@dataclass(frozen=True, slots=True)
class Corrections:
    """The correctives of a mesh, in the poses of a draw: standard lighting of normals that targets change.

    By primitive, targets are changes of unit normals (K, V, 3), and weights (P, K).
    """

    targets: Sequence[Float64Array]
    weights: Sequence[Float64Array]

    def normals(
        self, primitive: int, skinned: BlendedPrimitive, at: slice, first_pose: int, rows: slice
    ) -> Vector:
        """Return the drawn normals of some vertices, components (P, B). first_pose is that of ``at``."""
        count = at.stop - at.start
        change = np.zeros((3, rows.stop - rows.start, count))
        weights = self.weights[primitive][first_pose : first_pose + count]
        for target, weight in zip(self.targets[primitive], weights.T, strict=True):
            change += target[rows].T[:, :, None] * weight
        return tuple(axis.T for axis in skinned.changed_normals(at, rows, change))


class PosedBlock(NamedTuple):
    """Some vertices of a draw in P of its poses, with their true normals.

    rest is their primitive before skinning, and skinned is what moves it in these poses. normals (U, 3, B, P)
    are those of U truths, and exist (U, B, P) tells where. side (P, B) is −1 where joints mirror, None if
    none does.
    """

    poses: slice
    at: VertexBlock
    rest: RestPrimitive
    skinned: BlendedPrimitive
    normals: Float64Array
    exist: BoolArray
    side: Float64Array | None


@dataclass(frozen=True, eq=False)
class Draw:
    """A surface as one skin draws it, in P poses.

    skin and node are numbers. The node is the one whose morph weights move the surface, None without morph
    targets. poses are joint matrices and morph weights: those of the rest pose until the draw is posed.
    corrections are the correctives that its clips play there, if any.
    """

    surface: Surface
    skin: int
    node: int | None
    skeleton: Skeleton
    poses: PoseSet
    corrections: Corrections | None = None

    @classmethod
    def at_rest(cls, surface: Surface, skin: int, node: int | None) -> Draw:
        """Return a draw in the rest pose, without morph weights. Raises InputError for a broken skin."""
        skeleton = read_skeleton(surface.document, skin)
        with np.errstate(over="ignore", invalid="ignore"):  # what is past all numbers is not drawn
            poses = PoseSet((), rest_pose(skeleton), ("rest pose",), (None,))
        return cls(surface, skin, node, skeleton, poses)

    def posed(self, poses: PoseSet) -> Draw:
        """Return the draw in other poses, with the correctives that clips play there."""
        correctives = self.surface.correctives
        if correctives is None:
            return replace(self, poses=poses, corrections=None)
        times = np.array([0.0 if time is None else time for time in poses.times])
        numbers = poses.numbers or (None,) * len(times)
        weights = []
        for view in self.surface.views:
            mesh = view.source.mesh
            own = np.zeros((len(times), correctives.targets.get(mesh, 0)))
            for number in dict.fromkeys(numbers):
                rows = np.flatnonzero([one == number for one in numbers])
                own[rows] = correctives.weights(mesh, self.skin, self.node, number, times[rows])
            weights.append(own)
        return replace(self, poses=poses, corrections=Corrections(self.surface.changes, weights))

    def at(self, clip: Clip, times: Float64Array, *, turned: bool = True) -> Draw:
        """Return the draw at times (P,) of a clip. If turned, it faces along +Z."""
        # A scene of a hundred characters has a hundred times the channels of each.
        nodes, document = set(self.skeleton.nodes), self.surface.document
        own = clip._replace(channels=tuple(channel for channel in clip.channels if channel.node in nodes))
        matrices = clip_poses(self.skeleton, own, times)
        if turned and faces_backward(document):
            matrices = HALF_TURN @ matrices
        weights = None
        if self.node is not None:
            weights = clip_weights(self.node, clip, times, document.asset.nodes[self.node].resting_weights())
        count = len(times)
        played = (clip.name,) * count, tuple(times.tolist()), weights, (clip.number,) * count
        return self.posed(PoseSet((), matrices, *played))

    def moved(self, by: Float64Array) -> Draw:
        """Return the draw with matrices (P, 1, 4, 4) added to the matrices of all joints."""
        return replace(self, poses=self.poses._replace(joint_matrices=self.matrices + by))

    @property
    def matrices(self) -> Float64Array:
        """The joint matrices (P, J, 4, 4)."""
        return self.poses.joint_matrices

    @property
    def morphing(self) -> Morphing | None:
        """The morph targets that move it; None if none does. Raises InputError if one is broken."""
        return self.surface.morphing(self.poses.morph_weights)

    def by_lighting(self, pose: int) -> dict[str, Sequence[RestPrimitive]]:
        """Return the primitives of a pose before skinning, of the lightings for which targets move them."""
        rest, morphing = self.surface.rest, self.morphing
        found: dict[str, Sequence[RestPrimitive]] = {}
        if morphing is not None:
            standard = morphing.standard(rest, pose)
            found = {"standard": standard, "corrected": standard, "accurate": morphing.accurate(rest, pose)}
        if self.corrections is not None:
            changed = found.get("standard", rest)
            played = zip(changed, self.corrections.targets, self.corrections.weights, strict=True)
            found["corrected"] = [
                replace(one, normals=one.normals + np.einsum("k,kvi->vi", weights[pose], targets))
                for one, targets, weights in played
            ]
        return found

    @cached_property
    def areas(self) -> list[Float64Array]:
        """The areas (V,) around the vertices of each primitive at rest, in the squared unit of the scene."""
        space = RestAreas(self.surface.document, self.skin)
        return [space.of(view.now) for view in self.surface.views]

    def positions(self, every: int = 1) -> Iterator[Float64Array]:
        """Yield positions (P, V, 3) of each primitive: all poses, or one at a time if targets move it.

        With ``every``, only every so many poses count.
        """
        morphing, rests = self.morphing, self.surface.rest
        posed = ((rest, slice(None, None, every)) for rest in rests)
        if morphing is not None:
            poses = range(0, len(self.matrices), every)
            posed = ((one, slice(n, n + 1)) for n in poses for one in morphing.primitives(rests, n))
        for rest, some in posed:
            matrices = self.matrices[some]
            whole = slice(0, len(matrices)), slice(0, len(rest.positions))
            yield BlendedPrimitive(rest, matrices, Options()).positions(*whole).transpose(2, 1, 0)

    def truths(self, names: Sequence[Truth] = USUAL_TRUTHS) -> Truths:
        """Measure the surface at rest, for any as many poses without morph targets."""
        surface = self.surface
        return truths_at_rest(surface.operator, surface.rest, len(self.matrices), self.morphing, names)

    def true_normals(
        self, at_rest: Truths, work: Callable[[PosedBlock], Found], threads: Threads
    ) -> Iterator[Found]:
        """Yield the results of work on all vertices in all poses, block by block.

        Threads do the work. Their number does not change the order.
        """
        sides, morphing = sides_of(self.surface.rest, self.matrices), self.morphing
        weights = np.zeros((len(self.matrices), 0)) if morphing is None else morphing.weights

        def posed(first: int, poses: slice) -> Iterator[Found]:
            """Yield the results in poses of the same weights as the first one."""
            rests: Sequence[RestPrimitive] = self.surface.rest
            truths = at_rest
            if morphing is not None:
                rests, truths = morphing.posed(rests, truths, first)
            skinned = [BlendedPrimitive(one, self.matrices[poses], Options()) for one in rests]
            every = slice(0, poses.stop - poses.start)
            deformed = np.empty((3, self.surface.vertices, every.stop))
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # past all numbers: no truth
                for block in truths.vertex_blocks:
                    skinned[block.primitive].put_positions(every, block.rows, deformed, block.part.start)
            sums = truths.sums(deformed, threads)

            def worked(block: VertexBlock) -> Found:
                side, number = None if sides is None else sides[poses, block.part], block.primitive
                with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # likewise
                    normals = truths.normals(block.number, deformed, sums, side)
                    return work(PosedBlock(poses, block, rests[number], skinned[number], *normals, side))

            yield from threads.each(worked, truths.vertex_blocks)

        # Poses of equal weights start from the same primitives.
        edges = (np.flatnonzero((weights[1:] != weights[:-1]).any(axis=1)) + 1).tolist()
        for first, last in pairwise([0, *edges, len(weights)]):
            for start in range(first, last, POSES):
                yield from posed(first, slice(start, min(start + POSES, last)))
