"""Exit codes: 0 fine, 2 usage, 3 input, 4 output; the worst of several; and failures write nothing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from skinbake.cli import exit_codes
from skinbake.commands.bake import bake_document
from skinbake.errors import (
    InputError,
    OutputError,
    SkinbakeError,
    UnsupportedFeatureError,
)
from skinbake.gltf.document import Document
from tests.support.command_line import invoke, run
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, copied, edited, sheet, write_model

ALPHA = "_SKINBAKE_ALPHA_0"
SEAM = str(FOLDER / "seam.glb")
TUBE = str(FOLDER / "bent_tube.glb")


@pytest.mark.parametrize(
    ("error", "code"),
    [(InputError, 3), (UnsupportedFeatureError, 3), (OutputError, 4)],
)
def test_every_error_has_its_code(error: type[SkinbakeError], code: int) -> None:
    assert exit_codes.of_error(error("because")) == code


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


class TestBake:
    def test_fine_is_0(self, tmp_path: Path) -> None:
        assert invoke("bake", SEAM, "-o", tmp_path / "out.glb").exit_code == 0
        assert read(tmp_path / "out.glb").has_attribute(ALPHA)

    @pytest.mark.parametrize(
        "name", ["missing.glb", "folder.glb", "empty.glb", "text.gltf", "x" * 300 + ".glb"]
    )
    def test_an_input_that_cannot_be_read_is_3(self, name: str, tmp_path: Path) -> None:
        (tmp_path / "folder.glb").mkdir()
        (tmp_path / "empty.glb").touch()
        (tmp_path / "text.gltf").write_text("hello", encoding="utf-8")
        (tmp_path / "out").mkdir()
        result = invoke("bake", tmp_path / name, "-o", tmp_path / "out" / "out.glb")
        assert result.exit_code == 3
        assert f"error: {tmp_path / name}: " in result.stderr
        assert names(tmp_path / "out") == []

    @pytest.mark.parametrize("name", ["file/out.glb", "file/deep/out.glb", "y" * 300 + ".glb"])
    def test_an_output_that_cannot_be_written_is_4(self, name: str, tmp_path: Path) -> None:
        (tmp_path / "file").touch()
        result = invoke("bake", SEAM, "-o", tmp_path / name)
        assert result.exit_code == 4
        assert f"error: {tmp_path / name}: " in result.stderr
        assert names(tmp_path) == ["file"]

    def test_bake_tries_all_inputs_and_returns_the_worst_code(self, tmp_path: Path) -> None:
        broken = tmp_path / "broken.glb"
        broken.touch()
        folder = tmp_path / "out"
        folder.mkdir()
        result = invoke("bake", broken, SEAM, "--out-dir", folder)
        assert (result.exit_code, names(folder)) == (3, ["seam.glb"])
        (folder / "bent_tube.glb").mkdir()
        result = invoke("bake", TUBE, broken, FOLDER / "two_sets.glb", "--out-dir", folder)
        assert (result.exit_code, names(folder)) == (4, ["bent_tube.glb", "seam.glb", "two_sets.glb"])
        assert [line.split(": ")[1] for line in result.stdout.splitlines()] == ["baked"]
        failed = [line.split(": ")[1] for line in result.stderr.splitlines() if line.startswith("error: ")]
        assert failed == [str(folder / "bent_tube.glb"), str(broken)]

    def test_an_input_that_breaks_skinbake_does_not_stop_the_others(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def breaking(document: Document, *options: object) -> object:
            if "two_sets" in document.name:
                raise RuntimeError("a defect of skinbake")
            return bake_document(document, *options)  # type: ignore[arg-type]  # as it was called

        monkeypatch.setattr("skinbake.commands.bake.bake_document", breaking)
        result = invoke("bake", FOLDER / "two_sets.glb", SEAM, "--out-dir", tmp_path)
        assert result.exit_code == 3
        assert names(tmp_path) == ["seam.glb"]

    def test_too_little_memory_is_3(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def exhausted(*arguments: object) -> object:
            raise MemoryError

        monkeypatch.setattr("skinbake.commands.bake.bake_document", exhausted)
        result = invoke("bake", SEAM, "-o", tmp_path / "out.glb")
        assert result.exit_code == 3
        assert "it needs more memory than there is" in result.stderr

    def test_a_file_with_nothing_to_bake_is_0_with_a_warning(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None)])
        result = invoke("bake", path, "-o", tmp_path / "out.glb")
        assert result.exit_code == 0
        assert "passed through unchanged: none of its skinned primitives can be baked" in result.stderr
        assert (tmp_path / "out.glb").read_bytes() == path.read_bytes()

    def test_a_file_with_nothing_skinned_has_a_message_of_its_own(self, tmp_path: Path) -> None:
        path = edited("seam.glb", tmp_path, lambda content: content["nodes"][0].pop("skin"))
        result = invoke("bake", path, "-o", tmp_path / "out.glb")
        assert "passed through unchanged: it has a skin, but no mesh that is drawn with one" in result.stderr

    def test_a_skinned_mesh_without_joints_is_named(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "bare.glb", [sheet(JOINTS_0=None, WEIGHTS_0=None)])
        result = invoke("bake", path, "-o", tmp_path / "out.glb")
        assert (
            "passed through unchanged: the meshes that are drawn with a skin have no JOINTS_0"
            in result.stderr
        )

    def test_a_file_with_nothing_to_bake_is_3_under_require_baked(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None)])
        result = invoke("bake", path, "-o", tmp_path / "out.glb", "--require-baked")
        assert result.exit_code == 3
        assert "(--require-baked)" in result.stderr
        assert names(tmp_path) == ["bare.glb"]
        assert invoke("bake", SEAM, "-o", tmp_path / "out.glb", "--require-baked").exit_code == 0

    def test_warnings_as_errors_write_nothing(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "half.glb", [sheet(), sheet(NORMAL=None)])
        assert invoke("bake", path, "-o", tmp_path / "out.glb").exit_code == 0
        (tmp_path / "out.glb").unlink()
        result = invoke("bake", path, "-o", tmp_path / "out.glb", "--warnings-as-errors")
        assert result.exit_code == 3
        assert names(tmp_path) == ["half.glb"]
        # The reason is said, not only that there was one.
        assert "skipped: it has no NORMAL" in result.stderr
        assert invoke("bake", SEAM, "-o", tmp_path / "out.glb", "--warnings-as-errors").exit_code == 0

    def test_warnings_as_errors_of_verify_tell_each_warning_once(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "half.glb", [sheet(), sheet(NORMAL=None)])
        invoke("bake", path, "-o", tmp_path / "out.glb")
        result = invoke("verify", tmp_path / "out.glb", "--poses", "rest", "--warnings-as-errors")
        assert result.exit_code == 1
        assert result.stderr.count("skipped: it has no NORMAL") == 1

    def test_a_dry_run_writes_nothing_and_returns_the_same_code(self, tmp_path: Path) -> None:
        source = copied("seam.glb", tmp_path / "in")
        before = source.read_bytes()
        (tmp_path / "broken.glb").touch()
        (tmp_path / "out").mkdir()
        for target in (
            ["-o", tmp_path / "out" / "a.glb"],
            ["--out-dir", tmp_path / "out"],
            ["--in-place"],
            [],
        ):
            result = invoke("bake", source, *target, "--dry-run")
            assert (result.exit_code, "(dry run): baked" in result.stdout) == (0, True)
        assert invoke("bake", tmp_path / "broken.glb", "--dry-run").exit_code == 3
        assert invoke("bake", source, "-o", tmp_path / "broken.glb" / "a.glb", "--dry-run").exit_code == 4
        assert (names(tmp_path / "in"), names(tmp_path / "out")) == (["seam.glb"], [])
        assert source.read_bytes() == before

    def test_a_dry_run_to_stdout_writes_nothing_there(self) -> None:
        result = invoke("bake", SEAM, "-o", "-", "--dry-run")
        assert (result.exit_code, result.stdout_bytes) == (0, b"")

    def test_in_place_replaces_every_input_once(self, tmp_path: Path) -> None:
        first, second = copied("seam.glb", tmp_path), copied("two_sets.glb", tmp_path)
        result = invoke("bake", first, second, first, "--in-place")
        assert result.exit_code == 0
        assert len(result.stdout.splitlines()) == 2
        assert read(first).has_attribute(ALPHA)
        assert read(second).has_attribute(ALPHA)
        assert names(tmp_path) == ["seam.glb", "two_sets.glb"]

    def test_in_place_a_file_with_nothing_to_bake_is_not_touched(self, tmp_path: Path) -> None:
        path = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None)])
        before = path.stat()
        result = invoke("bake", path, "--in-place")
        assert (result.exit_code, "passed through unchanged" in result.stderr) == (0, True)
        after = path.stat()
        assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


class TestUsage:
    """Everything here is 2, says why, and touches no file."""

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ([], "Missing argument"),
            (["{seam}"], "give one of -o/--output, --out-dir, --in-place"),
            (["{seam}", "-o", "{dir}/a.glb", "--in-place"], "give only one of"),
            (["{seam}", "-o", "{dir}/a.glb", "--out-dir", "{dir}"], "give only one of"),
            (["{seam}", "--in-place", "--out-dir", "{dir}"], "give only one of"),
            (["{seam}", "{tube}", "-o", "{dir}/a.glb"], "-o takes one input"),
            (["model.obj", "-o", "{dir}/a.glb"], "model.obj: OBJ is not glTF: OBJ has no skin"),
            (["model", "-o", "{dir}/a.glb"], "model: no such file or folder"),
            (["model.txt", "-o", "{dir}/a.glb"], "expected a name"),
            (
                ["{seam}", "-o", "{dir}/a.fbx"],
                "a.fbx: expected a name that ends in .glb, .gltf, .vrm, or - for stdout",
            ),
            (["{seam}", "-o", "{dir}"], "out is a folder: use --out-dir"),
            (["{seam}", "-o", "{dir}/new/"], "new/ is a folder: use --out-dir"),
            (["{seam}", "-o", "{seam}"], "is the input; use --in-place"),
            (["{own}/seam.glb", "-o", "{own}/../own/seam.glb"], "is the input; use --in-place"),
            (["{own}/seam.glb", "-o", "{own}/link.glb"], "is the input; use --in-place"),
            (["{own}/seam.glb", "--out-dir", "{own}"], "is the input; use --in-place"),
            (["{seam}", "{own}/seam.glb", "--out-dir", "{dir}"], "would both become"),
            (["-", "--out-dir", "{dir}"], "--out-dir needs inputs that have a name"),
            (["-", "--in-place"], "--in-place needs files"),
            (["-", "-", "--dry-run"], "stdin can be read only once"),
            (["{seam}", "-o", "-", "--json"], "--json prints to stdout, and so does -o -"),
            (["{seam}", "-o", "{dir}/a.glb", "--weighting", "uniform"], "'uniform' is not one of"),
            (["{seam}", "-o", "{dir}/a.glb", "--frame", "none"], "'none' is not one of"),
            (["{seam}", "-o", "{dir}/a.glb", "--neighbours", "keep"], "'keep' is not one of"),
            (
                ["{seam}", "-o", "{dir}/a.glb", "--crease-angle", "-1"],
                "expected a number from 0 to 180, found -1",
            ),
            (
                ["{seam}", "-o", "{dir}/a.glb", "--crease-angle", "181"],
                "expected a number from 0 to 180, found 181",
            ),
            (["{seam}", "-o", "{dir}/a.glb", "--crease-angle", "nan"], "--crease-angle"),
            (["{seam}", "-o", "{dir}/a.glb", "--alpha-name", "ALPHA_{set}"], "begins with an underscore"),
            (["{seam}", "-o", "{dir}/a.glb", "--beta-name", "_BETA"], "contains {set}"),
            (
                ["{seam}", "-o", "{dir}/a.glb", "--alpha-name", "_X{set}", "--beta-name", "_X{set}"],
                "must differ",
            ),
            (["{seam}", "-o", "{dir}/a.glb", "--encoding", "half"], "'half' is not one of"),
            (["{seam}", "-o", "{dir}/a.glb", "--layout", "uv"], "'uv' is not one of"),
            (
                ["{seam}", "-o", "{dir}/a.glb", "--layout", "texcoord", "--encoding", "packed8"],
                "--layout texcoord needs --encoding float32, not packed8",
            ),
            (
                ["{seam}", "-o", "{dir}/a.glb", "--layout", "texcoord", "--alpha-name", "_A{set}"],
                "--alpha-name needs --layout attributes; texcoord has fixed names",
            ),
            (
                ["{seam}", "-o", "{dir}/a.glb", "--layout", "custom", "--beta-name", "_SKINBAKE_BETA_{set}"],
                "--beta-name needs --layout attributes; custom has fixed names",
            ),
            (["{seam}", "-o", "{dir}/a.glb", "--color", "blue"], "'blue' is not one of"),
            (["{seam}", "-o", "{dir}/a.glb", "--no-such"], "No such option"),
        ],
    )
    def test_bake(self, arguments: Sequence[str], message: str, tmp_path: Path) -> None:
        (tmp_path / "out").mkdir()
        copied("seam.glb", tmp_path / "own")
        (tmp_path / "own" / "link.glb").symlink_to("seam.glb")
        places = {"seam": SEAM, "tube": TUBE, "dir": tmp_path / "out", "own": tmp_path / "own"}
        filled = [argument if "{set}" in argument else argument.format_map(places) for argument in arguments]
        before = (tmp_path / "own" / "seam.glb").read_bytes(), Path(SEAM).read_bytes()
        result = invoke("bake", *filled)
        assert result.exit_code == 2, result.stderr
        assert message in " ".join(result.stderr.split())
        assert result.stdout == ""
        assert names(tmp_path / "out") == []
        assert before == ((tmp_path / "own" / "seam.glb").read_bytes(), Path(SEAM).read_bytes())

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["strip", SEAM], "give one of -o/--output, --out-dir, --in-place"),
            (["strip", SEAM, "-o", "a.glb", "--in-place"], "give only one of"),
            (["strip", SEAM, "-o", SEAM], "is the input; use --in-place to replace it"),
            (["strip", SEAM, "-o", "-", "--json"], "--json prints to stdout, and so does -o -"),
            (["strip", SEAM, "-o", "a.txt"], "expected a name"),
            (["strip", SEAM, TUBE, "-o", "a.glb"], "-o takes one input; use --out-dir for several"),
            (["strip", "-", "--in-place"], "needs files, not - for stdin"),
            (["strip", SEAM, "-o", "a.glb", "--summary", SEAM], "is the name of a model"),
            (["inspect"], "Missing argument"),
            (["inspect", "model.fbx"], "FBX2glTF"),
            (["inspect", SEAM, "--summary", SEAM], "is the name of a model"),
            (["inspect", "-", "-"], "stdin can be read only once"),
            (["frobnicate"], "No such command 'frobnicate'."),
            (["--no-such"], "No such option"),
        ],
    )
    def test_wrong_usage_of_the_commands_besides_bake_is_2(
        self, arguments: Sequence[str], message: str
    ) -> None:
        result = invoke(*arguments)
        assert result.exit_code == 2
        assert message in " ".join(result.stderr.split())


class TestStripAndInspect:
    def test_codes(self, tmp_path: Path) -> None:
        (tmp_path / "broken.glb").touch()
        assert invoke("inspect", SEAM).exit_code == 0
        assert invoke("inspect", tmp_path / "broken.glb").exit_code == 3
        assert invoke("inspect", tmp_path / "missing.gltf").exit_code == 3
        assert invoke("strip", SEAM, "-o", tmp_path / "out.glb").exit_code == 0
        assert invoke("strip", tmp_path / "broken.glb", "-o", tmp_path / "a.glb").exit_code == 3
        assert invoke("strip", SEAM, "-o", tmp_path / "broken.glb" / "a.glb").exit_code == 4
        assert invoke("strip", SEAM, "-o", tmp_path / "b.glb", "--warnings-as-errors").exit_code == 3
        assert names(tmp_path) == ["broken.glb", "out.glb"]

    def test_compressed_files_are_3_and_the_extension_is_named(self, tmp_path: Path) -> None:
        name = "KHR_draco_mesh_compression"
        path = edited(
            "seam.glb",
            tmp_path,
            lambda content: content["meshes"][0]["primitives"][0].update(extensions={name: {}}),
        )
        commands: list[list[str | Path]] = [["bake", path, "-o", tmp_path / "out.glb"], ["inspect", path]]
        for arguments in commands:
            result = invoke(*arguments)
            assert result.exit_code == 3
            assert name in result.stderr
        assert names(tmp_path) == ["seam.glb"]


@pytest.mark.slow
def test_the_codes_leave_the_process(tmp_path: Path) -> None:
    """A shell sees the same as the other tests see in this process."""
    (tmp_path / "broken.glb").touch()
    found = [
        run("bake", SEAM, "--dry-run").returncode,
        run("bake", SEAM).returncode,
        run("bake", tmp_path / "broken.glb", "--dry-run").returncode,
        run("bake", SEAM, "-o", tmp_path / "broken.glb" / "a.glb").returncode,
    ]
    assert found == [0, 2, 3, 4]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows deletes no current folder")
@pytest.mark.parametrize("arguments", [["config"], ["bake", FOLDER / "seam.glb", "--out-dir", "out"]])
def test_a_current_folder_that_was_deleted(arguments: list[str | Path], tmp_path: Path) -> None:
    code = "import os, sys; from skinbake.__main__ import run; os.rmdir(os.getcwd()); sys.exit(run())"
    result = run(*arguments, command=("-c", code), folder=tmp_path)
    assert result.returncode == exit_codes.INPUT
    assert result.stderr == b"error: the current folder was deleted: change to another one\n"
