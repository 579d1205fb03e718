"""skinbake cost: the paper's figures, a file's own bytes counted by hand, and the exit codes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from skinbake.choices import Encoding, Layout
from skinbake.errors import Place
from skinbake.format.layouts import GradientFormat
from skinbake.report.cost import FileCosts, FrameCost, PrimitiveCosts, VertexCost, as_text
from tests.support.command_line import call, document, invoke, run
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, SHARED, Part, bake, edited, rewritten, sheet, write_model
from tests.support.schemas import COUNT, PLACE, TEXT, WARNINGS, strict

DOI = "doi:10.1111/cgf.12330"
NAMES = ["LBS standard", "LBS direct", "LBS accurate", "DQS standard", "DQS accurate", "DQS exact"]

# Right margin of the supplemental material's pseudo-code, n being its N_max; 6 is 36 N + 118 by dqs.exact.
PAPER: dict[str, Callable[[int], list[int]]] = {
    "1": lambda n: [12 * n, 12, 9, 9, 9],
    "2": lambda n: [12 * n, 9 * n, 9 * n, 31, 12, 9, 9, 9],
    "3": lambda n: [9 * n, 9 * n, 3 * n - 3, 9 + 3 * n - 3, 9 + 3 * n - 3, 6, 3 * n - 3],
    "4": lambda n: [12 * n, 13, 27, 18, 18, 18],
    "5": lambda n: [12 * n, 13, 27, 24 * n, 3 * n - 3, 18 + 3 * n - 3, 18 + 3 * n - 3, 6],
}
EXACT = {1: 154, 2: 190, 3: 226, 4: 262, 5: 298, 6: 334, 7: 370, 8: 406}


def paper(influences: int) -> dict[str, int]:
    totals = {number: sum(lines(influences)) for number, lines in PAPER.items()}
    return {**totals, "6": EXACT[influences]}


def by_number(plain: int, direct: int, accurate: int) -> dict[str, int]:
    """Bytes by algorithm: standard lighting, algorithm 2, and the three that read α and β."""
    return {"1": plain, "2": direct, "3": accurate, "4": plain, "5": accurate, "6": accurate}


def cost(*arguments: str | Path) -> Any:
    result = invoke("cost", *arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return document(result)


FIGURES = dict.fromkeys("123456", COUNT)
LINES = {"type": "object", "patternProperties": {"^[1-9]$": COUNT}, "additionalProperties": False}
SUMS = {"multiply_adds": strict(FIGURES), "bytes": strict(FIGURES), "added_bytes": strict(FIGURES)}
COSTS = {
    **SUMS,
    "normal_map": strict(dict.fromkeys("356", COUNT)),
    "scaled_joints": strict(dict.fromkeys("456", COUNT)),
    "scaled_joints_normal_map": strict(dict.fromkeys("56", COUNT)),
    "lines": strict(dict.fromkeys("123456", LINES)),
}
SCHEMA = {"const": "skinbake.cost/1"}
SINGLE = strict({"schema": SCHEMA, "influences": COUNT, **COSTS})
TABLE = strict(
    {"schema": SCHEMA, "table": {"type": "array", "items": strict({"influences": COUNT, **COSTS})}}
)
PRIMITIVE = strict(
    {
        "mesh": COUNT,
        "primitive": COUNT,
        "vertices": COUNT,
        "draws": {"type": "integer", "minimum": 1},
        "influences": {"type": "integer", "multipleOf": 4},
        "baked": {"type": "boolean"},
        "stored": {"type": "object", "additionalProperties": {"type": "integer", "multipleOf": 4}},
        **COSTS,
        "per_frame": strict(SUMS),
    },
    optional=PLACE,
)
FILE = strict(
    {
        "schema": SCHEMA,
        "input": TEXT,
        "primitives": {"type": "array", "items": PRIMITIVE},
        "total": strict({"vertices": COUNT, **SUMS}),
        "warnings": WARNINGS,
    }
)


def test_json_has_the_documented_shape(tmp_path: Path) -> None:
    bake(FOLDER / "two_sets.glb", tmp_path / "baked.glb")
    jsonschema.validate(cost(), TABLE)
    jsonschema.validate(cost("--influences", "3"), SINGLE)
    for path in (FOLDER / SHARED, FOLDER / "weights_u16.glb", tmp_path / "baked.glb"):
        jsonschema.validate(cost(path), FILE)


class TestNumberOfInfluences:
    def test_four_cost_what_the_paper_s_table_says(self) -> None:
        found = cost("--influences", "4")
        assert found["multiply_adds"] == {"1": 87, "2": 190, "3": 132, "4": 142, "5": 253, "6": 262}
        # 12 + 12 + 16 of position, normal, tangent and 4 × (1 + 4) of influences are 60; ∇w is 4 × 3 floats,
        # α and β are 3 floats each.
        assert found["bytes"] == by_number(60, 60 + 48, 60 + 24)
        assert found["added_bytes"] == by_number(0, 48, 24)
        # T n0 by a matrix of 9 or a rotation of 18, and two cross products of 6.
        assert found["normal_map"] == {"3": 21, "5": 30, "6": 30}
        # Of 60 N + 83 by hand for algorithm 6, N = 4.
        assert found["scaled_joints"] == {"4": 201, "5": 306, "6": 323}
        # T n0 by a matrix of four rows, 12; its quotient by the mix, of which only the vector is needed: two
        # vectors scaled, 6, and a cross product of 6; and the two cross products as above.
        assert found["scaled_joints_normal_map"] == {"5": 36, "6": 36}

    @pytest.mark.parametrize("influences", range(1, 9))
    def test_every_line_costs_what_the_paper_says(self, influences: int) -> None:
        found = cost("--influences", str(influences))
        for number, lines in PAPER.items():
            expected = {str(line): count for line, count in enumerate(lines(influences), start=1)}
            assert found["lines"][number] == expected
        assert found["multiply_adds"] == paper(influences)
        assert sum(found["lines"]["6"].values()) == EXACT[influences]

    def test_the_table_goes_from_one_to_eight(self) -> None:
        found = cost()["table"]
        assert [row["influences"] for row in found] == [1, 2, 3, 4, 5, 6, 7, 8]
        for n, row in enumerate(found, start=1):
            assert row["multiply_adds"] == paper(n)
            assert row["bytes"] == by_number(40 + 5 * n, 40 + 5 * n + 12 * n, 40 + 5 * n + 8 * (n - 1))

    def test_sixty_four_is_the_most(self) -> None:
        assert cost("--influences", "64")["multiply_adds"]["1"] == 12 * 64 + 39


class TestFile:
    def test_two_influence_sets(self) -> None:
        found = cost(FOLDER / "two_sets.glb")
        (primitive,) = found["primitives"]
        assert (primitive["vertices"], primitive["draws"], primitive["influences"]) == (256, 1, 8)
        assert primitive["multiply_adds"] == paper(8)
        # Float position and normal, no tangent, twice 4 joints of 1 byte and 4 weights of 4: 64. ∇w is 8 × 3
        # floats, α and β are 7 floats each.
        assert primitive["bytes"] == by_number(64, 64 + 96, 64 + 56)
        assert primitive["added_bytes"] == by_number(0, 96, 56)
        frame = primitive["per_frame"]
        assert frame["multiply_adds"] == {number: 256 * count for number, count in paper(8).items()}
        assert frame["bytes"] == by_number(16_384, 40_960, 30_720)
        assert frame["added_bytes"] == by_number(0, 24_576, 14_336)
        assert found["total"] == {"vertices": 256, **frame}
        assert found["warnings"] == []

    def test_integer_weights_and_joints(self) -> None:
        """Float position and normal, 4 joints of 2 bytes, 4 weights of 1: 36; 4 × 1 and 4 × 2 too."""
        for name in ("weights_u8.glb", "weights_u16.glb"):
            found = cost(FOLDER / name)
            (primitive,) = found["primitives"]
            assert primitive["multiply_adds"] == paper(4)
            assert primitive["bytes"] == by_number(36, 36 + 48, 36 + 24)
            assert found["total"]["vertices"] == 187
            assert found["total"]["bytes"] == by_number(6_732, 15_708, 11_220)
        assert primitive["stored"] == {"POSITION": 12, "NORMAL": 12, "JOINTS_0": 4, "WEIGHTS_0": 8}

    def test_a_tangent_counts_where_it_is_stored(self) -> None:
        (primitive,) = cost(FOLDER / "mirrored_tangent.glb")["primitives"]
        assert primitive["bytes"] == by_number(12 + 12 + 16 + 4 + 16, 60 + 48, 60 + 24)

    def test_a_missing_normal_counts_as_bake_would_add_it(self, tmp_path: Path) -> None:
        """A TANGENT without a NORMAL is ignored, by glTF and by bake."""
        part = sheet(NORMAL=None, TANGENT=np.tile(np.array([1, 0, 0, 1], np.float32), (20, 1)))
        result = invoke("cost", write_model(tmp_path / "bare.glb", [part]), "--json")
        found = document(result)
        assert found["primitives"][0]["bytes"] == by_number(44, 44 + 48, 44 + 24)
        assert [entry["code"] for entry in found["warnings"]] == ["no-normals"]
        assert "bake --generate-normals" in result.stderr

    def test_attributes_take_multiples_of_four_bytes(self, tmp_path: Path) -> None:
        """A VEC3 of bytes takes 4, one of shorts 8: glTF wants every element aligned."""
        path = edited("seam.glb", tmp_path, shrunk)
        (primitive,) = cost(path)["primitives"]
        assert primitive["stored"] == {"POSITION": 8, "NORMAL": 4, "JOINTS_0": 4, "WEIGHTS_0": 16}
        assert primitive["bytes"] == by_number(32, 32 + 48, 32 + 24)

    def test_influence_sets_may_be_of_different_types(self, tmp_path: Path) -> None:
        part = sheet(JOINTS_1=np.zeros((20, 4), np.uint16), WEIGHTS_1=np.zeros((20, 4), np.float32))
        path = write_model(tmp_path / "mixed.glb", [part])
        (primitive,) = cost(path)["primitives"]
        assert primitive["bytes"]["1"] == 12 + 12 + (4 + 16) + (8 + 16)

    def test_the_whole_file_is_the_sum_of_its_primitives(self) -> None:
        found = cost(FOLDER / "two_primitives.glb")
        assert [primitive["vertices"] for primitive in found["primitives"]] == [121, 77]
        assert found["total"]["vertices"] == 198
        assert found["total"]["multiply_adds"] == {number: 198 * count for number, count in paper(4).items()}
        assert found["total"]["bytes"] == by_number(198 * 44, 198 * 92, 198 * 68)
        assert found["total"]["added_bytes"] == by_number(0, 198 * 48, 198 * 24)

    def test_vertices_count_where_triangles_use_them_and_as_often_as_nodes_draw_them(self) -> None:
        """Two halves of 7 × 9 vertices in accessors of 13 × 9, drawn by two nodes."""
        found = cost(FOLDER / SHARED)
        assert [(entry["vertices"], entry["draws"]) for entry in found["primitives"]] == [(63, 2), (63, 2)]
        assert found["primitives"][0]["per_frame"]["bytes"]["1"] == 63 * 2 * 44
        assert found["total"]["vertices"] == 252
        assert found["total"]["multiply_adds"]["3"] == 252 * 132

    def test_a_node_without_a_skin_does_not_skin(self, tmp_path: Path) -> None:
        def change(content: Any) -> None:
            content["meshes"].insert(0, content["meshes"][0])
            (node,) = [node for node in content["nodes"] if "mesh" in node]
            node["mesh"] = 1
            content["nodes"] += [{"mesh": 1}, {"mesh": 0}, {"skin": 0}]

        found = cost(edited("seam.glb", tmp_path, change))
        assert [(entry["mesh"], entry["draws"]) for entry in found["primitives"]] == [(1, 1)]
        assert [(entry["code"], entry["mesh"]) for entry in found["warnings"]] == [("no-skin", 0)]

    def test_indices_may_be_written_as_floats(self, tmp_path: Path) -> None:
        """Some exporters write 3.0."""

        def change(content: Any) -> None:
            attributes = content["meshes"][0]["primitives"][0]["attributes"]
            attributes.update({name: float(number) for name, number in attributes.items()})
            for node in content["nodes"]:
                node.update({key: float(node[key]) for key in ("mesh", "skin") if key in node})

        assert cost(edited("seam.glb", tmp_path, change))["total"] == cost(FOLDER / "seam.glb")["total"]

    def test_stdin(self) -> None:
        data = (FOLDER / "weights_u8.glb").read_bytes()
        process = run("cost", "-", stdin=data)
        assert (process.returncode, process.stderr) == (0, b"")
        assert b"187 vertices" in process.stdout


def shrunk(content: Any) -> None:
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    content["accessors"][attributes["POSITION"]].update(componentType=5122)
    content["accessors"][attributes["NORMAL"]].update(componentType=5120, normalized=True)


class TestBakedFile:
    def test_alpha_and_beta_cost_what_bake_was_expected_to_store(self, tmp_path: Path) -> None:
        bake(FOLDER / "two_sets.glb", tmp_path / "baked.glb")
        (before,) = cost(FOLDER / "two_sets.glb")["primitives"]
        (after,) = cost(tmp_path / "baked.glb")["primitives"]
        assert (before.pop("baked"), after.pop("baked")) == (False, True)
        assert after.pop("stored") == before.pop("stored") | {
            "_SKINBAKE_ALPHA_0": 12,
            "_SKINBAKE_ALPHA_1": 16,
            "_SKINBAKE_BETA_0": 12,
            "_SKINBAKE_BETA_1": 16,
        }
        assert after == before

    def test_alpha_and_beta_count_in_the_type_that_is_stored(self, tmp_path: Path) -> None:
        """As shorts: VEC3 takes 8 bytes, VEC4 8; ∇w would take 8 × 3 × 2."""
        path = self.changed(tmp_path, lambda accessor: accessor.update(componentType=5122))
        (primitive,) = cost(path)["primitives"]
        assert primitive["baked"] is True
        assert primitive["added_bytes"] == by_number(0, 48, 4 * 8)

    @pytest.mark.parametrize(("encoding", "size"), [(Encoding.PACKED8, 1), (Encoding.SNORM16, 2)])
    def test_an_encoding_has_a_scale_for_alpha_and_one_for_beta(
        self, encoding: Encoding, size: int, tmp_path: Path
    ) -> None:
        """Algorithm 2's ∇w would have three numbers and a scale for each of eight joints."""
        bake(FOLDER / "two_sets.glb", tmp_path / "baked.glb", storage=GradientFormat(encoding))
        (primitive,) = cost(tmp_path / "baked.glb")["primitives"]
        assert primitive["added_bytes"] == by_number(0, 8 * 4 * size, 2 * 8 * size)

    def test_texture_coordinates_count_once_although_one_holds_both(self, tmp_path: Path) -> None:
        bake(FOLDER / "two_sets.glb", tmp_path / "baked.glb", storage=GradientFormat(layout=Layout.TEXCOORD))
        (primitive,) = cost(tmp_path / "baked.glb")["primitives"]
        assert primitive["baked"] is True
        stored = {name: size for name, size in primitive["stored"].items() if name.startswith("TEXCOORD")}
        assert stored == {f"TEXCOORD_{number}": 8 for number in range(7)}
        assert primitive["added_bytes"] == by_number(0, 96, 56)

    @pytest.mark.parametrize("name", ["_SKINBAKE_BETA_1", "_SKINBAKE_ALPHA_0"])
    def test_half_a_bake_is_none(self, name: str, tmp_path: Path) -> None:
        def drop(content: Any) -> None:
            del content["meshes"][0]["primitives"][0]["attributes"][name]

        (primitive,) = cost(self.changed(tmp_path, lambda _: None, drop))["primitives"]
        assert primitive["baked"] is False
        assert "_SKINBAKE_BETA_0" not in primitive["stored"]
        assert primitive["added_bytes"] == by_number(0, 96, 56)

    @pytest.mark.parametrize("names", [None, 7, [7, 8], ["POSITION"], {}])
    def test_metadata_that_names_nothing_is_no_bake(self, names: object, tmp_path: Path) -> None:
        def spoil(content: Any) -> None:
            content["meshes"][0]["primitives"][0]["extras"]["skinbake"].update(alpha=names, beta=names)

        (primitive,) = cost(self.changed(tmp_path, lambda _: None, spoil))["primitives"]
        assert primitive["baked"] is False
        assert primitive["added_bytes"] == by_number(0, 96, 56)

    @staticmethod
    def changed(
        folder: Path, accessor: Callable[[Any], object], content: Callable[[Any], object] = lambda _: None
    ) -> Path:
        """Bake a file, then change the accessors of α and β, and the rest."""
        bake(FOLDER / "two_sets.glb", folder / "two_sets.glb")

        model = read(folder / "two_sets.glb")
        for name, number in model.content["meshes"][0]["primitives"][0]["attributes"].items():
            if name.startswith("_SKINBAKE"):
                accessor(model.content["accessors"][number])
        content(model.content)
        return rewritten(model, model.path)


