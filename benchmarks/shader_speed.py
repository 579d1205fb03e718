"""Time the generated WGSL of algorithms 1, 3, 4, 5 and 6 as compute passes, as ratios to algorithm 1.

Usage: python -m benchmarks.shader_speed [--vertices N ...] [--rounds N] [--adapter WORD]

Each invocation skins a vertex of four influences. It reads the attributes that its algorithm needs, tightly
packed as in a glTF file, and the joints' matrices or dual quaternions, all from storage buffers, and writes
position, normal and tangent. Vertices are random, and so are their joints: no worse for one than for another.

A round runs every algorithm once, in turn, so that a machine that slows down slows all; the first round does
not count. Times are the adapter's own timestamps where it has them, else wall time until the queue is empty.
Prints medians, and ratios of medians.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import wgpu
from wgpu.backends.wgpu_native import lib

from skinbake.choices import Language, Lighting, Method
from skinbake.geometry.dual_quaternions import dual_quaternions_from_matrices
from skinbake.shaders.choices import ShaderChoices
from tests.support.whole_fields import shader_text

JOINTS, INFLUENCES = 64, 4
WORKGROUP = 64
PART = 1 << 20
"""Vertices that one dispatch skins at most: the buffers of more would be larger than WebGPU lets one bind."""
TIMED = {
    1: (Method.LBS, Lighting.APPROXIMATED),
    3: (Method.LBS, Lighting.ACCURATE),
    4: (Method.DQS, Lighting.APPROXIMATED),
    5: (Method.DQS, Lighting.ACCURATE),
    6: (Method.DQS, Lighting.EXACT),
}
ATTRIBUTES = ("position", "normal", "joints", "weights", "alpha", "beta")


@dataclass(frozen=True, slots=True)
class Part:
    """The buffers of up to PART vertices by attribute, where the results go, and how many there are."""

    attributes: dict[str, Any]
    results: Any
    vertices: int


def adapter(word: str) -> Any:
    """Return the fast adapter, or the first whose description holds a word."""
    if not word:
        return wgpu.gpu.request_adapter_sync(power_preference="high-performance")
    found = wgpu.gpu.enumerate_adapters_sync()
    named = [each for each in found if word.lower() in each.summary.lower()]
    if not named:
        raise SystemExit(
            f"no adapter is called {word}; there are: {'; '.join(each.summary for each in found)}"
        )
    return named[0]


def device_of(chosen: Any) -> Any:
    """Return a device, with timestamps where the adapter has them."""
    features = [name for name in ("timestamp-query",) if name in chosen.features]
    return chosen.request_device_sync(required_features=features)


def shader(choices: ShaderChoices) -> str:
    """Return the text of the choices with a compute pass around it."""
    motion = "mat4x4<f32>" if choices.method is Method.LBS else "mat2x4<f32>"
    types = {"weights": "vec4<f32>", "joints": "u32"}
    bindings = [
        f"@group(0) @binding({number}) var<storage, read> {name}: array<{types.get(name, 'f32')}>;"
        for number, name in enumerate(reads(choices))
    ]
    vectors = {
        name: f"vec3<f32>({name}[3u * i], {name}[3u * i + 1u], {name}[3u * i + 2u])" for name in ATTRIBUTES
    }
    gradients = f", {vectors['alpha']}, {vectors['beta']}" if choices.reads_gradients else ""
    slots = ", ".join(f"motions[(j >> {8 * slot}u) & 255u]" for slot in range(INFLUENCES))
    writes = [
        f"results[9u * i + {3 * number + axis}u] = v.{name}.{letter};"
        for number, name in enumerate(("position", "normal", "tangent"))
        for axis, letter in enumerate("xyz")
    ]
    return "\n".join(
        [
            shader_text(choices),
            *bindings,
            f"@group(0) @binding({len(bindings)}) var<storage, read> motions: array<{motion}>;",
            f"@group(0) @binding({len(bindings) + 1}) var<storage, read_write> results: array<f32>;",
            f"@compute @workgroup_size({WORKGROUP})",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            "let i = id.x;",
            "if (i >= arrayLength(&weights)) { return; }",
            "let j = joints[i];",
            f"let moved = array<{motion}, {INFLUENCES}>({slots});",
            f"let frame = skinbake_frame({vectors['normal']});",
            f"let v = skinbake_{choices.stem}({vectors['position']}, frame, moved, weights[i]{gradients});",
            *writes,
            "}",
        ]
    )


def reads(choices: ShaderChoices) -> list[str]:
    """Return the attributes that a shader reads."""
    return [name for name in ATTRIBUTES if name not in ("alpha", "beta") or choices.reads_gradients]


def attribute_arrays(count: int) -> dict[str, npt.NDArray[Any]]:
    """Return random vertices as stored: float32, and four joints in a number."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(count, 3))
    weights = rng.random((count, INFLUENCES))
    arrays = {
        "position": rng.normal(size=(count, 3)),
        "normal": normals / np.linalg.norm(normals, axis=1, keepdims=True),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "alpha": rng.normal(size=(count, INFLUENCES - 1)),
        "beta": rng.normal(size=(count, INFLUENCES - 1)),
    }
    joints = rng.integers(0, JOINTS, (count, INFLUENCES), dtype=np.uint8)
    return {"joints": joints} | {name: values.astype(np.float32) for name, values in arrays.items()}


