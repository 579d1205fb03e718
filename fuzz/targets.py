"""Run the coverage-guided targets one after another, and write their seeds: ``python -m fuzz.targets``."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from fuzz import target_draco, target_glb, target_gltf, target_meshopt, target_state, target_uri
from fuzz.atheris_target import MISSING, is_here
from fuzz.batches import FINDS, REPOSITORY
from fuzz.log import LOG, note
from fuzz.models import EMBEDDED, GLB, JsonObject, Model
from fuzz.seeds import all_seeds
from fuzz.uris import ABSOLUTE, DATA, PLAIN, UPWARDS

TARGETS = {
    "glb": target_glb,
    "gltf": target_gltf,
    "draco": target_draco,
    "meshopt": target_meshopt,
    "uri": target_uri,
    "state": target_state,
}
DICTIONARY = REPOSITORY / "fuzz" / "gltf.dict"
CORPUS = REPOSITORY / "build" / "fuzz-seeds"
MOST = 16_000


def main() -> int:
    """Run or write as the command line says; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.targets", description=__doc__)
    parser.add_argument(
        "targets", nargs="*", metavar="TARGET", help=f"Of {', '.join(TARGETS)}; all by default."
    )
    parser.add_argument("--minutes", type=float, default=2.0, help="For all together.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--write-seeds", type=Path, metavar="DIR", help="Write each target's seeds, and run none."
    )
    parser.add_argument("--models", type=Path, help="Where models to take seeds from are kept.")
    parser.add_argument("--log", type=Path, default=LOG)
    given = parser.parse_args()
    if given.write_seeds:
        write_seeds(given.write_seeds, all_seeds(given.models))
        return 0
    if not is_here():
        print(f"not run: {MISSING}")
        return 0
    names = given.targets or list(TARGETS)
    write_seeds(CORPUS, all_seeds(given.models))
    finds = Counter[str]()
    for name in names:
        seconds = max(int(given.minutes * 60 / len(names)), 1)
        begun = time.monotonic()
        executions, found = run(name, seconds, given.seed)
        finds += found
        note(f"target {name}", executions=executions, seconds=time.monotonic() - begun, seed=given.seed,
             finds=found, log=given.log)  # fmt: skip
        print(f"{name}: {executions} executions in {seconds} s, {sum(found.values())} finds")
    print("".join(f"  {count:5} {name}\n" for name, count in finds.items()), end="")
    return 1 if finds else 0


def run(name: str, seconds: int, seed: int) -> tuple[int, Counter[str]]:
    """Run a target for some seconds; return its executions, and what ended it."""
    kept = FINDS / f"target-{name}"
    kept.mkdir(parents=True, exist_ok=True)
    grown = CORPUS.with_name("fuzz-grown") / name
    grown.mkdir(parents=True, exist_ok=True)
    process = subprocess.run(
        [
            sys.executable, "-m", f"fuzz.target_{name}", str(grown), str(CORPUS / name),
            f"-max_total_time={seconds}", f"-seed={seed}", f"-dict={DICTIONARY}", f"-artifact_prefix={kept}/",
            "-print_final_stats=1",            f"-max_len={MOST}", "-timeout=10", "-rss_limit_mb=2048",
        ],
        check=False, capture_output=True, text=True, errors="replace", cwd=REPOSITORY,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    done = re.search(r"number_of_executed_units: (\d+)", process.stderr)
    counts = [int(found) for found in re.findall(r"^#(\d+)\s", process.stderr, re.MULTILINE)]
    executions = int(done[1]) if done else max(counts, default=0)
    if process.returncode == 0:
        return executions, Counter()
    cause = re.search(r"Uncaught Python exception: ===\n(.*)", process.stderr) or re.search(
        r"ERROR: (.*)", process.stderr
    )
    (kept / "report.txt").write_text(process.stderr[-20_000:], encoding="utf-8")
    return executions, Counter({f"target-{name}: {cause[1][:120] if cause else process.returncode}": 1})


# Seeds


def write_seeds(folder: Path, models: list[Model]) -> None:
    """Write the seeds of every target, each into a folder of its name."""
    for name, seeds in _seeds(models).items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        for number, data in enumerate(seeds):
            if len(data) <= MOST:
                (folder / name / f"{number:04}").write_bytes(data)


def _seeds(models: list[Model]) -> dict[str, list[bytes]]:
    names = [*PLAIN, *DATA, *ABSOLUTE, *UPWARDS]
    record = {
        "key": "bake m.glb",
        "how": "0" * 32,
        "from": ".",
        "read": {"m.glb": "0" * 32},
        "made": {"o.glb": None},
    }
    head = b'{"skinbake-state":1}\n'
    return {
        "glb": [data for model in models for data in model.packed(GLB)[1].values()],
        "gltf": [data for model in models for data in model.packed(EMBEDDED)[1].values()],
        "draco": [stream for model in models for stream in _streams(model)],
        "meshopt": [json.dumps(view).encode() for model in models for view in _packed_views(model)],
        "uri": [name.encode("utf-8", "surrogatepass") for name in names],
        "state": [b"", head, head + json.dumps(record).encode() + b"\n", json.dumps(record).encode() * 2],
    }


def _streams(model: Model) -> list[bytes]:
    """Return the beginnings of a model's Draco streams."""
    found = []
    for mesh in model.json.get("meshes", []):
        for primitive in mesh["primitives"]:
            extension = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
            if extension:
                view = model.json["bufferViews"][extension["bufferView"]]
                start = view.get("byteOffset", 0)
                found.append(bytes(model.binary[start : start + min(view["byteLength"], 256)]))
    return found


def _packed_views(model: Model) -> list[JsonObject]:
    return [view for view in model.json.get("bufferViews", []) if "extensions" in view]


if __name__ == "__main__":
    sys.exit(main())
