"""The shown scene of a document in poses of its clips: what is drawn, and how wrong its lighting is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import zip_longest
from typing import Any

import numpy as np

from skinbake.choices import Truth
from skinbake.commands.bake import bake_document
from skinbake.commands.bake_options import BakeOptions
from skinbake.errors import BudgetError, ChoiceError, InputError, Notice, Skipped, printable
from skinbake.format.strip import stripped, uncorrected
from skinbake.freshness.baked_views import BakedView, is_baked, rest_primitive, whole_surfaces
from skinbake.freshness.corrective_freshness import PlayedCorrectives, damaged_correctives
from skinbake.freshness.expected import true_operator_of
from skinbake.geometry.frames import frame_from_normal, unit_normals
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, IntArray
from skinbake.geometry.triangles import smooth_normals
from skinbake.gltf.animation import (
    Clip,
    Skeleton,
    clip_poses,
    clip_weights,
    read_clips,
    read_node,
    read_skeleton,
)
from skinbake.gltf.budget import Cost, Work
from skinbake.gltf.document import Document
from skinbake.gltf.materials import tell_images_unplaced
from skinbake.gltf.primitives import (
    PrimitiveSource,
    has_surface,
    plain_sources,
    read_primitive,
    reason_to_skip,
    skinned_sources,
    why_nothing,
)
from skinbake.gltf.scenes import faces_backward, shown_nodes
from skinbake.measure.angles import Corrections, MeasuredBlock, lighting_errors, truths_at_rest
from skinbake.measure.morphing import morphing_of
from skinbake.skinning.rest import Options, RestPrimitive
from skinbake.truth.blending import BlendedPrimitive
from skinbake.truth.morphing import Morphing
from skinbake.truth.operator import GradientOperator
from skinbake.truth.poses import (
    PoseSet,
    draws_of,
)
from skinbake.truth.truths import Truths
from skinbake.wording import counted, one_or_many

HALF_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])
"""A turn of the whole scene around the vertical."""

LISTED = 20
"""The names of clips that a message lists."""

LIGHTINGS = ("standard", "accurate", "corrected")


@dataclass(frozen=True, slots=True)
class Draw:
    """A surface as one skin draws it: its primitives; with morph targets, the node that has their weights.

    skin is its number. operator builds the operator of the truths at its first call, once for all draws of
    the surface.
    correctives gives those of the file at times of a clip; it is None if it has none.
    """

    views: Sequence[BakedView]
    rest: Sequence[RestPrimitive]
    skin: int
    skeleton: Skeleton
    node: int | None
    operator: Callable[[], GradientOperator]
    correctives: Callable[[Clip, Float64Array], Corrections] | None = None


@dataclass(frozen=True, slots=True)
class Attachment:
    """A primitive that a node of the shown scene draws without a skin: a hat, a staff."""

    source: PrimitiveSource
    rest: RestPrimitive
    triangles: IntArray
    tangents: FloatArray | None
    skeleton: Skeleton

    def positions(self, matrices: Float64Array) -> Float64Array:
        """Return its positions (V, 3) under the node's matrix (4, 4)."""
        return np.asarray(self.rest.positions @ matrices[:3, :3].T + matrices[:3, 3])


def attachments(document: Document) -> list[Attachment]:
    """Return what nodes of the shown scene draw without a skin; tell what of it cannot be read."""
    sources: dict[int | None, list[PrimitiveSource]] = {}
    for source in plain_sources(document):
        sources.setdefault(source.mesh, []).append(source)
    nodes, budget = document.asset.nodes, document.budget
    found: list[Attachment] = []
    read: dict[tuple[int, int], Any] = {}
    lost: set[int] = set()
    for number in sorted(shown_nodes(document)):
        for source in sources.get(nodes[number].mesh, ()):
            try:
                skeleton = read_node(document, number)
                work = Cost.DRAWN_PRIMITIVE + Cost.SHOWN_CLIP * len(skeleton.nodes)
                budget.claim(work, "drawing meshes without a skin", document.place)
                key = source.mesh, source.primitive
                if key not in read:
                    read[key] = _rigid(document, source)
                vertices = 0 if read[key] is None else len(read[key][0].positions)
                again = f"drawing {vertices:,} vertices once more"
                budget.claim(Cost.DRAWN_AGAIN * vertices, again, source.place)
            except BudgetError:
                raise
            except InputError:
                lost.add(source.mesh)
                continue
            if read[key] is not None:
                rest, triangles, tangents = read[key]
                found.append(Attachment(source, rest, triangles, tangents, skeleton))
    if lost:
        words = one_or_many(len(lost), "1 mesh without a skin", "{} meshes without a skin")
        message = f"{words} cannot be read: left out of the picture"
        document.notices.tell(Notice("not-skinned", message, document.place, len(lost)))
    return found


