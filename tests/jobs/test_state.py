"""A state file may hold anything, from a power cut or a stranger: it costs a bake, and no more."""

from __future__ import annotations

import json
import os
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skinbake.jobs import state
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.state import HEADER, Recipe, State, recipe
from skinbake.jobs.work import Job
from skinbake.options import STATE_NAME
from tests.support.baking import bake_work, options_of
from tests.support.models import copied

KEY = b'{"key": "bake a.glb", '
DAMAGED = {
    "deep": KEY + b'"x": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "deep objects": b'{"key":' * 100_000,
    "not UTF-8": b'\xff\xfe{"key": "a"}',
    "NUL": b"\0" * 4096,
    "no object": b"[1, 2]",
    "a number": b"1" * 10_000,
    "a key that is none": b'{"key": ["a"]}',
    "no key": b"{}",
    "cut": b'{"key": "bake a.glb", "read": {"a',
    "surrogates": b'{"key": "\\ud800"}',
    "a long line": b'{"key": "' + b"x" * (state.LONGEST + 10) + b'"}',
    "a long one without an end": b"y" * (3 * state.LONGEST),
    "NaN": b'{"key": NaN}',
    "empty": b"",
}


@pytest.mark.parametrize("line", DAMAGED.values(), ids=DAMAGED)
def test_a_line_that_is_no_record_is_passed_over(line: bytes, tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    good = b'{"key": "verify b.glb", "how": "x"}\n'
    path.write_bytes(HEADER + good + line + b"\n" + good.replace(b"b.glb", b"c.glb"))
    found = State(str(path))
    assert found.known("verify b.glb") == good
    assert found.known("verify c.glb") == good.replace(b"b.glb", b"c.glb")
    found.add(b'{"key": "verify d.glb"}\n')
    found.close()
    assert State(str(path)).known("verify d.glb") is not None


@pytest.mark.parametrize("content", [b"", HEADER[:7], HEADER[:-1]], ids=["empty", "cut", "no end"])
def test_a_head_that_was_cut_begins_anew(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    path.write_bytes(content)
    first = State(str(path))
    assert [notice.code for notice in first.notices] == ["state-damaged"] * bool(content)
    first.add(b'{"key": "a"}\n')
    first.close()
    assert path.read_bytes() == HEADER + b'{"key": "a"}\n'


@pytest.mark.parametrize("content", [b"\0" * 100, b"garbage", b"\xff\xfe", b"{}\n" * 3])
def test_the_name_that_is_ours_may_hold_anything_and_another_name_is_another_s(
    content: bytes, tmp_path: Path
) -> None:
    (tmp_path / STATE_NAME).write_bytes(content)
    (tmp_path / "s.jsonl").write_bytes(content)
    for name, code, after in (
        (STATE_NAME, "state-damaged", HEADER + b'{"key": "a"}\n'),
        ("s.jsonl", "state-foreign", content),
    ):
        found = State(str(tmp_path / name))
        assert [(notice.code, notice.place.file) for notice in found.notices] == [
            (code, str(tmp_path / name))
        ]
        found.add(b'{"key": "a"}\n')
        assert (found.known("a") is None) == (name != STATE_NAME)
        found.close()
        assert (tmp_path / name).read_bytes() == after


def test_a_state_file_that_is_whole_needs_no_words(tmp_path: Path) -> None:
    for content in (None, b"", HEADER, HEADER + b"\xff\n"):
        if content is not None:
            (tmp_path / STATE_NAME).write_bytes(content)
        assert State(str(tmp_path / STATE_NAME)).notices == ()


class Forge:
    """An output that a bake made, its record, and what forgers make of that."""

    def __init__(self, folder: Path) -> None:
        self.source = str(copied("seam.glb", folder / "in"))
        self.target = str(folder / "out" / "seam.glb")
        work = bake_work()
        self.recipe: Recipe = recipe("bake", work.options, str(folder / "out" / STATE_NAME))
        result = FileWork((work,), (self.recipe,))(Job(self.source, self.target))
        assert result.record is not None
        self.note: Any = json.loads(result.record)

    def holds(self, **changes: Any) -> bool:
        record = json.dumps({**self.note, **changes}).encode()
        return self.recipe.still_holds(record, self.source, self.target)


@pytest.fixture
def forge(tmp_path: Path) -> Forge:
    return Forge(tmp_path)


def test_a_true_record_holds(forge: Forge) -> None:
    assert forge.holds()


@pytest.mark.slow
@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize(
    "changes",
    [
        {"read": {"../in/x": None}, "made": {}},
        {"made": {}},
        {"made": {"seam.glb": None}},
        {"made": {"seam.glb": ""}},
        {"made": {"seam.glb": 0}},
        {"made": {"x.glb": None}},
        {"read": {}},
        {"read": {"seam.glb": None}},
        {"read": [["../in/seam.glb", None]]},
        {"made": []},
        {"made": None},
        {"read": "ab"},
        {"made": {"seam.glb": ["x"]}},
    ],
    ids=str,
)
def test_a_record_that_says_nothing_of_source_and_target_holds_nowhere(
    changes: dict[str, Any], there: bool, forge: Forge
) -> None:
    if not there:
        Path(forge.target).unlink()
    assert not forge.holds(**changes)


def test_what_is_read_and_made_must_agree(forge: Forge) -> None:
    """A forger says of the target what it is, as if it had been read, and elsewhere what it was not."""
    digest = forge.note["made"]["seam.glb"]
    assert not forge.holds(
        read={**forge.note["read"], "seam.glb": digest}, made={"seam.glb": "0" * len(digest)}
    )


@pytest.mark.skipif(sys.platform == "win32", reason="FIFOs and links of POSIX")
def test_only_files_that_the_run_has_to_do_with_are_opened(
    forge: Forge, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "in" / "pipe")
    (tmp_path / "secret").write_bytes(b"x")
    opened = []
    original = os.open

    def watched(path: Any, *arguments: Any, **options: Any) -> int:
        opened.append(os.fspath(path))
        return original(path, *arguments, **options)

    monkeypatch.setattr(os, "open", watched)
    for name in ("../secret", "../in/../secret", str(tmp_path / "secret"), "/dev/zero", "/proc/self/environ"):
        for digest in (None, "0" * 32):
            assert not forge.holds(read={**forge.note["read"], name: digest})
    allowed = {forge.source, forge.target}
    assert set(map(os.path.normpath, opened)) <= allowed
    for name in ("../in/pipe", "../in/\0", "../in"):  # it would wait for a writer
        assert not forge.holds(read={**forge.note["read"], name: "0" * 32})


def test_files_below_the_folder_that_was_searched_are_the_run_s(forge: Forge, tmp_path: Path) -> None:
    (tmp_path / "tex").mkdir()
    (tmp_path / "tex" / "a.png").write_bytes(b"x")
    digest = state._digest(str(tmp_path / "tex" / "a.png"))
    more = {**forge.note["read"], "../tex/a.png": digest}
    assert not forge.holds(read=more)
    forge.recipe = recipe("bake", options_of(), str(tmp_path / "out" / STATE_NAME), [str(tmp_path)])
    assert forge.holds(read=more)


def random_value(chance: random.Random, depth: int = 0) -> Any:
    kinds: list[Callable[[], Any]] = [
        lambda: None,
        lambda: chance.choice([True, False, 0, -1, 1e308, 10**30]),
        lambda: "".join(chance.choices("ab/.\\\0\n\x1b\ud800é😀:0123456789abcdef", k=chance.randrange(40))),
        lambda: [random_value(chance, depth + 1) for _ in range(chance.randrange(4))],
        lambda: {
            str(random_value(chance, 9)): random_value(chance, depth + 1) for _ in range(chance.randrange(4))
        },
    ]
    return chance.choice(kinds[: 3 if depth > 3 else 5])()


@pytest.mark.slow
def test_random_records_neither_fail_nor_hold(forge: Forge, tmp_path: Path) -> None:
    """Records with members replaced by anything, and the file's bytes too."""
    chance = random.Random(0)
    true = forge.note
    for _ in range(2000):
        note = dict(true)
        for member in chance.sample(sorted(note), chance.randrange(1, len(note))):
            note[member] = random_value(chance)
        if note == true:
            continue
        record = json.dumps(note).encode()
        assert not forge.recipe.still_holds(record, forge.source, forge.target), note
    path = tmp_path / STATE_NAME
    for _ in range(300):
        data = bytearray(HEADER + json.dumps(true).encode() + b"\n")
        for _ in range(chance.randrange(1, 8)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        known = State(str(path)).known(forge.recipe.key(forge.target))
        if known is not None and json.loads(known) != true:
            assert not forge.recipe.still_holds(known, forge.source, forge.target)
