"""Read compressed files with the reference decoders (npm packages draco3dgltf and meshoptimizer)."""

from __future__ import annotations

import base64
import copy
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pygltflib

from tests.support.gltf_reading import DRACO, MESHOPT, GltfFile, JsonObject, read
from tests.support.node import Script
from tests.support.node import require_node as _require_node

DECODERS = Script("decompress.mjs", "draco3dgltf", "meshoptimizer")


def require_node() -> str:
    """Return the path of node where the decoders can run; else skip, or fail under SKINBAKE_STRICT=1."""
    return _require_node("draco3dgltf", "meshoptimizer")


def read_plain(path: Path) -> GltfFile:
    """Read one file with its compressed geometry decoded."""
    return read_plain_many([path])[path]


def read_plain_many(paths: Iterable[Path]) -> dict[Path, GltfFile]:
    """Read files; the keys are the paths as given.

    Each is as if it had never been compressed: the accessors that Draco holds and the buffer views that
    meshopt compressed have ordinary data, in a buffer of its own at the end. Raises ValueError where a file
    cannot be decoded. Files without compression need no node.
    """
    models = {path: read(path) for path in dict.fromkeys(paths)}
    wanted = [path for path, model in models.items() if is_compressed(model.content)]
    for path, answer in zip(wanted, DECODERS.ask_about(wanted), strict=True):
        models[path] = _plain(models[path], answer)
    return models


def is_compressed(content: JsonObject) -> bool:
    """Say whether a file names one of the compressions."""
    return bool({DRACO, *MESHOPT} & set(content.get("extensionsUsed", [])))


def _plain(model: GltfFile, answer: dict[str, Any]) -> GltfFile:
    if "failure" in answer:
        raise ValueError(f"{model.path}: {answer['failure']}")
    content = copy.deepcopy(model.content)
    data = bytearray()

    def placed(raw: str) -> JsonObject:
        decoded = base64.b64decode(raw)
        offset = len(data)
        data.extend(decoded + bytes(-len(decoded) % 4))
        return {"buffer": len(model.content["buffers"]), "byteOffset": offset, "byteLength": len(decoded)}

    for number, raw in answer["views"].items():
        view = content["bufferViews"][int(number)]
        del view["extensions"]
        view |= placed(raw)
    for entry in answer["primitives"]:
        primitive = content["meshes"][entry["mesh"]]["primitives"][entry["primitive"]]
        del primitive["extensions"][DRACO]
        for name, raw in entry["attributes"].items():
            _point(content, primitive["attributes"][name], placed(raw))
        _point(content, primitive["indices"], placed(entry["indices"]))
        content["accessors"][primitive["indices"]]["componentType"] = pygltflib.UNSIGNED_INT
    uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(data)).decode("ascii")
    content["buffers"].append({"byteLength": len(data), "uri": uri})
    return GltfFile(model.path, content, model.binary_chunk)


def _point(content: JsonObject, accessor: int, view: JsonObject) -> None:
    content["bufferViews"].append(view)
    content["accessors"][accessor] |= {"bufferView": len(content["bufferViews"]) - 1, "byteOffset": 0}
