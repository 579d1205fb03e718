"""The npm package and ``skinbake shader --target playcanvas`` have one source: the templates."""

from __future__ import annotations

import json
from typing import Any

import pytest

from skinbake.choices import Language, Lighting, Method
from skinbake.commands.shader import ShaderRequest, shader
from skinbake.errors import ChoiceError
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import playcanvas_package
from skinbake.version import __version__
from tests.playcanvas.write_package import FOLDER
from tests.support.whole_fields import shader_text


def test_the_module_of_the_package_is_what_the_command_writes() -> None:
    """``python -m tests.playcanvas.write_package`` writes it."""
    (text,) = playcanvas_package().values()
    assert (FOLDER / "index.js").read_bytes().decode("ascii") == text
    assert shader_text(ShaderChoices(Language.GLSL, target="playcanvas")) == text


def test_the_package_has_the_version_of_skinbake_and_names_its_files() -> None:
    package = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
    assert package["version"] == __version__
    assert {name for name in package["files"] if not (FOLDER / name).is_file()} == set()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lighting": Lighting.APPROXIMATED}, "approximated lighting is PlayCanvas's own"),
        ({"method": Method.DQS, "lighting": Lighting.ACCURATE}, "use --lighting exact"),
        ({"influences": 8}, "PlayCanvas reads four influences per vertex, not 8"),
        ({"influences": 2}, "use --influences 4"),
    ],
)
def test_choices_that_playcanvas_cannot_serve(options: dict[str, Any], message: str) -> None:
    request = ShaderRequest(Language.GLSL, target="playcanvas", **options)
    with pytest.raises(ChoiceError, match=message):
        shader(request)


def test_it_reads_the_frame_from_the_file_when_it_runs() -> None:
    assert shader(ShaderRequest(Language.GLSL, target="playcanvas")).notices == ()
