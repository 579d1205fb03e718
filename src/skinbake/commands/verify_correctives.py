"""``skinbake verify`` of a file with correctives: whether they fit the file, and how much they improve it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.choices import Gradients, PoseKind
from skinbake.commands.bake import Baker
from skinbake.commands.played_correctives import (
    BAKE,
    NUMBERS,
    SAME,
    PlayedCorrectives,
    changed_since,
    damaged_correctives,
    played_clips,
)
from skinbake.errors import Notice, Place
from skinbake.format.metadata import corrective_notes
from skinbake.format.strip import uncorrected
from skinbake.freshness.baked_views import baked_views, gathered_together
from skinbake.freshness.made_targets import made_states
from skinbake.freshness.staleness import surface_operator
from skinbake.geometry.poses import normalised
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.animation import (
    MORPH_WEIGHTS,
    PATHS,
    Clip,
    Skeleton,
    clip_values,
    clip_weights,
    read_skeleton,
)
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, is_number, text
from skinbake.gltf.morphs import resting_weights, target_count
from skinbake.gltf.primitives import PrimitiveSource, read_primitive, reason_to_skip, skinned_sources
from skinbake.measure.angles import Corrections, MeasuredBlock, lighting_errors
from skinbake.measure.draws import Draw
from skinbake.measure.measured import lighting_verdict
from skinbake.measure.morphing import morphing_of
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import Check, FileVerdict, Mixture
from skinbake.timing import stage
from skinbake.wording import counted

WORSE, ROUNDING = 1.005, 1e-3
"""From where on an error is worse than another one: its share, and degrees."""


def corrected_verdict(document: Document, options: VerifyOptions) -> FileVerdict:
    """Verify a document with correctives, as it is in memory. Raises InputError if it cannot be read.

    Standard lighting, the correctives, and what α and β would give are measured in the same poses.
    """
    with stage("read"):
        sources, notices = skinned_sources(document)
        problems = list(damaged_correctives(document))
    if problems:
        structure = Check("structure", "failed", tuple(problems))
        skipped = [Check(name, "skipped", (), "structure failed") for name in ("freshness", "lighting")]
        return FileVerdict(document.name, (structure, *skipped), notices=tuple(notices))
    with stage("freshness"):
        fresh = _freshness(document, sources)
    verdict, measured = _lighting_of(document, options, Baker())
    if measured is None:
        return verdict
    targets = measured.played.targets
    meshes = counted(len(targets), "mesh", "meshes")
    told = f"{counted(sum(targets.values()), 'corrective normal')} of {meshes}"
    structure = Check("structure", "passed", (), told)
    # That algorithms 2 and 3 agree says nothing of correctives.
    checks = [check for check in verdict.checks if check.name != "identity"]
    worse = [_worse(place, *means) for place, means in worse_primitives(verdict).items()]
    mixtures: list[Mixture] = []
    with stage("mixtures"):
        for place, mixture in measured.mixtures() if options.poses.kind is PoseKind.ANIMATION else ():
            mixtures.append(mixture)
            if any(mixture.corrected[by] > WORSE * mixture.standard[by] for by in mixture.standard):
                message = f"its correctives are worse than standard lighting {mixture.words}"
                worse.append(Notice("correctives-mixed", message, place))
    return replace(
        verdict,
        input=document.name,
        checks=(structure, fresh, *checks),
        notices=(*notices, *verdict.notices, *worse),
        mixtures=tuple(mixtures),
    )


def corrected_lighting(document: Document) -> FileVerdict:
    """Return the lighting of a document with correctives, as ``corrected_verdict`` measures it.

    α and β are those of the surface, which are made sooner. Raises InputError.
    """
    return _lighting_of(document, VerifyOptions(), Baker(gradients=Gradients.SURFACE))[0]


def _lighting_of(
    document: Document, options: VerifyOptions, baker: Baker
) -> tuple[FileVerdict, _Measured | None]:
    """Measure standard lighting, correctives and the α and β of a baker; None if their bake is not sound."""
    with stage("α and β"):
        plain, _, _ = uncorrected(document)
        gradients = baker.bake_document(plain).document
        every, _ = skinned_sources(gradients)
        wanted = [one for one in every if reason_to_skip(gradients, one, generate_normals=False) is None]
        views, problems = baked_views(gradients, wanted)
    if problems:
        return FileVerdict(document.name, (Check("structure", "failed", tuple(problems)),)), None
    measured = _Measured(document, gradients)
    surfaces = gathered_together(gradients, views)
    operators = [surface_operator(gradients, surface) for surface in surfaces]
    by_lbs = replace(options, methods=("lbs",))
    return lighting_verdict(gradients, by_lbs, surfaces, operators, measured.corrected), measured


def _freshness(document: Document, sources: Sequence[PrimitiveSource]) -> Check:
    """Return whether meshes, targets, weights and clips are those of the bake."""
    problems = [state.notice for state in made_states(document) if state.changed]
    moved: dict[str, None] = {}
    for source in sources:
        note = corrective_notes(document).get(source.mesh)
        if note is None:
            continue
        changed, fit = changed_since(document, source, read_primitive(document, source), note)
        if fit:
            moved |= dict.fromkeys(changed)
        elif changed:
            message = f"{' and '.join(changed)} changed since the bake of its correctives: {BAKE}"
            problems.append(Notice("stale", message, source.place))
        else:
            message = f"its corrective normals are not those of the bake any more: {BAKE}"
            problems.append(Notice("stale-targets", message, source.place))
    for number, note in corrective_notes(document).items():
        place = Place(document.name, number, text(document.objects("meshes")[number], "name", document.place))
        stale = dict.fromkeys(_stale_clips(document, number, note))
        problems += [Notice("stale-clips", f"{message}: {BAKE}", place) for message in stale]
    remark = f"{', '.join(moved)} changed since the bake, and the correctives still fit" if moved else ""
    return Check("freshness", "failed" if problems else "passed", tuple(problems), remark)


def _stale_clips(document: Document, mesh: int, note: JsonObject) -> Iterator[str]:
    """Yield what is wrong if clips play correctives of a mesh in other poses than those of the bake.

    Names, numbers and the order of clips do not count, nor do clips that are gone.
    """
    rows = note.get("plays")
    rows = [one for one in rows if isinstance(one, list)] if isinstance(rows, list) else []
    width = 2 * NUMBERS
    noted = np.array(
        [one for one in rows if len(one) == width and all(map(is_number, one))], dtype=np.float64
    ).reshape(-1, width)
    found = played_clips(document, mesh, int(note["targets"]))
    if not any(one.plays for one in found):
        yield "no clip plays its correctives any more"
    steps = 1 + noted.size // 1000
    document.budget.claim_steps(steps * len(found), "comparing what its clips play", document.place)
    is_played, silent = np.zeros(len(noted), dtype=np.bool_), dict[int, Clip]()
    for one in found:
        same = np.abs(noted - [*one.poses, *one.weights]) <= SAME
        in_poses = same[:, :NUMBERS].all(axis=1)
        is_noted = in_poses & same[:, NUMBERS:].all(axis=1)
        is_played |= is_noted
        if not one.plays:
            silent |= dict.fromkeys(np.flatnonzero(in_poses).tolist(), one.clip)
        elif not is_noted.any():
            if in_poses.any():
                yield f'clip "{one.clip.name}" plays its correctives by other weights than those of the bake'
            else:
                yield f'clip "{one.clip.name}" or its rig changed since the bake of its correctives'
    for number, clip in silent.items():
        if not is_played[number]:
            yield f'clip "{clip.name}" does not play its correctives any more'


class _Measured:
    """The draws in which the correctives of a document were measured, on a document without them."""

    def __init__(self, document: Document, plain: Document) -> None:
        self._document, self._plain, self.played = document, plain, PlayedCorrectives(document)
        self.drawn: list[Draw] = []

    def corrected(self, draw: Draw) -> Draw:
        """Return the draw with its correctives. A mesh without any has none."""
        weights = [self._weights(draw, view.source.mesh) for view in draw.views]
        found = replace(draw, corrections=Corrections(self.played.of_views(draw.views), weights))
        self.drawn.append(found)
        return found

    def _weights(self, draw: Draw, mesh: int) -> Float64Array:
        """Return the weights (P, K) of a mesh's correctives in the poses of a draw; 0 outside clips."""
        found = np.zeros((len(draw.poses.clips), self.played.targets.get(mesh, 0)))
        times = np.array([0.0 if time is None else time for time in draw.poses.times])
        for number in set(draw.poses.numbers) - {None}:
            rows = np.flatnonzero([one == number for one in draw.poses.numbers])
            clip = self.played.clips[int(number or 0)]
            found[rows] = self.played.weights(mesh, (draw.skin, draw.node), clip, times[rows])
        return found

    def mixtures(self) -> Iterator[tuple[Place, Mixture]]:
        """Yield what correctives do in poses that they were not made for, by surface.

        These are poses half-way between the first two clips that play them, as in a cross-fade, and those of
        the first one with a limb turned by 60°, as by IK.
        """
        for draw in self.drawn:
            mesh = next((v.source.mesh for v in draw.views if v.source.mesh in self.played.targets), None)
            if mesh is None or draw.corrections is None:
                continue
            skeleton = read_skeleton(self._document, draw.skin)
            nodes = set(skeleton.nodes)
            # The poses of the draw have claimed the work of looking for them.
            moving = [
                clip
                for clip in self.played.clips.values()
                if any(one.path != MORPH_WEIGHTS and one.node in nodes for one in clip.channels)
            ]
            # The weights of correctives by clip and primitive, and those of the file's own targets by clip.
            playing, times, weights = list[Clip](), list[Float64Array](), list[list[Float64Array]]()
            drawn = draw.skin, draw.node
            for clip in moving:
                at = clip.start + (clip.duration - clip.start) * MOMENTS
                played = [self.played.weights(view.source.mesh, drawn, clip, at) for view in draw.views]
                if any(one.any() for one in played):
                    playing.append(clip)
                    times.append(at)
                    weights.append(played)
                if len(playing) == 2:
                    break
            if not playing:
                continue
            place = draw.views[0].source.place._replace(primitive=None)
            own = [self._own_weights(draw, *pair) for pair in zip(playing, times, strict=True)]
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
                yield place, self._mixture(name, draw, matrices, mean, (own[0] + own[1]) / 2.0)
            limb = _limb(skeleton)
            if limb is not None:
                turned = np.zeros((len(skeleton.joints), len(MOMENTS), 4))
                turned[..., 0] = 1.0
                turned[limb] = TURN
                matrices = skeleton.joint_matrices(clip_values(playing[0], times[0]), turned, len(MOMENTS))
                joint = self._document.objects("nodes")[skeleton.nodes[skeleton.joints[limb]]].get("name")
                name = f'in "{playing[0].name}" with {joint or f"joint {limb}"} turned by 60°'
                yield place, self._mixture(name, draw, matrices, weights[0], own[0])

    def _own_weights(self, draw: Draw, clip: Clip, times: Float64Array) -> Float64Array:
        """Return the weights (P, N) of the file's own morph targets at times of a clip; N is 0 without."""
        if draw.node is None:
            return np.zeros((len(times), 0))
        own = target_count(self._plain, draw.views[0].source.mesh)
        resting = resting_weights(self._document, draw.node)
        return clip_weights(draw.node, self.played.clips[clip.number], times, resting)[:, :own]

    def _mixture(
        self,
        name: str,
        draw: Draw,
        matrices: Float64Array,
        weights: Sequence[Float64Array],
        own: Float64Array,
    ) -> Mixture:
        """Measure joint matrices (P, J, 4, 4) with weights (P, K) of correctives by primitive.

        own (P, N) are the weights of the file's own morph targets.
        """
        assert draw.corrections is not None
        poses = draw.poses._replace(joint_matrices=matrices, morph_weights=own if own.size else None)
        morphing = morphing_of(self._plain, draw.views, poses)
        sums: dict[tuple[str, str], list[float]] = {}

        def add(block: MeasuredBlock) -> None:
            if block.lighting in {"standard", "corrected"}:
                areas = draw.areas[block.primitive][block.vertex : block.vertex + block.errors.shape[1]]
                total = sums.setdefault((block.lighting, block.truth), [0.0, 0.0])
                total[0] += float(
                    (np.where(block.valid, np.nan_to_num(block.errors, nan=180.0), 0.0) * areas).sum()
                )
                total[1] += float((block.valid * areas).sum())

        corrections = replace(draw.corrections, weights=weights)
        lighting_errors(
            draw.operator,
            draw.rest,
            matrices,
            "lbs",
            add,
            morphing=morphing,
            corrections=corrections,
            direct=False,
        )
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
    for place, normals in (*verdict.primitives, *verdict.primitives_by_triangles):
        figures = normals.get("lbs", {})
        if "corrected" in figures:
            before, after = figures["standard"].mean, figures["corrected"].mean
            if after > WORSE * before + ROUNDING:
                found.setdefault(place, (before, after))
    return found


def _worse(place: Place, before: float, after: float) -> Notice:
    change = f"from {before:.2f}° to {after:.2f}°: skinbake strip takes them out"
    message = f"its correctives make its lighting worse in these poses, {change}"
    return Notice("correctives-worse", message, place)
