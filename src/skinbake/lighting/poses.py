"""The poses over which a file's lighting is measured: its own animations, random poses, or the rest pose.

A pose consists of joint matrices, and of morph weights if the mesh has targets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.choices import PoseKind
from skinbake.errors import InputError, Place
from skinbake.geometry.poses import random_weights
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.animation import (
    MORPH_WEIGHTS,
    Clip,
    Skeleton,
    clip_poses,
    clip_weights,
    random_poses,
    read_skeleton,
    rest_pose,
    skins_of,
)
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import MOST
from skinbake.gltf.morphs import resting_weights, target_count
from skinbake.wording import counted

SHARED_SAMPLES = 60
"""The poses that the clips of a file share if no number is given. Each clip gets at least 3."""

FALLBACK_POSES = 24
"""The number of random poses for a file that has no animation."""

BYTES_A_NODE_AND_POSE, BYTES_A_JOINT_AND_POSE = 640, 512
"""The bytes that a pose takes for a node while its matrices are made, and for a joint to keep its matrix."""

MORPHS_AT_ONCE = 2
"""The number of morph targets that a random pose moves. All targets at once would destroy a face."""


@dataclass(frozen=True, slots=True)
class PoseRequest:
    """The requested poses.

    samples is the number of samples of each clip (None: SHARED_SAMPLES for all), or the number of random
    poses. angle is the largest random rotation of a joint, in radians. offset is where a sample lies in each
    of N equal parts of a clip, from 0 to 1. None: samples go from the clip's first moment to its last.
    """

    kind: PoseKind = PoseKind.ANIMATION
    samples: int | None = None
    angle: float = float(np.radians(30.0))
    seed: int = 0
    offset: float | None = None

    @property
    def random_count(self) -> int:
        """Return the number of random poses, also of those that replace clips."""
        return (self.samples if self.kind is PoseKind.RANDOM else None) or FALLBACK_POSES


@dataclass(frozen=True, slots=True)
class PoseSet:
    """Joint matrices (P, J, 4, 4) of one skin, with each pose's clip and time in seconds (None: no clip).

    joint_names (J,) are for messages. morph_weights (P, N) belong to the node of the poses. They are None if
    the poses are for no node, or if its mesh has no targets.
    """

    joint_names: tuple[str, ...]
    joint_matrices: Float64Array
    clips: tuple[str, ...]
    times: tuple[float | None, ...]
    morph_weights: Float64Array | None = None

    @property
    def moving_targets(self) -> list[int]:
        """Return the morph targets that have a weight other than 0 in any pose."""
        weights = self.morph_weights
        return [] if weights is None else [int(target) for target in np.flatnonzero(weights.any(axis=0))]


def draws_of(document: Document, mesh: int, clips: Sequence[Clip]) -> list[tuple[int, int | None]]:
    """Return how nodes draw a mesh: each skin once, with a node if the mesh has morph targets.

    Nodes of one skin are one draw if their targets rest at the same weights and no clip moves them.
    """
    if not target_count(document, mesh):
        return [(skin, None) for skin in skins_of(document, mesh)]
    morphing = [channel for clip in clips for channel in clip.channels if channel.path == MORPH_WEIGHTS]
    animated = {channel.node for channel in morphing}.union(*{channel.nodes for channel in morphing})
    draws: dict[object, tuple[int, int | None]] = {}
    for number, node in enumerate(document.objects("nodes")):
        if node.get("mesh") == mesh and "skin" in node:
            resting = number if number in animated else tuple(resting_weights(document, number).tolist())
            draws.setdefault((int(node["skin"]), resting), (int(node["skin"]), number))
    return list(draws.values())


def joint_clips(document: Document, skin: int, clips: Sequence[Clip]) -> list[Clip]:
    """Return the clips that move the joints of a skin or their ancestors, with the channels that do."""
    nodes = set(read_skeleton(document, skin).nodes)
    return [clip for clip in (_only(nodes, None, clip) for clip in clips) if clip.channels]


def pose_set(
    document: Document, skin: int, clips: Sequence[Clip], request: PoseRequest, node: int | None = None
) -> PoseSet:
    """Return the poses of one skin, with the morph weights of the node that draws a mesh with it, if any.

    A clip of the file counts if it moves the skin's joints, their ancestors, or the node's weights. If no
    clip moves joints, random poses replace them. Raises InputError if joints go to infinity.
    """
    skeleton = read_skeleton(document, skin)
    names = _joint_names(document, skeleton)
    resting = None if node is None else resting_weights(document, node)
    morphs = None if node is None or resting is None or not resting.size else _Morphs(node, resting)
    moving = [clip for clip in (_only(set(skeleton.nodes), morphs, clip) for clip in clips) if clip.channels]
    _claim(document, skeleton, moving, request, 0 if resting is None else len(resting))
    with np.errstate(over="ignore", invalid="ignore"):  # the result is checked below
        if request.kind is PoseKind.REST:
            weights = None if morphs is None else morphs.resting[None]
            poses = PoseSet(names, rest_pose(skeleton), ("rest pose",), (None,), weights)
        elif request.kind is PoseKind.ANIMATION and any(_moves_joints(clip) for clip in moving):
            poses = _sampled(skeleton, morphs, moving, request, names)
        else:
            poses = _random(skeleton, morphs, request, names)
    _check_range(poses, skin, document.place)
    return poses


def _check_range(poses: PoseSet, skin: int, place: Place) -> None:
    """Raise InputError for a joint matrix that float32 cannot hold, because every renderer stores float32."""
    fits = (np.abs(poses.joint_matrices) <= MOST).all(axis=(2, 3))
    if fits.all():
        return
    pose, joint = np.argwhere(~fits)[0]
    raise InputError(
        f"in {poses.clips[pose]} the matrix of {poses.joint_names[joint]} of skin {skin} is past all numbers "
        "of float32: mend the scales and translations of its nodes, its inverse bind matrix, or its keys",
        place,
    )


def _claim(
    document: Document, skeleton: Skeleton, moving: Sequence[Clip], request: PoseRequest, targets: int
) -> None:
    """Count the memory of the poses: matrices of all nodes for a while, of the joints permanently."""
    clips = [clip for clip in moving if request.kind is PoseKind.ANIMATION]
    each = _samples_of_each(request.samples, clips) if clips else 0
    fallback = 1 if request.kind is PoseKind.REST else request.random_count
    poses = each * len(clips) or fallback
    channels = max((len(clip.channels) for clip in clips), default=0)
    budget, place = document.budget, document.place
    with budget.passing():
        at_a_time = (each or fallback) * (BYTES_A_NODE_AND_POSE * len(skeleton.nodes) + 256 * channels)
        budget.claim(
            at_a_time, f"{counted(each or fallback, 'pose')} of {counted(len(skeleton.nodes), 'node')}", place
        )
    size = poses * (BYTES_A_JOINT_AND_POSE * len(skeleton.joints) + 24 * targets)
    budget.claim(size, f"{counted(poses, 'pose')} of {counted(len(skeleton.joints), 'joint')}", place)


def _samples_of_each(samples: int | None, clips: Sequence[Clip]) -> int:
    return samples or max(3, round(SHARED_SAMPLES / len(clips)))


@dataclass(frozen=True, slots=True)
class _Morphs:
    """The node whose mesh has morph targets, and the rest weights (N,) of these targets."""

    node: int
    resting: Float64Array


def _only(nodes: set[int], morphs: _Morphs | None, clip: Clip) -> Clip:
    """Return a clip without the channels of other nodes. 84 skins have 84 times the channels of one."""
    morphed = None if morphs is None else morphs.node
    channels = tuple(
        channel
        for channel in clip.channels
        if (channel.morphs(morphed) if channel.path == MORPH_WEIGHTS else channel.node in nodes)
    )
    return replace(clip, channels=channels)


def _moves_joints(clip: Clip) -> bool:
    return any(channel.path != MORPH_WEIGHTS for channel in clip.channels)


def _joint_names(document: Document, skeleton: Skeleton) -> tuple[str, ...]:
    nodes = document.objects("nodes")
    found = [nodes[skeleton.nodes[joint]].get("name") for joint in skeleton.joints]
    return tuple(
        f'"{name}"' if name and isinstance(name, str) else f"joint {number}"
        for number, name in enumerate(found)
    )


def _sampled(
    skeleton: Skeleton,
    morphs: _Morphs | None,
    clips: Sequence[Clip],
    request: PoseRequest,
    joint_names: tuple[str, ...],
) -> PoseSet:
    each = _samples_of_each(request.samples, clips)
    matrices, weights, names, times = [], [], [], []
    for clip in clips:
        at = _moments(clip, each, request.offset)
        matrices.append(clip_poses(skeleton, clip, at))
        if morphs is not None:
            weights.append(clip_weights(morphs.node, clip, at, morphs.resting))
        names += [clip.name] * each
        times += at.tolist()
    morph_weights = np.concatenate(weights) if weights else None
    return PoseSet(joint_names, np.concatenate(matrices), tuple(names), tuple(times), morph_weights)


def _moments(clip: Clip, count: int, offset: float | None) -> Float64Array:
    """Return the times of a clip's samples, as ``PoseRequest`` says."""
    if offset is None:
        return np.linspace(clip.start, clip.duration, count)
    return clip.start + (clip.duration - clip.start) * (np.arange(count) + offset) / count


