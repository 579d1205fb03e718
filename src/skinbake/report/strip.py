"""What strip did, as a closing line and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skinbake.errors import Notice, printable
from skinbake.report.notices import counted, notice_list

SCHEMA = "skinbake.strip/1"


@dataclass(frozen=True, slots=True)
class StripResult:
    """How many primitives lost their bake, and what could not be undone."""

    input: str
    output: str
    primitives: int
    notices: tuple[Notice, ...]


def closing_line(result: StripResult) -> str:
    """Return one line that says what was taken out."""
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
