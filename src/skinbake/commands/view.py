"""``skinbake view``, and the pages of ``skinbake verify --html``.

A page shows a file, baked in memory if it was not baked, and its figures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote

import numpy as np

from skinbake.choices import FrameChoice, Gradients, Neighbours, Scheme, Weighting, Weld
from skinbake.commands.render import small_pictures
from skinbake.commands.shown import baked_in_memory, holds_bake, spots_in_clips, tell_unplaced
from skinbake.commands.verify import verify_document
from skinbake.errors import InputError, Notice, Notices, SkinbakeError
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.files.urls import STDIO
from skinbake.files.writing import write_file, write_files
from skinbake.format.note import corrective_notes
from skinbake.format.strip import stripped
from skinbake.freshness.baked_views import BakedView, sound_views
from skinbake.freshness.corrective_freshness import PlayedCorrectives
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.glb import STDIN
from skinbake.gltf.reading.materials import tell_images_missing
from skinbake.gltf.reading.scenes import shown_by
from skinbake.gltf.writing.container import for_target
from skinbake.gltf.writing.output import plan_output, refuse_own_input
from skinbake.gltf.writing.packing import bytes_of_images, with_images_inside
from skinbake.gltf.writing.recode import Compression, recoded
from skinbake.measure.options import VerifyOptions
from skinbake.measure.scene import Scene
from skinbake.report.verify import (
    Entry,
    FileVerdict,
    Spot,
    Spots,
    baked_lighting,
    conclusion,
    file_json,
    first_problem,
    gain,
    remarks,
    shown,
)
from skinbake.timing import stage
from skinbake.view.index import Listed, pages, sheet
from skinbake.view.page import OtherGradients, page
from skinbake.view.texts import INFLUENCES
from skinbake.wording import counted

LARGE_PAGE = 50_000_000
"""The bytes of a page from which on a notice says so."""


@dataclass(frozen=True, slots=True)
class ViewResult:
    """The page of a file, and the assumptions made.

    was_baked: the file held a bake already. If not, it was baked in memory.
    """

    page: bytes
    was_baked: bool
    notices: tuple[Notice, ...] = ()


def view_file(source: str, target: str | None = None, bounds: Bounds = BESIDE) -> ViewResult:
    """Return the page that shows one file. Nothing is written.

    Raises InputError if the file cannot be read, or has nothing skinned that can be baked. Raises OutputError
    if ``target`` is a file of the document.
    """
    with stage("read"):
        document = read_document(source, bounds)
    if target is not None:
        refuse_own_input(document, source, target)
    corrected = document if PlayedCorrectives.sound(document) else None
    was_baked = bool(sound_views(document)) or corrected is not None
    notes: list[str] = []
    if not was_baked:
        before = "The bake of the file is damaged." if holds_bake(document) else "The file was not baked."
        if corrective_notes(document):
            before = LEFT_OUT
        notes = [f"{before} {IN_MEMORY}"]
    if corrected or not was_baked:
        document = baked_in_memory(document)
    verdict = verify_document(corrected or document, VerifyOptions(finds_places=True))
    told = tuple(document.notices)
    with document.notices.withheld() as missing:
        made = page_of(document, replace(verdict, notices=told), notes, corrected=corrected)
    return ViewResult(made, was_baked, (*missing, *told))


def page_of(
    document: Document,
    verdict: FileVerdict,
    notes: Sequence[str],
    limits: Sequence[str] | None = None,
    corrected: Document | None = None,
) -> bytes:
    """Return the page of a document that was verified; tell what is missing in it.

    limits are those that it was held to, in words; None if it was not. corrected is the same document with
    correctives, if it has any: they are shown beside the α and β that ``document`` holds.
    """
    with stage("other gradients"):
        views = sound_views(document)
        others = list(_other_gradients(document, views, is_shown=corrected is None))
        if corrected:
            others += [_with_influences(view, view.kind) for view in views]
            notes = [*notes, COMPARED]
    with stage("page"):
        # A GLB without compression that holds all, which browsers read.
        with document.notices.withheld():
            packed = for_target(recoded(corrected or document, [], Compression(Scheme.NONE)), STDIO)
        packed, lost = with_images_inside(packed)
        tell_images_missing(document, lost, "page")
        glb = list(plan_output(packed, STDIO).files.popitem()[1])
        size = sum(map(len, glb))
        document.budget.claim(Cost.PAGE_BYTE * size, f"a page of {counted(size, 'byte')}", document.place)
        for view in views:
            tell_unplaced(document, view, "page")
        most = max((4 * view.source.influence_sets for view in views), default=0)
        if most > max(INFLUENCES):
            message = (
                f"it has up to {most} influences for a vertex, and a page draws {max(INFLUENCES)}: the page "
                "has its figures only. Bake it with --limit-influences 8"
            )
            document.notices.tell(Notice("influences-not-drawn", message, document.place))
        told = [*notes, *remarks(verdict)]
        for notice in (*document.notices, *verdict.notices):
            where = notice.place.within_file
            told.append(f"{notice.message} ({where})" if where else notice.message)
        name = "stdin" if document.place.file == STDIN else PurePath(document.name).name
        findings = {
            **_findings(verdict),
            "notes": told,
            "limits": limits,
            **_places(document, views, corrected, verdict),
        }
        made = page(name, glb, others, findings)
        if len(made) > LARGE_PAGE:
            images = f"{bytes_of_images(packed) / 1e6:.0f} MB are images"
            message = (
                f"the page has {len(made) / 1e6:.0f} MB, because the model has {size / 1e6:.0f} MB, of which "
                f"{images}: show a copy with smaller images or fewer clips"
            )
            document.notices.tell(Notice("page-large", message, document.place, len(made)))
        return made


IN_MEMORY = "This page baked it in memory, with the defaults."
LEFT_OUT = "The correctives of the file are damaged. The page draws what α and β would give in place of them."
COMPARED = "The file has correctives. What α and β would give was baked in memory, with the defaults."


def _other_gradients(
    document: Document, views: Sequence[BakedView], *, is_shown: bool = True
) -> Iterator[OtherGradients]:
    """Yield α and β of the kind that the file does not hold, baked with the same settings otherwise.

    Yields nothing if they cannot be baked: without a rig there is one kind only. is_shown: the page has the
    influences of the document, and needs no equal ones.
    """
    if not views:
        return
    from skinbake.commands.bake import bake_document  # a file without a bake needs no other
    from skinbake.commands.bake_options import BakeOptions

    kind, noted = Gradients.FITTED, views[0].note
    if views[0].kind is not Gradients.SURFACE:
        kind = Gradients.SURFACE
    known = noted.neighbours
    options = BakeOptions(
        gradients=kind,
        weighting=Weighting(noted.weighting),
        crease_angle=noted.crease_angle,
        neighbours=Neighbours(known) if known in list(Neighbours) else Neighbours.ADOPT,
        frame=FrameChoice(noted.frame),
        weld=Weld(noted.weld),
        generate_normals=True,  # strip takes generated ones away
    )
    try:
        with document.notices.withheld():
            plain, _ = stripped(document)
            made = bake_document(plain, options)
        others = {view.source.place: view for view in sound_views(made.document)}
    except InputError:
        return
    for view in views:
        other = others.get(view.source.place)
        if other is None or other.kind is not kind or other.alpha.shape != view.alpha.shape:
            continue
        found = _with_influences(other, kind)
        same = is_shown and np.array_equal(other.now.joints, view.now.joints)
        yield found._replace(joints=None, weights=None) if same else found


def _with_influences(view: BakedView, kind: Gradients) -> OtherGradients:
    """Return α and β of a primitive for the page, with the influences that they belong to."""
    place = view.source.place
    return OtherGradients(
        kind=str(kind),
        mesh=place.mesh or 0,
        primitive=place.primitive or 0,
        frame=view.note.frame,
        alpha=view.alpha,
        beta=view.beta,
        joints=view.now.joints,
        weights=view.now.weights,
    )


def _places(
    document: Document, views: Sequence[BakedView], corrected: Document | None, verdict: FileVerdict
) -> dict[str, list[dict[str, Any]]]:
    """Return where the bake shows, and where it gets worse. The page opens on the first place."""
    try:
        correctives = PlayedCorrectives(corrected) if corrected else None
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = spots_in_clips(Scene(document, views, correctives), verdict.spots)
    except InputError:  # a part of it cannot be posed, as the figures say
        found = Spots()

    def listed(spots: Sequence[Spot]) -> list[dict[str, Any]]:
        return [
            {
                "clip": spot.number,
                "time": spot.time,
                "where": spot.where,
                "words": spot.words,
                "mesh": mesh,
                "primitive": spot.place.primitive,
                "skin": shown_by(document, spot.skin, [mesh]).get(mesh, spot.skin),
                "vertex": spot.vertex,
                "towards": spot.towards,
                "radius": spot.radius,
            }
            for spot in spots
            if spot.number is not None and (mesh := spot.place.mesh) is not None
        ]

    return {"places": listed(found.shows), "worse": listed(found.worse)}


def _findings(verdict: FileVerdict) -> dict[str, Any]:
    """Return the verdict in the members of verify's JSON, with problems as sentences."""
    told, judged = file_json(verdict), conclusion(verdict)
    checks = [
        {
            **check,
            "problems": [
                f"{where}: {problem.message}" if (where := problem.place.within_file) else problem.message
                for problem in own.problems
            ],
        }
        for check, own in zip(told["checks"], verdict.checks, strict=True)
    ]
    remark = judged.sentence.removeprefix(f"{judged.headline}: ") if judged else ""
    return {
        "verdict": judged
        and {
            "words": judged.headline,
            "remark": f"{remark[:1].upper()}{remark[1:]}",
            "isGood": judged.short == "clear gain",
        },
        "by_triangles": told["normals_by_triangles"],
        "by_tangents": told["normals_by_tangents"],
        "primitives": told["primitives"],
        "poses": told["poses"],
        "outcome": verdict.outcome,
        "checks": checks,
    }


