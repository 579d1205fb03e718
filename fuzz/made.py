"""Models made from a seed: triangle soups with odd weights, odd names, and much work in small files.

The models of files are well-shaped before they are damaged. Here the JSON is valid, and the content is odd.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np
import numpy.typing as npt

from fuzz.models import JsonObject, Model

TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
CODES = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
ODD_NAMES = (
    *(
        "__proto__",
        "constructor",
        "",
        " ",
        "a\nb",
        "\x00",
        "\ud800",
        "\x1b[2J",
        "\u202e",
        "</script>",
        "${{x}}",
    ),
    *("::error::x", ".IGNORE", "$(shell x)", "../x", "-", "random:5", "animations", "x" * 3000, "α" * 60),
)
FILE_NAMES = (
    "a&b.bin",
    "~.bin",
    "%.bin",
    ".IGNORE",
    "a=b.bin",
    "a,b.bin",
    "b.bin ",
    "#.bin",
    "$x.bin",
    "ä.bin",
)
Array = npt.NDArray[Any]


class _Builder:
    """A model that accessors are added to."""

    def __init__(self, name: str) -> None:
        self.binary = bytearray()
        self.json: JsonObject = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}
        self.name = name

    def add(self, values: Array, *, bounded: bool = False, normalized: bool = False) -> int:
        """Add an accessor (count, components), and return its number."""
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes}
        self.binary += values.tobytes()
        self.json["bufferViews"].append(view)
        accessor: JsonObject = {
            "bufferView": len(self.json["bufferViews"]) - 1,
            "componentType": CODES[values.dtype.str[1:]],
            "count": len(values),
            "type": TYPES[values.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        if bounded:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def model(self) -> Model:
        """Return the model."""
        self.json["buffers"] = [{"byteLength": len(self.binary)}]
        return Model(self.name, self.json, self.binary)


def made_model(random: Random) -> Model:
    """Return a model of a family."""
    return random.choices((_soup, _named, _laborious), (6, 2, 2))[0](random)


def _soup(random: Random, vertices: int = 24, joints: int = 5) -> Model:
    """Return triangles between any vertices, some of them at one place, with odd weights in several sets."""
    numbers, built = np.random.default_rng(random.getrandbits(32)), _Builder("soup")
    count = random.randint(3, vertices)
    places = numbers.normal(size=(count, 3)) * random.choice((1.0, 1.0, 1e-3, 1e4, 1e-12))
    if random.random() < 0.5:
        places = places[numbers.integers(0, max(count // 2, 1), count)]
    places[:, 0] += random.choice((0.0, 0.0, 0.0, 1e5, 1e8))  # far off, float32 makes slivers
    normals = numbers.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = numbers.integers(0, count, (random.randint(1, 2 * vertices), 3))
    attributes = {"POSITION": built.add(places.astype("<f4"), bounded=True)}
    if random.random() < 0.9:
        attributes["NORMAL"] = built.add(normals.astype("<f4"))
    sets = random.choice((1, 1, 1, 2, 3))
    weights = _weights(random, numbers, (count, 4 * sets))
    slots = numbers.integers(0, random.choice((1, 2, joints)), (count, 4 * sets))
    for number in range(sets):
        own = slice(4 * number, 4 * number + 4)
        kind = random.choice(("f4", "f4", "u1", "u2"))
        stored = weights[:, own].astype("<f4")
        if kind != "f4":
            stored = np.round(weights[:, own].clip(0, 1) * np.iinfo(kind).max).astype(f"<{kind}")
        attributes[f"JOINTS_{number}"] = built.add(slots[:, own].astype(random.choice(("<u1", "<u2"))))
        attributes[f"WEIGHTS_{number}"] = built.add(stored, normalized=kind != "f4")
    primitive = {"attributes": attributes, "indices": built.add(triangles.reshape(-1, 1).astype("<u4"))}
    nodes: list[JsonObject] = [{"mesh": 0, "skin": 0}]
    nodes += [{"translation": numbers.normal(size=3).tolist()} for _ in range(joints)]
    for joint in range(1, joints):
        nodes[random.randint(1, joint)].setdefault("children", []).append(joint + 1)
    turns = numbers.normal(size=(3, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    sampler = {
        "input": built.add(np.array([[0.0], [0.5], [1.0]], "<f4"), bounded=True),
        "output": built.add(turns.astype("<f4")),
    }
    channel = {"sampler": 0, "target": {"node": random.randint(1, joints), "path": "rotation"}}
    built.json |= {
        "meshes": [{"primitives": [primitive]}],
        "nodes": nodes,
        "skins": [{"joints": list(range(1, joints + 1))}],
        "animations": [{"samplers": [sampler], "channels": [channel]}],
        "scenes": [{"nodes": [0, 1]}],
        "scene": 0,
    }
    return built.model()


def _weights(random: Random, numbers: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Return weights (V, K): plain, sparse, tiny, nothing but zeros at some vertices, or of odd sums."""
    weights = numbers.random(shape) * (numbers.random(shape) < random.choice((0.3, 0.7, 1.0)))
    odd: tuple[Callable[[Array], Array], ...] = (
        lambda one: one / np.maximum(one.sum(axis=1, keepdims=True), 1e-9),
        lambda one: one * 10.0 ** -numbers.integers(0, 40, shape),
        lambda one: one * (numbers.random((shape[0], 1)) < 0.7),
        lambda one: np.where(numbers.random(shape) < 0.3, -one, one),
        lambda one: one * random.choice((1e-4, 1e3, 1e30)),
        lambda one: np.eye(shape[1])[numbers.integers(0, shape[1], shape[0])],
    )
    return random.choice(odd)(weights)


