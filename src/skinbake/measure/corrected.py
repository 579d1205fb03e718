"""The lighting of a document with correctives, beside that of α and β, and in poses of no clip."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.errors import Place
from skinbake.freshness.baked_views import baked_views
from skinbake.freshness.corrective_freshness import PlayedCorrectives
from skinbake.geometry.poses import normalised
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, Clip, clip_values, clip_weights
from skinbake.gltf.reading.skins import PATHS, Skeleton
from skinbake.measure.angles import MeasuredBlock
from skinbake.measure.draws import Draw
from skinbake.measure.measured import Measurement, bakeable
from skinbake.measure.options import VerifyOptions
from skinbake.measure.scene import Scene, measure
from skinbake.report.verify import Check, FileVerdict, Mixture

WORSE, ROUNDING = 1.005, 1e-3
"""From where on an error is worse than another one: its share, and degrees."""


def corrected_lighting(
    played: PlayedCorrectives, gradients: Document, options: VerifyOptions
) -> tuple[FileVerdict, list[Draw]]:
    """Measure standard lighting, correctives, and α and β in the same poses. Return the draws, too.

    ``gradients`` is the document without its correctives, and with α and β. There are no draws if their bake
    is not sound. Raises InputError.
    """
    with gradients.notices.withheld() as problems:
        views = baked_views(gradients, bakeable(gradients))
    if problems:
        return FileVerdict(gradients.name, (Check("structure", "failed", tuple(problems)),)), []
    scene = Scene.of_bakes(gradients, views, correctives=played)
    measurement = Measurement(scene, replace(options, methods=("lbs",)))
    return measurement.verdict(), measurement.drawn


def mixtures(played: PlayedCorrectives, drawn: Sequence[Draw]) -> Iterator[tuple[Place, Mixture]]:
    """Yield what correctives do in poses that they were not made for, by surface.

    These are poses half-way between the first two clips that play them, as in a cross-fade, and those of
    the first one with a limb turned by 60°, as by IK.
    """
    for draw in drawn:
        views, skeleton = draw.surface.views, draw.skeleton
        if draw.corrections is None or not any(view.source.mesh in played.targets for view in views):
            continue
        # The poses of the draw have claimed the work of looking for the clips that move it.
        nodes = set(skeleton.nodes)
        moving = [
            clip
            for clip in played.clips.values()
            if any(one.path != MORPH_WEIGHTS and one.node in nodes for one in clip.channels)
        ]
        # The weights of correctives by clip and primitive, and those of the file's own targets by clip.
        playing, times, weights = list[Clip](), list[Float64Array](), list[list[Float64Array]]()
        for clip in moving:
            at = clip.start + (clip.duration - clip.start) * MOMENTS
            by_view = [
                played.weights(view.source.mesh, draw.skin, draw.node, clip.number, at) for view in views
            ]
            if any(one.any() for one in by_view):
                playing.append(clip)
                times.append(at)
                weights.append(by_view)
            if len(playing) == 2:
                break
        if not playing:
            continue
        own = [_own_weights(played, draw, *pair) for pair in zip(playing, times, strict=True)]
        if len(playing) == 2:
            first, second = (clip_values(*pair) for pair in zip(playing, times, strict=True))
            # The mean of the values (P, C) of two clips.
            at_rest = dict(
                zip(PATHS, (skeleton.translations, skeleton.rotations, skeleton.scales), strict=True)
            )
            found = {}
            for node, path in {**first, **second}:
                if node not in skeleton.nodes:
                    continue
                rest = np.tile(at_rest[path][skeleton.nodes.index(node)], (len(MOMENTS), 1))
                one, other = (values.get((node, path), rest) for values in (first, second))
                if path == "rotation":
                    near = np.where((one * other).sum(axis=1, keepdims=True) < 0.0, -other, other)
                    found[node, path] = normalised(one + near)
                else:
                    found[node, path] = (one + other) / 2.0
            matrices = skeleton.joint_matrices(found, None, len(MOMENTS))
            mean = [(one + other) / 2.0 for one, other in zip(*weights, strict=True)]
            name = f'half-way between "{playing[0].name}" and "{playing[1].name}"'
            yield draw.surface.place, _mixture(name, draw, matrices, mean, (own[0] + own[1]) / 2.0)
        limb = _limb(skeleton)
        if limb is not None:
            turned = np.zeros((len(skeleton.joints), len(MOMENTS), 4))
            turned[..., 0] = 1.0
            turned[limb] = TURN
            matrices = skeleton.joint_matrices(clip_values(playing[0], times[0]), turned, len(MOMENTS))
            joint = played.document.asset.nodes[skeleton.nodes[skeleton.joints[limb]]].name
            name = f'in "{playing[0].name}" with {joint or f"joint {limb}"} turned by 60°'
            yield draw.surface.place, _mixture(name, draw, matrices, weights[0], own[0])


def _own_weights(played: PlayedCorrectives, draw: Draw, clip: Clip, times: Float64Array) -> Float64Array:
    """Return the weights (P, N) of the file's own morph targets at times of a clip; N is 0 without."""
    if draw.node is None:
        return np.zeros((len(times), 0))
    own = draw.surface.document.asset.meshes[draw.surface.views[0].source.mesh].target_count
    resting = played.document.asset.nodes[draw.node].resting_weights()
    return clip_weights(draw.node, clip, times, resting)[:, :own]


