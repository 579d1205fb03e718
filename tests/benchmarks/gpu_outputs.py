"""What the passes of benchmarks/gpu give on a software driver, for tests: run as a process of its own.

A Vulkan loader reads its choice of drivers once a process.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from benchmarks.gpu.meshes import Mesh, Palettes, Wide, sheet, sheet_poses
from benchmarks.gpu.records import TimeRecord
from benchmarks.gpu.variants import VARIANTS

POSES = 2
PICTURE = 512
"""Pixels of a side: so many that the pixel of a vertex has its normal."""


@dataclass(frozen=True)
class Outputs:
    """Results by variant: positions (P, V, 3), normals and tangents (P, V, 6), pictures of the first pose.

    sizes are the bytes of the buffers that a compute pass has, by variant and name; clocks are the seconds of
    one pass with and without timestamps; cramped are the times on a device of small buffers.
    """

    positions: dict[str, npt.NDArray[np.float32]]
    frames: dict[str, npt.NDArray[np.float32]]
    pictures: dict[str, npt.NDArray[np.uint8]]
    sizes: dict[str, dict[str, int]]
    clocks: dict[bool, float]
    cramped: list[TimeRecord]


def split_sheet() -> Mesh:
    """Return a sheet that is split along a seam, with authored normals that lean from its own."""
    given = sheet(900)
    columns = 30
    seam = np.arange(10, len(given.positions), columns)
    copies = np.arange(len(given.positions), len(given.positions) + len(seam))
    renamed = np.arange(len(given.positions))
    renamed[seam] = copies
    beyond = given.positions[given.triangles].mean(axis=1)[:, 0] > given.positions[seam[0], 0]
    triangles = given.triangles.copy()
    triangles[beyond] = renamed[triangles[beyond]]
    whole = np.concatenate([np.arange(len(given.positions)), seam])
    rng = np.random.default_rng(7)
    leaning = given.normals + rng.uniform(-0.2, 0.2, given.normals.shape)
    leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
    return Mesh(
        given.positions[whole],
        leaning[whole].astype(np.float32),
        given.joints[whole],
        given.weights[whole],
        # So smooth that a picture of the normals is smooth.
        np.tile(np.array([0.4, -0.4, 0.2], np.float32), (len(whole), 1)),
        np.tile(np.array([0.15, 0.3, -0.3], np.float32), (len(whole), 1)),
        triangles,
        whole,
    )


def matrices() -> Wide:
    """Return the poses of the sheet."""
    return sheet_poses(POSES)


def smooth_sheet() -> Mesh:
    """Return the split sheet with its own normals, which a picture shows without speckles."""
    mesh = split_sheet()
    return replace(mesh, normals=sheet(900).normals[mesh.classes])


def outputs() -> Outputs:
    """Run everything on one device."""
    # Late, so that a test can say that wgpu is missing.
    from benchmarks import shader_speed
    from benchmarks.gpu import adapters, passes

    adapter = adapters.adapter_of("llvmpipe")
    device = adapters.device_of(adapter, timestamps=False)
    mesh, palettes = split_sheet(), Palettes.of(matrices())
    found = Outputs({}, {}, {}, {}, {}, [])
    for variant in VARIANTS:
        part = passes.Part.of(device, mesh, palettes)
        passes.compute_pass(device, variant, [part])()
        found.positions[variant.name] = part.read("posed_position")
        found.frames[variant.name] = part.read("posed_frame")
        names = {name for step in variant.steps for name in step.buffers}
        found.sizes[variant.name] = {name: part.buffer(name).size for name in names}
        if variant.choices is not None:
            first = passes.Part.of(device, smooth_sheet(), palettes.some(slice(1)))
            with patch("benchmarks.gpu.passes.picture_side", return_value=PICTURE):
                drawing = passes.Drawing(device, variant, [first])
            drawing()
            found.pictures[variant.name] = drawing.picture()
    for timestamps in (False, True):
        own = adapters.device_of(adapter, timestamps=timestamps)
        run = passes.compute_pass(own, VARIANTS[0], [passes.Part.of(own, mesh, palettes)])
        assert adapters.has_timestamps(own) == timestamps
        found.clocks[timestamps] = run()
    scene = shader_speed.Scene("cramped", 1, [passes.Part.of(device, mesh, palettes.some(slice(1)))])
    with patch("benchmarks.gpu.passes.largest_binding", return_value=15_000):
        found.cramped.extend(shader_speed.measured_times(device, scene, 1))
    return found


def write(path: str) -> None:
    """Write pickled ``Outputs``."""
    Path(path).write_bytes(pickle.dumps(outputs()))