def _page(
    source: str, verdict: FileVerdict, options: VerifyOptions, bounds: Bounds
) -> tuple[bytes, FileVerdict, Document, Document | None]:
    """Return the page of a file that was verified, the verdict on it, and what it shows as ``page_of`` does.

    A file without a bake is baked in memory, and its verdict has the figures of that bake.
    """
    document, notes = read_document(source, bounds), list[str]()
    failed = {check.name for check in verdict.checks if check.outcome == "failed"}
    if not verdict.by_truth and failed <= {"limits"} and not holds_bake(document):
        try:
            with document.notices.withheld():
                document = baked_in_memory(document)
        except InputError:
            pass  # nothing in it can be baked: its page shows it as it is
        else:
            measured = verify_document(document, VerifyOptions(finds_places=True))
            kept = {
                name: getattr(verdict, name) for name in ("input", "checks", "command", "notices", "left")
            }
            before = "A bake has left the file as it is." if verdict.left else "The file was not baked."
            verdict, notes = replace(measured, **kept), [f"{before} {IN_MEMORY}"]
    corrected = None
    if corrective_notes(document):
        corrected = document if PlayedCorrectives.sound(document) else None
        notes += [] if corrected else [LEFT_OUT]
        with document.notices.withheld():
            document = baked_in_memory(document)
    page = page_of(document, verdict, notes, limits_in_words(options), corrected)
    return page, verdict, document, corrected


