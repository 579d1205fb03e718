"""Every choice that changes a text, and a whole shader around each text, made of its own "Use:" lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

from skinbake.geometry.frames import NORMAL_FRAME, TANGENT_FRAME
from skinbake.replay.surface import DEFAULT_CAP
from skinbake.shaders.choices import ALGORITHMS, Language, Method, ShaderChoices
from skinbake.shaders.text import shader_text

FRAMES = (NORMAL_FRAME, TANGENT_FRAME)
INFLUENCES = range(1, 9)
MANY_INFLUENCES = (9, 12)
"""The first of a third set, and all of three sets."""

ATTRIBUTES = ("position", "normal", "tangent", "bitangent")
"""The members of skinbake_Vertex, in the order in which ``glsl`` and ``wgsl`` write them."""


def combinations(language: Language) -> list[ShaderChoices]:
    """Return the 96 of the six algorithms, one to eight influences and both frames."""
    return [
        ShaderChoices(language, method, lighting, influences, frame)
        for (method, lighting), influences, frame in product(ALGORITHMS, INFLUENCES, FRAMES)
    ]


def variants(language: Language) -> list[ShaderChoices]:
    """Return what the options and further influence sets add to ``combinations``."""
    every = [choices for choices in combinations(language) if choices.influences in (1, 2, 4, 8)]
    capped = [replace(choices, cap=DEFAULT_CAP) for choices in every if choices.is_corrected]
    mirrored = [replace(choices, mirrored_joints=True) for choices in every if choices.crosses]
    both = [replace(choices, cap=DEFAULT_CAP) for choices in mirrored if choices.influences == 4]
    fours = [choices for choices in combinations(language) if choices.influences == 4]
    many = [replace(choices, influences=count) for choices, count in product(fours, MANY_INFLUENCES)]
    return [*capped, *mirrored, *both, *many]


def together(language: Language) -> dict[str, list[ShaderChoices]]:
    """Return the same in groups that differ in nothing but the algorithm: they can be included together."""
    groups: dict[str, list[ShaderChoices]] = {}
    for name, choices in every_text(language).items():
        groups.setdefault(name.partition("-")[2], []).append(choices)
    return groups


def every_text(language: Language) -> dict[str, ShaderChoices]:
    """Return all combinations and variants by a name that is a file name too."""
    return {label(choices): choices for choices in [*combinations(language), *variants(language)]}


def label(choices: ShaderChoices) -> str:
    """Return a short name of the choices, without the language: ``dqs_exact-4-tangent-cap``."""
    words = [choices.stem, str(choices.influences), choices.frame]
    words += ["cap"] if choices.cap is not None else []
    words += ["mirrored"] if choices.mirrored_joints else []
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
        return f"vec{self.size}<{'u32' if self.is_integer else 'f32'}>"


def columns(choices: ShaderChoices) -> list[Column]:
    """Return the attributes that a shader reads; ``rest`` is POSITION and in w the joints' common scale."""
    found = [Column("rest", 4), Column("normal", 3)]
    if choices.frame == TANGENT_FRAME:
        found.append(Column("tangent", 4))
    sets = range(choices.influence_sets)
    found += [Column(f"joints_{number}", 4, is_integer=True) for number in sets]
    found += [Column(f"weights_{number}", 4) for number in sets]
    if choices.reads_gradients:
        kinds = ("alpha", "beta")
        found += [Column(f"{kind}_{number}", 4 if number else 3) for kind, number in product(kinds, sets)]
    return found


def glsl(several: Sequence[ShaderChoices], version: str, motions: int = 64) -> str:
    """Return a vertex shader with the texts of one or several choices, called one after the other.

    version is what follows ``#version``. The uniform blocks Matrices and Quaternions hold ``motions`` joints.
    posed_position … posed_bitangent are what it writes, the sum where there are several.
    """
    reads = {column.name: column for choices in several for column in columns(choices)}
    head = [f"#version {version}"]
    head += ["precision highp float;", "precision highp int;"] if version.endswith("es") else []
    return "\n".join(
        [
            *head,
            *(shader_text(choices) for choices in several),
            *(f"in {column.of_type(Language.GLSL)} {column.name};" for column in reads.values()),
            f"layout(std140) uniform Matrices {{ mat4 matrices[{motions}]; }};",
            f"layout(std140) uniform Quaternions {{ mat2x4 quaternions[{motions}]; }};",
            *(f"out vec3 posed_{attribute};" for attribute in ATTRIBUTES),
            "void main() {",
            *(f"posed_{attribute} = vec3(0.0);" for attribute in ATTRIBUTES),
            *(line for choices in several for line in _glsl_call(choices)),
            "gl_Position = vec4(posed_position, 1.0);",
            "}",
        ]
    )


def _glsl_call(choices: ShaderChoices) -> list[str]:
    name, table = ("M", "matrices") if choices.method is Method.LBS else ("Q", "quaternions")
    return [
        "{",
        f"{'mat4' if name == 'M' else 'mat2x4'} {name}[{choices.influences}];",
        *(f"{name}[{slot}] = {table}[{joint}];" for slot, joint in enumerate(_joints(choices))),
        "vec3 position = rest.w * rest.xyz;",
        *_scaled(usage(shader_text(choices)), "skinbake_Frame"),
        *(f"posed_{attribute} += v.{attribute};" for attribute in ATTRIBUTES),
        "} }",
    ]


def wgsl(choices: ShaderChoices) -> str:
    """Return a compute shader, 64 vertices a workgroup: bindings 0 motions, 1 columns, 2 the results."""
    own = shader_text(choices)
    name, kind = ("M", "mat4x4<f32>") if choices.method is Method.LBS else ("Q", "mat2x4<f32>")
    reads = columns(choices)
    chosen = ", ".join(f"motions[{joint}]" for joint in _joints(choices))
    loads = []
    for number, column in enumerate(reads):
        value = f"columns[{len(reads)}u * row + {number}u]"
        value = f"bitcast<vec4<u32>>({value})" if column.is_integer else value
        loads.append(f"let {column.name} = {value}{'.xyz' if column.size == 3 else ''};")
    return "\n".join(
        [
            own,
            f"@group(0) @binding(0) var<storage, read> motions: array<{kind}>;",
            "@group(0) @binding(1) var<storage, read> columns: array<vec4<f32>>;",
            "@group(0) @binding(2) var<storage, read_write> results: array<vec4<f32>>;",
            "@compute @workgroup_size(64)",
            "fn main(@builtin(global_invocation_id) id: vec3<u32>) {",
            "let row = id.x;",
            "if (4u * row >= arrayLength(&results)) { return; }",
            *loads,
            f"let {name} = array<{kind}, {choices.influences}>({chosen});",
            "let position = rest.w * rest.xyz;",
            *_scaled(usage(own), "let"),
            *(
                f"results[4u * row + {number}u] = vec4<f32>(v.{attribute}, 0.0);"
                for number, attribute in enumerate(ATTRIBUTES)
            ),
            "} }",
        ]
    )


def _joints(choices: ShaderChoices) -> list[str]:
    return [f"joints_{slot // 4}.{'xyzw'[slot % 4]}" for slot in range(choices.influences)]


def _scaled(lines: list[str], keyword: str) -> list[str]:
    """Return the usage lines with the frame scaled after the first of them; a block is left open."""
    scaled = "rest.w * unscaled.tangent, rest.w * unscaled.bitangent, unscaled.handedness"
    return [
        lines[0],
        f"{keyword} unscaled = frame;",
        "{",
        f"{keyword} frame = skinbake_Frame(unscaled.normal, {scaled});",
        *lines[1:],
    ]
