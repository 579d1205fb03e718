"""glTF documents of a few numbers, written accessor by accessor."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np

from skinbake.gltf.document import Document, parse_gltf
from tests.support.gltf_reading import JsonObject

TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
COMPONENTS = {np.dtype("f4"): 5126, np.dtype("i1"): 5120, np.dtype("u2"): 5123, np.dtype("i2"): 5122}


class Builder:
    """Collects accessors of a glTF document whose one buffer is a data URI."""

    def __init__(self) -> None:
        self.data = b""
        self.json: JsonObject = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}

    def accessor(self, values: object, *, normalized: bool = False) -> int:
        array = np.asarray(values)
        array = array.astype(np.float32) if array.dtype.kind == "f" else array
        array = array.reshape(len(array), -1)
        raw = array.tobytes()
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        self.json["accessors"].append(
            {
                "bufferView": len(self.json["bufferViews"]) - 1,
                "componentType": COMPONENTS[array.dtype],
                "count": len(array),
                "type": TYPES[array.shape[1]],
                "normalized": normalized,
            }
        )
        self.data += raw + b"\0" * (-len(raw) % 4)
        return len(self.json["accessors"]) - 1

    def text(self) -> bytes:
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        buffers = [{"byteLength": len(self.data), "uri": uri}] if self.data else []
        return json.dumps({**self.json, "buffers": buffers}).encode()

    def document(self) -> Document:
        return parse_gltf(self.text(), "small.gltf", Path())


def animate(
    builder: Builder,
    *,
    path: str = "rotation",
    node: int | None = 3,
    method: str | None = "LINEAR",
    times: object = (0.0, 1.0, 2.5),
    values: object = ((0.0, 0.0, 0.0, 1.0), (0.0, 0.6, 0.0, 0.8), (0.8, 0.0, 0.0, 0.6)),
    normalized: bool = False,
) -> None:
    """Add a clip of one channel."""
    sampler: JsonObject = {
        "input": builder.accessor(np.array(times)),
        "output": builder.accessor(np.array(values), normalized=normalized),
    }
    if method is not None:
        sampler["interpolation"] = method
    target = {"path": path} if node is None else {"path": path, "node": node}
    builder.json.setdefault("animations", []).append(
        {"samplers": [sampler], "channels": [{"sampler": 0, "target": target}]}
    )
