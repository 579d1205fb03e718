"""Render the templates: one text for one set of choices, the same text every time.

A target is a file ``templates/targets/NAME.LANGUAGE[.SUFFIX]``. With the suffix ``.js`` it is the
``shaders.js`` that the hand-written modules of ``engines/NAME`` import. A target may ``refuse`` choices that
its engine cannot serve. It gets its parts from ``text_for``, and tells this function the storage that it can
read: see ``_text_for``. Lines that begin with ``//%`` are statements and ``@{ }`` holds values, so that a
template reads like its own language.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from skinbake.choices import SLOTS_PER_SET, Encoding, Frame, Language, Layout, Lighting, Method, Morphs, Stage
from skinbake.errors import ChoiceError, Chosen
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.compute import TYPES, compute_context
from skinbake.shaders.engines import single_module
from skinbake.shaders.storage import ascii_name, literal, storage_context, storage_parts
from skinbake.version import __version__

if TYPE_CHECKING:
    import jinja2

TEMPLATES = Path(__file__).parent / "templates"
WIDTH = 110
HLSL = (
    (r'"glsl/(\w+)\.glsl"', r'"hlsl/\1.hlsl"'),
    (r"return (skinbake_(?:Frame|NormalMap))\(\s*(.*?)\);", r"\1 made = { \2 };\n    return made;"),
    (r"\bT \* (vec4\(frame\..*?, 0\.0\))", r"mul(\1, T)"),
    (r"(Q\[[^]]*\]\.moved) \* (vec4\(p, 1\.0\))", r"mul(\2, \1)"),
    (r"\b(mat3|mat4x3)\((\w+(?:\[@\{ slot\.index \}\])?)\)", r"(\1)\2"),
    (r"((?:\(mat3\))?\b[TJC]) \* (frame\.\w+|vec4\(p, 1\.0\))", r"mul(\1, \2)"),
    (r"any\(notEqual\((\w+), \w+\(0\.0\)\)\)", r"any(\1 != 0.0)"),
    (r"\b(u?)vec(\d)\b", lambda found: f"{'uint' if found[1] else 'float'}{found[2]}"),
    (r"\bmat3\b", "float3x3"),
    (r"\bmat4\b", "float4x4"),
    (r"\bmat4x3\b", "float3x4"),
    (r"\bmat2x4\b", "float2x4"),
    (r"\bmix\(", "lerp("),
    (r"\binversesqrt\(", "rsqrt("),
    (r"\bouterProduct\(", "skinbake_outer("),
)
"""What makes HLSL of a template in GLSL, in this order: patterns and what takes their place.

Structures have no constructors, but lists. A matrix times a vector is a call. A mat4x3 has four columns, as a
float3x4. The joints of ``dqs_scaled`` are stored as rows, so its products are the other way round.
"""
OWN = (
    *("language", "method", "lighting", "algorithm", "stem", "influences", "frame", "cap", "normal_map"),
    *("mirrored_joints", "scaled_joints", "morphs", "stage", "reads_gradients"),
    *("encoding", "layout", "decodes", "assembles", "storage_words"),
)
"""What templates know of the choices by the same names."""
ENUMERATIONS = {
    "language": Language,
    "method": Method,
    "lighting": Lighting,
    "frame": Frame,
    "encoding": Encoding,
    "layout": Layout,
}
"""The types of the choices that a template may change by their words."""
MORPH_CALLS = {
    Morphs.NORMAL: "skinbake_morphed_frame(rest, morphed_normal)",
    Morphs.TANGENT: "skinbake_morphed_tangent_frame(rest, morphed_normal, morphed_tangent)",
    Morphs.FRAMES: "skinbake_moved_frame(rest, morph, morph_up)",
    Morphs.FRAMES_NORMAL: "skinbake_moved_frame_by_normal(rest, morphed_normal, morph)",
}
METHOD_NAMES = {
    Method.LBS: "linear blend skinning",
    Method.DQS: "dual quaternion skinning",
    Method.BLEND: "blended skinning",
}


@dataclass(frozen=True, slots=True)
class Slot:
    """One influence slot, named as in the text: ``weights_0.x``, ``alpha_0.x``; slot 0 has no α and β."""

    index: int
    weight: str
    alpha: str
    beta: str


@dataclass(frozen=True, slots=True)
class InfluenceSet:
    """One set of four slots, in the words of the table of inputs. The attributes have the file's names."""

    number: int
    slots: str
    gradient_slots: str
    alpha_name: str
    beta_name: str


def targets() -> dict[str, tuple[Language, ...]]:
    """Return the languages of each target, from the names of the template files."""
    found: dict[str, list[Language]] = {}
    for path in sorted((TEMPLATES / "targets").iterdir()):
        name, language = path.name.split(".")[:2]
        found.setdefault(name, []).append(Language(language))
    return {name: tuple(languages) for name, languages in found.items()}


