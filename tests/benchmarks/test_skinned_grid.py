"""The grid that tools are timed on is a sound file, whatever its size and however it is written."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from benchmarks import skinned_grid, three_frame, truth_cost, view_speed
from benchmarks.skinned_grid import JOINTS, Grid, grid_of, write_grid
from tests.support import khronos
from tests.support.gltf_reading import GltfFile, read

VERTICES = 600


@pytest.fixture(scope="module")
def grid_file(tmp_path_factory: pytest.TempPathFactory) -> GltfFile:
    path = tmp_path_factory.mktemp("grid") / "grid.glb"
    write_grid(path, grid_of(VERTICES))
    return read(path)


def test_the_validator_has_nothing_against_it(grid_file: GltfFile) -> None:
    khronos.require_node()
    report = khronos.validate(grid_file.path)
    # Where a spline begins its weight is 0.
    warnings = {found.code for found in report["warnings"]} - {"ACCESSOR_JOINTS_USED_ZERO_WEIGHT"}
    assert (report["errors"], warnings) == ([], set())


def test_normals_are_those_of_its_triangles(grid_file: GltfFile) -> None:
    positions, triangles = grid_file.attribute("POSITION"), grid_file.triangles()
    corners = positions[triangles]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    around = np.zeros_like(positions)
    for corner in range(3):
        np.add.at(around, triangles[:, corner], facets)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    cosines = np.sum(around * grid_file.attribute("NORMAL"), axis=1)
    assert np.degrees(np.arccos(np.minimum(cosines, 1))).max() < 1.0


def test_triangles_cover_the_grid_once(grid_file: GltfFile) -> None:
    corners = grid_file.attribute("POSITION")[grid_file.triangles()][..., [0, 2]]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(4 * 4, rel=1e-6)


def test_weights_are_four_joints_and_add_up_to_one(grid_file: GltfFile) -> None:
    joints, weights = grid_file.influences()
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert all(len(set(row)) == 4 for row in joints.tolist())
    assert joints.max() == JOINTS - 1


def test_parts_make_the_same_file_as_the_whole(grid_file: GltfFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(skinned_grid, "VERTICES_AT_ONCE", 7 * grid_of(VERTICES).columns)
    other = grid_file.path.with_name("parts.glb")
    write_grid(other, grid_of(VERTICES))
    assert len(list(grid_of(VERTICES).parts())) > 2
    assert other.read_bytes() == grid_file.path.read_bytes()


@pytest.mark.parametrize(
    ("vertices", "sides"), [(1_000_000, (1000, 1000)), (1_000, (25, 40)), (34_000, (170, 200)), (4, (2, 2))]
)
def test_the_grid_is_as_square_as_it_can_be(vertices: int, sides: tuple[int, int]) -> None:
    assert grid_of(vertices) == Grid(*sides)


@pytest.mark.parametrize("vertices", [-4, 0, 1, 3, 10_007])
def test_a_prime_makes_no_grid(vertices: int) -> None:
    with pytest.raises(ValueError, match="no grid"):
        grid_of(vertices)


@pytest.mark.parametrize(
    ("script", "arguments"),
    [
        (skinned_grid, ["10007", "grid.glb"]),
        (three_frame, ["--vertices", "10007"]),
        (truth_cost, ["--vertices", "10007"]),
        (view_speed, ["10007"]),
    ],
)
def test_scripts_refuse_a_number_that_makes_no_grid(
    script: ModuleType,
    arguments: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["script", *arguments])
    with pytest.raises(SystemExit) as ended:
        script.main()
    assert ended.value.code == 2
    assert "there is no grid of 10,007 vertices: give a number with divisors" in capsys.readouterr().err


def test_a_phase_makes_another_file_of_the_same_size(grid_file: GltfFile, tmp_path: Path) -> None:
    write_grid(tmp_path / "other.glb", grid_of(VERTICES, phase=0.5))
    other = read(tmp_path / "other.glb")
    assert len(other.attribute("POSITION")) == VERTICES
    assert not np.array_equal(other.attribute("POSITION"), grid_file.attribute("POSITION"))


def test_a_payload_is_bytes_that_an_image_has(grid_file: GltfFile, tmp_path: Path) -> None:
    write_grid(tmp_path / "full.glb", grid_of(VERTICES), payload=1_000)
    full = read(tmp_path / "full.glb")
    (image,) = full.content["images"]
    assert len(full.buffer_view(image["bufferView"])) == 1_000
    np.testing.assert_array_equal(full.triangles(), grid_file.triangles())
