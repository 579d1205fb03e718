"""docs/gpu.md: the figures of all adapters that have a file of results, and what follows from them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from benchmarks.gpu.goals import (
    BYTES_GOAL,
    GOALS,
    by_variant,
    bytes_ratio,
    bytes_verdict,
    largest_mesh,
    median_time,
    times_ratio,
    verdict,
)
from benchmarks.gpu.meshes import INFLUENCES
from benchmarks.gpu.records import (
    COMPUTE,
    DRAWN,
    ErrorRecord,
    RunRecord,
    TimeRecord,
    measured_errors_of,
)
from benchmarks.gpu.variants import PACKED8, STANDARD, VARIANTS
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.counting import multiply_adds

FRAME = 16.0
"""Milliseconds of a frame at 60 frames a second, nearly."""
LINE = 110
"""Letters of a line of the page."""
RATES = (100, 500, 2000)
"""Gigabytes a second: an integrated GPU, a card of the middle, and one of a data centre."""

HEAD = """# The cost of a frame on a GPU

What does lighting with α and β cost at run time, beside standard skinning, and beside recomputing the normals
on the GPU after skinning? `python -m benchmarks.shader_speed` measures it on any Vulkan, Metal or Direct3D 12
adapter, and writes this page. Each adapter has a file in `benchmarks/gpu/results`, and its own tables below.

![{alt}]({chart})

{state}

## The ways
All skin a vertex of four influences in the normal frame. They read float positions, normals and weights, and
joints of 8 bits, tightly packed as in a glTF file. They give position, normal and tangent.

- *Standard, accurate, exact*: the WGSL that `skinbake shader` writes, with α and β as floats, `snorm16` or
  `packed8`. As a *compute pass* they write 36 bytes for each vertex. As a *vertex shader* they draw triangles
  of about half a pixel into a picture that is never shown. Only the vertex shader differs.
- *Recomputed, scatter*: skin the positions. Then each triangle adds its unit normal, times its angle, to its
  three corners by integer atomics (24 bits after the point). Then each vertex normalises its sum.
- *Recomputed, gather*: skin the positions. Then each vertex goes round its neighbours (a CSR of the one-ring,
  4 bytes a neighbour) and adds up the same sum.

