"""The tests' own instruments: each must be able to say no."""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from tests.support import corpus, corpus_folder, gltf_transform, khronos, node
from tests.support.gltf_reading import DRACO, MESHOPT, read
from tests.support.khronos import Finding, Report
from tests.support.tools import required_program

TUBE = FOLDER / "bent_tube.glb"
SKIP_BY_ITSELF = re.compile(r"^\s*(?:\w+ = )?pytest\.(?:importorskip\(|skip\(.*installed)", re.MULTILINE)
IMPORT_OF_A_TEST = re.compile(r"^\s*(?:from|import) tests\b.*\btest_\w+", re.MULTILINE)
PRIVATE_PATCH = re.compile(r'^\s*\w+\.setattr\(\s*(?:[\w.]+,\s*)?"(?:[\w.]+\.)?_[A-Za-z]', re.MULTILINE)
UNCLEAR_NAME = re.compile(r"^\s*def test_(?:so|nor|its?|they|th[eo]se|both|others?)_", re.MULTILINE)


def report(*, errors: list[str] | None = None, warnings: list[str] | None = None, at: str = "/") -> Report:
    return Report(
        errors=[Finding(code, f"{at}{n}") for n, code in enumerate(errors or [])],
        warnings=[Finding(code, f"{at}{n}") for n, code in enumerate(warnings or [])],
        infos=[Finding("UNUSED_OBJECT", "/")] if at != "/" else [],
        hints=[],
    )


def write_gltf(path: Path, raw: bytes, content: dict[str, Any]) -> Path:
    uri = "data:application/octet-stream;base64," + base64.b64encode(raw).decode()
    document = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(raw), "uri": uri}]}
    path.write_text(json.dumps(document | content), encoding="utf-8")
    return path


def failure_of(require: Callable[[], str]) -> str:
    """Return the message of pytest.fail; a skip raised here would pass for a skipped test."""
    with pytest.raises((pytest.fail.Exception, pytest.skip.Exception)) as caught:
        require()
    assert caught.type is pytest.fail.Exception
    return str(caught.value)


def modules_that_have(pattern: re.Pattern[str], names: str, least: int) -> list[str]:
    """Return the names of the modules of tests/ whose text a pattern finds, of at least so many."""
    modules = sorted(Path(corpus_folder.REPOSITORY, "tests").rglob(names))
    assert len(modules) >= least
    return [module.name for module in modules if pattern.search(module.read_text(encoding="utf-8"))]


def test_no_test_module_imports_another() -> None:
    """Common code lies in tests/support, so that any module can be run, moved or removed alone."""
    assert modules_that_have(IMPORT_OF_A_TEST, "test_*.py", least=90) == []
    assert IMPORT_OF_A_TEST.search("from tests.cli.test_json import BAKE")
    assert IMPORT_OF_A_TEST.search("    from tests.cli import running, test_json")
    assert not IMPORT_OF_A_TEST.search("from tests.support.models import FOLDER")


def test_no_test_patches_a_private_name() -> None:
    """A change inside a module then breaks no test of what it does."""
    assert modules_that_have(PRIVATE_PATCH, "*.py", least=150) == []
    assert PRIVATE_PATCH.search('    monkeypatch.setattr(state, "_code", lambda: "")')
    assert PRIVATE_PATCH.search('patch.setattr(\n    "skinbake.cli.progress._bar", None\n)')
    assert not PRIVATE_PATCH.search('monkeypatch.setattr(state, "__version__", "0.1.1")')


def test_no_name_of_a_test_leans_on_the_test_before_it() -> None:
    assert modules_that_have(UNCLEAR_NAME, "test_*.py", least=90) == []
    assert UNCLEAR_NAME.search("    def test_nor_is_a_picture(self) -> None:")
    assert not UNCLEAR_NAME.search("def test_italics_are_kept() -> None:")


