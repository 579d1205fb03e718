"""Run the compiled loops and the decoders under sanitizers: ``python -m fuzz.native --minutes 2``."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from fuzz.batches import FINDS
from fuzz.log import LOG, note
from fuzz.native.build import REPOSITORY, NoCompilerError, build, environment
from fuzz.native.work import KINDS, NOTE

NO_MEMORY = ("allocation-size-too-big", "out-of-memory", "calloc-overflow")
"""Reports of the sanitizer that say no more than that a stream asked for too much, which skinbake refuses."""


@dataclass
class Totals:
    """Executions and finds of one kind."""

    executions: int = 0
    refused_memory: int = 0
    finds: Counter[str] = field(default_factory=Counter)


def main() -> int:
    """Run as the command line says; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.native", description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"Of {', '.join(KINDS)}; all by default.")
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--seed", type=int, help="The first seed; by default the time.")
    parser.add_argument("--finds", type=Path, default=FINDS)
    parser.add_argument("--log", type=Path, default=LOG)
    given = parser.parse_args()
    try:
        build()
    except NoCompilerError as error:
        print(f"not run: {error}", file=sys.stderr)
        return 2
    first = given.seed if given.seed is not None else int(time.time()) * 1_000_000
    kinds = given.kinds or list(KINDS)
    found = False
    with ThreadPoolExecutor(len(kinds)) as pool:
        begun = time.monotonic()
        for kind, totals in zip(
            kinds,
            pool.map(lambda kind: run(kind, first, given.minutes * 60, given.finds), kinds),
            strict=True,
        ):
            seconds = time.monotonic() - begun
            note(
                f"native {kind}",
                executions=totals.executions,
                seconds=seconds,
                seed=first,
                finds=totals.finds,
                log=given.log,
            )
            rate = f"{totals.executions} executions from seed {first}, {totals.executions / seconds:.0f}/s"
            print(
                f"{kind}: {rate}, {totals.refused_memory} out of memory, {sum(totals.finds.values())} finds"
            )
            print("".join(f"  {count:6} {name}\n" for name, count in totals.finds.items()), end="")
            found = found or bool(totals.finds)
    return 1 if found else 0


def run(kind: str, first: int, seconds: float, finds: Path) -> Totals:
    """Run one kind for some seconds, in a new process each time that one dies."""
    totals = Totals()
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        notes = Path(folder, "note")
        while (left := end - time.monotonic()) > 0:
            notes.write_bytes(NOTE.pack(first, 0))
            command = [
                sys.executable,
                "-m",
                "fuzz.native.work",
                kind,
                str(first),
                "--seconds",
                f"{left:.1f}",
                "--note",
                str(notes),
            ]
            process = subprocess.run(
                command,
                check=False,
                capture_output=True,
                text=True,
                errors="replace",
                env=environment(),
                cwd=REPOSITORY,
            )
            first, done = NOTE.unpack(notes.read_bytes())
            totals.executions += done
            if process.returncode == 0:
                return totals
            if any(words in process.stderr for words in NO_MEMORY):
                totals.refused_memory += 1
            else:
                totals.finds[_kept(kind, first, process, finds)] += 1
            first += 1
    return totals


def _kept(kind: str, seed: int, process: subprocess.CompletedProcess[str], finds: Path) -> str:
    """Keep what a process said before it died; return the name of the cause."""
    summary = re.search(
        r"SUMMARY: (.*)|runtime error: (.*)|^(\w+(?:Error|Exception)\b.*)", process.stderr, re.MULTILINE
    )
    cause = (
        next((words for words in summary.groups() if words), "") if summary else f"exit {process.returncode}"
    )
    name = f"native-{kind}-" + re.sub(r"[^A-Za-z0-9.]+", "-", re.sub(r"/\S*/|0x\w+", "", cause))[:80].strip(
        "-"
    )
    folder = finds / name
    folder.mkdir(parents=True, exist_ok=True)
    again = f"python -m fuzz.native.work {kind} {seed}   # in fuzz.native.build.environment()"
    said = f"{again}\n\n{process.stderr}"
    (folder / "report.txt").write_text(said, encoding="utf-8")
    return name


if __name__ == "__main__":
    sys.exit(main())