Both recomputes give one normal to all copies of a vertex at a seam, and keep hard edges. Both carry the
authored normal along: a quaternion, found at rest, turns the frame of the recomputed normal and of one edge
into the frame of the authored normal. It takes the place of NORMAL. Without it, a recompute shades with other
normals than the artist's, at rest too.
"""

ALT = (
    "Bars for each way: the bytes that it must move for a vertex, its measured time, and its mean error. "
    "The figures stand in the tables below"
)

NO_GPU = """**No GPU has been measured yet.** The times below are of software that plays a GPU on a processor.
They say nothing about a GPU. The bytes and the errors hold for any adapter."""

ERRORS = """## What they are off by
Mean angles in degrees between the normals that the compute pass returned and the true normals, by tangents /
by triangles ([both truths](lighting.md#true-normals)), over the characters' own clips, weighted by rest area.
A recompute follows the same rule as the truth by triangles. So its figure by triangles says little. No way
follows the rule of the truth by tangents. But the fit of α and β aims between both, for small turns of the
rig, and at no pose of these clips.
"""

BYTES = """## What must move
Bytes of a vertex, for {scene}. *Moved* counts each buffer once in each step
that reads it, and once in each that writes it. Perfect caches are assumed: the gathers and atomics of a
recompute touch positions and sums about six times, and their time shows how much of that the caches catch.
*More* is what stays in memory beside the mesh: α and β, or the neighbours and the sums. *Drawn* is what the
vertex shader reads, indices included. The pixels are not counted.
"""

GOALS_HEAD = """## Goals
For the compute pass at 10 million vertices. *By bytes* is the ratio of the bytes moved. It is the ratio of
times where memory is the only limit. Arithmetic, latency and atomics move the measured ratio to either side.
"""

FRAME_HEAD = """## A frame of 16 ms
At 60 frames a second a frame has 16 ms for everything. *By bytes* is no measurement. It is the time for a
million vertices where memory of so many gigabytes a second is the only limit: the least that each way takes.
"""


def page(records: Sequence[RunRecord], chart: str) -> str:
    """Return the page of runs, the one to believe most first, beside a chart in the file ``chart``."""
    first = records[0]
    parts = [
        HEAD.format(alt=ALT, chart=chart, state=_state(records)),
        *_goals(records),
        *_frame(records),
        *_bytes(first),
        *_errors(measured_errors_of(records)),
    ]
    for record in records:
        parts += _adapter(record)
    return "\n".join([*parts, "---", "Made by `python -m benchmarks.shader_speed`."]) + "\n"


def _state(records: Sequence[RunRecord]) -> str:
    measured = [record.adapter for record in records if not record.software]
    if measured:
        return f"Measured on {', '.join(measured)}."
    return NO_GPU


def _goals(records: Sequence[RunRecord]) -> Iterator[str]:
    yield GOALS_HEAD
    yield "| goal | by bytes | " + " | ".join(record.adapter for record in records) + " |"
    yield "|---|--:|" + "---|" * len(records)
    for goal in GOALS:
        cells = [_judged(verdict(goal, record), times_ratio(goal, record), record) for record in records]
        yield f"| {goal.text} | {bytes_ratio(goal, records[0]):.2f} | {' | '.join(cells)} |"
    entries = by_variant(records[0], largest_mesh(records[0]), COMPUTE)
    more = f"{entries[PACKED8].more:.0f} bytes"
    yield f"| {BYTES_GOAL} | {more} | {' | '.join(map(bytes_verdict, records))} |"
    yield ""
    beyond = [f"- {goal.text}" for goal in GOALS if bytes_ratio(goal, records[0]) > goal.most]
    if beyond:
        yield "With perfect caches, where memory is the only limit, no shader text can meet these goals:"
        yield ""
        yield from beyond
        yield ""


def _judged(judgement: str, ratio: float | None, record: RunRecord) -> str:
    """Return a verdict, with the measured ratio where it counts."""
    return judgement if ratio is None or record.software else f"{judgement}: {ratio:.2f}"


def _frame(records: Sequence[RunRecord]) -> Iterator[str]:
    hardware = [record for record in records if not record.software]
    entries = by_variant(records[0], largest_mesh(records[0]), COMPUTE)
    yield FRAME_HEAD
    columns = [f"by bytes, {rate:,} GB/s" for rate in RATES] + [f"{record.adapter}" for record in hardware]
    yield f"| a million vertices, compute pass | {' | '.join(columns)} |"
    yield "|---|" + "--:|" * len(columns)
    for name, entry in entries.items():
        times = [entry.bytes_moved / rate for rate in RATES]
        cells = [_milliseconds(time) for time in times]
        cells += [_share_of_frame(record, name) for record in hardware]
        yield f"| {name} | {' | '.join(cells)} |"
    yield ""
    standard, accurate = (entries[name].bytes_moved for name in (STANDARD, PACKED8))
    cheaper = min(entry.bytes_moved for name, entry in entries.items() if "recomputed" in name)
    rate = RATES[0]
    more, recomputed = ((moved - standard) / rate for moved in (accurate, cheaper))
    yield textwrap.fill(
        f"So at {rate} GB/s a scene of a million skinned vertices spends {more:.2f} ms more on accurate "
        f"lighting with `packed8` than on standard lighting, {100 * more / FRAME:.1f} % of the frame. The "
        f"recompute that moves fewer bytes spends {recomputed:.2f} ms more than standard lighting, "
        f"{100 * recomputed / FRAME:.1f} % of the frame.",
        LINE,
    )
    yield ""


def _share_of_frame(record: RunRecord, name: str) -> str:
    entry = by_variant(record, largest_mesh(record), COMPUTE).get(name)
    time = None if entry is None else median_time(entry)
    if time is None:
        return "not measured"
    return _milliseconds(1e9 * time)


def _milliseconds(time: float) -> str:
    return f"{digits(time)} ms ({100 * time / FRAME:.1f} %)"


def digits(value: float) -> str:
    """Return a number with three digits, or more before the point."""
    return f"{value:,.{2 if value >= 1 else 3}f}" if value < 10 else f"{value:,.{1 if value < 100 else 0}f}"


def _bytes(record: RunRecord) -> Iterator[str]:
    scene = largest_mesh(record)
    yield BYTES.format(scene=scene)
    yield "| | moved | of LBS standard | more | drawn | of LBS standard |"
    yield "|---|--:|--:|--:|--:|--:|"
    computed, drawn = (by_variant(record, scene, stage) for stage in (COMPUTE, DRAWN))
    for name, entry in computed.items():
        ratio = entry.bytes_moved / computed[STANDARD].bytes_moved
        cells = [f"{entry.bytes_moved:.1f}", f"{ratio:.2f}", f"{entry.more:.1f}"]
        if name in drawn:
            cells += [
                f"{drawn[name].bytes_moved:.1f}",
                f"{drawn[name].bytes_moved / drawn[STANDARD].bytes_moved:.2f}",
            ]
        else:
            cells += ["", ""]
        yield f"| {name} | {' | '.join(cells)} |"
    yield ""
    counted = sum(multiply_adds(Algorithm.LBS_ACCURATE, INFLUENCES).values())
    moved = computed[PACKED8].bytes_moved
    yield textwrap.fill(
        f"Accurate lighting takes {counted} multiply-adds (`skinbake cost`), with `packed8` "
        f"{counted / moved:.1f} for each byte. A GPU that computes more of them in the time of a byte waits "
        "for its memory.",
        LINE,
    )
    yield ""


def _errors(errors: Sequence[ErrorRecord]) -> Iterator[str]:
    yield ERRORS
    if not errors:
        yield "Not measured: the corpus of characters was not there.\n"
        return
    poses = {entry.character: entry.poses for entry in errors}
    columns = [f"{name}, {count} poses" for name, count in poses.items()]
    yield f"| | {' | '.join(columns)} |"
    yield "|---|" + "--:|" * len(columns)
    for variant in VARIANTS:
        cells = []
        for character in poses:
            means = [
                f"{entry.mean:.2f}°"
                for entry in errors
                if (entry.character, entry.variant) == (character, variant.name)
            ]
            cells.append(" / ".join(means))
        yield f"| {variant.name} | {' | '.join(cells)} |"
    yield ""


def _adapter(record: RunRecord) -> Iterator[str]:
    kind = ", software on a processor" if record.software else ""
    versions = ", ".join(f"{name} {version}" for name, version in record.versions.items())
    yield f"## Times: {record.adapter}{kind}"
    yield textwrap.fill(
        f"{record.backend}, {record.driver}; {record.processor}, {record.system}; {versions}; {record.date}. "
        f"Medians of {record.rounds} rounds by {record.clock}. A copy kernel moves "
        f"{record.copy_rate / 1e9:,.1f} GB/s. *Share* is the share of it that the bytes moved take.",
        LINE,
    )
    if record.software:
        yield "\n**These are times of a processor. They say nothing about a GPU, and neither do the ratios.**"
    for scene in dict.fromkeys(entry.scene for entry in record.times):
        yield from _scene(record, scene)


def _scene(record: RunRecord, scene: str) -> Iterator[str]:
    yield f"\n**{scene[0].upper()}{scene[1:]}**, {record.adapter}\n"
    columns = (
        "compute pass, ns a vertex | of LBS standard | share | vertex shader, ns a vertex | of LBS standard"
    )
    yield f"| | {columns} |"
    yield "|---|--:|--:|--:|--:|--:|"
    computed, drawn = (by_variant(record, scene, stage) for stage in (COMPUTE, DRAWN))
    for name, entry in computed.items():
        time = median_time(entry)
        share = "" if time is None else f"{100 * entry.bytes_moved / time / record.copy_rate:.0f} %"
        cells = [*_time_and_ratio(entry, computed[STANDARD]), share]
        cells += _time_and_ratio(drawn[name], drawn[STANDARD]) if name in drawn else ["", ""]
        yield f"| {name} | {' | '.join(cells)} |"
    yield ""
    reasons = {
        f"{entry.variant}, {entry.stage}: {entry.missing}"
        for entry in record.times
        if entry.scene == scene and entry.missing
    }
    yield from (f"- {reason}" for reason in sorted(reasons))
    if reasons:
        yield ""


def _time_and_ratio(entry: TimeRecord, standard: TimeRecord) -> list[str]:
    time, of_standard = median_time(entry), median_time(standard)
    if time is None:
        return ["does not fit", ""]
    return [digits(1e9 * time), "" if of_standard is None else f"{time / of_standard:.2f}"]
