"""Whether the correctives of a file are sound, still fit its meshes, and are played as their bake meant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from skinbake.choices import Frame
from skinbake.errors import InputError, Notice
from skinbake.format.correctives import corrective_digest, nodes_with
from skinbake.format.digests import changed_arrays
from skinbake.format.note import VERSION, CorrectiveNote, corrective_notes, gradient_note
from skinbake.freshness.baked_views import BakedView
from skinbake.freshness.staleness import made_states
from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost, Work
from skinbake.gltf.document import Document
from skinbake.gltf.reading.accessors import read_attribute
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, Channel, Clip, clip_poses, clip_weights, read_clips
from skinbake.gltf.reading.meshes import read_primitive
from skinbake.gltf.reading.skins import Skeleton, read_skeleton
from skinbake.report.verify import Check
from skinbake.truth.poses import moving_clips, pose_work

BAKE = "run skinbake bake --correctives again"

PRINTED, BETWEEN = 16, 0.382
"""The poses of a clip that tell it from others, and where they lie in each of as many equal parts."""

NUMBERS, SAME = 4, 1e-3
"""The numbers that stand for the poses of a clip, and by how much they may differ; the same for its weights.

A tool that drops the keys that others imply within 1e-4 changes them by up to 3e-4.
"""


def damaged_correctives(document: Document) -> Iterator[Notice]:
    """Yield a problem for each mesh whose targets or metadata no bake can have made."""
    for number, note in corrective_notes(document).items():
        place, primitives = document.asset.meshes[number].place, document.asset.meshes[number].primitives
        if note.version != VERSION:
            message = f"its metadata has version {note.version}, this skinbake reads {VERSION}"
            yield Notice("version", f"{message}: update skinbake", place)
        elif any(gradient_note(document, one) for one in primitives):
            yield Notice("both-bakes", f"it has α/β and correctives, which correct it twice: {BAKE}", place)
        elif any(len(one.whole_targets) < note.targets for one in primitives):
            yield Notice("targets-missing", f"its morph targets were removed since the bake: {BAKE}", place)
        elif len(note.primitives) != len(primitives):
            yield Notice("metadata-broken", f'its metadata is damaged: "primitives"; {BAKE}', place)


def corrective_targets(document: Document, source: PrimitiveSource, added: int, count: int) -> Float64Array:
    """Return the last targets of a primitive, (K, V, 3), as a renderer reads them. Raises InputError."""
    found = np.zeros((added, count, 3))
    for number, target in enumerate(source.whole_targets[-added:]):
        if "NORMAL" in target:
            values = read_attribute(document, target, "NORMAL", source.place.at("NORMAL")).decoded()
            if values.shape != found[number].shape:
                raise InputError("its corrective normals do not fit its vertices", source.place)
            found[number] = values
    return found


def changed_since(
    document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive, note: CorrectiveNote
) -> tuple[tuple[str, ...], bool]:
    """Return the arrays of a primitive that changed since its bake, and whether its correctives still fit.

    They fit if each vertex has what it had, in whatever order. Raises InputError if a target is broken.
    """
    noted = note.primitives[source.primitive] if source.primitive < len(note.primitives) else None
    if noted is None or not noted.digest:
        return (), True
    targets = corrective_targets(document, source, note.targets, len(primitive.positions))
    fit = noted.targets == corrective_digest(primitive, targets)
    return changed_arrays(noted.digest, Frame.NORMAL, primitive), fit


class PlayedCorrectives:
    """The correctives of a document, as its clips play them. targets are their numbers by mesh."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.targets = {mesh: note.targets for mesh, note in corrective_notes(document).items()}

    @classmethod
    def sound(cls, document: Document) -> PlayedCorrectives | None:
        """Return the correctives of a document; None if it has none, or if they are damaged."""
        played = cls(document)
        return played if played.targets and not any(damaged_correctives(document)) else None

    @cached_property
    def clips(self) -> dict[int, Clip]:
        """The clips by number. Reading many takes long, and most documents have no correctives."""
        return {clip.number: clip for clip in read_clips(self.document)}

    def of_views(self, views: Sequence[BakedView]) -> list[Float64Array]:
        """Return the changes (K, V, 3) of unit normals of primitives; K is 0 in a mesh without correctives.

        The views may belong to a document whose correctives were stripped. Raises InputError.
        """
        found = []
        for view in views:
            added, count = self.targets.get(view.source.mesh, 0), len(view.now.positions)
            lengths = np.linalg.norm(view.now.normals.astype(np.float64), axis=1)
            own = np.zeros((0, count, 3))
            if added:
                source = self.document.asset.counterpart(view.source)
                own = corrective_targets(self.document, source, added, count)
            with np.errstate(invalid="ignore", divide="ignore"):
                found.append(np.nan_to_num(own / lengths[:, None]))
        return found

    def weights(
        self, mesh: int, skin: int, node: int | None, clip: int | None, times: Float64Array
    ) -> Float64Array:
        """Return the weights (P, K) that a clip gives a mesh's correctives at times (P,).

        skin draws the mesh, and node does if the file has morph targets of its own there. clip is a number:
        what is not a clip of the file, such as random poses, plays nothing.
        """
        added, node = self.targets.get(mesh, 0), self.node(mesh, skin) if node is None else node
        if not added or node is None or clip not in self.clips:
            return np.zeros((len(times), added))
        resting = self.document.asset.nodes[node].resting_weights()
        return clip_weights(node, self.clips[clip], times, resting)[:, -added:]

    def node(self, mesh: int, skin: int) -> int | None:
        """Return the first node that draws a mesh with a skin, whose weights its correctives have."""
        nodes = nodes_with(self.document, mesh, skin) or nodes_with(self.document, mesh)
        return nodes[0] if nodes else None


