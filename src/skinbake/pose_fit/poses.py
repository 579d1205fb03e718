"""The poses to which a bake is fitted: clips of the file itself, clips of other files, and random poses."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from skinbake.choices import PoseKind
from skinbake.errors import ChoiceError, InputError, Notice, Place
from skinbake.geometry.poses import fingerprint, is_fingerprint_of
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, once_a_document, read_document
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, Clip, read_clips
from skinbake.pose_fit.fit import FitPoses
from skinbake.truth.poses import PoseRequest, PoseSet, joint_clips, pose_set
from skinbake.wording import counted

ANIMATIONS, RANDOM = "animations", "random"

CLIP_POSES, LEAST_CLIP_POSES = 61, 3
"""The poses of all clips together, and of each clip at least."""

MOST_LEAST = 1200
"""The poses up to which each clip has its least number: more clips have two poses each, or one."""

BETWEEN = 0.382
"""Where the fit samples a clip: at this share of each of N equal parts.

``verify`` samples from the first moment to the last. It needs a multiple of 500 samples to meet one of these.
"""

RANDOM_POSES, RANDOM_ANGLE, RANDOM_SEED = 60, float(np.radians(45.0)), 2014
"""The random poses that go with clips. A fit to clips alone lights all other poses worse."""

LEAST_RANDOM_POSES = 4
"""The random poses of each skin at least, if no number was asked for."""

CLIP_SHARE = 0.95
"""The share of the clips in the fit. The random poses have the rest."""

MOST_RANDOM = 10_000


class ClipFile:
    """The clips of another file. They move the nodes of a rig that have the same names.

    name is the file's name without its folders. clips are by the file's own nodes, whose names are
    ``node_names``. Two objects are equal if they hold the same keys for the same names.
    """

    def __init__(self, name: str, clips: Sequence[Clip], node_names: dict[int, str]) -> None:
        self.name, self.clips, self.node_names = name, tuple(clips), node_names
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
        return cls(Path(path).name, clips, _node_names(document))

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


@dataclass(frozen=True, slots=True)
class FoundPoses:
    """The poses of one mesh by groups, and their fingerprint."""

    groups: tuple[FitPoses, ...]
    fingerprint: tuple[float, ...]

    def are(self, noted: Sequence[float]) -> bool:
        """Tell whether a fingerprint in the metadata is that of these poses."""
        return is_fingerprint_of(self.fingerprint, noted)


def poses_to_fit(document: Document, mesh: int, sources: Sequence[PoseSource], place: Place) -> FoundPoses:
    """Return the poses of all skins that draw a mesh, and tell what had to be assumed.

    They are made once for all meshes of the same skins. Clips have CLIP_SHARE of the fit if there are any.
    Raises InputError if a clip or a skin is broken, or if the surfaces are too much work for the file.
    """
    document.budget.claim(Cost.FITTED_SURFACE, "fitting it to its poses", place)
    clips: list[Clip] = []
    for source in sources:
        if source == ANIMATIONS:
            clips += read_clips(document)
        elif isinstance(source, ClipFile):
            found_clips, here, moved = source.clips_for(document)
            clips += found_clips
            if here < moved:
                are = "is" if here == 1 else "are"
                nodes = counted(moved, "node")
                message = f"{source.name} moves {nodes} by name; {here} of them {are} in this file"
                document.notices.tell(Notice("fit-poses-unmatched", message, place, moved - here))
    skins = document.asset.skins_of(mesh)
    known = _known_poses(document)
    key = tuple(skins), tuple(map(str, sources))
    if key not in known:
        known[key] = _Poses.of(document, skins, clips, sources)
    found = known[key]
    if not found.has_clips and any(not is_random(one) for one in sources):
        random = f"α/β are fitted to {counted(found.random, 'random pose')}"
        files = [source.name for source in sources if isinstance(source, ClipFile)]
        none = "no clip" if ANIMATIONS in sources or not files else f"no clip of {' or '.join(files)}"
        message = f"{none} moves its joints: {random}{_own_clips(document, skins, sources)}"
        document.notices.tell(Notice("fit-poses-random", message, place))
    return FoundPoses(found.groups, found.fingerprint)


def _own_clips(document: Document, skins: Sequence[int], sources: Sequence[PoseSource]) -> str:
    """Return advice if the clips of the document move the skins, and were not asked for."""
    if ANIMATIONS in sources:
        return ""
    try:
        clips = read_clips(document)
        is_moved = any(joint_clips(document, skin, clips) for skin in skins)
    except InputError:  # broken clips that nobody asked for
        return ""
    return f"; --fit-poses {ANIMATIONS} takes its own clips" if is_moved else ""


@once_a_document
def _known_poses(document: Document) -> dict[object, _Poses]:
    """Return the poses that were made, by the skins and where they come from."""
    return {}


@dataclass(frozen=True, slots=True)
class _Poses:
    """The poses of some skins by groups, their fingerprint, whether clips are among them, random ones."""

    groups: tuple[FitPoses, ...]
    fingerprint: tuple[float, ...]
    has_clips: bool
    random: int

    @classmethod
    def of(
        cls, document: Document, skins: Sequence[int], clips: Sequence[Clip], sources: Sequence[PoseSource]
    ) -> _Poses:
        """Sample the clips that move the skins, and draw random poses."""
        moving = {skin: own for skin in skins if (own := joint_clips(document, skin, clips))}
        count = max(1, sum(map(len, moving.values())))
        each = max(1, min(LEAST_CLIP_POSES, MOST_LEAST // count), CLIP_POSES // count)
        sampled = PoseRequest(samples=each, offset=BETWEEN)
        by_clips = [pose_set(document, skin, own, sampled) for skin, own in moving.items()]
        at_random = [
            pose_set(document, skin, (), PoseRequest(PoseKind.RANDOM, count, RANDOM_ANGLE, RANDOM_SEED))
            for skin, count in zip(skins, _random_counts(sources, len(skins)), strict=True)
            if count
        ]
        share = CLIP_SHARE if by_clips else 0.0
        joints = max(poses.joint_matrices.shape[1] for poses in [*by_clips, *at_random])
        parts = ((by_clips, share), (at_random, 1.0 - share))
        groups = tuple(_group(sets, joints, part) for sets, part in parts if sets)
        random = sum(len(poses.clips) for poses in at_random)
        prints = fingerprint([group.joint_matrices for group in groups])
        return cls(groups, prints, bool(by_clips), random)


def _random_counts(sources: Sequence[PoseSource], skins: int) -> list[int]:
    """Return the number of random poses of each skin: in all as many as asked for."""
    asked = [int(str(one).partition(":")[2]) for one in sources if is_random(one)]
    if not asked:
        return [max(LEAST_RANDOM_POSES, RANDOM_POSES // skins)] * skins
    each, left = divmod(max(asked), skins)
    return [each + (number < left) for number in range(skins)]


def is_random(source: PoseSource) -> bool:
    """Tell whether a source stands for random poses."""
    return isinstance(source, str) and source.startswith(f"{RANDOM}:")


def _group(sets: Sequence[PoseSet], joints: int, share: float) -> FitPoses:
    """Join sets of poses of so many joints. Joints that a set lacks stay at rest."""
    matrices = []
    for poses in sets:
        wide = np.broadcast_to(np.eye(4), (len(poses.joint_matrices), joints, 4, 4)).copy()
        wide[:, : poses.joint_matrices.shape[1]] = poses.joint_matrices
        matrices.append(wide)
    return FitPoses(np.concatenate(matrices), share)
