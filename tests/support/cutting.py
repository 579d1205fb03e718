"""Cut a file's meshes into one mesh for each primitive, and give those skins of their own."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np

from fixtures.builder import JsonObject, pack_glb
from tests.support.gltf_reading import read
from tests.support.models import rewritten


def cut_into_meshes(source: Path, target: Path, *, own_skins: bool = False) -> Path:
    """Write a file in which every primitive is a mesh, drawn by a copy of its node.

    The order of primitives stays. With ``own_skins`` every mesh but the first of a node has an equal copy of
    the skin.
    """
    model = read(source)
    meshes: list[JsonObject] = []
    nodes: list[JsonObject] = model.content["nodes"]
    for node in [node for node in nodes if "mesh" in node]:
        mesh = model.content["meshes"][node["mesh"]]
        for number, primitive in enumerate(mesh["primitives"]):
            meshes.append({**mesh, "primitives": [primitive]})
            part = node if number == 0 else copy.deepcopy(node)
            part["mesh"] = len(meshes) - 1
            if number:
                nodes.append(part)
                model.content["scenes"][0]["nodes"].append(len(nodes) - 1)
                if own_skins:
                    model.content["skins"].append(copy.deepcopy(model.content["skins"][node["skin"]]))
                    part["skin"] = len(model.content["skins"]) - 1
    model.content["meshes"] = meshes
    return rewritten(model, target)


def halved(source: Path, target: Path) -> Path:
    """Write a GLB whose first primitive is two, each with its half of the triangles, over the same vertices.

    The cut runs where the triangles' mean height is the median's: across arms, trunk or legs.
    """
    model = read(source)
    [primitive] = model.content["meshes"][0]["primitives"]
    triangles = model.triangles()
    heights = model.attribute("POSITION")[triangles].mean(axis=1)
    along = np.ptp(heights, axis=0).argmax()
    upper = heights[:, along] > np.median(heights[:, along])
    binary = bytearray(model.binary_chunk or b"")
    parts = []
    for chosen in (~upper, upper):
        binary += bytes(-len(binary) % 4)
        data = triangles[chosen].astype("<u4").tobytes()
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": 34963}
        binary += data
        model.content["bufferViews"].append(view)
        number = len(model.content["bufferViews"]) - 1
        count = 3 * int(np.count_nonzero(chosen))
        accessor = {"bufferView": number, "componentType": 5125, "count": count, "type": "SCALAR"}
        model.content["accessors"].append(accessor)
        parts.append({**primitive, "indices": len(model.content["accessors"]) - 1})
    model.content["meshes"][0]["primitives"] = parts
    model.content["buffers"][0]["byteLength"] = len(binary)
    target.write_bytes(pack_glb(model.content, bytes(binary)))
    return target
