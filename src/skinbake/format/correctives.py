"""Write correctives into a document: morph targets of normals, and the weights that clips play.

What engines need of a file that has them (docs/correctives.md):

- Once one target of a primitive has NORMAL, every target has one, and likewise POSITION. Some loaders take
  the base mesh for a difference where a target lacks what others have. A target that moves nothing has an
  accessor without a buffer view: zeros, without a byte.
- All primitives of a mesh have the same number of targets, also those that are not corrected.
- The targets and weights that are there come first, and keep their values.
- A clip that moves the skin and has no correctives plays zeros, because players keep the last value.
- One sampler holds the weights of all targets of a node (glTF 2.0, §3.11). So what a file animates already
  and the correctives get keys at the union of their times (``with_correctives``).

The note of the mesh says what was added, so that ``strip`` takes it out again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from skinbake.choices import CorrectiveAim, Encoding, Frame
from skinbake.errors import InputError, Place, UnsupportedFeatureError
from skinbake.format.digests import digests, unordered_digest
from skinbake.format.encodings import DTYPES, LARGEST
from skinbake.format.morph_targets import add_differences, add_zeros
from skinbake.format.note import (
    GENERATOR,
    KEY,
    VERSION,
    CorrectedPrimitive,
    CorrectiveNote,
    corrective_notes,
    morph_note,
)
from skinbake.geometry import poses
from skinbake.geometry.skinned import Float32Array, Float64Array, FloatArray, SkinnedPrimitive
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import (
    JsonObject,
    object_of,
    objects,
    reference,
)
from skinbake.gltf.reading.accessors import StoredArray, read_accessor
from skinbake.gltf.reading.clips import (
    MESH_POINTER,
    MORPH_WEIGHTS,
    POINTER,
    POINTER_EXTENSION,
    clip_weights,
    read_clips,
)
from skinbake.gltf.writing.additions import Additions

QUANTIZATION = "KHR_mesh_quantization"

TARGET_NAMES = "targetNames"

CUBIC_PIECES = 8
"""The straight pieces that follow a cubic one of a pointer to a weight."""


@dataclass(frozen=True, slots=True)
class ClipWeights:
    """The weights (N, K) of a mesh's targets at times (N,), float32, in one animation for some nodes."""

    animation: int
    nodes: Sequence[int]
    times: Float32Array
    weights: Float32Array


@dataclass(frozen=True, slots=True)
class MeshCorrectives:
    """The correctives of one mesh: targets (K, V, 3) of the normals of each of its sources, and clips.

    primitives are the arrays of the sources, for their digests. aim is what they were fitted to, playing are
    the names of the clips that play them, and character those of the files that have the same targets: people
    read them in the note.
    """

    mesh: int
    sources: Sequence[PrimitiveSource]
    primitives: Sequence[SkinnedPrimitive]
    targets: Sequence[Float64Array]
    clips: Sequence[ClipWeights]
    aim: CorrectiveAim
    playing: Sequence[str]
    character: Sequence[str] = ()

    @property
    def count(self) -> int:
        """The number of targets."""
        return len(self.targets[0])


def nodes_with(document: Document, mesh: int, skin: int | None = None) -> list[int]:
    """Return the nodes that draw a mesh: all, or those with a skin. All nodes are read once."""
    return _nodes_by_mesh(document).get(mesh if skin is None else (mesh, skin), [])


@once_a_document
def _nodes_by_mesh(document: Document) -> dict[object, list[int]]:
    """Return the nodes by the mesh that they draw, and by mesh and skin."""
    found: dict[object, list[int]] = {}
    for number, node in enumerate(document.objects("nodes")):
        drawn = reference(node.get("mesh"))
        if drawn is not None:
            found.setdefault(drawn, []).append(number)
            found.setdefault((drawn, reference(node.get("skin"))), []).append(number)
    return found


def check_targets(document: Document, mesh: int, place: Place) -> None:
    """Raise UnsupportedFeatureError if a mesh cannot get correctives: its clips or extras leave no place."""
    content = document.objects("meshes")[mesh]
    if not isinstance(content.get("extras", {}), dict):
        message = '"extras" of its mesh are not an object, so there is no place for targetNames and metadata'
        raise UnsupportedFeatureError(message, place)
    moved, nodes = _moved_weights(document), set(nodes_with(document, mesh))
    if mesh in moved.meshes or nodes & moved.pointed:
        message = (
            f"all its morph weights are animated through one pointer of {POINTER_EXTENSION}, which "
            "correctives cannot be merged with: animate them by a channel of the path weights"
        )
        raise UnsupportedFeatureError(message, place)
    if twice := nodes & moved.twice.keys():
        node = min(twice)
        message = (
            f"animation {moved.twice[node]} has two channels for the morph weights of node {node}, and may "
            "have one: remove the other"
        )
        raise InputError(message, place)


