"""Writers that hold every number as a double spell 3 as 3.0: such a file is read like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.choices import Gradients, Scheme
from skinbake.gltf.writing.recode import Compression
from tests.support.baked_files import Editable, verify
from tests.support.gltf_reading import read
from tests.support.models import FIXTURES, FOLDER, SHARED, baked, edited, rewritten, stripped

GLBS = [name for name in FIXTURES if name != SHARED]


def with_fractions(value: Any) -> Any:
    """Return a JSON value with 3.0 for 3; ``extras`` stay."""
    if isinstance(value, dict):
        return {key: entry if key == "extras" else with_fractions(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [with_fractions(entry) for entry in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def respelled(path: Path) -> Path:
    """Spell the whole numbers of a file with a fraction."""
    model = read(path)
    model.content.update(with_fractions(model.content))
    return rewritten(model, path)


def spelled(name: str, folder: Path) -> Path:
    """Copy a fixture, its whole numbers spelled with a fraction."""
    source = edited(name, folder, lambda content: content.update(with_fractions(content)))
    assert b'"componentType":5126.0' in source.read_bytes()
    return source


@pytest.mark.slow
@pytest.mark.parametrize("name", GLBS)
@pytest.mark.parametrize(
    "scheme",
    [Scheme.KEEP, *(pytest.param(one, marks=pytest.mark.slow) for one in (Scheme.DRACO, Scheme.MESHOPT))],
)
def test_the_bake_has_the_values_of_the_usual_spelling(scheme: Scheme, name: str, tmp_path: Path) -> None:
    compression = Compression(scheme)
    expected = baked(FOLDER / name, tmp_path / "whole.glb", compression=compression)
    found = baked(spelled(name, tmp_path / "in"), tmp_path / "fractions.glb", compression=compression)
    assert found.content == expected.content  # 3.0 and 3 are equal
    assert found.binary_chunk == expected.binary_chunk
    assert verify(tmp_path / "fractions.glb").exit_code == 0


def test_a_leaning_tangent_is_straightened(tmp_path: Path) -> None:
    file = Editable(FOLDER / "mirrored_tangent.glb")
    file.array("TANGENT")[0, 3] = 0
    source = respelled(file.write(tmp_path / "slip.glb"))
    after = baked(source, tmp_path / "baked.glb")
    assert after.attribute("TANGENT")[0, 3] == 1


@pytest.mark.parametrize("name", GLBS)
def test_strip_gives_the_values_back(name: str, tmp_path: Path) -> None:
    source = spelled(name, tmp_path / "in")
    baked(source, tmp_path / "baked.glb")
    after = stripped(tmp_path / "baked.glb", tmp_path / "back.glb")
    assert after.content == read(source).content
    assert after.binary_chunk == read(source).binary_chunk


def test_verify_tells_what_changed(tmp_path: Path) -> None:
    path = tmp_path / "moved.glb"
    baked(FOLDER / "bent_tube.glb", path)
    file = Editable(path)
    file.array("POSITION")[7] += np.float32(0.05)
    answer = verify(respelled(file.write(path)))
    assert answer.failed == ["freshness"]
    assert "POSITION" in answer.messages


def test_verify_passes_a_fit_whose_poses_are_not_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "still.glb"
    baked(FOLDER / "bent_tube.glb", path, gradients=Gradients.FITTED)
    file = Editable(path)
    del file.content["animations"]
    assert verify(respelled(file.write(path))).exit_code == 0
