"""Bake real models, verify them, and write what α and β are worth on each into docs/lighting.md.

``python -m benchmarks.corpus_table [FOLDER] [--output FILE]``: every .glb, .gltf and .vrm file below the
folder; without one, the models of the corpus that the tests use (SKINBAKE_CORPUS, or ../shared/corpus). Files
that cannot be baked, or that no true normal can be measured on, are listed with the reason. Exits with 1
where a model does not verify.
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.analytic_truth import END, START
from skinbake import __version__
from skinbake.choices import Baseline, PoseKind
from skinbake.commands.bake import Baker
from skinbake.errors import SkinbakeError
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.verify import Verify
from skinbake.jobs.work import Job
from skinbake.lighting.poses import PoseRequest
from skinbake.lighting.verify_options import VerifyOptions
from skinbake.report.verify import ErrorFigures, FileVerdict, gain
from tests.support.corpus_folder import find_corpus

REPOSITORY = Path(__file__).resolve().parents[1]
DEFAULT_OUTPUT = REPOSITORY / "docs" / "lighting.md"
SUFFIXES = {".glb", ".gltf", ".vrm"}
CORPUS_FOLDERS = ("public", "derived")
PACKAGES = ("numpy", "scipy")

HEAD = """# The gain of accurate lighting

The figures are angles in degrees between the normals that a shader computes and the true normals of the
deformed surface. Every model is baked and checked by `skinbake verify` (structure, freshness, algorithm 3 =
algorithm 2). It is measured over its own animations. If it has none, its joints turn at random by up to 30°.
α and β are fitted to the rig (`--gradients rig`, the default). [fitted.md](fitted.md) has the figures of the
paper's gradients beside them, also in poses of other kinds.

## True normals
A smooth surface has one normal at each point. A mesh has flat triangles, and the normal at a vertex is a
convention about them. The authored normals of the rest pose are such a convention. Animation files store no
normals for the other poses. So verify finds true normals itself, in two ways that have little in common. Both
look only at the places of the vertices before and after skinning, never at α and β. (The fit of α and β aims
between both, for small turns, and at no pose of the tables.) At rest both give the authored normal itself.

- **By tangents.** Two tangents are measured at each vertex, at rest and in the pose. A tangent is the change
  of the position along the triangles around the vertex, averaged with Max's weights (1999). The map from the
  tangents at rest to the tangents in the pose moves the authored normal.
- **By triangles.** The normal at a vertex is the mean of its triangles' normals, each weighted by the
  triangle's angle there (Thürmer and Wüthrich 1998). Modelling tools shade with it. It is computed at rest
  and in the pose. In the pose, the authored normal leans from it as at rest: by as much, and to the same side
  of the mesh. A vertex has none if each of its triangles is there twice, once for each side.

No option of bake changes these ways: the weighting of triangles, the crease angle (15°) and the tangents are
verify's own. All meshes that the same skins draw are one surface, with or without `--weld`, unless they have
morph targets. Only options that change the drawn surface change the truths. `--limit-influences` moves
vertices. `--generate-normals` makes other normals under another `--weld`. Slots of integer weights that adopt
a joint take one unit each from the largest weight, which hardly moves the standard error. Errors are weighted
by the area around each vertex in the rest pose, in the scene's unit. So a quantised mesh counts as much as
its float twin.

Each truth has an error of its own. It cannot be seen on a real model, but on a surface that has a formula.
The table shows a tube of three joints, bent in eight steps. Its figures are mean angles in degrees: standard
and accurate lighting (algorithms 1 and 3) against the formula; accurate lighting against each truth, as
verify measures it; and each truth against the formula. Where weights are smooth, accurate lighting is nearer
to the formula than either truth. There verify reports about twice its real error by tangents, and about
three times by triangles.

