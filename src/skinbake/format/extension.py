"""One influence set more, whose slots are free for joints of neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.choices import SLOTS_PER_SET
from skinbake.geometry.skinned import SkinnedPrimitive
from skinbake.gltf.accessors import StoredArray
from skinbake.gltf.primitives import StoredInfluences


@dataclass(frozen=True, slots=True)
class Extended:
    """A primitive with one influence set more, the sets to store, and the number of vertices that need it."""

    primitive: SkinnedPrimitive
    stored: tuple[StoredInfluences, ...]
    vertices: int


def extended(primitive: SkinnedPrimitive, sets: Sequence[StoredInfluences], vertices: int) -> Extended:
    """Return a primitive with a further set of weights 0, of the types of its last one."""
    last, count = sets[-1], len(primitive.positions)

    def empty(like: StoredArray) -> StoredArray:
        return StoredArray(np.zeros((count, SLOTS_PER_SET), like.values.dtype), like.normalized)

    added = StoredInfluences(empty(last.joints), empty(last.weights))
    wide = primitive.with_influences(
        np.pad(primitive.joints, ((0, 0), (0, SLOTS_PER_SET))),
        np.pad(primitive.weights, ((0, 0), (0, SLOTS_PER_SET))),
    )
    return Extended(wide, (*sets, added), vertices)
