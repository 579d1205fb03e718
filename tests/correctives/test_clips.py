"""Clips with correctives are told by what they play: their names, numbers and order do not count."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.correctives.models import TUBE, rewritten, turned, with_clips
from tests.support import corpus, gltf_reading
from tests.support.baked_files import Answer, Editable, verify
from tests.support.command_line import invoke

Change = Callable[[Any], None]
MIXAMO = "mixamo.com"


def baked(source: Path, *options: str) -> Path:
    target = source.with_name(f"baked_{source.name}")
    result = invoke("bake", source, "-o", target, "--correctives", "2", *options)
    assert result.exit_code == 0, result.output
    return target


def stale(answer: Answer) -> list[str]:
    return [one["message"] for one in answer.problems("freshness")]


def playing(path: Path) -> list[bool]:
    """Return by animation whether it has weights that are not 0."""
    file = gltf_reading.read(path)
    return [
        any(
            file.values(animation["samplers"][channel["sampler"]]["output"]).any()
            for channel in animation["channels"]
            if channel["target"]["path"] == "weights"
        )
        for animation in file.content["animations"]
    ]


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return baked(with_clips(tmp_path_factory.mktemp("three") / "tube.glb", ["a", "b", "c"]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [[MIXAMO] * 3, [None] * 3, ["", None, "animation 0"], [MIXAMO, "run", MIXAMO]], ids=str
)
def test_a_fresh_bake_of_clips_that_share_a_name_verifies(names: list[str | None], tmp_path: Path) -> None:
    answer = verify(baked(with_clips(tmp_path / "tube.glb", names)))
    assert answer.exit_code == 0, answer.messages
    assert "of 3 clips" in answer.file["poses"]


@pytest.mark.slow
def test_a_clip_that_plays_nothing_may_have_the_name_of_one_that_does(tmp_path: Path) -> None:
    """As of two clips of Mixamo's name of which one alone is corrected."""
    path = baked(with_clips(tmp_path / "tube.glb", [MIXAMO, MIXAMO]), "--clips", "1")
    assert playing(path) == [False, True]
    answer = verify(path)
    assert answer.exit_code == 0, answer.messages


@pytest.mark.slow
def test_a_name_chooses_all_clips_that_have_it(tmp_path: Path) -> None:
    source = with_clips(tmp_path / "tube.glb", [MIXAMO, "run", MIXAMO])
    assert playing(baked(source, "--clips", MIXAMO)) == [True, False, True]
    assert playing(baked(source, "--clips", f"{MIXAMO} (animation 2),run")) == [False, True, True]


@pytest.mark.slow
def test_reports_tell_clips_of_one_name_by_their_numbers(tmp_path: Path) -> None:
    source = with_clips(tmp_path / "tube.glb", [MIXAMO, MIXAMO])
    target = tmp_path / "baked.glb"
    result = invoke("bake", source, "-o", target, "--correctives", "2", "--json")
    [told] = json.loads(result.stdout)["files"][0]["correctives"]
    assert told["clips"] == [f"{MIXAMO} (animation 0)", f"{MIXAMO} (animation 1)"]
    worst = verify(target).file["normals_by_tangents"]["lbs"]["standard"]["worst"]
    assert worst["clip"] in told["clips"]
    assert f"{MIXAMO} (animation 0), {MIXAMO} (animation 1)" in invoke("inspect", target).output


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["none", "its own"])
def test_a_fresh_bake_of_a_mesh_under_two_skins_of_which_one_moves_verifies(
    joint: str, tmp_path: Path
) -> None:
    """The clip moves the joints of the first skin. The second one has others, or stands still."""

    def change(content: Any) -> None:
        nodes = content["nodes"]
        first = len(nodes)
        nodes += [{"translation": [0, 1.5 * (number > 0), 0]} for number in range(3)]
        nodes[first]["children"], nodes[first + 1]["children"] = [first + 1], [first + 2]
        joints = [first, first + 1, first + 2] if joint == "its own" else [first] * 3
        content["skins"].append({**content["skins"][0], "joints": joints})
        nodes.append({"mesh": 0, "skin": 1})
        content["scenes"][0]["nodes"] += [first, len(nodes) - 1]

    answer = verify(baked(rewritten(TUBE, tmp_path / "tube.glb", change)))
    assert answer.exit_code == 0, answer.messages


def _renamed(content: Any) -> None:
    for animation in content["animations"]:
        animation["name"] = "other"


def _reordered(content: Any) -> None:
    content["animations"] = content["animations"][::-1]


def _fewer(content: Any) -> None:
    del content["animations"][0]


def _one_more(content: Any) -> None:
    clip = copy.deepcopy(content["animations"][0])
    clip["channels"] = [one for one in clip["channels"] if one["target"]["path"] != "weights"][:1]
    content["animations"].append({**clip, "name": "a"})


