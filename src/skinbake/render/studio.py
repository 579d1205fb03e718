"""Draw subjects off-screen through WebGPU, with the WGSL of ``skinbake shader`` in the vertex stage."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Frame, Language, Lighting
from skinbake.errors import Place, UnsupportedFeatureError
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.reading.materials import Texture
from skinbake.render.materials import EVERY, Levels, Range, sampling
from skinbake.render.subject import YAW, Camera, Shot, Subject
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import shader_made
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.truth.blending import BlendedPrimitive
from skinbake.wording import installing

SCENE = Path(__file__).parent / "scene.wgsl"
MODES = ("shaded", "reflections", "error", "normals")
STOPS = ((217, 221, 225), (242, 209, 107), (238, 138, 46), (207, 47, 47), (92, 15, 58))
LIGHT = (-0.5, 0.6, 0.6)
BACKGROUND = (0.945, 0.941, 0.933)
SUPERSAMPLING = 2
"""Samples along each side of a pixel, beside the four of the driver."""

MOST_POINTS = 20_000
"""The points that place the camera."""

IMAGES = ("base", "normal", "emissive")
ONE_PIXEL: dict[str, Levels] = {
    use: (np.array([[pixel]], np.uint8),)
    for use, pixel in zip(
        IMAGES, ((255, 255, 255, 255), (128, 128, 255, 255), (255, 255, 255, 255)), strict=True
    )
}
"""What stands for an image that a material does not have."""

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
        # The light comes from the upper left of the first picture, and stays there.
        cosine, sine = np.cos(camera.yaws[0] - YAW), np.sin(camera.yaws[0] - YAW)
        turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
        self._light = turn @ LIGHT / np.linalg.norm(LIGHT)
        self._device = _device()
        self._modules: dict[tuple[str, int, bool, Frame], Any] = {}
        self._pipelines: dict[tuple[object, ...], Any] = {}
        self._at_rest: dict[int, Any] = {}
        self._indices = [
            self._buffer(subject.triangles.astype(np.uint32).tobytes(), _usage("INDEX"))
            for subject in subjects
        ]
        self._images: dict[tuple[int, bool], Any] = {}
        self._samplers: dict[tuple[str, str, str], Any] = {}

    def picture(self, shot: Shot, sides: Sequence[str], look: Look) -> Picture:
        """Return one picture (H, W, 3). With two lightings, the model is drawn twice, side by side."""
        edges = [look.width * number // len(sides) for number in range(len(sides) + 1)]
        widths = [end - start for start, end in pairwise(edges)]
        parts = [
            self._drawn(shot, lighting, replace(look, width=width))
            for lighting, width in zip(sides, widths, strict=True)
        ]
        found = np.concatenate(parts, axis=1)
        for edge in edges[1:-1]:
            found[:, edge - 1 : edge + 1] = 255
        return found

    def _drawn(self, shot: Shot, lighting: str, look: Look) -> Picture:
        import wgpu

        size = (SUPERSAMPLING * look.width, SUPERSAMPLING * look.height, 1)
        attached = wgpu.TextureUsage.RENDER_ATTACHMENT
        with _held():
            many, depth = (
                self._device.create_texture(size=size, format=kind, usage=attached, sample_count=4)
                for kind in ("rgba8unorm", "depth32float")
            )
            target = self._device.create_texture(
                size=size, format="rgba8unorm", usage=attached | wgpu.TextureUsage.COPY_SRC
            )
        encoder = self._device.create_command_encoder()
        step = encoder.begin_render_pass(
            color_attachments=[
                {
                    "view": many.create_view(),
                    "resolve_target": target.create_view(),
                    "clear_value": (*BACKGROUND, 1.0),
                    "load_op": "clear",
                    "store_op": "discard",
                }
            ],
            depth_stencil_attachment={
                "view": depth.create_view(),
                "depth_clear_value": 1.0,
                "depth_load_op": "clear",
                "depth_store_op": "discard",
            },
        )
        # What blends is drawn after all others, the farthest first: what is solid of it, then the rest.
        blended = [number for number, one in enumerate(self._subjects) if one.material.is_blended]
        if len(blended) > 1:
            towards, nearness = self._camera.axes(shot.yaw)[2], {}
            for number in blended:
                subject = self._subjects[number]
                moved = shot.morphed.get("standard", {}).get(number, subject.rest)
                posed = BlendedPrimitive(moved, shot.matrices[subject.pose_set][None], Options())
                places = posed.positions(slice(0, 1), slice(0, len(moved.positions)))[..., 0]
                nearness[number] = float((places.min(axis=1) + places.max(axis=1)) / 2 @ towards)
            blended.sort(key=nearness.__getitem__)
        for number in [number for number in range(len(self._subjects)) if number not in blended] + blended:
            self._draw(step, number, shot, lighting, look, self._subjects[number].material.ranges[0])
        for number in blended:
            for alphas in self._subjects[number].material.ranges[1]:
                self._draw(step, number, shot, lighting, look, alphas)
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

    def _draw(self, step: Any, number: int, shot: Shot, lighting: str, look: Look, alphas: Range) -> None:
        subject = self._subjects[number]
        matrices = shot.matrices[subject.pose_set].transpose(0, 2, 1).astype(np.float32).tobytes()
        buffers = (
            self._buffer(matrices),
            self._rows(number, shot, lighting),
            self._buffer(self._scene(subject, shot, look, alphas), _usage("UNIFORM")),
        )
        material = subject.material
        samplers = (self._sampler(material.textures.get(use)) for use in IMAGES)
        views = (self._image(material.images.get(use), use).create_view() for use in IMAGES)
        bound = [*({"buffer": buffer} for buffer in buffers), *samplers, *views]
        step.set_index_buffer(self._indices[number], "uint32")
        # The faces that each time are not drawn. Backs that blend are drawn first, as by three.js.
        both = ["front", "back"] if alphas[1] < EVERY else ["none"]
        for culled in both if material.is_double or subject.is_mirrored else ["back"]:
            pipeline = self._pipeline(subject, lighting, culled, alphas)
            step.set_pipeline(pipeline)
            group = self._device.create_bind_group(
                layout=pipeline.get_bind_group_layout(0),
                entries=[{"binding": n, "resource": resource} for n, resource in enumerate(bound)],
            )
            step.set_bind_group(0, group)
            step.draw_indexed(subject.triangles.size)

    def _rows(self, number: int, shot: Shot, lighting: str) -> Any:
        """Return the buffer of a subject's vertices. Those that no picture changes are uploaded once."""
        subject, errors = self._subjects[number], shot.errors.get(lighting)
        moved = shot.morphed.get(lighting, {})
        if errors is not None or number in moved:
            rest = moved.get(number, subject.rest)
            return self._vertices(_rows(subject, rest, None if errors is None else errors[number]))
        if number not in self._at_rest:
            self._at_rest[number] = self._vertices(_rows(subject, subject.rest, None))
        return self._at_rest[number]

    def _vertices(self, rows: npt.NDArray[np.float32]) -> Any:
        """Return a buffer of rows. Raises UnsupportedFeatureError for more than the device reads at once."""
        most = self._device.limits["max-storage-buffer-binding-size"] // rows[0].nbytes
        if len(rows) > most:
            message = (
                f"a primitive has {len(rows):,} vertices, and this device draws {most:,}: look at it with "
                "skinbake view"
            )
            raise UnsupportedFeatureError(message, Place("render"))
        return self._buffer(rows.tobytes())

    def _scene(self, subject: Subject, shot: Shot, look: Look, alphas: Range) -> bytes:
        """Return the bytes of the uniforms: see ``Scene`` in the text of the stages."""
        aspect, material = look.width / look.height, subject.material
        flags = [
            "normal" in material.images,
            subject.tangents is not None,
            material.is_double and not subject.is_mirrored,
            alphas[1] < EVERY,
            material.is_unlit,
        ]
        parts = [
            self._camera.projected(shot.yaw, aspect).T,
            [*self._camera.eye(shot.yaw, aspect), 1.0],
            [*self._light, 0.0],
            material.base,
            [*material.emissive, material.roughness],
        ]
        floats = b"".join(np.asarray(part, np.float32).tobytes() for part in parts)
        modes = np.array([MODES.index(look.mode), sum(flag << n for n, flag in enumerate(flags))], np.uint32)
        others = np.array([look.legend, material.normal_scale, *alphas, 0, 0], np.float32)
        return floats + modes.tobytes() + others.tobytes()

    def _sampler(self, texture: Texture | None) -> Any:
        """Return the sampler that reads images in one way."""
        wrap_u, wrap_v, magnified = key = sampling(texture)
        if key not in self._samplers:
            self._samplers[key] = self._device.create_sampler(
                address_mode_u=wrap_u,
                address_mode_v=wrap_v,
                mag_filter=magnified,
                min_filter="linear",
                mipmap_filter="linear",
            )
        return self._samplers[key]

    def _image(self, levels: Levels | None, use: str) -> Any:
        """Return the texture of an image, or of the one pixel that stands for none."""
        import wgpu

        if levels is None:
            levels = ONE_PIXEL[use]
        key = id(levels), use == "normal"
        if key not in self._images:
            height, width = levels[0].shape[:2]
            with _held():
                texture = self._device.create_texture(
                    size=(width, height, 1),
                    # Of colours the device filters what light adds up to, as three.js has it.
                    format="rgba8unorm" if use == "normal" else "rgba8unorm-srgb",
                    mip_level_count=len(levels),
                    usage=wgpu.TextureUsage.TEXTURE_BINDING | wgpu.TextureUsage.COPY_DST,
                )
            for number, level in enumerate(levels):
                self._device.queue.write_texture(
                    {"texture": texture, "mip_level": number},
                    np.ascontiguousarray(level),
                    {"bytes_per_row": 4 * level.shape[1], "rows_per_image": level.shape[0]},
                    (level.shape[1], level.shape[0], 1),
                )
            self._images[key] = texture
        return self._images[key]

    def _pipeline(self, subject: Subject, lighting: str, culled: str, alphas: Range) -> Any:
        slots, blends = subject.rest.joints.shape[1], alphas[1] < EVERY
        hides = not blends or alphas[0] > 0
        if lighting == "corrected":  # standard lighting, of other normals
            lighting = "standard"
        if subject.is_rigid:  # its normals are right under any scale
            lighting = "accurate"
        frame = Frame.TANGENT if subject.in_their_frame else Frame.NORMAL
        key = (lighting, slots, subject.is_mirrored, frame, culled, blends, hides)
        if key in self._pipelines:
            return self._pipelines[key]
        stages = key[:4]  # the text of the stages depends on no more
        if stages not in self._modules:
            self._modules[stages] = self._device.create_shader_module(code=shader(*stages))
        module = self._modules[stages]
        target: dict[str, Any] = {"format": "rgba8unorm"}
        if blends:
            over = {"src_factor": "one", "dst_factor": "one-minus-src-alpha", "operation": "add"}
            target["blend"] = {"color": over, "alpha": over}
        self._pipelines[key] = self._device.create_render_pipeline(
            layout="auto",
            vertex={"module": module, "entry_point": "vertex"},
            primitive={
                "topology": "triangle-list",
                "cull_mode": culled,
                "front_face": "cw" if subject.is_mirrored else "ccw",
            },
            depth_stencil={
                "format": "depth32float",
                "depth_write_enabled": hides,
                "depth_compare": "less-equal",  # a layer on another one is seen, as three.js has it
            },
            multisample={"count": 4},
            fragment={"module": module, "entry_point": "fragment", "targets": [target]},
        )
        return self._pipelines[key]

    def _buffer(self, data: bytes, usage: int | None = None) -> Any:
        with _held():
            return self._device.create_buffer_with_data(
                data=data, usage=_usage("STORAGE") if usage is None else usage
            )


