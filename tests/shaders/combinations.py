"""Every choice that changes a text, and a whole shader around each text, made of its own "Use:" lines."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from skinbake.choices import Frame, Language, Lighting, Method, Morphs, Stage
from skinbake.options import PUBLISHED_CAP
from skinbake.shaders.choices import ALGORITHMS, BEST, BLENDED, ShaderChoices
from tests.support.whole_fields import shader_text

FRAMES = (Frame.NORMAL, Frame.TANGENT)
INFLUENCES = range(1, 9)
MANY_INFLUENCES = (9, 12)
"""The first of a third set, and all of three sets."""

STORED: tuple[dict[str, Any], ...] = (
    {"encoding": "snorm16"},
    {"encoding": "packed8", "scale": 2.5},
    {"encoding": "packed8", "layout": "custom"},
    {"layout": "texcoord"},
    {"layout": "custom"},
)
"""How else α and β may be stored; the scale known and not."""

ATTRIBUTES = ("position", "normal", "tangent", "bitangent")
"""The members of skinbake_Vertex, in the order in which ``glsl`` and ``wgsl`` write them."""

TEXELS = ((0.36, -0.48, 0.8), (-0.6, 0.0, 0.8))
"""Two normals of a normal map. With one, the mapped normals take the place of tangent and bitangent."""


SCALED = "skinbake_ScaledMotion"

GLSL_MOTIONS = {
    "lbs": ("mat4", "matrices"),
    "dqs": ("mat2x4", "quaternions"),
    "scaled": (SCALED, "scaled"),
}
"""The type of a joint's motion in GLSL, and the member of the uniform block that holds them."""


def motion_kind(choices: ShaderChoices) -> str:
    """Return which motions of joints a text takes, blended ones beside matrices: lbs, dqs or scaled."""
    if choices.scaled_joints:
        return "scaled"
    return "lbs" if choices.method is Method.LBS else "dqs"


def combinations(language: Language) -> list[ShaderChoices]:
    """Return the 96 of the six algorithms, one to eight influences and both frames."""
    return [
        ShaderChoices(language, method, lighting, influences, frame)
        for (method, lighting), influences, frame in product(ALGORITHMS, INFLUENCES, FRAMES)
    ]


def variants(language: Language) -> list[ShaderChoices]:
    """Return what the options and further influence sets add to ``combinations``."""
    every = [choices for choices in combinations(language) if choices.influences in (1, 2, 4, 8)]
    capped = [replace(choices, cap=PUBLISHED_CAP) for choices in every if choices.is_corrected]
    mirrored = [replace(choices, mirrored_joints=True) for choices in every if choices.crosses]
    both = [replace(choices, cap=PUBLISHED_CAP) for choices in mirrored if choices.influences == 4]
    mapped = [replace(choices, normal_map=True) for choices in every if choices.is_corrected]
    mapped += [replace(choices, normal_map=True) for choices in both]
    fours = [choices for choices in combinations(language) if choices.influences == 4]
    many = [replace(choices, influences=count) for choices, count in product(fours, MANY_INFLUENCES)]
    return [*capped, *mirrored, *both, *mapped, *many, *_scaled_joints(language), *_blended(language)]


def _scaled_joints(language: Language) -> list[ShaderChoices]:
    """Return what dual quaternions of joints that scale add."""
    every = [
        ShaderChoices(language, Method.DQS, Lighting.EXACT, influences, frame, scaled_joints=True)
        for influences, frame in product((1, 2, 4, 9), FRAMES)
    ]
    mirrored = [replace(choices, mirrored_joints=True) for choices in every]
    both = [replace(choices, cap=PUBLISHED_CAP, normal_map=True) for choices in (*every, *mirrored)]
    return [*every, *mirrored, *both]


