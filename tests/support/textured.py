"""Models with images that lie on sets of texture coordinates, placed by KHR_texture_transform or by hand."""

from __future__ import annotations

import base64
import io
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from tests.support.baked_files import Editable, JsonObject
from tests.support.characters import Array
from tests.support.models import sheet, write_model
from tests.support.node import run_program

NAME = "KHR_texture_transform"
USES = ("base", "normal", "emissive")
TRANSFORMS: dict[str, dict[str, Any]] = {
    "base": {"offset": [0.3, -0.2], "rotation": 0.7, "scale": [2.0, 0.5]},
    "normal": {"offset": [-0.15, 0.45], "rotation": -1.1, "scale": [0.8, 3.0]},
    "emissive": {"offset": [0.6, 0.1], "rotation": 2.4, "scale": [-1.5, 0.7]},
}
SETS = {"base": 2, "normal": 0, "emissive": 1}

BROKEN: tuple[Any, ...] = (
    [],
    5,
    None,
    {"offset": "0.5"},
    {"offset": [0.5]},
    {"offset": [0.5, 0.5, 0.5]},
    {"scale": [2, True]},
    {"scale": [2, 1e39]},
    {"scale": 2},
    {"rotation": "0.5"},
    {"rotation": [0.5]},
    {"texCoord": -1},
    {"texCoord": 1.5},
    {"texCoord": True},
    {"texCoord": "1"},
)
"""Contents of the extension that say nothing."""

RED, GREEN, BLUE, YELLOW, CYAN = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0), (0, 255, 255)
EXAMPLE = {"offset": [0, 1], "rotation": 1.57079632679, "scale": [0.5, 0.5]}
"""The specification's own: the lower left quarter of an image, turned clockwise by 90°."""
QUARTER, TURNED = ((RED, GREEN), (BLUE, YELLOW)), ((BLUE, RED), (YELLOW, GREEN))
"""That quarter by rows, before and after. The other quarters are of another colour."""

REPEAT, CLAMP, MIRROR = 10497, 33071, 33648
SAMPLERS: dict[str, tuple[JsonObject, int, int]] = {
    "no sampler": ({}, REPEAT, REPEAT),
    "repeat": ({"wrapS": REPEAT, "wrapT": REPEAT}, REPEAT, REPEAT),
    "clamp": ({"wrapS": CLAMP, "wrapT": CLAMP}, CLAMP, CLAMP),
    "mirror": ({"wrapS": MIRROR, "wrapT": MIRROR}, MIRROR, MIRROR),
    "clamp and repeat": ({"wrapS": CLAMP, "wrapT": REPEAT}, CLAMP, REPEAT),
    "mirror and clamp": ({"wrapS": MIRROR, "wrapT": CLAMP}, MIRROR, CLAMP),
    "no number of glTF": ({"wrapS": 33069, "wrapT": "33071", "magFilter": [9728]}, REPEAT, REPEAT),
}
"""By name: a sampler, and what an image does along u and v beyond its edges."""


