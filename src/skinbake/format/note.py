"""The notes that a bake writes into a file: their members, their one reader and their one writer.

A note is an object under the key ``skinbake`` in ``extras`` (docs/reference/file-format.md): of a primitive
with α and β, of a mesh with correctives or changed morph targets, of an asset or a primitive that a bake has
left on purpose, and of a Draco stream that it has replaced. Each class below is one kind of note, and each of
its fields a member, in the order of the file. The name in the file is that of the field in camel case. A
member that a tool has damaged reads as if it were absent, unless ``damage`` has to tell of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Any, ClassVar, NamedTuple, Self, dataclass_transform

from skinbake.choices import Encoding, Frame, Gradients, Layout, Weighting, Weld
from skinbake.errors import InputError, Place, UnsupportedFeatureError
from skinbake.geometry.morphs import COMPONENTS
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import (
    JsonObject,
    entries_inside,
    entries_of,
    is_deeper,
    is_number,
    object_of,
    reference,
    shown,
    values_of,
    with_integers,
)
from skinbake.gltf.writing.additions import BUFFER_ADDED, BUFFER_LENGTH, FALLBACK_ADDED
from skinbake.options import MOST_CORRECTIVES
from skinbake.version import FILE_FORMAT, FIT, __version__

VERSION = FILE_FORMAT
GENERATOR = f"skinbake {__version__}"

KEY = "skinbake"
"""The key in ``extras`` of all notes."""

DEEPEST = 32
"""The most levels of a note; bake writes few."""

BAKE = "run skinbake bake"

NO_METADATA = (
    "it has α/β but no metadata that can be read (another tool may have dropped the extras), so a bake would "
    f"take adopted joints for its own: {BAKE} on its source"
)

BLEND_GRADIENT = "_SKINBAKE_BLEND"
"""The attribute of the gradient of blend weights: VEC2 FLOAT, ∂b/∂t0 and ∂b/∂b0 in 1 / length unit."""

IN_PLANE, UPWARD = "_SKINBAKE_MORPH", "_SKINBAKE_MORPH_UP"
"""The attributes of the differential of a target: VEC4 along t0 and b0, and VEC2 along n0."""

TEXCOORD = re.compile(r"TEXCOORD_(\d+)")


# How a member is read: from any value of the JSON to that of the field, None for what no bake writes.
def _as_is(value: Any) -> Any:
    return value


def _word(value: object) -> str:
    return value if isinstance(value, str) else shown(value)


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _number(value: object) -> float | None:
    return value if is_number(value) else None


def _each(read: Callable[[object], Any]) -> Callable[[object], tuple[Any, ...] | None]:
    """Return what reads the entries of a list, without those that cannot be read."""

    def read_all(value: object) -> tuple[Any, ...] | None:
        if not isinstance(value, list):
            return None
        return tuple(found for one in value if (found := read(one)) is not None)

    return read_all


_texts, _wholes = _each(_text), _each(reference)


def _numbers(value: object) -> tuple[float, ...] | None:
    return tuple(value) if isinstance(value, list) and all(map(is_number, value)) else None


def _numbered(length: int) -> Callable[[object], tuple[int | None, ...] | None]:
    """Return what reads a list of so many whole numbers, of which only a third may be null."""

    def read(value: object) -> tuple[int | None, ...] | None:
        found = tuple(map(reference, value)) if isinstance(value, list) else ()
        return found if len(found) == length and None not in found[:2] else None

    return read


def _named(read: Callable[[object], Any]) -> Callable[[object], dict[str, Any]]:
    """Return what reads an object whose members are all of one kind."""
    return lambda value: {
        name: one for name, given in object_of(value).items() if (one := read(given)) is not None
    }


def _record(kind: type[_Note]) -> Callable[[object], Any]:
    return lambda value: kind.read(object_of(value))


def _poses(value: object) -> FitPoses | None:
    found, sources = FitPoses.read(object_of(value)), object_of(value).get("from")
    whole = sources is None or (found.sources is not None and len(found.sources) == len(sources))
    return found if whole and found.fingerprint and found.slots else None


def _kept(value: object) -> float | None:
    return value if is_number(value) and 0 <= value <= 1 else None


def _shown(value: object) -> str:
    return "missing" if value is None else shown(value)


def _key(name: str) -> str:
    """Return the name in the file of a field: ``crease_angle`` is ``creaseAngle``."""
    return re.sub("_(.)", lambda found: found[1].upper(), name)


class _Member(NamedTuple):
    """How a member is read, what its absence means, its name in the file, and if it is written as absent."""

    read: Callable[[Any], Any]
    absent: Any
    key: str | None
    always: bool


def _member(
    read: Callable[[Any], Any], absent: Any = None, *, key: str | None = None, always: bool = False
) -> Any:
    """Declare a member: how it is read, and what its absence means. Only ``always`` writes it as that."""
    return _Member(read, str(absent) if isinstance(absent, Enum) else absent, key, always)  # as it reads


@dataclass_transform(kw_only_default=True, frozen_default=True)
class _Note:
    """A kind of note: a value with the members that its class declares. json is the note as the file has it.

    It is no dataclass, because the code of so many dataclasses takes 4 ms at each start.
    """

    members: ClassVar[dict[str, _Member]]
    json: JsonObject = {}  # noqa: RUF012  # nothing changes it

    def __init_subclass__(cls) -> None:
        found = {name: one for name, one in vars(cls).items() if isinstance(one, _Member)}
        cls.members = {name: one._replace(key=one.key or _key(name)) for name, one in found.items()}
        for name, one in found.items():
            setattr(cls, name, one.absent)

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and all(
            getattr(self, name) == getattr(other, name) for name in self.members
        )

    __hash__ = None  # type: ignore[assignment]  # members may be dicts

    def _replace(self, **changes: Any) -> Self:
        """Return the note with other members."""
        return type(self)(**{**self.__dict__, **changes})

    @classmethod
    def read(cls, raw: JsonObject) -> Self:
        """Return the note in an object. What is absent or damaged has the value of its absence."""
        found: dict[str, Any] = {"json": raw}
        for name, member in cls.members.items():
            if member.key in raw and (value := member.read(raw[member.key])) is not None:
                found[name] = value
        return cls(**found)

    def as_json(self) -> JsonObject:
        """Return the note as the file has it. A member that says no more than its absence is left out."""

        def plain(value: Any) -> Any:
            if isinstance(value, Enum):
                return str(value)
            if isinstance(value, tuple):
                return [plain(one) for one in value]
            if isinstance(value, Mapping):
                return {name: plain(one) for name, one in value.items()}
            return value.as_json() if isinstance(value, _Note) else value

        values = [(one, getattr(self, name)) for name, one in self.members.items()]
        return {str(one.key): plain(value) for one, value in values if one.always or value != one.absent}


class FitPoses(_Note):
    """The poses of a fit: their sources, four numbers that change with them, and the digest of α and β."""

    sources: tuple[str, ...] | None = _member(_texts, key="from")
    fingerprint: tuple[float, ...] = _member(_numbers, ())
    slots: str = _member(_text, "")


class Straightened(_Note):
    """The accessor of the TANGENT before a bake straightened some of it, and the digest of its values."""

    tangent: int | None = _member(reference, key="TANGENT")
    digest: str | None = _member(_text)


class Positions(_Note):
    """What an engine compares to see that a later tool has changed the mesh.

    The component type of POSITION; for triangles the drawn corners, and the sum over them of hashes of the
    joints; for floats the bounds of the drawn vertices.
    """

    component_type: int | None = _member(reference)
    corners: int | None = _member(reference)
    joints: int | None = _member(reference)
    min: tuple[float, ...] | None = _member(_numbers)
    max: tuple[float, ...] | None = _member(_numbers)


class Blend(_Note):
    """The attributes of blend weights and of their gradient."""

    weights: str = _member(_text, "")
    gradient: str = _member(_text, "")


class GradientNote(_Note):
    """What a bake notes of a primitive with α and β.

    The settings and the fit; what it has added or replaced, with the accessors from before; the digests of
    the arrays that α and β depend on; and how α and β are stored.
    """

    version: int = _member(_as_is, 0)
    generator: str = _member(_word, "skinbake", always=True)
    frame: str = _member(_word, "unknown")
    influences: int = _member(reference, 0)
    weighting: str = _member(_word, "unknown")
    crease_angle: float = _member(_number, math.nan)
    neighbours: str = _member(_word, "unknown")
    weld: str = _member(_word, Weld.MESH)
    gradients: str = _member(_word, Gradients.SURFACE)
    fit: int | None = _member(lambda value: value if type(value) is int else None)
    rig: str | None = _member(_word)
    poses: FitPoses | None = _member(_poses)
    kept: float | None = _member(_kept)
    generated: tuple[str, ...] = _member(_texts, ())
    straightened: Straightened | None = _member(_record(Straightened))
    former_attributes: tuple[str, ...] | None = _member(_texts)
    former_digest: Mapping[str, str] = _member(_named(_text), {})
    adopted: Mapping[str, int] | None = _member(_named(reference))
    digest: Mapping[str, str] = _member(_named(_text), {})
    alpha: tuple[str, ...] = _member(_texts, ())
    beta: tuple[str, ...] = _member(_texts, ())
    positions: Positions | None = _member(_record(Positions))
    layout: str = _member(_word, Layout.ATTRIBUTES)
    encoding: str = _member(_word, Encoding.FLOAT32)
    scale: float | None = _member(_number)
    keep_extras: bool = _member(bool, False)
    blend: Blend | None = _member(_record(Blend))

    @property
    def slot_names(self) -> list[str]:
        """The names of all attributes that hold α or β, each once."""
        return list(dict.fromkeys([*self.alpha, *self.beta]))

    @property
    def added_slot_names(self) -> list[str]:
        """The attributes that hold α or β, without names that no bake gives them."""
        if self.layout == Layout.TEXCOORD:
            return [name for name in self.slot_names if TEXCOORD.fullmatch(name)]
        return [name for name in self.slot_names if name.startswith("_")]

    @property
    def blend_names(self) -> list[str]:
        """The attribute of the gradient of blend weights if a bake has added it, as a list of one."""
        return [] if self.blend is None else [BLEND_GRADIENT]

    @property
    def other_version(self) -> str | None:
        """Which version of the note or of a fit cannot be read, and what to do; None if none is."""
        if isinstance(self.version, bool) or self.version != VERSION:
            remedy = "update skinbake" if self.version > VERSION else BAKE
            found = shown(self.version)
            return f"its metadata has version {found}, this skinbake reads {VERSION}: {remedy}"
        if self.gradients == Gradients.SURFACE or self.fit == FIT:
            return None
        remedy = "update skinbake" if self.fit is not None and self.fit > FIT else BAKE
        found = _shown(self.json.get("fit"))
        return f"its α/β come from version {found} of the fit, this skinbake has {FIT}: {remedy}"

    def refusal(self, influence_sets: int) -> tuple[str, str] | None:
        """Return the code of what is wrong with the note, and what to do; None if it can be read."""
        if self.other_version is not None:
            return "version", self.other_version
        wrong = next(self.damage(influence_sets), None)
        return None if wrong is None else ("metadata-broken", f"its metadata is damaged: {wrong}; {BAKE}")

    def differences(self, other: GradientNote, where: str) -> Iterator[str]:
        """Yield what differs from another note, ``where``, although one bake has gathered both together."""
        for key in ("weld", "gradients", "poses", "weighting", "crease_angle"):
            ours, theirs = getattr(self, key), getattr(other, key)
            if key == "poses":
                ours, theirs = (one and list(one.fingerprint) for one in (ours, theirs))
            if ours != theirs and not (key == "crease_angle" and math.isclose(ours, theirs)):
                yield f'"{_key(key)}" is {_shown(ours)}, and {_shown(theirs)} in {where}'

    def damage(self, influence_sets: int) -> Iterator[str]:
        """Yield the defects of the note of a primitive with so many influence sets.

        A note without one has all members that a bake writes, as it writes them.
        """
        known = {"frame": Frame, "weighting": Weighting, "weld": Weld, "gradients": Gradients}
        known |= {"layout": Layout, "encoding": Encoding}
        yield from map(
            self._wrong, (key for key, values in known.items() if getattr(self, key) not in list(values))
        )
        if self.gradients == Gradients.FITTED and (self.poses is None or self.poses.sources is None):
            yield self._wrong("poses")
        if self.kept is None and "kept" in self.json:
            yield self._wrong("kept")
        if not 0 <= self.crease_angle <= 180:
            yield self._wrong("creaseAngle")
        if self.influences != 4 * influence_sets:
            yield f"{self._wrong('influences')}, and it has {4 * influence_sets} a vertex"
        # The storage of α and β.
        if self.encoding in (Encoding.SNORM16, Encoding.PACKED8) and (self.scale is None or self.scale < 0):
            yield self._wrong("scale")
        is_texcoord = self.layout == Layout.TEXCOORD
        for key, names in (("alpha", self.alpha), ("beta", self.beta)):
            if len(names) != (2 if is_texcoord else 1) * influence_sets:
                yield f"{self._wrong(key)}, not an attribute for each influence set"
        if is_texcoord and len(self.slot_names) != 4 * influence_sets - 1:
            yield f'"alpha" and "beta" are {shown(self.slot_names)}: the set that both share is missing'
        if self.blend is not None and not (self.blend.weights and self.blend.gradient == BLEND_GRADIENT):
            yield self._wrong("blend")
        if not self.digest:
            yield self._wrong("digest")
            return
        wanted = ["POSITION", "NORMAL", "JOINTS", "WEIGHTS", "indices"]
        for name in [*wanted, "TANGENT"] if self.frame == Frame.TANGENT else wanted:
            if name not in self.digest:
                yield f'"digest" of {name} is {_shown(self.json["digest"].get(name))}'

    def _wrong(self, key: str) -> str:
        return f'"{key}" is {_shown(self.json.get(key))}'


class MorphTargets(_Note):
    """What bake has made for the morph targets of a primitive.

    targets is their number, normals the numbers of those that got NORMAL, zeros pairs of a target and its
    former accessor of NORMAL, which held zeros. frames is how many numbers of the differential each target
    has: 6, 4 or 0. digest is that of what all follow from.
    """

    targets: int = _member(reference, 0)
    normals: tuple[int, ...] = _member(_wholes, ())
    zeros: tuple[tuple[int, int], ...] = _member(_each(_numbered(2)), ())
    frames: int = _member(lambda value: value if value in (4, 6) else 0, 0)
    digest: str = _member(_text, "")

    def __bool__(self) -> bool:
        """Tell whether bake has added anything to its targets."""
        return bool(self.normals or self.frames)

    @property
    def names(self) -> tuple[str, ...]:
        """The attributes of the differential."""
        return (IN_PLANE, UPWARD)[: 2 if self.frames > COMPONENTS["in_plane"] else bool(self.frames)]


class MorphNote(_Note):
    """What a bake notes of a mesh whose morph targets it has changed, by primitive.

    correctives is the number of targets behind them that are correctives; a note with such is a
    ``CorrectiveNote`` too.
    """

    version: int = _member(reference, 0)
    generator: str = _member(_word, "skinbake", always=True)
    keep_extras: bool = _member(bool, False)
    correctives: int = _member(reference, 0, key="targets")
    morph_targets: tuple[MorphTargets, ...] = _member(_each(_record(MorphTargets)), ())


class CorrectedPrimitive(_Note):
    """A primitive of a mesh with correctives.

    filled are, by attribute, its former targets that got zeros. digest are those of its arrays in the normal
    frame, targets is that of its correctives on them; both are empty if it is not corrected.
    """

    filled: Mapping[str, tuple[int, ...]] = _member(_named(_wholes), {})
    digest: Mapping[str, str] = _member(_named(_text), {})
    targets: str = _member(_text, "")


class CorrectiveNote(_Note):
    """What a bake notes of a mesh with correctives.

    targets is their number. clips are the names of the clips that play them, for people. character are those
    of the files that have the same targets for their own clips (``--one-character``). channels are
    animation, channel and its former sampler, or None for a new channel; samplers the former number of
    samplers by animation. former are the members that the mesh had, names tells whether it had targetNames,
    former_names are others than for these targets. required are the lists that KHR_mesh_quantization was
    added to. plays are the numbers of the poses and of the weights of each clip that plays them.
    """

    version: int = _member(reference, 0)
    generator: str = _member(_text, "skinbake", always=True)
    targets: int = _member(reference, 0)
    aim: str = _member(_word, "")
    clips: tuple[str, ...] = _member(_texts, (), always=True)
    character: tuple[str, ...] = _member(_texts, ())
    channels: tuple[tuple[int, int, int | None], ...] = _member(_each(_numbered(3)), (), always=True)
    samplers: tuple[tuple[int, int], ...] = _member(_each(_numbered(2)), (), always=True)
    primitives: tuple[CorrectedPrimitive, ...] = _member(
        _each(lambda value: CorrectedPrimitive.read(value) if isinstance(value, dict) else None), ()
    )
    former: tuple[str, ...] = _member(_texts, (), always=True)
    names: bool = _member(bool, False, always=True)
    former_names: Any = _member(_as_is)
    encoding: str = _member(_word, Encoding.FLOAT32)
    required: tuple[str, ...] | None = _member(_texts)
    morph_targets: tuple[MorphTargets, ...] = _member(_each(_record(MorphTargets)), ())
    keep_extras: bool = _member(bool, False)
    plays: tuple[tuple[float, ...], ...] | None = _member(_each(_numbers))


class Left(_Note):
    """Why a bake has left a file or a primitive as it was.

    by are the options that did, empty for ``--leave-under``. gain, the mean error of standard lighting in
    degrees and the gain that was asked for are those of the file.
    """

    by: str = _member(_text, "")
    gain: float | None = _member(_number)
    standard_error: float | None = _member(_number)
    under: float | None = _member(_number)


class LeftNote(_Note):
    """What a bake notes where it leaves something on purpose: of the asset, or of a primitive."""

    version: int = _member(_as_is, 0)
    left: Left | None = _member(lambda value: Left.read(value) if isinstance(value, dict) else None)
    keep_extras: bool = _member(bool, False)


class StreamNote(_Note):
    """What a bake notes of a Draco stream that it has replaced: the extension before, and accessors by name.

    The accessors belong to the attributes that the new stream replaces or leaves out.
    """

    before: JsonObject | None = _member(lambda value: value if isinstance(value, dict) else None)
    accessors: JsonObject = _member(_as_is, {})


class BufferNote(_Note):
    """What ``gltf.additions`` notes of the buffer before a bake, in the first view that it adds."""

    byte_length: int | None = _member(reference, key=BUFFER_LENGTH)
    added: bool = _member(bool, False, key=BUFFER_ADDED)
    fallback_added: bool = _member(bool, False, key=FALLBACK_ADDED)


def gradient_note(document: Document, source: PrimitiveSource) -> GradientNote | None:
    """Return the note of a primitive with α and β, None if it is not baked, as ``gradient_note_in``."""
    return gradient_note_in(document, source.json)


def gradient_note_in(document: Document, primitive: JsonObject) -> GradientNote | None:
    """Return the note in the JSON of a primitive with α and β, None if it is not baked.

    It is in the ``extras`` of the primitive. If these are not an object, it is in the ``extras`` of its first
    α accessor. Raises InputError if primitives share the note of an accessor so often that reading it would
    take too much memory.
    """
    found = _stored(primitive)
    if found is not None:
        return None if isinstance(found.get("left"), dict) else GradientNote.read(found)
    for accessor in map(document.asset.accessor_at, values_of(primitive.get("attributes"))):
        if accessor is not None:
            note, entries = _note_of_accessor(document, accessor.number)
            if note is not None:
                what = f"reading the metadata of accessor {accessor.number}"
                document.budget.claim(Cost.NOTE_ENTRY * entries, what, document.place, passing=True)
                return note
    return None


@once_a_document
def _note_of_accessor(document: Document, number: int) -> tuple[GradientNote | None, int]:
    """Return the note in the extras of an accessor, and the number of its entries."""
    found = _stored(document.objects("accessors")[number])
    return None if found is None else GradientNote.read(found), entries_inside(found)


def corrective_note(mesh: JsonObject) -> CorrectiveNote | None:
    """Return the note of a mesh's correctives, None if it has none."""
    found = _stored(mesh, whole=True)
    note = None if found is None else CorrectiveNote.read(found)
    return note if note is not None and 0 < note.targets <= MOST_CORRECTIVES else None


