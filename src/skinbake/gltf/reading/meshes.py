"""Skinned primitives: from the document to arrays, with a reason for each skipped primitive."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from skinbake.errors import InputError, Notice, Place, Skipped, UnsupportedFeatureError, skipped
from skinbake.geometry.skinned import FloatArray, IntArray, SkinnedPrimitive, not_finite
from skinbake.geometry.triangles import TRIANGLE_FAN, TRIANGLES, unrolled
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Work
from skinbake.gltf.codecs import draco, meshopt
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import (
    LARGEST_INTEGER,
    integer,
    member,
    reference,
)
from skinbake.gltf.reading.accessors import StoredArray, read_accessor
from skinbake.gltf.reading.materials import UNLIT, material_of
from skinbake.wording import counted, one_or_many

FLOAT = ("f4", False)
UNIT_VECTORS = (FLOAT, ("i1", True), ("i2", True))
FRACTIONS = (FLOAT, ("u1", True), ("u2", True))
Formats: TypeAlias = Mapping[str, tuple[str, Collection[tuple[str, bool]]]]
"""By attribute, what is expected, in words, and the component types, with their normalisation."""

FORMATS: Formats = {
    "POSITION": (
        "positions must be floats, or signed or unsigned bytes or shorts",
        (FLOAT, *product(("i1", "u1", "i2", "u2"), (False, True))),
    ),
    "NORMAL": ("normals must be floats, or normalised signed bytes or shorts", UNIT_VECTORS),
    "TANGENT": ("tangents must be floats, or normalised signed bytes or shorts", UNIT_VECTORS),
    "WEIGHTS": ("weights must be floats, or normalised unsigned bytes or shorts", FRACTIONS),
    "JOINTS": ("joints must be unsigned bytes or shorts", [*product(("u1", "u2"), (False, True))]),
}
"""The formats of glTF 2.0, §3.7.2.1, and of KHR_mesh_quantization.

"normalized" on JOINTS has no meaning and is ignored, because an index is an index.
"""


MOST_SETS = 64
"""The most influence sets of a primitive: each slot of a vertex is compared with all others of it."""


class StoredInfluences(NamedTuple):
    """One influence set as stored: joints (V, 4), weights (V, 4) of their component types."""

    joints: StoredArray
    weights: StoredArray


def skinned_sources(document: Document) -> list[PrimitiveSource]:
    """Return the primitives that a node with a skin draws.

    A primitive is skinned if a node with a skin uses its mesh *and* it has JOINTS_0. ``joint_count`` is the
    smallest number of joints of all skins of its mesh. Raises InputError if nodes, skins or meshes contradict
    each other.
    """
    joint_counts = document.asset.joint_counts
    sources = [
        source
        for source in document.asset.primitives
        if source.mesh in joint_counts and "JOINTS_0" in source.attributes
    ]
    # The vertices and triangles, as far as the JSON is sound. What is not is refused where it is read.
    counts = [_whole(element.get("count")) or 0 for element in document.objects("accessors")]
    elements = 0
    for source in sources:
        vertices, indices = (
            counts[number] if (number := _whole(name)) is not None and number < len(counts) else 0
            for name in (source.attributes.get("POSITION"), source.json.get("indices"))
        )
        elements += vertices + (indices or vertices) // 3
    document.budget.look_at(elements, _own_vertices(document, sources, counts), document.place)
    return sources


def tell_half_skinned(document: Document) -> None:
    """Tell of primitives that have joints or a skin alone, and of influences that are not read."""
    joint_counts = document.asset.joint_counts
    for source in document.asset.primitives:
        place, has_joints = source.place, "JOINTS_0" in source.attributes
        if source.mesh not in joint_counts:
            if has_joints:
                reason = "it has joints, but no node gives its mesh a skin"
                document.notices.tell(skipped("no-skin", place, reason))
        elif not has_joints:
            reason = "its node has a skin, but it has no JOINTS_0"
            document.notices.tell(skipped("no-joints", place, reason))
        elif unread := source.unread_sets:
            missing = f"it has {unread[0]} and no JOINTS_{source.influence_sets}"
            message = f"{missing}: sets after the gap are not read"
            document.notices.tell(Notice("sets-after-gap", message, place))


def plain_sources(document: Document) -> list[PrimitiveSource]:
    """Return the primitives without a skin: those that no node with a skin draws, or without JOINTS_0."""
    joint_counts = document.asset.joint_counts
    return [
        source
        for source in document.asset.primitives
        if source.mesh not in joint_counts or "JOINTS_0" not in source.attributes
    ]


def _own_vertices(
    document: Document, sources: Sequence[PrimitiveSource], counts: Sequence[int]
) -> Iterator[int]:
    """Yield the number of vertices of each primitive whose positions lie in bytes that no other one has.

    Positions without bytes do not count, nor does what is not sound: that is refused where it is read.
    """
    accessors, views = document.objects("accessors"), document.objects("bufferViews")
    parts: set[tuple[int, int, int, int]] = set()
    for source in sources:
        number = _whole(source.attributes.get("POSITION"))
        if number is None or number >= len(accessors):
            continue
        accessor, stream = accessors[number], draco.extension_of(source.json)
        at = _whole((accessor if stream is None else stream).get("bufferView"))
        if at is None or at >= len(views):
            continue
        buffer, start, length = (
            _whole(views[at].get(key, 0)) for key in ("buffer", "byteOffset", "byteLength")
        )
        if buffer is None or start is None or length is None:
            continue
        if stream is None:
            start += _whole(accessor.get("byteOffset", 0)) or 0
            length = (12 if accessor.get("componentType") == 5126 else 3) * counts[
                number
            ]  # floats, or the smallest
        parts.add((buffer, start, start + length, counts[number]))
    last: dict[int, int] = {}
    for buffer, start, end, count in sorted(parts):
        if start >= last.get(buffer, 0):
            last[buffer] = end
            yield count


def why_nothing(document: Document) -> str:
    """Return why a document without skinned primitives has none: a clause for messages."""
    if document.asset.joint_counts:
        return "the meshes that are drawn with a skin have no JOINTS_0"
    if document.objects("skins"):
        return "it has a skin, but no mesh that is drawn with one"
    return "nothing in it is skinned"


def _whole(value: object) -> int | None:
    """Return a whole number from 0 to LARGEST_INTEGER, as JSON may spell it, or None."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, int) and 0 <= value <= LARGEST_INTEGER else None


