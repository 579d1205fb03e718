"""What a bake has stored for a primitive, decoded by its note, or the problem with it: α, β and the blend.

The blend weight b of a vertex is in an attribute that the user names: 0 is linear blend skinning, 1 dual
quaternion skinning (``skinning.blended``). Its gradient is stored as ∂b/∂t0 and ∂b/∂b0, in the frame of α, β.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import Encoding, Layout
from skinbake.errors import BudgetError, InputError, Notice, Place
from skinbake.format.encodings import DTYPES, decoded, noted_format
from skinbake.format.note import BAKE, BLEND_GRADIENT, GradientNote
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.meshes import FRACTIONS, read_decoded, refuse_not_finite
from skinbake.wording import counted

COMPONENT_TYPES = {Encoding.FLOAT32: "FLOAT", Encoding.SNORM16: "SHORT", Encoding.PACKED8: "BYTE"}


class DamagedBake(Exception):  # noqa: N818  # a verdict on a part, which ``baked_views`` tells
    """What a bake has stored is damaged; ``notice`` says how."""

    def __init__(self, code: str, message: str, place: Place, count: int = 1) -> None:
        super().__init__(message)
        self.notice = Notice(code, message, place, count)


class StoredSlots(NamedTuple):
    """α and β of slots 1 … K − 1 as a shader reads them, each (V, K − 1), in 1 / length unit of POSITION.

    rounding (V, 2) is the largest change of a value of α, and of β, by the encoding.
    """

    alpha: FloatArray
    beta: FloatArray
    rounding: Float64Array


def read_slots(document: Document, source: PrimitiveSource, note: GradientNote, count: int) -> StoredSlots:
    """Return α and β of a primitive with ``count`` vertices, by a note without ``damage``.

    Raises DamagedBake.
    """
    storage = noted_format(note)
    is_texcoord = storage.layout is Layout.TEXCOORD
    arrays: dict[str, npt.NDArray[Any]] = {}
    for name in note.slot_names:
        # Set 0 holds slots 1 to 3, and perhaps the scale of the vertex.
        is_first = name in (note.alpha[0], note.beta[0])
        width = 2 if is_texcoord else 3 if is_first and not storage.encoding.is_scaled else 4
        arrays[name] = _read(document, source, name, (count, width), storage.encoding)
    if is_texcoord:  # all numbers of α, then all of β, two in each set
        numbers = np.concatenate(list(arrays.values()), axis=1)
        return StoredSlots(numbers[:, : len(arrays)], numbers[:, len(arrays) :], np.zeros((count, 2)))
    of_alpha, of_beta = (
        decoded([arrays[name] for name in names], storage.encoding, storage.scale)
        for names in (note.alpha, note.beta)
    )
    rounding = np.column_stack([of_alpha.rounding, of_beta.rounding])
    return StoredSlots(of_alpha.values, of_beta.values, rounding)


def _read(
    document: Document, source: PrimitiveSource, name: str, shape: Sequence[int], encoding: Encoding
) -> npt.NDArray[Any]:
    """Return an attribute of this shape that a bake has added. Raises DamagedBake."""
    place = source.place.at(name)
    accessor = document.asset.accessor(source.attributes, name, place)
    if accessor is None:
        message = f"its metadata names this attribute, but the attribute was removed or renamed: {BAKE}"
        raise DamagedBake("attribute-missing", message, place)
    stored = read_accessor(document, accessor.number, place)
    values: npt.NDArray[Any] = stored.values
    if values.dtype != DTYPES[encoding] or stored.normalized != encoding.is_scaled:
        kind = f"{'normalised ' if stored.normalized else ''}{values.dtype.name}"
        wanted = f"{'normalised ' if encoding.is_scaled else ''}{COMPONENT_TYPES[encoding]}"
        done = "dequantised" if values.dtype.kind == "f" else "quantised"
        message = (
            f"it is stored as {kind}, expected {wanted}: another tool has probably {done} it "
            f"after the bake. Bake last: {BAKE} on the output of the last tool, or keep the tool "
            "off this attribute"
        )
        raise DamagedBake("attribute-format", message, place)
    if values.shape != tuple(shape):
        message = (
            f"it holds {values.shape[0]:,} vectors of {values.shape[1]}, expected "
            f"{shape[0]:,} of {shape[1]}: {BAKE}"
        )
        raise DamagedBake("attribute-format", message, place)
    broken = int(np.count_nonzero(~np.isfinite(values).all(axis=1)))
    if broken:
        message = f"at {counted(broken, 'vertex', 'vertices')} it is not a finite number: {BAKE}"
        raise DamagedBake("attribute-not-finite", message, place, broken)
    return values


SLACK = 1e-4
"""By so much a weight may lie outside 0 to 1: what rounding and interpolation leave."""

# An attribute whose name begins with an underscore has the family "".
_FORMATS = {"": ("blend weights must be floats, or normalised unsigned bytes or shorts", FRACTIONS)}


class BlendGradient(NamedTuple):
    """The name of the attribute with b, and the gradient (V, 2) of b along t0 and b0."""

    weights: str
    gradient: Float32Array


def read_blend_weights(
    document: Document, source: PrimitiveSource, name: str, count: int
) -> FloatArray | None:
    """Return b (V,) of a primitive with ``count`` vertices, None if it has no attribute of that name.

    Raises InputError if these are not numbers from 0 to 1, one for each vertex.
    """
    place = source.place.at(name)
    if name not in source.attributes:
        return None
    weights = read_decoded(document, source, name, 1, count, _FORMATS)
    refuse_not_finite(weights, "blend weights", place)
    outside = np.flatnonzero((weights[:, 0] < -SLACK) | (weights[:, 0] > 1.0 + SLACK))
    if len(outside):
        message = (
            f"it is {weights[outside[0], 0]:.6g} at vertex {outside[0]}, expected 0 (linear blend skinning) "
            f"to 1 (dual quaternions). The number of such vertices is {len(outside):,}"
        )
        raise InputError(message, place)
    return weights[:, 0]


def read_blend(
    document: Document, source: PrimitiveSource, note: GradientNote, count: int
) -> Float64Array | None:
    """Return b, ∂b/∂t0 and ∂b/∂b0 (V, 3) of a baked primitive, None without a blend, by a sound note.

    Raises DamagedBake.
    """
    if note.blend is None:
        return None
    name = note.blend.weights
    gradient = _read(document, source, BLEND_GRADIENT, (count, 2), Encoding.FLOAT32)
    try:
        weights = read_blend_weights(document, source, name, count)
    except BudgetError:
        raise
    except InputError as error:
        raise DamagedBake("attribute-format", error.message, error.place or source.place) from error
    if weights is None:
        message = (
            f"the bake read its blend weights from {name}, which was removed or renamed: run skinbake bake "
            "on a file that has it"
        )
        raise DamagedBake("attribute-missing", message, source.place.at(name))
    return np.column_stack([weights, gradient]).astype(np.float64)
