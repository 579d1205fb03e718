"""Bones that move or scale tilt a surface without a turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import skinbake
from benchmarks.squash_and_stretch import END, MODELS, START, errors, table
from fixtures.make_fixtures import FOLDER
from tests.support import khronos
from tests.support.whole_fields import angular_errors

NAMES = [name for name in MODELS.values() if "/" in name]


@pytest.mark.parametrize("name", NAMES)
def test_standard_lighting_is_degrees_off_and_accurate_lighting_is_not(name: str) -> None:
    standard, accurate = errors(FOLDER / name)
    assert standard > 3.0
    assert accurate < 0.1


def test_a_pushed_plane_has_the_normals_of_its_formula(tmp_path: Path) -> None:
    """z = d exp(−(x² + y²) / h²) when the bone has moved by d."""
    path = tmp_path / "moved.glb"
    skinbake.bake(FOLDER / NAMES[0], path)
    [posed] = skinbake.normals(path, time=0.5)
    # The height at the middle is the distance by which the bone has moved.
    x, y, z = posed.positions.T.astype(float)
    slope = 2.0 * z / 0.35**2
    expected = np.stack([slope * x, slope * y, np.ones_like(x)], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    apart = {name: angular_errors(posed.normals[name], expected) for name in ("standard", "accurate")}
    assert z.max() > 0.5
    assert apart["standard"].max() > 50.0
    assert apart["accurate"].max() < 2.0


@pytest.mark.parametrize("name", NAMES)
def test_the_validator_finds_nothing(name: str) -> None:
    report = khronos.validate(FOLDER / name)
    assert (report["errors"], report["warnings"]) == ([], [])


def test_the_table_stands_in_the_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "why.md").read_text("utf-8")
    rows = page.partition(START)[2].partition(END)[0].strip().splitlines()
    assert [row.split("|")[1] for row in rows] == [row.split("|")[1] for row in table()]