@contextmanager
def _held() -> Iterator[None]:
    """Raise UnsupportedFeatureError if the device has no memory for what is made in the block."""
    import wgpu

    try:
        yield
    except wgpu.GPUError as error:
        reason = str(error).strip().split("\n")[-1].strip()
        message = f"the device cannot hold what is drawn ({reason}): draw it smaller, by --size"
        raise UnsupportedFeatureError(message, Place("render")) from error


def _usage(name: str) -> int:
    """Return the flag of a buffer's use by its name in WebGPU."""
    import wgpu

    return int(getattr(wgpu.BufferUsage, name))


def require_packages() -> None:
    """Raise UnsupportedFeatureError if a package of the extra ``render`` cannot be imported."""
    for module, package in (("wgpu", "wgpu"), ("PIL.Image", "Pillow")):
        try:
            import_module(module)
        except ImportError as error:
            message = f"pictures need {package}, which is missing ({error}): {installing('render')}"
            raise UnsupportedFeatureError(message, Place("render")) from error


def _device() -> Any:
    """Return a device of any kind, a software driver too. Raises UnsupportedFeatureError without one."""
    import wgpu

    place = Place("render")
    # Without a desktop some drivers complain on stderr that there is no such folder. No window is opened.
    os.environ.setdefault("XDG_RUNTIME_DIR", gettempdir())
    try:
        return wgpu.gpu.request_adapter_sync().request_device_sync()
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        message = (
            f"no device draws pictures here ({reason}): install a driver of Vulkan, like mesa-vulkan-drivers"
        )
        raise UnsupportedFeatureError(message, place) from error


