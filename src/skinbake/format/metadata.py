"""The metadata ``extras.skinbake`` of each baked primitive (docs/reference/file-format.md)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.choices import Frame
from skinbake.errors import InputError, Place
from skinbake.geometry.skinned import FloatArray, IntArray, SkinnedPrimitive, blocks
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document
from skinbake.gltf.json_access import (
    JsonObject,
    entries_inside,
    entries_of,
    is_deeper,
    object_of,
    reference,
    with_integers,
)
from skinbake.options import MOST_CORRECTIVES
from skinbake.threads import Threads, thread_count
from skinbake.version import FILE_FORMAT

VERSION = FILE_FORMAT

KEY = "skinbake"
"""The key in ``extras`` of all notes that skinbake makes in a file."""

LARGE = 1 << 23
"""The bytes of arrays from which several threads read them: about 10 ms of work."""

DEEPEST_NOTE = 32
"""The most levels of a note of skinbake; bake writes two."""

POSES = "poses"
"""The member that names the poses of a fit: their sources, a fingerprint of them, and a digest of α and β."""

STORED_POSE = "storedPose"
"""The member about the stored pose to which α and β are fitted: a fingerprint of it, and a digest of both."""

KEPT = "kept"
"""The member that tells how much of its fit a primitive kept, if it kept a part. See ``gradients.kept``."""

STRAIGHTENED = "straightened"
"""The member that names the accessor of the TANGENT before a bake that straightened some of it."""

INFLUENCE_TYPES = {"JOINTS": "<u2", "WEIGHTS": "<f4"}
"""The types to which influences are converted for their digests."""

POSITIONS = "positions"
"""The member with what an engine compares, to see whether a tool has changed the mesh since its bake."""

LEFT = "left"
"""The member of ``asset.extras.skinbake`` that says why a bake has left the file as it was."""

FORMER_ATTRIBUTES = "formerAttributes"
"""The member that lists a primitive's attributes before a bake that changed the number of its influences."""


Digests = Callable[[], dict[str, str]]
"""What returns the digests of a primitive's arrays, by name."""


def digests(primitive: SkinnedPrimitive, frame: str) -> dict[str, str]:
    """Return a digest of each array that α and β depend on, by name.

    Each is the first 32 hexadecimal digits of the SHA-256 of the decoded values, tightly packed and little
    endian: float32 for POSITION, NORMAL, TANGENT (only if the frame uses it) and WEIGHTS, uint16 for JOINTS,
    uint32 for the unrolled triangles. So another storage of the same values has the same digests.
    """
    arrays: dict[str, tuple[npt.NDArray[Any], str]] = {
        "POSITION": (primitive.positions, "<f4"),
        "NORMAL": (primitive.normals, "<f4"),
        "indices": (primitive.triangles, "<u4"),
    }
    if frame == Frame.TANGENT and primitive.tangents is not None:
        arrays["TANGENT"] = (primitive.tangents, "<f4")
    joints = primitive.joints if primitive.stored_joints is None else primitive.stored_joints
    return array_digests({**arrays, **_of_influences(joints, primitive.weights)})


def tangent_digest(tangents: npt.NDArray[Any]) -> str:
    """Return the digest of tangents (V, 4), in the form of ``digests``."""
    return array_digest(tangents, "<f4")


def influence_digests(joints: npt.NDArray[Any], weights: npt.NDArray[Any]) -> dict[str, str]:
    """Return the digests of joints and weights (V, K) alone, in the form of ``digests``."""
    return array_digests(_of_influences(joints, weights))


def _of_influences(
    joints: npt.NDArray[Any], weights: npt.NDArray[Any]
) -> dict[str, tuple[npt.NDArray[Any], str]]:
    return {"JOINTS": (joints, INFLUENCE_TYPES["JOINTS"]), "WEIGHTS": (weights, INFLUENCE_TYPES["WEIGHTS"])}


def array_digests(arrays: Mapping[str, tuple[npt.NDArray[Any], str]]) -> dict[str, str]:
    """Return the digest of each array and its type, by name. Large arrays are read side by side."""
    size = sum(values.nbytes for values, _ in arrays.values())
    with Threads(thread_count() if size >= LARGE else 1) as threads:
        found = threads.each(lambda array: array_digest(*array), arrays.values())
        return dict(zip(arrays, found, strict=True))


