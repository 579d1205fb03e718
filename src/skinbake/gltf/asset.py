"""The parts of a glTF file as typed records: each is checked where it is first read (glTF 2.0, §5).

A record holds its JSON, which only this room and ``format/`` touch, and says what others need to know. What
nobody asks for is not checked: a broken material does not refuse a bake.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from skinbake.errors import InputError, Place
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.json_access import (
    JsonObject,
    entries_of,
    index,
    integer,
    is_number,
    member,
    object_of,
    objects,
    reference,
    shown,
    text,
)
from skinbake.wording import counted

SET = re.compile(r"(?:JOINTS|WEIGHTS)_(0|[1-9]\d{0,8})", re.ASCII)
"""The name of an attribute that holds influences."""

NUMBERED = re.compile(r"\(animation \d+\)$", re.ASCII)
"""How the name of an animation ends that shares it with others."""

REST = {
    "translation": np.zeros(3),
    "rotation": np.array([0.0, 0.0, 0.0, 1.0]),
    "scale": np.ones(3),
    "matrix": np.eye(4).ravel(),
}
"""The transform of a node that stores none. glTF has x of a rotation first, and matrices by columns."""


COMPONENT_NAMES = {
    5120: "BYTE",
    5121: "UNSIGNED_BYTE",
    5122: "SHORT",
    5123: "UNSIGNED_SHORT",
    5125: "UNSIGNED_INT",
    5126: "FLOAT",
}
COMPONENT_TYPES: dict[int, np.dtype[np.generic]] = {
    code: np.dtype(kind)
    for code, kind in zip(COMPONENT_NAMES, ("<i1", "<u1", "<i2", "<u2", "<u4", "<f4"), strict=True)
}
COMPONENT_CODES = {dtype: code for code, dtype in COMPONENT_TYPES.items()}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TYPES = {count: name for name, count in COMPONENTS.items()}
MATRIX_ROWS = {"MAT2": 2, "MAT3": 3, "MAT4": 4}


def component_dtype(holder: JsonObject) -> np.dtype[np.generic] | None:
    """Return the dtype of an object's ``componentType``, None if glTF does not define it."""
    code = reference(holder.get("componentType"))
    return None if code is None else COMPONENT_TYPES.get(code)


Shape: TypeAlias = tuple[np.dtype[np.generic], int, int]
"""The dtype, components and count of an accessor."""


@dataclass(frozen=True, slots=True)
class Accessor:
    """An accessor. The place that its methods take, for messages, is that of what names it."""

    number: int
    json: JsonObject

    @property
    def dtype(self) -> np.dtype[np.generic] | None:
        """The dtype of its components, None if glTF does not define it."""
        return component_dtype(self.json)

    @property
    def components(self) -> int | None:
        """The components of an element, None if its type is not one that is read."""
        kind = self.json.get("type")
        return COMPONENTS.get(kind) if isinstance(kind, str) else None

    @property
    def is_small_matrix(self) -> bool:
        """Whether it has the type of matrices that are not read: MAT2 or MAT3, with columns of 4 bytes each.

        Only attributes of applications have it.
        """
        return self.components is None and self._rows is not None

    @property
    def _rows(self) -> int | None:
        kind = self.json.get("type")
        return MATRIX_ROWS.get(kind) if isinstance(kind, str) else None

    @property
    def is_normalized(self) -> bool:
        """Whether its integers stand for fractions of the largest."""
        return self.json.get("normalized") is True

    def count(self, place: Place) -> int:
        """Return the declared number of its elements; InputError if it is not such a number."""
        return integer(self.json, "count", place, minimum=1)

    def shape(self, place: Place) -> Shape:
        """Return what it declares; InputError if glTF does not define it, or not here."""
        dtype, components = self.dtype, self.components
        if dtype is None or components is None:
            raise self._unknown_format(place)
        return dtype, components, self.count(place)

    def described(self, place: Place) -> tuple[str, int]:
        """Return its format, like ``VEC3 FLOAT``, and its size in bytes when tightly packed.

        Raises InputError if glTF does not allow its type or count.
        """
        dtype, rows = self.dtype, self._rows
        components = self.components if rows is None else rows
        if dtype is None or components is None:
            raise self._unknown_format(place)
        column = components * dtype.itemsize
        size = (
            column if rows is None else rows * (column + -column % 4)
        )  # glTF aligns the columns of matrices
        name = COMPONENT_NAMES[self.json["componentType"]]
        suffix = " normalised" if self.is_normalized else ""
        return f"{self.json['type']} {name}{suffix}", size * self.count(place)

    def _unknown_format(self, place: Place) -> InputError:
        missing = [f'"{key}"' for key in ("type", "componentType") if key not in self.json]
        if missing:
            return InputError(f"accessor {self.number} has no {' and no '.join(missing)}", place)
        known = self._rows is not None and self.dtype is not None
        verdict = "is not allowed here" if known else "glTF does not define"
        kind, code = shown(self.json.get("type")), shown(self.json.get("componentType"))
        return InputError(
            f"accessor {self.number} has type {kind} of component type {code}, which {verdict}", place
        )


