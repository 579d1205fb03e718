"""Shader code that reads stored α and β: decoded from integers, or assembled from pairs.

docs/reference/file-format.md, *Encodings* and *Layouts*.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skinbake.choices import SLOTS_PER_SET
from skinbake.errors import printable
from skinbake.shaders.choices import ShaderChoices

FORMATS = {"snorm16": "snorm16x4", "packed8": "snorm8x4"}
"""The WebGPU names of normalised SHORT and BYTE."""
LIMITS = {"snorm16": 32767, "packed8": 127}
KINDS = ("alpha", "beta")


@dataclass(frozen=True, slots=True)
class Pair:
    """One texture coordinate set of two numbers: its attribute, and its contents; empty if not read."""

    name: str
    holds: str


@dataclass(frozen=True, slots=True)
class Assembled:
    """α or β of one influence set, assembled from pairs: ``alpha_0``, a vec3 of ``pair_1.x`` ….

    params are the pairs that it reads, names are their attributes, numbers are the pair numbers as words.
    """

    name: str
    kind: str
    type: str
    slots: str
    params: tuple[str, ...]
    names: tuple[str, ...]
    numbers: str
    components: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Made:
    """One value, as the line that makes it has it: its name, its type, and the call that returns it."""

    name: str
    type: str
    call: str


def storage_parts(choices: ShaderChoices) -> list[str]:
    """Return the templates of the functions that read α and β, none if they need no function."""
    if choices.assembles:
        return ["assembled"]
    if not choices.decodes:
        return []
    return ["decoded", *(["decoded_further"] if choices.influence_sets > 1 else [])]


def storage_context(choices: ShaderChoices) -> dict[str, Any]:
    """Return the values of encodings and layouts for the templates."""
    assembled = _assembled(choices) if choices.assembles else []
    # The lines before the example call, each of which makes α or β of one influence set.
    preparations = [
        Made(part.name, part.type, f"skinbake_{part.name}({', '.join(part.names).lower()})")
        for part in assembled
    ]
    for kind in KINDS if choices.decodes and not choices.assembles else ():
        first = f"stored_{kind}_0"
        preparations.append(Made(f"{kind}_0", "vec3", f"skinbake_decoded({first}, scale)"))
        for number in range(1, choices.influence_sets):
            call = f"skinbake_decoded_further(stored_{kind}_{number}, {first}, scale)"
            preparations.append(Made(f"{kind}_{number}", "vec4", call))
    # What each pair holds, of those that some part reads.
    pairs = []
    if choices.assembles:
        read = {param for part in assembled for param in part.params}
        slots = range(1, len(choices.pair_names) + 1)
        row = [f"{kind} of slot {slot}" for kind in KINDS for slot in slots]
        for at, name in enumerate(choices.pair_names):
            holds = f"{row[2 * at]}, {row[2 * at + 1]}" if f"pair_{at + 1}" in read else ""
            pairs.append(Pair(ascii_name(name), holds))
    return {
        "vertex_format": FORMATS.get(choices.encoding),
        "limit": LIMITS.get(choices.encoding),
        # Nine digits are enough for any two float32.
        "scale": "" if choices.scale is None else literal(f"{choices.scale:.9g}"),
        "pairs": pairs,
        "assembled": assembled,
        "preparations": preparations,
    }


def literal(text: str) -> str:
    """Return the text of a number as a float literal of all languages."""
    return text if "." in text or "e" in text else f"{text}.0"


def _assembled(choices: ShaderChoices) -> list[Assembled]:
    """Return the parts of each set from the row α1 … α(K−1), β1 … β(K−1), two to a pair."""
    others = len(choices.pair_names)
    found = []
    for kind, start in zip(KINDS, (0, others), strict=True):
        for number in range(choices.influence_sets):
            first = max(SLOTS_PER_SET * number, 1)
            last = SLOTS_PER_SET * (number + 1) - 1
            places = [divmod(start + slot - 1, 2) for slot in range(first, last + 1)]
            pairs = list(dict.fromkeys(pair + 1 for pair, _ in places))
            found.append(
                Assembled(
                    name=f"{kind}_{number}",
                    kind=kind,
                    type=f"vec{len(places)}",
                    slots=f"slots {first} to {last}",
                    params=tuple(f"pair_{pair}" for pair in pairs),
                    names=tuple(ascii_name(choices.pair_names[pair - 1]) for pair in pairs),
                    numbers=f"{pairs[0]} to {pairs[-1]}",
                    components=tuple(f"pair_{pair + 1}.{'xy'[place]}" for pair, place in places),
                )
            )
    return found


def ascii_name(name: str) -> str:
    """Return a name from a file as printable ASCII, because it must not end the comment that holds it."""
    return printable(name).encode("ascii", "backslashreplace").decode()
