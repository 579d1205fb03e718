"""``skinbake render``: pictures of a file, baked in memory if it was not baked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skinbake.choices import Frame
from skinbake.commands.shown import baked_in_memory, followed, tell_unplaced, telling_pose
from skinbake.errors import ChoiceError, InputError, Notice, SkinbakeError
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.files.writing import write_file
from skinbake.freshness.baked_views import BakedView, sound_views
from skinbake.freshness.corrective_freshness import PlayedCorrectives
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, IntArray
from skinbake.geometry.triangles import smooth_normals
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import LAYERS, Cost
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.clips import RANDOM, Clip
from skinbake.gltf.reading.meshes import read_primitive, reason_to_skip, skinned_sources
from skinbake.gltf.reading.skins import Skeleton, rest_pose
from skinbake.gltf.writing.output import refuse_own_input
from skinbake.measure.draws import Draw
from skinbake.measure.scene import LIGHTINGS, Attachment, Scene, attachments, claim_draws, errors_of
from skinbake.render.materials import CLAY, WHITE, Materials
from skinbake.render.materials import placed as placed_by
from skinbake.render.pictures import MILLISECONDS, MOVING, captioned, encoded
from skinbake.render.studio import Look, Picture, Studio, placed, require_packages
from skinbake.render.subject import YAW, Camera, Shot, Subject
from skinbake.render.thumbnail import Posed, thumbnails
from skinbake.report.verify import Spot, Spots, in_degrees
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
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

CLOSE, KNOWN = 1.3, 0.1
"""What is seen close up, in radii of the place, as on the page; and the least of it, in sizes of the figure.

