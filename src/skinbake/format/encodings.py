"""How α and β are stored: by an encoding, and in the attributes of a layout.

An encoding takes fewer bytes: normalised integers relative to a scale of each vertex. A layout holds both in
attributes of their own, or in texture coordinates with two numbers each.

The format is in docs/reference/file-format.md.

With one scale for all vertices, linear integers have a mean error of up to 1.9°: single outliers set the
scale and spoil the other values. So the fourth component of set 0 holds the square root of the vertex's own
scale. The corner of a sliver may have a million times the usual gradient, which even a square root does not
bear. Then the scale of the file is less than the largest value, and the vertices beyond it are shortened.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import Encoding, Layout
from skinbake.format.note import TEXCOORD, GradientNote
from skinbake.geometry.skinned import Float64Array, FloatArray

CANDIDATES = 8
"""Number of scales that are tried for each vertex, from the smallest one on; the best is kept.

Mean error that packed8 adds, with 1, 2, 4, 8, 16 of them: 0.026, 0.022, 0.020, 0.018, 0.017° (CesiumMan),
0.028, 0.025, 0.021, 0.018, 0.016° (a hand), 0.033, 0.028, 0.024, 0.022, 0.020° (the hand with eight
influences).
"""

DTYPES: dict[Encoding, np.dtype[Any]] = {
    Encoding.FLOAT32: np.dtype("<f4"),
    Encoding.SNORM16: np.dtype("<i2"),
    Encoding.PACKED8: np.dtype("<i1"),
}

LARGEST = {Encoding.SNORM16: 32767, Encoding.PACKED8: 127}
"""The integer that means 1 (glTF 2.0, §3.11)."""


def vertex_bytes(encoding: Encoding, influences: int) -> int:
    """Return the bytes of α and β at a vertex with K slots: 2 (K − 1) numbers, and the scales."""
    return DTYPES[encoding].itemsize * 2 * (influences - (0 if encoding.is_scaled else 1))


ROUGHER = 2.0
"""The squared error that a scale may have, over the least one, to be preferred because it is larger."""

SCALES = 16
"""The scales that are tried, from the largest value on: each is a quarter of the one before."""

SWING = 1.0
"""How far joints take a vertex apart, at most, over the square root of its primitive's area.

Times α it is the tangent of the angle by which α turns a normal. The scale is chosen by that angle: of a
million it matters little how many there are.
"""


class DecodedSlots(NamedTuple):
    """α or β as a shader decodes it: values (V, K − 1) float32, 1 / length unit of POSITION.

    rounding (V,) is the largest change of a value by its storage: half a step of the vertex's integers, 0 for
    FLOAT.
    """

    values: FloatArray
    rounding: Float64Array


def by_set(slots: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
    """Split (V, K − 1) into slots 1–3, then groups of four."""
    return [slots[:, :3], *(slots[:, start : start + 4] for start in range(3, slots.shape[1], 4))]


def common_scale(slots: Sequence[FloatArray]) -> float:
    """Return the largest |value| of all arrays (V, K − 1), 0 if all are zero, as a float32 value."""
    return max((float(np.abs(values).max(initial=0.0)) for values in slots), default=0.0)


class Spread(NamedTuple):
    """The values of one primitive: alpha and beta (V, K − 1), and the areas (V,) around its vertices."""

    alpha: FloatArray
    beta: FloatArray
    areas: Float64Array


def bearing_scale(spreads: Sequence[Spread], encoding: Encoding) -> float:
    """Return the scale for α and β with outliers, as a float32 value: the ``common_scale``, or less.

    It is less where all vertices beyond it cost less angle, by area, than the others gain.
    """
    largest = common_scale([slots for spread in spreads for slots in (spread.alpha, spread.beta)])
    terms = []
    for alpha, beta, areas in spreads:
        sizes = _sizes(alpha, beta)
        lit, total = (sizes > 0.0) & (areas > 0.0), float(areas.sum())
        if lit.any():
            terms.append((sizes[lit], areas[lit] / total, SWING * np.sqrt(total)))

    def cost(scale: float | None) -> float:
        """Return the sum of squared angles; without a scale, as if each vertex had the best one."""
        limit, found = LARGEST[encoding], 0.0
        for sizes, weights, swing in terms:
            own = sizes
            if scale is not None:
                own = np.square(np.clip(np.ceil(limit * np.sqrt(sizes / scale)), 1.0, limit) / limit) * scale
            rounding = own / (2.0 * limit) / (sizes + 1.0 / swing)
            shortening = np.arctan(swing * sizes) - np.arctan(swing * np.minimum(sizes, own))
            found += float((weights * np.square(rounding + shortening)).sum())
        return found

    if not terms or cost(largest) <= ROUGHER * cost(None):
        return largest
    scales = [float(np.float32(largest / 4.0**step)) for step in range(SCALES)]
    with np.errstate(over="ignore"):  # a scale far below all values
        costs = [cost(scale) if scale > 0.0 else np.inf for scale in scales]
    return next(scale for scale, one in zip(scales, costs, strict=True) if one <= ROUGHER * min(costs))


def shortened(alpha: FloatArray, beta: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Return α and β (V, K − 1) without a value beyond the scale. All of a vertex are shortened alike.

    At a sliver both are so long that the normal hangs on their proportion. A scale of 0 is that of a surface
    without slopes: what is left of them is rounding.
    """
    sizes = _sizes(alpha, beta)
    if scale <= 0.0 or not (sizes > scale).any():
        return alpha, beta
    shares = (scale / np.maximum(sizes, scale))[:, None]
    return alpha * shares, beta * shares