def shader_made(choices: ShaderChoices, *, package: bool = False) -> tuple[str, ShaderChoices]:
    """Return the text and its choices; the target decides which direction the frame follows.

    With the text are the hand-written modules of an engine's package, without them if ``package`` is set.
    """
    made = choices

    def text_for(
        reads: Sequence[str] = (),
        morphs: str | None = None,
        also: Sequence[str] = (),
        cap_as: str = "",
        **changes: Any,
    ) -> dict[str, Any]:
        nonlocal made
        made = choices if morphs is None else replace(choices, morphs=Morphs(morphs))
        kinds = {name: ENUMERATIONS[name](word) for name, word in changes.items() if name in ENUMERATIONS}
        return _text_for(replace(made, **{**changes, **kinds}), reads, also, cap_as)

    languages = targets().get(choices.target, ())
    if choices.language not in languages:
        needed = Chosen("language", " or ".join(languages) or "none")
        raise ChoiceError("target", choices.target, reason=(" needs ", needed, f", not {choices.language}"))
    # The one template of the target in this language, perhaps with a further suffix.
    pattern = f"{choices.target}.{choices.language}"
    names = [path.name for path in (TEMPLATES / "targets").iterdir()]
    template = "targets/" + next(one for one in names if one == pattern or one.startswith(f"{pattern}."))
    rendered = _rendered(template, {**_context(choices), "text_for": text_for})
    text = "".join(f"{line.rstrip()}\n" for line in rendered.splitlines())
    if template.endswith(".js") and not package:
        text = single_module(choices.target, text)
    return text, made


def _text_for(
    choices: ShaderChoices, reads: Sequence[str], also: Sequence[str], cap_as: str
) -> dict[str, Any]:
    """Return the parts of a target's file: header, inputs, usage, snippet, and its parts by template.

    reads are the encodings and layouts that the code of the target can read, by the functions in the snippet.
    All targets read attributes of floats, of any names. Raises ChoiceError for other storage. ``also`` are
    further templates of the snippet. ``cap_as`` is an expression of the cap when the shader runs, if any.
    """
    needed = [str(choices.encoding)] if choices.decodes else []
    needed += [str(choices.layout)] if choices.assembles else []
    if not set(needed) <= set(reads):
        why = f"it reads alpha and beta as floats in their own attributes, not {choices.storage_words[2:]}"
        reason = (f": {why}; use ", Chosen("target", "plain"), ", or bake with the defaults")
        raise ChoiceError("target", choices.target, reason=reason, also=("encoding", "layout"))
    context = _context(choices, cap_as)
    language = choices.language
    wanted = [(name, context) for name in ("vertex", f"frame_{choices.frame}", *also)]
    usage = f"{language}/usage.txt"
    if choices.method is Method.BLEND:
        wanted += [(name, _context(one)) for one in choices.both for name in (*_parts(one), one.stem)]
        wanted.append(("blend", context))
    else:
        wanted += [(name, context) for name in (*_parts(choices), choices.stem)]
    if choices.stage is Stage.COMPUTE:
        wanted.append(("compute", context))
        usage = "compute.txt"
    texts = {name: _rendered(f"{language}/{name}.{language}", own) for name, own in wanted}
    if choices.method is Method.BLEND and language is not Language.WGSL:
        # The guards of the texts of either method alone, which may stand in the same shader.
        for one in choices.both:
            guard = _guard(one)
            texts[one.stem] = f"#ifndef {guard}\n#define {guard}\n{texts[one.stem]}\n#endif"
    parts = {name: "\n".join(map(_broken, text.splitlines())) for name, text in texts.items()}
    return {
        **context,
        "header": _rendered("header.txt", context),
        "inputs": _rendered("inputs.txt", context),
        "usage": _rendered(usage, context),
        "parts": parts,
        "snippet": "\n\n".join(parts.values()),
    }


def _rendered(template: str, context: dict[str, Any]) -> str:
    return _environment().get_template(template).render(context).strip("\n")


def _source(template: str) -> str | None:
    """Return the text of a template; one in HLSL that has no file is made of its twin in GLSL."""
    path = TEMPLATES / template
    if path.suffix == ".hlsl" and not path.exists():
        path = TEMPLATES / "glsl" / f"{path.stem}.glsl"
        if not path.exists():
            return None
        text = path.read_text(encoding="utf-8")
        for pattern, instead in HLSL:
            text = re.sub(pattern, instead, text, flags=re.DOTALL)
        return text
    return path.read_text(encoding="utf-8") if path.exists() else None


@cache
def _environment() -> jinja2.Environment:
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FunctionLoader(_source),
        undefined=jinja2.StrictUndefined,
        autoescape=False,
        line_statement_prefix="//%",
        line_comment_prefix="//#",
        variable_start_string="@{",
        variable_end_string="}",
        trim_blocks=True,
        keep_trailing_newline=True,
    )


