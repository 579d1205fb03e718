"""Set the version everywhere: ``python -m release.bump 0.2.0``.

The Python package, the packages of npm, the crate and the add-ons have one version. The shader text in
engines/ names it too, and is written anew.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from release.contents import REPOSITORY

PLACES = {
    "src/skinbake/version.py": r'^__version__ = "(.+)"$',
    "CITATION.cff": r"^version: (.+)$",
    "engines/*/package.json": r'^  "version": "(.+)",$',
    "engines/bevy/Cargo.toml": r'^version = "(.+)"$',
    "engines/godot/addons/skinbake/plugin.cfg": r'^version="(.+)"$',
    "engines/three/README.md": r"skinbake-three@([^/]+)/",
    "engines/blender/README.md": r"skinbake-blender-([^-]+)-",
}
"""Patterns of files, and what stands around the version in them."""

VERSION = re.compile(r"\d+\.\d+\.\d+")


def versions(repository: Path) -> dict[str, set[str]]:
    """Return the versions that stand in each file. An empty set: the file has lost its place."""
    return {
        path.relative_to(repository).as_posix(): set(re.findall(around, _text(path), re.MULTILINE))
        for pattern, around in PLACES.items()
        for path in sorted(repository.glob(pattern))
    }


def bump(repository: Path, version: str) -> None:
    """Write another version into each file. Raises ValueError if it is none, or if a file lacks its place."""
    if not VERSION.fullmatch(version):
        raise ValueError(f"{version}: expected three numbers, such as 0.2.0")
    lost = [name for name, found in versions(repository).items() if len(found) != 1]
    if lost:
        raise ValueError(f"{', '.join(lost)}: expected one version each")
    for pattern, around in PLACES.items():
        for path in repository.glob(pattern):
            with_new = re.sub(
                around,
                lambda found: found[0].replace(found[1], version),
                _text(path),
                flags=re.MULTILINE,
            )
            path.write_bytes(with_new.encode())


def _text(path: Path) -> str:
    return path.read_bytes().decode()


def main() -> None:
    """Set the version of the command line, and write the shader text."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        bump(REPOSITORY, sys.argv[1])
    except ValueError as error:
        sys.exit(str(error))
    subprocess.run([sys.executable, "-m", "tests.shaders.write_golden"], check=True, cwd=REPOSITORY)
    print("next: date the section of CHANGELOG.md, and RELEASING.md")


if __name__ == "__main__":
    main()
