"""The types of the options of the Python API, by the annotations of its functions."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from enum import StrEnum
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from skinbake.choices import BAKE_RANGES, VERIFY_RANGES, option_of
from skinbake.errors import ChoiceError

ELSEWHERE = {"GLTF2": object}
"""The names in annotations that only type checkers import."""

RANGES = {**BAKE_RANGES, **VERIFY_RANGES}


def check_types(annotated: Callable[..., Any], given: Mapping[str, object]) -> None:
    """Raise ChoiceError for an option whose value has another type than its annotation says.

    ``annotated`` is the function, or the class of its options. Which numbers an option takes is checked
    elsewhere, and so are names that are not annotated.
    """
    hints = get_type_hints(annotated, localns=ELSEWHERE)
    for name, value in given.items():
        if name in hints and not _fits(value, hints[name]):
            raise ChoiceError(f"{option_of(name)} {value!r}: expected {_expected(name, hints[name])}")


def _kinds(hint: Any) -> tuple[Any, ...]:
    """Return the types that an annotation joins by ``|``."""
    return get_args(hint) if get_origin(hint) in {Union, UnionType} else (hint,)


def _fits(value: object, hint: Any) -> bool:
    """Tell whether a value has one of the types. A text is no list of its letters."""
    return any(_is(value, kind) for kind in _kinds(hint))


def _is(value: object, kind: Any) -> bool:
    origin = get_origin(kind) or kind
    if origin in {int, float}:
        return value is not None
    if origin is bool:
        return isinstance(value, bool | np.bool_)
    if issubclass(origin, Collection) and not issubclass(origin, str):
        (inner,) = get_args(kind)
        is_text = isinstance(value, str | bytes)
        return isinstance(value, Collection) and not is_text and all(_fits(one, inner) for one in value)
    return isinstance(value, origin)


def _expected(name: str, hint: Any) -> str:
    """Return what an option takes, in words."""
    kinds = [get_origin(kind) or kind for kind in _kinds(hint) if kind is not NoneType]
    if name in RANGES:
        return str(RANGES[name])
    if bool in kinds:
        return "True or False"
    if issubclass(kinds[0], StrEnum):
        return f"one of {', '.join(kinds[0])}"
    return "a text" if kinds[0] is str else "a list of names"
