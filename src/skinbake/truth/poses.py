"""The poses over which a file's lighting is measured: its own animations, random poses, or the rest pose.

A pose consists of joint matrices, and of morph weights if the mesh has targets.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from skinbake.choices import PoseKind
from skinbake.errors import InputError
from skinbake.geometry.poses import random_weights
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.budget import Cost, Work
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, Clip, clip_values, clip_weights
from skinbake.gltf.reading.skins import Skeleton, random_poses, read_skeleton, rest_pose
from skinbake.wording import counted

SHARED_SAMPLES = 60
"""The poses that the clips of a file share if no number is given."""

LEAST_SAMPLES = 3
"""The poses that each of these clips gets at least."""

FALLBACK_POSES = 24
"""The number of random poses for a file that has no animation."""

MORPHS_AT_ONCE = 2
"""The number of morph targets that a random pose moves. All targets at once would destroy a face."""


class PoseRequest(NamedTuple):
    """The requested poses.

    samples is the number of samples of each clip (None: SHARED_SAMPLES for all), or the number of random
    poses. angle is the largest random rotation of a joint, in radians. offset is where a sample lies in each
    of N equal parts of a clip, from 0 to 1: never at both ends, where most clips stand in the same pose.
    most is the largest number of poses of a skin, which evenly spread clips share (None: no limit).
    """

    kind: PoseKind = PoseKind.ANIMATION
    samples: int | None = None
    angle: float = float(np.radians(30.0))
    seed: int = 0
    offset: float = 0.5
    most: int | None = None

    @property
    def random_count(self) -> int:
        """Return the number of random poses, also of those that replace clips."""
        return (self.samples if self.kind is PoseKind.RANDOM else None) or FALLBACK_POSES


class PoseSet(NamedTuple):
    """Joint matrices (P, J, 4, 4) of one skin, with each pose's clip and time in seconds (None: no clip).

    joint_names (J,) are for messages. morph_weights (P, N) belong to the node of the poses. They are None if
    the poses are for no node, or if its mesh has no targets. numbers count the animations.
    """

    joint_names: tuple[str, ...]
    joint_matrices: Float64Array
    clips: tuple[str, ...]
    times: tuple[float | None, ...]
    morph_weights: Float64Array | None = None
    numbers: tuple[int | None, ...] = ()

    @property
    def moving_targets(self) -> list[int]:
        """Return the morph targets that have a weight other than 0 in any pose."""
        weights = self.morph_weights
        return [] if weights is None else [int(target) for target in np.flatnonzero(weights.any(axis=0))]


def draws_of(document: Document, mesh: int, clips: Sequence[Clip]) -> list[tuple[int, int | None]]:
    """Return how nodes draw a mesh: each skin once, with a node if the mesh has morph targets.

    Nodes of one skin are one draw if their targets rest at the same weights and no clip moves them.
    """
    if not document.asset.meshes[mesh].target_count:
        return [(skin, None) for skin in document.asset.skins_of(mesh)]
    morphing = [channel for clip in clips for channel in clip.channels if channel.path == MORPH_WEIGHTS]
    animated = {channel.node for channel in morphing}.union(*{channel.nodes for channel in morphing})
    draws: dict[object, tuple[int, int | None]] = {}
    for node, drawn, skin in document.asset.drawn:
        if drawn == mesh:
            weights = () if node in animated else document.asset.nodes[node].resting_weights().tolist()
            resting = node if node in animated else tuple(weights)
            draws.setdefault((skin, resting), (skin, node))
    return list(draws.values())


def steps_of_looking(clips: Sequence[Clip]) -> int:
    """Return the steps of looking for the clips that move one skin."""
    return sum(3 + 2 * len(clip.channels) for clip in clips)


def moving_clips(document: Document, skin: int, clips: Sequence[Clip], node: int | None = None) -> list[Clip]:
    """Return the clips that move the joints of a skin, or their ancestors, with the channels that do.

    Channels of the morph weights of a node count too.
    """
    skeleton = read_skeleton(document, skin)
    what = f"looking for the clips of skin {skin}"
    document.budget.claim(Work(steps=steps_of_looking(clips)), what, document.place)
    nodes = set(skeleton.nodes)
    found = []
    for clip in clips:  # without the channels of other nodes: 84 skins have 84 times the channels of one
        channels = tuple(
            channel
            for channel in clip.channels
            if (channel.morphs(node) if channel.path == MORPH_WEIGHTS else channel.node in nodes)
        )
        if channels:
            found.append(clip._replace(channels=channels))
    return found


@dataclass(frozen=True)
class PosePlan:
    """The poses of one skin, and of the node that draws a mesh with it, before they are made.

    clips are those that move the skin or the node's weights. resting are the weights (N,) of the node's
    morph targets, None if there is no node or no target.
    """

    skin: int
    skeleton: Skeleton
    clips: tuple[Clip, ...]
    request: PoseRequest
    node: int | None = None
    resting: Float64Array | None = None

    @classmethod
    def of(
        cls, document: Document, skin: int, clips: Sequence[Clip], request: PoseRequest, node: int | None
    ) -> PosePlan:
        """Choose the clips. A clip of the file counts if it moves joints, their ancestors, or the weights."""
        resting = None
        if node is not None:
            resting = document.asset.nodes[node].resting_weights()
            resting = resting if resting.size else None
        morphed = None if resting is None else node
        moving = moving_clips(document, skin, clips, morphed)
        return cls(skin, read_skeleton(document, skin), tuple(moving), request, morphed, resting)

    @cached_property
    def sampled(self) -> Sequence[Clip]:
        """The clips that are sampled; none if random poses replace them, or if the pose is at rest."""
        if self.request.kind is not PoseKind.ANIMATION or not any(
            channel.path != MORPH_WEIGHTS for clip in self.clips for channel in clip.channels
        ):
            return ()
        count, most = len(self.clips), self.request.most
        some = count if most is None else min(count, max(1, most // LEAST_SAMPLES))
        return [self.clips[number * count // some] for number in range(some)]

    @cached_property
    def of_each(self) -> int:
        """The number of poses that are made at a time: all of a clip, or all."""
        clips, most = max(1, len(self.sampled)), self.request.most
        if self.request.kind is PoseKind.REST:
            return 1
        found = self.request.random_count
        if self.sampled:
            found = self.request.samples or max(LEAST_SAMPLES, round(SHARED_SAMPLES / clips))
        return found if most is None else min(found, max(1, most // clips))

    @property
    def count(self) -> int:
        """The number of poses."""
        return self.of_each * max(1, len(self.sampled))

    @property
    def morphs(self) -> bool:
        """Tell whether morph targets may move in the poses."""
        if self.resting is None or self.request.kind is PoseKind.REST:
            return self.resting is not None and bool(self.resting.any())
        return (
            not self.sampled
            or bool(self.resting.any())
            or any(channel.path == MORPH_WEIGHTS for clip in self.sampled for channel in clip.channels)
        )

    def key(self, clip: Clip) -> object:
        """Return what skins and clips have in common whose nodes move alike in the poses.

        The keys of an accessor are one array in all. Morph weights are no transform of a node.
        """
        channels = (
            (channel.node, channel.path, channel.method, id(channel.times), id(channel.values))
            for channel in clip.channels
            if channel.path != MORPH_WEIGHTS
        )
        times = clip.start, clip.duration, self.of_each, self.request.offset
        return self.skeleton.nodes, times, *channels

    def work(self, sampled: Collection[object] = ()) -> Work:
        """Return the steps of making the poses, beside clips that are ``sampled`` by now: their keys."""
        new = {key: clip for clip in self.sampled if (key := self.key(clip)) not in sampled}
        return pose_work(self.skeleton, list(new.values()), self.count)


def pose_work(skeleton: Skeleton, clips: Sequence[Clip], count: int) -> Work:
    """Return the steps of sampling clips for a skeleton, in so many poses in all."""
    channels = sum(len(clip.channels) for clip in clips)
    sampling = Cost.SAMPLED_CLIP * len(clips) + Cost.SAMPLED_CHANNEL * channels
    a_pose = Cost.POSED_NODE * len(skeleton.nodes) + Cost.POSED_JOINT * len(skeleton.joints)
    return sampling + a_pose * count


@once_a_document
def sampled_clips(document: Document) -> dict[object, Float64Array]:
    """Return the transforms (N, P, 4, 4) of nodes in sampled clips, by ``PosePlan.key``.

    Skins of the same joints share them: tools give each mesh a skin of its own, with other inverse bind
    matrices. So do nodes with one skin and other morph weights.
    """
    return {}


def pose_set(
    document: Document, skin: int, clips: Sequence[Clip], request: PoseRequest, node: int | None = None
) -> PoseSet:
    """Return the poses of one skin, with the morph weights of the node that draws a mesh with it, if any.

    Raises InputError as ``planned_poses``.
    """
    return planned_poses(document, PosePlan.of(document, skin, clips, request, node))


def planned_poses(document: Document, plan: PosePlan) -> PoseSet:
    """Return the poses of a plan. If no clip moves joints, random poses replace them.

    Raises InputError if joints go to infinity, or if the poses are too much work or memory for the file.
    """
    skeleton, clips, request = plan.skeleton, plan.sampled, plan.request
    # The steps, and the memory: of the matrices of all nodes for a while, and of the joints to keep.
    channels = max((len(clip.channels) for clip in clips), default=0)
    targets = 0 if plan.resting is None else len(plan.resting)
    budget, place = document.budget, document.place
    joints = f"{counted(plan.count, 'pose')} of {counted(len(skeleton.joints), 'joint')}"
    known = sampled_clips(document)
    budget.claim(plan.work(known), f"skin {plan.skin} in {joints}", place)
    kept = Cost.NODE_TRANSFORM * (len(skeleton.nodes) * plan.of_each)
    budget.claim(kept * len({plan.key(clip) for clip in clips} - known.keys()), joints, place)
    at_a_time = Cost.NODE_MATRIX * len(skeleton.nodes) + Cost.CHANNEL_VALUE * channels
    what = f"{counted(plan.of_each, 'pose')} of {counted(len(skeleton.nodes), 'node')}"
    budget.claim(at_a_time * plan.of_each, what, place, passing=True)
    a_pose = Cost.JOINT_MATRIX * len(skeleton.joints) + Cost.TARGET_WEIGHT * targets
    budget.claim(a_pose * plan.count, joints, place)
    found = [document.asset.nodes[skeleton.nodes[joint]].name for joint in skeleton.joints]
    names = tuple(f'"{name}"' if name else f"joint {number}" for number, name in enumerate(found))
    with np.errstate(over="ignore", invalid="ignore"):  # the result is checked below
        if request.kind is PoseKind.REST:
            weights = None if plan.resting is None else plan.resting[None]
            poses = PoseSet(names, rest_pose(skeleton), ("rest pose",), (None,), weights)
        elif clips:
            poses = _sampled(plan, names, known)
        else:
            weights = None
            if plan.resting is not None:
                weights = random_weights(plan.resting, plan.count, MORPHS_AT_ONCE, request.seed)
            matrices = random_poses(skeleton, plan.count, angle=request.angle, seed=request.seed)
            called = tuple(f"random pose {number}" for number in range(plan.count))
            poses = PoseSet(names, matrices, called, (None,) * plan.count, weights)
    # Every renderer stores float32.
    fits = (np.abs(poses.joint_matrices) <= np.finfo(np.float32).max).all(axis=(2, 3))
    if not fits.all():
        pose, joint = np.argwhere(~fits)[0]
        message = (
            f"in {poses.clips[pose]} the matrix of {names[joint]} of skin {plan.skin} is past all numbers of "
            "float32: mend the scales and translations of its nodes, its inverse bind matrix, or its keys"
        )
        raise InputError(message, place)
    return poses


def _sampled(plan: PosePlan, joint_names: tuple[str, ...], known: dict[object, Float64Array]) -> PoseSet:
    each, offset = plan.of_each, plan.request.offset
    skinned: dict[object, Float64Array] = {}
    matrices, weights, names, times = [], [], [], []
    numbers: list[int | None] = []
    for clip in plan.sampled:
        at = clip.start + (clip.duration - clip.start) * (np.arange(each) + offset) / each
        key = plan.key(clip)
        # Sampling takes the time; a bind pose is one product for each joint.
        if key not in known:
            known[key] = plan.skeleton.transforms(clip_values(clip, at), None, each)
        if key not in skinned:
            skinned[key] = plan.skeleton.bound(known[key])
        matrices.append(skinned[key])
        if plan.node is not None and plan.resting is not None:
            weights.append(clip_weights(plan.node, clip, at, plan.resting))
        names += [clip.name] * each
        times += at.tolist()
        numbers += [clip.number] * each
    morph_weights = np.concatenate(weights) if weights else None
    return PoseSet(
        joint_names, np.concatenate(matrices), tuple(names), tuple(times), morph_weights, tuple(numbers)
    )


def described(request: PoseRequest, sets: Sequence[PoseSet], seconds: float) -> str:
    """Return a description of the poses, like ``60 poses of 3 clips``. seconds is the clips' total length."""
    poses = max((len(poses.clips) for poses in sets), default=0)
    clips = {number for poses in sets for number in poses.numbers}
    if request.kind is PoseKind.REST:
        return "the rest pose"
    if clips:
        return f"{counted(poses, 'pose')} of {counted(len(clips), 'clip')} ({seconds:.3g} s)"
    reason = "" if request.kind is PoseKind.RANDOM else " (no animation moves its joints)"
    return f"{counted(poses, 'random pose')}, joints turned by up to {np.degrees(request.angle):.3g}°{reason}"
