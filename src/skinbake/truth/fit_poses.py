"""The poses to which a bake is fitted: clips of the file itself, clips of other files, and random poses."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from skinbake.choices import PoseKind
from skinbake.errors import BudgetError, ChoiceError, InputError, Notice
from skinbake.geometry.rig import Rig
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, once_a_document, read_document
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, Clip, read_clips
from skinbake.gltf.reading.skins import fitting_rig, read_skeleton
from skinbake.truth.poses import PosePlan, PoseRequest, moving_clips, planned_poses, pose_set
from skinbake.wording import counted

ANIMATIONS, RANDOM = "animations", "random"

CLIP_POSES = 3
"""The poses of all clips together: with the stored pose four, which are fitted at a time.

With 11, the error of seventeen characters in their clips is 0.4 % less in the mean, and by random poses of
±30° it is 0.2 % more. With 24 it is the same as with 11.
"""

BETWEEN = 0.382
"""Where the fit samples a clip: at this share of each of N equal parts, so never at its ends."""

RANDOM_ANGLE, RANDOM_SEED = float(np.radians(45.0)), 2014
"""By how much joints turn in random poses, at most."""

MOST_RANDOM = 1_000


class ClipFile:
    """The clips of another file. They move the nodes of a rig that have the same names.

    path names the file; name is its name without its folders. clips are by the file's own nodes, whose
    names are ``node_names``. Two objects are equal if they hold the same keys for the same names.
    """

    def __init__(self, path: str, clips: Sequence[Clip], node_names: dict[int, str]) -> None:
        self.path, self.name = path, Path(path).name
        self.clips, self.node_names = tuple(clips), node_names
        state = hashlib.sha256()
        for clip in self.clips:
            for channel in clip.channels:
                node = repr(node_names.get(channel.node))
                state.update(repr((node, channel.path, channel.method, channel.values.shape)).encode())
                for values in (channel.times, channel.values):
                    state.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        self.digest = state.hexdigest()[:32]

    @classmethod
    def read(cls, path: str) -> ClipFile:
        """Read the clips of a file. Raises InputError if it cannot be read, or has no clip."""
        document = read_document(path)
        clips = [
            clip._replace(channels=moving)
            for clip in read_clips(document)
            if (moving := tuple(channel for channel in clip.channels if channel.path != MORPH_WEIGHTS))
        ]
        if not clips:
            raise InputError("it has no animation that moves a node", document.place)
        return cls(path, clips, _node_names(document))

    def __str__(self) -> str:
        """Return the name and the digest, which stand for the clips where options are compared."""
        return f"{self.name} {self.digest}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ClipFile) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(str(self))

    def clips_for(self, document: Document) -> tuple[list[Clip], int, int]:
        """Return the clips by the nodes of a document, and how many of the moved nodes it has, of how many.

        A name that several nodes of either file share moves nothing.
        """
        ours = {name: node for node, name in _node_names(document).items()}
        moved = {channel.node for clip in self.clips for channel in clip.channels}
        found = {node: ours[name] for node in moved if (name := self.node_names.get(node)) in ours}
        clips = [
            clip._replace(
                channels=tuple(
                    channel._replace(node=found[channel.node])
                    for channel in clip.channels
                    if channel.node in found
                ),
            )
            for clip in self.clips
        ]
        return [clip for clip in clips if clip.channels], len(found), len(moved)


def _node_names(document: Document) -> dict[int, str]:
    """Return the names of the nodes that have a name for themselves."""
    counts = Counter(node.name for node in document.asset.nodes)
    return {node.number: node.name for node in document.asset.nodes if counts[node.name] == 1}


PoseSource: TypeAlias = "str | ClipFile"
"""``animations``, ``random:N``, or the clips of another file."""


def pose_source(value: PoseSource) -> PoseSource:
    """Return what a value of ``--fit-poses`` stands for. Raises ChoiceError, and InputError for a file."""
    if isinstance(value, ClipFile):
        return value
    if not isinstance(value, str):
        raise ChoiceError("fit_poses", value, "a list of names")
    if value in {ANIMATIONS, PoseKind.ANIMATION}:
        return ANIMATIONS
    kind, colon, count = value.partition(":")
    if kind != RANDOM and Path(value).suffix:
        # An error says that the file is that of the option, not an input.
        try:
            return ClipFile.read(value)
        except InputError as error:
            raise InputError(f"--fit-poses: {error.message}", error.place) from error
    if kind != RANDOM or not colon or not count.isdecimal() or not 1 <= int(count) <= MOST_RANDOM:
        expected = (
            f"{RANDOM}:N with N from 1 to {MOST_RANDOM:,}, {ANIMATIONS}, or a .glb, .gltf or .vrm file with "
            "animations"
        )
        raise ChoiceError("fit_poses", value, expected)
    return f"{RANDOM}:{int(count)}"


def posed_rig(document: Document, source: PrimitiveSource, sources: Sequence[PoseSource]) -> Rig | None:
    """Return the rig of the skin that draws a primitive with the poses to fit it to; None as ``fitting_rig``.

    These are the poses of the sources, those of the file's own clips if there are none, and the pose in which
    the nodes are stored. Tells what had to be assumed. Raises InputError if a named source is broken, or if
    the poses are too much work for the file.
    """
    rig = fitting_rig(document, source)
    if rig is None:
        return None
    try:
        poses = _poses(document, source, sources or (ANIMATIONS,))
    except BudgetError:
        raise
    except InputError as error:
        if sources:
            raise
        message = f"its clips cannot be read ({error.message}): α/β are fitted to turns of its joints alone"
        document.notices.tell(Notice("fit-poses-unread", message, source.place))
        return rig
    if not len(poses):
        if not sources:
            return rig
        files = [one.name for one in sources if isinstance(one, ClipFile)]
        none = f"no clip of {' or '.join(files)}" if files and ANIMATIONS not in sources else "no clip"
        message = f"{none} moves its joints: α/β are fitted to turns of its joints alone"
        document.notices.tell(Notice("fit-poses-none", message, source.place))
        return rig
    # Joints that a skin lacks are its first one, as in a replay.
    joints = np.arange(len(rig.parents))
    named = np.where(joints < poses.shape[1], joints, 0)
    # In float32, as engines have them: the last digits of an angle's sine depend on the processor.
    found = np.concatenate([poses[:, named], rig.poses]).astype(np.float32)
    return replace(rig, poses=found.astype(np.float64))


def _poses(document: Document, source: PrimitiveSource, sources: Sequence[PoseSource]) -> Float64Array:
    """Return the joint matrices (P, J, 3, 4) of some sources, of all skins that draw the mesh."""
    document.budget.claim(Cost.FITTED_SURFACE, "fitting it to its poses", source.place)
    for one in sources:
        if isinstance(one, ClipFile):
            _, here, moved = one.clips_for(document)
            if here < moved:
                are = "is" if here == 1 else "are"
                nodes = counted(moved, "node")
                message = f"{one.name} moves {nodes} by name; {here} of them {are} in this file"
                document.notices.tell(Notice("fit-poses-unmatched", message, source.place, moved - here))
    return _poses_of_skins(document, tuple(document.asset.skins_of(source.mesh)), tuple(sources))


@once_a_document
def _poses_of_skins(
    document: Document, skins: tuple[int, ...], sources: tuple[PoseSource, ...]
) -> Float64Array:
    """Return the joint matrices (P, J, 3, 4) of some skins. They are made once for all their meshes."""
    clips: list[Clip] = []
    for one in sources:
        clips += read_clips(document) if one == ANIMATIONS else ()
        clips += one.clips_for(document)[0] if isinstance(one, ClipFile) else ()
    pairs = [(skin, clip) for skin in skins for clip in moving_clips(document, skin, clips)]
    # Of many clips some have a pose, evenly spread. Few clips have the same number, and some of these poses
    # go.
    some = pairs if len(pairs) <= CLIP_POSES else [pairs[n] for n in _spread(len(pairs), CLIP_POSES)]
    request = PoseRequest(samples=-(-CLIP_POSES // max(1, len(some))), offset=BETWEEN)
    plans = [PosePlan(skin, read_skeleton(document, skin), (clip,), request) for skin, clip in some]
    sets = [planned_poses(document, plan).joint_matrices for plan in plans]
    taken = _spread(sum(map(len, sets)), CLIP_POSES)
    # As many random poses as are asked for, which the skins share.
    count = max((int(str(one).partition(":")[2]) for one in sources if is_random(one)), default=0)
    each, left = divmod(count, max(1, len(skins)))
    for number, skin in enumerate(skins):
        if each + (number < left):
            turned = PoseRequest(PoseKind.RANDOM, each + (number < left), RANDOM_ANGLE, RANDOM_SEED)
            start = sum(map(len, sets))
            sets.append(pose_set(document, skin, (), turned).joint_matrices)
            taken += range(start, start + len(sets[-1]))
    joints = max((own.shape[1] for own in sets), default=0)
    wide = [own[:, [*range(own.shape[1]), *[0] * (joints - own.shape[1])], :3] for own in sets]
    return np.concatenate([*wide, np.empty((0, joints, 3, 4))])[taken]


def _spread(every: int, some: int) -> list[int]:
    """Return some of so many numbers, evenly spread; all if these are fewer."""
    some = min(some, every)
    return [(2 * number + 1) * every // (2 * some) for number in range(some)]


def is_random(source: PoseSource) -> bool:
    """Tell whether a source stands for random poses."""
    return isinstance(source, str) and source.startswith(f"{RANDOM}:")
