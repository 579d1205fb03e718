"""Measure what the imports of each command cost, and check them against budgets.

Usage: python -m benchmarks.import_cost [--runs N]

The command runs N times under ``python -X importtime``, which counts a module's own time without that of the
modules that it imports. A module counts with the least of its times. The milliseconds are larger than those
of an untold start, because counting takes time too; what counts is how they share it. A budget is no time of
this machine: it is the number of modules of our own, and their time as a multiple of the time of numpy (of
click, where a command needs no numpy) in the same runs. The exit code is 1 if a budget is exceeded.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.skinned_grid import grid_of, write_grid

RUNS = 5
FIXTURE = Path(__file__).parent.parent / "fixtures" / "seam.glb"
LIBRARIES = ("skinbake", "numpy", "scipy", "click", "rich")
LARGEST = 12
"""The modules that are listed, the largest of our own and of the rest."""


@dataclass(frozen=True)
class Budget:
    """The most modules of our own, and their time as a multiple of that of another library."""

    modules: int
    multiple: float
    of: str = "numpy"


@dataclass(frozen=True)
class Case:
    """A command, and what its imports may cost."""

    name: str
    arguments: tuple[str, ...]
    budget: Budget


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=RUNS)
    runs = parser.parse_args().runs
    excesses = []
    with tempfile.TemporaryDirectory() as folder:
        for case in cases(Path(folder)):
            found = least(case.arguments, runs)
            print("\n".join(table(case.name, found)), end="\n\n", flush=True)
            excesses += [f"{case.name}: {excess}" for excess in over(case.budget, found)]
    print("\n".join(excesses) or "within the budgets")
    sys.exit(1 if excesses else 0)


def cases(folder: Path) -> list[Case]:
    """Return the commands, their files made."""
    baked, large = folder / "baked.glb", folder / "large.glb"
    write_grid(large, grid_of(40_000))
    bake = ("bake", str(FIXTURE), "-o", str(baked), "-q", "--no-sync")
    return [
        Case("--help", ("--help",), Budget(8, 0.8, "click")),
        Case("bake", bake, Budget(120, 1.9)),
        Case(
            "bake of a surface for several threads",
            ("bake", str(large), "-o", str(folder / "out.glb"), "-q", "--no-sync", "--threads", "2"),
            Budget(120, 1.9),
        ),
        Case("verify", ("verify", str(baked), "--poses", "random:1", "-q"), Budget(124, 2.0)),
    ]


def least(arguments: tuple[str, ...], runs: int) -> dict[str, int]:
    """Return the least microseconds of each module that the command imports, without those it imports."""
    found: dict[str, int] = {}
    for _ in range(runs):
        # Without its cache of bytecode, Python would compile.
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        command = [sys.executable, "-X", "importtime", "-m", "skinbake", *arguments]
        said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stderr
        for name, micros in times(said).items():
            found[name] = min(micros, found.get(name, micros))
    return found


def times(said: str) -> dict[str, int]:
    """Return the microseconds of each module in what ``-X importtime`` says."""
    found = {}
    for line in said.splitlines():
        own, _, rest = line.removeprefix("import time:").partition("|")
        if line.startswith("import time:") and own.strip().isdecimal():
            found[rest.partition("|")[2].strip()] = int(own)
    return found


def by_library(found: Mapping[str, int]) -> Counter[str]:
    """Return the microseconds of each library, of Python's own modules together."""
    sums: Counter[str] = Counter()
    for name, micros in found.items():
        top = name.partition(".")[0]
        sums[top if top in LIBRARIES else "Python"] += micros
    return sums


def over(budget: Budget, found: Mapping[str, int]) -> list[str]:
    """Return a sentence for each part of a budget that is exceeded."""
    sums = by_library(found)
    own = [name for name in found if name.partition(".")[0] == "skinbake"]
    excesses = []
    if len(own) > budget.modules:
        excesses.append(f"{len(own)} modules of our own, at most {budget.modules} are wanted")
    multiple = sums["skinbake"] / max(sums[budget.of], 1)
    if multiple > budget.multiple:
        excesses.append(f"our own modules take {multiple:.2f} × {budget.of}, at most {budget.multiple}")
    return excesses


def table(name: str, found: Mapping[str, int]) -> list[str]:
    """Return the lines on a command: its libraries, and the modules that take longest."""
    sums, counts = by_library(found), by_library(dict.fromkeys(found, 1))
    lines = [f"skinbake {name}: {sum(sums.values()) / 1e3:.1f} ms in {len(found)} modules"]
    lines += [f"  {library:<10}{sums[library] / 1e3:>8.1f} ms{counts[library]:>5}" for library in sums]
    for title, is_own in (("our own", True), ("others", False)):
        own = [module for module in found if (module.partition(".")[0] == "skinbake") is is_own]
        own.sort(key=lambda module: -found[module])
        largest = ", ".join(f"{module} {found[module] / 1e3:.1f}" for module in own[:LARGEST])
        lines.append(f"  {title}: {largest}")
    return lines


if __name__ == "__main__":
    main()
