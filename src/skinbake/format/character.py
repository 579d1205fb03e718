"""A character of which several files hold a copy, each with its own clips (``--one-character``).

A weights channel means something only to the targets that it was made for. So each copy gets the same
targets: they are fitted to the clips of all files, in the pose in which the first file stores its nodes.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skinbake.choices import Frame
from skinbake.errors import InputError
from skinbake.files.bounds import Bounds
from skinbake.format.digests import array_digest, digests
from skinbake.format.strip import stripped
from skinbake.gltf.document import Document, read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.reading.accessors import read_attribute
from skinbake.gltf.reading.clips import POINTER_EXTENSION, Clip, read_clips
from skinbake.gltf.reading.meshes import read_primitive, reason_to_skip, skinned_sources
from skinbake.gltf.reading.skins import read_skeleton
from skinbake.gltf.writing.additions import Additions

POSE = "translation", "rotation", "scale", "matrix", "weights"
"""The members of a node that say how it is stored."""


class _Member(NamedTuple):
    """The clips of one file, by its own nodes, and what these are called."""

    file: str
    clips: Sequence[Clip]
    names: dict[int, str]

    @property
    def digest(self) -> str:
        """The digest of all that a clip plays."""
        state = hashlib.sha256()
        for clip in self.clips:
            for channel in clip.channels:
                moved = sorted(self.names[node] for node in channel.nodes or {channel.node})
                how = clip.number, moved, channel.path, channel.method, channel.target, channel.values.shape
                state.update(repr(how).encode())
                for values in (channel.times, channel.values):
                    state.update(np.ascontiguousarray(values, "<f8").tobytes())
        return state.hexdigest()


class Character:
    """The clips of several files that hold the same skinned meshes on the same joints.

    ``files`` are the names of these files. Two objects are equal if all their clips and poses are.
    """

    def __init__(self, files: Iterable[tuple[str, Bounds]]) -> None:
        """Read the files. Those without a skinned mesh do not count: they have no place for weights.

        Raises InputError if a file cannot be read, or holds another character than the first.
        """
        self._members: list[_Member] = []
        self._pose: dict[str, JsonObject] = {}
        first: dict[str, str] = {}
        for path, bounds in files:
            document, _ = stripped(read_document(path, bounds))  # as before any bake
            parts = _parts(document)
            if not parts:
                continue
            names = _names(document)
            if not self._members:
                first = parts
                nodes = document.objects("nodes")
                self._pose = {name: _pose(nodes[number]) for number, name in names.items()}
            differing = [part for part in {**first, **parts} if first.get(part) != parts.get(part)]
            if differing:
                same = f"it does not hold the character of {self._members[0].file} (--one-character)"
                raise InputError(f"{same}: not the same {differing[0]}", document.place)
            self._members.append(_Member(Path(path).name, tuple(read_clips(document)), names))
        self.files = tuple(member.file for member in self._members)

    def __str__(self) -> str:
        """Return the names of the files and a digest: they stand for the clips where options are compared."""
        text = repr([*(member.digest for member in self._members), self._pose])
        return f"{', '.join(self.files)} {hashlib.sha256(text.encode()).hexdigest()[:32]}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Character) and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(str(self))

    def together(self, document: Document) -> tuple[Document, dict[int, int]]:
        """Return the document of one file with the clips of all, and its own ones: their number by the new.

        The clips and the stored pose are the same whichever file it is. Raises InputError if it is none.
        """
        names = _names(document)
        here = _Member("", tuple(read_clips(document)), names).digest
        own = next((member for member in self._members if member.digest == here), None)
        if own is None:
            raise InputError("its clips have changed since the run began", document.place)
        numbers = {name: number for number, name in names.items()}
        additions, animations, known = Additions(document), list[JsonObject](), dict[int, int]()
        for member, clip in ((one, clip) for one in self._members for clip in one.clips):
            samplers, channels = list[JsonObject](), list[JsonObject]()
            for channel in clip.channels:
                moved = {member.names[node] for node in channel.nodes or {channel.node}}
                kind = {"weights": "SCALAR", "rotation": "VEC4"}.get(channel.path, "VEC3")
                values = channel.values[..., [1, 2, 3, 0]] if kind == "VEC4" else channel.values
                for node in sorted(numbers[name] for name in moved & numbers.keys()):
                    target: JsonObject = {"node": node, "path": channel.path}
                    if channel.target is not None:
                        pointer = f"/nodes/{node}/weights/{channel.target}"
                        target = {"path": "pointer", "extensions": {POINTER_EXTENSION: {"pointer": pointer}}}
                    channels.append({"sampler": len(samplers), "target": target})
                samplers.append(
                    {
                        "input": additions.add_floats(channel.times),
                        "output": additions.add_floats(values, kind),
                        "interpolation": channel.method,
                    }
                )
            if channels:
                if member is own:
                    known[len(animations)] = clip.number
                animations.append({"name": clip.name, "samplers": samplers, "channels": channels})
        nodes = []
        for given, name in zip(document.objects("nodes"), names.values(), strict=True):
            other = {key: one for key, one in given.items() if key not in POSE}
            nodes.append({**other, **self._pose.get(name, _pose(given))})
        return additions.applied({"animations": animations, "nodes": nodes}), known


def _names(document: Document) -> dict[int, str]:
    """Return what each node is called: its name if no other node has it, otherwise its number."""
    counts = Counter(node.name for node in document.asset.nodes)
    return {
        node.number: node.name if node.name and counts[node.name] == 1 else f"node {node.number}"
        for node in document.asset.nodes
    }


def _pose(node: JsonObject) -> JsonObject:
    return {key: node[key] for key in POSE if key in node}


def _parts(document: Document) -> dict[str, str]:
    """Return a digest of each array of the skinned meshes, and of the hierarchy of their joints, by name."""
    found: dict[str, str] = {}
    names = _names(document)
    for source in skinned_sources(document):
        if reason_to_skip(document, source, generate_normals=False) is not None:
            continue
        where = source.place.within_file
        primitive = read_primitive(document, source)
        found |= {f"{name} of {where}": one for name, one in digests(primitive, Frame.NORMAL).items()}
        for number, target in enumerate(source.whole_targets):
            for name in target:
                values = read_attribute(document, target, name, source.place.at(name)).decoded()
                found[f"{name} of {where}, target {number}"] = array_digest(values, "<f4")
        found[f"weights of {where}"] = repr(document.asset.meshes[source.mesh].json.get("weights"))
        for number, skin in enumerate(document.asset.skins_of(source.mesh)):
            skeleton = read_skeleton(document, skin)
            joints = [names[node] for node in skeleton.nodes], skeleton.parents, skeleton.joints.tolist()
            bind = array_digest(skeleton.inverse_bind, "<f4")
            found[f"joints of {where}, skin {number}"] = repr(joints)
            found[f"inverse bind matrices of {where}, skin {number}"] = bind
    return found
