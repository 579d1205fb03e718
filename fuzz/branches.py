"""Tell which branches of skinbake's readers the fuzzer reaches: ``python -m fuzz.branches --minutes 2``.

Coverage is measured in the children that run the cases, and put together here. It costs most of the speed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import coverage

from fuzz.batches import FINDS, REPOSITORY, Plan, run_all
from fuzz.log import LOG, note
from fuzz.seeds import all_seeds

PACKAGE = "src/skinbake/gltf"

WRITING = "only where writing fails: `make faults` reaches it"
EXPLAINED = (
    ("output.py", "pthread_sigmask", "only on Windows"),
    ("output.py", "writev", "only on Windows"),
    ("resources.py", "os.name", "only on Windows"),
    ("output.py", "(*temporary, *created)", WRITING),
    ("output.py", "reversed(folders)", WRITING),
    ("output.py", "if written", "only where the system writes nothing and says so"),
    ("output.py", "os.W_OK", "root may write to every file; tests/gltf/test_output.py"),
    (
        "output.py",
        "samefile(target)",
        "a run never names its own buffer as target; tests/gltf/test_output.py",
    ),
    ("draco_stream.py", "soft <= limit", "only under a tighter limit of memory than the fuzzer sets"),
    ("draco_stream.py", "max(EXPANSION", "takes a stream that stands for 64 MiB; tests/gltf/test_draco.py"),
    ("draco_stream.py", "depth == 0", "the stream is read, `make fuzz` reaches it by target_draco"),
    ("draco_stream.py", "range(reader.varint())", "metadata of a stream: target_draco reaches it"),
    ("draco_stream.py", "range(0, 35, 7)", "a number that does not end: target_draco reaches it"),
    ("expansion.py", "max(RATIO", "takes 512 MiB of decoded bytes; tests/gltf/test_compression.py"),
    ("glb.py", "MAX_LENGTH", "takes an output of 4 GiB; tests/gltf/test_glb.py"),
    ("document.py", "if was_on", "the collector is on whenever a command runs"),
)
"""Branches that no damaged model reaches: the file, a part of the line, and why, or what else reaches it."""


def main() -> int:
    """Measure as the command line says; print the share, and each branch that was missed."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.branches", description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--corpus", type=Path)
    parser.add_argument("--log", type=Path, default=LOG)
    given = parser.parse_args()
    models = all_seeds(given.corpus)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begun = time.monotonic()
        whole = _measurement(folder / "imports")  # modules are imported here, before the children are made
        whole.start()
        plan = Plan(
            models, given.seed, given.minutes * 60, given.workers, finds=FINDS, around=_around(folder, whole)
        )
        totals = run_all(plan)
        whole.stop()
        whole.save()
        report = _report(folder)
    print("\n".join(lines(report)))
    share = report["totals"]
    seconds = time.monotonic() - begun
    note("branches", executions=totals.runs, seconds=seconds, seed=given.seed, finds=totals.finds,
         log=given.log, branches=share["num_branches"], covered=share["covered_branches"])  # fmt: skip
    return 0


def _measurement(file: Path) -> coverage.Coverage:
    return coverage.Coverage(
        data_file=str(file), branch=True, include=[f"{REPOSITORY}/{PACKAGE}/*"], config_file=False
    )


def _around(folder: Path, whole: coverage.Coverage) -> Callable[[Callable[[], None]], None]:
    def measured(work: Callable[[], None]) -> None:
        whole.stop()  # this child's copy of its parent's measurement
        own = _measurement(folder / f"child-{os.getpid()}")
        own.start()
        try:
            work()
        finally:
            own.stop()
            own.save()

    return measured


def _report(folder: Path) -> dict[str, dict[str, object]]:
    together = _measurement(folder / "together")
    together.combine([str(path) for path in folder.iterdir()])
    target = folder / "report.json"
    together.json_report(outfile=str(target), pretty_print=False)
    found: dict[str, dict[str, object]] = json.loads(target.read_text(encoding="utf-8"))
    return found


def lines(report: dict[str, dict[str, object]]) -> list[str]:
    """Return the share of branches, and each missed one with the line that it leaves."""
    found: list[str] = []
    explained: list[str] = []
    for file, content in sorted(report["files"].items()):
        missed = content["missing_branches"]  # type: ignore[index]
        source = Path(file).read_text(encoding="utf-8").splitlines()
        for start, end in missed:
            to = "the end" if end < 0 else f"line {end}"
            name, line = Path(file).name, source[start - 1].strip()
            why = next((why for of, part, why in EXPLAINED if of == name and part in line), None)
            where = f"  {name}:{start} to {to}: {line[:90]}"
            (found if why is None else explained).append(where if why is None else f"{where}   # {why}")
    totals = report["totals"]
    covered, branches = totals["covered_branches"], totals["num_branches"]
    share = 100 * covered / branches  # type: ignore[operator]
    return [
        f"{covered} of {branches} branches of {PACKAGE} reached: {share:.1f} %",
        f"{len(found)} missed:",
        *found,
        f"{len(explained)} missed, and why:",
        *explained,
    ]


if __name__ == "__main__":
    sys.exit(main())
