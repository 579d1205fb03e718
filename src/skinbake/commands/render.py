"""``skinbake render``: pictures of a file, baked in memory if it was not baked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skinbake.choices import Truth, Weighting
from skinbake.commands.view import baked_in_memory, sound_views
from skinbake.containment import BESIDE, Bounds
from skinbake.errors import ChoiceError, InputError, Notice, printable
from skinbake.geometry.skinned import Float32Array, Float64Array
from skinbake.gltf.animation import Clip, Skeleton, clip_poses, random_poses, read_clips, read_skeleton
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.json_access import is_number
from skinbake.gltf.output import refuse_own_input
from skinbake.gltf.writing import write_file
from skinbake.lighting.angles import MeasuredBlock, lighting_errors, truths_at_rest
from skinbake.lighting.baked_views import BakedView, whole_surfaces
from skinbake.lighting.measured import rest_surface
from skinbake.lighting.metrics import vertex_areas
from skinbake.lighting.operator import TRUE_CREASE_ANGLE, gradient_operator
from skinbake.lighting.poses import skins_of
from skinbake.render.files import MILLISECONDS, MOVING, encoded
from skinbake.render.studio import Look, Studio, placed
from skinbake.render.subject import CLAY, YAW, Shot, Subject
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.run import Skinning
from skinbake.skinning.surface import Options

SEARCHED = 25
"""The poses of a clip among which the one with the worst standard lighting is chosen."""

MOST_PICTURES = 120
RANDOM_ANGLE = float(np.radians(30.0))
NAMES = {"standard": "approximated", "accurate": "accurate"}


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """The options of ``skinbake render``.

    clip is a name or a number, None for the first. time is in seconds, None for the pose in which standard
    lighting is worst, or, in an animation, for the whole clip. sides are one or two lightings.
    """

    look: Look
    sides: tuple[str, ...] = ("accurate",)
    clip: str | None = None
    time: float | None = None
    turntable: bool = False


@dataclass(frozen=True, slots=True)
class RenderResult:
    """The file, the number of pictures in it, the pose of the first one in words, and notices."""

    data: bytes
    pictures: int
    pose: str
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True, slots=True)
class _Draw:
    """A surface as one skin draws it: its primitives, and the number of the skin's pose set."""

    views: Sequence[BakedView]
    skeleton: Skeleton
    pose_set: int


