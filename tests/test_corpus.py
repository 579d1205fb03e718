"""Files of other people: real models bake or say why not, broken ones do no harm."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from fixtures.builder import JsonObject
from fixtures.make_fixtures import FOLDER
from skinbake.commands.inspect import inspect_file
from skinbake.commands.strip import strip_file
from skinbake.commands.verify import verify_file
from skinbake.errors import InputError, SkinbakeError
from skinbake.gltf.writing.copies import NAME as NOTES
from skinbake.measure.options import VerifyOptions
from skinbake.report.bake import FileResult
from tests.support import corpus, khronos
from tests.support.baking import bake_file
from tests.support.corpus_folder import find_corpus
from tests.support.decoders import read_plain_many
from tests.support.gltf_reading import DRACO, MESHOPT, GltfFile, read
from tests.support.models import FIXTURES, KEY, assert_buffers_kept, note, primitives, without_additions

SECONDS = 10
"""No file here is larger than 4 MB: whatever takes longer hangs."""

# A change here is a change of what users get: of the models of the corpus, or of the characters of fixtures/.
BAKED, UNCHANGED, COMPRESSED = (38, 27, 5) if find_corpus() else (8, 1, 3)
REASONS = {"no-normals", "no-skin", "no-joints", "no-surface", "no-positions", "no-triangles"}
ALPHA = "_SKINBAKE_ALPHA_0"
BIG = "CesiumMan/CesiumMan.glb"


@dataclass(frozen=True)
class Run:
    """One model, what bake says of it, and where the result went."""

    source: Path
    target: Path
    result: FileResult

    def models(self) -> tuple[GltfFile, GltfFile]:
        return read(self.source), read(self.target)


@contextmanager
def time_limit() -> Iterator[None]:
    """Fail where the block takes longer than SECONDS; without SIGALRM, wait for it."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        pytest.fail(f"still busy after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def attempted(source: Path, target: Path, **options: Any) -> FileResult:
    """Bake a file, and return a failure that is said in words as a result too."""
    try:
        return bake_file(source, target, **options)
    except SkinbakeError as error:
        return FileResult(str(source), str(target), "failed", notices=error.notices, error=error)


def bake_all(folder: Path, **options: Any) -> list[Run]:
    runs = []
    for number, source in enumerate(corpus.valid_models()):
        target = folder / str(number) / source.name
        target.parent.mkdir()
        with time_limit():
            runs.append(Run(source, target, attempted(source, target, **options)))
    return runs


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """Every model baked once, each into an empty folder of its own."""
    return bake_all(tmp_path_factory.mktemp("baked"))


