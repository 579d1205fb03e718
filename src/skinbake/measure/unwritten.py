"""Bakes that are not in a file yet, and parts of them, as a replay reads them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from skinbake.geometry import frames
from skinbake.geometry.skinned import BakedPrimitive, IntArray, SkinnedPrimitive
from skinbake.gltf.primitives import PrimitiveSource
from skinbake.gradients import kernel
from skinbake.gradients.tangents import frame_vectors
from skinbake.skinning.rest import RestPrimitive
from skinbake.truth.mesh import normalised_weights

Array: TypeAlias = npt.NDArray[Any]


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
    positions = np.concatenate([bake.primitive.positions for bake in bakes])
    labels = kernel.label_equal_rows(positions)
    ends = np.cumsum([0, *(len(bake.primitive.positions) for bake in bakes)])
    marked = np.zeros(int(labels.max(initial=-1)) + 1, dtype=np.bool_)
    for own, start in zip(rows, ends[:-1], strict=True):
        marked[labels[start + own]] = True
    numbers: list[int] = []
    parts: list[UnwrittenBake] = []
    places: list[IntArray] = []
    for number, (bake, own) in enumerate(zip(bakes, rows, strict=True)):
        primitive, baked = bake.primitive, bake.baked
        used = marked[labels[ends[number] : ends[number + 1]]]
        if not used.any():
            continue
        a, b, c = primitive.triangles.T
        triangles = primitive.triangles[used[a] | used[b] | used[c]]
        used[triangles] = True
        kept, new = np.flatnonzero(used), np.cumsum(used) - 1
        adopting = used[baked.adopting]
        part = replace(
            primitive,
            positions=primitive.positions[kept],
            normals=primitive.normals[kept],
            tangents=None if primitive.tangents is None else primitive.tangents[kept],
            joints=primitive.joints[kept],
            weights=primitive.weights[kept],
            triangles=new[triangles],
        )
        result = replace(
            baked,
            alpha=baked.alpha[kept],
            beta=baked.beta[kept],
            adopting=new[baked.adopting[adopting]],
            adopted=baked.adopted[adopting],
            classes=baked.classes[kept],
        )
        numbers.append(number)
        parts.append(UnwrittenBake(bake.source, part, result))
        places.append(new[own])
    return numbers, parts, places


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