def _rigid(document: Document, source: PrimitiveSource) -> tuple[RestPrimitive, IntArray, Any] | None:
    """Return a primitive as one joint moves all of it, its triangles and TANGENT; None without a surface."""
    if not has_surface(document, source):
        return None
    mesh = read_primitive(document, source)
    count = len(mesh.positions)
    document.budget.claim(Cost.DRAWN_VERTEX * count, "a mesh without a skin", source.place)
    normals = mesh.normals
    if not len(normals):
        normals = smooth_normals(mesh.positions, mesh.triangles, np.arange(count))
    normals = unit_normals(normals)
    rest = RestPrimitive(
        np.asarray(mesh.positions, np.float64),
        normals,
        *frame_from_normal(normals),
        joints=np.zeros((count, 4), np.int64),
        weights=np.eye(4)[np.zeros(count, np.int64)],
        alpha=np.zeros((count, 3)),
        beta=np.zeros((count, 3)),
    )
    return rest, mesh.triangles, mesh.tangents


@dataclass(frozen=True, slots=True)
class PosedDraw:
    """Joint matrices (P, J, 4, 4) of a draw; morph targets that move it then, and correctives, if any.

    weights (P, N) are those of all morph targets, None without any.
    """

    matrices: Float64Array
    morphing: Morphing | None = None
    corrections: Corrections | None = None
    weights: Float64Array | None = None

    def every(self, step: int) -> PosedDraw:
        """Return every so many poses."""
        some = self.morphing and replace(self.morphing, weights=self.morphing.weights[::step])
        return PosedDraw(self.matrices[::step], some)


def shown_draws(
    document: Document, views: Sequence[BakedView], correctives: PlayedCorrectives | None = None
) -> Iterator[Draw]:
    """Yield what the nodes of the shown scene draw, with the correctives that were stripped, if any."""
    clips = read_clips(document)
    what = f"showing {counted(len(clips), 'clip')}"
    document.budget.claim(Cost.SHOWN_CLIP * len(clips), what, document.place)
    nodes = document.asset.nodes
    shown = {(nodes[number].mesh, nodes[number].skin) for number in shown_nodes(document)}
    meshes = {mesh for mesh, _ in shown}
    for group in whole_surfaces(document, [view for view in views if view.source.mesh in meshes]):
        surfaces: dict[tuple[int, ...], tuple[Draw, Sequence[Float64Array]]] = {}
        for skin, node in draws_of(document, group[0].source.mesh, clips):
            # Skins may draw meshes crosswise: each mesh by one of them here, by the other in another scene.
            parts = tuple(part for part, view in enumerate(group) if (view.source.mesh, skin) in shown)
            if not parts:
                continue
            skeleton = read_skeleton(document, skin)
            if parts not in surfaces:
                some = [group[part] for part in parts]
                rest = [rest_primitive(view) for view in some]
                operator = cache(partial(true_operator_of, document, some))
                draw = Draw(some, rest, skin, skeleton, node, operator)
                surfaces[parts] = draw, correctives.of_views(some) if correctives else ()
            draw, targets = surfaces[parts]
            drawn = skin, node
            played = partial(_played, correctives, draw.views, targets, drawn) if correctives else None
            yield replace(draw, skin=skin, skeleton=skeleton, node=node, correctives=played)


def _played(
    correctives: PlayedCorrectives,
    views: Sequence[BakedView],
    targets: Sequence[Float64Array],
    drawn: tuple[int, int | None],
    clip: Clip,
    times: Float64Array,
) -> Corrections:
    """Return the correctives of a surface at times of a clip. Random poses play none."""
    weights = [correctives.weights(one.source.mesh, *drawn, clip.number, times) for one in views]
    return Corrections(targets, weights)


