"""The page benchmarks/RESULTS.md, from the figures of ``python -m benchmarks.results``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks import speedup_chart
from benchmarks.processes import MIB, Json, median
from benchmarks.truth_cost import BOTH, METHODS
from skinbake.choices import Truth

NONE = "—"
FREE_MEMORY = 100 * MIB
"""The memory that a bake may take besides three times its file."""

WORTH_A_LINE = 0.0005
"""Seconds from which a stage has a line of its own."""

HEAD = """# Benchmarks

Written by `make bench`. Whole processes, start-up included, that take turns on one machine; a figure is the
median of its runs, the fastest in brackets, and the peak memory of the largest process.
*Ratio* is skinbake's figure divided by the peer's: below 1 is better than the peer.
"""


@dataclass(frozen=True)
class Line:
    """One line of the table; ``met`` is None where there is no bar, or nothing to compare with."""

    what: str
    ours: str
    peer: str
    theirs: str
    ratio: float | None
    bar: str
    met: bool | None


def page(results: Json) -> str:
    """Return the page as Markdown."""
    rows = results["rows"]
    parts = [HEAD, *about(results), "\n".join(table(rows)) + "\n", notes(rows), "\n".join(sizes(rows)) + "\n"]
    profile = list(stages(rows))
    if profile:
        parts.append("\n".join(profile) + "\n")
    if "speedup" in rows:
        parts.append("\n".join(speedup_chart.section(rows["speedup"])) + "\n")
    return "\n".join(parts)


def about(results: Json) -> Iterator[str]:
    """Yield the machine and the versions."""
    machine, versions = results["machine"], results["versions"]
    if results["quick"]:
        yield "**A quick run: one run each of small inputs. The figures say nothing.**\n"
    yield (
        f"{results['date']}, {machine['processor']}, {machine['cores']} cores, {machine['memory_gib']} GiB, "
        f"{machine['system']}. {', '.join(f'{name} {number}' for name, number in versions.items())}.\n"
    )
    for later in results.get("later", []):
        names = ", ".join(later["rows"])
        way = ", at real-time priority" if later["real_time"] else ""
        yield (
            f"Measured again on {later['date']}, {later['processor']}, {later['cores']} cores, other work on "
            f"the machine with a load of {later['load']}{way}: {names}.\n"
        )


def table(rows: Json) -> Iterator[str]:
    """Yield the table's lines."""
    yield "| what | skinbake | peer | its figure | ratio | bar | |"
    yield "|---|---|---|---|---|---|---|"
    for line in lines(rows):
        verdict = {True: "met", False: "**missed**", None: ""}[line.met]
        ratio = NONE if line.ratio is None else f"{line.ratio:.2f}"
        cells = (line.what, line.ours, line.peer, line.theirs, ratio, line.bar, verdict)
        yield f"| {' | '.join(cells)} |"


def lines(rows: Json) -> Iterator[Line]:
    """Yield what the table says."""
    yield from startup_lines(rows["startup"])
    yield character_line(rows["character"])
    yield from grid_lines(rows["grid"], rows["tangents"])
    yield from gradients_lines(rows["gradients"])
    yield from scaling_lines(rows["scaling"])
    yield from verify_lines(rows["verify"])
    yield from truth_lines(rows["truths"])
    yield files_line(rows["files"])
    yield payload_line(rows["payload"])


def startup_lines(row: Json) -> Iterator[Line]:
    """Yield how long skinbake takes to say what it is."""
    empty = row["runs"]["python -c pass"]
    for name in ("skinbake --help", "skinbake --version"):
        ours = row["runs"][name]
        yield Line(
            f"`{name}`",
            figure(ours),
            "`python -c pass`",
            figure(empty),
            median(ours) / median(empty),
            "under 0.10 s",
            median(ours) < 0.10,
        )


def character_line(row: Json) -> Line:
    """Return the bake of a character."""
    ours, theirs = row["runs"]["bake"], row["runs"].get("tangents")
    return compared(
        f"bake {row['model']}, {row['bytes'] / 1e6:.2f} MB",
        ours,
        "`gltf-transform tangents`",
        theirs,
        ("no slower; aim at 0.30 s", 1.0),
    )


def grid_lines(row: Json, tangents: Json) -> Iterator[Line]:
    """Yield the bake of a large grid, against each tool."""
    what = f"bake a grid of {row['vertices']:,} vertices, {row['bytes'] / 1e6:.0f} MB"
    runs, slow = row["runs"], tangents["runs"]
    copied = runs.get("copy")
    yield compared(what, runs["bake"], "`gltf-transform copy`", copied, ("0.40 of its time", 0.40))
    yield compared(f"{what}, `--no-sync`", runs["bake --no-sync"], "`gltf-transform copy`", copied, None)
    packed = runs.get("gltfpack")
    yield compared(
        f"{what}: memory", runs["bake"], "`gltfpack -noq`", packed, ("at most its memory", 1.0), "mib"
    )
    yield compared(what, slow["bake"], "`gltf-transform tangents`", slow.get("tangents"), None)


