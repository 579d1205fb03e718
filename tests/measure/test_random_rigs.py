"""The promise of the default bake on random rigs: no clip is lit worse than by standard lighting."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import skinbake
from tests.measure import random_rigs
from tests.support.baked_files import verify
from tests.support.baking import bake_file

OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {"encoding": "packed8"},
    {"neighbours": "extend"},
    {"neighbours": "drop"},
)

LEFT = 12
"""How many of 300 rigs may stay unbaked, because each part of α and β lights them worse."""


def lit(seed: int, folder: Path) -> str:
    """Return how a rig is lit: ``left`` unbaked, ``worse`` by over 1 % and 0.1° by either truth, or ``well``.

    It is lit at times that no bake saw.
    """
    source, target = random_rigs.write(seed, folder), folder / "baked.glb"
    status = bake_file(source, target, **OPTIONS[seed // 6 % len(OPTIONS)]).status
    if status != "baked":
        assert status == "left"
        skinbake.strip(target, folder / "stripped.glb")
        assert (folder / "stripped.glb").read_bytes() == source.read_bytes()
        return "left"
    answer = verify(target, "--method", "lbs", "--samples", "31")
    assert answer.exit_code == 0, seed
    (primitive,) = answer.file["primitives"]
    errors = [primitive[truth]["lbs"] for truth in ("normals_by_triangles", "normals_by_tangents")]
    pairs = [(one["accurate"]["mean"], one["standard"]["mean"]) for one in errors]
    is_worse = any(own > 1.01 * standard and own - standard > 0.1 for own, standard in pairs)
    return "worse" if is_worse else "well"


@pytest.mark.slow
def test_no_random_rig_is_lit_worse_than_standard_and_few_stay_unbaked(tmp_path: Path) -> None:
    found = {seed: lit(seed, tmp_path) for seed in range(300)}
    assert [seed for seed in found if found[seed] == "worse"] == []
    assert 0 < list(found.values()).count("left") <= LEFT
