"""Print fuzz/RELIABILITY.md from the logs of the fuzzer: ``python -m benchmarks.reliability LOG...``.

The page sums up the attempts, the branches of the readers that they reached, and their finds. ``--finds``
prints each find instead, with its cause and test. Each line of a log is a run of ``make fuzz``,
``fuzz-native``, ``fuzz-coverage`` or ``faults``; nothing else is added here.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from fuzz.mended import mended

LOG = Path(__file__).resolve().parents[1] / "build" / "fuzz-log.jsonl"

Line = dict[str, Any]

WORDS = {
    "commands": "every command on damaged models",
    "branches": "the same, with branches counted",
    "native kernel": "compiled loops of bake, under two sanitizers",
    "native loops": "compiled loops of verify, likewise",
    "native decoders": "Draco and meshopt decoders, likewise",
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
    dates = sorted(line["date"][:10] for line in lines)
    when = f"The runs are from {dates[0]} to {dates[-1]}." if dates else "Nothing has been run yet."
    parts = [
        "# Reliability",
        "Attempts to break skinbake with damaged models, kills and I/O errors. A *find* is a crash, a hang, "
        f"or an output or exit code against the promises of [SECURITY.md](../SECURITY.md). {when}",
        _executions(lines),
        "\n".join(f"- {fact}" for fact in _facts(lines)),
        "*Written by `python -m benchmarks.reliability` from the logs of `make fuzz`, `make fuzz-native`, "
        "`make fuzz-coverage` and `make faults`; its option `--finds` lists each find, with cause and test.*",
    ]
    return "\n\n".join(parts) + "\n"


def _executions(lines: Sequence[Line]) -> str:
    rows = ["| tried | executions | hours | finds |", "|---|--:|--:|--:|"]
    kinds = {line["kind"] for line in lines}
    for kind in [*(known for known in WORDS if known in kinds), *sorted(kinds - WORDS.keys())]:
        own = [line for line in lines if line["kind"] == kind]
        count, hours = sum(line["executions"] for line in own), sum(line["seconds"] for line in own) / 3600
        found = len({name for line in own for name in line["finds"]})
        rows.append(f"| {WORDS.get(kind, kind)} | {count:,} | {hours:.2f} | {found} |")
    return "\n".join(rows)


def _facts(lines: Sequence[Line]) -> Iterator[str]:
    found = sorted({name for line in lines for name in line["finds"]})
    still = [name for name in found if not mended(name)]
    state = f"Open: {', '.join(still)}" if still else "All are mended, or were not faults"
    yield f"**Finds**: {len(found)} in all. {state}."
    faults = Counter[str]()
    for line in lines:
        if line["kind"] == "faults":
            faults.update(line.get("kinds", {}))
    if faults:
        kinds = ", ".join(f"{kind} {count:,}" for kind, count in faults.items())
        yield (
            f"**Faults**, each at each call that writes: {kinds}. With `+` all calls that follow fail too, "
            "except calls that remove files. `short` writes half of the bytes."
        )
    measured = [line for line in lines if line["kind"] == "branches" and line.get("branches")]
    if measured:
        last = max(measured, key=lambda line: str(line["date"]))
        share = 100 * last["covered"] / last["branches"]
        yield (
            f"**Branches**: {last['covered']} of {last['branches']} of `src/skinbake/files` and "
            f"`src/skinbake/gltf` ({share:.1f} %) are reached."
        )
    files = {
        (line["kind"], name): figures
        for line in sorted(lines, key=lambda line: str(line["date"]))
        for name, figures in line.get("files", {}).items()
    }
    plain = [figures for (kind, _), figures in files.items() if kind == "hostile"]
    if plain:
        codes = " or ".join(sorted({code for figures in files.values() for code in figures[0].split()}))
        slowest, largest = (max(figures[n] for figures in plain) for n in (1, 2))
        yield (
            f"**Hostile files**: every command on {len(plain)} files that once broke a promise ends with "
            f"exit code {codes}, after {slowest} s and with {largest} MiB at most."
        )


def finds(lines: Sequence[Line]) -> Iterator[str]:
    """Yield a line for each find: its name, how often and when it was seen, its cause and its test."""
    last: dict[str, str] = {}
    times = Counter[str]()
    for line in sorted(lines, key=lambda line: str(line["date"])):
        times.update(line["finds"])
        last.update(dict.fromkeys(line["finds"], line["date"][:10]))
    for name, day in sorted(last.items()):
        yield f"{name}  {times[name]:,} ×, last on {day}: {mended(name) or 'open'}"


def main() -> int:
    """Print the page of the logs that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability", description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, default=[LOG], metavar="LOG")
    parser.add_argument("--finds", action="store_true", help="list the finds instead of the page")
    given = parser.parse_args()
    lines = read_logs(given.logs)
    print("\n".join(finds(lines)) if given.finds else page(lines).rstrip("\n"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