def claim_draws(document: Document, draws: Sequence[Draw], clips: Sequence[Clip], poses: int) -> None:
    """Count the memory and the work of draws in so many poses. Raises InputError if it is too much."""
    for draw in draws:
        skeleton, primitives = draw.skeleton, len(draw.rest)
        vertices = sum(len(rest.positions) for rest in draw.rest)
        nodes, joints = len(skeleton.nodes), len(skeleton.joints)
        work = Cost.DRAWN_PRIMITIVE * primitives + Cost.SAMPLED_CLIP * len(clips)
        work += Work(steps=sum(len(clip.channels) for clip in clips) + poses * (nodes + joints))
        if draw.node is not None:
            targets = document.asset.meshes[draw.views[0].source.mesh].target_count
            work += (Cost.DRAWN_MORPH + Cost.DRAWN_TARGET * targets) * (primitives * poses)
            work += Cost.READ_TARGET * (targets * primitives * len(clips))
        work += (Cost.NODE_MATRIX * nodes + Cost.JOINT_MATRIX * joints) * poses
        work += (Cost.DRAWN_VERTEX + Cost.POSED_VERTEX * poses) * vertices
        drawn = f"drawing {counted(vertices, 'vertex', 'vertices')} in {counted(poses, 'pose')}"
        document.budget.claim(work, drawn, document.place)


def posed_draw(
    document: Document, draw: Draw, clip: Clip, times: Float64Array, *, turned: bool = True
) -> PosedDraw:
    """Return a draw at times of a clip. If turned, it faces along +Z."""
    # A scene of a hundred characters has a hundred times the channels of each.
    nodes = set(draw.skeleton.nodes)
    own = clip._replace(channels=tuple(channel for channel in clip.channels if channel.node in nodes))
    matrices = clip_poses(draw.skeleton, own, times)
    if turned and faces_backward(document):
        matrices = HALF_TURN @ matrices
    corrections = draw.correctives and draw.correctives(clip, times)
    if draw.node is None:
        return PosedDraw(matrices, None, corrections)
    weights = clip_weights(draw.node, clip, times, document.asset.nodes[draw.node].resting_weights())
    poses = PoseSet((), matrices, (), (), weights)
    # A search poses a draw some hundred times, mostly by the same targets. They are read once.
    known: dict[int, Any] = document.derived.setdefault("targets of draws", {})
    moving, key = poses.moving_targets, id(draw.views)
    if key not in known or known[key][1] != moving:
        known[key] = draw.views, moving, morphing_of(document, draw.views, poses)
    morphing = known[key][2] and replace(known[key][2], weights=weights[:, moving])
    return PosedDraw(matrices, morphing, corrections, weights)


def posed_attachment(
    document: Document, attached: Attachment, clip: Clip, times: Float64Array
) -> Float64Array:
    """Return the matrix (P, 1, 4, 4) of its node at times of a clip. It faces along +Z."""
    turn = HALF_TURN if faces_backward(document) else np.eye(4)
    return turn @ clip_poses(attached.skeleton, clip, times)


def posed_primitives(draw: Draw, posed: PosedDraw) -> Iterator[tuple[RestPrimitive, Float64Array]]:
    """Yield each primitive before skinning, with the joint matrices of the poses in which it is that."""
    if posed.morphing is None:
        yield from ((rest, posed.matrices) for rest in draw.rest)
        return
    for pose in range(len(posed.matrices)):
        for rest in posed.morphing.primitives(draw.rest, pose):
            yield rest, posed.matrices[pose : pose + 1]


def lighting_errors_of(
    draws: Sequence[Draw],
    posed: Sequence[PosedDraw],
    truth: Truth = Truth.TRIANGLES,
    at_rest: Sequence[Truths | None] = (),
) -> list[dict[str, Float32Array]]:
    """Return, for each primitive by lighting, errors in degrees and where they are known: (2, P, V)."""
    found: list[dict[str, Float32Array]] = []
    for draw, one, truths in zip_longest(draws, posed, at_rest):
        count = len(one.matrices)
        names = LIGHTINGS if one.corrections else LIGHTINGS[:2]
        own = [
            {name: np.zeros((2, count, len(rest.positions)), np.float32) for name in names}
            for rest in draw.rest
        ]

        def record(block: MeasuredBlock, own: Any = own) -> None:
            found = own[block.primitive].get(block.lighting)
            if found is not None:
                poses = slice(block.pose, block.pose + block.errors.shape[0])
                rows = slice(block.vertex, block.vertex + block.errors.shape[1])
                found[0, poses, rows] = np.where(block.valid, block.errors, 0.0)
                found[1, poses, rows] = block.valid

        measure_draw(draw, one, record, truth, truths)
        found += own
    return found


