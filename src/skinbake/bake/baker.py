"""Bake the primitives of one mesh: weight field, welded surface, gradients, slots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.bake.gradients import weight_gradients
from skinbake.bake.influences import NO_JOINT, WeightDefects, WeightField, weight_field
from skinbake.bake.slots import ADOPT, SlotGradients, assign
from skinbake.bake.weld import concatenated, weld
from skinbake.geometry import frames
from skinbake.geometry.skinned import BakedPrimitive, FloatArray, IntArray, SkinnedPrimitive
from skinbake.geometry.triangles import proper

AUTO = "auto"

TANGENT_TOLERANCE = 0.1
"""Degrees by which t0 × b0 may lean from n0 before a TANGENT is not used."""


@dataclass(frozen=True, slots=True)
class BakeSettings:
    """How to bake. crease_angle in radians; weighting, neighbours and frame as on the command line."""

    weighting: str = "max"
    crease_angle: float = float(np.radians(15.0))
    neighbours: str = ADOPT
    frame: str = AUTO


@dataclass(frozen=True, slots=True)
class BakeFindings:
    """What baking one primitive met, in numbers.

    tangent_deviation is the largest angle in degrees between t0 × b0 and n0, 0 without TANGENT;
    bad_tangents how many vertices exceed TANGENT_TOLERANCE. lost is the share of the gradient that no slot
    holds.
    """

    weights: WeightDefects
    degenerate_triangles: int
    zero_normals: int
    tangent_deviation: float
    bad_tangents: int
    adopting_vertices: int
    overflowing_vertices: int
    lost: float


def bake_mesh(
    primitives: Sequence[SkinnedPrimitive], settings: BakeSettings
) -> list[tuple[BakedPrimitive, BakeFindings]]:
    """Return α and β of every primitive of one mesh, gathered across their borders.

    The primitives are those that are baked, in mesh space, all skinned by the same joints. With
    ``frame="tangent"`` every primitive must have tangents.
    """
    fields, defects = zip(*(weight_field(primitive) for primitive in primitives), strict=True)
    field = concatenated(fields)
    positions = np.concatenate([primitive.positions for primitive in primitives])
    normals = np.concatenate([frames.unit_normals(primitive.normals) for primitive in primitives])
    starts = np.cumsum([0, *(len(primitive.positions) for primitive in primitives)])
    masks = [proper(primitive.positions, primitive.triangles) for primitive in primitives]
    triangles = np.concatenate(
        [primitive.triangles[mask] + start for primitive, mask, start in zip(primitives, masks, starts, strict=False)]
    )
    classes = weld(positions, normals, field, crease_angle=settings.crease_angle)
    gradients = weight_gradients(positions, triangles, field, classes, weighting=settings.weighting)
    results = []
    for number, primitive in enumerate(primitives):
        rows = slice(starts[number], starts[number + 1])
        kind, frame, deviation, bad = _rest_frame(primitive, normals[rows], settings.frame)
        slots = assign(gradients, classes[rows], fields[number], frame, neighbours=settings.neighbours)
        findings = BakeFindings(
            weights=defects[number],
            degenerate_triangles=int(np.count_nonzero(~masks[number])),
            zero_normals=int(np.count_nonzero(~primitive.normals.any(axis=1))),
            tangent_deviation=deviation,
            bad_tangents=bad,
            adopting_vertices=int(np.count_nonzero((slots.adopted != NO_JOINT).any(axis=1))),
            overflowing_vertices=slots.overflowing,
            lost=slots.lost,
        )
        results.append((_baked(slots, kind), findings))
    return results


def _rest_frame(
    primitive: SkinnedPrimitive, normals: npt.NDArray[np.float32], choice: str
) -> tuple[str, tuple[FloatArray, FloatArray], float, int]:
    """Return the frame's kind, (t0, b0), the tangents' largest deviation in degrees and how many deviate."""
    deviation, bad = 0.0, 0
    if primitive.tangents is not None and choice != frames.NORMAL_FRAME:
        used = np.unique(primitive.triangles)
        angles = frames.tangent_deviation(normals[used], primitive.tangents[used])
        deviation, bad = float(angles.max(initial=0.0)), int(np.count_nonzero(angles > TANGENT_TOLERANCE))
        if choice == frames.TANGENT_FRAME or bad == 0:
            return frames.TANGENT_FRAME, frames.frame_from_tangent(normals, primitive.tangents), deviation, bad
    return frames.NORMAL_FRAME, frames.frame_from_normal(normals), deviation, bad


def _baked(slots: SlotGradients, frame: str) -> BakedPrimitive:
    return BakedPrimitive(
        alpha=slots.alpha[:, 1:].astype(np.float32),
        beta=slots.beta[:, 1:].astype(np.float32),
        adopted_joints=slots.adopted,
        frame=frame,
    )
