"""``bake --weld skin``: a character cut into meshes is baked, and verified, as the one surface that it is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.support import corpus, gltf_transform, khronos
from tests.support.baked_files import verify
from tests.support.command_line import document, invoke
from tests.support.cutting import cut_into_meshes, halved
from tests.support.gltf_reading import GltfFile, read
from tests.support.models import Part, baked, rewritten, sheet, stripped, write_model

FOLDER = Path(__file__).resolve().parents[2] / "fixtures"
NAMES = ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0", "JOINTS_0", "WEIGHTS_0")
TRUTHS = "normals_by_triangles", "normals_by_tangents"
FEW = ("--poses", "random:2", "--method", "lbs")


def arrays(model: GltfFile) -> list[npt.NDArray[Any]]:
    """Return everything baked, primitive by primitive in the file's order."""
    return [
        model.stored_attribute(name, mesh, number)
        for mesh, entry in enumerate(model.content["meshes"])
        for number, primitive in enumerate(entry["primitives"])
        if "JOINTS_0" in primitive["attributes"]
        for name in NAMES
    ]


@pytest.mark.parametrize("own_skins", [False, True])
def test_a_cut_mesh_has_the_bits_of_the_whole(own_skins: bool, tmp_path: Path) -> None:
    """The primitives are the same and stand in the same order, so every sum is the same sum."""
    whole = FOLDER / "two_primitives.glb"
    cut = cut_into_meshes(whole, tmp_path / "cut.glb", own_skins=own_skins)
    expected = arrays(baked(whole, tmp_path / "whole_baked.glb"))
    found = arrays(baked(cut, tmp_path / "cut_baked.glb", weld="skin"))
    apart = arrays(baked(cut, tmp_path / "apart.glb"))
    assert len(found) == len(expected) == 2 * len(NAMES)
    assert all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))
    # With --weld mesh the cut shows, in α and β of both parts.
    assert [np.array_equal(one, other) for one, other in zip(apart, expected, strict=True)] == [
        name in ("JOINTS_0", "WEIGHTS_0") for name in NAMES * 2
    ]
    assert verify(tmp_path / "cut_baked.glb", *FEW).exit_code == 0
    assert verify(tmp_path / "apart.glb", *FEW).exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["CesiumMan/CesiumMan.glb", "Fox/fox.glb", "hand_l-weights-u8.glb"])
def test_a_character_cut_in_half_is_baked_as_the_whole(name: str, tmp_path: Path) -> None:
    """Of the gradients of the surface: a fit is held back by the primitive."""
    cut = cut_into_meshes(halved(corpus.character(name), tmp_path / "half.glb"), tmp_path / "cut.glb")
    expected = arrays(
        baked(corpus.character(name), tmp_path / "whole.glb", generate_normals=True, gradients="surface")
    )
    found = arrays(baked(cut, tmp_path / "skin.glb", weld="skin", generate_normals=True, gradients="surface"))
    apart = arrays(baked(cut, tmp_path / "mesh.glb", generate_normals=True, gradients="surface"))
    for part in range(2):
        for one, other in zip(expected, found[4 * part : 4 * part + 4], strict=True):
            # Triangles in another order: float64 sums differ in the last digits, and their float32 by one.
            largest = np.abs(one.astype(np.float64)).max()
            assert np.allclose(other, one, rtol=2e-7, atol=1e-12 * largest)
    used = [np.unique(read(cut).triangles(part)) for part in range(2)]
    shown = np.abs(apart[0][used[0]] - expected[0][used[0]]).max()
    assert shown > 0.01 * np.abs(expected[0]).max()
    assert verify(tmp_path / "skin.glb", *FEW).exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "tolerance"), [("CesiumMan/CesiumMan.glb", 1e-6), ("hand_l-weights-u8.glb", 1e-3)]
)
def test_no_option_of_bake_changes_the_standard_error(name: str, tolerance: float, tmp_path: Path) -> None:
    """Not of a character in two meshes either. Slots that integer weights adopt move vertices a little."""
    cut = cut_into_meshes(halved(corpus.character(name), tmp_path / "half.glb"), tmp_path / "cut.glb")
    options: list[dict[str, Any]] = [{}, {"weld": "skin"}, {"neighbours": "drop"}, {"gradients": "surface"}]
    options += [{"weighting": "area"}, {"weighting": "angle", "weld": "skin"}]
    options += [{"crease_angle": 60.0, "frame": "normal", "weld": "skin"}]
    found = []
    for number, how in enumerate(options):
        path = tmp_path / f"{number}.glb"
        baked(cut, path, **how)
        file = verify(path, *FEW).file
        found.append([file[truth]["lbs"]["standard"] for truth in TRUTHS])
    for figures in found[1:]:
        for one, other in zip(figures, found[0], strict=True):
            for figure in ("mean", "p95", "p99"):
                assert one[figure] == pytest.approx(other[figure], rel=tolerance)


