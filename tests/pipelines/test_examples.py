"""The examples of builds, each by its own tool: what is baked, what is not baked again, what fails."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.pipelines.programs import environment_with_skinbake
from tests.support import gltf_reading, gltf_transform
from tests.support.command_line import document, invoke
from tests.support.models import FOLDER
from tests.support.node import SUPPORT
from tests.support.strictness import missing_tool

EXAMPLES = Path(__file__).parents[2] / "examples"
BUILDS = {
    "make": [["make"]],
    "ninja": [["ninja"]],
    "cmake": [["cmake", "-B", "build"], ["cmake", "--build", "build"]],
    "npm": [["npm", "run", "--silent", "build"]],
    "gltf-transform": [["npm", "run", "--silent", "build"]],
}
ENCODINGS = {"VEC4 SHORT normalised": "snorm16", "VEC4 BYTE normalised": "packed8"}
NEEDED = {"cmake": ("cmake", "make"), "gltf-transform": ("node", "npm")}


class Build:
    """A copy of an example with one model, and its build."""

    def __init__(self, tool: str, folder: Path) -> None:
        self.environment = environment_with_skinbake(folder / "bin")
        for program in NEEDED.get(tool, (tool,)):
            if shutil.which(program, path=self.environment["PATH"]) is None:
                missing_tool(f"{program} is not installed")
        self.commands = BUILDS[tool]
        self.folder = folder / "models"
        shutil.copytree(EXAMPLES / tool, self.folder)
        if tool == "gltf-transform":
            gltf_transform.require_node()
            (self.folder / "node_modules").symlink_to(SUPPORT / "node_modules")
        (self.folder / "art").mkdir()
        shutil.copyfile(FOLDER / "seam.glb", self.folder / "art" / "hero.glb")
        self._calls = folder / "bin" / "calls"
        for name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):  # of the make that runs the tests
            self.environment.pop(name, None)

    def __call__(self) -> tuple[bool, list[str]]:
        """Build. Return whether that went well, and the commands of skinbake that were called."""
        self._calls.write_text("")
        went_well = True
        for command in self.commands:
            process = subprocess.run(
                command, cwd=self.folder, env=self.environment, capture_output=True, text=True, check=False
            )
            went_well = went_well and process.returncode == 0
        return went_well, self._calls.read_text().split()

    @property
    def baked(self) -> Path:
        """The model that was baked."""
        (found,) = (self.folder / "build").rglob("hero.glb")
        return found

    def encoding(self) -> str:
        """Return the encoding of the baked model."""
        found = document(invoke("inspect", self.baked, "--json"))["primitives"][0]["attributes"]
        return ENCODINGS[found["_SKINBAKE_ALPHA_0"]["format"]]

    def configure(self, *words: str) -> None:
        """Replace words of the options by the words after them, some time later."""
        file = self.folder / "skinbake.toml"
        text = file.read_text("utf-8")
        for old, new in zip(words[::2], words[1::2], strict=True):
            assert old in text
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
        self.made_newer(file)

    def made_newer(self, file: Path) -> None:
        """Let time pass for all other files, because some tools know no parts of a second."""
        for path in self.folder.rglob("*"):
            if path.is_file() and path != file:
                found = path.stat()
                os.utime(path, ns=(found.st_atime_ns, found.st_mtime_ns - 5_000_000_000))
        os.utime(file)  # by the system's clock of files, which lags behind time.time() by up to 4 ms


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["make", "ninja", "cmake"])
def test_a_build_bakes_what_changed_and_fails_where_verify_fails(tool: str, tmp_path: Path) -> None:
    build = Build(tool, tmp_path)
    assert build() == (True, ["bake", "verify"])
    assert build.encoding() == "snorm16"
    assert build() == (True, [])

    build.made_newer(build.folder / "art" / "hero.glb")
    assert build() == (True, ["bake", "verify"])
    assert build() == (True, [])

    build.configure('"snorm16"', '"packed8"', "min-gain = 1", "min-gain = 1000000")
    assert build() == (False, ["bake", "verify"])
    assert build.encoding() == "packed8"
    assert build() == (False, ["verify"])  # a failure is not forgotten


@pytest.mark.slow
def test_ninja_bakes_what_is_added_to_the_list_and_nothing_else(tmp_path: Path) -> None:
    build = Build("ninja", tmp_path)
    assert build() == (True, ["bake", "verify"])
    added = "old/my hero.glb"
    (build.folder / "art" / "old").mkdir()
    shutil.copy(build.folder / "art" / "hero.glb", build.folder / "art" / added)
    models = build.folder / "models.txt"
    models.write_text(f"{models.read_text()}\n{added}\n")
    build.made_newer(models)
    assert build() == (True, ["bake", "verify"])
    assert (build.folder / "build" / added).is_file()
    assert build() == (True, [])


@pytest.mark.slow
def test_make_takes_names_with_spaces(tmp_path: Path) -> None:
    build = Build("make", tmp_path)
    (build.folder / "art" / "hero.glb").rename(build.folder / "art" / "my old hero.glb")
    assert build() == (True, ["bake", "verify"])
    assert (build.folder / "build" / "my old hero.glb").is_file()
    assert build() == (True, [])
    build.configure('"snorm16"', '"packed8"')  # the rules that bake has written name it too
    assert build() == (True, ["bake", "verify"])


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["make", "cmake", "npm", "gltf-transform"])
def test_models_in_folders_of_art_are_built_too(tool: str, tmp_path: Path) -> None:
    build = Build(tool, tmp_path)
    shutil.copytree(build.folder / "art", build.folder / "art" / "old" / "heroes")
    assert build()[0]
    assert len(list((build.folder / "build").rglob("hero.glb"))) == 2
    before = {path: path.stat().st_mtime_ns for path in (build.folder / "build").rglob("hero.glb")}
    assert build()[0]
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["npm", "gltf-transform"])
def test_the_npm_script_passes_over_what_has_not_changed(tool: str, tmp_path: Path) -> None:
    build = Build(tool, tmp_path)
    assert build() == (True, ["bake", "verify"])
    assert build.encoding() == "snorm16"
    before = build.baked.stat().st_mtime_ns
    assert build()[0]
    assert build.baked.stat().st_mtime_ns == before

    shutil.copyfile(FOLDER / "two_sets.glb", build.folder / "art" / "hero.glb")
    assert build()[0]
    assert build.baked.stat().st_mtime_ns > before

    build.configure("min-gain = 1", "min-gain = 1000000")
    assert build() == (False, ["bake", "verify"])


@pytest.mark.slow
def test_gltf_transform_runs_before_skinbake(tmp_path: Path) -> None:
    build = Build("gltf-transform", tmp_path)
    assert build()[0]
    found = gltf_reading.read(build.baked).content
    assert found["asset"]["generator"].startswith("glTF-Transform")
    assert "EXT_meshopt_compression" in found["extensionsUsed"]


def test_every_example_is_run() -> None:
    folders = {path.name for path in EXAMPLES.iterdir() if path.is_dir()}
    assert folders == set(BUILDS)
    readme = (EXAMPLES / "README.md").read_text("utf-8")
    assert all(f"| `{name}/" in readme for name in folders)
