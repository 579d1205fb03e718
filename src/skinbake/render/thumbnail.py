"""Small pictures in clay without a device: a rasteriser in numpy, and a writer of PNG (its §5)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import Float64Array, IntArray
from skinbake.render.subject import Camera

SIZE = (176, 176)
SUPERSAMPLING = 2
AT_ONCE = 1 << 20
"""The number of pixels that are tried at a time."""

LIGHT = np.array([-0.66, 0.60, 0.45])
"""Where the light comes from, as the camera sees it: it grazes the surface from the left and above."""


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """A surface in one pose: positions (V, 3), triangles (T, 3), and normals (L, V, 3) by L lightings."""

    positions: Float64Array
    normals: Float64Array
    triangles: IntArray


def thumbnails(surfaces: list[Posed], camera: Camera) -> list[bytes]:
    """Return a PNG of grey and alpha for each lighting. What is not finite is left out."""
    width, height = (SUPERSAMPLING * side for side in SIZE)
    yaw = camera.yaws[0]
    matrix, axes = camera.projected(yaw, width / height), camera.axes(yaw)
    grey = np.zeros((len(surfaces[0].normals), width * height))
    depths = np.full(width * height, np.inf)
    towards, light = axes[2], LIGHT @ axes / np.linalg.norm(LIGHT)
    half = (light + towards) / np.linalg.norm(light + towards)
    # Positions may be of any size; what overflows lies outside the picture.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for surface in surfaces:
            # places (V, 3): pixels from the upper left corner, and the depth
            clip = np.column_stack([surface.positions, np.ones(len(surface.positions))]) @ matrix.T
            places = (clip[:, :3] / clip[:, 3:] * [1, -1, 1] * 0.5 + 0.5) * [width, height, 1.0]
            places[clip[:, 2] < 0] = np.nan  # a triangle with a corner before the near plane is left out
            (x, y), (u, v) = np.diff(places[surface.triangles, :2], axis=1).transpose(1, 2, 0)
            is_behind = x * v > y * u  # y goes down
            for pixels, depth, triangles, shares in _fragments(places, surface.triangles, (width, height)):
                # Clay from 0 to 1: ambient, from above, diffuse and a highlight (Blinn 1977). A triangle seen
                # from behind is lit like its front, whatever its normals say.
                n = np.einsum("fk,lfki->lfi", shares, surface.normals[:, surface.triangles[triangles]])
                n /= np.linalg.norm(n, axis=2, keepdims=True)
                n[:, is_behind[triangles]] *= -1
                lit = 0.24 + 0.14 * n[..., 1] + 0.66 * np.maximum(n @ light, 0)
                lit += 0.25 * np.maximum(n @ half, 0) ** 40
                shades = np.clip(lit, 0, 1) ** (1 / 1.4)
                sound = np.isfinite(shades).all(axis=0) & np.isfinite(depth)
                order = np.flatnonzero(sound)[np.argsort(-depth[sound], kind="stable")]
                order = order[depth[order] < depths[pixels[order]]]
                # Of several values for one pixel, the last one stays: the nearest.
                grey[:, pixels[order]], depths[pixels[order]] = shades[:, order], depth[order]
    covered = np.isfinite(depths).astype(np.float64)
    *means, alpha = (
        part.reshape(SIZE[1], SUPERSAMPLING, SIZE[0], SUPERSAMPLING).mean(axis=(1, 3))
        for part in (*(grey * covered), covered)
    )
    shown = [np.divide(mean, alpha, out=np.zeros_like(alpha), where=alpha > 0) for mean in means]
    return [
        png(np.stack([255 * one, 255 * alpha], axis=2).round().clip(0, 255).astype(np.uint8)) for one in shown
    ]


def _fragments(
    places: Float64Array, triangles: IntArray, size: tuple[int, int]
) -> Iterator[tuple[IntArray, Float64Array, IntArray, Float64Array]]:
    """Yield pixels, depths, triangles and shares of corners (F, 3): triangles of one extent at a time."""
    corners = places[triangles]
    low = np.floor(np.clip(corners[..., :2].min(axis=1), 0, size))
    high = np.ceil(np.clip(corners[..., :2].max(axis=1), 0, size))
    extents = (high - low).max(axis=1)
    seen = np.isfinite(corners).all(axis=(1, 2)) & (high > low).all(axis=1)
    extent = 1
    smallest = 0
    while smallest < max(size):
        chosen = np.flatnonzero(seen & (extents > smallest) & (extents <= extent))
        step = max(1, AT_ONCE // extent**2)
        for start in range(0, len(chosen), step):
            some = chosen[start : start + step]
            # All pixels of a square of this extent, and their places in the triangle: shares of the corners
            # by the areas opposite to them. A pixel is inside where no share is negative.
            y, x = (axis.ravel() for axis in np.mgrid[:extent, :extent])
            px, py = low[some, 0, None] + x, low[some, 1, None] + y
            (x0, y0), (x1, y1), (x2, y2) = (corners[some, corner, :2].T[..., None] for corner in range(3))
            area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
            b1 = ((px + 0.5 - x0) * (y2 - y0) - (x2 - x0) * (py + 0.5 - y0)) / area
            b2 = ((x1 - x0) * (py + 0.5 - y0) - (px + 0.5 - x0) * (y1 - y0)) / area
            shares = np.stack([1 - b1 - b2, b1, b2], axis=-1)
            inside = (shares >= 0).all(axis=-1) & (px < size[0]) & (py < size[1])
            owners, kept = some[np.nonzero(inside)[0]], shares[inside]
            depth = np.einsum("fk,fk->f", kept, corners[owners, :, 2])
            yield (py[inside] * size[0] + px[inside]).astype(np.intp), depth, owners, kept
        smallest, extent = extent, 2 * extent


def png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Return a PNG of pixels (H, W, 2): grey and alpha."""
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    above = np.vstack([np.zeros_like(rows[:1]), rows[:-1]])
    filtered = np.column_stack([np.full(height, 2, np.uint8), rows - above])  # the filter "up"
    head = struct.pack(">IIBBBBB", width, height, 8, 4, 0, 0, 0)
    parts = [
        _chunk(b"IHDR", head),
        _chunk(b"IDAT", zlib.compress(filtered.tobytes(), 9)),
        _chunk(b"IEND", b""),
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
