"""Files that hold one character, each with its own clips: their correctives fit each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.correctives.models import SHEET, TUBE, clip_files, mean_errors, rewritten, with_clips
from tests.support import corpus, gltf_reading, khronos
from tests.support.baked_files import Editable, verify
from tests.support.characters import Array
from tests.support.command_line import invoke
from tests.support.played import weights_at

pytestmark = pytest.mark.slow


def bake(*arguments: str | Path, code: int = 0) -> str:
    result = invoke("bake", *arguments, "--correctives", "2", "--one-character")
    assert result.exit_code == code, result.output
    return result.output


def tubes(tmp_path: Path) -> list[Path]:
    """Write a tube without clips, and two files with a clip each."""
    return clip_files(with_clips(tmp_path / "tube.glb", ["bend", "lean"]), tmp_path / "art")


def targets(path: Path) -> list[Array]:
    """Return the morphed normals (V, 3) of the file, 0 where a target has none."""
    file = gltf_reading.read(path)
    return [
        file.values(target["NORMAL"])
        for mesh in file.content["meshes"]
        for primitive in mesh["primitives"]
        for target in primitive.get("targets", [])
    ]


def assert_alike(*paths: Path) -> None:
    first = targets(paths[0])
    assert first and any(one.any() for one in first)
    for path in paths[1:]:
        assert all(np.array_equal(*pair) for pair in zip(first, targets(path), strict=True)), path


@pytest.mark.parametrize("name", ["RobotMantis/animated_robot_mantis.glb", "Mannequiny/mannequiny-0.3.0.glb"])
def test_each_clip_file_of_a_real_character_gets_the_same_targets_and_its_own_weights(
    tmp_path: Path, name: str
) -> None:
    hero, *clips = clip_files(corpus.model(name), tmp_path / "art")
    some = [hero, *clips[:2]]
    output = bake(*some, "--out-dir", tmp_path / "build")
    assert "2 corrective normals for clips of other files" in output
    built = [tmp_path / "build" / one.name for one in some]
    assert_alike(*built)
    for path in built[1:]:
        assert verify(path, "--min-gain", "1.1").exit_code == 0
        times = gltf_reading.read(path)
        end = times.values(times.content["animations"][0]["samplers"][0]["input"])[-1, 0]
        standard, corrected = mean_errors(path, 0, [0.21 * end, 0.43 * end, 0.77 * end])
        assert corrected < 0.8 * standard


def test_alone_a_clip_file_gets_other_targets(tmp_path: Path) -> None:
    """So the ones of one character are equal because they are made together."""
    _, clip, _ = paths = tubes(tmp_path)
    bake(*paths, "--out-dir", tmp_path / "build")
    assert_alike(*(tmp_path / "build" / one.name for one in paths))
    invoke("bake", clip, "-o", tmp_path / "alone.glb", "--correctives", "2")
    together, alone = targets(tmp_path / "build" / clip.name), targets(tmp_path / "alone.glb")
    assert not all(np.array_equal(*pair) for pair in zip(together, alone, strict=True))


def test_a_second_bake_in_place_changes_nothing_and_strip_gives_the_inputs_back(tmp_path: Path) -> None:
    paths = tubes(tmp_path)
    given = [path.read_bytes() for path in paths]
    bake(*paths, "--in-place", "--jobs", "2")
    made = [path.read_bytes() for path in paths]
    assert all(one != other for one, other in zip(given, made, strict=True))
    bake(*paths, "--in-place", "--jobs", "2")
    assert [path.read_bytes() for path in paths] == made
    assert not khronos.validate(paths[1])["errors"]
    assert invoke("strip", *paths, "--in-place").exit_code == 0
    assert [path.read_bytes() for path in paths] == given


def test_all_clips_play_in_the_stored_pose_of_the_first_file(tmp_path: Path) -> None:
    """Exporters store the nodes of a clip file in the pose of a frame."""
    hero, clip, other = tubes(tmp_path)

    def moved(content: Any) -> None:
        for node in content["nodes"]:
            if "joint" in node.get("name", ""):
                node["rotation"] = [0.0, 0.6, 0.0, 0.8]

    rewritten(clip, clip, moved)
    bake(hero, clip, other, "--out-dir", tmp_path / "build")
    assert_alike(*(tmp_path / "build" / path.name for path in (hero, clip, other)))


def test_names_tell_the_nodes_whatever_their_numbers(tmp_path: Path) -> None:
    hero, clip, _ = tubes(tmp_path)

    def with_a_camera(content: Any) -> None:
        """Put a node before all others."""
        content["nodes"].insert(0, {"name": "camera"})
        for node in content["nodes"]:
            node.update({key: [one + 1 for one in node[key]] for key in {"children"} & node.keys()})
        content["skins"][0]["joints"] = [one + 1 for one in content["skins"][0]["joints"]]
        if "skeleton" in content["skins"][0]:
            content["skins"][0]["skeleton"] += 1
        content["scenes"][0]["nodes"] = [one + 1 for one in content["scenes"][0]["nodes"]]
        for channel in content["animations"][0]["channels"]:
            channel["target"]["node"] += 1

    rewritten(clip, clip, with_a_camera)
    bake(hero, clip, "--out-dir", tmp_path / "build")
    assert_alike(tmp_path / "build" / hero.name, tmp_path / "build" / clip.name)
    assert verify(tmp_path / "build" / clip.name).exit_code == 0


def test_clips_that_play_a_face_in_their_own_files_share_its_correctives(tmp_path: Path) -> None:
    model = Editable(SHEET)
    [breathe] = model.content["animations"]
    half = {**breathe, "name": "half", "channels": breathe["channels"][1:]}
    model.content["animations"] = [breathe, half]
    paths = clip_files(model.write(tmp_path / "sheet.glb"), tmp_path / "art")
    bake(*paths, "--out-dir", tmp_path / "build")
    built = [tmp_path / "build" / path.name for path in paths]
    assert_alike(*built)
    assert all(verify(path).exit_code == 0 for path in built)


def test_a_file_whose_clips_are_elsewhere_passes_and_has_no_gain_to_meet(tmp_path: Path) -> None:
    hero, *_ = paths = tubes(tmp_path)
    bake(*paths, "--out-dir", tmp_path / "build")
    result = invoke("verify", tmp_path / "build" / hero.name, "--min-gain", "1.2")
    assert result.exit_code == 0 and "Clips of other files play its correctives" in result.output


def test_a_clip_file_that_has_lost_its_clip_fails(tmp_path: Path) -> None:
    paths = tubes(tmp_path)
    bake(*paths, "--out-dir", tmp_path / "build")

    def without_clips(content: Any) -> None:
        del content["animations"]

    lost = rewritten(tmp_path / "build" / paths[1].name, tmp_path / "lost.glb", without_clips)
    assert verify(lost).failed == ["freshness"]


def test_a_clip_file_without_the_mesh_passes_through_and_says_what_to_do(tmp_path: Path) -> None:
    hero, clip, other = tubes(tmp_path)

    def without_the_mesh(content: Any) -> None:
        del content["meshes"], content["skins"]
        for node in content["nodes"]:
            node.pop("mesh", None)
            node.pop("skin", None)

    rewritten(clip, clip, without_the_mesh)
    output = bake(hero, clip, other, "--out-dir", tmp_path / "build")
    assert "export it with the mesh" in output
    assert (tmp_path / "build" / clip.name).read_bytes() == clip.read_bytes()
    assert_alike(tmp_path / "build" / hero.name, tmp_path / "build" / other.name)


def test_another_character_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    hero, clip, _ = tubes(tmp_path)
    model = Editable(clip)
    model.stored(model.content["meshes"][0]["primitives"][0]["attributes"]["POSITION"])[0] += 0.25
    model.write(clip)
    output = bake(hero, clip, "--out-dir", tmp_path / "build", code=3)
    assert 'not the same POSITION of mesh 0 "tube", primitive 0' in output
    assert not (tmp_path / "build").exists()


def test_a_bake_of_one_file_alone_warns_that_it_leaves_the_others(tmp_path: Path) -> None:
    paths = tubes(tmp_path)
    bake(*paths, "--out-dir", tmp_path / "build")
    alone = invoke("bake", tmp_path / "build" / paths[1].name, "--dry-run", "--correctives", "2")
    assert "its correctives were those of hero.glb, clip0.glb, clip1.glb" in alone.output


def test_a_change_of_one_clip_bakes_all_files_again(tmp_path: Path) -> None:
    paths = tubes(tmp_path)
    how = ["--out-dir", str(tmp_path / "build"), "--skip-unchanged", "--depfile", str(tmp_path / "build.d")]
    assert "up to date" not in bake(*paths, *how)
    assert bake(*paths, *how).count("up to date") == 3

    def slower(content: Any) -> None:
        content["animations"][0]["channels"].pop()

    rewritten(paths[2], paths[2], slower)
    assert "up to date" not in bake(*paths, *how)
    rules = (tmp_path / "build.d").read_text().splitlines()
    outputs = [line for line in rules if line.startswith(str(tmp_path / "build"))]
    assert len(outputs) == 3 and all(str(path) in line for path in paths for line in outputs)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([TUBE], "--one-character needs --correctives"),
        (["-", "--correctives", "auto"], "--one-character needs files"),
        (["https://127.0.0.1/hero.glb", "--correctives", "auto"], "--one-character needs files"),
    ],
)
def test_what_has_no_character_is_an_error_of_usage(arguments: list[str | Path], words: str) -> None:
    result = invoke("bake", *arguments, "--dry-run", "--one-character")
    assert result.exit_code == 2 and words in result.output


def test_chosen_clips_are_those_of_all_files(tmp_path: Path) -> None:
    _, *clips = paths = tubes(tmp_path)
    for chosen in ("lean", "1"):
        bake(*paths, "--out-dir", tmp_path / "build", "--clips", chosen)
        played = [weights_at(gltf_reading.read(tmp_path / "build" / one.name), 0, 0, 0.7) for one in clips]
        assert [one is not None and bool(one.any()) for one in played] == [False, True]
        assert all(one is not None for one in played)
        assert_alike(*(tmp_path / "build" / one.name for one in paths))
