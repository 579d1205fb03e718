"""Build the zip that Blender installs: ``python -m engines.blender.build``.

The zip holds the add-on, and as wheels skinbake and the libraries that it needs and Blender does not have.
Blender unpacks the wheels into its own Python when it installs the zip. Wheels fit one system and one version
of Python. So a zip serves one system, and either Blender 4.5 and 5.0 (Python 3.11) or later ones (Python
3.13). From a terminal, the system is that of the build; ``make dist`` calls ``build_all``. The same sources
and wheels give the same bytes.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable, Sequence
from importlib.metadata import distribution
from pathlib import Path

from release.wheels import record, zipped
from skinbake.version import __version__

REPOSITORY = Path(__file__).resolve().parents[2]
ADDON = Path(__file__).resolve().parent / "addon"
PACKAGE = REPOSITORY / "src" / "skinbake"

LIBRARIES = ("DracoPy", "libigl", "meshopt", "scipy")
"""What `bake` and `verify` need of the dependencies in pyproject.toml. Blender has numpy."""

COMPILED = ("gradients/_kernel", "truth/_loops")
"""The compiled loops, which the installation of skinbake leaves beside the sources."""

BLENDERS: dict[str, tuple[str, str | None]] = {"3.11": ("4.5.0", "5.1.0"), "3.13": ("5.1.0", None)}
"""By version of Python: the first Blender that has it, and the first one that no longer has it."""

PLATFORMS = {
    "linux-x64": ("manylinux_2_17_x86_64", "manylinux_2_28_x86_64"),
    "macos-arm64": ("macosx_11_0_arm64", "macosx_14_0_arm64"),
    "windows-x64": ("win_amd64",),
}
"""By Blender's name of a system: the platform of skinbake's wheel, then others that libraries have."""

SYSTEMS = {"darwin": "macos"}
MACHINES = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}
"""Blender's names, where they differ from Python's."""


def build_all(folder: Path, skinbake_wheels: Path, wheels: Path) -> list[Path]:
    """Write the zips of all systems and Blenders into a folder. Return their paths.

    skinbake_wheels is a folder with a wheel of skinbake for each system. Those of the libraries are
    downloaded into folders below another one, unless they are there.
    """
    made = []
    for system, platforms in PLATFORMS.items():
        [own] = skinbake_wheels.glob(f"skinbake-{__version__}-*-{platforms[0]}.whl")
        for python in BLENDERS:
            libraries = wheels / f"{system}-{python}"
            if not _fitting(libraries, python):
                download(libraries, python, platforms)
            made.append(build(folder, python, libraries, system, (own.name, own.read_bytes())))
    return made


def build(
    folder: Path, python: str, wheels: Path, system: str = "", own: tuple[str, bytes] | None = None
) -> Path:
    """Write a zip into a folder, with the libraries whose wheels lie in another one. Return its path.

    system is Blender's name of it, by default that of this one. own is the name and the bytes of skinbake's
    wheel, by default of the skinbake that runs this.
    """
    system = system or this_system()
    libraries = _library_wheels(wheels, python)
    contents = addon_files() | {f"wheels/{path.name}": path.read_bytes() for path in libraries}
    name, wheel = own or skinbake_wheel()
    contents[f"wheels/{name}"] = wheel
    held = [key for key in contents if key.endswith(".whl")]
    contents["blender_manifest.toml"] = _manifest(python, system, held)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"skinbake-blender-{__version__}-{system}-py{python.replace('.', '')}.zip"
    # Wheels are compressed already.
    target.write_bytes(zipped(contents, zipfile.ZIP_STORED))
    return target


def download(folder: Path, python: str, platforms: Iterable[str] = ()) -> None:
    """Have pip fetch the wheels of the libraries, by default for this system."""
    with (REPOSITORY / "pyproject.toml").open("rb") as file:
        dependencies = tomllib.load(file)["project"]["dependencies"]
    wanted = [line for line in dependencies if line.startswith(LIBRARIES)]
    options = ["--no-deps", "--only-binary", ":all:", "--python-version", python, "--dest", str(folder)]
    options += [word for platform in platforms for word in ("--platform", platform)]
    pip = [sys.executable, "-I", "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, *options, *wanted], check=True)


def this_system() -> str:
    """Return Blender's name of this system, such as ``linux-x64``."""
    name, machine = platform.system().lower(), platform.machine().lower()
    return f"{SYSTEMS.get(name, name)}-{MACHINES.get(machine, machine)}"


