"""The passes that are timed, over buffers that fit: a compute pass, or a picture of small triangles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import isqrt
from typing import Any

import numpy as np
import numpy.typing as npt
import wgpu

from benchmarks.gpu.adapters import Clock, bind_group, largest_binding
from benchmarks.gpu.meshes import Mesh, Palettes
from benchmarks.gpu.texts import VERTEX_FORMATS, WORKGROUP, compute_text, drawn_text
from benchmarks.gpu.variants import LAYOUTS, TRIANGLE, Counts, Step, Variant, contents, gradient_scale

POSED_AT_ONCE = 1 << 20
"""Posed vertices of one part at most: the largest buffer of a part is then far below WebGPU's 128 MiB."""

LARGEST_PICTURE = 2048
"""Pixels of a picture's side at most."""


class DoesNotFitError(Exception):
    """A buffer is larger than the adapter lets a shader have."""


@dataclass(slots=True)
class Part:
    """Some vertices in some poses, and their buffers, made when a pass first needs them."""

    device: Any
    mesh: Mesh
    palettes: Palettes
    counts: Counts
    _buffers: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, device: Any, mesh: Mesh, palettes: Palettes) -> Part:
        """Count what the buffers will hold."""
        return cls(device, mesh, palettes, Counts.of(mesh, palettes))

    def buffer(self, name: str) -> Any:
        """Return a buffer by the name of its layout; ``counts`` is the uniform."""
        if name not in self._buffers:
            self._buffers[name] = self._uniform() if name == "counts" else self._made(name)
        return self._buffers[name]

    def read(self, name: str) -> npt.NDArray[np.float32]:
        """Return a result: rows of a posed vertex, (P, V, …) float32."""
        data = np.frombuffer(self.device.queue.read_buffer(self.buffer(name)), np.float32)
        return data.reshape(self.palettes.poses, len(self.mesh.positions), -1)

    def destroy(self) -> None:
        """Free the memory of the buffers at once."""
        for buffer in self._buffers.values():
            buffer.destroy()
        self._buffers.clear()

    def _made(self, name: str) -> Any:
        size, limit = self.counts.size(name), largest_binding(self.device)
        if size > limit:
            raise DoesNotFitError(f"{name} needs {size:,} bytes, the adapter binds {limit:,}")
        usage = wgpu.BufferUsage
        flags = usage.STORAGE | usage.VERTEX | (usage.INDEX if name == "indices" else 0)
        given = contents(name, self.mesh, self.palettes)
        if given is None:
            return self.device.create_buffer(size=size, usage=flags | usage.COPY_SRC)
        assert given.nbytes == size, name
        return self.device.create_buffer_with_data(data=given, usage=flags)

    def _uniform(self) -> Any:
        data = np.zeros(4, np.uint32)
        data[:3] = self.counts.vertices, self.counts.triangles, self.counts.joints
        data[3:].view(np.float32)[:] = gradient_scale(self.mesh)
        return self.device.create_buffer_with_data(data=data, usage=wgpu.BufferUsage.UNIFORM)