def entry_of(
    verdict: FileVerdict, options: VerifyOptions, path: Path, bounds: Bounds, *, sync: bool = True
) -> Entry:
    """Write the page of a file that was verified, and return what a sheet shows of it, or why it cannot."""
    try:
        page, verdict, document, corrected = _page(verdict.input, verdict, options, bounds)
        pictures = tuple(small_pictures(document, corrected, verdict.spots))
        write_files(path.parent, {path: [page]}, str(path), sync=sync)
        size = sum(
            document.asset.accessors[accessor].described(view.source.place)[1]
            for view in ([] if corrected else sound_views(document))
            for name in view.note.slot_names
            if (accessor := document.asset.accessor_of(view.source, name)) is not None
        )
        return Entry(verdict, pictures, size or None, tuple(document.notices))
    except SkinbakeError as error:
        return Entry(verdict, error=error)


def write_report(
    verdicts: Sequence[FileVerdict],
    options: Mapping[str, VerifyOptions],
    target: str,
    bounds: Callable[[str], Bounds],
    notices: Notices,
    *,
    command: str = "verify",
    sync: bool = True,
) -> tuple[Path | None, list[SkinbakeError]]:
    """Write the page of one verdict, or a sheet and the pages of several in a folder of its name.

    ``options`` belong to each input. ``bounds`` gives the folders in which the document of an input may
    name files. A file that cannot be read, or was not verified again, has no page. The sheet tells the limits
    that are the same for all, and that there are others. Return the folder of the pages, None if there is
    none, and the errors of single pages, which the sheet goes without. ``notices`` are told what pages lack.
    Raises SkinbakeError if the page of a single verdict, or the sheet, cannot be written.
    """
    if len(verdicts) == 1 and verdicts[0].error is None and not verdicts[0].up_to_date:
        source = verdicts[0].input
        page, _, document, _ = _page(source, verdicts[0], options[source], bounds(source))
        notices.tell(*document.notices)
        write_file([page], target, sync=sync)
        return None, []
    listed, folder, failed = list[Listed](), None, list[SkinbakeError]()
    for verdict, path in zip(verdicts, pages(target, [one.input for one in verdicts]), strict=True):
        entry, source = verdict.entry, verdict.input
        link: str | None = None
        if entry is None and verdict.error is None and not verdict.up_to_date:
            entry = entry_of(verdict, options[source], path, bounds(source), sync=sync)
        if entry is not None and entry.error is not None:
            failed.append(entry.error)
        elif entry is not None:
            folder, link = path.parent, f"{quote(path.parent.name)}/{path.name}"
            notices.tell(*entry.notices)
        listed.append(_listed(verdict, link, entry or Entry(verdict)))
    # A sentence on the limits of all files.
    limits = [limits_in_words(options[verdict.input]) for verdict in verdicts]
    common = [limit for limit in limits[0] if all(limit in others for others in limits)]
    if any(len(own) > len(common) for own in limits):
        common.append("others that differ between files, on their pages")
    sentence = f"Limits: {', '.join(common)}." if common else "No limits were asked for."
    write_file([sheet(listed, "" if command == "view" else sentence, command)], target, sync=sync)
    return folder, failed


