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

from skinbake.errors import BudgetError, InputError, Place, UnsupportedFeatureError
from skinbake.format.attribute_store import meshopt_packing
from skinbake.format.metadata import DEEPEST_NOTE, KEY, VERSION, unordered_digest
from skinbake.geometry.morphs import COMPONENTS, Differences
from skinbake.geometry.skinned import FloatArray, IntArray, SkinnedPrimitive
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.additions import Additions, Packed
from skinbake.gltf.codecs.views import COMPONENT_CODES, TYPES
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, entries_of, is_deeper, object_of, reference, with_integers
from skinbake.gltf.primitives import PrimitiveSource
from skinbake.version import __version__

NOTE = "morphTargets"
"""The member of a mesh's note that tells, by primitive, what bake added to targets."""

IN_PLANE, UPWARD = "_SKINBAKE_MORPH", "_SKINBAKE_MORPH_UP"
"""The attributes of the differential of a target: VEC4 along t0 and b0, and VEC2 along n0.

glTF wants an attribute of that name in the primitive too. There it is zeros, without a byte.
"""

FRAMES = (IN_PLANE, UPWARD)


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
    # The vertices are those of all targets of a primitive, and stored once. Sparse values are tightly packed.
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
    extras = document.objects("meshes")[mesh].get("extras", {})
    if not isinstance(extras, dict) or KEY in extras:
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
        zeros = [[one, targets[one]["NORMAL"]] for one in item.normals if "NORMAL" in targets[one]]
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
        meshes[item.source.mesh] = _noted({**mesh, "primitives": primitives}, item, zeros)
        lengths.append(additions.byte_length - before)
    return lengths


def _noted(mesh: JsonObject, item: MadeTargets, zeros: list[list[int]]) -> JsonObject:
    """Return the JSON of a mesh with the note that tells what was added to a primitive.

    ``zeros`` are targets, and their former accessors of NORMAL, which held zeros.
    """
    extras = object_of(mesh.get("extras"))
    note = dict(object_of(extras.get(KEY)))
    if not note:
        note = {"version": VERSION, "generator": f"skinbake {__version__}"}
        note |= {"keepExtras": True} if mesh.get("extras") == {} else {}
    entries = [dict(one) for one in note.get(NOTE, [{} for _ in mesh["primitives"]])]
    numbers = sum(COMPONENTS[kind] for kind, _ in zip(("in_plane", "upward"), item.frames, strict=False))
    entries[item.source.primitive] = {
        "targets": len(item.source.json["targets"]),
        **({"normals": sorted(item.normals)} if item.normals else {}),
        **({"zeros": zeros} if zeros else {}),
        **({"frames": numbers} if numbers else {}),
        "digest": item.digest,
    }
    return {**mesh, "extras": {**extras, KEY: {**note, NOTE: entries}}}


def morph_note(mesh: JsonObject) -> JsonObject | None:
    """Return the note of a mesh whose targets bake has changed, None without a sound one."""
    note = object_of(mesh.get("extras")).get(KEY)
    if not isinstance(note, dict) or is_deeper(note, DEEPEST_NOTE) or not isinstance(note.get(NOTE), list):
        return None
    note = with_integers(note)  # some tools write all numbers anew, 1 as 1.0
    version = reference(note.get("version"))
    return None if version is None else {**note, "version": version}


class NotedTargets(NamedTuple):
    """What the note of a mesh says of a primitive: the targets with NORMAL by bake, and their digest.

    frames is how many numbers of the differential each target has: 6, 4 or 0. zeros are the accessors of
    zeros that targets had as NORMAL.
    """

    normals: tuple[int, ...] = ()
    frames: int = 0
    digest: object = None
    zeros: Mapping[int, int] = {}

    def __bool__(self) -> bool:
        """Tell whether bake has added anything to its targets."""
        return bool(self.normals or self.frames)

    @property
    def names(self) -> tuple[str, ...]:
        """The attributes of the differential."""
        return FRAMES[: 2 if self.frames > COMPONENTS["in_plane"] else bool(self.frames)]


def noted_targets(mesh: JsonObject) -> list[NotedTargets]:
    """Return what the note of a mesh says of each of its primitives.

    What is damaged in it counts as absent. So does an entry if another tool has removed or added targets:
    then the numbers may be those of others.
    """
    note = morph_note(mesh)
    entries = note[NOTE] if note else []
    added = reference((note or {}).get("targets")) or 0  # correctives, which are the last ones
    found = []
    for number, primitive in enumerate(entries_of(mesh.get("primitives"))):
        entry = object_of(entries[number]) if number < len(entries) else {}
        targets = primitive.get("targets")
        if not isinstance(targets, list) or len(targets) - added != entry.get("targets"):
            found.append(NotedTargets())
            continue
        numbers, frames = entry.get("normals"), entry.get("frames")
        normals = numbers if isinstance(numbers, list) else []
        zeros = entry.get("zeros")
        pairs = [one for one in (zeros if isinstance(zeros, list) else []) if isinstance(one, list)]
        whole = [one for one in pairs if len(one) == 2 and None not in map(reference, one)]
        found.append(
            NotedTargets(
                tuple(number for number in normals if reference(number) is not None),
                frames if frames in (4, 6) else 0,
                entry.get("digest"),
                {target: accessor for target, accessor in whole if target in normals},
            )
        )
    return found


def former_targets(document: Document, mesh: JsonObject) -> JsonObject:
    """Return the JSON of a mesh as it was before bake changed its targets.

    A NORMAL of zeros that another tool has taken away or renumbered stays away: it counts as absent.
    """
    note = morph_note(mesh)
    if note is None:
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
            zeros = {one: at for one, at in noted.zeros.items() if _is_zeros(document, at, primitive)}
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
    extras = {key: one for key, one in mesh["extras"].items() if key != KEY}
    found = {**mesh, "primitives": primitives, "extras": extras}
    if not extras and not note.get("keepExtras"):
        del found["extras"]
    return found


def _is_zeros(document: Document, accessor: int, primitive: JsonObject) -> bool:
    """Tell whether an accessor holds zeros, as many and as wide as NORMAL of a primitive."""
    accessors, normals = document.objects("accessors"), object_of(primitive.get("attributes")).get("NORMAL")
    alike = reference(normals)
    if alike is None or not (0 <= alike < len(accessors) and 0 <= accessor < len(accessors)):
        return False
    if any(accessors[accessor].get(name) != accessors[alike].get(name) for name in ("count", "type")):
        return False
    try:
        with document.budget.passing():
            return not read_accessor(document, accessor, Place(document.name)).values.any()
    except BudgetError:
        raise
    except InputError:
        return False
