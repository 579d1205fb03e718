"""Work is bounded by the bytes of a file: small files that ask for much are refused, or measured in part."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skinbake.errors import InputError, Place
from skinbake.format.strip import stripped
from skinbake.freshness.baked_views import sound_views
from skinbake.freshness.staleness import made_states
from skinbake.gltf import budget as budgets
from skinbake.gltf.budget import Budget, Cost, Work
from skinbake.gltf.document import read_document
from skinbake.gltf.json_access import JsonObject
from skinbake.gltf.reading.clips import read_clips
from skinbake.gltf.reading.meshes import skinned_sources
from skinbake.measure.scene import Scene
from skinbake.truth.poses import PosePlan, PoseRequest
from tests.support.command_line import invoke
from tests.support.models import Change, Part, bake, sheet, write_model
from tests.support.webgpu import NAGA

CPU_SECONDS = 25
"""The processor time of a child, about ten times what one of these commands takes. Before there was a bound,
each of the families took longer by some command."""

HERE = Place("x.glb")

LIMITED = (
    f"import os, resource, sys; resource.setrlimit(resource.RLIMIT_CPU, ({CPU_SECONDS}, {CPU_SECONDS}));"
    "os.execv(sys.executable, [sys.executable, '-m', 'skinbake', *sys.argv[1:]])"
)


def with_skins(count: int) -> Change:
    """Have so many skins draw the mesh, each with the joints in another order."""

    def change(content: JsonObject) -> None:
        (skin,) = content["skins"]
        for number in range(1, count):
            joints = skin["joints"] + skin["joints"][:1] * (number % 97)
            content["skins"].append({"joints": [*joints, skin["joints"][number % 2]]})
            content["nodes"].append({"mesh": 0, "skin": number})
            content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    return change


def with_clips(count: int) -> Change:
    """Add clips that turn a joint."""

    def change(content: JsonObject) -> None:
        keys = len(content["accessors"])
        floats = {"componentType": 5126, "count": 2}
        content["accessors"] += [floats | {"type": "SCALAR"}, floats | {"type": "VEC4"}]
        target = {"node": content["skins"][0]["joints"][0], "path": "rotation"}
        samplers = [{"input": keys, "output": keys + 1}]
        clip = {"samplers": samplers, "channels": [{"sampler": 0, "target": target}]}
        content["animations"] = [clip] * count

    return change


def with_targets(count: int, primitives: int = 1) -> Change:
    """Add morph targets of one accessor, with weights at rest, and repeat the primitive."""

    def change(content: JsonObject) -> None:
        (primitive,) = content["meshes"][0]["primitives"]
        primitive["targets"] = [{"POSITION": primitive["attributes"]["NORMAL"]}] * count
        content["meshes"][0] |= {"weights": [0.001] * count, "primitives": [primitive] * primitives}

    return change


def with_meshes(count: int) -> Change:
    """Repeat the mesh, each time for a node of its own."""

    def change(content: JsonObject) -> None:
        for number in range(1, count):
            content["meshes"].append(content["meshes"][0])
            content["nodes"].append({"mesh": number, "skin": 0})
            content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    return change


def with_repeated_joints(count: int) -> Change:
    """Have the skin list its joints again and again."""

    def change(content: JsonObject) -> None:
        skin = content["skins"][0]
        skin["joints"] = (skin["joints"] * count)[:count]
        skin.pop("inverseBindMatrices", None)

    return change


def all_of(*changes: Change) -> Change:
    """Make several changes, one after the other."""

    def change(content: JsonObject) -> None:
        for one in changes:
            one(content)

    return change


FAMILIES: dict[str, Change] = {
    "skins": with_skins(900),
    "skins by clips": all_of(with_skins(250), with_clips(250)),
    "targets by clips": all_of(with_targets(300), with_clips(700)),
    "targets by clips, primitives and skins": all_of(with_targets(200, 9), with_clips(250), with_skins(9)),
    "targets": all_of(with_targets(50_000), with_clips(50)),
    "clips": with_clips(9000),
    "joints": with_repeated_joints(150_000),
    "primitives": with_targets(1, 1500),
}

COMMANDS: dict[str, Callable[[Path, Path, Path], list[str | Path]]] = {
    "verify": lambda source, baked, folder: ["verify", baked, "-q"],
    "normals": lambda source, baked, folder: [
        *("verify", baked, "-q", "--dump-normals", folder / "out.jsonl")
    ],
    "view": lambda source, baked, folder: ["view", source, "-o", folder / "out.html", "-q"],
    "render": lambda source, baked, folder: ["render", source, "-o", folder / "out.png", "-q"],
    "bake": lambda source, baked, folder: ["bake", source, "-o", folder / "out.glb", "-q"],
    "draco": lambda source, baked, folder: [
        "bake",
        source,
        "-o",
        folder / "out.glb",
        "-q",
        "--compress",
        "draco",
    ],
    "strip": lambda source, baked, folder: ["strip", baked, "-o", folder / "out.glb", "-q"],
    "correctives": lambda source, baked, folder: [
        *("bake", source, "-o", folder / "out.glb", "-q", "--correctives", "auto")
    ],
    "shader": lambda source, baked, folder: ["shader", "--lang", "glsl", "--for", baked, "-q"],
}


@pytest.fixture(scope="module")
def families(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, Path]]:
    """Return the file of a family and its bake, which are made once."""

    @cache
    def made(family: str) -> tuple[Path, Path]:
        folder = tmp_path_factory.mktemp("family")
        source, target = folder / "source.glb", folder / "baked.glb"
        write_model(source, [sheet()], change=FAMILIES[family])
        assert source.stat().st_size < 1_300_000
        with pytest.MonkeyPatch.context() as unbounded:  # bake writes nothing that verify refuses
            unbounded.setattr("skinbake.measure.measured.claim_verification", lambda document: None)
            bake(source, target)
        return source, target

    return made


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits the processor time of a child")
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("family", FAMILIES)
def test_small_files_take_no_long_work(
    family: str, command: str, families: Callable[[str], tuple[Path, Path]], tmp_path: Path
) -> None:
    if command == "render":
        NAGA.require()
    arguments = map(str, COMMANDS[command](*families(family), tmp_path))
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode in {0, 3}, done.stderr
    if done.returncode:
        assert re.search("steps of work|times poses|A file of", done.stderr), done.stderr
        assert "Traceback" not in done.stderr


def test_steps_are_refused_by_the_bytes_of_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budgets, "STEPS", budgets.Limit(1, 100))
    budget = Budget(backed=50)
    budget.claim(Work(steps=50), "one", HERE)
    budget.claim(Work(steps=60), "two", HERE)
    with pytest.raises(
        InputError, match="three would take 41 steps of work, so the file would take 151 in all"
    ):
        budget.claim(Work(steps=41), "three", HERE)
    budget.claim(Work(steps=40), "four", HERE)
    assert budget.steps_left == 0


@pytest.mark.slow
def test_many_tiny_meshes_are_refused_before_they_are_worked_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_model(tmp_path / "in.glb", [sheet()], change=with_meshes(700))
    out, text = tmp_path / "baked.glb", tmp_path / "x.glsl"
    with monkeypatch.context() as unbounded:
        unbounded.setattr(budgets, "STEPS", budgets.Limit(1, 1 << 30))
        assert invoke("bake", source, "-o", out).exit_code == 0
    for command, what in [
        (("bake", source, "-o", tmp_path / "p.glb", "--gradients", "fitted"), "fitting it to its poses"),
        (("shader", "--lang", "glsl", "--for", out, "-o", text), "the freshness of 700 primitives"),
        (("verify", out), "the freshness of 700 primitives"),
    ]:
        done = invoke(*command)
        assert done.exit_code == 3
        assert f"{what} would take" in done.stderr
    source = write_model(tmp_path / "in.glb", [sheet()], change=with_meshes(3000))
    done = invoke("bake", source, "-o", out)
    assert done.exit_code == 3
    assert "baking 3,000 primitives would take 2,100,000 steps" in done.stderr


@pytest.mark.slow
def test_a_character_of_many_small_parts_is_baked_verified_and_shown(tmp_path: Path) -> None:
    """130 parts of 8 vertices, in 180 KB, were refused by verify, and 100 by view."""
    commands: list[list[str | Path]] = [
        ["bake", tmp_path / "in.glb", "-o", tmp_path / "out.glb"],
        ["verify", tmp_path / "out.glb"],
        ["view", tmp_path / "in.glb", "-o", tmp_path / "out.html"],
        ["bake", tmp_path / "in.glb", "-o", tmp_path / "poses.glb", "--gradients", "fitted"],
        ["bake", tmp_path / "in.glb", "-o", tmp_path / "draco.glb", "--compress", "draco"],
    ]
    positions = sheet().attributes["POSITION"]
    parts = [sheet(POSITION=positions + np.array([0, number, 0], np.float32)) for number in range(350)]
    write_model(tmp_path / "in.glb", parts)
    assert [invoke(*command).exit_code for command in commands] == [0, 0, 0, 0, 0]
    write_model(tmp_path / "in.glb", [sheet()], change=with_targets(1, 350))
    (tmp_path / "out.glb").unlink()
    assert [invoke(*command).exit_code for command in commands] == [3, 3, 3, 3, 3]


def test_parts_allow_steps_by_vertices_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sheet has 20 vertices of 12 bytes."""
    monkeypatch.setattr(budgets, "STEPS_A_PART", 50_000)

    def allowed(count: int, change: Change | None = None) -> int:
        document = read_document(str(write_model(tmp_path / "in.glb", [sheet()] * count, change=change)))
        skinned_sources(document)
        return document.budget.parts

    def at(offset: int) -> Change:
        def change(content: JsonObject) -> None:
            first, second = (one["attributes"] for one in content["meshes"][0]["primitives"])
            positions = content["accessors"][second["POSITION"]]
            positions.update(content["accessors"][first["POSITION"]], byteOffset=offset, count=4)

        return change

    def without_bytes(content: JsonObject) -> None:
        del content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]][
            "bufferView"
        ]

    assert allowed(1) == 50_000
    assert allowed(3) == 150_000
    assert allowed(1, with_targets(1, 5)) == 50_000
    assert allowed(2, at(0)) == 12_000
    assert allowed(2, at(16)) == 50_000
    assert allowed(2, at(240)) == 62_000
    assert allowed(1, without_bytes) == 0


