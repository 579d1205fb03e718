"""Files whose nodes are stored in another pose than the bind pose: how they are baked and verified."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from skinbake.cli import exit_codes
from tests.support import corpus
from tests.support.baked_files import source, verify
from tests.support.command_line import invoke
from tests.support.gltf_reading import read
from tests.support.models import note, rewritten, scaled

POSED = "RobotMantis/animated_robot_mantis.glb"


def turned(path: Path, degrees: float, name: str) -> Path:
    """Write a copy of a file whose second joint is stored turned about x."""
    file = read(path)
    node = file.content["nodes"][file.content["skins"][0]["joints"][1]]
    half = np.radians(degrees) / 2.0
    node["rotation"] = [float(np.sin(half)), 0.0, 0.0, float(np.cos(half))]
    return rewritten(file, path.with_name(name))


def baked(original: Path, folder: Path, *options: str) -> Path:
    target = folder / "baked.glb"
    result = invoke("bake", original, "-o", target, "-q", *options)
    assert result.exit_code == 0, result.stderr
    return target


@pytest.fixture
def _model(tmp_path: Path) -> Path:
    copy = tmp_path / "model.glb"
    copy.write_bytes(source("bent_tube.glb").read_bytes())
    return copy


def poses_of(path: Path) -> Any:
    noted = note(read(path).content)
    assert noted is not None
    return noted.get("poses")


def mean(path: Path) -> float:
    """Return the mean error of accurate lighting in the stored pose, in degrees."""
    found: dict[str, Any] = skinbake.verify(path, methods=["lbs"], poses="rest")
    return float(found["normals_by_tangents"]["lbs"]["accurate"]["mean"])


def test_the_bind_pose_changes_no_fingerprint(_model: Path, tmp_path: Path) -> None:
    plain, hardly = (baked(path, tmp_path) for path in (_model, turned(_model, 0.9, "hardly.glb")))
    assert poses_of(plain)["fingerprint"] == poses_of(hardly)["fingerprint"]


@pytest.mark.parametrize("options", [(), ("--encoding", "packed8")])
def test_a_stored_pose_is_noted_and_verify_passes(
    _model: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    before = poses_of(baked(_model, tmp_path))["fingerprint"]
    path = baked(turned(_model, 40.0, "turned.glb"), tmp_path, *options)
    assert poses_of(path)["fingerprint"] != before
    answer = verify(path)
    assert (answer.exit_code, answer.failed) == (0, [])


def test_surface_gradients_know_no_pose(_model: Path, tmp_path: Path) -> None:
    path = baked(turned(_model, 40.0, "turned.glb"), tmp_path, "--gradients", "surface")
    assert poses_of(path) is None
    assert verify(turned(path, 10.0, "other.glb")).failed == []


@pytest.mark.slow
@corpus.needed
def test_a_fit_to_the_stored_pose_lights_that_pose_better(tmp_path: Path) -> None:
    path = baked(corpus.model(POSED), tmp_path)
    skinbake.bake(corpus.model(POSED), tmp_path / "surface.glb", gradients="surface")
    assert mean(path) < 0.8 * mean(tmp_path / "surface.glb")


def test_a_pose_that_changes_later_is_told_and_passes_by_the_digest(_model: Path, tmp_path: Path) -> None:
    path = turned(baked(turned(_model, 40.0, "turned.glb"), tmp_path), 25.0, "later.glb")
    answer = verify(path)
    assert (answer.exit_code, answer.failed) == (0, [])
    assert "the poses of the fit are not in the file" in invoke("verify", path, "-v").stdout


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "failed"), [(1.0, []), (1.01, ["freshness"])])
def test_a_character_that_is_placed_elsewhere_keeps_its_pose(
    _model: Path, tmp_path: Path, factor: float, failed: list[str]
) -> None:
    file = read(baked(turned(_model, 40.0, "turned.glb"), tmp_path))
    root = file.content["nodes"][file.content["skins"][0]["joints"][0]]
    root |= {"translation": [5.0, 0.0, -3.0], "rotation": [0.0, 0.6, 0.0, 0.8], "scale": [2.0, 2.0, 2.0]}
    path = scaled(rewritten(file, tmp_path / "placed.glb"), "_SKINBAKE_ALPHA_0", factor, "scaled.glb")
    assert verify(path).failed == failed
    assert "the poses of the fit are not in the file" not in invoke("verify", path, "-v").stdout


def test_a_pose_that_becomes_the_bind_pose_passes_too(_model: Path, tmp_path: Path) -> None:
    path = baked(turned(_model, 40.0, "turned.glb"), tmp_path)
    file = read(path)
    del file.content["nodes"][file.content["skins"][0]["joints"][1]]["rotation"]
    answer = verify(rewritten(file, tmp_path / "later.glb"))
    assert (answer.exit_code, answer.failed) == (0, [])


@pytest.mark.parametrize("later", [40.0, 25.0])
def test_one_percent_of_alpha_is_caught_in_either_pose(_model: Path, tmp_path: Path, later: float) -> None:
    path = turned(baked(turned(_model, 40.0, "turned.glb"), tmp_path), later, "later.glb")
    answer = verify(scaled(path, "_SKINBAKE_ALPHA_0", 1.01, "scaled.glb"))
    assert answer.failed == ["freshness"]


@pytest.mark.parametrize("broken", [None, 3, {}, {"fingerprint": [0.1] * 4}, {"slots": "0" * 32}])
def test_a_damaged_note_is_told(_model: Path, tmp_path: Path, broken: Any) -> None:
    file = read(baked(turned(_model, 40.0, "turned.glb"), tmp_path))
    file.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["poses"] = broken
    answer = verify(rewritten(file, tmp_path / "broken.glb"))
    assert answer.exit_code == exit_codes.VERIFICATION
    assert '"poses" is' in answer.messages


@pytest.mark.parametrize("later", [40.0, 25.0])
def test_a_note_that_one_primitive_of_a_mesh_lost_is_told(tmp_path: Path, later: float) -> None:
    copy = tmp_path / "model.glb"
    copy.write_bytes(source("two_primitives.glb").read_bytes())
    file = read(turned(baked(turned(copy, 40.0, "turned.glb"), tmp_path), later, "later.glb"))
    del file.content["meshes"][0]["primitives"][1]["extras"]["skinbake"]["poses"]
    answer = verify(rewritten(file, tmp_path / "lost.glb"))
    assert (answer.exit_code, answer.failed) == (exit_codes.VERIFICATION, ["structure"])
    assert '"poses" is missing' in answer.messages
