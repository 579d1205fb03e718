"""Bake real models, verify them, and write what α and β are worth on each into docs/lighting.md.

``python -m benchmarks.corpus_table [FOLDER] [--output FILE]``: every .glb, .gltf and .vrm file below the
folder; without one, the public part of the corpus (SKINBAKE_CORPUS, or ../shared/corpus). The page's part
between two marks is written anew. Test files of few vertices, models that do not bend, and the second file of
one geometry are left out. So are files that cannot be baked, or that no true normal can be measured on: the
reason is printed. Exits with 1 where a model does not verify.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.marked import write_between
from skinbake.choices import USUAL_TRUTHS, Baseline, Truth
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import SkinbakeError
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.verify import Verify
from skinbake.jobs.work import Job
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import ErrorFigures, FileVerdict, gain
from tests.support.corpus_folder import find_corpus

REPOSITORY = Path(__file__).resolve().parents[1]
DEFAULT_OUTPUT = REPOSITORY / "docs" / "lighting.md"
SUFFIXES = {".glb", ".gltf", ".vrm"}
CORPUS_FOLDERS = ("public", "derived")

START, END = "<!-- models: begin -->", "<!-- models: end -->"
FEWEST = 20
"""A model with fewer vertices is a test of a file format. It has no surface on which a normal is known."""


@dataclass(frozen=True)
class Model:
    """One model: what it is called, what bake and verify found, the gain over the inverse transpose."""

    name: str
    vertices: int
    verdict: FileVerdict
    other_gain: float | None


def main() -> int:
    """Write the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, nargs="?", help="where the models lie (default: the corpus)")
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the page to write into")
    options = parser.parse_args()
    folder = options.folder or next(iter(corpus_folders()), None)
    if folder is None:
        print("no models: name a folder, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    models = list(measured(sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)))
    write_between(options.output, START, END, "\n".join(table(models)))
    failed = [model.name for model in models if not model.verdict.passed]
    print(f"{len(models)} models -> {options.output}")
    for name in failed:
        print(f"{name} does not verify", file=sys.stderr)
    return 1 if failed else 0


def corpus_folders() -> list[Path]:
    """Return the corpus's folders of valid models, none where it is not here."""
    corpus = find_corpus()
    if corpus is None:
        return []
    return [corpus / name for name in CORPUS_FOLDERS if (corpus / name).is_dir()]


def verified(target: str, options: VerifyOptions) -> FileVerdict:
    """Return the verdict on a file, with an error where it cannot be verified."""
    return FileWork((Verify(options),))(Job(target))


def measured(paths: list[Path]) -> Iterator[Model]:
    """Yield what bake and verify find on every file that bends, each geometry once."""
    seen = set()
    for path, name in zip(paths, told_apart(paths), strict=True):
        print(f"{name} ...", file=sys.stderr, flush=True)
        with TemporaryDirectory() as folder:
            target = str(Path(folder) / path.name)
            try:
                result = bake_file(str(path), target, BakeOptions(generate_normals=True))
            except SkinbakeError as error:
                print(f"  left out: {error.message}", file=sys.stderr)
                continue
            if result.status != "baked":
                print(f"  left out: {result.notices[-1].message}", file=sys.stderr)
                continue
            verdict = verified(target, VerifyOptions(("lbs",)))
            other = verified(target, VerifyOptions(("lbs",), baseline=Baseline.INVERSE_TRANSPOSE))
        vertices = sum(counts.vertices for _, counts in result.primitives)
        lbs = verdict.by_truth.get(Truth.TRIANGLES, {}).get("lbs", {})
        if verdict.passed and (vertices < FEWEST or gain(lbs) is None):
            continue
        key = vertices, round(lbs["standard"].mean, 2) if lbs else None
        if key not in seen:
            seen.add(key)
            yield Model(name, vertices, verdict, gain(other.by_truth.get(Truth.TRIANGLES, {}).get("lbs", {})))


def told_apart(paths: list[Path]) -> list[str]:
    """Return the files' names, with the folder in front where two have the same."""
    names = [path.name for path in paths]
    return [f"{path.parent.name}/{path.name}" if names.count(path.name) > 1 else path.name for path in paths]


def table(models: Iterable[Model]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield (
        "| model | vertices | by triangles: standard | accurate | gain | over i. t. "
        "| by tangents: standard | accurate | gain |"
    )
    yield "|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    for model in models:
        yield f"| {' | '.join(row(model))} |"


def row(model: Model) -> Iterator[str]:
    """Yield the cells of one model."""
    first, second = (model.verdict.by_truth.get(truth, {}).get("lbs", {}) for truth in USUAL_TRUTHS)
    yield (
        model.name
        + ("" if " clip" in model.verdict.poses else " (random)")
        + ("" if model.verdict.passed else " (**does not verify**)")
    )
    yield f"{model.vertices:,}"
    yield from means(first)
    yield times(model.other_gain)
    yield from means(second)


def means(figures: dict[str, ErrorFigures]) -> Iterator[str]:
    """Yield the mean errors in degrees, and the gain."""
    for name in ("standard", "accurate"):
        yield f"{figures[name].mean:.2f}" if name in figures else "—"
    yield times(gain(figures))


def times(factor: float | None) -> str:
    """Return a gain."""
    return "—" if factor is None else f"{factor:.1f}"


if __name__ == "__main__":
    sys.exit(main())
