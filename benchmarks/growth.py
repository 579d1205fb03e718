"""Show that time and memory grow with a file's bytes: hostile families, each at four doubling sizes.

Usage: python -m benchmarks.growth [--family NAME]... [--kib SIZE]

Each family makes one thing as numerous as a file of so many bytes can have it: primitives that share their
accessors, buffer views of one Draco stream, channels of one sampler. Every command runs in a child, whose
processor time and peak memory are taken; "refused" is exit 3. The last column is the largest factor by which
a doubling of the bytes multiplies the memory, or a time of more than 0.5 s: 2 is linear. Up to the bounds of
docs/reference/limits.md some families grow faster than their bytes. Beyond them they are refused at once.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np

from fixtures.builder import pack_glb
from skinbake.cli.main import main as main_command

SIZES, SMALLEST = 4, 32
"""Sizes of each family, and KiB of the first."""

WARM = (
    "skinbake.jobs.bake",
    "skinbake.commands.verify",
    "skinbake.cli.strip",
    "igl",
    "scipy.spatial",
)
"""Modules that are imported before children are made: their time is not the file's."""

NOTICEABLE = 0.5
"""Seconds of a processor. The growth of a shorter time cannot be seen."""

PNG_MAGIC, NAMED_BYTES = b"\x89PNG\r\n\x1a\n", 1 << 16
"""How a PNG begins, and the bytes of an image that is named often."""

PATIENCE = 60
"""Seconds of a processor after which a child is given up."""

Content = dict[str, Any]
COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
CODES = {"<f4": 5126, "<u4": 5125, "|u1": 5121, "<u2": 5123}