Where weights change within an edge (steep), or have kinks, the mesh is too coarse to follow the formula. All
three share a part of that error, and verify does not see this part. By tangents it reports less than the real
error: on the kinked tubes under a half of it from 768 vertices on, and an eighth at 12,028. By triangles it
reports less than the real error on the kinked tubes, and more on the steep ones. A difference says nothing if
it is smaller than the distance between the two truths.

The table is of bake's default, `--gradients rig`. `python -m benchmarks.analytic_truth --gradients surface`
prints the same table for the gradients of the surface.

{analytic}

## Reading the tables
Each figure is over all vertices and poses, weighted by the area around a vertex at rest. So a finely divided
hand counts no more than a coarse back of the same size. *Mean* is the average. 95 % of the area stays below
*p95*. *Gain* is the standard mean divided by the accurate one (blank if the error is rounding). *Standard* is
the lighting of today's engines (algorithm 1; 4 for dual quaternions). *Accurate* uses α and β (algorithm 3;
5). *Exact* is algorithm 6. Figures are by tangents if nothing else is said.

The gain is large if joints bend a smooth, finely divided surface. It is small if little bends. It is small if
every vertex has one joint, because then standard lighting is wrong at the border triangles only. And it is
small if the mesh is coarse or full of hard edges: the true normals are measured on its triangles too, and a
dozen triangles show them to some ten degrees only. A gain below 1 says that by this measure accurate lighting
is no better on that model. Standard lighting is the blended matrix here, as in three.js. *Over i. t.* is the
gain over the inverse transpose, as in Bevy. If joints are scaled unevenly, the inverse transpose alone may
bring all the gain.
"""


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
    parser.add_argument("--output", type=Path, default=DEFAULT_OUTPUT, help="the file to write")
    parser.add_argument("--samples", type=int, help="poses of each clip (default: 60 shared by all)")
    options = parser.parse_args()
    folders = [options.folder] if options.folder else corpus_folders()
    if not folders:
        print("no models: name a folder, or set SKINBAKE_CORPUS", file=sys.stderr)
        return 3
    found = sorted(
        {path for folder in folders for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES}
    )
    models, left_out = measure(found, options.samples)
    text = page(models, left_out, options.samples, analytic_part(options.output))
    options.output.write_text(text, encoding="utf-8")
    failed = [model.name for model in models if not model.verdict.passed]
    print(f"{len(models)} models, {len(left_out)} left out -> {options.output}")
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
    return FileWork(Verify(options))(Job(target))


def measure(paths: list[Path], samples: int | None) -> tuple[list[Model], list[tuple[str, str]]]:
    """Bake and verify every file; return the models, and (name, reason) of what was left out."""
    models, left_out = [], []
    request = PoseRequest(PoseKind.ANIMATION, samples)
    names = dict(zip(paths, told_apart(paths), strict=True))
    for path in paths:
        print(f"{names[path]} ...", file=sys.stderr)
        with TemporaryDirectory() as folder:
            target = str(Path(folder) / path.name)
            try:
                result = Baker(generate_normals=True).bake_file(str(path), target)
            except SkinbakeError as error:
                left_out.append((names[path], error.message))
                continue
            if result.status != "baked":
                left_out.append((names[path], result.notices[-1].message))
                continue
            verdict = verified(target, VerifyOptions(poses=request))
            other = verified(target, VerifyOptions(("lbs",), request, baseline=Baseline.INVERSE_TRANSPOSE))
        if verdict.passed and not verdict.normals:
            left_out.append((names[path], verdict.checks[-1].remark))
        else:
            vertices = sum(counts.vertices for _, counts in result.primitives)
            models.append(Model(names[path], vertices, verdict, gain((other.normals or {}).get("lbs", {}))))
    return models, left_out


def told_apart(paths: list[Path]) -> list[str]:
    """Return the files' names, with the folder in front where two have the same."""
    names = [path.name for path in paths]
    return [f"{path.parent.name}/{path.name}" if names.count(path.name) > 1 else path.name for path in paths]


