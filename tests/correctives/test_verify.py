"""Verify of files with correctives: freshness, figures, limits, and poses that no corrective was made for."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.correctives.models import SHEET, TUBE, joined, parted, rewritten
from tests.support import corpus, gltf_reading
from tests.support.baked_files import Answer, verify
from tests.support.command_line import invoke


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(TUBE, tmp_path_factory.mktemp("tube") / "tube.glb")


def made(source: Path, target: Path, *options: str) -> Path:
    result = invoke("bake", source, "-o", target, "--correctives", "auto", *options)
    assert result.exit_code == 0, result.output
    return target


def checks(answer: Answer) -> dict[str, str]:
    return {check["name"]: check["outcome"] for check in answer.file["checks"]}


@pytest.mark.slow
def test_corrected_lighting_is_measured_beside_the_others(tube: Path) -> None:
    answer = verify(tube)
    assert checks(answer) == {"structure": "passed", "freshness": "passed"}
    for by in ("normals_by_triangles", "normals_by_tangents"):
        figures = answer.file[by]["lbs"]
        assert figures["corrected"]["mean"] < 0.1 * figures["standard"]["mean"]
        assert figures["accurate"]["mean"] < figures["standard"]["mean"]
        assert figures["gain"] == pytest.approx(figures["standard"]["mean"] / figures["corrected"]["mean"])


@pytest.mark.slow
def test_poses_without_a_clip_play_nothing(tube: Path) -> None:
    figures = verify(tube, "--poses", "random:3").file["normals_by_tangents"]["lbs"]
    assert figures["corrected"]["mean"] == pytest.approx(figures["standard"]["mean"], rel=1e-5)


@pytest.mark.slow
def test_limits_hold_the_corrected_lighting(tube: Path) -> None:
    assert checks(verify(tube, "--min-gain", "5"))["limits"] == "passed"
    assert checks(verify(tube, "--max-mean-error", "0.01"))["limits"] == "failed"


def _moved(content: Any) -> None:
    content["nodes"][2]["translation"] = [0.0, 1.7, 0.1]


def _fewer(content: Any) -> None:
    for primitive in content["meshes"][0]["primitives"]:
        primitive["targets"].pop()


def _silent(content: Any) -> None:
    animation = content["animations"][0]
    animation["channels"] = [one for one in animation["channels"] if one["target"]["path"] != "weights"]


def _other_normals(content: Any) -> None:
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    attributes["NORMAL"] = attributes["POSITION"]


def _swapped(content: Any) -> None:
    targets = content["meshes"][0]["primitives"][0]["targets"]
    targets[0]["NORMAL"], targets[1]["NORMAL"] = targets[1]["NORMAL"], targets[0]["NORMAL"]


@pytest.mark.parametrize(
    ("change", "check", "code"),
    [
        (_moved, "freshness", "stale-clips"),
        (_silent, "freshness", "stale-clips"),
        (_fewer, "structure", "targets-missing"),
        (_other_normals, "freshness", "stale"),
        (_swapped, "freshness", "stale-targets"),
    ],
)
def test_what_no_longer_fits_is_stale(
    tube: Path, tmp_path: Path, change: Callable[[Any], None], check: str, code: str
) -> None:
    answer = verify(rewritten(tube, tmp_path / "other.glb", change))
    assert checks(answer)[check] == "failed"
    assert code in {one["code"] for found in answer.file["checks"] for one in found["problems"]}


@pytest.mark.slow
def test_a_face_moves_its_own_targets_while_it_is_measured(tmp_path: Path) -> None:
    answer = verify(made(SHEET, tmp_path / "sheet.glb"))
    assert answer.file["morphs"]["moving"]
    figures = answer.file["normals_by_tangents"]["lbs"]
    assert figures["corrected"]["mean"] < 0.3 * figures["standard"]["mean"]


@pytest.mark.slow
def test_every_primitive_has_figures(tmp_path: Path) -> None:
    answer = verify(made(parted(tmp_path / "in.glb"), tmp_path / "out.glb"))
    assert len(answer.file["primitives"]) == 3
    assert all("corrected" in one["normals_by_tangents"]["lbs"] for one in answer.file["primitives"])


@pytest.mark.slow
def test_cross_fades_and_a_turned_limb_are_measured(tmp_path: Path) -> None:
    answer = verify(made(corpus.model("RiggedElf/RiggedElf.gltf"), tmp_path / "elf.glb"))
    between, turned = answer.file["mixtures"]
    assert between["name"].startswith("half-way between") and "turned by 60°" in turned["name"]
    for mixture in (between, turned):
        for truth in ("tangents", "triangles"):
            assert mixture["corrected"][truth] < mixture["standard"][truth]


def test_inspect_names_the_clips_that_play_them(tube: Path) -> None:
    assert "2 corrective normals in bend, up to date" in invoke("inspect", tube).output
    (found,) = json.loads(invoke("inspect", tube, "--json").stdout)["primitives"]
    assert found["correctives"]["targets"] == 2 and found["correctives"]["changed"] == []
    assert len(gltf_reading.read(tube).primitive(0)["targets"]) == 2


@pytest.mark.slow
def test_pages_say_where_they_leave_damaged_correctives_out(tube: Path, tmp_path: Path) -> None:
    def without_entries(content: Any) -> None:
        content["meshes"][0]["extras"]["skinbake"]["primitives"] = []

    damaged = rewritten(tube, tmp_path / "damaged.glb", without_entries)
    result = invoke("view", damaged, "-o", tmp_path / "page.html")
    assert result.exit_code == 0 and "its correctives are left out here" in result.output
    assert invoke("verify", damaged, "--html", tmp_path / "report.html").exit_code == 1
    for page in ("page.html", "report.html"):
        assert "The correctives of the file are damaged." in (tmp_path / page).read_text()
    assert invoke("verify", tube, "--html", tmp_path / "sound.html").exit_code == 0
    assert "The file has correctives." in (tmp_path / "sound.html").read_text()


def test_correctives_that_make_a_file_worse_are_told(tube: Path, tmp_path: Path) -> None:
    def turned(content: Any) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        primitive["targets"][1]["NORMAL"] = primitive["attributes"]["POSITION"]

    answer = verify(rewritten(tube, tmp_path / "worse.glb", turned))
    codes = {one["code"] for one in answer.file["warnings"]}
    assert {"correctives-worse", "correctives-mixed"} <= codes


def _of_three(target: Path) -> Path:
    """Write the tube, its parts and the sheet with morph targets as three meshes of one file, with clips."""
    return joined([TUBE, parted(target.with_name("parts.glb")), SHEET], target)


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--encoding", "packed8"), ("--clips", "breathe")], ids=str)
def test_the_figures_of_a_bake_are_those_of_verify(options: tuple[str, ...], tmp_path: Path) -> None:
    given, target = _of_three(tmp_path / "in.glb"), tmp_path / "out.glb"
    result = invoke("bake", given, "-o", target, "--correctives", "auto", "--json", *options)
    assert result.exit_code == 0, result.output
    (baked,) = json.loads(result.stdout)["files"]
    said = invoke("bake", given, "-o", target, "--correctives", "auto", *options).output
    file = verify(target).file
    for truth, member in (("triangles", "normals_by_triangles"), ("tangents", "normals_by_tangents")):
        before, after = (file[member]["lbs"][one]["mean"] for one in ("standard", "corrected"))
        assert f"{before:.2f}° -> {after:.2f}° by {truth}" in said
        own = {one["mesh"]: one for one in file["primitives"] if one["mesh"] != 1}
        for mesh in (one for one in baked["correctives"] if one["mesh"] != 1):
            figures = own[mesh["mesh"]][member]["lbs"]
            assert mesh["standard"][truth] == pytest.approx(figures["standard"]["mean"], rel=1e-4)
            assert mesh["remaining"][truth] == pytest.approx(figures["corrected"]["mean"], rel=1e-4)
        # The mean of the parts lies between those of the parts, and nowhere does a mesh become worse.
        parts = [one[member]["lbs"]["corrected"]["mean"] for one in file["primitives"] if one["mesh"] == 1]
        for mesh in (one for one in baked["correctives"] if one["mesh"] == 1):
            assert min(parts) <= mesh["remaining"][truth] <= max(parts)
