"""The adapter that is measured: its choice, its clock, and the bandwidth of its memory."""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np
import wgpu
from wgpu.backends.wgpu_native import lib

COPIED_BYTES = 128 << 20
COPIED_BYTES_IN_SOFTWARE = 32 << 20
COPY_WORKGROUP = 256
COPY = """
@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> target_: array<vec4<f32>>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < arrayLength(&source)) {
        target_[id.x] = source[id.x];
    }
}
"""


def adapter_of(word: str) -> Any:
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


def device_of(adapter: Any, *, timestamps: bool = True) -> Any:
    """Return a device, with timestamps if the adapter has them, unless they are not wanted."""
    has = timestamps and "timestamp-query" in adapter.features
    return adapter.request_device_sync(required_features=["timestamp-query"] if has else [])


def is_software(adapter: Any) -> bool:
    """Tell whether the adapter is a processor. Its times say nothing about graphics hardware."""
    return bool(adapter.info["adapter_type"] == "CPU")


def largest_binding(device: Any) -> int:
    """Return the bytes of a buffer that a shader may have at most."""
    limits = device.limits
    return int(min(limits["max-storage-buffer-binding-size"], limits["max-buffer-size"]))


class Clock:
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
        """Run what the encoder holds, and return how long its pass took."""
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


def copy_rate(device: Any, rounds: int, *, software: bool) -> float:
    """Return the bytes a second, read and written, of a kernel that copies a buffer: the median of rounds."""
    size = min(COPIED_BYTES_IN_SOFTWARE if software else COPIED_BYTES, largest_binding(device))
    size -= size % (16 * COPY_WORKGROUP)
    module = device.create_shader_module(code=COPY)
    pipeline = device.create_compute_pipeline(
        layout="auto", compute={"module": module, "entry_point": "main"}
    )
    buffers = [device.create_buffer(size=size, usage=wgpu.BufferUsage.STORAGE) for _ in range(2)]
    group = bind_group(device, pipeline, buffers)
    clock = Clock(device)
    taken = []
    for _ in range(rounds + 1):
        encoder = device.create_command_encoder()
        run = encoder.begin_compute_pass(**clock.settings)
        run.set_pipeline(pipeline)
        run.set_bind_group(0, group)
        run.dispatch_workgroups(size // (16 * COPY_WORKGROUP))
        run.end()
        taken.append(clock.seconds(encoder))
    for buffer in buffers:
        buffer.destroy()
    return 2 * size / statistics.median(taken[1:])


def bind_group(device: Any, pipeline: Any, buffers: list[Any]) -> Any:
    """Return group 0 of a pipeline, with buffers at bindings 0, 1, and so on."""
    entries = [
        {"binding": number, "resource": {"buffer": buffer, "offset": 0, "size": buffer.size}}
        for number, buffer in enumerate(buffers)
    ]
    return device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries)
