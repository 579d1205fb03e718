"""Which poses a file's lighting is measured over: its own animations, random ones, or the rest pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skinbake.errors import InputError
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.animation import Clip, Skeleton, clip_poses, random_poses, read_skeleton, rest_pose
from skinbake.gltf.document import Document

SHARED_SAMPLES = 60
"""Poses that a file's clips share where no number is given, at least 3 each."""

FALLBACK_POSES = 24
"""Random poses of a file that has no animation."""


@dataclass(frozen=True, slots=True)
class PoseRequest:
    """What was asked for: kind is ``animation``, ``random`` or ``rest``.

    samples is how many times each clip is sampled (None: SHARED_SAMPLES for all) or how many random poses
    there are; angle the largest random rotation of a joint, in radians.
    """

    kind: str = "animation"
    samples: int | None = None
    angle: float = float(np.radians(30.0))
    seed: int = 0


@dataclass(frozen=True, slots=True)
class PoseSet:
    """Joint matrices (P, J, 4, 4) of one skin, with each pose's clip and time in seconds (None: no clip).

    joint_names (J,) are for messages.
    """

    joint_names: tuple[str, ...]
    joint_matrices: Float64Array
    clips: tuple[str, ...]
    times: tuple[float | None, ...]


def skins_of(document: Document, mesh: int) -> list[int]:
    """Return the skins that nodes draw a mesh with, in the nodes' order."""
    # Some exporters write 3.0; that they are indices was seen when the primitives were read.
    skins = {
        int(node["skin"]): None
        for node in document.objects("nodes")
        if node.get("mesh") == mesh and "skin" in node
    }
    return list(skins)


def pose_set(document: Document, skin: int, clips: Sequence[Clip], request: PoseRequest) -> PoseSet:
    """Return the poses of one skin; InputError where its joints go to infinity.

    Of the file's clips those count that move the skin's joints or their ancestors. A file or skin without
    any gets random poses instead of none.
    """
    skeleton = read_skeleton(document, skin)
    names = _joint_names(document, skeleton)
    moving = [clip for clip in (_only(set(skeleton.nodes), clip) for clip in clips) if clip.channels]
    if request.kind == "rest":
        poses = PoseSet(names, rest_pose(skeleton), ("rest pose",), (None,))
    elif request.kind == "animation" and moving:
        poses = _sampled(skeleton, moving, request.samples, names)
    else:
        poses = _random(skeleton, request, names)
    if not np.isfinite(poses.joint_matrices).all():
        raise InputError(f"the joints of skin {skin} do not have finite transforms", document.place)
    return poses


def _only(nodes: set[int], clip: Clip) -> Clip:
    """Return a clip without the channels of other nodes: a file of 84 skins has 84 times those of one."""
    return replace(clip, channels=tuple(channel for channel in clip.channels if channel.node in nodes))


def _joint_names(document: Document, skeleton: Skeleton) -> tuple[str, ...]:
    nodes = document.objects("nodes")
    found = [nodes[skeleton.nodes[joint]].get("name") for joint in skeleton.joints]
    return tuple(f'"{name}"' if name else f"joint {number}" for number, name in enumerate(found))


def _sampled(
    skeleton: Skeleton, clips: Sequence[Clip], samples: int | None, joint_names: tuple[str, ...]
) -> PoseSet:
    each = samples or max(3, round(SHARED_SAMPLES / len(clips)))
    matrices, names, times = [], [], []
    for clip in clips:
        at = np.linspace(clip.start, clip.duration, each)
        matrices.append(clip_poses(skeleton, clip, at))
        names += [clip.name] * each
        times += at.tolist()
    return PoseSet(joint_names, np.concatenate(matrices), tuple(names), tuple(times))


def _random(skeleton: Skeleton, request: PoseRequest, joint_names: tuple[str, ...]) -> PoseSet:
    count = (request.samples if request.kind == "random" else None) or FALLBACK_POSES
    matrices = random_poses(skeleton, count, angle=request.angle, seed=request.seed)
    return PoseSet(
        joint_names, matrices, tuple(f"random pose {number}" for number in range(count)), (None,) * count
    )


def described(request: PoseRequest, sets: Sequence[PoseSet], seconds: float) -> str:
    """Return what the poses are, like ``60 poses of 3 clips``; seconds is the clips' total length."""
    poses = max((len(poses.clips) for poses in sets), default=0)
    clips = {
        clip
        for poses in sets
        for clip, time in zip(poses.clips, poses.times, strict=True)
        if time is not None
    }
    if request.kind == "rest":
        return "the rest pose"
    if clips:
        return f"{poses} poses of {len(clips)} clip{'s' if len(clips) > 1 else ''} ({seconds:.3g} s)"
    reason = "" if request.kind == "random" else " (no animation moves its joints)"
    return f"{poses} random poses, joints turned by up to {np.degrees(request.angle):.3g}°{reason}"
