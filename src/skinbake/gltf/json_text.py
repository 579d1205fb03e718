"""JSON text to values and back, at any depth (RFC 8259).

Python's own parser and writer do the work. They are recursive and fail at some hundred levels. Deeper texts
go through the loops below, which are slower and keep their state in lists.
"""

from __future__ import annotations

import gc
import json
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

DEEPEST = 1 << 16
"""The largest number of levels of a text. The Khronos validator runs out of memory somewhere past 10,000."""

_SPACE = re.compile(r"[ \t\n\r]*")
_CLOSING = {"[": "]", "{": "}"}


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
    """Return the value of a JSON text; ValueError if it is invalid, or has more levels than DEEPEST."""
    decoder = json.JSONDecoder(parse_constant=_reject_constant)
    with collector_off():
        try:
            return decoder.decode(text)
        except RecursionError:
            return _parsed_in_a_loop(text, decoder)


def _reject_constant(name: str) -> float:
    raise ValueError(f"{name} is not valid JSON")


def _parsed_in_a_loop(text: str, decoder: json.JSONDecoder) -> Any:
    root: list[Any] = []
    holders: list[Any] = [root]  # the root's holder, then the arrays and objects that are open
    at = _after_space(text, 0)
    while True:
        key, at = _key(text, at, decoder) if isinstance(holders[-1], dict) else ("", at)
        opening = text[at : at + 1]
        if opening in _CLOSING:
            value: Any = [] if opening == "[" else {}
            at = _after_space(text, at + 1)
            is_open = text[at : at + 1] != _CLOSING[opening]
            at += not is_open
        else:
            is_open = False
            value, at = decoder.raw_decode(text, at)
        holder = holders[-1]
        if isinstance(holder, dict):
            holder[key] = value
        else:
            holder.append(value)
        if is_open:
            holders.append(value)
            if len(holders) > DEEPEST:
                raise ValueError(f"it is nested deeper than {DEEPEST} levels")
            continue
        at = _closed(text, at, holders)
        if len(holders) == 1:
            if at != len(text):
                raise json.JSONDecodeError("Extra data", text, at)
            return root[0]


def _closed(text: str, at: int, holders: list[Any]) -> int:
    """Close the holders that end after a value; return where the next value begins, or the text ends."""
    while True:
        at = _after_space(text, at)
        if len(holders) == 1:
            return at
        following = text[at : at + 1]
        if following == ",":
            return _after_space(text, at + 1)
        if following != ("}" if isinstance(holders[-1], dict) else "]"):
            raise json.JSONDecodeError("Expecting ',' delimiter", text, at)
        holders.pop()
        at += 1


def _after_space(text: str, at: int) -> int:
    found = _SPACE.match(text, at)
    return at if found is None else found.end()


def _key(text: str, at: int, decoder: json.JSONDecoder) -> tuple[str, int]:
    if text[at : at + 1] != '"':
        raise json.JSONDecodeError("Expecting property name enclosed in double quotes", text, at)
    key, at = decoder.raw_decode(text, at)
    at = _after_space(text, at)
    if text[at : at + 1] != ":":
        raise json.JSONDecodeError("Expecting ':' delimiter", text, at)
    return str(key), _after_space(text, at + 1)


def written(value: Any, *, indent: str | None, ascii_only: bool) -> str:
    """Return a JSON text, on one line without ``indent``; ValueError for numbers that are not finite.

    A text that is too deep for Python's own writer is always on one line: with indentation, its length would
    grow with the square of its depth.
    """
    options: dict[str, Any] = {"ensure_ascii": ascii_only, "allow_nan": False}
    separators = (",", ":") if indent is None else (",", ": ")
    try:
        return json.dumps(value, indent=indent, separators=separators, **options)
    except RecursionError:
        return "".join(_pieces(value, json.JSONEncoder(**options)))


def not_finite(value: Any) -> Iterator[str]:
    """Yield the JSON pointer (RFC 6901) of each number in a value that is not finite, in order.

    The parser makes infinity of 1E400.
    """
    left: list[Iterator[tuple[Any, Any]]] = [iter([("", value)])]  # entries to come
    keys: list[Any] = []  # those of the arrays and objects that are open
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


def _pieces(value: Any, encoder: json.JSONEncoder) -> Iterator[str]:
    """Yield the text of a value piece by piece."""
    left: list[tuple[Iterator[Any], str]] = [(iter([value]), "")]  # entries to come, and the closing text
    is_first = True
    while left:
        entries, closing = left[-1]
        try:
            entry = next(entries)
        except StopIteration:
            left.pop()
            is_first = False
            yield closing
            continue
        if not is_first:
            yield ","
        if closing == "}":
            key, entry = entry
            yield encoder.encode(key) + ":"
        is_first = isinstance(entry, list | dict)
        if isinstance(entry, list):
            left.append((iter(entry), "]"))
            yield "["
        elif isinstance(entry, dict):
            left.append((iter(entry.items()), "}"))
            yield "{"
        else:
            yield encoder.encode(entry)