def reason_to_skip(document: Document, source: PrimitiveSource, *, generate_normals: bool) -> Skipped | None:
    """Return the reason why a skinned primitive is not baked, None if it is.

    Raises InputError if its JSON refers to missing accessors, or is not valid glTF.
    """
    asset = document.asset
    for name in source.attributes:
        asset.accessor(source.attributes, name, source.place)
    corners = asset.accessor(source.json, "indices", source.place)
    member(member(source.json, "extensions", source.place), draco.EXTENSION, source.place)
    mode = integer(source.json, "mode", source.place, default=TRIANGLES)
    if mode > TRIANGLE_FAN:
        raise InputError(f'"mode" is {mode}; glTF knows 0 to {TRIANGLE_FAN}', source.place)
    if mode < TRIANGLES:
        kind = "points" if mode == 0 else "lines"
        return skipped("no-surface", source.place, f"it draws {kind}, which have no surface")
    if "POSITION" not in source.attributes:
        return skipped("no-positions", source.place, "it has no POSITION")
    # KHR_materials_variants may give it several materials. A broken one counts as lit.
    shown = [material_of(document, number) for number in source.materials]
    unlit = all(material is not None and material.is_unlit for material in shown)
    if "NORMAL" not in source.attributes and not generate_normals and not unlit:
        reason = "it has no NORMAL; bake --generate-normals adds smooth ones"
        return skipped("no-normals", source.place, reason)
    corners = corners or asset.accessor(source.attributes, "POSITION", source.place.at("POSITION"))
    if corners is None or corners.count(source.place) < 3:
        return skipped("no-triangles", source.place, "it has no whole triangle")
    if unlit:
        reason = f"no light reaches it, because its material is unlit ({UNLIT})"
        return skipped("unlit", source.place, reason)
    return None


def has_surface(document: Document, source: PrimitiveSource) -> bool:
    """Tell whether a primitive draws a triangle, lit or not. Raises InputError if it is broken."""
    reason = reason_to_skip(document, source, generate_normals=True)
    return reason is None or reason.code == "unlit"


def parts_not_plain(
    document: Document, source: PrimitiveSource, whole: Container[str], floats: Container[str], *, moved: bool
) -> set[str]:
    """Return words for what a program cannot read that takes arrays as they lie in the file.

    They are compressions, and attributes of those in ``whole`` and ``floats`` that sparse accessors replace;
    those in ``floats`` that are not floats too. moved: its morph targets count. The primitive has been read.
    """
    accessors, views = document.asset.accessors, document.objects("bufferViews")
    found = set[str]() if draco.extension_of(source.json) is None else {draco.EXTENSION}
    for attributes in (source.attributes, *(source.whole_targets if moved else ())):
        for name, number in attributes.items():
            if name not in whole and name not in floats:
                continue
            accessor = accessors[number]
            view = reference(accessor.json.get("bufferView"))
            found |= set() if view is None else {*meshopt.extensions_of(views[view], source.place)}
            found |= {f"sparse {name}"} if "sparse" in accessor.json else set()
            if name in floats and accessor.dtype != np.float32:
                found.add(f"quantised {name}")
    return found


