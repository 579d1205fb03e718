"""A small rasteriser in numpy: the oracle for pictures of the replay."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import clip_poses, random_clip, read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.skinning.rest import Algorithm
from tests.support.characters import Array, unit
from tests.support.replay import replay


@dataclass(frozen=True)
class Fragments:
    """The pixels (H, W) that the nearest triangle covers, and what varies over them (H, W, 3)."""

    covered: np.ndarray
    positions: Array
    normals: Array


def fragments(
    path: Path, algorithm: Algorithm, time: float, matrix: Array, size: tuple[int, int]
) -> Fragments:
    """Rasterise a baked file of one primitive, at a time of its clip, or of random poses.

    matrix (4, 4) leads to the screen. Normals and positions are perspective-correct.
    """
    document = read_document(str(path))
    (view,) = baked_views(document, skinned_sources(document))
    skeleton = read_skeleton(document, 0)
    clip = next(iter(read_clips(document)), None) or random_clip(document)
    poses = clip_poses(skeleton, clip, np.array([time]))
    posed = replay(algorithm, rest_primitive(view), poses)
    positions, normals = posed.positions[0].astype(float), unit(posed.normals[0])
    cut = np.column_stack([positions, np.ones(len(positions))]) @ matrix.T
    places = (cut[:, :3] / cut[:, 3:] * [1, -1, 1] * 0.5 + 0.5) * [*size, 1]
    covered, corners, shares = covering(places, cut[:, 3], view.now.triangles, size)
    mixed = [np.einsum("hwk,hwki->hwi", shares, values[corners]) for values in (positions, normals)]
    mixed[1] = mixed[1] / np.maximum(np.linalg.norm(mixed[1], axis=-1, keepdims=True), 1e-9)
    return Fragments(covered, *mixed)


def covering(
    places: Array, depths: Array, triangles: np.ndarray, size: tuple[int, int], *, clockwise: bool = False
) -> tuple[np.ndarray, np.ndarray, Array]:
    """Return the pixels (H, W) that the nearest triangle covers, its vertices, and their shares, (H, W, 3).

    places (V, 3) are pixels, from the top, and the depth. depths (V,) are those by which varyings are
    divided. Triangles that seem clockwise are left out, or the others are.
    """
    width, height = size
    depth = np.full((height, width), np.inf)
    owner = np.full((height, width), -1)
    shares = np.zeros((height, width, 3))
    for number, triangle in enumerate(triangles):
        corners = places[triangle]
        (x0, y0), (x1, y1), (x2, y2) = corners[:, :2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if (area <= 0) if clockwise else (area >= 0):  # counter-clockwise is negative, with y downwards
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
        true_shares = weights / depths[triangle]
        shares[rows, columns][nearer] = (true_shares / true_shares.sum(axis=-1, keepdims=True))[nearer]
    covered = owner >= 0
    return covered, triangles[np.where(covered, owner, 0)], shares


def eroded(mask: np.ndarray, steps: int) -> np.ndarray:
    """Return the pixels of a mask that are so many steps away from its edge."""
    for _ in range(steps):
        padded = np.pad(mask, 1)
        mask = mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask
