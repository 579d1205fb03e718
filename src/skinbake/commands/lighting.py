"""The lighting of a baked document, measured mesh by mesh and skin by skin, and held against limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skinbake.commands.baked_views import BakedView
from skinbake.commands.morphing import morph_count, morphing_of
from skinbake.commands.poses import PoseRequest, PoseSet, described, draws_of, pose_set
from skinbake.errors import Notice, Place
from skinbake.geometry import frames
from skinbake.geometry.skinned import BoolArray, FloatArray
from skinbake.gltf.animation import read_clips
from skinbake.gltf.document import Document
from skinbake.replay.surface import Baseline, RestSurface
from skinbake.report.notices import counted
from skinbake.report.verify import Check, ErrorFigures, FileVerdict, Normals, Worst, gain
from skinbake.verify.influences import normalised_weights
from skinbake.verify.lighting import IDENTITY_TOLERANCE, LightingErrors, lighting_errors, not_rigid_joints
from skinbake.verify.metrics import summarise, vertex_areas
from skinbake.verify.operator import GradientOperator

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many poses are done, and how many there are."""


@dataclass(frozen=True, slots=True)
class VerifyOptions:
    """The options of ``skinbake verify``.

    methods are those asked for; empty: LBS, and DQS where the joints are rigid. Limits are degrees, or a
    factor, of the accurate lighting; None asks nothing.
    """

    methods: tuple[str, ...] = ()
    poses: PoseRequest = field(default_factory=PoseRequest)
    max_mean_error: float | None = None
    max_p95_error: float | None = None
    min_gain: float | None = None
    require_baked: bool = False
    warnings_as_errors: bool = False
    cap: float | None = None
    baseline: Baseline = Baseline.BLENDED


@dataclass(frozen=True, slots=True)
class _Segment:
    """Errors of one primitive under one skin: where, over which poses, (P, V), with the areas (V,)."""

    place: Place
    poses: PoseSet
    areas: FloatArray
    errors: dict[str, FloatArray]
    valid: BoolArray


class Lighting:
    """Measures a document's lighting, mesh by mesh and skin by skin."""

    def __init__(self, document: Document, options: VerifyOptions, progress: Progress) -> None:
        self._document, self._options, self._progress = document, options, progress
        self._clips = read_clips(document)
        self._done, self._total, self._identity = 0, 0, 0.0
        self._segments: dict[str, list[_Segment]] = {}
        self._poses: dict[tuple[int, int | None], PoseSet] = {}

    def measured(
        self, meshes: Sequence[Sequence[BakedView]], operators: Sequence[GradientOperator]
    ) -> FileVerdict:
        """Return a verdict that holds the lighting checks and figures."""
        drawn = [
            (views, operator, [rest_surface(view) for view in views], poses)
            for views, operator in zip(meshes, operators, strict=True)
            for poses in self._pose_sets(views[0].source.mesh)
        ]
        not_rigid = list(dict.fromkeys(n for _, _, rest, poses in drawn for n in _not_rigid(rest, poses)))
        methods = self._options.methods or (("lbs",) if not_rigid else ("lbs", "dqs"))
        reason = without_dqs(not_rigid)
        if "dqs" in methods and not_rigid:
            problem = Notice("not-rigid", f"dual quaternions were asked for: {reason}", self._document.place)
            check = Check("lighting", "failed", (problem,))
            return FileVerdict(self._document.name, (check,), without_dqs=reason)
        self._total = sum(len(poses.clips) for *_, poses in drawn) * len(methods)
        for method in methods:
            for views, operator, rest, poses in drawn:
                self._measure(method, views, operator, rest, poses)
        verdict = self._verdict([poses for *_, poses in drawn], reason if not_rigid else None)
        morphs = morph_count(self._document, [(views[0].source.mesh, poses) for views, *_, poses in drawn])
        return replace(verdict, notices=tuple(dict.fromkeys(self._mirrored(meshes))), morphs=morphs)

    def _pose_sets(self, mesh: int) -> list[PoseSet]:
        draws = draws_of(self._document, mesh, self._clips)
        for skin, node in draws:
            if (skin, node) not in self._poses:
                found = pose_set(self._document, skin, self._clips, self._options.poses, node)
                self._poses[skin, node] = found
        return [self._poses[draw] for draw in draws]

    def _mirrored(self, meshes: Sequence[Sequence[BakedView]]) -> Iterator[Notice]:
        """Yield a notice for each mesh that a mirroring joint draws inside out."""
        for views in meshes:
            for poses in self._pose_sets(views[0].source.mesh):
                count = int(
                    np.count_nonzero((np.linalg.det(poses.joint_matrices[..., :3, :3]) < 0).any(axis=0))
                )
                if count:
                    message = (
                        f"{counted(count, 'joint mirrors', 'joints mirror')} (negative determinant): t' × b' "
                        "points inside there, and the shader must turn it round"
                    )
                    yield Notice(
                        "joints-mirror", message, replace(views[0].source.place, primitive=None), count
                    )

    def _measure(
        self,
        method: str,
        views: Sequence[BakedView],
        operator: GradientOperator,
        rest: Sequence[RestSurface],
        poses: PoseSet,
    ) -> None:
        found: LightingErrors = lighting_errors(
            operator,
            rest,
            poses.joint_matrices,
            method,
            cap=self._options.cap,
            baseline=self._options.baseline,
            morphing=morphing_of(self._document, views, poses),
            advance=self._advance,
        )
        self._identity = max(self._identity, found.identity)
        for view, rows in zip(views, operator.slices, strict=True):
            errors = {lighting: values[:, rows] for lighting, values in found.errors.items()}
            areas = vertex_areas(view.now.positions, view.now.triangles)
            segment = _Segment(view.source.place, poses, areas, errors, found.valid[:, rows])
            self._segments.setdefault(method, []).append(segment)

    def _advance(self, poses: int) -> None:
        self._done += poses
        self._progress(self._document.name, self._done, self._total)

    def _identity_check(self) -> Check:
        remark = f"direct and accurate (algorithms 2 and 3) agree within {self._identity:.1g}°"
        if self._identity <= IDENTITY_TOLERANCE:
            return Check("identity", "passed", (), remark)
        message = (
            f"direct and accurate normals (algorithms 2 and 3) differ by {self._identity:.2g}°, and should "
            "agree to rounding: this is a fault of skinbake, please report it"
        )
        return Check("identity", "failed", (Notice("identity", message, self._document.place),))

    def _verdict(self, poses: Sequence[PoseSet], without_dqs: str | None) -> FileVerdict:
        normals = _figures(self._segments)
        seconds = sum(clip.duration - clip.start for clip in self._clips)
        identity = self._identity_check()
        checks = [identity] if "lbs" in normals else []
        if not normals:
            checks.append(
                Check("lighting", "skipped", (), "there is no true normal at any vertex in these poses")
            )
        limits = _exceeded(normals, self._options, self._document.place)
        asked = (self._options.max_mean_error, self._options.max_p95_error, self._options.min_gain)
        if any(limit is not None for limit in asked):
            checks.append(_limits_check(limits, normals, self._options))
        places = {segment.place: None for segments in self._segments.values() for segment in segments}
        by_primitive = tuple(
            (place, _figures({m: [s for s in ss if s.place == place] for m, ss in self._segments.items()}))
            for place in places
        )
        return FileVerdict(
            self._document.name,
            tuple(checks),
            normals,
            by_primitive,
            described(self._options.poses, poses, seconds),
            without_dqs,
        )


