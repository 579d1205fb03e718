"""Clips: the animations of a file, and what they move at any time (glTF 2.0, §3.11)."""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np

from skinbake.errors import InputError
from skinbake.geometry import poses
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import JsonObject, index, member, objects, text
from skinbake.gltf.reading.accessors import read_wide
from skinbake.gltf.reading.skins import PATHS, TURN, Skeleton
from skinbake.wording import counted

MORPH_WEIGHTS = "weights"
"""The path of a channel that moves no transform of a node."""

RANDOM, RANDOM_POSES, RANDOM_ANGLE = -1, 8, np.pi / 6
"""The number of ``random_clip``, its poses, and the largest turn of a joint in radians, as on the page."""

POINTER_EXTENSION = "KHR_animation_pointer"
POINTER = re.compile(
    "/nodes/(0|[1-9][0-9]{0,8})/(?:(translation|rotation|scale)|(weights)(?:/(0|[1-9][0-9]{0,8}))?)"
)
"""The JSON pointers (RFC 6901) that name the properties of a node, and one of its morph weights."""

MESH_POINTER = re.compile("/meshes/(0|[1-9][0-9]{0,8})/weights(?:/(0|[1-9][0-9]{0,8}))?")
"""Those that name morph weights of a mesh, all or one: those of all its nodes without their own."""


class Channel(NamedTuple):
    """One animated property of one node.

    times (N,) are in seconds. values are (N, C), or (N, 3, C) for CUBICSPLINE. Rotations have w first. For
    the path ``weights``, C is the number of morph targets. A channel that moves the weights of a mesh has all
    skinned nodes that take them from there in ``nodes``, and one of them in ``node``. target is the morph
    target if the channel moves the weight of one: C is 1.
    """

    node: int
    path: str
    method: str
    times: Float64Array
    values: Float64Array
    nodes: frozenset[int] = frozenset()
    target: int | None = None

    def morphs(self, node: int | None) -> bool:
        """Tell whether the channel moves the morph weights of a node."""
        return self.path == MORPH_WEIGHTS and (node == self.node or node in self.nodes)


class Clip(NamedTuple):
    """One animation, named as ``Animation.called``: the channels that move nodes or morph skinned meshes.

    start and duration are in seconds, from the first key to the last. glTF clips usually begin at 0, but
    exporters also cut clips from a longer take, and these begin later. number is that of the animation in the
    file, or ``RANDOM``.
    """

    name: str
    duration: float
    channels: tuple[Channel, ...]
    start: float = 0.0
    number: int = 0


def random_clip(document: Document) -> Clip:
    """Return a clip in which all joints turn from one random pose to the next, from rest to rest.

    A pose lasts a second. The page has the same clip (``randomClip`` in poses.js), by the same numbers.
    """
    joints = list(dict.fromkeys(joint for skin in document.asset.skins for joint in skin.joints))
    # Mulberry32: its state grows by a constant, so that all numbers of a sequence are known at once.
    state = np.arange(1, 3 * RANDOM_POSES * len(joints) + 1, dtype=np.uint32) * np.uint32(0x6D2B79F5)
    state += np.uint32(1)  # the seed
    mixed = (state ^ (state >> 15)) * (state | 1)
    mixed ^= mixed + (mixed ^ (mixed >> 7)) * (mixed | 61)
    z, around, half = np.moveaxis((mixed ^ (mixed >> 14)).reshape(-1, RANDOM_POSES, 3) / 2.0**32, 2, 0)
    z, around, half = 2 * z - 1, 2 * np.pi * around, RANDOM_ANGLE * half / 2
    flat = np.sqrt(1 - z * z) * np.sin(half)
    turned = np.stack([np.cos(half), flat * np.cos(around), flat * np.sin(around), z * np.sin(half)], axis=2)
    values = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), RANDOM_POSES + 2, 1))
    values[:, 1:-1] = turned.astype(np.float32)  # as the page keeps them
    times = np.arange(RANDOM_POSES + 2, dtype=np.float64)
    channels = (
        Channel(node, TURN, poses.LINEAR, times, own) for node, own in zip(joints, values, strict=True)
    )
    return Clip("Random poses", float(times[-1]), tuple(channels), number=RANDOM)


def clip_poses(skeleton: Skeleton, clip: Clip, at: Float64Array) -> Float64Array:
    """Return the joint matrices (P, J, 4, 4) of a clip at the times ``at`` (P,) in seconds."""
    return skeleton.joint_matrices(clip_values(clip, at), None, len(at))


