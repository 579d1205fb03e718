"""Models damaged in one chosen way each: what chance takes too long to do to the right part of a model."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from fuzz.models import JsonObject, Model

Edit = Callable[[JsonObject], object]


def _set(*path: Any, to: object) -> Edit:
    """Return an edit that sets the member at a path, making objects on the way."""

    def edit(content: JsonObject) -> None:
        holder: Any = content
        for key in path[:-1]:
            holder = holder.setdefault(key, {}) if isinstance(holder, dict) else holder[key]
        if isinstance(holder, list) and path[-1] == len(holder):
            holder.append(to)
        else:
            holder[path[-1]] = to

    return edit


FIRST = ("meshes", 0, "primitives", 0)
CHANNEL = ("animations", 0, "channels", 0)
SAMPLER = ("animations", 0, "samplers", 0)

MORPHED: tuple[Edit, ...] = (
    _set(*FIRST, "targets", 0, "POSITION", to=3),
    _set(*FIRST, "targets", 0, "POSITION", to=2),
    _set(*FIRST, "targets", 0, "NORMAL", to=4),
    _set(*FIRST, "targets", 1, to={"POSITION": 0}),
    _set(*FIRST, "targets", to=[{"POSITION": 0}, {"POSITION": 0}]),
    _set(*FIRST, "targets", to=[]),
    _set("meshes", 0, "weights", to=[0.5, 0.5, 0.5]),
    _set("meshes", 0, "weights", to=["x"]),
    _set("nodes", 0, "weights", to=[1e300, 1]),
    _set("nodes", 0, "weights", to=[0.5]),
    _set(*CHANNEL, "target", "path", to="weights"),
    _set("meshes", 0, "primitives", 1, to={"attributes": {"POSITION": 0, "NORMAL": 1}}),
)
"""Edits of a model with morph targets."""

ANY: tuple[Edit, ...] = (
    _set(*SAMPLER, "interpolation", to="SPLINE"),
    _set(*CHANNEL, "target", "path", to="pointer"),
    _set(*CHANNEL, "target", to={}),
    _set(*SAMPLER, "output", to=0),
    _set("skins", 0, "joints", to=[]),
    _set("skins", 0, "joints", to=3),
    _set("nodes", 1, "children", to={}),
    _set(*FIRST, "extras", to={}),
    _set(*FIRST, "extras", to=3),
    _set("extensionsUsed", to=["MSFT_texture_dds"]),
    _set("accessors", 0, "sparse", to={"count": 1, "indices": {"componentType": 5121}, "values": {}}),
    _set("accessors", 0, "type", to="VEC9"),
    _set("accessors", 0, "count", to=int("9" * 4300)),
    _set("buffers", 1, to={"byteLength": 4, "uri": "data:text/plain,%00%01%02%03"}),
    _set("buffers", 1, to={"byteLength": 4, "uri": "data:nothing"}),
    _set("accessors", 0, "min", to=[1e300, 0, 0]),
    _set("images", to=[{"bufferView": 0}]),
)
"""Edits of any skinned and animated model."""

DRACO: tuple[Edit, ...] = (
    _set(*FIRST, "indices", to=99),
    _set(*FIRST, "attributes", "JOINTS_0", to=99),
    _set("meshes", 0, "primitives", 0, "mode", to=5),
    _set("meshes", 0, "primitives", 0, "extensions", "KHR_draco_mesh_compression", "bufferView", to=0),
    _set("meshes", 0, "primitives", 0, "extensions", "KHR_draco_mesh_compression", "attributes", to={}),
)
"""Edits of a model in Draco."""


def directed_seeds(plain: Model, morphed: Model, draco: Model) -> list[Model]:
    """Return the models of all edits; what an edit does not fit is left out."""
    found = []
    for base, edits in ((morphed, MORPHED), (plain, ANY), (draco, DRACO)):
        for number, edit in enumerate(edits):
            made = base.copied()
            made.name = f"directed-{number}-{base.name}"
            try:
                edit(made.json)
            except (KeyError, IndexError, TypeError, AttributeError):
                continue
            found.append(made)
    more = [_shared(draco), *_streams(draco), _not_finite(morphed), _never(plain), _two_skins(plain)]
    return [*found, *more, *_twice(plain), _long_gaps(plain), _matrices(plain)]


def _never(model: Model) -> Model:
    """Return the model with a key of its clip at a time that is not a number."""
    made = model.copied()
    made.name = "directed-never"
    accessor = made.json["accessors"][made.json["animations"][0]["samplers"][0]["input"]]
    view = made.json["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    struct.pack_into("<f", made.binary, start, float("nan"))
    return made


def _two_skins(model: Model) -> Model:
    """Return the model with a second node and a second skin, which say what the first ones say."""
    made = model.copied()
    made.name = "directed-two-skins"
    made.json["skins"].append(dict(made.json["skins"][0]))
    made.json["nodes"].append({"mesh": 0, "skin": len(made.json["skins"]) - 1})
    return made


def _long_gaps(model: Model) -> Model:
    """Return the model with much white space where bake adds attributes."""
    made, gap = model.copied(), " " * 300
    made.name = "directed-gaps"
    attributes = made.json["meshes"][0]["primitives"][0]["attributes"]
    made.raw["@gaps"] = f'{attributes["POSITION"]},{gap}"_OTHER"{gap}: {attributes["POSITION"]}'
    attributes["_FIRST"] = "@gaps"
    return made


def _matrices(model: Model) -> Model:
    """Return the model with a matrix at each vertex, which Draco cannot store."""
    made = model.copied()
    made.name = "directed-matrices"
    attributes, accessors = made.json["meshes"][0]["primitives"][0]["attributes"], made.json["accessors"]
    count = accessors[attributes["POSITION"]]["count"]
    attributes["_MATRIX"] = len(accessors)
    accessors.append({"componentType": 5126, "count": count, "type": "MAT2"})
    return made


def _twice(model: Model) -> list[Model]:
    """Return the model with the same member twice, before all others and behind them."""
    first, last = model.copied(), model.copied()
    first.json = {"extras": "@twice", **first.json}
    last.json["extras"] = "@twice"
    for name, made in (("first", first), ("last", last)):
        made.name = f"directed-twice-{name}"
        made.raw["@twice"] = '1, "extras": 2'
    return [first, last]


def _not_finite(model: Model) -> Model:
    """Return the model with differences of morph targets that are not finite."""
    made = model.copied()
    made.name = "directed-differences"
    number = made.json["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]
    view = made.json["bufferViews"][made.json["accessors"][number]["bufferView"]]
    struct.pack_into("<f", made.binary, view.get("byteOffset", 0), float("inf"))
    return made


def _shared(model: Model) -> Model:
    """Return the model with its stream twice, under two primitives that share accessors."""
    made = model.copied()
    made.name = "directed-shared"
    mesh = made.json["meshes"][0]
    other = model.copied().json["meshes"][0]["primitives"][0]
    views = made.json["bufferViews"]
    views.append(dict(views[other["extensions"]["KHR_draco_mesh_compression"]["bufferView"]]))
    other["extensions"]["KHR_draco_mesh_compression"]["bufferView"] = len(views) - 1
    mesh["primitives"].append(other)
    return made


def _streams(model: Model) -> list[Model]:
    """Return the model with its stream cut in its header, with metadata, and with other counts."""
    extension = model.json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]
    view = model.json["bufferViews"][extension["bufferView"]]
    start = view.get("byteOffset", 0)
    found = []
    for number, (at, data) in enumerate(
        ((10, b"\x80\0\0"), (10, b"\x80\1\0\0\0\0"), (7, b"\0"), (11, b"\xff" * 6))
    ):
        made = model.copied()
        made.name = f"directed-stream-{number}"
        made.binary[start + at : start + at + len(data)] = data
        found.append(made)
    cut = model.copied()
    cut.name = "directed-cut"
    cut.json["bufferViews"][extension["bufferView"]]["byteLength"] = 12
    return [*found, cut]
