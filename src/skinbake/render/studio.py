"""Draw subjects off-screen through WebGPU, with the WGSL of ``skinbake shader`` in the vertex stage."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Frame, Language, Lighting
from skinbake.errors import Place, UnsupportedFeatureError
from skinbake.geometry.skinned import Float64Array
from skinbake.render.subject import Camera, Shot, Subject
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import shader_made
from skinbake.skinning.surface import RestSurface

SCENE = Path(__file__).parent / "scene.wgsl"
MODES = ("shaded", "reflections", "error", "normals")
STOPS = ((217, 221, 225), (242, 209, 107), (238, 138, 46), (207, 47, 47), (92, 15, 58))
LIGHT = (0.60, 0.60, 0.53)
BACKGROUND = (0.945, 0.941, 0.933)
SUPERSAMPLING = 2
"""Samples along each side of a pixel, beside the four of the driver."""

MOST_POINTS = 20_000
"""The points that place the camera."""

LIGHTINGS = {"standard": Lighting.APPROXIMATED, "accurate": Lighting.ACCURATE}

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Look:
    """How pictures are drawn: size in pixels, mode, the largest angle of the legend in degrees."""

    width: int
    height: int
    mode: str = "shaded"
    legend: float = 20.0


class Studio:
    """A device with the subjects on it. Raises UnsupportedFeatureError if there is none."""

    def __init__(self, subjects: Sequence[Subject], camera: Camera) -> None:
        self._subjects, self._camera = subjects, camera
        self._device = _device()
        self._modules: dict[tuple[str, int, bool], Any] = {}

    def picture(self, shot: Shot, sides: Sequence[str], look: Look) -> Picture:
        """Return one picture (H, W, 3). With two lightings, the model is drawn twice, side by side."""
        part = replace(look, width=look.width // len(sides))
        found = np.concatenate([self._drawn(shot, lighting, part) for lighting in sides], axis=1)
        if len(sides) > 1:
            found[:, part.width - 1 : part.width + 1] = 255
        return found

    def _drawn(self, shot: Shot, lighting: str, look: Look) -> Picture:
        import wgpu

        size = (SUPERSAMPLING * look.width, SUPERSAMPLING * look.height, 1)
        attached = wgpu.TextureUsage.RENDER_ATTACHMENT
        many, depth = (
            self._device.create_texture(size=size, format=kind, usage=attached, sample_count=4)
            for kind in ("rgba8unorm", "depth32float")
        )
        target = self._device.create_texture(
            size=size, format="rgba8unorm", usage=attached | wgpu.TextureUsage.COPY_SRC
        )
        encoder = self._device.create_command_encoder()
        step = encoder.begin_render_pass(**_attachments(many, target, depth))
        for number, subject in enumerate(self._subjects):
            self._draw(step, number, subject, shot, lighting, look)
        step.end()
        self._device.queue.submit([encoder.finish()])
        data = self._device.queue.read_texture(
            {"texture": target}, {"bytes_per_row": 4 * size[0], "rows_per_image": size[1]}, size
        )
        samples = np.frombuffer(data, np.uint8).reshape(
            look.height, SUPERSAMPLING, look.width, SUPERSAMPLING, 4
        )
        means: npt.NDArray[np.float32] = samples[..., :3].astype(np.float32).mean(axis=(1, 3))
        return means.round().astype(np.uint8)

    def _draw(self, step: Any, number: int, subject: Subject, shot: Shot, lighting: str, look: Look) -> None:
        import wgpu

        aspect = look.width / look.height
        pipeline = self._pipeline(subject, lighting)
        scene = [
            self._camera.projected(shot.yaw, aspect).T,
            [*self._camera.eye(shot.yaw, aspect), 1.0],
            [*(np.array(LIGHT) / np.linalg.norm(LIGHT)), 0.0],
            [*subject.base, 1.0],
        ]
        uniforms = b"".join(np.asarray(part, np.float32).tobytes() for part in scene)
        uniforms += np.uint32(MODES.index(look.mode)).tobytes() + np.float32(look.legend).tobytes() + bytes(8)
        matrices = shot.matrices[subject.pose_set].transpose(0, 2, 1).astype(np.float32).tobytes()
        errors = shot.errors.get(lighting)
        buffers = (
            self._buffer(matrices),
            self._buffer(_rows(subject, None if errors is None else errors[number])),
            self._buffer(uniforms, wgpu.BufferUsage.UNIFORM),
        )
        step.set_pipeline(pipeline)
        group = self._device.create_bind_group(
            layout=pipeline.get_bind_group_layout(0),
            entries=[{"binding": n, "resource": {"buffer": buffer}} for n, buffer in enumerate(buffers)],
        )
        step.set_bind_group(0, group)
        indices = self._buffer(subject.triangles.astype(np.uint32).tobytes(), wgpu.BufferUsage.INDEX)
        step.set_index_buffer(indices, "uint32")
        step.draw_indexed(subject.triangles.size)

    def _pipeline(self, subject: Subject, lighting: str) -> Any:
        module = self._module(lighting, subject.rest.joints.shape[1], subject.is_mirrored)
        culled = "none" if subject.is_double or subject.is_mirrored else "back"
        return self._device.create_render_pipeline(
            layout="auto",
            vertex={"module": module, "entry_point": "vertex"},
            primitive={"topology": "triangle-list", "cull_mode": culled},
            depth_stencil={"format": "depth32float", "depth_write_enabled": True, "depth_compare": "less"},
            multisample={"count": 4},
            fragment={"module": module, "entry_point": "fragment", "targets": [{"format": "rgba8unorm"}]},
        )

    def _module(self, lighting: str, slots: int, mirrored: bool) -> Any:
        key = (lighting, slots, mirrored)
        if key not in self._modules:
            self._modules[key] = self._device.create_shader_module(code=shader(*key))
        return self._modules[key]

    def _buffer(self, data: bytes, usage: int | None = None) -> Any:
        import wgpu

        return self._device.create_buffer_with_data(data=data, usage=usage or wgpu.BufferUsage.STORAGE)


def _device() -> Any:
    """Return a device of any kind, a software driver too. Raises UnsupportedFeatureError without one."""
    place = Place("render")
    # Without a desktop some drivers complain on stderr that there is no such folder. No window is opened.
    os.environ.setdefault("XDG_RUNTIME_DIR", gettempdir())
    try:
        import wgpu
    except ImportError as error:
        message = "pictures need wgpu and Pillow: pip install 'skinbake[render]'"
        raise UnsupportedFeatureError(message, place) from error
    try:
        return wgpu.gpu.request_adapter_sync().request_device_sync()
    except RuntimeError as error:
        message = (
            f"no device draws pictures here ({error}): install a driver of Vulkan, like mesa-vulkan-drivers"
        )
        raise UnsupportedFeatureError(message, place) from error


def shader(lighting: str, slots: int, mirrored: bool) -> str:
    """Return the text of ``skinbake shader`` for so many slots, and the stages that call it."""
    choices = ShaderChoices(
        Language.WGSL,
        lighting=LIGHTINGS[lighting],
        influences=slots,
        frame=Frame.TANGENT,  # frames are computed before; of both texts it is the one that has a handedness
        mirrored_joints=mirrored and lighting == "accurate",
    )
    sets = range(choices.influence_sets)
    first = 4
    joints = [f"joints[u32(row[{first + number}].{c})]" for number in sets for c in "xyzw"][:slots]
    weights = [f"row[{first + len(sets) + number}]" for number in sets]
    slopes = [
        f"row[{first + (2 + kind) * len(sets) + set}]{'' if set else '.xyz'}"
        for kind in (0, 1)
        for set in sets
    ]
    arguments = ["row[0].xyz", "frame", "M", *weights, *(slopes if choices.reads_gradients else [])]
    words = {
        "ROW": str(first + 4 * len(sets)),
        "INFLUENCES": str(slots),
        "MATRICES": ", ".join(joints),
        "CALL": f"{choices.stem}({', '.join(arguments)})",
        "STOPS": ", ".join(f"vec3<f32>({r / 255}, {g / 255}, {b / 255})" for r, g, b in STOPS),
    }
    scene = SCENE.read_text(encoding="utf-8")
    for word, value in words.items():
        scene = scene.replace(word, value)
    return shader_made(choices)[0] + scene


def _rows(subject: Subject, errors: tuple[Any, Any] | None) -> bytes:
    """Return what the vertex stage reads of each vertex, in vec4: see ``shader``."""
    rest = subject.rest
    count, slots = rest.joints.shape
    padded = 4 * -(-slots // 4)
    degrees, known = (np.zeros(count), np.zeros(count)) if errors is None else errors

    def wide(values: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        filled = np.pad(values, ((0, 0), (0, padded - values.shape[1])))
        return [filled[:, start : start + 4] for start in range(0, padded, 4)]

    def slopes(values: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        first = np.pad(values[:, :3], ((0, 0), (0, 4 - min(3, values.shape[1]))))
        return [first, *wide(np.pad(values, ((0, 0), (1, 0))))[1:]]

    parts = [
        np.column_stack([rest.positions, degrees]),
        np.column_stack([rest.normals, known]),
        np.column_stack([rest.tangents, _handedness(rest)]),
        np.column_stack([rest.bitangents, np.zeros(count)]),
        *wide(rest.joints),
        *wide(rest.weights),
        *slopes(rest.alpha),
        *slopes(rest.beta),
    ]
    return np.stack(parts, axis=1).astype(np.float32).tobytes()


def _handedness(rest: RestSurface) -> npt.NDArray[Any]:
    """Return 1 or −1 (V,): the side of t0 × b0 on which n0 is."""
    side = np.einsum("vi,vi->v", np.cross(rest.tangents, rest.bitangents), rest.normals)
    return np.where(side < 0, -1.0, 1.0)


def _attachments(many: Any, target: Any, depth: Any) -> dict[str, Any]:
    return {
        "color_attachments": [
            {
                "view": many.create_view(),
                "resolve_target": target.create_view(),
                "clear_value": (*BACKGROUND, 1.0),
                "load_op": "clear",
                "store_op": "discard",
            }
        ],
        "depth_stencil_attachment": {
            "view": depth.create_view(),
            "depth_clear_value": 1.0,
            "depth_load_op": "clear",
            "depth_store_op": "discard",
        },
    }


def placed(positions: Sequence[Float64Array], yaws: Sequence[float]) -> Camera:
    """Return the camera that shows all positions (…, 3) from each of its angles."""
    every = np.concatenate([part.reshape(-1, 3) for part in positions])
    every = every[:: max(1, len(every) // MOST_POINTS)]
    low, high = every.min(axis=0), every.max(axis=0)
    return Camera((low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0, every, tuple(yaws))