@once_a_document
def corrective_notes(document: Document) -> dict[int, CorrectiveNote]:
    """Return the notes of correctives by mesh. They are read once: each lists all primitives."""
    notes = ((number, corrective_note(mesh)) for number, mesh in enumerate(document.objects("meshes")))
    return {number: note for number, note in notes if note is not None}


def morph_note(mesh: JsonObject) -> MorphNote | None:
    """Return the note of a mesh whose targets bake has changed, None without a sound one."""
    found = _stored(mesh, whole=True)
    return MorphNote.read(found) if found and isinstance(found.get("morphTargets"), list) else None


@once_a_document
def made_targets(document: Document, mesh: int) -> list[MorphTargets]:
    """Return what bake has made for the targets of each primitive of a mesh."""
    return noted_targets(document.objects("meshes")[mesh])


def noted_targets(mesh: JsonObject) -> list[MorphTargets]:
    """Return what the note of a mesh says of each of its primitives.

    An entry counts as absent if another tool has removed or added targets: then the numbers may be those of
    others.
    """
    note = morph_note(mesh) or MorphNote()
    found = []
    for number, primitive in enumerate(entries_of(mesh.get("primitives"))):
        entry = note.morph_targets[number] if number < len(note.morph_targets) else MorphTargets()
        targets = primitive.get("targets")
        is_whole = isinstance(targets, list) and len(targets) - note.correctives == entry.targets
        found.append(entry if is_whole else MorphTargets())
    return found


