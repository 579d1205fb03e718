"""Morph targets of skinned primitives: differences and weights at rest (glTF 2.0, §3.7.2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from skinbake.errors import InputError
from skinbake.geometry.morphs import (
    COMPONENTS,
    NO_DIFFERENCES,
    Differences,
    Kind,
    MorphTarget,
    MorphTargets,
)
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Work
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.meshes import FLOAT, UNIT_VECTORS, Formats, check_format, refuse_not_finite
from skinbake.wording import counted

UNIT_DIFFERENCES = "differences must be floats, or normalised signed bytes or shorts", UNIT_VECTORS
FORMATS: Formats = {
    "POSITION": (
        "differences must be floats, or signed bytes or shorts",
        (FLOAT, *product(("i1", "i2"), (False, True))),
    ),
    "NORMAL": UNIT_DIFFERENCES,
    "TANGENT": UNIT_DIFFERENCES,
    "": ("differences must be floats", (FLOAT,)),
}
"""The formats of glTF 2.0, §3.7.2.2, and of KHR_mesh_quantization."""


def targets_without_normal(document: Document, source: PrimitiveSource) -> list[int]:
    """Return the numbers of the targets of a primitive without NORMAL, or with zeros where POSITION moves.

    Exporters of VRM write such zeros. Raises InputError for targets that are broken.
    """
    targets = source.targets
    with_zeros = [number for number, target in enumerate(targets) if {"NORMAL", "POSITION"} <= target.keys()]
    for name, moves in (("NORMAL", False), ("POSITION", True)):
        with_zeros = [one for one in with_zeros if _moves(document, source, one, name) is moves]
    return [number for number, target in enumerate(targets) if "NORMAL" not in target or number in with_zeros]


def _moves(document: Document, source: PrimitiveSource, number: int, name: str) -> bool:
    """Tell whether a target changes an attribute at any vertex. Each accessor is read once for it."""
    targets, asset, known = source.targets, document.asset, _known_to_move(document)
    place = source.place.at(f"{name} of morph target {number}")
    accessor = asset.accessor(targets[number], name, place)
    key = name, None if accessor is None else accessor.number
    if key not in known:
        vertices = asset.accessor(source.attributes, "POSITION", place)
        count = 0 if vertices is None else vertices.count(place)
        with document.budget.passing():
            found = _differences(document, source, (number, name, 3), targets, count, {})
        known[key] = len(found.rows) > 0
    return known[key]


@once_a_document
def _known_to_move(document: Document) -> dict[tuple[str, int | None], bool]:
    """Return whether targets change anything, by attribute and accessor."""
    return {}


def read_targets(
    document: Document,
    source: PrimitiveSource,
    wanted: list[int],
    *,
    count: int,
    tangents: bool,
    further: Sequence[str] = (),
) -> MorphTargets | None:
    """Return the wanted targets of a primitive of ``count`` vertices, None if it has no targets.

    ``tangents`` means that the frame is from TANGENT, so that targets of TANGENT count. ``further`` are the
    attributes of the numbers of the differential: in the plane, and upward. Raises InputError
    with the target and the attribute for a format that glTF does not allow, for a number of elements that
    differs from POSITION, and for positions that are not finite. Normals and tangents that are not finite
    count as 0.
    """
    targets = source.targets
    if not targets:
        return None
    members: dict[Kind, str] = {"positions": "POSITION", "normals": "NORMAL"}
    members |= {"tangents": "TANGENT"} if tangents else {}
    members |= dict(zip(("in_plane", "upward"), further, strict=False))
    read: dict[tuple[str, int], Differences] = {}
    found = [
        MorphTarget(
            **{
                member: _differences(
                    document, source, (number, name, COMPONENTS.get(member, 3)), targets, count, read
                )
                for member, name in members.items()
            }
        )
        for number in wanted
    ]
    with_tangents = tangents and any("TANGENT" in target for target in targets)
    return MorphTargets(tuple(found), with_tangents, 2 * (len(further) + bool(further)))


def _differences(
    document: Document,
    source: PrimitiveSource,
    which: tuple[int, str, int],
    targets: list[JsonObject],
    count: int,
    read: dict[tuple[str, int], Differences],
) -> Differences:
    """Return one attribute of one target; ``read`` caches the results by accessor."""
    number, name, components = which
    place = source.place.at(f"{name} of morph target {number}")
    accessor = document.asset.accessor(targets[number], name, place)
    if accessor is None:
        return NO_DIFFERENCES
    key = name, accessor.number
    if key not in read:
        declared = accessor.count(place)
        if declared != count:
            raise InputError(f"it has {counted(declared, 'element')}, POSITION has {count:,}", place)
        with document.budget.passing():
            stored = read_accessor(document, accessor.number, place)
            check_format(stored, name, components, place, FORMATS)
            document.budget.claim(Work(bytes=stored.decoded_size), "its decoded values", place)
            values = stored.decoded()
            if name == "POSITION":
                refuse_not_finite(values, "values", place)
            read[key] = Differences.of(values)
        kept = read[key]
        document.budget.claim(Work(bytes=kept.rows.nbytes + kept.values.nbytes), "its differences", place)
    return read[key]
