"""What bake adds to the morph targets that a file has: NORMAL for those without it, and their differential.

Once one target of a primitive has NORMAL, every target has one, because some loaders take the base mesh for a
difference where a target lacks what others have. A target that turns no normal has an accessor without a
buffer view: zeros, without a byte. The metadata ``extras.skinbake`` of the mesh says what was added, so that
``strip`` takes it out again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.errors import BrokenPassedOver, InputError, Place, UnsupportedFeatureError
from skinbake.format.attribute_store import meshopt_packing
from skinbake.format.digests import unordered_digest
from skinbake.format.note import (
    GENERATOR,
    IN_PLANE,
    UPWARD,
    VERSION,
    MorphNote,
    MorphTargets,
    has_place,
    morph_note,
    noted_targets,
    with_note,
    without_note,
)
from skinbake.geometry.morphs import COMPONENTS, Differences
from skinbake.geometry.skinned import FloatArray, IntArray, SkinnedPrimitive
from skinbake.gltf.asset import COMPONENT_CODES, TYPES, PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, entries_of, object_of
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.writing.additions import Additions, Packed

FRAMES = (IN_PLANE, UPWARD)
"""The attributes of the differential of a target.

glTF wants an attribute of that name in the primitive too. There it is zeros, without a byte.
"""


class MadeTargets(NamedTuple):
    """What bake adds to targets of one primitive, by number.

    normals are the changes of NORMAL, for normals as stored. frames are the numbers of the differential: in
    the plane (V, 4), and perhaps upward (V, 2), of every target; or there are none. digest is that of what
    both follow from (``morph_digest``).
    """

    source: PrimitiveSource
    normals: Mapping[int, Differences]
    frames: Sequence[Mapping[int, Differences]]
    digest: str


def add_zeros(additions: Additions, count: int, kind: str, *, bounded: bool) -> int:
    """Add the accessor of so many elements of zeros, without a buffer view, and return its index."""
    bounds: JsonObject = {"min": [0, 0, 0], "max": [0, 0, 0]} if bounded else {}
    return additions.add_described({"componentType": 5126, "count": count, "type": kind, **bounds})


def add_differences(
    additions: Additions, values: npt.NDArray[Any], *, normalized: bool = False, packed: Packed | None = None
) -> int:
    """Add the differences (V, C) of a target, sparse where that is smaller. Return the accessor's index.

    packed is how a view that is not sparse is compressed.
    """
    rows = np.flatnonzero(values.any(axis=1))
    kind = next(one for one in (np.uint8, np.uint16, np.uint32) if len(values) <= np.iinfo(one).max)
    indices, some = rows.astype(kind), np.ascontiguousarray(values[rows])
    size = values.itemsize * values.shape[1]
    described: JsonObject = {
        "componentType": COMPONENT_CODES[values.dtype],
        "count": len(values),
        "type": TYPES[values.shape[1]],
        **({"normalized": True} if normalized else {}),
    }
    if (size + -size % 4) * len(values) <= indices.nbytes + some.nbytes:
        return additions.add_described({"bufferView": additions.add_values(values, packed), **described})
    # The vertices belong to all targets of a primitive: they are stored once. Sparse values are packed.
    sparse = {
        "count": len(rows),
        "indices": {
            "bufferView": additions.add_stream(indices.tobytes()),
            "componentType": COMPONENT_CODES[indices.dtype],
        },
        "values": {"bufferView": additions.add_stream(some.tobytes())},
    }
    return additions.add_described({**described, "sparse": sparse})


def morph_digest(primitive: SkinnedPrimitive, targets: Mapping[int, Differences]) -> str:
    """Return the digest of what made normals follow from: the mesh, and what targets add to POSITION.

    The order of vertices and triangles does not count, nor do copies of a vertex: tools change both.
    """
    every = np.arange(len(primitive.positions))
    parts: list[tuple[int, IntArray, FloatArray]]
    parts = [(0, every, primitive.positions), (1, every[: len(primitive.normals)], primitive.normals)]
    parts += ((2 + number, one.rows, one.values) for number, one in sorted(targets.items()))
    return unordered_digest(primitive, parts)


def check_extras(document: Document, mesh: int, place: Place) -> None:
    """Raise UnsupportedFeatureError if the extras of a mesh have no place for metadata."""
    if not has_place(document.objects("meshes")[mesh]):
        message = '"extras" of its mesh leave no place for the metadata of morph targets'
        raise UnsupportedFeatureError(message, place)


def add_made(
    document: Document,
    additions: Additions,
    meshes: list[JsonObject],
    made: Sequence[MadeTargets],
    level: int | None,
) -> list[int]:
    """Add NORMAL and the differential to targets, and change ``meshes`` in place. Return bytes by primitive.

    level is that of ``--compress-level``, for views that meshopt compresses. Raises InputError if the
    primitive has an attribute of the names of the differential.
    """
    lengths = []
    for item in made:
        before = additions.byte_length
        mesh, number = meshes[item.source.mesh], item.source.primitive
        primitives = list(mesh["primitives"])
        accessors = document.objects("accessors")
        count = int(accessors[int(item.source.attributes["POSITION"])]["count"])
        packed = meshopt_packing(document, item.source, level)
        targets = list(item.source.json["targets"])
        zeros = tuple((one, targets[one]["NORMAL"]) for one in item.normals if "NORMAL" in targets[one])
        attributes = dict(primitives[number]["attributes"])
        parts = {"NORMAL": (item.normals, 3)}
        parts |= {
            name: (one, COMPONENTS[kind])
            for name, kind, one in zip(FRAMES, ("in_plane", "upward"), item.frames, strict=False)
        }
        for name, (values, components) in parts.items():
            if name in FRAMES:
                if name in attributes:
                    message = f"it already has an attribute {name}: remove it, or bake without --morph-frames"
                    raise InputError(message, item.source.place)
                attributes[name] = add_zeros(additions, count, TYPES[components], bounded=False)
            for target, added in values.items():
                if len(added.rows):
                    dense = np.zeros((count, components), np.float32)
                    dense[added.rows] = added.values
                    accessor = add_differences(additions, dense, packed=packed)
                else:
                    accessor = add_zeros(additions, count, TYPES[components], bounded=False)
                targets[target] = {**targets[target], name: accessor}
        primitives[number] = {**primitives[number], "attributes": attributes, "targets": targets}
        # The note of the mesh, which an earlier primitive of it may have begun.
        note = morph_note(mesh) or MorphNote(version=VERSION, generator=GENERATOR)
        entries = list(note.morph_targets or [MorphTargets()] * len(primitives))
        kinds = ("in_plane", "upward")[: len(item.frames)]
        entries[number] = MorphTargets(
            targets=len(targets),
            normals=tuple(sorted(item.normals)),
            zeros=zeros,
            frames=sum(COMPONENTS[kind] for kind in kinds),
            digest=item.digest,
        )
        note = note._replace(morph_targets=tuple(entries))
        meshes[item.source.mesh] = with_note({**mesh, "primitives": primitives}, note)
        lengths.append(additions.byte_length - before)
    return lengths


def former_targets(document: Document, mesh: JsonObject) -> JsonObject:
    """Return the JSON of a mesh as it was before bake changed its targets.

    A NORMAL of zeros that another tool has taken away or renumbered stays away: it counts as absent.
    """
    if morph_note(mesh) is None:
        return mesh
    primitives = []
    for primitive, noted in zip(entries_of(mesh.get("primitives")), noted_targets(mesh), strict=False):
        targets = primitive.get("targets")
        changed = dict(primitive)
        if noted.frames and isinstance(primitive.get("attributes"), dict):
            changed["attributes"] = {
                name: one for name, one in primitive["attributes"].items() if name not in noted.names
            }
        if noted and isinstance(targets, list):
            zeros = {
                one: at
                for one, at in noted.zeros
                if one in noted.normals and _is_zeros(document, at, primitive)
            }
            changed["targets"] = [
                {
                    name: zeros.get(position, one) if name == "NORMAL" else one
                    for name, one in object_of(target).items()
                    if name not in noted.names
                    and (name != "NORMAL" or position not in noted.normals or position in zeros)
                }
                for position, target in enumerate(targets)
            ]
        primitives.append(changed)
    return without_note({**mesh, "primitives": primitives})


def _is_zeros(document: Document, accessor: int, primitive: JsonObject) -> bool:
    """Tell whether an accessor holds zeros, as many and as wide as NORMAL of a primitive."""
    asset, normals = document.asset, object_of(primitive.get("attributes")).get("NORMAL")
    found, alike = asset.accessor_at(accessor), asset.accessor_at(normals)
    if found is None or alike is None:
        return False
    if any(found.json.get(name) != alike.json.get(name) for name in ("count", "type")):
        return False
    with BrokenPassedOver(), document.budget.passing():
        return not read_accessor(document, accessor, Place(document.name)).values.any()
    return False
