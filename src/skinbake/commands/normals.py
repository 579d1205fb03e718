"""The normals of a baked file in one pose, of every lighting and by both truths: what a port is held to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.choices import USUAL_TRUTHS, Baseline, Method
from skinbake.commands.shown import baked_in_memory, telling_pose
from skinbake.errors import InputError
from skinbake.files.bounds import BESIDE, Bounds
from skinbake.files.writing import write_file
from skinbake.freshness.baked_views import sound_views
from skinbake.freshness.corrective_freshness import PlayedCorrectives
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.reading.clips import RANDOM, Clip
from skinbake.gltf.writing.output import refuse_own_input
from skinbake.measure.angles import INSIDE_OUT, METHODS
from skinbake.measure.draws import Corrections, Draw
from skinbake.measure.scene import Scene, claim_draws
from skinbake.report.normals import PosedNormals, line
from skinbake.skinning.blended import BlendedSkinning
from skinbake.skinning.components import Vector
from skinbake.skinning.rest import Algorithm, Options, RestPrimitive
from skinbake.skinning.run import Skinning
from skinbake.threads import Threads, thread_count
from skinbake.truth.blending import sides_of


@dataclass(frozen=True, slots=True)
class NormalsRequest:
    """The asked pose and skinning. The clip is a name or a number, the time in seconds.

    None for either: the pose in which the bake shows most.
    """

    clip: str | None = None
    time: float | None = None
    methods: Sequence[Method] = (Method.LBS,)
    cap: float | None = None
    baseline: Baseline = Baseline.BLENDED


def posed_normals(document: Document, request: NormalsRequest) -> Iterator[PosedNormals]:
    """Yield the normals of each baked primitive as each skin of the shown scene draws it, by each method.

    A document with correctives is baked in memory too: so it has accurate lighting beside them.
    Raises InputError if nothing is baked soundly, or if the file cannot be posed, or is too much work. Raises
    ChoiceError for a clip that does not exist, or a time outside it.
    """
    views = sound_views(document)
    correctives = None if views else PlayedCorrectives.sound(document)
    if correctives:
        document = baked_in_memory(document)
        views = sound_views(document)
    if not views:
        message = "no α and β in it are sound, so it has no accurate normals: run skinbake bake"
        raise InputError(f"{message}, which says what it skips and why", document.place)
    if Method.BLEND in request.methods and all(view.blend is None for view in views):
        message = "no primitive of it has blend weights that a bake has read: run skinbake bake --blend"
        raise InputError(message, document.place)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what has no normal gets NaN
        scene = Scene(document, views, correctives)
        clip, moment, _ = telling_pose(scene, request.clip, request.time)
        draws = scene.shown()
        claim_draws(document, draws, [clip], len(request.methods))
    for draw in draws:
        for method in request.methods:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                posed = draw.at(clip, np.array([moment]), turned=False)
                found = _of_draw(posed, clip, moment, method, Options(request.cap, request.baseline))
            yield from found


def normals_of_file(source: str, request: NormalsRequest, bounds: Bounds = BESIDE) -> list[PosedNormals]:
    """Return the normals of a file. Raises SkinbakeError as ``posed_normals``, or if it cannot be read."""
    return list(posed_normals(read_document(source, bounds), request))


def write_normals(
    source: str, target: str, request: NormalsRequest, *, sync: bool = True, bounds: Bounds = BESIDE
) -> str:
    """Write the normals of a file as JSON lines, whole or not at all. Return the pose in words.

    Raises SkinbakeError as ``normals_of_file``, or if the target cannot be written.
    """
    document = read_document(source, bounds)
    refuse_own_input(document, source, target)
    lines, pose = [], ""
    for one in posed_normals(document, request):
        what = f"the text of {one.numbers:,} numbers"
        document.budget.claim(Cost.WRITTEN_NUMBER * one.numbers, what, document.place)
        lines.append(line(source, one))
        pose = one.pose
    write_file(lines, target, sync=sync)
    return pose


def _of_draw(draw: Draw, clip: Clip, moment: float, method: Method, options: Options) -> list[PosedNormals]:
    """Return the normals of the primitives of a draw, which is posed at one moment of a clip."""
    rest: Sequence[RestPrimitive] = draw.surface.rest
    truths, morphing, own_weights = draw.truths(), draw.morphing, draw.poses.morph_weights
    if morphing is not None:
        rest, truths = morphing.posed(rest, truths, 0)
    skinned: Sequence[Skinning | BlendedSkinning] = (
        BlendedSkinning.of_mesh(rest, draw.matrices, options)
        if method is Method.BLEND
        else Skinning.of_mesh(rest, draw.matrices, options, dual_quaternions=method is Method.DQS)
    )
    algorithms = {name: one for name, one in METHODS[method].items() if name != "direct"}
    # The positions, and the normals of each lighting, outside where joints mirror.
    count = len(truths.operator.positions)
    deformed = np.empty((3, count, 1))
    names = [*algorithms, *(["corrected"] if draw.corrections and method is Method.LBS else [])]
    normals = {name: np.empty((count, 3)) for name in names}
    sides = sides_of(rest, draw.matrices)
    for block in truths.vertex_blocks:
        found = skinned[block.primitive].run(tuple(algorithms.values()), slice(0, 1), block.rows)
        deformed[:, block.part, 0] = _rows(found[0].position).T
        for name, one in zip(algorithms, found, strict=True):
            normals[name][block.part] = _rows(one.normal)
            if sides is not None and name in INSIDE_OUT:
                normals[name][block.part] *= sides[0, block.part, None]
    # Correctives change the normals that standard lighting skins.
    played = draw.corrections or Corrections([], [np.zeros((1, 0))] * len(rest))
    if "corrected" in normals:
        for own, part, targets, weights in zip(
            rest, truths.operator.slices, played.targets, played.weights, strict=True
        ):
            summed = own.summed_normals(slice(None)) + np.einsum("k,kvi->vi", weights[0], targets)
            changed = replace(own, normals=summed)
            lit = Skinning.of(changed, draw.matrices, dual_quaternions=False, options=options)
            (vertex,) = lit.run((Algorithm.LBS_STANDARD,), slice(0, 1), slice(0, len(own.positions)))
            normals["corrected"][part] = _rows(vertex.normal)
    for name, vectors in normals.items():
        lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
        normals[name] = np.where(lengths > 0.0, vectors / lengths, np.nan)
    # The true normals of these positions.
    by_truth = {str(name): np.full((count, 3), np.nan) for name in USUAL_TRUTHS}
    with Threads(thread_count()) as threads:
        sums = truths.sums(deformed, threads)
    for block in truths.vertex_blocks:
        side = None if sides is None else sides[:, block.part]
        expected, exist = truths.normals(block.number, deformed, sums, side)
        for vectors, own, valid in zip(by_truth.values(), expected, exist, strict=True):
            vectors[block.part] = np.where(valid, own[..., 0].T, np.nan)
    correctives, views = draw.surface.correctives, draw.surface.views
    return [
        PosedNormals(
            mesh=view.source.mesh,
            primitive=view.source.primitive,
            skin=draw.skin,
            node=draw.node
            if correctives is None or draw.node is not None
            else correctives.node(view.source.mesh, draw.skin),
            clip=None if clip.number == RANDOM else clip.name,
            time=moment,
            method=method,
            positions=deformed[:, part, 0].T,
            normals={name: vectors[part] for name, vectors in normals.items()},
            truths={name: vectors[part] for name, vectors in by_truth.items()},
            joint_matrices=draw.matrices[0],
            # Correctives are the last targets of a file.
            morph_weights=np.append([] if own_weights is None else own_weights[0], weights[0]),
        )
        for view, part, weights in zip(views, truths.operator.slices, played.weights, strict=True)
    ]


def _rows(vector: Vector) -> Float64Array:
    """Return the vectors (B, 3) of the only pose of a block."""
    return np.stack([np.asarray(axis, dtype=np.float64)[0] for axis in vector], axis=-1)
