"""URLs on the command line, and what goes with --dask."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from skinbake.cli import exit_codes
from skinbake.commands import dask_runner
from skinbake.errors import InputError
from tests.cli.running import document, invoke
from tests.commands.libraries import filesystem, stored, tree, upload, write_library


@pytest.fixture(autouse=True)
def _storages() -> Iterator[None]:
    yield
    memory = filesystem("memory")
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """A library on the disk and, the same, at memory://lib; baked to ``here`` on the disk."""
    write_library(tmp_path / "lib")
    upload(tmp_path / "lib", "memory://lib")
    assert invoke("bake", tmp_path / "lib", "--out-dir", tmp_path / "here").exit_code == 0
    return tmp_path


def test_folders_and_patterns_behind_urls(library: Path) -> None:
    result = invoke("bake", "memory://lib/", "--out-dir", "memory://out", "--json")
    assert result.exit_code == 0
    assert [(file["input"], file["output"]) for file in document(result)["files"]] == [
        (f"memory://lib/{name}", f"memory://out/{name}")
        for name in (
            "characters/bent_tube.glb",
            "characters/two_sets.glb",
            "props/crate.gltf",
            "shared/shared_accessors.gltf",
        )
    ]
    assert stored("memory://out") == tree(library / "here")
    pattern = invoke("bake", "memory://lib/**/two*.glb", "--out-dir", "memory://one")
    assert pattern.exit_code == 0
    assert list(stored("memory://one")) == ["characters/two_sets.glb"]
    verified = invoke("verify", "memory://out/characters", "--json")
    assert [file["input"] for file in document(verified)["files"]] == [
        "memory://out/characters/bent_tube.glb",
        "memory://out/characters/two_sets.glb",
    ]
    assert verified.exit_code == 0


def test_outputs_are_not_taken_for_inputs(library: Path) -> None:
    for _ in range(2):
        assert invoke("bake", "memory://lib", "--out-dir", "memory://lib/out").exit_code == 0
    assert stored("memory://lib/out").keys() == {
        name for name in tree(library / "here") if not name.startswith("common")
    }


def test_urls_in_several_processes(library: Path) -> None:
    sources = [f"file://{library}/lib"] * 1
    result = invoke("bake", *sources, "--out-dir", f"file://{library}/away", "--jobs", "2")
    assert result.exit_code == 0
    assert tree(library / "away") == tree(library / "here")


def test_one_url_to_another_and_in_place(library: Path) -> None:
    url, path = "memory://lib/characters/two_sets.glb", "characters/two_sets.glb"
    assert invoke("bake", url, "-o", "memory://new/a.glb").exit_code == 0
    assert stored("memory://new") == {"a.glb": tree(library / "here")[path]}
    assert invoke("bake", url, "--in-place").exit_code == 0
    assert stored("memory://lib")[path] == tree(library / "here")[path]


def test_what_cannot_be_had_is_one_sentence_a_file(library: Path) -> None:
    names = ["memory://lib/gone.glb", "memory://gone", "memory://lib/*.png", "warp://a.glb", "gs://b/"]
    result = invoke("bake", *names, "--out-dir", "memory://out", "-q")
    assert result.exit_code == exit_codes.INPUT
    lines = result.stderr.splitlines()
    for name, reason in zip(
        names,
        [
            "cannot be read: No such file or directory",
            "nothing in this folder ends in .glb, .gltf, .vrm",
            "no file matches this pattern that ends in .glb, .gltf, .vrm",
            "fsspec knows no protocol warp://",
            "the driver for gs:// is not installed: Please install gcsfs to access Google Storage",
        ],
        strict=True,
    ):
        assert f"error: {name}: {reason}" in lines
    assert stored("memory://out") == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.glb", "--dask", "tcp://h:1", "--jobs", "2"], "--jobs is for processes of this machine"),
        (["-", "--dask", "tcp://h:1"], "not - for stdin"),
        (["memory://a.glb", "--skip-unchanged", "--state", "s.jsonl"], "not with --dask or URLs"),
        (["a.glb", "--dask", "tcp://h:1", "--skip-unchanged", "--state", "s"], "not with --dask or URLs"),
    ],
)
def test_what_does_not_go_together(arguments: list[str], message: str) -> None:
    for command in (["bake", "--dry-run"], ["verify"]):
        result = invoke(*command, *arguments)
        assert result.exit_code == exit_codes.USAGE
        assert message in result.stderr


def test_a_scheduler_that_does_not_answer(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_runner, "CONNECT_SECONDS", 0.3)
    with pytest.raises(InputError, match=r"tcp://127\.0\.0\.1:1: no Dask scheduler answers"):
        invoke("bake", library / "lib", "--out-dir", library / "away", "--dask", "tcp://127.0.0.1:1")
    assert not (library / "away").exists()
