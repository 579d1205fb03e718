"""Bake real models with every encoding, and write what each takes and costs into docs/encodings.md.

``python -m benchmarks.encoding_table [FOLDER] [--output FILE]``: every .glb, .gltf and .vrm file below the
folder is in the table; without one, eight characters of the corpus that the tests use (SKINBAKE_CORPUS, or
../shared/corpus), and all others are baked too, for the largest figures. Exits with 1 where a bake does not
verify.
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.corpus_table import REPOSITORY, SUFFIXES, corpus_folders, told_apart
from skinbake import __version__
from skinbake.choices import Encoding, Truth
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_file
from skinbake.errors import SkinbakeError
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import FileResult
from skinbake.wording import counted

DEFAULT_OUTPUT = REPOSITORY / "docs" / "encodings.md"
CHARACTERS = (
    "CesiumMan.glb",
    "trex.gltf",
    "mannequiny-0.3.0.glb",
    "Barbarian.glb",
    "Alien_Scolitex.gltf",
    "BaseFemale.glb",
    "hand_l.gltf",
    "hand_l-two-sets.glb",
)
SCALED = (Encoding.SNORM16, Encoding.PACKED8)

HEAD = """# The cost of smaller α and β

`bake --encoding` stores α and β in fewer bytes ([formats](reference/file-format.md#encodings)). `snorm16`
cannot be told from floats. `packed8`, the smallest, turns normals by under 0.1° on average.

Degrees over the model's own clips (random poses if it has none), weighted by rest area. *Error*: of accurate
normals by `float32`, as `verify` measures it by triangles. *Turned*: by the encoding, mean / 99th percentile,
as `bake` prints it. *Added*: the growth of the mean error.
"""


@dataclass(frozen=True)
class Measured:
    """One model in one encoding: bytes a vertex, how far normals turn (mean, p99), their mean error."""

    size: int
    turned: tuple[float, float] | None
    error: float | None


Row = dict[Encoding, Measured]


def main() -> int:
    """Write the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, nargs="?", help="where the models lie (default: the corpus)")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the file to write")
    options = parser.parse_args()
    folders = [options.folder] if options.folder else corpus_folders()
    if not folders:
        print("no models: name a folder, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    paths = sorted(
        {path for folder in folders for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES}
    )
    rows: dict[str, Row] = {}
    all_turned: dict[str, Row] = {}
    for path, name in zip(paths, told_apart(paths), strict=True):
        print(f"{name} ...", file=sys.stderr)
        shown = options.folder is not None or path.name in CHARACTERS
        found = measured(path, verified=shown)
        if found:
            all_turned[name] = found
            rows |= {name: found} if shown else {}
    options.output.write_text(page(rows, all_turned), encoding="utf-8")
    failed = [name for name, row in rows.items() if any(entry.error is None for entry in row.values())]
    print(f"{len(rows)} of {len(all_turned)} models -> {options.output}")
    for name in failed:
        print(f"{name} does not verify", file=sys.stderr)
    return 1 if failed else 0


def measured(path: Path, *, verified: bool) -> Row:
    """Bake a file with every encoding; empty where it cannot be baked."""
    row: Row = {}
    with TemporaryDirectory() as folder:
        target = str(Path(folder) / path.name)
        for encoding in Encoding:
            options = BakeOptions(generate_normals=True, encoding=encoding)
            try:
                result = bake_file(str(path), target, options)
            except SkinbakeError:
                return {}
            if result.status != "baked":
                return {}
            row[encoding] = Measured(size(result), turned(result), mean_error(target) if verified else None)
    return row


def size(result: FileResult) -> int:
    """Return the bytes of α and β at a vertex, of the primitive with the most influences."""
    return max(counts.bytes_per_vertex for _, counts in result.primitives)


def turned(result: FileResult) -> tuple[float, float] | None:
    """Return mean and 99th percentile of the angle that the encoding turns normals by."""
    cost = result.encoding
    return None if cost is None or cost.mean is None or cost.p99 is None else (cost.mean, cost.p99)


def mean_error(target: str) -> float | None:
    """Return the mean error of accurate LBS normals, None where the file does not verify."""
    try:
        verdict = verify_file(target, VerifyOptions(methods=("lbs",)))
    except SkinbakeError:
        return None
    figures = verdict.by_truth.get(Truth.TRIANGLES, {}).get("lbs", {}).get("accurate")
    return figures.mean if figures and verdict.passed else None


def page(rows: dict[str, Row], all_turned: dict[str, Row]) -> str:
    """Return the page as Markdown."""
    parts = [HEAD, "\n".join(table(rows)) + "\n"]
    if len(all_turned) > len(rows):
        parts.append("\n".join(largest(all_turned)) + "\n")
    parts.append(
        f"---\nMade by `python -m benchmarks.encoding_table` with skinbake {__version__}, Python "
        f"{platform.python_version()}.\n"
    )
    return "\n".join(parts)


def table(rows: dict[str, Row]) -> Iterator[str]:
    """Yield the lines of the table."""
    head = ["model", "float32 bytes", "error"]
    for encoding in SCALED:
        head += [f"{encoding} bytes", "turned mean / p99", "added"]
    yield f"| {' | '.join(head)} |"
    yield "|---" + "|--:" * (len(head) - 1) + "|"
    for name, row in rows.items():
        plain = row[Encoding.FLOAT32]
        cells = [name, str(plain.size), degrees(plain.error, 2)]
        for encoding in SCALED:
            entry = row[encoding]
            more = None if entry.error is None or plain.error is None else entry.error - plain.error
            cells += [str(entry.size), pair(entry.turned), degrees(more, 4, sign=True)]
        yield f"| {' | '.join(cells)} |"


def largest(rows: dict[str, Row]) -> Iterator[str]:
    """Yield what the worst of all models are, by encoding, and which are not measured."""
    still = [name for name, row in rows.items() if any(row[encoding].turned is None for encoding in SCALED)]
    if still:
        yield (
            f"Of the corpus, {counted(len(rows), 'model')} can be baked. `bake` measures no angle on "
            f"{', '.join(still)}: no triangle of it has an area, or no joint of it can be posed."
        )
        yield ""
    yield f"The largest angles by which normals turn, over {counted(len(rows) - len(still), 'model')}:"
    yield ""
    for encoding in SCALED:
        worst, name = max((turned, name) for name, row in rows.items() if (turned := row[encoding].turned))
        yield f"- {encoding}: {pair(worst)} ({name})"


def pair(values: Sequence[float] | None) -> str:
    """Return mean and 99th percentile in degrees."""
    return "—" if values is None else f"{values[0]:.4f}° / {values[1]:.4f}°"


def degrees(value: float | None, digits: int, *, sign: bool = False) -> str:
    """Return an angle, with its sign where it may have either."""
    if value is None:
        return "—"
    rounded = round(value, digits) + 0.0  # no −0
    return f"{rounded:+.{digits}f}°" if sign and rounded else f"{rounded:.{digits}f}°"


if __name__ == "__main__":
    sys.exit(main())