def shader(lighting: str, slots: int, mirrored: bool, frame: Frame = Frame.TANGENT) -> str:
    """Return the text of ``skinbake shader`` for so many slots, and the stages that call it."""
    choices = ShaderChoices(
        Language.WGSL,
        lighting=Lighting(lighting),
        influences=slots,
        frame=frame,
        mirrored_joints=mirrored and lighting == "accurate",
        normal_map=lighting == "accurate",
    )
    sets = range(choices.influence_sets)
    first = 7
    joints = [f"joints[u32(row[{first + number}].{c})]" for number in sets for c in "xyzw"][:slots]
    weights = [f"row[{first + len(sets) + number}]" for number in sets]
    slopes = [
        f"row[{first + (2 + kind) * len(sets) + set}]{'' if set else '.xyz'}"
        for kind in (0, 1)
        for set in sets
    ]
    arguments = ["row[0].xyz", "frame", "M", *weights, *(slopes if choices.reads_gradients else [])]
    is_own = frame is Frame.TANGENT
    given = "v, rest" if is_own else "v, rest, tangent"
    relief = [f"skinbake_normal_map({given}).{name}" for name in ("cotangent", "cobitangent")]
    if not choices.normal_map:  # as in engines, standard lighting keeps no lengths
        columns = ["v.tangent", "v.bitangent"]
        if not is_own:
            # What it makes of a vector at rest, from what it makes of the frame.
            across = "(tangent.w * cross(rest.normal, tangent.xyz))"
            columns = [
                " + ".join(
                    f"dot({vector}, rest.{name}) * v.{name}" for name in ("tangent", "bitangent", "normal")
                )
                for vector in ("tangent.xyz", across)
            ]
        relief = [f"vec4<f32>(normalize({column}), 1.0)" for column in columns]
    words = {
        "row[TANGENT]": f"row[{first + 4 * len(sets)}]",
        "ALONG": "tangent.xyz" if is_own else "vec3<f32>(1.0, 0.0, 0.0)",
        "COTANGENT": relief[0],
        "COBITANGENT": relief[1],
        "ROW": str(first + 4 * len(sets) + 1),
        "INFLUENCES": str(slots),
        "MATRICES": ", ".join(joints),
        "CALL": f"{choices.stem}({', '.join(arguments)})",
        "STOPS": ", ".join(f"vec3<f32>({r / 255}, {g / 255}, {b / 255})" for r, g, b in STOPS),
    }
    scene = SCENE.read_text(encoding="utf-8")
    for word, value in words.items():
        scene = scene.replace(word, value)
    return shader_made(choices)[0] + scene


