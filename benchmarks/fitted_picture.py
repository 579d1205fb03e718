"""Draw docs/fitted.png: the error of one coarse model's normals, standard, with the gradients, and fitted.

Usage: python -m benchmarks.fitted_picture [MODEL] [--output FILE]

The model is baked with ``--gradients surface`` and ``rig``, and lit over its clips. Each vertex, at rest,
has the colour of its mean error over all poses and both truths; the means printed are by area. Without a
model, it is the fox of the corpus (SKINBAKE_CORPUS, or ../shared/corpus).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from benchmarks.bend_picture import BACKGROUND, GREY, INK, INSIDE, Array, font, heat, rasterise, unit
from benchmarks.bend_picture import SCALE_TOP as FULL_HEAT
from benchmarks.corpus_table import REPOSITORY, corpus_folders
from benchmarks.lit_errors import error_fields
from skinbake.choices import USUAL_TRUTHS, Gradients, PoseKind
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.geometry.skinned import IntArray
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.skinning.rest import Algorithm
from skinbake.truth.areas import vertex_areas
from skinbake.truth.poses import PoseRequest, pose_set
from tests.support.replay import replay

PANEL = (500, 380)
MARGIN, HEADER, FOOTER = 14, 76, 60
SUPERSAMPLING = 3
TURN, TILT = np.radians(-62.0), np.radians(14.0)
FILLED = 0.9
SCALE_TOP = 15.0
SCALE = FULL_HEAT / SCALE_TOP


@dataclass(frozen=True)
class Lit:
    """A model at rest: positions (V, 3), triangles (T, 3), areas (V,), errors (V,) by kind of bake."""

    positions: Array
    triangles: IntArray
    areas: Array
    errors: dict[str, Array]


def lit_both_ways(path: Path) -> Lit:
    """Bake a model both ways, and measure its first primitive over its clips."""
    found: dict[str, Array] = {}
    for gradients in (Gradients.SURFACE, Gradients.FITTED):
        options = BakeOptions(gradients=gradients, generate_normals=True)
        document = bake_document(read_document(str(path)), options).document
        view = baked_views(document, skinned_sources(document))[0]
        poses = pose_set(document, 0, read_clips(document), PoseRequest())
        fields = error_fields(document, [view], poses, "lbs")
        for kind, lighting in (("standard", "standard"), (str(gradients), "accurate")):
            by_truth = [np.nan_to_num(fields[truth, lighting, 0][0]).mean(axis=0) for truth in USUAL_TRUTHS]
            found.setdefault(kind, np.mean(by_truth, axis=0))
    rest = pose_set(document, 0, [], PoseRequest(PoseKind.REST)).joint_matrices
    positions = replay(Algorithm.LBS_STANDARD, rest_primitive(view), rest).positions[0]
    return Lit(positions, view.now.triangles, vertex_areas(view.now.positions, view.now.triangles), found)


def camera() -> Array:
    """Return the rotation (3, 3) from the model to the view: x right, y up, z towards the eye."""
    c, s = np.cos(TURN), np.sin(TURN)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(TILT), np.sin(TILT)
    return np.asarray(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ turn)


def panels(lit: Lit) -> dict[str, Image.Image]:
    """Render the errors, one panel a kind of bake."""
    width, height = (SUPERSAMPLING * side for side in PANEL)
    seen = lit.positions @ camera().T
    low, high = seen.min(axis=0), seen.max(axis=0)
    zoom = FILLED * min(width / (high - low)[0], height / (high - low)[1])
    points = (seen - (low + high) / 2) * zoom * [1, -1, 1] + [width / 2, height / 2, 0]
    owner, where = rasterise(points, lit.triangles, width, height)
    covered = owner >= 0
    corners, bary = lit.triangles[owner[covered]], where[covered]
    faces = unit(
        np.cross(seen[corners[:, 1]] - seen[corners[:, 0]], seen[corners[:, 2]] - seen[corners[:, 0]])
    )
    found = {}
    for kind, errors in lit.errors.items():
        colours = heat(SCALE * np.einsum("pc,pc->p", bary, errors[corners]))
        shaded = colours * (0.72 + 0.28 * np.clip(faces[:, 2:], 0, 1))
        canvas = np.tile(BACKGROUND, (height, width, 1))
        canvas[covered] = np.where(faces[:, 2:] < 0, INSIDE, shaded)
        blocks = canvas.reshape(PANEL[1], SUPERSAMPLING, PANEL[0], SUPERSAMPLING, 3).mean(axis=(1, 3))
        found[kind] = Image.fromarray(np.round(255 * blocks).astype(np.uint8))
    return found


TITLES = {
    "standard": "Standard lighting",
    Gradients.SURFACE: "--gradients surface",
    Gradients.FITTED: "--gradients fitted",
}


def compose(lit: Lit) -> Image.Image:
    """Put the panels side by side, with titles, figures and the scale."""
    width, height = PANEL
    sheet = Image.new("RGB", (3 * width + 4 * MARGIN, HEADER + height + FOOTER), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (kind, panel) in enumerate(panels(lit).items()):
        left = MARGIN + number * (width + MARGIN)
        sheet.paste(panel, (left, HEADER))
        mean = np.average(lit.errors[kind], weights=lit.areas)
        draw.text((left + width / 2, 30), TITLES[kind], INK, font(26), "mm")
        draw.text((left + width / 2, 58), f"normals off by {mean:.2f}° on average", GREY, font(17), "mm")
    left, top, length = width + 2 * MARGIN + 60, HEADER + height + 8, width - 120
    for column in range(length):
        colour = heat(np.array(FULL_HEAT * column / (length - 1)))
        draw.line([(left + column, top), (left + column, top + 14)], tuple(round(255 * c) for c in colour))
    for degrees in range(0, int(SCALE_TOP) + 1, 5):
        x = left + (length - 1) * degrees / SCALE_TOP
        draw.line([(x, top + 14), (x, top + 19)], GREY)
        label = f"{degrees}°+" if degrees == SCALE_TOP else f"{degrees}°"
        draw.text((x, top + 31), label, GREY, font(16), "mm")
    return sheet


def main() -> None:
    """Draw the picture and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("model", type=Path, nargs="?", help="the model (default: the corpus's fox)")
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "fitted.png")
    options = parser.parse_args()
    model = options.model or corpus_folders()[0] / "Fox" / "fox.glb"
    lit = lit_both_ways(model)
    compose(lit).save(options.output, optimize=True)
    for kind, errors in lit.errors.items():
        print(f"{kind}: mean {np.average(errors, weights=lit.areas):.2f}°, max {errors.max():.1f}°")


if __name__ == "__main__":
    main()