class Node(NamedTuple):
    """A node of the hierarchy."""

    asset: Asset
    number: int
    json: JsonObject

    @property
    def name(self) -> str:
        """Its name, empty if it has none."""
        name = self.json.get("name")
        return name if isinstance(name, str) else ""

    @property
    def mesh(self) -> int | None:
        """The mesh that it draws; InputError if the file has no such mesh."""
        return self._index("mesh", len(self.asset.objects("meshes")))

    @property
    def skin(self) -> int | None:
        """The skin with which it draws its mesh; InputError if the file has no such skin."""
        return self._index("skin", len(self.asset.objects("skins")))

    def _index(self, key: str, count: int) -> int | None:
        return index(self.json, key, count, self.asset.place, owner=f"node {self.number}", kind=key)

    @property
    def has_matrix(self) -> bool:
        """Whether it stores its transform as a matrix."""
        return "matrix" in self.json

    def stored(self, key: str) -> Float64Array:
        """Return its ``translation``, ``rotation``, ``scale`` or ``matrix``; InputError for no numbers."""
        value, rest = self.json.get(key), REST[key]
        if value is None:
            return rest
        if not isinstance(value, list) or len(value) != len(rest) or not all(map(is_number, value)):
            raise InputError(f'node {self.number}: "{key}" must be {len(rest)} numbers', self.asset.place)
        return np.array(value, dtype=np.float64)

    def resting_weights(self) -> Float64Array:
        """Return the weights (N,) of the N targets of its mesh without an animation; it draws a mesh.

        They are its own, otherwise those of the mesh, otherwise 0. Raises InputError if they are not N
        numbers.
        """
        mesh = self.asset.meshes[self.mesh or 0]
        count, owner, called, place = mesh.target_count, self.json, f"node {self.number}", self.asset.place
        if owner.get("weights") is None:
            owner, called, place = mesh.json, "its mesh", mesh.place
        value = owner.get("weights")
        if value is None:
            return np.zeros(count)
        if not isinstance(value, list) or not all(map(is_number, value)) or len(value) != count:
            numbers = counted(count, "number")
            raise InputError(f'"weights" of {called} must be {numbers}, one for each morph target', place)
        return np.array(value, dtype=np.float64)


@dataclass(frozen=True)
class Skin:
    """A skin: the nodes that it lists as joints, and their inverse bind matrices."""

    asset: Asset
    number: int
    json: JsonObject

    @property
    def joint_count(self) -> int:
        """The number of joints, which are not checked to be nodes; InputError if it lists none."""
        return len(self._listed)

    @property
    def _listed(self) -> list[Any]:
        joints = self.json.get("joints")
        if not isinstance(joints, list) or not joints:
            raise InputError(f"skin {self.number} has no joints", self.asset.place)
        return joints

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """The nodes that it lists; InputError if one is not a node."""
        owner, place, count = f"skin {self.number}", self.asset.place, len(self.asset.objects("nodes"))
        joints = [
            index({"joint": joint}, "joint", count, place, owner=owner, kind="node") for joint in self._listed
        ]
        return tuple(joint for joint in joints if joint is not None)

    @property
    def inverse_bind(self) -> int | None:
        """The accessor of its inverse bind matrices; InputError if the file has no such accessor."""
        count, owner = len(self.asset.objects("accessors")), f"skin {self.number}"
        return index(self.json, "inverseBindMatrices", count, self.asset.place, owner=owner, kind="accessor")


