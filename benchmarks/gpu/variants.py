"""What is measured: the ways to a skinned normal, the buffers of each of their steps, and the bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.gpu.meshes import INFLUENCES, Mesh, Palettes
from skinbake.choices import Encoding, Language, Lighting, Method
from skinbake.format.encodings import common_scale, encoded
from skinbake.shaders.choices import ShaderChoices

VERTEX, INSTANCE, TRIANGLE, NEIGHBOUR, JOINT = "vertex", "posed vertex", "triangle", "neighbour", "joint"
"""What a row of a buffer belongs to. A posed vertex is a vertex of one instance."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A buffer: the type of its elements in WGSL, the bytes of a row, and what a row belongs to."""

    type: str
    row: int
    of: str


LAYOUTS: Mapping[str, Layout] = {
    "position": Layout("f32", 12, VERTEX),
    "normal": Layout("f32", 12, VERTEX),
    "joints": Layout("u32", 4, VERTEX),
    "weights": Layout("vec4<f32>", 16, VERTEX),
    "gradients_float32": Layout("vec2<f32>", 24, VERTEX),
    "gradients_snorm16": Layout("vec2<u32>", 16, VERTEX),
    "gradients_packed8": Layout("u32", 8, VERTEX),
    "matrices": Layout("mat4x4<f32>", 64, JOINT),
    "quaternions": Layout("mat2x4<f32>", 32, JOINT),
    "posed_position": Layout("f32", 12, INSTANCE),
    "posed_frame": Layout("f32", 24, INSTANCE),
    "sums": Layout("i32", 12, INSTANCE),
    "triangles": Layout("u32", 12, TRIANGLE),
    "indices": Layout("u32", 12, TRIANGLE),
    "places": Layout("vec2<u32>", 8, VERTEX),
    "ranges": Layout("vec2<u32>", 8, VERTEX),
    "ring": Layout("u32", 4, NEIGHBOUR),
    "turns": Layout("vec4<f32>", 16, VERTEX),
}

ADJACENCY = ("sums", "triangles", "places", "ranges", "ring")
"""What a recompute needs beside the mesh and its results."""


@dataclass(frozen=True, slots=True)
class Counts:
    """How many rows the buffers of a mesh have."""

    vertices: int
    triangles: int
    neighbours: int
    joints: int
    instances: int

    @classmethod
    def of(cls, mesh: Mesh, palettes: Palettes) -> Counts:
        """Count the rows of a mesh in so many poses."""
        triangles, neighbours = len(mesh.adjacency.triangles), len(mesh.adjacency.ring)
        return cls(len(mesh.positions), triangles, neighbours, palettes.joints, palettes.poses)

    def rows(self, name: str) -> int:
        """Return the rows of a buffer."""
        return {
            VERTEX: self.vertices,
            INSTANCE: self.vertices * self.instances,
            TRIANGLE: self.triangles,
            NEIGHBOUR: self.neighbours,
            JOINT: self.joints * self.instances,
        }[LAYOUTS[name].of]

    def size(self, name: str) -> int:
        """Return the bytes of a buffer."""
        return LAYOUTS[name].row * self.rows(name)

    @property
    def posed(self) -> int:
        """The posed vertices."""
        return self.vertices * self.instances


@dataclass(frozen=True, slots=True)
class Step:
    """One dispatch: its entry point, what has an invocation, and its buffers.

    ``updates`` are both read and written.
    """

    entry: str
    over: str
    reads: tuple[str, ...]
    writes: tuple[str, ...] = ()
    updates: tuple[str, ...] = ()

    @property
    def buffers(self) -> tuple[str, ...]:
        """Return the buffers in the order of their bindings."""
        return self.reads + self.writes + self.updates

    def bytes_moved(self, counts: Counts) -> int:
        """Return the bytes that must move: each buffer once if it is read, and once if it is written."""
        return sum(map(counts.size, self.buffers)) + sum(map(counts.size, self.updates))


