"""JSON text to values and back (RFC 8259). Texts deeper than Python's parser and writer go are refused."""

from __future__ import annotations

import gc
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

TOO_DEEP = "its arrays and objects are nested too deep"


@contextmanager
def collector_off() -> Iterator[None]:
    """Switch the garbage collector off: it would visit every object of a large JSON again and again."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:  # pragma: no branch: it is on in a command
            gc.enable()


def parsed(text: str) -> Any:
    """Return the value of a JSON text; ValueError if it is invalid, or nested hundreds of levels deep."""
    decoder = json.JSONDecoder(parse_constant=_reject_constant)
    with collector_off():
        try:
            return decoder.decode(text)
        except RecursionError as error:
            raise ValueError(TOO_DEEP) from error


def _reject_constant(name: str) -> float:
    raise ValueError(f"{name} is not valid JSON")


def written(value: Any, *, indent: str | None, ascii_only: bool) -> str:
    """Return a JSON text, on one line without ``indent``.

    Raises ValueError for numbers that are not finite, and for values that are nested too deep.
    """
    separators = (",", ":") if indent is None else (",", ": ")
    try:
        return json.dumps(
            value, indent=indent, separators=separators, ensure_ascii=ascii_only, allow_nan=False
        )
    except RecursionError as error:
        raise ValueError(TOO_DEEP) from error


def not_finite(value: Any) -> Iterator[str]:
    """Yield the JSON pointer (RFC 6901) of each number in a value that is not finite, in order.

    The parser makes infinity of 1E400.
    """
    left: list[Iterator[tuple[Any, Any]]] = [iter([("", value)])]  # entries to come
    keys: list[Any] = []  # of the arrays and objects that are open
    while left:  # pragma: no branch: tests/gltf/test_json_text.py
        for key, entry in left[-1]:
            if isinstance(entry, dict | list):
                keys.append(key)
                left.append(iter(entry.items() if isinstance(entry, dict) else enumerate(entry)))
                break
            if isinstance(entry, float) and not math.isfinite(entry):
                yield "/".join(str(one).replace("~", "~0").replace("/", "~1") for one in (*keys, key))
        else:
            left.pop()
            del keys[-1:]
