"""Bake correctives into real models, measure them by verify, and write the table of docs/correctives.md.

``python -m benchmarks.correctives [FOLDER ...] [--output FILE]``: every .glb and .gltf file with clips below
the folders; without one, the public part of the corpus and its cases. Errors are means in degrees, as verify
measures them at times that are no keys. Files in which nothing bends, or that no corrective improves, are
listed below the table. Then CesiumMan is baked five times each with correctives and with
``--gradients fitted``; the ratio of the shortest times is printed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.marked import write_between
from skinbake.choices import Encoding, Gradients
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_file
from skinbake.errors import SkinbakeError
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import FileResult
from tests.support.corpus_folder import find_corpus

REPOSITORY = Path(__file__).resolve().parents[1]
DEFAULT_OUTPUT = REPOSITORY / "docs" / "correctives.md"
START, END = "<!-- figures: begin -->", "<!-- figures: end -->"
LISTED = 3_000
"""The vertices of a model that has a row of its own. The means count all."""

FEWEST_VERTICES, FEWEST_DEGREES = 20, 0.1
"""A model of fewer vertices tests a file format. Under the angle there is nothing to correct."""


@dataclass(frozen=True)
class Row:
    """A model: vertices, targets, bytes a vertex by encoding, and mean errors by truth and lighting.

    by_bytes is the corrected error with ``packed8`` as a share of the standard one, as the bake says it.
    """

    name: str
    vertices: int
    targets: str
    sizes: dict[Encoding, float]
    errors: dict[str, dict[str, float]]
    by_bytes: dict[str, float]

    def ratio(self, truth: str) -> float:
        """Return the corrected error as a share of the standard one."""
        return self.errors[truth]["corrected"] / self.errors[truth]["standard"]


def main() -> int:
    """Write the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT)
    options = parser.parse_args()
    corpus = find_corpus()
    found = [path for folder in options.folders for path in folder.rglob("*")]
    if not options.folders and corpus is not None:
        found = [*(corpus / "public").rglob("*"), *(corpus / "cases").glob("*")]
    paths = sorted(path for path in found if path.suffix in {".glb", ".gltf"})
    if not paths:
        print("no models: name a folder, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    rows = [row for path in paths for row in measured(path)]
    write_between(options.output, START, END, "\n".join(table(rows)))
    character = next((path for path in paths if path.name == "CesiumMan.glb"), None)
    if character is not None:
        compared = BakeOptions(correctives="auto"), BakeOptions(gradients=Gradients.FITTED)
        shortest = [min(seconds(character, options) for _ in range(5)) for options in compared]
        print(f"CesiumMan: {shortest[0]:.2f} s, {shortest[0] / shortest[1]:.1f} times --gradients fitted")
    return 0


def seconds(path: Path, options: BakeOptions) -> float:
    """Return how long a bake takes that writes nothing."""
    start = time.perf_counter()
    bake_file(str(path), None, options)
    return time.perf_counter() - start


def measured(path: Path) -> Iterator[Row]:
    """Yield the row of a model, none if nothing in it can be corrected."""
    with TemporaryDirectory() as folder:
        target, sizes = str(Path(folder) / "out.glb"), {}
        try:
            for encoding in (Encoding.PACKED8, Encoding.FLOAT32):
                result = bake_file(str(path), target, BakeOptions(correctives="auto", encoding=encoding))
                if not result.correctives:
                    reasons = {notice.code for notice in result.notices} - {"nothing-baked"}
                    print(f"{path.name}: left out ({', '.join(sorted(reasons)) or result.status})")
                    return
                sizes[encoding] = size(result)
                if encoding is Encoding.PACKED8:
                    by_bytes = shares(result)
            verdict = verify_file(target, VerifyOptions())
        except SkinbakeError as error:
            print(f"{path.name}: left out ({error.message[:80]})")
            return
    vertices = sum(count.vertices for _, count in result.correctives)
    errors = {
        truth: {lighting: one.mean for lighting, one in normals["lbs"].items()}
        for truth, normals in verdict.by_truth.items()
    }
    if vertices < FEWEST_VERTICES or min(one["standard"] for one in errors.values()) < FEWEST_DEGREES:
        print(f"{path.name}: left out (nothing bends)")
        return
    counts = sorted({count.targets for _, count in result.correctives})
    targets = str(counts[0]) if len(counts) == 1 else f"{counts[0]}–{counts[-1]}"
    row = Row(f"{path.parent.name}/{path.name}", vertices, targets, sizes, errors, by_bytes)
    print(
        f"{row.name}: {row.ratio('triangles'):.2f} by triangles, {row.ratio('tangents'):.2f} by tangents",
        flush=True,
    )
    yield row


def shares(result: FileResult) -> dict[str, float]:
    """Return the remaining errors of a bake as shares of the standard ones, by truth."""
    return {truth: after / before for truth, before, after in result.lighting}


def size(result: FileResult) -> float:
    """Return the added bytes of a vertex."""
    counts = [count for _, count in result.correctives]
    return sum(one.added_bytes for one in counts) / sum(one.vertices for one in counts)


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of the table, and the means."""
    lightings = "standard / shader / corrected"
    yield f"| model | vertices | K | bytes a vertex, packed8 / float32 | triangles: {lightings} | tangents |"
    yield "|---|--:|--:|--:|---|---|"
    for row in (row for row in rows if row.vertices >= LISTED):
        by = [
            " / ".join(f"{row.errors[truth][one]:.2f}" for one in ("standard", "accurate", "corrected"))
            for truth in ("triangles", "tangents")
        ]
        sizes = " / ".join(f"{row.sizes[one]:.0f}" for one in (Encoding.PACKED8, Encoding.FLOAT32))
        yield f"| {row.name} | {row.vertices:,} | {row.targets} | {sizes} | {by[0]} | {by[1]} |"
    means: dict[str, Any] = {
        truth: sum(row.ratio(truth) for row in rows) / len(rows) for truth in ("triangles", "tangents")
    }
    worst = max(row.ratio(truth) for row in rows for truth in means)
    mean_sizes = {
        one: sum(row.sizes[one] for row in rows) / len(rows) for one in Encoding if one in rows[0].sizes
    }
    by_bytes = {truth: sum(row.by_bytes[truth] for row in rows) / len(rows) for truth in means}
    yield ""
    yield (
        f"In the mean of {len(rows)} models, of which those from {LISTED:,} vertices on are listed, "
        f"`float32` leaves {means['triangles']:.2f} of the standard error by triangles and "
        f"{means['tangents']:.2f} by tangents ({worst:.2f} in the worst) with "
        f"{mean_sizes[Encoding.FLOAT32]:.0f} bytes a vertex; `packed8` leaves {by_bytes['triangles']:.2f} "
        f"and {by_bytes['tangents']:.2f} with {mean_sizes[Encoding.PACKED8]:.0f}."
    )
    print(json.dumps({"means": means, "worst": worst, "bytes": mean_sizes}))


if __name__ == "__main__":
    sys.exit(main())