@corpus.needed
@pytest.mark.slow
def test_slots_that_integer_weights_adopt_tear_no_surface_apart(tmp_path: Path) -> None:
    """Copies of a vertex in two meshes adopt other joints, and the largest weights pay differently."""
    source = corpus.model("BaseFemale/BaseFemale.glb")
    quantised = tmp_path / "quantised.glb"
    bits = [word for name in ("position", "normal", "weight") for word in (f"--quantize-{name}", "16")]
    gltf_transform.run(["quantize", "--quantization-volume", "scene", *bits, source, quantised])
    found = []
    for model in (source, quantised):
        baked(model, tmp_path / "baked.glb")
        file = verify(tmp_path / "baked.glb", *FEW).file
        for truth in TRUTHS:
            found += [file[truth]["lbs"][lighting]["mean"] for lighting in ("standard", "accurate")]
    assert found[:4] == pytest.approx(found[4:], rel=0.01)


def test_verify_measures_a_cut_mesh_as_it_does_the_whole(tmp_path: Path) -> None:
    whole = FOLDER / "two_primitives.glb"
    cut = cut_into_meshes(whole, tmp_path / "cut.glb")
    baked(whole, tmp_path / "whole_baked.glb")
    baked(cut, tmp_path / "cut_baked.glb", weld="skin")
    expected, found = (verify(tmp_path / name, *FEW).file for name in ("whole_baked.glb", "cut_baked.glb"))
    for lighting, figures in expected["normals_by_tangents"]["lbs"].items():
        if lighting != "gain":
            # The same sums over the same vertices, to the last bit or two of a mean of thousands.
            assert found["normals_by_tangents"]["lbs"][lighting]["mean"] == pytest.approx(
                figures["mean"], rel=1e-12
            )


def by_both_truths(path: Path) -> dict[str, float]:
    """Return the mean error of standard lighting by each truth."""
    found = verify(path, *FEW).file
    return {key: found[key]["lbs"]["standard"]["mean"] for key in TRUTHS}


def test_the_truths_owe_nothing_to_the_weld_of_the_bake(tmp_path: Path) -> None:
    """Standard lighting does not use α and β, so no option of bake changes its error."""
    cut = cut_into_meshes(FOLDER / "two_primitives.glb", tmp_path / "cut.glb")
    baked(cut, tmp_path / "skin.glb", weld="skin")
    baked(cut, tmp_path / "mesh.glb")
    baked(FOLDER / "two_primitives.glb", tmp_path / "whole.glb")
    skin, mesh, whole = (by_both_truths(tmp_path / f"{name}.glb") for name in ("skin", "mesh", "whole"))
    assert mesh == pytest.approx(skin, rel=1e-6)
    assert mesh == pytest.approx(whole, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["CesiumMan/CesiumMan.glb", "RobotMantis/animated_robot_mantis.glb"])
def test_the_truths_of_real_characters_owe_nothing_to_the_weld_either(name: str, tmp_path: Path) -> None:
    cut = cut_into_meshes(halved(corpus.character(name), tmp_path / "half.glb"), tmp_path / "cut.glb")
    baked(cut, tmp_path / "skin.glb", weld="skin")
    baked(cut, tmp_path / "mesh.glb")
    # The slots of a border vertex may have adopted other joints, with a weight of a billionth.
    assert by_both_truths(tmp_path / "mesh.glb") == pytest.approx(
        by_both_truths(tmp_path / "skin.glb"), rel=1e-6
    )


def test_the_metadata_says_so_and_a_bake_again_changes_nothing(tmp_path: Path) -> None:
    cut = cut_into_meshes(FOLDER / "two_primitives.glb", tmp_path / "cut.glb")
    once = baked(cut, tmp_path / "once.glb", weld="skin")
    notes = [mesh["primitives"][0]["extras"]["skinbake"] for mesh in once.content["meshes"]]
    assert [note["weld"] for note in notes] == ["skin", "skin"]
    baked(tmp_path / "once.glb", tmp_path / "twice.glb", weld="skin")
    assert (tmp_path / "twice.glb").read_bytes() == (tmp_path / "once.glb").read_bytes()
    back = baked(tmp_path / "once.glb", tmp_path / "back.glb")
    assert "weld" not in back.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]
    baked(cut, tmp_path / "never.glb")
    assert (tmp_path / "back.glb").read_bytes() == (tmp_path / "never.glb").read_bytes()
    assert json.dumps(stripped(tmp_path / "once.glb", tmp_path / "s.glb").content) == json.dumps(
        read(cut).content
    )


def test_generated_normals_do_not_show_the_cut_either(tmp_path: Path) -> None:
    whole = write_model(tmp_path / "whole.glb", [sheet(NORMAL=None), reflected()])
    cut = cut_into_meshes(whole, tmp_path / "cut.glb")
    expected = baked(whole, tmp_path / "a.glb", generate_normals=True)
    found = baked(cut, tmp_path / "b.glb", generate_normals=True, weld="skin")
    apart = baked(cut, tmp_path / "c.glb", generate_normals=True)
    for number in range(2):
        normals = expected.stored_attribute("NORMAL", 0, number)
        assert np.array_equal(found.stored_attribute("NORMAL", number), normals)
        assert not np.array_equal(apart.stored_attribute("NORMAL", number), normals)