class TestKhronos:
    def test_reads_external_resources_and_reports_what_is_wrong(self, tmp_path: Path) -> None:
        source = FOLDER / "shared_accessors.gltf"
        moved = tmp_path / source.name
        moved.write_bytes(source.read_bytes())
        reports = khronos.validate_many([source, moved, TUBE])
        assert list(reports) == [source, moved, TUBE]
        assert reports[source]["errors"] == []
        # Beside the copy there is no .bin.
        assert Finding("IO_ERROR", "/buffers/0/uri") in reports[moved]["errors"]
        assert khronos.new_findings(reports[source], reports[moved]) == {("error", "IO_ERROR"): 1}
        assert khronos.validate(TUBE)["infos"] != []

    def test_calls_a_file_that_is_no_gltf_an_error(self, tmp_path: Path) -> None:
        path = tmp_path / "empty.glb"
        path.write_bytes(b"")
        assert khronos.validate(path)["errors"] == [Finding("NOT_GLTF", "")]

    def test_refuses_a_path_to_nowhere(self, tmp_path: Path) -> None:
        with pytest.raises(FileNotFoundError):
            khronos.validate(tmp_path / "nowhere.glb")

    @pytest.mark.slow
    def test_a_validator_that_ended_is_said_and_started_anew(self) -> None:
        khronos.validate(TUBE)
        khronos.VALIDATOR._started().kill()
        with pytest.raises(RuntimeError, match="answered for 0 of 1 files"):
            khronos.validate(TUBE)
        assert khronos.validate(TUBE)["errors"] == []

    def test_new_findings_ignore_moved_pointers_and_infos(self) -> None:
        before = report(errors=["A", "A"], warnings=["B"])
        assert not khronos.new_findings(before, report(errors=["A"], warnings=["B"], at="/moved/"))

    def test_new_findings_count_rises_and_severities(self) -> None:
        before = report(errors=["A"], warnings=["B"])
        after = report(errors=["A", "A", "B"], warnings=["B"])
        assert khronos.new_findings(before, after) == {("error", "A"): 1, ("error", "B"): 1}


class TestGltfTransform:
    @pytest.mark.slow
    def test_rewrites_a_model(self, tmp_path: Path) -> None:
        target = tmp_path / "quantised.glb"
        process = gltf_transform.run(["quantize", TUBE, target])
        assert process.returncode == 0, process.stderr
        assert read(target).stored_attribute("POSITION").dtype == np.int16

    @pytest.mark.slow
    def test_reports_failure_by_its_exit_code(self, tmp_path: Path) -> None:
        process = gltf_transform.run(["quantize", tmp_path / "nowhere.glb", tmp_path / "out.glb"])
        assert process.returncode != 0


def test_no_test_skips_for_a_missing_tool_by_itself() -> None:
    """``missing_tool`` does it, and fails a strict run."""
    assert modules_that_have(SKIP_BY_ITSELF, "*.py", least=150) == []
    assert SKIP_BY_ITSELF.search('        pytest.skip("groff is not installed")')
    assert SKIP_BY_ITSELF.search('pty = pytest.importorskip("pty")')


