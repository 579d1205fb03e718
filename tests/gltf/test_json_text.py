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


def in_a_loop(text: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Parse with Python's own parser at the end of its depth from the start."""

    def too_deep(self: json.JSONDecoder, text: str) -> Any:
        raise RecursionError

    with monkeypatch.context() as patch:
        patch.setattr(json.JSONDecoder, "decode", too_deep)
        return json_text.parsed(text)


@pytest.mark.parametrize("text", PLAIN)
def test_the_loop_reads_what_the_library_reads(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = in_a_loop(text, monkeypatch)
    assert json.dumps(found) == json.dumps(json.loads(text))  # key order counts


@pytest.mark.parametrize("text", BROKEN)
def test_the_loop_refuses_what_the_library_refuses(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"."):
        json_text.parsed(text)
    with pytest.raises(ValueError, match=r"."):
        in_a_loop(text, monkeypatch)


@pytest.mark.parametrize("objects", [False, True])
@pytest.mark.parametrize(
    "depth",
    [900, 1100, *(pytest.param(depth, marks=pytest.mark.slow) for depth in (20_000, json_text.DEEPEST - 1))],
)
def test_deep_texts_come_back_as_they_were(depth: int, objects: bool) -> None:
    text = nested(depth, objects=objects)
    assert json_text.written(json_text.parsed(text), indent=None, ascii_only=True) == text


def test_a_deep_text_is_written_on_one_line_whatever_the_indentation() -> None:
    text = '{"a":[1,"ä"],"deep":' + nested(20_000, objects=False) + "}"
    assert json_text.written(json_text.parsed(text), indent="  ", ascii_only=False) == text


def test_plain_texts_are_written_as_the_json_library_writes_them() -> None:
    value = json.loads(PLAIN[2])
    for indent in (None, "\t"):
        separators = (",", ":") if indent is None else (",", ": ")
        for ascii_only in (False, True):
            assert json_text.written(value, indent=indent, ascii_only=ascii_only) == json.dumps(
                value, indent=indent, separators=separators, ensure_ascii=ascii_only
            )


@pytest.mark.parametrize("deep", [False, True])
def test_numbers_that_are_not_finite_are_not_written(deep: bool) -> None:
    value: Any = float("inf")
    for _ in range(2000 if deep else 1):
        value = [value]
    with pytest.raises(ValueError, match="JSON compliant"):
        json_text.written(value, indent=None, ascii_only=False)


def test_each_number_that_is_not_finite_has_its_pointer() -> None:
    value = {"a": [1.0, float("inf"), {"b/c~": float("nan")}], "d": -float("inf"), "e": 2}
    assert list(json_text.not_finite(value)) == ["/a/1", "/a/2/b~1c~0", "/d"]


def test_what_is_nested_past_all_sense_is_refused() -> None:
    with pytest.raises(ValueError, match=f"nested deeper than {json_text.DEEPEST} levels"):
        json_text.parsed(nested(json_text.DEEPEST + 1, objects=False))
