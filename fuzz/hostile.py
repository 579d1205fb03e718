"""Run every command on files that once broke a promise: ``python -m fuzz.hostile [--asan]``.

The files are in ``hostile/`` of the corpus. A table says how each command ended, the seconds of the slowest,
at best of some tries, and the memory of the largest. The seconds are those of the clock, or those of the
processors if they are fewer: on a busy machine a command waits for others. With ``--asan`` all run under
AddressSanitizer, which is slower and larger: then no bound holds. The exit code is 1 if a command ended in an
undocumented way, or over the bounds.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fuzz.log import LOG, note
from fuzz.native.build import REPOSITORY, build, environment
from tests.support.corpus_folder import find_corpus

DOCUMENTED = {0, 1, 2, 3, 4}
SECONDS, MEBIBYTES = 1.0, 512
TRIES = 5
UNREMEMBERED = ":malloc_context_size=0:quarantine_size_mb=32"
"""Freed memory is kept less long, and without the place that took it: that saves half of the memory."""

LAUNCHER = REPOSITORY / "benchmarks" / "launch.py"


@dataclass(frozen=True)
class Run:
    """How a command ended: its exit code, time, peak memory, and the last line that it said."""

    code: int
    seconds: float
    mebibytes: float
    said: str


def command_lines(path: Path, out: Path) -> Iterator[list[str]]:
    """Yield the command lines for a file: the one that broke the promise, if it is noted, and the usual."""
    note = path.parent / "_note.json"
    if note.exists():
        recorded = json.loads(note.read_text(encoding="utf-8"))[1][0][2]
        yield [
            word.replace("WORKDIR/c/in", str(path.parent)).replace("WORKDIR/c/out", str(out))
            for word in recorded
        ]
    yield ["bake", str(path), "-o", str(out / "o.glb"), "--generate-normals"]
    yield ["bake", str(path), "-o", str(out / "d.glb"), "--compress", "draco", "--texcoord-bits", "12"]
    yield ["verify", str(path)]
    yield ["inspect", str(path)]
    yield ["strip", str(path), "-o", str(out / "s.gltf")]


def run(arguments: list[str], env: dict[str, str]) -> Run:
    """Run one command in a process of its own."""
    launch = [sys.executable, "-I", "-S", str(LAUNCHER)]
    command = [*launch, sys.executable, "-m", "skinbake", *arguments]
    before = processor_seconds()
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False, errors="replace")
    seconds, peak = done.stdout.split()[-2:]
    said = done.stderr.strip().rpartition("\n")[2]
    return Run(done.returncode, min(float(seconds), processor_seconds() - before), int(peak) / 2**20, said)


def processor_seconds() -> float:
    """Return the processor time of all children that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def least(arguments: list[str], env: dict[str, str], tries: int) -> Run:
    """Run one command; again, up to so many times, where it took too long: the machine may be busy."""
    runs = [run(arguments, env)]
    while runs[-1].seconds > SECONDS and len(runs) < tries:
        runs.append(run(arguments, env))
    return min(runs, key=lambda one: one.seconds)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.hostile", description=__doc__)
    parser.add_argument("--asan", action="store_true", help="Under AddressSanitizer.")
    parser.add_argument("--log", type=Path, default=LOG)
    given = parser.parse_args()
    corpus = find_corpus()
    if corpus is None:
        sys.exit("there is no corpus: set SKINBAKE_CORPUS")
    env = dict(os.environ)
    if given.asan:
        build()
        env = environment()
        env["ASAN_OPTIONS"] += UNREMEMBERED
    env.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package is compiled to bytecode
    bad = 0
    begun, count, table = time.monotonic(), 0, {}
    print("| file | exit codes | slowest, s | largest, MiB |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "hostile")
        shutil.copytree(corpus / "hostile", copy, copy_function=shutil.copyfile)
        out = Path(folder, "out")
        for path in sorted(path for path in copy.rglob("*") if path.suffix in {".glb", ".gltf"}):
            out.mkdir()
            runs = [least(arguments, env, TRIES) for arguments in command_lines(path, out)]
            shutil.rmtree(out)
            slowest, largest = max(r.seconds for r in runs), max(r.mebibytes for r in runs)
            codes = " ".join(str(r.code) for r in runs)
            count += len(runs)
            table[path.relative_to(copy).as_posix()] = [codes, round(slowest, 2), round(largest)]
            print(f"| {path.relative_to(copy)} | {codes} | {slowest:.2f} | {largest:.0f} |", flush=True)
            wrong = [r for r in runs if r.code not in DOCUMENTED or "should not" in r.said]
            over = not given.asan and (slowest > SECONDS or largest > MEBIBYTES)
            bad += bool(wrong) or over
            for one in wrong:
                print(f"  {one.said}")
    kind = "hostile, sanitized" if given.asan else "hostile"
    note(kind, executions=count, seconds=time.monotonic() - begun, seed=None,
         finds={"over-bounds-or-undocumented": bad} if bad else {}, log=given.log, files=table)  # fmt: skip
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
