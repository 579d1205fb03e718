"""Accessors whose values are in a Draco stream (KHR_draco_mesh_compression).

The extension is a member of a primitive. It says by unique id which attribute of the stream holds which
attribute of the primitive. The accessors declare the number and the type of the values, and have no buffer
view. An accessor may have a buffer view too, for loaders that do not know the extension. It is still read
from the stream, because the vertices have the same order there for all attributes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.errors import BrokenPassedOver, InputError, Place, UnsupportedFeatureError
from skinbake.geometry.triangles import TRIANGLES
from skinbake.gltf.asset import Shape
from skinbake.gltf.budget import Work
from skinbake.gltf.codecs.meshopt import view_bytes
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import JsonObject, entries_of, index, integer, member, reference
from skinbake.wording import counted

if TYPE_CHECKING:
    from skinbake.gltf.codecs.draco_stream import DracoMesh

EXTENSION = "KHR_draco_mesh_compression"
USUAL_LEVEL = 7
"""The default effort of Draco, from 0 (fast) to 10 (small)."""

MOST_ATTRIBUTES = 127
"""The most attributes of one stream: DracoPy numbers them with signed bytes."""


class Claim(NamedTuple):
    """The data of an accessor: one attribute of a primitive's stream, or its triangles (None).

    primitive is the JSON of the primitive at the time when it had that stream.
    """

    primitive: JsonObject
    unique_id: int | None


def extension_of(primitive: JsonObject) -> JsonObject | None:
    """Return a primitive's Draco extension, None where it has none or something that is not an object."""
    extensions = primitive.get("extensions")
    found = extensions.get(EXTENSION) if isinstance(extensions, dict) else None
    return found if isinstance(found, dict) else None


def decoded_accessor(
    document: Document, number: int, shape: Shape, place: Place
) -> npt.NDArray[np.generic] | None:
    """Return the values (count, components) of an accessor from its Draco stream, None without one.

    shape is the dtype, components and count that the accessor declares. Raises InputError if the stream
    cannot be decoded or holds other data. Raises UnsupportedFeatureError if streams hold different values for
    one accessor.
    """
    draco = _draco_of(document)
    claims, known = draco.claims.get(number), draco.values
    if claims is None:
        return None
    if number not in known:
        values = _claimed(document, claims[0], shape, place)
        for other in claims[1:]:
            if not _equal(values, _claimed(document, other, shape, place)):
                raise UnsupportedFeatureError(
                    f"accessor {number} stands for different values in two Draco streams", place
                )
        known[number] = values
    return known[number]


def holds_the_same(document: Document, primitive: JsonObject, before: JsonObject, place: Place) -> bool:
    """Tell whether the stream of ``before`` has the data of a primitive's stream, where both name it.

    False if it cannot be read, because another tool has moved or removed the buffer view since. Raises
    InputError if primitives share streams so often that comparing them would take too much memory.
    """
    now, then = dict(_claims_of(primitive)), dict(_claims_of(before))
    known = _draco_of(document).pairs
    with BrokenPassedOver():
        for number in now.keys() & then.keys():
            pair = now[number], then[number]
            key = number, *(_data_of(claim) for claim in pair)
            if key not in known:
                shape = _shape(document, number, place)
                values = [_claimed(document, claim, shape, place) for claim in pair]
                work = Work(bytes=2 * values[0].nbytes)
                document.budget.claim(work, "comparing its Draco streams", place, passing=True)
                known[key] = _equal(*values)
            if not known[key]:
                return False
        return read_stream(document, before, place).faces.size > 0
    return False


def _equal(one: npt.NDArray[np.generic], other: npt.NDArray[np.generic]) -> bool:
    """Tell whether two arrays of one type are equal bit for bit."""
    return one is other or (one.shape == other.shape and one.tobytes() == other.tobytes())


def _shape(document: Document, number: int, place: Place) -> Shape:
    accessors = document.asset.accessors
    if not 0 <= number < len(accessors):
        raise InputError(f"it refers to accessor {number} of an array of {len(accessors)}", place)
    if accessors[number].dtype is None or accessors[number].components is None:
        raise InputError(f"accessor {number} has a type that a Draco stream cannot hold", place)
    return accessors[number].shape(place)


@dataclass
class _Draco:
    """The Draco streams of a document: who claims their data, and what was decoded.

    - ``claims`` are by accessor, several if primitives share it.
    - ``values`` belong to accessors: if primitives share one, their values are compared once.
    - ``pairs`` tells whether two claims to an accessor hold the same values.
    - ``streams`` are by buffer view and declared counts.
    """

    claims: dict[int, list[Claim]]
    values: dict[int, npt.NDArray[np.generic]] = field(default_factory=dict)
    pairs: dict[tuple[object, ...], bool] = field(default_factory=dict)
    streams: dict[tuple[int, ...], DracoMesh] = field(default_factory=dict)
    has_former: bool = False


@once_a_document
def _draco_of(document: Document) -> _Draco:
    different: dict[int, dict[object, Claim]] = {}
    for primitive in _primitives(document):
        for number, claim in _claims_of(primitive):
            different.setdefault(number, {}).setdefault(_data_of(claim), claim)
    return _Draco({number: list(held.values()) for number, held in different.items()})


def add_former_streams(document: Document, former: Callable[[JsonObject], JsonObject | None]) -> None:
    """Let accessors that no present stream holds be read from the streams that primitives had before an edit.

    former returns a primitive of the document as it was, None where it had no other stream. A second call for
    a document does nothing: every primitive that is restored makes one.
    """
    draco = _draco_of(document)
    if draco.has_former:
        return
    draco.has_former = True
    for primitive in filter(None, map(former, _primitives(document))):
        for number, claim in _claims_of(primitive):
            draco.claims.setdefault(number, [claim])


