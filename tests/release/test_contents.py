"""What an installation gets: the wheel without compiled loops, made from a copy of the tree."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from release.contents import PACKAGE, REPOSITORY, faults

LEFT = shutil.ignore_patterns("*.so", "*.pyd", "*.egg-info", "__pycache__", "node_modules")


@pytest.mark.slow
def test_a_wheel_holds_the_package_and_nothing_else(tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(PACKAGE.parent, copy / "src", ignore=LEFT)
    for folder in ("engines", "tests/release"):
        shutil.copytree(REPOSITORY / folder, copy / folder, ignore=LEFT)
    for name in (
        "pyproject.toml",
        "setup.py",
        "MANIFEST.in",
        "README.md",
        "LICENSE",
        "NOTICE",
        "CHANGELOG.md",
        "CITATION.cff",
    ):
        shutil.copy(REPOSITORY / name, copy)
    wheel = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    wheel.append("--no-build-isolation")
    variables = {**os.environ, "SKINBAKE_PURE": "1"}
    subprocess.run([*wheel, "--wheel-dir", str(tmp_path), str(copy)], check=True, env=variables)
    [made] = tmp_path.glob("skinbake-*.whl")
    assert made.name.endswith("-py3-none-any.whl")
    assert faults(made) == []
    installed = tmp_path / "installed"
    with zipfile.ZipFile(made) as archive:
        archive.extractall(installed)
    command = [sys.executable, "-m", "skinbake", "shader", "--target", "three"]
    variables = {**os.environ, "PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"}
    shader = subprocess.run(command, check=True, env=variables, cwd=tmp_path, capture_output=True)
    assert shader.stdout.startswith(b"// Accurate lighting in three.js")


def test_a_wheel_of_other_files_has_faults(tmp_path: Path) -> None:
    wheel = tmp_path / "skinbake-1-py3-none-any.whl"
    sources = [path for path in PACKAGE.rglob("*") if path.suffix in {".py", ".wgsl", ".pyi"}]
    with zipfile.ZipFile(wheel, "w") as archive:
        for name in (*(path.relative_to(PACKAGE.parent).as_posix() for path in sources), "tests/test_api.py"):
            archive.writestr(name, "")
        archive.writestr("skinbake/__pycache__/api.pyc", "")
    found = faults(wheel)
    assert "lacks skinbake/view/templates/page/page.html" in found
    assert "lacks skinbake/engines/three/core.js" in found
    assert "has skinbake/__pycache__/api.pyc" in found
    assert "has tests/test_api.py" in found
    assert not any("api.py" in fault for fault in found if fault.startswith("lacks"))


def test_a_compiled_wheel_needs_both_modules_of_loops(tmp_path: Path) -> None:
    wheel = tmp_path / "skinbake-1-cp311-abi3-win_amd64.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("skinbake/gradients/_kernel.pyd", "")
    found = faults(wheel)
    assert "lacks truth/_loops" in found
    assert "lacks gradients/_kernel" not in found
    assert "has skinbake/gradients/_kernel.pyd" not in found


def test_a_module_for_macos_on_arm_needs_a_signature(tmp_path: Path) -> None:
    wheel = tmp_path / "skinbake-1-cp311-abi3-macosx_11_0_arm64.whl"
    header = [0xFEEDFACF, 0x0100000C, 0, 6]
    uuid, signature = [0x1B, 24, 0, 0, 0, 0], [0x1D, 16, 0, 0]
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, commands in (("gradients/_kernel", [uuid, signature]), ("truth/_loops", [signature, uuid])):
            words = [*header, 2, 40, 0, 0, *commands[0], *commands[1]]
            archive.writestr(f"skinbake/{name}.abi3.so", struct.pack(f"<{len(words)}I", *words))
    assert not any("signature" in fault for fault in faults(wheel))
    with zipfile.ZipFile(wheel, "w") as archive:
        words = [*header, 1, 24, 0, 0, *uuid]
        archive.writestr("skinbake/truth/_loops.abi3.so", struct.pack(f"<{len(words)}I", *words))
    assert "lacks a signature of skinbake/truth/_loops.abi3.so" in faults(wheel)