def _broken(line: str) -> str:
    """Break a line of code at the end of a term or an argument: its length follows the influences."""
    stripped = line.lstrip()
    indent = " " * (len(line) - len(stripped) + 8)
    lines = []
    while len(line) > WIDTH:
        end = min(WIDTH, len(line.partition("//")[0]))
        at = max(line.rfind(", ", len(indent), end) + 1, line.rfind(" + ", len(indent), end))
        if at <= 0:
            break
        lines.append(line[:at])
        line = indent + line[at:].lstrip()
    return "\n".join([*lines, line])


def _context(choices: ShaderChoices, cap_as: str = "") -> dict[str, Any]:
    """Return all values for the templates."""
    slots = []
    for index in range(choices.influences):
        number, component = divmod(index, SLOTS_PER_SET)
        letter = "xyzw"[component]
        gradient = letter if number else " xyz"[component]  # slot 0 has no α and no β
        names = f"weights_{number}.{letter}", f"alpha_{number}.{gradient}", f"beta_{number}.{gradient}"
        slots.append(Slot(index, *names))
    others = slots[1:]
    sets = _sets(choices)
    types = TYPES[choices.language]
    weights = [(types["vec4"], f"weights_{s.number}") for s in sets]
    gradients = [
        (types["vec3" if s.number == 0 else "vec4"], f"{kind}_{s.number}")
        for kind in ("alpha", "beta")
        for s in sets
        if choices.influences > 1
    ]
    # The arguments of the example call.
    given = [name for _, name in gradients]
    if not choices.reads_gradients and choices.lighting != "direct":
        given = []
    if choices.lighting == "direct":
        given = [f"skinbake_gradients({', '.join(['frame', *given])})"]
    motions = {Method.LBS: ["M"], Method.DQS: ["Q"], Method.BLEND: ["M", "Q"]}[choices.method]
    blend = ["blend" if choices.is_corrected else "blend.x"] if choices.method is Method.BLEND else []
    arguments = ["position", "frame", *motions, *(name for _, name in weights), *given, *blend]
    stored = storage_context(choices)
    cap = cap_as if cap_as or choices.cap is None else literal(repr(float(choices.cap)))

    def corrected(base: str, correction: str) -> str:
        if not others:
            return base
        if choices.cap is None:
            return f"{base} + {correction}"
        return f"skinbake_capped({base}, {correction}, {cap})"

    def dual(gradient: str) -> str:
        if choices.morphs.moves_frame:
            return gradient.replace("frame.tangent", "along_t").replace("frame.bitangent", "along_b")
        return f"k * ({gradient})" if choices.morphs is Morphs.TANGENT else gradient

    def handed(normal: str) -> str:
        return f"frame.handedness * {normal}" if choices.frame == "tangent" else normal

    return {
        **{name: getattr(choices, name) for name in OWN},
        "version": __version__,
        "command": command_line(choices),
        "file": ascii_name(choices.attributes.file) if choices.attributes else "",
        "method_name": METHOD_NAMES[choices.method],
        "cap_text": cap,
        "dual_stem": choices.both[1].stem if choices.method is Method.BLEND else "",
        "blend_name": (choices.attributes and choices.attributes.blend) or "b",
        "moves_frame": choices.morphs.moves_frame,
        "morph_call": MORPH_CALLS.get(choices.morphs, ""),
        "guard": _guard(choices),
        "slot_words": _slot_words(0, choices.influences - 1),
        "slots": slots,
        "others": others,
        "sets": sets,
        "types": types,
        "padded": {name: f"{kind:<{max(map(len, types.values()))}}" for name, kind in types.items()},
        "weight_params": weights,
        "gradient_params": gradients,
        "arguments": arguments,
        "params": lambda pairs: _params(choices.language, pairs),
        "sum": _sum,
        "joined": _joined,
        "corrected": corrected,
        "dual": dual,
        "handed": handed,
        "number": lambda value: literal(repr(float(value))),
        "ascii_name": ascii_name,
        "count": lambda n, noun: f"{n} {noun}{'' if n == 1 else 's'}",
        "refuse": partial(_refuse, choices),
        **stored,
        **compute_context(choices, stored["assembled"], arguments),
    }


def command_line(choices: ShaderChoices) -> str:
    """Return the command that writes the same text again, with every choice and the file."""
    words = ["skinbake shader", f"--lang {choices.language}"]
    words += [f"--{name} {getattr(choices, name)}" for name in ("method", "lighting", "influences", "frame")]
    words += [] if choices.cap is None else [f"--cap {choices.cap!r}"]
    flags = "scaled_joints", "mirrored_joints", "normal_map"
    words += [f"--{name.replace('_', '-')}" for name in flags if getattr(choices, name)]
    usual = ShaderChoices(choices.language)
    for name in ("encoding", "layout", "morphs", "stage", "target"):
        chosen = getattr(choices, name)
        words += [] if chosen == getattr(usual, name) else [f"--{name} {chosen}"]
    if choices.attributes is not None:
        words.append(f"--for {shlex.quote(ascii_name(choices.attributes.file))}")
    return " ".join(words)


