"""bake and verify find the same limited influences, each by its own route."""

from __future__ import annotations

import numpy as np
import pytest

from skinbake.format.influences import common_unit, with_limit
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.reading.accessors import StoredArray
from skinbake.gltf.reading.meshes import StoredInfluences
from skinbake.gradients.influences import limited_slots
from skinbake.truth.mesh import normalised_weights
from tests.measure.limited import limited_primitive


def random_sets(kind: str, seed: int) -> list[StoredInfluences]:
    """Return three influence sets of 2,000 vertices with ties, repeats, sums off and empty vertices."""
    rng = np.random.default_rng(seed)
    top = 1.0 if kind == "f4" else np.iinfo(kind).max
    weights = rng.choice([0, 0, 0.05, 0.1, 0.1, 0.25, rng.random()], (2000, 12)) * top
    weights[:1000] /= np.maximum(weights[:1000].sum(axis=1, keepdims=True) / top, 1e-3)
    weights[:3] = 0
    if kind == "f4":
        weights[3:20, 5] = -0.1
    joints = rng.integers(0, 15, (2000, 12))
    return [
        StoredInfluences(
            StoredArray(joints[:, start : start + 4].astype("u1"), normalized=False),
            StoredArray(weights[:, start : start + 4].astype(kind), normalized=kind != "f4"),
        )
        for start in (0, 4, 8)
    ]


@pytest.mark.parametrize("kind", ["f4", "u1", "u2"])
@pytest.mark.parametrize("count", [4, 8])
def test_bake_and_verify_keep_the_same_joints_and_weights(kind: str, count: int) -> None:
    sets = random_sets(kind, seed=count)
    primitive = primitive_of(sets)
    slots = limited_slots(primitive, count)
    baked = primitive_of(with_limit(sets, slots.slots, slots.shares, slots.rewritten))
    found = limited_primitive(primitive, count, common_unit(sets))
    assert slots.rewritten.mean() > 0.5
    assert np.array_equal(np.where(found.weights > 0, found.joints, 0)[3:], baked.joints[3:])
    # In units of an integer type nothing but equality will do; w / Σw in float32 rounds by 6e-8.
    expected = normalised_weights(baked.weights, baked.joints)
    assert np.abs(normalised_weights(found.weights, found.joints) - expected).max() < 2e-7
    # Empty vertices: slot 0's joint, at weight 1 to verify and 0 in the file.
    assert np.array_equal(found.joints[:3, 0], baked.joints[:3, 0])


def primitive_of(sets: list[StoredInfluences]) -> SkinnedPrimitive:
    joints = np.concatenate([entry.joints.values.astype(np.int64) for entry in sets], axis=1)
    weights = np.concatenate([entry.weights.decoded() for entry in sets], axis=1)
    nothing = np.zeros((len(joints), 3))
    return SkinnedPrimitive(nothing, nothing, None, joints, weights, np.zeros((0, 3), dtype=np.int64))