def motions() -> dict[Method, npt.NDArray[np.float32]]:
    """Return random rigid joints as the shaders have them: matrices column by column, scalars last."""
    rng = np.random.default_rng(1)
    matrices = np.tile(np.eye(4), (JOINTS, 1, 1))
    turned = np.linalg.qr(rng.normal(size=(JOINTS, 3, 3))).Q
    matrices[:, :3, :3] = turned * np.linalg.det(turned)[:, None, None]
    matrices[:, :3, 3] = rng.normal(size=(JOINTS, 3))
    quaternions = dual_quaternions_from_matrices(matrices)[:, [1, 2, 3, 0, 5, 6, 7, 4]]
    return {
        Method.LBS: np.ascontiguousarray(np.swapaxes(matrices, 1, 2), np.float32),
        Method.DQS: np.ascontiguousarray(quaternions, np.float32),
    }


def parts_of(device: Any, vertices: int) -> list[Part]:
    """Return the buffers of so many vertices, the same random ones over and over."""
    storage = wgpu.BufferUsage.STORAGE
    arrays = attribute_arrays(min(PART, vertices))
    parts = []
    for first in range(0, vertices, PART):
        count = min(PART, vertices - first)
        attributes = {
            name: device.create_buffer_with_data(data=np.ascontiguousarray(values[:count]), usage=storage)
            for name, values in arrays.items()
        }
        parts.append(Part(attributes, device.create_buffer(size=36 * count, usage=storage), count))
    return parts


def pass_of(
    device: Any, choices: ShaderChoices, parts: list[Part], joints: npt.NDArray[np.float32]
) -> Callable[[], float]:
    """Return what runs a shader over all parts once and tells the seconds."""
    module = device.create_shader_module(code=shader(choices))
    pipeline = device.create_compute_pipeline(
        layout="auto", compute={"module": module, "entry_point": "main"}
    )
    held = device.create_buffer_with_data(data=joints, usage=wgpu.BufferUsage.STORAGE)
    groups = []
    for part in parts:
        buffers = [*(part.attributes[name] for name in reads(choices)), held, part.results]
        entries = [
            {"binding": number, "resource": {"buffer": buffer, "offset": 0, "size": buffer.size}}
            for number, buffer in enumerate(buffers)
        ]
        groups.append(device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries))
    clock = _Clock(device)

    def run() -> float:
        encoder = device.create_command_encoder()
        compute = encoder.begin_compute_pass(**clock.settings)
        compute.set_pipeline(pipeline)
        for group, part in zip(groups, parts, strict=True):
            compute.set_bind_group(0, group)
            compute.dispatch_workgroups(-(-part.vertices // WORKGROUP))
        compute.end()
        return clock.seconds(encoder)

    return run


class _Clock:
    """Times one pass: by the adapter's timestamps, else from submission until the queue is empty."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.settings: dict[str, Any] = {}
        usage = wgpu.BufferUsage
        self._ticks = device.create_buffer(
            size=16, usage=usage.QUERY_RESOLVE | usage.COPY_SRC | usage.COPY_DST
        )
        self._queries = None
        if has_timestamps(device):
            self._queries = device.create_query_set(type="timestamp", count=2)
            writes = {"beginning_of_pass_write_index": 0, "end_of_pass_write_index": 1}
            self.settings = {"timestamp_writes": {"query_set": self._queries, **writes}}

    def seconds(self, encoder: Any) -> float:
        if self._queries is not None:
            encoder.resolve_query_set(self._queries, 0, 2, self._ticks, 0)
        start = time.perf_counter()
        self._device.queue.submit([encoder.finish()])
        # Reading waits for everything before it.
        first, last = np.frombuffer(self._device.queue.read_buffer(self._ticks), np.uint64)
        passed = time.perf_counter() - start
        return float(last - first) * 1e-9 * timestamp_period(self._device) if self._queries else passed


def has_timestamps(device: Any) -> bool:
    """Tell whether the device measures passes itself."""
    return "timestamp-query" in device.features


def timestamp_period(device: Any) -> float:
    """Return the nanoseconds of a tick, which wgpu keeps to itself."""
    return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vertices", type=float, nargs="+", default=[1e6, 1e7])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--adapter", default="", help="part of its name; the fastest without")
    arguments = parser.parse_args()
    chosen = adapter(arguments.adapter)
    device = device_of(chosen)
    print(
        f"{chosen.summary}, wgpu {wgpu.__version__}, {INFLUENCES} influences, {JOINTS} joints, normal frame"
    )
    if chosen.info["adapter_type"] == "CPU":
        print("This adapter is a processor: its figures say nothing about graphics hardware.")
    by = "timestamps of the adapter" if has_timestamps(device) else "wall time"
    print(f"median of {arguments.rounds} rounds, {by}")
    print(f"{'vertices':>12}{'algorithm':>26}{'ns/vertex':>11}{'ratio':>8}")
    joints = motions()
    for vertices in (int(number) for number in arguments.vertices):
        parts = parts_of(device, vertices)
        runs = {
            number: pass_of(
                device, ShaderChoices(Language.WGSL, *choice, INFLUENCES), parts, joints[choice[0]]
            )
            for number, choice in TIMED.items()
        }
        rounds = [{number: run() for number, run in runs.items()} for _ in range(arguments.rounds + 1)]
        medians = {number: statistics.median(taken[number] for taken in rounds[1:]) for number in runs}
        for number, seconds in medians.items():
            name = f"{number} {' '.join(TIMED[number])}"
            ratio = seconds / medians[1]
            print(f"{vertices:>12,}{name:>26}{1e9 * seconds / vertices:>11.3f}{ratio:>8.2f}")


if __name__ == "__main__":
    main()