@pytest.fixture(scope="session")
def with_normals(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """The same with --generate-normals."""
    return bake_all(tmp_path_factory.mktemp("normals"), generate_normals=True)


def baked(runs: list[Run]) -> list[Run]:
    return [run for run in runs if run.result.status == "baked"]


def restore_stream(primitive: JsonObject) -> None:
    """Put back the Draco extension that bake noted; nothing where there is none."""
    extension = primitive.get("extensions", {}).get(DRACO, {})
    if KEY in extension.get("extras", {}):
        primitive["extensions"][DRACO] = extension["extras"][KEY]["before"]


def written(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


class TestRealModels:
    @pytest.mark.slow
    def test_every_one_bakes_or_passes_through(self, runs: list[Run]) -> None:
        found = Counter(run.result.status for run in runs)
        assert found == {"baked": BAKED, "unchanged": UNCHANGED}

    @pytest.mark.slow
    def test_what_is_skipped_has_its_reason(self, runs: list[Run]) -> None:
        for run in runs:
            codes = [notice.code for notice in run.result.notices]
            assert run.result.skipped == sum(code in REASONS - {"no-skin", "no-joints"} for code in codes)
            if run.result.status == "unchanged":
                assert "nothing-baked" in codes
                assert REASONS & set(codes)

    @pytest.mark.slow
    def test_what_came_compressed_leaves_compressed(self, runs: list[Run]) -> None:
        count = 0
        for run in runs:
            before, after = (set(model.content.get("extensionsUsed", [])) for model in run.models())
            assert after == before
            count += bool({DRACO, *MESHOPT} & before)
        assert count == COMPRESSED

    @pytest.mark.slow
    def test_verify_passes_every_one_that_was_compressed(self, runs: list[Run]) -> None:
        for run in baked(runs):
            if {DRACO, *MESHOPT} & set(read(run.source).content.get("extensionsUsed", [])):
                verdict = verify_file(str(run.target), VerifyOptions())
                assert verdict.passed, run.source

    @pytest.mark.slow
    def test_every_skinned_primitive_of_a_baked_model_has_its_attributes(self, runs: list[Run]) -> None:
        for run in baked(runs):
            _, after = run.models()
            count = 0
            for mesh, number, primitive in primitives(after.content):
                found = note(after.content, mesh, number)
                assert (found is not None) == (ALPHA in primitive["attributes"])
                count += found is not None
            assert count == len(run.result.primitives)

    @pytest.mark.slow
    def test_real_models_change_by_the_additions_only(self, runs: list[Run]) -> None:
        for run in baked(runs):
            before, after = run.models()
            for _, _, primitive in primitives(after.content):
                restore_stream(primitive)
            assert json.dumps(without_additions(before.content, after.content)) == json.dumps(before.content)
            assert_buffers_kept(before, after)

    def test_what_passes_through_keeps_its_bytes(self, runs: list[Run]) -> None:
        for run in runs:
            if run.result.status == "unchanged":
                assert run.target.read_bytes() == run.source.read_bytes()

    @pytest.mark.slow
    def test_baking_twice_is_baking_once(self, runs: list[Run], tmp_path: Path) -> None:
        for number, run in enumerate(baked(runs)):
            folder = tmp_path / str(number)
            folder.mkdir()
            bake_file(str(run.target), str(folder / run.target.name))
            # The notes of copies name their sources, which differ.
            once, twice = (
                {name: data for name, data in written(place).items() if name != NOTES}
                for place in (run.target.parent, folder)
            )
            assert twice == once, run.source

    @pytest.mark.slow
    def test_strip_gives_the_original_back(self, runs: list[Run], tmp_path: Path) -> None:
        for number, run in enumerate(baked(runs)):
            target = tmp_path / str(number) / run.target.name
            target.parent.mkdir()
            result = strip_file(str(run.target), str(target))
            assert {notice.code for notice in result.notices} <= {"file-missing"}
            assert target.read_bytes() == run.source.read_bytes()
            before, after = read(run.source), read(target)
            assert json.dumps(after.content) == json.dumps(before.content)
            assert after.binary_chunk == before.binary_chunk
            assert_buffers_kept(before, after)

    @pytest.mark.slow
    def test_strip_undoes_generated_normals_too(self, with_normals: list[Run], tmp_path: Path) -> None:
        generated = [
            run for run in with_normals if any(count.generated_normals for _, count in run.result.primitives)
        ]
        assert len(generated) == UNCHANGED
        for number, run in enumerate(generated):
            target = tmp_path / str(number) / run.target.name
            target.parent.mkdir()
            strip_file(str(run.target), str(target))
            assert json.dumps(read(target).content) == json.dumps(read(run.source).content)

    @pytest.mark.slow
    def test_every_container_becomes_the_other(self, runs: list[Run], tmp_path: Path) -> None:
        for number, run in enumerate(baked(runs)):
            suffix = ".gltf" if run.source.suffix == ".glb" else ".glb"
            target = tmp_path / str(number) / f"model{suffix}"
            target.parent.mkdir()
            assert bake_file(str(run.source), str(target)).status != "failed"
            assert_views_kept(read(run.source), read(target))
            models = read_plain_many([run.target, target]).values()
            for mesh, part, primitive in primitives(read(run.target).content):
                if ALPHA in primitive["attributes"]:
                    first, second = (model.stored_attribute(ALPHA, mesh, part) for model in models)
                    assert first.tobytes() == second.tobytes()

    @pytest.mark.slow
    def test_inspect_reads_every_result(self, runs: list[Run]) -> None:
        for run in baked(runs):
            bakes = [primitive.bake for primitive in inspect_file(str(run.target)).primitives]
            assert sum(found is not None for found in bakes) == len(run.result.primitives)
            assert all(found.changed == () for found in bakes if found)


def assert_views_kept(before: GltfFile, after: GltfFile) -> None:
    """Check that the bytes of every buffer view are there. Those of data: URIs go into the chunk of a GLB."""
    for number, view in enumerate(before.content.get("bufferViews", [])):
        if not any("meshopt" in name for name in view.get("extensions", {})):
            assert after.buffer_view(number) == before.buffer_view(number)


@pytest.mark.slow
def test_the_khronos_validator_finds_nothing_new(
    runs: list[Run], with_normals: list[Run], tmp_path: Path
) -> None:
    """Errors and warnings of every result against those of what it came from, in one batch."""
    khronos.require_node()
    pairs = [(run.source, run.target) for run in runs if run.result.error is None]
    pairs += [
        (run.source, run.target)
        for run in with_normals
        if any(count.generated_normals for _, count in run.result.primitives)
    ]
    for name in FIXTURES:
        bake_file(str(FOLDER / name), str(tmp_path / name))
        pairs.append((FOLDER / name, tmp_path / name))
    reports = khronos.validate_many([path for pair in pairs for path in pair])
    new = {str(target): khronos.new_findings(reports[source], reports[target]) for source, target in pairs}
    assert {target: found for target, found in new.items() if found} == {}
    assert len(pairs) == BAKED + 2 * UNCHANGED + len(FIXTURES)


def test_the_khronos_validator_would_find_a_wrong_addition(tmp_path: Path) -> None:
    khronos.require_node()
    target = tmp_path / "seam.glb"
    bake_file(str(FOLDER / "seam.glb"), str(target))
    data = target.read_bytes()
    target.write_bytes(
        data.replace(
            b'"componentType":5126,"count":198,"type":"VEC3"',
            b'"componentType":5125,"count":198,"type":"VEC3"',
        )
    )
    reports = khronos.validate_many([FOLDER / "seam.glb", target])
    assert khronos.new_findings(reports[FOLDER / "seam.glb"], reports[target])


class TestBrokenFiles:
    @pytest.mark.parametrize("generate_normals", [False, pytest.param(True, marks=pytest.mark.slow)])
    def test_no_broken_file_crashes_or_hangs_bake_or_leaves_an_output(
        self, generate_normals: bool, tmp_path: Path
    ) -> None:
        statuses: Counter[str] = Counter()
        for number, (source, _) in enumerate(corpus.invalid_models()):
            folder = tmp_path / str(number)
            folder.mkdir()
            with time_limit():
                result = attempted(source, folder / source.name, generate_normals=generate_normals)
            statuses[result.status] += 1
            if result.status == "failed":
                assert result.error is not None
                assert str(result.error).startswith(str(source))
                assert written(folder) == {}
            else:
                assert (folder / source.name).is_file()
        assert sum(statuses.values()) == 339
        assert statuses["failed"] > 30

    @pytest.mark.slow
    def test_a_failure_leaves_an_old_file_as_it_was(self, tmp_path: Path) -> None:
        for source, _ in corpus.invalid_models():
            target = tmp_path / source.name
            target.write_bytes(b"old")
            if attempted(source, target).status == "failed":
                assert target.read_bytes() == b"old"

    @pytest.mark.slow
    def test_no_broken_file_crashes_inspect_or_strip(self, tmp_path: Path) -> None:
        for source, _ in corpus.invalid_models():
            target = str(tmp_path / source.name)
            for attempt in (inspect_file, partial(strip_file, target=target)):
                try:
                    with time_limit():
                        attempt(str(source))
                except SkinbakeError as error:
                    assert str(error).startswith(str(source))

    def test_every_truncation_of_a_glb_is_refused(self, tmp_path: Path) -> None:
        data = corpus.character(BIG).read_bytes()
        for length in (0, 3, 11, 12, 19, 20, 1000, len(data) // 2, len(data) - 4, len(data) - 1):
            (tmp_path / "cut.glb").write_bytes(data[:length])
            with pytest.raises(InputError):
                bake_file(str(tmp_path / "cut.glb"), str(tmp_path / "out.glb"))
        assert [path.name for path in tmp_path.iterdir()] == ["cut.glb"]


class TestProcesses:
    def run(self, sources: list[Path], folder: Path) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "skinbake", "bake", *map(str, sources), "--out-dir", str(folder)]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    @pytest.mark.slow
    def test_real_models_leave_in_order(self, tmp_path: Path) -> None:
        sources = {source.name: source for source in corpus.valid_models()}
        process = self.run(list(sources.values()), tmp_path)
        assert process.returncode == 0
        assert "Traceback" not in process.stderr
        assert "should not" not in process.stderr
        assert len(process.stdout.splitlines()) == len(sources)

    @pytest.mark.slow
    def test_broken_files_end_in_0_or_3_without_a_traceback(self, tmp_path: Path) -> None:
        """All in one process, and every fortieth in one of its own."""
        sources = {source.name: source for source, _ in corpus.invalid_models()}
        process = self.run(list(sources.values()), tmp_path)
        assert process.returncode == 3
        assert "Traceback" not in process.stderr
        assert "should not" not in process.stderr
        failed = [line for line in process.stderr.splitlines() if line.startswith("error: ")]
        assert len(process.stdout.splitlines()) + len(failed) == len(sources)
        shutil.rmtree(tmp_path)
        for source in list(sources.values())[::40]:
            tmp_path.mkdir()
            process = self.run([source], tmp_path)
            assert process.returncode in {0, 3}
            assert "Traceback" not in process.stderr
            assert (process.returncode == 0) == (tmp_path / source.name).exists()
            shutil.rmtree(tmp_path)
