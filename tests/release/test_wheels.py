"""Wheels made of a wheel: what installers read of them."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from release.try_dist import fits_here
from release.wheels import with_modules


def pure_wheel(folder: Path) -> Path:
    wheel = folder / "skinbake-1.0-py3-none-any.whl"
    info = "skinbake-1.0.dist-info"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("skinbake/__init__.py", "")
        archive.writestr(f"{info}/METADATA", "Metadata-Version: 2.1\nName: skinbake\nVersion: 1.0\n")
        archive.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{info}/RECORD", "skinbake/__init__.py,,\n")
    return wheel


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["win_amd64", "macosx_11_0_arm64", "musllinux_1_2_aarch64"])
def test_pip_takes_a_wheel_with_modules_for_its_platform_alone(platform: str, tmp_path: Path) -> None:
    modules = {"skinbake/_loops.abi3.so": b"compiled"}
    made = with_modules(pure_wheel(tmp_path), modules, platform, tmp_path)
    for asked, python, code in ((platform, "3.11", 0), (platform, "3.14", 0), ("win32", "3.11", 1)):
        target = tmp_path / f"{asked}-{python}"
        options = ["--target", str(target), "--platform", asked, "--python-version", python, "--no-deps"]
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-index", *options]
        done = subprocess.run(
            [*pip, "--only-binary", ":all:", str(made)], capture_output=True, text=True, check=False
        )
        assert done.returncode == code, done.stderr
        assert (target / "skinbake" / "_loops.abi3.so").exists() == (code == 0)


def test_the_same_modules_give_the_same_wheel(tmp_path: Path) -> None:
    pure = pure_wheel(tmp_path)
    made = []
    for name in "ab":
        (tmp_path / name).mkdir()
        made.append(with_modules(pure, {"skinbake/_loops.pyd": name.encode()}, "win_amd64", tmp_path / name))
    again = with_modules(pure, {"skinbake/_loops.pyd": b"a"}, "win_amd64", tmp_path)
    assert made[0].read_bytes() == again.read_bytes() != made[1].read_bytes()


def test_files_are_tried_where_they_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    names = (
        "skinbake-1-cp311-abi3-win_amd64.whl",
        "skinbake-1-cp311-abi3-macosx_11_0_x86_64.whl",
        "skinbake-1-cp311-abi3-manylinux_2_17_x86_64.whl",
        "skinbake-1-cp311-abi3-manylinux_2_17_aarch64.whl",
        "skinbake-1-cp311-abi3-musllinux_1_2_x86_64.whl",
        "skinbake-1-py3-none-any.whl",
        "skinbake-1.tar.gz",
    )
    for system, machine, number in (("linux", "x86_64", 2), ("win32", "AMD64", 0), ("darwin", "x86_64", 1)):
        monkeypatch.setattr("sys.platform", system)
        monkeypatch.setattr("platform.machine", lambda machine=machine: machine)
        assert [name for name in names if fits_here(name)] == [names[number], *names[5:]]
