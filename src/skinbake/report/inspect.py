"""The contents of a file, as text for people and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from skinbake.choices import Gradients
from skinbake.errors import Notice, Place, printable
from skinbake.report.notices import notice_list, place_fields
from skinbake.wording import counted

SCHEMA = "skinbake.inspect/1"


@dataclass(frozen=True, slots=True)
class AttributeSummary:
    """The format of one attribute, like ``VEC3 FLOAT``, and its size in bytes, tightly packed."""

    name: str
    format: str
    byte_length: int


@dataclass(frozen=True, slots=True)
class BakeSummary:
    """The metadata of a bake, the arrays that changed since, and the size of α and β."""

    metadata: dict[str, Any]
    changed: tuple[str, ...]
    byte_length: int


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


@dataclass(frozen=True, slots=True)
class InspectResult:
    """The contents of a file: its size, skins, animations and skinned primitives, and the notices."""

    input: str
    byte_length: int
    meshes: int
    skins: int
    animations: int
    primitives: tuple[PrimitiveSummary, ...]
    notices: tuple[Notice, ...]


def as_text(result: InspectResult) -> str:
    """Return the summary as lines for a terminal."""
    lines = [
        f"{printable(result.input)}: {result.byte_length:,} bytes, "
        f"{counted(result.meshes, 'mesh', 'meshes')}, "
        f"{counted(result.skins, 'skin')}, {counted(result.animations, 'animation')}, "
        f"{counted(len(result.primitives), 'skinned primitive')}"
    ]
    for primitive in result.primitives:
        lines += _primitive_lines(primitive)
    return "\n".join(lines)


def _primitive_lines(primitive: PrimitiveSummary) -> Iterator[str]:
    yield f"  {primitive.place.within_file}"
    yield (
        f"    surface     {counted(primitive.vertices, 'vertex', 'vertices')}, "
        f"{counted(primitive.triangles, 'triangle')}"
        + (f", {counted(primitive.morph_targets, 'morph target')}" if primitive.morph_targets else "")
    )
    low, high = primitive.weight_sums
    yield (
        f"    influences  up to {primitive.influences} of {4 * primitive.influence_sets} slots used, "
        f"{counted(primitive.joints, 'joint')}, weights sum to {low:.6g} … {high:.6g}"
    )
    for kind, count in primitive.defects.items():
        if count:
            yield f"    weights     {counted(count, 'vertex', 'vertices')} {kind.replace('_', ' ')}"
    yield f"    frame       {primitive.frame}"
    stored = ", ".join(f"{printable(a.name)} {a.format}" for a in primitive.attributes)
    yield f"    attributes  {stored}"
    if primitive.compression is not None:
        yield f"    compressed  {primitive.compression}; bytes are those of the decoded data"
    yield f"    baked       {_bake_text(primitive.bake)}"


def _bake_text(bake: BakeSummary | None) -> str:
    if bake is None:
        return "no"
    noted = bake.metadata
    state = f"but {', '.join(bake.changed)} changed since: bake again" if bake.changed else "up to date"
    generator = printable(str(noted.get("generator", "skinbake")))
    return (
        f"by {generator}, gradients {printable(str(noted.get('gradients', Gradients.SURFACE)))}, "
        f"frame from {noted.get('frame')}, weighting {noted.get('weighting')}, "
        f"neighbours {noted.get('neighbours')}, {_storage(noted)}{bake.byte_length:,} bytes, {state}"
    )


def _storage(noted: dict[str, Any]) -> str:
    """Return the storage of α and β, if it is not the default."""
    found = [f"{key} {printable(str(noted[key]))}, " for key in ("encoding", "layout") if key in noted]
    return "".join(found)


def as_json(result: InspectResult) -> dict[str, Any]:
    """Return the summary as one JSON object; docs/reference/json.md documents its members."""
    return {
        "schema": SCHEMA,
        "input": result.input,
        "bytes": result.byte_length,
        "meshes": result.meshes,
        "skins": result.skins,
        "animations": result.animations,
        "primitives": [_primitive_json(primitive) for primitive in result.primitives],
        "warnings": notice_list(result.notices),
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
    }
