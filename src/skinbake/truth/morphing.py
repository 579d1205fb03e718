"""A mesh under its morph targets in some poses: its primitives before skinning, and their truths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from skinbake.geometry.morphs import MorphTargets
from skinbake.geometry.skinned import Float64Array
from skinbake.skinning.morphs import as_engines_light, morphed
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.truths import Truths


@dataclass(frozen=True, slots=True)
class Morphing:
    """The morph targets of one mesh by primitive (None: no targets), and their weights (P, N) in P poses.

    authored tells by primitive whether the file gives NORMAL for all that moves there. Where it does not, or
    bake has made it, the true normals belong to the moved surface. kept, if it is there, keeps each pose's
    primitives and truths when they are first made, for another method.
    """

    targets: tuple[MorphTargets | None, ...]
    authored: tuple[bool, ...]
    weights: Float64Array
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
