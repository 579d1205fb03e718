"""``skinbake strip``: the document as it was before bake."""

from __future__ import annotations

from dataclasses import replace

from skinbake.errors import InputError, Notice, Place, noticed
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.files.urls import STDIO
from skinbake.files.versions import version_of
from skinbake.format.strip import has_lost_metadata, stripped
from skinbake.gltf.document import read_document
from skinbake.gltf.writing.beside import files_read
from skinbake.gltf.writing.container import for_target
from skinbake.gltf.writing.output import plan_output, refuse_own_input, tell_other_names
from skinbake.report.depfile import prerequisites
from skinbake.report.strip import StripResult
from skinbake.timing import stage


def strip_file(
    source: str,
    target: str,
    *,
    warnings_as_errors: bool = False,
    sync: bool = True,
    bounds: Bounds = BESIDE,
    root: str | None = None,
    lists_read: bool = False,
) -> StripResult:
    """Write a document without the additions of bake. Raises SkinbakeError; then nothing is written.

    With ``sync``, it waits until the file is on the disk. Nothing is written outside ``root``, which is the
    target's own folder by default. A file that holds no bake is not replaced by itself.
    With ``lists_read``, the result names the files that were read beside the source.
    """
    in_place = target == source != STDIO
    replaced = version_of(source) if in_place else None
    with stage("read"):
        given = read_document(source, bounds)
    refuse_own_input(given, source, target)
    with stage("strip"):
        document, count = stripped(given)
    if count == 0:
        reason = "it holds no bake"
        if has_lost_metadata(given):
            reason = "its α/β have no metadata to undo them by: take its source"
        given.notices.tell(Notice("nothing-baked", f"passed through unchanged: {reason}", Place(source)))
    document = for_target(document, target)
    read = prerequisites(source, files_read(given, target, pack=False)) if lists_read else ()
    with stage("write"):
        untouched = in_place and count == 0
        planned = None if untouched else plan_output(document, target, root=root)
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
            replace(planned, replaces=replaced).write(sync=sync)
    return StripResult(source, target, count, notices, read=read)
