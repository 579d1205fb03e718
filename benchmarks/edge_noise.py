"""Errors of lighting on a baked document, by truth: their mean, and how much they change over an edge."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float64Array, IntArray
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document
from skinbake.gltf.primitives import skinned_sources
from skinbake.lighting.angles import MeasuredBlock, lighting_errors, not_rigid_joints
from skinbake.lighting.baked_views import BakedView, baked_views, whole_surfaces
from skinbake.lighting.morphing import morphing_of
from skinbake.lighting.operator import true_operator
from skinbake.lighting.poses import PoseRequest, PoseSet, draws_of, pose_set
from skinbake.lighting.rest_areas import RestAreas
from skinbake.lighting.rest_primitives import rest_primitive

Field = tuple[Float64Array, BoolArray]
"""Errors in degrees (P, V), and whether the true normal exists there (P, V)."""

WITHOUT_NORMAL = 180.0
"""The error in degrees of a lighting that yields no normal, as verify counts it."""


@dataclass
class Sums:
    """The sums behind a mean error by area, and behind the mean squared change over an edge."""

    error: float = 0.0
    area: float = 0.0
    squares: float = 0.0
    changes: float = 0.0
    edges: int = 0

    @property
    def mean(self) -> float:
        """Return the mean error in degrees, NaN if nothing counts."""
        return self.error / self.area if self.area else np.nan

    @property
    def change(self) -> float:
        """Return the root of the mean squared change over an edge in degrees, NaN without edges."""
        return float(np.sqrt(self.squares / self.edges)) if self.edges else np.nan

    @property
    def mean_change(self) -> float:
        """Return the mean change over an edge in degrees, NaN without edges."""
        return self.changes / self.edges if self.edges else np.nan

    def add(self, errors: Float64Array, valid: BoolArray, areas: Float64Array, edges: IntArray) -> None:
        """Count errors and valid (P, V) of a primitive with areas (V,) and edges (E, 2)."""
        errors = np.where(np.isfinite(errors), errors, WITHOUT_NORMAL)
        weights = np.where(valid & (areas > 0.0), areas, 0.0)
        self.error += float((errors * weights).sum())
        self.area += float(weights.sum())
        both = valid[:, edges[:, 0]] & valid[:, edges[:, 1]]
        changes = (errors[:, edges[:, 0]] - errors[:, edges[:, 1]])[both]
        self.squares += float((changes**2).sum())
        self.changes += float(np.abs(changes).sum())
        self.edges += int(both.sum())


@dataclass
class Lit:
    """The errors of a document's lighting. sums has the keys (truth, method, lighting)."""

    sums: dict[tuple[str, str, str], Sums] = field(default_factory=dict)
    from_clips: bool = True

    def mean(self, truth: str, method: str = "lbs", lighting: str = "accurate") -> float:
        """Return the mean error in degrees, NaN where it was not measured."""
        return self.sums.get((truth, method, lighting), Sums()).mean

    def change(self, truth: str, lighting: str = "accurate", *, squared: bool = True) -> float:
        """Return the change of the error over an edge under LBS in degrees: root mean square, or mean."""
        sums = self.sums.get((truth, "lbs", lighting), Sums())
        return sums.change if squared else sums.mean_change


def measured(document: Document, request: PoseRequest, *, with_dqs: bool) -> Lit:
    """Measure a baked document in some poses by both truths, as verify does."""
    found, clips = Lit(), read_clips(document)
    views, _ = baked_views(document, skinned_sources(document)[0])
    for together in whole_surfaces(document, views):
        for skin, node in draws_of(document, together[0].source.mesh, clips):
            poses = pose_set(document, skin, clips, request, node)
            found.from_clips &= None not in poses.times
            space = RestAreas(document, skin)
            areas = [space.of(view.now) for view in together]
            _measure(document, together, areas, poses, found, with_dqs=with_dqs)
    return found


def _measure(
    document: Document,
    views: list[BakedView],
    areas: list[Float64Array],
    poses: PoseSet,
    found: Lit,
    *,
    with_dqs: bool,
) -> None:
    """Add the errors of one skin on one surface."""
    rigid = with_dqs and not not_rigid_joints([rest_primitive(view) for view in views], poses.joint_matrices)
    for method in ("lbs", "dqs") if rigid else ("lbs",):
        for (truth, lighting, surface), (errors, valid) in error_fields(
            document, views, poses, method
        ).items():
            if lighting != "direct":
                sums = found.sums.setdefault((truth, method, lighting), Sums())
                sums.add(errors, valid, areas[surface], edges_of(views[surface].now.triangles))


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
        morphing = morphing_of(document, views, poses)
        lighting_errors(operator, rest, poses.joint_matrices, method, record, morphing=morphing)
    return fields


def edges_of(triangles: IntArray) -> IntArray:
    """Return the edges (E, 2) of triangles (T, 3), each once."""
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    return np.unique(np.sort(sides.astype(np.int64), axis=1), axis=0)
