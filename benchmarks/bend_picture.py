"""Draw docs/bend.png: a bent tube lit by standard normals, by accurate ones, and the error between.

Usage: python -m benchmarks.bend_picture [OUTPUT.png]

The fixture is baked, its clip is sampled at every key, and the pose with the largest mean error of the
standard normals is drawn. Errors are angles to the true normals of ``skinbake.truth.normals``; the
means printed are weighted by rest area. One rasterisation serves all three panels: they differ in normals
alone.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from skinbake.choices import FrameChoice
from skinbake.commands.bake import bake_document
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.clips import clip_poses, read_clips
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.measure.tally import ErrorSummary
from skinbake.skinning.rest import Algorithm, RestPrimitive
from skinbake.truth.areas import vertex_areas
from skinbake.truth.mesh import normalised_weights
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import rest_frames
from tests.support.replay import replay
from tests.support.whole_fields import angular_errors, reference_normals, rest_frame, summarise

Array = npt.NDArray[np.float64]

REPOSITORY = Path(__file__).resolve().parents[1]
MODEL = REPOSITORY / "fixtures" / "bent_tube.glb"

PANEL = (484, 400)
MARGIN = 14
HEADER = 76
FOOTER = 60
SUPERSAMPLING = 3
# The elbow from its inside, upright: where standard lighting goes wrong most.
TURN, TILT, ROLL = np.radians(15.0), np.radians(10.0), np.radians(45.0)
CENTRE = np.array([-0.25, 1.20, 0.0])
ZOOM = 195.0  # pixels a metre
BACKGROUND = np.array([0.90, 0.91, 0.92])
INSIDE = np.array([0.20, 0.20, 0.22])
CLAY = np.array([0.82, 0.41, 0.26])
INK, GREY = (28, 30, 34), (96, 100, 108)
SCALE_TOP = 30.0
# From nearly white, for no error, through yellow and red to nearly black.
STOPS = np.array(
    [[0.93, 0.94, 0.95], [0.99, 0.85, 0.40], [0.94, 0.45, 0.14], [0.70, 0.08, 0.18], [0.22, 0.02, 0.20]]
)


@dataclass(frozen=True)
class Bend:
    """The tube in one pose: positions and three fields of unit normals, all (V, 3), and triangles (T, 3)."""

    positions: Array
    triangles: npt.NDArray[np.integer]
    standard: Array
    accurate: Array
    errors: Array
    summaries: tuple[ErrorSummary, ErrorSummary]


def strongest_bend() -> Bend:
    """Bake the fixture and pose it where standard lighting is worst."""
    document = bake_document(read_document(str(MODEL))).document
    source = skinned_sources(document)[0]
    primitive = read_primitive(document, source)
    frame = rest_frame(primitive, FrameChoice.AUTO)
    alpha, beta = (
        read_accessor(document, source.attributes[f"_SKINBAKE_{name}_0"], source.place).decoded()
        for name in ("ALPHA", "BETA")
    )
    rest = RestPrimitive(
        positions=primitive.positions,
        normals=primitive.normals,
        tangents=frame.tangents,
        bitangents=frame.bitangents,
        joints=primitive.joints,
        weights=normalised_weights(primitive.weights, primitive.joints),
        alpha=alpha,
        beta=beta,
    )
    (clip,) = read_clips(document)
    poses = clip_poses(read_skeleton(document, 0), clip, np.unique(clip.channels[0].times))
    standard, accurate = (replay(a, rest, poses) for a in (Algorithm.LBS_STANDARD, Algorithm.LBS_ACCURATE))
    frames = rest_frames(
        gradient_operator([primitive]),
        primitive.positions,
        primitive.normals,
        frame.tangents,
        frame.bitangents,
    )
    expected, _ = reference_normals(frames, standard.positions)
    areas = vertex_areas(primitive.positions, primitive.triangles)
    errors = [angular_errors(posed.normals, expected) for posed in (standard, accurate)]
    worst = int(np.argmax(np.average(errors[0], axis=1, weights=areas)))
    summaries = [summarise(error[worst : worst + 1], areas) for error in errors]
    assert summaries[0] is not None and summaries[1] is not None
    return Bend(
        positions=standard.positions[worst],
        triangles=primitive.triangles,
        standard=unit(standard.normals[worst]),
        accurate=unit(accurate.normals[worst]),
        errors=errors[0][worst],
        summaries=(summaries[0], summaries[1]),
    )


def unit(vectors: Array) -> Array:
    """Normalise vectors along the last axis."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def camera() -> Array:
    """Return the rotation (3, 3) from the model to the view: x right, y up, z towards the eye."""
    c, s = np.cos(TURN), np.sin(TURN)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(TILT), np.sin(TILT)
    tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = np.cos(ROLL), np.sin(ROLL)
    return np.asarray(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ tilt @ turn)


