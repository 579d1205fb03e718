"""Install what ``release.build`` made in clean environments, and compare it with the tree.

``python -m release.try_dist`` takes each Python from 3.11 on that it finds on PATH and below ~/.pyenv. For
each of them and each file of dist/ it makes a virtual environment, installs, bakes and verifies. The bakes
have the bytes of the tree's; those without compiled loops have the bytes of the tree's numpy.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from release.build import REPOSITORY, TARGET

OLDEST = (3, 11)
MODELS = ("bent_tube.glb", "foreign_joints.glb", "morphed_sheet.glb")
IS_COMPILED = """
from skinbake.gradients import kernel as gradients
from skinbake.truth import kernel as lighting
print(gradients.IS_COMPILED, lighting.IS_COMPILED)
"""
NUMPY = {"SKINBAKE_KERNEL": "numpy"}


def pythons() -> dict[tuple[int, int], Path]:
    """Return an interpreter of each version from the oldest on, by version."""
    folders = [Path(name) for name in os.environ.get("PATH", "").split(os.pathsep) if name]
    folders += sorted(Path.home().glob(".pyenv/versions/*/bin"))
    found: dict[tuple[int, int], Path] = {}
    for path in (path for folder in folders for path in sorted(folder.glob("python3.*"))):
        named = re.fullmatch(r"python3\.(\d+)(\.exe)?", path.name)
        version = (3, int(named[1])) if named else (0, 0)
        if version >= OLDEST and version not in found and _has_venv(path):
            found[version] = path
    return dict(sorted(found.items()))


def _has_venv(python: Path) -> bool:
    tried = subprocess.run([python, "-c", "import ensurepip, venv"], capture_output=True, check=False)
    return tried.returncode == 0


def bakes(python: Path, folder: Path, variables: Mapping[str, str]) -> dict[str, bytes]:
    """Bake and verify the models with an interpreter's skinbake. Return the bytes of the outputs."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "SKINBAKE"))
    }
    command = [str(python), "-m", "skinbake"]
    sources = [str(REPOSITORY / "fixtures" / name) for name in MODELS]
    for arguments in (
        ["bake", "-q", *sources, "--out-dir", "out"],
        ["verify", "-q", "out", "--samples", "4"],
        ["view", "-q", "out/bent_tube.glb", "-o", "page.html"],
        ["shader", "--lang", "wgsl", "--for", "out/bent_tube.glb"],
    ):
        subprocess.run(
            [*command, *arguments],
            check=True,
            cwd=folder,
            env={**environment, **variables},
            stdout=subprocess.DEVNULL,
        )
    return {name: (folder / "out" / name).read_bytes() for name in MODELS}


def try_one(python: Path, archive: Path, folder: Path, *, compiled: bool) -> dict[str, bytes]:
    """Install an archive in a new virtual environment, and return its bakes."""
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
    own = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    pip = [str(own), "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "install", str(archive)], check=True, cwd=folder)
    subprocess.run([*pip, "check"], check=True, cwd=folder, stdout=subprocess.DEVNULL)
    told = subprocess.run([own, "-c", IS_COMPILED], check=True, cwd=folder, capture_output=True, text=True)
    if told.stdout.split() != [str(compiled)] * 2:
        raise SystemExit(f"{archive.name}: compiled loops: {told.stdout.strip()}; expected: {compiled}")
    return bakes(own, folder, {})


def main() -> None:
    """Try each file of dist/ with each Python."""
    archives = sorted(path for path in TARGET.glob("skinbake-*") if path.suffix in {".gz", ".whl"})
    found = pythons()
    if not archives or not found:
        sys.exit(f"nothing in {TARGET}: run make dist" if not archives else "no Python was found")
    different = []
    with tempfile.TemporaryDirectory() as name:
        expected = {}
        for compiled in (True, False):
            folder = Path(name, f"tree-{compiled}")
            folder.mkdir()
            expected[compiled] = bakes(Path(sys.executable), folder, {} if compiled else NUMPY)
        for version, python in found.items():
            for archive in archives:
                compiled = not archive.name.endswith("-any.whl")
                folder = Path(name, "tried")
                folder.mkdir()
                same = try_one(python, archive, folder, compiled=compiled) == expected[compiled]
                shutil.rmtree(folder)
                said = "the bytes of the tree" if same else "OTHER BYTES than the tree"
                print(
                    f"Python {version[0]}.{version[1]}, {archive.name}: bake and verify pass, {said}",
                    flush=True,
                )
                different += [] if same else [archive.name]
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