class _MovedWeights(NamedTuple):
    """What animations move the morph weights of.

    channels are the channels of nodes by animation. twice are the nodes with two in one, with its number.
    pointed and meshes are nodes and meshes whose weights all move through one pointer.
    """

    channels: list[dict[int, int]]
    twice: dict[int, int]
    pointed: set[int]
    meshes: set[int]


@once_a_document
def _moved_weights(document: Document) -> _MovedWeights:
    found = _MovedWeights([], {}, set(), set())
    for number, animation in enumerate(document.objects("animations")):
        channels: dict[int, int] = {}
        for position, channel in enumerate(objects(animation, "channels", document.place)):
            target = object_of(channel.get("target"))
            node = reference(target.get("node"))
            is_weights = target.get("path") == MORPH_WEIGHTS
            if is_weights and node is not None and channels.setdefault(node, position) != position:
                found.twice[node] = number
            extension = object_of(object_of(target.get("extensions")).get(POINTER_EXTENSION))
            pointer = str(extension.get("pointer", ""))
            of_node, of_mesh = POINTER.fullmatch(pointer), MESH_POINTER.fullmatch(pointer)
            if of_node and of_node[3] and not of_node[4]:
                found.pointed.add(int(of_node[1]))
            if of_mesh and not of_mesh[2]:
                found.meshes.add(int(of_mesh[1]))
        found.channels.append(channels)
    return found


def with_mesh_correctives(
    document: Document, items: Sequence[MeshCorrectives], encoding: Encoding
) -> tuple[Document, list[int]]:
    """Return the document with correctives, and the added bytes by mesh.

    The document holds no bake. Raises InputError if targets or weights of the file are broken.
    """
    additions = Additions(document, note_key=KEY)
    meshes, nodes = list(document.objects("meshes")), list(document.objects("nodes"))
    animations = [dict(animation) for animation in document.objects("animations")]
    # Normalised integers need the extension.
    lists = ("extensionsUsed", "extensionsRequired") if encoding.is_scaled else ()
    lacking = [key for key in lists if QUANTIZATION not in document.json.get(key, [])]
    lengths = []
    for item in items:
        before = additions.byte_length
        meshes[item.mesh] = _corrected(document, additions, item, animations, encoding, lacking)
        for number in nodes_with(document, item.mesh):
            if nodes[number].get("weights") is not None:
                nodes[number] = {**nodes[number], "weights": [*nodes[number]["weights"], *[0] * item.count]}
        lengths.append(additions.byte_length - before)
    changes: dict[str, Any] = {"meshes": meshes, "nodes": nodes, "animations": animations}
    changes |= {key: [*document.json.get(key, []), QUANTIZATION] for key in lacking}
    return additions.applied(changes), lengths