def image(*rows: npt.ArrayLike) -> dict[str, str]:
    """Return a glTF image that holds the pixels (W, 3) of these rows as PNG."""
    data = io.BytesIO()
    Image.fromarray(np.array(rows, np.uint8)).save(data, "PNG")
    return {"uri": "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()}


def by_formula(coordinates: Array, *, offset: list[float], rotation: float, scale: list[float]) -> Array:
    """translation(offset) · rotation · scale · (u, v, 1). A turn is counter-clockwise where v points down."""
    cosine, sine = np.cos(rotation), np.sin(rotation)
    moved = np.array([[1, 0, offset[0]], [0, 1, offset[1]], [0, 0, 1]])
    turned = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    matrix = moved @ turned @ np.diag([*scale, 1])
    return np.asarray((np.column_stack([coordinates, np.ones(len(coordinates))]) @ matrix.T)[:, :2])


def placed_by_extension(source: Path, target: Path, uses: Collection[str] = USES) -> Path:
    """Copy a GLB, with images on the sets 0, 1 and 2 that the extension moves.

    It names the set of one image, the texture names the set of another, and nothing names set 0.
    """
    file = Editable(source)
    _add_sets(file, _sets(file))
    infos: dict[str, JsonObject] = {use: {"extensions": {NAME: {**TRANSFORMS[use]}}} for use in uses}
    if "base" in infos:
        infos["base"]["extensions"][NAME]["texCoord"] = SETS["base"]
        infos["base"]["texCoord"] = SETS["emissive"]
    if "emissive" in infos:
        infos["emissive"]["texCoord"] = SETS["emissive"]
    set_material(file.content, infos)
    return file.write(target)


def placed_by_hand(
    source: Path, target: Path, uses: Collection[str] = USES, *, is_moved: bool = True
) -> Path:
    """Copy a GLB, with the same images in the same places: each has a set that was moved by the formula.

    The set of the first image is 0. is_moved False leaves out the formula.
    """
    file = Editable(source)
    sets = _sets(file)
    moved = [by_formula(sets[SETS[use]], **TRANSFORMS[use]) if is_moved else sets[SETS[use]] for use in uses]
    _add_sets(file, moved)
    set_material(file.content, {use: {"texCoord": number} for number, use in enumerate(uses)})
    return file.write(target)


def white_in_two_ways(source: Path, folder: Path) -> tuple[Path, Path]:
    """Copy a GLB twice, with one normal map: white by an image on another set, and white by a factor."""
    by_image = Editable(placed_by_extension(source, folder / "by_image.glb", ("base", "normal")))
    by_image.content["images"][0] = image([(255, 255, 255)])
    by_factor = Editable(placed_by_extension(source, folder / "by_factor.glb", ("normal",)))
    by_factor.content["materials"][0]["pbrMetallicRoughness"] = {"baseColorFactor": [1, 1, 1, 1]}
    return by_image.write(folder / "by_image.glb"), by_factor.write(folder / "by_factor.glb")


def _sets(file: Editable) -> list[Array]:
    """Return three sets of coordinates (V, 2) that follow the surface without a seam."""
    positions = file.array("POSITION").astype(np.float64)
    x, y, z = ((positions - positions.min(axis=0)) / np.ptp(positions, axis=0).max()).T
    pairs = ((x + 0.3 * z, y), (y * y + z, x - 0.4 * y), (z - x, y + 0.5 * x))
    return [np.column_stack(pair).astype(np.float32).astype(np.float64) for pair in pairs]


def _add_sets(file: Editable, sets: Sequence[Array]) -> None:
    attributes = file.primitive()["attributes"]
    attributes |= {f"TEXCOORD_{n}": file.add(values.astype(np.float32)) for n, values in enumerate(sets)}


def set_material(content: JsonObject, infos: Mapping[str, JsonObject]) -> None:
    """Give the first material an image for each use, without a seam where it repeats."""
    content["textures"] = [{"source": number} for number in range(len(infos))]
    content["images"] = [image(*_pixels(use)) for use in infos]
    found = {use: {**info, "index": number} for number, (use, info) in enumerate(infos.items())}
    material: JsonObject = {"doubleSided": True}
    if "base" in found:
        material["pbrMetallicRoughness"] = {"baseColorTexture": found["base"]}
    if "normal" in found:
        material["normalTexture"] = found["normal"]
    if "emissive" in found:
        material |= {"emissiveTexture": found["emissive"], "emissiveFactor": [0.8, 0.8, 0.8]}
    content["materials"] = [material]


def _pixels(use: str) -> Array:
    v, u = 2 * np.pi * (np.mgrid[:64, :64] + 0.5) / 64
    if use == "normal":
        slopes = np.stack([0.5 * np.sin(2 * u), 0.5 * np.sin(u + v), np.ones_like(u)], axis=-1)
        return np.asarray(127.5 + 127.5 * slopes / np.linalg.norm(slopes, axis=-1, keepdims=True))
    waves = {"base": (np.sin(u), np.sin(v), np.cos(u - v)), "emissive": (0 * u - 1, np.sin(u + v), np.cos(u))}
    return np.asarray(127.5 + 120 * np.stack(waves[use], axis=-1))


def packed(source: Path, target: Path) -> Editable:
    """Write a file by gltfpack, which quantises texture coordinates, and return what it wrote."""
    run_program("gltfpack", "../cli.js", "-i", str(source), "-o", str(target), folder=target.parent)
    return Editable(target)


def quartered(
    path: Path, transform: JsonObject, sampler: JsonObject | None = None, size: int | None = None
) -> Path:
    """Write a flat sheet that does not move and glows in the colours of an image with this transform.

    With a size, the image has no pixels but those of QUARTER: so many of each colour along a side.
    """
    flat = sheet().attributes["POSITION"] * [1, 1, 0]
    count = len(flat)
    low, high = flat.min(axis=0)[:2], flat.max(axis=0)[:2]
    attributes: dict[str, Any] = {
        "POSITION": flat.astype(np.float32),
        "NORMAL": np.tile([0, 0, 1], (count, 1)).astype(np.float32),
        "TEXCOORD_0": np.abs((flat[:, :2] - [low[0], high[1]]) / (high - low)).astype(np.float32),
        "JOINTS_0": np.zeros((count, 4), np.uint8),
        "WEIGHTS_0": np.tile([1, 0, 0, 0], (count, 1)).astype(np.float32),
    }
    pixels = np.tile(np.array(CYAN), (64, 64, 1))
    pixels[32:, :32] = np.repeat(np.repeat(QUARTER, 16, axis=0), 16, axis=1)
    if size is not None:
        pixels = np.repeat(np.repeat(QUARTER, size, axis=0), size, axis=1)
    still = np.array([0, 1, *[0, 0, 0, 1] * 2], "<f4").tobytes()

    def change(content: JsonObject) -> None:
        info = {"index": 0, "extensions": {NAME: transform}}
        black = {"baseColorFactor": [0, 0, 0, 1]}
        content["materials"] = [
            {"pbrMetallicRoughness": black, "emissiveTexture": info, "emissiveFactor": [1, 1, 1]}
        ]
        content["images"], content["textures"] = [image(*pixels)], [{"source": 0}]
        if sampler:
            content["samplers"], content["textures"] = [{}, sampler], [{"source": 0, "sampler": 1}]
        uri = "data:application/octet-stream;base64," + base64.b64encode(still).decode()
        content["buffers"].append({"uri": uri, "byteLength": len(still)})
        view, accessor = len(content["bufferViews"]), len(content["accessors"])
        buffer = len(content["buffers"]) - 1
        content["bufferViews"] += [
            {"buffer": buffer, "byteLength": 8},
            {"buffer": buffer, "byteOffset": 8, "byteLength": 32},
        ]
        content["accessors"] += [
            {"bufferView": view, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            {"bufferView": view + 1, "componentType": 5126, "count": 2, "type": "VEC4"},
        ]
        target = {"node": content["skins"][0]["joints"][0], "path": "rotation"}
        content["animations"] = [
            {
                "channels": [{"sampler": 0, "target": target}],
                "samplers": [{"input": accessor, "output": accessor + 1}],
            }
        ]

    return write_model(path, [sheet(**attributes)], change=change)


Quarters = tuple[tuple[tuple[int, ...], ...], ...]


def beyond(folder: Path, name: str, offset: int) -> tuple[Path, Quarters]:
    """Write a sheet on which an image of four quarters is moved by its own size, by an offset of 1 or −1.

    Return the quarters that it shows.
    """
    sampler, *wraps = SAMPLERS[name]
    path = quartered(folder / "beyond.glb", {"offset": [offset, offset]}, sampler, size=32)
    last = int(offset > 0)
    columns, rows = ({REPEAT: [0, 1], CLAMP: [last, last], MIRROR: [1, 0]}[wrap] for wrap in wraps)
    return path, tuple(tuple(QUARTER[row][column] for column in columns) for row in rows)


def share_of_pure(picture: npt.NDArray[Any]) -> float:
    """Return the share of what glows in a picture (H, W, 3) that has one of the four colours alone."""
    glowing = picture[np.ptp(picture, axis=-1) > 60].astype(np.float64)
    tones = glowing / glowing.max(axis=1, keepdims=True) * 255
    known = np.array([RED, GREEN, BLUE, YELLOW])
    apart = np.abs(tones[:, None] - known).max(axis=2).min(axis=1)
    return float((apart < 60).mean())


def quarters_seen(picture: npt.NDArray[Any]) -> Quarters:
    """Return the colours of the quarters of what glows in a picture (H, W, 3), by rows: the nearest known."""
    rows, columns = (np.ptp(picture, axis=-1) > 120).nonzero()
    known = (RED, GREEN, BLUE, YELLOW, CYAN)

    def seen(down: float, right: float) -> tuple[int, ...]:
        row = round(rows.min() + down * np.ptp(rows))
        column = round(columns.min() + right * np.ptp(columns))
        apart = np.abs(np.array(known) - picture[row, column]).sum(axis=1)
        return known[int(apart.argmin())]

    return tuple(tuple(seen(down, right) for right in (0.25, 0.75)) for down in (0.25, 0.75))


def with_holes() -> dict[str, str]:
    """Return a red image, every other stripe of which is a hole: its alpha is 0."""
    pixels = np.zeros((32, 32, 4), np.uint8)
    pixels[..., 0] = 255
    pixels[:, np.arange(32) // 8 % 2 == 0, 3] = 255
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG")
    return {"uri": f"data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}"}
