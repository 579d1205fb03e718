"""Time verify by one truth and by both: 34,000 vertices in 200 random poses, on one thread.

Usage: python -m benchmarks.truth_cost [--vertices N] [--poses P] [--runs N]

``verify`` always measures by both truths; here one is taken out. Prints the least processor seconds of the
measuring, without start-up, reading and the check of α and β, and what both truths cost beside each alone.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import skinbake
from benchmarks.skinned_grid import grid_of, grid_vertices, write_grid
from skinbake.choices import Method, Truth
from skinbake.lighting.angles import lighting_errors, truths_at_rest

CHOICES: dict[str, Sequence[Truth]] = {**{str(truth): (truth,) for truth in Truth}, "both": tuple(Truth)}


def main() -> None:
    """Print the seconds and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--vertices", type=grid_vertices, default=34_000)
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        grid, baked = Path(folder, "grid.glb"), Path(folder, "baked.glb")
        write_grid(grid, grid_of(options.vertices))
        skinbake.bake(grid, baked)
        for method in Method:
            seconds = {name: float("inf") for name in CHOICES}
            for _ in range(options.runs):
                for name, truths in CHOICES.items():
                    with only(truths), timed() as spent:
                        skinbake.verify(
                            baked, methods=[method], poses="random", samples=options.poses, threads=1
                        )
                    seconds[name] = min(seconds[name], sum(spent))
            taken = ", ".join(f"{name} {found:.2f} s" for name, found in seconds.items())
            ratios = ", ".join(f"{seconds['both'] / seconds[truth]:.2f} x {truth} alone" for truth in Truth)
            print(f"{method}: {taken}; both are {ratios}")


@contextmanager
def only(truths: Sequence[Truth]) -> Iterator[None]:
    """Let verify measure by these truths alone."""
    with patch("skinbake.lighting.measured.truths_at_rest", partial(truths_at_rest, names=truths)):
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

    with patch("skinbake.lighting.measured.lighting_errors", measured):
        yield spent


if __name__ == "__main__":
    main()
