"""Whether the NORMAL that bake has made for morph targets still fits what they add to POSITION."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from skinbake.errors import InputError, Notice
from skinbake.format.morph_targets import morph_digest, noted_primitive
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import entries_of
from skinbake.gltf.morphs import read_targets
from skinbake.gltf.primitives import PrimitiveSource, all_sources, read_primitive


class MadeState(NamedTuple):
    """A primitive whose targets have NORMAL by bake: how many of all, and whether they changed since."""

    source: PrimitiveSource
    targets: int
    of: int
    changed: bool

    @property
    def notice(self) -> Notice:
        """Return what is wrong if they changed."""
        message = (
            f"the NORMAL that bake has made for {self.targets:,} of its {self.of:,} morph targets does not "
            "belong to its positions and normals now: run skinbake bake --morph-normals"
        )
        return Notice("morph-normals-stale", message, self.source.place, self.targets)


def made_states(document: Document) -> Iterator[MadeState]:
    """Yield the primitives whose targets have NORMAL by bake, with or without a skin."""
    for source in all_sources(document):
        noted = noted_primitive(document.objects("meshes")[source.mesh], source.primitive)
        if noted:
            targets = entries_of(source.json.get("targets"))
            made = noted["normals"]
            with document.budget.passing():
                changed = _digest(document, source, made) != noted.get("digest")
            yield MadeState(source, len(made), len(targets), changed)


def _digest(document: Document, source: PrimitiveSource, made: list[int]) -> str | None:
    """Return the digest of what these targets of a primitive follow from now, None if it is not all there."""
    targets = entries_of(source.json.get("targets"))
    if any(not 0 <= number < len(targets) or "NORMAL" not in targets[number] for number in made):
        return None
    try:
        primitive = read_primitive(document, source)
        read = read_targets(document, source, made, count=len(primitive.positions), tangents=False)
    except InputError as error:
        if error is document.budget.refusal:
            raise
        return None
    assert read is not None
    moves = dict(zip(made, (target.positions for target in read.targets), strict=True))
    return morph_digest(primitive, moves)
