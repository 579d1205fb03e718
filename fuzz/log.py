"""The log of all runs: a JSON line each, from which fuzz/RELIABILITY.md is made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

LOG = Path(__file__).resolve().parents[1] / "build" / "fuzz-log.jsonl"


def note(
    kind: str,
    *,
    executions: int,
    seconds: float,
    seed: int | None,
    finds: Mapping[str, int],
    log: Path = LOG,
    **more: Any,
) -> None:
    """Append what a run did: how many executions in which time from which seed, and what it found."""
    line = {
        "date": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "kind": kind,
        "executions": executions,
        "seconds": round(seconds, 1),
        "seed": seed,
        "finds": dict(finds),
        **more,
    }
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")