def analytic_part(path: Path) -> str:
    """Return the part of a page that ``analytic_truth`` writes, empty where the page has none."""
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    inside = text.split(START)[1].split(END)[0] if START in text and END in text else "\n"
    return f"{START}{inside}{END}"


def page(models: list[Model], left_out: list[tuple[str, str]], samples: int | None, analytic: str) -> str:
    """Return the page as Markdown."""
    animated = [model for model in models if " clip" in model.verdict.poses]
    others = [model for model in models if model not in animated]
    notes: dict[str, int] = {}
    parts = [HEAD.replace("{analytic}", analytic)]
    for title, chosen in (
        ("Models in their own animations", animated),
        ("Models without animation: random poses", others),
    ):
        if chosen:
            parts.append("\n".join([f"## {title}", *table(chosen, notes)]) + "\n")
    if notes:
        lines = [f"{number}. {reason}." for reason, number in notes.items()]
        head = "—: dual quaternions carry no scale, and some joints do:\n"
        parts.append("\n".join([head, *lines]) + "\n")
    if left_out:
        lines = [f"- {name}: {reason}" for name, reason in left_out]
        parts.append("\n".join(["## Left out", *lines]) + "\n")
    parts.append(made(samples))
    return "\n".join(parts)


def table(models: Iterable[Model], notes: dict[str, int]) -> Iterator[str]:
    """Yield the lines of a table; what kept dual quaternions out is added to ``notes``, numbered."""
    yield ""
    yield (
        "| model | vertices | poses | LBS standard mean / p95 | accurate mean / p95 | gain | over i. t. "
        "| by triangles: standard mean | accurate mean / p95 | gain | DQS standard mean | accurate | exact |"
    )
    yield "|---|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
    for model in models:
        yield f"| {' | '.join(row(model, notes))} |"


def row(model: Model, notes: dict[str, int]) -> Iterator[str]:
    """Yield the cells of one model."""
    verdict = model.verdict
    normals = verdict.normals or {}
    lbs, dqs = normals.get("lbs", {}), normals.get("dqs", {})
    by_triangles = (verdict.by_triangles or {}).get("lbs", {})
    yield model.name + ("" if verdict.passed else " (**does not verify**)")
    yield f"{model.vertices:,}"
    yield verdict.poses.split(" (")[0].split(", ")[0]
    yield pair(lbs.get("approximated"))
    yield pair(lbs.get("accurate"))
    yield from map(times, (gain(lbs), model.other_gain))
    yield f"{by_triangles['approximated'].mean:.2f}°" if by_triangles else ""
    yield pair(by_triangles.get("accurate"))
    yield times(gain(by_triangles))
    if dqs:
        yield from (f"{dqs[name].mean:.2f}°" for name in ("approximated", "accurate", "exact"))
    else:
        number = notes.setdefault(verdict.without_dqs or "not measured", len(notes) + 1)
        yield from (f"— ({number})", "—", "—")


def times(factor: float | None) -> str:
    """Return a gain."""
    return "" if factor is None else f"{factor:.1f} ×"


def pair(figures: ErrorFigures | None) -> str:
    """Return mean and 95th percentile in degrees."""
    return "" if figures is None else f"{figures.mean:.2f}° / {figures.p95:.2f}°"


def made(samples: int | None) -> str:
    """Return how the page was made."""
    option = "" if samples is None else f" --samples {samples}"
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    each = (
        "60 poses shared by a file's clips, at least 3 each" if samples is None else f"{samples} poses a clip"
    )
    return (
        f"---\nMade by `python -m benchmarks.corpus_table{option}`, and its table of the tube by `python -m "
        f"benchmarks.analytic_truth`, with skinbake {__version__}, Python "
        f"{platform.python_version()}, {versions}: default bake with `--generate-normals`, {each}, 24 random "
        "poses of a file without animation.\n"
    )


if __name__ == "__main__":
    sys.exit(main())
