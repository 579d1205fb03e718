"""The contents of a file, as text for people and as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from skinbake.errors import Notice, Place, SkinbakeError, printable
from skinbake.report.totals import (
    error_fields,
    notice_list,
    place_fields,
    timing_fields,
)
from skinbake.wording import counted

SCHEMA = "skinbake.inspect/1"
FILES_SCHEMA = "skinbake.inspect-files/1"
OUTCOMES = ("inspected", "failed")

DEFECTS = {
    "negative": "with a negative weight",
    "all_zero": "with no weight above 0",
    "not_normalised": "with weights that do not sum to 1",
    "repeated_joint": "with one joint in several slots",
}
"""What vertices have whose weights need an assumption, by kind."""


@dataclass(frozen=True, slots=True)
class AttributeSummary:
    """The format of one attribute, like ``VEC3 FLOAT``, and its size in bytes, tightly packed."""

    name: str
    format: str
    byte_length: int


LEFT = "left unbaked on purpose"


@dataclass(frozen=True, slots=True)
class BakeSummary:
    """The note of a bake, also in words, the arrays that changed since, and the size of α and β.

    other tells why this skinbake does not read it, and what to do.
    """

    metadata: dict[str, Any]
    words: str
    changed: tuple[str, ...]
    byte_length: int
    other: str | None = None


@dataclass(frozen=True, slots=True)
class CorrectiveSummary:
    """The correctives of a primitive: targets, the clips that play them, and arrays that changed since."""

    generator: str
    targets: int
    clips: tuple[str, ...]
    changed: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PrimitiveSummary:
    """One skinned primitive.

    influences is the largest number of positive weights at a vertex. weight_sums are the smallest and largest
    sum as stored. defects counts the vertices whose weights need an assumption, by kind. frame is the choice
    of ``--frame auto``. compression is the extension that holds any of its data, None without one.
    """

    place: Place
    vertices: int
    triangles: int
    joints: int
    influence_sets: int
    influences: int
    weight_sums: tuple[float, float]
    defects: dict[str, int]
    frame: str
    attributes: tuple[AttributeSummary, ...]
    compression: str | None
    morph_targets: int
    bake: BakeSummary | None
    correctives: CorrectiveSummary | None = None


@dataclass(frozen=True, slots=True)
class MorphSummary:
    """What bake has added to the targets of a primitive, with or without a skin.

    normals is the number of those that got NORMAL, frames how many numbers of the differential each has.
    changed: what these follow from is not what it was.
    """

    place: Place
    targets: int
    normals: int
    frames: int
    changed: bool


@dataclass(frozen=True, slots=True)
class InspectResult:
    """The contents of a file: its size, skins, animations and skinned primitives, and the notices.

    left: a bake has left it unbaked on purpose. morphs are what bake has added to morph targets.
    """

    input: str
    byte_length: int
    meshes: int
    skins: int
    animations: int
    primitives: tuple[PrimitiveSummary, ...]
    notices: tuple[Notice, ...]
    left: bool = False
    morphs: tuple[MorphSummary, ...] = ()


@dataclass(frozen=True, slots=True)
class FileSummary:
    """The result of one input: its summary, or the error that left it without one.

    record is always None. timings are seconds by stage, None if they were not requested.
    """

    input: str
    summary: InspectResult | None = None
    error: SkinbakeError | None = None
    record: bytes | None = None
    timings: dict[str, float] | None = None

    @property
    def status(self) -> str:
        """The outcome of the file."""
        return "failed" if self.error else "inspected"

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Return the notices of the summary, or those from before the error."""
        if self.summary is not None:
            return self.summary.notices
        return () if self.error is None else self.error.notices


def as_line(result: InspectResult) -> str:
    """Return the summary as one line: the counts, and how much of the file is baked."""
    return f"{_counts(result)}, {LEFT if result.left else _baked_text(result.primitives)}"


def _baked_text(primitives: Sequence[PrimitiveSummary]) -> str:
    """Return how many primitives are baked, and of how many the bake is stale."""
    if not primitives:
        return "nothing to bake"
    baked = [found for primitive in primitives if (found := primitive.bake or primitive.correctives)]
    if not baked:
        return "not baked"
    changed = sum(bool(bake.changed) for bake in baked)
    share = "baked" if len(baked) == len(primitives) else f"{len(baked):,} of {len(primitives):,} baked"
    return f"{share}, {counted(changed, 'primitive')} changed since: bake again" if changed else share


def _counts(result: InspectResult) -> str:
    return (
        f"{printable(result.input)}: {counted(result.byte_length, 'byte')}, "
        f"{counted(result.meshes, 'mesh', 'meshes')}, "
        f"{counted(result.skins, 'skin')}, {counted(result.animations, 'animation')}, "
        f"{counted(len(result.primitives), 'skinned primitive')}"
    )


