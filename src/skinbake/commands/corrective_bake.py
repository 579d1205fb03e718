"""``skinbake bake --correctives``: morph targets of normals in place of α and β."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skinbake.choices import USUAL_TRUTHS, CorrectiveAim, Encoding, FrameChoice
from skinbake.commands.bake_options import OF_SURFACE, BakeOptions
from skinbake.commands.gradient_bake import BakedDocument, bake_gradients
from skinbake.commands.surface_bake import SurfaceBake, bake_surfaces
from skinbake.correctives.fit import (
    LEAST_HELD_BACK,
    LEAST_KEYS,
    Correctives,
    Motion,
    fitted,
    held_back_times,
)
from skinbake.correctives.surface import CorrectedSurface
from skinbake.errors import Chosen, InputError, Message, Notice, Place, warnings_in
from skinbake.format.baked import with_baked
from skinbake.format.correctives import (
    ClipWeights,
    MeshCorrectives,
    check_targets,
    nodes_with,
    with_mesh_correctives,
    with_plays,
)
from skinbake.format.encodings import GradientFormat
from skinbake.format.strip import uncorrected
from skinbake.freshness.baked_views import BakedView
from skinbake.freshness.corrective_freshness import PlayedClips, PlayedCorrectives
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, Clip, read_clips
from skinbake.gltf.reading.meshes import read_primitive
from skinbake.gltf.reading.morphs import targets_without_normal
from skinbake.gltf.reading.scenes import meshes_of_one_skin
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.measure.corrected import corrected_lighting, worse_primitives
from skinbake.measure.draws import Draw, Surface
from skinbake.measure.measured import bakeable
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import CorrectiveCounts, MorphCounts
from skinbake.report.verify import NEGLIGIBLE
from skinbake.timing import stage
from skinbake.truth.operator import true_operator
from skinbake.truth.poses import PosePlan, PoseRequest, pose_work
from skinbake.wording import counted

if TYPE_CHECKING:
    from skinbake.report.verify import FileVerdict

STEPS = {Encoding.FLOAT32: 2.0**-14, Encoding.SNORM16: 1.0 / 32767.0, Encoding.PACKED8: 1.0 / 127.0}
"""The steps of the components of targets as they are stored."""

AS_USUAL = VerifyOptions()
"""How verify measures the lighting without options."""

UNIT_LENGTH = 1e-2
"""How far the length of a stored normal may be from 1 without a difference to its targets: bytes are."""


def bake_correctives(
    document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions
) -> BakedDocument:
    """Make the correctives of primitives. Those that verify would find worse than none are left out.

    They are made for the normals that morph targets have then. Raises InputError if clips, skins or targets
    of the file are broken, or a clip of ``--clips`` is missing.
    """
    what = f"baking {counted(len(sources), 'primitive')}"
    document.budget.claim(Cost.BAKED_PRIMITIVE * len(sources), what, document.place)
    # Engines add the normals of morph targets first: those that lack NORMAL get it before any fit.
    morphs: list[tuple[Place, MorphCounts]] = []
    if options.morph_normals or any(targets_without_normal(document, source) for source in sources):
        from skinbake.commands.morph_bake import morph_bake  # few models have such targets

        with document.notices.withheld():
            surfaces = bake_surfaces(document, sources, OF_SURFACE)
        made = morph_bake(document, [bake for surface in surfaces for bake in surface], options)
        if made:
            with stage("store"):
                document, _, lengths = with_baked(
                    document,
                    [],
                    options.attribute_names,
                    GradientFormat(options.encoding, options.layout),
                    made=[item for item, _ in made],
                )
            sources = [document.asset.counterpart(source) for source in sources]
            morphs = [
                (item.source.place, count._replace(added_bytes=length))
                for (item, count), length in zip(made, lengths, strict=True)
            ]
    if options.character is None:
        found, verdict, written, lengths = _helpful(document, sources, options)
    else:
        # Fitted and measured with the clips of all files that hold the character. Own ones go into this one.
        for source in sources:
            check_targets(document, source.mesh, source.place)
        whole, own_clips = options.character.together(document)
        there = [whole.asset.counterpart(source) for source in sources]
        found, verdict, _, _ = _helpful(whole, there, options)
        found = [_of_file(document, one, own_clips, options.character.files) for one in found]
        if verdict is not None:
            written, lengths = _written(document, [item for *_, item in found if item], options.encoding)
    idle = [_nothing(place, one, options.clips) for place, one, item in found if item is None]
    if verdict is None:
        document.notices.tell(*idle)
        return BakedDocument(document, morphs=morphs)
    # What others have makes plain what the rest does not need.
    document.notices.tell(*warnings_in(idle))
    sizes = iter(lengths)
    counts = [
        (place, _counts(one, item, verdict, next(sizes))) for place, one, item in found if item is not None
    ]
    return BakedDocument(written, morphs=morphs, correctives=counts, verdict=verdict)


Found: TypeAlias = "tuple[Place, Correctives, MeshCorrectives | None]"
"""The correctives of a mesh, and what is to be written of them."""


def _helpful(
    document: Document, sources: Sequence[PrimitiveSource], options: BakeOptions
) -> tuple[list[Found], FileVerdict | None, Document, list[int]]:
    """Return the correctives of each mesh, their lighting, the document with them and the added bytes.

    There is no verdict if there are none.
    """
    clips = read_clips(document)
    chosen = _chosen(document, clips, options.clips)
    # Meshes that one skin draws are fitted as one surface, so that no seam shows. A mesh with morph targets
    # is by itself: each node has its own weights for them.
    asset = document.asset.meshes
    plain = [mesh for mesh in dict.fromkeys(one.mesh for one in sources) if not asset[mesh].target_count]
    morphing = [mesh for mesh in dict.fromkeys(one.mesh for one in sources) if mesh not in plain]
    if clips and not options.clips_own_weights:
        morphing = _own_weights(document, morphing, clips)
    found: list[Found] = []
    for group in [*meshes_of_one_skin(document, plain), *([mesh] for mesh in morphing)]:
        of_group = [one for mesh in group for one in sources if one.mesh == mesh]
        found += _fitted(document, of_group, clips, chosen, options)
    # What makes a primitive worse is left out, and the rest is measured again.
    while items := [item for _, _, item in found if item is not None]:
        written, lengths = _written(document, items, options.encoding)
        with stage("gain"):
            # As if the written file were read: a bake writes nothing that verify refuses.
            fresh = document.budget.afresh(sum(lengths))
            verdict = lighting_with_correctives(written.edited(budget=fresh))
        if verdict.unplayed is not None:
            raise verdict.unplayed
        worse = {(place.mesh, place.primitive) for place in worse_primitives(verdict)}
        if not worse:
            return found, verdict, written, lengths
        for number, (place, one, own) in enumerate(found):
            if own is not None:
                kept = [
                    np.zeros_like(targets) if (source.mesh, source.primitive) in worse else targets
                    for source, targets in zip(own.sources, own.targets, strict=True)
                ]
                some = any(targets.any() for targets in kept)
                found[number] = place, one, replace(own, targets=kept) if some else None
    return found, None, document, []


def _written(
    document: Document, items: Sequence[MeshCorrectives], encoding: Encoding
) -> tuple[Document, list[int]]:
    """Return the document with correctives and the added bytes by mesh.

    What its clips play is noted: verify knows them again by it.
    """
    with stage("store"):
        written, lengths = with_mesh_correctives(document, items, encoding)
        plays, played = {}, PlayedClips(written)
        for item in items:
            of_mesh = played.of_mesh(item.mesh, item.count)
            plays[item.mesh] = [(*one.poses, *one.weights) for one in of_mesh if one.plays]
        return with_plays(written, plays), lengths


def _of_file(
    document: Document, found: Found, own_clips: Mapping[int, int], character: Sequence[str]
) -> Found:
    """Return correctives with the clips of one file alone, whose numbers ``own_clips`` has."""
    place, one, item = found
    if item is not None:
        tracks = (track for track in one.tracks if track.motion.clip.number in own_clips)
        one = replace(one, tracks=tuple(tracks))
        clips = [clip for clip in item.clips if clip.animation in own_clips]
        item = replace(
            item,
            sources=[document.asset.counterpart(source) for source in item.sources],
            clips=[replace(clip, animation=own_clips[clip.animation]) for clip in clips],
            playing=_playing(one),
            character=character,
        )
    return place, one, item


def _playing(made: Correctives) -> list[str]:
    """Return the names of the clips that play correctives, each once."""
    return list(dict.fromkeys(track.motion.clip.name for track in made.tracks if track.plays))


def _own_weights(document: Document, meshes: Sequence[int], clips: Sequence[Clip]) -> list[int]:
    """Return the meshes whose weights of morph targets clips or nodes set; tell of the others.

    A channel of weights holds those of all targets. Correctives would take the others from the page.
    """
    found = []
    for mesh in meshes:
        nodes = nodes_with(document, mesh)
        if any(document.asset.nodes[node].resting_weights().any() for node in nodes) or any(
            channel.morphs(node) for node in nodes for clip in clips for channel in clip.channels
        ):
            found.append(mesh)
            continue
        words = (
            "no correctives: no clip and no node moves its morph targets, which are left to the page. With ",
            Chosen("clips_own_weights"),
            ", clips play correctives, and zeros over what a page sets",
        )
        document.notices.tell(Notice("weights-free", Message(*words), document.asset.meshes[mesh].place))
    return found


def lighting_with_correctives(
    document: Document, asked: VerifyOptions = AS_USUAL, by: BakeOptions = OF_SURFACE
) -> FileVerdict:
    """Measure the lighting of a document with correctives, beside that of α and β that a bake would give.

    Nothing is told of it.
    """
    with document.notices.withheld():
        with stage("α and β"):
            plain, _ = uncorrected(document)
            gradients = bake_gradients(plain, bakeable(plain), by).document
        return corrected_lighting(PlayedCorrectives(document), gradients, asked)[0]


def _nothing(place: Place, correctives: Correctives, asked: Sequence[str]) -> Notice:
    """Return why a mesh gets no correctives. asked are the clips of ``--clips``."""
    if not correctives.tracks:
        clip = "chosen clip" if asked else "clip"
        message = f"no correctives: no {clip} moves its joints, and only clips play correctives"
        return Notice("no-clips", message, place)
    mean = max(correctives.standard, default=0.0)
    if mean < NEGLIGIBLE:
        message = f"no correctives: nothing to correct, its lighting is wrong by {mean:.2g}° in its clips"
        return Notice("nothing-to-correct", message, place)
    message = f"no correctives: they do not improve its lighting, which is wrong by {mean:.2g}° in its clips"
    return Notice("correctives-idle", message, place)


def _chosen(document: Document, clips: Sequence[Clip], asked: Sequence[str]) -> set[int]:
    """Return the numbers of the clips that play correctives: the clips of ``--clips``, else all.

    A name that several clips have stands for all of them.
    """
    if not asked:
        return {clip.number for clip in clips}
    known: dict[str, set[int]] = {str(clip.number): {clip.number} for clip in clips}
    named: dict[str, set[int]] = {}
    for clip in clips:
        for name in {clip.name, document.asset.animations[clip.number].name or clip.name}:
            named.setdefault(name, set()).add(clip.number)
    known |= named
    wanted = [part for name in asked for part in ([name] if name in known else name.split(","))]
    for name in wanted:
        if name not in known:
            there = ", ".join(sorted(clip.name for clip in clips)) or "none"
            raise InputError(f"--clips: it has no clip {name!r}; its clips are: {there}", document.place)
    return set().union(*(known[name] for name in wanted))


def _fitted(
    document: Document,
    sources: Sequence[PrimitiveSource],
    clips: Sequence[Clip],
    chosen: set[int],
    options: BakeOptions,
) -> list[Found]:
    """Return the correctives of the meshes of one surface."""
    meshes = list(dict.fromkeys(source.mesh for source in sources))
    places = [next(s for s in sources if s.mesh == mesh).place._replace(primitive=None) for mesh in meshes]
    for mesh, place in zip(meshes, places, strict=True):
        check_targets(document, mesh, place)
    accurate = options.corrective_aim is CorrectiveAim.GRADIENTS
    with stage("arrays"):
        primitives = [read_primitive(document, source) for source in sources]
        if accurate:
            # With the α and β that a bake would give them.
            given = SurfaceBake.of(document, sources, replace(options, frame=FrameChoice.NORMAL))
            views = [BakedView.unwritten(bake.to_store) for bake in given.plain(given.primitives)]
        else:
            views = [BakedView.unbaked(*pair) for pair in zip(sources, primitives, strict=True)]
    # A motion is a chosen clip at a node. Nodes that draw alike have one.
    nodes, plans = _nodes(document, meshes, clips), dict[int, PosePlan]()
    for node in (node for of_mesh in nodes.values() for node in of_mesh.values()):
        skin = document.asset.nodes[node].skin or 0
        plans[node] = PosePlan.of(document, skin, clips, PoseRequest(), node)
    moving, place = _moving_targets(plans.values()), sources[0].place
    surface = Surface(
        document,
        views,
        lambda: true_operator(primitives, claim=document.budget.welding(place)),
        moving=moving,
    )
    draws = {node: Draw.at_rest(surface, plan.skin, plan.node) for node, plan in plans.items()}
    motions = [
        Motion(node, draws[node], clip)
        for node, plan in plans.items()
        for clip in plan.sampled
        if clip.number in chosen
    ]
    if not motions:
        none = tuple(np.zeros((0, len(one.positions), 3)) for one in primitives)
        nothing = Correctives(none, (), (), 1.0, 0)
        return [(place, nothing, None) for place in places]
    _claim_fit(surface, motions, len(moving))
    areas = np.concatenate(motions[0].draw.areas)
    # The primitives of each mesh, which is given its own targets and weights.
    parts, start = [], 0
    for mesh in meshes:
        count = sum(source.mesh == mesh for source in sources)
        parts.append(slice(start, start + count))
        start += count
    with stage("fit"):
        # Morph targets stand at the means of the weights that clips play.
        mean = None
        if moving:
            held = [one.at(held_back_times(one.clip, len(motions))).poses.morph_weights for one in motions]
            mean = np.mean([one.mean(axis=0) for one in held if one is not None], axis=0)[None]
        made = fitted(
            CorrectedSurface.of(surface, mean),
            parts,
            motions,
            areas,
            None if options.correctives == "auto" else options.correctives,
            STEPS[options.encoding],
            accurate=accurate,
            claim=lambda work: document.budget.claim(work, "fitting its correctives", place),
        )
    # A clip that was not chosen plays zeros: else its weights would stay those of the clip before it.
    idle = {
        node: [clip for clip in plan.sampled if clip.number not in chosen] for node, plan in plans.items()
    }
    # Targets are added to the normals as stored, whose lengths are not quite 1, or not at all.
    lengths = []
    for primitive in primitives:
        own = np.sqrt(np.square(primitive.normals.astype(np.float64)).sum(axis=1))
        is_unit = np.abs(own - 1.0) < UNIT_LENGTH
        lengths.append(np.where(is_unit | ~np.isfinite(own), 1.0, own)[:, None])
    found = []
    for mesh, here, part, one in zip(meshes, places, parts, made, strict=True):
        item = None
        if one.count:
            item = MeshCorrectives(
                mesh=mesh,
                sources=sources[part],
                primitives=primitives[part],
                targets=[own * size for own, size in zip(one.targets, lengths[part], strict=True)],
                clips=_weights(nodes[mesh], one, idle),
                aim=options.corrective_aim,
                playing=_playing(one),
            )
        found.append((here, one, item))
    return found


def _nodes(document: Document, meshes: Sequence[int], clips: Sequence[Clip]) -> dict[int, dict[int, int]]:
    """Return by mesh the nodes that draw it, each with the first node of a surface that draws alike.

    These have the same joints, inverse bind matrices and, if the mesh has targets, the same morph weights.
    """
    morphing = [mesh for mesh in meshes if document.asset.meshes[mesh].target_count]
    played: dict[int, list[object]] = {}
    for clip in clips if morphing else ():
        for channel in clip.channels:
            if channel.path == MORPH_WEIGHTS:
                key = clip.number, channel.method, id(channel.times), id(channel.values), channel.target
                for node in {channel.node, *channel.nodes}:
                    played.setdefault(node, []).append(key)
    bindings: dict[int, object] = {}
    first: dict[object, int] = {}
    found: dict[int, dict[int, int]] = {mesh: {} for mesh in meshes}
    for mesh in meshes:
        for node in nodes_with(document, mesh):
            skin = document.asset.nodes[node].skin
            if skin is None:
                continue
            if skin not in bindings:
                skeleton = read_skeleton(document, skin)
                joints = tuple(skeleton.nodes[joint] for joint in skeleton.joints)
                bindings[skin] = joints, (skeleton.inverse_bind + 0.0).tobytes()
            weights: object = None
            if mesh in morphing:
                resting = document.asset.nodes[node].resting_weights()
                weights = tuple(resting.tolist()), tuple(played.get(node, ()))
            found[mesh][node] = first.setdefault((bindings[skin], weights), node)
    return found


def _moving_targets(plans: Iterable[PosePlan]) -> list[int]:
    """Return the morph targets that have a weight other than 0, at rest or in a clip."""
    found: set[int] = set()
    for plan in plans:
        if plan.resting is not None:
            found.update(np.flatnonzero(plan.resting).tolist())
            for channel in (channel for clip in plan.sampled for channel in clip.channels):
                if channel.path == MORPH_WEIGHTS and channel.target is None:
                    keys = channel.values.reshape(-1, len(plan.resting))
                    found.update(np.flatnonzero(keys.any(axis=0)).tolist())
                elif channel.path == MORPH_WEIGHTS:
                    found.add(channel.target or 0)
    return sorted(found)


def _claim_fit(surface: Surface, motions: Sequence[Motion], targets: int) -> None:
    """Count the work of fitting a surface to motions, which so many targets move. Raises InputError."""
    poses = LEAST_KEYS + LEAST_HELD_BACK
    work = Cost.FITTED_KEY * (surface.vertices * LEAST_KEYS * len(motions))
    for motion in motions:
        work += Cost.FITTED_MOTION + pose_work(motion.draw.skeleton, [motion.clip], poses)
        if targets:
            of_pose = Cost.MEASURED_MORPH + Cost.MEASURED_TARGET * targets
            work += of_pose * (len(surface.views) * poses)
    what = f"{counted(surface.vertices, 'vertex', 'vertices')} to {counted(len(motions), 'clip')}"
    fitting = f"fitting {what} of its skins (--clips chooses some)"
    surface.document.budget.claim(work, fitting, surface.views[0].source.place)


def _weights(nodes: Mapping[int, int], made: Correctives, idle: dict[int, list[Clip]]) -> list[ClipWeights]:
    """Return the weights by clip and by the ``nodes`` that draw alike; 0 in clips that were not chosen."""
    found = []
    for of in dict.fromkeys(nodes.values()):
        alike = [node for node, other in nodes.items() if other == of]
        found += [
            ClipWeights(track.motion.clip.number, alike, track.times, track.weights)
            for track in made.tracks
            if track.motion.node == of
        ]
        for clip in idle[of]:
            ends = np.unique(np.array([clip.start, clip.duration], dtype=np.float32))
            zeros = np.zeros((len(ends), made.count), dtype=np.float32)
            found.append(ClipWeights(clip.number, alike, ends, zeros))
    return found


def _counts(
    made: Correctives, item: MeshCorrectives, verdict: FileVerdict, added_bytes: int
) -> CorrectiveCounts:
    """Return the numbers of the report for one mesh, whose errors a verdict has by primitive."""
    still = [track.motion.clip.name for track in made.tracks if not track.plays]
    fitted, corrected = (
        sum(int(np.count_nonzero(one.any(axis=(0, 2)))) for one in targets)
        for targets in (made.targets, item.targets)
    )
    means: dict[str, dict[str, float]] = {"standard": {}, "corrected": {}}
    for truth in USUAL_TRUTHS:
        measured = verdict.figures[truth].primitives if truth in verdict.figures else ()
        of_mesh = [figures["lbs"] for place, figures in measured if place.mesh == item.mesh and figures]
        for lighting, by_truth in means.items():
            own = [figures[lighting] for figures in of_mesh]
            weight = sum(one.weight for one in own)
            by_truth[str(truth)] = sum(one.mean * one.weight for one in own) / max(weight, 1e-300)
    return CorrectiveCounts(
        targets=made.count,
        vertices=sum(one.shape[1] for one in made.targets),
        corrected=corrected,
        given_up=made.given_up + fitted - corrected,
        keys=sum(len(track.times) for track in made.tracks if track.plays),
        clips=tuple(_playing(made)),
        idle_clips=tuple(dict.fromkeys(still)),
        left=made.left,
        standard=means["standard"],
        remaining=means["corrected"],
        added_bytes=added_bytes,
    )