def left_note(holder: JsonObject) -> Left | None:
    """Return why a bake has left a primitive, or the file of an asset, on purpose; None if it has not."""
    found = _stored(holder)
    return None if found is None else LeftNote.read(found).left


def primitive_left(source: PrimitiveSource) -> Left | None:
    """Return why a bake has left a primitive on purpose, None if it has not."""
    return left_note(source.json)


def file_left(document: Document) -> Left | None:
    """Return why a bake has left a file on purpose, None if it has not."""
    return left_note(object_of(document.json.get("asset")))


def stream_note(extension: JsonObject) -> StreamNote | None:
    """Return the note of a Draco stream that a bake has made in place of another, None without one."""
    found = object_of(extension.get("extras")).get(KEY)
    note = StreamNote.read(found) if isinstance(found, dict) else None
    return note if note and note.before is not None and isinstance(note.accessors, dict) else None


def buffer_note(view: JsonObject) -> BufferNote | None:
    """Return the note of the buffer before a bake, None if the view is not the first that one has added."""
    found = object_of(view.get("extras")).get(KEY)
    return BufferNote.read(found) if isinstance(found, dict) else None


def _stored(holder: JsonObject, *, whole: bool = False) -> JsonObject | None:
    """Return the note of an object as the file has it; None where there is none, or one of another program.

    Some tools write all numbers anew, 1 as 1.0. ``whole``: all numbers of it are whole that can be.
    """
    note = object_of(holder.get("extras")).get(KEY)
    if not isinstance(note, dict) or is_deeper(note, DEEPEST):
        return None
    if whole or isinstance(note.get("version"), float):
        note = with_integers(note)
    return note if isinstance(note.get("version"), int) else None