def _blended(language: Language) -> list[ShaderChoices]:
    """Return what blended skinning adds."""
    every = [
        ShaderChoices(language, Method.BLEND, lighting, influences, frame)
        for lighting, influences, frame in product(BLENDED, (1, 2, 4, 9), FRAMES)
    ]
    best = [choices for choices in every if choices.is_corrected]
    scaled = [replace(choices, scaled_joints=True) for choices in best]
    mirrored = [replace(choices, mirrored_joints=True) for choices in scaled]
    return [*every, *scaled, *mirrored, *(replace(choices, cap=PUBLISHED_CAP) for choices in best + mirrored)]


def stored_and_morphed(language: Language) -> list[ShaderChoices]:
    """Return what encodings, layouts and morph targets add to the best lighting, also together."""
    methods = [ShaderChoices(language, method, BEST[method]) for method in (Method.LBS, Method.DQS)]
    found = []
    for choices, influences, frame in product(methods, (4, 8), FRAMES):
        base = replace(choices, influences=influences, frame=frame)
        morphs = [Morphs.NORMAL, *([Morphs.TANGENT] if frame == Frame.TANGENT else [])]
        moved = [Morphs.FRAMES, Morphs.FRAMES_NORMAL]
        found += [replace(base, **storage) for storage in STORED]
        found += [replace(base, morphs=kind) for kind in (*morphs, *moved)]
        mapped = [replace(base, morphs=kind, normal_map=True) for kind in (*morphs, *moved)]
        found += mapped if influences == 4 else []
        found += [replace(base, **storage, morphs=morphs[-1]) for storage in STORED[1:4:2]]
    blend = ShaderChoices(language, Method.BLEND, BEST[Method.BLEND], 8, Frame.TANGENT, scaled_joints=True)
    found += [replace(blend, **storage) for storage in STORED[1:4:2]]
    return [*found, *(replace(blend, morphs=kind) for kind in (Morphs.TANGENT, Morphs.FRAMES))]


def together(language: Language) -> dict[str, list[ShaderChoices]]:
    """Return the same in groups that differ in nothing but the algorithm: they can be included together."""
    groups: dict[str, list[ShaderChoices]] = {}
    for name, choices in every_text(language).items():
        groups.setdefault(name.partition("-")[2], []).append(choices)
    return groups


def every_text(language: Language) -> dict[str, ShaderChoices]:
    """Return all combinations and variants by a name that is a file name too."""
    return _named([*combinations(language), *variants(language)])


def fewer(every: Mapping[str, ShaderChoices]) -> dict[str, ShaderChoices]:
    """Return both frames and all options with four influences; other counts in one frame, without options.

    For what is slow, where another test has all of them.
    """
    return {
        name: choices
        for name, choices in every.items()
        if choices.influences == 4
        or (choices.influences in (1, 8, 9) and choices.frame == Frame.TANGENT and not _has_option(choices))
    }


def _has_option(choices: ShaderChoices) -> bool:
    """Tell whether a cap or mirrored joints change the text."""
    return choices.cap is not None or choices.mirrored_joints


def every_stored_and_morphed(language: Language) -> dict[str, ShaderChoices]:
    """Return the further ones of ``stored_and_morphed`` by name."""
    return _named(stored_and_morphed(language))


def _named(several: Sequence[ShaderChoices]) -> dict[str, ShaderChoices]:
    named = {label(choices): choices for choices in several}
    assert len(named) == len(several)
    return named


def label(choices: ShaderChoices) -> str:
    """Return a short name of the choices, without the language: ``dqs_exact-4-tangent-cap``."""
    words = [choices.stem, str(choices.influences), choices.frame]
    words += ["cap"] if choices.cap is not None else []
    words += ["mirrored"] if choices.mirrored_joints else []
    words += ["mapped"] if choices.normal_map else []
    words += [choices.encoding] if choices.encoding != "float32" else []
    words += [choices.layout] if choices.layout != "attributes" else []
    words += [f"morphed_{choices.morphs}"] if choices.morphs is not Morphs.NONE else []
    words += ["compute"] if choices.stage is Stage.COMPUTE else []
    return "-".join(words)


