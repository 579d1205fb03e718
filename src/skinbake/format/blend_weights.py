"""The blend weight b of each vertex, in an attribute that the user names, and its stored gradient.

b = 0 is linear blend skinning, b = 1 dual quaternion skinning (``skinning.blended``). The gradient is stored
as ∂b/∂t0 and ∂b/∂b0, in the frame of α and β.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from skinbake.choices import Encoding
from skinbake.errors import BudgetError, InputError, Notice
from skinbake.format.stored_slots import read_array, shown
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.budget import Work
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, index, object_of
from skinbake.gltf.primitives import FLOAT, Formats, PrimitiveSource, check_format, refuse_not_finite
from skinbake.wording import counted

NOTE = "blend"
"""The member of the metadata: ``weights`` and ``gradient``, the names of two attributes."""

GRADIENT = "_SKINBAKE_BLEND"
"""The attribute of the gradient: VEC2 FLOAT, ∂b/∂t0 and ∂b/∂b0 in 1 / length unit of POSITION."""

SLACK = 1e-4
"""By so much a weight may lie outside 0 to 1: what rounding and interpolation leave."""

# An attribute whose name begins with an underscore has the family "".
_FORMATS: Formats = {"": (FLOAT, ("u1", True), ("u2", True))}
_EXPECTED = {"": "blend weights must be floats, or normalised unsigned bytes or shorts"}


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
    number = index(source.attributes, name, len(document.objects("accessors")), place)
    if number is None:
        return None
    stored = read_accessor(document, number, place)
    if len(stored.values) != count:
        raise InputError(f"it has {counted(len(stored.values), 'element')}, POSITION has {count:,}", place)
    check_format(stored, name, 1, place, formats=_FORMATS, expected=_EXPECTED)
    document.budget.claim(Work(bytes=stored.decoded_size), "its decoded values", place)
    weights = stored.decoded()
    refuse_not_finite(weights, "blend weights", place)
    outside = np.flatnonzero((weights[:, 0] < -SLACK) | (weights[:, 0] > 1.0 + SLACK))
    if len(outside):
        message = (
            f"it is {weights[outside[0], 0]:.6g} at vertex {outside[0]}, expected 0 (linear blend skinning) "
            f"to 1 (dual quaternions). The number of such vertices is {len(outside):,}"
        )
        raise InputError(message, place)
    return weights[:, 0]


def blend_names(note: JsonObject) -> list[str]:
    """Return the attribute of the gradient if a bake has added it, as a list of one."""
    return [GRADIENT] if NOTE in note else []


def wrong_blend(note: JsonObject) -> Iterator[str]:
    """Yield the defect of the metadata's member about the blend."""
    names = object_of(note.get(NOTE))
    if NOTE in note and not (names.get("gradient") == GRADIENT and isinstance(names.get("weights"), str)):
        yield f'"{NOTE}" is {shown(note[NOTE])}'


def read_blend(
    document: Document, source: PrimitiveSource, note: JsonObject, count: int
) -> Float64Array | Notice | None:
    """Return b, ∂b/∂t0 and ∂b/∂b0 (V, 3) of a baked primitive, None without a blend, or the problem.

    ``wrong_blend`` must have found no defect in the metadata.
    """
    if NOTE not in note:
        return None
    name = note[NOTE]["weights"]
    gradient = read_array(document, source, GRADIENT, (count, 2), Encoding.FLOAT32)
    if isinstance(gradient, Notice):
        return gradient
    try:
        weights = read_blend_weights(document, source, name, count)
    except BudgetError:
        raise
    except InputError as error:
        return Notice("attribute-format", error.message, error.place or source.place)
    if weights is None:
        message = (
            f"the bake read its blend weights from {name}, which was removed or renamed: run skinbake bake "
            "on a file that has it"
        )
        return Notice("attribute-missing", message, source.place.at(name))
    return np.column_stack([weights, gradient]).astype(np.float64)
