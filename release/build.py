"""Build the sdist and two wheels into dist/: ``python -m release.build``.

One wheel has the compiled loops, for this system and every Python from 3.11 on (abi3). The other one has none
and fits every system: numpy does their work, more slowly. Both are made from the sdist, so that it is whole.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from release.contents import faults

REPOSITORY = Path(__file__).resolve().parents[1]
TARGET = REPOSITORY / "dist"


def build(target: Path) -> list[Path]:
    """Build anew into a folder, which is emptied before. Return the paths."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    _run("build", "--sdist", "--outdir", str(target), str(REPOSITORY))
    [sdist] = target.glob("*.tar.gz")
    wheel = ["pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", str(sdist), "--wheel-dir"]
    _run(*wheel, str(target), SKINBAKE_PURE="1")
    with tempfile.TemporaryDirectory() as folder:
        _run(*wheel, folder)
        [compiled] = Path(folder).glob("*.whl")
        if sys.platform == "linux":  # an index takes wheels only of named generations of Linux systems
            _run("auditwheel", "repair", "--wheel-dir", str(target), str(compiled))
        else:
            shutil.copy(compiled, target)
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


if __name__ == "__main__":
    main()