@dataclass(frozen=True)
class Mesh:
    """A mesh: its primitives."""

    asset: Asset
    number: int
    json: JsonObject

    @cached_property
    def place(self) -> Place:
        """Its place for messages; InputError if its name is not a text."""
        file = self.asset.place
        return Place(file.file, self.number, text(self.json, "name", file))

    @cached_property
    def primitives(self) -> tuple[PrimitiveSource, ...]:
        """Its primitives; InputError if they are not an array of objects."""
        count, here = self.asset.joint_counts.get(self.number, 0), self.place
        return tuple(
            PrimitiveSource(
                self.number, number, content, count, Place(here.file, here.mesh, here.mesh_name, number)
            )
            for number, content in enumerate(objects(self.json, "primitives", here))
        )

    @cached_property
    def target_count(self) -> int:
        """The number of its morph targets. Primitives without targets do not count.

        Raises InputError if the others have different numbers.
        """
        counts = sorted({len(primitive.targets) for primitive in self.primitives} - {0})
        if len(counts) > 1:
            found = " and ".join(str(count) for count in counts)
            raise InputError(
                f"its primitives have {found} morph targets; "
                "all primitives of a mesh must have the same number",
                self.place,
            )
        return counts[0] if counts else 0


class PrimitiveSource(NamedTuple):
    """One primitive of a mesh in the document.

    joint_count is the smallest number of joints of all skins of its mesh, 0 without a skin.
    """

    mesh: int
    primitive: int
    json: JsonObject
    joint_count: int
    place: Place

    @property
    def attributes(self) -> JsonObject:
        """Return the JSON object that maps attribute names to accessor indices."""
        return member(self.json, "attributes", self.place)

    @property
    def material(self) -> int | None:
        """Its material, which may not be there."""
        return reference(self.json.get("material"))

    @property
    def materials(self) -> list[int | None]:
        """Its material, and those that KHR_materials_variants may give it."""
        variants = object_of(object_of(self.json.get("extensions")).get("KHR_materials_variants"))
        others = entries_of(variants.get("mappings"))
        return [self.material, *(reference(one.get("material")) for one in others)]

    @property
    def has_targets(self) -> bool:
        """Whether it has morph targets, of whatever kind."""
        return "targets" in self.json

    @property
    def whole_targets(self) -> list[JsonObject]:
        """Its morph targets that are objects, for what must not stop at a broken one."""
        return entries_of(self.json.get("targets"))

    @property
    def targets(self) -> list[JsonObject]:
        """Return its morph targets, which map attribute names to accessors; InputError if they are broken."""
        return objects(self.json, "targets", self.place)

    @property
    def influence_sets(self) -> int:
        """Return the number of ``JOINTS_n`` sets of the primitive, counted from 0 without a gap."""
        attributes = self.attributes
        count = 0
        while f"JOINTS_{count}" in attributes:
            count += 1
        return count

    @property
    def unread_sets(self) -> list[str]:
        """Return the attributes of influence sets that are not read, because a set before them is missing."""
        read = self.influence_sets
        found = (SET.fullmatch(name) for name in self.attributes)
        return [
            name for number, name in sorted((int(one[1]), one[0]) for one in found if one) if number >= read
        ]


class Animation(NamedTuple):
    """An animation; ``called`` is its name, with its number where others share the name."""

    number: int
    json: JsonObject
    name: str
    called: str


class Drawn(NamedTuple):
    """A node that draws a mesh with a skin."""

    node: int
    mesh: int
    skin: int


