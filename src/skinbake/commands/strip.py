"""``skinbake strip``: the document as it was before bake."""

from __future__ import annotations

from dataclasses import replace

from skinbake.errors import InputError, Notice, Place, noticed
from skinbake.files.bounds import OWN_FOLDERS, Within
from skinbake.files.urls import STDIO
from skinbake.files.versions import version_of
from skinbake.format.strip import has_lost_metadata, stripped
from skinbake.gltf.document import read_document
from skinbake.gltf.writing.beside import files_read
from skinbake.gltf.writing.container import for_target
from skinbake.gltf.writing.output import AS_USUAL, Writing, plan_output, refuse_own_input, tell_other_names
from skinbake.report.depfile import prerequisites
from skinbake.report.strip import StripResult
from skinbake.timing import stage


def strip_file(
    source: str,
    target: str,
    writing: Writing = AS_USUAL,
    within: Within = OWN_FOLDERS,
    *,
    warnings_as_errors: bool = False,
) -> StripResult:
    """Write a document without the additions of bake. Raises SkinbakeError; then nothing is written.

    A file that holds no bake is not replaced by itself.
    """
    in_place = target == source != STDIO
    replaced = version_of(source) if in_place else None
    with stage("read"):
        given = read_document(source, within.bounds)
    refuse_own_input(given, source, target)
    with stage("strip"):
        document, count = stripped(given)
    if count == 0:
        reason = "it holds no bake"
        if has_lost_metadata(given):
            reason = "its α/β have no metadata to undo them by: take its source"
        given.notices.tell(Notice("nothing-baked", f"passed through unchanged: {reason}", Place(source)))
    document = for_target(document, target)
    read = prerequisites(source, files_read(given, target, pack=False)) if writing.lists_read else ()
    with stage("write"):
        untouched = in_place and count == 0
        planned = None if untouched else plan_output(document, target, root=within.output)
    if in_place and planned:
        tell_other_names(given, source)
    notices = tuple(given.notices)
    if warnings_as_errors and notices:
        raise InputError(
            f"not written: {'; '.join(notice.message for notice in notices)} (--warnings-as-errors)",
            Place(source),
        )
    if planned is not None:
        with noticed(notices), stage("write"):
            replace(planned, replaces=replaced).write(sync=writing.sync)
    return StripResult(source, target, count, notices, read=read)
