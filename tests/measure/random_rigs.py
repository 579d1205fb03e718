"""Random models for the promise of the default bake: steep and wide weights, stretched and moved joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.measure import stiff_models
from tests.measure.stiff_models import Mesh


def tube(generator: np.random.Generator) -> Mesh:
    """Return a tube of any resolution, bumpy or a cone, on a chain of two to six joints.

    Its weights are steep or wide, and some are noisy.
    """
    rings, sides, joints = (int(generator.integers(*span)) for span in ((4, 24), (3, 14), (2, 7)))
    length = generator.uniform(2.0, 8.0)
    around = np.tile(np.arange(sides) * 2 * np.pi / sides, rings)
    up = np.repeat(np.linspace(0.0, length, rings), sides)
    bumps = 1.0 + generator.uniform(0.0, 0.3) * np.cos(generator.integers(0, 4) * around + up)
    bumps += generator.choice([0.0, 0.1]) * generator.normal(size=len(up))
    radius = generator.uniform(0.1, 0.8) * bumps * (1.0 - generator.choice([0.0, 0.7]) * up / length)
    positions = np.column_stack([radius * np.cos(around), radius * np.sin(around), up])
    ring, side = np.divmod(np.arange((rings - 1) * sides), sides)
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    triangles = np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)])
    bone, spread = length / joints, np.exp(generator.uniform(np.log(0.08), np.log(2.0)))
    powers = -2.0 * np.square(((np.arange(joints) + 0.5) * bone - up[:, None]) / (bone * spread))
    falling = np.exp(powers - powers.max(axis=1, keepdims=True))
    falling *= 1.0 + generator.choice([0.0, 0.3]) * generator.random(falling.shape)
    order = np.argsort(-falling, axis=1)[:, :4]
    shares = np.take_along_axis(falling, order, axis=1)
    lacking = (0, 0), (0, 4 - order.shape[1])
    shares = np.pad(shares / shares.sum(axis=1, keepdims=True), lacking)
    origins = np.column_stack([np.zeros((joints, 2)), np.arange(joints) * bone])
    normals = stiff_models.smooth(positions, triangles)
    return Mesh(positions, normals, triangles, np.pad(order, lacking), shares, origins)


def write(seed: int, folder: Path) -> Path:
    """Write a model whose clip turns all joints, and stretches or scales those of three in four."""
    generator = np.random.default_rng(seed)
    makers = stiff_models.robot, stiff_models.spring, stiff_models.six_vertices, tube, tube, tube
    mesh = makers[seed % len(makers)](generator)
    joints = len(mesh.origins)
    motions = list(stiff_models.turns(generator, joints, generator.choice([20.0, 60.0, 120.0])))
    what = generator.integers(0, 4)
    if what & 1:
        motions += stiff_models.stretches(generator, mesh.origins)
    if what & 2:
        motions += stiff_models.scales(generator, joints, generator.choice([0.05, 0.15, 0.4]))
    return stiff_models.write(folder / f"{seed}.glb", mesh, motions)