def usage(text: str) -> list[str]:
    """Return the lines of code that the header prints below "Use:"."""
    lines = iter(text.splitlines())
    for line in lines:
        if line == "// Use:":
            break
    return [line.removeprefix("//").strip() for line in _while_comment(lines)]


def _while_comment(lines: Iterator[str]) -> Iterator[str]:
    for line in lines:
        if not line.startswith("//"):
            return
        yield line


@dataclass(frozen=True, slots=True)
class Column:
    """One vertex attribute as the wrapped shaders read it: four numbers a vertex, the first ``size`` used."""

    name: str
    size: int
    is_integer: bool = False

    def of_type(self, language: Language) -> str:
        """Return the type in a shading language."""
        if language is Language.GLSL:
            return f"{'u' if self.is_integer else ''}vec{self.size}"
        if language is Language.HLSL:
            return f"{'uint' if self.is_integer else 'float'}{self.size}"
        return f"vec{self.size}<{'u32' if self.is_integer else 'f32'}>"


def columns(choices: ShaderChoices) -> list[Column]:
    """Return the attributes that a shader reads; ``point`` is POSITION and in w the joints' common scale.

    Those of morph targets are what the caller has added up.
    """
    found = [Column("point", 4), Column("normal", 3)]
    if choices.frame == Frame.TANGENT or choices.normal_map:
        found.append(Column("tangent", 4))
    sets = range(choices.influence_sets)
    found += [Column(f"joints_{number}", 4, is_integer=True) for number in sets]
    found += [Column(f"weights_{number}", 4) for number in sets]
    if choices.morphs not in (Morphs.NONE, Morphs.FRAMES):
        found.append(Column("morphed_normal", 3))
    if choices.morphs is Morphs.TANGENT:
        found.append(Column("morphed_tangent", 3))
    if choices.morphs.moves_frame:
        found.append(Column("morph", 4))
    if choices.morphs is Morphs.FRAMES:
        found.append(Column("morph_up", 2))
    kinds = ("alpha", "beta")
    if choices.decodes:
        found += [Column(f"stored_{kind}_{number}", 4) for kind, number in product(kinds, sets)]
    elif choices.assembles:
        shown = " ".join(usage(shader_text(choices)))
        found += [Column(name, 2) for name in dict.fromkeys(re.findall(r"\btexcoord_\d+", shown))]
    elif choices.reads_gradients:
        found += [Column(f"{kind}_{number}", 4 if number else 3) for kind, number in product(kinds, sets)]
    if choices.method is Method.BLEND:
        found.append(Column("blend", 3))
    return found


def glsl(several: Sequence[ShaderChoices], version: str, motions: int = 64) -> str:
    """Return a vertex shader with the texts of one or several choices, called one after the other.

    version is what follows ``#version``. The uniform blocks of GLSL_MOTIONS hold ``motions`` joints.
    posed_position … posed_bitangent are what it writes, the sum where there are several.
    """
    reads = {column.name: column for choices in several for column in columns(choices)}
    head = [f"#version {version}"]
    head += ["precision highp float;", "precision highp int;"] if version.endswith("es") else []
    return "\n".join(
        [
            *head,
            *(shader_text(choices) for choices in several),
            "const float scale = 2.0;",
            *(f"in {column.of_type(Language.GLSL)} {column.name};" for column in reads.values()),
            f"layout(std140) uniform Matrices {{ mat4 matrices[{motions}]; }};",
            f"layout(std140) uniform Quaternions {{ mat2x4 quaternions[{motions}]; }};",
            *(
                f"layout(std140) uniform Scaled {{ {SCALED} scaled[{motions}]; }};"
                for _ in range(any(choices.scaled_joints for choices in several))
            ),
            *(f"out vec3 posed_{attribute};" for attribute in ATTRIBUTES),
            "void main() {",
            *(f"posed_{attribute} = vec3(0.0);" for attribute in ATTRIBUTES),
            *(line for choices in several for line in _glsl_call(choices)),
            "gl_Position = vec4(posed_position, 1.0);",
            "}",
        ]
    )


