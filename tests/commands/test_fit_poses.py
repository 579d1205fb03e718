"""``bake`` with ``--fit-poses``, and how ``verify`` holds such a bake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from skinbake.cli import exit_codes
from tests.support import corpus
from tests.support.baked_files import CESIUM_MAN, source, verify
from tests.support.command_line import document, invoke, run
from tests.support.gltf_reading import read
from tests.support.models import Change, copied, edited, note, rewritten, scaled

pytestmark = pytest.mark.slow

CLIP = "bent_tube.glb"


def baked(original: Path, folder: Path, *options: str, name: str = "baked.glb") -> Path:
    target = folder / name
    result = invoke("bake", original, "-o", target, "-q", "--gradients", "fitted", *options)
    assert result.exit_code == 0, result.stderr
    return target


def changed(path: Path, change: Change, name: str) -> Path:
    """Write a copy of a file with another JSON, and the same binary part."""
    file = read(path)
    change(file.content)
    return rewritten(file, path.with_name(name))


def without_clips(content: Any) -> None:
    del content["animations"]


def mean(path: Path) -> float:
    """Return the mean error in degrees of accurate lighting, in poses that no fit here takes."""
    found: dict[str, Any] = skinbake.verify(path, methods=["lbs"], samples=34)
    return float(found["normals_by_tangents"]["lbs"]["accurate"]["mean"])


@pytest.mark.slow
def test_a_clip_is_lit_better_by_a_fit_to_it(tmp_path: Path) -> None:
    original = corpus.character(CESIUM_MAN)
    for kind in ("surface", "fitted"):
        skinbake.bake(original, tmp_path / f"{kind}.glb", gradients=kind)
    surface, fitted = (mean(tmp_path / f"{kind}.glb") for kind in ("surface", "fitted"))
    assert fitted < 0.75 * surface


def test_the_metadata_names_the_poses_and_verify_passes(tmp_path: Path) -> None:
    path = baked(source(CLIP), tmp_path)
    noted = note(read(path).content)
    assert noted is not None
    assert (noted["gradients"], noted["poses"]["from"]) == ("fitted", ["animations"])
    answer = verify(path)
    assert (answer.exit_code, answer.failed) == (0, [])


def test_two_bakes_are_the_same_bytes_also_by_workers(tmp_path: Path) -> None:
    one = baked(source(CLIP), tmp_path, "--fit-poses", "random:9", "--fit-poses", "animations")
    folder = tmp_path / "in"
    for name in (CLIP, "seam.glb"):
        copied(name, folder)
    options = ("--gradients", "fitted", "--fit-poses", "random:9", "--fit-poses", "animation")
    result = invoke("bake", folder, "--out-dir", tmp_path / "out", "-q", "--jobs", "2", *options)
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "out" / CLIP).read_bytes() == one.read_bytes()


def test_one_percent_of_alpha_is_caught(tmp_path: Path) -> None:
    path = baked(source(CLIP), tmp_path)
    answer = verify(scaled(path, "_SKINBAKE_ALPHA_0", 1.01, "scaled.glb"))
    assert answer.failed == ["freshness"]


def test_a_bake_whose_clips_are_gone_passes_by_its_digest(tmp_path: Path) -> None:
    path = changed(baked(source(CLIP), tmp_path), without_clips, "gone.glb")
    answer = verify(path)
    assert answer.exit_code == 0
    assert "the poses of the fit are not in the file" in invoke("verify", path, "-v").stdout
    answer = verify(scaled(path, "_SKINBAKE_ALPHA_0", 1.01, "scaled.glb"))
    assert answer.failed == ["freshness"]
    assert "α/β changed since its bake" in answer.messages


def test_a_bake_whose_clips_are_gone_fails_if_its_arrays_or_its_rig_changed(tmp_path: Path) -> None:
    path = changed(baked(source(CLIP), tmp_path), without_clips, "gone.glb")
    moved = verify(scaled(path, "POSITION", 1.5, "moved.glb", first=3))
    assert moved.failed == ["freshness"]
    assert "POSITION changed since its bake" in moved.messages

    def turn_upside_down(content: Any) -> None:
        joints = content["skins"][0]["joints"]
        joints[0], joints[-1] = joints[-1], joints[0]

    rig = verify(changed(path, turn_upside_down, "rig.glb"))
    assert "freshness" in rig.failed
    assert "The skeleton changed since the bake" in rig.messages


def test_the_clips_of_another_file_move_nodes_of_the_same_names(tmp_path: Path) -> None:
    own = baked(source(CLIP), tmp_path)
    walk = changed(named(copied(CLIP, tmp_path)), lambda content: None, "walk.glb")
    still = changed(walk, without_clips, "still.glb")
    path = baked(still, tmp_path, "--fit-poses", str(walk), name="lent.glb")
    found, wanted = (read(one).attribute("_SKINBAKE_ALPHA_0") for one in (path, own))
    np.testing.assert_array_equal(found, wanted)
    noted = note(read(path).content)
    assert noted is not None and noted["poses"]["from"] == ["walk.glb"]
    answer = verify(path)
    assert answer.exit_code == 0
    assert "the poses of the fit are not in the file" in invoke("verify", path, "-v").stdout


def named(path: Path) -> Path:
    """Give every node of a file a name of its own."""

    def name(content: Any) -> None:
        for number, node in enumerate(content["nodes"]):
            node["name"] = f"node {number}"

    return changed(path, name, path.name)


def test_nodes_without_a_partner_are_told(tmp_path: Path) -> None:
    walk = named(copied(CLIP, tmp_path))

    def rename(content: Any) -> None:
        for node in content["nodes"]:
            node["name"] = "other " + node["name"]
        del content["animations"]

    other = changed(walk, rename, "other.glb")
    result = invoke("bake", other, "--dry-run", "--json", "--gradients", "fitted", "--fit-poses", walk)
    codes = [notice["code"] for notice in document(result)["files"][0]["warnings"]]
    assert {"fit-poses-unmatched", "fit-poses-none"} <= set(codes)


def test_clips_of_another_file_that_move_no_joint_are_named(tmp_path: Path) -> None:
    (tmp_path / "lent").mkdir()
    walk = named(copied(CLIP, tmp_path / "lent"))
    own = copied(CLIP, tmp_path)
    still = changed(own, without_clips, "still.glb")

    def move_another_node(content: Any) -> None:
        content["nodes"].append({"name": "door"})
        for channel in content["animations"][0]["channels"]:
            channel["target"]["node"] = len(content["nodes"]) - 1

    other = changed(own, move_another_node, "door.glb")

    def break_clips(content: Any) -> None:
        content["animations"][0]["samplers"][0]["interpolation"] = "CUBE"

    broken = changed(own, break_clips, "broken.glb")
    for path in (own, still, other, broken):
        result = invoke("bake", path, "--dry-run", "--gradients", "fitted", "--fit-poses", walk)
        assert result.exit_code == exit_codes.OK
        wanted = f"no clip of {walk.name} moves its joints: α/β are fitted to turns of its joints alone"
        assert wanted in result.stderr, path
    both = ("--fit-poses", walk, "--fit-poses", "animations")
    result = invoke("bake", still, "--dry-run", "--gradients", "fitted", *both)
    assert "no clip moves its joints" in result.stderr


def test_inverse_bind_matrices_of_zeros_are_baked_with_a_notice(tmp_path: Path) -> None:
    """An accessor without a buffer view is zeros. All poses are zeros too, and none moves anything."""

    def without_view(content: Any) -> None:
        del content["accessors"][content["skins"][0]["inverseBindMatrices"]]["bufferView"]

    path = edited(CLIP, tmp_path, without_view)
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--gradients", "fitted")
    assert result.exit_code == 0, result.stderr
    assert "no inverse bind matrix of the skin can be inverted" in result.stderr


@pytest.mark.parametrize(("gradients", "advised"), [("fitted", False), ("surface", True)])
def test_a_fit_to_the_rig_is_not_advised_where_it_is_impossible(
    gradients: str, advised: bool, tmp_path: Path
) -> None:
    """Over half of the vertices of this mesh adopt joints."""

    def without_view(content: Any) -> None:
        del content["accessors"][content["skins"][0]["inverseBindMatrices"]]["bufferView"]

    path = edited("foreign_joints.glb", tmp_path, without_view)
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--gradients", gradients)
    assert "so coarse a mesh is often lit worse" in result.stderr
    assert ("take --gradients fitted" in result.stderr) is advised


def test_a_file_without_clips_is_fitted_to_turns_without_a_notice(tmp_path: Path) -> None:
    still = changed(copied(CLIP, tmp_path), without_clips, "still.glb")
    result = invoke("bake", still, "-o", tmp_path / "baked.glb")
    assert result.stderr == ""
    assert verify(tmp_path / "baked.glb").exit_code == 0
    result = invoke("bake", still, "--dry-run", "--fit-poses", "random:8")
    assert (result.exit_code, result.stderr) == (exit_codes.OK, "")


def test_a_clip_that_cannot_be_read_leaves_a_fit_to_turns_with_a_notice(tmp_path: Path) -> None:
    def break_clips(content: Any) -> None:
        content["animations"][0]["samplers"][0]["interpolation"] = "CUBE"

    broken = changed(copied(CLIP, tmp_path), break_clips, "broken.glb")
    result = invoke("bake", broken, "-o", tmp_path / "baked.glb")
    assert result.exit_code == exit_codes.OK
    assert "its clips cannot be read" in result.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--gradients", "surface", "--fit-poses", "animations"], "--fit-poses needs --gradients fitted"),
        (["--gradients", "fitted", "--fit-poses", "random:"], "expected random:N"),
        (["--gradients", "fitted", "--fit-poses", "random:0"], "expected random:N"),
        (["--gradients", "fitted", "--fit-poses", "animate"], "expected random:N"),
        (["--gradients", "fitted", "--fit-poses", "random:1001"], "expected random:N"),
    ],
)
def test_values_without_a_meaning_are_usage_errors(options: list[str], said: str) -> None:
    result = invoke("bake", source(CLIP), "--dry-run", *options)
    assert result.exit_code == exit_codes.USAGE
    assert said in result.stderr


def test_a_file_of_clips_must_be_readable_and_have_some(tmp_path: Path) -> None:
    options = ("--dry-run", "--gradients", "fitted", "--fit-poses")
    missing = run("bake", source(CLIP), *options, tmp_path / "none.glb")
    assert missing.returncode == exit_codes.INPUT
    assert b"none.glb: --fit-poses: cannot be read" in missing.stderr
    still = changed(copied(CLIP, tmp_path), without_clips, "still.glb")
    result = run("bake", source(CLIP), *options, still)
    assert result.returncode == exit_codes.INPUT
    assert b"it has no animation that moves a node" in result.stderr


@pytest.mark.parametrize("option", ["-o", "--summary"])
def test_the_file_of_clips_is_never_written(tmp_path: Path, option: str) -> None:
    walk = copied(CLIP, tmp_path)
    before = walk.read_bytes()
    link = tmp_path / "link.glb"
    link.hardlink_to(walk)
    target: list[str | Path] = ["-o", tmp_path / "out.glb"] if option != "-o" else []
    result = invoke(
        "bake", source("seam.glb"), *target, "--gradients", "fitted", "--fit-poses", walk, option, link
    )
    assert result.exit_code == exit_codes.USAGE
    assert walk.read_bytes() == before