def has_float_tangents(document: Document, source: PrimitiveSource) -> bool:
    """Tell whether a primitive stores TANGENT as floats; InputError if it names no accessor."""
    accessor = document.asset.accessor(source.attributes, "TANGENT", source.place)
    return accessor is not None and accessor.dtype == np.float32


def read_primitive(document: Document, source: PrimitiveSource) -> SkinnedPrimitive:
    """Return the arrays of one skinned primitive.

    normals is (0, 3) without NORMAL. Raises InputError if an attribute has a format that glTF does not allow
    or another count than POSITION, if positions or weights are not finite, and for a joint index outside the
    skin at a weight other than zero. Normals and tangents that are not finite stay for the caller.
    """
    positions = read_decoded(document, source, "POSITION", 3)
    refuse_not_finite(positions, "values", source.place.at("POSITION"))
    count = len(positions)
    normals = (
        read_decoded(document, source, "NORMAL", 3, count)
        if "NORMAL" in source.attributes
        else np.zeros((0, 3))
    )
    has_tangent = "TANGENT" in source.attributes and "NORMAL" in source.attributes
    tangents = read_decoded(document, source, "TANGENT", 4, count) if has_tangent else None
    influences = read_influences(document, source, count)
    sizes = [entry.joints.values.nbytes * (len(influences) > 1) for entry in influences]
    sizes += [entry.weights.decoded_size or entry.weights.values.nbytes for entry in influences]
    document.budget.claim(Work(bytes=sum(sizes)), "its influences", source.place)
    joints: IntArray = np.zeros((count, 0), np.uint8)
    weights: FloatArray = np.zeros((count, 0), np.float32)
    if influences:  # a mesh without a skin has none
        joints, weights = side_by_side(influences)
    for number in range(len(influences)):
        own = weights[:, 4 * number : 4 * number + 4]
        refuse_not_finite(own, "weights", source.place.at(f"WEIGHTS_{number}"))
    counting = joints_of_skin(joints, weights, source)
    triangles, stored = read_triangles(document, source), None if counting is joints else joints
    return SkinnedPrimitive(positions, normals, tangents, counting, weights, triangles, stored_joints=stored)


def refuse_not_finite(values: FloatArray, name: str, place: Place) -> None:
    """Raise InputError if the values (V, C) of an attribute are not all finite numbers."""
    if np.isfinite(values).all():
        return
    vertices = np.flatnonzero(~np.isfinite(values).all(axis=1))
    first = f"vertex {vertices[0]}, where {not_finite(values[vertices[0]])}"
    found = one_or_many(len(vertices), f"at {first}", f"at {{}} vertices, first at {first}")
    message = f"its {name} are not all finite numbers ({found}): mend the mesh in the modelling tool"
    raise InputError(message, place)


def read_influences(document: Document, source: PrimitiveSource, count: int) -> list[StoredInfluences]:
    """Return every influence set of a primitive with ``count`` vertices, as stored."""
    sets = []
    if source.influence_sets > MOST_SETS:
        raise UnsupportedFeatureError(
            f"it has {source.influence_sets} influence sets; the limit is {MOST_SETS}", source.place
        )
    for number in range(source.influence_sets):
        if f"WEIGHTS_{number}" not in source.attributes:
            lacks = f"it has JOINTS_{number} and no WEIGHTS_{number}"
            raise InputError(f"{lacks}: write the weights, or remove the joints", source.place)
        joints = _stored(document, source, f"JOINTS_{number}", 4, count)
        weights = _stored(document, source, f"WEIGHTS_{number}", 4, count)
        sets.append(StoredInfluences(joints, weights))
    return sets


def side_by_side(sets: Sequence[StoredInfluences]) -> tuple[IntArray, FloatArray]:
    """Return joints and weights of all influence sets, (V, K) each, decoded; one set is not copied."""
    joints = [cast(IntArray, entry.joints.values) for entry in sets]  # the format has been checked
    weights = [entry.weights.decoded() for entry in sets]
    if len(sets) == 1:
        return joints[0], weights[0]
    return np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)


