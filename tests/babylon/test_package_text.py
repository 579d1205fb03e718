"""The npm package and ``skinbake shader --target babylon`` have one source: the templates."""

from __future__ import annotations

import json

from skinbake.choices import Language
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import babylon_package
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
