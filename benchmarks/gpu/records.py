"""The figures of one run on one adapter, as they stand in a file of benchmarks/gpu/results."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).with_name("results")
COMPUTE, DRAWN = "compute pass", "vertex shader"


@dataclass(frozen=True, slots=True)
class TimeRecord:
    """The seconds of each round that one variant took for one scene, or the reason why there are none.

    instances is 1 for a mesh, else the characters of a crowd. bytes_moved are those of a posed vertex. more
    are the bytes of a vertex for α and β, or for neighbours.
    """

    scene: str
    instances: int
    posed_vertices: int
    variant: str
    stage: str
    bytes_moved: float
    more: float
    seconds: tuple[float, ...] = ()
    missing: str = ""


@dataclass(frozen=True, slots=True)
class ErrorRecord:
    """The angle between a variant's normals and a truth, in degrees, over all poses of a character."""

    character: str
    poses: int
    variant: str
    truth: str
    mean: float
    p95: float


@dataclass(frozen=True, slots=True)
class RunRecord:
    """One run. copy_rate is bytes a second, read and written. software: the adapter is a processor."""

    adapter: str
    backend: str
    driver: str
    software: bool
    processor: str
    system: str
    date: str
    versions: dict[str, str]
    clock: str
    rounds: int
    copy_rate: float
    times: tuple[TimeRecord, ...]
    errors: tuple[ErrorRecord, ...]

    @property
    def file_name(self) -> str:
        """Return a name for the adapter and its interface. A later run on the same one replaces the file."""
        words = f"{self.adapter} {self.backend}".lower()
        return re.sub(r"[^a-z0-9]+", "-", words).strip("-") + ".json"


def write_record(record: RunRecord, folder: Path) -> Path:
    """Write a run's figures into a folder, the rounds of each time in one line, and return the file."""
    text = json.dumps(asdict(record), indent=1, ensure_ascii=False)
    text = re.sub(r"\[[-\d.e,\s]+\]", lambda found: " ".join(found[0].split()), text)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / record.file_name
    target.write_text(text + "\n", encoding="utf-8")
    return target


def read_record(path: Path) -> RunRecord:
    """Read a file that ``write_record`` wrote."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    found["times"] = tuple(
        TimeRecord(**{**entry, "seconds": tuple(entry["seconds"])}) for entry in found["times"]
    )
    found["errors"] = tuple(ErrorRecord(**entry) for entry in found["errors"])
    return RunRecord(**found)


def measured_errors_of(records: Sequence[RunRecord]) -> tuple[ErrorRecord, ...]:
    """Return the errors of the first run that had the corpus of characters."""
    return next((record.errors for record in records if record.errors), ())


def read_records(folder: Path) -> list[RunRecord]:
    """Read the runs of all adapters: graphics hardware first, then software, by name."""
    found = [read_record(path) for path in sorted(folder.glob("*.json"))]
    return sorted(found, key=lambda record: record.software)