class TestMissingTools:
    @pytest.fixture(autouse=True)
    def no_packages(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        monkeypatch.setattr(node, "SUPPORT", tmp_path)

    def test_are_skipped_with_the_command_that_installs_them(self, monkeypatch: pytest.MonkeyPatch) -> None:
        required_program("node")
        monkeypatch.delenv("SKINBAKE_STRICT", raising=False)
        with pytest.raises(pytest.skip.Exception, match="npm ci --prefix tests/support"):
            khronos.require_node()

    def test_fail_a_strict_run(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SKINBAKE_STRICT", "1")
        assert "SKINBAKE_STRICT" in failure_of(gltf_transform.require_node)

    def test_node_itself_counts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SKINBAKE_STRICT", "1")
        monkeypatch.setenv("PATH", "")
        assert "node is not installed" in failure_of(khronos.require_node)


class TestCorpus:
    @corpus.needed
    def test_has_all_its_models(self) -> None:
        models = corpus.valid_models()
        assert len(models) == len(set(models)) == 52 + 13
        assert [path for path in models if not path.is_file()] == []
        assert {path.suffix for path in models} == {".gltf", ".glb", ".vrm"}
        invalid = corpus.invalid_models()
        assert len(invalid) == len({path for path, _ in invalid}) == 339
        assert [path for path, _ in invalid if not path.is_file()] == []
        assert all(
            verdict in ("ERROR", "WARN", "see note") or verdict[:5] == "valid" for _, verdict in invalid
        )

    @corpus.needed
    def test_finds_models_by_name(self) -> None:
        assert corpus.model("CesiumMan/CesiumMan.glb") in corpus.valid_models()
        assert corpus.model("decoded/bath_day.glb") in corpus.valid_models()
        with pytest.raises(FileNotFoundError):
            corpus.model("CesiumMan/nobody.glb")

    def test_is_found_where_the_environment_says(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        (tmp_path / "public").mkdir()
        (tmp_path / "public" / "ATTRIBUTION.tsv").write_text("file\n", encoding="utf-8")
        monkeypatch.setenv("SKINBAKE_CORPUS", str(tmp_path))
        assert corpus.require_corpus() == tmp_path

    @pytest.mark.parametrize("strict", ["0", "1"])
    def test_without_it_fixtures_stand_in_and_all_else_is_skipped(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, strict: str
    ) -> None:
        monkeypatch.setenv("SKINBAKE_CORPUS", str(tmp_path))
        monkeypatch.setenv("SKINBAKE_STRICT", strict)
        here = corpus.valid_models()
        assert corpus.model("Fox/fox.glb") in here
        assert corpus.character("CesiumMan/CesiumMan.glb") in here
        assert [case.marks for case in corpus.parameters(corpus.valid_models)] == [()] * len(here)
        for missing in (corpus.invalid_models, partial(corpus.model, "CesiumMan/CesiumMan.glb")):
            with pytest.raises(pytest.skip.Exception, match="set SKINBAKE_CORPUS"):
                missing()
        (case,) = corpus.parameters(corpus.invalid_models)
        assert [mark.name for mark in case.marks] == ["skip"]


class TestCharacters:
    """What fixtures/characters promises: licences that allow it, and few bytes."""

    def test_each_character_has_its_source_author_and_licence(self) -> None:
        page = (corpus.CHARACTERS / "README.md").read_text(encoding="utf-8")
        rows = re.findall(r"^\| `(.*?)` \| (.*?) \| (.*?) \| (.*?) \|", page, re.MULTILINE)
        names = {name for cell, *_ in rows for name in cell.split("`, `")}
        assert names | {"README.md"} == {path.name for path in corpus.CHARACTERS.iterdir()}
        for _, author, licence, changes in rows:
            assert author
            assert changes
            assert licence
            assert re.sub(r"CC0 1\.0|CC BY 4\.0|\([a-z, ]*\)|[, ]", "", licence) == ""

    def test_the_characters_together_stay_under_a_megabyte(self) -> None:
        assert sum(path.stat().st_size for path in corpus.CHARACTERS.iterdir()) < 1_000_000

    def test_every_stand_in_is_there(self) -> None:
        assert all((corpus.CHARACTERS / name).is_file() for name in corpus.STAND_INS.values())


class TestGltfReading:
    def test_decodes_strided_normalised_and_sparse_accessors(self, tmp_path: Path) -> None:
        rows = b"".join(struct.pack("<Hhh2x", n, -32768 + n, 32767) for n in range(3))
        sparse = struct.pack("<H2xhh", 1, 7, -7)
        path = write_gltf(
            tmp_path / "strided.gltf",
            rows + sparse,
            {
                "bufferViews": [
                    {"buffer": 0, "byteLength": 24, "byteStride": 8},
                    {"buffer": 0, "byteOffset": 24, "byteLength": 8},
                ],
                "accessors": [
                    {"bufferView": 0, "componentType": 5123, "count": 3, "type": "SCALAR"},
                    {
                        "bufferView": 0,
                        "byteOffset": 2,
                        "componentType": 5122,
                        "normalized": True,
                        "count": 3,
                        "type": "VEC2",
                    },
                    {
                        "componentType": 5122,
                        "count": 3,
                        "type": "VEC2",
                        "sparse": {
                            "count": 1,
                            "indices": {"bufferView": 1, "componentType": 5123},
                            "values": {"bufferView": 1, "byteOffset": 4},
                        },
                    },
                ],
            },
        )
        model = read(path)
        assert model.stored(0).tolist() == [[0], [1], [2]]
        assert model.stored(1)[:, 0].tolist() == [-32768, -32767, -32766]
        assert model.values(1).tolist() == [[-1, 1], [-1, 1], [-32766 / 32767, 1]]
        assert model.stored(2).tolist() == [[0, 0], [7, -7], [0, 0]]

    def test_pads_the_columns_of_small_matrices(self, tmp_path: Path) -> None:
        content = {
            "bufferViews": [{"buffer": 0, "byteLength": 12}],
            "accessors": [{"bufferView": 0, "componentType": 5121, "count": 1, "type": "MAT3"}],
        }
        raw = bytes([1, 2, 3, 99, 4, 5, 6, 99, 7, 8, 9, 99])
        model = read(write_gltf(tmp_path / "matrix.gltf", raw, content))
        assert model.matrices(0)[0].tolist() == [[1, 4, 7], [2, 5, 8], [3, 6, 9]]

    @pytest.mark.parametrize(
        ("mode", "expected"),
        [
            (4, [[4, 3, 2]]),
            (5, [[4, 3, 2], [3, 1, 2], [2, 1, 0]]),
            (6, [[3, 2, 4], [2, 1, 4], [1, 0, 4]]),
        ],
    )
    def test_unrolls_strips_and_fans(self, tmp_path: Path, mode: int, expected: list[list[int]]) -> None:
        content = {
            "bufferViews": [{"buffer": 0, "byteLength": 5}],
            "accessors": [{"bufferView": 0, "componentType": 5121, "count": 5, "type": "SCALAR"}],
            "meshes": [{"primitives": [{"attributes": {}, "indices": 0, "mode": mode}]}],
        }
        model = read(write_gltf(tmp_path / "strip.gltf", bytes([4, 3, 2, 1, 0]), content))
        assert model.triangles().tolist() == expected

    @pytest.mark.parametrize("extension", MESHOPT)
    def test_refuses_compressed_data(self, tmp_path: Path, extension: str) -> None:
        content = {
            "bufferViews": [{"buffer": 0, "byteLength": 4, "extensions": {extension: {}}}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "extensions": {DRACO: {}}}]}],
        }
        model = read(write_gltf(tmp_path / "compressed.gltf", bytes(4), content))
        with pytest.raises(ValueError, match="meshopt"):
            model.buffer_view(0)
        with pytest.raises(ValueError, match="Draco"):
            model.attribute("POSITION")

    def test_refuses_a_view_that_leaves_its_buffer(self, tmp_path: Path) -> None:
        content = {"bufferViews": [{"buffer": 0, "byteOffset": 2, "byteLength": 4}]}
        model = read(write_gltf(tmp_path / "short.gltf", bytes(5), content))
        with pytest.raises(ValueError, match="leaves its buffer"):
            model.buffer_view(0)

    @pytest.mark.slow
    def test_agrees_with_the_bounds_that_real_files_declare(self) -> None:
        for path in corpus.valid_models():
            model = read(path)
            if {*MESHOPT, DRACO} & set(model.content.get("extensionsUsed", [])):
                continue
            for number, accessor in enumerate(model.content.get("accessors", [])):
                stored = model.stored(number)
                assert len(stored) == accessor["count"]
                if "min" in accessor:
                    # Exporters print bounds with as few as five decimals.
                    np.testing.assert_allclose(stored.min(axis=0), accessor["min"], atol=1e-5)
                    np.testing.assert_allclose(stored.max(axis=0), accessor["max"], atol=1e-5)

    @pytest.mark.parametrize(
        "twin", ["spider-triangle-strip.glb", "spider-sparse-attributes.glb", "spider-nonindexed.glb"]
    )
    def test_reads_twins_alike(self, twin: str) -> None:
        """The area vectors of the triangles, summed with a weight that depends on the place."""
        sums = []
        for path in (corpus.model("Spider/gltf_spider_animated.gltf"), corpus.model(twin)):
            model = read(path)
            corners = model.attribute("POSITION")[model.triangles()]
            areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            sums.append((areas * corners.mean(axis=1) ** 2).sum(axis=0))
        np.testing.assert_allclose(sums[0], sums[1], rtol=1e-6, atol=1e-9)
