"""Time the replay of each algorithm on 10,000 vertices × 100 poses, against libigl's plain skinning.

Usage: python -m benchmarks.replay_speed [--runs N]

The peer blends the same joint matrices over the same vertices and moves positions only: libigl's `lbs_matrix`
once, then one product a pose. Prints medians of processor seconds on one core, and ratios to the peer's.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import igl
import numpy as np

from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.rest import RestPrimitive
from tests.support.replay import replay

VERTICES, POSES, JOINTS, INFLUENCES = 10_000, 100, 40, 4


def rest_primitive() -> RestPrimitive:
    """Return vertices with random frames, weights and derivatives: the cost does not depend on them."""
    generator = np.random.default_rng(0)
    frames = np.linalg.qr(generator.normal(size=(VERTICES, 3, 3))).Q
    weights = generator.random((VERTICES, INFLUENCES))
    return RestPrimitive(
        positions=generator.normal(size=(VERTICES, 3)),
        normals=frames[:, 0],
        tangents=frames[:, 1],
        bitangents=frames[:, 2],
        joints=generator.integers(0, JOINTS, (VERTICES, INFLUENCES)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        alpha=generator.normal(size=(VERTICES, INFLUENCES - 1)),
        beta=generator.normal(size=(VERTICES, INFLUENCES - 1)),
    )


def joint_matrices() -> np.ndarray:
    """Return rigid joint matrices (P, J, 4, 4)."""
    generator = np.random.default_rng(1)
    rotations = np.linalg.qr(generator.normal(size=(POSES, JOINTS, 3, 3))).Q
    matrices = np.tile(np.eye(4), (POSES, JOINTS, 1, 1))
    matrices[..., :3, :3] = rotations * np.linalg.det(rotations)[..., None, None]
    matrices[..., :3, 3] = generator.normal(size=(POSES, JOINTS, 3))
    return matrices


def plain_skinning(rest: RestPrimitive, matrices: np.ndarray) -> None:
    """Move the positions of all poses with libigl's matrix."""
    dense = np.zeros((VERTICES, JOINTS))
    np.add.at(dense, (np.arange(VERTICES)[:, None], rest.joints), rest.weights)
    blend = igl.lbs_matrix(rest.positions, dense)
    for pose in matrices:
        blend @ pose[:, :3].transpose(0, 2, 1).reshape(-1, 3)


def median_seconds(work: Callable[[], object], runs: int) -> float:
    """Return the median processor time of ``runs`` runs after one that does not count."""
    taken = []
    for _ in range(runs + 1):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return statistics.median(taken[1:])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    rest, matrices = rest_primitive(), joint_matrices()
    peer = median_seconds(lambda: plain_skinning(rest, matrices), runs)
    print(f"{VERTICES:,} vertices × {POSES} poses, {INFLUENCES} influences, median of {runs} runs")
    print(f"{'':<22}{'float64':>9}{'ratio':>8}{'float32':>9}{'ratio':>8}")
    print(f"{'libigl, positions':<22}{peer:>9.3f}{1.0:>8.2f}")
    for algorithm in Algorithm:
        wide, narrow = (
            median_seconds(partial(replay, algorithm, rest, matrices, dtype=dtype), runs)
            for dtype in (np.float64, np.float32)
        )
        name = f"{int(algorithm)} {algorithm.name.lower().replace('_', ' ')}"
        print(f"{name:<22}{wide:>9.3f}{wide / peer:>8.2f}{narrow:>9.3f}{narrow / peer:>8.2f}")


if __name__ == "__main__":
    main()
