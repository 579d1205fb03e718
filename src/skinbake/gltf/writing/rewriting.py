"""A changed JSON value as text, in which all that is unchanged keeps its former text.

The spelling of numbers and names, white space and line ends stay. So the text of a baked document differs
from its source by the additions alone, and ``strip`` restores the source byte for byte.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from skinbake.gltf.json_text import collector_off, written

_START = re.compile("\ufeff?[ \t\n\r]*")
_SPACE = re.compile(r"[ \t\n\r]*")
_REMOVED: Any = object()

LONGEST_GAP = 256
"""The most characters of white space that additions repeat: many times a long one would fill the memory."""


def rewritten(former: str, before: Any, value: Any, *, indent: str | None, ascii_only: bool) -> str:
    """Return a text of a value, with parts of the former text, of the value ``before``.

    A part of the value has its former text if it is the same object as in the former value, or an equal
    scalar. All else is written as ``json_text.written`` writes it with these options; ValueError for numbers
    that are not finite, or values nested too deep. A text that has a changed member twice is all written anew
    between the white space at its ends.
    """
    start = _end_of(_START, former, 0)
    writer = _Rewriting(former, indent, ascii_only)
    try:
        with collector_off():
            text, end = writer.entry(start, before, value, 0)
    except (RecursionError, _OtherTextError, json.JSONDecodeError):
        text, end = written(value, indent=indent, ascii_only=ascii_only), len(former.rstrip())
    return former[:start] + text + former[end:]


class _OtherTextError(Exception):
    """The text is not that of the value. For example, it has a member twice, and the value has the last."""


class _Entry(NamedTuple):
    """An entry of an object or array before and after, with its key in an object.

    ``after`` is _REMOVED if it is not there any more.
    """

    key: str | None
    before: Any
    after: Any


class _Part(NamedTuple):
    """The text of an entry, with its key in an object.

    ``separator`` is the text between it and the entry that preceded it, empty if there was none.
    """

    key: str | None
    separator: str
    text: str


class _Rewriting:
    def __init__(self, text: str, indent: str | None, ascii_only: bool) -> None:
        self._text = text
        self._indent = indent
        self._ascii_only = ascii_only
        self._line_end = "\r\n" if "\r\n" in text[:256] else "\n"
        # Only keys and ends are wanted. True instead of each object takes less time, and no memory.
        self._scan = json.JSONDecoder(object_pairs_hook=bool).raw_decode

    def entry(self, at: int, before: Any, after: Any, depth: int) -> tuple[str, int]:
        """Return the text of ``after``, and where the text of ``before`` ends, which begins at ``at``."""
        if after is not before:
            if isinstance(before, dict) and isinstance(after, dict):
                members = [_Entry(key, value, after.get(key, _REMOVED)) for key, value in before.items()]
                return self._holder(
                    at,
                    members,
                    [_Entry(key, _REMOVED, value) for key, value in after.items() if key not in before],
                    depth,
                    after,
                )
            if isinstance(before, list) and isinstance(after, list):
                entries, more = _paired(before, after)
                return self._holder(at, entries, more, depth, None)
        end = self._scan(self._text, at)[1]
        # One and the same scalar: 1 is not 1.0, and 0.0 is not −0.0.
        is_same = after is before or (not isinstance(after, dict | list) and repr(before) == repr(after))
        return self._text[at:end] if is_same else self._fresh(after, depth), end

    def _holder(
        self,
        at: int,
        entries: Sequence[_Entry],
        added: Iterable[_Entry],
        depth: int,
        keys: Iterable[str] | None,
    ) -> tuple[str, int]:
        """Return the text of an object or array, and where its former text ends.

        ``keys`` belong to the object, in their new order, None for an array.
        """
        text, brackets = self._text, "[]" if keys is None else "{}"
        self._expect(brackets[0], at)
        at += 1
        first_space = text[at : _end_of(_SPACE, text, at)] if entries else self._line(depth + 1)
        separator, colon = f",{first_space}", ":" if self._indent is None else ": "
        parts: list[_Part] = []
        for number, entry in enumerate(entries):
            start = _end_of(_SPACE, text, at)
            if number:
                start = _end_of(_SPACE, text, start + 1)
                separator = text[at:start]
            value_start = start
            if entry.key is not None:
                key, key_end = self._scan(text, start)
                if key != entry.key:
                    raise _OtherTextError
                value_start = _end_of(_SPACE, text, key_end)
                self._expect(":", value_start)
                value_start = _end_of(_SPACE, text, value_start + 1)
                colon = text[key_end:value_start]
            if entry.after is _REMOVED:
                at = self._scan(text, value_start)[1]
                continue
            value, at = self.entry(value_start, entry.before, entry.after, depth + 1)
            parts.append(_Part(entry.key, separator if number else "", text[start:value_start] + value))
        end = _end_of(_SPACE, text, at)
        self._expect(brackets[1], end)
        last_space = text[at:end] if entries else self._line(depth)
        if len(separator) > LONGEST_GAP:
            separator = f",{self._line(depth + 1)}"
        if len(colon) > LONGEST_GAP:
            colon = ": "
        for entry in added:
            name = "" if entry.key is None else json.dumps(entry.key, ensure_ascii=self._ascii_only) + colon
            parts.append(_Part(entry.key, "", name + self._fresh(entry.after, depth + 1)))
        if not parts:
            return brackets, end + 1
        if keys is not None:
            by_key = {part.key: part for part in parts}
            parts = [by_key[key] for key in keys]
        pieces = [piece for part in parts for piece in (part.separator or separator, part.text)]
        return "".join([brackets[0], first_space, *pieces[1:], last_space, brackets[1]]), end + 1

    def _expect(self, mark: str, at: int) -> None:
        if self._text[at : at + 1] != mark:
            raise _OtherTextError

    def _fresh(self, value: Any, depth: int) -> str:
        text = written(value, indent=self._indent, ascii_only=self._ascii_only)
        return text.replace("\n", self._line(depth))

    def _line(self, depth: int) -> str:
        """Return the end of a line and the white space of the next one, nothing if all is on one line."""
        return "" if self._indent is None else self._line_end + self._indent * depth


def _end_of(pattern: re.Pattern[str], text: str, at: int) -> int:
    found = pattern.match(text, at)
    return at if found is None else found.end()


def _paired(before: Sequence[Any], after: Sequence[Any]) -> tuple[list[_Entry], list[_Entry]]:
    """Return the former entries of an array, and the new ones behind them.

    An object that is the same as a former one belongs to it. All others belong to the next former one.
    """
    places = {id(value): number for number, value in enumerate(before) if isinstance(value, dict | list)}
    entries: list[_Entry] = []
    for number, value in enumerate(after):
        place = places.get(id(value), -1)
        while len(entries) < place:
            entries.append(_Entry(None, before[len(entries)], _REMOVED))
        if len(entries) == len(before):
            return entries, [_Entry(None, _REMOVED, value) for value in after[number:]]
        entries.append(_Entry(None, before[len(entries)], value))
    return [*entries, *(_Entry(None, value, _REMOVED) for value in before[len(entries) :])], []
