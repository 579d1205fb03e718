"""A part that is cut out of primitives has all triangles around its vertices, across seams and primitives."""

from __future__ import annotations

import numpy as np

from skinbake.choices import Frame
from skinbake.errors import Place
from skinbake.format.baked import Baked
from skinbake.format.note import GradientNote
from skinbake.geometry.skinned import BakedPrimitive, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.measure.guard import cut_out

COUNT = 400


def made(generator: np.random.Generator, number: int) -> Baked:
    """Return a primitive of random triangles, whose positions are of so few that many are copies."""
    positions = generator.choice(np.array([-0.0, 0.0, 0.1, 0.3, 1.0, -2.5, 7.0], np.float32), size=(COUNT, 3))
    weights = np.zeros((COUNT, 4), dtype=np.float32)
    weights[:, 0] = np.arange(COUNT)  # as good as a name
    primitive = SkinnedPrimitive(
        positions=positions,
        normals=np.ones((COUNT, 3), dtype=np.float32),
        tangents=None,
        joints=np.zeros((COUNT, 4), dtype=np.uint8),
        weights=weights,
        triangles=generator.integers(0, COUNT, size=(300, 3)).astype(np.uint32),
    )
    adopting = np.flatnonzero(generator.random(COUNT) < 0.3)
    baked = BakedPrimitive(
        alpha=np.repeat(np.arange(COUNT, dtype=np.float32)[:, None], 3, axis=1),
        beta=np.zeros((COUNT, 3), dtype=np.float32),
        adopting=adopting,
        adopted=np.repeat(adopting[:, None], 4, axis=1).astype(np.int32),
        frame=Frame.NORMAL,
        classes=np.arange(COUNT),
    )
    source = PrimitiveSource(0, number, {}, 1, Place("model.glb"))
    return Baked(source, primitive, baked, dict, GradientNote())


def test_a_part_has_all_triangles_at_the_places_of_its_vertices() -> None:
    generator = np.random.default_rng(7)
    bakes = [made(generator, number) for number in range(2)]
    rows = [np.array([3, 50, 399]), np.array([], dtype=np.int64)]
    numbers, parts, places = cut_out(bakes, rows)
    wanted = {tuple(point + 0.0) for point in bakes[0].primitive.positions[rows[0]]}
    for number, part, place in zip(numbers, parts, places, strict=True):
        whole = bakes[number].primitive
        names = part.primitive.weights[:, 0].astype(np.int64)
        assert (names[place] == rows[number]).all()
        near = [
            triangle
            for triangle in whole.triangles.tolist()
            if any(tuple(whole.positions[corner] + 0.0) in wanted for corner in triangle)
        ]
        assert names[part.primitive.triangles].tolist() == near
        assert near
        assert (part.result.alpha[:, 0] == names).all()
        assert (names[part.result.adopting] == part.result.adopted[:, 0]).all()
        assert set(names) & set(bakes[number].result.adopting) == set(part.result.adopted[:, 0])
    assert numbers == [0, 1]
