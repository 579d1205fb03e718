"""Bake the primitives of one mesh: weight field, welded surface, gradients, slots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.bake.gradients import weight_gradients
from skinbake.bake.influences import NO_JOINT, WeightDefects, weight_field
from skinbake.bake.slots import SlotGradients, assign, shared_capacity
from skinbake.bake.weld import concatenated, weld
from skinbake.geometry import frames
from skinbake.geometry.skinned import BakedPrimitive, FloatArray, SkinnedPrimitive
from skinbake.geometry.triangles import proper

AUTO = "auto"
ADOPT, DROP = "adopt", "drop"

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
    bad_tangents how many vertices exceed TANGENT_TOLERANCE. magnitude is the summed length of the gradients,
    in 1 / length unit, lost the share of it that no slot holds.
    """

    weights: WeightDefects
    degenerate_triangles: int
    zero_normals: int
    tangent_deviation: float
    bad_tangents: int
    adopting_vertices: int
    overflowing_vertices: int
    magnitude: float
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
    normals = np.concatenate([primitive.normals for primitive in primitives])
    starts = np.cumsum([0, *(len(primitive.positions) for primitive in primitives)])
    masks = [proper(primitive.positions, primitive.triangles) for primitive in primitives]
    triangles = np.concatenate(
        [
            (primitive.triangles if mask.all() else primitive.triangles[mask]) + start
            for primitive, mask, start in zip(primitives, masks, starts, strict=False)
        ]
    )
    classes = weld(positions, normals, field, crease_angle=settings.crease_angle)
    gradients = weight_gradients(positions, triangles, field, classes, weighting=settings.weighting)
    capacity = shared_capacity(field, classes) if settings.neighbours == ADOPT else None
    results = []
    for number, primitive in enumerate(primitives):
        rows = slice(starts[number], starts[number + 1])
        frame = rest_frame(primitive, settings.frame)
        slots = assign(
            gradients,
            classes[rows],
            fields[number],
            (frame.tangents, frame.bitangents),
            None if capacity is None else capacity[rows],
        )
        findings = BakeFindings(
            weights=defects[number],
            degenerate_triangles=int(np.count_nonzero(~masks[number])),
            zero_normals=int(np.count_nonzero(~frames.has_direction(primitive.normals))),
            tangent_deviation=frame.deviation,
            bad_tangents=frame.deviating,
            adopting_vertices=int(np.count_nonzero((slots.adopted != NO_JOINT).any(axis=1))),
            overflowing_vertices=slots.overflowing,
            magnitude=slots.magnitude,
            lost=slots.lost,
        )
        results.append((_baked(slots, frame.kind), findings))
    return results


@dataclass(frozen=True, slots=True)
class RestFrame:
    """The frame (t0, b0), each (V, 3), that one primitive is baked for, and how its TANGENT fares.

    kind is ``tangent`` or ``normal``; deviation the largest angle in degrees by which t0 × b0 leans from n0
    at a vertex of a triangle, deviating how many vertices lean more than TANGENT_TOLERANCE.
    """

    kind: str
    tangents: FloatArray
    bitangents: FloatArray
    deviation: float = 0.0
    deviating: int = 0


def rest_frame(primitive: SkinnedPrimitive, choice: str) -> RestFrame:
    """Return the rest frame of a primitive with normals; choice is ``auto``, ``tangent`` or ``normal``.

    ``auto`` takes TANGENT where it is orthonormal enough at every vertex, else the frame from NORMAL.
    """
    normals = frames.unit_normals(primitive.normals)
    deviation, deviating = 0.0, 0
    if primitive.tangents is not None and choice != frames.NORMAL_FRAME:
        used = np.unique(primitive.triangles)
        angles = frames.tangent_deviation(normals[used], primitive.tangents[used])
        deviation = float(angles.max(initial=0.0))
        deviating = int(np.count_nonzero(angles > TANGENT_TOLERANCE))
        if choice == frames.TANGENT_FRAME or deviating == 0:
            pair = frames.frame_from_tangent(normals, primitive.tangents)
            return RestFrame(frames.TANGENT_FRAME, *pair, deviation, deviating)
    return RestFrame(frames.NORMAL_FRAME, *frames.frame_from_normal(normals), deviation, deviating)


def _baked(slots: SlotGradients, frame: str) -> BakedPrimitive:
    return BakedPrimitive(
        alpha=slots.alpha[:, 1:].astype(np.float32),
        beta=slots.beta[:, 1:].astype(np.float32),
        adopted_joints=slots.adopted,
        frame=frame,
    )
