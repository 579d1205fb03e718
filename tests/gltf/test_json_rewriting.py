"""A changed document keeps the text of all that is unchanged."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skinbake import strip
from skinbake.gltf import json_text
from skinbake.gltf.glb import join_glb
from skinbake.gltf.writing.rewriting import rewritten
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, SHARED, bake, copied

SPACES = ["", " ", "\n", "\r\n\t", "  \n"]
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(max_size=5),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("abcdeé"), inner, max_size=4),
    max_leaves=12,
)


def spelled(value: Any, random: Random) -> str:
    """Return a text of a value as other programs may write it."""
    if isinstance(value, dict):
        members = (f"{spaced(key, random)}:{spaced(entry, random)}" for key, entry in value.items())
        return f"{{{','.join(members) or random.choice(SPACES)}}}"
    if isinstance(value, list):
        return f"[{','.join(spaced(entry, random) for entry in value) or random.choice(SPACES)}]"
    if isinstance(value, float):
        return random.choice([repr(value), f"{value:.20e}", f"{value:.17E}"])
    return json.dumps(value, ensure_ascii=random.random() < 0.5)


def spaced(value: Any, random: Random) -> str:
    return f"{random.choice(SPACES)}{spelled(value, random)}{random.choice(SPACES)}"


def holders(value: Any) -> Iterator[Any]:
    if isinstance(value, dict | list):
        yield value
        for entry in value.values() if isinstance(value, dict) else value:
            yield from holders(entry)


class FormerText(NamedTuple):
    text: str
    value: Any


def former_text(value: Any, random: Random) -> FormerText:
    text = spaced(value, random)
    return FormerText(text, json_text.parsed(text))


def with_additions(value: Any, random: Random) -> Any:
    """Return a copy with new members and entries at the ends, which shares what has none."""
    more = random.choice([1, -0.0, "ÿ", [1, {"y": 2e-9}], {"y": [True]}])
    if isinstance(value, dict):
        changed: Any = {key: with_additions(entry, random) for key, entry in value.items()}
        changed.update({"x": more} if random.random() < 0.5 else {})
    elif isinstance(value, list):
        changed = [with_additions(entry, random) for entry in value] + [more] * random.randrange(3)
    else:
        return value
    return value if exact(changed) == exact(value) else changed


def without(value: Any, former: Any) -> Any:
    """Return a copy of a value without the additions to a former one, which shares what had none."""
    if isinstance(former, dict):
        left: Any = {key: without(value[key], entry) for key, entry in former.items()}
    elif isinstance(former, list):
        left = [without(value[number], entry) for number, entry in enumerate(former)]
    else:
        return value
    return value if exact(left) == exact(value) else left


def exact(value: Any) -> str:
    """Return a text that tells 1 from 1.0, and 0.0 from −0.0."""
    return json.dumps(value)


@pytest.mark.slow
@given(VALUES, st.sampled_from([None, "  ", "\t"]), st.booleans(), st.integers(0, 1 << 32))
def test_additions_leave_the_text_and_can_be_undone(
    entry: Any, indent: str | None, ascii_only: bool, seed: int
) -> None:
    random = Random(seed)
    former = former_text({"a": entry, "b": 0.1}, random)
    assert rewritten(*former, former.value, indent=indent, ascii_only=ascii_only) == former.text
    value = with_additions(former.value, random)
    text = rewritten(*former, value, indent=indent, ascii_only=ascii_only)
    assert exact(json_text.parsed(text)) == exact(value)
    baked = FormerText(text, json_text.parsed(text))
    left = without(baked.value, former.value)
    undone = rewritten(*baked, left, indent=indent, ascii_only=ascii_only)
    assert exact(json_text.parsed(undone)) == exact(former.value)
    if all(holders(former.value)):  # white space in an empty object goes when something comes into it
        assert undone == former.text


@pytest.mark.slow
@given(VALUES, st.sampled_from([None, " "]), st.integers(0, 1 << 32))
def test_any_change_is_written(entry: Any, indent: str | None, seed: int) -> None:
    random = Random(seed)
    former = former_text({"a": entry, "b": [entry, 1, 1.0]}, random)
    value = copy.deepcopy(former.value)
    for holder in list(holders(value)):
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        change = random.choice(["nothing", "remove", "replace", "reverse", "first"])
        if change == "remove" and keys:
            del holder[random.choice(keys)]
        elif change == "replace" and keys:
            holder[random.choice(keys)] = random.choice([0, -0.0, 1.0, "1", None, [], {"a": 1}, entry])
        elif change == "reverse" and isinstance(holder, list):
            holder.reverse()
        elif change == "first" and isinstance(holder, dict):
            members = {"first": entry, **holder}
            holder.clear()
            holder.update(members)
    text = rewritten(*former, value, indent=indent, ascii_only=False)
    assert exact(json_text.parsed(text)) == exact(value)


@pytest.mark.parametrize(
    ("text", "change", "expected"),
    [
        ('{"a" : 1E0}', {"b": 2}, '{"a" : 1E0,"b" : 2}'),
        ('{\r\n  "a": -0\r\n}', {"b": [1]}, '{\r\n  "a": -0,\r\n  "b": [\r\n    1\r\n  ]\r\n}'),
        ('\ufeff{ "a":[1 , 2] }\n', {"a": [1, 2, 3]}, '\ufeff{ "a":[1 , 2 , 3] }\n'),
        ("{ }", {"b": 1}, '{\n  "b": 1\n}'),
        ('{"\\u00e4":"\\/", "a": 1}', {"a": 2}, '{"\\u00e4":"\\/", "a": 2}'),
        ('{"a":[[1e2],[3.0],[4]]}', {"a": [[4], [1, 5]]}, '{"a":[[4],[1,5]]}'),
        ('{"a": 1, "a": 2}\n', {"b": 3}, '{\n  "a": 2,\n  "b": 3\n}\n'),
        ('{"a":{}, "a":{"n":1}}', {"a": {"n": 2}}, '{"a":{"n":2}}'),
        ('{"a":[], "a":[1]}', {"a": [1, 2]}, '{"a":[1,2]}'),
        ('{"a":["],","]}"], "a":[[],7]}', {"a": [[5], 7]}, '{"a":[[5],7]}'),
        ('{"a": { "b": 1 } , "c": [ 2 ]}', {"a": {}, "c": []}, '{"a": {} , "c": []}'),
        ('{"a":0.0 , "b":1 , "c":1}', {"a": -0.0, "b": 1.0, "c": True}, '{"a":-0.0 , "b":1.0 , "c":true}'),
        ('{"a":{}}', {"a": {"n": 1}}, '{"a":{"n":1}}'),
        ('{"a":1}', {"ä": 2}, '{"a":1,"ä":2}'),
        ('{"a":1, "a":2}', {"ä": 3}, '{"a":2,"ä":3}'),
        (
            f'{{"a":"{"x" * 256}",\r\n "b": 1}}',
            {"c": {"d": 2}},
            f'{{"a":"{"x" * 256}",\r\n "b": 1,\r\n "c": {{\n    "d": 2\n  }}}}',
        ),
    ],
    ids=[
        "colon",
        "line ends",
        "mark",
        "empty",
        "escapes",
        "arrays",
        "twice",
        "empty first",
        "no entry first",
        "text within",
        "emptied",
        "equal numbers",
        "one line",
        "other letters",
        "other letters, twice",
        "late line ends",
    ],
)
def test_new_text_looks_like_the_text_around_it(text: str, change: dict[str, Any], expected: str) -> None:
    value = json.loads(text.removeprefix("\ufeff"))
    indent = "  " if "\n" in expected else None
    found = rewritten(*FormerText(text, value), {**value, **change}, indent=indent, ascii_only=False)
    assert found == expected


def test_new_text_may_be_ascii_alone() -> None:
    value = {"a": "é"}
    found = rewritten(*FormerText('{"a":"é"}', value), {**value, "ä": "ü"}, indent=None, ascii_only=True)
    assert found == '{"a":"é","\\u00e4":"\\u00fc"}'


def test_members_in_another_order_keep_their_text() -> None:
    text = '{"a" : 1e0, "b" : [2E0],\t"c" : 3.50}'
    value = json.loads(text)
    for order, expected in (
        ("bca", '"b" : [2E0],\t"c" : 3.50,\t"a" : 1e0'),
        ("anb", '"a" : 1e0,\t"n" : 5, "b" : [2E0]'),
        ("nc", '"n" : 5,\t"c" : 3.50'),
    ):
        ordered = {key: {**value, "n": 5}[key] for key in order}
        found = rewritten(*FormerText(text, value), ordered, indent=None, ascii_only=False)
        assert found == f"{{{expected}}}"


def test_additions_do_not_repeat_a_long_gap() -> None:
    gap = " " * 1000
    for text in (f'{{"a":1,{gap}"b":2}}', f'{{{gap}"a":1}}', f'{{"a":{gap}1}}'):
        value = json.loads(text)
        more = {f"n{number}": number for number in range(50)}
        found = rewritten(*FormerText(text, value), {**value, **more}, indent=None, ascii_only=False)
        assert found.startswith(text.removesuffix("}") + ",")
        assert json.loads(found) == {**value, **more}
        assert len(found) < 2 * len(text)


@pytest.mark.parametrize(("length", "repeats"), [(256, True), (257, False)])
def test_additions_repeat_a_gap_up_to_256_characters(length: int, repeats: bool) -> None:
    """The gap is what stands between two entries, comma included, or between a key and its value."""
    comma, colon = "," + " " * (length - 1), ":" + " " * (length - 1)
    for text, short in (
        (f'{{"o": {{"a": 1{comma}"b": 2', f'{comma if repeats else f",{chr(10)}    "}"n": 3'),
        (f'{{"o": {{"a": 1, "b"{colon}2', f', "n"{colon if repeats else ": "}3'),
    ):
        value = json.loads(text + "}}")
        changed = {"o": {**value["o"], "n": 3}}
        found = rewritten(*FormerText(text + "}}", value), changed, indent="  ", ascii_only=False)
        assert found == text + short + "}}"


def test_a_moved_object_keeps_its_text() -> None:
    text = '{"a":[{"n":1.0e0}, {"n":2E0}, {"n":3.00}]}'
    value = json.loads(text)
    first, second, third = value["a"]
    for order, expected in (
        ([first, third], '{"n":1.0e0}, {"n":3.00}'),
        ([third], '{"n":3.00}'),
        ([first, {"n": 5}, third], '{"n":1.0e0}, {"n":5}, {"n":3.00}'),
        ([third, second], '{"n":3.00}, {"n":2.0}'),
    ):
        found = rewritten(*FormerText(text, value), {"a": order}, indent=None, ascii_only=False)
        assert found == f'{{"a":[{expected}]}}'


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_baked_text_differs_by_whole_lines(tmp_path: Path, line_end: str) -> None:
    source = copied(SHARED, tmp_path)
    content = json.loads(source.read_text(encoding="utf-8"))
    content["extras"] = {"small": "@", "zero": "@@"}
    text = json.dumps(content, indent="\t", separators=(" ,", " : "))
    text = text.replace('"@@"', "-0").replace('"@"', "4.50E-7").replace("\n", line_end)
    source.write_bytes(text.encode())
    baked, restored = tmp_path / "baked.gltf", tmp_path / "restored.gltf"
    bake(source, baked)
    kept, lines = text.split(line_end), baked.read_bytes().decode().split(line_end)
    matches = SequenceMatcher(None, kept, lines, autojunk=False).get_opcodes()
    changed = [line for kind, first, last, *_ in matches if kind != "equal" for line in kept[first:last]]
    assert all(re.search(r"_0|[]}0-9]$", line) for line in changed), (
        changed
    )  # a comma follows, or a number is new
    assert len(changed) < 30
    strip(str(baked), str(restored))
    assert restored.read_bytes() == source.read_bytes()


def test_removed_influences_come_back_as_the_text_around_them(tmp_path: Path) -> None:
    model = read(FOLDER / "two_sets.glb")
    text = json.dumps(model.content, separators=(" , ", " : "), sort_keys=True)
    source, baked, restored = (tmp_path / f"{name}.glb" for name in ("source", "baked", "restored"))
    source.write_bytes(b"".join(join_glb(text.encode(), [model.binary_chunk or b""], ())))
    bake(source, baked, limit_influences=4)
    assert not read(baked).has_attribute("JOINTS_1")
    strip(str(baked), str(restored))
    assert restored.read_bytes() == source.read_bytes()
