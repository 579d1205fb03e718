"""The stored α and β of one primitive, decoded by its metadata, or the problem with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import Encoding, Layout
from skinbake.errors import Notice, Place
from skinbake.format.encodings import DTYPES, decoded
from skinbake.format.layouts import GradientFormat, noted_format, unpaired
from skinbake.format.metadata import slot_names
from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.gltf import json_access
from skinbake.gltf.accessors import StoredArray, read_accessor
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index
from skinbake.gltf.primitives import PrimitiveSource
from skinbake.wording import counted

BAKE = "run skinbake bake"

NO_METADATA = (
    "it has α/β but no metadata that can be read (another tool may have dropped the extras), so a bake would "
    f"take adopted joints for its own: {BAKE} on its source"
)
COMPONENT_TYPES = {Encoding.FLOAT32: "FLOAT", Encoding.SNORM16: "SHORT", Encoding.PACKED8: "BYTE"}


class StoredSlots(NamedTuple):
    """α and β of slots 1 … K − 1 as a shader reads them, each (V, K − 1), in 1 / length unit of POSITION.

    rounding (V, 2) is the largest change of a value of α, and of β, by the encoding.
    """

    alpha: FloatArray
    beta: FloatArray
    rounding: Float64Array


def wrong_storage(metadata: JsonObject, influence_sets: int) -> Iterator[str]:
    """Yield the defects of the metadata's members about the storage of α and β."""
    layout, encoding, scale = (metadata.get(key) for key in ("layout", "encoding", "scale"))
    for key, value, known in (("layout", layout, [*Layout]), ("encoding", encoding, [*Encoding])):
        if key in metadata and value not in known:
            yield f'"{key}" is {shown(value)}'
    if encoding in (Encoding.SNORM16, Encoding.PACKED8) and not (json_access.is_number(scale) and scale >= 0):
        yield f'"scale" is {shown(scale)}'
    count = 2 * influence_sets if layout == Layout.TEXCOORD else influence_sets
    for key in ("alpha", "beta"):
        names = metadata.get(key)
        if not isinstance(names, list) or not (
            len(names) == count and all(isinstance(value, str) for value in names)
        ):
            yield f'"{key}" is {shown(names)}, not an attribute for each influence set'
            return
    if layout == Layout.TEXCOORD and len(slot_names(metadata)) != 4 * influence_sets - 1:
        yield (f'"alpha" and "beta" are {shown(slot_names(metadata))}: the set that both share is missing')


def shown(value: object) -> str:
    """Return a value of the metadata for a message, shortened."""
    if value is None:
        return "missing"
    return json_access.shown(value)


def read_slots(
    document: Document, source: PrimitiveSource, metadata: JsonObject, count: int
) -> StoredSlots | Notice:
    """Return α and β of a primitive with ``count`` vertices, or the problem with them.

    ``wrong_storage`` must have found no defect in the metadata.
    """
    storage = noted_format(metadata)
    arrays: dict[str, npt.NDArray[Any]] = {}
    for name in slot_names(metadata):
        first = name in (metadata["alpha"][0], metadata["beta"][0])
        found = read_array(document, source, name, _shape(storage, count, first=first), storage.encoding)
        if isinstance(found, Notice):
            return found
        arrays[name] = found
    if storage.layout is Layout.TEXCOORD:
        alpha, beta = unpaired(list(arrays.values()))
        return StoredSlots(alpha, beta, np.zeros((count, 2)))
    of_alpha, of_beta = (
        decoded([arrays[name] for name in metadata[key]], storage.encoding, storage.scale)
        for key in ("alpha", "beta")
    )
    rounding = np.column_stack([of_alpha.rounding, of_beta.rounding])
    return StoredSlots(of_alpha.values, of_beta.values, rounding)


def _shape(storage: GradientFormat, count: int, *, first: bool) -> tuple[int, int]:
    """Return the shape of an attribute that holds slots; ``first`` tells whether it belongs to set 0."""
    if storage.layout is Layout.TEXCOORD:
        return count, 2
    return count, 3 if first and not storage.encoding.is_scaled else 4


def read_array(
    document: Document, source: PrimitiveSource, name: str, shape: Sequence[int], encoding: Encoding
) -> npt.NDArray[Any] | Notice:
    """Return an attribute that a bake has added to a primitive, of this shape, or the problem with it."""
    place = source.place.at(name)
    accessor = index(source.attributes, name, len(document.objects("accessors")), place)
    if accessor is None:
        message = f"its metadata names this attribute, but the attribute was removed or renamed: {BAKE}"
        return Notice("attribute-missing", message, place)
    stored = read_accessor(document, accessor, place)
    problem = _format_problem(stored, shape, encoding, place)
    if problem is not None:
        return problem
    values: npt.NDArray[Any] = stored.values
    broken = int(np.count_nonzero(~np.isfinite(values).all(axis=1)))
    if broken:
        message = f"at {counted(broken, 'vertex', 'vertices')} it is not a finite number: {BAKE}"
        return Notice("attribute-not-finite", message, place, broken)
    return values


def _format_problem(
    stored: StoredArray, shape: Sequence[int], encoding: Encoding, place: Place
) -> Notice | None:
    values = stored.values
    if values.dtype != DTYPES[encoding] or stored.normalized != encoding.is_scaled:
        found = f"{'normalised ' if stored.normalized else ''}{values.dtype.name}"
        wanted = f"{'normalised ' if encoding.is_scaled else ''}{COMPONENT_TYPES[encoding]}"
        done = "dequantised" if values.dtype.kind == "f" else "quantised"
        message = (
            f"it is stored as {found}, expected {wanted}: another tool has probably {done} it "
            f"after the bake. Bake last: {BAKE} on the output of the last tool, or keep the tool "
            "off this attribute"
        )
        return Notice("attribute-format", message, place)
    if values.shape != tuple(shape):
        message = (
            f"it holds {values.shape[0]:,} vectors of {values.shape[1]}, expected "
            f"{shape[0]:,} of {shape[1]}: {BAKE}"
        )
        return Notice("attribute-format", message, place)
    return None
