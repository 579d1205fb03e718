"""Time two builds of the loops of bake in turn, on the surfaces of models, and compare their results.

Usage: python -m benchmarks.loops_in_turn BEFORE.so AFTER.so MODEL... [--rounds N]

The builds are of ``gradients/_kernel.c``. A line has a surface, the nanoseconds a vertex by both builds, how
many times as fast the second is, and the number of α and β that differ. Times are those of the processor on
one thread, and medians of rounds.

What was tried in place of these loops, on one AMD EPYC, by GCC 12. They take 22 % of the processor's time of
a bake of 1,000,000 vertices: twice as fast, a bake by two threads would take 0.9 of its time.

- One text, compiled for one class and for four of them in lanes of AVX2, without the table of neighbours.
  Lanes took classes around which all vertices name the same joints in the same order. The grid was 1.24 times
  as fast. Characters of 3,000 vertices and more, but rigid ones, were 0.54 to 0.95 times as fast: files order
  joints by weight, so of the classes whose weights vary only 9 to 56 % are of that kind.
- The same by sets of joints, in any order. Then 76 to 95 % of these classes find three others, but to find
  the sets, and to bring weights into their order, took what lanes saved: the grid 0.88, characters 0.58 to
  1.25.
- A look whether weights vary, before the table of neighbours is made: 1.4 to 1.7 where few do, else 0.9 to
  1.07.
"""

from __future__ import annotations

import argparse
import statistics
import time
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np

from skinbake.commands.bake import Baker
from skinbake.gradients import by_loops, kernel
from skinbake.gradients.surface import Surface, SurfaceSlots
from skinbake.threads import threads_limited

LEAST = 3_000
"""The vertices of the smallest surface that is timed."""

VERTICES = 100_000
"""The vertices that each build bakes in a round, at least."""


def loops_of(library: Path) -> ModuleType:
    """Return the module of a build."""
    loader = ExtensionFileLoader("_kernel", str(library.resolve()))
    specification = spec_from_loader("_kernel", loader)
    assert specification is not None
    return module_from_spec(specification)


def surfaces_of(model: Path) -> list[tuple[Surface, dict[str, Any]]]:
    """Return the larger surfaces that a bake of the model has, and how it bakes them."""
    found = []

    def bake_surface(surface: Surface, **options: Any) -> SurfaceSlots:
        if len(surface.positions) >= LEAST:
            found.append((surface, options))
        return by_loops.bake_surface(surface, **options)

    with TemporaryDirectory() as folder, patch.object(kernel, "bake_surface", bake_surface):
        Baker().bake_file(str(model), str(Path(folder, "baked.glb")))
    return found


def main() -> None:
    """Print a line for each surface."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.loops_in_turn")
    parser.add_argument("builds", nargs=2, type=Path, metavar="BUILD")
    parser.add_argument("models", nargs="+", type=Path, metavar="MODEL")
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    builds = [loops_of(library) for library in given.builds]
    for model in given.models:
        for surface, options in surfaces_of(model):
            count = len(surface.positions)
            repeats = range(-(-VERTICES // count))
            seconds: list[list[float]] = [[], []]
            slots: list[SurfaceSlots] = []
            for turn in range(2 * (given.rounds + 1)):
                which = (turn + turn // 2) % 2
                with threads_limited(1), patch.object(by_loops, "loops", builds[which]):
                    start = time.process_time()
                    for _ in repeats:
                        found = by_loops.bake_surface(surface, **options)
                    taken = time.process_time() - start
                slots = [*slots[-1:], found]
                if turn > 1:  # the first round warms up
                    seconds[which].append(taken / len(repeats))
            before, after = (statistics.median(each) for each in seconds)
            faster = statistics.median(one / other for one, other in zip(*seconds, strict=True))
            differ = sum(
                np.count_nonzero(getattr(slots[0], name) != getattr(slots[1], name))
                for name in ("alpha", "beta")
            )
            both = f"{1e9 * before / count:.0f}, {1e9 * after / count:.0f} ns a vertex"
            print(f"{model.name}, {count:,} vertices: {both}, {faster:.2f} times as fast, {differ} differ")


if __name__ == "__main__":
    main()