class PlayedClip(NamedTuple):
    """What a clip plays where a node draws a mesh with a skin: numbers for its poses, and for morph weights.

    plays tells whether a weight of a corrective is not 0.
    """

    clip: Clip
    poses: tuple[float, ...]
    weights: tuple[float, ...]
    plays: bool


class PlayedClips:
    """What the clips of a document play, which serves all its meshes."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._by_skin: dict[int, dict[int, tuple[Float64Array, tuple[float, ...]]]] = {}

    @cached_property
    def _channels(self) -> dict[tuple[int, int], list[Channel]]:
        """The channels of morph weights by clip and node."""
        found: dict[tuple[int, int], list[Channel]] = {}
        for clip in read_clips(self._document):
            for channel in clip.channels:
                for node in {channel.node, *channel.nodes} if channel.path == MORPH_WEIGHTS else ():
                    found.setdefault((clip.number, node), []).append(channel)
        return found

    def of_mesh(self, mesh: int, added: int) -> list[PlayedClip]:
        """Return what the clips play that move the skins of a mesh, or the last ``added`` of its targets.

        What is played alike is listed once. Raises InputError if clips are broken, or too much work for the
        file.
        """
        document, found = self._document, dict[object, PlayedClip]()
        for node in nodes_with(document, mesh):
            skin = document.asset.nodes[node].skin
            if skin is None:
                continue
            if skin not in self._by_skin:
                moving = moving_clips(document, skin, read_clips(document))
                self._by_skin[skin] = {clip.number: self._printed(skin, clip) for clip in moving}
            resting = document.asset.nodes[node].resting_weights()
            for clip in read_clips(document):
                times, poses = self._by_skin[skin].get(clip.number, (None, None))
                own = self._channels.get((clip.number, node), ())
                key = skin, clip.number, resting.tobytes(), *(id(one.values) for one in own)
                if key in found or (times is None and not own):
                    continue
                if times is None or poses is None:
                    times, poses = self._printed(skin, clip._replace(channels=()))
                document.budget.claim(Cost.SAMPLED_CHANNEL, "what its clips play", document.place)
                weights = clip_weights(node, clip._replace(channels=tuple(own)), times, resting)
                prints = _printed_values(weights)
                found[key] = PlayedClip(clip, poses, prints, bool(weights[:, -added:].any()))
        # The first of those that are alike.
        return list({(one.poses, one.weights): one for one in reversed(found.values())}.values())[::-1]

    def _printed(self, skin: int, clip: Clip) -> tuple[Float64Array, tuple[float, ...]]:
        """Return times (P,) of a clip, and numbers for its poses there. Only its own channels count.

        A clip may also move other parts of the scene, which tools take out. Where the whole scene lies does
        not count either.
        """
        skeleton, budget = read_skeleton(self._document, skin), self._document.budget
        work = pose_work(skeleton, [clip], PRINTED)
        budget.claim(work, f"what moves skin {skin}", self._document.place)
        start = min((float(one.times[0]) for one in clip.channels), default=clip.start)
        end = max((float(one.times[-1]) for one in clip.channels), default=clip.duration)
        times = start + (end - start) * (np.arange(PRINTED) + BETWEEN) / PRINTED
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # NaN counts as 0
            return times, _printed_values(_sized(skeleton, clip_poses(skeleton, clip, times)))


def _sized(skeleton: Skeleton, matrices: Float64Array) -> Float64Array:
    """Return joint matrices (P, J, 4, 4) as numbers of about 1, whatever the units of the file."""

    def mean(values: Float64Array) -> Any:
        return np.sqrt(np.square(values).mean())

    turned, moved = matrices[..., :3, :3], matrices[..., :3, 3]
    moved = moved - moved.mean(axis=1, keepdims=True)
    bind, size = skeleton.inverse_bind[:, :3], mean(turned)
    reach = mean(bind[..., 3]) * size / mean(bind[..., :3])
    length = np.hypot(np.nan_to_num(reach), mean(moved))
    count = len(matrices)
    return np.concatenate([(turned / size).reshape(count, -1), (moved / length).reshape(count, -1)], axis=1)


def _printed_values(values: Float64Array) -> tuple[float, ...]:
    """Return ``NUMBERS`` numbers that change with any of values (P, N), half with what all poses share."""
    finite, count = np.where(np.isfinite(values), values, 0.0), len(values)
    poses = np.full(count, 1.0 / count), np.cos(2.4 * np.arange(count)) / count**0.5
    means = [(shares[:, None] * finite).sum(axis=0) for shares in poses]
    steps, size = np.arange(1, finite.shape[1] + 1), max(finite.shape[1], 1) ** 0.5
    return tuple(
        round(float((means[number * 2 // NUMBERS] * np.cos((number + 1) * steps)).sum()) / size, 5)
        for number in range(NUMBERS)
    )


def corrective_freshness(document: Document, sources: Sequence[PrimitiveSource]) -> Check:
    """Return whether meshes, targets, weights and clips are as the bake left them."""
    problems = [state.notice for state in made_states(document) if state.changed]
    moved: dict[str, None] = {}
    for source in sources:
        note = corrective_notes(document).get(source.mesh)
        if note is None:
            continue
        changed, fit = changed_since(document, source, read_primitive(document, source), note)
        if fit:
            moved |= dict.fromkeys(changed)
        elif changed:
            message = f"{' and '.join(changed)} changed since the bake of its correctives: {BAKE}"
            problems.append(Notice("stale", message, source.place))
        else:
            message = f"its corrective normals are not those of the bake any more: {BAKE}"
            problems.append(Notice("stale-targets", message, source.place))
    clips = PlayedClips(document)
    for number, note in corrective_notes(document).items():
        place = document.asset.meshes[number].place
        found = clips.of_mesh(number, note.targets)
        stale = dict.fromkeys(_stale_clips(document, found, note))
        problems += [Notice("stale-clips", f"{message}: {BAKE}", place) for message in stale]
    remark = f"{', '.join(moved)} changed since the bake, and the correctives still fit" if moved else ""
    return Check("freshness", "failed" if problems else "passed", tuple(problems), remark)


def _stale_clips(document: Document, found: Sequence[PlayedClip], note: CorrectiveNote) -> Iterator[str]:
    """Yield what is wrong if clips play correctives of a mesh in other poses than those of the bake.

    Names, numbers and the order of clips do not count, nor do clips that are gone.
    """
    width = 2 * NUMBERS
    rows = [one for one in note.plays or () if len(one) == width]
    noted = np.array(rows, dtype=np.float64).reshape(-1, width)
    if not any(one.plays for one in found) and not (note.character and note.plays == ()):
        yield "no clip plays its correctives any more"
    steps = 1 + noted.size // 1000
    document.budget.claim(Work(steps=steps * len(found)), "comparing what its clips play", document.place)
    is_played, silent = np.zeros(len(noted), dtype=np.bool_), dict[int, Clip]()
    for one in found:
        same = np.abs(noted - [*one.poses, *one.weights]) <= SAME
        in_poses = same[:, :NUMBERS].all(axis=1)
        is_noted = in_poses & same[:, NUMBERS:].all(axis=1)
        is_played |= is_noted
        if not one.plays:
            silent |= dict.fromkeys(np.flatnonzero(in_poses).tolist(), one.clip)
        elif not is_noted.any():
            if in_poses.any():
                yield f'clip "{one.clip.name}" plays its correctives by other weights than those of the bake'
            else:
                yield f'clip "{one.clip.name}" or its rig changed since the bake of its correctives'
    for number, clip in silent.items():
        if not is_played[number]:
            yield f'clip "{clip.name}" does not play its correctives any more'
