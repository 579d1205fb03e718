"""``skinbake verify``: whether a file still has the right α/β, and how much they improve its lighting."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from time import perf_counter

from skinbake.commands.remedies import tell_worse_lighting
from skinbake.errors import Notice, Skipped, warnings_in
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.format.note import corrective_notes, file_left, gradient_note
from skinbake.freshness.baked_views import baked_views, gathered_together, is_baked, left_on_purpose
from skinbake.freshness.staleness import (
    claim_freshness,
    fits_begun,
    freshness_check,
    made_states,
    surface_operator,
)
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.meshes import reason_to_skip, skinned_sources, tell_half_skinned
from skinbake.gradients.influences import weight_sum_notices
from skinbake.gradients.normals import lean_notices
from skinbake.measure.measured import Measurement
from skinbake.measure.options import VerifyOptions
from skinbake.measure.scene import Scene
from skinbake.report.verify import Check, FileVerdict, leaves_room
from skinbake.threads import Threads, thread_count
from skinbake.timing import stage
from skinbake.wording import counted


def verify_file(source: str, options: VerifyOptions, bounds: Bounds = BESIDE) -> FileVerdict:
    """Verify one file. Raises SkinbakeError if it cannot be read."""
    with stage("read"):
        document = read_document(source, bounds)
    verdict = verify_document(document, options, looks_further=True)
    verdict = replace(verdict, input=source, notices=tuple(document.notices))
    if options.warnings_as_errors and (warned := warnings_in(verdict.notices)):
        problem = Check("warnings", "failed", tuple(warned))
        return replace(verdict, checks=(*verdict.checks, problem))
    return verdict


def verify_document(
    document: Document, options: VerifyOptions, *, looks_further: bool = False
) -> FileVerdict:
    """Verify a document, as it is in memory. Its notices are told, and not in the verdict.

    looks_further: where it gains little, other bakes are tried. Raises InputError if a part of it cannot be
    read.
    """
    if corrective_notes(document):
        from skinbake.commands.verify_correctives import corrected_verdict  # most files have α and β

        return _beside_others(document, corrected_verdict(document, options), options, looks_further)
    begun = perf_counter()
    wanted: list[PrimitiveSource] = []
    with document.notices.withheld() as left_out, stage("read"):
        tell_half_skinned(document)
        left = left_on_purpose(document)
        for source in skinned_sources(document):
            if source.place in left:
                continue
            reason = reason_to_skip(document, source, generate_normals=False)
            if reason is None:
                wanted.append(source)
            else:
                document.notices.tell(reason)
        stale = [state.notice for state in made_states(document) if state.changed]
    lost = _lost(document, left_out)
    told, problems = [notice for notice in left_out if notice not in lost], [*lost.values()]
    if not problems and not any(is_baked(document, entry) for entry in wanted):
        return _unbaked(document, options, [*told, *stale], wanted)
    document.notices.tell(*told)
    claim_freshness(document, len(wanted))
    with document.notices.withheld() as damaged, stage("read"):
        views = baked_views(document, wanted)
    problems += damaged
    if problems:
        return FileVerdict.damaged(document.name, problems)
    vertices = counted(sum(len(view.now.positions) for view in views), "vertex", "vertices")
    found = [f"{counted(len(views), 'baked primitive')}, {vertices}", *left.values()]
    structure, begun = (
        Check("structure", "passed", (), "; ".join(found), perf_counter() - begun),
        perf_counter(),
    )
    for view in views:
        document.notices.tell(*weight_sum_notices(view.now, view.source.place))
    document.notices.tell(*lean_notices((view.now, view.source.place) for view in views))
    # Whether a bake of the file as it is now would light it in the same way.
    surfaces = gathered_together(document, views)
    with Threads(thread_count()) as threads:
        with stage("freshness"):
            fits = fits_begun(document, surfaces, threads)
        with stage("gradient operator"):
            operators = [surface_operator(document, surface) for surface in surfaces]
        with stage("freshness"):
            fresh = freshness_check(document, surfaces, operators, fits)
    if stale:
        fresh = replace(fresh, outcome="failed", problems=(*fresh.problems, *stale), remark="")
    fresh, begun = replace(fresh, seconds=perf_counter() - begun), perf_counter()
    # How it is lit, and whether another bake would light it better, which is told first.
    with document.notices.withheld() as of_lighting:
        verdict = Measurement(Scene.of_bakes(document, views, operators), options).verdict()
    if fresh.outcome == "passed":
        verdict = _beside_others(document, verdict, options, looks_further)
        tell_worse_lighting(document, views, verdict, options.methods or ("lbs", "blend"))
    document.notices.tell(*of_lighting)
    # The first check of the lighting stands for the measurement.
    first = (replace(check, seconds=perf_counter() - begun) for check in verdict.checks[:1])
    return replace(verdict, checks=(structure, fresh, *first, *verdict.checks[1:]))


def _lost(document: Document, left_out: Iterable[Notice]) -> dict[Notice, Notice]:
    """Return problems in place of notices: what is baked can no longer be, although light reaches it."""
    found: dict[Notice, Notice] = {}
    for notice in left_out:
        if isinstance(notice, Skipped) and notice.code not in {"no-skin", "unlit"}:
            mesh = document.asset.meshes[notice.place.mesh or 0]
            if gradient_note(document, mesh.primitives[notice.place.primitive or 0]) is not None:
                lost = f"it is baked, but it has lost data that α/β need ({notice.reason})"
                found[notice] = Notice(notice.code, f"{lost}: run skinbake bake", notice.place)
    return found


def _beside_others(
    document: Document, verdict: FileVerdict, options: VerifyOptions, looks_further: bool
) -> FileVerdict:
    """Return a verdict with the bakes that are better, if any are looked for."""
    if not looks_further or not leaves_room(verdict):
        return verdict
    from skinbake.commands.other_bakes import other_bakes  # most files gain enough

    return replace(verdict, others=other_bakes(document, verdict, options))


def _unbaked(
    document: Document, options: VerifyOptions, notices: list[Notice], wanted: Sequence[PrimitiveSource]
) -> FileVerdict:
    """Return the verdict for a file without a bake. Limits are for those that draw a skinned surface."""
    unlit = not wanted and any(notice.code == "unlit" for notice in notices)
    nothing = "nothing that light reaches is baked in it" if unlit else "nothing in it is baked"
    missing = Notice("not-baked", nothing, document.place)
    command = "skinbake bake" if wanted else ""
    if not wanted and any(notice.code == "no-normals" for notice in notices):
        command = "skinbake bake --generate-normals"
    left = file_left(document)
    if left is not None and command:
        # Bake has left it on purpose: it passes, whatever limits there are. What has no NORMAL was left, too,
        # by a bake that generates them.
        found = [] if left.gain is None else [f"gain {left.gain:.15g}"]
        found += [] if left.standard_error is None else [f"standard lighting {left.standard_error:.15g}° off"]
        still = "standard lighting is better" if left.by else "little to win"
        remark = f"left unbaked by bake {left.by or '--leave-under'}: {', '.join(found) or still}"
        check = Check("structure", "skipped", (), remark)
        document.notices.tell(*(notice for notice in notices if notice.code != "no-normals"))
        return FileVerdict(document.name, (check,), left=True)
    document.notices.tell(*notices)
    if options.require_baked:
        advice = (
            f"run {command}" if command else "nothing in it can be baked; --require-baked is for characters"
        )
        problem = replace(missing, message=f"{nothing}: {advice}")
        return FileVerdict(document.name, (Check("structure", "failed", (problem,)),))
    check = Check("structure", "skipped", (), nothing)
    if options.limits and command:
        limits = " and ".join(options.limits)
        message = f"it is not baked, so it cannot meet {limits}: run {command} first"
        failed = Check("limits", "failed", (replace(missing, message=message),), message)
        return FileVerdict(document.name, (check, failed))
    document.notices.tell(missing)
    return FileVerdict(document.name, (check,), command=command)