def _corrected(
    document: Document,
    additions: Additions,
    item: MeshCorrectives,
    animations: list[JsonObject],
    encoding: Encoding,
    lacking: Sequence[str],
) -> JsonObject:
    """Return the JSON of a mesh with targets, weights, names of targets, and a note, and change animations.

    lacking are the lists of extensions that KHR_mesh_quantization is added to.
    """
    mesh = document.objects("meshes")[item.mesh]
    there, place = document.asset.meshes[item.mesh].target_count, item.sources[0].place
    channels, samplers = _add_clips(document, additions, item, animations, there)
    of_sources = {source.primitive: number for number, source in enumerate(item.sources)}
    primitives, noted = [], []
    for position, primitive in enumerate(objects(mesh, "primitives", place)):
        number = of_sources.get(position)
        own = None if number is None else item.targets[number]
        changed, filled = _with_own(document, additions, primitive, (there, item.count), own, encoding)
        entry = CorrectedPrimitive(filled=filled)
        if number is not None and own is not None:
            stored = item.primitives[number]
            decoded = StoredArray(stored_targets(own, encoding), encoding.is_scaled).decoded()
            targets = corrective_digest(stored, decoded)
            entry = entry._replace(digest=digests(stored, Frame.NORMAL), targets=targets)
        primitives.append(changed)
        noted.append(entry)
    names = object_of(mesh.get("extras")).get(TARGET_NAMES)
    extras = dict(object_of(mesh.get("extras")))
    if there == 0 or (isinstance(names, list) and len(names) == there):
        ours = [f"corrective normal {number + 1}" for number in range(item.count)]
        extras[TARGET_NAMES] = [*(names if isinstance(names, list) and there else []), *ours]
    made = morph_note(mesh)  # what bake has made for the file's own targets
    note = CorrectiveNote(
        version=VERSION,
        generator=GENERATOR,
        targets=item.count,
        aim=item.aim,
        clips=tuple(item.playing),
        character=tuple(item.character),
        channels=channels,
        samplers=samplers,
        primitives=tuple(noted),
        former=tuple(key for key in ("weights", "extras") if key in mesh),
        names=TARGET_NAMES in object_of(mesh.get("extras")),
        former_names=names if there == 0 else None,
        encoding=encoding,
        required=tuple(lacking) if encoding.is_scaled else None,
        morph_targets=made.morph_targets if made else (),
        keep_extras=bool(made and made.keep_extras),
    )
    weights = [*mesh.get("weights", [0] * there), *[0] * item.count]
    extras[KEY] = note.as_json()
    return {**mesh, "primitives": primitives, "weights": weights, "extras": extras}


def with_plays(document: Document, plays: Mapping[int, Sequence[tuple[float, ...]]]) -> Document:
    """Return the document with notes of what clips play, by mesh, by which ``verify`` knows them again."""
    meshes = list(document.objects("meshes"))
    for number, rows in plays.items():
        mesh, note = meshes[number], corrective_notes(document)[number]
        extras = {**mesh["extras"], KEY: note._replace(plays=tuple(rows)).as_json()}
        meshes[number] = {**mesh, "extras": extras}
    return document.edited(json={**document.json, "meshes": meshes})


def corrective_digest(primitive: SkinnedPrimitive, targets: FloatArray) -> str:
    """Return the digest of targets (K, V, 3), as renderers read them, on the surface that they correct.

    The order of vertices and triangles does not count, nor do copies of a vertex: tools change both.
    """
    every = np.arange(len(primitive.positions))
    joints = primitive.joints if primitive.stored_joints is None else primitive.stored_joints
    arrays = (primitive.positions, primitive.normals, joints, primitive.weights, *targets)
    return unordered_digest(primitive, [(part, every, values) for part, values in enumerate(arrays)])


def stored_targets(targets: Float64Array, encoding: Encoding) -> npt.NDArray[Any]:
    """Return targets as numbers of an encoding. Integers are normalised."""
    if not encoding.is_scaled:
        return targets.astype(np.float32)
    most = LARGEST[encoding]
    return np.clip(np.rint(targets * most), -most, most).astype(DTYPES[encoding])


def _with_own(
    document: Document,
    additions: Additions,
    primitive: JsonObject,
    counts: tuple[int, int],
    targets: Float64Array | None,
    encoding: Encoding,
) -> tuple[JsonObject, dict[str, tuple[int, ...]]]:
    """Return the JSON of a primitive with targets behind its own, and what its own ones were filled with.

    counts are the targets of the mesh before, and the added ones. Zeros are added wherever a target lacks
    what another one has. The second value names the targets by attribute.
    """
    there, added = counts
    place = document.place
    attributes = object_of(primitive.get("attributes"))
    base = reference(attributes.get("POSITION"))
    if base is None:
        raise InputError("one of its primitives has no POSITION, so it cannot have morph targets", place)
    count = document.asset.accessors[base].count(place)
    own = objects(primitive, "targets", place)
    if len(own) != there:  # a mesh of which some primitives have no targets
        own = [{} for _ in range(there)]
    names = dict.fromkeys(["POSITION", *(["NORMAL"] if "NORMAL" in attributes else [])])
    names |= dict.fromkeys(name for target in own for name in target)
    kinds = dict.fromkeys(names, "VEC3")
    for target in own:
        for name, number in target.items():
            kinds[name] = str(document.objects("accessors")[int(number)].get("type"))

    def zeros(wanted: Iterable[str]) -> JsonObject:
        return {name: add_zeros(additions, count, kinds[name], bounded=name == "POSITION") for name in wanted}

    filled: dict[str, list[int]] = {}
    complete = []
    for number, target in enumerate(own):
        lacking = [name for name in ("POSITION", "NORMAL") if name in names and name not in target]
        for name in lacking:
            filled.setdefault(name, []).append(number)
        complete.append({**target, **zeros(lacking)} if lacking else target)
    stored = None if targets is None or "NORMAL" not in names else stored_targets(targets, encoding)
    for number in range(added):
        normal = {}
        if stored is not None and stored[number].any():
            normal["NORMAL"] = add_differences(additions, stored[number], normalized=encoding.is_scaled)
        complete.append({**zeros(name for name in names if name not in normal), **normal})
    return {**primitive, "targets": complete}, {name: tuple(numbers) for name, numbers in filled.items()}