def _limits_check(problems: Sequence[Notice], normals: Normals, options: VerifyOptions) -> Check:
    if problems:
        return Check("limits", "failed", tuple(problems), "; ".join(problem.message for problem in problems))
    bends = any(gain(figures) is not None for figures in normals.values())
    remark = "no gain to hold to --min-gain: nothing bends in these poses"
    return Check("limits", "passed", (), remark if options.min_gain is not None and not bends else "")


def _not_rigid(rest: Sequence[RestSurface], poses: PoseSet) -> list[str]:
    return [poses.joint_names[joint] for joint in not_rigid_joints(rest, poses.joint_matrices)]


def rest_surface(view: BakedView) -> RestSurface:
    """Return what a replay reads of a baked primitive, float64; joints past the skin's become 0."""
    joints = np.where(view.now.joints < view.source.joint_count, view.now.joints, 0)
    return RestSurface(
        positions=view.now.positions.astype(np.float64),
        normals=frames.unit_normals(view.now.normals).astype(np.float64),
        tangents=view.tangents.astype(np.float64),
        bitangents=view.bitangents.astype(np.float64),
        joints=joints,
        weights=normalised_weights(view.now.weights, joints),
        alpha=view.alpha.astype(np.float64),
        beta=view.beta.astype(np.float64),
    )


def without_dqs(joints: Sequence[str]) -> str:
    """Return why dual quaternions cannot stand for these joints, by name."""
    shown = ", ".join(joints[:4]) + (", …" if len(joints) > 4 else "")
    verb = "is" if len(joints) == 1 else "are"
    return f"{shown} {verb} not rigid up to one scale common to all joints"


def _figures(segments: dict[str, list[_Segment]]) -> Normals:
    """Return the figures of all samples together, by method and lighting; poses weigh equally."""
    result: Normals = {}
    for method, parts in segments.items():
        areas = np.concatenate([np.tile(part.areas, len(part.valid)) for part in parts])
        valid = np.concatenate([part.valid.ravel() for part in parts])[None]
        for lighting in parts[0].errors if parts else ():
            errors = np.concatenate([part.errors[lighting].ravel() for part in parts])[None]
            summary = summarise(errors, areas, valid=valid)
            if summary is not None:
                worst = _worst(parts, summary.worst_vertex)
                result.setdefault(method, {})[lighting] = ErrorFigures(
                    summary.mean, summary.p95, summary.p99, summary.max, worst
                )
    return result


def _worst(parts: Sequence[_Segment], sample: int) -> Worst:
    for part in parts:
        if sample < part.valid.size:
            pose, vertex = divmod(sample, part.valid.shape[1])
            return Worst(part.place, vertex, part.poses.clips[pose], part.poses.times[pose])
        sample -= part.valid.size
    raise IndexError(sample)


def _exceeded(normals: Normals, options: VerifyOptions, place: Place) -> list[Notice]:
    """Return a problem for each limit that the accurate lighting of a method exceeds."""
    problems = []
    for method in options.methods or ("lbs",):
        figures = normals.get(method, {})
        if "accurate" not in figures:
            problems.append(Notice("no-figures", f"no lighting could be measured for {method}", place))
            continue
        accurate = figures["accurate"]
        for name, limit, value in (
            ("mean", options.max_mean_error, accurate.mean),
            ("95th percentile", options.max_p95_error, accurate.p95),
        ):
            if limit is not None and not value <= limit:
                message = f"{method.upper()} accurate: the {name} of the error is {value:.3f}°, over {limit}°"
                problems.append(Notice("limit", message, place))
        factor = gain(figures)
        if options.min_gain is not None and factor is not None and factor < options.min_gain:
            message = f"{method.upper()}: the gain is {factor:.2f}, below {options.min_gain}"
            problems.append(Notice("limit", message, place))
    return problems
