"""The benchmark that takes one truth out of verify."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

import skinbake
from benchmarks.peers import REPOSITORY
from benchmarks.skinned_grid import grid_of, write_grid
from benchmarks.truth_cost import CHOICES, only, timed, whole_process
from skinbake.choices import USUAL_TRUTHS, Truth

FIGURES = {Truth.TRIANGLES: "normals_by_triangles", Truth.TANGENTS: "normals_by_tangents"}


@pytest.mark.slow
def test_a_truth_measures_the_same_without_the_other(tmp_path: Path) -> None:
    grid, baked = tmp_path / "grid.glb", tmp_path / "baked.glb"
    write_grid(grid, grid_of(64))
    skinbake.bake(grid, baked)

    def verified() -> dict[str, Any]:
        return skinbake.verify(baked, methods=["lbs"], poses="random", samples=3)

    whole = verified()
    for truth, other in zip(USUAL_TRUTHS, reversed(USUAL_TRUTHS), strict=True):
        with only([truth]), timed() as spent:
            alone = verified()
        measured, alike = alone[FIGURES[truth]]["lbs"], whole[FIGURES[truth]]["lbs"]
        del measured["direct"]  # by the first truth of all
        assert measured == {name: alike[name] for name in measured}
        assert not alone[FIGURES[other]]
        assert min(spent) > 0  # those of other bakes too, as this one gains little
    assert verified() == whole


@pytest.mark.slow
def test_a_whole_process_measures_by_the_truths_that_it_names(tmp_path: Path) -> None:
    grid, baked = tmp_path / "grid.glb", tmp_path / "baked.glb"
    write_grid(grid, grid_of(64))
    skinbake.bake(grid, baked)
    for choice, truths in CHOICES.items():
        command = [*whole_process(choice, "LBS", 3, baked), "--json"]
        done = subprocess.run(command, capture_output=True, check=True, cwd=REPOSITORY)
        (file,) = json.loads(done.stdout)["files"]
        assert [truth for truth in USUAL_TRUTHS if file[FIGURES[truth]]] == list(truths)