@pytest.mark.slow
def test_thousands_of_meshes_that_are_only_read_are_refused_early(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.glb", [sheet()], change=with_targets(1, 9000))
    done = invoke("inspect", source)
    assert done.exit_code == 3
    assert "9,000 primitives would take" in done.stderr
    few = write_model(tmp_path / "in.glb", [sheet()], change=with_targets(1, 90))
    assert invoke("inspect", few).exit_code == 0


class Counted(list[Any]):
    """A list that counts how often it is read from its beginning."""

    reads = 0

    def __iter__(self) -> Iterator[Any]:
        self.reads += 1
        return super().__iter__()


@pytest.mark.slow
@pytest.mark.parametrize("noted", [False, True])
def test_primitives_of_a_mesh_are_not_read_once_for_each_of_them(noted: bool, tmp_path: Path) -> None:
    """20,000 primitives in 1.6 MB took 11 s to strip."""
    path = write_model(tmp_path / "in.glb", [sheet()], change=with_targets(1, 50))
    if noted:
        assert invoke("bake", path, "-o", tmp_path / "out.glb", "--morph-frames").exit_code == 0
        path = tmp_path / "out.glb"
    document = read_document(str(path))
    (mesh,) = document.json["meshes"]
    lists = [Counted(mesh["primitives"])]
    mesh["primitives"] = lists[0]
    if noted:
        lists.append(Counted(mesh["extras"]["skinbake"]["morphTargets"]))
        mesh["extras"]["skinbake"]["morphTargets"] = lists[1]
    assert stripped(document)[1] == (50 if noted else 0)
    assert len(list(made_states(document))) == (50 if noted else 0)
    assert max(one.reads for one in lists) < 50


@pytest.mark.parametrize("drawn", [True, False])
def test_nodes_are_not_read_once_for_each_mesh_with_correctives(drawn: bool, tmp_path: Path) -> None:
    """2,000 meshes and 60,000 nodes, in 0.3 MB, took 29 s to strip."""
    path = write_model(tmp_path / "in.glb", [sheet()], change=with_meshes(50))
    document = read_document(str(path))
    for mesh in document.json["meshes"]:
        mesh["extras"] = {"skinbake": {"version": 1, "targets": 1}}
    if not drawn:
        document.json["nodes"] = [{}] * 60
    nodes = Counted(document.json["nodes"])
    document.json["nodes"] = nodes
    assert stripped(document)[1] == 50
    assert nodes.reads < 10


@pytest.mark.slow
def test_streams_of_draco_are_steps_of_work(tmp_path: Path) -> None:
    """500 primitives that share their arrays, in 41 KB, took 25 s to be refused."""
    source = write_model(tmp_path / "in.glb", [sheet(NORMAL=None)], change=with_meshes(250))
    arguments: list[str | Path] = ["bake", source, "-o", tmp_path / "out.glb", "--generate-normals"]
    arguments += ["--compress", "draco"]
    done = invoke(*arguments)
    assert done.exit_code == 3
    assert "into Draco would take 6,000 steps of work" in done.stderr
    positions = sheet().attributes["POSITION"]
    parts = [sheet(POSITION=positions + np.array([0, number, 0], np.float32)) for number in range(25)]
    write_model(tmp_path / "in.glb", parts)
    assert invoke(*arguments).exit_code == 0
    done = invoke(*arguments, "--position-bits", "24", "--normal-bits", "24")
    assert done.exit_code == 3
    assert "into Draco would take 140,217 steps of work" in done.stderr


def test_clips_that_say_the_same_are_sampled_once(tmp_path: Path) -> None:
    path = write_model(tmp_path / "in.glb", [sheet()], change=with_clips(40))
    document = read_document(str(path))
    clips = read_clips(document)
    assert len(clips) == 40
    one, every = (PosePlan.of(document, 0, some, PoseRequest(samples=5), None) for some in (clips[:1], clips))
    a_clip = Cost.SAMPLED_CLIP + Cost.SAMPLED_CHANNEL * len(clips[0].channels)
    assert every.work().steps - a_clip.steps == 40 * (one.work().steps - a_clip.steps)


@pytest.mark.slow
def test_poses_that_are_too_much_work_are_left_out_with_a_notice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_model(tmp_path / "in.glb", [sheet()], change=all_of(with_targets(3), with_clips(200)))
    bake(source, tmp_path / "baked.glb")
    measured, notice = verified(tmp_path / "baked.glb")
    count = int(measured.split()[0])
    assert 3 < count < 600
    assert measured.startswith(f"{count} poses of {count // 3} clips")
    assert f"in {count} of up to 600 poses" in notice
    monkeypatch.setattr(budgets, "STEPS", budgets.Limit(1, 1 << 30))
    measured, notice = verified(tmp_path / "baked.glb")
    assert measured.startswith("600 poses of 200 clips")
    assert not notice


@pytest.mark.slow
@pytest.mark.parametrize("clips", [1, 150])
def test_skins_that_are_too_much_work_are_left_out_with_a_notice(clips: int, tmp_path: Path) -> None:
    """A scene of 250 skins in 20 KB was baked, and verify refused it."""
    source = write_model(tmp_path / "in.glb", [sheet()], change=all_of(with_skins(250), with_clips(clips)))
    bake(source, tmp_path / "baked.glb")
    measured, notice = verified(tmp_path / "baked.glb")
    assert measured
    found = re.search("in ([0-9]+) of the 250 ways in which skins draw its meshes", notice)
    assert found is not None
    assert 50 < int(found[1]) < 150


@pytest.mark.slow
def test_each_mesh_is_measured_in_its_first_skin_before_any_in_its_second(tmp_path: Path) -> None:
    def change(content: JsonObject) -> None:
        with_skins(150)(content)
        content["meshes"].append(json.loads(json.dumps(content["meshes"][0])))
        content["nodes"].append({"mesh": 1, "skin": 0})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)

    bake(write_model(tmp_path / "in.glb", [sheet()], change=change), tmp_path / "baked.glb")
    (found,) = json.loads(invoke("verify", tmp_path / "baked.glb", "--json").stdout)["files"]
    assert "poses-left-out" in {one["code"] for one in found["warnings"]}
    assert [one["mesh"] for one in found["primitives"]] == [0, 1]