def gradients_lines(row: Json) -> Iterator[Line]:
    """Yield the gradients alone, against each loop."""
    what, runs = f"gradients alone, {row['vertices']:,} vertices, one core", row["runs"]
    bar = ("a third of its time: 0.11 s where it takes 0.33 s", 1 / 3)
    yield compared(what, runs["skinbake"], "the authors' loop, C++ -O3", runs.get("authors' loop"), bar)
    peer = "meshoptimizer's generateTangents, WebAssembly"
    yield compared(what, runs["skinbake"], peer, runs.get("meshoptimizer"), None)


def scaling_lines(row: Json) -> Iterator[Line]:
    """Yield how time and memory grow."""
    sizes = row["sizes"]
    reach = f"{sizes[0]['vertices']:,} to {sizes[-1]['vertices']:,} vertices"
    slope, last = slopes(sizes)
    yield Line(
        f"time from {reach}: slope of log time over log vertices",
        f"{slope:.2f} by least squares, {last:.2f} between the last two",
        NONE,
        NONE,
        None,
        "at most 1.05",
        slope <= 1.05,
    )
    worst = max(beyond_free(size) for size in sizes)
    yield Line(
        f"memory from {reach}: (peak − 100 MiB) / file",
        f"{worst:.2f} at most" if worst > 0 else "below 0",
        NONE,
        NONE,
        None,
        "at most 3",
        worst <= 3,
    )


def verify_lines(row: Json) -> Iterator[Line]:
    """Yield the verification of a grid in random poses, as it is by default and by one method alone."""
    for methods in ("both methods", "LBS"):
        yield compared(
            f"verify, {row['vertices']:,} vertices, {row['poses']} poses, {methods}",
            row["runs"][methods],
            "libigl: positions, averaged normals",
            row["runs"]["libigl"],
            ("no slower", 1.0),
        )


def truth_lines(row: Json) -> Iterator[Line]:
    """Yield the verification by both truths, against that by one: by both methods, and by each."""
    for methods in METHODS:
        yield compared(
            f"verify, {row['vertices']:,} vertices, {row['poses']} poses, {methods}, by both truths",
            row["runs"][f"{methods}, {BOTH}"],
            "the same by tangents alone",
            row["runs"][f"{methods}, {Truth.TANGENTS}"],
            ("1.3 of its time", 1.3),
        )


def files_line(row: Json) -> Line:
    """Return the bake of many files in one call."""
    ours = row["runs"]["one call"]
    scale = row["files"] / row["single_calls"]
    theirs = {"seconds": [seconds * scale for seconds in row["runs"]["single calls"]["seconds"]]}
    jobs = f", --jobs {row['jobs']}" if row["jobs"] > 1 else ""
    return compared(
        f"bake {row['files']:,} files of {row['vertices']:,} vertices in one call{jobs}",
        {"seconds": ours["seconds"]},
        f"as many single calls, from {row['single_calls']}",
        theirs,
        ("an eighth", 1 / 8),
    )


def payload_line(row: Json) -> Line:
    """Return the bake of a small grid in a file that is mostly textures."""
    what = f"bake {row['vertices']:,} vertices with {row['payload'] / 1e6:.0f} MB of textures"
    return compared(what, row["runs"]["bake"], "`gltf-transform copy`", row["runs"].get("copy"), None)


def compared(
    what: str, ours: Json, peer: str, theirs: Json | None, bar: tuple[str, float] | None, by: str = "seconds"
) -> Line:
    """Return a line whose bar, if any, is the largest ratio of seconds, or of MiB."""
    if theirs is None:
        return Line(what, figure(ours), peer, "not installed", None, bar[0] if bar else NONE, None)
    ratio = median(ours, by) / median(theirs, by)
    met = None if bar is None else ratio <= bar[1]
    return Line(what, figure(ours), peer, figure(theirs), ratio, bar[0] if bar else NONE, met)


def figure(measured: Json) -> str:
    """Return seconds and, where they were taken, MiB of one command."""
    middle, fastest = seconds(median(measured)), seconds(min(measured["seconds"]))
    text = f"{middle} s" if middle == fastest else f"{middle} s ({fastest})"
    return f"{text}, {median(measured, 'mib'):,.0f} MiB" if "mib" in measured else text


