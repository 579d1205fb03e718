"""The result of many files together: one JSON object, counts, repeated failures, and times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from skinbake.errors import BudgetError, InputError, Notice, Place, SkinbakeError, printable
from skinbake.wording import counted, gain_in_words

SCREEN = 20
"""The number of files whose lines are still in sight at the end."""

LISTED = 100
"""The number of failures that the end lists."""

LOWEST = 3
"""The number of files with the smallest gains that the end lists."""


@dataclass(slots=True)
class Totals:
    """Counts of files by outcome, in the order of the report; files is their number.

    ``not_baked`` is the number of files that passed ``verify`` only because nothing in them is baked.
    ``left`` is that of those which a bake has left so on purpose. ``gains`` are those of files, with their
    names. ``command`` bakes what is not baked.
    """

    files: int
    outcomes: tuple[str, ...]
    counts: Counter[str] = field(default_factory=Counter)
    not_baked: int = 0
    left: int = 0
    command: str = ""
    gains: list[tuple[float, str]] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """Return the number of finished files."""
        return self.counts.total()

    def add(self, outcome: str, reason: str, timings: Mapping[str, float] | None) -> None:
        """Count a file. ``reason`` names it and says why it failed, if it did."""
        self.counts[outcome] += 1
        if outcome == "failed":
            self.failures.append(reason)
        for stage, seconds in (timings or {}).items():
            self.timings[stage] = self.timings.get(stage, 0.0) + seconds


def reason_of(source: str, error: SkinbakeError | None) -> str:
    """Return the error of a file with the file's name, or nothing if there is none."""
    if error is None:
        return ""
    text = str(error)
    return text if text.startswith(printable(source)) else f"{source}: {text}"


def count(totals: Totals, result: Any) -> None:
    """Count the result of a file by its status."""
    totals.add(result.status, reason_of(result.input, result.error), result.timings)


def failure_lines(totals: Totals) -> Iterator[str]:
    """Yield the failures again, if there are several and their own lines may be out of sight."""
    count = len(totals.failures)
    if count < 2 or totals.files <= SCREEN:
        return
    yield f"{count:,} of {counted(totals.files, 'file')} failed:"
    for failure in totals.failures[:LISTED]:
        yield f"  {printable(failure)}"
    if count > LISTED:
        yield f"  … and {count - LISTED:,} more"


def lowest_lines(totals: Totals) -> Iterator[str]:
    """Yield a line with the files of the smallest gains, if there are several."""
    if len(totals.gains) > 1:
        lowest = sorted(totals.gains)[:LOWEST]
        found = [f"{gain_in_words(gain)}x {printable(name)}" for gain, name in lowest]
        yield f"lowest gains: {', '.join(found)}"


def closing_line(totals: Totals, seconds: float, *, interrupted: bool = False) -> str:
    """Return one line about all files."""
    first, *others = totals.outcomes
    counts = {first: totals.counts[first] - totals.not_baked - totals.left}
    counts |= {"not baked": totals.not_baked, "left unbaked": totals.left}
    counts |= {outcome: totals.counts[outcome] for outcome in others}
    parts = [f"{count:,} {outcome.replace('-', ' ')}" for outcome, count in counts.items() if count]
    which = counted(totals.files, "file")
    if interrupted:
        which = f"interrupted after {totals.done:,} of {which}"
    if not totals.done:
        return f"{which}: none done, in {seconds:.1f} s"
    speed = totals.done / seconds if seconds > 0 else 0.0
    rate = f"{speed:,.{0 if speed >= 10 else 2}f} files/s" if speed else "at once"
    then = f". Next: {totals.command}" if totals.command else ""
    return f"{which}: {', '.join(parts)}, in {seconds:.1f} s ({rate}){then}"


def totals_json(totals: Totals, seconds: float, *, schema: str, exit_code: int) -> dict[str, Any]:
    """Return the last line of a summary."""
    counts = {outcome.replace("-", "_"): totals.counts[outcome] for outcome in totals.outcomes}
    return {
        "schema": schema,
        "kind": "total",
        "exit_code": exit_code,
        "files": totals.files,
        **counts,
        "seconds": round(seconds, 3),
        **timing_fields(totals.timings or None),
    }


def timing_lines(totals: Totals, process: Mapping[str, float | None]) -> Iterator[str]:
    """Yield a table of seconds by stage, and of the seconds of the whole process.

    Shares are shares of the sum of the stages. This sum is more than the time of the process if several work
    at once.
    """
    timings, whole = totals.timings, sum(totals.timings.values())
    over = "" if totals.files == 1 else f", summed over {counted(totals.done, 'file')}"
    yield f"seconds by stage{over}:"
    width = max(len(name) for name in (*timings, *process, "together"))
    for name, seconds in timings.items():
        yield f"  {name:<{width}}{seconds:>10.3f}{seconds / whole if whole else 0:>6.0%}"
    yield f"  {'together':<{width}}{whole:>10.3f}"
    yield "seconds of the whole process:"
    for name, spent in process.items():
        if spent is not None:
            yield f"  {name.replace('_', '-'):<{width}}{spent:>10.3f}"


def timing_fields(seconds: Mapping[str, float | None] | None) -> dict[str, Any]:
    """Return seconds, by stage or of the process, as a member. If they were not requested, there is none."""
    return {} if seconds is None else {"timings": dict(seconds)}


def run_json(
    schema: str,
    files: Iterable[Mapping[str, Any]],
    *,
    exit_code: int,
    process: Mapping[str, float | None] | None,
    **chosen: Any,
) -> dict[str, Any]:
    """Return the results of all files as one JSON object.

    ``process`` holds the seconds of the whole process, None if they were not requested. ``chosen`` are
    options of the run that the object names.
    """
    return {
        "schema": schema,
        **chosen,
        "exit_code": exit_code,
        **timing_fields(process),
        "files": list(files),
    }


def place_fields(place: Place) -> dict[str, Any]:
    """Return a place as the members that are known, without the file."""
    fields = {
        "mesh": place.mesh,
        "mesh_name": place.mesh_name,
        "primitive": place.primitive,
        "attribute": place.attribute,
    }
    return {key: value for key, value in fields.items() if value is not None}


def notice_list(notices: Iterable[Notice]) -> list[dict[str, Any]]:
    """Return notices as JSON objects with a stable ``code``."""
    return [
        {"code": notice.code, "message": notice.message, "count": notice.count, **place_fields(notice.place)}
        for notice in notices
    ]


def error_fields(error: SkinbakeError | None) -> dict[str, Any] | None:
    """Return an error as a JSON object, None if there is none."""
    if error is None:
        return None
    where = place_fields(error.place) if error.place else {}
    kind = InputError if isinstance(error, BudgetError) else type(error)
    return {"kind": kind.__name__, "message": error.message, **where}
