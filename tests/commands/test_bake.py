"""How often ``bake`` does its work: a primitive is baked once, and once more for what a limit costs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.choices import Encoding
from skinbake.commands import surface_bake
from skinbake.format.encodings import GradientFormat
from skinbake.gradients import baker
from tests.support.baking import bake_file

PACKED8 = GradientFormat(Encoding.PACKED8)


@pytest.mark.parametrize(
    "options", [{}, {"storage": PACKED8}, {"limit_influences": 4}, {"limit_influences": 8}], ids=str
)
def test_a_surface_is_baked_once(
    options: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []
    original = baker.bake_primitives

    def counted(primitives: Sequence[Any], *how: Any) -> Any:
        calls.append(len(primitives))
        return original(primitives, *how)

    monkeypatch.setattr(surface_bake, "bake_primitives", counted)
    result = bake_file(str(FOLDER / "two_sets.glb"), str(tmp_path / "out.glb"), **options)
    assert result.status == "baked"
    assert len(calls) == 1
