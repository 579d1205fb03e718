"""Ask the Khronos glTF validator (npm package gltf-validator) about files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

from tests.support.node import Script
from tests.support.node import require_node as _require_node

VALIDATOR = Script("validate.mjs", "gltf-validator")


class Finding(NamedTuple):
    """One message of the validator: its code, and the JSON pointer that it is about."""

    code: str
    pointer: str


class Report(TypedDict):
    """Everything that the validator found in one file, by severity."""

    errors: list[Finding]
    warnings: list[Finding]
    infos: list[Finding]
    hints: list[Finding]


def require_node() -> str:
    """Return the path of node where the validator can run; else skip, or fail under SKINBAKE_STRICT=1."""
    return _require_node("gltf-validator")


def validate(path: Path) -> Report:
    """Validate one .glb, .gltf or .vrm file with the resources beside it."""
    return validate_many([path])[path]


def validate_many(paths: Iterable[Path]) -> dict[Path, Report]:
    """Validate files; the keys are the paths as given.

    A file that the validator cannot recognise at all has one error, NOT_GLTF. Raises FileNotFoundError where
    a path leads nowhere.
    """
    wanted = list(dict.fromkeys(paths))
    for path in wanted:
        if not path.is_file():
            raise FileNotFoundError(path)
    return {path: _report(answer) for path, answer in zip(wanted, VALIDATOR.ask_about(wanted), strict=True)}


def new_findings(before: Report, after: Report) -> Counter[tuple[str, str]]:
    """Count the errors and warnings that ``after`` has and ``before`` had not, by (severity, code).

    A pointer that only moved is nothing new; one more finding of a code that was there before is. Empty,
    hence false, where nothing is new. Infos and hints do not count.
    """
    return _counted(after) - _counted(before)


def _counted(report: Report) -> Counter[tuple[str, str]]:
    return Counter(
        [("error", finding.code) for finding in report["errors"]]
        + [("warning", finding.code) for finding in report["warnings"]]
    )


def _report(content: Any) -> Report:
    report = Report(errors=[], warnings=[], infos=[], hints=[])
    if "failure" in content:
        report["errors"].append(Finding("NOT_GLTF", ""))
        return report
    of_severity = {
        "error": report["errors"],
        "warning": report["warnings"],
        "info": report["infos"],
        "hint": report["hints"],
    }
    for severity, code, pointer in content["issues"]:
        of_severity[severity].append(Finding(code, pointer))
    return report
