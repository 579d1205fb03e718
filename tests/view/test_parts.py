"""The parts of the page: its modules as one script, and its texts of shaders."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from skinbake.commands import view
from skinbake.view.sources import FOLDER, MODULES, filled_page, script
from skinbake.view.texts import packed_texts, shown_choices
from tests.support.command_line import invoke
from tests.support.models import edited

DECLARED = re.compile(r"^(?:export )?(?:async )?(?:const|let|class|function)\s+(\w+)", re.MULTILINE)


def test_every_module_comes_after_those_that_it_imports() -> None:
    for number, name in enumerate(MODULES):
        found = re.findall(r"from '\./([a-z]+\.js)'", (FOLDER / name).read_text(encoding="utf-8"))
        assert set(found) <= set(MODULES[:number]), name
    assert {path.name for path in FOLDER.glob("*.js")} == set(MODULES)


def test_the_script_has_each_name_once_and_no_link() -> None:
    names = DECLARED.findall(script())
    assert len(names) == len(set(names))
    assert len(names) > 100
    assert not re.search(r"^(import|export) ", script(), re.MULTILINE)


def test_nothing_in_the_script_or_style_can_end_its_element() -> None:
    for text in (script(), (FOLDER / "page.css").read_text(encoding="utf-8")):
        assert not re.search(r"</(script|style)|<!--|\r", text, re.IGNORECASE)


def test_the_texts_are_what_skinbake_shader_writes() -> None:
    """A few of them, by the command line; the others are made by the same function."""
    packed = packed_texts()
    assert set(packed["texts"]) == {name for name, _ in shown_choices()}

    def text(name: str) -> str:
        parts = [packed["paragraphs"][number] for number in packed["texts"][name]]
        return "\n\n".join("\n".join(packed["lines"][number] for number in part) for part in parts)

    plain = ["--frame", "normal"]
    tangent = ["--frame", "tangent", "--encoding", "snorm16", "--morphs", "tangent", "--mirrored-joints"]
    dual = ["--method", "dqs", "--influences", "8", "--encoding", "packed8"]
    for name, options in (
        ("lbs_accurate/4/normal/float32/none/plain", [*plain, "--normal-map"]),
        ("lbs_standard/4/normal/float32/none/plain", ["--lighting", "standard", *plain]),
        ("dqs_exact/8/normal/packed8/none/plain", [*dual, *plain, "--normal-map"]),
        ("lbs_accurate/4/tangent/snorm16/tangent/mirrored", [*tangent, "--normal-map"]),
    ):
        assert text(name) == invoke("shader", "--lang", "glsl", *options).stdout, name


def test_the_wheel_has_every_file_that_is_no_code() -> None:
    """Files of C are compiled. All others must be named in pyproject.toml."""
    package = FOLDER.parents[2]
    project = tomllib.loads((package.parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = project["tool"]["setuptools"]["package-data"]["skinbake"]
    named = {path for pattern in patterns for path in package.glob(pattern) if path.is_file()}
    code = {".py", ".c", ".h", ".so", ".pyd", ".pyc"}
    found = {path for path in package.rglob("*") if path.is_file() and path.suffix not in code}
    assert found == named


def test_no_two_choices_have_one_name() -> None:
    names = [name for name, _ in shown_choices()]
    assert len(names) == len(set(names))


def test_a_value_is_never_filled_in_again() -> None:
    empty = dict.fromkeys(("version", "model", "texts", "given"), "")
    assert "@{model}@{script}" in filled_page({**empty, "title": "@{model}@{script}"})
    with pytest.raises(KeyError):
        filled_page(empty)


@pytest.mark.slow
def test_a_large_page_says_what_makes_it_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An image of a megabyte, and a limit of a megabyte in place of fifty."""
    noise = np.random.default_rng(0).integers(0, 256, (600, 600, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")

    def paint(content: dict[str, Any]) -> None:
        content["images"] = [{"uri": "noise.png"}]

    path = edited("bent_tube.glb", tmp_path, paint)
    for limit, is_told in ((1_000_000, True), (view.LARGE_PAGE, False)):
        monkeypatch.setattr(view, "LARGE_PAGE", limit)
        result = invoke("view", path, "-o", tmp_path / "page.html")
        assert result.exit_code == 0, result.output
        told = "the page has 2 MB, because the model has 1 MB, of which 1 MB are images: show a copy"
        assert (told in result.stderr) == is_told
