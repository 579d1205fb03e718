"""Time verify by one truth and by both: 34,000 vertices in 200 random poses.

Usage: python -m benchmarks.truth_cost [--vertices N] [--poses P] [--runs N]

``verify`` always measures by both truths; here one is taken out. Prints the seconds of whole processes,
start-up included, and the least processor seconds of the measuring alone: on one thread, without start-up,
reading and the check of α and β. Each line says what both truths cost beside each alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import skinbake
from benchmarks.processes import SKINBAKE, Command, Rounds, in_turn, median
from benchmarks.skinned_grid import grid_of, grid_vertices, write_grid
from skinbake.choices import USUAL_TRUTHS, Method, Truth
from skinbake.measure.angles import lighting_errors
from skinbake.truth.truths import truths_at_rest

BOTH = "both"
MEASURED = (Method.LBS, Method.DQS)
METHODS = {"both methods": [], **{method.upper(): ["--method", str(method)] for method in MEASURED}}
"""The options of verify by the name of its methods: without one, by both."""

CHOICES: dict[str, Sequence[Truth]] = {
    **{str(truth): (truth,) for truth in USUAL_TRUTHS},
    BOTH: USUAL_TRUTHS,
}


def main() -> None:
    """Print the seconds and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--vertices", type=grid_vertices, default=34_000)
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--runs", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        grid, baked = Path(folder, "grid.glb"), Path(folder, "baked.glb")
        write_grid(grid, grid_of(options.vertices))
        skinbake.bake(grid, baked)
        for methods in METHODS:
            commands = {name: whole_process(name, methods, options.poses, baked) for name in CHOICES}
            runs = in_turn(commands, Rounds(least=options.runs, most=options.runs))
            print(f"{methods}, whole processes: {told({name: median(runs[name]) for name in CHOICES})}")
        for method in MEASURED:
            measured = measuring(baked, method, options.poses, options.runs)
            print(f"{method.upper()}, measuring alone: {told(measured)}")


def told(seconds: Mapping[str, float]) -> str:
    """Return the seconds of each choice of truths, and what both cost beside each alone."""
    taken = ", ".join(f"{name} {found:.2f} s" for name, found in seconds.items())
    ratios = ", ".join(f"{seconds[BOTH] / seconds[truth]:.2f} x {truth} alone" for truth in USUAL_TRUTHS)
    return f"{taken}; both are {ratios}"


def whole_process(truths: str, methods: str, poses: int, baked: Path) -> Command:
    """Return the command that verifies a baked file by one truth or by both, in random poses.

    methods is a name of ``METHODS``.
    """
    arguments: Command = ["verify", "-q", baked, "--poses", f"random:{poses}", *METHODS[methods]]
    if truths == BOTH:
        return [*SKINBAKE, *arguments]
    return [sys.executable, "-m", "benchmarks.one_truth", truths, *arguments]


def measuring(baked: Path, method: Method, poses: int, runs: int) -> dict[str, float]:
    """Return the least processor seconds of the measuring by each choice of truths."""
    seconds = {name: float("inf") for name in CHOICES}
    for _ in range(runs):
        for name, truths in CHOICES.items():
            with only(truths), timed() as spent:
                skinbake.verify(baked, methods=[method], poses="random", samples=poses, threads=1)
            seconds[name] = min(seconds[name], sum(spent))
    return seconds


@contextmanager
def only(truths: Sequence[Truth]) -> Iterator[None]:
    """Let verify measure by these truths alone."""
    with patch("skinbake.measure.measured.truths_at_rest", partial(truths_at_rest, names=truths)):
        yield


@contextmanager
def timed() -> Iterator[list[float]]:
    """Collect the processor seconds of each measured mesh."""
    spent: list[float] = []

    def measured(*arguments: Any, **options: Any) -> float:
        start = time.process_time()
        found = lighting_errors(*arguments, **options)
        spent.append(time.process_time() - start)
        return found

    with patch("skinbake.measure.measured.lighting_errors", measured):
        yield spent


if __name__ == "__main__":
    main()