From nearer nobody recognises the place.
"""


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
    correctives = None if views else PlayedCorrectives.sound(document)
    own = "corrected" if correctives else "accurate"
    sides = [side or own for side in options.sides]
    if "corrected" in sides and not correctives:
        raise ChoiceError("lighting", "corrected", reason=(": the file has no correctives",))
    reasons = [reason_to_skip(document, one, generate_normals=True) for one in skinned_sources(document)]
    is_unlit = None not in reasons and any(one is not None and one.code == "unlit" for one in reasons)
    was_baked = bool(views) or correctives is not None or is_unlit
    if not views and not is_unlit:
        document = baked_in_memory(document)
        views = sound_views(document)
        if not views:
            raise InputError("nothing in it is baked soundly: run skinbake verify", document.place)
    unlit = _unlit_views(document)
    skipped = "limit them in the source, because bake skips what is unlit"
    for some, remedy in ((views, "bake it with --limit-influences 8"), (unlit, skipped)):
        for view in some:
            count = view.now.joints.shape[1]
            if count > MOST_INFLUENCES:  # a shader would be compiled for long
                raise InputError(
                    f"it has up to {count} influences for a vertex, and a picture draws {MOST_INFLUENCES}: "
                    f"{remedy}",
                    view.source.place,
                )
    suffix = Path(target).suffix.lower()
    require_packages()
    # What is too large is refused, and what is not a number is not drawn.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        scene = Scene(document, views, correctives)
        pictures, pose = _pictures(scene, unlit, sides, own, options, moves=suffix in MOVING)
    data = encoded(pictures, suffix)
    write_file([data], target, sync=sync)
    return RenderResult(data, len(pictures), pose, was_baked, tuple(document.notices))


def _unlit_views(document: Document) -> list[BakedView]:
    """Return the skinned primitives that no light reaches, which look alike by any lighting."""
    found = []
    for source in skinned_sources(document):
        reason = reason_to_skip(document, source, generate_normals=True)
        if reason is None or reason.code != "unlit":
            continue
        now = read_primitive(document, source)
        count = len(now.positions)
        document.budget.claim(Cost.DRAWN_VERTEX * count, "a mesh without light", source.place)
        if not len(now.normals):
            now = replace(now, normals=smooth_normals(now.positions, now.triangles, np.arange(count)))
        found.append(BakedView.unbaked(source, now))
    return found


def _pictures(
    scene: Scene,
    unlit: Sequence[BakedView],
    sides: Sequence[str],
    own: str,
    options: RenderOptions,
    *,
    moves: bool,
) -> tuple[list[Picture], str]:
    """Return the pictures, and the first pose in words; tell what is missing in them."""
    document = scene.document
    draws = [*scene.shown(), *(Scene(document, unlit).shown() if unlit else ())]
    clip, moment, spot = telling_pose(scene, options.clip, options.time, is_close=options.is_close)
    times, pose = _times(clip, moment, options, moves=moves)
    if spot is not None:
        pose = f"{pose}, close up on {spot.joint}: {spot.words}"
    pixels = options.look.width * options.look.height
    work = (Cost.SAMPLED_PIXEL + Cost.DRAWN_PIXEL * len(times)) * pixels
    document.budget.claim(work, f"drawing {counted(len(times), 'picture')}", document.place)
    claim_draws(document, draws, [clip], len(times))
    posed = [draw.at(clip, times) for draw in draws]
    rigid = [one.at(document, clip, times) for one in attachments(document)]
    # What is drawn of each primitive: those with skins come first.
    materials = Materials(document)
    is_lit = options.look.mode == "shaded"
    in_clay = options.in_clay or not is_lit
    subjects = _subjects(document, draws, rigid, materials, in_clay=in_clay, is_lit=is_lit)
    # The camera sees the character in some of the poses, and what hangs on it: a stage does not.
    step = max(1, len(times) // 6)
    some = [part for draw in posed for part in draw.positions(step)]
    if not all((np.abs(part) < MOST).all() for part in some):
        raise InputError("its positions are too large for a renderer: scale the model down", document.place)
    every = np.concatenate([part.reshape(-1, 3) for part in some])
    low, high = every.min(axis=0), every.max(axis=0)
    for one in rigid:
        points = np.stack([one.positions(pose) for pose in range(0, len(times), step)])
        if (np.linalg.norm(points - (low + high) / 2, axis=-1) < NEAR * np.linalg.norm(high - low) / 2).all():
            some.append(points)
    yaw = YAW if spot is None else float(np.arctan2(spot.towards[0], spot.towards[2]))
    yaws = list(map(float, np.linspace(yaw, yaw + 2 * np.pi, 12))) if options.turntable else [yaw]
    camera, words = placed(some, yaws), list(sides)
    if spot is not None:
        (at,) = followed(spot, [draw.at(clip, np.array([moment])) for draw in draws])
        camera = _close_to(spot, at, camera)
        if (times == spot.time).all():
            figures = {"standard": spot.standard, own: spot.baked}
            words = [f"{side}, {in_degrees(figures[side])}" for side in sides]
        # The camera stays with the place, which is the same as to move the scene.
        moves_by = np.zeros((len(times), 1, 4, 4))
        moves_by[..., :3, 3] = [[at - now] for now in followed(spot, posed)]
        posed = [draw.moved(moves_by) for draw in posed]
        rigid = [replace(one, matrices=one.matrices + moves_by) for one in rigid]
    layers = [1 + len(one.material.ranges[1]) for one in subjects]
    projected = camera.projected(yaws[0], options.look.width / options.look.height)
    _refuse_layers(document, posed, rigid, layers, projected)
    studio = Studio(subjects, camera)
    shots = _shots(posed, rigid, options, yaws[0])
    pictures = [captioned(studio.picture(shot, sides, options.look), words, options.look) for shot in shots]
    materials.tell_missing()
    for view in () if in_clay else (view for draw in draws for view in draw.surface.views):
        tell_unplaced(document, view, "picture")
    return pictures, pose


def _close_to(spot: Spot, middle: Float64Array, camera: Camera) -> Camera:
    """Return the camera that looks at a place from close by."""
    size = float(np.linalg.norm(np.ptp(camera.points, axis=0)))
    ball = middle + max(CLOSE * spot.radius, KNOWN * size) * np.concatenate([np.eye(3), -np.eye(3)])
    return replace(camera, middle=middle, points=ball, pitch=float(np.arcsin(spot.towards[1])))


def _refuse_layers(
    document: Document,
    draws: Sequence[Draw],
    rigid: Sequence[Attachment],
    times: Sequence[int],
    projected: Float64Array,
) -> None:
    """Raise InputError if triangles cover the first picture far more often than the triangles of a character.

    times: how often each primitive is drawn; what blends, twice. projected (4, 4) leads to the screen. What
    lies beside the picture counts as if it were at its edge.
    """
    found: list[tuple[Float64Array, IntArray]] = []
    for draw in draws:
        first = draw.positions(len(draw.matrices))
        views = draw.surface.views
        found += [(part[0], view.now.triangles) for part, view in zip(first, views, strict=True)]
    found += [(one.positions(0), one.triangles) for one in rigid]
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


def small_pictures(
    document: Document, corrected: Document | None = None, known: Spots | None = None
) -> list[bytes]:
    """Return PNGs of a baked file in clay: the whole figure, then the place where the bake shows most.

    Each comes by standard lighting and by that of the bake, or of the correctives of ``corrected``, in the
    pose that shows most; known are the places, if they were measured. There is no place if the bake shows
    nowhere, and no picture if nothing can be drawn.
    They need no device and no extra: the replay lights each vertex, and normals are interpolated as on a GPU.
    """
    try:
        correctives = PlayedCorrectives(corrected) if corrected else None
        scene = Scene(document, sound_views(document), correctives)
        if not (draws := scene.shown()):
            return []
        unlit = _unlit_views(document)
        draws += Scene(document, unlit).shown() if unlit else []
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # only numbers are drawn
            try:
                clip, moment, spot = telling_pose(scene, None, None, is_close=True, known=known)
            except InputError:
                clip, moment, spot = telling_pose(scene, None, None, known=known)
            posed_draws = [draw.at(clip, np.array([moment])) for draw in draws]
            found = [one for draw in posed_draws for one in _in_clay(draw)]
            middle = next(followed(spot, posed_draws), None) if spot else None
            for one in attachments(document):
                posed = one.at(document, clip, np.array([moment]))
                normals = one.rest.normals @ np.linalg.pinv(posed.matrices[0, 0, :3, :3])
                found.append(Posed(posed.positions(0), np.stack([normals, normals]), one.triangles))
    except SkinbakeError:
        return []
    sound = [part.positions[(np.abs(part.positions) < MOST).all(axis=1)] for part in found]
    if not sum(map(len, sound)):
        return []
    if spot is None or middle is None:
        return thumbnails(found, placed(sound, [YAW]))
    camera = placed(sound, [float(np.arctan2(spot.towards[0], spot.towards[2]))])
    return [*thumbnails(found, camera), *thumbnails(found, _close_to(spot, middle, camera))]


def _in_clay(draw: Draw) -> Iterator[Posed]:
    """Yield each primitive of a draw in its first pose, by standard lighting and by the bake's."""
    own, how = "accurate", Algorithm.LBS_ACCURATE
    if draw.corrections is not None:
        own, how = "corrected", Algorithm.LBS_STANDARD
    found, rest = draw.by_lighting(0), draw.surface.rest
    both = [found.get(name, rest) for name in ("standard", own)]
    turned = (np.linalg.det(rest_pose(draw.skeleton)[0, :, :3, :3]) < 0).any()
    for view, *pair in zip(draw.surface.views, *both, strict=True):
        lit = []
        for one, algorithm in zip(pair, (Algorithm.LBS_STANDARD, how), strict=True):
            skinning = Skinning.of(one, draw.matrices, dual_quaternions=False, options=Options())
            lit += skinning.run((algorithm,), slice(0, 1), slice(0, len(one.positions)))
        positions, *normals = (
            np.stack([np.asarray(axis, np.float64)[0] for axis in vector], axis=-1)
            for vector in (lit[0].position, *(one.normal for one in lit))
        )
        triangles = view.now.triangles[:, ::-1] if turned else view.now.triangles
        yield Posed(positions, np.stack(normals), triangles)


