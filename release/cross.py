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

BROWSER = "pyemscripten_2026_0_wasm32"
"""The name that wheels have for Pyodide 314, in browsers and Node.js. Its loops run in older ones too."""

OLDEST = (3, 11)
"""The Python whose limited API the loops use."""

# zig compiles for the processor and with the checks that it likes unless told: any processor, and none.
FLAGS = [*OTHERS, "-mcpu=baseline", "-fno-sanitize=undefined", "-shared", "-s"]

# What every browser since 2021 and Node.js since 16 have, and vectors are not among it.
BROWSER_FLAGS = [*OTHERS, "-mcpu=mvp+mutable_globals+sign_ext+nontrapping_fptoint+bulk_memory"]
BROWSER_FLAGS += ["-fno-sanitize=undefined", "-fPIC", "-fvisibility=hidden"]


def compile_loops(
    module: str, tree: Path, platform: str, folder: Path, *, links: bool = True
) -> tuple[str, bytes]:
    """Compile a module, such as ``gradients/_kernel``, of an unpacked sdist. Return its file name and bytes.

    platform is BROWSER or a key of SYSTEMS. Temporary files stay in the folder. Without links, the bytes are
    those of the object, for which zig builds none of the system's libraries.
    """
    headers = folder / "include"
    if not headers.exists():
        shutil.copytree(sysconfig.get_path("include"), headers)
        shutil.copy(Path(__file__).with_name("pyconfig.h"), headers)
    source = tree / "src" / "skinbake" / f"{module}.c"
    suffix, more = ".abi3.so", ["-fPIC"]
    made = folder / f"{module.replace('/', '.')}.{platform}"
    if platform == BROWSER:
        _compile_for_browsers(source, headers, made)
        return f"{module}{suffix}", made.read_bytes()
    if not links:
        more = ["-c"]
    elif platform.startswith("win"):
        suffix, more = ".pyd", [str(import_library("python3", stable_names(), folder))]
    elif platform.startswith("macosx"):
        # Else the module would hold the path of the temporary folder.
        more = ["-fPIC", "-undefined", "dynamic_lookup", f"-Wl,-install_name,{Path(module).name}.abi3.so"]
    zig("cc", "-target", SYSTEMS[platform], *FLAGS, f"-I{headers}", str(source), *more, "-o", str(made))
    return f"{module}{suffix}", made.read_bytes()


def _compile_for_browsers(source: Path, headers: Path, made: Path) -> None:
    """Compile a side module of Emscripten: the names of Python and of C stay open until Pyodide links it."""
    import ziglang

    # zig has no C library of Emscripten: musl's declarations for another system of 32 bits serve.
    library = Path(ziglang.__file__).parent / "lib" / "libc" / "include"
    found = [f"-isystem{library / name}" for name in ("arm-linux-musl", "generic-musl")]
    compiled = made.with_suffix(".o")
    target = ["-target", "wasm32-emscripten"]
    zig("cc", *target, *BROWSER_FLAGS, *found, f"-I{headers}", "-c", str(source), "-o", str(compiled))
    options = ["--experimental-pic", "-shared", "--unresolved-symbols=import-dynamic", "--strip-all"]
    zig("wasm-ld", *options, f"--export-if-defined=PyInit_{source.stem}", str(compiled), "-o", str(made))


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