def asked_clips(document: Document, asked: str | None) -> Sequence[Clip]:
    """Return the clip of a name or number, or all. Raises ChoiceError for a clip that does not exist."""
    clips = read_clips(document)
    if asked is None:
        return clips
    named = [clip for clip in clips if clip.name == asked]
    if not named and asked.isdecimal():
        named = [clip for clip in clips if clip.number == int(asked)]
    if not named:
        alike = [clip for clip in clips if document.asset.animations[clip.number].name == asked]
        there = alike or clips
        listed = [printable(clip.name) for clip in there[:LISTED]] or ["none"]
        more = [f"{len(there) - LISTED} more"] if len(there) > LISTED else []
        what = "several clips of this name: choose by number among" if alike else "no such clip; it has"
        raise ChoiceError(
            "clip", printable(asked), reason=(f": the file has {what} {', '.join(listed + more)}",)
        )
    return named


def truths_of_draw(draw: Draw, posed: PosedDraw, truth: Truth) -> Truths:
    """Measure a draw at rest for any calls of ``measure_draw`` with so many poses, without morph targets."""
    return truths_at_rest(draw.operator(), draw.rest, len(posed.matrices), posed.morphing, (truth,))


def measure_draw(
    draw: Draw,
    posed: PosedDraw,
    record: Callable[[MeasuredBlock], None],
    truth: Truth,
    at_rest: Truths | None = None,
) -> None:
    """Measure the errors of lighting by linear blend skinning against one truth, block by block."""
    lighting_errors(
        draw.operator(),
        draw.rest,
        posed.matrices,
        "lbs",
        record,
        morphing=posed.morphing,
        at_rest=at_rest or truths_of_draw(draw, posed, truth),
        corrections=posed.corrections,
        direct=False,
    )


def posed_positions(draw: Draw, posed: PosedDraw) -> Iterator[Float64Array]:
    """Yield positions (P, V, 3) of each primitive: all poses, or one at a time if targets move it."""
    for rest, matrices in posed_primitives(draw, posed):
        every = slice(0, len(matrices)), slice(0, len(rest.positions))
        yield BlendedPrimitive(rest, matrices, Options()).positions(*every).transpose(2, 1, 0)


OF_STORAGE = {"draco-sequential"}
"""The notices of a bake that speak only of the bytes of its output."""


def baked_in_memory(document: Document) -> Document:
    """Bake a document with the defaults. Raises InputError if nothing in it can be baked.

    Nothing is stored, so nothing is told of storage.
    """
    count = len(skinned_sources(document))
    what = f"baking {counted(count, 'primitive')} in memory"
    document.budget.claim(Cost.DRAWN_PRIMITIVE * count, what, document.place)
    with document.notices.withheld():
        plain, _ = uncorrected(document)
        if plain is document or holds_bake(document):
            plain, _ = stripped(document)
    with document.notices.withheld() as told:
        made = bake_document(plain, BakeOptions(generate_normals=True))
    if not made.primitives:
        reasons = "; ".join(notice.reason for notice in told if isinstance(notice, Skipped))
        raise InputError(f"nothing in it can be shown: {reasons or why_nothing(document)}", document.place)
    tell, sources = document.notices.tell, skinned_sources(document)
    message = "its bake is damaged, and one made in memory is shown: skinbake verify says what is wrong"
    tell(*(Notice("bake-damaged", message, one.place) for one in sources if is_baked(document, one)))
    for problem in damaged_correctives(document):
        message = f"its correctives are left out here, and α and β shown in place of them: {problem.message}"
        tell(Notice("correctives-not-shown", message, problem.place))
    message = "it has no NORMAL: smooth normals are generated here, and in a bake with --generate-normals"
    for one in sources:
        if "NORMAL" not in one.attributes and reason_to_skip(document, one, generate_normals=True) is None:
            tell(Notice("normals-generated", message, one.place))
    tell(*(notice for notice in told if notice.code not in OF_STORAGE))
    return made.document


def sound_correctives(document: Document) -> PlayedCorrectives | None:
    """Return the correctives of a document; None if it has none, or if they are damaged."""
    played = PlayedCorrectives(document)
    return played if played.targets and not any(damaged_correctives(document)) else None


def holds_bake(document: Document) -> bool:
    """Tell whether a primitive holds a bake, sound or not."""
    return any(is_baked(document, source) for source in skinned_sources(document))


def tell_unplaced(document: Document, view: BakedView, made: str) -> None:
    """Tell if an image of a primitive has no texture coordinates there."""
    ours = {*view.metadata["alpha"], *view.metadata["beta"]}  # they may be stored as such sets
    tell_images_unplaced(document, view.source, set(view.source.attributes) - ours, made)
