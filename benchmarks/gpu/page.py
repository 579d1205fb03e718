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
from skinbake.choices import Truth
from skinbake.skinning.counting import multiply_adds
from skinbake.skinning.rest import Algorithm

FRAME = 16.0
"""Milliseconds of a frame at 60 frames a second, nearly."""
LINE = 110
"""Letters of a line of the page."""
RATES = (100, 500)
"""Gigabytes a second: an integrated GPU, and a card of the middle."""

HEAD = """# The cost of a frame on a GPU

What lighting with α and β costs at run time, beside standard skinning, and beside normals that the GPU
recomputes after skinning. With `packed8`, accurate lighting moves {more:.0f} bytes more for each vertex.

![{alt}]({chart})

{state}

- *Standard, accurate, exact*: the WGSL of `skinbake shader`, in a compute pass: it skins a vertex of four
  influences in the normal frame and writes position, normal and tangent.
- *Recomputed*: skin the positions, then add up the triangles' normals, weighted by their angles, at each
  vertex: *scatter* by atomics, *gather* along a list of neighbours. Both keep hard edges and the authored
  normal's lean.
"""

ALT = (
    "Bars for each way: the bytes that it must move for a vertex, its measured time, and its mean error. "
    "The figures stand in the tables below"
)

NO_GPU = "**No GPU has been measured yet.** Bytes and errors hold for any adapter."

ERRORS = """## Error
Mean angles in degrees to the true normals, by triangles / by tangents ([both](lighting.md#true-normals)),
over the characters' own clips. A recompute follows the rule of the truth by triangles, so its first figure
says little, and the bars above show the second.
"""

BYTES = """## Bytes
A vertex of {scene}, with perfect caches: each buffer counts once in each step that
reads or writes it. *More* is what stays in memory beside the mesh. *A million* is the least time for a
million vertices, where memory of so many gigabytes a second is the only limit, and its share of a frame of
16 ms.
"""

GOALS_HEAD = """## Goals
For the compute pass at 10 million vertices. *By bytes* is the ratio of the bytes moved. It is the ratio of
times where memory is the only limit. Arithmetic, latency and atomics move the measured ratio to either side.
"""


def page(records: Sequence[RunRecord], chart: str) -> str:
    """Return the page of runs, the one to believe most first, beside a chart in the file ``chart``."""
    first = records[0]
    hardware = [record for record in records if not record.software]
    entries = by_variant(first, largest_mesh(first), COMPUTE)
    more = entries[PACKED8].bytes_moved - entries[STANDARD].bytes_moved
    parts = [
        HEAD.format(more=more, alt=ALT, chart=chart, state=_state(records)),
        *_bytes(first),
        *_errors(measured_errors_of(records)),
        *(_goals(hardware) if hardware else ()),
    ]
    for record in hardware:
        parts += _adapter(record)
    parts.append(
        "*Measured by `python -m benchmarks.shader_speed` on any Vulkan, Metal or Direct3D 12 adapter.*"
    )
    return "\n".join(parts) + "\n"


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
        found = [(verdict(goal, record), times_ratio(goal, record)) for record in records]
        cells = [judged if ratio is None else f"{judged}: {ratio:.2f}" for judged, ratio in found]
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


def _milliseconds(time: float) -> str:
    return f"{digits(time)} ms ({100 * time / FRAME:.1f} %)"


def digits(value: float) -> str:
    """Return a number with three digits, or more before the point."""
    return f"{value:,.{2 if value >= 1 else 3}f}" if value < 10 else f"{value:,.{1 if value < 100 else 0}f}"


def _bytes(record: RunRecord) -> Iterator[str]:
    scene = largest_mesh(record)
    yield BYTES.format(scene=scene)
    columns = [f"a million, {rate:,} GB/s" for rate in RATES]
    yield f"| | moved | of standard | more | {' | '.join(columns)} |"
    yield "|---|--:|--:|--:|" + "--:|" * len(columns)
    computed = by_variant(record, scene, COMPUTE)
    for name, entry in computed.items():
        ratio = entry.bytes_moved / computed[STANDARD].bytes_moved
        cells = [f"{entry.bytes_moved:.1f}", f"{ratio:.2f}", f"{entry.more:.1f}"]
        cells += [_milliseconds(entry.bytes_moved / rate) for rate in RATES]
        yield f"| {name} | {' | '.join(cells)} |"
    yield ""
    counted = sum(multiply_adds(Algorithm.LBS_ACCURATE, INFLUENCES).values())
    moved = computed[PACKED8].bytes_moved
    yield textwrap.fill(
        f"Accurate lighting takes {counted} multiply-adds (`skinbake cost`; 144 [with the "
        f"frame](shaders.md#which-lighting)), with `packed8` {counted / moved:.1f} for each byte. A GPU that "
        "computes more of them in the time of a byte waits for its memory.",
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
            means = {
                entry.truth: f"{entry.mean:.2f}°"
                for entry in errors
                if (entry.character, entry.variant) == (character, variant.name)
            }
            cells.append(" / ".join(means[by] for by in (Truth.TRIANGLES, Truth.TANGENTS) if by in means))
        yield f"| {variant.name} | {' | '.join(cells)} |"
    yield ""


def _adapter(record: RunRecord) -> Iterator[str]:
    versions = ", ".join(f"{name} {version}" for name, version in record.versions.items())
    yield f"## Times: {record.adapter}"
    yield textwrap.fill(
        f"{record.backend}, {record.driver}; {record.processor}, {record.system}; {versions}; {record.date}. "
        f"Medians of {record.rounds} rounds by {record.clock}. A copy kernel moves "
        f"{record.copy_rate / 1e9:,.1f} GB/s. *Share* is the share of it that the bytes moved take.",
        LINE,
    )
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