def _rows(subject: Subject, rest: RestPrimitive, errors: tuple[Any, Any] | None) -> npt.NDArray[np.float32]:
    """Return what the vertex stage reads of each vertex, in vec4 (V, R, 4): see ``shader``."""
    count, slots = rest.joints.shape
    padded = 4 * -(-slots // 4)
    degrees, known = (np.zeros(count), np.zeros(count)) if errors is None else errors
    base, normal, emissive = (subject.texcoords.get(use, np.zeros((count, 2))) for use in IMAGES)
    colours = np.ones((count, 4)) if subject.colours is None else subject.colours

    def wide(values: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        filled = np.pad(values, ((0, 0), (0, padded - values.shape[1])))
        return [filled[:, start : start + 4] for start in range(0, padded, 4)]

    def slopes(values: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        first = np.pad(values[:, :3], ((0, 0), (0, 4 - min(3, values.shape[1]))))
        return [first, *wide(np.pad(values, ((0, 0), (1, 0))))[1:]]

    # A texture lies along the frame without morph targets: these are the parts of TANGENT there.
    still = subject.rest
    texture = np.zeros((count, 4))
    if subject.in_their_frame:
        texture[:, 0] = rest.tangent_lengths()
    elif subject.tangents is not None:
        frame = np.stack([still.tangents, still.bitangents, still.normals], axis=1)
        texture[:, :3] = np.einsum("vij,vj->vi", frame, subject.tangents[:, :3])
        texture[:, 3] = subject.tangents[:, 3]
    parts = [
        np.column_stack([rest.positions, degrees]),
        np.column_stack([rest.normals, known]),
        np.column_stack([rest.tangents, rest.handedness()]),
        np.column_stack([rest.bitangents, np.zeros(count)]),
        np.column_stack([base, normal]),
        np.pad(emissive, ((0, 0), (0, 2))),
        colours,
        *wide(rest.joints),
        *wide(rest.weights),
        *slopes(rest.alpha),
        *slopes(rest.beta),
        texture,
    ]
    return np.stack(parts, axis=1).astype(np.float32)


def placed(positions: Sequence[Float64Array], yaws: Sequence[float]) -> Camera:
    """Return the camera that shows all positions (…, 3) from each of its angles."""
    every = np.concatenate([part.reshape(-1, 3) for part in positions])
    every = every[:: max(1, len(every) // MOST_POINTS)]
    low, high = every.min(axis=0), every.max(axis=0)
    return Camera((low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0, every, tuple(yaws))
