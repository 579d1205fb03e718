"""Whole fields at once, of what the package computes block by block: for tests and benchmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gradients.tangents import chosen_frame, frame_vectors
from skinbake.measure.tally import ErrorSummary, ErrorTally
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import shader_made
from skinbake.truth.areas import angles_between
from skinbake.truth.normals import RestFrames, posed_tangents, tangent_normals

BLOCK = 1 << 16
"""Vertices × poses of ``reference_normals`` at a time."""


@dataclass(frozen=True, slots=True)
class RestFrame:
    """The frame at rest of one primitive: kind is ``tangent`` or ``normal``; t0 and b0, each (V, 3)."""

    kind: str
    tangents: FloatArray
    bitangents: FloatArray


def rest_frame(primitive: SkinnedPrimitive, choice: str) -> RestFrame:
    """Return the frame at rest of a primitive with normals; choice as for ``chosen_frame``."""
    chosen = chosen_frame(primitive, choice)
    return RestFrame(chosen.kind, *frame_vectors(primitive, chosen.kind))


def shader_text(choices: ShaderChoices) -> str:
    """Return the file that ``skinbake shader`` writes: ASCII, with a newline at its end.

    Raises ChoiceError if the target does not have the language, or cannot serve the choices.
    """
    return shader_made(choices)[0]


def angular_errors(measured: FloatArray, expected: FloatArray) -> Float64Array:
    """Return the angle between two fields of vectors of any length, in degrees: (P, V) float64, or any (...).

    measured and expected (..., 3), one space. The angle is that of the sine |m × e| and the cosine m · e,
    which keeps its digits near 0° where an arccos has none left. It is NaN where either vector is zero or not
    finite: a zero vector has no angle.
    """
    m = np.moveaxis(np.asarray(measured, dtype=np.float64), -1, 0)
    e = np.moveaxis(np.asarray(expected, dtype=np.float64), -1, 0)
    return angles_between((m[0], m[1], m[2]), (e[0], e[1], e[2]))


def summarise(
    errors: FloatArray, areas: FloatArray, *, valid: BoolArray | None = None
) -> ErrorSummary | None:
    """Summarise angular errors over poses and vertices, weighted by area; None where nothing counts.

    errors (P, V), degrees; areas (V,), rest areas in any unit. valid (P, V), all true by default, is where
    the *expected* normal exists: samples outside it, and vertices without area, are left out. A NaN inside
    it means that the measured normal does not exist, and it counts as 180°: a method that yields no normal
    must not look better for it.

    """
    tally = ErrorTally()
    tally.add(errors, areas, valid=valid)
    return tally.summary()


def reference_normals(
    rest: RestFrames, deformed: FloatArray, sides: FloatArray | None = None
) -> tuple[Float64Array, BoolArray]:
    """Return the true normals of a deformed mesh by tangents, and where they are valid.

    deformed (P, V, 3): the skinned positions over the mesh's concatenated vertices, in any one space per
    pose. The normals are (P, V, 3) float64 unit vectors in that space, the mask is (P, V). It is false, and
    the normal NaN, where the rest frame is not valid or the deformed one is flat.

    With c = a × b of the tangents a, b and ĉ its direction, F takes a0, b0, ĉ0 to a1, b1,
    ĉ1 sqrt(|c1| / |c0|). The factor keeps a uniform scale uniform: joint matrices with an overall 0.01 are
    common. So at rest, and under any rotation and uniform scale, cof(F) n0 is n0 or its image up to
    rounding, authored normals included. sides (P, V) is −1 where the joints mirror a vertex, 1 elsewhere and
    by default: its third column points to the other side of the surface, so that F is the mirror, and the
    normal is −cof(F) n0, which stays outside.
    """
    count = max(1, BLOCK // max(1, deformed.shape[1]))
    normals = np.empty(deformed.shape)
    for start in range(0, len(deformed), count):
        block = slice(start, start + count)
        posed = np.ascontiguousarray(np.transpose(deformed[block], (2, 1, 0)), dtype=np.float64)
        for part, derivatives in zip(rest.parts, rest.derivatives, strict=True):
            side = None if sides is None else sides[block, part]
            found, _ = tangent_normals(rest, part, posed_tangents(derivatives, posed), side)
            normals[block, part] = np.stack(found, axis=2)
    return normals, np.isfinite(normals[..., 0])