def rasterise(
    points: Array, triangles: npt.NDArray[np.integer], width: int, height: int
) -> tuple[Array, Array]:
    """Return per pixel the nearest triangle (H, W), −1 for none, and barycentric coordinates (H, W, 3).

    points (V, 3) in pixels, y downwards, z towards the eye.
    """
    depth = np.full((height, width), -np.inf)
    owner = np.full((height, width), -1)
    where = np.zeros((height, width, 3))
    for number, corners in enumerate(points[triangles]):
        low = np.maximum(np.floor(corners[:, :2].min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(corners[:, :2].max(axis=0)).astype(int) + 1, (width, height))
        (x0, y0), (x1, y1), (x2, y2) = corners[:, :2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0 or (high <= low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        u = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
        v = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
        bary = np.stack([1 - u - v, u, v], axis=-1)
        z = bary @ corners[:, 2]
        box = (slice(low[1], high[1]), slice(low[0], high[0]))
        nearer = (bary >= -1e-9).all(axis=-1) & (z > depth[box])
        depth[box][nearer], owner[box][nearer], where[box][nearer] = z[nearer], number, bary[nearer]
    return owner, where


def shade(normals: Array) -> Array:
    """Light clay (…, 3) by view-space unit normals: a raking key light with a highlight, fill from below."""
    key, fill = unit(np.array([0.5, 0.7, 0.5])), unit(np.array([-0.7, -0.4, 0.4]))
    half = unit(key + np.array([0.0, 0.0, 1.0]))
    diffuse = np.clip(normals @ key, 0, None)[..., None]
    back = np.clip(normals @ fill, 0, None)[..., None]
    gloss = np.clip(normals @ half, 0, None)[..., None] ** 50
    linear = CLAY**2.2 * (0.06 + 1.15 * diffuse) + back * np.array([0.04, 0.06, 0.11]) + 0.5 * gloss
    return np.asarray(np.clip(linear, 0, 1) ** (1 / 2.2))


def heat(degrees: Array) -> Array:
    """Colour angles (…): 0 is the first stop, SCALE_TOP and more the last."""
    at = np.clip(degrees / SCALE_TOP, 0, 1)
    return np.stack([np.interp(at, np.linspace(0, 1, len(STOPS)), stop) for stop in STOPS.T], axis=-1)


def panels(bend: Bend) -> list[Image.Image]:
    """Render the three panels: standard, accurate, error of standard."""
    width, height = (SUPERSAMPLING * side for side in PANEL)
    view = camera()
    seen = (bend.positions - CENTRE) @ view.T
    points = seen * SUPERSAMPLING * ZOOM * [1, -1, 1] + [width / 2, height / 2, 0]
    owner, where = rasterise(points, bend.triangles, width, height)
    covered = owner >= 0
    corners, bary = bend.triangles[owner[covered]], where[covered]
    faces = np.cross(seen[corners[:, 1]] - seen[corners[:, 0]], seen[corners[:, 2]] - seen[corners[:, 0]])
    inside = faces[:, 2] < 0

    def image(colours: Array) -> Image.Image:
        canvas = np.tile(BACKGROUND, (height, width, 1))
        canvas[covered] = np.where(inside[:, None], INSIDE, colours)
        blocks = canvas.reshape(PANEL[1], SUPERSAMPLING, PANEL[0], SUPERSAMPLING, 3).mean(axis=(1, 3))
        return Image.fromarray(np.round(255 * blocks).astype(np.uint8))

    def interpolated(field: Array) -> Array:
        return np.asarray(np.einsum("pc,pc...->p...", bary, field[corners]))

    lit = [shade(unit(interpolated(normals @ view.T))) for normals in (bend.standard, bend.accurate)]
    error = heat(interpolated(bend.errors))
    lambert = 0.72 + 0.28 * unit(interpolated(bend.accurate @ view.T))[:, 2:].clip(0, 1)
    return [image(colours) for colours in (*lit, error * lambert)]


def font(size: int) -> ImageFont.FreeTypeFont:
    """Return Pillow's own font: the same on every machine."""
    found = ImageFont.load_default(size)
    assert isinstance(found, ImageFont.FreeTypeFont), "Pillow was built without FreeType"
    return found


def compose(bend: Bend) -> Image.Image:
    """Put the panels side by side, with titles, figures and the scale."""
    width, height = PANEL
    total = (3 * width + 4 * MARGIN, HEADER + height + FOOTER)
    sheet = Image.new("RGB", total, "white")
    draw = ImageDraw.Draw(sheet)
    standard, accurate = bend.summaries
    captions = [
        (
            "Standard lighting",
            f"normals off by {standard.mean:.1f}° on average, {standard.max:.0f}° at worst",
        ),
        (
            "Accurate lighting",
            f"normals off by {accurate.mean:.1f}° on average, {accurate.max:.0f}° at worst",
        ),
        ("Error of standard lighting", "angle between its normals and the surface's"),
    ]
    for number, (panel, (title, line)) in enumerate(zip(panels(bend), captions, strict=True)):
        left = MARGIN + number * (width + MARGIN)
        sheet.paste(panel, (left, HEADER))
        draw.text((left + width / 2, 30), title, INK, font(26), "mm")
        draw.text((left + width / 2, 58), line, GREY, font(17), "mm")
    left, top = 2 * width + 3 * MARGIN + 60, HEADER + height + 8
    length = width - 120
    for column in range(length):
        colour = heat(np.array(SCALE_TOP * column / (length - 1)))
        draw.line([(left + column, top), (left + column, top + 14)], tuple(round(255 * c) for c in colour))
    for degrees in range(0, int(SCALE_TOP) + 1, 5):
        x = left + (length - 1) * degrees / SCALE_TOP
        draw.line([(x, top + 14), (x, top + 19)], GREY)
        label = f"{degrees}°+" if degrees == SCALE_TOP else f"{degrees}°"
        draw.text((x, top + 31), label, GREY, font(16), "mm")
    return sheet


def main() -> None:
    """Draw the picture and print its figures."""
    bend = strongest_bend()
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else REPOSITORY / "docs" / "bend.png"
    target.parent.mkdir(exist_ok=True)
    compose(bend).save(target, optimize=True)
    for name, summary in zip(("standard", "accurate"), bend.summaries, strict=True):
        print(f"{name}: mean {summary.mean:.2f}°, p95 {summary.p95:.2f}°, max {summary.max:.2f}°")
    print(f"{target}: {target.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
