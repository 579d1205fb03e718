"""The section on speed-up by threads of benchmarks/RESULTS.md, and its chart as SVG."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from benchmarks.processes import Json, median

CHART = "speedup.svg"
GOALS = {"verify": 1.8, "bake 10,": 1.7, "bake 1,000 ×": 2 / 1.2}
"""The least speed-ups by two threads that are wanted, by the beginning of a case's name."""

WIDTH, HEIGHT, LEFT, TOP, PLOT = 780, 420, 50, 20, 340
COLOURS = ("#3778bf", "#d1593a", "#3a9c5a", "#8a5fb5", "#a08020", "#30a0a0")
GREY = "#888888"


def speedups(runs: Json) -> dict[int, float]:
    """Return the time of one thread divided by that of each number of threads."""
    return {int(count): median(runs["1"]) / median(taken) for count, taken in runs.items()}


def serial_share(speedup: float, threads: int) -> float:
    """Return the share of the work that no further thread takes, by Amdahl's law."""
    return max(0.0, (threads / speedup - 1.0) / (threads - 1.0))


def section(row: Json) -> Iterator[str]:
    """Yield the section's lines."""
    cases, most = row["cases"], row["cores"]
    counts = [int(count) for count in next(iter(cases.values()))]
    yield "## Speed-up by threads"
    yield f"![Speed-up by threads]({CHART})"
    yield ""
    yield (
        "Seconds of one thread divided by the seconds of N: medians of whole processes that take turns. "
        f"*Serial* is the share of the work that only one of {most} threads does, by Amdahl's law. Start-up "
        "is in it. MiB are those of the largest process. Each of many files is synced to the disk."
    )
    yield ""
    heads = ("what", "one thread", *(f"{count} threads" for count in counts[1:]), "serial")
    yield f"| {' | '.join(heads)} | MiB by one, by {most} | goal by two | |"
    yield f"|---|---|{'---|' * (len(counts) - 1)}---|---|---|---|"
    for name, runs in cases.items():
        found = speedups(runs)
        goal = next((least for start, least in GOALS.items() if name.startswith(start)), None)
        by_count = [f"{median(runs[str(count)]):.2f} s, {found[count]:.2f} ×" for count in counts[1:]]
        cells = (
            name,
            f"{median(runs['1']):.2f} s",
            *by_count,
            f"{serial_share(found[most], most):.0%}" if most > 1 else "",
            f"{median(runs['1'], 'mib'):,.0f}, {median(runs[str(most)], 'mib'):,.0f}",
            "" if goal is None else f"{goal:.2f} ×",
            "" if goal is None or 2 not in found else "met" if found[2] >= goal else "**missed**",
        )
        yield f"| {' | '.join(cells)} |"


def chart(row: Json) -> str:
    """Return the chart: the speed-up of each case by the number of threads, and the line of no loss."""
    most = max(2, row["cores"])

    def at(count: float, speedup: float) -> str:
        step = PLOT / most
        return f"{LEFT + step * count:.1f},{TOP + PLOT - step * speedup:.1f}"

    parts = [_line([at(0, 0), at(most, most)], GREY, dashed=True)]
    for number in range(most + 1):
        parts += [
            _text(at(number, 0), str(number), 0, 18, "middle"),
            _text(at(0, number), str(number), -8, 4, "end"),
        ]
    parts += [_line([at(0, most), at(0, 0), at(most, 0)], GREY)]
    for number, (name, runs) in enumerate(row["cases"].items()):
        colour, found = COLOURS[number % len(COLOURS)], sorted(speedups(runs).items())
        parts.append(_line([at(count, speedup) for count, speedup in found], colour))
        parts += [_dot(at(count, speedup), colour) for count, speedup in found]
        label = f"{name}: {found[-1][1]:.2f} ×"
        parts.append(_text(f"{LEFT + PLOT + 20},{TOP + 14 + 22 * number}", label, 0, 0, "start", colour))
    parts.append(_text(at(most / 2, 0), "threads", 0, 38, "middle"))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif">'
    title = "<title>Speed-up by threads</title>"
    paper = f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>'
    return "\n".join([head, title, paper, *parts, "</svg>"]) + "\n"


def _line(points: Sequence[str], colour: str, *, dashed: bool = False) -> str:
    dashes = ' stroke-dasharray="6 4"' if dashed else ""
    return f'<polyline points="{" ".join(points)}" fill="none" stroke="{colour}" stroke-width="2"{dashes}/>'


def _dot(place: str, colour: str) -> str:
    x, y = place.split(",")
    return f'<circle cx="{x}" cy="{y}" r="4" fill="{colour}"/>'


def _text(place: str, words: str, right: float, down: float, anchor: str, colour: str = "#333333") -> str:
    x, y = map(float, place.split(","))
    return (
        f'<text x="{x + right:.1f}" y="{y + down:.1f}" text-anchor="{anchor}" font-size="13" fill="{colour}">'
        f"{escape(words)}</text>"
    )
