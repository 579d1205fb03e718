"""The result of strip, as a closing line and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from skinbake.errors import Notice, SkinbakeError, printable
from skinbake.report.totals import error_fields, notice_list, timing_fields
from skinbake.wording import counted

SCHEMA = "skinbake.strip/1"
FILES_SCHEMA = "skinbake.strip-files/1"
OUTCOMES = ("stripped", "unchanged", "failed")

Status = Literal["stripped", "unchanged", "failed"]
"""``unchanged``: passed through, because it holds no bake."""


@dataclass(frozen=True, slots=True)
class StripResult:
    """The number of primitives that lost their bake, and notices on leftovers.

    error is the reason of a failure. record is always None. timings are seconds by stage, None if they were
    not requested. read are the paths of the files beside the input that were read, if they were requested.
    """

    input: str
    output: str
    primitives: int
    notices: tuple[Notice, ...]
    error: SkinbakeError | None = None
    record: bytes | None = None
    timings: dict[str, float] | None = None
    read: tuple[str, ...] = ()

    @property
    def status(self) -> Status:
        """The outcome of the file."""
        if self.error is not None:
            return "failed"
        return "stripped" if self.primitives else "unchanged"


def closing_line(result: StripResult) -> str:
    """Return one line with the number of stripped primitives."""
    name = printable(result.input)
    what = f"stripped {counted(result.primitives, 'primitive')}" if result.primitives else "unchanged"
    where = name if result.output == result.input else f"{name} -> {printable(result.output)}"
    return f"{where}: {what}"


def as_json(result: StripResult) -> dict[str, Any]:
    """Return the result as one JSON object."""
    return {
        "schema": SCHEMA,
        "input": result.input,
        "output": result.output,
        "primitives": result.primitives,
        "warnings": notice_list(result.notices),
    }


def file_json(result: StripResult) -> dict[str, Any]:
    """Return the result of one file as a JSON object; docs/reference/json.md documents its members."""
    return {
        "input": result.input,
        "output": result.output,
        "status": result.status,
        "primitives": result.primitives,
        "warnings": notice_list(result.notices),
        "error": error_fields(result.error),
        **timing_fields(result.timings),
    }
