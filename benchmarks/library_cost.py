"""Compute what baking a million assets costs, from the figures of the last `make bench`.

Usage: python -m benchmarks.library_cost [--results FILE.json] [--output FILE.md]

Reads benchmarks/RESULTS.json and writes docs/library_cost.md: the same figures give the same page. For the
mean asset (V vertices, X bytes that bake only copies) and N cores on M nodes:

    t = file + vertex · V + payload · X + wait      seconds of a core for an asset
    B = (read + written) · V + 2 X                  bytes moved for an asset

    cores     = ASSETS · t / N
    network   = ASSETS · B / (M · node)
    store     = ASSETS · B / store
    scheduler = ASSETS / (tasks · files of a task)

These overlap, because each worker is at another file. So the largest counts.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.processes import Json, median
from benchmarks.results import OUTPUT as RESULTS

OUTPUT = Path(__file__).resolve().parents[1] / "docs" / "library_cost.md"
ASSETS = 1_000_000
CORES = (10, 100, 1_000)


@dataclass(frozen=True)
class Kind:
    """A kind of asset: its share of the library, vertices, and bytes of textures and animation."""

    name: str
    share: float
    vertices: int
    payload: int


LIBRARY = (
    Kind("crowd", 0.60, 2_500, 1_000_000),
    Kind("character", 0.30, 10_000, 4_000_000),
    Kind("hero", 0.09, 50_000, 16_000_000),
    Kind("scan", 0.01, 1_000_000, 64_000_000),
)


@dataclass(frozen=True)
class Cluster:
    """The assumptions about the machines.

    Cores of a node; bytes a second of a node's network and of the store; seconds waited for an asset. A task
    holds files until they take task_seconds or are task_files, as those of ``--dask`` do.
    """

    node_cores: int = 16
    node_bytes: float = 1.25e9
    store_bytes: float = 10e9
    latency: float = 0.02
    task_seconds: float = 0.5
    task_files: int = 64


CLUSTER = Cluster()
LARGEST_FOR_RATE = 1_000_000
"""Vertices of the largest grid that the rate is taken from: the library has none larger."""

HEAD = """# The cost of a library of a million assets

A calculation, not a run: the rates of the last `make bench` ([RESULTS.md](../benchmarks/RESULTS.md)) on an
assumed library and cluster. Put your own numbers into `benchmarks/library_cost.py`, which writes this page.
"""


@dataclass(frozen=True)
class Rates:
    """The measured rates, of one core unless said otherwise.

    start: seconds of a whole process on the smallest grid; file: seconds a file in a process that runs
    already; vertex: seconds a vertex; payload: seconds a byte that bake only copies; read, written: bytes a
    vertex; tasks: tasks a second of the whole scheduler, None where it was not measured.
    """

    start: float
    file: float
    vertex: float
    payload: float
    read: float
    written: float
    tasks: float | None


def main() -> int:
    """Write the page; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=RESULTS.with_suffix(".json"))
    parser.add_argument("--output", type=Path, default=OUTPUT)
    options = parser.parse_args()
    results = json.loads(options.results.read_text(encoding="utf-8"))
    options.output.write_text(page(results), encoding="utf-8")
    print(f"-> {options.output}")
    return 0


