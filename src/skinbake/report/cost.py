"""The cost of the paper's algorithms, as tables that fit a terminal of 80 columns, and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from skinbake.errors import Notice, Place, printable
from skinbake.report.totals import notice_list, place_fields
from skinbake.wording import counted

SCHEMA = "skinbake.cost/1"

NAMES = {
    1: "LBS standard",
    2: "LBS direct",
    3: "LBS accurate",
    4: "DQS standard",
    5: "DQS accurate",
    6: "DQS exact",
}

RULES = (
    "Multiply-adds are counted by the rules of the supplement to Tarini, Panozzo and "
    "Sorkine-Hornung 2014 (doi:10.1111/cgf.12330). They count T p as 12, mixing dual quaternions "
    "as 12 per influence, and moving a position by one as 27. Algorithm 6 is not in the paper and "
    "is counted by the same rules. A GPU also builds the frame, and leaves out what no output "
    "needs: with 4 influences it runs 144 for algorithm 3, and for algorithm 1 69 with a normal "
    "alone, 78 with a tangent, and 96 with a bitangent. A normal map that follows the surface adds "
    "21 to algorithm 3, and 30 to 5 and 6. Where joints scale, shear or mirror, 4 influences cost "
    "201 multiply-adds by algorithm 4, 306 by 5 and 323 by 6, and a normal map adds 36 to 5 and 6."
)
ADDED = "added bytes are α and β of all influences except one, or ∇w of all influences for algorithm 2"
COMMON_TYPES = (
    "Bytes count float position (12), normal (12) and tangent (16), with an 8-bit joint and a "
    f"float weight per influence; {ADDED}, as floats."
)
STORED_TYPES = (
    f"Bytes count every stored slot, used or not, each attribute in multiples of 4; {ADDED}. A "
    "frame skins each vertex of a triangle once for every node that draws it. Morph targets, and "
    "building a tangent frame from NORMAL, are not counted."
)
WIDTH = 78
"""The longest line of a sentence."""

VERTEX, FRAME = (11, 7, 7), (13, 12, 11)
"""The widths of the columns of one vertex, and of a frame: multiply-adds, bytes, added bytes."""


@dataclass(frozen=True, slots=True)
class VertexCost:
    """One algorithm at one vertex: multiply-adds in all and by line number, bytes read, and added bytes.

    normal_map are the multiply-adds that a normal map adds, None if the algorithm has none for it.
    scaled_joints are those in all where joints scale, None for linear blending; scaled_joints_normal_map are
    those that a normal map adds there.
    """

    multiply_adds: int
    bytes: int
    added_bytes: int
    lines: Mapping[int, int]
    normal_map: int | None = None
    scaled_joints: int | None = None
    scaled_joints_normal_map: int | None = None


VertexCosts: TypeAlias = Mapping[int, VertexCost]
"""By algorithm number, 1 … 6."""


@dataclass(frozen=True, slots=True)
class FrameCost:
    """One algorithm over all vertices that a frame skins."""

    multiply_adds: int
    bytes: int
    added_bytes: int


FrameCosts: TypeAlias = Mapping[int, FrameCost]
"""By algorithm number, 1 … 6."""


@dataclass(frozen=True, slots=True)
class InfluenceCosts:
    """A vertex with a number of influences, its data in the most common types of glTF."""

    influences: int
    costs: VertexCosts


@dataclass(frozen=True, slots=True)
class CostTable:
    """Vertices with several numbers of influences."""

    rows: tuple[InfluenceCosts, ...]


@dataclass(frozen=True, slots=True)
class PrimitiveCosts:
    """One skinned primitive: its vertices, its draws, its stored bytes, and its costs.

    stored is bytes for each vertex by attribute. baked tells whether α and β are among them.
    """

    place: Place
    vertices: int
    draws: int
    influences: int
    baked: bool
    stored: Mapping[str, int]
    per_vertex: VertexCosts
    per_frame: FrameCosts


@dataclass(frozen=True, slots=True)
class FileCosts:
    """A file: its skinned primitives, their sum (vertices × draws, costs of a frame), and the notices."""

    input: str
    primitives: tuple[PrimitiveCosts, ...]
    vertices: int
    total: FrameCosts
    notices: tuple[Notice, ...]


CostResult: TypeAlias = InfluenceCosts | CostTable | FileCosts


def as_text(result: CostResult) -> str:
    """Return the costs as tables for a terminal, with a sentence on operations and one on bytes."""
    if isinstance(result, FileCosts):
        return "\n".join(_file_lines(result))
    lines = _single_lines(result) if isinstance(result, InfluenceCosts) else _table_lines(result)
    return "\n".join([*lines, *_wrapped(RULES), *_wrapped(COMMON_TYPES)])


def _wrapped(sentence: str) -> list[str]:
    return textwrap.wrap(sentence, WIDTH)


def _label(number: int) -> str:
    return f"{number}  {NAMES[number]:<12}"


def _single_lines(result: InfluenceCosts) -> Iterator[str]:
    yield f"Per vertex with {counted(result.influences, 'influence')}"
    yield f"  {'':<15}{'multiply-adds':>15}{'bytes':>7}{'added':>7}  multiply-adds by line"
    for number, cost in result.costs.items():
        by_line = "+".join(str(count) for count in cost.lines.values())
        yield f"  {_label(number)}{cost.multiply_adds:15,}{cost.bytes:7,}{cost.added_bytes:7,}  {by_line}"


def _table_lines(result: CostTable) -> Iterator[str]:
    yield from _grid("Multiply-adds per vertex", result.rows, "multiply_adds")
    yield from _grid("Bytes per vertex", result.rows, "bytes")


def _grid(title: str, rows: Sequence[InfluenceCosts], figure: str) -> Iterator[str]:
    yield title
    yield f"  {'N influences':<15}" + "".join(f"{row.influences:6}" for row in rows)
    for number in NAMES:
        figures = (getattr(row.costs[number], figure) for row in rows)
        yield f"  {_label(number)}" + "".join(f"{value:6}" for value in figures)


def _file_lines(result: FileCosts) -> Iterator[str]:
    yield (
        f"{printable(result.input)}: {counted(len(result.primitives), 'skinned primitive')}, "
        f"{counted(result.vertices, 'vertex', 'vertices')} a frame"
    )
    if not result.primitives:
        return
    for primitive in result.primitives:
        yield from _primitive_lines(primitive)
    if len(result.primitives) > 1:
        yield "  the whole file, per frame"
        yield f"    {'':<15}" + _heads(FRAME)
        for number, frame in result.total.items():
            yield f"    {_label(number)}{_figures(FRAME, frame)}"
    yield from _wrapped(RULES)
    yield from _wrapped(STORED_TYPES)


def _primitive_lines(primitive: PrimitiveCosts) -> Iterator[str]:
    mesh = primitive.place.mesh_name
    name = f' "{printable(mesh)}"' if mesh else ""
    often = f" × {primitive.draws} nodes" if primitive.draws > 1 else ""
    yield (
        f"  mesh {primitive.place.mesh}{name}, primitive {primitive.place.primitive}: "
        f"{counted(primitive.vertices, 'vertex', 'vertices')}{often}, "
        f"{counted(primitive.influences, 'influence')}"
    )
    stored = ", ".join(f"{printable(attribute)} {size}" for attribute, size in primitive.stored.items())
    yield f"    bytes stored per vertex: {stored}" + ("" if primitive.baked else "; α, β as bake would")
    yield f"    {'':<15}{'per vertex:':>{VERTEX[0]}}{'per frame:':>{sum(VERTEX[1:]) + FRAME[0]}}"
    yield f"    {'':<15}{_heads(VERTEX)}{_heads(FRAME)}"
    for number, cost in primitive.per_vertex.items():
        vertex = _figures(VERTEX, cost)
        yield f"    {_label(number)}{vertex}{_figures(FRAME, primitive.per_frame[number])}"


def _heads(widths: Sequence[int]) -> str:
    titles = ("mul-adds", "bytes", "added")
    return "".join(f"{title:>{width}}" for title, width in zip(titles, widths, strict=True))


def _figures(widths: Sequence[int], cost: VertexCost | FrameCost) -> str:
    figures = (cost.multiply_adds, cost.bytes, cost.added_bytes)
    return "".join(f"{figure:{width},}" for figure, width in zip(figures, widths, strict=True))


def as_json(result: CostResult) -> dict[str, Any]:
    """Return the costs as one JSON object; docs/reference/json.md documents its members."""
    if isinstance(result, InfluenceCosts):
        return {"schema": SCHEMA, **_influences_json(result)}
    if isinstance(result, CostTable):
        return {"schema": SCHEMA, "table": [_influences_json(row) for row in result.rows]}
    return {
        "schema": SCHEMA,
        "input": result.input,
        "primitives": [_primitive_json(primitive) for primitive in result.primitives],
        "total": {"vertices": result.vertices, **_figures_json(result.total)},
        "warnings": notice_list(result.notices),
    }


def _influences_json(row: InfluenceCosts) -> dict[str, Any]:
    return {"influences": row.influences, **_vertex_json(row.costs)}


def _primitive_json(primitive: PrimitiveCosts) -> dict[str, Any]:
    return {
        **place_fields(primitive.place),
        "vertices": primitive.vertices,
        "draws": primitive.draws,
        "influences": primitive.influences,
        "baked": primitive.baked,
        "stored": dict(primitive.stored),
        **_vertex_json(primitive.per_vertex),
        "per_frame": _figures_json(primitive.per_frame),
    }


def _vertex_json(costs: VertexCosts) -> dict[str, Any]:
    lines = {
        str(number): {str(line): count for line, count in cost.lines.items()}
        for number, cost in costs.items()
    }
    further = {
        figure: {
            str(number): getattr(cost, figure)
            for number, cost in costs.items()
            if getattr(cost, figure) is not None
        }
        for figure in ("normal_map", "scaled_joints", "scaled_joints_normal_map")
    }
    return {**_figures_json(costs), **further, "lines": lines}


def _figures_json(costs: VertexCosts | FrameCosts) -> dict[str, Any]:
    return {
        figure: {str(number): getattr(cost, figure) for number, cost in costs.items()}
        for figure in ("multiply_adds", "bytes", "added_bytes")
    }
