"""List the kept finds by cause: ``python -m fuzz.finds_report``, a line each."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from fuzz.batches import FINDS


def lines(folder: Path) -> list[str]:
    """Return a line for each kept case: its kind, its cause, the command, and the last words of its text."""
    found = []
    for path in sorted(folder.glob("*/case.json")):
        case = json.loads(path.read_text(encoding="utf-8"))
        last = (case["text"].strip().splitlines() or [""])[-1][:160]
        command = f"skinbake {' '.join(case['arguments'])}"
        found.append(" | ".join([case["kind"], case["key"], command, last, path.parent.name]))
    return found


if __name__ == "__main__":
    print("\n".join(lines(Path(sys.argv[1]) if len(sys.argv) > 1 else FINDS)))