def _primitives(document: Document) -> Iterator[JsonObject]:
    for mesh in document.objects("meshes"):
        for primitive in entries_of(mesh.get("primitives")):
            if extension_of(primitive) is not None:
                yield primitive


def accessors_inside(document: Document, primitive: JsonObject, place: Place) -> Iterator[tuple[int, bool]]:
    """Yield the accessors in a primitive's stream, and whether each one holds its indices.

    Raises InputError if one is missing, or has a type that a stream cannot hold.
    """
    for number, claim in _claims_of(primitive):
        _shape(document, number, place)
        yield number, claim.unique_id is None


def _claims_of(primitive: JsonObject) -> Iterator[tuple[int, Claim]]:
    inside = (extension_of(primitive) or {}).get("attributes")
    attributes = primitive.get("attributes")
    for name, unique_id in inside.items() if isinstance(inside, dict) else ():
        number = reference(attributes.get(name)) if isinstance(attributes, dict) else None
        if number is not None:
            yield number, Claim(primitive, reference(unique_id))
    indices = reference(primitive.get("indices"))
    if indices is not None:
        yield indices, Claim(primitive, None)


def _data_of(claim: Claim) -> tuple[int | None, int | None]:
    """Return the attribute and the buffer view of a claim."""
    view = (extension_of(claim.primitive) or {}).get("bufferView")
    return reference(view), claim.unique_id


def _claimed(document: Document, claim: Claim, shape: Shape, place: Place) -> npt.NDArray[np.generic]:
    mesh = read_stream(document, claim.primitive, place)
    faces = mesh.faces.reshape(-1, 1)
    values = faces if claim.unique_id is None else mesh.attributes.get(claim.unique_id)
    if values is None:
        there = ", ".join(map(str, sorted(mesh.attributes))) or "none"
        raise InputError(f"its Draco stream has no attribute {claim.unique_id}; it has {there}", place)
    if values.dtype != shape[0]:
        work = Work(bytes=values.size * (shape[0].itemsize + 16))
        document.budget.claim(work, "the content of its Draco stream", place)
    largest = None if claim.unique_id is None else mesh.signed.get(claim.unique_id)
    return _of_type(values, shape, largest, place)


def _of_type(
    values: npt.NDArray[Any], shape: Shape, largest: int | None, place: Place
) -> npt.NDArray[np.generic]:
    """Return decoded values in the declared type of the accessor, which must hold each of them exactly."""
    dtype, components, count = shape
    if values.shape != (count, components):
        raise InputError(
            f"its Draco stream holds {counted(values.shape[0], 'element')} of "
            f"{counted(values.shape[1], 'component')}, but the accessor declares {count:,} of {components}",
            place,
        )
    if values.dtype == dtype:
        return values
    if largest is not None and dtype.kind != "f" and np.any(values != np.rint(values)):
        values = np.rint(values.astype(np.float64) * largest)  # Draco's "normalized" signed integers
    with np.errstate(invalid="ignore", over="ignore"):  # what does not fit is refused below
        cast = values.astype(dtype)
    if not np.array_equal(cast.astype(np.float64), values.astype(np.float64)):
        raise InputError(
            f"its Draco stream holds values that do not fit the {dtype.name} of its accessor", place
        )
    return cast


def read_stream(document: Document, primitive: JsonObject, place: Place) -> DracoMesh:
    """Return the decoded stream of a Draco primitive; InputError if it contradicts the JSON."""
    from skinbake.gltf.codecs import draco_stream

    extension = extension_of(primitive) or {}
    view = index(extension, "bufferView", len(document.objects("bufferViews")), place)
    if view is None:
        raise InputError(f"its {EXTENSION} names no buffer view", place)
    if integer(primitive, "mode", place, default=TRIANGLES) != TRIANGLES:
        raise UnsupportedFeatureError(
            "it is a triangle strip in Draco, which decoders read in different ways: store it as triangles",
            place,
        )
    counts = declared(document, primitive, member(extension, "attributes", place), place)
    known = _draco_of(document).streams
    key = (view, *counts)
    if key not in known:
        data = view_bytes(document, view, place)
        found = draco_stream.check_counts(data, *counts[:2], place)
        work = Work(bytes=counts[2], unpacked=counts[2], packed=len(data))
        document.budget.claim(work, "compressed data", place)
        known[key] = draco_stream.decode(data, found.method, counts[2], place)
    return known[key]


def declared(
    document: Document, primitive: JsonObject, inside: Mapping[str, Any], place: Place
) -> tuple[int, int, int]:
    """Return the declared vertices and indices of a Draco primitive, and the bytes of all its accessors.

    Raises InputError if the attributes ``inside`` the stream have different counts or no accessor.
    """
    asset, attributes = document.asset, member(primitive, "attributes", place)
    vertices, size = 0, 0
    for name in inside:
        accessor = asset.accessor(attributes, name, place.at(name))
        if accessor is None:
            raise InputError(f"its {EXTENSION} has {name}, but the primitive does not", place)
        count = accessor.count(place.at(name))
        if vertices not in {0, count}:
            from skinbake.gltf.codecs.draco_stream import REMEDY

            raise InputError(
                f"it has {counted(count, 'element')}, but other attributes of its Draco stream have "
                f"{vertices:,}{REMEDY}",
                place,
            )
        itemsize = 0 if accessor.dtype is None else accessor.dtype.itemsize
        vertices, size = count, size + count * (accessor.components or 0) * itemsize
    corners = asset.accessor(primitive, "indices", place.at("indices"))
    if vertices == 0 or corners is None:
        raise InputError(f"its {EXTENSION} has no attributes, or the primitive has no indices", place)
    count = corners.count(place.at("indices"))
    return vertices, count, size + 4 * count