def _times(clip: Clip, moment: float, options: RenderOptions, *, moves: bool) -> tuple[Float64Array, str]:
    """Return the time of each picture, and the first pose in words."""
    if clip.number != RANDOM and options.time is None and (moves or options.turntable):
        count = max(2, min(MOST_PICTURES, round(1000 * (clip.duration - clip.start) / MILLISECONDS)))
        return np.linspace(clip.start, clip.duration, count, endpoint=False), f'clip "{clip.name}"'
    count = MOST_PICTURES // 2 if options.turntable else 1
    at = "random poses (no clip moves it)" if clip.number == RANDOM else f'clip "{clip.name}"'
    return np.full(count, moment), f"{at} at {moment:.2f} s"


def _subjects(
    document: Document,
    draws: Sequence[Draw],
    rigid: Sequence[Attachment],
    materials: Materials,
    *,
    in_clay: bool,
    is_lit: bool,
) -> list[Subject]:
    """Return what is drawn of each primitive, with the number of its draw or attachment."""
    parts: list[tuple[int, Skeleton, RestPrimitive, BakedView | Attachment]] = [
        (number, draw.skeleton, *part)
        for number, draw in enumerate(draws)
        for part in zip(draw.surface.rest, draw.surface.views, strict=True)
    ]
    parts += [(number, one.skeleton, one.rest, one) for number, one in enumerate(rigid, len(draws))]
    found = []
    for number, skeleton, rest, drawn in parts:
        source, frame, ours = drawn.source, None, set[str]()
        triangles, tangents = (
            (drawn.triangles, drawn.tangents)
            if isinstance(drawn, Attachment)
            else (drawn.now.triangles, drawn.now.tangents)
        )
        if isinstance(drawn, BakedView):
            frame = drawn.note.frame
            ours = {*drawn.note.alpha, *drawn.note.beta}  # they may be stored as such sets
        material = materials.of(source.material, in_clay, is_lit=is_lit)
        # The texture coordinates (V, 2) of each image that lies on a set which the primitive has.
        count, texcoords = len(rest.positions), dict[str, FloatArray]()
        for use, texture in material.textures.items():
            name = f"TEXCOORD_{texture.texcoord}"
            own = None if name in ours else _attribute(document, source, name, (2,), count)
            if own is not None:
                texcoords[use] = placed_by(texture, own)
        material = material.with_images(texcoords)
        colours = None if material.is_plain else _attribute(document, source, "COLOR_0", (3, 4), count)
        if colours is not None and material.base == CLAY:
            material = replace(material, base=WHITE)
        at_rest = rest_pose(skeleton)[0, :, :3, :3]
        found.append(
            Subject(
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
        )
    return found


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
    draws: Sequence[Draw], rigid: Sequence[Attachment], options: RenderOptions, yaw: float
) -> Iterator[Shot]:
    """Yield a shot of each pose, with the errors of each primitive by lighting if they are shown."""
    count = len(draws[0].matrices)
    errors: list[dict[str, Float32Array]] = []
    if options.look.mode == "error":
        errors = [one for draw in draws for one in errors_of(draw)]
        for one in rigid:  # nothing is known of what has no skin
            nothing = np.zeros((2, count, len(one.rest.positions)), np.float32)
            errors.append(dict.fromkeys(LIGHTINGS, nothing))
    starts = np.cumsum([0, *(len(draw.surface.rest) for draw in draws)]).tolist()
    for pose in range(count):
        told = {
            name: tuple((own[name][0, pose], own[name][1, pose]) for own in errors)
            for name in (errors[0] if errors else ())
        }
        # What targets move in the pose, by lighting and by the number of the primitive among all.
        moved: dict[str, dict[int, RestPrimitive]] = {name: {} for name in LIGHTINGS}
        for draw, first in zip(draws, starts, strict=False):
            for lighting, primitives in draw.by_lighting(pose).items():
                moved[lighting].update(enumerate(primitives, first))
        matrices = *(one.matrices[pose] for one in draws), *(one.matrices[pose] for one in rigid)
        turned = 2 * np.pi * pose / count if options.turntable else 0.0
        yield Shot(matrices, yaw + turned, told, moved)
