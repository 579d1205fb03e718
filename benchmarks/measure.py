"""Measure the rows of `make bench`: one function for each row of the table, or for a few rows of one run.

Each takes a plan (how much) and an empty folder, and returns JSON: what was measured on which input, and
the figures of every command's runs under its name. Where a peer is not installed its runs are missing.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks import peers, truth_cost
from benchmarks.corpus_table import corpus_folders
from benchmarks.our_gradients import mesh_of, write_mesh
from benchmarks.processes import SKINBAKE, Command, Json, Rounds, figures, in_turn, run
from benchmarks.skinned_grid import grid_of, write_grid
from skinbake.choices import Truth
from skinbake.threads import usable_cores

CHARACTER = Path("CesiumMan", "CesiumMan.glb")
FALLBACK = peers.REPOSITORY / "fixtures" / "bent_tube.glb"
JOBS = 2
REPEATS = 3
"""Repeats of a loop that is timed inside its process: the arrays are read once for all of them."""

COUNTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""The threads by which the speed-up is measured, as far as there are more cores."""

MEMORY, DISK = 400, 300
"""Bytes a vertex that must be free for a grid to be baked: half as much again as its bake may take."""

SCRIPT = [sys.executable, "-m"]


SLOW = Rounds(least=3, most=5, warm_up=False)
"""For what takes many seconds, and whose code other rows have warmed up."""


@dataclass(frozen=True)
class Plan:
    """How much is measured: how many vertices, poses, files, calls and bytes; and how often."""

    grid: int = 1_000_000
    scaling: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
    largest: int = 10_000_000
    verified: int = 34_000
    poses: int = 200
    files: int = 1_000
    file_vertices: int = 2_500
    single_calls: int = 50
    payload: int = 64_000_000
    rounds: Rounds = field(default_factory=Rounds)
    slow: Rounds = SLOW


FULL = Plan()
QUICK = Plan(
    grid=10_000,
    scaling=(1_000, 3_000, 10_000),
    largest=10_000,
    verified=2_500,
    poses=10,
    files=8,
    file_vertices=400,
    single_calls=2,
    payload=1_000_000,
    rounds=Rounds(least=1, most=1, warm_up=False),
    slow=Rounds(least=1, most=1, warm_up=False),
)


def startup(plan: Plan, folder: Path) -> Json:
    """Time what answers without work, against an empty Python program."""
    commands: dict[str, Command] = {
        "skinbake --help": [*SKINBAKE, "--help"],
        "skinbake --version": [*SKINBAKE, "--version"],
        "python -c pass": peers.EMPTY_PYTHON,
    }
    return {"runs": in_turn(commands, plan.rounds)}


def character(plan: Plan, folder: Path) -> Json:
    """Bake a character."""
    model = character_model()
    commands = {"bake": bake(model, folder), "tangents": tool("tangents", model, folder)}
    return {"model": model.name, "bytes": model.stat().st_size, "runs": measured(commands, plan.rounds)}


def grid(plan: Plan, folder: Path) -> Json:
    """Bake a grid of a million vertices, against tools that read and write it."""
    model = new_grid(plan.grid, folder)
    fast = {
        "bake": bake(model, folder),
        "bake --no-sync": [*bake(model, folder), "--no-sync"],
        "copy": tool("copy", model, folder),
        "gltfpack": peers.gltfpack(model, folder / "packed.glb"),
    }
    return {"vertices": plan.grid, "bytes": model.stat().st_size, "runs": measured(fast, plan.rounds)}


def tangents(plan: Plan, folder: Path) -> Json:
    """Bake the same grid, against a tool that makes tangents and takes half a minute."""
    model = new_grid(plan.grid, folder)
    commands = {"bake": bake(model, folder), "tangents": tool("tangents", model, folder)}
    return {"runs": measured(commands, plan.slow)}


def gradients(plan: Plan, folder: Path) -> Json:
    """Time the gradients alone, on one core, against two loops of others: inside the processes."""
    mesh = folder / "mesh.raw"
    write_mesh(mesh, mesh_of(grid_of(plan.grid)))
    loop = peers.authors_loop(folder)
    commands: dict[str, Command] = {"skinbake": [*SCRIPT, "benchmarks.our_gradients", mesh, str(REPEATS)]}
    if loop is not None:
        commands["authors' loop"] = [loop, mesh, str(REPEATS)]
    meshoptimizer = peers.meshopt_tangents(mesh, REPEATS)
    if meshoptimizer is not None:
        commands["meshoptimizer"] = meshoptimizer
    seconds: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(plan.rounds.least):
        for name, command in commands.items():
            seconds[name] += map(float, run(command, one_core=True).printed.split())
    return {"vertices": plan.grid, "runs": {name: {"seconds": taken} for name, taken in seconds.items()}}


