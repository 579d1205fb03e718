"""Move a grid through random poses with libigl, and average its triangles' normals at vertices in each.

Usage: python -m benchmarks.libigl_normals VERTICES POSES

That is the least that a check of normals computes: the places of the vertices, and the normals of the
surface that they make. Prints the mean of the last pose's normals' y, so that nothing can be left out.
"""

from __future__ import annotations

import sys

import igl
import numpy as np

from benchmarks.skinned_grid import JOINTS, grid_arrays, grid_of


def main() -> None:
    arrays = grid_arrays(grid_of(int(sys.argv[1])))
    positions = arrays["POSITION"].astype(np.float64)
    triangles = arrays["indices"].reshape(-1, 3).astype(np.int64)
    dense = np.zeros((len(positions), JOINTS))
    np.put_along_axis(dense, arrays["JOINTS_0"].astype(np.int64), arrays["WEIGHTS_0"], axis=1)
    blend = igl.lbs_matrix(positions, dense)
    generator = np.random.default_rng(0)
    for _ in range(int(sys.argv[2])):
        transforms = np.concatenate([rotations(generator), np.zeros((JOINTS, 1, 3))], axis=1)
        moved = blend @ transforms.reshape(-1, 3)
        normals = igl.per_vertex_normals(moved, triangles)
    print(normals[:, 1].mean())


def rotations(generator: np.random.Generator) -> np.ndarray:
    """Return a rotation (J, 3, 3) for each joint, about z by up to 30 degrees."""
    angles = np.radians(30) * generator.uniform(-1, 1, JOINTS)
    turned = np.tile(np.eye(3), (JOINTS, 1, 1))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(angles)
    turned[:, 0, 1], turned[:, 1, 0] = np.sin(angles), -np.sin(angles)
    return turned


if __name__ == "__main__":
    main()
