"""Install what ``release.build`` made in clean environments, and compare it with the tree.

``python -m release.try_dist`` takes each Python from 3.11 on that it finds on PATH and below ~/.pyenv. For
each of them and each file of dist/ that fits this system it makes a virtual environment, installs, bakes and
verifies. On Linux it then does so for the other systems that can be run there (``release.other_systems``).

The bakes have the bytes of the tree's; those without compiled loops have the bytes of the tree's numpy.
With SKINBAKE_STRICT=1 in the environment, a system that cannot be tried is a failure.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from release.build import TARGET
from release.contents import REPOSITORY
from release.other_systems import OTHER_SYSTEMS, OtherSystem, made, missing_programs, site_with, variables_of

OLDEST = (3, 11)
MODELS = ("bent_tube.glb", "foreign_joints.glb", "morphed_sheet.glb")
VECTOR_BITS = """
from importlib import import_module
for room, loops in (("gradients", "_kernel"), ("truth", "_loops")):
    compiled = import_module(f"skinbake.{room}.kernel").IS_COMPILED
    print(import_module(f"skinbake.{room}.{loops}").VECTOR_BITS if compiled else 0)
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


def fits_here(archive: str) -> bool:
    """Tell whether an sdist or a wheel fits this system, by its name."""
    family = {"linux": "manylinux", "darwin": "macosx", "win32": "win"}.get(sys.platform, sys.platform)
    here = f"-{family}_" in archive and archive.endswith(f"_{platform.machine().lower()}.whl")
    return here or archive.endswith(("-any.whl", ".tar.gz"))


def bakes(
    python: Sequence[str], folder: Path, variables: Mapping[str, str], *, briefly: bool = False
) -> dict[str, bytes]:
    """Bake, verify and strip the models by an interpreter's skinbake. Return the bytes of the bakes.

    Unless briefly, write a page and a shader too.
    """
    out = folder / "out"
    sources = [str(REPOSITORY / "fixtures" / name) for name in MODELS]
    shown = (
        ["view", "-q", "out/bent_tube.glb", "-o", "page.html"],
        ["shader", "--lang", "wgsl", "--for", "out/bent_tube.glb"],
    )
    for arguments in (
        ["bake", "-q", *sources, "--out-dir", "out"],
        ["verify", "-q", "out", "--samples", "4"],
        ["strip", "-q", *(f"out/{name}" for name in MODELS), "--out-dir", "stripped"],
        *(() if briefly else shown),
    ):
        said(python, ["-m", "skinbake", *arguments], folder, variables)
    for name in MODELS:
        if (folder / "stripped" / name).read_bytes() != (REPOSITORY / "fixtures" / name).read_bytes():
            raise SystemExit(f"{name}: strip gives other bytes than before the bake")
    return {name: (out / name).read_bytes() for name in MODELS}


def said(python: Sequence[str], arguments: list[str], folder: Path, variables: Mapping[str, str]) -> str:
    """Return what an interpreter prints. If it fails, end with that."""
    clean = {name: text for name, text in os.environ.items() if not name.startswith(("PYTHON", "SKINBAKE"))}
    done = subprocess.run(
        [*python, *arguments],
        check=False,
        cwd=folder,
        env={**clean, **variables},
        stdin=subprocess.DEVNULL,
        capture_output=True,
    )
    told, errors = (stream.decode(errors="replace") for stream in (done.stdout, done.stderr))
    if done.returncode:
        raise SystemExit(f"{' '.join([*python, *arguments])}: exit {done.returncode}\n{told}{errors}")
    return told


def vector_bits(python: Sequence[str], folder: Path, variables: Mapping[str, str]) -> int:
    """Return the bits of the vectors that an interpreter's skinbake uses, 0 without compiled loops."""
    [bits] = set(said(python, ["-c", VECTOR_BITS], folder, variables).split())
    return int(bits)


def try_one(python: Path, archive: Path, folder: Path) -> tuple[int, dict[str, bytes]]:
    """Install an archive in a new virtual environment. Return the bits of its vectors, and its bakes."""
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
    own = [str(folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python")]
    pip = ["-m", "pip", "--disable-pip-version-check", "--quiet"]
    said(own, [*pip, "install", str(archive)], folder, {})
    said(own, [*pip, "check"], folder, {})
    return vector_bits(own, folder, {}), bakes(own, folder, {})


def try_elsewhere(system: OtherSystem, name: str, folder: Path) -> tuple[int, dict[str, bytes]]:
    """Install skinbake for another system, and run it there. Return the bits of vectors, and the bakes."""
    folder_of_python = REPOSITORY / "build" / "systems" / name.replace(" ", "-").lower()
    python = made(system, folder_of_python)
    site_with(system, TARGET, folder / "site")
    variables = variables_of(system, folder_of_python, folder)
    return vector_bits(python, folder, variables), bakes(python, folder, variables, briefly=True)


def main() -> None:
    """Try each file of dist/ that can be tried."""
    archives = sorted(path for path in TARGET.glob("skinbake-*") if path.suffix in {".gz", ".whl"})
    found = pythons()
    if not archives or not found:
        sys.exit(f"nothing in {TARGET}: run make dist" if not archives else "no Python was found")
    failed = False
    with tempfile.TemporaryDirectory() as temporary:
        expected = {}
        for compiled in (True, False):
            folder = Path(temporary, f"tree-{compiled}")
            folder.mkdir()
            variables = {} if compiled else NUMPY
            bits = vector_bits([sys.executable], folder, variables)
            expected[compiled] = bits, bakes([sys.executable], folder, variables)

        def tell(
            what: str, found: tuple[int, dict[str, bytes]], wanted: tuple[int, dict[str, bytes]]
        ) -> bool:
            """Print what came of one try. Return whether it is as it should be."""
            (bits, given), (wide, bytes_of_tree) = found, wanted
            loops = f"vectors of {bits} bits" if bits else "no compiled loops"
            loops += "" if bits == wide else f" INSTEAD OF {wide}"
            same = "the bytes" if given == bytes_of_tree else "OTHER BYTES than those"
            print(f"{what}: bake, verify and strip pass, {loops}, {same} of the tree", flush=True)
            return found == wanted

        here = [path for path in archives if fits_here(path.name)]
        for version, python in found.items():
            for archive in here:
                with tempfile.TemporaryDirectory() as name:
                    tried_here = try_one(python, archive, Path(name))
                label = f"Python {version[0]}.{version[1]}, {archive.name}"
                failed |= not tell(label, tried_here, expected[not archive.name.endswith("-any.whl")])
        tried = {path.name for path in here}
        for name, system in OTHER_SYSTEMS.items():
            missing = missing_programs(system)
            if missing:
                print(f"{name}: not tried, for want of {', '.join(missing)}", flush=True)
                failed |= os.environ.get("SKINBAKE_STRICT") == "1"
                continue
            bits, wanted = expected[True]
            with tempfile.TemporaryDirectory() as work:
                # Nothing on ARM is wider than what all its processors have.
                wide = 128 if "aarch64" in system.wheels[0] else bits
                failed |= not tell(name, try_elsewhere(system, name, Path(work)), (wide, wanted))
            tried |= {path.name for path in archives if system.wheels[0] in path.name}
        print("built, not run: " + (", ".join(p.name for p in archives if p.name not in tried) or "none"))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
