"""Whether stored α and β fit the mesh of the file, and where they do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import Float64Array, FloatArray
from skinbake.skinning.rest import all_slots

RELATIVE_TOLERANCE = 1e-3
"""The largest allowed difference between stored and recomputed, relative to the vertex's largest entry.

float32 storage and two routes to the same mean differ by 1e-6. An α scaled by 1.01 differs by 1e-2.
"""

FLOOR = 1e-5
"""Entries below this share of the primitive's largest entry, or of the vertex's reach, are rounding."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """The differences between stored α and β (V, K − 1) and recomputed ones.

    differing is the number of vertices, out of count, that exceed the tolerance. largest is the largest
    difference relative to the vertex's largest entry. worst is the vertex of that difference.
    """

    differing: int
    count: int
    largest: float
    worst: int

    @property
    def agrees(self) -> bool:
        """Tell whether no vertex differs."""
        return self.differing == 0


def compare(
    stored: tuple[FloatArray, FloatArray],
    expected: tuple[FloatArray, FloatArray],
    *,
    reach: FloatArray | None = None,
    rounding: FloatArray | None = None,
) -> Comparison:
    """Compare stored with recomputed α and β, each a pair of (V, K − 1), in 1 / length unit of POSITION.

    reach (V,), in the same unit, is the largest possible derivative of a weight at each vertex. If a weight
    is constant, both sides are rounding, and only reach shows it. rounding (V, 2), in the same unit, is the
    largest change that an encoding may have made to a stored α, and to a stored β. Differences up to it are
    allowed. A vertex whose recomputed α or β float32 cannot hold differs from anything.
    """
    given, wanted = (np.stack(pair, axis=2).astype(np.float64) for pair in (stored, expected))
    known = np.asarray(np.isfinite(wanted).all(axis=(1, 2)))
    wanted = all_slots(np.where(known[:, None, None], wanted, 0.0))
    # The scale (V,) to which the difference at each vertex is compared.
    own = np.abs(wanted).max(axis=(1, 2), initial=0.0)
    scale = np.maximum(own, FLOOR * own.max(initial=0.0))
    if reach is not None:
        scale = np.maximum(scale, FLOOR * reach)
    scale = np.where(scale > 0.0, scale, 1.0)
    allowed = np.zeros((len(given), 1, 2)) if rounding is None else np.asarray(rounding)[:, None]
    off: Float64Array = (np.abs(given - wanted[:, 1:]) - allowed).max(axis=(1, 2), initial=0.0)
    difference = np.where(known, off / scale, np.inf)
    return Comparison(
        differing=int(np.count_nonzero(difference > RELATIVE_TOLERANCE)),
        count=len(difference),
        largest=float(difference.max(initial=0.0)),
        worst=int(difference.argmax()) if len(difference) else 0,
    )