def _add_clips(
    document: Document,
    additions: Additions,
    item: MeshCorrectives,
    animations: list[JsonObject],
    there: int,
) -> tuple[tuple[tuple[int, int, int | None], ...], tuple[tuple[int, int], ...]]:
    """Add the weights of a mesh's targets to animations; return channels and samplers of ``CorrectiveNote``.

    A channel of weights that is there gets a sampler with more weights; otherwise one is added.
    """
    place = item.sources[0].place
    changed: list[tuple[int, int, int | None]] = []
    before: dict[int, int] = {}
    moved = _moved_weights(document).channels
    of_clip = {(clip.animation, node): clip for clip in item.clips for node in clip.nodes}
    # A node has no skin where it stands still: it has no clips.
    skins = {
        node: reference(document.objects("nodes")[node].get("skin"))
        for node in nodes_with(document, item.mesh)
    }
    for number in range(len(animations)):
        animation = animations[number]
        channels, samplers = list(animation.get("channels", [])), list(animation.get("samplers", []))
        count = len(samplers)
        shared: dict[int | None, int] = {}
        for node, skin in skins.items():
            clip = of_clip.get((number, node))
            position = moved[number].get(node)
            if clip is None and position is None:
                continue
            sampler = shared.get(skin) if position is None and not there else None
            if sampler is None:
                own = None if position is None else samplers[int(channels[position]["sampler"])]
                keys = _keys(document, own, clip, (node, there, item.count), place)
                sampler = len(samplers)
                samplers.append(
                    {
                        "input": additions.add_floats(
                            keys.times, min=[float(keys.times.min())], max=[float(keys.times.max())]
                        ),
                        "output": additions.add_floats(keys.values),
                        "interpolation": keys.method,
                    }
                )
                shared[skin] = sampler
            if position is None:
                changed.append((number, len(channels), None))
                channels.append({"sampler": sampler, "target": {"node": node, "path": MORPH_WEIGHTS}})
            else:
                changed.append((number, position, channels[position]["sampler"]))
                channels[position] = {**channels[position], "sampler": sampler}
        if len(samplers) > count:
            before[number] = count
            animations[number] = {**animation, "channels": channels, "samplers": samplers}
    return tuple(changed), tuple(before.items())