@dataclass(frozen=True, slots=True)
class Variant:
    """A way to a skinned normal. choices None recomputes it after linear blending."""

    name: str
    steps: tuple[Step, ...]
    choices: ShaderChoices | None = None

    def bytes_moved(self, counts: Counts) -> int:
        """Return the bytes that the steps must move."""
        return sum(step.bytes_moved(counts) for step in self.steps)

    def adjacency_bytes(self, counts: Counts) -> int:
        """Return the bytes that α and β, or the neighbours, take in memory."""
        names = {name for step in self.steps for name in step.buffers}
        return sum(counts.size(name) for name in names if name in ADJACENCY or "gradients" in name)

    @property
    def reads_when_drawn(self) -> tuple[str, ...]:
        """Return the buffers of the vertex shader, the indices among them."""
        return (*self.steps[0].reads, "indices")

    def bytes_drawn(self, counts: Counts) -> int:
        """Return the bytes that a vertex shader must read. Those of the picture are not among them."""
        return sum(map(counts.size, self.reads_when_drawn))


def _shader(name: str, method: Method, lighting: Lighting, encoding: Encoding = Encoding.FLOAT32) -> Variant:
    choices = ShaderChoices(Language.WGSL, method, lighting, INFLUENCES, encoding=encoding)
    reads = ["position", "normal", "joints", "weights"]
    reads += [f"gradients_{encoding}"] if choices.reads_gradients else []
    reads += ["matrices" if method is Method.LBS else "quaternions"]
    return Variant(name, (Step("main", VERTEX, tuple(reads), ("posed_position", "posed_frame")),), choices)


_SKIN = ("position", "joints", "weights", "matrices")
STANDARD, PACKED8, FLOATS = "LBS standard", "LBS accurate, packed8", "LBS accurate, float32"
SCATTER, GATHER = "LBS recomputed, scatter", "LBS recomputed, gather"
VARIANTS = (
    _shader(STANDARD, Method.LBS, Lighting.STANDARD),
    _shader(FLOATS, Method.LBS, Lighting.ACCURATE),
    _shader("LBS accurate, snorm16", Method.LBS, Lighting.ACCURATE, Encoding.SNORM16),
    _shader(PACKED8, Method.LBS, Lighting.ACCURATE, Encoding.PACKED8),
    Variant(
        SCATTER,
        (
            Step("skin_and_clear", VERTEX, _SKIN, ("posed_position", "sums")),
            Step("scatter", TRIANGLE, ("triangles", "posed_position"), (), ("sums",)),
            Step("resolve", VERTEX, ("places", "turns", "posed_position", "sums"), ("posed_frame",)),
        ),
    ),
    Variant(
        GATHER,
        (
            Step("skin", VERTEX, _SKIN, ("posed_position",)),
            Step("gather", VERTEX, ("ranges", "ring", "turns", "posed_position"), ("posed_frame",)),
        ),
    ),
    _shader("DQS standard", Method.DQS, Lighting.STANDARD),
    _shader("DQS accurate", Method.DQS, Lighting.ACCURATE),
    _shader("DQS exact", Method.DQS, Lighting.EXACT),
)
BY_NAME = {variant.name: variant for variant in VARIANTS}


def gradient_scale(mesh: Mesh) -> float:
    """Return the scale that the encoded α and β of a mesh are relative to."""
    return common_scale([mesh.alpha, mesh.beta])


def _gradients(encoding: Encoding) -> Callable[[Mesh], npt.NDArray[np.generic]]:
    def stored(mesh: Mesh) -> npt.NDArray[np.generic]:
        scale = gradient_scale(mesh)
        return np.hstack([encoded(values, encoding, scale)[0] for values in (mesh.alpha, mesh.beta)])

    return stored


_CONTENTS: Mapping[str, Callable[[Mesh], npt.NDArray[np.generic]]] = {
    "position": lambda mesh: mesh.positions,
    "normal": lambda mesh: mesh.normals,
    "joints": lambda mesh: mesh.joints,
    "weights": lambda mesh: mesh.weights,
    **{f"gradients_{encoding}": _gradients(encoding) for encoding in Encoding},
    "triangles": lambda mesh: mesh.adjacency.triangles,
    "indices": lambda mesh: mesh.triangles.astype(np.uint32),
    "places": lambda mesh: mesh.adjacency.places,
    "ranges": lambda mesh: mesh.adjacency.ranges,
    "ring": lambda mesh: mesh.adjacency.ring,
    "turns": lambda mesh: mesh.adjacency.turns,
}


def contents(name: str, mesh: Mesh, palettes: Palettes) -> npt.NDArray[np.generic] | None:
    """Return what a buffer holds before the first step, or None for a result."""
    if name in ("matrices", "quaternions"):
        return palettes.matrices if name == "matrices" else palettes.quaternions
    make = _CONTENTS.get(name)
    return None if make is None else np.ascontiguousarray(make(mesh))