def _listed(verdict: FileVerdict, link: str | None, entry: Entry) -> Listed:
    """Return the row of a file in the sheet, with why it failed, or why it has no figures."""
    figures = found.figures if (found := shown(entry.verdict)) else {}
    judged = conclusion(entry.verdict)
    skipped = [check.remark for check in verdict.checks if check.outcome == "skipped"]
    if verdict.error is not None:
        where = verdict.error.place.within_file if verdict.error.place else ""
        remark = f"{where}: {verdict.error.message}" if where else verdict.error.message
    elif verdict.up_to_date:
        remark = "before, up to date"  # after the outcome: passed
    elif not verdict.passed:
        remark = first_problem(verdict)
    else:
        remark = "" if verdict.found_no_bake else "; ".join(skipped)
    return Listed(
        name=verdict.input,
        link=link,
        pictures=entry.pictures,
        outcome=verdict.outcome,
        remark=remark,
        verdict=judged.short if judged else "",
        step=judged.step if judged else "",
        standard=figures["standard"].mean if figures else None,
        accurate=figures[baked_lighting(figures)].mean if figures else None,
        gain=gain(figures) if figures else None,
        byte_length=entry.byte_length,
    )


def limits_in_words(options: VerifyOptions) -> list[str]:
    """Return the limits that were asked for, in words."""
    words = {
        "--max-mean-error": "mean error at most {:g}°",
        "--max-p95-error": "95th percentile of the error at most {:g}°",
        "--min-gain": "gain at least {:g}×",
    }
    return [words[option].format(limit) for option, limit in options.limits.items()]
