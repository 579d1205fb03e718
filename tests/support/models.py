"""Files for these tests: fixtures copied and edited, sheets made to order; and what a bake may add."""

from __future__ import annotations

import base64
import copy
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib

from fixtures import builder, make_fixtures
from fixtures.builder import AnyArray, JsonObject, Model, pack_glb
from skinbake.commands.strip import strip_file
from skinbake.report.bake import FileResult
from tests.support.baking import bake_file
from tests.support.gltf_reading import GltfFile, read

FOLDER = make_fixtures.FOLDER
FIXTURES = sorted(path.name for path in FOLDER.iterdir() if path.suffix in (".glb", ".gltf"))
SHARED, SHARED_BIN = "shared_accessors.gltf", "shared accessors.bin"
KEY = "skinbake"

Change = Callable[[JsonObject], object]


def copied(name: str, folder: Path) -> Path:
    """Copy a fixture, and the buffer beside it, into a folder."""
    folder.mkdir(exist_ok=True)
    if name == SHARED:
        shutil.copyfile(FOLDER / SHARED_BIN, folder / SHARED_BIN)
    shutil.copyfile(FOLDER / name, folder / name)
    return folder / name


def edited(name: str, folder: Path, change: Change) -> Path:
    """Copy a fixture with its JSON changed."""
    path = copied(name, folder)
    model = read(path)
    change(model.content)
    return rewritten(model, path)


def rewritten(model: GltfFile, path: Path) -> Path:
    """Write a model's JSON, and its BIN chunk for a GLB, to a path."""
    if path.suffix == ".gltf":
        path.write_text(json.dumps(model.content, indent=1), encoding="utf-8")
    else:
        path.write_bytes(pack_glb(model.content, model.binary_chunk or b""))
    return path


@dataclass(frozen=True)
class Part:
    """One primitive to be made; None for ``indices`` makes one without."""

    attributes: Mapping[str, AnyArray]
    indices: AnyArray | None
    mode: int = pygltflib.TRIANGLES


