"""The result of strip, as a closing line and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skinbake.errors import Notice, printable
from skinbake.report.notices import notice_list
from skinbake.wording import counted

SCHEMA = "skinbake.strip/1"


@dataclass(frozen=True, slots=True)
class StripResult:
    """The number of primitives that lost their bake, and notices on leftovers."""

    input: str
    output: str
    primitives: int
    notices: tuple[Notice, ...]


def closing_line(result: StripResult) -> str:
    """Return one line with the number of stripped primitives."""
    what = f"stripped {counted(result.primitives, 'primitive')}" if result.primitives else "unchanged"
    return f"{printable(result.input)} -> {printable(result.output)}: {what}"


def as_json(result: StripResult) -> dict[str, Any]:
    """Return the result as one JSON object."""
    return {
        "schema": SCHEMA,
        "input": result.input,
        "output": result.output,
        "primitives": result.primitives,
        "warnings": notice_list(result.notices),
    }