def _sizes(alpha: FloatArray, beta: FloatArray) -> Float64Array:
    """Return the largest |value| of each vertex (V,)."""
    both = np.maximum(np.abs(alpha), np.abs(beta)).max(axis=1, initial=0.0)
    return np.asarray(both, dtype=np.float64)


def encoded(slots: FloatArray, encoding: Encoding, scale: float) -> list[npt.NDArray[Any]]:
    """Return α or β (V, K − 1) as arrays to store, one for each influence set.

    FLOAT: (V, 3), then (V, 4) float32. Other encodings: (V, 4) integers c, read as c / limit. Set 0 holds
    slots 1–3 relative to the scale s of the vertex, and w ≥ 0 with s = w² · scale. Each further set holds its
    four slots relative to s. No value is larger than s. scale is at least the largest value. A vertex
    of zeros is stored as zeros.
    """
    if not encoding.is_scaled:
        return by_set(slots)
    limit, wide = LARGEST[encoding], slots.astype(np.float64)
    largest = np.abs(wide).max(axis=1, initial=0.0)
    least = np.ceil(limit * np.sqrt(largest / (scale or 1.0)))
    least += (least / limit) ** 2 * scale < largest  # corrects the rounding of the root
    least = np.minimum(least, limit)
    root, integers, error = _rounded(wide, least, limit, scale)
    for step in range(1, CANDIDATES):
        tried = _rounded(wide, np.where(least > 0, np.minimum(least + step, limit), 0), limit, scale)
        better = tried[2] < error
        root = np.where(better, tried[0], root)
        integers = np.where(better[:, None], tried[1], integers)
        error = np.where(better, tried[2], error)
    first, *others = by_set(integers.astype(DTYPES[encoding]))
    return [np.column_stack([first, root.astype(DTYPES[encoding])]), *others]


def _rounded(
    slots: Float64Array, root: Float64Array, limit: int, scale: float
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the roots (V,) as given, the integers (V, K − 1) beside them, and the squared error (V,)."""
    own = ((root / limit) ** 2 * scale)[:, None]
    integers = np.rint(np.divide(limit * slots, own, out=np.zeros_like(slots), where=own > 0.0))
    error: Float64Array = ((integers * own / limit - slots) ** 2).sum(axis=1)
    return root, integers, error


def rounded(slots: FloatArray, encoding: Encoding, scale: float) -> FloatArray:
    """Return α or β (V, K − 1) float32 as a shader reads the arrays of ``encoded``."""
    return decoded(encoded(slots, encoding, scale), encoding, scale).values


def decoded(sets: Sequence[npt.NDArray[Any]], encoding: Encoding, scale: float) -> DecodedSlots:
    """Return α or β from the arrays of ``encoded``: set 0 and all further sets are (V, 4)."""
    if not encoding.is_scaled:
        values = np.concatenate(sets, axis=1).astype(np.float32)
        return DecodedSlots(values, np.zeros(len(values)))
    limit = LARGEST[encoding]
    parts = [np.maximum(part.astype(np.float64) / limit, -1.0) for part in sets]
    own = parts[0][:, 3] ** 2 * scale
    relative = np.concatenate([parts[0][:, :3], *parts[1:]], axis=1)
    return DecodedSlots((own[:, None] * relative).astype(np.float32), own / (2 * limit))


CUSTOM_NAMES = (("_CUSTOM0", "_CUSTOM1"), ("_CUSTOM2", "_CUSTOM3"))
"""α and β by influence set, as CUSTOM0 … CUSTOM3 of Godot after 4.6 (godotengine/godot#120040)."""


class GradientFormat(NamedTuple):
    """The storage of α and β in one file; scale is the encoding's, in 1 / length unit of POSITION."""

    encoding: Encoding = Encoding.FLOAT32
    layout: Layout = Layout.ATTRIBUTES
    scale: float = 0.0


def noted_format(note: GradientNote) -> GradientFormat:
    """Return the storage in a note; ValueError if a name is unknown."""
    return GradientFormat(Encoding(note.encoding), Layout(note.layout), note.scale or 0.0)


def free_texcoords(attributes: Iterable[str], count: int) -> list[str]:
    """Return the names of ``count`` texture coordinate sets after the existing ones.

    glTF numbers them without a gap, so the new ones begin after the last.
    """
    taken = (int(found[1]) for name in attributes if (found := TEXCOORD.fullmatch(name)))
    first = max(taken, default=-1) + 1
    return [f"TEXCOORD_{number}" for number in range(first, first + count)]