def scaled(path: Path, attribute: str, factor: float, name: str, *, first: int = 0) -> Path:
    """Write a copy of a file with an attribute of floats times a factor, from a vertex on."""
    file = read(path)
    number = file.content["meshes"][0]["primitives"][0]["attributes"][attribute]
    accessor = file.content["accessors"][number]
    view = file.content["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    assert accessor["componentType"] == 5126
    chunk = bytearray(file.binary_chunk or b"")
    values = np.frombuffer(chunk, dtype="<f4", count=3 * accessor["count"], offset=start)
    values[3 * first :] *= np.float32(factor)
    return rewritten(replace(file, binary_chunk=bytes(chunk)), path.with_name(name))


def sheet(**changes: AnyArray | None) -> Part:
    """Make a curved sheet of 5 × 4 vertices and two joints; None takes an attribute away."""
    x, y, triangles = builder.grid(np.linspace(-1, 1, 5), np.linspace(-0.6, 0.6, 4))
    positions, normals, _ = make_fixtures.sheet_surface(x, y)
    joints, weights = make_fixtures.influences(make_fixtures.sheet_weights(x, y, 2))
    attributes: dict[str, AnyArray | None] = {
        "POSITION": positions.astype(np.float32),
        "NORMAL": normals.astype(np.float32),
        "JOINTS_0": joints.astype(np.uint8),
        "WEIGHTS_0": weights.astype(np.float32),
    }
    attributes |= changes
    return Part({name: array for name, array in attributes.items() if array is not None}, triangles)


def in_two_sets(part: Part) -> Part:
    """Return a sheet with the second of its joints in a second set."""
    joints, weights = (np.asarray(part.attributes[name]) for name in ("JOINTS_0", "WEIGHTS_0"))
    second = np.arange(4) == 1
    moved = {"JOINTS_0": joints * ~second, "WEIGHTS_0": weights * ~second}
    moved |= {
        "JOINTS_1": np.roll(joints * second, -1, axis=1),
        "WEIGHTS_1": np.roll(weights * second, -1, axis=1),
    }
    return Part({**part.attributes, **moved}, part.indices)


def tangents_along(part: Part) -> AnyArray:
    """Return TANGENT of a sheet: some direction across its normals."""
    normals = np.asarray(part.attributes["NORMAL"], dtype=np.float64)
    across = np.cross([0.0, 1.0, 0.0], normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.column_stack([across, np.ones(len(across))]).astype(np.float32)


def write_model(path: Path, parts: Sequence[Part], *, joints: int = 2, change: Change | None = None) -> Path:
    """Write one skinned mesh of these parts as .glb, or as .gltf with a data URI."""
    model = Model()
    material = model.add_material("clay", (0.8, 0.4, 0.3))
    primitives = []
    for part in parts:
        indices = np.zeros(3) if part.indices is None else np.asarray(part.indices)
        primitive = model.add_primitive(
            part.attributes, indices.reshape(-1).astype(np.int64), material=material, mode=part.mode
        )
        if part.indices is None:
            primitive.indices = None
        primitives.append(primitive)
    node = model.add_root(pygltflib.Node(name="body", mesh=model.add_mesh("sheet", primitives)))
    origins = np.zeros((joints, 3))
    origins[:, 0] = np.arange(joints)
    model.document.nodes[node].skin = model.add_joint_chain("joint", origins)
    content, data = model.to_json(), bytes(model.data)
    if path.suffix == ".gltf":
        content["buffers"][0]["uri"] = (
            "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        )
    if change is not None:
        change(content)
    return rewritten(GltfFile(path, content, data), path)


def crowd(path: Path, side: int, primitives: int) -> Path:
    """Write primitives that share the accessors of one sheet of side × side vertices, all backed by bytes."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    count = side * side
    arrays: dict[str, AnyArray] = {
        "POSITION": np.stack([u, 0 * u, v], axis=1).astype(np.float32),
        "NORMAL": np.tile(np.array([0, 1, 0], np.float32), (count, 1)),
        "JOINTS_0": np.zeros((count, 4), np.uint8),
        "WEIGHTS_0": np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
    }

    def share(content: JsonObject) -> None:
        content["meshes"][0]["primitives"] *= primitives

    return write_model(path, [sheet(**arrays)], change=share)


def bake(source: Path | str, target: Path | str, **options: Any) -> FileResult:
    """Bake a file, which must succeed, and return what bake says of it."""
    result = bake_file(str(source), str(target), **options)
    assert result.error is None, result.error
    return result


def baked(source: Path, target: Path, **options: Any) -> GltfFile:
    """Bake a file in which something can be baked, and read the result."""
    result = bake(source, target, **options)
    assert result.status == "baked", result.notices
    return read(target)


def stripped(source: Path, target: Path) -> GltfFile:
    """Strip a file without a notice, and read the result."""
    assert strip_file(str(source), str(target)).notices == ()
    return read(target)


def primitives(content: JsonObject) -> Iterator[tuple[int, int, JsonObject]]:
    """Yield mesh number, primitive number and JSON of each primitive."""
    for mesh, entry in enumerate(content.get("meshes", [])):
        for number, primitive in enumerate(entry.get("primitives", [])):
            yield mesh, number, primitive


def note(content: JsonObject, mesh: int = 0, primitive: int = 0) -> JsonObject | None:
    """Return what bake noted of a primitive: in its extras, else in those of its first α accessor."""
    found = content["meshes"][mesh]["primitives"][primitive]
    holders = [found, *(content["accessors"][number] for number in found["attributes"].values())]
    notes = [_members(_members(holder.get("extras")).get(KEY)) for holder in holders]
    ours = [dict(found) for found in notes if "digest" in found]
    assert len(ours) <= 1
    return ours[0] if ours else None


def _members(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def without_additions(before: JsonObject, after: JsonObject) -> JsonObject:
    """Return baked JSON without what bake may add to ``before``; anything else is left for comparison."""
    content = copy.deepcopy(after)
    for mesh, number, primitive in primitives(content):
        found = note(after, mesh, number)
        if found is None:
            continue
        own = before["meshes"][mesh]["primitives"][number]
        for name in dict.fromkeys([*found["alpha"], *found["beta"], *found.get("generated", ())]):
            del primitive["attributes"][name]
        for name, accessor in found.get("adopted", {}).items():
            assert own["attributes"][name] == accessor != primitive["attributes"][name]
            primitive["attributes"][name] = accessor
        extras = primitive.get("extras")
        if isinstance(extras, dict) and KEY not in _members(own.get("extras")):
            del extras[KEY]
            if not extras and "extras" not in own:
                del primitive["extras"]
    for array in ("accessors", "bufferViews", "buffers"):
        if array in before:
            content[array] = content[array][: len(before[array])]
    for old, new in zip(before.get("buffers", []), content.get("buffers", []), strict=True):
        new["byteLength"] = old["byteLength"]
    return content


def assert_only_added(before: GltfFile, after: GltfFile) -> None:
    """Check that a bake left the JSON, its key order and every byte of the buffers as they were."""
    assert json.dumps(without_additions(before.content, after.content)) == json.dumps(before.content)
    assert_buffers_kept(before, after)


def assert_buffers_kept(before: GltfFile, after: GltfFile) -> None:
    """Check that every buffer starts with the bytes it had."""
    for number, buffer in enumerate(before.content.get("buffers", [])):
        if "uri" not in buffer and (number or before.binary_chunk is None):
            continue  # a fallback buffer, which no bytes stand for
        length = buffer["byteLength"]
        assert after.buffer(number)[:length] == before.buffer(number)[:length]


def with_pointers(content: JsonObject) -> None:
    """Have all channels of a file name their nodes by the pointers of KHR_animation_pointer."""
    for animation in content["animations"]:
        for channel in animation["channels"]:
            pointer = "/nodes/{node}/{path}".format(**channel["target"])
            extensions = {"KHR_animation_pointer": {"pointer": pointer}}
            channel["target"] = {"path": "pointer", "extensions": extensions}
    content["extensionsUsed"] = [*content.get("extensionsUsed", []), "KHR_animation_pointer"]
