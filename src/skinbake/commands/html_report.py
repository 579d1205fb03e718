"""``skinbake verify --html``: the page of one file, or an index and the pages of several."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from skinbake.commands.render import small_picture
from skinbake.commands.view import page_of
from skinbake.files.bounds import Bounds
from skinbake.files.writing import write_file, write_files
from skinbake.gltf.document import Document, read_document
from skinbake.lighting.verify_options import VerifyOptions
from skinbake.report.verify import FileVerdict, by_worse_truth, first_problem, gain
from skinbake.view.index import Listed, index, pages


def _page(document: Document, verdict: FileVerdict, options: VerifyOptions) -> bytes:
    """Return the page of a file that was verified, with its verdict and the limits that it was held to."""
    return page_of(document, verdict, [], limits=limits_in_words(options))[0]


def write_report(
    verdicts: Sequence[FileVerdict],
    options: Mapping[str, VerifyOptions],
    target: str,
    bounds: Callable[[str], Bounds],
    *,
    sync: bool = True,
) -> Path | None:
    """Write the page of one verdict, or an index and the pages of several in a folder of its name.

    ``options`` are those of each input. ``bounds`` gives the folders in which the document of an input may
    name files. A file that cannot be read, or was not verified again, has no page. The index tells the limits
    that are the same for all, and that there are others. Return the folder of the pages, None if there is
    none. Raises SkinbakeError; the files that were written before stay.
    """
    if len(verdicts) == 1 and verdicts[0].error is None and not verdicts[0].up_to_date:
        source = verdicts[0].input
        document = read_document(source, bounds(source))
        write_file([_page(document, verdicts[0], options[source])], target, sync=sync)
        return None
    listed, folder = [], None
    for verdict, path in zip(verdicts, pages(target, [one.input for one in verdicts]), strict=True):
        link = picture = None
        if verdict.error is None and not verdict.up_to_date:
            document = read_document(verdict.input, bounds(verdict.input))
            page, picture = _page(document, verdict, options[verdict.input]), small_picture(document)
            write_files(path.parent, {path: [page]}, str(path), sync=sync)
            folder = path.parent
            link = f"{quote(folder.name)}/{path.name}"
        listed.append(_listed(verdict, link, picture))
    limits = [limits_in_words(options[verdict.input]) for verdict in verdicts]
    write_file([index(listed, _limits_of_all(limits))], target, sync=sync)
    return folder


def _listed(verdict: FileVerdict, link: str | None, picture: bytes | None) -> Listed:
    """Return the entry of a file in the index."""
    figures = by_worse_truth(verdict)
    return Listed(
        name=verdict.input,
        link=link,
        picture=picture,
        outcome=verdict.outcome,
        remark=_remark(verdict),
        standard=figures["approximated"].mean if figures else None,
        accurate=figures["accurate"].mean if figures else None,
        gain=gain(figures) if figures else None,
    )


def _remark(verdict: FileVerdict) -> str:
    """Return why a file failed, or why it has no figures."""
    if verdict.error is not None:
        where = verdict.error.place.within_file if verdict.error.place else ""
        return f"{where}: {verdict.error.message}" if where else verdict.error.message
    if verdict.up_to_date:
        return "before, up to date"  # after the outcome: passed
    if not verdict.passed:
        return first_problem(verdict)
    skipped = [check.remark for check in verdict.checks if check.outcome == "skipped"]
    return "" if verdict.found_no_bake else "; ".join(skipped)


def _limits_of_all(limits: Sequence[Sequence[str]]) -> str:
    """Return a sentence on the limits of all files, each in words."""
    common = [limit for limit in limits[0] if all(limit in others for others in limits)]
    if any(len(own) > len(common) for own in limits):
        words = [*common, "others that differ between files, on their pages"]
        return f"Limits: {', '.join(words)}."
    return f"Limits: {', '.join(common)}." if common else "No limits were asked for."


def limits_in_words(options: VerifyOptions) -> list[str]:
    """Return the limits that were asked for, in words."""
    given = (
        ("mean error at most", options.max_mean_error, "°"),
        ("95th percentile of the error at most", options.max_p95_error, "°"),
        ("gain at least", options.min_gain, "×"),
    )
    return [f"{words} {limit:g}{unit}" for words, limit, unit in given if limit is not None]
