"""Without the part that serves URLs and clusters: files on this disk need nothing of it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from skinbake.cli import exit_codes
from tests.support.command_line import run
from tests.support.models import FOLDER

WITHOUT = """
import sys


class Refusing:
    def find_spec(self, name, path=None, target=None):
        if name == "skinbake.jobs.remote" or name.startswith("skinbake.jobs.remote."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


sys.meta_path.insert(0, Refusing())
from skinbake.cli.main import entry_point

entry_point()
"""
INSTALL = "which is not installed: pip install 'skinbake[dask]'"
SEAM = FOLDER / "seam.glb"


def run_without(*arguments: str | Path) -> subprocess.CompletedProcess[bytes]:
    return run(*arguments, command=("-c", WITHOUT))


@pytest.mark.slow
def test_files_on_this_disk_are_baked_and_verified(tmp_path: Path) -> None:
    here, without = tmp_path / "here", tmp_path / "without"
    models = [SEAM, FOLDER / "shared_accessors.gltf"]
    assert run("bake", *models, "--out-dir", here).returncode == 0
    process = run_without("bake", *models, "--out-dir", without, "--skip-unchanged")
    assert (process.returncode, process.stderr) == (0, b"")
    for path in here.iterdir():
        assert (without / path.name).read_bytes() == path.read_bytes()
    checked = run_without("verify", without / "seam.glb", "--poses", "rest")
    assert (checked.returncode, checked.stderr) == (0, b"")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message", "code"),
    [
        (
            ["bake", "memory://a/seam.glb", "-o", "{}/out.glb"],
            f"memory://a/seam.glb: URLs need skinbake.jobs.remote, {INSTALL}",
            exit_codes.INPUT,
        ),
        (
            ["bake", str(SEAM), "-o", "memory://a/out.glb"],
            f"memory://a/out.glb: URLs need skinbake.jobs.remote, {INSTALL}",
            exit_codes.OUTPUT,
        ),
        (
            ["verify", "memory://a/seam.glb"],
            f"memory://a/seam.glb: URLs need skinbake.jobs.remote, {INSTALL}",
            exit_codes.INPUT,
        ),
        (
            ["verify", str(SEAM), "--dask", "tcp://127.0.0.1:1"],
            f"tcp://127.0.0.1:1: --dask needs skinbake.jobs.remote, {INSTALL}",
            exit_codes.INPUT,
        ),
    ],
)
def test_what_needs_it_says_what_to_install(
    arguments: list[str], message: str, code: int, tmp_path: Path
) -> None:
    process = run_without(*(argument.format(tmp_path) for argument in arguments))
    assert process.returncode == code
    assert process.stderr.decode().splitlines() == [f"error: {message}"]
    assert list(tmp_path.iterdir()) == []
