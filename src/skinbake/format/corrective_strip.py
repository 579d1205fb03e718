"""Take correctives out of a document: the reverse of ``format.correctives``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skinbake.errors import BrokenPassedOver, Notice, Place
from skinbake.format.correctives import QUANTIZATION, TARGET_NAMES, nodes_with
from skinbake.format.note import KEY, CorrectiveNote, MorphNote, corrective_notes, refuse_later
from skinbake.geometry import poses
from skinbake.geometry.skinned import FloatArray
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import JsonObject, entries_of, listed, object_of, put_back, reference, text
from skinbake.gltf.reading.accessors import read_accessor
from skinbake.gltf.reading.clips import MORPH_WEIGHTS, POINTER_EXTENSION
from skinbake.gltf.writing.additions import Additions

FLOAT, UNSIGNED = 5126, (5121, 5123)

QUANTISED = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_")
"""The attributes to which KHR_mesh_quantization gives further types."""


WEIGHTS_POINTER = re.compile(r"/(nodes|meshes)/([0-9]{1,9})/weights(?:/([0-9]{1,9}))?")
"""A JSON pointer of KHR_animation_pointer to all morph weights of a node or a mesh, or to one."""


@dataclass(frozen=True, slots=True)
class Narrowed:
    """A channel of weights whose former sampler is gone: its animation, its number, the targets to keep."""

    animation: int
    channel: int
    targets: int


def without_correctives(document: Document) -> tuple[JsonObject, list[Narrowed]]:
    """Return the JSON without correctives, and the channels still to be narrowed.

    A channel needs ``narrowed`` if another tool has rearranged the animations since the bake. Raises
    UnsupportedFeatureError if a later version of skinbake has made the correctives.
    """
    meshes, nodes = list(document.objects("meshes")), list(document.objects("nodes"))
    notes = corrective_notes(document)
    root = dict(document.json)
    kept: dict[int, int] = {}
    for number, note in notes.items():
        mesh = meshes[number]
        refuse_later(note.version, Place(document.name, number, text(mesh, "name", document.place)))
        counts = [len(entries_of(one.get("targets"))) for one in entries_of(mesh.get("primitives"))]
        kept[number] = max(0, max(counts, default=0) - note.targets)
        meshes[number] = _former_mesh(document, mesh, note, kept[number])
        for node in nodes_with(document, number):
            weights = nodes[node].get("weights")
            if isinstance(weights, list) and len(weights) > kept[number]:
                nodes[node] = {**nodes[node], "weights": weights[: kept[number]]}
                if not kept[number]:  # written by another tool: no bake adds them
                    del nodes[node]["weights"]
    root["meshes"] = meshes
    added_to = {key for note in notes.values() for key in note.required or ()}
    for key in () if _needs_quantisation(document, meshes) else ("extensionsUsed", "extensionsRequired"):
        named = root.get(key)
        if key in added_to and isinstance(named, list) and QUANTIZATION in named:
            put_back(root, key, [name for name in named if name != QUANTIZATION])
    if "nodes" in root:
        root["nodes"] = nodes
    animations, narrowed = _former_animations(document, notes, kept)
    if "animations" in root:
        put_back(root, "animations", animations)
    return root, narrowed


def _needs_quantisation(document: Document, meshes: Sequence[JsonObject]) -> bool:
    """Tell whether attributes or targets have types that only KHR_mesh_quantization allows."""
    for primitive in (one for mesh in meshes for one in entries_of(mesh.get("primitives"))):
        for attributes in (object_of(primitive.get("attributes")), *entries_of(primitive.get("targets"))):
            for name, value in attributes.items():
                accessor = document.asset.accessor_at(value)
                if accessor is None:
                    continue
                kind = accessor.json.get("componentType")
                is_plain = name.startswith("TEXCOORD_") and accessor.is_normalized and kind in UNSIGNED
                if kind != FLOAT and not is_plain and name.startswith(QUANTISED):
                    return True
    return False


def _former_mesh(document: Document, mesh: JsonObject, note: CorrectiveNote, kept: int) -> JsonObject:
    """Return the JSON of a mesh with the first ``kept`` targets alone, and without our metadata."""
    primitives = []
    for number, primitive in enumerate(entries_of(mesh.get("primitives"))):
        filled = note.primitives[number].filled if number < len(note.primitives) else {}
        targets = [
            {
                name: one
                for name, one in target.items()
                if position not in filled.get(name, ()) or not _is_zeros(document, one)
            }
            for position, target in enumerate(entries_of(primitive.get("targets"))[:kept])
        ]
        changed = dict(primitive)
        put_back(changed, "targets", targets if any(targets) else [])
        primitives.append(changed)
    found = {**mesh, "primitives": primitives}
    weights = mesh.get("weights")
    if isinstance(weights, list) and ("weights" in note.former or any(weights[:kept])):
        found["weights"] = weights[:kept]
    else:
        found.pop("weights", None)
    extras = {key: value for key, value in object_of(mesh.get("extras")).items() if key != KEY}
    names = extras.get(TARGET_NAMES)
    if note.former_names is not None:
        extras[TARGET_NAMES] = note.former_names
    elif not kept and not note.names:
        extras.pop(TARGET_NAMES, None)
    elif isinstance(names, list) and len(names) == kept + note.targets:
        extras[TARGET_NAMES] = names[:kept]
    if note.morph_targets:  # what was made for the file's own targets stays
        extras[KEY] = MorphNote.read(note.json)._replace(correctives=0).as_json()
    found["extras"] = extras
    if not extras and "extras" not in note.former:
        del found["extras"]
    return found


def _former_animations(
    document: Document, notes: dict[int, CorrectiveNote], kept: dict[int, int]
) -> tuple[list[JsonObject], list[Narrowed]]:
    """Return the animations before the bake, and the channels whose former samplers are gone."""
    animations = [dict(one) for one in document.objects("animations")]
    of_node = {node: mesh for mesh in notes for node in nodes_with(document, mesh)}
    changed = (one for note in notes.values() for one in note.channels)
    former = {(number, position): sampler for number, position, sampler in changed}
    samplers_before = (one for note in notes.values() for one in note.samplers)
    counts = dict(sorted(samplers_before, reverse=True))  # the least of each animation comes last
    narrowed, found = [], []
    for number, animation in enumerate(animations):
        channels, samplers = entries_of(animation.get("channels")), entries_of(animation.get("samplers"))
        left: list[JsonObject] = []
        is_ours, every = False, [_moved_weights(channel, of_node) for channel in channels]
        for position, channel in enumerate(channels):
            mesh, weight = every[position]
            if mesh not in kept or (weight is not None and weight < kept[mesh]):
                left.append(channel)
                continue
            is_ours = True
            if not kept[mesh] or weight is not None:
                continue
            sampler = listed(animation, "samplers", channel.get("sampler")) or {}
            before = former.get((number, position))
            if before is not None:
                if _still_plays(document, sampler, samplers[before : before + 1], kept[mesh]):
                    left.append({**channel, "sampler": before})
                    continue
            elif (number, position) in former:
                # It was added beside pointers, which a later tool may have dropped.
                points = any(moved[0] == mesh and moved[1] is not None for moved in every)
                if points or not _moves(document, sampler, kept[mesh]):
                    continue
            narrowed.append(Narrowed(number, len(left), kept[mesh]))
            left.append(channel)
        if is_ours:
            most = max((int(one["sampler"]) + 1 for one in left), default=0)
            samplers = samplers[: max(counts.get(number, len(samplers)), most)]
            animation |= {"channels": left, "samplers": samplers}
        if left or not is_ours:  # a tool may have left an animation with our channels alone
            found.append(animation)
    return found, narrowed


def _moved_weights(channel: JsonObject, of_node: Mapping[int, int]) -> tuple[int, int | None]:
    """Return the mesh whose weights a channel moves, −1 for none, and which weight if it is one alone."""
    target = object_of(channel.get("target"))
    if target.get("path") == MORPH_WEIGHTS:
        node = reference(target.get("node"))
        return -1 if node is None else of_node.get(node, -1), None
    extension = object_of(object_of(target.get("extensions")).get(POINTER_EXTENSION))
    found = WEIGHTS_POINTER.fullmatch(str(extension.get("pointer")))
    if found is None:
        return -1, None
    number = int(found[2])
    mesh = number if found[1] == "meshes" else of_node.get(number, -1)
    return mesh, None if found[3] is None else int(found[3])


def _is_zeros(document: Document, value: object) -> bool:
    """Tell whether an accessor holds nothing but zeros: another tool may have put data there."""
    accessor = document.asset.accessor_at(value)
    if accessor is not None and accessor.json.keys().isdisjoint({"bufferView", "sparse"}):
        return True
    values = _read(document, value)
    return values is not None and not values.any()


def _read(document: Document, value: object) -> FloatArray | None:
    """Return the values of an accessor, None if they cannot be read, and count the work."""
    accessor = document.asset.accessor_at(value)
    if accessor is None:
        return None
    with BrokenPassedOver():
        count = accessor.count(document.place)
        document.budget.claim(Cost.UNDONE_NUMBER * count, "undoing its bake", document.place)
        with document.budget.passing():
            # As correctives are made and stored, also where the weights of a file are integers.
            return read_accessor(document, accessor.number, document.place).decoded().astype(np.float32)
    return None


def _still_plays(document: Document, now: JsonObject, before: Sequence[JsonObject], targets: int) -> bool:
    """Tell whether a sampler has the values of a former one for its first targets, at all former keys.

    Tools renumber samplers. Then the former one by number may be any other, or gone.
    """
    both = [now, *before]
    methods = [sampler.get("interpolation") == poses.CUBICSPLINE for sampler in both]
    numbers = [reference(sampler.get(key)) for sampler in both for key in ("input", "output")]
    if not before or methods[0] != methods[1]:
        return False
    return _agree(document, tuple(numbers), 3 if methods[0] else 1, targets)


def _moves(document: Document, sampler: JsonObject, targets: int) -> bool:
    """Tell whether a sampler moves any of the first targets."""
    times, values = (_read(document, sampler.get(key)) for key in ("input", "output"))
    each = 3 if sampler.get("interpolation") == poses.CUBICSPLINE else 1
    if times is None or values is None or values.size % (len(times) * each):
        return False
    played = values.reshape(len(times), each, -1)[:, each // 2, :targets]
    return bool(np.ptp(played, axis=0).any())


@once_a_document
def _agree(document: Document, numbers: tuple[int | None, ...], each: int, targets: int) -> bool:
    """Tell whether keys and values of a sampler hold those of a former one, ``each`` values a key.

    numbers are the accessors of both, of the sampler first.
    """
    arrays = [_read(document, number) for number in numbers]
    if any(array is None or array.shape[1] != 1 for array in arrays):
        return False
    times, values, former_times, former = (array[:, 0] for array in arrays if array is not None)
    if former.size != len(former_times) * each * targets or values.size % (len(times) * each):
        return False
    # Of two keys at one time, the last counts.
    last = np.append(np.diff(former_times) > 0, True)
    rows = np.minimum(np.searchsorted(times, former_times[last]), len(times) - 1)
    middle = each // 2
    played = values.reshape(len(times), each, -1)[rows, middle, :targets]
    wanted = former.reshape(len(former_times), each, -1)[last, middle]
    return np.array_equal(times[rows], former_times[last]) and np.array_equal(played, wanted)


def narrowed(document: Document, channels: Sequence[Narrowed]) -> Document:
    """Return the document with new samplers of the first weights alone, and tell of them."""
    if not channels:
        return document
    additions = Additions(document)
    animations = [dict(one) for one in document.objects("animations")]
    for one in channels:
        animation = animations[one.animation]
        moving, samplers = list(animation["channels"]), list(animation["samplers"])
        sampler = samplers[int(moving[one.channel]["sampler"])]
        keys = document.asset.accessors[int(sampler["input"])].count(document.place)
        each = 3 if sampler.get("interpolation") == poses.CUBICSPLINE else 1
        values = read_accessor(document, int(sampler["output"]), document.place).decoded()
        output = additions.add_floats(values.reshape(keys * each, -1)[:, : one.targets])
        moving[one.channel] = {**moving[one.channel], "sampler": len(samplers)}
        animation |= {"channels": moving, "samplers": [*samplers, {**sampler, "output": output}]}
    message = (
        "another tool has rearranged the animations since the bake: the weights of the file's own targets "
        "are kept, with keys at the times of the correctives"
    )
    document.notices.tell(Notice("weights-kept", message, document.place))
    return additions.applied({"animations": animations})