def clip_values(clip: Clip, at: Float64Array) -> dict[tuple[int, str], Float64Array]:
    """Return the values (P, C) of each node and path that a clip moves, at the times ``at`` (P,)."""
    # Exporters write all channels of a clip with the same keys. Together they take as long as one.
    moving = [channel for channel in clip.channels if channel.path != MORPH_WEIGHTS]
    # Channels with equal values too are evaluated once.
    alike: dict[tuple[int, str, str], dict[int, Channel]] = {}
    for channel in moving:
        same = alike.setdefault((id(channel.times), channel.path, channel.method), {})
        same.setdefault(id(channel.values), channel)
    found: dict[tuple[int, int, str, str], Float64Array] = {}
    for (times, path, method), channels in alike.items():
        values = np.stack([channel.values for channel in channels.values()])
        sampled = _at(next(iter(channels.values()))._replace(values=values), at)
        found.update(
            ((times, one, path, method), result) for one, result in zip(channels, sampled, strict=True)
        )
    return {
        (channel.node, channel.path): found[
            id(channel.times), id(channel.values), channel.path, channel.method
        ]
        for channel in moving
    }


def clip_weights(node: int, clip: Clip, at: Float64Array, resting: Float64Array) -> Float64Array:
    """Return the morph weights (P, N) of a node; ``resting`` (N,) if the clip does not animate them."""
    weights = np.broadcast_to(resting, (len(at), len(resting)))
    for channel in clip.channels:
        if channel.morphs(node) and channel.target is None:
            weights = _at(channel, at)
        elif channel.morphs(node):
            weights = weights.copy()
            weights[:, channel.target] = _at(channel, at)[:, 0]
    return weights


def _at(channel: Channel, at: Float64Array) -> Float64Array:
    return poses.interpolated(
        channel.times, channel.values, at, method=channel.method, rotation=channel.path in ("rotation", TURN)
    )


def animations_of(document: Document, nodes: Container[int]) -> list[int]:
    """Return the numbers of the animations that move, turn or scale any of some nodes. Keys are not read.

    Raises InputError if a target is broken.
    """
    place, found = document.place, []
    for animation in document.asset.animations:
        number = animation.number
        targets = (
            _target(document, channel, f"animation {number}")
            for channel in objects(animation.json, "channels", place)
        )
        if any(path in PATHS and node in nodes for node, path, _, _ in targets):
            found.append(number)
    return found


def read_clips(document: Document, some: Sequence[int] | None = None) -> Sequence[Clip]:
    """Return the animations that move, turn, scale or morph, or some of them; InputError if one is broken."""
    known, place = _known_clips(document), document.place
    times: dict[int | bytes, Float64Array] = {}
    outputs: dict[tuple[object, ...], Float64Array] = {}
    animations = document.asset.animations
    numbers = range(len(animations)) if some is None else some
    for number in numbers:
        if number in known:
            continue
        animation = animations[number]
        samplers = objects(animation.json, "samplers", place)
        text(animation.json, "name", place)  # it must be one
        channels = []
        for channel in objects(animation.json, "channels", place):
            found = _channel(document, animation.called, samplers, channel, times, outputs)
            if found is not None:
                channels.append(found)
        known[number] = None
        if channels:
            start = min(float(channel.times[0]) for channel in channels)
            duration = max(float(channel.times[-1]) for channel in channels)
            known[number] = Clip(animation.called, duration, tuple(channels), start, number)
    return [clip for number in numbers if (clip := known[number])]


@once_a_document
def _known_clips(document: Document) -> dict[int, Clip | None]:
    """Return the clips that were read, by the number of their animation; None for one that moves nothing."""
    return {}