def _random(
    skeleton: Skeleton, morphs: _Morphs | None, request: PoseRequest, joint_names: tuple[str, ...]
) -> PoseSet:
    count = request.random_count
    matrices = random_poses(skeleton, count, angle=request.angle, seed=request.seed)
    weights = None if morphs is None else random_weights(morphs.resting, count, MORPHS_AT_ONCE, request.seed)
    names = tuple(f"random pose {number}" for number in range(count))
    return PoseSet(joint_names, matrices, names, (None,) * count, weights)


def described(request: PoseRequest, sets: Sequence[PoseSet], seconds: float) -> str:
    """Return a description of the poses, like ``60 poses of 3 clips``. seconds is the clips' total length."""
    poses = max((len(poses.clips) for poses in sets), default=0)
    clips = {
        clip
        for poses in sets
        for clip, time in zip(poses.clips, poses.times, strict=True)
        if time is not None
    }
    if request.kind is PoseKind.REST:
        return "the rest pose"
    if clips:
        return f"{counted(poses, 'pose')} of {counted(len(clips), 'clip')} ({seconds:.3g} s)"
    reason = "" if request.kind is PoseKind.RANDOM else " (no animation moves its joints)"
    return f"{counted(poses, 'random pose')}, joints turned by up to {np.degrees(request.angle):.3g}°{reason}"
