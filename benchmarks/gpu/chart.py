"""The chart of docs/gpu.md, as SVG: bytes, times and errors of each way on one adapter."""

from __future__ import annotations

import statistics
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from benchmarks.gpu.goals import by_variant, largest_mesh, median_time
from benchmarks.gpu.records import COMPUTE, ErrorRecord, RunRecord, measured_errors_of
from benchmarks.gpu.variants import VARIANTS
from skinbake.choices import Truth

WIDTH, HEAD, ROW, FOOT = 920, 78, 30, 26
NAMES, PANEL, GAP = 200, 210, 34
BAR = 18
FIGURE = 50
"""The room for a figure beside the longest bar."""
LETTERS = 30
"""Letters of the line below a title at most."""
INK, GREY = "#1c1e22", "#60646c"
STANDARD, ACCURATE, RECOMPUTED = "#9aa3ad", "#d1693f", "#3f74b5"


@dataclass(frozen=True, slots=True)
class Panel:
    """A column of bars: its title, the line below, a value for each row (None: not measured), its format."""

    title: str
    line: str
    values: Sequence[float | None]
    format: str


def chart(records: Sequence[RunRecord]) -> str:
    """Return the SVG of the first run's largest mesh, and of the first characters that were measured."""
    record = records[0]
    names = [variant.name for variant in VARIANTS]
    panels = [_bytes(record, names), _times(record, names), _errors(measured_errors_of(records), names)]
    height = HEAD + ROW * len(names) + FOOT
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" '
        f'viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">'
    )
    lines = [head, f'<rect width="{WIDTH}" height="{height}" fill="white"/>', *_names(names)]
    for number, panel in enumerate(panels):
        lines += _bars(panel, NAMES + number * (PANEL + GAP), names)
    return "\n".join([*lines, "</svg>"]) + "\n"


def _bytes(record: RunRecord, names: Sequence[str]) -> Panel:
    entries = by_variant(record, largest_mesh(record), COMPUTE)
    moved = [entries[name].bytes_moved for name in names]
    return Panel("Bytes that must move", "a vertex, by the layouts", moved, "{:.0f}")


def _times(record: RunRecord, names: Sequence[str]) -> Panel:
    entries = by_variant(record, largest_mesh(record), COMPUTE)
    times = [median_time(entries[name]) for name in names]
    if record.software:
        # A chart would give these times a weight that they do not have.
        return Panel("Nanoseconds a vertex", "no GPU measured yet", [None] * len(names), "")
    values = [None if time is None else 1e9 * time for time in times]
    return Panel("Nanoseconds a vertex", _short(record.adapter), values, "{:.3f}")


def _errors(errors: Sequence[ErrorRecord], names: Sequence[str]) -> Panel:
    characters = list(dict.fromkeys(entry.character for entry in errors))
    values = []
    for name in names:
        means = [entry.mean for entry in errors if (entry.variant, entry.truth) == (name, Truth.TANGENTS)]
        values.append(statistics.fmean(means) if means else None)
    line = f"mean of {len(characters)} characters, by tangents"
    return Panel("Degrees off", line, values, "{:.2f}°")


def _short(adapter: str) -> str:
    """Return an adapter's name without what stands in brackets, as long as a panel is wide."""
    return textwrap.shorten(adapter.partition("(")[0], LETTERS, placeholder=" …")


def _names(names: Sequence[str]) -> Iterator[str]:
    for number, name in enumerate(names):
        y = HEAD + ROW * number + BAR - 4
        yield _text(NAMES - 12, y, name, 14, INK, "end")


def _bars(panel: Panel, left: int, names: Sequence[str]) -> Iterator[str]:
    yield _text(left, 30, panel.title, 18, INK)
    yield _text(left, 52, panel.line, 13, GREY)
    longest = max((value for value in panel.values if value is not None), default=1.0)
    for number, (name, value) in enumerate(zip(names, panel.values, strict=True)):
        y = HEAD + ROW * number
        if value is None:
            yield _text(left, y + BAR - 4, "not measured", 13, GREY)
            continue
        width = (PANEL - FIGURE) * value / longest
        yield f'<rect x="{left}" y="{y}" width="{width:.1f}" height="{BAR}" rx="2" fill="{_colour(name)}"/>'
        yield _text(left + width + 6, y + BAR - 4, panel.format.format(value), 13, INK)


def _colour(name: str) -> str:
    if "standard" in name:
        return STANDARD
    return RECOMPUTED if "recomputed" in name else ACCURATE


def _text(x: float, y: float, words: str, size: int, colour: str, anchor: str = "start") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{colour}" '
        f'text-anchor="{anchor}">{escape(words)}</text>'
    )
