"""Time skinned normals on an adapter of wgpu, and write docs/gpu.md.

Usage: python -m benchmarks.shader_speed [--vertices N ...] [--crowd N] [--rounds N] [--adapter WORD]
       python -m benchmarks.shader_speed --page-only

The generated WGSL of algorithms 1, 3, 4, 5 and 6 runs as a compute pass and as a vertex shader that draws
small triangles. Two recomputes of the normals run after a pass that skins positions. The meshes are sheets of
any size, and a crowd: one character of 10,000 vertices, drawn many times with its own joints each time.

A round runs everything once, in turn, so that a machine that slows down slows all; the first round does not
count. Times are the adapter's own timestamps, else wall time until the queue is empty. Without options the
sizes suit the adapter: 10,000, a million and 10 million vertices, 1,000 characters and 30 rounds on a GPU,
far less on a processor.

The figures go into benchmarks/gpu/results, a file for each adapter, and the page is made of all these files.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import wgpu

from benchmarks.gpu import adapters
from benchmarks.gpu.characters import corpus_characters, measured_errors
from benchmarks.gpu.chart import chart
from benchmarks.gpu.meshes import Palettes, sheet, sheet_poses
from benchmarks.gpu.page import page
from benchmarks.gpu.passes import (
    POSED_AT_ONCE,
    DoesNotFitError,
    Drawing,
    Part,
    compute_pass,
    parts_of_instances,
)
from benchmarks.gpu.records import (
    COMPUTE,
    DRAWN,
    RESULTS,
    ErrorRecord,
    RunRecord,
    TimeRecord,
    read_records,
    write_record,
)
from benchmarks.gpu.variants import VARIANTS, Variant
from benchmarks.results import processor
from skinbake import __version__

OUTPUT = Path(__file__).resolve().parents[1] / "docs" / "gpu.md"
CROWD_VERTICES = 10_000


@dataclass(frozen=True, slots=True)
class Sizes:
    """What is measured if nothing else is asked for."""

    vertices: tuple[float, ...]
    crowd: int
    rounds: int


ON_HARDWARE = Sizes((1e4, 1e6, 1e7), 1000, 30)
IN_SOFTWARE = Sizes((1e4, 1e5), 10, 9)


@dataclass(frozen=True, slots=True)
class Scene:
    """What is skinned at once, and its name: parts are as much of it as fits into buffers."""

    name: str
    instances: int
    parts: Sequence[Part]

    @property
    def posed(self) -> int:
        """The posed vertices."""
        return sum(part.counts.posed for part in self.parts)


def scenes(device: Any, vertices: Sequence[float], crowd: int, crowd_vertices: int) -> Iterator[Scene]:
    """Yield meshes of so many vertices, then one character so many times."""
    for number in map(int, vertices):
        count = -(-number // POSED_AT_ONCE)
        mesh, palettes = sheet(number // count), Palettes.of(sheet_poses(1))
        # Each part has buffers of its own, as if it were another part of one large mesh.
        parts = [Part.of(device, mesh, palettes) for _ in range(count)]
        yield Scene(f"one mesh of {number:,} vertices", 1, parts)
    if crowd:
        name = f"{crowd:,} characters of {crowd_vertices:,} vertices"
        parts = parts_of_instances(device, sheet(crowd_vertices), Palettes.of(sheet_poses(crowd)))
        yield Scene(name, crowd, parts)


def measured_times(device: Any, scene: Scene, rounds: int) -> list[TimeRecord]:
    """Run every variant in both stages, in turn, and return the times of the rounds after the first."""
    runs, missing = {}, {}
    stages = [(COMPUTE, variant) for variant in VARIANTS]
    stages += [(DRAWN, variant) for variant in VARIANTS if variant.choices is not None]
    for stage, variant in stages:
        try:
            make = compute_pass if stage == COMPUTE else Drawing
            runs[stage, variant.name] = make(device, variant, scene.parts)
        except (DoesNotFitError, wgpu.GPUError) as error:
            missing[stage, variant.name] = f"does not fit: {str(error).splitlines()[0]}"
    taken: dict[tuple[str, str], list[float]] = {key: [] for key in runs}
    for _ in range(rounds + 1):
        for key, run in runs.items():
            taken[key].append(run())
    return [
        time_record(scene, stage, variant, taken.get((stage, variant.name), [])[1:], missing)
        for stage, variant in stages
    ]


def time_record(
    scene: Scene, stage: str, variant: Variant, seconds: list[float], missing: dict[tuple[str, str], str]
) -> TimeRecord:
    """Return the seconds of one variant, with the bytes that its layouts give."""
    counts = [part.counts for part in scene.parts]
    moved = sum(variant.bytes_moved(c) if stage == COMPUTE else variant.bytes_drawn(c) for c in counts)
    more = sum(map(variant.adjacency_bytes, counts)) / sum(c.vertices for c in counts)
    reason = missing.get((stage, variant.name), "")
    return TimeRecord(
        scene.name,
        scene.instances,
        scene.posed,
        variant.name,
        stage,
        moved / scene.posed,
        more,
        tuple(seconds),
        reason,
    )


def measured_run(adapter: Any, options: argparse.Namespace) -> RunRecord:
    """Measure the copy kernel, all scenes and the characters on one adapter."""
    software = adapters.is_software(adapter)
    device = adapters.device_of(adapter, timestamps=_wants_timestamps(options.clock, software))
    usual = IN_SOFTWARE if software else ON_HARDWARE
    rounds = usual.rounds if options.rounds is None else options.rounds
    crowd = usual.crowd if options.crowd is None else options.crowd
    rate = adapters.copy_rate(device, rounds, software=software)
    times: list[TimeRecord] = []
    for scene in scenes(device, options.vertices or usual.vertices, crowd, options.crowd_vertices):
        print(f"{scene.name} ...", file=sys.stderr)
        times += measured_times(device, scene, rounds)
        for part in scene.parts:
            part.destroy()
    errors: list[ErrorRecord] = []
    for character in () if options.no_characters else corpus_characters(options.samples):
        print(f"{character.name} ...", file=sys.stderr)
        errors += measured_errors(device, character, VARIANTS)
    info = adapter.info
    return RunRecord(
        info["device"],
        info["backend_type"],
        info["description"],
        software,
        processor(),
        f"{platform.system()} {platform.machine()}",
        time.strftime("%Y-%m-%d"),
        {"skinbake": __version__, "wgpu": wgpu.__version__},
        "timestamps of the adapter" if adapters.has_timestamps(device) else "wall time",
        rounds,
        rate,
        tuple(times),
        tuple(errors),
    )


def _wants_timestamps(clock: str, software: bool) -> bool:
    """Tell whether to ask for timestamps. Those of lavapipe may come before the work is done."""
    return clock == "timestamps" or (clock == "auto" and not software)


def write_page(results: Path, output: Path) -> None:
    """Write the page of all runs in a folder, and the chart of the first."""
    records = read_records(results)
    picture = output.with_suffix(".svg")
    picture.write_text(chart(records), encoding="utf-8")
    output.write_text(page(records, picture.name), encoding="utf-8")
    print(f"{len(records)} adapters -> {output}, {picture}")


def parser() -> argparse.ArgumentParser:
    found = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    found.add_argument("--vertices", type=float, nargs="+", metavar="N", help="vertices of the meshes")
    found.add_argument("--crowd", type=int, metavar="N", help="characters of the crowd; 0: none")
    found.add_argument("--crowd-vertices", type=int, default=CROWD_VERTICES, metavar="N")
    found.add_argument("--rounds", type=int, metavar="N", help="rounds that count")
    found.add_argument("--adapter", default="", metavar="WORD", help="part of its name; the fastest without")
    found.add_argument(
        "--clock",
        choices=("auto", "timestamps", "wall"),
        default="auto",
        help="auto: the adapter's timestamps on a GPU, wall time on a processor",
    )
    found.add_argument("--samples", type=int, metavar="N", help="poses of each clip; as verify without")
    found.add_argument("--no-characters", action="store_true", help="leave the errors out")
    found.add_argument("--results", type=Path, default=RESULTS, metavar="FOLDER")
    found.add_argument("--output", type=Path, default=OUTPUT, metavar="FILE.md")
    found.add_argument("--page-only", action="store_true", help="measure nothing, write the page anew")
    return found


def main() -> None:
    """Measure one adapter, unless asked for the page alone, and write the page of all."""
    options = parser().parse_args()
    if not options.page_only:
        record = measured_run(adapters.adapter_of(options.adapter), options)
        print(write_record(record, options.results))
    write_page(options.results, options.output)


if __name__ == "__main__":
    main()
