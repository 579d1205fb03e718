"""Primitives that no light reaches: they are not baked, and every command says so; a picture has them."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.builder import JsonObject
from tests.support import gltf_transform
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, edited, note, rewritten

UNLIT: JsonObject = {"extensions": {"KHR_materials_unlit": {}}}
TUBE, TWO = "bent_tube.glb", "two_primitives.glb"


def with_material(content: JsonObject, material: Any, primitive: int = 0) -> None:
    content.setdefault("materials", []).append(material)
    content["meshes"][0]["primitives"][primitive]["material"] = len(content["materials"]) - 1


def unlit(content: JsonObject) -> None:
    with_material(content, UNLIT)
    content["extensionsUsed"] = [*content.get("extensionsUsed", []), "KHR_materials_unlit"]


def codes(result: Any) -> list[str]:
    return [warning["code"] for warning in document(result)["files"][0]["warnings"]]


def test_an_unlit_model_is_not_baked_and_each_command_says_why(tmp_path: Path) -> None:
    path = edited(TUBE, tmp_path, unlit)
    assert codes(invoke("bake", path, "-o", tmp_path / "out.glb", "--json")) == ["unlit", "nothing-baked"]
    assert (tmp_path / "out.glb").read_bytes() == path.read_bytes()
    assert codes(invoke("verify", path, "--json", "--min-gain", "2")) == ["unlit", "not-baked"]
    assert "no light reaches it" in invoke("inspect", path).stderr
    result = invoke("view", path, "-o", tmp_path / "p.html")
    assert result.exit_code == 3
    assert "nothing in it can be shown: no light reaches it" in result.stderr


@pytest.mark.parametrize("lost", ["", "NORMAL", "TEXCOORD_0"])
def test_a_bake_that_became_unlit_is_not_praised_and_not_refused(tmp_path: Path, lost: str) -> None:
    """Other tools make materials unlit, and then drop the normals that no material reads."""
    invoke("bake", FOLDER / TUBE, "-o", tmp_path / "baked.glb")
    file = read(tmp_path / "baked.glb")
    unlit(file.content)
    file.content["meshes"][0]["primitives"][0]["attributes"].pop(lost, None)
    path = rewritten(file, tmp_path / "unlit.glb")
    result = invoke("verify", path, "--json")
    assert result.exit_code == 0
    verdict = document(result)["files"][0]
    assert (verdict["normals_by_tangents"], codes(result)) == (None, ["unlit", "not-baked"])
    result = invoke("shader", "--lang", "glsl", "--for", path)
    assert result.exit_code != 0
    assert "no light reaches it" in result.stderr
    assert "no light reaches it" in invoke("inspect", path).stderr
    assert invoke("verify", path, "--require-baked").exit_code == 1


@pytest.mark.slow
def test_an_unlit_model_passes_after_prune(tmp_path: Path) -> None:
    gltf_transform.require_node()
    path = edited(TUBE, tmp_path, unlit)
    assert (
        gltf_transform.run(["prune", path, tmp_path / "pruned.glb", "--keep-attributes", "false"]).returncode
        == 0
    )
    pruned = tmp_path / "pruned.glb"
    assert "NORMAL" not in read(pruned).content["meshes"][0]["primitives"][0]["attributes"]
    for result in (invoke("verify", pruned), invoke("bake", pruned, "--dry-run")):
        assert result.exit_code == 0
        assert "--generate-normals" not in result.stderr


@pytest.mark.slow
def test_lit_primitives_of_a_mesh_are_baked_as_if_the_unlit_ones_were_not_there(tmp_path: Path) -> None:
    def alone(content: JsonObject) -> None:
        del content["meshes"][0]["primitives"][0]

    mixed, single = edited(TWO, tmp_path / "mixed", unlit), edited(TWO, tmp_path / "alone", alone)
    outs = [tmp_path / "mixed.glb", tmp_path / "alone.glb"]
    for path, out in zip((mixed, single), outs, strict=True):
        assert invoke("bake", path, "-o", out).exit_code == 0
    both, one = map(read, outs)
    assert note(both.content, 0, 0) is None
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"):
        assert np.array_equal(both.stored_attribute(name, primitive=1)[0], one.stored_attribute(name)[0])
    result = invoke("verify", outs[0], "--json")
    assert result.exit_code == 0
    assert [part["primitive"] for part in document(result)["files"][0]["primitives"]] == [1]
    assert invoke("shader", "--lang", "glsl", "--for", outs[0]).exit_code == 0
    assert invoke("view", outs[0], "-o", tmp_path / "page.html").exit_code == 0


TOON: JsonObject = {"extensions": {"KHR_materials_unlit": {}, "VRMC_materials_mtoon": {"specVersion": "1.0"}}}


def of_vrm_0(shader: object) -> Any:
    def change(content: JsonObject) -> None:
        unlit(content)
        properties: list[Any] = [{} for _ in content["materials"]]
        properties[-1] = {"shader": shader}
        content["extensions"] = {"VRM": {"materialProperties": properties}}

    return change


def of_variants(*materials: Any) -> Any:
    def change(content: JsonObject) -> None:
        unlit(content)
        first = len(content["materials"])
        content["materials"] += copy.deepcopy(list(materials))
        mappings = [{"material": first + number, "variants": [0]} for number in range(len(materials))]
        extension = {"KHR_materials_variants": {"mappings": mappings}}
        content["meshes"][0]["primitives"][0]["extensions"] = extension

    return change


@pytest.mark.parametrize(
    ("change", "lit"),
    [
        (unlit, False),
        (lambda content: with_material(content, {}), True),
        (lambda content: with_material(content, TOON), True),
        (of_vrm_0("VRM/MToon"), True),
        (of_vrm_0("VRM/UnlitTexture"), False),
        (of_vrm_0("VRM_USE_GLTFSHADER"), False),
        (of_vrm_0(["VRM/MToon"]), False),
        (of_variants(UNLIT, UNLIT), False),
        (of_variants(UNLIT, {"name": "lit"}), True),
        (lambda content: with_material(content, {"extensions": []}), True),
        (lambda content: with_material(content, {"extensions": {"KHR_materials_unlit": None}}), False),
        (lambda content: content["meshes"][0]["primitives"][0].update(material=77), True),
        (lambda content: content["meshes"][0]["primitives"][0].update(material=-1), True),
        (lambda content: content.update(materials=UNLIT), True),
    ],
)
def test_a_primitive_is_lit_if_one_of_its_materials_is(tmp_path: Path, change: Any, lit: bool) -> None:
    path = edited(TUBE, tmp_path, change)
    result = invoke("bake", path, "--dry-run", "--json")
    assert result.exit_code == 0
    assert ("unlit" in codes(result)) is not lit
    assert len(document(result)["files"][0]["primitives"]) == lit
