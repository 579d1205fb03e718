"""The npm package and ``skinbake shader --target babylon`` have one source: the templates."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import pytest

from skinbake.choices import Language, Lighting, Method
from skinbake.errors import ChoiceError
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import babylon_package, shader_made
from skinbake.version import __version__
from tests.babylon.write_package import FOLDER
from tests.support.node import SUPPORT
from tests.support.whole_fields import shader_text


def test_the_module_is_what_the_command_writes() -> None:
    """``python -m tests.babylon.write_package`` writes it."""
    module = (FOLDER / "index.js").read_bytes().decode("ascii")
    assert module == shader_text(ShaderChoices(Language.GLSL, target="babylon"))
    assert babylon_package() == {"index.js": module}


def test_the_package_has_the_version_of_skinbake_and_names_its_files() -> None:
    package = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    assert package["version"] == __version__
    assert {name for name in package["files"] if not (FOLDER / name).is_file()} == set()


def test_the_package_asks_for_the_version_of_babylon_that_is_tested() -> None:
    package = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    tested = json.loads((SUPPORT / "package.json").read_text(encoding="utf-8"))["devDependencies"]
    peers = package["peerDependencies"]
    assert {name: f"^{tested[name]}" for name in peers} == peers


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"method": Method.DQS, "lighting": Lighting.EXACT}, "Babylon.js blends joint matrices"),
        (
            {"lighting": Lighting.APPROXIMATED},
            "--target babylon: use --lighting accurate; approximated lighting is Babylon.js's own",
        ),
        (
            {"lighting": Lighting.DIRECT},
            "its module corrects normals by the accurate algorithm only; use --lighting accurate",
        ),
        ({"influences": 12}, "bake with --limit-influences 8"),
        ({"influences": 2}, "use --influences 4"),
    ],
)
def test_what_babylon_cannot_use_is_refused(changes: dict[str, Any], reason: str) -> None:
    choices = replace(ShaderChoices(Language.GLSL, target="babylon"), **changes)
    with pytest.raises(ChoiceError, match=re.escape(reason)):
        shader_made(choices)


def test_a_file_s_influences_and_mirrors_change_nothing() -> None:
    """The module sees to both when it runs."""
    usual = ShaderChoices(Language.GLSL, target="babylon")
    texts = [
        shader_made(choices)[0].splitlines()
        for choices in (usual, replace(usual, influences=8, mirrored_joints=True))
    ]
    assert [line for line in texts[0] if "--" not in line] == [line for line in texts[1] if "--" not in line]