def test_targets_of_a_draw_are_read_once_for_all_moments_of_a_search(tmp_path: Path) -> None:
    """A file of 1,000 targets in 65 KB took 4 s of its 6 to be read again for each of 300 moments."""
    source = write_model(tmp_path / "in.glb", [sheet()], change=all_of(with_targets(3), with_clips(1)))
    bake(source, tmp_path / "baked.glb")
    document = read_document(str(tmp_path / "baked.glb"))
    (draw,), (clip,) = Scene(document, sound_views(document)).shown(), read_clips(document)
    first = draw.at(clip, np.array([0.0])).morphing
    spent = document.budget.taken.bytes
    second = draw.at(clip, np.array([0.0, 0.5])).morphing
    assert document.budget.taken.bytes == spent
    assert first is not None
    assert second is not None
    assert second.targets is first.targets
    assert np.array_equal(second.weights, np.full((2, 3), 0.001))
    assert draw.node is not None
    document.objects("nodes")[draw.node]["weights"] = [0, 0, 1]  # other targets move
    third = draw.at(clip, np.array([0.0])).morphing
    assert third is not None
    assert third.weights.tolist() == [[1.0]]


def fan(count: int) -> Part:
    """Make a cone with a copy of its tip for each triangle."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    positions = np.concatenate([rim, np.tile([[0, 0, 0.3]], (count, 1))]).astype(np.float32)
    weights = np.zeros((2 * count, 4), np.float32)
    weights[:, 0] = (positions[:, 0] + 1) / 2
    weights[:, 1] = 1 - weights[:, 0]
    numbers = np.arange(count)
    part = sheet(
        POSITION=positions,
        NORMAL=np.tile(np.array([[0, 0, 1]], np.float32), (2 * count, 1)),
        WEIGHTS_0=weights,
        JOINTS_0=np.tile(np.array([[0, 1, 0, 0]], np.uint8), (2 * count, 1)),
    )
    return replace(part, indices=np.stack([count + numbers, numbers, (numbers + 1) % count], axis=1))


def grid(side: int) -> Part:
    """Make a plane of so many vertices a side, of which two joints have shares."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(0, 1, side)] * 2))
    first = np.add.outer(side * np.arange(side - 1), np.arange(side - 1)).ravel()
    part = sheet(
        POSITION=np.stack([x, y, 0 * x], axis=1).astype(np.float32),
        NORMAL=np.tile(np.array([[0, 0, 1]], np.float32), (side**2, 1)),
        WEIGHTS_0=np.stack([x, 1 - x, 0 * x, 0 * x], axis=1).astype(np.float32),
        JOINTS_0=np.tile(np.array([[0, 1, 0, 0]], np.uint8), (side**2, 1)),
    )
    halves = [first, first + 1, first + side], [first + 1, first + side + 1, first + side]
    return replace(part, indices=np.concatenate([np.stack(half, axis=1) for half in halves]))


