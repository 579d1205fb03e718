"""The folders of outputs that the user named are made; no other folder, and none if the command fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from skinbake.errors import OutputError
from skinbake.gltf.writing.copies import NAME as NOTES
from tests.support.command_line import invoke
from tests.support.models import FOLDER, bake

SEAM = FOLDER / "seam.glb"


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


@pytest.mark.parametrize(
    "arguments",
    [
        ["bake", str(SEAM), "-o", "new/deep/out.glb"],
        ["bake", str(SEAM), "--dry-run", "--summary", "new/deep/out.jsonl"],
        ["strip", "{baked}", "-o", "new/deep/out.gltf"],
        ["shader", "--lang", "glsl", "--frame", "normal", "-o", "new/deep/out.glsl"],
        ["view", str(SEAM), "-o", "new/deep/out.html"],
        ["verify", "{baked}", "--poses", "rest", "--junit", "new/deep/out.xml"],
        pytest.param(
            ["verify", "{baked}", "--poses", "rest", "--html", "new/deep/out.html"], marks=pytest.mark.slow
        ),
        ["verify", "{baked}", "--poses", "rest", "--skip-unchanged", "--state", "new/deep/out.jsonl"],
    ],
)
def test_missing_folders_are_made(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bake(SEAM, tmp_path / "baked.glb")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    result = invoke(*(argument.format(baked=tmp_path / "baked.glb") for argument in arguments))
    assert result.exit_code == 0, result.output
    made = {name for name in names(tmp_path) if not name.endswith((".bin", NOTES))}
    out = Path(arguments[-1]).name
    assert made == {"baked.glb", "here", "here/new", "here/new/deep", f"here/new/deep/{out}"}


@pytest.mark.parametrize(
    "arguments",
    [
        ["bake", "broken.glb", "-o", "new/out.glb"],
        ["bake", str(SEAM), "-o", "new/out.glb", "--dry-run"],
        ["bake", str(SEAM), "-o", "new/out.png"],
        ["strip", "broken.glb", "-o", "new/out.glb"],
        ["view", "broken.glb", "-o", "new/out.html"],
        ["shader", "--for", "broken.glb", "--lang", "glsl", "-o", "new/out.glsl"],
    ],
)
def test_no_folder_is_made_if_nothing_is_written(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.glb").write_bytes(b"glTF")
    invoke(*arguments)
    assert names(tmp_path) == {"broken.glb"}


def test_a_summary_below_a_file_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written: Not a directory"):
        invoke("bake", SEAM, "--dry-run", "--summary", tmp_path / "file" / "out")


@pytest.mark.parametrize("option", ["--junit", "--html"])
def test_a_report_below_a_file_is_an_output_error(option: str, tmp_path: Path) -> None:
    bake(SEAM, tmp_path / "baked.glb")
    before = (tmp_path / "baked.glb").read_bytes()
    result = invoke(
        "verify", tmp_path / "baked.glb", "--poses", "rest", option, tmp_path / "baked.glb/out.html"
    )
    assert result.exit_code == 4, result.output
    assert "baked.glb/out.html: " in result.stderr
    assert (tmp_path / "baked.glb").read_bytes() == before
