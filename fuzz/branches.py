"""Tell which branches of skinbake's readers are reached: ``python -m fuzz.branches --minutes 2``.

By damaged models and by injected faults together. Coverage is measured in the children that run the cases,
which costs most of the speed. A branch that is missed without an explanation in ``explained.py`` is an error,
and so is an explanation of a branch that is reached or is not there.
"""

from __future__ import annotations

import argparse
import ast
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fuzz.aimed import aimed_cases
from fuzz.batches import FINDS, Plan, run_all
from fuzz.explained import BY_SYSTEM, EXPLAINED, SELDOM
from fuzz.log import LOG, note
from fuzz.measuring import PACKAGES, REPOSITORY, SOURCE, measured, measurement
from fuzz.seeds import all_seeds

Branch = tuple[str, str, str]
"""The file below the package, the function, and the two lines that a branch leads from and to."""

KEYS = (("executed_branches", True), ("missing_branches", False))


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
    reached, missed = branches(report)
    found, wrong = judged(reached, missed, EXPLAINED)
    print("\n".join([*found, *(f"ERROR: {line}" for line in wrong)]))
    seconds = time.monotonic() - begun
    runs, faults = _tallied(given.keep, totals.runs, faults)
    note("branches", executions=runs, seconds=seconds, seed=given.seed, finds=totals.finds,
         log=given.log, branches=len(reached) + len(missed), covered=len(reached), faults=faults,
         explained=len(missed.keys() & EXPLAINED.keys()))  # fmt: skip
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


def branches(report: Mapping[str, Any]) -> tuple[dict[Branch, str], dict[Branch, str]]:
    """Return the branches that were reached and those that were missed, each with where it is.

    A branch is told by its function and the text of its lines: numbers change with each edit. The second of
    one function with the same text has ``#2`` behind it.
    """
    found: tuple[dict[Branch, str], dict[Branch, str]] = {}, {}
    for file, content in sorted(report["files"].items()):
        text = Path(REPOSITORY, file).read_text(encoding="utf-8")
        source, functions = text.splitlines(), _functions(ast.parse(text))
        name = Path(file).as_posix().partition(f"{SOURCE}/")[2]
        known = [(*arc, reached) for key, reached in KEYS for arc in content[key]]
        times: Counter[Branch] = Counter()
        for start, end, reached in sorted(known):
            goal = source[end - 1].strip() if end > 0 else "the end"
            function = next((of for first, last, of in functions if first <= start <= last), "")
            branch = name, function, f"{source[start - 1].strip()} -> {goal}"
            times[branch] += 1
            if times[branch] > 1:
                branch = (*branch[:2], f"{branch[2]} #{times[branch]}")
            found[0 if reached else 1][branch] = f"{name}:{start}"
    return found


def _functions(tree: ast.Module) -> list[tuple[int, int, str]]:
    """Return the lines and names of all functions, the innermost first."""
    found = [
        (node.lineno, node.end_lineno or node.lineno, node.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    return sorted(found, key=lambda each: each[0] - each[1], reverse=True)


def judged(
    reached: Mapping[Branch, str], missed: Mapping[Branch, str], explained: Mapping[Branch, str]
) -> tuple[list[str], list[str]]:
    """Return what to print, and what is wrong: branches without an explanation, explanations without one."""
    count = len(reached) + len(missed)
    parts = " and ".join(f"{SOURCE}/{package}" for package in PACKAGES)
    lines = [f"{len(reached)} of {count} branches of {parts} reached: {100 * len(reached) / count:.1f} %"]
    known = [branch for branch in missed if branch in explained]
    lines += [f"{len(known)} missed, and why:"] if known else []
    lines += [f"  {missed[branch]}: {branch[2]}   # {explained[branch]}" for branch in known]
    wrong = [
        f"{where} is missed, and nothing explains it: {branch!r}"
        for branch, where in missed.items()
        if branch not in explained
    ]
    wrong += [
        f"explained, but reached: {branch!r}"
        for branch, reason in explained.items()
        if branch in reached and reason not in BY_SYSTEM and not reason.startswith(SELDOM)
    ]
    wrong += [
        f"explained, but not there: {branch!r}"
        for branch in explained
        if branch not in reached and branch not in missed
    ]
    return lines, wrong


if __name__ == "__main__":
    sys.exit(main())
