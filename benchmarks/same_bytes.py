"""Bake all models with two builds of skinbake, strip the outputs, and say where files differ.

Usage: python -m benchmarks.same_bytes BEFORE AFTER [FOLDER] [--after OPTIONS]

BEFORE and AFTER are two ``skinbake`` commands. FOLDER holds models (by default the corpus of SKINBAKE_CORPUS,
or ../shared/corpus). A refactoring differs nowhere. Where a default has changed between the two builds,
``--after`` gives the second one options that bring the former default back, like ``--after "--gradients
surface"``.
"""

from __future__ import annotations

import argparse
import hashlib
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.corpus_folder import find_corpus

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
MODELS = {".glb", ".gltf", ".vrm"}
USAGE = "%(prog)s BEFORE AFTER [FOLDER] [--after OPTIONS]"


def outputs(command: str, models: Path, options: list[str]) -> dict[str, str]:
    """Return the digests of all files that baking a folder, and stripping that, make, by name.

    The exit code of the bake, and those of the strips, are under names of their own.
    """
    with tempfile.TemporaryDirectory() as folder:
        baked, stripped = Path(folder, "baked"), Path(folder, "stripped")
        bake = [command, "bake", str(models), "--out-dir", str(baked), "-q", *options]
        done = subprocess.run(bake, capture_output=True, check=False)
        found = {"exit code": str(done.returncode)}
        for path in sorted(baked.rglob("*")):
            if path.suffix in MODELS:
                target = stripped / path.relative_to(baked)
                target.parent.mkdir(parents=True, exist_ok=True)
                strip = [command, "strip", str(path), "-o", str(target), "-q"]
                done = subprocess.run(strip, capture_output=True, check=False)
                found[f"exit code of strip {path.relative_to(baked)}"] = str(done.returncode)
        for path in sorted(Path(folder).rglob("*")):
            if path.is_file():
                found[path.relative_to(folder).as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest()
        return found


def main() -> int:
    """Print a line a set of options and one a difference; 1 where there are any."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.same_bytes", usage=USAGE)
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("folder", nargs="?", type=Path, default=find_corpus())
    parser.add_argument("--after", dest="only_after", default="", metavar="OPTIONS")
    given = parser.parse_args()
    if given.folder is None:
        sys.exit("there is no corpus: name a folder of models")
    differences = 0
    for options in OPTIONS:
        for folder in FOLDERS if (given.folder / FOLDERS[0]).is_dir() else (".",):
            models = given.folder / folder
            old = outputs(given.before, models, [*options])
            new = outputs(given.after, models, [*options, *shlex.split(given.only_after)])
            unlike = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
            files = sum(not name.startswith("exit code") for name in old)
            line = f"{' '.join(options) or 'defaults'}, {folder}: {files} files, {len(unlike)} differ"
            print(line, flush=True)
            for name in unlike:
                print(f"  {name}")
            differences += len(unlike)
    return 1 if differences else 0


if __name__ == "__main__":
    sys.exit(main())
