"""A file cannot have verify measure many vertices in many clips: both grow with its bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.growth import many_clips
from skinbake.gltf import budget as budgets
from tests.support.command_line import invoke


def test_vertices_times_clips_are_bounded_by_the_bytes_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, baked = tmp_path / "m.glb", tmp_path / "b.glb"
    many_clips(1 << 14).written(source)  # 63 clips, of which each gets 3 poses, and 100 vertices
    assert invoke("bake", source, "-o", baked).exit_code == 0
    monkeypatch.setattr(budgets, "FREE", 0)
    monkeypatch.setattr(budgets, "RATIO", 200)
    result = invoke("verify", baked)
    assert result.exit_code == 3, result.output
    assert "measuring it in all clips would take" in result.stderr
    monkeypatch.setattr(budgets, "RATIO", 2048)
    assert invoke("verify", baked).exit_code == 0
    assert invoke("verify", baked, "--samples", "9").exit_code == 0  # what an option adds is free