def _moved_as_a_whole(content: Any) -> None:
    """As ``gltf-transform center`` does it."""
    nodes, scene = content["nodes"], content["scenes"][0]
    nodes.append({"translation": [3.0, -5.0, 0.5], "children": scene["nodes"]})
    scene["nodes"] = [len(nodes) - 1]


@pytest.mark.slow
@pytest.mark.parametrize("change", [_renamed, _reordered, _fewer, _one_more, _moved_as_a_whole])
def test_names_numbers_and_places_of_clips_do_not_count(three: Path, tmp_path: Path, change: Change) -> None:
    answer = verify(rewritten(three, tmp_path / "other.glb", change))
    assert answer.exit_code == 0, answer.messages


def _weights(content: Any, number: int) -> Any:
    animation = content["animations"][number]
    [found] = [one for one in animation["channels"] if one["target"]["path"] == "weights"]
    return animation["samplers"][found["sampler"]]


def _swapped(content: Any) -> None:
    one, other = _weights(content, 0), _weights(content, 1)
    one["input"], other["input"] = other["input"], one["input"]
    one["output"], other["output"] = other["output"], one["output"]


def _silent(content: Any) -> None:
    animation = content["animations"][1]
    animation["channels"] = [one for one in animation["channels"] if one["target"]["path"] != "weights"]


def _all_silent(content: Any) -> None:
    del content["animations"]


def _longer_limb(content: Any) -> None:
    content["nodes"][3]["translation"] = [0.0, 1.6, 0.0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_swapped, ['"a" plays its correctives by other weights', '"b" plays its correctives by other']),
        (_silent, ['"b" does not play its correctives any more']),
        (_all_silent, ["no clip plays its correctives any more"]),
        (_longer_limb, ['"a" or its rig changed', '"b" or its rig changed', '"c" or its rig changed']),
    ],
)
def test_clips_that_play_correctives_otherwise_are_stale(
    three: Path, tmp_path: Path, change: Change, words: list[str]
) -> None:
    messages = stale(verify(rewritten(three, tmp_path / "other.glb", change)))
    assert len(messages) == len(words)
    assert all(word in message for word, message in zip(words, messages, strict=True))


@pytest.mark.parametrize("keys", [slice(None), slice(1, 3)], ids=["whole", "in part"])
def test_a_clip_whose_joint_turns_otherwise_is_stale(three: Path, tmp_path: Path, keys: slice) -> None:
    model = Editable(three)
    sampler = model.content["animations"][2]["samplers"][1]
    sampler["output"] = turned(model, sampler["output"], 5.0, 0, keys)
    [message] = stale(verify(model.write(tmp_path / "other.glb")))
    assert message.startswith('clip "c" or its rig changed since the bake')


@pytest.mark.slow
def test_vertices_in_another_order_keep_correctives_fresh(three: Path, tmp_path: Path) -> None:
    """As after ``gltf-transform reorder``; a target in another order than its vertices is stale."""
    model = Editable(three)
    primitive = model.primitive()
    order = np.random.default_rng(3).permutation(len(model.array("POSITION")))
    rank = np.argsort(order)
    indices = model.array("indices")
    indices[:] = rank[indices]
    for accessor in primitive["attributes"].values():
        model.stored(accessor)[:] = np.array(model.stored(accessor))[order]
    stays = model.write(tmp_path / "stale.glb")
    assert verify(stays).problems("freshness")[0]["code"] == "stale"
    assert "changed since: bake again" in invoke("inspect", stays).output
    file = gltf_reading.read(three)
    for target in primitive["targets"]:
        if "NORMAL" in target:
            dense = file.values(target["NORMAL"])[order]
            target["NORMAL"] = model.add(np.ascontiguousarray(dense, dtype=np.float32))
    path = model.write(tmp_path / "moved.glb")
    answer = verify(path)
    assert answer.exit_code == 0, answer.messages
    [remark] = [one["remark"] for one in answer.file["checks"] if one["name"] == "freshness"]
    assert remark.endswith("changed since the bake, and the correctives still fit")
    assert "up to date" in invoke("inspect", path).output


@corpus.needed
@pytest.mark.parametrize("name", ["same_clip_names_small.glb", "correctives_two_skins.glb"])
def test_fresh_correctives_of_hostile_clips_verify(name: str, tmp_path: Path) -> None:
    [source] = [path for path in corpus.hostile_files("turn4") if path.name == name]
    target = tmp_path / name
    result = invoke("bake", source, "-o", target, "--correctives", "auto")
    assert result.exit_code == 0, result.output
    answer = verify(target)
    assert answer.exit_code == 0, answer.messages
