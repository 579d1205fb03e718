"""Measure how well a frame follows morph targets: the tables of docs/morphs.md, between marks.

``python -m benchmarks.morph_frames [--output FILE]``. The first table is of an analytic surface whose
differential is known; the second of characters of the corpus (SKINBAKE_CORPUS, or ../shared/corpus), which
get a smooth target, a wave or a bend, for want of real ones; the third of a real face whose targets have no
NORMAL.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.marked import write_between
from skinbake.choices import Truth
from skinbake.commands.bake import bake_file
from skinbake.commands.bake_options import BakeOptions
from skinbake.commands.verify import verify_file
from skinbake.geometry.frames import frame_from_normal, unit_vectors
from skinbake.geometry.morphs import Differences, MorphTargets
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import read_document
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.meshes import read_primitive, skinned_sources
from skinbake.gltf.writing.additions import Additions
from skinbake.gltf.writing.output import plan_output
from skinbake.measure.options import VerifyOptions
from skinbake.report.verify import FileVerdict
from skinbake.skinning.morphs import morphed
from skinbake.skinning.rest import Algorithm, RestPrimitive
from tests.support import analytic, morphing
from tests.support.replay import replay

REPOSITORY = Path(__file__).resolve().parents[1]
BENDS = ("medium", "strong")
CHARACTERS = (
    "CesiumMan/CesiumMan.glb",
    "Mannequiny/mannequiny-0.3.0.glb",
    "Alien/Alien_Scolitex.gltf",
    "TRex/trex.gltf",
    "RiggedElf/RiggedElf.gltf",
)

SURFACE = "<!-- surface: begin -->", "<!-- surface: end -->"
MODELS = "<!-- characters: begin -->", "<!-- characters: end -->"
FACE = "<!-- face: begin -->", "<!-- face: end -->"
KEY_WEIGHTS = np.array([[0.0], [1.0], [0.0]], np.float32)


def main() -> int:
    """Write the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=REPOSITORY / "docs" / "morphs.md")
    options = parser.parse_args()
    for (start, end), lines in (
        (SURFACE, surface_table()),
        (MODELS, character_table()),
        (FACE, face_table()),
    ):
        write_between(options.output, start, end, "\n".join(lines))
    return 0


# The analytic surface


def surface_table() -> Iterator[str]:
    """Yield a row for each target, at its whole weight."""
    yield "| target | turn | standard | by normal | by tangent | four | six |"
    yield "|---|--:|--:|--:|--:|--:|--:|"
    u, v = analytic.grid(60, 40, jitter=0.3, seed=3)
    points = analytic.sample(u, v)
    for name, displacement in morphing.DISPLACEMENTS.items():
        found = figures(points, displacement)
        yield f"| {name} | " + " | ".join(f"{value:.2f}" for value in found) + " |"


def figures(points: analytic.Sample, displacement: morphing.Displacement) -> list[float]:
    """Return the means that a row shows."""
    area = np.linalg.norm(np.cross(*analytic.derivatives(points.u, points.v)), axis=1)

    def mean(first: Any, second: Any) -> float:
        return float(np.average(analytic.degrees_between(first, second), weights=area))

    weight = np.ones(1)
    shape = morphing.morphed_surface(displacement, 1.0)
    by_normal = morphed(surface(points), morphing.target(points, displacement), weight)
    target = morphing.target(points, displacement, tangents=True)
    by_tangent = morphed(surface(points, tangents=True), target, weight)
    moved = [
        morphed(surface(points), with_numbers(points, displacement, numbers), weight) for numbers in (4, 6)
    ]
    image = exact(points, shape, by_normal)
    rows = []
    for bend in BENDS:
        expected = true_image(image, by_normal.normals, bend)
        rows.append(
            [
                mean(posed(by_normal, Algorithm.LBS_STANDARD, bend), expected),
                *(
                    mean(posed(one, Algorithm.LBS_ACCURATE, bend), expected)
                    for one in (by_normal, by_tangent, *moved)
                ),
            ]
        )
    return [mean(by_normal.normals, points.normals), *np.mean(rows, axis=0).tolist()]


def with_numbers(points: analytic.Sample, displacement: morphing.Displacement, numbers: int) -> MorphTargets:
    """Return the target with numbers of its differential along the normal frame of the surface."""
    rest, found = surface(points), morphing.target(points, displacement)
    vectors = [np.asarray(v, dtype=np.float64) for v in (rest.tangents, rest.bitangents)]
    images = morphing.images(points, morphing.morphed_surface(displacement, 1.0), *vectors)
    basis = np.stack([*vectors, points.normals], axis=2)
    t, b = (
        np.linalg.solve(basis, (image - vector)[:, :, None])[:, :, 0]
        for image, vector in zip(images, vectors, strict=True)
    )
    in_plane = Differences.of(np.concatenate([t[:, :2], b[:, :2]], axis=1))
    upward = Differences.of(np.stack([t[:, 2], b[:, 2]], axis=1))
    return MorphTargets((found.targets[0]._replace(in_plane=in_plane, upward=upward),), numbers=numbers)


