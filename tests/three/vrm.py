"""Characters of VRM 0 and 1 for three-vrm: fixtures with a humanoid, MToon and expressions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.support.baked_files import Editable

LIMBS = ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
HUMAN_BONES = ("hips", "spine", "head", *(f"{side}{limb}" for side in ("left", "right") for limb in LIMBS))
"""The bones without which three-vrm refuses a file."""
EXPRESSIONS = ("aa", "ih")
"""Each has all of one morph target."""
OUTLINE = 0.01
WAYS = ("HorizontalInner", "HorizontalOuter", "VerticalDown", "VerticalUp")
STRAIGHT = [0, 0, 0, 1, 1, 1, 1, 0]
"""The one curve of VRM 0 that three-vrm has, by which eyes turn."""

JsonObject = dict[str, Any]


def as_vrm(source: Path, target: Path, version: int) -> Path:
    """Write a character of two morph targets as VRM: its bones are empty nodes beside the skeleton."""
    file = Editable(source)
    content = file.content
    (mesh_node,) = (number for number, node in enumerate(content["nodes"]) if "mesh" in node)
    bones = {}
    for name in HUMAN_BONES:
        bones[name] = len(content["nodes"])
        content["nodes"].append({"name": name})
    content["scenes"][0]["nodes"].extend(bones.values())
    content["materials"] = [{"name": "skin"}]
    file.primitive()["material"] = 0
    write = {0: _write_vrm_0, 1: _write_vrm_1}[version]
    write(content, bones, mesh_node)
    return file.write(target)


def _write_vrm_0(content: JsonObject, bones: dict[str, int], mesh_node: int) -> None:
    mesh = content["nodes"][mesh_node]["mesh"]
    groups = [
        {
            "name": name,
            "presetName": {"aa": "a", "ih": "i"}[name],
            "binds": [{"mesh": mesh, "index": number, "weight": 100}],
        }
        for number, name in enumerate(EXPRESSIONS)
    ]
    material = {
        "name": content["materials"][0].get("name", ""),
        "shader": "VRM/MToon",
        "renderQueue": 2000,
        "floatProperties": {"_OutlineWidthMode": 1, "_OutlineWidth": 100 * OUTLINE},
        "vectorProperties": {},
        "textureProperties": {},
        "keywordMap": {},
        "tagMap": {"RenderType": "Opaque"},
    }
    extension = {
        "specVersion": "0.0",
        "meta": {"title": "bent tube"},
        "humanoid": {"humanBones": [{"bone": name, "node": node} for name, node in bones.items()]},
        "firstPerson": {f"lookAt{way}": {"curve": STRAIGHT} for way in WAYS},
        "blendShapeMaster": {"blendShapeGroups": groups},
        "secondaryAnimation": {"boneGroups": [], "colliderGroups": []},
        "materialProperties": [material],
    }
    _use(content, "VRM", extension)


def _write_vrm_1(content: JsonObject, bones: dict[str, int], mesh_node: int) -> None:
    preset = {
        name: {"morphTargetBinds": [{"node": mesh_node, "index": number, "weight": 1.0}]}
        for number, name in enumerate(EXPRESSIONS)
    }
    extension = {
        "specVersion": "1.0",
        "meta": {"name": "bent tube", "authors": ["-"], "licenseUrl": "https://vrm.dev/licenses/1.0/"},
        "humanoid": {"humanBones": {name: {"node": node} for name, node in bones.items()}},
        "expressions": {"preset": preset},
    }
    _use(content, "VRMC_vrm", extension)
    mtoon = {"specVersion": "1.0", "outlineWidthMode": "worldCoordinates", "outlineWidthFactor": OUTLINE}
    content["extensionsUsed"].append("VRMC_materials_mtoon")
    content["materials"][0]["extensions"] = {"VRMC_materials_mtoon": mtoon}


def _use(content: JsonObject, name: str, extension: JsonObject) -> None:
    content.setdefault("extensions", {})[name] = extension
    content.setdefault("extensionsUsed", []).append(name)
