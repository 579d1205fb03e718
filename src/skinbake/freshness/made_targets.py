"""Whether what bake has made for morph targets still fits what they add to POSITION."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from skinbake.errors import BudgetError, InputError, Notice
from skinbake.format.morph_targets import morph_digest
from skinbake.format.note import MorphTargets, made_targets
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.meshes import read_primitive
from skinbake.gltf.reading.morphs import read_targets


class MadeState(NamedTuple):
    """A primitive of whose targets some have NORMAL by bake, or all numbers of the differential.

    frames is how many numbers these are. changed: what both follow from is not what it was.
    """

    source: PrimitiveSource
    targets: int
    frames: int
    of: int
    changed: bool

    @property
    def notice(self) -> Notice:
        """Return what is wrong if they changed."""
        made = " and ".join(["NORMAL"] * bool(self.targets) + ["the differential"] * bool(self.frames))
        options = " ".join(["--morph-normals"] * bool(self.targets) + ["--morph-frames"] * bool(self.frames))
        message = (
            f"what bake has made for its morph targets ({made}) does not belong to its positions and normals "
            f"now: run skinbake bake {options}"
        )
        return Notice("morphs-stale", message, self.source.place, self.of)


def made_states(document: Document) -> Iterator[MadeState]:
    """Yield the primitives whose targets have NORMAL by bake, with or without a skin."""
    meshes = [made_targets(document, mesh.number) for mesh in document.asset.meshes]
    for source in document.asset.primitives:
        noted = meshes[source.mesh][source.primitive]
        if noted:
            targets = source.whole_targets
            with document.budget.passing():
                changed = _digest(document, source, noted) != noted.digest
            yield MadeState(source, len(noted.normals), noted.frames, len(targets), changed)


def _digest(document: Document, source: PrimitiveSource, noted: MorphTargets) -> str | None:
    """Return the digest of what was made for the targets of a primitive, None if it is not all there."""
    targets = source.whole_targets
    if any(not 0 <= number < len(targets) or "NORMAL" not in targets[number] for number in noted.normals):
        return None
    if any(name not in target for target in targets for name in noted.names):
        return None
    made = list(range(len(targets))) if noted.frames else list(noted.normals)
    try:
        primitive = read_primitive(document, source)
        read = read_targets(document, source, made, count=len(primitive.positions), tangents=False)
    except BudgetError:
        raise
    except InputError:
        return None
    assert read is not None
    moves = dict(zip(made, (target.positions for target in read.targets), strict=True))
    return morph_digest(primitive, moves)
