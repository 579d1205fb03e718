"""Characters without light, bodies that blend in colours that glow, and their pictures by three.js."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from fixtures.builder import JsonObject
from tests.support import browser
from tests.support.characters import Array
from tests.support.gltf_reading import read
from tests.support.models import Part, rewritten, write_model
from tests.support.node import package_folder, require_node
from tests.support.stage import opened_page, page_of

GLASS = 178
"""An alpha of 255 with which it is seen which of two colours lies before the other."""
COLOURS = ((217, 102, 102), (102, 217, 102), (102, 102, 217), (217, 217, 102), (217, 102, 217))
"""None is dark: what a light adds to a bright colour is not seen."""
TOLERANCE = 30
"""Of 255: three.js maps no tones, and has no light here."""


@dataclass(frozen=True)
class Ball:
    """A ball, its colours on the side of +z and on the other one, and its alpha; is_carried by the clip."""

    middle: tuple[float, float, float]
    radius: float
    colours: tuple[int, int]
    alpha: int = 255
    is_carried: bool = False


Primitives = Sequence[Sequence[Ball]]

LIMBS: Primitives = [
    [
        Ball((0.0, 0.0, 0.0), 1.0, (0, 1)),
        Ball((0.5, 0.3, 1.2), 0.5, (2, 3)),
        Ball((-0.4, -0.2, -1.2), 0.5, (3, 2)),
        Ball((0.0, 0.0, 0.0), 0.6, (4, 4)),
    ]
]
"""One primitive: a body, a limb before it, a limb behind it, and another layer inside."""

GLASSES: Primitives = [
    [Ball((0.3, 0.1, 1.5), 0.6, (2, 3), GLASS)],
    [Ball((0.0, 0.0, 0.0), 0.9, (0, 1), GLASS)],
    [Ball((-0.3, 0.1, -1.5), 0.6, (3, 4), GLASS)],
]
"""Primitives that are stored from the nearest to the farthest."""

CARRIED: Primitives = [
    [Ball((0.1, 0.0, -1.2), 0.7, (0, 1), GLASS)],
    [Ball((0.8, 0.2, 1.2), 0.6, (2, 3), GLASS, is_carried=True)],
]
"""The clip carries the nearer one behind the other one."""

MIXED: Primitives = [
    [Ball((0.4, 0.2, 1.4), 0.5, (2, 3))],
    [Ball((0.0, 0.0, 0.0), 0.9, (0, 1), GLASS)],
    [Ball((-0.3, 0.0, -1.4), 0.6, (4, 3))],
]
"""Solid ones before and behind one of glass, all of one material."""

LAYERED: Primitives = [
    [Ball((0.0, 0.0, 0.0), 1.0, (0, 1))],
    [Ball((0.0, 0.0, 0.0), 1.0, (2, 3), GLASS)],
]
"""A layer of glass on a body of the same shape."""

END = 1.0
CARRIES = (-2.0, 0.0, -4.5)


def body(path: Path, primitives: Primitives, material: JsonObject) -> Path:
    """Write balls in one material, the triangles of each primitive in any order, and a clip of 1 s."""
    shades = sorted(
        {(ball.colours[side], ball.alpha) for each in primitives for ball in each for side in (0, 1)}
    )
    parts = [_part(each, shades) for each in primitives]
    pixels = {
        "glow": [[(*COLOURS[colour], 255) for colour, _ in shades]],
        "base": [[(0, 0, 0, alpha) for _, alpha in shades]],
    }

    def change(content: JsonObject) -> None:
        content["images"] = [{"uri": _png(rows)} for rows in pixels.values()]
        content["samplers"] = [{"magFilter": 9728, "minFilter": 9728}]
        content["textures"] = [{"source": number, "sampler": 0} for number in (0, 1)]
        content["materials"] = [
            {
                "emissiveTexture": {"index": 0},
                "emissiveFactor": [1, 1, 1],
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}, "metallicFactor": 0},
                **material,
            }
        ]
        moved = np.array([0, END, 1, 0, 0, *np.add((1, 0, 0), CARRIES)], "<f4").tobytes()
        uri = "data:application/octet-stream;base64," + base64.b64encode(moved).decode()
        buffer, view, accessor = (len(content[key]) for key in ("buffers", "bufferViews", "accessors"))
        content["buffers"].append({"uri": uri, "byteLength": len(moved)})
        content["bufferViews"] += [
            {"buffer": buffer, "byteLength": 8},
            {"buffer": buffer, "byteOffset": 8, "byteLength": 24},
        ]
        content["accessors"] += [
            {
                "bufferView": view,
                "componentType": 5126,
                "count": 2,
                "type": "SCALAR",
                "min": [0],
                "max": [END],
            },
            {"bufferView": view + 1, "componentType": 5126, "count": 2, "type": "VEC3"},
        ]
        target = {"node": content["skins"][0]["joints"][1], "path": "translation"}
        content["animations"] = [
            {
                "channels": [{"sampler": 0, "target": target}],
                "samplers": [{"input": accessor, "output": accessor + 1}],
            }
        ]

    return write_model(path, parts, change=change)


def _part(balls: Sequence[Ball], shades: Sequence[tuple[int, int]]) -> Part:
    each = [_triangles(ball, shades) for ball in balls]
    order = np.random.default_rng(5).permutation(sum(len(one["POSITION"]) for one in each))
    arrays = {name: np.concatenate([one[name] for one in each])[order] for name in each[0]}
    flat = {name: values.reshape(-1, values.shape[-1]) for name, values in arrays.items()}
    return Part(flat, np.arange(len(flat["POSITION"])).reshape(-1, 3))


def _triangles(ball: Ball, shades: Sequence[tuple[int, int]]) -> dict[str, Array]:
    """Return the attributes of the triangles of a ball: (T, 3, N) each."""
    rows, columns = 24, 48
    down, around = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij"
    )
    unit = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], axis=-1)
    a, b, c, d = unit[:-1, :-1], unit[1:, :-1], unit[1:, 1:], unit[:-1, 1:]
    normals = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(normals[:, 1] - normals[:, 0], normals[:, 2] - normals[:, 0]), axis=1)
    normals = normals[area > 1e-9]
    behind = (normals.mean(axis=1)[:, 2] < 0).astype(int)
    shade = np.array([shades.index((colour, ball.alpha)) for colour in ball.colours])[behind]
    texcoords = np.stack([(shade + 0.5) / len(shades), np.full(len(shade), 0.5)], axis=-1)
    count = len(normals)
    joint = int(ball.is_carried)
    return {
        "POSITION": (ball.middle + ball.radius * normals).astype(np.float32),
        "NORMAL": normals.astype(np.float32),
        "TEXCOORD_0": np.tile(texcoords[:, None], (1, 3, 1)).astype(np.float32),
        "JOINTS_0": np.full((count, 3, 4), [joint, 0, 0, 0], np.uint8),
        "WEIGHTS_0": np.tile(np.array([1, 0, 0, 0], np.float32), (count, 3, 1)),
    }


def _png(rows: Sequence[Sequence[tuple[int, ...]]]) -> str:
    data = io.BytesIO()
    Image.fromarray(np.array(rows, np.uint8)).save(data, "PNG")
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


REAL = [
    "public/Barbarian/Barbarian.glb",
    "public/Robot/robot.glb",
    "public/Fox/fox.glb",
    "public/CesiumMan/CesiumMan.glb",
    "public/Mannequiny/mannequiny-0.3.0.glb",
    "public/BaseFemale/BaseFemale.glb",
    "public/RobotMantis/animated_robot_mantis.glb",
    "public/Tentacle/InfiniteSkinnedTentacle.glb",
    "public/Butterfly/animated_butterfly.glb",
    "public/VRM/cryptovoxels.vrm",
    "derived/decoded/bath_day.glb",
    "cases/unlit.glb",
]
"""Characters of the corpus: images, MASK, BLEND, both sides, colours of vertices, many materials."""


def flat(source: Path, target: Path, alpha: float = 1.0, material: JsonObject | None = None) -> Path:
    """Write a file that no light reaches, its colours with an alpha, its materials with more members."""
    file = read(source)
    for one in file.content["materials"]:
        one.setdefault("extensions", {})["KHR_materials_unlit"] = {}
        pbr = one.setdefault("pbrMetallicRoughness", {})
        pbr["baseColorFactor"] = [
            *pbr.get("baseColorFactor", [1, 1, 1, 1])[:3],
            alpha * pbr.get("baseColorFactor", [1])[-1],
        ]
        one.update(material or {})
    used = {*file.content.get("extensionsUsed", []), "KHR_materials_unlit", "KHR_texture_transform"}
    file.content["extensionsUsed"] = sorted(used)
    return rewritten(file, target)


class Three:
    """A page on which three.js draws."""

    def __init__(self, page: browser.Page, models: Path) -> None:
        self._page, self._models = page, models

    def picture(self, path: Path, time: float, projected: Array, size: tuple[int, int]) -> Array:
        """Return what three.js draws of a file (H, W, 4), with colours that are multiplied by alpha.

        projected (4, 4) leads to the screen; size is the width and the height.
        """
        (self._models / path.name).write_bytes(path.read_bytes())
        width, height = size
        told = {"url": f"/models/{path.name}", "time": time, "projected": projected.T.ravel().tolist()}
        text = self._page.call("drawn", {**told, "width": width, "height": height})
        pixels = np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)
        return pixels[::-1].astype(np.float64)


@contextmanager
def three(folder: Path) -> Iterator[Three]:
    """Yield a page of three.js."""
    require_node("three")
    page = page_of(
        "/support/three_picture.mjs",
        {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"},
    )
    with opened_page(page, folder, {"three": package_folder("three")}) as (shown, models):
        yield Three(shown, models)


SCENES = [
    *(
        pytest.param(primitives, time, is_double, id=f"{name}, {how}")
        for is_double, how in ((True, "seen from both sides"), (False, "from one side"))
        for primitives, time, name in (
            (GLASSES, 0.0, "glasses"),
            (CARRIED, 0.0, "before the other one"),
            (CARRIED, END, "carried behind the other one"),
            (MIXED, 0.0, "glass and solids"),
        )
    ),
    # From both sides, three.js draws the layer's back through the body.
    pytest.param(LAYERED, 0.0, False, id="a layer on a body, from one side"),
]
"""Primitives, the time of the clip, and whether they are double-sided."""


def share_apart(
    found: Array, wanted: Array, tolerance: float = TOLERANCE, body: npt.NDArray[np.bool_] | None = None
) -> float:
    """Return the share of a drawn body's pixels that are unlike all pixels around the same place there.

    body (H, W) tells where it is; without it, that is where the picture is unlike its corner.
    """
    padded = np.pad(wanted, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = wanted.shape[:2]
    near = [padded[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    apart = np.min([np.abs(found - one).max(axis=2) for one in near], axis=0) > tolerance
    if body is None:
        body = np.abs(wanted - wanted[0, 0]).max(axis=2) > TOLERANCE
    assert body.mean() > 0.02
    return float(apart.sum() / body.sum())
