"""What dump, pictures and pages show of a document: a bake in memory if it has none, and the asked clips."""

from __future__ import annotations

from collections.abc import Sequence

from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import ChoiceError, InputError, Notice, Skipped, printable
from skinbake.format.strip import stripped, uncorrected
from skinbake.freshness.baked_views import BakedView, is_baked
from skinbake.freshness.corrective_freshness import damaged_correctives
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import Clip, read_clips
from skinbake.gltf.reading.materials import tell_images_unplaced
from skinbake.gltf.reading.meshes import reason_to_skip, skinned_sources, why_nothing
from skinbake.wording import counted

LISTED = 20
"""The names of clips that a message lists."""

OF_STORAGE = {"draco-sequential"}
"""The notices of a bake that speak only of the bytes of its output."""


def baked_in_memory(document: Document) -> Document:
    """Bake a document with the defaults. Raises InputError if nothing in it can be baked.

    Nothing is stored, so nothing is told of storage.
    """
    count = len(skinned_sources(document))
    what = f"baking {counted(count, 'primitive')} in memory"
    document.budget.claim(Cost.DRAWN_PRIMITIVE * count, what, document.place)
    with document.notices.withheld():
        plain, _ = uncorrected(document)
        if plain is document or holds_bake(document):
            plain, _ = stripped(document)
    with document.notices.withheld() as told:
        made = bake_document(plain, BakeOptions(generate_normals=True))
    if not made.primitives:
        reasons = "; ".join(notice.reason for notice in told if isinstance(notice, Skipped))
        raise InputError(f"nothing in it can be shown: {reasons or why_nothing(document)}", document.place)
    tell, sources = document.notices.tell, skinned_sources(document)
    message = "its bake is damaged, and one made in memory is shown: skinbake verify says what is wrong"
    tell(*(Notice("bake-damaged", message, one.place) for one in sources if is_baked(document, one)))
    for problem in damaged_correctives(document):
        message = f"its correctives are left out here, and α and β shown in place of them: {problem.message}"
        tell(Notice("correctives-not-shown", message, problem.place))
    message = "it has no NORMAL: smooth normals are generated here, and in a bake with --generate-normals"
    for one in sources:
        if "NORMAL" not in one.attributes and reason_to_skip(document, one, generate_normals=True) is None:
            tell(Notice("normals-generated", message, one.place))
    tell(*(notice for notice in told if notice.code not in OF_STORAGE))
    return made.document


def holds_bake(document: Document) -> bool:
    """Tell whether a primitive holds a bake, sound or not."""
    return any(is_baked(document, source) for source in skinned_sources(document))


def tell_unplaced(document: Document, view: BakedView, made: str) -> None:
    """Tell if an image of a primitive has no texture coordinates there."""
    ours = {*view.note.alpha, *view.note.beta}  # they may be stored as such sets
    tell_images_unplaced(document, view.source, set(view.source.attributes) - ours, made)


def asked_clips(document: Document, asked: str | None) -> Sequence[Clip]:
    """Return the clip of a name or number, or all. Raises ChoiceError for a clip that does not exist."""
    clips = read_clips(document)
    if asked is None:
        return clips
    named = [clip for clip in clips if clip.name == asked]
    if not named and asked.isdecimal():
        named = [clip for clip in clips if clip.number == int(asked)]
    if not named:
        alike = [clip for clip in clips if document.asset.animations[clip.number].name == asked]
        there = alike or clips
        listed = [printable(clip.name) for clip in there[:LISTED]] or ["none"]
        more = [f"{len(there) - LISTED} more"] if len(there) > LISTED else []
        what = "several clips of this name: choose by number among" if alike else "no such clip; it has"
        raise ChoiceError(
            "clip", printable(asked), reason=(f": the file has {what} {', '.join(listed + more)}",)
        )
    return named
