"""Names in files cannot talk to the terminal: what is not printable is shown as an escape, everywhere."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Any

import pytest

from skinbake.cli.console import json_text
from skinbake.errors import Place, printable_lines
from tests.support.command_line import call, run
from tests.support.models import FOLDER, baked, edited, rewritten

if sys.platform == "win32":
    pytest.skip("no file has such a name on Windows", allow_module_level=True)

EVIL = "\x1b]0;owned\x07\x1b[31m\r\x9b2J\x7f\u202egpj.\u2066\u200f\x85\u2028"
FORBIDDEN = [c.encode() for c in "\x1b\x07\r\x9b\x7f\u202e\u2066\u200f\x85\u2028"]
UTF_8 = {"PYTHONIOENCODING": "utf-8"}


def renamed(content: Any) -> None:
    """Put the characters into every name that glTF has."""
    for array in (
        "meshes",
        "skins",
        "nodes",
        "materials",
        "animations",
        "accessors",
        "bufferViews",
        "images",
    ):
        for number, entry in enumerate(content.get(array, [])):
            entry["name"] = f"{array}{number}{EVIL}\nforged: line"
    content["materials"] = [{"name": EVIL, "extensions": {EVIL: {}}}]
    content["extensionsUsed"] = [EVIL]
    content["asset"]["generator"] = EVIL
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    attributes["_" + EVIL] = attributes["POSITION"]


@pytest.fixture(scope="module")
def evil(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model whose names, and whose own name, hold what a terminal would obey."""
    folder = tmp_path_factory.mktemp("evil")
    path = edited("bent_tube.glb", folder / "in", renamed)
    return path.rename(folder / f"a{EVIL}.glb")


def broken(content: Any) -> None:
    renamed(content)
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    attributes["WEIGHTS_0"] = attributes["POSITION"]
    content["extensionsRequired"] = [EVIL]


COMMANDS = [
    ["bake", "{}", "-o", "{}.out.glb", "-vv", "--timings"],
    ["bake", "{}", "{0}", "--out-dir", "{}.out", "--json", "--jobs", "2", "-vv"],
    ["bake", "{}", "-o", "{}.gltf", "--generate-normals", "--weld", "skin"],
    ["verify", "{}", "--poses", "rest", "-vv"],
    ["verify", "{}.out.glb", "--poses", "animation", "--samples", "2", "-v"],
    ["verify", "{}.out.glb", "--poses", "rest", "--json"],
    ["shader", "--lang", "glsl", "--for", "{}.out.glb", "-v"],
    ["shader", "--lang", "glsl", "--for", "{}.out.glb", "-o", "{}.glsl"],
    ["inspect", "{}"],
    ["inspect", "{}.out.glb", "--json"],
    ["view", "{}", "-o", "{}.html"],
    ["verify", "{}.out.glb", "--poses", "rest", "--html", "{}.report.html"],
    ["strip", "{}.out.glb", "-o", "{}.stripped.glb"],
    ["inspect", "{}.missing.glb"],
    ["inspect", "{}", "--no-such" + EVIL],
    ["inspect", "{}", EVIL],
    ["bake", "{}", "--weighting", EVIL],
    ["verify", "{}", "--poses", EVIL],
    [EVIL],
]


OWN = ("inspect", "shader")
"""Commands that run as processes of their own; the others print by the same functions."""


def said(*arguments: str | Path) -> bytes:
    way = run if arguments[0] in OWN else call
    process = way(*arguments, env=UTF_8)
    assert b"Traceback" not in process.stderr
    return process.stdout + process.stderr


@pytest.mark.slow
def test_no_command_prints_a_control_character_of_a_file(evil: Path) -> None:
    """In this order: later commands read what earlier ones have written."""
    for pattern in COMMANDS:
        arguments = [argument.replace("{0}", "{}").replace("{}", str(evil)) for argument in pattern]
        text = said(*arguments)
        assert text, pattern
        assert [c for c in FORBIDDEN if c in text] == [], (pattern, text)
        assert not any(line.startswith(b"forged") for line in text.splitlines()), (pattern, text)


@pytest.mark.slow
def test_metadata_of_a_bake_forges_no_line(tmp_path: Path) -> None:
    model = baked(FOLDER / "bent_tube.glb", tmp_path / "tube.glb")
    metadata = model.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]
    names = ("generator", "gradients", "frame", "weighting", "neighbours", "encoding", "layout")
    metadata.update({name: f"{name}\nforged: line" for name in names})
    metadata["digest"]["POSITION\nforged: line"] = 32 * "0"
    text = said("inspect", rewritten(model, model.path))
    assert text.count(b"\\nforged: line") == 9  # the damage that is told, too
    assert b"\nforged" not in text
    # Such a bake is broken, so its primitive is not counted as none.
    assert b"\n  structure  failed\n" in said("verify", model.path)


@pytest.mark.slow
@pytest.mark.parametrize("command", [["bake", "--dry-run"], ["verify"], ["inspect"]])
def test_errors_are_no_exception(command: list[str], evil: Path, tmp_path: Path) -> None:
    path = edited("bent_tube.glb", tmp_path, broken)
    text = said(command[0], path, *command[1:])
    assert b"error" in text or b"warning" in text
    assert [c for c in FORBIDDEN if c in text] == [], text


def test_json_has_the_names_as_they_are(evil: Path) -> None:
    process = call("inspect", evil, "--json", env=UTF_8)
    content = json.loads(process.stdout)
    assert content["input"] == str(evil)
    assert "α" in json_text({"α": 1})


def test_escapes_are_those_of_python_and_json() -> None:
    assert printable_lines("a\x1b[0mb\nc\u202ed\re") == "a\\x1b[0mb\nc\\u202ed\\re"
    assert str(Place("a\x1b\n.glb", 1, "\u202e")) == 'a\\x1b\\n.glb: mesh 1 "\\u202e"'
    text = "\x1b\x7f\x9b\u202e\ud800\U000e0001ä"
    assert json_text(text) == '"\\u001b\\u007f\\u009b\\u202e\\ud800\\udb40\\udc01ä"'
    assert json.loads(json_text(text)) == text


def test_what_modules_log_is_printable_too(capsys: pytest.CaptureFixture[str]) -> None:
    from skinbake.jobs.work import log_to_stderr

    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    root.handlers.clear()
    try:
        log_to_stderr(logging.INFO)
        logging.getLogger("skinbake").info("read %s", EVIL)
    finally:
        root.handlers[:] = before
        root.setLevel(level)
    shown = capsys.readouterr().err
    assert shown.startswith("skinbake: read \\x1b]0;owned\\x07")
    assert not set(EVIL) & set("\x1b\x07\r\x9b\u202e") & set(shown)
