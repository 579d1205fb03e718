"""The WGSL of every step: ``skinbake shader``'s text or recompute.wgsl, with bindings and an entry point."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from benchmarks.gpu.meshes import INFLUENCES
from benchmarks.gpu.variants import LAYOUTS, Step, Variant
from skinbake.choices import Encoding, Method
from skinbake.shaders.choices import ShaderChoices
from tests.support.whole_fields import shader_text

WORKGROUP = 64
COUNTS = """struct Counts {
    vertices: u32,
    triangles: u32,
    joints: u32,
    scale: f32, // of the encoded gradients
}
"""
VERTEX_FORMATS = {
    "position": ("float32x3",),
    "normal": ("float32x3",),
    "joints": ("uint8x4",),
    "weights": ("float32x4",),
    "gradients_float32": ("float32x3", "float32x3"),
    "gradients_snorm16": ("snorm16x4", "snorm16x4"),
    "gradients_packed8": ("snorm8x4", "snorm8x4"),
}
"""The attributes in a vertex buffer of the vertex shader."""

_DECODED = {
    "gradients_float32": """    let g0 = gradients_float32[3u * i];
    let g1 = gradients_float32[3u * i + 1u];
    let g2 = gradients_float32[3u * i + 2u];
    let alpha_0 = vec3<f32>(g0, g1.x);
    let beta_0 = vec3<f32>(g1.y, g2);
""",
    "gradients_snorm16": """    let g0 = gradients_snorm16[2u * i];
    let g1 = gradients_snorm16[2u * i + 1u];
    let alpha_0 = skinbake_decoded(vec4<f32>(unpack2x16snorm(g0.x), unpack2x16snorm(g0.y)), counts.scale);
    let beta_0 = skinbake_decoded(vec4<f32>(unpack2x16snorm(g1.x), unpack2x16snorm(g1.y)), counts.scale);
""",
    "gradients_packed8": """    let g0 = gradients_packed8[2u * i];
    let g1 = gradients_packed8[2u * i + 1u];
    let alpha_0 = skinbake_decoded(unpack4x8snorm(g0), counts.scale);
    let beta_0 = skinbake_decoded(unpack4x8snorm(g1), counts.scale);
""",
}


def compute_text(variant: Variant, step: Step) -> str:
    """Return a compute shader, entry point ``main``: x counts what the step is over, y the instances."""
    body = _recompute_text(step) if variant.choices is None else _skinning_text(variant.choices, step)
    guard = f"""@compute @workgroup_size({WORKGROUP})
fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
    if (id.x < counts.{"triangles" if step.over == "triangle" else "vertices"}) {{
        run(id.x, id.y);
    }}
}}
"""
    return "\n".join([COUNTS, *_declarations(step), body, guard])


def _declarations(step: Step) -> list[str]:
    found = ["@group(0) @binding(0) var<uniform> counts: Counts;"]
    for number, name in enumerate(step.buffers, start=1):
        access = "read" if name in step.reads else "read_write"
        kind = LAYOUTS[name].type
        kind = f"atomic<{kind}>" if name in step.updates else kind
        found.append(f"@group(0) @binding({number}) var<storage, {access}> {name}: array<{kind}>;")
    return found


@cache
def _recompute_parts() -> dict[str, str]:
    """Return the functions that all steps may use, by name, and each step's own ones under its entry."""
    text = Path(__file__).with_name("recompute.wgsl").read_text(encoding="utf-8")
    common, *steps = re.split(r"^//: ", text, flags=re.MULTILINE)
    functions = re.findall(r"(?:^//[^\n]*\n)*^fn (?:.|\n)*?^}\n\n?", common, flags=re.MULTILINE)
    found = {"": common[: common.index(functions[0])]}
    for function in functions:
        name = re.search(r"^fn (\w+)", function, flags=re.MULTILINE)
        assert name is not None
        found[name[1]] = function
    return found | dict(step.split("\n", 1) for step in steps)