def slots_digest(arrays: Mapping[str, npt.NDArray[Any]]) -> str:
    """Return one digest of the attributes that hold α and β, by name, as they are stored."""
    digest = hashlib.sha256()
    typed = {name: (values, values.dtype.newbyteorder("<").str) for name, values in sorted(arrays.items())}
    for name, found in array_digests(typed).items():
        digest.update(f"{name} {typed[name][1]} {found} ".encode())
    return digest.hexdigest()[:32]


def array_digest(values: npt.NDArray[Any], dtype: str) -> str:
    """Return the digest of one array, its values first converted to ``dtype``."""
    digest = hashlib.sha256()
    if values.dtype == dtype and values.flags.c_contiguous:
        digest.update(values.data)
    else:
        for rows in blocks(len(values)):
            with np.errstate(invalid="ignore", over="ignore"):  # NaN has a digest too
                digest.update(np.ascontiguousarray(values[rows], dtype=dtype).data)
    return digest.hexdigest()[:32]


def unordered_digest(
    primitive: SkinnedPrimitive, parts: Sequence[tuple[int, IntArray, FloatArray | IntArray]]
) -> str:
    """Return the digest of the triangles of a primitive by what is known of their vertices.

    parts are numbers of a kind, vertices (N,), and values (N, C) of these, read as float32. The order of
    vertices and triangles does not count, nor do copies of a vertex: tools change both.
    """
    # A number of 64 bits for what is known of each vertex, mixed as by splitmix64 (Steele et al. 2014).
    vertices = np.zeros(len(primitive.positions), np.uint64)
    for part, rows, values in parts:
        with np.errstate(over="ignore", invalid="ignore"):  # a NaN may be signalling
            stored = values.astype(np.float32) + np.float32(0)  # −0 is 0
        for column in stored.T:
            mixed = (vertices[rows] ^ np.uint64(part)) * np.uint64(0x9E3779B97F4A7C15)
            mixed = (mixed ^ column.view(np.uint32)) * np.uint64(0xBF58476D1CE4E5B9)
            mixed = (mixed ^ mixed >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
            vertices[rows] = mixed ^ mixed >> np.uint64(31)
    # Each triangle begins with its smallest number, and so does their list.
    corners = vertices[primitive.triangles]
    turns = corners.argmin(axis=1)[:, None] + np.arange(3)
    corners = np.take_along_axis(corners, turns % 3, axis=1)
    return array_digest(corners[np.lexsort(corners.T[::-1])], "<u8")


def changed_arrays(note: JsonObject, primitive: SkinnedPrimitive) -> tuple[str, ...]:
    """Return the names of arrays that are missing or whose digest differs from the noted one."""
    noted = note.get("digest")
    noted = noted if isinstance(noted, dict) else {}
    now = digests(primitive, str(note.get("frame")))
    return tuple(name for name in {**now, **noted} if noted.get(name) != now.get(name))


def read_left(document: Document) -> JsonObject | None:
    """Return the note of a bake that has left the file as it was, because it has little to win, or None."""
    note = _noted(object_of(document.json.get("asset")))
    left = None if note is None else note.get(LEFT)
    return left if isinstance(left, dict) else None


def with_left(document: Document, left: JsonObject) -> Document | None:
    """Return the document with that note; None where another one's extras of the asset leave no place."""
    asset = object_of(document.json.get("asset"))
    extras = asset.get("extras", {})
    if not isinstance(extras, dict) or KEY in extras:
        return None
    note = {"version": VERSION, LEFT: left, **({"keepExtras": True} if asset.get("extras") == {} else {})}
    return document.edited(json={**document.json, "asset": {**asset, "extras": {**extras, KEY: note}}})


def without_left(document: Document) -> Document:
    """Return the document as it was before that note."""
    if read_left(document) is None:
        return document
    asset = dict(document.json["asset"])
    note, extras = asset["extras"][KEY], {key: asset["extras"][key] for key in asset["extras"] if key != KEY}
    asset["extras"] = extras
    if not extras and not note.get("keepExtras"):
        del asset["extras"]
    return document.edited(json={**document.json, "asset": asset})


def read_metadata(document: Document, primitive: JsonObject) -> JsonObject | None:
    """Return the metadata of a primitive, None if it is not baked.

    It is in the ``extras`` of the primitive. If these are not an object, it is in the ``extras`` of its first
    α accessor. Raises InputError if primitives share the metadata of an accessor so often that reading it
    would take too much memory.
    """
    found = _noted(primitive)
    if found is not None:
        return found
    attributes, accessors = primitive.get("attributes"), document.objects("accessors")
    for value in attributes.values() if isinstance(attributes, dict) else ():
        number = reference(value)
        if number is not None and 0 <= number < len(accessors):
            # The metadata in the extras of an accessor, which many primitives may name.
            known: dict[int, tuple[JsonObject | None, int]] = document.derived.setdefault("notes", {})
            if number not in known:
                note = _noted(document.objects("accessors")[number])
                known[number] = note, entries_inside(note)
            note, entries = known[number]
            if note is not None:
                what = f"reading the metadata of accessor {number}"
                document.budget.claim(Cost.NOTE_ENTRY * entries, what, document.place, passing=True)
            found = note
            if found is not None:
                return found
    return None


def noted_names(note: JsonObject, key: str) -> list[str]:
    """Return the attribute names under a key like ``alpha``, none if they are not a list."""
    names = note.get(key)
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def slot_names(note: JsonObject) -> list[str]:
    """Return the names of all attributes that hold α or β, each once."""
    return list(dict.fromkeys([*noted_names(note, "alpha"), *noted_names(note, "beta")]))


def _noted(holder: JsonObject) -> JsonObject | None:
    extras = holder.get("extras")
    note = extras.get(KEY) if isinstance(extras, dict) else None
    if not isinstance(note, dict) or is_deeper(note, DEEPEST_NOTE):
        return None
    if isinstance(note.get("version"), float):
        note = with_integers(note)  # some tools write all numbers anew, 1 as 1.0
    return note if isinstance(note.get("version"), int) else None


def corrective_note(mesh: JsonObject) -> JsonObject | None:
    """Return the metadata of a mesh's correctives, None if it has none.

    Members that are damaged, and of no type that a bake writes, are left out.
    """
    note = object_of(mesh.get("extras")).get(KEY)
    if not isinstance(note, dict) or is_deeper(note, DEEPEST_NOTE):
        return None
    note = with_integers(note)  # some tools write all numbers anew, 1 as 1.0
    version, targets = reference(note.get("version")), reference(note.get("targets"))
    if version is None or targets is None or not 0 < targets <= MOST_CORRECTIVES:
        return None
    lists = ("primitives", "channels", "samplers", "clips", "former", "required")
    sound = {key: value for key, value in note.items() if key not in lists or isinstance(value, list)}
    for key in ("clips", "former", "required"):
        sound[key] = [name for name in sound.get(key, []) if isinstance(name, str)]
    return {**sound, "version": version, "targets": targets}


def corrective_notes(document: Document) -> dict[int, JsonObject]:
    """Return the metadata of correctives by mesh. They are read once: each lists all primitives."""
    known: dict[str, dict[int, JsonObject]] = document.derived.setdefault("corrective notes", {})
    if not known:
        notes = ((number, corrective_note(mesh)) for number, mesh in enumerate(document.objects("meshes")))
        known[""] = {number: note for number, note in notes if note is not None}
    return known[""]


def refuse_other_kind(document: Document, *, correctives: bool) -> None:
    """Raise InputError if a document has the other kind of bake: α/β for correctives, and the reverse."""
    for number, mesh in enumerate(document.objects("meshes")):
        if correctives:
            is_other = any(read_metadata(document, one) for one in entries_of(mesh.get("primitives")))
        else:
            is_other = corrective_note(mesh) is not None
        if is_other:
            there, wanted = ("α/β", "correctives") if correctives else ("correctives", "α/β")
            message = (
                f"it has {there} already, and both would correct its normals twice: run skinbake strip "
                f"first, or bake {wanted} into the source file"
            )
            raise InputError(message, Place(document.name, number))
