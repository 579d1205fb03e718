"""Draw docs/shaders.png with the shaders that ``skinbake shader`` writes, on whatever GPU or driver there is.

Usage: python -m benchmarks.bend_render [OUTPUT.png | --figures]

The fixture is baked and posed where standard lighting is worst. The WGSL of standard and of accurate
lighting skins it, once in a compute pass, whose normals are held against
``skinbake.truth.normals``, and once in the vertex stage of the picture. The errors printed are
those of the compute pass: float32, on the GPU, weighted by rest area. ``--figures`` prints them and draws
nothing.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import wgpu
from PIL import Image, ImageDraw

from benchmarks.bend_picture import GREY, INK, MODEL, REPOSITORY, SCALE_TOP, STOPS, font, heat, unit
from skinbake.choices import Language, Lighting
from skinbake.commands.bake import bake_document
from skinbake.freshness.baked_views import baked_views, rest_primitive
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import clip_poses, read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.measure.tally import ErrorSummary
from skinbake.shaders.choices import ShaderChoices
from skinbake.skinning.rest import Algorithm
from skinbake.truth.areas import vertex_areas
from skinbake.truth.operator import gradient_operator
from skinbake.truth.truths import rest_frames
from tests.support.replay import replay
from tests.support.whole_fields import angular_errors, reference_normals, shader_text, summarise

Array = npt.NDArray[np.float64]
Single = npt.NDArray[np.float32]

STANDARD, ACCURATE = Lighting.STANDARD, Lighting.ACCURATE
PANEL = (440, 310)
MARGIN, HEADER = 14, 84
SUPERSAMPLING = 4
# The elbow from its inside, upright: where standard lighting goes wrong most.
TURN, TILT, ROLL = np.radians(15.0), np.radians(10.0), np.radians(45.0)
CENTRE = np.array([-0.25, 1.16, 0.0])
HALF_HEIGHT, DEPTH = 0.86, 4.0  # metres
BACKGROUND = (0.90, 0.91, 0.92)
LIT, TRUE, ERROR = 0, 1, 2

SCENE = """
struct Scene {
    clip: mat4x4<f32>, // from mesh space to the screen
    view: mat4x4<f32>, // the same without scale, for directions
    mode: u32,
}
struct Varying {
    @builtin(position) position: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) error: f32,
}
@group(0) @binding(0) var<storage, read> joints: array<mat4x4<f32>>;
@group(0) @binding(1) var<storage, read> rows: array<array<vec4<f32>, ROW>>;
@group(0) @binding(2) var<storage, read_write> results: array<vec4<f32>>;
@group(0) @binding(3) var<uniform> scene: Scene;

fn skinned(index: u32) -> skinbake_Vertex {
    let row = rows[index];
    let position = row[0].xyz;
    let slots = vec4<u32>(row[2]);
    let M = array<mat4x4<f32>, 4>(joints[slots.x], joints[slots.y], joints[slots.z], joints[slots.w]);
    let weights_0 = row[3];
    let alpha_0 = row[4].xyz;
    let beta_0 = row[5].xyz;
    let frame = skinbake_frame(row[1].xyz);
    return CALL;
}

@compute @workgroup_size(64)
fn measure(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < arrayLength(&rows)) {
        results[id.x] = vec4<f32>(skinned(id.x).normal, 0.0);
    }
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Varying {
    let v = skinned(index);
    let normal = select(normalize(v.normal), rows[index][6].xyz, scene.mode == TRUEu);
    return Varying(scene.clip * vec4<f32>(v.position, 1.0), (scene.view * vec4<f32>(normal, 0.0)).xyz,
        rows[index][6].w);
}

// A studio: a key light, a fill from below, and a wall of light tubes that the glaze mirrors.
fn lit(n: vec3<f32>) -> vec3<f32> {
    let key = normalize(vec3<f32>(0.5, 0.75, 0.55));
    let fill = normalize(vec3<f32>(-0.7, -0.4, 0.4));
    let clay = vec3<f32>(0.60, 0.115, 0.045);
    let mirrored = 2.0 * n.z * n - vec3<f32>(0.0, 0.0, 1.0);
    let height = dot(mirrored, normalize(vec3<f32>(0.35, 1.0, 0.0)));
    let wave = cos(11.0 * asin(clamp(height, -1.0, 1.0)) - 0.6);
    let tube = smoothstep(0.35, 0.85, wave);
    let diffuse = 0.08 + 0.95 * max(dot(n, key), 0.0);
    let shine = (0.25 + 0.6 * max(dot(n, key), 0.0)) * tube;
    return clay * diffuse + max(dot(n, fill), 0.0) * vec3<f32>(0.03, 0.05, 0.10) + 0.75 * shine;
}