def has_place(holder: JsonObject) -> bool:
    """Tell whether ``extras`` of an object have place for a note: they are absent, or have no such key."""
    extras = holder.get("extras", {})
    return isinstance(extras, dict) and KEY not in extras


def with_note(holder: JsonObject, note: _Note) -> JsonObject:
    """Return an object with a note in its ``extras``, which notes too whether these were empty before."""
    if holder.get("extras") == {} and "keep_extras" in note.members:
        note = note._replace(keep_extras=True)
    return {**holder, "extras": {**object_of(holder.get("extras")), KEY: note.as_json()}}


def without_note(holder: JsonObject) -> JsonObject:
    """Return an object without its note, and without ``extras`` that a bake has added."""
    if _stored(holder) is None and stream_note(holder) is None:
        return holder
    extras = dict(holder["extras"])
    note = extras.pop(KEY)
    found = {**holder, "extras": extras}
    if not extras and not note.get("keepExtras"):
        del found["extras"]
    return found


def with_left_primitives(document: Document, left: Sequence[tuple[PrimitiveSource, str]]) -> Document:
    """Return the document with notes of the primitives that were left, each by the options that left it.

    Raises UnsupportedFeatureError if other extras of a primitive leave no place.
    """
    if not left:
        return document
    meshes = list(document.objects("meshes"))
    for source, by in left:
        primitives = list(meshes[source.mesh]["primitives"])
        primitive = primitives[source.primitive]
        if not has_place(primitive):
            message = f'its "extras" leave no place for the note that {by} left it out'
            raise UnsupportedFeatureError(message, source.place)
        note = LeftNote(version=VERSION, left=Left(by=by))
        primitives[source.primitive] = with_note(primitive, note)
        meshes[source.mesh] = {**meshes[source.mesh], "primitives": primitives}
    return document.edited(json={**document.json, "meshes": meshes})


