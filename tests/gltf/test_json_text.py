"""JSON of any depth (RFC 8259); the oracle is Python's own parser and writer."""

from __future__ import annotations

import json
from typing import Any

import pytest

from skinbake.gltf import json_text

PLAIN = [
    "[]",
    "{}",
    ' {"a" : [1, -2.5e3, "\\u00e4\\"\\n", true, false, null, {}, [], [[ ]]], "a2": {"c":"d", "b":{}} }\r\n\t',
    "3",
    '"text"',
    '{"twice": 1, "other": 2, "twice": [3]}',
    "[123456789012345678901234567890, 1e400]",
]
BROKEN = [
    "",
    "[",
    "]",
    "[1",
    "[1,]",
    "[,1]",
    "[1 2]",
    "[1}",
    '{"a"}',
    '{"a":}',
    '{"a":1,}',
    "{1:2}",
    "{a:1}",
    '{"a":1]',
    "[1] 2",
    "[NaN]",
    "[-Infinity]",
    "[tru]",
    '["open',
    "[[1]]]",
]


def nested(depth: int, *, objects: bool) -> str:
    return '{"a":' * depth + "1" + "}" * depth if objects else "[" * depth + "]" * depth


@pytest.mark.parametrize("text", BROKEN)
def test_broken_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        json_text.parsed(text)


@pytest.mark.slow
@pytest.mark.parametrize("objects", [False, True])
def test_deep_texts_come_back_as_they_were_or_are_refused(objects: bool) -> None:
    text = nested(100, objects=objects)
    assert json_text.written(json_text.parsed(text), indent=None, ascii_only=True) == text
    with pytest.raises(ValueError, match="nested too deep"):
        json_text.parsed(nested(100_000, objects=objects))
    value: Any = 1
    for _ in range(100_000):
        value = [value]
    with pytest.raises(ValueError, match="nested too deep"):
        json_text.written(value, indent="  ", ascii_only=True)


def test_plain_texts_are_written_as_the_json_library_writes_them() -> None:
    value = json.loads(PLAIN[2])
    for indent in (None, "\t"):
        separators = (",", ":") if indent is None else (",", ": ")
        for ascii_only in (False, True):
            assert json_text.written(value, indent=indent, ascii_only=ascii_only) == json.dumps(
                value, indent=indent, separators=separators, ensure_ascii=ascii_only
            )


def test_numbers_that_are_not_finite_are_not_written() -> None:
    value: Any = [float("inf")]
    with pytest.raises(ValueError, match="JSON compliant"):
        json_text.written(value, indent=None, ascii_only=False)


def test_each_number_that_is_not_finite_has_its_pointer() -> None:
    value = {"a": [1.0, float("inf"), {"b/c~": float("nan")}], "d": -float("inf"), "e": 2}
    assert list(json_text.not_finite(value)) == ["/a/1", "/a/2/b~1c~0", "/d"]
