"""The correctives of a file as it stores them: whether they are sound, and what its clips play."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from skinbake.errors import InputError, Notice, Place
from skinbake.format.correctives import corrective_digest, nodes_with
from skinbake.format.metadata import VERSION, changed_arrays, corrective_notes, read_metadata
from skinbake.freshness.baked_views import BakedView
from skinbake.geometry.skinned import Float64Array, SkinnedPrimitive
from skinbake.gltf.accessors import read_accessor
from skinbake.gltf.animation import (
    MORPH_WEIGHTS,
    Clip,
    Skeleton,
    clip_poses,
    clip_weights,
    read_clips,
    read_skeleton,
)
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import JsonObject, entries_of, object_of, reference, text
from skinbake.gltf.primitives import PrimitiveSource
from skinbake.truth.poses import joint_clips, pose_work

BAKE = "run skinbake bake --correctives again"

PRINTED, BETWEEN = 16, 0.382
"""The poses of a clip that tell it from others, and where they lie in each of as many equal parts."""

NUMBERS, SAME = 4, 1e-3
"""The numbers that stand for the poses of a clip, and by how much they may differ; the same for its weights.

A tool that drops the keys that others imply within 1e-4 changes them by up to 3e-4.
"""


def damaged_correctives(document: Document) -> Iterator[Notice]:
    """Yield a problem for each mesh whose targets or metadata are not those of a bake."""
    for number, note in corrective_notes(document).items():
        mesh = document.objects("meshes")[number]
        place = Place(document.name, number, text(mesh, "name", document.place))
        primitives = entries_of(mesh.get("primitives"))
        if note["version"] != VERSION:
            message = f"its metadata has version {note['version']}, this skinbake reads {VERSION}"
            yield Notice("version", f"{message}: update skinbake", place)
        elif any(read_metadata(document, one) for one in primitives):
            yield Notice("both-bakes", f"it has α/β and correctives, which correct it twice: {BAKE}", place)
        elif any(len(entries_of(one.get("targets"))) < int(note["targets"]) for one in primitives):
            yield Notice("targets-missing", f"its morph targets were removed since the bake: {BAKE}", place)
        elif len(entries_of(note.get("primitives"))) != len(primitives):
            yield Notice("metadata-broken", f'its metadata is damaged: "primitives"; {BAKE}', place)


def corrective_targets(document: Document, source: PrimitiveSource, added: int, count: int) -> Float64Array:
    """Return the last targets of a primitive, (K, V, 3), as a renderer reads them. Raises InputError."""
    found = np.zeros((added, count, 3))
    for number, target in enumerate(entries_of(source.json.get("targets"))[-added:]):
        accessor = reference(target.get("NORMAL"))
        if accessor is not None:
            values = read_accessor(document, accessor, source.place.at("NORMAL")).decoded()
            if values.shape != found[number].shape:
                raise InputError("its corrective normals do not fit its vertices", source.place)
            found[number] = values
    return found


def changed_since(
    document: Document, source: PrimitiveSource, primitive: SkinnedPrimitive, note: JsonObject
) -> tuple[tuple[str, ...], bool]:
    """Return the arrays of a primitive that changed since its bake, and whether its correctives still fit.

    They fit if each vertex has what it had, in whatever order. Raises InputError if a target is broken.
    """
    entries = note.get("primitives", [])
    entry = object_of(entries[source.primitive]) if source.primitive < len(entries) else {}
    if "digest" not in entry:
        return (), True
    targets = corrective_targets(document, source, int(note["targets"]), len(primitive.positions))
    fit = entry.get("targets") == corrective_digest(primitive, targets)
    return changed_arrays({**entry, "frame": "normal"}, primitive), fit


class PlayedClip(NamedTuple):
    """What a clip plays where a node draws a mesh with a skin: numbers for its poses, and for morph weights.

    plays tells whether a weight of a corrective is not 0.
    """

    clip: Clip
    poses: tuple[float, ...]
    weights: tuple[float, ...]
    plays: bool


def played_clips(document: Document, mesh: int, added: int) -> list[PlayedClip]:
    """Return what the clips play that move the skins of a mesh, or the last ``added`` of its targets.

    What is played alike is listed once. Raises InputError if clips are broken, or too much work for the file.
    """
    found: dict[object, PlayedClip] = {}
    for node in nodes_with(document, mesh):
        skin = reference(document.objects("nodes")[node].get("skin"))
        if skin is None:
            continue
        resting = document.asset.nodes[node].resting_weights()
        channels = _weights_of_nodes(document)
        for clip in read_clips(document):
            times, poses = _posed(document, skin).get(clip.number, (None, None))
            own = channels.get((clip.number, node), ())
            key = skin, clip.number, resting.tobytes(), *(id(one.values) for one in own)
            if key in found or (times is None and not own):
                continue
            if times is None or poses is None:
                times, poses = _printed(document, skin, clip._replace(channels=()))
            document.budget.claim(Cost.SAMPLED_CHANNEL, "what its clips play", document.place)
            weights = clip_weights(node, clip._replace(channels=tuple(own)), times, resting)
            prints = _printed_values(weights)
            found[key] = PlayedClip(clip, poses, prints, bool(weights[:, -added:].any()))
    return list({(one.poses, one.weights): one for one in reversed(found.values())}.values())[::-1]


def _weights_of_nodes(document: Document) -> dict[tuple[int, int], list[Any]]:
    """Return the channels of morph weights by clip and node."""
    known: dict[tuple[int, int], list[Any]] = document.derived.setdefault("weights of nodes", {})
    if not known:
        for clip in read_clips(document):
            for channel in clip.channels:
                for node in {channel.node, *channel.nodes} if channel.path == MORPH_WEIGHTS else ():
                    known.setdefault((clip.number, node), []).append(channel)
    return known


def _posed(document: Document, skin: int) -> dict[int, tuple[Float64Array, tuple[float, ...]]]:
    """Return the times, and numbers for the poses there, of the clips that move a skin, by their number."""
    known: dict[int, Any] = document.derived.setdefault("printed clips", {})
    if skin not in known:
        moving = joint_clips(document, skin, read_clips(document))
        known[skin] = {clip.number: _printed(document, skin, clip) for clip in moving}
    found: dict[int, tuple[Float64Array, tuple[float, ...]]] = known[skin]
    return found


def _printed(document: Document, skin: int, clip: Clip) -> tuple[Float64Array, tuple[float, ...]]:
    """Return times (P,) of a clip, and numbers for its poses there. Only its own channels count.

    A clip may also move other parts of the scene, which tools take out. Where the whole scene lies does not
    count either.
    """
    skeleton = read_skeleton(document, skin)
    document.budget.claim(pose_work(skeleton, [clip], PRINTED), f"what moves skin {skin}", document.place)
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
    steps, size = np.arange(1, finite.shape[1] + 1), max(finite.shape[1], 1) ** 0.5
    return tuple(
        round(float((poses[number * 2 // NUMBERS] @ finite) @ np.cos((number + 1) * steps)) / size, 5)
        for number in range(NUMBERS)
    )


class PlayedCorrectives:
    """The correctives of a document, as its clips play them. targets are their numbers by mesh."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self.targets = {mesh: int(note["targets"]) for mesh, note in corrective_notes(document).items()}

    @cached_property
    def clips(self) -> dict[int, Clip]:
        """The clips by number. Reading many takes long, and most documents have no correctives."""
        return {clip.number: clip for clip in read_clips(self._document)}

    def of_views(self, views: Sequence[BakedView]) -> list[Float64Array]:
        """Return the changes (K, V, 3) of unit normals of primitives; K is 0 in a mesh without correctives.

        The views may be those of a document whose correctives were stripped. Raises InputError.
        """
        found = []
        for view in views:
            added, count = self.targets.get(view.source.mesh, 0), len(view.now.positions)
            source = self._document.asset.counterpart(view.source)
            lengths = np.linalg.norm(view.now.normals.astype(np.float64), axis=1)
            own = np.zeros((0, count, 3))
            if added:
                own = corrective_targets(self._document, source, added, count)
            with np.errstate(invalid="ignore", divide="ignore"):
                found.append(np.nan_to_num(own / lengths[:, None]))
        return found

    def weights(
        self, mesh: int, draw: tuple[int, int | None], clip: Clip, times: Float64Array
    ) -> Float64Array:
        """Return the weights (P, K) that a clip gives a mesh's correctives at times (P,).

        draw are the skin that draws the mesh, and the node if the file has morph targets of its own there.
        """
        skin, node = draw
        added, node = self.targets.get(mesh, 0), self.node(mesh, skin) if node is None else node
        if not added or node is None:
            return np.zeros((len(times), added))
        resting = self._document.asset.nodes[node].resting_weights()
        # A clip of a stripped document, or of joints alone, has no channels of morph weights.
        whole = self.clips.get(clip.number, clip)
        return clip_weights(node, whole, times, resting)[:, -added:]

    def node(self, mesh: int, skin: int) -> int | None:
        """Return the first node that draws a mesh with a skin, whose weights its correctives have."""
        nodes = nodes_with(self._document, mesh, skin) or nodes_with(self._document, mesh)
        return nodes[0] if nodes else None
