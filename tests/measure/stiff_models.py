"""Small models whose fit may be worse than standard lighting: stiff robots, spring chains, six vertices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pygltflib as gltf

from fixtures.builder import Model
from tests.support.baked_files import Editable

Array = npt.NDArray[Any]
FRAMES = 24


class Mesh(NamedTuple):
    """The arrays of a primitive, and the origins (J, 3) of the joints, which hang on each other."""

    positions: Array
    normals: Array
    triangles: Array
    joints: Array
    weights: Array
    origins: Array


class Motion(NamedTuple):
    """What a clip does to a joint: one value of a property for each of ``FRAMES`` frames."""

    joint: int
    path: str
    values: Array


def write(path: Path, mesh: Mesh, motions: Sequence[Motion] = ()) -> Path:
    """Write a model of one mesh, with a clip if there are motions."""
    model = Model()
    attributes: dict[str, Array] = {
        "POSITION": mesh.positions.astype(np.float32),
        "NORMAL": mesh.normals.astype(np.float32),
        "JOINTS_0": mesh.joints.astype(np.uint16),
        "WEIGHTS_0": mesh.weights.astype(np.float32),
    }
    material = model.add_material("grey", (0.5, 0.5, 0.5))
    primitive = model.add_primitive(attributes, mesh.triangles, material=material)
    model.add_root(gltf.Node(mesh=model.add_mesh("stiff", [primitive]), skin=0))
    model.add_joint_chain("joint", mesh.origins)
    if motions:
        times = model.add_accessor(np.arange(FRAMES, dtype=np.float32) / np.float32(24.0), bounds=True)
        outputs = [model.add_accessor(motion.values.astype(np.float32)) for motion in motions]
        samplers = [
            gltf.AnimationSampler(input=times, output=output, interpolation="LINEAR") for output in outputs
        ]
        channels = [
            gltf.AnimationChannel(
                sampler=number, target=gltf.AnimationChannelTarget(node=1 + motion.joint, path=motion.path)
            )
            for number, motion in enumerate(motions)
        ]
        model.document.animations.append(gltf.Animation(name="clip", samplers=samplers, channels=channels))
    path.write_bytes(model.to_glb())
    return path


def smooth(positions: Array, triangles: Array) -> Array:
    """Return the normals of vertices, weighted by area."""
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    across, normals = np.cross(b - a, c - a), np.zeros_like(positions)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], across)
    unit: Array = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def turns(generator: np.random.Generator, joints: int, degrees: float) -> Iterator[Motion]:
    """Yield a swing about a random axis for each joint."""
    for joint in range(joints):
        axis = generator.normal(size=3)
        axis /= np.linalg.norm(axis)
        half = np.radians(degrees / 2) * np.sin(np.linspace(0, 2 * np.pi, FRAMES) + generator.uniform(0, 6))
        yield Motion(joint, "rotation", np.column_stack([np.sin(half)[:, None] * axis, np.cos(half)]))


def stretches(generator: np.random.Generator, origins: Array) -> Iterator[Motion]:
    """Yield moves of each joint along its bone, by up to 0.4 of its length, as springs do."""
    for joint, bone in enumerate(np.diff(origins, axis=0, prepend=np.zeros((1, 3)))):
        wave = 1.0 + 0.4 * np.sin(np.linspace(0, 2 * np.pi, FRAMES) + generator.uniform(0, 6))
        yield Motion(joint, "translation", wave[:, None] * bone)


def scales(generator: np.random.Generator, joints: int, amount: float = 0.15) -> Iterator[Motion]:
    """Yield uneven scales of each joint."""
    for joint in range(joints):
        waves = np.linspace(0, 2 * np.pi, FRAMES)[:, None] + generator.uniform(0, 6, 3)
        yield Motion(joint, "scale", 1.0 + amount * np.sin(waves))


def robot(generator: np.random.Generator, count: int | None = None) -> Mesh:
    """Return boxes, one for each joint, of which a few corners belong to a second joint too.

    Half of the robots have hard edges. count is the number of boxes, 3 to 7 if it is None.
    """
    count = int(generator.integers(3, 8)) if count is None else count
    is_hard = bool(generator.random() < 0.5)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) - 0.5
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([[f[0], f[1], f[2], f[0], f[2], f[3]] for f in faces]).reshape(-1, 3)
    rows = triangles.ravel() if is_hard else np.arange(8)
    positions, joints, weights = [], [], []
    for joint in range(count):
        own, share = np.zeros((8, 4), dtype=int), np.zeros((8, 4))
        own[:, 0], share[:, 0] = joint, 1.0
        for corner in np.flatnonzero(generator.random(8) < 0.15):
            own[corner, 1] = joint + 1 if joint == 0 else joint - 1
            part = generator.uniform(0.1, 0.6)
            share[corner, :2] = 1.0 - part, part
        box = corners * generator.uniform(0.3, 1.0, 3) + [0, 0, joint + 0.5]
        positions.append(box[rows])
        joints.append(own[rows])
        weights.append(share[rows])
    of_box = np.arange(36).reshape(-1, 3) if is_hard else triangles
    indices = np.concatenate([of_box + len(rows) * joint for joint in range(count)])
    points = np.concatenate(positions)
    origins = np.column_stack([np.zeros((count, 2)), np.arange(count)])
    return Mesh(
        points, smooth(points, indices), indices, np.concatenate(joints), np.concatenate(weights), origins
    )


def spring(generator: np.random.Generator) -> Mesh:
    """Return an open prism of 60 vertices on a chain of joints, with smooth weights."""
    rings = int(generator.choice([10, 12, 15, 20]))
    sides, joints = 60 // rings, int(generator.integers(4, rings + 1))
    length, radius = generator.uniform(2.0, 8.0), generator.uniform(0.1, 0.4)
    around = np.tile(np.arange(sides) * 2 * np.pi / sides, rings)
    up = np.repeat(np.linspace(0.0, length, rings), sides)
    outward = np.column_stack([np.cos(around), np.sin(around), np.zeros(60)])
    ring, side = np.divmod(np.arange(60 - sides), sides)
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    triangles = np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)])
    bone, spread = length / joints, generator.uniform(0.3, 1.5)
    middles = (np.arange(joints) + 0.5) * bone
    falling = np.exp(-2.0 * np.square((middles - up[:, None]) / (bone * spread)))
    order = np.argsort(-falling, axis=1)[:, :4]
    shares = np.take_along_axis(falling, order, axis=1)
    origins = np.column_stack([np.zeros((joints, 2)), np.arange(joints) * bone])
    positions = radius * outward + up[:, None] * [0, 0, 1]
    return Mesh(positions, outward, triangles, order, shares / shares.sum(axis=1, keepdims=True), origins)


def six_vertices(generator: np.random.Generator) -> Mesh:
    """Return two quads, one above the other, as the generator of glTF's test assets makes them."""
    height, bent = generator.uniform(0.3, 1.0), bool(generator.random() < 0.5)
    positions = np.array([[x, y * height, 0.0] for y in (0, 1, 2) for x in (-0.3, 0.3)])
    positions[:, 2] = generator.uniform(-0.2, 0.2, 6) * bent
    triangles = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]])
    joints, weights = np.zeros((6, 4), dtype=int), np.zeros((6, 4))
    joints[:, 1] = 1
    part = np.repeat(generator.uniform(0.0, 1.0, 3), 2)
    weights[:, :2] = np.column_stack([1 - part, part])
    origins = np.array([[0.0, 0.0, 0.0], [0.0, height, 0.0]])
    return Mesh(positions, smooth(positions, triangles), triangles, joints, weights, origins)


def with_scaled_joints(source: Path, target: Path, generator: np.random.Generator) -> Path:
    """Write a character whose clips scale every joint unevenly by up to 15 %, in place of what they did."""
    file = Editable(source)
    joints = sorted({joint for skin in file.content["skins"] for joint in skin["joints"]})
    for clip in file.content["animations"]:
        inputs = [file.content["accessors"][sampler["input"]] for sampler in clip["samplers"]]
        length = max(accessor["max"][0] for accessor in inputs)
        times = file.add(np.linspace(0.0, length, FRAMES, dtype=np.float32)[:, None])
        clip["channels"] = [one for one in clip["channels"] if one["target"]["path"] != "scale"]
        for joint, motion in zip(joints, scales(generator, len(joints)), strict=True):
            scale = motion.values * file.content["nodes"][joint].get("scale", [1.0, 1.0, 1.0])
            clip["samplers"].append({"input": times, "output": file.add(scale.astype(np.float32))})
            target_of = {"node": joint, "path": "scale"}
            clip["channels"].append({"sampler": len(clip["samplers"]) - 1, "target": target_of})
    return file.write(target)