class TestText:
    def test_the_table_of_one_number_of_influences(self) -> None:
        text = invoke("cost", "--influences", "4").stdout
        rows = [line.split() for line in text.splitlines() if re.match(r"  [1-6]  ", line)]
        assert [" ".join(row[1:3]) for row in rows] == NAMES
        assert [int(row[3]) for row in rows] == [87, 190, 132, 142, 253, 262]
        assert [int(row[4]) for row in rows] == [60, 108, 84, 60, 84, 84]
        assert [int(row[5]) for row in rows] == [0, 48, 24, 0, 24, 24]
        assert "36+36+9+18+18+6+9" in text
        assert DOI in text

    def test_table(self) -> None:
        text = invoke("cost").stdout
        rows = [line for line in text.splitlines() if re.match(r"  [1-6]  ", line)]
        assert len({len(row) for row in rows}) == 1  # aligned
        counts = [[int(value) for value in row.split()[3:]] for row in rows]
        assert counts[:6] == [[paper(n)[number] for n in range(1, 9)] for number in "123456"]
        assert counts[8] == [45, 58, 71, 84, 97, 110, 123, 136]
        assert DOI in text

    def test_file(self) -> None:
        text = invoke("cost", FOLDER / SHARED).stdout
        assert text.startswith(f"{FOLDER / SHARED}: 2 skinned primitives, 252 vertices a frame\n")
        assert 'mesh 0 "shared", primitive 1: 63 vertices × 2 nodes, 4 influences' in text
        rows = [line for line in text.splitlines() if re.match(r"    [1-6]  ", line)]
        assert rows[8].split()[3:] == ["132", "68", "24", "16,632", "8,568", "3,024"]
        assert rows[14].split()[3:] == ["33,264", "17,136", "6,048"]
        lines = text.splitlines()
        assert rows[12] == lines[lines.index("  the whole file, per frame") + 2]
        heads = [line for line in lines if line.endswith("added")]
        for head, part in zip(heads, (rows[:6], rows[6:12], rows[12:]), strict=True):
            assert {len(row) for row in part} == {len(head)}  # aligned
        assert DOI in text

    def test_the_bytes_of_a_bake_are_stored_or_those_that_bake_would_store(self, tmp_path: Path) -> None:
        source, written = FOLDER / "seam.glb", tmp_path / "baked.glb"
        assert invoke("bake", source, "-o", written).exit_code == 0
        stored = "\n    bytes stored per vertex: POSITION 12, NORMAL 12, JOINTS_0 4, WEIGHTS_0 16"
        assert f"{stored}; α, β as bake would\n" in invoke("cost", source).stdout
        assert f"{stored}, _SKINBAKE_ALPHA_0 12, _SKINBAKE_BETA_0 12\n" in invoke("cost", written).stdout

    def test_a_file_of_one_primitive_has_no_line_for_the_whole_file(self) -> None:
        assert "the whole file" not in invoke("cost", FOLDER / "seam.glb").stdout

    @pytest.mark.parametrize(
        "arguments", [[], ["--influences", "4"], ["--influences", "64"], [str(FOLDER / SHARED)]]
    )
    def test_lines_fit_a_usual_terminal(self, arguments: list[str]) -> None:
        """Only a list of attributes may be longer: a table whose lines are broken cannot be read."""
        lines = invoke("cost", *arguments).stdout.replace(str(FOLDER), "fixtures").splitlines()
        assert max(len(line) for line in lines if "bytes stored per vertex" not in line) <= 80

    def test_the_table_of_a_large_file_fits_too(self) -> None:
        """A frame of three million vertices, at eight influences."""
        vertex, frame = VertexCost(433, 136, 56, {}), FrameCost(999_999_999, 408_000_000, 168_000_000)
        costs, frames = dict.fromkeys(range(1, 7), vertex), dict.fromkeys(range(1, 7), frame)
        part = PrimitiveCosts(Place("a.glb", 0, None, 0), 3_000_000, 1, 8, False, {}, costs, frames)
        lines = as_text(FileCosts("a.glb", (part,), 3_000_000, frames, ())).splitlines()
        assert max(map(len, lines)) <= 80
        assert len({len(line) for line in lines if re.match(r"    [1-6]  ", line)}) == 1

    def test_quiet_leaves_json_alone(self) -> None:
        assert invoke("cost", "-q").output == ""
        assert cost("-q")["table"]


