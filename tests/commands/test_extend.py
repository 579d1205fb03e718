"""``bake --neighbours extend``: a further influence set where neighbours' joints find no free slot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skinbake
from skinbake.cli import exit_codes
from tests.support import corpus, khronos
from tests.support.baked_files import CESIUM_MAN, Editable, source, verify
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import read
from tests.support.models import baked, rewritten, sheet, stripped, write_model

FULL = "two_sets.glb"
"""A fixture with vertices that have more foreign joints than free slots."""
DRACO, BYTES = "hand_l-draco-sequential.glb", "hand_l-weights-u8.glb"


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("extended") / "baked.glb"
    baked(source(FULL), path, neighbours="extend")
    return path


def test_extend_finds_a_slot_for_all_joints_of_neighbours(extended: Path, tmp_path: Path) -> None:
    result = document(invoke("bake", source(FULL), "--dry-run", "--json", "--neighbours", "extend"))
    counts = result["files"][0]["primitives"][0]
    before = document(invoke("bake", source(FULL), "--dry-run", "--json"))["files"][0]["primitives"][0]
    assert (before["overflowing_vertices"], before["influences"], before["extended"]) == (6, 8, None)
    assert (counts["overflowing_vertices"], counts["influences"]) == (0, 12)
    assert counts["lost_gradient"] < 1e-5  # joints that are not worth a slot
    # Joints and weights of the new set, and 8 floats of α and β. The multiply-adds are those of ``cost``.
    assert counts["extended"]["vertices"] == 6
    joints, weights = (read(extended).stored_attribute(f"{kind}_2") for kind in ("JOINTS", "WEIGHTS"))
    assert counts["extended"]["bytes"] == joints[0].nbytes + weights[0].nbytes + 8 * 4
    costs = [document(invoke("cost", "--influences", str(count), "--json")) for count in (8, 12)]
    work = [cost["multiply_adds"]["3"] for cost in costs]
    assert counts["extended"]["multiply_adds"] == work[1] - work[0]


@pytest.mark.parametrize("little", [0.0, 2e-4])
def test_no_set_is_advised_or_added_for_vertices_with_too_little_weight(
    tmp_path: Path, little: float
) -> None:
    """They may not adopt, however many slots they have."""
    joints = (np.arange(80).reshape(20, 4) % 40).astype(np.uint8)

    def written(few: float) -> Path:
        weights = np.full((20, 4), 0.25, dtype=np.float32)
        weights[3:] = few
        return write_model(tmp_path / "few.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=40)

    assert "try --neighbours extend" in invoke("bake", written(0.25), "--dry-run").stdout
    path = written(little)
    # Vertices 0 to 2 and their neighbours of full weight are few: the others count for nothing.
    advised = document(invoke("bake", path, "--dry-run", "--json"))["files"][0]["primitives"][0]
    assert advised["overflowing_vertices"] <= 3
    weights = np.full((20, 4), little, dtype=np.float32)
    path = write_model(tmp_path / "none.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=40)
    result = invoke("bake", path, "-o", tmp_path / "out.glb", "--neighbours", "extend")
    assert "influence set" not in result.stdout
    assert "JOINTS_1" not in read(tmp_path / "out.glb").content["meshes"][0]["primitives"][0]["attributes"]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_the_bytes_are_those_of_the_types_in_the_file(tmp_path: Path, kind: type[np.generic]) -> None:
    """Weights in 8 bits are stored in 16 where a slot adopts a joint, as one of the new set does."""
    joints = (np.arange(80).reshape(20, 4) % 40).astype(np.uint8)
    whole = 1 if kind is np.float32 else np.iinfo(kind).max  # type: ignore[type-var]  # the others are integers
    weights = np.tile(np.array([0.4, 0.2, 0.2, 0.2]) * whole, (20, 1)).astype(kind)
    path = write_model(tmp_path / "full.glb", [sheet(JOINTS_0=joints, WEIGHTS_0=weights)], joints=40)
    result = document(invoke("bake", path, "-o", tmp_path / "out.glb", "--json", "--neighbours", "extend"))
    file = read(tmp_path / "out.glb")
    names = ("JOINTS_1", "WEIGHTS_1", "_SKINBAKE_ALPHA_1", "_SKINBAKE_BETA_1")
    told = result["files"][0]["primitives"][0]["extended"]["bytes"]
    assert told == sum(file.stored_attribute(name)[0].nbytes for name in names)


def test_a_bake_that_adds_a_set_names_the_engines_that_do_not_read_it(tmp_path: Path) -> None:
    result = invoke("bake", source(FULL), "-o", tmp_path / "out.glb", "--neighbours", "extend")
    assert "; three.js, PlayCanvas, Galacean, Godot and Bevy read four influences only)" in result.stdout


def test_the_new_set_moves_no_vertex(extended: Path) -> None:
    file = read(extended)
    assert file.attribute("WEIGHTS_2").max() <= 2.0**-30
    assert file.stored_attribute("JOINTS_2").any()
    assert not khronos.new_findings(khronos.validate(source(FULL)), khronos.validate(extended))


def test_verify_passes_and_a_second_bake_is_the_same(extended: Path, tmp_path: Path) -> None:
    answer = verify(extended)
    assert (answer.exit_code, answer.failed) == (0, [])
    baked(extended, tmp_path / "again.glb", neighbours="extend")
    assert (tmp_path / "again.glb").read_bytes() == extended.read_bytes()


def test_strip_takes_the_set_away(extended: Path, tmp_path: Path) -> None:
    stripped(extended, tmp_path / "stripped.glb")
    baked(source(FULL), tmp_path / "usual.glb")
    stripped(tmp_path / "usual.glb", tmp_path / "wanted.glb")
    assert (tmp_path / "stripped.glb").read_bytes() == (tmp_path / "wanted.glb").read_bytes()


def test_an_attribute_that_came_after_the_bake_outlives_strip_and_another_bake(
    extended: Path, tmp_path: Path
) -> None:
    model = read(extended)
    attributes = model.primitive(0)["attributes"]
    attributes["_FUR"] = attributes["NORMAL"]
    path = rewritten(model, tmp_path / "furry.glb")
    bare = stripped(path, tmp_path / "stripped.glb")
    assert bare.primitive(0)["attributes"].keys() == {*read(source(FULL)).primitive(0)["attributes"], "_FUR"}
    again = baked(path, tmp_path / "again.glb", neighbours="extend")
    assert again.primitive(0)["attributes"].keys() == attributes.keys()


def test_a_set_that_was_edited_since_stays_with_a_notice(extended: Path, tmp_path: Path) -> None:
    file = read(extended)
    primitive: Any = file.content["meshes"][0]["primitives"][0]
    primitive["attributes"]["WEIGHTS_2"] = primitive["attributes"]["WEIGHTS_1"]
    path = rewritten(file, tmp_path / "edited.glb")
    result = invoke("strip", path, "-o", tmp_path / "stripped.glb")
    assert "the influences that --neighbours extend added stay" in result.stderr
    assert read(tmp_path / "stripped.glb").has_attribute("JOINTS_2")


def test_a_primitive_with_free_slots_gets_no_set(tmp_path: Path) -> None:
    one, other = (
        baked(source("foreign_joints.glb"), tmp_path / f"{kind}.glb", neighbours=kind)
        for kind in ("adopt", "extend")
    )
    for name in ("JOINTS_0", "WEIGHTS_0", "_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        np.testing.assert_array_equal(one.stored_attribute(name), other.stored_attribute(name))
    assert not other.has_attribute("JOINTS_1")


def test_extend_contradicts_a_limit_and_arrays() -> None:
    result = invoke("bake", source(FULL), "--dry-run", "--neighbours", "extend", "--limit-influences", "4")
    assert result.exit_code == exit_codes.USAGE
    assert "--limit-influences contradicts --neighbours extend" in result.stderr
    triangle = np.eye(3, dtype=np.float32)
    with pytest.raises(ValueError, match="works on files only"):
        skinbake.weight_gradients(
            triangle,
            np.ones((3, 3)),
            [[0, 1, 2]],
            np.zeros((3, 4), int),
            np.ones((3, 4)),
            neighbours="extend",
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", [DRACO, BYTES])
def test_extend_works_on_compressed_and_integer_influences(tmp_path: Path, name: str) -> None:
    skinbake.bake(corpus.model(name), tmp_path / "baked.glb", neighbours="extend")
    answer = verify(tmp_path / "baked.glb")
    assert (answer.exit_code, answer.failed) == (0, [])
    after = khronos.validate(tmp_path / "baked.glb")
    assert not khronos.new_findings(khronos.validate(corpus.model(name)), after)


@pytest.mark.slow
def test_extend_lights_a_character_better(tmp_path: Path) -> None:
    found = {}
    for kind in ("adopt", "extend"):
        path = tmp_path / f"{kind}.glb"
        skinbake.bake(corpus.character(CESIUM_MAN), path, neighbours=kind, gradients="surface")
        found[kind] = skinbake.verify(path, methods=["lbs"])["normals_by_tangents"]["lbs"]["accurate"]["mean"]
    assert found["extend"] < 0.7 * found["adopt"]


def test_no_set_is_added_where_it_would_close_a_gap(tmp_path: Path) -> None:
    """The sets after a gap are not read. A new set before them would make them count."""
    file = Editable(source(FULL))
    attributes = file.primitive()["attributes"]
    for kind in ("JOINTS", "WEIGHTS"):
        attributes[f"{kind}_3"] = attributes[f"{kind}_1"]
    gap = file.write(tmp_path / "gap.glb")
    found = document(invoke("bake", gap, "-o", tmp_path / "out.glb", "--json", "--neighbours", "extend"))
    counts = found["files"][0]["primitives"][0]
    assert (counts["extended"], counts["influences"], counts["overflowing_vertices"]) == (None, 8, 6)
    assert verify(tmp_path / "out.glb").failed == []
