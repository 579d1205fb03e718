"""The loop that the gradients are timed against computes what the authors describe."""

from __future__ import annotations

import subprocess
from pathlib import Path

import igl
import numpy as np
import pytest

from benchmarks import peers
from benchmarks.our_gradients import SLOTS, Mesh, read_mesh, write_mesh
from tests.support.strictness import missing_tool

JOINTS = 7


@pytest.fixture
def mesh() -> Mesh:
    """A bumpy sheet without symmetry, with random influences: no joint is named twice at a vertex."""
    generator = np.random.default_rng(5)
    u, v = np.meshgrid(np.arange(9.0), np.arange(7.0), indexing="ij")
    points = np.stack([u, v, np.zeros_like(u)], axis=-1) + generator.uniform(-0.3, 0.3, (9, 7, 3))
    corner = (np.arange(8)[:, None] * 7 + np.arange(6)).ravel()
    below = corner + 7
    triangles = np.concatenate(
        [np.stack([corner, below, corner + 1], axis=1), np.stack([corner + 1, below, below + 1], axis=1)]
    )
    joints = np.stack([generator.permutation(JOINTS)[:SLOTS] for _ in range(63)])
    weights = generator.random((63, SLOTS)) * (generator.random((63, SLOTS)) < 0.7)
    # Some triangles on which a weight does not vary: they count for no slot of that weight.
    joints[:20], weights[:20] = [0, 1, 2, 3], [0.5, 0.5, 0, 0]
    return Mesh(
        points.reshape(-1, 3).astype(np.float32),
        triangles.astype(np.int32),
        joints.astype(np.int32),
        weights.astype(np.float32),
    )


def expected(mesh: Mesh) -> np.ndarray:
    """The gradients of slots (V, SLOTS, 3), by libigl's gradient of every joint's whole weight function."""
    positions, triangles = mesh.positions.astype(np.float64), mesh.triangles.astype(np.int64)
    functions = np.zeros((len(positions), JOINTS))
    np.put_along_axis(functions, mesh.joints.astype(np.int64), mesh.weights.astype(np.float64), axis=1)
    on_triangles = (igl.grad(positions, triangles) @ functions).reshape(3, len(triangles), JOINTS)
    shares = igl.internal_angles(positions, triangles) * igl.doublearea(positions, triangles)[:, None]
    sums, totals = np.zeros((len(positions), JOINTS, 3)), np.zeros((len(positions), JOINTS, 1))
    varies = np.ptp(functions[triangles], axis=1) > 0
    for t, corners in enumerate(triangles):
        for i, vertex in enumerate(corners):
            sums[vertex] += shares[t, i] * on_triangles[:, t].T
            totals[vertex] += shares[t, i] * varies[t, :, None]
    means = np.divide(sums, totals, out=np.zeros_like(sums), where=totals > 0)
    return np.take_along_axis(means, mesh.joints[..., None].astype(np.int64), axis=1)


@pytest.mark.slow
def test_the_authors_loop_computes_the_mean_by_angle_and_area(mesh: Mesh, tmp_path: Path) -> None:
    program = peers.authors_loop(tmp_path)
    if program is None:
        missing_tool("g++ is not installed")
    path, gradients = tmp_path / "mesh.raw", tmp_path / "gradients.raw"
    write_mesh(path, mesh)
    printed = subprocess.run(
        [program, path, "2", gradients], check=True, capture_output=True, text=True
    ).stdout
    assert len([float(line) for line in printed.split()]) == 2
    found = np.fromfile(gradients, "<f4").reshape(-1, SLOTS, 3)
    np.testing.assert_allclose(found, expected(mesh), rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_the_authors_loop_says_what_is_wrong_with_a_file(tmp_path: Path) -> None:
    program = peers.authors_loop(tmp_path)
    if program is None:
        missing_tool("g++ is not installed")
    short = tmp_path / "short.raw"
    np.array([1_000, 1_000], "<i8").tofile(short)
    process = subprocess.run([program, short, "1"], check=False, capture_output=True, text=True)
    assert (process.returncode, process.stderr) == (1, f"{short} is too short\n")


def test_a_mesh_is_read_as_it_was_written(mesh: Mesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / "mesh.raw", mesh)
    again = read_mesh(tmp_path / "mesh.raw")
    for name in ("positions", "triangles", "joints", "weights"):
        np.testing.assert_array_equal(getattr(again, name), getattr(mesh, name))