def scaling(plan: Plan, folder: Path) -> Json:
    """Bake grids from small to as large as this machine's memory and disk take."""
    sizes = [vertices for vertices in plan.scaling if has_room(vertices, folder)]
    models = {vertices: new_grid(vertices, folder) for vertices in sizes}
    commands = {str(vertices): bake(model, folder) for vertices, model in models.items()}
    runs = in_turn(commands, plan.slow)
    written = {vertices: Path(commands[str(vertices)][-1]).stat().st_size for vertices in sizes}
    return {
        "sizes": [
            {
                "vertices": vertices,
                "bytes": models[vertices].stat().st_size,
                "written": written[vertices],
                **runs[str(vertices)],
            }
            for vertices in sizes
        ],
        "left_out": [vertices for vertices in plan.scaling if vertices not in sizes],
    }


def verify(plan: Plan, folder: Path) -> Json:
    """Verify a grid in random poses, against libigl moving it and averaging its normals in as many."""
    baked = folder / "baked.glb"
    run([*SKINBAKE, "bake", "-q", new_grid(plan.verified, folder), "-o", baked])
    poses = str(plan.poses)
    both: Command = [*SKINBAKE, "verify", "-q", baked, "--poses", f"random:{poses}"]
    commands: dict[str, Command] = {
        "both methods": both,
        "LBS": [*both, "--method", "lbs"],
        "libigl": [*SCRIPT, "benchmarks.libigl_normals", str(plan.verified), poses],
    }
    return {"vertices": plan.verified, "poses": plan.poses, "runs": in_turn(commands, plan.rounds)}


def truths(plan: Plan, folder: Path) -> Json:
    """Verify the same grid by both truths, against the one of them that takes less time."""
    baked = folder / "baked.glb"
    run([*SKINBAKE, "bake", "-q", new_grid(plan.verified, folder), "-o", baked])
    commands = {
        f"{methods}, {choice}": truth_cost.whole_process(choice, methods, plan.poses, baked)
        for methods in truth_cost.METHODS
        for choice in (Truth.TANGENTS, truth_cost.BOTH)
    }
    return {"vertices": plan.verified, "poses": plan.poses, "runs": in_turn(commands, plan.rounds)}


def speedup(plan: Plan, folder: Path) -> Json:
    """Time commands by 1 to as many threads as there are cores, and many files by as many processes."""
    cores = usable_cores()
    counts = [count for count in COUNTS if count < cores] + [cores]
    baked = folder / "baked.glb"
    run([*SKINBAKE, "bake", "-q", new_grid(plan.verified, folder), "-o", baked])
    poses = f"random:{plan.poses}"
    verified: Command = [*SKINBAKE, "verify", "-q", baked, "--poses", poses, "--threads"]
    cases = {f"verify {plan.verified:,} vertices, {plan.poses} poses": verified}
    for vertices in dict.fromkeys((plan.grid, plan.largest)):
        if has_room(vertices, folder):
            command = bake(new_grid(vertices, folder), folder)
            cases[f"bake {vertices:,} vertices"] = [*command, "--threads"]
            cases[f"bake {vertices:,} vertices, --no-sync"] = [*command, "--no-sync", "--threads"]
    models = folder / "models"
    models.mkdir()
    for number in range(plan.files):
        shutil.copyfile(character_model(), models / f"{number:04}.glb")
    many: Command = [*SKINBAKE, "bake", "-q", models, "--out-dir", folder / "many", "--jobs"]
    cases[f"bake {plan.files:,} × {character_model().name}, by --jobs"] = many
    found = {}
    for name, command in cases.items():
        found[name] = in_turn({str(count): [*command, str(count)] for count in counts}, plan.slow)
    return {"cores": cores, "cases": found}


