"""Bake and strip all models with two builds of skinbake, and say where their outputs differ.

Usage: python -m benchmarks.same_bytes BEFORE AFTER [FOLDER]: two ``skinbake`` commands, and a folder of
models (by default the corpus of SKINBAKE_CORPUS, or ../shared/corpus). A refactoring differs nowhere.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.corpus import find_corpus

OPTIONS: tuple[tuple[str, ...], ...] = (
    (),
    ("--encoding", "packed8", "--generate-normals"),
    ("--encoding", "snorm16", "--frame", "normal", "--weighting", "angle-area"),
    ("--layout", "texcoord", "--neighbours", "drop"),
    ("--weld", "skin", "--crease-angle", "60"),
    ("--limit-influences", "4"),
    ("--compress", "none"),
    ("--compress", "meshopt"),
)
FOLDERS = ("public", "derived")


def outputs(command: str, models: Path, options: tuple[str, ...]) -> dict[str, str]:
    """Return the digests of all files that baking a folder makes, and the exit code, by name."""
    with tempfile.TemporaryDirectory() as folder:
        bake = [command, "bake", str(models), "--out-dir", folder, "-q", *options]
        done = subprocess.run(bake, capture_output=True, check=False)
        found = {"exit code": str(done.returncode)}
        for path in sorted(Path(folder).rglob("*")):
            if path.is_file():
                found[path.relative_to(folder).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
        return found


def main() -> int:
    """Print a line a set of options and one a difference; 1 where there are any."""
    if len(sys.argv) not in {3, 4}:
        sys.exit(__doc__)
    before, after = sys.argv[1:3]
    root = Path(sys.argv[3]) if len(sys.argv) == 4 else find_corpus()
    if root is None:
        sys.exit("there is no corpus: name a folder of models")
    differences = 0
    for options in OPTIONS:
        for folder in FOLDERS if (root / FOLDERS[0]).is_dir() else (".",):
            old, new = (outputs(command, root / folder, options) for command in (before, after))
            unlike = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
            print(f"{' '.join(options) or 'defaults'}, {folder}: {len(old) - 1} files, {len(unlike)} differ")
            for name in unlike:
                print(f"  {name}")
            differences += len(unlike)
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