def render_file(
    source: str, target: str, options: RenderOptions, *, sync: bool = True, bounds: Bounds = BESIDE
) -> RenderResult:
    """Draw a file and write the picture, whole or not at all.

    Raises SkinbakeError; then nothing is written. Raises ChoiceError for a clip that does not exist.
    """
    document = read_document(source, bounds)
    refuse_own_input(document, source, target)
    notices: tuple[Notice, ...] = ()
    views = sound_views(document)
    if not views:
        document, notices = baked_in_memory(document)
        views = sound_views(document)
    if not views:
        raise InputError("nothing in it is baked soundly: run skinbake verify", document.place)
    suffix = Path(target).suffix.lower()
    draws = list(_draws(document, views))
    clip = _clip(document, options.clip)
    times, pose = _times(draws, clip, options, moves=suffix in MOVING)
    posed = [_posed(draw.skeleton, clip, times) for draw in draws]
    subjects = [_subject(document, draw, view) for draw in draws for view in draw.views]
    some = [matrices[:: max(1, len(times) // 6)] for matrices in posed]
    yaws = np.linspace(YAW, YAW + 2 * np.pi, 12) if options.turntable else [YAW]
    camera = placed(list(_positions(draws, some)), list(map(float, yaws)))
    studio = Studio(subjects, camera)
    errors = _errors(draws, posed) if options.look.mode == "error" else None
    shots = _shots(posed, errors, options, len(times))
    pictures = [studio.picture(shot, options.sides, options.look) for shot in shots]
    data = encoded(pictures, suffix)
    write_file([data], target, sync=sync)
    return RenderResult(data, len(pictures), pose, notices)


def _draws(document: Document, views: Sequence[BakedView]) -> Iterator[_Draw]:
    number = 0
    for group in whole_surfaces(document, views):
        for skin in skins_of(document, group[0].source.mesh):
            yield _Draw(group, read_skeleton(document, skin), number)
            number += 1


def _clip(document: Document, asked: str | None) -> Clip | None:
    """Return the clip of a name or number, the first one if none is asked for, None if there is none."""
    clips = read_clips(document)
    if asked is None:
        return next((clip for clip in clips if any(one.path != "weights" for one in clip.channels)), None)
    named = [clip for clip in clips if clip.name == asked]
    if not named and asked.isdecimal() and int(asked) < len(clips):
        named = [clips[int(asked)]]
    if not named:
        listed = ", ".join(clip.name for clip in clips) or "none"
        raise ChoiceError(f"--clip {asked}: the file has no such clip; it has {listed}")
    return named[0]


def _times(
    draws: Sequence[_Draw], clip: Clip | None, options: RenderOptions, *, moves: bool
) -> tuple[Float64Array, str]:
    """Return the time of each picture, and the first pose in words. Raises ChoiceError for another time."""
    _check_time(clip, options.time)
    if clip is None:
        count = MOST_PICTURES // 2 if options.turntable else 1
        return np.zeros(count), "a random pose, because it has no clip"
    if options.time is not None or (not moves and not options.turntable):
        time = options.time
        if time is None:
            searched = _spread(clip, SEARCHED)
            time = float(searched[_worst(draws, [_posed(draw.skeleton, clip, searched) for draw in draws])])
        count = MOST_PICTURES // 2 if options.turntable else 1
        return np.full(count, time), f'clip "{clip.name}" at {time:.2f} s'
    count = max(2, min(MOST_PICTURES, round(1000 * (clip.duration - clip.start) / MILLISECONDS)))
    return np.linspace(clip.start, clip.duration, count, endpoint=False), f'clip "{clip.name}"'


def _check_time(clip: Clip | None, time: float | None) -> None:
    """Raise ChoiceError for a time that no clip has."""
    if time is None:
        return
    if clip is None:
        raise ChoiceError(f"--time {time:g}: the file has no clip that moves joints")
    if not clip.start <= time <= clip.duration:
        raise ChoiceError(
            f'--time {time:g}: clip "{printable(clip.name)}" goes from {clip.start:g} to {clip.duration:g} s'
        )


def _spread(clip: Clip | None, count: int) -> Float64Array:
    return np.zeros(1) if clip is None else np.linspace(clip.start, clip.duration, count)


def _posed(skeleton: Skeleton, clip: Clip | None, times: Float64Array) -> Float64Array:
    """Return joint matrices (P, J, 4, 4)."""
    if clip is None:
        pose = random_poses(skeleton, 1, angle=RANDOM_ANGLE, seed=0)
        return np.repeat(pose, len(times), axis=0)
    return clip_poses(skeleton, clip, times)


def _subject(document: Document, draw: _Draw, view: BakedView) -> Subject:
    materials = document.objects("materials")
    number = view.source.json.get("material")
    material: dict[str, Any] = (
        materials[number] if isinstance(number, int) and number < len(materials) else {}
    )
    rest = rest_surface(view)
    return Subject(
        rest=rest,
        triangles=view.now.triangles,
        pose_set=draw.pose_set,
        base=_base_colour(material),
        is_mirrored=bool((np.linalg.det(draw.skeleton.joint_matrices({}, None, 1)[0, :, :3, :3]) < 0).any()),
        is_double=material.get("doubleSided") is True,
    )


def _base_colour(material: dict[str, Any]) -> tuple[float, float, float]:
    """Return the material's own colour; clay if it has an image, which is not drawn, or no colour."""
    found = material.get("pbrMetallicRoughness")
    if not isinstance(found, dict) or "baseColorTexture" in found:
        return CLAY
    factor = found.get("baseColorFactor")
    if not isinstance(factor, list) or len(factor) < 3 or not all(map(is_number, factor)):
        return CLAY
    return float(factor[0]), float(factor[1]), float(factor[2])


def _positions(draws: Sequence[_Draw], posed: Sequence[Float64Array]) -> Iterator[Float64Array]:
    """Yield the positions (P, V, 3) of each primitive."""
    for draw, matrices in zip(draws, posed, strict=True):
        for view in draw.views:
            rest = rest_surface(view)
            skinning = Skinning.of(rest, matrices, dual_quaternions=False, options=Options())
            every = slice(0, len(matrices)), slice(0, len(rest.positions))
            (found,) = skinning.run((Algorithm.LBS_APPROXIMATED,), *every)
            yield np.stack([np.asarray(component, np.float64) for component in found.position], axis=-1)


def _errors(draws: Sequence[_Draw], posed: Sequence[Float64Array]) -> list[dict[str, Float32Array]]:
    """Return, for each primitive by lighting, errors in degrees and where they are known: (2, P, V)."""
    found: list[dict[str, Float32Array]] = []
    for draw, matrices in zip(draws, posed, strict=True):
        rest = [rest_surface(view) for view in draw.views]
        operator = gradient_operator(
            [view.now for view in draw.views],
            weighting=Weighting.MAX,
            crease_angle_degrees=TRUE_CREASE_ANGLE,
        )
        own = [
            {name: np.zeros((2, len(matrices), len(one.positions)), np.float32) for name in NAMES}
            for one in rest
        ]

        def record(block: MeasuredBlock, own: Any = own) -> None:
            for name, lighting in NAMES.items():
                if block.lighting == lighting:
                    poses = slice(block.pose, block.pose + block.errors.shape[0])
                    rows = slice(block.vertex, block.vertex + block.errors.shape[1])
                    own[block.surface][name][0, poses, rows] = np.where(block.valid, block.errors, 0.0)
                    own[block.surface][name][1, poses, rows] = block.valid

        truths = truths_at_rest(operator, rest, len(matrices), None, (Truth.TRIANGLES,))
        lighting_errors(operator, rest, matrices, "lbs", record, at_rest=truths)
        found += own
    return found


def _worst(draws: Sequence[_Draw], posed: Sequence[Float64Array]) -> int:
    """Return the pose with the largest mean error of standard lighting."""
    errors = _errors(draws, posed)
    views = [view for draw in draws for view in draw.views]
    total = np.zeros(len(posed[0]))
    for view, own in zip(views, errors, strict=True):
        degrees, known = own["standard"]
        total += (degrees * known) @ vertex_areas(view.now.positions, view.now.triangles)
    return int(np.argmax(total))


def _shots(
    posed: Sequence[Float64Array], errors: Sequence[Any] | None, options: RenderOptions, count: int
) -> Iterator[Shot]:
    for pose in range(count):
        turned = 2 * np.pi * pose / count if options.turntable else 0.0
        told = {
            name: tuple((own[name][0, pose], own[name][1, pose]) for own in errors or ()) for name in NAMES
        }
        yield Shot(
            tuple(matrices[pose] for matrices in posed), YAW + turned, told if errors is not None else {}
        )
