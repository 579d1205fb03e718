"""Errors of lighting on a baked document, by truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skinbake.freshness.baked_views import BakedView, baked_views, rest_primitive, whole_surfaces
from skinbake.geometry.skinned import BoolArray, Float64Array
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.measure.angles import MeasuredBlock, lighting_errors
from skinbake.measure.draws import Surface
from skinbake.truth.areas import RestAreas
from skinbake.truth.operator import true_operator
from skinbake.truth.poses import PoseRequest, PoseSet, draws_of, pose_set
from skinbake.truth.truths import truths_at_rest

Field = tuple[Float64Array, BoolArray]
"""Errors in degrees (P, V), and whether the true normal exists there (P, V)."""

WITHOUT_NORMAL = 180.0
"""The error in degrees of a lighting that yields no normal, as verify counts it."""


@dataclass
class Lit:
    """The mean errors of a document's lighting by LBS: sums of (error × area, area) by truth and lighting."""

    sums: dict[tuple[str, str], Float64Array] = field(default_factory=dict)
    from_clips: bool = True

    def mean(self, truth: str, lighting: str = "accurate") -> float:
        """Return the mean error in degrees, NaN where it was not measured."""
        error, area = self.sums.get((truth, lighting), np.zeros(2))
        return float(error / area) if area else np.nan


def measured(document: Document, request: PoseRequest) -> Lit:
    """Measure a baked document in some poses by both truths, as verify does."""
    found, clips = Lit(), read_clips(document)
    views = baked_views(document, skinned_sources(document))
    for together in whole_surfaces(document, views):
        for skin, node in draws_of(document, together[0].source.mesh, clips):
            poses = pose_set(document, skin, clips, request, node)
            found.from_clips &= None not in poses.times
            space = RestAreas(document, skin)
            areas = [space.of(view.now) for view in together]
            fields = error_fields(document, together, poses, "lbs")
            for (truth, lighting, surface), (errors, valid) in fields.items():
                counted = np.where(valid & (areas[surface] > 0.0), areas[surface], 0.0)
                known = np.where(np.isfinite(errors), errors, WITHOUT_NORMAL)
                sums = found.sums.setdefault((truth, lighting), np.zeros(2))
                sums += (known * counted).sum(), counted.sum()
    return found


def error_fields(
    document: Document, views: list[BakedView], poses: PoseSet, method: str
) -> dict[tuple[str, str, int], Field]:
    """Return the errors on one surface under one skin, by truth, lighting, and number of the view."""
    fields: dict[tuple[str, str, int], Field] = {}
    operator = true_operator([view.now for view in views])

    def record(block: MeasuredBlock) -> None:
        shape = len(poses.clips), len(views[block.primitive].now.positions)
        key = block.truth, block.lighting, block.primitive
        errors, valid = fields.setdefault(key, (np.zeros(shape), np.zeros(shape, dtype=np.bool_)))
        rows, columns = block.errors.shape
        at = slice(block.pose, block.pose + rows), slice(block.vertex, block.vertex + columns)
        errors[at], valid[at] = block.errors, block.valid

    rest = [rest_primitive(view) for view in views]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # as verify measures
        morphing = Surface(document, views, lambda: operator).morphing(poses.morph_weights)
        truths = truths_at_rest(operator, rest, len(poses.clips), morphing)
        lighting_errors(
            operator, rest, poses.joint_matrices, method, record, morphing=morphing, at_rest=truths
        )
    return fields