def test_correctives_of_many_vertices_in_many_clips_are_refused_and_some_clips_advised(
    tmp_path: Path,
) -> None:
    """10,000 vertices in 250 clips that are one, 0.6 MB, took 12 s, in 400 clips minutes."""
    source = write_model(tmp_path / "in.glb", [grid(45)], change=with_clips(150))
    arguments: list[str | Path] = ["bake", source, "-o", tmp_path / "out.glb", "--correctives", "auto"]
    done = invoke(*arguments)
    said = " ".join(done.stderr.split())
    assert done.exit_code == 3
    assert "fitting 2,025 vertices to 150 clips of its skins (--clips chooses some) would take" in said
    assert invoke(*arguments, "--clips", "animation 7").exit_code == 0


@pytest.mark.slow
def test_vertices_times_poses_are_left_out_with_a_notice(tmp_path: Path) -> None:
    """A crowd of one mesh with sixty skins was refused by verify."""
    bake(
        write_model(tmp_path / "in.glb", [fan(600)], change=all_of(with_skins(60), with_clips(1))),
        tmp_path / "baked.glb",
    )
    measured, notice = verified(tmp_path / "baked.glb")
    assert measured
    assert "poses of each skin" in notice


@pytest.mark.slow
@pytest.mark.parametrize("count", [40, 60, 90, 150, 1500])
def test_a_bake_that_verify_would_refuse_is_not_written(count: int, tmp_path: Path) -> None:
    """2,000 primitives of a few shared vertices were baked, and verify refused them."""
    source = write_model(tmp_path / "in.glb", [sheet()], change=with_targets(1, count))
    done = invoke("bake", source, "-o", tmp_path / "baked.glb")
    if count < 50:
        assert done.exit_code == 0, done.stderr
    if done.exit_code:
        assert done.exit_code == 3
        assert re.search("would take .* steps of work|so many copies at one place", done.stderr)
        assert not (tmp_path / "baked.glb").exists()
    else:
        assert count < 100
        assert invoke("verify", tmp_path / "baked.glb").exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize("count", [300, 1500])
def test_a_fan_with_a_centre_for_each_triangle_is_refused_or_verifies(count: int, tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.glb", [fan(count)])
    done = invoke("bake", source, "-o", tmp_path / "baked.glb")
    if count > 1000:
        assert done.exit_code == 3
        assert "so many copies at one place that welding them would take" in done.stderr
    else:
        assert done.exit_code == 0, done.stderr
        assert invoke("verify", tmp_path / "baked.glb").exit_code == 0


def verified(path: Path) -> tuple[str, str]:
    """Return the poses that verify measures, and what its notice on left out ones says."""
    (found,) = json.loads(invoke("verify", path, "--json").stdout)["files"]
    notices = [one["message"] for one in found["warnings"] if one["code"] == "poses-left-out"]
    return found["poses"], " ".join(notices)