def parts_of_instances(device: Any, mesh: Mesh, palettes: Palettes) -> list[Part]:
    """Return one mesh in many poses, as many poses at a time as fit into buffers."""
    row = max(LAYOUTS["posed_frame"].row, LAYOUTS["sums"].row)
    most = min(POSED_AT_ONCE, largest_binding(device) // row) // len(mesh.positions)
    step = max(1, most)
    return [
        Part.of(device, mesh, palettes.some(slice(first, first + step)))
        for first in range(0, palettes.poses, step)
    ]


def compute_pass(device: Any, variant: Variant, parts: Sequence[Part]) -> Callable[[], float]:
    """Return what runs a variant's steps over all parts once, and tells the seconds."""
    work = [list(_dispatches(device, variant, step, parts)) for step in variant.steps]
    clock = Clock(device)

    def run() -> float:
        encoder = device.create_command_encoder()
        compute = encoder.begin_compute_pass(**clock.settings)
        for dispatches in work:
            for pipeline, group, workgroups in dispatches:
                compute.set_pipeline(pipeline)
                compute.set_bind_group(0, group)
                compute.dispatch_workgroups(*workgroups)
        compute.end()
        return clock.seconds(encoder)

    return run


def _dispatches(
    device: Any, variant: Variant, step: Step, parts: Sequence[Part]
) -> Iterator[tuple[Any, Any, tuple[int, int]]]:
    module = device.create_shader_module(code=compute_text(variant, step))
    pipeline = device.create_compute_pipeline(
        layout="auto", compute={"module": module, "entry_point": "main"}
    )
    for part in parts:
        buffers = [part.buffer(name) for name in ("counts", *step.buffers)]
        counts = part.counts
        count = counts.triangles if step.over == TRIANGLE else counts.vertices
        yield pipeline, bind_group(device, pipeline, buffers), (-(-count // WORKGROUP), counts.instances)


def picture_side(counts: Counts) -> int:
    """Return the pixels of a side of a picture in which triangles are as small as half a pixel."""
    return max(16, min(LARGEST_PICTURE, isqrt(counts.vertices)))


class Drawing:
    """Draws all parts with a variant's vertex shader into a picture, and tells the seconds of each call."""

    def __init__(self, device: Any, variant: Variant, parts: Sequence[Part]) -> None:
        self._device, self._parts = device, parts
        self._pipeline = _render_pipeline(device, variant)
        self._side = picture_side(parts[0].counts)
        usage = wgpu.TextureUsage
        self._texture = device.create_texture(
            size=(self._side, self._side, 1),
            format="rgba8unorm",
            usage=usage.RENDER_ATTACHMENT | usage.COPY_SRC,
        )
        motions = variant.reads_when_drawn[-2]
        self._groups = [
            bind_group(device, self._pipeline, [part.buffer("counts"), part.buffer(motions)])
            for part in parts
        ]
        attributes = [name for name in variant.reads_when_drawn if name in VERTEX_FORMATS]
        self._buffers = [[part.buffer(name) for name in (*attributes, "indices")] for part in parts]
        self._clock = Clock(device)

    def __call__(self) -> float:
        """Draw once."""
        encoder = self._device.create_command_encoder()
        target = {"view": self._texture.create_view(), "load_op": "clear", "store_op": "store"}
        draw = encoder.begin_render_pass(color_attachments=[target], **self._clock.settings)
        draw.set_pipeline(self._pipeline)
        for part, group, (*buffers, indices) in zip(self._parts, self._groups, self._buffers, strict=True):
            draw.set_bind_group(0, group)
            for number, buffer in enumerate(buffers):
                draw.set_vertex_buffer(number, buffer)
            draw.set_index_buffer(indices, "uint32")
            draw.draw_indexed(3 * part.counts.triangles, part.counts.instances)
        draw.end()
        return self._clock.seconds(encoder)

    def picture(self) -> npt.NDArray[np.uint8]:
        """Return the pixels (H, W, 4) of the last call."""
        size = (self._side, self._side, 1)
        layout = {"bytes_per_row": 4 * self._side, "rows_per_image": self._side}
        data = self._device.queue.read_texture({"texture": self._texture}, layout, size)
        return np.frombuffer(data, np.uint8).reshape(self._side, self._side, 4)


def _render_pipeline(device: Any, variant: Variant) -> Any:
    assert variant.choices is not None
    module = device.create_shader_module(code=drawn_text(variant.choices))
    return device.create_render_pipeline(
        layout="auto",
        vertex={"module": module, "entry_point": "vertex", "buffers": list(_vertex_buffers(variant))},
        primitive={"topology": "triangle-list"},
        fragment={"module": module, "entry_point": "fragment", "targets": [{"format": "rgba8unorm"}]},
    )


def _vertex_buffers(variant: Variant) -> Iterator[dict[str, Any]]:
    location = 0
    for name in variant.reads_when_drawn:
        formats = VERTEX_FORMATS.get(name, ())
        stride = LAYOUTS[name].row
        attributes = []
        for number, kind in enumerate(formats):
            offset = number * stride // len(formats)
            attributes.append({"format": kind, "offset": offset, "shader_location": location})
            location += 1
        if attributes:
            yield {"array_stride": stride, "step_mode": "vertex", "attributes": attributes}