def surface(points: analytic.Sample, *, tangents: bool = False) -> RestPrimitive:
    """Return the tube at rest, in the normal frame or in that of its own tangents."""
    t0, b0 = points.tangents, points.bitangents
    if not tangents:
        t0, b0 = (v.astype(np.float64) for v in frame_from_normal(points.normals.astype(np.float32)))
    return RestPrimitive(
        positions=points.positions,
        normals=points.normals,
        tangents=t0,
        bitangents=b0,
        joints=np.tile(np.arange(3), (len(points.u), 1)),
        weights=points.weights,
        alpha=np.einsum("vki,vi->vk", points.gradients, t0)[:, 1:],
        beta=np.einsum("vki,vi->vk", points.gradients, b0)[:, 1:],
    )


def posed(rest: RestPrimitive, algorithm: Algorithm, bend: str) -> Float64Array:
    """Return the skinned normals (V, 3)."""
    matrices = analytic.joint_matrices(bend)[None]
    return np.asarray(replay(algorithm, rest, matrices).normals[0], dtype=np.float64)


def exact(points: analytic.Sample, shape: analytic.Surface, moved: RestPrimitive) -> RestPrimitive:
    """Return the morphed surface with the images of t0 and b0."""
    rest = surface(points)
    frame = [np.asarray(vectors, dtype=np.float64) for vectors in (rest.tangents, rest.bitangents)]
    t, b = morphing.images(points, shape, *frame)
    return replace(moved, tangents=t, bitangents=b)


def true_image(image: RestPrimitive, normals: Any, bend: str) -> Float64Array:
    """Return cof(F) n, F from the exact frames before and after: what skinbake verify measures on a mesh."""
    skinned = replay(Algorithm.LBS_ACCURATE, image, analytic.joint_matrices(bend)[None])
    before = columns(image.tangents, image.bitangents, None)
    after = columns(skinned.tangents[0], skinned.bitangents[0], (image.tangents, image.bitangents))
    f = after @ np.linalg.inv(before)
    cofactors = np.linalg.det(f)[:, None, None] * np.swapaxes(np.linalg.inv(f), 1, 2)
    return np.asarray(np.einsum("vij,vj->vi", cofactors, normals))


def columns(a: Any, b: Any, before: tuple[Any, Any] | None) -> Float64Array:
    """Return [a b ĉ s] as matrices (V, 3, 3), c = a × b, s = sqrt(|c| / |c before|)."""
    c = np.cross(a, b)
    area = np.linalg.norm(c, axis=1, keepdims=True)
    rest = area if before is None else np.linalg.norm(np.cross(*before), axis=1, keepdims=True)
    return np.stack([a, b, c / area * np.sqrt(area / rest)], axis=2)


# Characters


def character_table() -> Iterator[str]:
    """Yield a row for each model, or a remark where the corpus is not here."""
    told = os.environ.get("SKINBAKE_CORPUS")
    corpus = Path(told) if told else REPOSITORY.parent / "shared" / "corpus"
    found = [corpus / "public" / name for name in CHARACTERS if (corpus / "public" / name).is_file()]
    if not found:
        yield "(The corpus was not there.)"
        return
    yield "| model | target | standard | accurate | gain |"
    yield "|---|---|--:|--:|--:|"
    for path in found:
        with TemporaryDirectory() as folder:
            target = Path(folder) / "baked" / f"{path.stem}.glb"
            bake_file(str(path), str(target), BakeOptions(generate_normals=True))
            yield f"| {path.name} | none | {verdict_row(target)} |"
            for name, warp in (("wave", wave), ("bend", bend)):
                moved = Path(folder) / f"{name}.glb"
                with_target(target, moved, warp)
                yield f"| | {name} | {verdict_row(moved)} |"


def face_table() -> Iterator[str]:
    """Yield a row for each bake of a face whose targets have no NORMAL, in its clip and in random poses."""
    told = os.environ.get("SKINBAKE_CORPUS")
    path = (Path(told) if told else REPOSITORY.parent / "shared" / "corpus") / "cases" / "face_rig_run.glb"
    if not path.is_file():
        yield "(The corpus was not there.)"
        return
    yield "| | bytes | standard, in its clip | accurate | standard, in random poses | accurate |"
    yield "|---|--:|--:|--:|--:|--:|"
    with TemporaryDirectory() as folder:
        for name, options in FACES.items():
            target = Path(folder) / "baked.glb"
            bake_file(str(path), str(target), BakeOptions(**options))
            rows = [verdict_row(target, poses).rsplit(" | ", 1)[0] for poses in ("animation", "random")]
            size = target.stat().st_size - path.stat().st_size
            yield f"| {name} | {size:,} | {' | '.join(rows)} |"


