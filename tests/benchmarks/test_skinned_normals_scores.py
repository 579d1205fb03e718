"""docs/scores.md has the scores that engines get here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import skinned_normals_scores as scores
from skinbake.commands.bake import bake_file
from tests.support.node import require_node

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("kind", ["stock", "adapter"])
def test_the_page_has_the_scores_of_three(kind: str, tmp_path: Path) -> None:
    require_node("three")
    engine = scores.ENGINES[0]
    path = tmp_path / "stock.glb"
    path.write_bytes(scores.packed())
    if kind == "adapter":
        bake_file(str(path), str(tmp_path / "adapter.glb"))
        path = tmp_path / "adapter.glb"
    found = scores.scores(engine, kind, path, tmp_path)
    lines = (scores.REPOSITORY / "docs" / "scores.md").read_text("utf-8").splitlines()
    start = next(at for at, line in enumerate(lines) if line.startswith(f"| {engine.title} "))
    cells = lines[start + scores.KINDS.index(kind)].split(" | ")
    assert cells[1] == kind
    np.testing.assert_allclose(found, np.array(cells[2:-1], np.float64), atol=0.011)
