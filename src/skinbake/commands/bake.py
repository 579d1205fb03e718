"""``skinbake bake``: read a document, bake every skinned primitive, write it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from skinbake.choices import FrameChoice, Scheme
from skinbake.commands.bake_options import DEFAULTS, BakeOptions
from skinbake.commands.gradient_bake import BakedDocument, bake_gradients
from skinbake.errors import Chosen, InputError, Notice, Skipped, noticed, skipped, warnings_in
from skinbake.files.bounds import OWN_FOLDERS, Within
from skinbake.files.temporary import Ahead
from skinbake.files.urls import STDIO
from skinbake.files.versions import digests_of, version_of
from skinbake.format.note import Left as LeftNote
from skinbake.format.note import corrective_notes, refuse_other_kind, with_left, with_left_primitives
from skinbake.format.strip import stripped
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.meshes import reason_to_skip, skinned_sources, tell_half_skinned, why_nothing
from skinbake.gltf.writing.beside import files_read
from skinbake.gltf.writing.container import for_target
from skinbake.gltf.writing.output import (
    AS_USUAL,
    Writing,
    plan_output,
    refuse_own_input,
    tell_other_names,
    write_ahead,
)
from skinbake.report.bake import FileResult, Left
from skinbake.timing import stage

FITTED = "--gradients fitted"
"""The option that leaves what every part of its fit lights worse."""

JSON_A_PRIMITIVE = 1450
"""About as many bytes of JSON are added for a primitive."""


def bake_file(
    source: str,
    target: str | None,
    options: BakeOptions = DEFAULTS,
    writing: Writing = AS_USUAL,
    within: Within = OWN_FOLDERS,
) -> FileResult:
    """Bake one file and write it to ``target``. With None, or on a dry run, nothing is written.

    Raises SkinbakeError, and then nothing has been written. Its notices are those found before the error.
    """
    # A file in its own place is replaced only if nobody has written it since.
    replaced = version_of(source) if target == source != STDIO else None
    with stage("read"):
        document = read_document(source, within.bounds)
    if target is not None:
        refuse_own_input(document, source, target)
    with noticed(document.notices), Ahead(is_itself=replaced is not None) as ahead:
        # The waits for the disk are the longest of a large file, so it begins to be written beside the bake.
        begin = None
        if target is not None and writing.sync and not writing.dry_run:
            begin = partial(write_ahead, ahead, target=target, root=within.output)
        made = rebaked(document, target, options, pack=writing.pack, begin=begin)
        read: tuple[str, ...] = ()
        if writing.lists_read:
            from skinbake.report.depfile import prerequisites  # only --depfile needs it

            read = prerequisites(source, files_read(document, target, pack=writing.pack))
        # What has no change and stays in its place is not written.
        planned = None
        if target is not None and not (made.document is document and target == source != STDIO):
            with stage("write"):
                planned = plan_output(made.document, target, root=within.output, grows=made.is_baked)
            if target == source:
                tell_other_names(document, source)
        # All that can be told has been told, and nothing is written yet.
        if options.warnings_as_errors and warnings_in(document.notices):
            raise InputError("not written: there are warnings (--warnings-as-errors)", document.place)
        if planned is not None and not writing.dry_run:
            with stage("write"):
                planned = replace(planned, replaces=replaced).write(sync=writing.sync, ahead=ahead)
    return FileResult(
        source,
        target,
        "baked" if made.is_baked else "left" if made.left else "unchanged",
        tuple(made.primitives),
        made.skipped,
        tuple(document.notices),
        encoding=made.encoding,
        correctives=tuple(made.correctives),
        lighting=made.lighting,
        morphs=tuple(made.morphs),
        written=digests_of(planned.files) if writing.traced and planned else {},
        read=read,
        left=made.left,
    )


def rebaked(
    document: Document,
    target: str | None,
    options: BakeOptions,
    *,
    pack: bool = False,
    begin: Callable[..., None] | None = None,
) -> BakedDocument:
    """Bake a document that may hold an earlier bake, for the container of the target.

    ``begin`` gets the document before the bake, and about how much its JSON will grow. If no primitive can be
    baked, the result is the document as it came, with any earlier bake. Raises InputError.
    """
    refuse_other_kind(document, correctives=options.correctives is not None)
    if options.correctives is not None and options.character is None:
        for number, note in corrective_notes(document).items():
            if note.character:
                others = ", ".join(note.character)
                message = f"its correctives were those of {others}: baked alone, it does not fit their clips"
                place = document.asset.meshes[number].place
                document.notices.tell(Notice("character-apart", message, place))
    with document.notices.withheld() as before:
        # A bake is made of the file as it was before an earlier one: two bakes give what one gives.
        with stage("strip"):
            original, _ = stripped(document)
            prepared = original if target is None else for_target(original, target, pack=pack)
        if begin is not None and document.asset.skins and options.compress is Scheme.KEEP:
            count = len(document.asset.primitives) if original is document else 0
            begin(prepared, growth=JSON_A_PRIMITIVE * count)
    with document.notices.withheld() as told:
        made = bake_document(prepared, options)
    if made.is_baked or made.left:
        document.notices.tell(*before, *told)
        return made
    # Nothing was baked, and so nothing is undone.
    reason = "none of its skinned primitives can be baked" if made.skipped else why_nothing(document)
    if options.character is not None and document.asset.animations:
        reason += (
            ". Only a node with the mesh has a channel of weights, so its clips play no correctives: export "
            "it with the mesh, put its clips into the character's file before the bake, or bake α and β"
        )
    if options.correctives is not None and told:
        last = [*told][-1]
        reason = last.reason if isinstance(last, Skipped) else last.message
    if options.require_baked:
        raise InputError(f"{reason} (--require-baked)", document.place)
    result = document if target is None else for_target(document, target, pack=pack)
    is_idle = options.correctives is not None and told and not warnings_in(told)
    code = "nothing-to-correct" if is_idle else "nothing-baked"
    document.notices.tell(*told, Notice(code, f"passed through unchanged: {reason}", document.place))
    return made._replace(document=result)


class LeftOut(NamedTuple):
    """What a choice leaves out: the option as it is typed, and what is to be told of it."""

    option: str
    notices: Sequence[Notice] = ()


def left_by_choice(options: BakeOptions, source: PrimitiveSource) -> LeftOut | None:
    """Return which option leaves out a primitive that could be baked, None if none does.

    Every such choice belongs here. The bake notes it in the file, and so ``verify`` takes the primitive for
    left on purpose, not for forgotten.
    """
    if options.frame is FrameChoice.TANGENT:
        lacking = next((name for name in ("NORMAL", "TANGENT") if name not in source.attributes), None)
        if lacking is not None:
            auto = Chosen("frame", FrameChoice.AUTO)
            words = f"it has no {lacking}; ", auto, " takes the frame from NORMAL"
            return LeftOut("--frame tangent", [skipped("no-tangents", source.place, *words)])
    return None


def bake_document(
    document: Document,
    options: BakeOptions = DEFAULTS,
    leaves: Callable[[BakeOptions, PrimitiveSource], LeftOut | None] = left_by_choice,
) -> BakedDocument:
    """Bake the skinned primitives of a document that holds no earlier bake (``stripped``).

    Those that a choice ``leaves`` out are noted as such. Raises InputError.
    """
    # What is baked, what a choice leaves out, and why the rest cannot be baked.
    sources: list[PrimitiveSource] = []
    left_by: list[tuple[PrimitiveSource, str]] = []
    every = skinned_sources(document)
    tell_half_skinned(document)
    for source in every:
        reason = reason_to_skip(document, source, generate_normals=options.generate_normals)
        choice = leaves(options, source) if reason is None else None
        if reason is not None:
            document.notices.tell(reason)
        elif choice is not None:
            left_by.append((source, choice.option))
            document.notices.tell(*choice.notices)
        else:
            sources.append(source)
    left_out = len(every) - len(sources)
    if not sources and not options.morph_normals:
        return BakedDocument(document, skipped=left_out)
    with document.notices.withheld() as told:
        if options.correctives is None:
            made = bake_gradients(document, sources, options)
            baked = {place for place, _ in made.primitives}
            held = [source for source in sources if source.place not in baked]
            left_by += [(source, FITTED) for source in held]
            left_out += len(held)
            if held and not made.is_baked:
                made = made._replace(left=Left(reason="standard lighting is better"))
        else:
            from skinbake.commands.corrective_bake import bake_correctives  # most bakes add α and β

            made = bake_correctives(document, sources, options)
        made = made._replace(skipped=left_out)
        left = made.left or _left(made, options, told)
    noted = None
    if left is not None:
        by = FITTED if made.left else ""
        note = LeftNote(by=by, gain=left.gain, standard_error=left.standard_error, under=left.under)
        noted = with_left(document, note)
    if noted is None:
        document.notices.tell(*told)
        if not made.is_baked:
            return made._replace(left=None)
        return made._replace(document=with_left_primitives(made.document, left_by))
    # Of a bake that is not written, only its advice counts.
    is_advised = options.correctives is None
    document.notices.tell(*(one for one in told if made.left or (one.is_advice and is_advised)))
    return BakedDocument(noted, skipped=left_out, left=left)


def _left(made: BakedDocument, options: BakeOptions, told: Collection[Notice]) -> Left | None:
    """Return why a document is better left unbaked, None if it is not, or if nobody asks.

    The gain is measured as verify does. The lower one of both truths counts. ``told`` are the notices of the
    bake.
    """
    limit, corrects = options.leave_under, options.correctives is not None
    if limit is None or not (corrects or made.primitives):
        return None
    from skinbake.measure.measured import lighting_of
    from skinbake.report.verify import NEGLIGIBLE, by_worse_truth, gain

    measured = made.document
    try:
        with stage("gain"):
            if corrects:
                from skinbake.commands.corrective_bake import lighting_with_correctives

                verdict = made.verdict or lighting_with_correctives(measured)
            else:
                verdict = lighting_of(measured)
            figures = by_worse_truth(verdict)
        if verdict.unplayed is not None:
            raise verdict.unplayed
    except InputError as error:
        message = f"it is baked, because its gain could not be measured: {error.message}"
        measured.notices.tell(Notice("gain-unmeasured", message, error.place or measured.place))
        return None
    if not figures:
        return None
    factor, standard = gain(figures), figures["standard"].mean
    if standard >= NEGLIGIBLE and (factor is None or factor >= limit):
        return None
    still = "no clip moves its joints"
    reason = f"in random poses, because {still}" if "random" in verdict.poses else ""
    if corrects and not made.correctives and any(notice.code == "no-clips" for notice in told):
        factor, reason = None, f"{still}, and only clips play correctives"
    return Left(factor, standard, limit, reason)
