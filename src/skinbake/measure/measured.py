"""The lighting of a baked document, measured mesh by mesh and skin by skin, and compared with limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skinbake.choices import PoseKind, Truth
from skinbake.errors import BudgetError, InputError, Notice, Place
from skinbake.freshness.baked_views import baked_views
from skinbake.freshness.staleness import claim_freshness
from skinbake.geometry.dual_quaternions import not_rigid_joints
from skinbake.geometry.poses import determinants
from skinbake.geometry.skinned import BoolArray
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import Clip, read_clips
from skinbake.gltf.reading.meshes import reason_to_skip, skinned_sources
from skinbake.measure.angles import (
    IDENTITY_TOLERANCE,
    MeasuredBlock,
    lighting_errors,
)
from skinbake.measure.draws import Draw
from skinbake.measure.float32 import Rounding, rounding_of
from skinbake.measure.options import VerifyOptions, limits_check
from skinbake.measure.reliefs import ReliefTallies
from skinbake.measure.scene import Scene
from skinbake.measure.tally import Tallies
from skinbake.report.verify import Check, Figures, FileVerdict, MorphCount, Normals
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.skinning.run import joints_in_use
from skinbake.timing import stage, tell_steps
from skinbake.truth import kernel
from skinbake.truth.poses import PoseSet, described
from skinbake.truth.truths import Truths, truths_at_rest
from skinbake.wording import counted

if TYPE_CHECKING:
    from skinbake.measure.places import Places
    from skinbake.truth.morphing import Morphing

MORPHED_BYTES = 64 << 20
"""The memory in which morphed primitives wait for the second method. Those that need more are made again."""

MANY_VERTICES = 1 << 18
"""From so many vertices on, freed memory is given back before a measurement. It takes some milliseconds."""

BY_LBS = VerifyOptions(methods=("lbs",))
"""How the lighting of a bake is measured: by linear blend skinning, in the poses of the file."""


class Measurement:
    """The measurement of the lighting of a scene, with what serves more than one draw or method.

    drawn are the measured draws, once there is a verdict.
    """

    def __init__(self, scene: Scene, options: VerifyOptions) -> None:
        self._scene, self._document, self._options = scene, scene.document, options
        self.drawn: list[Draw] = []
        self._clips: Sequence[Clip] = ()
        self._done, self._total, self._identity = 0.0, 0, 0.0
        self._tallies = Tallies(())
        self._at_rest: tuple[tuple[int, int, bool], Truths] | None = None
        self._morphed: dict[int, Morphing] = {}
        self._room = MORPHED_BYTES
        self._reliefs = ReliefTallies(scene.document, Options(options.cap, options.baseline))
        self._places: Places | None = None
        if options.finds_places:
            from skinbake.measure.places import Places  # only reports for people have them

            self._places = Places()

    def verdict(self) -> FileVerdict:
        """Return a verdict with the checks of the lighting and its figures; tell what spoils them.

        Correctives are measured too, if the scene has any. Raises InputError if the file cannot be posed, or
        asks for work out of proportion to its size.
        """
        document, asked, unplayed = self._document, self._options.poses, None
        with stage("poses"):
            try:
                self._clips = read_clips(document)
                with document.notices.withheld() as left_out:
                    self.drawn = drawn = self._scene.measured(self._clips, asked)
                document.notices.tell(*left_out)
            except BudgetError:
                raise
            except InputError as error:
                # Its clips are broken, or move joints past all numbers.
                message = f"its animations are broken, and are not played ({error.message})"
                unplayed = InputError(message, document.place)
                if self._options.poses.kind is PoseKind.ANIMATION:
                    message += ": random poses are measured in their place. Mend or remove the animations"
                document.notices.tell(Notice("animations-broken", message, document.place))
                self._clips = ()
                self.drawn = drawn = self._scene.measured((), asked)
        has_blend = any(view.blend is not None for view in self._scene.views)
        methods = self._options.methods or ("lbs", "dqs", *(["blend"] if has_blend else []))
        if "blend" in methods and not has_blend:
            message = "no primitive of it has blend weights that a bake has read: run skinbake bake --blend"
            raise InputError(message, document.place)
        scaled = dict.fromkeys(
            name for draw in drawn for name in scaled_joints(draw.surface.rest, draw.poses)
        )
        self._total = sum(len(draw.poses.clips) for draw in drawn) * len(methods)
        self._tallies = Tallies(view.source.place for draw in drawn for view in draw.surface.views)
        self._reliefs.expect(drawn)
        # The figures are checked to be finite.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for method in methods:
                for draw in drawn:
                    self._measure(method, draw, again=method != methods[-1])
            document.notices.tell(*_mirrored(drawn), *(_rounded(drawn) if "lbs" in methods else ()))
            with stage("figures"):
                verdict = self._verdict(drawn, tuple(scaled) if {"dqs", "blend"} & {*methods} else ())
        moving: dict[int, set[int]] = {}
        for draw in drawn:
            mesh = draw.surface.views[0].source.mesh
            moving.setdefault(mesh, set()).update(draw.poses.moving_targets)
        targets = sum(document.asset.meshes[mesh].target_count for mesh in moving)
        morphs = MorphCount(targets, sum(map(len, moving.values()))) if targets else None
        spots = None if self._places is None else self._places.spots()
        return replace(
            verdict, unplayed=unplayed, is_partial=self._scene.is_partial, morphs=morphs, spots=spots
        )

    def _measure(self, method: str, draw: Draw, *, again: bool) -> None:
        """Measure a draw by a method; ``again``: another method follows."""
        if len(draw.surface.operator.positions) >= MANY_VERTICES:
            give_back_freed_memory()
        morphing = self._morphing(draw, again=again)
        truths = self._truths(draw, morphing)
        poses, all_areas = draw.poses, draw.areas
        places = (view.source.place for view in draw.surface.views)
        first = self._tallies.begin(places, poses.clips, poses.times)
        cells = self._places if method == "lbs" else None
        if cells is not None:
            cells.begin(draw)

        def counted(block: MeasuredBlock) -> Callable[[], None]:
            """Count a block on one of several threads. Return what adds it on one thread, in their order."""
            areas = all_areas[block.primitive][block.vertex : block.vertex + block.errors.shape[1]]
            with stage("figures"):
                found = kernel.count_errors(block.errors, areas, block.valid)
                of_cells = None if cells is None else cells.counted(block)
            key = block.truth, method, block.lighting
            start = first + block.primitive, block.pose, block.vertex

            def add() -> None:
                with stage("figures"):
                    self._tallies.take(key, found, start)
                    if cells is not None:
                        cells.add(block, of_cells)

            return add

        identity = lighting_errors(
            draw.surface.operator,
            draw.surface.rest,
            draw.poses.joint_matrices,
            method,
            lambda add: add(),  # what the tallies return for a block
            count=counted,
            options=Options(self._options.cap, self._options.baseline),
            morphing=morphing,
            at_rest=truths,
            corrections=draw.corrections,
            advance=self._advance,
        )
        if cells is not None:
            cells.end()
        if method != "blend":
            with stage("reliefs"):
                self._reliefs.measure(method, draw, truths, morphing)
        self._identity = max(self._identity, identity)

    def _morphing(self, draw: Draw, *, again: bool) -> Morphing | None:
        """Return the morph targets of a draw. Keep its morphed primitives for the next method if small."""
        key = id(draw)
        if key in self._morphed:
            return self._morphed[key] if again else self._morphed.pop(key)
        morphing = draw.morphing
        # The memory of each vertex in one pose, with the data that truths need.
        size = sum(8 * rest.joints.shape[0] * (20 + 3 * rest.joints.shape[1]) for rest in draw.surface.rest)
        size *= len(draw.poses.clips)
        if morphing is None or not again or size > self._room:
            return morphing
        self._room -= size
        self._morphed[key] = replace(morphing, kept={})
        return self._morphed[key]

    def _truths(self, draw: Draw, morphing: Morphing | None) -> Truths:
        """Return the data of a mesh at rest. The last ones serve again for the same mesh in as many poses."""
        key = id(draw.surface.operator), len(draw.poses.clips), morphing is None
        if self._at_rest is None or self._at_rest[0] != key:
            self._at_rest = None  # two at a time would take twice the memory
            surface = draw.surface
            self._at_rest = key, truths_at_rest(surface.operator, surface.rest, key[1], morphing)
        return self._at_rest[1]

    def _advance(self, poses: float) -> None:
        before, self._done = round(self._done), self._done + poses
        if round(self._done) != before:
            tell_steps(round(self._done), self._total)

    def _verdict(self, drawn: Sequence[Draw], scaled: tuple[str, ...]) -> FileVerdict:
        measured = [truth for truth in self._options.truths if truth is not Truth.RELIEF]
        figures: dict[Truth, Figures] = {truth: self._tallies.figures(truth) for truth in measured}
        by_truth: dict[Truth, Normals] = {truth: one.whole for truth, one in figures.items()}
        reliefs = self._reliefs.reliefs()
        if Truth.RELIEF in self._options.truths:
            by_truth[Truth.RELIEF] = {} if reliefs is None else reliefs.by_normal.whole
        # Products of numbers near the largest float may overflow.
        found = [
            one
            for by_method in by_truth.values()
            for lightings in by_method.values()
            for one in lightings.values()
        ]
        if not all(math.isfinite(one.mean) and math.isfinite(one.max) for one in found):
            raise InputError(
                "its positions, gradients and joint matrices are so large that their products overflow: "
                "scale the model down",
                self._document.place,
            )
        # The checks of the lighting. One that does not apply is left out.
        checks, normals = list[Check](), next(filter(None, by_truth.values()), {})
        if "lbs" in normals:
            if self._options.cap is None:
                checks.append(identity_check(self._identity, drawn, self._document.place))
            else:  # a cap bounds algorithm 3 alone
                checks.append(Check("identity", "skipped", (), "--cap bounds one of both algorithms"))
        if not normals:
            nothing = "there is no true normal at any vertex in these poses"
            checks.append(Check("lighting", "skipped", (), nothing))
        if self._options.limits:
            held = {truth: found for truth, found in by_truth.items() if self._options.truth in {None, truth}}
            checks.append(limits_check(held, self._options, self._document.place))
        seconds = sum(clip.duration - clip.start for clip in self._clips)
        return FileVerdict(
            self._document.name,
            tuple(checks),
            figures,
            described(self._options.poses, [draw.poses for draw in drawn], seconds),
            scaled,
            reliefs=reliefs,
        )


def _mirrored(drawn: Sequence[Draw]) -> Iterator[Notice]:
    """Yield a notice for each draw with joints in use that mirror, and turn the surface inside out."""
    mirrors: dict[int, BoolArray] = {}
    for draw in drawn:
        key, matrices = id(draw.poses), draw.poses.joint_matrices
        if key not in mirrors:
            mirrors[key] = np.any(determinants(matrices) < 0, axis=0)
        count = int(np.count_nonzero(mirrors[key] & joints_in_use(draw.surface.rest, matrices.shape[1])))
        if count:
            joints = counted(count, "joint mirrors", "joints mirror")
            message = (
                f"{joints} the surface (negative determinant): write the shader with --for this file, or "
                "with --mirrored-joints, so that normals stay outside"
            )
            yield Notice(
                "joints-mirror", message, draw.surface.views[0].source.place._replace(primitive=None), count
            )


def _rounded(drawn: Sequence[Draw]) -> Iterator[Notice]:
    """Yield a notice for each primitive whose accurate normals float32 spoils in its poses."""
    worst: dict[Place, Rounding] = {}
    for draw in drawn:
        for view, rest in zip(draw.surface.views, draw.surface.rest, strict=True):
            found = rounding_of(rest, draw.poses.joint_matrices)
            if found is not None:
                worst[view.source.place] = max(found, worst.get(view.source.place, found))
    for place, found in worst.items():
        what = (
            f"in float32, as GPUs compute, rounding turns accurate normals by up to {found.angle:.2g}° at "
            f"{counted(found.vertices, 'vertex', 'vertices')}, because "
        )
        distance = f"{float(f'{found.distance:.3g}'):,.10g}"
        why = f"its poses take it {distance} length units from the origin: move it nearer"
        if found.is_steep:
            why = (
                "α and β are too large there: run skinbake bake again, or, if the bake is fresh, merge the "
                "vertices that nearly coincide"
            )
        yield Notice("float32", what + why, place, found.vertices)


def scaled_joints(rest: Sequence[RestPrimitive], poses: PoseSet) -> list[str]:
    """Return the names of the joints in use that are not rigid in these poses, up to one common scale."""
    in_use = joints_in_use(rest, poses.joint_matrices.shape[1])
    return [poses.joint_names[joint] for joint in not_rigid_joints(poses.joint_matrices, in_use)]


def identity_check(angle: float, drawn: Sequence[Draw], place: Place) -> Check:
    """Return whether algorithms 2 and 3 agree. angle is the largest one between their normals, in degrees."""
    remark = f"direct and accurate (algorithms 2 and 3) agree within {angle:.1g}°"
    if angle <= IDENTITY_TOLERANCE:
        return Check("identity", "passed", (), remark)
    message = f"direct and accurate normals (algorithms 2 and 3) differ by {angle:.2g}°"
    strained = max((_strain(draw) for draw in drawn), default=(0.0, ""))
    if strained[0] > STRAINED:
        message += (
            f": its joint matrices are singular or too unlike in size, {strained[1]} most of all, and "
            "rounding takes over: mend the nodes, inverse bind matrices or animations that make them"
        )
    else:
        message += ", and should agree to rounding: this is a fault of skinbake, please report it"
    return Check("identity", "failed", (Notice("identity", message, place),))


STRAINED = 1e6
"""The ratio of joint matrix sizes above which rounding alone can separate algorithms 2 and 3."""


def _strain(draw: Draw) -> tuple[float, str]:
    """Return the ratio of the largest to the least scaling of a frame by joints, and the joint to blame."""
    matrices = draw.poses.joint_matrices
    stretches = np.linalg.svd(matrices[..., :3, :3], compute_uv=False)
    extent = max(float(np.abs(rest.positions).max(initial=0.0)) for rest in draw.surface.rest)
    slope = max(float(np.abs([rest.alpha, rest.beta]).max(initial=0.0)) for rest in draw.surface.rest)
    reach = stretches[..., 0] * extent + np.abs(matrices[..., :3, 3]).max(axis=-1)
    largest = (stretches[..., 0] + reach * slope).max(axis=0)
    least = stretches[..., 2].min(axis=0)
    # A joint that scales by 0 strains without limit.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        too_large, too_small = largest / np.median(largest), np.median(least) / least
        strain = float(largest.max() / least.min())
        worst = int(np.argmax(np.nan_to_num(np.maximum(too_large, too_small), nan=np.inf)))
    return (math.inf if math.isnan(strain) else strain), draw.poses.joint_names[worst]


def give_back_freed_memory() -> None:
    """Give the system what this process has freed. Other C libraries than glibc do so by themselves.

    glibc keeps arrays of up to 32 MB for later ones. After the preparation of a million vertices that is a
    third of all memory.
    """
    import ctypes  # few files are that large

    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return
    trim(0)


def bakeable(document: Document) -> list[PrimitiveSource]:
    """Return the skinned primitives that can be baked as they are."""
    every = skinned_sources(document)
    return [one for one in every if reason_to_skip(document, one, generate_normals=False) is None]


def lighting_of(document: Document, options: VerifyOptions = BY_LBS) -> FileVerdict:
    """Return the lighting of a document that has just been baked. Nothing is told of it.

    Its freshness is not in question.
    """
    with document.notices.withheld():
        views = baked_views(document, bakeable(document))
        return Measurement(Scene.of_bakes(document, views), options).verdict()


def claim_verification(document: Document) -> None:
    """Count the work of verifying a document that has just been baked. Raises InputError if it is too much.

    Other faults of the document raise nothing: verify says them.
    """
    wanted = bakeable(document)
    claim_freshness(document, len(wanted))
    try:
        with document.notices.withheld():
            views = baked_views(document, wanted)
            Scene.of_bakes(document, views).measured(read_clips(document), VerifyOptions().poses)
    except BudgetError:
        raise
    except InputError:
        pass
