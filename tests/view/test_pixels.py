"""What the page draws, pixel by pixel, against the replay's normals shaded by the same formulas in numpy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.gltf.animation import clip_poses, read_clips, read_skeleton
from skinbake.gltf.document import read_document
from skinbake.gltf.primitives import skinned_sources
from skinbake.lighting.baked_views import baked_views
from skinbake.lighting.measured import rest_surface
from skinbake.skinning.algorithms import Algorithm
from tests.support import browser
from tests.support.characters import Array, baked, unit
from tests.support.replay import replay
from tests.view.pages import picture, shown

TIME = 0.45
MEAN = 2.0
"""Of 255: a pixel has 256 steps, and the GPU interpolates in float32."""
SILHOUETTE = 3
"""Pixels beside an edge of the surface, which antialiasing mixes with others."""
CLAY = np.array([0.60, 0.585, 0.56])


@dataclass(frozen=True)
class Fragments:
    """The pixels (H, W) that the nearest triangle covers, and what varies over them (H, W, 3)."""

    covered: np.ndarray
    positions: Array
    normals: Array


@pytest.fixture(scope="module")
def browsing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[browser.Page, Path]]:
    """Open the page of the fixture, at rest in one pose."""
    path = baked(FOLDER / "bent_tube.glb", tmp_path_factory.mktemp("pixels"))
    with shown(path) as page:
        page.show_as(900, 640, "light")
        page.call(
            """((time) => {
                application.stopMeasuring();
                application.seek(time, true);
                for (const id of ['textures', 'moving']) document.getElementById(id).checked = false;
                for (const side of [left, right]) side.value = 'rig';
                application.chooseSides();
                application.goHome();
            })""",
            TIME,
        )
        yield page, path


@pytest.mark.parametrize("lighting", ["standard", "rig"])
@pytest.mark.parametrize("mode", ["shaded", "normals"])
def test_pixels_are_those_of_the_replay(
    browsing: tuple[browser.Page, Path], mode: str, lighting: str
) -> None:
    page, path = browsing
    page.call(
        """((mode, lighting) => {
            for (const side of [left, right]) side.value = lighting;
            application.chooseSides();
            document.querySelector(`input[value=${mode}]`).click();
        })""",
        mode,
        lighting,
    )
    found = picture(page)[::-1].astype(np.float64)
    height, width = found.shape[:2]
    algorithm = Algorithm.LBS_ACCURATE if lighting == "rig" else Algorithm.LBS_APPROXIMATED
    matrix, eye, turn = page.call(
        "((aspect) => [application.camera.projected(aspect), application.camera.eye, application.turn])",
        width / height,
    )
    drawn = fragments(path, algorithm, np.array(matrix).reshape(4, 4).T, (width, height))
    wanted = 255 * (shaded(drawn, np.array(eye), turn) if mode == "shaded" else 0.5 + 0.5 * drawn.normals)
    inside = eroded(drawn.covered, SILHOUETTE)
    assert inside.sum() > 10_000
    difference = np.abs(found[..., :3] - wanted)[inside]
    assert difference.mean() < MEAN
    assert np.percentile(difference, 99) < 4 * MEAN


def fragments(path: Path, algorithm: Algorithm, matrix: Array, size: tuple[int, int]) -> Fragments:
    """Rasterise the posed surface with a depth buffer; normals and positions are perspective-correct."""
    document = read_document(str(path))
    (view,), _ = baked_views(document, skinned_sources(document)[0])
    poses = clip_poses(read_skeleton(document, 0), read_clips(document)[0], np.array([TIME]))
    posed = replay(algorithm, rest_surface(view), poses)
    positions, normals = posed.positions[0].astype(float), unit(posed.normals[0])
    clip = np.column_stack([positions, np.ones(len(positions))]) @ matrix.T
    places = (clip[:, :3] / clip[:, 3:] * [1, -1, 1] * 0.5 + 0.5) * [*size, 1]
    width, height = size
    depth = np.full((height, width), np.inf)
    owner = np.full((height, width), -1)
    shares = np.zeros((height, width, 3))
    for number, triangle in enumerate(view.now.triangles):
        corners = places[triangle]
        (x0, y0), (x1, y1), (x2, y2) = corners[:, :2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area >= 0:  # counter-clockwise, with y downwards
            continue
        columns = slice(max(0, int(min(x0, x1, x2) - 0.5)), min(width, int(max(x0, x1, x2) + 1.5)))
        rows = slice(max(0, int(min(y0, y1, y2) - 0.5)), min(height, int(max(y0, y1, y2) + 1.5)))
        y, x = np.mgrid[rows, columns] + 0.5
        b1 = ((x - x0) * (y2 - y0) - (x2 - x0) * (y - y0)) / area
        b2 = ((x1 - x0) * (y - y0) - (x - x0) * (y1 - y0)) / area
        weights = np.stack([1 - b1 - b2, b1, b2], axis=-1)
        z = weights @ corners[:, 2]
        nearer = (weights >= 0).all(axis=-1) & (z < depth[rows, columns])
        depth[rows, columns][nearer] = z[nearer]
        owner[rows, columns][nearer] = number
        true_shares = weights / clip[triangle, 3]
        shares[rows, columns][nearer] = (true_shares / true_shares.sum(axis=-1, keepdims=True))[nearer]
    covered = owner >= 0
    corners = view.now.triangles[np.where(covered, owner, 0)]
    mixed = [np.einsum("hwk,hwki->hwi", shares, values[corners]) for values in (positions, normals)]
    mixed[1] = mixed[1] / np.maximum(np.linalg.norm(mixed[1], axis=-1, keepdims=True), 1e-9)
    return Fragments(covered, *mixed)


def shaded(drawn: Fragments, eye: Array, turn: float) -> Array:
    """Return the colours (H, W, 3) of clay under the page's light: GGX, Schlick and a sky of two colours."""

    def dot(a: Array, b: Array) -> Array:
        return np.asarray((a * b).sum(axis=-1, keepdims=True))

    n = drawn.normals
    v = unit_fields(eye - drawn.positions)
    light = unit_fields(np.array([0.75 * np.sin(turn), 0.6, 0.75 * np.cos(turn)]))
    h = unit_fields(light + v)
    nl, nh, nv = np.maximum(dot(n, light), 0), np.maximum(dot(n, h), 0), np.maximum(dot(n, v), 1e-3)
    roughness = 0.42
    a2 = roughness**4
    spread = a2 / (nh**2 * (a2 - 1) + 1) ** 2
    k = (roughness + 1) ** 2 / 8
    shine = 0.04 + 0.96 * (1 - np.maximum(dot(v, h), 0)) ** 5
    specular = shine * spread / (4 * (nl * (1 - k) + k) * (nv * (1 - k) + k))
    up = 0.5 + 0.5 * n[..., 1:2]
    sky = (1 - up) * np.array([0.16, 0.15, 0.145]) + up * np.array([0.36, 0.39, 0.43])
    rim = (1 - nv) ** 4 * 0.12
    colour = CLAY * (sky + 1.7 * nl * np.array([1.0, 0.98, 0.94])) + nl * specular * 1.2 + rim * sky
    return np.asarray(np.clip((colour / (1 + 0.18 * colour)) ** (1 / 2.2), 0, 1))


def unit_fields(vectors: Array) -> Array:
    """Return vectors (…, 3) divided by their lengths."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def eroded(mask: np.ndarray, steps: int) -> np.ndarray:
    """Return the pixels of a mask that are so many steps away from its edge."""
    for _ in range(steps):
        padded = np.pad(mask, 1)
        mask = mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask
