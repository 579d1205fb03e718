"""Time `skinbake bake` as a whole process, against glTF-Transform on the same files in the same run.

Usage: python -m benchmarks.bake_speed [--runs N] [--vertices N] [MODEL ...]

Without models a fixture is baked. A grid of --vertices skinned vertices (a million by default) is made for
the occasion. The peer is `gltf-transform tangents`, which also computes one attribute a vertex from the
surface; it is taken from tests/support (npm ci --prefix tests/support), and left out where it is not there.
Commands take turns, so that a machine that slows down slows both. Prints medians, and the ratio of medians.
"""

from __future__ import annotations

import argparse
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.skinned_grid import glb_bytes, grid_arrays
from skinbake import __version__

ROOT = Path(__file__).parents[1]
PEER = ROOT / "tests/support/node_modules/.bin/gltf-transform"


def seconds(command: Sequence[str]) -> float:
    """Return the wall time of one run of a command; it must succeed."""
    start = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - start


def medians(commands: Sequence[Sequence[str]], runs: int) -> list[float]:
    """Return the median time of each command over ``runs`` rounds, in turn, after one warm-up round."""
    rounds = [[seconds(command) for command in commands] for _ in range(runs + 1)]
    return [statistics.median(times) for times in zip(*rounds[1:], strict=True)]


def row(name: str, model: Path, output: Path, runs: int) -> str:
    """Return one line of the table."""
    bake = [
        sys.executable,
        "-m",
        "skinbake",
        "bake",
        "-q",
        str(model),
        "-o",
        str(output / f"bake{model.suffix}"),
    ]
    peer = [str(PEER), "tangents", str(model), str(output / f"peer{model.suffix}")]
    size = model.stat().st_size / 1e6
    if not PEER.exists():
        return f"{name:<28}{size:>9.1f}{medians([bake], runs)[0]:>11.2f}{'—':>12}{'—':>9}"
    ours, theirs = medians([bake, peer], runs)
    return f"{name:<28}{size:>9.1f}{ours:>11.2f}{theirs:>12.2f}{ours / theirs:>9.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", nargs="*", type=Path, default=[ROOT / "fixtures/bent_tube.glb"])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--vertices", type=int, default=1_000_000)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="skinbake-bench-"))
    try:
        grid = folder / "grid.glb"
        grid.write_bytes(glb_bytes(grid_arrays(round(arguments.vertices**0.5))))
        print(
            f"skinbake {__version__}, Python {platform.python_version()}, numpy {np.__version__}, "
            f"{platform.machine()}, median of {arguments.runs} whole processes, seconds"
        )
        print(f"{'model':<28}{'MB':>9}{'bake':>11}{'tangents':>12}{'ratio':>9}")
        for model in arguments.models:
            print(row(model.name, model, folder, arguments.runs))
        print(row(f"grid of {arguments.vertices:,} vertices", grid, folder, arguments.runs))
        (help_time,) = medians([[sys.executable, "-m", "skinbake", "--help"]], arguments.runs)
        print(f"{'--help':<28}{'':>9}{help_time:>11.2f}")
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