def _named(random: Random) -> Model:
    """Return a soup whose entries, and the file of a second buffer, have odd names."""
    model = _soup(random)
    for kind in ("nodes", "meshes", "skins", "animations", "accessors", "scenes"):
        for entry in model.json[kind]:
            entry["name"] = random.choice(ODD_NAMES)
    model.json["materials"] = [{"name": random.choice(ODD_NAMES), "extensions": {"KHR_materials_unlit": {}}}]
    if random.random() < 0.2:
        model.json["meshes"][0]["primitives"][0]["material"] = 0
    file = random.choice(FILE_NAMES)
    model.json["buffers"].append({"uri": file.replace("%", "%25").replace("#", "%23"), "byteLength": 4})
    model.files[file] = b"\x00\x00\x80\x3f"
    model.name = "names"
    return model


def _laborious(random: Random) -> Model:
    """Return a small soup of which many clips, skins, draws, nodes or targets make much work."""
    model, many = _soup(random, vertices=12, joints=3), random.choice((50, 400, 1500))
    content = model.json
    primitive = content["meshes"][0]["primitives"][0]
    kinds = ("clips", "skins", "draws", "primitives", "meshes", "noted", "targets", "channels", "joints")
    match random.choice(kinds):
        case "clips":
            content["animations"] *= many
        case "skins":
            content["skins"] *= many
            content["nodes"] += [{"mesh": 0, "skin": number} for number in range(many)]
        case "draws":
            content["nodes"] += [{"mesh": 0, "skin": 0}] * many
        case "primitives":
            content["meshes"][0]["primitives"] *= many
        case "meshes":
            content["meshes"] *= many
            content["nodes"] += [{"mesh": number, "skin": 0} for number in range(many)]
        case "noted":  # as if correctives had been baked
            noted = {"primitives": [primitive], "extras": {"skinbake": {"version": 1, "targets": 1}}}
            content["meshes"] += [noted] * many
            content["nodes"] += [{"mesh": number % (many + 1)} for number in range(10 * many)]
        case "targets":
            primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}] * many
            content["meshes"][0]["weights"] = [0.01] * many
        case "channels":
            content["animations"][0]["channels"] *= many
        case "joints":
            content["skins"][0]["joints"] *= many
    model.name = "laborious"
    return model
