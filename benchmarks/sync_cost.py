"""Measure the wait of bake until its outputs are on the disk: a table, with ``--no-sync`` beside it.

``python -m benchmarks.sync_cost [FOLDER]`` works in a folder of FOLDER's disk, by default the current one.
CesiumMan is left out where there is no corpus. Times are whole processes', the least of some runs in turns.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.skinned_grid import grid_of, write_grid
from tests.support.corpus_folder import find_corpus

RUNS = 5
SMALL_FILES = 1000
FIXTURE = Path(__file__).parent.parent / "fixtures" / "seam.glb"


def main() -> None:
    place = sys.argv[1] if len(sys.argv) > 1 else os.curdir
    print(f"{'':<32}{'--no-sync':>11}{'default':>11}{'more':>9}{'':>8}{'a file':>11}")
    with tempfile.TemporaryDirectory(dir=place, prefix="sync-cost-") as folder:
        for name, count, runs, arguments in cases(Path(folder)):
            without, with_sync = timed(arguments, Path(folder), runs)
            more = with_sync - without
            print(
                f"{name:<32}{without:>9.3f} s{with_sync:>9.3f} s{more:>7.3f} s{more / without:>8.1%}"
                f"{more / count * 1e3:>8.2f} ms",
                flush=True,
            )


def cases(folder: Path) -> Iterator[tuple[str, int, int, list[str]]]:
    """Yield what is baked, how many files that are, how often, and the arguments."""
    corpus = find_corpus()
    if corpus is not None:
        yield "CesiumMan", 1, RUNS, [str(corpus / "public" / "CesiumMan" / "CesiumMan.glb")]
    grid = folder / "grid.glb"
    write_grid(grid, grid_of(1_000_000))
    yield "a grid of a million vertices", 1, RUNS, [str(grid)]
    small = folder / "small"
    small.mkdir()
    for number in range(SMALL_FILES):
        shutil.copyfile(FIXTURE, small / f"{number:04}.glb")
    for jobs in ("1", str(len(os.sched_getaffinity(0)))):
        yield f"{SMALL_FILES:,} small files, --jobs {jobs}", SMALL_FILES, 2, [str(small), "--jobs", jobs]


def timed(arguments: list[str], folder: Path, runs: int) -> tuple[float, float]:
    """Return the least seconds without and with waiting, run in turns."""
    found: dict[str, list[float]] = {"--no-sync": [], "": []}
    for _ in range(runs):
        for option, seconds in found.items():
            out = folder / "out"
            command = ["bake", *arguments, "--out-dir", str(out), "-q", *filter(None, [option])]
            os.sync()  # not to wait for what an earlier run has left
            start = time.perf_counter()
            subprocess.run([sys.executable, "-m", "skinbake", *command], check=True)
            seconds.append(time.perf_counter() - start)
            shutil.rmtree(out)
    return min(found["--no-sync"]), min(found[""])


if __name__ == "__main__":
    main()
