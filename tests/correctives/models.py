"""Models of few parts that files with correctives are made of."""

from __future__ import annotations

import base64
import copy
import json
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fixtures.make_fixtures import FOLDER
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from tests.support import gltf_reading
from tests.support.baked_files import Editable
from tests.support.characters import Array, angles, unit
from tests.support.played import drawn
from tests.support.triangle_truth import true_normals

TUBE, SHEET = FOLDER / "bent_tube.glb", FOLDER / "morphed_sheet.glb"


def rewritten(source: Path, target: Path, change: Any) -> Path:
    """Write a GLB with other JSON: ``change`` alters it."""
    file = gltf_reading.read(source)
    content = copy.deepcopy(file.content)
    change(content)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    binary = file.binary_chunk or b""
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    target.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    return target


def parted(target: Path) -> Path:
    """Write the bent tube in three primitives, drawn by two nodes of two skins with the same joints."""

    def change(content: Any) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        whole = content["accessors"][primitive["indices"]]
        third, parts = whole["count"] // 3, []
        for number in range(3):
            content["accessors"].append({**whole, "byteOffset": 2 * third * number, "count": third})
            parts.append({**primitive, "indices": len(content["accessors"]) - 1})
            for bound in ("min", "max"):
                content["accessors"][-1].pop(bound)
        content["meshes"][0]["primitives"] = parts
        content["skins"].append(copy.deepcopy(content["skins"][0]))
        drawer = next(node for node in content["nodes"] if "skin" in node)
        content["nodes"].append({**drawer, "name": "again", "skin": 1})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    return rewritten(TUBE, target, change)


def turned(model: Editable, accessor: int, degrees: float, axis: int, keys: slice) -> int:
    """Add a copy of an accessor of rotations, in some of which the joint is turned further. Return it."""
    values = np.array(model.stored(accessor))
    half = np.radians(degrees) / 2
    turn = np.zeros(4)
    turn[axis], turn[3] = np.sin(half), np.cos(half)
    x, y, z, w = values[keys].T
    a, b, c, d = turn
    values[keys] = np.stack(
        [
            *(w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a),
            *(w * c + x * b - y * a + z * d, w * d - x * a - y * b - z * c),
        ],
        axis=1,
    )
    return model.add(values.astype(np.float32))


def with_clips(target: Path, names: Sequence[str | None]) -> Path:
    """Write the tube with a clip of each name, None for none. Each bends it about another axis."""
    model = Editable(TUBE)
    [bend] = model.content["animations"]
    clips = []
    for number, name in enumerate(names):
        clip = copy.deepcopy(bend)
        del clip["name"]
        if number:
            output = turned(model, bend["samplers"][0]["output"], 40.0 * number, number % 3, slice(None))
            clip["samplers"][0]["output"] = output
        clips.append(clip if name is None else {**clip, "name": name})
    model.content["animations"] = clips
    return model.write(target)


def clip_files(source: Path, folder: Path) -> list[Path]:
    """Write the model without clips as hero.glb, and once with each clip alone."""
    count = len(gltf_reading.read(source).content["animations"])

    def only(number: int | None) -> Any:
        def change(content: Any) -> None:
            content["animations"] = [] if number is None else [content["animations"][number]]
            if number is None:
                del content["animations"]

        return change

    folder.mkdir(exist_ok=True)
    clips = [rewritten(source, folder / f"clip{number}.glb", only(number)) for number in range(count)]
    return [rewritten(source, folder / "hero.glb", only(None)), *clips]


REFERENCES = {
    "accessors": ("bufferView",),
    "bufferViews": ("buffer",),
    "nodes": ("mesh", "skin", "children"),
    "skins": ("inverseBindMatrices", "joints", "skeleton"),
    "scenes": ("nodes",),
}
"""The members of the top-level arrays that name entries of others."""


def joined(sources: list[Path], target: Path) -> Path:
    """Write several GLBs as one, with all their meshes, skins and clips."""
    whole: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
    for source in sources:
        file = gltf_reading.read(source)
        content = copy.deepcopy(file.content)
        uri = "data:application/octet-stream;base64,"
        content["buffers"][0]["uri"] = uri + base64.b64encode(file.binary_chunk or b"").decode()
        starts = {key: len(whole.get(key, [])) for key in content if isinstance(content[key], list)}
        of = {"bufferView": "bufferViews", "buffer": "buffers", "mesh": "meshes", "skin": "skins"}
        of |= dict.fromkeys(("children", "joints", "skeleton", "nodes"), "nodes")
        of |= dict.fromkeys(("inverseBindMatrices", "input", "output", "indices"), "accessors")

        def moved(name: str, value: Any, starts: dict[str, int] = starts, of: dict[str, str] = of) -> Any:
            start = starts[of.get(name, "accessors")]
            if isinstance(value, dict):
                return {key: one + starts["accessors"] for key, one in value.items()}
            return [one + start for one in value] if isinstance(value, list) else value + start

        for key, names in REFERENCES.items():
            for entry in content.get(key, []):
                entry |= {name: moved(name, entry[name]) for name in names if name in entry}
                for part in entry.get("sparse", {}).values():
                    if isinstance(part, dict):
                        part["bufferView"] += starts["bufferViews"]
        for primitive in (one for mesh in content["meshes"] for one in mesh["primitives"]):
            primitive["attributes"] = moved("", primitive["attributes"])
            primitive["indices"] += starts["accessors"]
            primitive.pop("material", None)
            for number, one in enumerate(primitive.get("targets", [])):
                primitive["targets"][number] = moved("", one)
        for animation in content.get("animations", []):
            for sampler in animation["samplers"]:
                sampler |= {name: moved(name, sampler[name]) for name in ("input", "output")}
            for channel in animation["channels"]:
                channel["target"]["node"] += starts["nodes"]
        whole["scenes"][0]["nodes"] += content["scenes"][0]["nodes"]
        for key in ("buffers", "bufferViews", "accessors", "meshes", "skins", "nodes", "animations"):
            whole.setdefault(key, []).extend(content.get(key, []))
    text = json.dumps(whole).encode()
    text += b" " * (-len(text) % 4)
    target.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text)
    return target


def mean_errors(path: Path, clip: int, times: list[float], **how: Any) -> Array:
    """Return the mean angles (2,) to the normals of posed triangles: standard, and corrected.

    All nodes and primitives count, vertex by vertex. The normals that the file's own targets give are true at
    rest, if all of these have NORMAL.
    """
    document = read_document(str(path))
    primitives = {
        (one.mesh, one.primitive): read_primitive(document, one) for one in skinned_sources(document)
    }
    authored = {
        (mesh, number)
        for mesh, content in enumerate(document.json["meshes"])
        for number, one in enumerate(content["primitives"])
        if "filled" not in content["extras"]["skinbake"]["primitives"][number] and one.get("targets")
    }
    found: list[Array] = []
    for time in times:
        for pair in zip(
            *(drawn(path, clip, time, corrected=one, **how) for one in (False, True)), strict=True
        ):
            standard, primitive = pair[0], primitives[pair[0].mesh, pair[0].primitive]
            if (pair[0].mesh, pair[0].primitive) in authored:
                primitive = replace(primitive, positions=standard.at_rest, normals=unit(standard.changed))
            truth = true_normals(primitive, standard.positions[None])[0]
            known = np.isfinite(truth[:, 0])
            found.append(np.array([angles(one.normals[known], truth[known]) for one in pair]))
    mean: Array = np.concatenate(found, axis=1).mean(axis=1)
    return mean
