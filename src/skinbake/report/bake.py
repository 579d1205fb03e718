"""The result of bake for each file, as a closing line and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from skinbake.choices import READERS_OF_FOUR
from skinbake.errors import Notice, Place, SkinbakeError, printable, warnings_in
from skinbake.report.totals import (
    error_fields,
    notice_list,
    place_fields,
    timing_fields,
)
from skinbake.wording import counted, gain_in_words, percent

SCHEMA = "skinbake.bake/1"
OUTCOMES = ("baked", "left", "unchanged", "up-to-date", "failed")

SHOWN_LOSS = 0.0005
"""The share of the gradient from which a short line tells its loss."""

BAD_LOSS = 0.05
"""The share of the gradient from which its loss is bad, as the pages tell users."""

SEEN = 0.0001
"""Below this angle in degrees, the exact value does not matter."""

Status = Literal["baked", "left", "unchanged", "up-to-date", "failed"]
"""``left``: left unbaked, with a note, because there is little or nothing to win.

``unchanged``: passed through, because nothing in it can be baked.

``up-to-date``: not baked again, because the result would be the same.
"""


class LimitCost(NamedTuple):
    """The cost of fewer influences for a primitive.

    influences is the new number for each vertex. vertices is the number of vertices that lost some. left_out
    is the lost share of their weight, on average.
    """

    influences: int
    vertices: int
    left_out: float


class ExtensionCost(NamedTuple):
    """The influence set that --neighbours extend adds to a primitive, and its price.

    vertices needed it. bytes are those of joints, weights, α and β more at each vertex, multiply_adds those
    of algorithm 3.
    """

    influences: int
    vertices: int
    bytes: int
    multiply_adds: int


class BakedCounts(NamedTuple):
    """The bake of one primitive, in numbers.

    gradients is the kind of α and β. adopting_vertices took joints of their neighbours into free slots.
    overflowing_vertices had more such joints than free slots. gradient is the summed length of the weight
    gradients, in 1 / length unit, and lost_gradient the share of it that no slot holds. added_bytes is the
    growth of the file by the primitive, bytes_per_vertex the size of α and β for a vertex. limited is the
    effect of --limit-influences, extended that of --neighbours extend. kept is the part of α and β that is
    kept, from 0 to 1, None for all.
    """

    vertices: int
    triangles: int
    degenerate_triangles: int
    influences: int
    gradients: str
    frame: str
    generated_normals: bool
    adopting_vertices: int
    overflowing_vertices: int
    gradient: float
    lost_gradient: float
    added_bytes: int
    bytes_per_vertex: int
    limited: LimitCost | None = None
    extended: ExtensionCost | None = None
    kept: float | None = None


class CorrectiveCounts(NamedTuple):
    """The correctives of one mesh, in numbers.

    corrected are the vertices that have targets, given_up those whose targets did not help. keys are those of
    the weights in all clips. idle_clips are clips with the weights 0, because correctives do not help there.
    left is the share of the squared changes that the targets leave. standard and remaining are mean errors in
    degrees by truth, as verify measures them.
    """

    targets: int
    vertices: int
    corrected: int
    given_up: int
    keys: int
    clips: tuple[str, ...]
    idle_clips: tuple[str, ...]
    left: float
    standard: dict[str, float]
    remaining: dict[str, float]
    added_bytes: int


class MorphCounts(NamedTuple):
    """What bake has made for the targets of one primitive, in numbers.

    normals is the number of targets that got NORMAL. frames is how many numbers of the differential each
    target got: 6, 4 or 0. mean and max are the degrees by which the made NORMAL turns normals at weight 1,
    over the vertices where it turns any.
    """

    targets: int
    normals: int
    frames: int
    mean: float
    max: float
    added_bytes: int = 0


class EncodingCost(NamedTuple):
    """The encoding of α and β, and the angle by which it turns accurate normals, weighted by area.

    The degrees are None for float32, which is the reference of the others, and if no normal is known.
    """

    name: str
    mean: float | None = None
    p99: float | None = None


class Left(NamedTuple):
    """Why a bake has left a file unbaked: by --leave-under, or as the fit lights nothing in it better.

    gain is the lower one, None where accurate lighting is exact, or where there is no bake. standard_error is
    the mean of standard lighting in degrees. under is the gain that was asked for. Both are None without
    --leave-under. reason is what the numbers do not say, perhaps nothing.
    """

    gain: float | None = None
    standard_error: float | None = None
    under: float | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class FileResult:
    """The result of one input.

    output is None if nothing was to be written. skipped counts the skinned primitives that were left out.
    error is the reason of a failure. encoding is the encoding of α and β (None if nothing was baked). written
    has digests of the written files, by path, if they were requested. record is the entry for a state file.
    timings are seconds by stage, None if they were not requested. read are the paths of the files beside the
    input that were read, if they were requested. left is the reason of the status ``left``. lighting are the
    mean errors in degrees by truth, without and with correctives, as verify measures them; empty without.
    """

    input: str
    output: str | None
    status: Status
    primitives: tuple[tuple[Place, BakedCounts], ...] = ()
    skipped: int = 0
    notices: tuple[Notice, ...] = ()
    error: SkinbakeError | None = None
    encoding: EncodingCost | None = None
    correctives: tuple[tuple[Place, CorrectiveCounts], ...] = ()
    lighting: tuple[tuple[str, float, float], ...] = ()
    morphs: tuple[tuple[Place, MorphCounts], ...] = ()
    written: dict[str, str] | None = None
    record: bytes | None = None
    timings: dict[str, float] | None = None
    read: tuple[str, ...] = ()
    left: Left | None = None


def short_line(result: FileResult, *, dry_run: bool) -> str:
    """Return the line of one file among many: what is missing from it is in ``closing_line``."""
    counts = [count for _, count in result.primitives]
    if result.correctives:
        parts = [f"baked: {_corrected(result)}"]
        parts += _warned(result)
        return f"{_names(result, dry_run=dry_run)}: {', '.join(parts)}"
    if not counts:
        return closing_line(result, dry_run=dry_run)
    size = counted(sum(count.added_bytes for count in counts), "byte")
    parts = [f"baked: {counted(len(counts), 'primitive')}, {size} added"]
    parts += _morphs([count for _, count in result.morphs])
    parts += [f"{result.skipped:,} skipped"] if result.skipped else []
    parts += [_limited(costs)] if (costs := [count.limited for count in counts if count.limited]) else []
    lost = _lost(counts)
    parts += [f"{percent(lost, 1)} of the gradient left out{_remedy(counts)}"] if lost >= SHOWN_LOSS else []
    parts += _warned(result)
    return f"{_names(result, dry_run=dry_run)}: {', '.join(parts)}"


def _warned(result: FileResult) -> list[str]:
    """Return the number of warnings, if there are any. Advice is none."""
    found = warnings_in(result.notices)
    return [counted(len(found), "warning")] if found else []


def _names(result: FileResult, *, dry_run: bool) -> str:
    """Return the names of the input and of the output."""
    name = printable(result.input)
    if dry_run:
        return f"{name} (dry run)"
    return name if result.output in {None, result.input} else f"{name} -> {printable(str(result.output))}"


def closing_line(result: FileResult, *, dry_run: bool) -> str:
    """Return one line with the numbers of baked, skipped and assumed things."""
    names = _names(result, dry_run=dry_run)
    if result.status == "up-to-date":
        return f"{names}: up to date"
    if result.left is not None:
        left = result.left
        lower = "by the lower of two measurements"
        found = [] if left.gain is None else [f"gain {gain_in_words(left.gain)}x {lower}"]
        if left.standard_error is not None and (found or not left.reason):
            found.append(f"standard lighting {left.standard_error:.2f}° off")
        return f"{names}: left unbaked: {', '.join([*found, *([left.reason] if left.reason else [])])}"
    counts = [count for _, count in result.primitives]
    parts = [f"{result.status}: {_baked(counts)}" if counts else result.status]
    if result.correctives:
        parts = [f"{result.status}: {_corrected(result)}"]
        parts.append("played by clips alone: poses by IK or physics keep the last correction")
    parts += _encoding_text(result.encoding, counts)
    parts += _morphs([count for _, count in result.morphs])
    if result.skipped:
        parts.append(f"{counted(result.skipped, 'skinned primitive')} skipped")
    if counts and not any(count.gradient for count in counts):
        parts.append("no weight changes along the surface, so all α/β are 0: only uneven scale gains")
    costs = [count.limited for count in counts if count.limited]
    if costs:
        parts.append(_limited(costs))
    further = [count.extended for count in counts if count.extended]
    if further:
        parts.append(_extended(further))
    adopting = sum(count.adopting_vertices for count in counts)
    if adopting:
        parts.append(f"{counted(adopting, 'vertex', 'vertices')} adopted joints")
    overflowing = sum(count.overflowing_vertices for count in counts)
    if overflowing:
        parts.append(
            f"{counted(overflowing, 'vertex', 'vertices')} left out some joints of their neighbours "
            f"({percent(_lost(counts), 2)} of the gradient{_remedy(counts)})"
        )
    if kept := sum(count.kept is not None for count in counts):
        they = "it" if kept == 1 else "them"
        parts.append(f"{counted(kept, 'primitive')} held back (all of α/β would light {they} worse)")
    degenerate = sum(count.degenerate_triangles for count in counts)
    if degenerate:
        parts.append(f"{counted(degenerate, 'triangle')} without area ignored")
    parts += _warned(result)
    return f"{names}: {', '.join(parts)}"


def detail_lines(result: FileResult) -> Iterator[str]:
    """Yield a line for each baked primitive or corrected mesh, for ``--verbose``."""
    for place, one in result.correctives:
        idle = f", weights 0 in {', '.join(map(printable, one.idle_clips))}" if one.idle_clips else ""
        yield (
            f"{place}: {counted(one.targets, 'target')} for {one.corrected:,} of "
            f"{counted(one.vertices, 'vertex', 'vertices')}, {one.given_up:,} given up, "
            f"{counted(one.keys, 'key')} in {counted(len(one.clips), 'clip')}{idle}, "
            f"{counted(one.added_bytes, 'byte')}"
        )
    for place, found in result.morphs:
        mean, most = _degrees(found.mean), _degrees(found.max)
        yield (
            f"{place}: {counted(found.targets, 'morph target')}, NORMAL made for {found.normals:,}, which "
            f"turns normals by {mean} in the mean and up to {most} at weight 1, "
            f"{found.frames} numbers of the differential for each, {counted(found.added_bytes, 'byte')}"
        )
    for place, count in result.primitives:
        lost = percent(count.lost_gradient, 2)
        kept = "" if count.kept is None else f", keeping {percent(count.kept, 1)} of α/β"
        yield (
            f"{place}: {counted(count.vertices, 'vertex', 'vertices')}, "
            f"{counted(count.triangles, 'triangle')}, {counted(count.influences, 'slot')}, "
            f"frame from {count.frame}, "
            f"{counted(count.adopting_vertices, 'vertex', 'vertices')} adopting, "
            f"{count.overflowing_vertices:,} leaving joints out ({lost} of the gradient), "
            f"{counted(count.added_bytes, 'byte')}{kept}"
        )


def _corrected(result: FileResult) -> str:
    """Return the numbers of the correctives of all meshes, and the mean errors of the file."""
    counts = [count for _, count in result.correctives]
    vertices = sum(count.vertices for count in counts)
    targets = " or ".join(str(number) for number in sorted({count.targets for count in counts}))
    clips = len({clip for count in counts for clip in count.clips})
    changes = [f"{before:.2f}° -> {after:.2f}° by {truth}" for truth, before, after in result.lighting]
    where = f"in {counted(clips, 'clip')}" if clips else "for clips of other files"
    size = sum(count.added_bytes for count in counts)
    meshes = f" on each of {counted(len(counts), 'mesh', 'meshes')}" if len(counts) > 1 else ""
    plural = "" if targets == "1" else "s"
    return (
        f"{targets} corrective normal{plural}{meshes} {where}, {', '.join(changes)}, "
        f"{counted(size, 'byte')} added ({size / vertices:.1f} a vertex)"
    )


def _morphs(counts: Sequence[MorphCounts]) -> Iterator[str]:
    """Yield what morph targets have got, and what it costs."""
    normals = sum(count.normals for count in counts)
    frames = [count for count in counts if count.frames]
    primitives = counted(len(counts), "primitive")
    made = [f"NORMAL made for {counted(normals, 'morph target')} of {primitives}"] if normals else []
    if frames:
        numbers = " or ".join(str(one) for one in sorted({count.frames for count in frames}))
        targets = counted(sum(count.targets for count in frames), "morph target")
        made.append(f"{numbers} numbers of the differential for {targets}")
    if made:
        yield f"{' and '.join(made)} ({counted(sum(count.added_bytes for count in counts), 'byte')})"


def _baked(counts: Sequence[BakedCounts]) -> str:
    vertices = sum(count.vertices for count in counts)
    size = sum(count.added_bytes for count in counts)
    frames = " and ".join(sorted({count.frame for count in counts}))
    return (
        f"{counted(len(counts), 'primitive')}, {counted(vertices, 'vertex', 'vertices')}, "
        f"frame from {frames}, {counted(size, 'byte')} added"
    )


def _encoding_text(encoding: EncodingCost | None, counts: Sequence[BakedCounts]) -> Iterator[str]:
    """Yield the size and the cost of an encoding other than float32."""
    if encoding is None or encoding.name == "float32":
        return
    sizes = " or ".join(str(size) for size in sorted({count.bytes_per_vertex for count in counts}))
    yield f"{encoding.name} at {sizes} bytes a vertex"
    if encoding.mean is not None:
        mean, p99 = _degrees(encoding.mean), _degrees(encoding.p99 or 0.0)
        yield f"which turns normals by {mean} on average and {p99} at the 99th percentile"


def _degrees(angle: float) -> str:
    if 0.0 < angle < SEEN:
        return f"under {SEEN}°"
    return f"{angle:.2g}°" if angle < 99.5 else f"{angle:.0f}°"  # 1.2e+02


def _limited(costs: Sequence[LimitCost]) -> str:
    """Return the weight that a limit of influences has taken."""
    vertices = sum(cost.vertices for cost in costs)
    left_out = sum(cost.left_out * cost.vertices for cost in costs) / max(vertices, 1)
    lost = f"{counted(vertices, 'vertex', 'vertices')} lost {percent(left_out, 2)} of their weight"
    return f"limited to {costs[0].influences} influences: {lost if vertices else 'no weight lost'}"


def _extended(costs: Sequence[ExtensionCost]) -> str:
    """Return the price of further influence sets, of the dearest primitive."""
    size, work = max(cost.bytes for cost in costs), max(cost.multiply_adds for cost in costs)
    vertices = counted(sum(cost.vertices for cost in costs), "vertex", "vertices")
    return (
        f"an influence set added to {counted(len(costs), 'primitive')} for {vertices} "
        f"(+{size} bytes and +{work} multiply-adds a vertex; {READERS_OF_FOUR} read four influences only)"
    )


def _lost(counts: Sequence[BakedCounts]) -> float:
    """Return the lost share of all gradients of all primitives together."""
    whole = sum(count.gradient for count in counts)
    return sum(count.lost_gradient * count.gradient for count in counts) / whole if whole else 0.0


def _remedy(counts: Sequence[BakedCounts]) -> str:
    """Return the option that may help if much of the gradient is left out, unless the bake has used it."""
    if _lost(counts) < BAD_LOSS or any(count.extended for count in counts):
        return ""
    if any(count.limited for count in counts):
        return "; try a larger --limit-influences"
    return f"; try --neighbours extend, but {READERS_OF_FOUR} read four influences only"


def file_json(result: FileResult) -> dict[str, Any]:
    """Return the result of one file as a JSON object; docs/reference/json.md documents its members."""
    return {
        "input": result.input,
        "output": result.output,
        "status": result.status,
        "skipped": result.skipped,
        "primitives": [{**place_fields(place), **_as_object(counts)} for place, counts in result.primitives],
        "correctives": [{**place_fields(place), **_as_object(one)} for place, one in result.correctives],
        "morphs": [{**place_fields(place), **_as_object(one)} for place, one in result.morphs],
        "warnings": notice_list(result.notices),
        "encoding": None
        if (encoding := result.encoding) is None
        else {
            "name": encoding.name,
            "added_error": None if encoding.mean is None else {"mean": encoding.mean, "p99": encoding.p99},
        },
        "left": None if result.left is None else _as_object(result.left),
        "error": error_fields(result.error),
        **timing_fields(result.timings),
    }


def _as_object(record: Any) -> dict[str, Any]:
    """Return a record as a JSON object, and the records that it holds too."""
    return {
        name: _as_object(value) if hasattr(value, "_asdict") else value
        for name, value in record._asdict().items()
    }