class TestNothingToCount:
    def test_a_primitive_without_a_surface_costs_nothing_and_is_named(self, tmp_path: Path) -> None:
        points = Part(sheet().attributes, np.arange(20), mode=0)
        result = invoke("cost", write_model(tmp_path / "points.glb", [sheet(), points]), "--json")
        found = document(result)
        assert [entry["primitive"] for entry in found["primitives"]] == [0]
        assert [(entry["code"], entry["primitive"]) for entry in found["warnings"]] == [("no-surface", 1)]
        assert found["total"]["vertices"] == 20
        assert "it draws points" in result.stderr

    def test_a_file_without_skins(self, tmp_path: Path) -> None:
        path = edited("seam.glb", tmp_path, unskinned)
        found = cost(path)
        jsonschema.validate(found, FILE)
        assert found["primitives"] == []
        assert found["total"]["bytes"] == by_number(0, 0, 0)
        result = invoke("cost", path)
        assert result.exit_code == 0
        assert result.stdout == f"{path}: 0 skinned primitives, 0 vertices a frame\n"


def unskinned(content: Any) -> None:
    for node in content["nodes"]:
        node.pop("skin", None)


class TestErrors:
    @pytest.mark.parametrize(
        "arguments",
        [
            ["--influences", "0"],
            ["--influences", "65"],
            ["--influences", "four"],
            ["--influences", "4.0"],
            ["--influences"],
            ["--influences", "4", str(FOLDER / "seam.glb")],
            ["model.fbx"],
            [str(FOLDER / "seam.glb"), str(FOLDER / "two_sets.glb")],
            ["--frame", "normal"],
        ],
    )
    def test_wrong_usage_is_2(self, arguments: list[str]) -> None:
        result = invoke("cost", *arguments)
        assert (result.exit_code, result.stdout) == (2, "")
        assert "Error: " in result.stderr

    @pytest.mark.parametrize("flags", [[], ["--json"]])
    @pytest.mark.parametrize("name", ["missing.glb", "empty.glb", "short.glb", "text.gltf"])
    def test_a_file_that_cannot_be_read_is_3(self, name: str, flags: list[str], tmp_path: Path) -> None:
        (tmp_path / "empty.glb").touch()
        (tmp_path / "short.glb").write_bytes((FOLDER / "seam.glb").read_bytes()[:5_000])
        (tmp_path / "text.gltf").write_text("hello", encoding="utf-8")
        process = (run if name == "short.glb" else call)("cost", tmp_path / name, *flags)
        assert (process.returncode, process.stdout) == (3, b"")
        assert process.stderr.startswith(f"error: {tmp_path / name}: ".encode())
        assert b"Traceback" not in process.stderr
        assert b"should not" not in process.stderr

    @pytest.mark.parametrize(
        ("primitive", "message"),
        [
            ({"attributes": {"NORMAL": 9_999}}, 'primitive 0: "NORMAL" refers to entry 9999'),
            ({"attributes": {"WEIGHTS_0": None}}, "WEIGHTS_0"),
            ({"attributes": {"JOINTS_1": 0}}, "primitive 0"),
            ({"extensions": {"KHR_draco_mesh_compression": {}}}, "KHR_draco_mesh_compression"),
        ],
    )
    def test_data_that_is_wrong_is_3_and_says_where(
        self, primitive: dict[str, dict[str, Any]], message: str, tmp_path: Path
    ) -> None:
        def spoil(content: Any) -> None:
            found = content["meshes"][0]["primitives"][0]
            for key, members in primitive.items():
                found[key] = {**found.get(key, {}), **members}

        process = call("cost", edited("seam.glb", tmp_path, spoil))
        assert (process.returncode, process.stdout) == (3, b"")
        assert message.encode() in process.stderr
        assert b"Traceback" not in process.stderr
        assert b"should not" not in process.stderr


LOADED = """
import sys
from skinbake.cli.main import main
main(["cost", "--help"], standalone_mode=False)
heavy = {"numpy", "skinbake.skinning", "skinbake.commands", "skinbake.report"}
print(sorted(heavy & set(sys.modules)), file=sys.stderr)
"""


def test_help_imports_nothing_heavy() -> None:
    process = run(command=("-c", LOADED))
    assert process.stdout.startswith(b"Usage: ")
    assert process.stderr.split() == [b"[]"]