def _keys(
    document: Document,
    sampler: JsonObject | None,
    clip: ClipWeights | None,
    of_node: tuple[int, int, int],
    place: Place,
) -> Keys:
    """Return the keys of all weights of a node: those of a sampler, or its weights at rest, then correctives.

    of_node are the node, the number of targets before, and the added ones. Without a clip, these are 0. What
    moves single weights through pointers stays, and the keys have the same values, for players that read no
    pointers. A cubic curve is followed by straight pieces.
    """
    node, there, added = of_node
    if sampler is None:
        assert clip is not None
        (whole,) = read_clips(document, [clip.animation]) if there else (None,)
        at = clip.times.astype(np.float64)
        for channel in whole.channels if whole else ():
            if channel.morphs(node):
                held = np.nextafter(channel.times[1:].astype(np.float32), np.float32(-np.inf))
                keys = np.arange(CUBIC_PIECES * (len(channel.times) - 1)) / CUBIC_PIECES
                cubic = np.interp(keys, np.arange(len(channel.times)), channel.times)
                further = {poses.STEP: held, poses.CUBICSPLINE: cubic}.get(channel.method, held[:0])
                at = np.unique(np.concatenate([at, channel.times, further]).astype(np.float32)).astype(float)
        former = np.broadcast_to(document.asset.nodes[node].resting_weights(), (len(at), there))
        former = former if whole is None else clip_weights(node, whole, at, former[0])
        own = Keys(at.astype(np.float32), former.astype(np.float32), poses.LINEAR)
        return with_correctives(own, clip.times, clip.weights)
    method = str(sampler.get("interpolation", poses.LINEAR))
    times = read_accessor(document, int(sampler["input"]), place).decoded()[:, 0].astype(np.float32)
    values = read_accessor(document, int(sampler["output"]), place).decoded().astype(np.float32)
    each = 3 if method == poses.CUBICSPLINE else 1
    if values.size != len(times) * each * there:
        raise InputError(f"the weights of node {node} do not fit its {there} morph targets", place)
    shape = (len(times), 3, there) if each == 3 else (len(times), there)
    own = Keys(times, values.reshape(shape), method)
    if clip is None:
        ends = times[[0, -1]] if len(times) > 1 else times[:1]
        return with_correctives(own, ends, np.zeros((len(ends), added), dtype=np.float32))
    return with_correctives(own, clip.times, clip.weights)


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of a sampler: times (N,), values (N, T), or (N, 3, T) for CUBICSPLINE, and the method."""

    times: Float32Array
    values: Float32Array
    method: str


def with_correctives(there: Keys, times: Float32Array, weights: Float32Array) -> Keys:
    """Return keys for all targets: those that are there, then correctives of weights (M, K) at times (M,).

    LINEAR stays LINEAR: the values between two keys are the same with further keys on the line. CUBICSPLINE
    stays CUBICSPLINE: a cubic piece is cut into two with the same values and slopes, and each straight piece
    of the correctives is a cubic piece with one slope. STEP becomes LINEAR, with the former value held until
    the last float before each key. Where there are no correctives before their first or after their last key,
    the value stays.
    """
    own, kept = there.times.astype(np.float64), np.append(np.diff(there.times) > 0, True)
    union = np.union1d(there.times, times).astype(np.float32)
    if there.method == poses.STEP:
        held = np.nextafter(there.times[1:], np.float32(-np.inf))
        union = np.union1d(union, held[held >= there.times[0]]).astype(np.float32)
    at = union.astype(np.float64)
    straight = [np.interp(at, times, column) for column in weights.T.astype(np.float64)]
    ours = np.stack(straight, axis=1).astype(np.float32)
    former = there.values.astype(np.float64)
    if there.method != poses.CUBICSPLINE:
        found = poses.interpolated(own, former, at, method=there.method, rotation=False).astype(np.float32)
        # Keys that are there keep their bits. Of two at one time, the last counts from there on.
        found[np.searchsorted(union, there.times[kept])] = there.values[kept]
        return Keys(union, np.concatenate([found, ours], axis=1), poses.LINEAR)
    cubic = np.zeros((len(union), 3, former.shape[2] + ours.shape[1]), dtype=np.float32)
    cubic[:, 1, former.shape[2] :] = ours
    slopes = np.diff(ours, axis=0) / np.diff(at)[:, None]
    cubic[1:, 0, former.shape[2] :] = slopes
    cubic[:-1, 2, former.shape[2] :] = slopes
    values = poses.interpolated(own, former, at, method=there.method, rotation=False)
    # The derivatives (P, T) of a spline of values (N, 3, T), 0 outside its keys.
    before = np.clip(np.searchsorted(own, at, side="right") - 1, 0, max(len(own) - 2, 0))
    after = np.minimum(before + 1, len(own) - 1)
    span = own[after] - own[before]
    inside = (at >= own[0]) & (at <= own[-1]) & (span > 0)
    span = np.where(span > 0, span, 1.0)
    s = ((at - own[before]) / span)[:, None]
    left, right = former[before], former[after]
    slope = (
        (6 * s * s - 6 * s) * (left[:, 1] - right[:, 1]) / span[:, None]
        + (3 * s * s - 4 * s + 1) * left[:, 2]
        + (3 * s * s - 2 * s) * right[:, 0]
    )
    slope = np.where(inside[:, None], slope, 0.0)
    cubic[:, :, : former.shape[2]] = np.stack([slope, values, slope], axis=1)
    cubic[np.searchsorted(union, there.times[kept]), :, : former.shape[2]] = there.values[kept]
    # Before the first and after the last key that were there, the value stays.
    if union[0] < there.times[0]:
        cubic[np.searchsorted(union, there.times[0]), 0, : former.shape[2]] = 0.0
    if union[-1] > there.times[-1]:
        cubic[np.searchsorted(union, there.times[-1]), 2, : former.shape[2]] = 0.0
    return Keys(union, cubic, poses.CUBICSPLINE)
