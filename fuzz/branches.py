"""Tell which branches of skinbake's readers are reached: ``python -m fuzz.branches --minutes 2``.

By damaged models and by injected faults together. Coverage is measured in the children that run the cases,
which costs most of the speed. A branch that is missed is an error, unless its line says why: ``# pragma: no
cover``, or ``no branch``, and what keeps the fuzzer from it or the tests that reach it.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fuzz.aimed import aimed_cases
from fuzz.batches import FINDS, Plan, run_all
from fuzz.log import LOG, note
from fuzz.measuring import PACKAGES, REPOSITORY, SOURCE, measured, measurement
from fuzz.seeds import all_seeds


def main() -> int:
    """Measure as the command line says; print the share, and each branch that was missed."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.branches", description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--corpus", type=Path)
    parser.add_argument("--every", type=int, default=1, help="Inject faults only at each so-many-th call.")
    parser.add_argument(
        "--keep", type=Path, help="Keep the measurements here, and count those that are here."
    )
    parser.add_argument("--log", type=Path, default=LOG)
    given = parser.parse_args()
    models = all_seeds(given.corpus)
    with tempfile.TemporaryDirectory() as name:
        folder = given.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        begun = time.monotonic()
        faults = _faults(folder, given.every)
        whole = measurement(folder / f"imports-{given.seed}")  # before the children are made
        whole.start()
        plan = Plan(
            models, given.seed, given.minutes * 60, given.workers, finds=FINDS, around=_around(folder, whole),
            aimed=aimed_cases(models),
        )  # fmt: skip
        totals = run_all(plan)
        whole.stop()
        whole.save()
        report = _report(folder, Path(name, "report"))
    covered, count = (report["totals"][name] for name in ("covered_branches", "num_branches"))
    parts = " and ".join(f"{SOURCE}/{package}" for package in PACKAGES)
    print(f"{covered} of {count} branches of {parts} reached: {100 * covered / count:.1f} %")
    wrong = missed(report)
    print("\n".join(wrong))
    seconds = time.monotonic() - begun
    runs, faults = _tallied(given.keep, totals.runs, faults)
    note("branches", executions=runs, seconds=seconds, seed=given.seed, finds=totals.finds,
         log=given.log, branches=count, covered=covered, faults=faults)  # fmt: skip
    return 1 if wrong else 0


def _tallied(kept: Path | None, runs: int, faults: int) -> tuple[int, int]:
    """Return how many runs and faults are behind the measurements, those kept from before among them."""
    if kept is None:
        return runs, faults
    file = kept.with_name(f"{kept.name}.tally.json")
    before = json.loads(file.read_text(encoding="utf-8")) if file.exists() else [0, 0]
    file.write_text(json.dumps([before[0] + runs, before[1] + faults]), encoding="utf-8")
    return before[0] + runs, before[1] + faults


def _faults(folder: Path, every: int) -> int:
    """Inject faults with measured children; return how many."""
    if every < 1:
        return 0
    with tempfile.TemporaryDirectory() as name:
        log = Path(name, "log")
        subprocess.run(
            [
                sys.executable,
                "-m",
                "fuzz.faults",
                "--every",
                str(every),
                "--coverage",
                str(folder),
                "--log",
                log,
            ],
            cwd=REPOSITORY,
            stdout=subprocess.DEVNULL,
            check=False,
        )
        return int(json.loads(log.read_text())["executions"]) if log.exists() else 0


def _around(folder: Path, whole: Any) -> Callable[[Callable[[], None]], None]:
    def around(work: Callable[[], None]) -> None:
        whole.stop()  # this child's copy of its parent's measurement
        measured(work, folder)

    return around


def _report(folder: Path, scratch: Path) -> dict[str, Any]:
    together = measurement(scratch / "together")
    scratch.mkdir()
    copies = [shutil.copy(path, scratch / f"copy-{path.name}") for path in folder.iterdir() if path.is_file()]
    together.combine([str(path) for path in copies])
    target = scratch / "report.json"
    together.json_report(outfile=str(target), pretty_print=False)
    found: dict[str, Any] = json.loads(target.read_text(encoding="utf-8"))
    return found


def missed(report: Mapping[str, Any]) -> list[str]:
    """Return a line for each branch that was missed, unless its line is marked."""
    found = []
    for file, content in sorted(report["files"].items()):
        source = Path(REPOSITORY, file).read_text(encoding="utf-8").splitlines()
        for start, end in sorted(content["missing_branches"]):
            goal = source[end - 1].strip() if end > 0 else "the end"
            found.append(f"{file}:{start} is missed: {source[start - 1].strip()} -> {goal}")
    return found


if __name__ == "__main__":
    sys.exit(main())