def _channel(
    document: Document,
    clip: str,
    samplers: list[JsonObject],
    channel: JsonObject,
    known: dict[int | bytes, Float64Array],
    outputs: dict[tuple[object, ...], Float64Array],
) -> Channel | None:
    """Return one channel, or None if it moves no node and morphs no skinned mesh.

    known are the times that were read before, by accessor and by value. outputs are the values, by
    accessor and use.
    """
    place, owner = document.place, f'clip "{clip}"'
    node, path, nodes, one = _target(document, channel, owner)
    sampler_index = index(channel, "sampler", len(samplers), place, owner=owner)
    if node is None or path is None or sampler_index is None:
        return None
    components = PATHS.get(path)
    if path == MORPH_WEIGHTS:
        drawing = document.asset.nodes[node]
        mesh, skin = drawing.mesh, drawing.skin
        components = 0 if mesh is None or skin is None else document.asset.meshes[mesh].target_count
        if components and one is not None:
            index({"weight": one}, "weight", components, place, owner=owner, kind="morph target")
            components = 1
    if not components:
        return None
    sampler = samplers[sampler_index]
    accessors = document.objects("accessors")
    source, output = (
        index(sampler, key, len(accessors), place, owner=owner, kind="accessor")
        for key in ("input", "output")
    )
    if source is None or output is None:
        raise _refused(document, clip, node, "its sampler lacks its input or output")
    if source not in known:
        stored = read_wide(document, source, place)
        if (fault := _time_fault(stored)) is not None:
            raise _refused(document, clip, node, fault)
        # Many exporters store the same times for each channel. Channels of one array are evaluated together.
        known[source] = known.setdefault(stored.tobytes(), stored[:, 0])
    times = known[source]
    method = text(sampler, "interpolation", place) or poses.LINEAR
    if method not in {poses.STEP, poses.LINEAR, poses.CUBICSPLINE}:
        raise _refused(document, clip, node, f"its sampler has the unknown interpolation {method!r}")
    each = 3 if method == poses.CUBICSPLINE else 1
    use = (output, path, each * len(times), components)
    if use not in outputs:
        values = read_wide(document, output, place)
        if (fault := _fault(values, each * len(times), components, path)) is not None:
            raise _refused(document, clip, node, fault)
        by_key = values[:, [3, 0, 1, 2]] if path == "rotation" else values
        shape = (-1, 3, components) if each == 3 else (-1, components)
        outputs[use] = by_key.reshape(shape)
    return Channel(node, path, method, times, outputs[use], nodes, one)


def _target(
    document: Document, channel: JsonObject, clip: str
) -> tuple[int | None, str | None, frozenset[int], int | None]:
    """Return the node and its property that a channel moves, also through a pointer; None for others.

    ``Channel.nodes`` and ``Channel.target`` come last. clip names the clip in errors.
    """
    place, count = document.place, len(document.objects("nodes"))
    target = member(channel, "target", place)
    path = text(target, "path", place)
    if path != "pointer":
        return index(target, "node", count, place, owner=clip, kind="node"), path, frozenset(), None
    extension = member(member(target, "extensions", place), POINTER_EXTENSION, place)
    pointer = text(extension, "pointer", place) or ""
    owner = f'{clip}: the pointer "{pointer}"'
    if (found := POINTER.fullmatch(pointer)) is not None:
        node = index({"node": int(found[1])}, "node", count, place, owner=owner, kind="node")
        return node, found[2] or found[3], frozenset(), int(found[4]) if found[4] else None
    if (found := MESH_POINTER.fullmatch(pointer)) is None:
        return None, None, frozenset(), None
    meshes = len(document.objects("meshes"))
    mesh = index({"mesh": int(found[1])}, "mesh", meshes, place, owner=owner, kind="mesh")
    nodes = document.asset.takers_of_weights.get(mesh or 0, frozenset())
    return min(nodes, default=None), MORPH_WEIGHTS, nodes, int(found[2]) if found[2] else None


def _refused(document: Document, clip: str, node: int, fault: str) -> InputError:
    name = document.asset.nodes[node].name
    called = f'node "{name}"' if name else f"node {node}"
    return InputError(f'clip "{clip}", {called}: {fault}', document.place)


def _time_fault(times: Float64Array) -> str | None:
    """Return why the values of an accessor (N, C) cannot be the times of keys; None if they can."""
    if times.shape[1] != 1:
        return f"the times of its keys must be scalars, found {times.shape[1]} components"
    if not np.isfinite(times).all():
        return "a time of its keys is not a finite number"
    back = np.flatnonzero(np.diff(times[:, 0]) < 0)
    if not len(back):
        return None
    before, after = times[back[0] : back[0] + 2, 0]
    return f"the times of its keys must ascend, but {after:g} s follows {before:g} s"


def _fault(values: Float64Array, count: int, components: int, path: str) -> str | None:
    """Return why the outputs of a sampler cannot be those of so many keys; None if they can.

    The file stores morph weights as scalars, key by key.
    """
    if path == MORPH_WEIGHTS:
        shape, needed = (count * components, 1), counted(count * components, "scalar")
        path = f"the weights of {counted(components, 'morph target')}"
        each = "a morph weight"
    else:
        shape, needed = (count, components), f"{counted(count, 'output')} of {components} components"
        each = f"a {path}"
    if values.shape != shape:
        found = f"{len(values):,} of {counted(values.shape[1], 'component')}"
        return f"its sampler for {path} needs {needed}, found {found}"
    return None if np.isfinite(values).all() else f"{each} of its keys is not a finite number"