def _glsl_call(choices: ShaderChoices) -> list[str]:
    motions = [(*GLSL_MOTIONS[motion_kind(choices)], "M" if choices.method is Method.LBS else "Q")]
    motions += [("mat4", "matrices", "M")] if choices.method is Method.BLEND else []
    return [
        "{",
        *(f"{kind} {name}[{choices.influences}];" for kind, _, name in motions),
        *(
            f"{name}[{slot}] = {table}[{joint}];"
            for _, table, name in motions
            for slot, joint in enumerate(_joints(choices))
        ),
        f"vec3 {_position(choices)} = point.w * point.xyz;",
        *_scaled(usage(shader_text(choices)), "skinbake_Frame"),
        *(
            f"posed_{attribute} += {value};"
            for attribute, value in zip(ATTRIBUTES, _results(choices, "vec3"), strict=True)
        ),
        "} }",
    ]


def wgsl(choices: ShaderChoices) -> str:
    """Return a compute shader, 64 vertices a workgroup: bindings 0 motions, 1 columns, 2 the results.

    Of blended skinning 3, too: the matrices beside the motions.
    """
    own = shader_text(choices)
    kind = {"lbs": "mat4x4<f32>", "dqs": "mat2x4<f32>", "scaled": SCALED}[motion_kind(choices)]
    name = "M" if choices.method is Method.LBS else "Q"
    reads = columns(choices)
    is_blend = choices.method is Method.BLEND
    matrices = ", ".join(f"matrices[{joint}]" for joint in _joints(choices))
    chosen = ", ".join(f"motions[{joint}]" for joint in _joints(choices))
    loads = []
    for number, column in enumerate(reads):
        value = f"columns[{len(reads)}u * row + {number}u]"
        value = f"bitcast<vec4<u32>>({value})" if column.is_integer else value
        loads.append(f"let {column.name} = {value}{'.' + 'xyzw'[: column.size]};")
    return "\n".join(
        [
            own,
            "const scale = 2.0;",
            f"@group(0) @binding(0) var<storage, read> motions: array<{kind}>;",
            "@group(0) @binding(1) var<storage, read> columns: array<vec4<f32>>;",
            "@group(0) @binding(2) var<storage, read_write> results: array<vec4<f32>>;",
            *["@group(0) @binding(3) var<storage, read> matrices: array<mat4x4<f32>>;"][: int(is_blend)],
            "@compute @workgroup_size(64)",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            "let row = id.x;",
            "if (4u * row >= arrayLength(&results)) { return; }",
            *loads,
            f"let {name} = array<{kind}, {choices.influences}>({chosen});",
            *[f"let M = array<mat4x4<f32>, {choices.influences}>({matrices});"][: int(is_blend)],
            f"let {_position(choices)} = point.w * point.xyz;",
            *_scaled(usage(own), "let"),
            *(
                f"results[4u * row + {number}u] = vec4<f32>({value}, 0.0);"
                for number, value in enumerate(_results(choices, "vec3<f32>"))
            ),
            "} }",
        ]
    )


def hlsl(several: Sequence[ShaderChoices]) -> str:
    """Return a compute shader as ``wgsl``, of texts of one method that can be included together.

    It reads ``shared_columns``, and writes the results of all texts side by side. Matrices have HLSL's
    default packing.
    """
    kind = "float4x4" if several[0].method is Method.LBS else "float4"
    reads = shared_columns(several)
    loads = []
    for number, column in enumerate(reads):
        value = f"columns[{len(reads)} * row + {number}].{'xyzw'[: column.size]}"
        value = f"asuint({value})" if column.is_integer else value
        loads.append(f"{column.of_type(Language.HLSL)} {_hlsl_name(column.name)} = {value};")
    return "\n".join(
        [
            *(shader_text(choices) for choices in several),
            "static const float scale = 2.0;",
            f"StructuredBuffer<{kind}> motions : register(t0);",
            "StructuredBuffer<float4> columns : register(t1);",
            "RWStructuredBuffer<float4> results : register(u2);",
            *(
                "StructuredBuffer<float4x4> matrices : register(t3);"
                for _ in range(several[0].method is Method.BLEND)
            ),
            "[numthreads(64, 1, 1)]",
            "void main(uint3 id : SV_DispatchThreadID) {",
            "uint row = id.x, count, size;",
            "results.GetDimensions(count, size);",
            f"if ({len(ATTRIBUTES) * len(several)} * row >= count) return;",
            *loads,
            *(line for at, choices in enumerate(several) for line in _hlsl_call(choices, at, len(several))),
            "}",
        ]
    )


