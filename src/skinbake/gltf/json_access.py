"""Checked reading of the parsed glTF JSON: nothing of a file's structure is believed before it is seen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from skinbake.errors import InputError, Place

JsonObject: TypeAlias = dict[str, Any]


def objects(parent: Mapping[str, Any], key: str, place: Place) -> list[JsonObject]:
    """Return the array of objects under ``key``, empty where there is none.

    Raises InputError where it is not an array, or has an entry that is not an object.
    """
    value = parent.get(key)
    if value is None:
        return []
    if not isinstance(value, list) or not set(map(type, value)) <= {dict}:
        raise InputError(f'"{key}" must be an array of objects, found {_shown(value)}', place)
    return value


def member(parent: Mapping[str, Any], key: str, place: Place) -> JsonObject:
    """Return the object under ``key``, empty where there is none; InputError where it is something else."""
    value = parent.get(key)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f'"{key}" must be an object, found {_shown(value)}', place)
    return value


def integer(
    parent: Mapping[str, Any], key: str, place: Place, *, default: int | None = None, minimum: int = 0
) -> int:
    """Return the integer under ``key``; InputError where it is missing without default, or out of range."""
    value = parent.get(key, default)
    if type(value) is int and value >= minimum:
        return value
    if isinstance(value, float) and value.is_integer():
        value = int(value)  # some exporters write 3.0
    if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
        raise InputError(f'"{key}" must be an integer of at least {minimum}, found {_shown(value)}', place)
    return value


def index(parent: Mapping[str, Any], key: str, length: int, place: Place) -> int | None:
    """Return the index under ``key`` into an array of ``length``, None where there is none."""
    if key not in parent:
        return None
    value = integer(parent, key, place)
    if value >= length:
        raise InputError(f'"{key}" refers to entry {value} of an array of {length}', place)
    return value


def accessor_number(value: object) -> int | None:
    """Return a reference to an accessor as an integer, None where it is none; 3.0 is 3, as in ``integer``."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def entries_of(value: object) -> list[JsonObject]:
    """Return the objects of an array whatever it is, for a search that must not stop at a broken entry."""
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def values_of(value: object) -> list[Any]:
    """Return the values of an object, none where it is something else."""
    return list(value.values()) if isinstance(value, dict) else []


def text(parent: Mapping[str, Any], key: str, place: Place) -> str | None:
    """Return the string under ``key``, None where there is none; InputError where it is something else."""
    value = parent.get(key)
    if value is not None and not isinstance(value, str):
        raise InputError(f'"{key}" must be a string, found {_shown(value)}', place)
    return value


def _shown(value: object) -> str:
    shown = repr(value)
    return shown if len(shown) <= 40 else f"{shown[:40]}…"
