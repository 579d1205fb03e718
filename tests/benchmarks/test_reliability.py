"""The page about reliability says what the logs say."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.reliability import finds, page, read_logs

LINES = [
    {"date": "2026-01-02T00:00:00Z", "kind": "commands", "executions": 1500, "seconds": 1800, "seed": 1,
     "finds": {"defect-A": 2}, "codes": {"bake 0": 1000, "bake 3": 400, "strip 0": 100}},
    {"date": "2026-01-03T00:00:00Z", "kind": "commands", "executions": 500, "seconds": 1800, "seed": 2,
     "finds": {"defect-A": 1, "hang-B": 1}, "codes": {"bake 0": 500}},
    {"date": "2026-01-03T00:00:00Z", "kind": "branches", "executions": 90, "seconds": 9, "seed": 3,
     "finds": {}, "branches": 200, "covered": 191},
    {"date": "2026-01-03T00:00:01Z", "kind": "branches", "executions": 91, "seconds": 9, "seed": 4,
     "finds": {}, "branches": 200, "covered": 194, "faults": 1200},
    {"date": "2026-01-03T00:00:00Z", "kind": "hostile", "executions": 5, "seconds": 3, "seed": None,
     "finds": {}, "files": {"a/m.glb": ["3 3 0", 0.4, 60]}},
    {"date": "2026-01-03T00:00:00Z", "kind": "hostile, sanitized", "executions": 5, "seconds": 30,
     "seed": None, "finds": {}, "files": {"a/m.glb": ["3 3 1", 4.0, 600]}},
    {"date": "2026-01-04T00:00:00Z", "kind": "faults", "executions": 7, "seconds": 1, "seed": None,
     "finds": {}, "kinds": {"kill": 4, "eio+": 3}},
]  # fmt: skip


def test_the_page_adds_up_what_the_logs_have(tmp_path: Path) -> None:
    logs = [tmp_path / "a.jsonl", tmp_path / "b.jsonl"]
    logs[0].write_text("".join(json.dumps(line) + "\n" for line in LINES[:2]))
    logs[1].write_text("".join(json.dumps(line) + "\n" for line in LINES[2:]))
    lines = read_logs(logs)
    text = page(lines)
    assert "| every command on damaged models | 2,000 | 1.00 | 2 |" in text
    assert "**Finds**: 2 in all. Open: defect-A, hang-B." in text
    assert "kill 4, eio+ 3." in text
    assert "194 of 200 of `src/skinbake/files` and `src/skinbake/gltf` (97.0 %)" in text
    assert (
        "every command on 1 files that once broke a promise ends with exit code 0 or 1 or 3, after 0.4 s"
        in text
    )
    assert next(iter(finds(lines))) == "defect-A  3 ×, last on 2026-01-03: open"


def test_a_page_without_runs_says_so() -> None:
    assert "Nothing has been run yet." in page([])
