"""The packages of engines/, and the single modules that ``skinbake shader`` makes of them."""

from __future__ import annotations

import configparser
import json
import re
import struct
import subprocess
from pathlib import Path

import pytest

from skinbake.shaders.engines import engines_folder
from skinbake.version import __version__
from tests.support.command_line import invoke
from tests.support.node import require_node

PACKAGES = ["three", "babylon", "playcanvas", "galacean"]
IDENTIFIER = r"[A-Za-z_$][\w$]*"


def written(target: str, *options: str) -> str:
    result = invoke("shader", "--target", target, *options)
    assert result.exit_code == 0
    assert result.stderr == ""
    return result.stdout


def exported(text: str) -> set[str]:
    """The names that a module exports, where it declares them or in lists."""
    declared = set(re.findall(rf"^export (?:const|function|class) ({IDENTIFIER})", text, re.MULTILINE))
    listed = ",".join(re.findall(r"^export \{([^}]*)\}", text, re.MULTILINE))
    return declared | {name.strip() for name in listed.split(",") if name.strip()}


@pytest.mark.parametrize("engine", PACKAGES)
def test_a_package_has_the_version_of_skinbake_and_names_its_files(engine: str) -> None:
    folder = engines_folder() / engine
    package = json.loads((folder / "package.json").read_text(encoding="utf-8"))
    assert package["version"] == __version__
    assert {path.name for path in folder.iterdir()} == {"package.json", *package["files"]}


def test_the_add_on_has_the_version_of_skinbake_and_names_its_script() -> None:
    addon = engines_folder() / "godot" / "addons" / "skinbake"
    plugin = configparser.ConfigParser()
    plugin.read(addon / "plugin.cfg", encoding="utf-8")
    assert plugin["plugin"]["version"].strip('"') == __version__
    assert (addon / plugin["plugin"]["script"].strip('"')).is_file()


def test_the_add_on_has_what_the_asset_store_of_godot_asks_for() -> None:
    folder = engines_folder() / "godot"
    licence = (folder / "addons" / "skinbake" / "LICENSE").read_text(encoding="utf-8")
    assert licence == (folder.parents[1] / "LICENSE").read_text(encoding="utf-8")
    assert re.search(r"^Copyright \(c\) \d{4} \w", licence, re.MULTILINE)
    assert (folder / "addons" / "skinbake" / "README.md").is_file()
    assert (folder / ".gitattributes").is_file()
    width, height = struct.unpack(">II", (folder / "icon.png").read_bytes()[16:24])
    assert width == height >= 128


@pytest.mark.parametrize("engine", PACKAGES)
def test_a_single_module_exports_what_the_package_does_and_imports_the_engine_alone(engine: str) -> None:
    single = written(engine)
    assert exported(single) == exported((engines_folder() / engine / "index.js").read_text(encoding="ascii"))
    sources = re.findall(r" from '(.*)';$", single.partition("\nconst ")[0], re.MULTILINE)
    imported = [source for source in sources if not source.startswith("skinbake-")]
    assert imported
    assert not any(source.startswith(".") for source in imported)
    assert "\nimport " not in single.partition("\nconst ")[2]


@pytest.mark.parametrize("engine", PACKAGES)
def test_a_single_module_has_each_line_of_the_modules_once(engine: str) -> None:
    """Lines of code; those of exports and imports lead from module to module."""
    single = written(engine).splitlines()
    folder = engines_folder() / engine
    modules = [path for path in folder.glob("*.js") if path.name != "webgpu.js"]
    lines = [line for path in modules for line in path.read_text(encoding="ascii").splitlines()]
    code = [line.removeprefix("export ") for line in lines if line.startswith(("    ", "export ", "const "))]
    listed = re.compile(rf"    {IDENTIFIER},|\{{.*\}} from .*")
    kept = [line for line in code if not listed.fullmatch(line)]
    assert len(kept) > 400
    found = [line.removeprefix("export ") for line in single]
    assert {line for line in kept if kept.count(line) != found.count(line)} == set()


