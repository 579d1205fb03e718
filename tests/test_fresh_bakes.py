"""A fresh bake verifies, of either kind, whatever the skins, clips and nodes of the file are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support import corpus
from tests.support.baked_files import Editable, verify
from tests.support.command_line import invoke
from tests.support.models import Part, sheet, write_model

KINDS = {
    "α/β": (),
    "α/β of the surface": ("--gradients", "surface"),
    "correctives": ("--correctives", "auto"),
}
NAMES = ["mixamo.com", "mixamo.com", None, "", "run", "animation 0"]
JOINTS = 4


def random_part(random: np.random.Generator) -> Part:
    """Return a sheet with random influences: some alike, some 0, some of a joint named twice."""
    whole = sheet()
    count = len(np.asarray(whole.attributes["POSITION"]))
    weights = random.choice([0.0, 0.0, 0.25, 0.5, 1.0], size=(count, 4)) + 1e-3
    weights[random.random((count, 4)) < 0.4] = 0.0
    weights[weights.sum(axis=1) == 0.0, 0] = 1.0
    weights /= weights.sum(axis=1, keepdims=True)
    joints = random.integers(0, JOINTS, (count, 4))
    attributes = dict(whole.attributes)
    attributes |= {"JOINTS_0": joints.astype(np.uint8), "WEIGHTS_0": weights.astype(np.float32)}
    return Part(attributes, whole.indices)


def add_clip(model: Editable, random: np.random.Generator, name: str | None, joints: list[int]) -> None:
    """Add a clip that turns, moves or scales some joints, between any keys."""
    count = int(random.integers(1, 5))
    times = model.add(np.sort(random.uniform(0.0, 2.0, (count, 1)), axis=0).astype(np.float32))
    animation: dict[str, Any] = {"channels": [], "samplers": []} | ({} if name is None else {"name": name})
    for joint in random.choice(joints, int(random.integers(1, len(joints) + 1)), replace=False):
        path = str(random.choice(["rotation", "rotation", "translation", "scale"]))
        method = str(random.choice(["LINEAR", "STEP", "CUBICSPLINE"]))
        size = count * (3 if method == "CUBICSPLINE" else 1)
        values = random.normal(size=(size, 4 if path == "rotation" else 3)) * 0.4
        values[:, 3 if path == "rotation" else slice(None)] += path != "translation"
        if path == "rotation":
            values /= np.linalg.norm(values, axis=1, keepdims=True)
        output = model.add(values.astype(np.float32))
        animation["samplers"].append({"input": times, "output": output, "interpolation": method})
        target = {"node": int(joint), "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})
    model.content.setdefault("animations", []).append(animation)


def random_model(seed: int, path: Path) -> Path:
    """Write a mesh of up to three primitives under up to three skins, with up to four clips."""
    random = np.random.default_rng(seed)
    parts = [random_part(random) for _ in range(int(random.integers(1, 4)))]
    model = Editable(write_model(path, parts, joints=JOINTS))
    content = model.content
    joints = list(content["skins"][0]["joints"])
    body = next(number for number, node in enumerate(content["nodes"]) if "mesh" in node)
    for skin in range(int(random.integers(0, 3))):
        own = {**content["skins"][0], "joints": [int(one) for one in random.permutation(joints)]}
        if random.random() < 0.5:
            own.pop("inverseBindMatrices", None)
        content["skins"].append(own)
        content["nodes"].append({**content["nodes"][body], "name": f"body {skin}", "skin": skin + 1})
        content["scenes"][0]["nodes"].append(len(content["nodes"]) - 1)
    if random.random() < 0.5:
        mesh = content["meshes"][0]
        for primitive in mesh["primitives"]:
            count = content["accessors"][primitive["attributes"]["POSITION"]]["count"]
            moved = model.add((random.normal(size=(count, 3)) * 0.1).astype(np.float32))
            bounds = model.stored(moved)
            low, high = bounds.min(axis=0).tolist(), bounds.max(axis=0).tolist()
            content["accessors"][moved] |= {"min": low, "max": high}
            primitive["targets"] = [{"POSITION": moved}]
    for name in random.choice(np.array(NAMES, dtype=object), int(random.integers(1, 5))):
        add_clip(model, random, name, joints)
    return model.write(path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_a_fresh_bake_of_any_skins_and_clips_verifies(seed: int, kind: str, tmp_path: Path) -> None:
    source, target = random_model(seed, tmp_path / "model.glb"), tmp_path / "baked.glb"
    result = invoke("bake", source, "-o", target, *KINDS[kind])
    assert result.exit_code == 0, result.output
    answer = verify(target)
    assert answer.exit_code == 0, answer.messages


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_fresh_bake_of_three_hundred_skins_verifies(kind: str, tmp_path: Path) -> None:
    model = Editable(write_model(tmp_path / "model.glb", [sheet()], joints=JOINTS))
    content = model.content
    joints = list(content["skins"][0]["joints"])
    add_clip(model, np.random.default_rng(3), "bend", joints)
    body = next(number for number, node in enumerate(content["nodes"]) if "mesh" in node)
    content["skins"] += [content["skins"][0]] * 299
    content["nodes"] += [{**content["nodes"][body], "skin": number} for number in range(1, 300)]
    content["scenes"][0]["nodes"] += range(len(content["nodes"]) - 299, len(content["nodes"]))
    target = tmp_path / "baked.glb"
    result = invoke("bake", model.write(tmp_path / "skins.glb"), "-o", target, *KINDS[kind])
    assert result.exit_code == 0, result.output
    answer = verify(target)
    assert answer.exit_code == 0, answer.messages


@pytest.mark.parametrize("kind", KINDS)
def test_a_fresh_bake_beside_a_clip_past_float32_verifies_or_is_refused(kind: str, tmp_path: Path) -> None:
    model = Editable(write_model(tmp_path / "model.glb", [sheet()], joints=JOINTS))
    joints = list(model.content["skins"][0]["joints"])
    add_clip(model, np.random.default_rng(3), "bend", joints)
    animation = model.content["animations"][0]
    sampler = {
        "input": model.add(np.array([[0.0], [1.0]], dtype=np.float32)),
        "output": model.add(np.full((2, 3), 1e30, dtype=np.float32)),
    }
    for joint in joints[1:3]:
        animation["samplers"].append(sampler)
        target = {"node": joint, "path": "scale"}
        animation["channels"] = [one for one in animation["channels"] if one["target"] != target]
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})
    target_path = tmp_path / "baked.glb"
    result = invoke("bake", model.write(tmp_path / "huge.glb"), "-o", target_path, *KINDS[kind])
    if kind == "correctives":
        assert result.exit_code == 3 and not target_path.exists(), result.output
        return
    assert result.exit_code == 0, result.output
    answer = verify(target_path)
    assert answer.exit_code == 0, answer.messages
    assert "animations-broken" in [one["code"] for one in answer.file["warnings"]]


@pytest.mark.slow
@corpus.needed
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["fresh_held_two_skins.glb", "dup_weights_channel.glb"])
def test_a_bake_of_a_hostile_file_verifies_or_is_refused(name: str, kind: str, tmp_path: Path) -> None:
    [source] = [path for path in corpus.hostile_files("turn4") if path.name == name]
    target = tmp_path / "baked.glb"
    result = invoke("bake", source, "-o", target, *KINDS[kind])
    if name == "dup_weights_channel.glb" and kind == "correctives":
        assert result.exit_code == 3 and not target.exists()
        assert "animation 0 has two channels for the morph weights of node 2" in result.output
        return
    assert result.exit_code == 0, result.output
    answer = verify(target)
    assert answer.exit_code == 0, answer.messages
