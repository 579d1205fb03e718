"""``skinbake strip``: the document as it was before bake."""

from __future__ import annotations

from skinbake.containment import BESIDE, Bounds
from skinbake.errors import InputError, Notice, Place
from skinbake.format.strip import stripped
from skinbake.gltf.container import for_target
from skinbake.gltf.document import read_document
from skinbake.gltf.output import plan_output, refuse_own_input
from skinbake.report.strip import StripResult


def strip_file(
    source: str,
    target: str,
    *,
    warnings_as_errors: bool = False,
    sync: bool = True,
    bounds: Bounds = BESIDE,
) -> StripResult:
    """Write a document without the additions of bake. Raises SkinbakeError; then nothing is written.

    With ``sync``, it waits until the file is on the disk.
    """
    document = read_document(source, bounds)
    refuse_own_input(document, source, target)
    document, count, notices = stripped(document)
    if count == 0:
        notices.append(Notice("nothing-baked", "passed through unchanged: it holds no bake", Place(source)))
    document, found = for_target(document, target)
    planned = plan_output(document, target)
    notices += [*found, *planned.notices]
    if warnings_as_errors and notices:
        raise InputError(
            f"not written: {'; '.join(notice.message for notice in notices)} (--warnings-as-errors)",
            Place(source),
        )
    planned.write(sync=sync)
    return StripResult(source, target, count, tuple(notices))