@pytest.mark.parametrize(
    ("engine", "options"),
    [
        ("babylon", ""),
        ("three", "--lighting direct"),
        *(
            pytest.param(engine, options, marks=pytest.mark.slow)
            for engine, options in (
                ("babylon", "--method dqs"),
                ("galacean", "--method dqs"),
                ("three", "--method dqs"),
                ("playcanvas", "--method dqs"),
                ("playcanvas", "--lighting direct"),
            )
        ),
    ],
)
def test_a_single_module_is_a_module_of_javascript(engine: str, options: str, tmp_path: Path) -> None:
    """A name that two of its parts declare is a SyntaxError."""
    path = tmp_path / "skinbake.mjs"
    path.write_text(written(engine, *options.split()), encoding="ascii")
    command = [require_node(), "--check", str(path)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.parametrize("engine", [*PACKAGES, "godot"])
def test_the_top_of_a_text_tells_its_use_and_the_command_that_wrote_it(engine: str) -> None:
    top = written(engine, "--mirrored-joints").splitlines()[:25]
    assert top[0].startswith("// Accurate lighting in ")
    (command,) = (line for line in top if line.startswith("//     skinbake shader "))
    assert "--mirrored-joints" in command
    assert f"--target {engine}" in command


@pytest.mark.parametrize("engine", [*PACKAGES, "godot"])
def test_a_module_of_an_engine_serves_every_frame_encoding_and_layout(engine: str) -> None:
    """They change the command that the text names, and nothing else."""
    options = ["--frame", "tangent", "--encoding", "snorm16", "--layout", "custom"]
    usual, other = (
        [line for line in text.splitlines() if not line.startswith("//     skinbake shader ")]
        for text in (written(engine), written(engine, *options))
    )
    assert usual == other


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--target babylon --method dqs --lighting accurate", "use --lighting exact"),
        ("--target babylon --lighting standard", "standard lighting is Babylon.js's own"),
        ("--target babylon --lighting direct", "by the accurate algorithm only; use --lighting accurate"),
        ("--target babylon --influences 12", "bake with --limit-influences 8"),
        ("--target babylon --influences 2", "use --influences 4"),
        ("--target playcanvas --lighting standard", "standard lighting is PlayCanvas's own"),
        ("--target playcanvas --method dqs --lighting accurate", "use --lighting exact"),
        ("--target playcanvas --influences 8", "PlayCanvas reads four influences per vertex, not 8"),
        ("--target playcanvas --influences 2", "use --influences 4"),
        ("--target galacean --method dqs --lighting accurate", "use --lighting exact"),
        ("--target galacean --lighting standard", "standard lighting is Galacean's own"),
        ("--target galacean --lighting direct", "by the accurate algorithm only; use --lighting accurate"),
        ("--target galacean --influences 8", "Galacean reads four influences per vertex, not 8"),
        ("--target galacean --influences 2", "use --influences 4"),
        ("--target godot --method dqs", "node Skinbake"),
        ("--target godot --lighting standard", "Godot's own"),
        ("--target godot --lighting direct", "--lighting accurate"),
        ("--target godot --influences 8", "--limit-influences 4"),
        ("--target godot --influences 3", "--influences 4"),
    ],
)
def test_a_choice_that_an_engine_cannot_serve_is_refused(options: str, message: str) -> None:
    result = invoke("shader", *options.split())
    assert result.exit_code == 2
    assert message in result.stderr


@pytest.mark.parametrize("options", ["--influences 8", "--mirrored-joints"])
def test_the_influences_of_a_file_and_its_mirrors_change_nothing_for_babylon(options: str) -> None:
    """The module sees to both when it runs."""
    usual, other = (
        [line for line in text.splitlines() if not line.startswith("//     skinbake shader ")]
        for text in (written("babylon"), written("babylon", *options.split()))
    )
    assert usual == other