FACES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "`--morph-normals`": {"morph_normals": True},
    "`--morph-normals --morph-frames`: four": {"morph_normals": True, "morph_frames": True},
    "`--morph-frames`: six": {"morph_frames": True},
}


def verdict_row(path: Path, poses: str = "animation") -> str:
    """Return the cells of one verdict."""
    verdict: FileVerdict = verify_file(str(path), VerifyOptions.of(methods=("lbs",), poses=poses))
    lbs = verdict.by_truth[Truth.TRIANGLES]["lbs"]
    standard, accurate = lbs["standard"], lbs["accurate"]
    return f"{standard.mean:.2f} | {accurate.mean:.2f} | {standard.mean / accurate.mean:.1f}"


Warp = Callable[[Float64Array, Float64Array], Float64Array]
"""The displacement of points (V, 3), in a box (2, 3) of the model's lowest and highest coordinates."""


def wave(points: Float64Array, box: Float64Array) -> Float64Array:
    """Raise bumps of 1 % of the model's size."""
    size = float(np.ptp(box, axis=0).max())
    phase = (points - box.mean(axis=0)) @ np.array([17.0, 23.0, 13.0]) / size
    return 0.01 * size * np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase)], axis=1)


def bend(points: Float64Array, box: Float64Array) -> Float64Array:
    """Bend by 60° over the model's greatest extent."""
    up = int(np.ptp(box, axis=0).argmax())
    across, arm = (up + 1) % 3, points - box.mean(axis=0)
    angle = np.radians(60) * arm[:, up] / float(np.ptp(box[:, up]))
    turned = arm.copy()
    turned[:, up] = np.cos(angle) * arm[:, up] - np.sin(angle) * arm[:, across]
    turned[:, across] = np.sin(angle) * arm[:, up] + np.cos(angle) * arm[:, across]
    moved: Float64Array = turned - arm
    return moved


def differences(
    warp: Warp, box: Float64Array, positions: Float64Array, normals: Float64Array
) -> tuple[Any, Any]:
    """Return what a target holds of a warp of space: ΔPOSITION, and ΔNORMAL of the exact normals, float32."""
    step = 1e-5 * float(np.ptp(box, axis=0).max())
    slopes = [(warp(positions + step * e, box) - warp(positions - step * e, box)) for e in np.eye(3)]
    jacobian = np.stack(slopes, axis=2) / (2 * step) + np.eye(3)
    turned = unit_vectors(np.einsum("vji,vj->vi", np.linalg.inv(jacobian), normals))
    return warp(positions, box).astype(np.float32), (turned - normals).astype(np.float32)


def with_target(path: Path, target: Path, warp: Warp) -> None:
    """Write a copy whose skinned primitives have one target, and whose clips move its weight."""
    document = read_document(str(path))
    sources = skinned_sources(document)
    every = [read_primitive(document, source) for source in sources]
    everywhere = np.concatenate([primitive.positions for primitive in every]).astype(np.float64)
    box = np.stack([everywhere.min(axis=0), everywhere.max(axis=0)])
    additions, meshes = Additions(document), [dict(mesh) for mesh in document.objects("meshes")]
    for source, primitive in zip(sources, every, strict=True):
        normals = unit_vectors(primitive.normals)
        moved, turned = differences(warp, box, primitive.positions.astype(np.float64), normals)
        made = {"POSITION": additions.add(moved), "NORMAL": additions.add(turned)}
        primitives = list(meshes[source.mesh]["primitives"])
        primitives[source.primitive] = {**source.json, "targets": [made]}
        meshes[source.mesh]["primitives"] = primitives
    nodes = [n for n, node in enumerate(document.objects("nodes")) if "skin" in node and "mesh" in node]
    animations = [
        with_weights(
            animation,
            [
                read_accessor(document, s["input"], document.place).decoded()[:, 0]
                for s in animation["samplers"]
            ],
            nodes,
            additions,
        )
        for animation in document.objects("animations")
    ]
    plan_output(additions.applied({"meshes": meshes, "animations": animations}), str(target)).write()


def with_weights(animation: Any, times: list[Any], nodes: list[int], additions: Additions) -> Any:
    """Return an animation that moves the weight of nodes up and down between its first and last key."""
    first, last = min(float(each[0]) for each in times), max(float(each[-1]) for each in times)
    keys = np.linspace(first, last, len(KEY_WEIGHTS), dtype=np.float32)[:, None]
    sampler = {"input": additions.add(keys), "output": additions.add(KEY_WEIGHTS)}
    number = len(animation["samplers"])
    channels = [{"sampler": number, "target": {"node": node, "path": "weights"}} for node in nodes]
    return {
        **animation,
        "samplers": [*animation["samplers"], sampler],
        "channels": [*animation["channels"], *channels],
    }


if __name__ == "__main__":
    raise SystemExit(main())