def files(plan: Plan, folder: Path) -> Json:
    """Bake many files in one call, against a call for each of some of them."""
    models = folder / "models"
    models.mkdir()
    for number in range(plan.files):
        write_grid(models / f"{number:04}.glb", grid_of(plan.file_vertices, phase=number / plan.files))
    sources = sorted(models.iterdir())
    many = [*SKINBAKE, "bake", "-q", *many_files(models, sources), "--out-dir", folder / "baked"]
    singles = [bake(source, folder) for source in sources[: plan.single_calls]]
    together, alone = [], []
    for _ in range(plan.slow.least):
        together.append(run(many))
        alone.append([run(single) for single in singles])
        shutil.rmtree(folder / "baked")
    return {
        "files": plan.files,
        "vertices": plan.file_vertices,
        "bytes": sources[0].stat().st_size,
        "jobs": JOBS if "--jobs" in many else 1,
        "single_calls": plan.single_calls,
        "runs": {
            "one call": figures(together),
            "single calls": {"seconds": [sum(each.seconds for each in calls) for calls in alone]},
        },
    }


def payload(plan: Plan, folder: Path) -> Json:
    """Bake a small grid with and without textures, which bake reads and writes but does not look at."""
    bare = new_grid(plan.file_vertices, folder)
    full = folder / "full.glb"
    write_grid(full, grid_of(plan.file_vertices), plan.payload)
    commands = {"bare": bake(bare, folder), "bake": bake(full, folder), "copy": tool("copy", full, folder)}
    return {
        "vertices": plan.file_vertices,
        "payload": plan.payload,
        "runs": measured(commands, plan.rounds),
    }


def stages(plan: Plan, folder: Path) -> Json:
    """Record where bake spends its time, by stage, on the character and on the grid; the rest is start-up."""
    models = {character_model().name: character_model()}
    models[f"{plan.grid:,} vertices"] = new_grid(plan.grid, folder)
    found = []
    for name, model in models.items():
        command: Command = [*SCRIPT, "benchmarks.bake_stages", model, folder / "baked.glb"]
        runs = sorted((run(command) for _ in range(plan.slow.least)), key=lambda one: one.seconds)
        middle = runs[len(runs) // 2]
        seconds = round(middle.seconds, 4)
        spent = {stage: round(taken, 5) for stage, taken in json.loads(middle.printed).items()}
        found.append({"model": name, "seconds": seconds, "stages": spent})
    return {"models": found}


def character_model() -> Path:
    """Return a small real character, or a fixture where the corpus is not here."""
    found = [models / CHARACTER for models in corpus_folders() if (models / CHARACTER).is_file()]
    return found[0] if found else FALLBACK


def bake(model: Path, folder: Path) -> Command:
    """Return the command that bakes a model into a folder; its target stands last."""
    return [*SKINBAKE, "bake", "-q", model, "-o", folder / f"baked-{model.name}"]


def tool(work: str, model: Path, folder: Path) -> Command | None:
    """Return the command of glTF-Transform on a model, None where it is not installed."""
    return peers.gltf_transform(work, model, folder / f"{work}-{model.name}")


def measured(commands: Mapping[str, Command | None], rounds: Rounds) -> Json:
    """Measure the commands that there are."""
    return in_turn({name: command for name, command in commands.items() if command is not None}, rounds)


def new_grid(vertices: int, folder: Path) -> Path:
    """Write a grid and return its path."""
    path = folder / f"grid-{vertices}.glb"
    write_grid(path, grid_of(vertices))
    return path


def has_room(vertices: int, folder: Path) -> bool:
    """Say whether a grid of that size can be baked here without swapping or filling the disk."""
    return vertices * MEMORY < free_memory() and vertices * DISK < shutil.disk_usage(folder).free


def free_memory() -> int:
    """Return how many bytes a program can have: what the system says, or all where it says nothing."""
    told = Path("/proc/meminfo")
    if told.is_file():
        for line in told.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def many_files(models: Path, sources: Sequence[Path]) -> list[str | Path]:
    """Return the arguments that name all models of a folder, to be baked by JOBS processes where it can."""
    told = run([*SKINBAKE, "bake", "--help"]).printed
    return [models, "--jobs", str(JOBS)] if "--jobs" in told else list(sources)


ROWS: dict[str, Callable[[Plan, Path], Json]] = {
    "startup": startup,
    "character": character,
    "grid": grid,
    "tangents": tangents,
    "gradients": gradients,
    "scaling": scaling,
    "verify": verify,
    "truths": truths,
    "speedup": speedup,
    "files": files,
    "payload": payload,
    "stages": stages,
}