class Scene:
    """A GLB in the making, with one skinned mesh unless a family says otherwise."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.beside: dict[str, bytes] = {}
        self.json: Content = {
            "asset": {"version": "2.0"},
            "bufferViews": [],
            "accessors": [],
            "meshes": [{"primitives": []}],
            "nodes": [{"mesh": 0, "skin": 0}, {}],
            "skins": [{"joints": [1]}],
        }

    def view(self, data: bytes) -> int:
        """Add a buffer view."""
        self.data += bytes(-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str, kind: str) -> int:
        """Add an accessor with a buffer view of its own."""
        array = np.ascontiguousarray(values, dtype=dtype)
        count = array.size // COMPONENTS[kind]
        entry = {"bufferView": self.view(array.tobytes()), "componentType": CODES[dtype], "count": count}
        self.json["accessors"].append({**entry, "type": kind})
        return len(self.json["accessors"]) - 1

    def surface(self, side: int) -> Content:
        """Add the accessors of a wavy sheet of side × side vertices, and return its primitive."""
        u, v = (axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
        corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
        triangles = np.stack(
            [corner, corner + side, corner + 1, corner + 1, corner + side, corner + side + 1], axis=1
        )
        return self.primitive(np.stack([u, np.sin(u + v), v], axis=1), triangles)

    def primitive(self, positions: Any, triangles: Any, normals: Any = (0, 1, 0)) -> Content:
        """Add the accessors of a surface bound to joint 0, and return its primitive."""
        count = len(positions)
        weights, joints = np.zeros((count, 4)), np.zeros((count, 4))
        weights[:, 0] = 1
        attributes = {
            "POSITION": self.accessor(positions, "<f4", "VEC3"),
            "NORMAL": self.accessor(np.broadcast_to(normals, (count, 3)), "<f4", "VEC3"),
            "JOINTS_0": self.accessor(joints, "|u1", "VEC4"),
            "WEIGHTS_0": self.accessor(weights, "<f4", "VEC4"),
        }
        return {"attributes": attributes, "indices": self.accessor(triangles, "<u4", "SCALAR")}

    def draw(self, primitives: list[Content]) -> Scene:
        """Make these the primitives of mesh 0."""
        self.json["meshes"][0]["primitives"] = primitives
        return self

    def written(self, path: Path) -> Path:
        """Write the GLB, and the files beside it that it names."""
        for name, content in self.beside.items():
            path.with_name(name).write_bytes(content)
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        path.write_bytes(pack_glb(self.json, bytes(self.data)))
        return path


def _side(size: int, bytes_each: int = 72) -> int:
    return max(3, int((size / bytes_each) ** 0.5))


def plain(size: int) -> Scene:
    scene = Scene()
    return scene.draw([scene.surface(_side(size))])


def shared_accessors(size: int) -> Scene:
    scene = Scene()
    one = scene.surface(_side(size // 2))
    return scene.draw([one] * (size // 2 // len(json.dumps(one))))


def own_triangles(size: int) -> Scene:
    """Make many small primitives."""
    scene = Scene()
    one = scene.surface(3)
    return scene.draw([one] * (size // len(json.dumps(one))))


def many_meshes(size: int) -> Scene:
    scene = Scene()
    one = scene.surface(3)
    each = len(json.dumps([{"primitives": [one]}, {"mesh": 10000, "skin": 0}]))
    scene.json["meshes"] = [{"primitives": [one]}] * (size // each)
    scene.json["nodes"] = [{}, {}, *({"mesh": mesh, "skin": 0} for mesh in range(size // each))]
    return scene


def many_skins(size: int) -> Scene:
    """Make one mesh drawn by many skins."""
    scene = Scene()
    scene.draw([scene.surface(_side(size // 2))])
    count = size // 2 // 45
    scene.json["skins"] = [{"joints": [1]}] * count
    scene.json["nodes"] = [{}, {}, *({"mesh": 0, "skin": skin} for skin in range(count))]
    return scene


def deep_joints(size: int) -> Scene:
    """Make a chain of nodes, and many skins of its last."""
    scene = Scene()
    scene.draw([scene.surface(3)])
    depth, skins = size // 2 // 20, size // 2 // 50
    chain = [{"children": [node + 1]} for node in range(depth - 1)]
    scene.json["nodes"] = [*chain, {}, *({"mesh": 0, "skin": skin} for skin in range(skins))]
    scene.json["skins"] = [{"joints": [depth - 1]}] * skins
    return scene


def many_joints(size: int) -> Scene:
    scene = Scene()
    scene.draw([scene.surface(3)])
    count = size // 12
    scene.json["nodes"] += [{}] * count
    scene.json["skins"] = [{"joints": list(range(1, count))}]
    return scene


def joint_chain(size: int) -> Scene:
    """Make a chain of joints, and a surface that hangs on its last two."""
    scene = Scene()
    one = scene.surface(_side(size // 2))
    count, joints = scene.json["accessors"][0]["count"], size // 2 // 30
    bound, share = np.tile([0, 1, 0, 0], (count, 1)), np.linspace(0, 1, count)
    one["attributes"]["JOINTS_0"] = scene.accessor(bound, "|u1", "VEC4")
    one["attributes"]["WEIGHTS_0"] = scene.accessor(
        np.stack([share, 1 - share, 0 * share, 0 * share], axis=1), "<f4", "VEC4"
    )
    scene.json["nodes"] = [
        {"mesh": 0, "skin": 0},
        *({"children": [node + 1]} for node in range(1, joints)),
        {},
    ]
    scene.json["skins"] = [{"joints": list(range(joints, 0, -1))}]
    return scene.draw([one])


def _animated(scene: Scene, channels: int, clips: int, keys: int) -> Scene:
    times = scene.accessor(np.arange(keys), "<f4", "SCALAR")
    turns = scene.accessor(np.tile([0.0, 0, 0, 1], (keys, 1)), "<f4", "VEC4")
    channel = {"sampler": 0, "target": {"node": 1, "path": "rotation"}}
    clip = {"channels": [channel] * channels, "samplers": [{"input": times, "output": turns}]}
    scene.json["animations"] = [clip] * clips
    return scene


def many_channels(size: int) -> Scene:
    scene = Scene()
    scene.draw([scene.surface(3)])
    return _animated(scene, size // 2 // 62, 1, size // 2 // 20)


def many_clips(size: int) -> Scene:
    scene = Scene()
    scene.draw([scene.surface(_side(size // 2))])
    return _animated(scene, 1, size // 2 // 130, 2)


def many_sets(size: int) -> Scene:
    """Give as many influence sets as are taken, all of one accessor."""
    scene = Scene()
    one = scene.surface(_side(size))
    sets = {
        f"{kind}_{n}": one["attributes"][f"{kind}_0"] for n in range(64) for kind in ("JOINTS", "WEIGHTS")
    }
    return scene.draw([{**one, "attributes": {**one["attributes"], **sets}}])


def fan(size: int) -> Scene:
    """Make triangles round one point, of which each has a copy of its own."""
    scene = Scene()
    count = size // 150
    angles = 2 * np.pi * np.arange(count + 1) / (count + 1)
    rim = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    positions = np.concatenate([np.zeros((count, 3)), rim])
    triangles = np.stack([np.arange(count), count + 1 + np.arange(count), count + np.arange(count)], axis=1)
    return scene.draw([scene.primitive(positions, triangles)])


def crowd(size: int) -> Scene:
    """Make triangles that share a point, each with another normal there."""
    scene = fan(size)
    count = size // 150
    turns = np.linspace(0, 0.2, 2 * count + 1)
    normals = np.stack([np.sin(turns), np.cos(turns), 0 * turns], axis=1)
    scene.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = scene.accessor(normals, "<f4", "VEC3")
    return scene


def sparse_targets(size: int) -> Scene:
    """Make morph targets of which each claims zeros for every vertex."""
    scene = Scene()
    one = scene.surface(_side(size // 2))
    count = scene.json["accessors"][0]["count"]
    index, value = scene.view(b"\0\0\0\0"), scene.view(bytes(12))
    sparse = {
        "count": 1,
        "indices": {"bufferView": index, "componentType": 5125},
        "values": {"bufferView": value},
    }
    target = {"componentType": 5126, "count": count, "type": "VEC3", "sparse": sparse}
    targets = size // 2 // (len(json.dumps(target)) + 24)
    first = len(scene.json["accessors"])
    scene.json["accessors"] += [target] * targets
    one["targets"] = [{"POSITION": first + number} for number in range(targets)]
    return scene.draw([one])


def draco_views(size: int) -> Scene:
    """Make primitives that share accessors, each with a buffer view of its own of one Draco stream."""
    scene = Scene()
    one = scene.surface(_side(size // 2, 24))
    count, corners = scene.json["accessors"][0]["count"], scene.json["accessors"][4]["count"]
    views, start = scene.json["bufferViews"], scene.json["bufferViews"][0]
    points, faces = (
        np.frombuffer(scene.data, dtype, view["byteLength"] // 4, view["byteOffset"]).reshape(-1, 3)
        for dtype, view in (("<f4", start), ("<u4", views[4]))
    )
    arrays = {"quantization_bits": 0, "preserve_order": True, "compression_level": 1}
    stream = DracoPy.encode(points.copy(), faces.copy(), **arrays)
    unique = DracoPy.decode(stream).attributes[0]["unique_id"]
    made = Scene()
    for source in (0, 1, 2, 3, 4):
        entry = dict(scene.json["accessors"][source])
        if source in (0, 4):
            del entry["bufferView"]
        else:
            view = views[source]
            data = bytes(scene.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
            entry["bufferView"] = made.view(data)
        made.json["accessors"].append(entry)
    where = made.json["bufferViews"][made.view(stream)]
    primitives = []
    for _ in range(size // 2 // 320):
        made.json["bufferViews"].append(dict(where))
        extension = {"bufferView": len(made.json["bufferViews"]) - 1, "attributes": {"POSITION": unique}}
        primitives.append({**one, "extensions": {"KHR_draco_mesh_compression": extension}})
    made.json["extensionsUsed"] = made.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    assert count and corners
    return made.draw(primitives)


def shared_note(size: int) -> Scene:
    """Make primitives that share the metadata of a bake, in the extras of an accessor, with many entries."""
    scene = Scene()
    one = scene.surface(3)
    note = {"version": 1, "alpha": ["A"] * (size // 2 // 5)}
    scene.json["accessors"][0]["extras"] = {"skinbake": note}
    return scene.draw([one] * (size // 2 // len(json.dumps(one))))


def former_influences(size: int) -> Scene:
    """Make primitives that share large influences, of which a bake is said to have kept the former ones."""
    scene = Scene()
    one = scene.surface(_side(size // 2))
    note = {"version": 1, "adopted": {}, "digest": {}}
    scene.json["accessors"][2]["extras"] = {"skinbake": note}
    return scene.draw([one] * (size // 2 // len(json.dumps(one))))


def former_streams(size: int) -> Scene:
    """Make primitives that share a Draco stream, and another one that a bake is said to have replaced."""
    scene = draco_views(size // 2)
    views, primitives = scene.json["bufferViews"], scene.json["meshes"][0]["primitives"]
    first = primitives[0]["extensions"]["KHR_draco_mesh_compression"]
    start = views[first["bufferView"]]
    stream = bytes(scene.data[start["byteOffset"] : start["byteOffset"] + start["byteLength"]])
    before = {**first, "bufferView": scene.view(stream)}
    extension = {**first, "extras": {"skinbake": {"before": before}}}
    note = {"extras": {"skinbake": {"version": 1}}}
    one = {**primitives[0], **note, "extensions": {"KHR_draco_mesh_compression": extension}}
    return scene.draw([one] * (size // 2 // len(json.dumps(one))))


def many_views(size: int) -> Scene:
    """Make a buffer with many views."""
    scene = Scene()
    primitives = [scene.surface(3) for _ in range(size // 2000)]
    return scene.draw(primitives)


def named_images(size: int) -> Scene:
    """Make many textures, each of an image of its own, which all name one file."""
    scene = Scene()
    scene.draw([scene.surface(3)])
    scene.beside["a.png"] = PNG_MAGIC.ljust(NAMED_BYTES, b"\0")
    count = size // 32
    scene.json["images"] = [{"uri": "a.png"}] * count
    scene.json["textures"] = [{"source": image} for image in range(count)]
    return scene


FAMILIES: dict[str, Callable[[int], Scene]] = {
    made.__name__: made
    for made in (
        plain,
        shared_accessors,
        own_triangles,
        many_meshes,
        many_skins,
        deep_joints,
        many_joints,
        joint_chain,
        many_channels,
        many_clips,
        many_sets,
        fan,
        crowd,
        sparse_targets,
        draco_views,
        shared_note,
        former_influences,
        former_streams,
        many_views,
        named_images,
    )
}

COMMANDS = {
    "bake": ["bake", "{source}", "-o", "{baked}"],
    "verify": ["verify", "{baked}"],
    "strip": ["strip", "{baked}", "-o", "{other}"],
    "inspect": ["inspect", "{source}"],
}

STRIP_AS_IT_IS = {"strip as it is": ["strip", "{source}", "-o", "{other}"]}

MORE_COMMANDS = {
    "named_images": {"bake --pack": ["bake", "--pack", "{source}", "-o", "{other}"]},
    "shared_note": STRIP_AS_IT_IS,
    "former_influences": STRIP_AS_IT_IS,
    "former_streams": STRIP_AS_IT_IS,
}
"""Commands for some families only. The others strip the new bake, which has none of the old metadata."""


@dataclass(frozen=True)
class Run:
    """The time and memory of one command on one file."""

    seconds: float
    mebibytes: float
    code: int | None

    def __str__(self) -> str:
        """Read like ``1.2 s, 80 MiB``."""
        verdict = {3: " refused", None: " gave up"}.get(self.code, "")
        return f"{self.seconds:.2f} s {self.mebibytes:.0f} MiB{verdict}"


def run(command: list[str]) -> Run:
    """Run skinbake in a child of this process, which has all that it imports."""
    start = time.perf_counter()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE))
        os._exit(_done(command))
    _, status, usage = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    spent = min(usage.ru_utime + usage.ru_stime, time.perf_counter() - start)
    return Run(spent, usage.ru_maxrss / 1024, None if code < 0 else code)


def _done(command: list[str]) -> int:
    """Run skinbake here, without a word, and return its exit code."""
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    try:
        main_command([*command, "-q"], standalone_mode=False)
    except SystemExit as leaving:
        return int(leaving.code or 0)
    return 0


def table(families: list[str], smallest: int) -> Iterator[str]:
    """Yield the lines of the table as they come."""
    yield (
        "| family, command | "
        + " | ".join(f"{smallest << step} KiB" for step in range(SIZES))
        + " | a doubling |"
    )
    yield "|---|" + "---|" * SIZES + "---|"
    with tempfile.TemporaryDirectory() as folder:
        for family in families:
            commands = COMMANDS | MORE_COMMANDS.get(family, {})
            found: dict[str, list[Run]] = {name: [] for name in commands}
            for step in range(SIZES):
                paths = {name: Path(folder, f"{name}.glb") for name in ("source", "baked", "other")}
                for path in paths.values():
                    path.unlink(missing_ok=True)
                FAMILIES[family](smallest << 10 + step).written(paths["source"])
                for name, command in commands.items():
                    there = name not in {"verify", "strip"} or paths["baked"].exists()
                    kept = paths if there else {**paths, "baked": paths["source"]}
                    found[name].append(run([part.format(**kept) for part in command]))
            for name, runs in found.items():
                yield f"| {family}, {name} | {' | '.join(map(str, runs))} | {growth(runs):.1f} |"


def growth(runs: list[Run]) -> float:
    """Return what a doubling costs at most, in time or memory, 1 where nothing is noticeable."""
    steps = list(pairwise(runs))
    times = [after.seconds / before.seconds for before, after in steps if after.seconds > NOTICEABLE]
    return max([1.0, *times, *(after.mebibytes / before.mebibytes for before, after in steps)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--family", action="append", choices=list(FAMILIES))
    parser.add_argument("--kib", type=int, default=SMALLEST, help="the smallest size")
    chosen = parser.parse_args()
    for module in WARM:
        importlib.import_module(module)
    for line in table(chosen.family or list(FAMILIES), chosen.kib):
        print(line, flush=True)


if __name__ == "__main__":
    main()
