"""The lighting of a baked document, measured mesh by mesh and skin by skin, and compared with limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from skinbake.choices import PoseKind, Truth
from skinbake.errors import InputError, Notice
from skinbake.gltf.animation import Clip, read_clips
from skinbake.gltf.document import Document
from skinbake.lighting.angles import (
    lighting_errors,
    truths_at_rest,
)
from skinbake.lighting.baked_views import BakedView
from skinbake.lighting.draws import Draw, draws, true_surfaces
from skinbake.lighting.error_limits import limits_check
from skinbake.lighting.file_tallies import FileTallies
from skinbake.lighting.freed_memory import give_back_freed_memory
from skinbake.lighting.joint_checks import identity_check, joints_without_dqs, mirrored, without_dqs
from skinbake.lighting.morphing import Morphing, morph_count, morphing_of
from skinbake.lighting.operator import GradientOperator
from skinbake.lighting.poses import described
from skinbake.lighting.truths import Truths
from skinbake.lighting.verify_options import VerifyOptions
from skinbake.report.verify import Check, FileVerdict, Normals
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.timing import stage, tell_steps

MORPHED_BYTES = 64 << 20
"""The memory in which morphed primitives wait for the second method. Those that need more are made again."""

MANY_VERTICES = 1 << 18
"""From so many vertices on, freed memory is given back before a measurement. It takes some milliseconds."""


def lighting_verdict(
    document: Document,
    options: VerifyOptions,
    meshes: Sequence[Sequence[BakedView]],
    operators: Sequence[GradientOperator],
) -> FileVerdict:
    """Measure the lighting of a document. Return a verdict with the checks of the lighting and its figures.

    meshes are the surfaces of the bakes. operators have the settings of the bakes, one for each surface.
    Raises InputError if the file cannot be posed, or asks for work out of proportion to its size.
    """
    return _Measurement(document, options).verdict(meshes, operators)


class _Measurement:
    """The measurement of a document, draw by draw, with what serves more than one draw or method."""

    def __init__(self, document: Document, options: VerifyOptions) -> None:
        self._document, self._options = document, options
        with stage("poses"):
            self._clips, self._unread = _readable_clips(document, options.poses.kind)
        self._done, self._total, self._identity = 0.0, 0, 0.0
        self._tallies = FileTallies()
        self._at_rest: tuple[tuple[int, int, bool], Truths] | None = None
        self._morphed: dict[int, Morphing] = {}
        self._room = MORPHED_BYTES

    def verdict(
        self, meshes: Sequence[Sequence[BakedView]], operators: Sequence[GradientOperator]
    ) -> FileVerdict:
        """Return the verdict; the arguments are those of ``lighting_verdict``."""
        with stage("gradient operator"):
            surfaces = true_surfaces(self._document, meshes, operators)
        with stage("poses"):
            drawn, left_out = draws(self._document, surfaces, self._clips, self._options.poses)
        not_rigid = list(
            dict.fromkeys(n for draw in drawn for n in joints_without_dqs(draw.rest, draw.poses))
        )
        methods = self._options.methods or (("lbs",) if not_rigid else ("lbs", "dqs"))
        reason = without_dqs(not_rigid)
        if "dqs" in methods and not_rigid:
            problem = Notice("not-rigid", f"dual quaternions were asked for: {reason}", self._document.place)
            check = Check("lighting", "failed", (problem,))
            return FileVerdict(self._document.name, (check,), without_dqs=reason)
        self._total = sum(len(draw.poses.clips) for draw in drawn) * len(methods)
        # The figures are checked to be finite.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for method in methods:
                self._tallies.expect(method, drawn)
                for draw in drawn:
                    self._measure(method, draw, again=method != methods[-1])
                self._tallies.sum_up()
            with stage("figures"):
                verdict = self._verdict(drawn, reason if not_rigid else None)
        morphs = morph_count(self._document, [(draw.views[0].source.mesh, draw.poses) for draw in drawn])
        notices = *self._unread, *left_out, *dict.fromkeys(mirrored(drawn))
        return replace(verdict, notices=notices, morphs=morphs)

    def _measure(self, method: str, draw: Draw, *, again: bool) -> None:
        """Measure a draw by a method; ``again``: another method follows."""
        if len(draw.operator.positions) >= MANY_VERTICES:
            give_back_freed_memory()
        morphing = self._morphing(draw, again=again)
        identity = lighting_errors(
            draw.operator,
            draw.rest,
            draw.poses.joint_matrices,
            method,
            lambda add: add(),  # what the tallies return for a block
            count=self._tallies.counting(method, draw),
            options=Options(self._options.cap, self._options.baseline),
            morphing=morphing,
            at_rest=self._truths(draw, morphing),
            advance=self._advance,
        )
        self._identity = max(self._identity, identity)

    def _morphing(self, draw: Draw, *, again: bool) -> Morphing | None:
        """Return the morph targets of a draw. Keep its morphed primitives for the next method if small."""
        key = id(draw)
        if key in self._morphed:
            return self._morphed[key] if again else self._morphed.pop(key)
        morphing = morphing_of(self._document, draw.views, draw.poses)
        size = sum(_morphed_size(rest) for rest in draw.rest) * len(draw.poses.clips)
        if morphing is None or not again or size > self._room:
            return morphing
        self._room -= size
        self._morphed[key] = replace(morphing, kept={})
        return self._morphed[key]

    def _truths(self, draw: Draw, morphing: Morphing | None) -> Truths:
        """Return the data of a mesh at rest. The last ones serve again for the same mesh in as many poses."""
        key = id(draw.operator), len(draw.poses.clips), morphing is None
        if self._at_rest is None or self._at_rest[0] != key:
            self._at_rest = None  # two at a time would take twice the memory
            self._at_rest = key, truths_at_rest(draw.operator, draw.rest, key[1], morphing)
        return self._at_rest[1]

    def _advance(self, poses: float) -> None:
        before, self._done = round(self._done), self._done + poses
        if round(self._done) != before:
            tell_steps(round(self._done), self._total)

    def _verdict(self, drawn: Sequence[Draw], without_dqs: str | None) -> FileVerdict:
        by_truth = {truth: self._tallies.figures(truth) for truth in Truth}
        self._refuse_overflow(by_truth)
        primitives = {truth: self._tallies.figures_of_primitives(truth) for truth in Truth}
        seconds = sum(clip.duration - clip.start for clip in self._clips)
        return FileVerdict(
            self._document.name,
            tuple(self._checks(by_truth, drawn)),
            by_truth[Truth.TANGENTS],
            primitives[Truth.TANGENTS],
            described(self._options.poses, [draw.poses for draw in drawn], seconds),
            without_dqs,
            by_triangles=by_truth[Truth.TRIANGLES],
            primitives_by_triangles=primitives[Truth.TRIANGLES],
        )

    def _refuse_overflow(self, by_truth: Mapping[Truth, Normals]) -> None:
        """Raise InputError if a figure is not finite."""
        found = [
            figures
            for by_method in by_truth.values()
            for lightings in by_method.values()
            for figures in lightings.values()
        ]
        if not all(math.isfinite(figures.mean) and math.isfinite(figures.max) for figures in found):
            raise InputError(
                "its positions, gradients and joint matrices are so large that their products overflow: "
                "scale the model down",
                self._document.place,
            )

    def _checks(self, by_truth: Mapping[Truth, Normals], drawn: Sequence[Draw]) -> Iterator[Check]:
        """Yield the checks of the lighting. One that does not apply is left out."""
        normals = by_truth[Truth.TANGENTS]
        if "lbs" in normals:
            yield identity_check(self._identity, drawn, self._document.place)
        if not normals:
            yield Check("lighting", "skipped", (), "there is no true normal at any vertex in these poses")
        if self._options.limits:
            held = {truth: by_truth[truth] for truth in Truth if self._options.truth in {None, truth}}
            yield limits_check(held, self._options, self._document.place)


def _readable_clips(document: Document, kind: PoseKind) -> tuple[list[Clip], list[Notice]]:
    """Return the clips of a document. Broken ones give a notice, or InputError if their poses are wanted."""
    try:
        return read_clips(document), []
    except InputError as error:
        if kind is PoseKind.ANIMATION:
            advice = "skinbake verify --poses random measures without its clips"
            raise InputError(f"{error.message}; {advice}", error.place) from error
        message = f"its animations are broken, and were not read ({error.message})"
        return [], [Notice("animations-broken", message, document.place)]


def _morphed_size(rest: RestPrimitive) -> int:
    """Return the memory of a primitive in one pose of its morph targets, with the data that truths need."""
    vertices, slots = rest.joints.shape
    return int(vertices * 8 * (4 * 3 + 3 * slots + 8))