fn heat(degrees: f32) -> vec3<f32> {
    var stops = array<vec3<f32>, STOPS>(COLOURS);
    let at = clamp(degrees / TOP, 0.0, 1.0) * (STOPS - 1);
    let below = min(u32(at), STOPSu - 2u);
    return mix(stops[below], stops[below + 1u], at - f32(below));
}

@fragment
fn fragment(in: Varying, @builtin(front_facing) outside: bool) -> @location(0) vec4<f32> {
    let n = normalize(in.normal);
    if (!outside) {
        return vec4<f32>(0.2, 0.2, 0.22, 1.0);
    }
    if (scene.mode == ERRORu) {
        return vec4<f32>(heat(in.error) * (0.72 + 0.28 * clamp(n.z, 0.0, 1.0)), 1.0);
    }
    return vec4<f32>(pow(clamp(lit(n), vec3<f32>(0.0), vec3<f32>(1.0)), vec3<f32>(1.0 / 2.2)), 1.0);
}
"""


@dataclass(frozen=True)
class Bend:
    """The tube in one pose: what a vertex shader reads (V, …), float32, and its true normals (V, 3).

    matrices (J, 4, 4), triangles (T, 3), rest areas (V,).
    """

    positions: Single
    normals: Single
    joints: Single
    weights: Single
    alpha: Single
    beta: Single
    matrices: Single
    triangles: npt.NDArray[np.uint32]
    true_normals: Array
    areas: Array


def strongest_bend() -> Bend:
    """Bake the fixture and pose it where standard lighting is worst."""
    document = bake_document(read_document(str(MODEL))).document
    (view,) = baked_views(document, skinned_sources(document))
    rest, now = rest_primitive(view), view.now
    (clip,) = read_clips(document)
    poses = clip_poses(read_skeleton(document, 0), clip, np.unique(clip.channels[0].times))
    standard = replay(Algorithm.LBS_STANDARD, rest, poses)
    operator = gradient_operator([now])
    frames = rest_frames(operator, now.positions, now.normals, view.tangents, view.bitangents)
    expected, _ = reference_normals(frames, standard.positions)
    areas = vertex_areas(now.positions, now.triangles)
    errors = angular_errors(standard.normals, expected)
    worst = int(np.argmax(np.average(errors, axis=1, weights=areas)))

    def single(array: npt.NDArray[Any]) -> Single:
        return array.astype(np.float32)

    return Bend(
        positions=single(rest.positions),
        normals=single(rest.normals),
        joints=single(rest.joints),
        weights=single(rest.weights),
        alpha=single(rest.alpha),
        beta=single(rest.beta),
        matrices=single(poses[worst]),
        triangles=now.triangles.astype(np.uint32),
        true_normals=unit(expected[worst]),
        areas=areas,
    )


def shader(lighting: Lighting) -> str:
    """Return the generated text for the fixture's frame, and what draws and measures with it."""
    choices = ShaderChoices(Language.WGSL, lighting=lighting)
    slopes = ", alpha_0, beta_0" if choices.reads_gradients else ""
    colours = ", ".join(f"vec3<f32>({r}, {g}, {b})" for r, g, b in STOPS)
    words = {"CALL": f"skinbake_{choices.stem}(position, frame, M, weights_0{slopes})", "COLOURS": colours}
    words |= {"STOPS": str(len(STOPS)), "TOP": repr(SCALE_TOP), "ROW": "7"}
    words |= {"TRUE": str(TRUE), "ERROR": str(ERROR)}
    scene = SCENE
    for word, value in words.items():
        scene = scene.replace(word, value)
    return shader_text(choices) + scene


def camera() -> tuple[Single, Single]:
    """Return the matrices of SCENE: to the screen, depth 0 … 1 away from the eye, and of directions."""
    c, s = np.cos([TURN, TILT, ROLL]), np.sin([TURN, TILT, ROLL])
    turn = np.array([[c[0], 0, s[0]], [0, 1, 0], [-s[0], 0, c[0]]])
    tilt = np.array([[1, 0, 0], [0, c[1], -s[1]], [0, s[1], c[1]]])
    roll = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    view, clip = np.eye(4), np.eye(4)
    view[:3, :3] = roll @ tilt @ turn
    scale = np.array([PANEL[1] / PANEL[0], 1.0, -HALF_HEIGHT / DEPTH]) / HALF_HEIGHT
    clip[:3, :3] = scale[:, None] * view[:3, :3]
    clip[:3, 3] = -clip[:3, :3] @ CENTRE + [0, 0, 0.5]
    return clip.astype(np.float32), view.astype(np.float32)


