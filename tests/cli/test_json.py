"""--json: stdout is one JSON document and nothing else, as docs/reference/json.md says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.command_line import call, document, invoke, run
from tests.support.models import FIXTURES, FOLDER, SHARED, bake, edited, sheet, write_model
from tests.support.schemas import BAKE, INSPECT, STRIP, checked


@pytest.mark.slow
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


@pytest.mark.slow
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
    (tmp_path / "file").touch()
    result = invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / "file" / "a.glb", "--json")
    found = checked(document(result), BAKE)
    assert (found["exit_code"], found["files"][0]["error"]["kind"]) == (4, "OutputError")


@pytest.mark.parametrize("flag", ["-q", "-v", "--color=always"])
def test_how_much_is_said_changes_nothing_in_the_document(flag: str, tmp_path: Path) -> None:
    plain = invoke("bake", FOLDER / "seam.glb", "--dry-run", "--json")
    other = invoke("bake", FOLDER / "seam.glb", "--dry-run", "--json", flag)
    assert other.stdout == plain.stdout
    assert checked(document(other), BAKE)["dry_run"] is True


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["\ud800", 'quo"te\\', "line\nbreak", "α 😀"])
def test_any_name_that_json_can_hold_comes_through(name: str, tmp_path: Path) -> None:
    path = edited("seam.glb", tmp_path, lambda content: content["meshes"][0].update(name=name))
    commands: list[list[str | Path]] = [["bake", path, "--dry-run"], ["inspect", path]]
    for arguments in commands:
        ways = (run, call) if name == "\ud800" else (call,)
        for way in ways:
            process = way(*arguments, "--json", env={"PYTHONIOENCODING": "utf-8"})
            assert process.returncode == 0, process.stderr
            assert name_in(process.stdout) == name


def name_in(stdout: bytes) -> str:
    found = json.loads(stdout)
    holder = found["files"][0] if "files" in found else found
    name: str = holder["primitives"][0]["mesh_name"]
    return name
