"""Checked reading of the parsed glTF JSON: every structure is checked before it is used."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias, TypeGuard

from skinbake.errors import InputError, Place
from skinbake.wording import counted

JsonObject: TypeAlias = dict[str, Any]

LARGEST_INTEGER = 1 << 53
"""The largest integer that a count, a length or an index may be: every JSON parser reads it exactly.

Python reads integers of up to 4,300 digits, and then cannot write their sums and products in a message.
"""


def objects(parent: Mapping[str, Any], key: str, place: Place) -> list[JsonObject]:
    """Return the array of objects under ``key``, empty if there is none.

    Raises InputError if it is not an array, or has an entry that is not an object.
    """
    return _array(parent, key, place, dict, "objects")


def _array(parent: Mapping[str, Any], key: str, place: Place, kind: type, entries: str) -> list[Any]:
    value = parent.get(key)
    if value is None:
        return []
    if not isinstance(value, list) or not set(map(type, value)) <= {kind}:
        raise InputError(f'"{key}" must be an array of {entries}, found {shown(value)}', place)
    return value


def member(parent: Mapping[str, Any], key: str, place: Place) -> JsonObject:
    """Return the object under ``key``, empty if there is none; InputError if it is something else."""
    value = parent.get(key)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f'"{key}" must be an object, found {shown(value)}', place)
    return value


def integer(
    parent: Mapping[str, Any],
    key: str,
    place: Place,
    *,
    default: int | None = None,
    minimum: int = 0,
    owner: str = "",
) -> int:
    """Return the integer under ``key``; InputError if it is missing without default, or out of range.

    The range is from ``minimum`` to LARGEST_INTEGER.
    ``owner`` names the parent in messages, if the place does not tell it.
    """
    value = parent.get(key, default)
    if type(value) is int and minimum <= value <= LARGEST_INTEGER:
        return value
    if value is None and default is not None:
        return default  # some exporters write null
    of = f"{owner}: " if owner else ""
    if isinstance(value, float) and value.is_integer():
        value = int(value)  # some exporters write 3.0
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        found = f"found {shown(value)}" if key in parent else "and it is missing"
        raise InputError(f'{of}"{key}" must be an integer of at least {minimum}, {found}', place)
    if value > LARGEST_INTEGER:
        most = f"at most {LARGEST_INTEGER:,}, found {shown(value)}"
        raise InputError(f'{of}"{key}" must be an integer of {most}', place)
    return value


def index(
    parent: Mapping[str, Any], key: str, length: int, place: Place, *, owner: str = "", kind: str = ""
) -> int | None:
    """Return the index under ``key`` into an array of ``length``, None if there is none.

    ``owner`` is as for ``integer``. ``kind`` is the name of an entry, if the array is that of the whole file.
    """
    if key not in parent:
        return None
    value = integer(parent, key, place, owner=owner)
    if value >= length:
        message = f'"{key}" refers to entry {value} of an array of {length}'
        if kind:
            plural = kind + ("es" if kind.endswith("sh") else "s")
            message = f'"{key}" is {value}, but the file has {counted(length, kind, plural)}'
        raise InputError(f"{owner}: {message}" if owner else message, place)
    return value


def names(parent: Mapping[str, Any], key: str, place: Place) -> list[str]:
    """Return the array of strings under ``key``, empty if there is none; InputError for another value."""
    return _array(parent, key, place, str, "strings")


def every_object(root: object) -> Iterator[JsonObject]:
    """Yield the objects in a value, itself included, at any depth."""
    left = [root]
    while left:
        node = left.pop()
        if isinstance(node, dict):
            yield node
            left += node.values()
        elif isinstance(node, list):
            left += node


def entries_inside(value: object) -> int:
    """Return the number of entries of all arrays and objects in a value, at any depth."""
    left, count = [value], 0
    while left:
        node = left.pop()
        inner = list(node.values()) if isinstance(node, dict) else node
        if isinstance(inner, list):
            left += inner
            count += len(inner)
    return count


def is_deeper(value: object, levels: int) -> bool:
    """Tell whether arrays and objects have more than this many levels."""
    layer = [value]
    for _ in range(levels):
        inner = [list(node.values()) if isinstance(node, dict) else node for node in layer]
        layer = [entry for node in inner if isinstance(node, list) for entry in node]
        if not layer:
            return False
    return any(isinstance(node, list | dict) for node in layer)


def reference(value: object) -> int | None:
    """Return a reference to an entry of an array, or a code, as an integer; None if it is none. 3.0 is 3."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def with_integers(value: Any) -> Any:
    """Return a copy of a value of the JSON, in which 3.0 is 3 wherever it stands.

    The depth of the value is the caller's to check.
    """
    if isinstance(value, dict):
        return {key: with_integers(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [with_integers(entry) for entry in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


MOST = 3.4028234663852886e38
"""The largest valid number in a file, that of FLOAT; sums and products stay finite in float64."""


def is_number(value: object) -> TypeGuard[float]:
    """Tell whether a value of the JSON is a number in the range of float32; JSON integers have any size."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MOST


def object_of(value: object) -> JsonObject:
    """Return a value that is an object, else an empty one."""
    return value if isinstance(value, dict) else {}


def listed(parent: JsonObject, key: str, number: object) -> JsonObject | None:
    """Return the object in a place of a list of ``parent``, None if the list has no such place."""
    objects, place = parent.get(key), reference(number)
    if not isinstance(objects, list) or place is None or not 0 <= place < len(objects):
        return None
    return object_of(objects[place])


def entries_of(value: object) -> list[JsonObject]:
    """Return the objects in any value, for a search that must not stop at a broken entry."""
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def values_of(value: object) -> list[Any]:
    """Return the values of an object, none if it is something else."""
    return list(value.values()) if isinstance(value, dict) else []


def put_back(parent: JsonObject, key: str, entries: list[Any] | JsonObject) -> None:
    """Set an array or object, or remove it if it is empty: glTF allows no empty array."""
    parent[key] = entries
    if not entries:
        del parent[key]


def text(parent: Mapping[str, Any], key: str, place: Place) -> str | None:
    """Return the string under ``key``, None if there is none; InputError if it is something else."""
    value = parent.get(key)
    if value is not None and not isinstance(value, str):
        raise InputError(f'"{key}" must be a string, found {shown(value)}', place)
    return value


def shown(value: object) -> str:
    """Return a value for a message, shortened."""
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    try:
        text = repr(value)
    except RecursionError:
        return f"an {'object' if isinstance(value, dict) else 'array'} nested very deep"
    return text if len(text) <= 40 else f"{text[:40]}…"