class Studio:
    """A device, the bend on it, and one shader module a lighting."""

    def __init__(self, bend: Bend) -> None:
        self.bend = bend
        self.device: Any = wgpu.gpu.request_adapter_sync().request_device_sync()
        self.modules = {
            lighting: self.device.create_shader_module(code=shader(lighting))
            for lighting in (STANDARD, ACCURATE)
        }

    def measured(self, lighting: Lighting) -> Array:
        """Return the normals (V, 3) that a lighting's shader computes, not unit."""
        size = 16 * len(self.bend.positions)
        results = self._buffer(bytes(size), wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC)
        pipeline = self.device.create_compute_pipeline(
            layout="auto", compute={"module": self.modules[lighting], "entry_point": "measure"}
        )
        encoder = self.device.create_command_encoder()
        step = encoder.begin_compute_pass()
        step.set_pipeline(pipeline)
        step.set_bind_group(0, self._group(pipeline, {**self._mesh(np.zeros(size // 16)), 2: results}))
        step.dispatch_workgroups(-(-size // 16 // 64))
        step.end()
        self.device.queue.submit([encoder.finish()])
        found = np.frombuffer(self.device.queue.read_buffer(results), np.float32).reshape(-1, 4)
        return found[:, :3].astype(np.float64)

    def picture(self, lighting: Lighting, mode: int, errors: Array) -> Image.Image:
        """Render one panel, errors (V,) in degrees."""
        size = (SUPERSAMPLING * PANEL[0], SUPERSAMPLING * PANEL[1], 1)
        usage = wgpu.TextureUsage.RENDER_ATTACHMENT
        colour = self.device.create_texture(
            size=size, format="rgba8unorm", usage=usage | wgpu.TextureUsage.COPY_SRC
        )
        depth = self.device.create_texture(size=size, format="depth32float", usage=usage)
        pipeline = self._render_pipeline(lighting)
        matrices = [matrix.T.tobytes() for matrix in camera()]
        scene = b"".join([*matrices, np.array([mode, 0, 0, 0], np.uint32).tobytes()])
        bound = {**self._mesh(errors), 3: self._buffer(scene, wgpu.BufferUsage.UNIFORM)}
        indices = self._buffer(self.bend.triangles.tobytes(), wgpu.BufferUsage.INDEX)
        encoder = self.device.create_command_encoder()
        step = encoder.begin_render_pass(**_attachments(colour.create_view(), depth.create_view()))
        step.set_pipeline(pipeline)
        step.set_bind_group(0, self._group(pipeline, bound))
        step.set_index_buffer(indices, "uint32")
        step.draw_indexed(self.bend.triangles.size)
        step.end()
        self.device.queue.submit([encoder.finish()])
        return self._reduced(colour, size)

    def _render_pipeline(self, lighting: Lighting) -> Any:
        module = self.modules[lighting]
        return self.device.create_render_pipeline(
            layout="auto",
            vertex={"module": module, "entry_point": "vertex"},
            primitive={"topology": "triangle-list"},
            depth_stencil={"format": "depth32float", "depth_write_enabled": True, "depth_compare": "less"},
            fragment={"module": module, "entry_point": "fragment", "targets": [{"format": "rgba8unorm"}]},
        )

    def _mesh(self, errors: Array) -> dict[int, Any]:
        """Return the buffers of joints and rows: seven vec4 a vertex, as ``skinned`` reads them."""
        bend = self.bend
        truth = np.column_stack([bend.true_normals, errors])
        columns: list[npt.NDArray[np.floating]] = [bend.positions, bend.normals, bend.joints, bend.weights]
        columns += [bend.alpha, bend.beta, truth]
        padded = [np.pad(column, ((0, 0), (0, 4 - column.shape[1]))) for column in columns]
        rows = np.stack(padded, axis=1).astype(np.float32).tobytes()
        joints = bend.matrices.transpose(0, 2, 1).tobytes()
        return {0: self._buffer(joints), 1: self._buffer(rows)}

    def _buffer(self, data: bytes, usage: int = wgpu.BufferUsage.STORAGE) -> Any:
        return self.device.create_buffer_with_data(data=data, usage=usage)

    def _group(self, pipeline: Any, buffers: dict[int, Any]) -> Any:
        return self.device.create_bind_group(
            layout=pipeline.get_bind_group_layout(0),
            entries=[{"binding": n, "resource": {"buffer": buffer}} for n, buffer in buffers.items()],
        )

    def _reduced(self, texture: Any, size: tuple[int, int, int]) -> Image.Image:
        """Return the texture at the panel's size, every pixel the mean of its samples."""
        data = self.device.queue.read_texture(
            {"texture": texture}, {"bytes_per_row": 4 * size[0], "rows_per_image": size[1]}, size
        )
        samples = np.frombuffer(data, np.uint8).reshape(size[1], size[0], 4)
        return Image.fromarray(samples[..., :3].copy()).resize(PANEL, Image.Resampling.BOX)


def _attachments(colour: Any, depth: Any) -> dict[str, Any]:
    clear = {"load_op": "clear", "store_op": "store"}
    return {
        "color_attachments": [{"view": colour, "clear_value": (*BACKGROUND, 1.0), **clear}],
        "depth_stencil_attachment": {
            "view": depth,
            "depth_clear_value": 1.0,
            "depth_load_op": "clear",
            "depth_store_op": "discard",
        },
    }


def figures(studio: Studio) -> dict[Lighting, tuple[Array, ErrorSummary]]:
    """Return each lighting's errors (V,) in degrees, and their summary over the surface."""
    found = {}
    for lighting in (STANDARD, ACCURATE):
        errors = angular_errors(studio.measured(lighting)[None], studio.bend.true_normals[None])
        summary = summarise(errors, studio.bend.areas)
        assert summary is not None
        found[lighting] = (errors[0], summary)
    return found


def compose(studio: Studio, found: dict[Lighting, tuple[Array, ErrorSummary]]) -> Image.Image:
    """Put the panels together: lit by standard, accurate and true normals, and the errors of two.

    found is that of ``figures``.
    """
    width, height = PANEL
    sheet = Image.new("RGB", (3 * width + 4 * MARGIN, HEADER + 2 * (height + MARGIN)), "white")
    draw = ImageDraw.Draw(sheet)
    columns = [
        ("Standard lighting", STANDARD, _words(found[STANDARD][1])),
        ("Accurate lighting", ACCURATE, _words(found[ACCURATE][1])),
        ("True normals", None, "measured on the deformed surface"),
    ]
    for number, (title, lighting, line) in enumerate(columns):
        left = MARGIN + number * (width + MARGIN)
        draw.text((left + width / 2, 32), title, INK, font(26), "mm")
        draw.text((left + width / 2, 62), line, GREY, font(17), "mm")
        errors = found[lighting or STANDARD][0]
        lit = studio.picture(lighting or STANDARD, LIT if lighting else TRUE, errors)
        sheet.paste(lit, (left, HEADER))
        if lighting:
            sheet.paste(studio.picture(lighting, ERROR, errors), (left, HEADER + height + MARGIN))
    _draw_scale(draw, 2 * width + 3 * MARGIN, HEADER + height + MARGIN)
    return sheet


def _words(summary: ErrorSummary) -> str:
    return f"normals off by {summary.mean:.1f}° on average, {summary.max:.0f}° at worst"


def _draw_scale(draw: ImageDraw.ImageDraw, left: int, top: int) -> None:
    """Draw the scale of the errors into the panel that is left over."""
    width = PANEL[0]
    draw.text((left + width / 2, top + 110), "Error of the normals", INK, font(24), "mm")
    draw.text((left + width / 2, top + 140), "angle to the true ones", GREY, font(17), "mm")
    start, length, bar = left + 50, width - 100, top + 172
    for column in range(length):
        colour = heat(np.array(SCALE_TOP * column / (length - 1)))
        draw.line([(start + column, bar), (start + column, bar + 18)], tuple(round(255 * c) for c in colour))
    for degrees in range(0, int(SCALE_TOP) + 1, 5):
        x = start + (length - 1) * degrees / SCALE_TOP
        draw.line([(x, bar + 18), (x, bar + 24)], GREY)
        label = f"{degrees}°+" if degrees == SCALE_TOP else f"{degrees}°"
        draw.text((x, bar + 38), label, GREY, font(16), "mm")


def main() -> None:
    """Draw the picture unless asked for the figures alone, and print these."""
    studio = Studio(strongest_bend())
    found = figures(studio)
    for lighting, (_, summary) in found.items():
        print(f"{lighting}: mean {summary.mean:.2f}°, p95 {summary.p95:.2f}°, max {summary.max:.2f}°")
    if "--figures" in sys.argv[1:]:
        return
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else REPOSITORY / "docs" / "shaders.png"
    target.parent.mkdir(exist_ok=True)
    compose(studio, found).save(target, optimize=True)
    print(f"{target}: {target.stat().st_size:,} bytes, by {studio.device.adapter_info['device']}")


if __name__ == "__main__":
    main()