def with_left(document: Document, left: Left) -> Document | None:
    """Return the document with a note that it was left; None where other extras of the asset leave no place.

    Numbers are rounded: they must not change with the order of sums.
    """
    asset = object_of(document.json.get("asset"))
    if not has_place(asset):
        return None
    numbers = {name: getattr(left, name) for name in ("gain", "standard_error", "under")}
    rounded = {name: None if one is None else float(f"{one:.4g}") for name, one in numbers.items()}
    asset = with_note(asset, LeftNote(version=VERSION, left=left._replace(**rounded)))
    return document.edited(json={**document.json, "asset": asset})


def without_left(document: Document) -> Document:
    """Return the document as it was before the notes that it, or any of its primitives, was left."""
    root = dict(document.json)
    if file_left(document) is not None:
        root["asset"] = without_note(root["asset"])
    for number, mesh in enumerate(document.objects("meshes")):
        if any(map(left_note, entries_of(mesh.get("primitives")))):
            root["meshes"] = list(root["meshes"])
            primitives = [without_note(one) if left_note(one) else one for one in mesh["primitives"]]
            root["meshes"][number] = {**mesh, "primitives": primitives}
    is_same = all(root[key] is value for key, value in document.json.items())
    return document if is_same else document.edited(json=root)


def refuse_other_kind(document: Document, *, correctives: bool) -> None:
    """Raise InputError if a document has the other kind of bake: α/β for correctives, and the reverse."""
    for number, mesh in enumerate(document.objects("meshes")):
        if correctives:
            is_other = any(gradient_note_in(document, one) for one in entries_of(mesh.get("primitives")))
        else:
            is_other = corrective_note(mesh) is not None
        if is_other:
            there, wanted = ("α/β", "correctives") if correctives else ("correctives", "α/β")
            message = (
                f"it has {there} already, and both would correct its normals twice: run skinbake strip "
                f"first, or bake {wanted} into the source file"
            )
            raise InputError(message, Place(document.name, number))


def refuse_later(version: int, place: Place) -> None:
    """Raise UnsupportedFeatureError for the note of a later skinbake: what it means is unknown."""
    if version > VERSION:
        message = f"its metadata has version {version}, this skinbake reads {VERSION}: update skinbake"
        raise UnsupportedFeatureError(message, place)