def read_triangles(document: Document, source: PrimitiveSource) -> npt.NDArray[np.uint32]:
    """Return the triangles (T, 3) of the primitive, strips and fans unrolled; InputError for an index ≥ V."""
    place = source.place.at("indices")
    mode = integer(source.json, "mode", place, default=TRIANGLES)
    indices = read_indices(document, source)
    # The triangles of a strip or fan come from three temporary arrays.
    each = 4 * (indices.dtype != np.uint32) if mode == TRIANGLES else 40
    document.budget.claim(Work(bytes=each * len(indices)), "its triangles", place)
    return unrolled(indices, mode)


def read_indices(document: Document, source: PrimitiveSource) -> IntArray:
    """Return the indices (N,) of the primitive, 0 … V − 1 without any; InputError for an index ≥ V."""
    place = source.place.at("indices")
    of_positions = source.place.at("POSITION")
    count = document.asset.needed(source.attributes, "POSITION", of_positions).count(of_positions)
    corners = document.asset.accessor(source.json, "indices", place)
    if corners is None:
        document.budget.claim(Work(bytes=4 * count), "its indices", place)
        return np.arange(count, dtype=np.uint32)
    stored = read_accessor(document, corners.number, place).values
    if stored.dtype.kind != "u" or stored.shape[1] != 1:
        raise InputError("indices must be scalars of an unsigned integer type", place)
    indices: IntArray = stored[:, 0]  # type: ignore[assignment]  # unsigned: checked above
    if indices.max() >= count:
        raise InputError(
            f"index {indices.max()} is too large for {counted(count, 'vertex', 'vertices')}", place
        )
    return indices


def _stored(
    document: Document,
    source: PrimitiveSource,
    attribute: str,
    components: int,
    count: int | None,
    formats: Formats = FORMATS,
) -> StoredArray:
    place = source.place.at(attribute)
    accessor = document.asset.needed(source.attributes, attribute, place)
    declared = accessor.count(place)
    if count is not None and declared != count:
        raise InputError(f"it has {counted(declared, 'element')}, POSITION has {count:,}", place)
    stored = read_accessor(document, accessor.number, place)
    check_format(stored, attribute, components, place, formats)
    return stored


def check_format(
    stored: StoredArray,
    attribute: str,
    components: int,
    place: Place,
    formats: Formats = FORMATS,
) -> None:
    """Raise InputError if glTF does not allow these components or this type for an attribute."""
    if stored.values.shape[1] != components:
        found = counted(stored.values.shape[1], "component")
        raise InputError(f"it has {found}, {components} are needed", place)
    family = attribute.split("_", maxsplit=1)[0]
    kind = stored.values.dtype.str[1:]
    expected, allowed = formats[family]
    if (kind, stored.normalized) in allowed:
        return
    remedy = f"export the mesh again with {'unsigned shorts' if family == 'JOINTS' else 'floats'}"
    if not stored.normalized and (kind, True) in allowed:
        remedy = f'set "normalized": true in its accessor if {np.iinfo(kind).max} stands for 1, or {remedy}'
    found = f"{'normalised ' if stored.normalized else ''}{stored.values.dtype.name}"
    raise InputError(f"{expected}, found {found}: {remedy}", place)


def read_decoded(
    document: Document,
    source: PrimitiveSource,
    attribute: str,
    components: int,
    count: int | None = None,
    formats: Formats = FORMATS,
) -> FloatArray:
    """Return an attribute (V, components), with as many elements as ``count``. Raises InputError."""
    stored = _stored(document, source, attribute, components, count, formats)
    document.budget.claim(Work(bytes=stored.decoded_size), "its decoded values", source.place.at(attribute))
    return stored.decoded()


def joints_of_skin(joints: IntArray, weights: FloatArray, source: PrimitiveSource) -> IntArray:
    """Return joints (V, K) as they count: 0 in slot 0 of a vertex without weight if that is past the skin's.

    Raises InputError for a joint past the skin's at a weight other than zero.
    """
    if not joints.size or joints.max() < source.joint_count:
        return joints
    outside = (joints >= source.joint_count) & (weights != 0)
    if outside.any():
        vertex, slot = np.argwhere(outside)[0]
        raise InputError(
            f"vertex {vertex} has a weight for joint {joints[vertex, slot]}, but the skin has only "
            f"{counted(source.joint_count, 'joint')}. The number of such vertices is "
            f"{np.count_nonzero(outside.any(axis=1)):,}",
            source.place.at(f"JOINTS_{slot // 4}"),
        )
    # Such a vertex counts as bound to the joint of slot 0, and its neighbours adopt that one.
    unbound = (joints[:, 0] >= source.joint_count) & ~(weights > 0.0).any(axis=1)
    if unbound.any():
        joints = joints.copy()
        joints[unbound, 0] = 0
    return joints
