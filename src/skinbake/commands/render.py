"""``skinbake render``: pictures of a file, baked in memory if it was not baked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from skinbake.choices import Frame
from skinbake.commands.posed_scene import (
    LIGHTINGS,
    Attachment,
    Draw,
    PosedDraw,
    attachments,
    baked_in_memory,
    claim_draws,
    lighting_errors_of,
    posed_attachment,
    posed_draw,
    posed_positions,
    posed_primitives,
    shown_draws,
    sound_correctives,
    tell_unplaced,
)
from skinbake.commands.where_it_shows import followed, in_degrees, in_words, telling_pose
from skinbake.errors import ChoiceError, InputError, Notice, SkinbakeError
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.files.writing import write_file
from skinbake.freshness.baked_views import BakedView, rest_primitive, sound_views
from skinbake.geometry.skinned import Float64Array, FloatArray, IntArray
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.animation import RANDOM, Clip, Skeleton, random_clip, read_clips, rest_pose
from skinbake.gltf.budget import LAYERS, Cost
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.output import refuse_own_input
from skinbake.gltf.primitives import PrimitiveSource, reason_to_skip, skinned_sources
from skinbake.render.materials import CLAY, WHITE, Material, Materials
from skinbake.render.pictures import MILLISECONDS, MOVING, captioned, encoded
from skinbake.render.studio import Look, Picture, Studio, placed, require_packages
from skinbake.render.subject import YAW, Shot, Subject
from skinbake.render.thumbnail import Posed, thumbnail
from skinbake.skinning.algorithms import Algorithm
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.wording import counted

MOST = 1e15
"""The largest coordinate of a picture: squares of lengths then stay floats, as on the page."""

MOST_INFLUENCES = 64
"""The most influences of a vertex that are drawn. Drivers compile a shader of 256 for a minute."""

NEAREST = 1e-6
"""The least depth of a corner, in units of the scene. What lies behind the camera counts as far beside it."""

MOST_PICTURES = 120
NEAR = 1.5
"""What hangs on a character lies within so many radii of the box around it."""

CLOSE = 1.3
"""What is seen close up, in radii of the place, as on the page."""


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """The options of ``skinbake render``.

    clip is a name or a number, None for the one in which the bake shows most. time is in seconds, None for
    the pose in which it does, or, in an animation, for the whole clip. sides are one or two
    lightings, None for that which the file's bake gives. in_clay draws no images and no colours. is_close:
    the camera looks at the place where the bake shows most, and follows it.
    """

    look: Look
    sides: tuple[str | None, ...] = (None,)
    clip: str | None = None
    time: float | None = None
    turntable: bool = False
    in_clay: bool = False
    is_close: bool = False


@dataclass(frozen=True, slots=True)
class RenderResult:
    """The file, the number of pictures in it, the pose of the first one in words, and notices.

    was_baked: the file held a bake already. If not, it was baked in memory.
    """

    data: bytes
    pictures: int
    pose: str
    was_baked: bool
    notices: tuple[Notice, ...] = ()


def render_file(
    source: str, target: str, options: RenderOptions, *, sync: bool = True, bounds: Bounds = BESIDE
) -> RenderResult:
    """Draw a file and write the picture, whole or not at all.

    Raises SkinbakeError; then nothing is written. Raises ChoiceError for a clip that does not exist.
    """
    document = read_document(source, bounds)
    refuse_own_input(document, source, target)
    views = sound_views(document)
    correctives = None if views else sound_correctives(document)
    own = "corrected" if correctives else "accurate"
    sides = [side or own for side in options.sides]
    if "corrected" in sides and not correctives:
        raise ChoiceError("lighting", "corrected", reason=(": the file has no correctives",))
    was_baked = bool(views) or correctives is not None
    if not views:
        document = baked_in_memory(document)
        views = sound_views(document)
    if not views:
        raise InputError("nothing in it is baked soundly: run skinbake verify", document.place)
    _check_influences(views)
    suffix = Path(target).suffix.lower()
    require_packages()
    # What is too large is refused, and what is not a number is not drawn.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        draws = list(shown_draws(document, views, correctives))
        pictures, pose = _pictures(document, draws, sides, own, options, moves=suffix in MOVING)
    data = encoded(pictures, suffix)
    write_file([data], target, sync=sync)
    for primitive in skinned_sources(document):
        reason = reason_to_skip(document, primitive, generate_normals=True)
        if reason is not None and reason.code == "unlit":  # no picture has it
            document.notices.tell(reason)
    return RenderResult(data, len(pictures), pose, was_baked, tuple(document.notices))


def _check_influences(views: Sequence[BakedView]) -> None:
    """Raise InputError for more influences than a shader is compiled for in some seconds."""
    for view in views:
        count = view.now.joints.shape[1]
        if count > MOST_INFLUENCES:
            raise InputError(
                f"it has up to {count} influences for a vertex, and a picture draws {MOST_INFLUENCES}: "
                "bake it with --limit-influences 8",
                view.source.place,
            )


def _pictures(
    document: Document,
    draws: Sequence[Draw],
    sides: Sequence[str],
    own: str,
    options: RenderOptions,
    *,
    moves: bool,
) -> tuple[list[Picture], str]:
    """Return the pictures, and the first pose in words; tell what is missing in them."""
    clip, moment, spot = telling_pose(document, draws, options.clip, options.time, is_close=options.is_close)
    times, pose = _times(clip, moment, options, moves=moves)
    if spot is not None:
        pose = f"{pose}, close up: {in_words(spot)}"
    pixels = options.look.width * options.look.height
    work = (Cost.SAMPLED_PIXEL + Cost.DRAWN_PIXEL * len(times)) * pixels
    document.budget.claim(work, f"drawing {counted(len(times), 'picture')}", document.place)
    claim_draws(document, draws, [clip], len(times))
    posed = [posed_draw(document, draw, clip, times) for draw in draws]
    materials = Materials(document)
    is_lit = options.look.mode == "shaded"
    in_clay = options.in_clay or not is_lit
    rigid = attachments(document)
    held = [posed_attachment(document, one, clip, times) for one in rigid]
    parts: list[tuple[int, BakedView | Attachment, Skeleton]] = [
        (number, view, draw.skeleton) for number, draw in enumerate(draws) for view in draw.views
    ]
    parts += [(number, one, one.skeleton) for number, one in enumerate(rigid, len(draws))]
    subjects = [
        _subject(
            document, number, drawn, skeleton, materials.of(drawn.source.material, in_clay, is_lit=is_lit)
        )
        for number, drawn, skeleton in parts
    ]
    some = [
        part
        for draw, one in zip(draws, posed, strict=True)
        for part in posed_positions(draw, one.every(max(1, len(times) // 6)))
    ]
    if not all((np.abs(part) < MOST).all() for part in some):
        raise InputError("its positions are too large for a renderer: scale the model down", document.place)
    some += _hanging(some, rigid, [matrices[:: max(1, len(times) // 6)] for matrices in held])
    yaw = YAW if spot is None else float(np.arctan2(spot.towards[0], spot.towards[2]))
    yaws = list(map(float, np.linspace(yaw, yaw + 2 * np.pi, 12))) if options.turntable else [yaw]
    camera, words = placed(some, yaws), list(sides)
    if spot is not None:
        ball = spot.middle + CLOSE * spot.radius * np.concatenate([np.eye(3), -np.eye(3)])
        pitch = float(np.arcsin(spot.towards[1]))
        camera = replace(camera, middle=spot.middle, points=ball, pitch=pitch)
        if (times == spot.time).all():
            figures = {"standard": spot.standard, own: spot.baked}
            words = [f"{side}, {in_degrees(figures[side])}" for side in sides]
        # The camera stays with the place, which is the same as to move the scene.
        (at,) = followed(
            spot, draws[spot.draw], posed_draw(document, draws[spot.draw], clip, np.array([spot.time]))
        )
        moves_by = np.zeros((len(times), 1, 4, 4))
        moves_by[..., :3, 3] = [[at - now] for now in followed(spot, draws[spot.draw], posed[spot.draw])]
        posed = [replace(one, matrices=one.matrices + moves_by) for one in posed]
        held = [matrices + moves_by for matrices in held]
    _refuse_layers(
        document,
        draws,
        posed,
        rigid,
        held,
        [1 + one.material.is_blended for one in subjects],
        camera.projected(yaws[0], options.look.width / options.look.height),
    )
    studio = Studio(subjects, camera)
    errors = lighting_errors_of(draws, posed) if options.look.mode == "error" else None
    if errors:  # nothing is known of what has no skin
        unknown = (np.zeros((2, len(times), len(one.rest.positions)), np.float32) for one in rigid)
        errors += [dict.fromkeys(LIGHTINGS, nothing) for nothing in unknown]
    shots = (
        replace(shot, matrices=(*shot.matrices, *(matrices[number] for matrices in held)))
        for number, shot in enumerate(_shots(draws, posed, errors, options, yaws[0], len(times)))
    )
    pictures = [captioned(studio.picture(shot, sides, options.look), words, options.look) for shot in shots]
    materials.tell_missing()
    for view in () if in_clay else (view for draw in draws for view in draw.views):
        tell_unplaced(document, view, "picture")
    return pictures, pose


def _refuse_layers(
    document: Document,
    draws: Sequence[Draw],
    posed: Sequence[PosedDraw],
    rigid: Sequence[Attachment],
    held: Sequence[Float64Array],
    times: Sequence[int],
    projected: Float64Array,
) -> None:
    """Raise InputError if triangles cover the first picture far more often than those of a character.

    times: how often each primitive is drawn; what blends, twice. projected (4, 4) leads to the screen. What
    lies beside the picture counts as if it were at its edge.
    """
    found: list[tuple[Float64Array, IntArray]] = []
    for draw, one in zip(draws, posed, strict=True):
        first = islice(posed_positions(draw, one.every(len(one.matrices))), len(draw.views))
        found += [(part[0], view.now.triangles) for part, view in zip(first, draw.views, strict=True)]
    found += [
        (one.positions(matrices[0, 0]), one.triangles) for one, matrices in zip(rigid, held, strict=True)
    ]
    layers = 0.0
    count = sum(len(triangles) for _, triangles in found)
    what = f"the area of {counted(count, 'triangle')}"
    document.budget.claim(Cost.COVERING_TRIANGLE * count, what, document.place, passing=True)
    for (positions, triangles), drawn in zip(found, times, strict=True):
        at = positions @ projected[:, :3].T + projected[:, 3]
        corners = np.clip(at[:, :2] / np.maximum(at[:, 3:], NEAREST), -1.0, 1.0)[triangles]
        (x, y), (u, v) = np.moveaxis(corners[:, 1:] - corners[:, :1], 0, -1)
        layers += drawn * float(np.abs(x * v - y * u).sum()) / 2 / 4
    most = LAYERS.most(document.budget.backed)
    if layers > most:
        raise InputError(
            f"its triangles would cover the picture {layers:,.0f} times, one over the other, and a file of "
            f"its size may at most {most:,} times: look at it with skinbake view",
            document.place,
        )


def _hanging(
    shown: Sequence[Float64Array], rigid: Sequence[Attachment], held: Sequence[Float64Array]
) -> Iterator[Float64Array]:
    """Yield positions of what hangs on the character, which is in the picture with it; a stage is not."""
    every = np.concatenate([part.reshape(-1, 3) for part in shown])
    low, high = every.min(axis=0), every.max(axis=0)
    for one, matrices in zip(rigid, held, strict=True):
        points = np.stack([one.positions(matrix) for (matrix,) in matrices])
        if (np.linalg.norm(points - (low + high) / 2, axis=-1) < NEAR * np.linalg.norm(high - low) / 2).all():
            yield points


def small_picture(document: Document) -> bytes | None:
    """Return a PNG of a baked file in the middle of its first clip; None if nothing of it can be drawn.

    It needs no device and no extra.
    """
    try:
        draws = list(shown_draws(document, sound_views(document)))
        clip = next(iter(read_clips(document)), None) or random_clip(document)
        times = np.array([(clip.start + clip.duration) / 2])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # only numbers are drawn
            found = [part for draw in draws for part in _still(draw, posed_draw(document, draw, clip, times))]
    except SkinbakeError:
        return None
    sound = [part.positions[(np.abs(part.positions) < MOST).all(axis=1)] for part in found]
    if not sum(map(len, sound)):
        return None
    return thumbnail(found, placed(sound, [YAW]))


def _still(draw: Draw, posed: PosedDraw) -> Iterator[Posed]:
    """Yield the primitives of a draw in its only pose, with accurate normals."""
    for view, (rest, matrices) in zip(draw.views, posed_primitives(draw, posed), strict=True):
        skinning = Skinning.of(rest, matrices, dual_quaternions=False, options=Options())
        (found,) = skinning.run((Algorithm.LBS_ACCURATE,), slice(0, 1), slice(0, len(rest.positions)))
        positions, normals = (
            np.stack([np.asarray(axis, np.float64)[0] for axis in vector], axis=-1)
            for vector in (found.position, found.normal)
        )
        yield Posed(positions, normals, view.now.triangles)


def _times(clip: Clip, moment: float, options: RenderOptions, *, moves: bool) -> tuple[Float64Array, str]:
    """Return the time of each picture, and the first pose in words."""
    if clip.number != RANDOM and options.time is None and (moves or options.turntable):
        count = max(2, min(MOST_PICTURES, round(1000 * (clip.duration - clip.start) / MILLISECONDS)))
        return np.linspace(clip.start, clip.duration, count, endpoint=False), f'clip "{clip.name}"'
    count = MOST_PICTURES // 2 if options.turntable else 1
    at = "random poses (no clip moves it)" if clip.number == RANDOM else f'clip "{clip.name}"'
    return np.full(count, moment), f"{at} at {moment:.2f} s"


def _subject(
    document: Document,
    number: int,
    drawn: BakedView | Attachment,
    skeleton: Skeleton,
    material: Material,
) -> Subject:
    """Return what is drawn of a primitive, with the joint matrices of a number."""
    at_rest = rest_pose(skeleton)[0, :, :3, :3]
    if isinstance(drawn, Attachment):
        rest, triangles, tangents, ours, frame = drawn.rest, drawn.triangles, drawn.tangents, set[str](), None
    else:
        rest, triangles, tangents = rest_primitive(drawn), drawn.now.triangles, drawn.now.tangents
        ours = {
            *drawn.metadata["alpha"],
            *drawn.metadata["beta"],
        }  # they may be stored as such sets
        frame = drawn.metadata["frame"]
    count = len(rest.positions)
    # the texture coordinates (V, 2) of each image that lies on a set which the primitive has
    texcoords: dict[str, FloatArray] = {}
    for use, placement in material.placements.items():
        name = f"TEXCOORD_{placement.texcoord}"
        own = None if name in ours else _attribute(document, drawn.source, name, (2,), count)
        if own is not None:
            texcoords[use] = placement.placed(own)
    material = material.with_images(texcoords)
    colours = None if material.is_plain else _attribute(document, drawn.source, "COLOR_0", (3, 4), count)
    if colours is not None and material.base == CLAY:
        material = replace(material, base=WHITE)
    return Subject(
        rest=rest,
        triangles=triangles,
        pose_set=number,
        material=material,
        texcoords=texcoords,
        colours=colours,
        is_mirrored=bool((np.linalg.det(at_rest) < 0).any()),
        tangents=tangents,
        in_their_frame=frame == Frame.TANGENT,
        is_rigid=frame is None,
    )


def _attribute(
    document: Document, source: PrimitiveSource, name: str, widths: tuple[int, ...], count: int
) -> FloatArray | None:
    """Return the values of an attribute that is only drawn (V, the largest width); None if it has no such."""
    number = document.asset.accessor_of(source, name)
    if number is None:
        return None
    found = read_accessor(document, number, source.place).decoded()
    if found.shape[0] != count or found.shape[1] not in widths:
        return None
    sound = np.nan_to_num(found.astype(np.float64), posinf=0.0, neginf=0.0)
    return np.pad(sound, ((0, 0), (0, widths[-1] - found.shape[1])), constant_values=1.0)


def _shots(
    draws: Sequence[Draw],
    posed: Sequence[PosedDraw],
    errors: Sequence[Any] | None,
    options: RenderOptions,
    yaw: float,
    count: int,
) -> Iterator[Shot]:
    for pose in range(count):
        turned = 2 * np.pi * pose / count if options.turntable else 0.0
        told = {
            name: tuple((own[name][0, pose], own[name][1, pose]) for own in errors or ())
            for name in (errors[0] if errors else ())
        }
        yield Shot(
            tuple(one.matrices[pose] for one in posed),
            yaw + turned,
            told,
            _morphed(draws, posed, pose),
        )


def _morphed(
    draws: Sequence[Draw], posed: Sequence[PosedDraw], pose: int
) -> dict[str, dict[int, RestPrimitive]]:
    """Return the primitives that targets move in a pose, by lighting and by their number among all."""
    found: dict[str, dict[int, RestPrimitive]] = {"standard": {}, "accurate": {}, "corrected": {}}
    first = 0
    for draw, one in zip(draws, posed, strict=True):
        standard = draw.rest
        if one.morphing is not None:
            standard = one.morphing.standard(draw.rest, pose)
            for lighting in ("standard", "corrected"):
                found[lighting].update(enumerate(standard, first))
            found["accurate"].update(enumerate(one.morphing.accurate(draw.rest, pose), first))
        if one.corrections is not None:
            played = zip(standard, one.corrections.targets, one.corrections.weights, strict=True)
            for number, (primitive, targets, weights) in enumerate(played, first):
                change = np.einsum("k,kvi->vi", weights[pose], targets)
                found["corrected"][number] = replace(primitive, normals=primitive.normals + change)
        first += len(draw.rest)
    return found
