"""The morph targets of baked meshes that move in the measured poses of a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from skinbake.choices import Frame, Morphs
from skinbake.format.morph_targets import NotedTargets, noted_targets
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.morphs import MorphTargets
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import objects
from skinbake.gltf.morphs import read_targets, target_count
from skinbake.report.verify import MorphCount
from skinbake.skinning.morphs import as_engines_light, morphed
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.poses import PoseSet
from skinbake.truth.truths import Truths

NUMBERS = {6: Morphs.FRAMES, 4: Morphs.FRAMES_NORMAL}
"""What follows so many numbers of the differential."""


@dataclass(frozen=True, slots=True)
class Morphing:
    """The morph targets of one mesh by primitive (None: no targets), and their weights (P, N) in P poses.

    authored tells by primitive whether the file gives NORMAL for all that moves there. Where it does not, or
    bake has made it, the true normals are those of the moved surface. kept, if it is there, keeps each pose's
    primitives and truths when they are first made, for another method.
    """

    targets: tuple[MorphTargets | None, ...]
    weights: Float64Array
    authored: tuple[bool, ...]
    kept: dict[int, tuple[Sequence[RestPrimitive], Truths]] | None = None

    def primitives(self, primitives: Sequence[RestPrimitive], pose: int) -> list[RestPrimitive]:
        """Return the primitives as they are in one pose, before skinning.

        One of them serves all lightings: it has the normals of engines, and the frame of accurate lighting.
        """
        weights = self.weights[pose]
        return [
            moved if targets is None else as_engines_light(moved, rest, targets, weights)
            for moved, rest, targets in zip(
                self.accurate(primitives, pose), primitives, self.targets, strict=True
            )
        ]

    def accurate(self, primitives: Sequence[RestPrimitive], pose: int) -> list[RestPrimitive]:
        """Return the primitives in one pose as accurate lighting has them: normals belong to frames."""
        weights = self.weights[pose]
        return [
            primitive if targets is None else morphed(primitive, targets, weights)
            for primitive, targets in zip(primitives, self.targets, strict=True)
        ]

    def standard(self, primitives: Sequence[RestPrimitive], pose: int) -> list[RestPrimitive]:
        """Return the primitives in one pose as engines have them, which know no numbers of bake."""
        without = [None if targets is None else targets._replace(numbers=0) for targets in self.targets]
        return replace(self, targets=tuple(without)).accurate(primitives, pose)

    def posed(
        self, primitives: Sequence[RestPrimitive], truths: Truths, pose: int
    ) -> tuple[Sequence[RestPrimitive], Truths]:
        """Return the primitives as they are in one pose, before skinning, and their truths.

        primitives and truths are those without morph targets.
        """
        if not self.weights[pose].any():
            return primitives, truths
        kept = {} if self.kept is None else self.kept
        if pose not in kept:
            moved = self.primitives(primitives, pose)
            kept[pose] = moved, truths.moved(self.as_true(moved, truths))
        return kept[pose]

    def as_true(self, moved: Sequence[RestPrimitive], truths: Truths) -> Sequence[RestPrimitive]:
        """Return the primitives of a pose with the normals that are true before skinning."""
        if all(self.authored):
            return moved
        return [
            primitive if by_file else replace(primitive, normals=normals)
            for primitive, by_file, normals in zip(
                moved, self.authored, truths.surface_normals(moved), strict=True
            )
        ]


def morphing_of(document: Document, views: Sequence[BakedView], poses: PoseSet) -> Morphing | None:
    """Return the moving targets of the primitives of one mesh in these poses; None if no target moves.

    Targets whose weight is 0 in every pose are not read. Raises InputError if one of the others is broken.
    """
    moving = poses.moving_targets
    if poses.morph_weights is None or not moving:
        return None
    made = noted_of(document, views)
    targets = tuple(
        read_targets(
            document,
            view.source,
            moving,
            count=len(view.now.positions),
            tangents=view.metadata["frame"] == Frame.TANGENT,
            further=noted.names,
        )
        for view, noted in zip(views, made, strict=True)
    )
    authored = tuple(_is_authored(*pair, moving) for pair in zip(targets, made, strict=True))
    return Morphing(targets, poses.morph_weights[:, moving], authored)


def noted_of(document: Document, views: Sequence[BakedView]) -> list[NotedTargets]:
    """Return what bake has added to the targets of primitives."""
    meshes = {view.source.mesh for view in views}
    noted = {mesh: noted_targets(document.objects("meshes")[mesh]) for mesh in meshes}
    return [noted[view.source.mesh][view.source.primitive] for view in views]


def _is_authored(targets: MorphTargets | None, noted: NotedTargets, moving: Sequence[int]) -> bool:
    """Tell whether all of these targets that move a primitive turn its normals too, and none by bake."""
    return targets is None or all(
        len(target.normals.rows) and number not in noted.normals
        for number, target in zip(moving, targets.targets, strict=True)
        if len(target.positions.rows)
    )


def carrier(document: Document, views: Sequence[BakedView], *, numbers: bool) -> Morphs:
    """Return what the frame of primitives follows under their morph targets; NONE without targets.

    With ``numbers``, it is the differential if all have the same numbers of it. Else it is the tangent if the
    frame comes from TANGENT and any target has TANGENT, else the normal.
    """
    found = Morphs.NONE
    stored: set[int] = set()
    for view, noted in zip(views, noted_of(document, views), strict=True):
        targets = objects(view.source.json, "targets", view.source.place)
        if targets:
            stored.add(noted.frames)
            found = Morphs.NORMAL if found is Morphs.NONE else found
            if view.metadata["frame"] == Frame.TANGENT and any("TANGENT" in target for target in targets):
                found = Morphs.TANGENT
    return NUMBERS.get(next(iter(stored)), found) if numbers and len(stored) == 1 else found


def morph_count(document: Document, drawn: Iterable[tuple[int, PoseSet]]) -> MorphCount | None:
    """Count the morph targets of meshes, and the targets that move in the poses of any node that draws them.

    drawn are meshes with their poses. None if there are no targets.
    """
    moving: dict[int, set[int]] = {}
    for mesh, poses in drawn:
        moving.setdefault(mesh, set()).update(poses.moving_targets)
    targets = sum(target_count(document, mesh) for mesh in moving)
    return MorphCount(targets, sum(map(len, moving.values()))) if targets else None
