"""Print docs/reliability.md from the logs of the fuzzer: ``python -m benchmarks.reliability LOG...``.

The page lists the attempts and their number, the branches of the readers that they reached, and their
finds. Each line of a log is a run of ``make fuzz``, ``fuzz-native``, ``fuzz-coverage`` or ``faults``; nothing
else is added here.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fuzz.mended import mended

LOG = Path(__file__).resolve().parents[1] / "build" / "fuzz-log.jsonl"

Line = dict[str, Any]

WORDS = {
    "commands": "`skinbake` with damaged models, by every command and `--compress` way",
    "branches": "the same, with branches counted",
    "native kernel": "compiled loops of bake, under AddressSanitizer and UndefinedBehaviorSanitizer",
    "native loops": "compiled loops of verify, under both",
    "native decoders": "Draco and meshopt decoders as `skinbake` calls them, under both",
    "hostile": "every command on files that once broke a promise",
    "hostile, sanitized": "the same, under AddressSanitizer",
    "faults": "commands with a kill, a signal or an I/O error at one call",
    "target glb": "reader of GLB, coverage-guided",
    "target gltf": "reader of accessors, views and data: URIs, coverage-guided",
    "target draco": "reader of Draco's counts, coverage-guided",
    "target meshopt": "reader of meshopt's headers, coverage-guided",
    "target uri": "reader of URIs, coverage-guided",
    "target state": "reader of state files, coverage-guided",
}
"""The program or the code that each kind of run tries, in the order of the table."""


def read_logs(paths: Iterable[Path]) -> list[Line]:
    """Return the lines of logs."""
    return [json.loads(line) for path in paths for line in path.read_text(encoding="utf-8").splitlines()]


def page(lines: Sequence[Line]) -> str:
    """Return the page."""
    parts = [
        "# Reliability",
        "This page lists the attempts to break skinbake, and their results. "
        "`python -m benchmarks.reliability` writes this page from the logs of "
        "`make fuzz`, `make fuzz-native`, `make fuzz-coverage` and `make faults`. "
        "[growth.md](growth.md) shows how time and memory grow with hostile files.",
        *_executions(lines),
        *_codes(lines),
        *_faults(lines),
        *_coverage(lines),
        *_hostile(lines),
        *_finds(lines),
    ]
    return "\n\n".join(parts) + "\n"


def _executions(lines: Sequence[Line]) -> list[str]:
    rows = ["| program | executions | hours | runs | causes found |", "|---|---|---|---|---|"]
    kinds = {line["kind"] for line in lines}
    for kind in [*(known for known in WORDS if known in kinds), *sorted(kinds - WORDS.keys())]:
        own = [line for line in lines if line["kind"] == kind]
        count, hours = sum(line["executions"] for line in own), sum(line["seconds"] for line in own) / 3600
        found = len({name for line in own for name in line["finds"]})
        rows.append(f"| {WORDS.get(kind, kind)} | {count:,} | {hours:.2f} | {len(own)} | {found} |")
    dates = sorted(line["date"] for line in lines)
    when = f"From {dates[0][:10]} to {dates[-1][:10]}." if dates else "Nothing has been run yet."
    return ["## Executions", when, "\n".join(rows)]


def _codes(lines: Sequence[Line]) -> list[str]:
    """Return how the commands ended."""
    counts = Counter[str]()
    for line in lines:
        if line["kind"] == "commands":
            counts.update(line.get("codes", {}))
    if not counts:
        return []
    codes = sorted({name.partition(" ")[2] for name in counts})
    rows = [f"| command | {' | '.join(codes)} |", "|---" * (len(codes) + 1) + "|"]
    commands = sorted({name.partition(" ")[0] for name in counts})
    cells = {command: [f"{counts[f'{command} {code}']:,}" for code in codes] for command in commands}
    rows += [f"| {' | '.join([command, *cells[command]])} |" for command in commands]
    return ["## How commands ended", "By exit code.", "\n".join(rows)]


def _faults(lines: Sequence[Line]) -> list[str]:
    counts = Counter[str]()
    for line in lines:
        if line["kind"] == "faults":
            counts.update(line.get("kinds", {}))
    if not counts:
        return []
    rows = ["| fault | times |", "|---|---|", *(f"| {kind} | {count:,} |" for kind, count in counts.items())]
    about = (
        "Each fault is tried at each call that writes, one after another. With `+` all calls that follow "
        "fail too, except calls that remove files. `short` writes half of the bytes."
    )
    return ["## Faults", about, "\n".join(rows)]


def _coverage(lines: Sequence[Line]) -> list[str]:
    measured = [line for line in lines if line["kind"] == "branches" and line.get("branches")]
    if not measured:
        return []
    last = max(measured, key=lambda line: str(line["date"]))
    share = 100 * last["covered"] / last["branches"]
    by = f"{last['executions']:,} runs of commands from seed {last['seed']}"
    by += f" and {last['faults']:,} faults" if last.get("faults") else ""
    counts = f"{last['covered']} of {last['branches']} branches"
    text = f"{counts} of src/skinbake/files and src/skinbake/gltf ({share:.1f} %) are reached by {by}."
    if last.get("explained"):
        why = "names another way to reach it, or the reason why nothing can."
        text += f" For each of {last['explained']} others, [fuzz/explained.py](../fuzz/explained.py) {why}"
    return ["## Branches", text]


def _hostile(lines: Sequence[Line]) -> list[str]:
    """Return how commands ended on the hostile files, as they were run last."""
    last = {
        line["kind"]: line["files"]
        for line in sorted(lines, key=lambda line: str(line["date"]))
        if "files" in line
    }
    if not last:
        return []
    plain, sanitized = last.get("hostile", {}), last.get("hostile, sanitized", {})
    rows = [
        "| file | exit codes | slowest, s | largest, MiB | under AddressSanitizer |",
        "|---|---|---|---|---|",
    ]
    for name in {**plain, **sanitized}:
        codes, slowest, largest = plain.get(name, ("", "", ""))
        rows.append(f"| {name} | {codes} | {slowest} | {largest} | {sanitized.get(name, ('',))[0]} |")
    about = (
        "The first command is the one that broke the promise, if it is noted. The others are `bake`, "
        "`bake --compress draco`, `verify`, `inspect` and `strip`. A time is that of a whole process: the "
        "best of some tries, by the clock or, if it is less, by the processors."
    )
    return ["## Hostile files", about, "\n".join(rows)]


def _finds(lines: Sequence[Line]) -> list[str]:
    """Return the finds, each with the day on which it was seen last."""
    last: dict[str, str] = {}
    times = Counter[str]()
    for line in sorted(lines, key=lambda line: str(line["date"])):
        times.update(line["finds"])
        last.update(dict.fromkeys(line["finds"], line["date"][:10]))
    if not last:
        return ["## Found", "Nothing."]
    rows = ["| find | times | last seen | cause, and the test |", "|---|---|---|---|"]
    rows += [
        f"| {name.replace('|', '/')} | {times[name]:,} | {day} | {mended(name) or 'open'} |"
        for name, day in sorted(last.items())
    ]
    return ["## Found", "\n".join(rows)]


def main() -> int:
    """Print the page of the logs that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability", description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, default=[LOG], metavar="LOG")
    given = parser.parse_args()
    print(page(read_logs(given.logs)), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