def _sets(choices: ShaderChoices) -> list[InfluenceSet]:
    found = []
    for number in range(choices.influence_sets):
        first = SLOTS_PER_SET * number
        last = min(first + SLOTS_PER_SET, choices.influences) - 1
        names = choices.attributes
        found.append(
            InfluenceSet(
                number,
                _slot_words(first, last),
                _slot_words(max(first, 1), last),
                names.alpha[number] if names else _usual_name(choices, "ALPHA", number),
                names.beta[number] if names else _usual_name(choices, "BETA", number),
            )
        )
    return found


def _usual_name(choices: ShaderChoices, kind: str, number: int) -> str:
    if choices.layout == "custom":
        return f"_CUSTOM{2 * number + (kind == 'BETA')}"
    return f"_SKINBAKE_{kind}_{number}"


def _slot_words(first: int, last: int) -> str:
    return f"slot {first}" if first >= last else f"slots {first} to {last}"


def _parts(choices: ShaderChoices) -> list[str]:
    """Return the templates of the functions that the algorithm calls, in an order that compiles."""
    several, wgsl = choices.influences > 1, choices.language is Language.WGSL
    hlsl = choices.language is Language.HLSL
    is_dual = choices.method is Method.DQS and not choices.scaled_joints
    wanted = {
        "morphed": choices.morphs in (Morphs.NORMAL, Morphs.TANGENT, Morphs.FRAMES_NORMAL),
        "morphed_tangent": choices.morphs is Morphs.TANGENT,
        "moved_frame": choices.morphs is Morphs.FRAMES,
        "moved_frame_by_normal": choices.morphs is Morphs.FRAMES_NORMAL,
        # WGSL has no constructor from a part of a matrix.
        "rows": wgsl and choices.algorithm in (1, 2),
        "upper": wgsl and choices.algorithm == 3,
        "moved": choices.algorithm in (2, 3),
        "gradients": choices.algorithm == 2,
        # HLSL has no such function of its own.
        "outer": hlsl and choices.algorithm == 2,
        "dual_quaternion": choices.method is Method.DQS,
        "hemisphere": is_dual and several,
        # In WGSL, the function for the host multiplies too.
        "product": choices.scaled_joints and (several or wgsl),
        "scaled_joint": choices.scaled_joints,
        "scaled_motion": choices.scaled_joints,
        "rotation": choices.algorithm in (4, 5),
        "capped": choices.cap is not None and several,
        "derivative": choices.algorithm == 6 and is_dual and several,
        "normal_map": choices.normal_map,
    }
    return [*storage_parts(choices), *(name for name, is_wanted in wanted.items() if is_wanted)]


def _guard(choices: ShaderChoices) -> str:
    words = [choices.stem, str(choices.influences), choices.frame]
    words += ["capped"] if choices.cap is not None else []
    words += ["mirrored"] if choices.mirrored_joints else []
    words += ["mapped"] if choices.normal_map else []
    words += [choices.encoding] if choices.decodes else []
    words += [f"texcoord_{len(choices.pair_names)}"] if choices.assembles else []
    words += [f"morphed_{choices.morphs}".replace("-", "_")] if choices.morphs is not Morphs.NONE else []
    words += ["compute"] if choices.stage is Stage.COMPUTE else []
    return "_".join(["SKINBAKE", *words, choices.language]).upper()


def _params(language: Language, pairs: Iterable[tuple[str, str]]) -> str:
    """Return further parameters of a declaration, each with its comma before it."""
    if language is Language.WGSL:
        return "".join(f", {name}: {kind}" for kind, name in pairs)
    return "".join(f", {kind} {name}" for kind, name in pairs)


def _sum(kind: str, pattern: str, slots: Sequence[Slot]) -> str:
    """Return Σ factor · term over slots; the factors are ``weight``, ``alpha`` or ``beta``."""
    return " + ".join(f"{getattr(slot, kind)} * {pattern % slot.index}" for slot in slots)


def _joined(separator: str, pattern: str, slots: Sequence[Slot]) -> str:
    return separator.join(pattern.replace("%d", str(slot.index)) for slot in slots)


def _refuse(choices: ShaderChoices, option: str, why: str) -> NoReturn:
    """Raise ChoiceError about a target, because of another option. ``why`` has words of the command line."""
    raise ChoiceError("target", choices.target, reason=(f": {why}",), also=(option,))
