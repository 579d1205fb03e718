"""References between the entries of a document's arrays, and references to missing entries."""

from __future__ import annotations

from collections.abc import Sequence

from skinbake.errors import InputError, Place
from skinbake.gltf.codecs import meshopt
from skinbake.gltf.json_access import (
    JsonObject,
    entries_of,
    every_object,
    integer,
    reference,
    values_of,
)
from skinbake.wording import counted

VIEW = "bufferView"

VIEW_KEYS = (VIEW, "values", "arrayOffsets", "stringOffsets")
"""The keys of references to buffer views. All but the first belong to EXT_structural_metadata."""

ACCESSOR_KEYS = (
    "indices",
    "inverseBindMatrices",
    "input",
    "output",
    "accessor",
    "mergeIndices",
    "mergeValues",
)
"""The keys of references to accessors, besides ``attributes`` and ``targets``.

The last three belong to extensions. EXT_mesh_gpu_instancing has ``attributes`` too.
"""


def uses_of_accessors(root: object) -> dict[int, int]:
    """Return the number of references to each accessor, in glTF 2.0 itself and in extensions."""
    found: list[object] = []
    for node in every_object(root):
        found += (node.get(key) for key in ACCESSOR_KEYS)
        if VIEW not in node:  # else it is a Draco stream, and its attributes are ids
            found += values_of(node.get("attributes"))
        for target in entries_of(node.get("targets")):
            found += target.values()
    uses: dict[int, int] = {}
    for value in found:
        number = reference(value)
        if number is not None:
            uses[number] = uses.get(number, 0) + 1
    return uses


def views_in_use(root: object) -> set[int]:
    """Return every number under a key that names buffer views, at any depth."""
    found = (reference(node.get(key)) for node in every_object(root) for key in VIEW_KEYS)
    return {number for number in found if number is not None}


def buffers_in_use(root: object) -> set[int]:
    """Return every number under a key ``buffer``, at any depth."""
    found = (reference(node.get("buffer")) for node in every_object(root))
    return {number for number in found if number is not None}


def check_views(views: Sequence[JsonObject], length: int | None, place: Place) -> None:
    """Raise InputError if a buffer view does not name its bytes, or would reach into added ones.

    ``length`` is that of buffer 0, without padding behind it, if bytes are added at its end.
    """
    for number, view in enumerate(views):
        where = place.at(f"buffer view {number}")
        for holder in meshopt.ranges_of(view, where):
            buffer = integer(holder, "buffer", where)
            start = integer(holder, "byteOffset", where, default=0)
            end = start + integer(holder, "byteLength", where, minimum=1)
            if buffer == 0 and length is not None and end > length:
                raise InputError(f"it ends at byte {end} of buffer 0, which has {length}", where)


def refuse_dangling(root: JsonObject, key: str, added: int, place: Place) -> None:
    """Raise InputError if a reference names a missing entry that ``added`` entries would supply.

    An added entry must not become the target of a broken reference.
    """
    used = {
        "accessors": lambda: set(uses_of_accessors(root)),
        "bufferViews": lambda: views_in_use(root),
        "buffers": lambda: buffers_in_use(root),
    }[key]()
    entries = root.get(key)
    count = len(entries) if isinstance(entries, list) else 0
    wrong = [number for number in used if count <= number < count + added]
    if wrong:
        has = counted(count, "entry", "entries")
        raise InputError(
            f'a reference names entry {min(wrong)} of "{key}", which has only {has}. '
            "The entries that bake adds must not become its target: correct the reference first",
            place,
        )