def reflected() -> Part:
    """Return the sheet beyond x = 1 that is its image in that plane: they meet in a valley."""
    part = sheet(NORMAL=None)
    assert part.indices is not None
    positions = np.array(part.attributes["POSITION"], dtype=np.float32)
    positions[:, 0] = 2 - positions[:, 0]
    return replace(
        part,
        attributes={**part.attributes, "POSITION": positions},
        indices=part.indices.reshape(-1, 3)[:, ::-1],
    )


def cut_and_baked(folder: Path) -> Path:
    cut = cut_into_meshes(FOLDER / "two_primitives.glb", folder / "cut.glb")
    baked(cut, folder / "baked.glb", weld="skin")
    return folder / "baked.glb"


def test_verify_sees_a_weld_that_the_metadata_does_not_tell(tmp_path: Path) -> None:
    model = read(cut_and_baked(tmp_path))
    for mesh in model.content["meshes"]:
        del mesh["primitives"][0]["extras"]["skinbake"]["weld"]
    answer = verify(rewritten(model, tmp_path / "edited.glb"), *FEW)
    assert answer.failed == ["freshness"]
    assert len(answer.problems("freshness")) == 2


def test_verify_sees_that_a_mesh_is_no_longer_drawn_by_the_skin(tmp_path: Path) -> None:
    model = read(cut_and_baked(tmp_path))
    model.content["meshes"][1]["primitives"][0]["attributes"] = {
        key: value
        for key, value in model.content["meshes"][1]["primitives"][0]["attributes"].items()
        if key in ("POSITION", "NORMAL")
    }
    del model.content["meshes"][1]["primitives"][0]["extras"]
    [problem] = verify(rewritten(model, tmp_path / "edited.glb"), *FEW).problems("freshness")
    assert (problem["code"], problem["mesh"]) == ("stale", 0)
    assert "but perhaps the meshes that its skin draws" in problem["message"]


def test_verify_names_the_mesh_whose_change_reaches_over_the_border(tmp_path: Path) -> None:
    model = read(cut_and_baked(tmp_path))
    primitive = model.content["meshes"][1]["primitives"][0]
    # A scaled copy of the positions cannot stand in the file's bytes: another accessor's do.
    primitive["attributes"]["NORMAL"] = primitive["attributes"]["POSITION"]
    problems = verify(rewritten(model, tmp_path / "edited.glb"), *FEW).problems("freshness")
    assert [problem["mesh"] for problem in problems] == [0, 1]
    assert 'It is welded with mesh 1 "cut", primitive 0, which changed' in problems[0]["message"]


@pytest.mark.parametrize("value", ["body", 3, None])
def test_a_weld_that_does_not_exist_is_damaged_metadata(value: object, tmp_path: Path) -> None:
    model = read(cut_and_baked(tmp_path))
    model.content["meshes"][0]["primitives"][0]["extras"]["skinbake"]["weld"] = value
    problems = verify(rewritten(model, tmp_path / "edited.glb"), *FEW).problems("structure")
    assert problems[0]["code"] == "metadata-broken"
    assert '"weld" is' in problems[0]["message"]


def test_meshes_of_a_skin_that_contradict_each_other_are_damaged(tmp_path: Path) -> None:
    model = read(cut_and_baked(tmp_path))
    del model.content["meshes"][1]["primitives"][0]["extras"]["skinbake"]["weld"]
    [problem] = verify(rewritten(model, tmp_path / "edited.glb"), *FEW).problems("structure")
    assert (problem["code"], problem["mesh"]) == ("metadata-broken", 1)
    assert "\"weld\" is 'mesh', and 'skin' in mesh 0" in problem["message"]


def test_the_option_and_its_notice_reach_the_command_line(tmp_path: Path) -> None:
    cut = cut_into_meshes(FOLDER / "two_primitives.glb", tmp_path / "cut.glb", own_skins=True)
    model = read(cut)
    model.content["skins"][1]["joints"].reverse()
    rewritten(model, cut)
    given = ("bake", cut, "-o", tmp_path / "out.glb", "--weld")
    assert invoke(*given, "mesh").stderr == ""
    result = invoke(*given, "skin", "--json")
    assert [warning["code"] for warning in document(result)["files"][0]["warnings"]] == ["weld-apart"]
    assert invoke(*given, "skin", "--warnings-as-errors").exit_code == 3
    assert invoke(*given, "body").exit_code == 2


def test_the_khronos_validator_finds_nothing_new(tmp_path: Path) -> None:
    khronos.require_node()
    after = cut_and_baked(tmp_path)
    reports = khronos.validate_many([tmp_path / "cut.glb", after])
    assert not khronos.new_findings(reports[tmp_path / "cut.glb"], reports[after])
