"""skinbake cost: the paper's figures, and the exit codes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from tests.support.command_line import document, invoke, run
from tests.support.schemas import COUNT, strict

DOI = "doi:10.1111/cgf.12330"
NAMES = ["LBS standard", "LBS direct", "LBS accurate", "DQS standard", "DQS accurate", "DQS exact"]

# Right margin of the supplemental material's pseudo-code, n being its N_max; 6 is 36 N + 118 by dqs.exact.
PAPER: dict[str, Callable[[int], list[int]]] = {
    "1": lambda n: [12 * n, 12, 9, 9, 9],
    "2": lambda n: [12 * n, 9 * n, 9 * n, 31, 12, 9, 9, 9],
    "3": lambda n: [9 * n, 9 * n, 3 * n - 3, 9 + 3 * n - 3, 9 + 3 * n - 3, 6, 3 * n - 3],
    "4": lambda n: [12 * n, 13, 27, 18, 18, 18],
    "5": lambda n: [12 * n, 13, 27, 24 * n, 3 * n - 3, 18 + 3 * n - 3, 18 + 3 * n - 3, 6],
}
EXACT = {1: 154, 2: 190, 3: 226, 4: 262, 5: 298, 6: 334, 7: 370, 8: 406}


def paper(influences: int) -> dict[str, int]:
    totals = {number: sum(lines(influences)) for number, lines in PAPER.items()}
    return {**totals, "6": EXACT[influences]}


def by_number(plain: int, direct: int, accurate: int) -> dict[str, int]:
    """Bytes by algorithm: standard lighting, algorithm 2, and the three that read α and β."""
    return {"1": plain, "2": direct, "3": accurate, "4": plain, "5": accurate, "6": accurate}


def cost(*arguments: str | Path) -> Any:
    result = invoke("cost", *arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return document(result)


FIGURES = dict.fromkeys("123456", COUNT)
LINES = {"type": "object", "patternProperties": {"^[1-9]$": COUNT}, "additionalProperties": False}
SUMS = {"multiply_adds": strict(FIGURES), "bytes": strict(FIGURES), "added_bytes": strict(FIGURES)}
COSTS = {
    **SUMS,
    "normal_map": strict(dict.fromkeys("356", COUNT)),
    "scaled_joints": strict(dict.fromkeys("456", COUNT)),
    "scaled_joints_normal_map": strict(dict.fromkeys("56", COUNT)),
    "lines": strict(dict.fromkeys("123456", LINES)),
}
SCHEMA = {"const": "skinbake.cost/1"}
SINGLE = strict({"schema": SCHEMA, "influences": COUNT, **COSTS})
TABLE = strict(
    {"schema": SCHEMA, "table": {"type": "array", "items": strict({"influences": COUNT, **COSTS})}}
)


def test_json_has_the_documented_shape() -> None:
    jsonschema.validate(cost(), TABLE)
    jsonschema.validate(cost("--influences", "3"), SINGLE)


class TestNumberOfInfluences:
    def test_four_cost_what_the_paper_s_table_says(self) -> None:
        found = cost("--influences", "4")
        assert found["multiply_adds"] == {"1": 87, "2": 190, "3": 132, "4": 142, "5": 253, "6": 262}
        # 12 + 12 + 16 of position, normal, tangent and 4 × (1 + 4) of influences are 60; ∇w is 4 × 3 floats,
        # α and β are 3 floats each.
        assert found["bytes"] == by_number(60, 60 + 48, 60 + 24)
        assert found["added_bytes"] == by_number(0, 48, 24)
        # T n0 by a matrix of 9 or a rotation of 18, and two cross products of 6.
        assert found["normal_map"] == {"3": 21, "5": 30, "6": 30}
        # Of 60 N + 83 by hand for algorithm 6, N = 4.
        assert found["scaled_joints"] == {"4": 201, "5": 306, "6": 323}
        # T n0 by a matrix of four rows, 12; its quotient by the mix, of which only the vector is needed: two
        # vectors scaled, 6, and a cross product of 6; and the two cross products as above.
        assert found["scaled_joints_normal_map"] == {"5": 36, "6": 36}

    @pytest.mark.parametrize("influences", range(1, 9))
    def test_every_line_costs_what_the_paper_says(self, influences: int) -> None:
        found = cost("--influences", str(influences))
        for number, lines in PAPER.items():
            expected = {str(line): count for line, count in enumerate(lines(influences), start=1)}
            assert found["lines"][number] == expected
        assert found["multiply_adds"] == paper(influences)
        assert sum(found["lines"]["6"].values()) == EXACT[influences]

    def test_the_table_goes_from_one_to_eight(self) -> None:
        found = cost()["table"]
        assert [row["influences"] for row in found] == [1, 2, 3, 4, 5, 6, 7, 8]
        for n, row in enumerate(found, start=1):
            assert row["multiply_adds"] == paper(n)
            assert row["bytes"] == by_number(40 + 5 * n, 40 + 5 * n + 12 * n, 40 + 5 * n + 8 * (n - 1))

    def test_sixty_four_is_the_most(self) -> None:
        assert cost("--influences", "64")["multiply_adds"]["1"] == 12 * 64 + 39


class TestText:
    def test_the_table_of_one_number_of_influences(self) -> None:
        text = invoke("cost", "--influences", "4").stdout
        rows = [line.split() for line in text.splitlines() if re.match(r"  [1-6]  ", line)]
        assert [" ".join(row[1:3]) for row in rows] == NAMES
        assert [int(row[3]) for row in rows] == [87, 190, 132, 142, 253, 262]
        assert [int(row[4]) for row in rows] == [60, 108, 84, 60, 84, 84]
        assert [int(row[5]) for row in rows] == [0, 48, 24, 0, 24, 24]
        assert "36+36+9+18+18+6+9" in text
        assert DOI in text

    def test_table(self) -> None:
        text = invoke("cost").stdout
        rows = [line for line in text.splitlines() if re.match(r"  [1-6]  ", line)]
        assert len({len(row) for row in rows}) == 1  # aligned
        counts = [[int(value) for value in row.split()[3:]] for row in rows]
        assert counts[:6] == [[paper(n)[number] for n in range(1, 9)] for number in "123456"]
        assert counts[8] == [45, 58, 71, 84, 97, 110, 123, 136]
        assert DOI in text

    @pytest.mark.parametrize("arguments", [[], ["--influences", "4"], ["--influences", "64"]])
    def test_lines_fit_a_usual_terminal(self, arguments: list[str]) -> None:
        assert max(map(len, invoke("cost", *arguments).stdout.splitlines())) <= 80

    def test_quiet_leaves_json_alone(self) -> None:
        assert invoke("cost", "-q").output == ""
        assert cost("-q")["table"]


class TestErrors:
    @pytest.mark.parametrize(
        "arguments",
        [
            ["--influences", "0"],
            ["--influences", "65"],
            ["--influences", "four"],
            ["--influences", "4.0"],
            ["--influences"],
            ["hero.glb"],
            ["--frame", "normal"],
        ],
    )
    def test_wrong_usage_is_2(self, arguments: list[str]) -> None:
        result = invoke("cost", *arguments)
        assert (result.exit_code, result.stdout) == (2, "")
        assert "Error: " in result.stderr


LOADED = """
import sys
from skinbake.cli.main import main
main(["cost", "--help"], standalone_mode=False)
heavy = {"numpy", "skinbake.skinning", "skinbake.commands", "skinbake.report"}
print(sorted(heavy & set(sys.modules)), file=sys.stderr)
"""


def test_help_imports_nothing_heavy() -> None:
    process = run(command=("-c", LOADED))
    assert process.stdout.startswith(b"Usage: ")
    assert process.stderr.split() == [b"[]"]
