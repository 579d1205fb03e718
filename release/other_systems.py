"""Pythons of other systems that run on a Linux of x86_64, each in a folder of its own.

| system | Python | runs by |
|---|---|---|
| Windows | CPython's DLLs, which panda3d brings; python.exe is three lines | wine64 |
| Linux on aarch64 | Debian's | qemu-aarch64-static |
| Linux with musl | Debian's source, compiled with musl-gcc | itself |

Windows reads the standard library of this system's Python 3.11. macOS cannot be run.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from release.cross import SYSTEMS, import_library, stable_names, zig

VERSION = "3.11"
"""The Python of all of them: the oldest one that the wheels serve."""

NEEDED = ("click", "jinja2", "markupsafe", "colorama")
"""What `bake`, `verify` and `strip` import beside numpy where the loops are compiled."""

WINDOWS_PYTHON = "panda3d==1.10.16"

OLDER_NUMPY = "numpy==1.26.4"
"""Debian 12's Wine 8 lacks a function that newer ones call (crealf), and its musl 1.2.3 reads no DT_RELR."""


@dataclass(frozen=True)
class OtherSystem:
    """How a Python is made in a folder, and how it is called."""

    wheels: tuple[str, ...]
    """The names that wheels have for the system. The first is that of the wheel to try."""
    programs: tuple[str, ...]
    """What must be installed, by names of Debian's packages and of files in them."""
    make: Callable[[Path], None]
    command: Callable[[Path], list[str]]
    numpy: str = OLDER_NUMPY


def call(command: Sequence[str | Path], folder: Path, **variables: str) -> None:
    """Run a command, and show what it prints only if it fails."""
    environment = {**os.environ, **variables}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.stdout[-2000:]}{done.stderr[-2000:]}")


def pip(folder: Path, *arguments: str) -> None:
    """Call the pip that runs this."""
    call([sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments], folder)


def site_with(system: OtherSystem, wheels: Path, site: Path) -> None:
    """Install skinbake from a folder of wheels, and what it needs, for another system."""
    options = ["--target", str(site), "--no-deps", "--no-compile", "--only-binary", ":all:"]
    options += ["--python-version", VERSION, *(f"--platform={tag}" for tag in system.wheels)]
    pip(site.parent, "install", *options, "--no-index", "--find-links", str(wheels), "skinbake")
    pip(site.parent, "install", *options, *NEEDED, system.numpy)


