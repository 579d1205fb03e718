"""Whole processes, measured in turn: wall time and peak memory of commands that do the same work."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Command = Sequence[str | Path]
Json = dict[str, Any]

LAUNCHER = [sys.executable, "-I", "-S", str(Path(__file__).with_name("launch.py"))]
SKINBAKE = [str(Path(sys.executable).with_name("skinbake"))]
MIB = 1 << 20
NOT_INHERITED = {"PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED", "PYTHONPATH", "PYTHONPROFILEIMPORTTIME"}
"""A variable that a developer's shell may have set and a user's has not: users keep their bytecode."""


@dataclass(frozen=True)
class Run:
    """One run of a command: seconds, MiB of its largest process, and what it printed."""

    seconds: float
    mib: float
    printed: str


@dataclass(frozen=True)
class Rounds:
    """How often commands run in turn: ``least`` rounds, then up to ``most`` while ``budget`` seconds last.

    The first round, which fills caches, does not count where ``warm_up`` is set.
    """

    least: int = 3
    most: int = 15
    budget: float = 30.0
    warm_up: bool = True


def run(command: Command, *, one_core: bool = False) -> Run:
    """Run a command to its end; raise SystemExit with what it said where it fails.

    The disk first gets what earlier runs wrote, so that no run pays for another.
    """
    words = [str(word) for word in command]
    os.sync()
    process = subprocess.run(
        [*LAUNCHER, *(["--one-core"] if one_core else []), *words],
        env={name: value for name, value in os.environ.items() if name not in NOT_INHERITED},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(words)} failed ({process.returncode}):\n{process.stderr.strip()}")
    printed, _, figures = process.stdout.rstrip("\n").rpartition("\n")
    seconds, peak = figures.split()
    return Run(float(seconds), int(peak) / MIB, printed)


def run_at_real_time() -> None:
    """Let commands run before all other work of this machine, from now on. It takes Linux and privileges."""
    LAUNCHER[:0] = ["chrt", "-f", "10"]


def in_turn(commands: Mapping[str, Command], rounds: Rounds) -> Json:
    """Run commands in turn, so that a machine that slows down slows all; return each one's figures.

    Figures are ``seconds`` and ``mib``, one of each for every round that counted.
    """
    if rounds.warm_up:
        for command in commands.values():
            run(command)
    taken: dict[str, list[Run]] = {name: [] for name in commands}
    start = time.perf_counter()
    for number in range(rounds.most):
        if number >= rounds.least and time.perf_counter() - start > rounds.budget:
            break
        for name, command in commands.items():
            taken[name].append(run(command))
    return {name: figures(runs) for name, runs in taken.items()}


def figures(runs: Sequence[Run]) -> Json:
    """Return the figures of one command's runs."""
    return {
        "seconds": [round(each.seconds, 4) for each in runs],
        "mib": [round(each.mib, 1) for each in runs],
    }


def median(measured: Json, what: str = "seconds") -> float:
    """Return the median of one command's figures."""
    return float(statistics.median(measured[what]))
