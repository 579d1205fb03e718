"""Two builds of the loops of bake are timed on the same surfaces, and their results compared."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from benchmarks import loops_in_turn
from benchmarks.skinned_grid import Grid, write_grid
from skinbake.gradients import kernel
from tests.support.strictness import missing_tool


@pytest.mark.slow
def test_a_build_gives_what_it_gave_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not kernel.IS_COMPILED:
        missing_tool("skinbake was installed without its compiled loops")
    from skinbake.gradients import _kernel

    build, model = str(_kernel.__file__), tmp_path / "grid.glb"
    write_grid(model, Grid(50, 80))
    monkeypatch.setattr(sys, "argv", ["loops_in_turn", build, build, str(model), "--rounds", "1"])
    loops_in_turn.main()
    printed = capsys.readouterr().out
    times = r"grid.glb, 4,000 vertices: (\d+), (\d+) ns a vertex, \d+\.\d\d times as fast, 0 differ\n"
    found = re.fullmatch(times, printed)
    assert found is not None, printed
    assert min(int(figure) for figure in found.groups()) > 0
