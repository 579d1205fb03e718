"""``skinbake cost``: multiply-adds and bytes of the paper's algorithms, as text and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from skinbake.skinning.counting import Cost, cost_table, multiply_adds, normal_map_cost
from skinbake.skinning.rest import Algorithm
from skinbake.wording import counted

SCHEMA = "skinbake.cost/1"

TABLE = range(1, 9)
"""The numbers of influences in the table: one or two influence sets of glTF."""

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
TYPES = (
    "Bytes count float position (12), normal (12) and tangent (16), with an 8-bit joint and a "
    "float weight per influence; added bytes are α and β of all influences except one, or ∇w of "
    "all influences for algorithm 2, as floats."
)
WIDTH = 78
"""The longest line of a sentence."""


Costs: TypeAlias = dict[int, dict[Algorithm, Cost]]
"""The costs of a vertex by its number of influences, its data in the most common types of glTF."""


def costs_of(influences: int | None) -> Costs:
    """Return the costs of a vertex with N ≥ 1 influences; None: of all numbers in the table."""
    return {one: cost_table(one) for one in (TABLE if influences is None else [influences])}


def as_text(costs: Costs) -> str:
    """Return the costs as tables for a terminal, with a sentence on operations and one on bytes."""
    lines = _single_lines(*next(iter(costs.items()))) if len(costs) == 1 else _table_lines(costs)
    return "\n".join([*lines, *textwrap.wrap(RULES, WIDTH), *textwrap.wrap(TYPES, WIDTH)])


def _label(algorithm: int) -> str:
    return f"{algorithm:d}  {NAMES[algorithm]:<12}"


def _single_lines(influences: int, costs: Mapping[Algorithm, Cost]) -> Iterator[str]:
    yield f"Per vertex with {counted(influences, 'influence')}"
    yield f"  {'':<15}{'multiply-adds':>15}{'bytes':>7}{'added':>7}  multiply-adds by line"
    for algorithm, cost in costs.items():
        by_line = "+".join(str(count) for count in cost.lines.values())
        size = cost.vertex_bytes
        yield f"  {_label(algorithm)}{cost.multiply_adds:15,}{size.total:7,}{size.added:7,}  {by_line}"


def _table_lines(costs: Costs) -> Iterator[str]:
    for title in ("Multiply-adds per vertex", "Bytes per vertex"):
        yield title
        yield f"  {'N influences':<15}" + "".join(f"{influences:6}" for influences in costs)
        for algorithm in Algorithm:
            row = [by_algorithm[algorithm] for by_algorithm in costs.values()]
            figures = [one.vertex_bytes.total if "Bytes" in title else one.multiply_adds for one in row]
            yield f"  {_label(algorithm)}" + "".join(f"{value:6}" for value in figures)


def as_json(costs: Costs) -> dict[str, Any]:
    """Return the costs as one JSON object; docs/reference/json.md documents its members."""
    found = [_row_as_json(*row) for row in costs.items()]
    return {"schema": SCHEMA, **found[0]} if len(costs) == 1 else {"schema": SCHEMA, "table": found}


def _row_as_json(influences: int, costs: Mapping[Algorithm, Cost]) -> dict[str, Any]:
    found: dict[str, Any] = {"influences": influences}
    for algorithm, cost in costs.items():
        figures = {
            "multiply_adds": cost.multiply_adds,
            "bytes": cost.vertex_bytes.total,
            "added_bytes": cost.vertex_bytes.added,
            "normal_map": normal_map_cost(algorithm),
            "lines": {str(number): count for number, count in cost.lines.items()},
        }
        if algorithm.uses_dual_quaternions:
            scaled = multiply_adds(algorithm, influences, scaled_joints=True)
            figures["scaled_joints"] = sum(scaled.values())
            figures["scaled_joints_normal_map"] = normal_map_cost(algorithm, scaled_joints=True)
        for figure, value in figures.items():
            if value is not None:
                found.setdefault(figure, {})[f"{algorithm:d}"] = value
    return found
