"""Build the sdist and the wheels into dist/, and zips for Blender into build/: ``python -m release.build``.

The wheels of seven systems and of browsers have compiled loops, for every Python from 3.11 on (abi3). zig
compiles all of them on any one system. One more wheel has none and fits every system: numpy does their work,
more slowly. All are made from the sdist, so that it is whole.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from engines.blender.build import build_all
from release.contents import LOOPS, REPOSITORY, faults
from release.cross import BROWSER, SYSTEMS, compile_loops
from release.wheels import with_modules

TARGET = REPOSITORY / "dist"


def build(target: Path) -> list[Path]:
    """Build anew into a folder, which is emptied before. Return the paths."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    _run("build", "--sdist", "--outdir", str(target), str(REPOSITORY))
    [sdist] = target.glob("*.tar.gz")
    wheel = ["pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", str(sdist), "--wheel-dir"]
    _run(*wheel, str(target), SKINBAKE_PURE="1")
    [pure] = target.glob("*.whl")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        shutil.unpack_archive(sdist, folder, filter="data")
        tree = folder / sdist.name.removesuffix(".tar.gz")
        for platform in (*SYSTEMS, BROWSER):
            made = (compile_loops(module, tree, platform, folder) for module in LOOPS)
            with_modules(pure, {f"skinbake/{name}": data for name, data in made}, platform, target)
    return [sdist, *sorted(target.glob("*.whl"))]


def _run(module: str, *arguments: str, **variables: str) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "PATH": path, **variables}
    subprocess.run([sys.executable, "-m", module, *arguments], check=True, env=environment)


def main() -> None:
    """Build into dist/, list the files, and fail if one of them is not as it should be."""
    built = build(TARGET)
    for path in built:
        print(f"{path.relative_to(REPOSITORY)}: {path.stat().st_size:,} bytes")
    found = [f"{path.name}: {fault}" for path in built for fault in faults(path)]
    if found:
        sys.exit("\n".join(found))
    # abi3audit reads no WebAssembly: tests/release/test_cross.py looks at what those loops import.
    compiled = [str(path) for path in built if "-abi3-" in path.name and BROWSER not in path.name]
    _run("abi3audit", "--strict", *compiled)
    # A registry would be sent all of dist/, and takes no zips.
    for path in build_all(
        REPOSITORY / "build", TARGET, REPOSITORY / "build" / "blender" / "wheels-by-system"
    ):
        print(f"{path.relative_to(REPOSITORY)}: {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