def shared_columns(several: Sequence[ShaderChoices]) -> list[Column]:
    """Return the attributes that any of the texts reads."""
    return list({column.name: column for choices in several for column in columns(choices)}.values())


def _hlsl_call(choices: ShaderChoices, at: int, count: int) -> list[str]:
    kind = {"lbs": "float4x4", "dqs": "float2x4", "scaled": SCALED}[motion_kind(choices)]
    name = "M" if choices.method is Method.LBS else "Q"
    take = {
        "float4x4": "{0} = motions[{1}];",
        "float2x4": "{0} = float2x4(motions[2 * {1}], motions[2 * {1} + 1]);",
        SCALED: "for (uint i = 0; i < 4; i++) {0}.moved[i] = motions[5 * {1} + i]; "
        "{0}.turn = motions[5 * {1} + 4];",
    }[kind]
    return [
        "{",
        f"{kind} {name}[{choices.influences}];",
        *(take.format(f"{name}[{slot}]", joint) for slot, joint in enumerate(_joints(choices))),
        *(
            line
            for _ in range(choices.method is Method.BLEND)
            for line in (
                f"float4x4 M[{choices.influences}];",
                *(f"M[{slot}] = matrices[{joint}];" for slot, joint in enumerate(_joints(choices))),
            )
        ),
        f"float3 {_position(choices)} = place.w * place.xyz;",
        *_hlsl_scaled(usage(shader_text(choices))),
        *(
            f"results[{len(ATTRIBUTES)} * ({count} * row + {at}) + {number}] = float4({value}, 0.0);"
            for number, value in enumerate(_results(choices, "float3"))
        ),
        "}",
    ]


def _hlsl_name(name: str) -> str:
    """Return the name of a column; ``point`` is a word of HLSL's."""
    return "place" if name == "point" else name


def _hlsl_scaled(lines: list[str]) -> list[str]:
    made = next(at for at, line in enumerate(lines) if line.startswith("skinbake_Frame frame = ")) + 1
    return [*lines[:made], "frame.tangent *= place.w;", "frame.bitangent *= place.w;", *lines[made:]]


def _results(choices: ShaderChoices, vector: str) -> list[str]:
    """Return what a shader writes. Mapped normals have the length that the normal has."""
    found = [f"v.{attribute}" for attribute in ATTRIBUTES]
    if choices.normal_map:
        at = "map.normal, map.cotangent, map.cobitangent"
        calls = [f"skinbake_mapped_normal({vector}{texel}, {at})" for texel in TEXELS]
        found[2:] = [f"length(v.normal) * {call}" for call in calls]
    return found


def _joints(choices: ShaderChoices) -> list[str]:
    return [f"joints_{slot // 4}.{'xyzw'[slot % 4]}" for slot in range(choices.influences)]


def _position(choices: ShaderChoices) -> str:
    return "position" if choices.morphs is Morphs.NONE else "morphed_position"


def _scaled(lines: list[str], keyword: str) -> list[str]:
    """Return the usage lines with the frame scaled where they have made it; a block is left open."""
    scaled = "point.w * unscaled.tangent, point.w * unscaled.bitangent, unscaled.handedness"
    made = next(at for at, line in enumerate(lines) if line.startswith(f"{keyword} frame = ")) + 1
    return [
        *lines[:made],
        f"{keyword} unscaled = frame;",
        "{",
        f"{keyword} frame = skinbake_Frame(unscaled.normal, {scaled});",
        *lines[made:],
    ]
