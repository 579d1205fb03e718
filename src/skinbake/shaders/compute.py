"""What the text of a compute pass has beside the functions: the numbers of a primitive, and what it reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from skinbake.choices import Frame, Language, Method, Morphs
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.storage import KINDS, Made

IN_GLSL = ("vec2", "vec3", "vec4", "uvec4", "uint", "float", "uvec2")
TYPES = {
    language: dict(zip(IN_GLSL, names, strict=True))
    for language, names in {
        Language.GLSL: IN_GLSL,
        Language.WGSL: ("vec2<f32>", "vec3<f32>", "vec4<f32>", "vec4<u32>", "u32", "f32", "vec2<u32>"),
        Language.HLSL: ("float2", "float3", "float4", "uint4", "uint", "float", "uint2"),
    }.items()
}
"""The types of each language by their names in GLSL."""

MATRICES = {
    Language.GLSL: {Method.LBS: "mat4", Method.DQS: "mat2x4"},
    Language.WGSL: {Method.LBS: "mat4x4<f32>", Method.DQS: "mat2x4<f32>"},
    Language.HLSL: {Method.LBS: "float4x4", Method.DQS: "float2x4"},
}
"""The type of a joint's motion."""

POSITIVE = {
    Language.GLSL: "any(greaterThan({}, vec4(0.0)))",
    Language.WGSL: "any({} > vec4<f32>(0.0))",
    Language.HLSL: "any({} > 0.0)",
}
"""Whether one of four weights is positive."""

HEAD = (
    *("vertices", "targets", "joint_size", "weight_size"),
    *("posed_stride", "posed_position", "posed_normal", "posed_tangent"),
)
"""The first numbers of a primitive, whole ones. The scales of α and β and of the joints follow."""

ABSENT = "0xffffffff"
"""Stands for an offset where there is nothing."""


@dataclass(frozen=True, slots=True)
class Sum:
    """One sum over morph targets: its name in a target, its type, the variable, and what it begins with."""

    name: str
    type: str
    variable: str
    start: str


def compute_context(
    choices: ShaderChoices, assembled: Sequence[Any], arguments: Sequence[str]
) -> Mapping[str, Any]:
    """Return the values for the template of a compute pass.

    assembled are the parts of α and β in texture coordinates; arguments belong to the call in a vertex
    stage.
    """
    reads = [_read("position", "vec3"), _read("normal", "vec3", "normal")]
    reads += [_read("tangent", "vec4")] if choices.frame == Frame.TANGENT else []
    sets = range(choices.influence_sets)
    for number in sets:
        name = f"joints_{number}"
        call = f"skinbake_integers(skinbake_draw.{name}, vertex, skinbake_draw.joint_size)"
        reads.append(Made(name, "uvec4", call))
    reads += [_read(f"weights_{number}", "vec4", "weights") for number in sets]
    if choices.decodes:
        reads += [_read(f"stored_{kind}_{number}", "vec4", "stored") for kind, number in product(KINDS, sets)]
    elif choices.assembles:
        names = dict.fromkeys(name.lower() for part in assembled for name in part.names)
        reads += [_read(name, "vec2") for name in names]
    elif choices.reads_gradients:
        reads += [
            _read(f"{kind}_{number}", "vec4" if number else "vec3") for kind, number in product(KINDS, sets)
        ]
    words = TYPES[choices.language]
    given = [*arguments]
    if choices.morphs is not Morphs.NONE:
        given[0] = "morphed_position"
    if choices.lighting == "direct" and choices.language is Language.HLSL:
        given[-1] = "a"
    # The sums over morph targets that the frame of the choices needs, and that of the position.
    sums = [Sum("position", "vec3", "morphed_position", "position")]
    if choices.morphs is not Morphs.FRAMES:
        sums.append(Sum("normal", "vec3", "morphed_normal", "normal"))
    if choices.morphs is Morphs.TANGENT:
        sums.append(Sum("tangent", "vec3", "morphed_tangent", "tangent.xyz"))
    zeros = {Language.GLSL: "vec%d(0.0)", Language.WGSL: "vec%d<f32>()", Language.HLSL: "0.0"}
    numbers = [("morph", 4)] if choices.morphs.moves_frame else []
    numbers += [("morph_up", 2)] if choices.morphs is Morphs.FRAMES else []
    for name, size in numbers:
        sums.append(Sum(name, f"vec{size}", name, zeros[choices.language].replace("%d", str(size))))
    return {
        "absent": ABSENT,
        "draw_members": [
            *((words["uint"], name) for name in HEAD),
            *((words["float"], name) for name in ("scale", "joint_scale")),
            *((words["uvec2"], read.name) for read in reads),
        ],
        "compute_reads": reads,
        "motion_type": "skinbake_ScaledMotion"
        if choices.scaled_joints
        else MATRICES[choices.language][Method.LBS if choices.method is Method.LBS else Method.DQS],
        "motion_name": "M" if choices.method is Method.LBS else "Q",
        "scales_joints": choices.method is Method.DQS and not choices.scaled_joints,
        "is_bound": " || ".join(POSITIVE[choices.language].format(f"weights_{number}") for number in sets),
        "slot_joints": [f"joints_{slot // 4}.{'xyzw'[slot % 4]}" for slot in range(choices.influences)],
        "morphed": sums,
        "arguments_of_compute": given,
    }


def _read(name: str, kind: str, function: str = "") -> Made:
    return Made(name, kind, f"skinbake_{function or kind}(skinbake_draw.{name}, vertex)")
