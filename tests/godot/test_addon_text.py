"""The Godot add-on and ``skinbake shader --target godot`` have one source: the templates."""

from __future__ import annotations

import configparser
import re

import pytest

from skinbake.choices import Encoding, Frame, Language, Layout
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import shader_made
from skinbake.version import __version__
from tests.godot.write_addon import ADDON, INCLUDE
from tests.support.command_line import invoke


def test_the_include_of_the_add_on_is_what_the_command_writes() -> None:
    """``python -m tests.godot.write_addon`` writes it."""
    result = invoke("shader", "--target", "godot")
    assert result.exit_code == 0
    assert result.stderr == ""
    assert INCLUDE.read_bytes().decode("ascii") == result.stdout


def test_one_include_serves_every_frame_encoding_and_layout() -> None:
    """They change the command that the header names, and nothing else."""
    texts = {
        re.sub(r"^//     skinbake shader .*", "", shader_made(choices)[0], flags=re.MULTILINE)
        for choices in (
            ShaderChoices(Language.GLSL, target="godot"),
            ShaderChoices(Language.GLSL, target="godot", frame=Frame.TANGENT),
            ShaderChoices(Language.GLSL, target="godot", encoding=Encoding.SNORM16, scale=2.0),
            ShaderChoices(Language.GLSL, target="godot", layout=Layout.TEXCOORD),
        )
    }
    assert len(texts) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "dqs", "lighting": "exact"}, "--method lbs"),
        ({"lighting": "approximated"}, "Godot's own"),
        ({"lighting": "direct"}, "--lighting accurate"),
        ({"influences": 8}, "--limit-influences 4"),
        ({"influences": 3}, "--influences 4"),
    ],
)
def test_what_a_shader_of_godot_cannot_do_is_refused(changes: dict[str, object], message: str) -> None:
    options = [word for name, value in changes.items() for word in (f"--{name}", str(value))]
    result = invoke("shader", "--target", "godot", *options)
    assert result.exit_code == 2
    assert message in result.stderr


def test_the_add_on_has_the_version_of_skinbake_and_names_its_script() -> None:
    plugin = configparser.ConfigParser()
    plugin.read(ADDON / "plugin.cfg", encoding="utf-8")
    assert plugin["plugin"]["version"].strip('"') == __version__
    assert (ADDON / plugin["plugin"]["script"].strip('"')).is_file()