def as_text(result: InspectResult) -> str:
    """Return the summary as lines for a terminal."""
    lines = [_counts(result)]
    if result.left:
        lines.append(f"  {LEFT}")
    for primitive in result.primitives:
        lines += _primitive_lines(primitive)
    for morph in result.morphs:
        state = _state(["POSITION or NORMAL"] if morph.changed else [])
        made = [f"NORMAL made for {morph.normals:,}"] if morph.normals else []
        made += [f"{morph.frames} numbers of the differential for each"] if morph.frames else []
        targets = counted(morph.targets, "morph target")
        lines += [f"  {morph.place.within_file}", f"    {targets}: {', '.join([*made, state])}"]
    return "\n".join(lines)


def _primitive_lines(primitive: PrimitiveSummary) -> Iterator[str]:
    yield f"  {primitive.place.within_file}"
    yield (
        f"    surface     {counted(primitive.vertices, 'vertex', 'vertices')}, "
        f"{counted(primitive.triangles, 'triangle')}"
        + (f", {counted(primitive.morph_targets, 'morph target')}" if primitive.morph_targets else "")
    )
    sums = dict.fromkeys(f"{weight_sum:.6g}" for weight_sum in primitive.weight_sums)
    yield (
        f"    influences  up to {primitive.influences} of {4 * primitive.influence_sets} slots used, "
        f"{counted(primitive.joints, 'joint')}, weights sum to {' … '.join(sums)}"
    )
    for kind, count in primitive.defects.items():
        if count:
            yield f"    weights     {counted(count, 'vertex', 'vertices')} {DEFECTS[kind]}"
    yield f"    frame       {primitive.frame}"
    stored = ", ".join(f"{printable(a.name)} {a.format}" for a in primitive.attributes)
    yield f"    attributes  {stored}"
    if primitive.compression is not None:
        yield f"    compressed  {primitive.compression}; bytes are those of the decoded data"
    if primitive.correctives is None:
        yield f"    baked       {_bake_text(primitive.bake)}"
        return
    found = primitive.correctives
    state = _state(found.changed)
    targets, clips = counted(found.targets, "corrective normal"), ", ".join(found.clips) or "no clip"
    yield printable(f"    baked       by {found.generator}, {targets} in {clips}, {state}")


def _state(changed: Sequence[str]) -> str:
    return f"but {', '.join(changed)} changed since: bake again" if changed else "up to date"


def _bake_text(bake: BakeSummary | None) -> str:
    if bake is None:
        return "no"
    state = f"but {bake.other}" if bake.other else _state(bake.changed)
    return printable(f"{bake.words}, {counted(bake.byte_length, 'byte')}, {state}")


def as_json(result: InspectResult) -> dict[str, Any]:
    """Return the summary as one JSON object; docs/reference/json.md documents its members."""
    return {
        "schema": SCHEMA,
        "input": result.input,
        "bytes": result.byte_length,
        "meshes": result.meshes,
        "skins": result.skins,
        "animations": result.animations,
        "left": result.left,
        "primitives": [_primitive_json(primitive) for primitive in result.primitives],
        "morphs": [
            {
                **place_fields(one.place),
                "targets": one.targets,
                "normals": one.normals,
                "frames": one.frames,
                "changed": one.changed,
            }
            for one in result.morphs
        ],
        "warnings": notice_list(result.notices),
    }


def file_json(result: FileSummary) -> dict[str, Any]:
    """Return the result of one file as a JSON object."""
    found: dict[str, Any] = {"input": result.input, "warnings": notice_list(result.notices)}
    if result.summary is not None:
        found = as_json(result.summary)
        del found["schema"]
    return {
        **found,
        "error": error_fields(result.error),
        **timing_fields(result.timings),
    }


def _primitive_json(primitive: PrimitiveSummary) -> dict[str, Any]:
    return {
        **place_fields(primitive.place),
        "vertices": primitive.vertices,
        "triangles": primitive.triangles,
        "joints": primitive.joints,
        "influence_sets": primitive.influence_sets,
        "influences": primitive.influences,
        "weight_sums": list(primitive.weight_sums),
        "defects": primitive.defects,
        "frame": primitive.frame,
        "attributes": {
            attribute.name: {"format": attribute.format, "bytes": attribute.byte_length}
            for attribute in primitive.attributes
        },
        "compression": primitive.compression,
        "morph_targets": primitive.morph_targets,
        "baked": None
        if primitive.bake is None
        else {
            "metadata": primitive.bake.metadata,
            "changed": list(primitive.bake.changed),
            "bytes": primitive.bake.byte_length,
        },
        "correctives": None if primitive.correctives is None else asdict(primitive.correctives),
    }
