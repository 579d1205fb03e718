"""Time bakes with and without the guard, whole processes in turn, and print the guard's share.

Usage: python -m benchmarks.guard_cost MODEL [--rounds N]

The share is the median over the rounds of (with − without) / without.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.processes import SKINBAKE, Command, Rounds, in_turn

UNGUARDED = """
import skinbake.commands.bake as command
from skinbake.cli.main import main
command._guarded = lambda document, surfaces, made, settings: (list(made), [])
raise SystemExit(main())
"""


def main() -> None:
    """Measure, and print a line."""
    parser = argparse.ArgumentParser(usage="%(prog)s MODEL [--rounds N]")
    parser.add_argument("model", type=Path)
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    with TemporaryDirectory(prefix="skinbake-bench-") as folder:
        words = ["bake", given.model, "-o", Path(folder, "baked.glb"), "--no-sync"]
        commands: dict[str, Command] = {
            "with": [*SKINBAKE, *words],
            "without": [sys.executable, "-c", UNGUARDED, *words],
        }
        taken = in_turn(commands, Rounds(least=given.rounds, most=given.rounds))
    pairs = list(zip(taken["with"]["seconds"], taken["without"]["seconds"], strict=True))
    share = statistics.median(with_guard / without - 1.0 for with_guard, without in pairs)
    seconds = statistics.median(without for _, without in pairs)
    print(f"{given.model.name}: {share:+.1%} of {seconds:.2f} s without the guard, {len(pairs)} rounds")


if __name__ == "__main__":
    main()
