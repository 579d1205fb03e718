"""The npm package and ``skinbake shader --target three`` have one source: the templates."""

from __future__ import annotations

import json
import re

import pytest

from skinbake.choices import Language
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import three_package
from skinbake.version import __version__
from tests.support.whole_fields import shader_text
from tests.three.write_package import FOLDER


@pytest.mark.parametrize("name", three_package())
def test_a_module_of_the_package_is_what_the_templates_give(name: str) -> None:
    """``python -m tests.three.write_package`` writes them."""
    assert (FOLDER / name).read_bytes().decode("ascii") == three_package()[name]


def test_the_single_file_has_the_same_shader_and_the_same_core() -> None:
    single = shader_text(ShaderChoices(Language.GLSL, target="three"))
    index = three_package()["index.js"]
    assert index[index.index("const DECLARATIONS") :] in single
    core = three_package()["core.js"].split("export {")[0].strip()
    assert core in single
    assert re.findall(r"^import .* from '(.*)'", single, re.MULTILINE) == ["three"]


def test_the_package_has_the_version_of_skinbake_and_names_its_files() -> None:
    package = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    assert package["version"] == __version__
    assert {name for name in package["files"] if not (FOLDER / name).is_file()} == set()