def _recompute_text(step: Step) -> str:
    """Return the constants, the functions that the step needs, and the step's own."""
    parts = _recompute_parts()
    needed = [step.entry]
    for name in needed:
        called = dict.fromkeys(re.findall(r"(\w+)\(", parts[name]))
        needed += [one for one in called if one in parts and one not in needed]
    return "".join([parts[""], *(parts[name] for name in reversed(needed))])


def _call(choices: ShaderChoices, gradients: str) -> str:
    palette = _palette(choices)
    gathered = ", ".join(f"{palette}[slots.{slot}]" for slot in "xyzw")
    return f"""    let moved = array<{LAYOUTS[palette].type}, {INFLUENCES}>({gathered});
    let v = skinbake_{choices.stem}(p, skinbake_frame(n), moved, w{gradients});
"""


def _palette(choices: ShaderChoices) -> str:
    return "matrices" if choices.method is Method.LBS else "quaternions"


def _skinning_text(choices: ShaderChoices, step: Step) -> str:
    """Return a function that skins a vertex in one pose with the text of ``skinbake shader``."""
    stored = next((name for name in step.reads if name.startswith("gradients")), "")
    vectors = "".join(
        f"    let {short} = vec3<f32>({name}[3u * i], {name}[3u * i + 1u], {name}[3u * i + 2u]);\n"
        for short, name in (("p", "position"), ("n", "normal"))
    )
    writes = "".join(
        f"    {buffer}[{row}u * posed + {first + axis}u] = v.{vector}.{'xyz'[axis]};\n"
        for buffer, row, first, vector in (
            ("posed_position", 3, 0, "position"),
            ("posed_frame", 6, 0, "normal"),
            ("posed_frame", 6, 3, "tangent"),
        )
        for axis in range(3)
    )
    return f"""{shader_text(choices)}
fn run(i: u32, instance: u32) {{
    let slots = unpack4xU8(joints[i]) + instance * counts.joints;
    let w = weights[i];
{vectors}{_DECODED.get(stored, "")}{_call(choices, ", alpha_0, beta_0" if stored else "")}\
    let posed = instance * counts.vertices + i;
{writes}}}
"""


def drawn_text(choices: ShaderChoices) -> str:
    """Return a vertex shader and a fragment shader: the normal as a colour, seen along the z axis."""
    palette = _palette(choices)
    stored = ""
    gradients = ""
    if choices.reads_gradients:
        size = 3 if choices.encoding is Encoding.FLOAT32 else 4
        stored = f"    @location(4) alpha: vec{size}<f32>,\n    @location(5) beta: vec{size}<f32>,\n"
        gradients = ", given.alpha, given.beta"
        if choices.decodes:
            gradients = "".join(
                f", skinbake_decoded(given.{name}, counts.scale)" for name in ("alpha", "beta")
            )
    return f"""{shader_text(choices)}
{COUNTS}
@group(0) @binding(0) var<uniform> counts: Counts;
@group(0) @binding(1) var<storage, read> {palette}: array<{LAYOUTS[palette].type}>;

struct Given {{
    @location(0) position: vec3<f32>,
    @location(1) normal: vec3<f32>,
    @location(2) joints: vec4<u32>,
    @location(3) weights: vec4<f32>,
{stored}}}
struct Varying {{
    @builtin(position) position: vec4<f32>,
    @location(0) normal: vec3<f32>,
}}

@vertex
fn vertex(given: Given, @builtin(instance_index) instance: u32) -> Varying {{
    let slots = given.joints + instance * counts.joints;
    let p = given.position;
    let n = given.normal;
    let w = given.weights;
{_call(choices, gradients)}\
    return Varying(vec4<f32>(v.position.xy, 0.5 + 0.1 * v.position.z, 1.0), v.normal);
}}

@fragment
fn fragment(drawn: Varying) -> @location(0) vec4<f32> {{
    return vec4<f32>(0.5 + 0.5 * normalize(drawn.normal), 1.0);
}}
"""
