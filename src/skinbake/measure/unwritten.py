"""Bakes that are not in a file yet, and parts of them, as a replay reads them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.geometry import frames
from skinbake.geometry.skinned import (
    BakedPrimitive,
    FloatArray,
    IntArray,
    SkinnedPrimitive,
    blocks,
)
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gradients import kernel
from skinbake.gradients.surface import bit_patterns
from skinbake.gradients.tangents import frame_vectors
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.mesh import normalised_weights

Array: TypeAlias = npt.NDArray[Any]

DIGEST_BITS = 16
"""The digests of positions fill a table of so many bits. In a cache it is read fast."""

ODD = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D], dtype=np.uint32)
"""Odd numbers that spread the bits of a coordinate over the upper half of a product, one for each axis."""


class UnwrittenBake(NamedTuple):
    """One primitive, the arrays that were baked, and the result of the bake."""

    source: PrimitiveSource
    primitive: SkinnedPrimitive
    baked: BakedPrimitive

    def rest_primitive(self) -> RestPrimitive:
        """Return it as float64. Adopted joints have weight 0, and joints past the skin become 0."""
        primitive, baked = self.primitive, self.baked
        tangents, bitangents = frame_vectors(primitive, baked.frame)
        named = np.where(baked.adopted_joints >= 0, baked.adopted_joints, primitive.joints)
        joints = np.where(named < self.source.joint_count, named, 0)
        return RestPrimitive(
            positions=primitive.positions.astype(np.float64),
            normals=frames.unit_normals(primitive.normals).astype(np.float64),
            tangents=tangents.astype(np.float64),
            bitangents=bitangents.astype(np.float64),
            joints=joints,
            weights=normalised_weights(primitive.weights, joints),
            alpha=baked.alpha.astype(np.float64),
            beta=baked.beta.astype(np.float64),
        )


def cut_out(
    bakes: Sequence[UnwrittenBake], rows: Sequence[IntArray]
) -> tuple[list[int], list[UnwrittenBake], list[IntArray]]:
    """Cut vertices out of primitives in one space, with all vertices at their places and all triangles there.

    rows are the vertices of each primitive. Return the numbers of the primitives that have any part, the part
    of each, and where its vertices are. Only these have all around them that they have in the whole.
    """
    near = _with_copies([bake.primitive.positions for bake in bakes], rows)
    numbers: list[int] = []
    parts: list[UnwrittenBake] = []
    places: list[IntArray] = []
    for number, (bake, own, there) in enumerate(zip(bakes, rows, near, strict=True)):
        primitive, baked = bake.primitive, bake.baked
        if not len(there):
            continue
        used = np.zeros(len(primitive.positions), dtype=np.bool_)
        used[there] = True
        # The triangles that have one of the used vertices.
        corners = primitive.triangles.ravel()
        at = [block.start + np.flatnonzero(used[corners[block]]) for block in blocks(len(corners))]
        owners = np.concatenate(at or [np.empty(0, dtype=np.int64)]) // 3
        triangles = primitive.triangles[owners[np.diff(owners, prepend=-1) > 0]]
        used[triangles] = True
        kept = np.flatnonzero(used)
        adopting = used[baked.adopting]
        part = replace(
            primitive,
            positions=primitive.positions[kept],
            normals=primitive.normals[kept],
            tangents=None if primitive.tangents is None else primitive.tangents[kept],
            joints=primitive.joints[kept],
            weights=primitive.weights[kept],
            triangles=np.searchsorted(kept, triangles),
        )
        result = baked._replace(
            alpha=baked.alpha[kept],
            beta=baked.beta[kept],
            adopting=np.searchsorted(kept, baked.adopting[adopting]),
            adopted=baked.adopted[adopting],
            classes=baked.classes[kept],
        )
        numbers.append(number)
        parts.append(UnwrittenBake(bake.source, part, result))
        places.append(np.searchsorted(kept, own))
    return numbers, parts, places


def _with_copies(positions: Sequence[FloatArray], rows: Sequence[IntArray]) -> list[IntArray]:
    """Return some vertices of primitives, and all others at their places. positions are (V, 3)."""
    places = np.concatenate([each[own] for each, own in zip(positions, rows, strict=True)])
    # A table of digests tells that most vertices are at no such place. Only the rest is compared.
    table = np.zeros(1 << DIGEST_BITS, dtype=np.bool_)
    table[_digests(places)] = True
    maybe = [
        np.concatenate(
            [part.start + np.flatnonzero(table[_digests(each[part])]) for part in blocks(len(each))]
        )
        for each in positions
    ]
    candidates = (each[own] for each, own in zip(positions, maybe, strict=True))
    labels = kernel.label_equal_rows(np.concatenate([places, *candidates]))
    wanted = np.zeros(len(labels), dtype=np.bool_)
    wanted[labels[: len(places)]] = True
    found = np.split(wanted[labels[len(places) :]], np.cumsum([*map(len, maybe)])[:-1])
    return [own[there] for own, there in zip(maybe, found, strict=True)]


def _digests(positions: FloatArray) -> IntArray:
    """Return a number of DIGEST_BITS bits for each position (V, 3), the same for equal ones."""
    x, y, z = bit_patterns(positions.astype(np.float32, copy=False)).T
    mixed: IntArray = (x * ODD[0]) ^ (y * ODD[1]) ^ (z * ODD[2])
    return mixed >> np.uint32(32 - DIGEST_BITS)


def joined(parts: Sequence[UnwrittenBake]) -> tuple[SkinnedPrimitive, RestPrimitive]:
    """Return primitives in one space as one, their vertices one after the other, and it as a replay reads it.

    It has as many slots as the one with the most. It has no TANGENT: the frames are in what the replay reads.
    """
    rests = [part.rest_primitive() for part in parts]
    width = max(rest.joints.shape[1] for rest in rests)
    starts = np.cumsum([0, *(len(rest.positions) for rest in rests)])[:-1]

    def rows(arrays: Iterable[Array], columns: int) -> Array:
        """Return the rows of several arrays, each filled with zeros to so many columns."""
        found = list(arrays)
        whole = np.zeros((sum(map(len, found)), columns), dtype=np.result_type(*found))
        for one, first in zip(found, starts, strict=True):
            whole[first : first + len(one), : one.shape[1]] = one
        return whole

    primitives = [part.primitive for part in parts]
    whole = SkinnedPrimitive(
        positions=rows((one.positions for one in primitives), 3),
        normals=rows((one.normals for one in primitives), 3),
        tangents=None,
        joints=rows((one.joints for one in primitives), width),
        weights=rows((one.weights for one in primitives), width),
        triangles=np.concatenate(
            [one.triangles + first for one, first in zip(primitives, starts, strict=True)]
        ),
    )
    rest = RestPrimitive(
        positions=rows((one.positions for one in rests), 3),
        normals=rows((one.normals for one in rests), 3),
        tangents=rows((one.tangents for one in rests), 3),
        bitangents=rows((one.bitangents for one in rests), 3),
        joints=rows((one.joints for one in rests), width),
        weights=rows((one.weights for one in rests), width),
        alpha=rows((one.alpha for one in rests), width - 1),
        beta=rows((one.beta for one in rests), width - 1),
    )
    return whole, rest
