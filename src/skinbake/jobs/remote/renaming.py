"""The user's names for files, in the place of paths in a private folder, in results and errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import TypeVar, cast

from skinbake.errors import SkinbakeError

T = TypeVar("T")


def with_names(call: Callable[[], T], naming: Callable[[str], str]) -> T:
    """Return the result of the call, or raise its error, with the naming applied to every text in it."""
    try:
        return _renamed(call(), naming)
    except SkinbakeError as error:
        raise _renamed_error(error, naming) from error


def _renamed_error(error: SkinbakeError, naming: Callable[[str], str]) -> SkinbakeError:
    renamed = type(error)(naming(error.message), _renamed(error.place, naming))
    renamed.notices = _renamed(error.notices, naming)
    return renamed


def _renamed(value: T, naming: Callable[[str], str]) -> T:
    """Return a value with the naming applied to every text in it."""
    renamed: object = value
    if isinstance(value, str):
        renamed = naming(value) if type(value) is str else value
    elif isinstance(value, SkinbakeError):
        renamed = _renamed_error(value, naming)
    elif is_dataclass(value) and not isinstance(value, type):
        texts = {f.name: _renamed(getattr(value, f.name), naming) for f in fields(value) if f.init}
        renamed = replace(value, **texts)
    elif isinstance(value, tuple | list):
        renamed = type(value)(_renamed(item, naming) for item in value)
    elif isinstance(value, dict):
        renamed = {_renamed(key, naming): _renamed(item, naming) for key, item in value.items()}
    return cast("T", renamed)