def addon_files() -> dict[str, bytes]:
    """Return the add-on without its wheels, by path in the zip."""
    found = {path.name: path.read_bytes() for path in ADDON.iterdir() if path.suffix in {".py", ".toml"}}
    return found | {"LICENSE": (REPOSITORY / "LICENSE").read_bytes()}


def skinbake_wheel() -> tuple[str, bytes]:
    """Return the name and the bytes of a wheel of the skinbake that runs this, compiled loops included.

    pip would compile the loops anew, which takes half a minute.
    """
    compiled = _compiled_loops()
    sources = [path for path in PACKAGE.rglob("*") if path.is_file() and _is_source(path)]
    contents = {f"skinbake/{path.relative_to(PACKAGE).as_posix()}": path.read_bytes() for path in sources}
    contents |= {f"skinbake/{path.relative_to(PACKAGE).as_posix()}": path.read_bytes() for path in compiled}
    tag = f"cp311-abi3-{sysconfig.get_platform().translate(str.maketrans('-.', '__'))}"
    tag = tag if compiled else "py3-none-any"
    info = f"skinbake-{__version__}.dist-info"
    pure = "false" if compiled else "true"
    about = f"Wheel-Version: 1.0\nGenerator: engines.blender\nRoot-Is-Purelib: {pure}\nTag: {tag}\n"
    contents[f"{info}/METADATA"] = (distribution("skinbake").read_text("METADATA") or "").encode()
    contents[f"{info}/WHEEL"] = about.encode()
    contents[f"{info}/RECORD"] = record(contents, f"{info}/RECORD").encode()
    return f"skinbake-{__version__}-{tag}.whl", zipped(contents, zipfile.ZIP_DEFLATED)


def _compiled_loops() -> list[Path]:
    """Return both modules of compiled loops, or none where they were not compiled."""
    found = [path for stem in COMPILED for path in PACKAGE.glob(f"{stem}*") if path.suffix in {".so", ".pyd"}]
    return found if len(found) == len(COMPILED) else []


def _is_source(path: Path) -> bool:
    return "__pycache__" not in path.parts and path.suffix not in {".c", ".so", ".pyd"}


def _library_wheels(folder: Path, python: str) -> list[Path]:
    """Return one wheel of each library for a Python. Raises ValueError where there is none, or a choice."""
    found = []
    fitting = _fitting(folder, python)
    for library in LIBRARIES:
        wheels = [path for path in fitting if path.name.lower().startswith(f"{library.lower()}-")]
        if len(wheels) != 1:
            raise ValueError(
                f"{folder}: expected one wheel of {library} for Python {python}, found {len(wheels)}"
            )
        found += wheels
    return found


def _fitting(folder: Path, python: str) -> list[Path]:
    """Return the wheels in a folder that fit a version of Python, by the tags in their names."""
    tag = f"cp{python.replace('.', '')}"
    wheels = [(path, path.stem.split("-")) for path in folder.glob("*.whl")]
    return [path for path, parts in wheels if tag in parts[-3].split(".") or parts[-2] in {"abi3", "none"}]


def _manifest(python: str, system: str, wheels: Iterable[str]) -> bytes:
    """Return the manifest of the add-on with what a build knows. It goes before the tables of TOML."""
    first, last = BLENDERS[python]
    known = [f'version = "{__version__}"', f'blender_version_min = "{first}"']
    known += [f'blender_version_max = "{last}"'] if last else []
    known += [f'platforms = ["{system}"]', "wheels = ["]
    known += [*(f'    "./{wheel}",' for wheel in sorted(wheels)), "]"]
    head, table, rest = (ADDON / "blender_manifest.toml").read_text(encoding="utf-8").partition("\n[")
    return f"{head}{chr(10).join(known)}\n{table}{rest}".encode()


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line, and build."""
    parser = argparse.ArgumentParser(prog="python -m engines.blender.build", description="Build the add-on.")
    parser.add_argument("-o", "--out-dir", type=Path, default=REPOSITORY / "build", help="default: build")
    parser.add_argument("--python", choices=BLENDERS, default="3.11", help="Blender's Python; default: 3.11")
    parser.add_argument(
        "--wheels", type=Path, help="keep the libraries' wheels in this folder, and use them again"
    )
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        wheels = given.wheels or Path(temporary)
        if not _fitting(wheels, given.python):
            download(wheels, given.python)
        try:
            target = build(given.out_dir, given.python, wheels)
        except ValueError as error:
            parser.error(str(error))
    sys.stdout.write(f"{target}\n")


if __name__ == "__main__":
    main()
