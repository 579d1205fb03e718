"""Accessors to arrays: every component type, normalised, strided, sparse, compressed (glTF 2.0, §3.6.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.errors import InputError, Place
from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.gltf.asset import Shape, component_dtype
from skinbake.gltf.budget import Work
from skinbake.gltf.codecs import draco
from skinbake.gltf.codecs.meshopt import view_bytes
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, integer, member
from skinbake.wording import counted, one_or_many


class StoredArray(NamedTuple):
    """The elements of an accessor as stored: values (count, components) of its component type."""

    values: npt.NDArray[np.generic]
    normalized: bool

    @property
    def decoded_size(self) -> int:
        """Return the bytes that ``decoded`` takes: integers become float64, in three steps if normalised."""
        return 0 if self.values.dtype.kind == "f" else self.values.size * (24 if self.normalized else 8)

    def decoded(self) -> FloatArray:
        """Return the values as the vertex shader reads them.

        FLOAT stays float32, without a copy. Integers become float64. Normalised integers are divided by the
        largest value of the type, and clamped at −1. In float64, 255ths and 65535ths sum to one exactly
        enough.
        """
        values = self.values
        if values.dtype.kind == "f":
            return values.astype(np.float32, copy=False)
        decoded = values.astype(np.float64)
        if not self.normalized:
            return decoded
        return np.asarray(np.maximum(decoded / np.iinfo(values.dtype.str).max, -1.0))

    def wide(self) -> Float64Array:
        """Return the decoded values as float64; NaN of every kind stays."""
        with np.errstate(invalid="ignore"):  # casting a signalling NaN
            return self.decoded().astype(np.float64)


def read_accessor(document: Document, number: int, place: Place) -> StoredArray:
    """Return the elements of accessor ``number``, with its sparse substitution.

    The array may be a read-only, strided view of the buffer. Its elements are aligned, even if the file does
    not align them. Raises InputError if the accessor, its buffer view, its buffer and the bytes contradict
    each other.
    """
    accessor = document.asset.accessors[number]
    dtype, components, count = shape = accessor.shape(place)
    values = draco.decoded_accessor(document, number, shape, place)
    if values is None:
        view = index(accessor.json, "bufferView", len(document.objects("bufferViews")), place)
        if view is not None:
            offset = integer(accessor.json, "byteOffset", place, default=0)
            values = _view_array(document, view, offset, shape, place)
        else:
            document.budget.claim_zeros(count * components * dtype.itemsize, number, place)
            values = np.zeros((count, components), dtype)
    if "sparse" in accessor.json:
        values = _substituted(document, member(accessor.json, "sparse", place), values, place)
    if not values.flags.aligned:  # glTF forbids this, and compiled code cannot read it
        values = values.copy()
    return StoredArray(values, accessor.is_normalized and dtype.kind != "f")


def read_wide(document: Document, number: int, place: Place) -> Float64Array:
    """Return the decoded values of an accessor of an animation or skin as float64; InputError as above."""
    stored = read_accessor(document, number, place)
    # The decoded values, the widened ones, and the same again if components change places.
    size = stored.decoded_size + 16 * stored.values.size
    document.budget.claim(Work(bytes=size), f"accessor {number} of an animation or skin", place)
    return stored.wide()


def read_attribute(document: Document, attributes: Mapping[str, Any], name: str, place: Place) -> StoredArray:
    """Return the elements of the accessor to which an object maps an attribute; InputError without one."""
    return read_accessor(document, document.asset.needed(attributes, name, place).number, place)


def _view_array(
    document: Document,
    view_index: int,
    offset: int,
    shape: Shape,
    place: Place,
) -> npt.NDArray[np.generic]:
    dtype, components, count = shape
    view = document.objects("bufferViews")[view_index]
    data = view_bytes(document, view_index, place)
    element = dtype.itemsize * components
    stride = integer(view, "byteStride", place, default=element, minimum=1)
    if stride < element:
        raise InputError(
            f"buffer view {view_index} has byteStride {stride} for elements of {counted(element, 'byte')}",
            place,
        )
    end = offset + stride * (count - 1) + element
    if end > len(data):
        raise InputError(
            f"{one_or_many(count, '1 element needs', '{} elements need')} {counted(end, 'byte')} of "
            f"buffer view {view_index}, which has {len(data):,}",
            place,
        )
    # The stride of a single element may be larger than any address.
    return np.ndarray(
        (count, components), dtype, data, offset, (stride if count > 1 else element, dtype.itemsize)
    )


def _substituted(
    document: Document, sparse: JsonObject, dense: npt.NDArray[np.generic], place: Place
) -> npt.NDArray[np.generic]:
    count = integer(sparse, "count", place, minimum=1)
    where, what = member(sparse, "indices", place), member(sparse, "values", place)
    dtype = component_dtype(where)
    if dtype is None or dtype.kind != "u":
        raise InputError("the indices of a sparse accessor are not unsigned integers", place)
    count_of_views = len(document.objects("bufferViews"))
    index_view, value_view = (index(holder, "bufferView", count_of_views, place) for holder in (where, what))
    if index_view is None or value_view is None:
        raise InputError("a sparse accessor names no buffer view for its indices or values", place)
    offsets = integer(where, "byteOffset", place, default=0), integer(what, "byteOffset", place, default=0)
    positions = _view_array(document, index_view, offsets[0], (dtype, 1, count), place)[:, 0].astype(np.int64)
    if positions.max() >= len(dense):
        raise InputError(
            f"a sparse accessor replaces element {positions.max()}, but it has only "
            f"{counted(len(dense), 'element')}",
            place,
        )
    document.budget.claim(Work(bytes=dense.nbytes), "its sparse accessor", place)
    values = dense.copy()
    values[positions] = _view_array(
        document, value_view, offsets[1], (dense.dtype, dense.shape[1], count), place
    )
    return values