def _make_windows(folder: Path) -> None:
    options = ["--no-deps", "--only-binary", ":all:", "--platform", "win_amd64", "--python-version", VERSION]
    pip(folder, "download", *options, WINDOWS_PYTHON)
    [wheel] = folder.glob("panda3d-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            # Wine has the C library of Windows itself.
            if name.startswith("deploy_libs/") and "api-ms-win" not in name:
                (folder / Path(name).name).write_bytes(archive.read(name))
    wheel.unlink()
    number = VERSION.replace(".", "")
    source = folder / "python.c"
    source.write_text(
        "#include <wchar.h>\n"
        "extern int Py_Main(int, wchar_t **);\n"
        "int wmain(int argc, wchar_t **argv) { return Py_Main(argc, argv); }\n"
    )
    for_windows = ["cc", "-target", SYSTEMS["win_amd64"], "-O1"]
    library = str(import_library(f"python{number}", ["Py_Main"], folder))
    zig(*for_windows, "-municode", str(source), library, "-o", str(folder / "python.exe"))
    # python3.dll hands each function of the stable ABI on to the DLL of the version.
    names = [name.partition(" ") for name in stable_names()]
    forwarded = [f"{name}=python{number}.{name}{space}{kind}" for name, space, kind in names]
    definition, empty = folder / "forwarded.def", folder / "empty.c"
    definition.write_text("\n".join(["LIBRARY python3.dll", "EXPORTS", *forwarded, ""]))
    empty.write_text("int DllMainCRTStartup(void *a, unsigned b, void *c) { return 1; }\n")
    dll = str(folder / "python3.dll")
    zig(*for_windows, "-shared", "-nostdlib", str(empty), str(definition), "-o", dll)
    (folder / "Lib").symlink_to(_standard_library())


def _standard_library() -> Path:
    """Return the folder of the modules in Python of this system's Python of the same version."""
    command = [f"python{VERSION}", "-c", "import sysconfig; print(sysconfig.get_path('stdlib'))"]
    return Path(subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip())


def _apt(folder: Path, *, kind: str, machine: str) -> list[str]:
    """Return apt-get with lists of its own, of another machine's packages or of sources, and fetch them."""
    own = folder / "apt"
    for name in ("lists/partial", "cache/archives/partial"):
        (own / name).mkdir(parents=True)
    (own / "status").touch()
    known = [Path("/etc/apt/sources.list.d/debian.sources"), Path("/etc/apt/sources.list")]
    given = next(path for path in known if path.exists())
    sources = own / given.name
    # The first one alone: mirrors of later ones, such as security's, may lack sources.
    first = re.split(r"\n\n|\n(?=deb )", given.read_text(encoding="utf-8").strip())[0]
    sources.write_text(re.sub(r"^(Types: )?deb\b", rf"\g<1>{kind}", first, flags=re.MULTILINE) + "\n")
    options = [f"APT::Architecture={machine}", f"APT::Architectures={machine}", "APT::Sandbox::User=root"]
    options += [f"Dir::Etc::SourceList={sources}", "Dir::Etc::SourceParts=-", f"Dir::Cache={own / 'cache'}"]
    options += [f"Dir::State::Lists={own / 'lists'}", f"Dir::State::Status={own / 'status'}"]
    command = ["apt-get", "-qq", *(part for option in options for part in ("-o", option))]
    call([*command, "update"], folder)
    return command


def _make_aarch64(folder: Path) -> None:
    apt = _apt(folder, kind="deb", machine="arm64")
    packages = [f"python{VERSION}-minimal", f"libpython{VERSION}-stdlib", "libstdc++6"]
    call([*apt, "install", "--yes", "--no-install-recommends", "--download-only", *packages], folder)
    for package in sorted(folder.glob("apt/cache/archives/*.deb")):
        call(["dpkg-deb", "-x", package, folder / "root"], folder)
    shutil.rmtree(folder / "apt")


def _make_musl(folder: Path) -> None:
    call(
        [*_apt(folder, kind="deb-src", machine="amd64"), "source", "--download-only", f"python{VERSION}"],
        folder,
    )
    [source] = folder.glob("*.orig.tar.*")
    with tarfile.open(source) as archive:
        archive.extractall(folder, filter="data")
    shutil.rmtree(folder / "apt")
    [unpacked] = folder.glob("Python-*/")
    unpacked.rename(folder / "python")
    compiler = folder / "cc"  # Debian's gcc names its own C library, whatever it compiles for
    named = 'case "$1" in *-print-multiarch) echo x86_64-linux-musl; exit ;; esac'
    compiler.write_text(f'#!/bin/sh\n{named}\nexec musl-gcc "$@"\n')
    compiler.chmod(0o755)
    # As if for another system: so it takes none of this one's libraries, which need another C library.
    apart = {"CC": str(compiler), "PKG_CONFIG_LIBDIR": "/nowhere", "_PYTHON_HOST_PLATFORM": "linux-x86_64"}
    options = ["--quiet", "--without-ensurepip", "--disable-test-modules", "--without-doc-strings"]
    call(["./configure", *options], folder / "python", **apart)
    call(["make", f"-j{os.cpu_count()}"], folder / "python", **apart)


OTHER_SYSTEMS = {
    "Windows": OtherSystem(
        wheels=("win_amd64",),
        programs=("/usr/lib/wine/wine64",),
        make=_make_windows,
        command=lambda folder: ["/usr/lib/wine/wine64", str(folder / "python.exe")],
    ),
    "Linux on aarch64": OtherSystem(
        wheels=("manylinux_2_17_aarch64", "manylinux_2_27_aarch64", "manylinux_2_28_aarch64"),
        programs=("qemu-aarch64-static", "apt-get"),
        make=_make_aarch64,
        command=lambda folder: [
            "qemu-aarch64-static",
            *("-L", str(folder / "root")),
            str(folder / f"root/usr/bin/python{VERSION}"),
        ],
        numpy="numpy",
    ),
    "Linux with musl": OtherSystem(
        wheels=("musllinux_1_2_x86_64", "musllinux_1_1_x86_64"),
        programs=("musl-gcc", "make", "apt-get"),
        make=_make_musl,
        command=lambda folder: [str(folder / "python/python")],
    ),
}
"""By the name in messages."""


def variables_of(system: OtherSystem, python: Path, work: Path) -> dict[str, str]:
    """Return the environment of a system's Python. Its work folder has the packages in ``site``."""
    site = {"PYTHONPATH": str(work / "site"), "PYTHONDONTWRITEBYTECODE": "1"}
    if not system.wheels[0].startswith("win"):
        return site
    wine = {"WINEPREFIX": str(work / "wine"), "WINEDEBUG": "-all"}
    return {**site, **wine, "PYTHONHOME": str(python), "PYTHONPATH": f"{work / 'site'};{python}"}


def missing_programs(system: OtherSystem) -> list[str]:
    """Return the programs that are not installed."""
    return [name for name in system.programs if not shutil.which(name)]


def made(system: OtherSystem, folder: Path) -> list[str]:
    """Return the command of a system's Python, which is made in the folder unless it is there."""
    stamp = folder / "stamp"
    if not stamp.exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        system.make(folder)
        stamp.touch()
    # The folders of this system's own packages stay out (-S).
    return [*system.command(folder), "-S"]