@dataclass(frozen=True)
class Asset:
    """The content of a document without its bytes."""

    json: JsonObject
    place: Place

    @cached_property
    def _lists(self) -> dict[str, list[JsonObject]]:
        return {}

    def objects(self, key: str) -> list[JsonObject]:
        """Return a top-level array of objects (``accessors``, ``meshes`` …), empty where absent."""
        if key not in self._lists:
            self._lists[key] = objects(self.json, key, self.place)
        return self._lists[key]

    @cached_property
    def accessors(self) -> tuple[Accessor, ...]:
        """All accessors."""
        return tuple(Accessor(number, content) for number, content in enumerate(self.objects("accessors")))

    def accessor(self, holder: Mapping[str, Any], key: str, place: Place) -> Accessor | None:
        """Return the accessor that an object names by a key, None if it has no such key.

        Raises InputError if the file has no such accessor.
        """
        number = index(holder, key, len(self.objects("accessors")), place)
        return None if number is None else self.accessors[number]

    def needed(self, holder: Mapping[str, Any], key: str, place: Place) -> Accessor:
        """Return the accessor that an object names by a key; InputError without such a key or accessor."""
        found = self.accessor(holder, key, place)
        if found is None:
            raise InputError(f"it has no {key}", place)
        return found

    @cached_property
    def nodes(self) -> tuple[Node, ...]:
        """All nodes."""
        return tuple(Node(self, number, content) for number, content in enumerate(self.objects("nodes")))

    @cached_property
    def skins(self) -> tuple[Skin, ...]:
        """All skins."""
        return tuple(Skin(self, number, content) for number, content in enumerate(self.objects("skins")))

    @cached_property
    def meshes(self) -> tuple[Mesh, ...]:
        """All meshes."""
        return tuple(Mesh(self, number, content) for number, content in enumerate(self.objects("meshes")))

    @cached_property
    def primitives(self) -> tuple[PrimitiveSource, ...]:
        """The primitives of all meshes."""
        return tuple(primitive for mesh in self.meshes for primitive in mesh.primitives)

    def accessor_of(self, source: PrimitiveSource, attribute: str) -> int | None:
        """Return the accessor of an attribute, None if it has none or the file has no such accessor."""
        found = self.accessor_at(source.attributes.get(attribute))
        return None if found is None else found.number

    def accessor_at(self, value: object) -> Accessor | None:
        """Return the accessor to which a value of the JSON refers, None if there is none."""
        number = reference(value)
        return self.accessors[number] if number is not None and 0 <= number < len(self.accessors) else None

    def counterpart(self, source: PrimitiveSource) -> PrimitiveSource:
        """Return the same primitive as in an earlier version of this document: it has other accessors."""
        return source._replace(json=self.objects("meshes")[source.mesh]["primitives"][source.primitive])

    @cached_property
    def animations(self) -> tuple[Animation, ...]:
        """All animations."""
        stored = [content.get("name") for content in self.objects("animations")]
        names = [name if isinstance(name, str) else "" for name in stored]
        called = [name or f"animation {number}" for number, name in enumerate(names)]
        uses = Counter(called)
        # A name that ends like these gets its number too: it could be the same as one of them.
        called = [
            f"{name} (animation {number})" if uses[name] > 1 or NUMBERED.search(name) else name
            for number, name in enumerate(called)
        ]
        return tuple(
            Animation(number, content, names[number], called[number])
            for number, content in enumerate(self.objects("animations"))
        )

    @cached_property
    def drawn(self) -> tuple[Drawn, ...]:
        """The nodes that draw a mesh with a skin; InputError if any node names no mesh or no skin."""
        found = []
        for node in self.nodes:
            if "mesh" not in node.json and "skin" not in node.json:
                continue
            mesh, skin = node.mesh, node.skin
            if mesh is not None and skin is not None:
                found.append(Drawn(node.number, mesh, skin))
        return tuple(found)

    @cached_property
    def joint_counts(self) -> Mapping[int, int]:
        """The smallest number of joints of all skins of a mesh, for the meshes that are drawn with one."""
        counts: dict[int, int] = {}
        for _, mesh, skin in self.drawn:
            joint_count = self.skins[skin].joint_count
            counts[mesh] = min(counts.get(mesh, joint_count), joint_count)
        return counts

    def skins_of(self, mesh: int) -> list[int]:
        """Return the skins with which nodes draw a mesh, in the nodes' order."""
        return self._skins_by_mesh.get(mesh, [])

    @cached_property
    def _skins_by_mesh(self) -> Mapping[int, list[int]]:
        found: dict[int, dict[int, None]] = {}
        for _, mesh, skin in self.drawn:
            found.setdefault(mesh, {})[skin] = None
        return {mesh: list(skins) for mesh, skins in found.items()}

    @cached_property
    def takers_of_weights(self) -> Mapping[int, frozenset[int]]:
        """The nodes that draw a mesh with a skin and take their morph weights from it, by mesh."""
        found: dict[int, list[int]] = {}
        for node, mesh, _ in self.drawn:
            if self.nodes[node].json.get("weights") is None:
                found.setdefault(mesh, []).append(node)
        return {mesh: frozenset(nodes) for mesh, nodes in found.items()}

    @cached_property
    def parents(self) -> Mapping[int, int]:
        """The parent of each node that has one; InputError if children are broken or have two parents."""
        parents: dict[int, int] = {}
        for node in self.nodes:
            children, owner = node.json.get("children", []), f"node {node.number}"
            if not isinstance(children, list):
                raise InputError(f"{owner} has children that are not an array", self.place)
            for child in children:
                position = index(
                    {"child": child}, "child", len(self.nodes), self.place, owner=owner, kind="node"
                )
                if position is not None and parents.setdefault(position, node.number) != node.number:
                    raise InputError(f"node {position} has two parents", self.place)
        return parents
