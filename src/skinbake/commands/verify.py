"""``skinbake verify``: whether a file still has the right α/β, and how much they improve its lighting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from skinbake.commands.remedies import worse_lighting
from skinbake.errors import Notice, Skipped, warnings_in
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.format.note import Left, corrective_notes, file_left, gradient_note
from skinbake.freshness.baked_views import BakedView, baked_views, gathered_together, is_baked
from skinbake.freshness.made_targets import made_states
from skinbake.freshness.staleness import claim_freshness, fits_begun, freshness_check, surface_operator
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
from skinbake.truth.operator import GradientOperator
from skinbake.wording import counted


def verify_file(source: str, options: VerifyOptions, bounds: Bounds = BESIDE) -> FileVerdict:
    """Verify one file. Raises SkinbakeError if it cannot be read."""
    with stage("read"):
        document = read_document(source, bounds)
    verdict = replace(verify_document(document, options, looks_further=True), input=source)
    if options.warnings_as_errors and (warned := warnings_in(verdict.notices)):
        problem = Check("warnings", "failed", tuple(warned))
        return replace(verdict, checks=(*verdict.checks, problem))
    return verdict


def verify_document(
    document: Document, options: VerifyOptions, *, looks_further: bool = False
) -> FileVerdict:
    """Verify a document, as it is in memory. Raises InputError if a part of it cannot be read.

    looks_further: where it gains little, other bakes are tried.
    """
    if corrective_notes(document):
        from skinbake.commands.verify_correctives import corrected_verdict  # most files have α and β

        return _beside_others(document, corrected_verdict(document, options), options, looks_further)
    with stage("read"):
        wanted, lost, notices = _sorted_out(document)
        stale = [state.notice for state in made_states(document) if state.changed]
    if not lost and not any(is_baked(document, entry) for entry in wanted):
        notices += stale
        return _unbaked(document, options, notices, wanted)
    claim_freshness(document, len(wanted))
    with document.notices.withheld() as damaged, stage("read"):
        views = baked_views(document, wanted)
    problems = [*lost, *damaged]
    if problems:
        structure = Check("structure", "failed", tuple(problems))
        rest = [Check(name, "skipped", (), "structure failed") for name in ("freshness", "lighting")]
        return FileVerdict(document.name, (structure, *rest), notices=tuple(notices))
    structure = Check("structure", "passed", (), _counted(views))
    for view in views:
        notices += weight_sum_notices(view.now, view.source.place)
    notices += lean_notices((view.now, view.source.place) for view in views)
    surfaces = gathered_together(document, views)
    operators, fresh = _operators_and_freshness(document, surfaces)
    if stale:
        fresh = replace(fresh, outcome="failed", problems=(*fresh.problems, *stale), remark="")
    verdict = Measurement(Scene.of_bakes(document, views, operators), options).verdict()
    if fresh.outcome == "passed":
        verdict = _beside_others(document, verdict, options, looks_further)
        notices += worse_lighting(views, verdict, options.methods or ("lbs", "blend"))
    checks = (structure, fresh, *verdict.checks)
    return replace(verdict, checks=checks, notices=(*notices, *verdict.notices))


def _beside_others(
    document: Document, verdict: FileVerdict, options: VerifyOptions, looks_further: bool
) -> FileVerdict:
    """Return a verdict with the bakes that are better, if any are looked for."""
    if not looks_further or not leaves_room(verdict):
        return verdict
    from skinbake.commands.other_bakes import other_bakes  # most files gain enough

    return replace(verdict, others=other_bakes(document, verdict, options))


def _operators_and_freshness(
    document: Document, surfaces: Sequence[Sequence[BakedView]]
) -> tuple[list[GradientOperator], Check]:
    with Threads(thread_count()) as threads:
        with stage("freshness"):
            fits = fits_begun(document, surfaces, threads)
        with stage("gradient operator"):
            operators = [surface_operator(document, surface) for surface in surfaces]
        with stage("freshness"):
            return operators, freshness_check(document, surfaces, operators, fits)


def _sorted_out(document: Document) -> tuple[list[PrimitiveSource], list[Notice], list[Notice]]:
    """Return the skinned primitives that can be baked, problems, and notices on the primitives left out.

    A primitive that is baked, but can no longer be baked, is a problem, unless no light reaches it.
    """
    with document.notices.withheld() as half_skinned:
        tell_half_skinned(document)
    notices = list(half_skinned)
    wanted: list[PrimitiveSource] = []
    unread = [notice for notice in notices if isinstance(notice, Skipped) and notice.code == "no-joints"]
    for entry in skinned_sources(document):
        reason = reason_to_skip(document, entry, generate_normals=False)
        if reason is None:
            wanted.append(entry)
        else:
            notices.append(reason)
            unread += [] if reason.code == "unlit" else [reason]
    lost = [_lost(notice) for notice in unread if _has_metadata(document, notice)]
    baked_ones = {(notice.code, notice.place) for notice in lost}
    return wanted, lost, [notice for notice in notices if (notice.code, notice.place) not in baked_ones]


def _has_metadata(document: Document, notice: Notice) -> bool:
    mesh, primitive = notice.place.mesh, notice.place.primitive
    if mesh is None or primitive is None:
        return False
    found = document.asset.meshes[mesh].primitives[primitive]
    return gradient_note(document, found.json) is not None


def _lost(notice: Skipped) -> Notice:
    message = f"it is baked, but it has lost data that α/β need ({notice.reason}): run skinbake bake"
    return Notice(notice.code, message, notice.place)


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
    if left is not None and command:  # what has no NORMAL was left, too, by a bake that generates them
        return _left(document, left, [notice for notice in notices if notice.code != "no-normals"])
    if options.require_baked:
        advice = (
            f"run {command}" if command else "nothing in it can be baked; --require-baked is for characters"
        )
        problem = replace(missing, message=f"{nothing}: {advice}")
        return FileVerdict(document.name, (Check("structure", "failed", (problem,)),), notices=tuple(notices))
    check = Check("structure", "skipped", (), nothing)
    if options.limits and command:
        limits = " and ".join(options.limits)
        message = f"it is not baked, so it cannot meet {limits}: run {command} first"
        failed = Check("limits", "failed", (replace(missing, message=message),), message)
        return FileVerdict(document.name, (check, failed), notices=tuple(notices))
    return FileVerdict(document.name, (check,), notices=(*notices, missing), command=command)


def _left(document: Document, left: Left, notices: list[Notice]) -> FileVerdict:
    """Return the verdict for a file that bake has left on purpose. It passes, whatever limits there are."""
    found = [] if left.gain is None else [f"gain {left.gain:.15g}"]
    found += [] if left.standard_error is None else [f"standard lighting {left.standard_error:.15g}° off"]
    remark = f"left unbaked by bake --leave-under: {', '.join(found) or 'little to win'}"
    check = Check("structure", "skipped", (), remark)
    return FileVerdict(document.name, (check,), notices=tuple(notices), left=True)


def _counted(views: Sequence[BakedView]) -> str:
    vertices = sum(len(view.now.positions) for view in views)
    return f"{counted(len(views), 'baked primitive')}, {counted(vertices, 'vertex', 'vertices')}"