def seconds(value: float) -> str:
    """Return a number of seconds to two or three digits."""
    digits = 0 if value >= 100 else 1 if value >= 10 else 2 if value >= 0.1 else 3
    return f"{value:,.{digits}f}"


def slopes(sizes: list[Json]) -> tuple[float, float]:
    """Return the slope of log seconds over log vertices: by least squares over all, and of the last step."""
    x = [math.log(size["vertices"]) for size in sizes]
    y = [math.log(median(size)) for size in sizes]
    return float(np.polyfit(x, y, 1)[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])


def beyond_free(size: Json) -> float:
    """Return the peak memory less 100 MiB, as a multiple of the file."""
    return (median(size, "mib") * MIB - FREE_MEMORY) / float(size["bytes"])


def notes(rows: Json) -> str:
    """Return what must be known to read the table."""
    character, files, verify = rows["character"], rows["files"], rows["verify"]
    said = [
        "CesiumMan is that of the corpus, 3,273 vertices."
        if character["model"] == "CesiumMan.glb"
        else "Instead of CesiumMan a fixture is baked: the corpus of real models is not here.",
        "Grids are those of `benchmarks/skinned_grid.py`: FLOAT weights, four influences of 32 joints, "
        "normals, texture coordinates, two triangles a vertex.",
        "bake waits until its output is on the disk. The other tools and `bake --no-sync` do not.",
        "The gradients are timed inside their processes, without start-up and reading. The authors' loop is "
        "`benchmarks/authors_loop.cpp`, written from what Tarini et al. (2014) published: means by angle × "
        "area, of a vertex's own joints, in float32. skinbake's one pass also sees the neighbours' joints, "
        "adopts them, makes frames, and writes α and β, in float64.",
        "meshoptimizer's generateTangents gives each corner of a triangle a tangent along the texture "
        "coordinates, nothing of joints.",
        f"verify has a grid in random poses: no real character at hand has {verify['vertices']:,} vertices. "
        "The peer computes where vertices go and the moved surface's normals, a part of what verify does.",
        f"Single calls are timed for {files['single_calls']} of the {files['files']:,} files, and scaled.",
    ]
    return "\n".join(f"- {sentence}" for sentence in said) + "\n"


def sizes(rows: Json) -> Iterator[str]:
    """Yield the section on scaling."""
    row = rows["scaling"]
    yield "## By size"
    yield "| vertices | MB read | written | seconds | µs a vertex | MiB | (MiB − 100) / file | runs |"
    yield "|---|---|---|---|---|---|---|---|"
    for size in row["sizes"]:
        cells = (
            f"{size['vertices']:,}",
            f"{size['bytes'] / 1e6:.2f}",
            f"{size['written'] / 1e6:.2f}",
            seconds(median(size)),
            f"{1e6 * median(size) / size['vertices']:.2f}",
            f"{median(size, 'mib'):,.0f}",
            f"{beyond_free(size):.2f}" if beyond_free(size) > 0 else "below 0",
            str(len(size["seconds"])),
        )
        yield f"| {' | '.join(cells)} |"
    for vertices in row["left_out"]:
        yield f"\n{vertices:,} vertices were left out: too little free memory or disk."


def stages(rows: Json) -> Iterator[str]:
    """Yield the section on where the time goes; nothing where no stage was recorded."""
    models = rows["stages"]["models"]
    names = dict.fromkeys(
        name for model in models for name, taken in model["stages"].items() if taken >= WORTH_A_LINE
    )
    if not names:
        return
    yield "## Where the time goes"
    yield "Seconds of one bake, that of the middle of its runs, and their share of the whole process."
    yield ""
    yield f"| stage | {' | | '.join(model['model'] for model in models)} | |"
    yield f"|---|{'---|---|' * len(models)}"
    for name in names:
        yield f"| {name} | {' | '.join(spent(model, model['stages'].get(name, 0.0)) for model in models)} |"
    rest = [model["seconds"] - sum(model["stages"].get(name, 0.0) for name in names) for model in models]
    yield f"| start-up | {' | '.join(spent(model, left) for model, left in zip(models, rest, strict=True))} |"
    yield f"| together | {' | '.join(spent(model, model['seconds']) for model in models)} |"
    yield ""
    yield (
        "bake writes the unchanged bytes of a large GLB while its kernel runs, unless `--no-sync` is given. "
        "Of two cores one is idle in start-up, which imports modules, in the guard, and in *write*, where α "
        "and β wait for the disk."
    )


def spent(model: Json, taken: float) -> str:
    """Return seconds, and what share they are of a model's."""
    return f"{taken:.3f} | {taken / model['seconds']:.0%}"
