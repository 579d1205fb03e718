"""Models of few parts that files with correctives are made of."""

from __future__ import annotations

import copy
import json
import struct
from pathlib import Path
from typing import Any

from fixtures.make_fixtures import FOLDER
from tests.support import gltf_reading

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