def _mixture(
    name: str, draw: Draw, matrices: Float64Array, weights: Sequence[Float64Array], own: Float64Array
) -> Mixture:
    """Measure joint matrices (P, J, 4, 4) with weights (P, K) of correctives by primitive.

    own (P, N) are the weights of the file's own morph targets.
    """
    assert draw.corrections is not None
    poses = draw.poses._replace(joint_matrices=matrices, morph_weights=own if own.size else None)
    mixed = replace(draw, poses=poses, corrections=replace(draw.corrections, weights=weights))
    sums: dict[tuple[str, str], list[float]] = {}

    def add(block: MeasuredBlock) -> None:
        if block.lighting in {"standard", "corrected"}:
            areas = draw.areas[block.primitive][block.vertex : block.vertex + block.errors.shape[1]]
            total = sums.setdefault((block.lighting, block.truth), [0.0, 0.0])
            errors = np.where(block.valid, np.nan_to_num(block.errors, nan=180.0), 0.0)
            total[0] += float((errors * areas).sum())
            total[1] += float((block.valid * areas).sum())

    measure(mixed, add)
    means = {key: total / max(weight, 1e-300) for key, (total, weight) in sums.items()}
    by_truth = [
        {truth: mean for (of, truth), mean in means.items() if of == lighting}
        for lighting in ("standard", "corrected")
    ]
    return Mixture(name, *by_truth)


MOMENTS: Float64Array = np.linspace(0.0, 1.0, 12, endpoint=False) + 0.382 / 12.0
"""The moments of a clip that mixtures take, as shares of its length."""

TURN = np.cos(np.pi / 6.0), *(np.sin(np.pi / 6.0) / np.sqrt(3.0) * np.ones(3))
"""A turn by 60°, as a quaternion (w, x, y, z). Its axis is none of a joint's own."""


def _limb(skeleton: Skeleton) -> int | None:
    """Return the joint that carries the most others, but at most a quarter of them; None if there is none."""
    carried = np.zeros(len(skeleton.nodes), dtype=np.int64)
    carried[skeleton.joints] = 1
    for node in reversed(range(len(skeleton.nodes))):  # parents come before their children
        if skeleton.parents[node] >= 0:
            carried[skeleton.parents[node]] += carried[node]
    of_joints = carried[skeleton.joints]
    few = (of_joints > 1) & (of_joints <= max(2, len(of_joints) // 4))
    return int(np.argmax(np.where(few, of_joints, 0))) if few.any() else None


def worse_primitives(verdict: FileVerdict) -> dict[Place, tuple[float, float]]:
    """Return the primitives that correctives make worse by a truth, with the means before and after."""
    found: dict[Place, tuple[float, float]] = {}
    for place, normals in verdict.primitives:
        figures = normals.get("lbs", {})
        if "corrected" in figures:
            before, after = figures["standard"].mean, figures["corrected"].mean
            if after > WORSE * before + ROUNDING:
                found.setdefault(place, (before, after))
    return found