def rates(rows: Json) -> Rates:
    """Return the rates that the measured rows give."""
    sizes = [size for size in rows["scaling"]["sizes"] if size["vertices"] <= LARGEST_FOR_RATE]
    least, small, large = sizes[0], *sizes[-2:]
    start = median(least)
    vertex = max(0.0, (median(large) - median(small)) / (large["vertices"] - small["vertices"]))
    files, textured = rows["files"], rows["payload"]
    busy = files["jobs"] * (median(files["runs"]["one call"]) - start) / files["files"]
    copying = median(textured["runs"]["bake"]) - median(textured["runs"]["bare"])
    per_second = rows["tasks"].get("per_second")
    return Rates(
        start=start,
        file=max(0.0, busy - vertex * files["vertices"]),
        vertex=vertex,
        payload=max(0.0, copying / textured["payload"]),
        read=large["bytes"] / large["vertices"],
        written=large["written"] / large["vertices"],
        tasks=sorted(per_second)[len(per_second) // 2] if per_second else None,
    )


@dataclass(frozen=True)
class Asset:
    """The mean asset: seconds of one core on it, waiting included, and bytes read and written."""

    vertices: float
    seconds: float
    read: float
    written: float


def mean_asset(found: Rates, cluster: Cluster) -> Asset:
    """Return the mean over the library."""
    vertices = sum(kind.share * kind.vertices for kind in LIBRARY)
    payload = sum(kind.share * kind.payload for kind in LIBRARY)
    return Asset(
        vertices,
        found.file + found.vertex * vertices + found.payload * payload + cluster.latency,
        found.read * vertices + payload,
        found.written * vertices + payload,
    )


def limits(cores: int, asset: Asset, found: Rates, cluster: Cluster) -> dict[str, float]:
    """Return the seconds that each part of the cluster needs for the library, were it alone."""
    nodes = math.ceil(cores / cluster.node_cores)
    moved = ASSETS * (asset.read + asset.written)
    needed = {
        "cores": ASSETS * asset.seconds / cores,
        "network": moved / (nodes * cluster.node_bytes),
        "store": moved / cluster.store_bytes,
    }
    if found.tasks is not None:
        needed["scheduler"] = ASSETS / (found.tasks * task_files(asset, cluster))
    return needed


def task_files(asset: Asset, cluster: Cluster) -> int:
    """Return how many mean assets make a task."""
    return max(1, min(cluster.task_files, int(cluster.task_seconds / asset.seconds)))


def page(results: Json) -> str:
    """Return the page as Markdown."""
    found = rates(results["rows"])
    asset = mean_asset(found, CLUSTER)
    parts = [
        HEAD,
        quick_warning(results),
        "\n".join(costs(asset, found)) + "\n",
        "\n".join(bottlenecks(asset, found)) + "\n",
        "\n".join(assumptions(results)) + "\n",
    ]
    return "\n".join(part for part in parts if part)


def quick_warning(results: Json) -> str:
    """Return a warning where the figures are those of a quick run."""
    return "**From a quick run: the figures mean nothing.**\n" if results["quick"] else ""


def costs(asset: Asset, found: Rates) -> Iterator[str]:
    """Yield the table of what the library costs."""
    read, written = ASSETS * asset.read, ASSETS * asset.written
    yield (
        f"The mean asset has {asset.vertices:,.0f} vertices and takes {1e3 * asset.seconds:.0f} ms of a "
        "core. "
        f"The whole library: {read / 1e12:.1f} TB read, "
        f"{written / 1e12:.1f} TB written, {ASSETS * asset.seconds / 3600:,.1f} core hours."
    )
    yield ""
    names = list(limits(1, asset, found, CLUSTER))
    yield f"| N | {' | '.join(names)} | wall time | core hours held | bottleneck |"
    yield f"|---|{'---|' * len(names)}---|---|---|"
    for cores in CORES:
        needed = limits(cores, asset, found, CLUSTER)
        wall = found.start + max(needed.values())
        cells = [duration(value) for value in needed.values()]
        held = f"{wall * cores / 3600:,.0f}"
        yield f"| {cores:,} | {' | '.join(cells)} | **{duration(wall)}** | {held} | {bottleneck(needed)} |"


def bottlenecks(asset: Asset, found: Rates) -> Iterator[str]:
    """Yield the bottleneck of each part, and the remedy."""
    moved = asset.read + asset.written
    textures = 2 * sum(kind.share * kind.payload for kind in LIBRARY) / moved
    node = moved / asset.seconds * CLUSTER.node_cores
    yield (
        f"- **Network of a node**: {CLUSTER.node_cores} busy cores move {node / 1e9:.2f} GB/s, and it "
        f"carries {CLUSTER.node_bytes / 1e9:.2f}."
    )
    yield (
        f"- **Store**: {CLUSTER.store_bytes / 1e9:.0f} GB/s, at any number of cores. {textures:.0%} of the "
        "bytes are textures and animation. A library that keeps textures beside its .gltf files "
        "need not move them."
    )
    if found.tasks is not None:
        yield (
            f"- **Scheduler**: one process, {found.tasks:,.0f} tasks a second. `--dask` puts several files "
            f"into a task, {task_files(asset, CLUSTER)} of the mean size."
        )
    yield (
        "- **The client**, if the library is on its own disk: every byte goes through its network, in "
        f"{duration(ASSETS * moved / CLUSTER.node_bytes)}. Use URLs, which the workers read themselves."
    )
    yield (
        f"- **Start-up**: {found.start:.2f} s for each worker. One call for each file would take "
        f"{found.start / asset.seconds:.1f} × the work itself."
    )


def assumptions(results: Json) -> Iterator[str]:
    """Yield the assumptions."""
    yield "## Assumed"
    yield "| kind of asset | share | vertices | textures and animation |"
    yield "|---|--:|--:|--:|"
    for kind in LIBRARY:
        yield f"| {kind.name} | {kind.share:.0%} | {kind.vertices:,} | {kind.payload / 1e6:.0f} MB |"
    yield ""
    yield (
        f"Nodes of {CLUSTER.node_cores} cores; tasks of {CLUSTER.task_seconds} s, at most "
        f"{CLUSTER.task_files} files; {1e3 * CLUSTER.latency:.0f} ms until a file is opened and its output "
        f"closed. The rates are of {results['machine']['processor']}, {results['date']}. Not counted: cores "
        "that share a memory, the end of a run, compressed input, waiting "
        "for the cluster, and `verify`, which takes longer than `bake`."
    )


def bottleneck(needed: dict[str, float]) -> str:
    """Return the part that takes longest."""
    return max(needed, key=lambda name: needed[name])


def duration(seconds: float) -> str:
    """Return seconds as hours and minutes, minutes, or seconds."""
    minutes = round(seconds / 60)
    if minutes >= 120:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min" if minutes >= 10 else f"{seconds:.0f} s"


if __name__ == "__main__":
    sys.exit(main())
