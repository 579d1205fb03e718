"""--json: stdout is one JSON document and nothing else, of the shape that CONVENTIONS.md documents."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from tests.cli.running import document, invoke, run
from tests.gltf.models import FIXTURES, FOLDER, SHARED, bake, edited, sheet, write_model

COUNT = {"type": "integer", "minimum": 0}
TEXT = {"type": "string", "minLength": 1}
PLACE = {
    "mesh": COUNT,
    "mesh_name": {"type": "string"},
    "primitive": COUNT,
    "attribute": TEXT,
}


def strict(properties: dict[str, Any], *, optional: dict[str, Any] | None = None) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {**properties, **(optional or {})},
        "required": list(properties),
        "additionalProperties": False,
    }


WARNINGS = {
    "type": "array",
    "items": strict(
        {
            "code": {"type": "string", "pattern": "^[a-z]+(-[a-z]+)*$"},
            "message": TEXT,
            "count": {"type": "integer", "minimum": 1},
        },
        optional=PLACE,
    ),
}
ERROR = {
    "oneOf": [
        {"type": "null"},
        strict(
            {
                "kind": {"enum": ["InputError", "UnsupportedFeatureError", "OutputError"]},
                "message": TEXT,
            },
            optional=PLACE,
        ),
    ]
}
SPREAD = strict({name: {"type": "number", "minimum": 0} for name in ("mean", "p99", "max")})
LIMITED = {
    "oneOf": [
        {"type": "null"},
        strict(
            {
                "influences": {"type": "integer", "multipleOf": 4, "minimum": 4},
                "vertices": COUNT,
                "left_out": {"type": "number", "minimum": 0, "maximum": 1},
                "normals": SPREAD,
                "positions": SPREAD,
                "size": {"type": "number", "minimum": 0},
                "poses": TEXT,
            }
        ),
    ]
}
BAKED = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "vertices": COUNT,
        "triangles": COUNT,
        "degenerate_triangles": COUNT,
        "influences": {"type": "integer", "multipleOf": 4, "minimum": 4},
        "frame": {"enum": ["tangent", "normal"]},
        "generated_normals": {"type": "boolean"},
        "adopting_vertices": COUNT,
        "overflowing_vertices": COUNT,
        "lost_gradient": {"type": "number", "minimum": 0, "maximum": 1},
        "gradient": {"type": "number", "minimum": 0},
        "added_bytes": COUNT,
        "bytes_per_vertex": {"type": "integer", "minimum": 6},
        "limited": LIMITED,
    },
    optional={"mesh_name": {"type": "string"}},
)
ANGLE = {"type": "number", "minimum": 0, "maximum": 180}
ENCODING = {
    "oneOf": [
        {"type": "null"},
        strict(
            {
                "name": {"enum": ["float32", "snorm16", "packed8"]},
                "added_error": {"oneOf": [{"type": "null"}, strict({"mean": ANGLE, "p99": ANGLE})]},
            }
        ),
    ]
}
SECONDS = {"type": "number", "minimum": 0}
TIMINGS = {"type": "object", "additionalProperties": SECONDS, "required": ["other"]}
PROCESS_TIMINGS = strict(
    {"start_up": {"type": ["number", "null"]}, "imports": SECONDS, "elapsed": SECONDS},
)
BAKE = strict(
    {
        "schema": {"const": "skinbake.bake/1"},
        "dry_run": {"type": "boolean"},
        "exit_code": {"enum": [0, 3, 4]},
        "files": {
            "type": "array",
            "minItems": 1,
            "items": strict(
                {
                    "input": TEXT,
                    "output": {"type": ["string", "null"]},
                    "status": {"enum": ["baked", "unchanged", "up-to-date", "failed"]},
                    "skipped": COUNT,
                    "primitives": {"type": "array", "items": BAKED},
                    "encoding": ENCODING,
                    "warnings": WARNINGS,
                    "error": ERROR,
                },
                optional={"timings": TIMINGS},
            ),
        },
    },
    optional={"timings": PROCESS_TIMINGS},
)
SUMMARY = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "vertices": COUNT,
        "triangles": COUNT,
        "joints": COUNT,
        "influence_sets": {"type": "integer", "minimum": 1},
        "influences": COUNT,
        "weight_sums": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
        "defects": {"type": "object", "additionalProperties": COUNT},
        "frame": TEXT,
        "attributes": {
            "type": "object",
            "additionalProperties": strict({"format": TEXT, "bytes": {"type": "integer", "minimum": 1}}),
        },
        "compression": {"type": ["string", "null"]},
        "morph_targets": COUNT,
        "baked": {
            "oneOf": [
                {"type": "null"},
                strict(
                    {
                        "metadata": {"type": "object"},
                        "changed": {"type": "array", "items": TEXT},
                        "bytes": COUNT,
                    }
                ),
            ]
        },
    },
    optional={"mesh_name": {"type": "string"}},
)
INSPECT = strict(
    {
        "schema": {"const": "skinbake.inspect/1"},
        "input": TEXT,
        "bytes": COUNT,
        "meshes": COUNT,
        "skins": COUNT,
        "animations": COUNT,
        "primitives": {"type": "array", "items": SUMMARY},
        "warnings": WARNINGS,
    }
)
STRIP = strict(
    {
        "schema": {"const": "skinbake.strip/1"},
        "input": TEXT,
        "output": TEXT,
        "primitives": COUNT,
        "warnings": WARNINGS,
    }
)


def checked(found: Any, schema: dict[str, Any]) -> Any:
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(found, schema, cls=jsonschema.Draft202012Validator)
    return found


def test_bake_of_every_fixture(tmp_path: Path) -> None:
    inputs = [FOLDER / name for name in FIXTURES]
    result = invoke("bake", *inputs, "--out-dir", tmp_path, "--json")
    found = checked(document(result), BAKE)
    assert (found["exit_code"], result.exit_code, found["dry_run"]) == (0, 0, False)
    assert [file["input"] for file in found["files"]] == [str(path) for path in inputs]
    assert [file["output"] for file in found["files"]] == [str(tmp_path / name) for name in FIXTURES]
    by_name = dict(zip(FIXTURES, found["files"], strict=True))
    (tube,) = by_name["bent_tube.glb"]["primitives"]
    assert (tube["vertices"], tube["frame"], tube["influences"]) == (1518, "normal", 4)
    for name, file in by_name.items():
        if name.endswith(".glb"):
            grown = (tmp_path / name).stat().st_size - (FOLDER / name).stat().st_size
            # The rest is JSON: some hundreds of bytes for each primitive.
            assert 0 < grown - sum(primitive["added_bytes"] for primitive in file["primitives"]) < 3000


@pytest.mark.parametrize(("encoding", "size", "least"), [("packed8", 8, 1e-3), ("snorm16", 16, 1e-6)])
def test_bake_says_what_an_encoding_costs(encoding: str, size: int, least: float) -> None:
    result = invoke("bake", FOLDER / "bent_tube.glb", "--dry-run", "--json", "--encoding", encoding)
    (file,) = checked(document(result), BAKE)["files"]
    assert file["encoding"]["name"] == encoding
    added = file["encoding"]["added_error"]
    # One part in 254 is 0.2°, of a term that only some of the surface has; one in 65,534 is 256 times less.
    assert least < added["mean"] < 100 * least
    assert added["mean"] < added["p99"] < 1000 * least
    assert [primitive["bytes_per_vertex"] for primitive in file["primitives"]] == [size]


def test_bake_as_float32_has_nothing_to_measure() -> None:
    (file,) = checked(document(invoke("bake", FOLDER / "bent_tube.glb", "--dry-run", "--json")), BAKE)[
        "files"
    ]
    assert file["encoding"] == {"name": "float32", "added_error": None}
    assert [primitive["bytes_per_vertex"] for primitive in file["primitives"]] == [24]


def test_bake_with_a_limit_of_influences(tmp_path: Path) -> None:
    inputs = [FOLDER / name for name in FIXTURES]
    result = invoke("bake", *inputs, "--out-dir", tmp_path, "--json", "--limit-influences", "4")
    found = checked(document(result), BAKE)
    limited = [file["input"] for file in found["files"] if file["primitives"][0]["limited"]]
    assert limited == [str(FOLDER / "two_sets.glb")]


def test_failures_and_warnings_are_in_the_document(tmp_path: Path) -> None:
    broken = tmp_path / "broken.glb"
    broken.touch()
    bare = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None), sheet()])
    weights = edited(
        "seam.glb", tmp_path, lambda content: content["accessors"][3].update(count=3, type="VEC4")
    )
    (tmp_path / "out").mkdir()
    result = invoke("bake", broken, bare, weights, "--out-dir", tmp_path / "out", "--json")
    found = checked(document(result), BAKE)
    first, second, third = found["files"]
    assert (found["exit_code"], result.exit_code) == (3, 3)
    assert (first["status"], first["error"]["kind"]) == ("failed", "InputError")
    assert (second["status"], second["skipped"], second["error"]) == ("baked", 1, None)
    (warning,) = second["warnings"]
    assert (warning["code"], warning["mesh"], warning["primitive"]) == ("no-normals", 0, 0)
    assert warning["mesh_name"] == "sheet"
    assert third["error"]["attribute"].startswith(("JOINTS", "WEIGHTS"))
    # Warnings and errors are on stderr besides, for people.
    assert result.stderr.count("error: ") == 2
    assert result.stderr.count("warning: ") == 1


def test_an_output_error_has_its_kind_and_code(tmp_path: Path) -> None:
    result = invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / "no" / "a.glb", "--json")
    found = checked(document(result), BAKE)
    assert (found["exit_code"], found["files"][0]["error"]["kind"]) == (4, "OutputError")


@pytest.mark.parametrize("flag", ["-q", "-v", "--color=always"])
def test_how_much_is_said_changes_nothing_in_the_document(flag: str, tmp_path: Path) -> None:
    plain = invoke("bake", FOLDER / "seam.glb", "--dry-run", "--json")
    other = invoke("bake", FOLDER / "seam.glb", "--dry-run", "--json", flag)
    assert other.stdout == plain.stdout
    assert checked(document(other), BAKE)["dry_run"] is True


def test_inspect(tmp_path: Path) -> None:
    for name in FIXTURES:
        found = checked(document(invoke("inspect", FOLDER / name, "--json")), INSPECT)
        assert all(primitive["baked"] is None for primitive in found["primitives"])
        bake(FOLDER / name, tmp_path / name)
        found = checked(document(invoke("inspect", tmp_path / name, "--json")), INSPECT)
        for primitive in found["primitives"]:
            assert primitive["baked"]["changed"] == []
            slots = 4 * primitive["influence_sets"] - 1
            assert primitive["baked"]["bytes"] == 2 * slots * 4 * primitive["vertices"]
    assert found["bytes"] == (tmp_path / FIXTURES[-1]).stat().st_size


def test_inspect_tells_formats_and_sizes() -> None:
    found = document(invoke("inspect", FOLDER / "weights_u8.glb", "--json"))
    (primitive,) = found["primitives"]
    assert primitive["attributes"] == {
        "POSITION": {"format": "VEC3 FLOAT", "bytes": 187 * 12},
        "NORMAL": {"format": "VEC3 FLOAT", "bytes": 187 * 12},
        "JOINTS_0": {"format": "VEC4 UNSIGNED_SHORT", "bytes": 187 * 8},
        "WEIGHTS_0": {"format": "VEC4 UNSIGNED_BYTE normalised", "bytes": 187 * 4},
    }
    assert primitive["weight_sums"] == pytest.approx([1, 1])
    shared = document(invoke("inspect", FOLDER / SHARED, "--json"))
    assert [entry["morph_targets"] for entry in shared["primitives"]] == [1, 1]
    assert shared["bytes"] == sum((FOLDER / name).stat().st_size for name in (SHARED, "shared accessors.bin"))


def test_strip(tmp_path: Path) -> None:
    bake(FOLDER / "two_primitives.glb", tmp_path / "baked.glb")
    result = invoke("strip", tmp_path / "baked.glb", "-o", tmp_path / "out.glb", "--json")
    found = checked(document(result), STRIP)
    assert (found["primitives"], found["warnings"]) == (2, [])
    result = invoke("strip", FOLDER / "seam.glb", "-o", tmp_path / "out.glb", "--json")
    found = checked(document(result), STRIP)
    assert [warning["code"] for warning in found["warnings"]] == ["nothing-baked"]


@pytest.mark.parametrize("name", ["\ud800", 'quo"te\\', "line\nbreak", "α 😀"])
def test_any_name_that_json_can_hold_comes_through(name: str, tmp_path: Path) -> None:
    path = edited("seam.glb", tmp_path, lambda content: content["meshes"][0].update(name=name))
    commands: list[list[str | Path]] = [["bake", path, "--dry-run"], ["inspect", path]]
    for arguments in commands:
        process = run(*arguments, "--json", env={"PYTHONIOENCODING": "utf-8"})
        assert process.returncode == 0, process.stderr
        assert name_in(process.stdout) == name


def name_in(stdout: bytes) -> str:
    found = json.loads(stdout)
    holder = found["files"][0] if "files" in found else found
    name: str = holder["primitives"][0]["mesh_name"]
    return name
