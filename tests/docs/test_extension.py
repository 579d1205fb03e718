"""The draft of the extension: its schemas against what bakes write, and what it says of other tools."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from fixtures import skinned_normals_test
from fixtures.make_fixtures import FOLDER as FIXTURES
from tests.support import gltf_transform, khronos
from tests.support.baked_files import Editable
from tests.support.command_line import invoke
from tests.support.gltf_reading import read

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "extension"
NAME = "VENDOR_skin_weight_gradients"
SCHEMAS = {kind: FOLDER / "schema" / f"{kind}.{NAME}.schema.json" for kind in ("mesh.primitive", "mesh")}
PAGE = (FOLDER / "README.md").read_text("utf-8")

JsonObject = dict[str, Any]


def validator(kind: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(SCHEMAS[kind].read_text("utf-8")))


def with_first_node_turned(file: Editable) -> None:
    """The stored pose is then another one than the bind pose."""
    joint = file.content["skins"][0]["joints"][1]
    file.content["nodes"][joint]["rotation"] = [0.0, 0.0, 0.38268343, 0.92387953]


def with_a_leaning_tangent(file: Editable) -> None:
    file.array("TANGENT")[7, :3] += 0.3 * file.array("NORMAL")[7]


def without_normals(file: Editable) -> None:
    del file.primitive()["attributes"]["NORMAL"]


def without_normals_of_targets(file: Editable) -> None:
    for target in file.primitive()["targets"]:
        del target["NORMAL"]


def with_empty_extras(file: Editable) -> None:
    file.primitive()["extras"] = {}
    file.content["meshes"][0]["extras"] = {}


Change = Callable[[Editable], None]


def with_zeros_as_normals_of_targets(file: Editable) -> None:
    """Let targets turn no normal, as exporters of VRM do."""
    for target in file.primitive()["targets"]:
        file.stored(target["NORMAL"])[:] = 0


ASSET = f"{skinned_normals_test.FOLDER}/{skinned_normals_test.NAME}.gltf"


def with_blend_weights(file: Editable) -> None:
    """Give the mesh blend weights of linear blending and dual quaternions."""
    weights = np.linspace(0, 1, len(file.array("POSITION")), dtype=np.float32)
    file.primitive()["attributes"]["_B"] = file.add(weights[:, None])


BAKES: list[tuple[str, Change | None, str]] = [
    ("bent_tube.glb", None, ""),
    ("bent_tube.glb", with_first_node_turned, ""),
    ("bent_tube.glb", with_empty_extras, "--encoding packed8"),
    ("bent_tube.glb", None, "--gradients surface --weighting area --crease-angle 30"),
    ("bent_tube.glb", None, "--gradients fitted --fit-poses random:4 --encoding snorm16"),
    ("bent_tube.glb", None, "--alpha-name _A{set} --beta-name _B{set} --weld skin"),
    ("bent_tube.glb", without_normals, "--generate-normals"),
    ("mirrored_tangent.glb", with_a_leaning_tangent, ""),
    ("mirrored_tangent.glb", None, "--frame normal --compress meshopt"),
    ("two_sets.glb", None, "--limit-influences 4 --encoding packed8"),
    ("two_sets.glb", None, "--layout custom --encoding snorm16"),
    ("two_sets.glb", None, "--layout texcoord --neighbours drop"),
    ("foreign_joints.glb", None, ""),
    ("foreign_joints.glb", None, "--neighbours extend"),
    ("weights_u8.glb", None, "--compress draco"),
    ("shared_accessors.gltf", None, ""),
    (ASSET, None, ""),
    ("bent_tube.glb", with_blend_weights, "--blend _B"),
    ("morphed_sheet.glb", None, "--morph-frames"),
    ("morphed_sheet.glb", without_normals_of_targets, "--morph-frames"),
    ("morphed_sheet.glb", with_empty_extras, "--morph-frames"),
    ("morphed_sheet.glb", without_normals_of_targets, "--morph-normals"),
    ("morphed_sheet.glb", with_zeros_as_normals_of_targets, "--morph-normals"),
]


def baked(folder: Path, name: str, change: Change | None, options: str) -> Path:
    """Bake a fixture, changed, and return the GLB."""
    source = FIXTURES / name
    if change is not None:
        file = Editable(source)
        change(file)
        source = file.write(folder / "source.glb")
    target = folder / "baked.glb"
    result = invoke("bake", source, "-o", target, "--pack", *options.split())
    assert result.exit_code == 0, result.output
    return target


def notes(path: Path) -> Iterator[tuple[str, JsonObject]]:
    """Yield the kind of each note of α and β or of morph numbers in a file, and the note."""
    content = read(path).content
    for mesh in content["meshes"]:
        primitives = mesh["primitives"]
        held = [one for one in [*primitives, *content["accessors"]] if isinstance(one.get("extras"), dict)]
        yield from (
            ("mesh.primitive", one["extras"]["skinbake"]) for one in held if "skinbake" in one["extras"]
        )
        if "skinbake" in mesh.get("extras", {}):
            yield "mesh", mesh["extras"]["skinbake"]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, JsonObject]]:
    """Return the notes of all bakes."""
    found: list[tuple[str, JsonObject]] = []
    for bake in BAKES:
        of_one = list(notes(baked(tmp_path_factory.mktemp("bake"), *bake)))
        assert of_one, bake
        found += of_one
    return found


@pytest.mark.parametrize("kind", SCHEMAS)
def test_schemas_are_sound_and_named_as_their_files(kind: str) -> None:
    schema = json.loads(SCHEMAS[kind].read_text("utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$id"] == SCHEMAS[kind].name


@pytest.mark.slow
def test_the_metadata_of_every_option_fits_the_schemas(written: list[tuple[str, JsonObject]]) -> None:
    for kind, note in written:
        validator(kind).validate(note)


@pytest.mark.parametrize("kind", SCHEMAS)
def test_schemas_have_what_bakes_write_and_nothing_else(
    kind: str, written: list[tuple[str, JsonObject]]
) -> None:
    for path in (
        (),
        ("positions",),
        ("poses",),
        ("straightened",),
        ("blend",),
        ("morphTargets", "items"),
    ):
        schema = json.loads(SCHEMAS[kind].read_text("utf-8"))
        held = [note for one, note in written if one == kind]
        for key in path:
            schema = schema if key == "items" else schema.get("properties", {}).get(key, {})
            parts = [note.get(key, {}) for note in held] if key != "items" else held
            held = [one for part in parts for one in (part if isinstance(part, list) else [part])]
        schema = schema["items"]["anyOf"][1] if path[-1:] == ("items",) and schema else schema
        members = {member for note in held for member in note}
        assert members == set(schema.get("properties", {})) - {"extensions", "extras", "kept"}, path


def put(key: str, value: object) -> Callable[[JsonObject], object]:
    return lambda note: note.update({key: value})


def drop(*keys: str) -> Callable[[JsonObject], object]:
    return lambda note: [note.pop(key) for key in keys]


DAMAGES: dict[str, Callable[[JsonObject], object]] = {
    **{f"no {key}": drop(key) for key in ("version", "frame", "influences", "alpha", "beta", "digest")},
    "a version of text": put("version", "1"),
    "an unknown frame": put("frame", "world"),
    "five influences": put("influences", 5),
    "a name without _": put("alpha", ["ALPHA_0"]),
    "a name twice": put("beta", ["_B", "_B"]),
    "no names": put("alpha", []),
    "TEXCOORD without its layout": put("beta", ["TEXCOORD_1"]),
    "another layout's names": put("layout", "texcoord"),
    "other names than CUSTOM": put("layout", "custom"),
    "an encoding without scale": put("encoding", "packed8"),
    "a scale without encoding": put("scale", 1.0),
    "a negative scale": lambda note: note.update(encoding="packed8", scale=-1.0),
    "a short digest": lambda note: note["digest"].update(NORMAL="0b8d"),
    "no digest of POSITION": lambda note: note["digest"].pop("POSITION"),
    "a digest of TANGENT in the normal frame": lambda note: note["digest"].update(TANGENT="0" * 32),
    "the tangent frame without its digest": put("frame", "tangent"),
    "a digest of another array": lambda note: note["digest"].update(COLOR_0="0" * 32),
    "bounds without their other end": lambda note: note["positions"].pop("max"),
    "bounds of two numbers": lambda note: note["positions"].update(min=[0, 0]),
    "no type of positions": lambda note: note["positions"].pop("componentType"),
    "a fit without its rig": drop("rig"),
    "poses that are not told": drop("poses"),
    "poses without a fit": drop("gradients", "fit", "rig"),
    "a part over 1": put("kept", 1.5),
    "former influences without digest": put("adopted", {"JOINTS_0": 3}),
    "former influences of no set": lambda note: note.update(adopted={"JOINTS": 3}, formerDigest={}),
    "an extras that was kept by no": put("keepExtras", False),
}


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> JsonObject:
    ((_, note),) = notes(baked(tmp_path_factory.mktemp("usual"), "bent_tube.glb", None, ""))
    return note


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_metadata_does_not_fit(damage: str, usual: JsonObject) -> None:
    note = copy.deepcopy(usual)
    DAMAGES[damage](note)
    assert note != usual
    assert not validator("mesh.primitive").is_valid(note)


@pytest.mark.parametrize(
    "entry",
    [
        {"targets": 2},
        {"targets": 0, "frames": 4, "digest": "0" * 32},
        {"targets": 2, "frames": 5, "digest": "0" * 32},
        {"targets": 2, "normals": [], "digest": "0" * 32},
        {"targets": 2, "digest": "0" * 32},
    ],
)
def test_damaged_metadata_of_targets_does_not_fit(entry: JsonObject) -> None:
    sound = {"targets": 2, "frames": 4, "digest": "0" * 32}
    assert validator("mesh").is_valid({"version": 1, "morphTargets": [{}, sound]})
    assert not validator("mesh").is_valid({"version": 1, "morphTargets": [{}, entry]})


def test_the_example_of_the_page_is_what_bake_writes(tmp_path: Path) -> None:
    (block,) = re.findall(r"```json\n(.*?)```", PAGE, flags=re.DOTALL)
    shown = json.loads(block)["extensions"][NAME]
    validator("mesh.primitive").validate(shown)
    ((_, note),) = notes(baked(tmp_path, "seam.glb", None, ""))
    assert shown == {key: note[key] for key in shown}


def test_the_page_names_the_properties_of_the_schema() -> None:
    schema = json.loads(SCHEMAS["mesh.primitive"].read_text("utf-8"))
    table = PAGE.split("## Properties")[1].split("```")[0]
    named = {name for row in re.findall(r"^\| (`.*?) \|", table, flags=re.MULTILINE) for name in _quoted(row)}
    assert set(schema["required"]) <= named <= set(schema["properties"])


def _quoted(text: str) -> list[str]:
    return re.findall(r"`(\w+)`", text)


def with_the_extension(path: Path, names: bool) -> Path:
    """Put the object of the extension into a baked file, and perhaps name its attributes after it."""
    file = Editable(path)
    primitive = file.primitive()
    primitive["extensions"] = {NAME: copy.deepcopy(file.metadata())}
    file.content["extensionsUsed"] = [NAME]
    if names:
        attributes = primitive["attributes"]
        for which in ("ALPHA_0", "BETA_0"):
            attributes[f"{NAME}:{which}"] = attributes.pop(f"_SKINBAKE_{which}")
    return file.write(path.with_name("extended.glb"))


def test_the_validator_takes_the_object_but_no_attribute_named_after_the_extension(tmp_path: Path) -> None:
    path = baked(tmp_path, "seam.glb", None, "")
    assert khronos.validate(with_the_extension(path, names=False))["errors"] == []
    errors = khronos.validate(with_the_extension(path, names=True))["errors"]
    assert [finding.code for finding in errors] == ["MESH_PRIMITIVE_INVALID_ATTRIBUTE"] * 2


@pytest.mark.slow
def test_gltf_transform_drops_the_object_and_keeps_the_extras(tmp_path: Path) -> None:
    path = with_the_extension(baked(tmp_path, "seam.glb", None, ""), names=False)
    assert gltf_transform.transform([(path, tmp_path / "copied.glb", "copy")]) == [""]
    (primitive,) = read(tmp_path / "copied.glb").content["meshes"][0]["primitives"]
    assert primitive["extras"]["skinbake"] == Editable(path).metadata()
    assert "extensions" not in primitive
    assert "_SKINBAKE_ALPHA_0" in primitive["attributes"]
