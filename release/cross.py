"""Compile the loops for other systems than this one: by zig, a clang with the C libraries of each system."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from setup import OTHERS

SYSTEMS = {
    "win_amd64": "x86_64-windows-gnu",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "manylinux_2_17_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64": "aarch64-linux-gnu.2.17",
    "musllinux_1_2_x86_64": "x86_64-linux-musl",
    "musllinux_1_2_aarch64": "aarch64-linux-musl",
}
"""Zig's names of the systems, by the names that wheels have for them."""

OLDEST = (3, 11)
"""The Python whose limited API the loops use."""

# zig compiles for the processor and with the checks that it likes unless told: any processor, and none.
FLAGS = [*OTHERS, "-mcpu=baseline", "-fno-sanitize=undefined", "-shared", "-s"]


def compile_loops(module: str, tree: Path, platform: str, folder: Path) -> tuple[str, bytes]:
    """Compile a module, such as ``gradients/_kernel``, of an unpacked sdist. Return its file name and bytes.

    platform is a key of SYSTEMS. Temporary files stay in the folder.
    """
    headers = folder / "include"
    if not headers.exists():
        shutil.copytree(sysconfig.get_path("include"), headers)
        shutil.copy(Path(__file__).with_name("pyconfig.h"), headers)
    suffix, more = ".abi3.so", ["-fPIC"]
    if platform.startswith("win"):
        suffix, more = ".pyd", [str(import_library("python3", stable_names(), folder))]
    elif platform.startswith("macosx"):
        # Else the module would hold the path of the temporary folder.
        more = ["-fPIC", "-undefined", "dynamic_lookup", f"-Wl,-install_name,{Path(module).name}.abi3.so"]
    made = folder / f"{module.replace('/', '.')}.{platform}{suffix}"
    source = tree / "src" / "skinbake" / f"{module}.c"
    zig("cc", "-target", SYSTEMS[platform], *FLAGS, f"-I{headers}", str(source), *more, "-o", str(made))
    return f"{module}{suffix}", made.read_bytes()


def import_library(name: str, exported: list[str], folder: Path) -> Path:
    """Write what a linker must know of a DLL: the names that it exports."""
    made, definition = folder / f"{name}.lib", folder / f"{name}.def"
    definition.write_text("\n".join([f"LIBRARY {name}.dll", "EXPORTS", *exported, ""]))
    zig("dlltool", "-m", "i386:x86-64", "-d", str(definition), "-l", str(made))
    return made


def stable_names() -> list[str]:
    """Return the functions and data of Python's stable ABI, as a linker reads them."""
    import abi3info  # of the extra `dist`

    functions, data = abi3info.FUNCTIONS.values(), abi3info.DATAS.values()
    old = [it for it in (*functions, *data) if (it.added.major, it.added.minor) <= OLDEST]
    return sorted(f"{it.symbol.name}{' DATA' * (it in data)}" for it in old)


def zig(*arguments: str) -> None:
    """Call zig. Raises CalledProcessError."""
    subprocess.run([sys.executable, "-m", "ziglang", *arguments], check=True)
