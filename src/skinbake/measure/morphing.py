"""The morph targets of baked meshes, and what their frames follow."""

from __future__ import annotations

from collections.abc import Sequence

from skinbake.choices import Frame, Morphs
from skinbake.format.note import MorphTargets as MadeTargets
from skinbake.format.note import made_targets
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.morphs import MorphTargets
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.morphs import read_targets

NUMBERS = {6: Morphs.FRAMES, 4: Morphs.FRAMES_NORMAL}
"""What follows so many numbers of the differential."""


def moving_targets(
    document: Document,
    sources: Sequence[PrimitiveSource],
    counts: Sequence[int],
    moving: list[int],
    frames: Sequence[str],
) -> tuple[tuple[MorphTargets | None, ...], tuple[bool, ...]]:
    """Return some targets of primitives of so many vertices, and whether the file gives NORMAL for them.

    frames are those of the primitives. Raises InputError if a target is broken.
    """
    made = noted_of(document, sources)
    targets = tuple(
        read_targets(
            document, source, moving, count=count, tangents=frame == Frame.TANGENT, further=noted.names
        )
        for source, count, frame, noted in zip(sources, counts, frames, made, strict=True)
    )
    return targets, tuple(_is_authored(*pair, moving) for pair in zip(targets, made, strict=True))


def noted_of(document: Document, sources: Sequence[PrimitiveSource]) -> list[MadeTargets]:
    """Return what bake has added to the targets of primitives."""
    meshes = {source.mesh for source in sources}
    noted = {mesh: made_targets(document, mesh) for mesh in meshes}
    return [noted[source.mesh][source.primitive] for source in sources]


def _is_authored(targets: MorphTargets | None, noted: MadeTargets, moving: Sequence[int]) -> bool:
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
    for view, noted in zip(views, noted_of(document, [view.source for view in views]), strict=True):
        targets = view.source.targets
        if targets:
            stored.add(noted.frames)
            found = Morphs.NORMAL if found is Morphs.NONE else found
            if view.note.frame == Frame.TANGENT and any("TANGENT" in target for target in targets):
                found = Morphs.TANGENT
    return NUMBERS.get(next(iter(stored)), found) if numbers and len(stored) == 1 else found
