"""Folders and patterns: which files they mean, and where each of them goes."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

from skinbake.cli.inputs import expanded
from skinbake.cli.targets import in_turns
from tests.support.command_line import document, invoke, run
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, SHARED, copied, rewritten

SEAM = FOLDER / "seam.glb"
LINKS = pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")


def put(folder: Path, *names: str) -> None:
    """Put a skinned model there under each name; folders are made."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(SEAM, folder / name)


def files(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    root = tmp_path / "art"
    put(root, "b.glb", "a/z.glb", "a/B.GLB", "a/deep/er/x.vrm", "c.d/e.glb", ".hidden/h.glb", "a/.skip.glb")
    put(root, "a/.skinbake-0123456789ab.tmp", "notes.txt")
    copied(SHARED, root / "shared")
    return root


EVERYTHING = ["a/B.GLB", "a/deep/er/x.vrm", "a/z.glb", "b.glb", "c.d/e.glb", "shared/shared_accessors.gltf"]


def test_a_folder_is_all_models_below_it_in_order(tree: Path, tmp_path: Path) -> None:
    result = invoke("bake", tree, "--out-dir", tmp_path / "out", "--json")
    found = document(result)["files"]
    assert [file["input"] for file in found] == [str(tree / name) for name in EVERYTHING]
    assert [file["output"] for file in found] == [str(tmp_path / "out" / name) for name in EVERYTHING]
    written = files(tmp_path / "out")
    notes = "shared/.skinbake-copies.json"
    assert {*EVERYTHING, "shared/shared accessors.bin", notes} <= set(written)
    # Besides: the buffer that baking the .gltf added. No hidden input, no other file.
    assert len(written) == len(EVERYTHING) + 3
    assert read(tmp_path / "out" / "a/deep/er/x.vrm").has_attribute("_SKINBAKE_ALPHA_0")


@pytest.mark.parametrize(
    ("pattern", "kept"),
    [
        ("{}/**/*.glb", ["a/z.glb", "b.glb", "c.d/e.glb"]),
        ("{}/**", EVERYTHING),
        ("{}/**/*", EVERYTHING),
        ("{}/*.glb", ["b.glb"]),
        ("{}/*/*.*", ["a/B.GLB", "a/z.glb", "c.d/e.glb", "shared/shared_accessors.gltf"]),
        ("{}/a/**/?.*", ["B.GLB", "deep/er/x.vrm", "z.glb"]),
        ("{}/a/**/**/x.vrm", ["deep/er/x.vrm"]),
        ("{}/[a-b]/*.glb", ["a/z.glb"]),
        ("{}/**/deep/*/x.vrm", ["a/deep/er/x.vrm"]),
        ("{}/.hidden/*.glb", ["h.glb"]),
        ("{}/.h*/*", [".hidden/h.glb"]),
        ("{}/a/.*.glb", [".skip.glb"]),
    ],
)
def test_a_pattern_keeps_the_path_from_its_first_wildcard_on(
    pattern: str, kept: list[str], tree: Path, tmp_path: Path
) -> None:
    result = invoke("bake", pattern.format(tree), "--out-dir", tmp_path / "out", "--json")
    out = [file["output"] for file in document(result)["files"]]
    assert out == [str(tmp_path / "out" / name) for name in kept]
    assert all((tmp_path / "out" / name).is_file() for name in kept)


@pytest.mark.slow
def test_a_relative_pattern_begins_here(tree: Path) -> None:
    process = run("bake", "**/*.glb", "--out-dir", "out", "-q", folder=tree)
    assert process.returncode == 0, process.stderr
    assert files(tree / "out") == ["a/z.glb", "b.glb", "c.d/e.glb"]
    # Outputs inside are not read as inputs another time.
    process = run("bake", ".", "--out-dir", "out", "--json", "--dry-run", folder=tree)
    assert process.stdout.count(b'"input"') == len(EVERYTHING)
    assert b'"out/' not in process.stdout.replace(b'"output": "out/', b"")


@pytest.mark.parametrize("name", ["a[1].glb", "odd*.glb", "what?.glb"])
def test_a_name_that_exists_is_no_pattern(name: str, tmp_path: Path) -> None:
    if sys.platform == "win32":
        pytest.skip("Windows has no such names")
    put(tmp_path / "in", name, "a1.glb", "odd-one.glb", "whatX.glb")
    invoke("bake", tmp_path / "in" / name, "--out-dir", tmp_path / "out")
    assert files(tmp_path / "out") == [name]
    (tmp_path / "in" / "[b]").mkdir()
    put(tmp_path / "in" / "[b]", "x.glb")
    put(tmp_path / "in" / "b", "y.glb")
    invoke("bake", tmp_path / "in" / "[b]", "--out-dir", tmp_path / "out2")
    assert files(tmp_path / "out2") == ["x.glb"]


@pytest.mark.parametrize("command", ["bake", "verify"])
@pytest.mark.parametrize(
    ("argument", "reason"), [("{}/empty", "this folder"), ("{}/no*.glb", "this pattern")]
)
def test_what_means_no_file_is_an_input_error_and_the_others_are_tried(
    command: str, argument: str, reason: str, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    put(tmp_path, "a.glb", "empty/readme.txt")
    options: list[str | Path] = ["--out-dir", tmp_path / "out"] if command == "bake" else []
    result = invoke(command, argument.format(tmp_path), tmp_path / "a.glb", *options)
    assert result.exit_code == 3
    assert f"error: {argument.format(tmp_path)}: " in result.stderr
    assert reason in result.stderr
    assert str(tmp_path / "a.glb") in result.stdout


@LINKS
def test_linked_folders_are_passed_over_linked_files_are_not(tmp_path: Path) -> None:
    put(tmp_path / "in", "a/x.glb")
    (tmp_path / "in" / "a" / "loop").symlink_to("..", target_is_directory=True)
    (tmp_path / "in" / "link.glb").symlink_to("a/x.glb")
    (tmp_path / "in" / "broken.glb").symlink_to("nowhere.glb")
    (tmp_path / "way").symlink_to("in", target_is_directory=True)
    for number, argument in enumerate(("in", "way", "in/**/*.glb")):
        out = tmp_path / f"out{number}"
        result = invoke("bake", tmp_path / argument, "--out-dir", out)
        assert files(out) == ["a/x.glb", "link.glb"]
        assert result.exit_code == 3  # somebody misses the file that a link leads to
        assert "broken.glb: cannot be read: No such file" in result.stderr


def test_in_place_takes_folders_and_bakes_each_file_once(tree: Path) -> None:
    before = files(tree)
    result = invoke("bake", tree, tree / "b.glb", f"{tree}/a/*.glb", "--in-place", "--json")
    found = document(result)["files"]
    assert (result.exit_code, len(found)) == (0, len(EVERYTHING))
    assert all(read(tree / name).has_attribute("_SKINBAKE_ALPHA_0") for name in EVERYTHING)
    assert set(before) <= set(files(tree))


def test_in_place_keeps_the_order_in_which_files_are_first_named(tree: Path) -> None:
    result = invoke("bake", tree / "b.glb", tree / "a", tree / "b.glb", "--in-place", "--json")
    found = [Path(file["input"]).relative_to(tree).as_posix() for file in document(result)["files"]]
    assert found == ["b.glb", "a/B.GLB", "a/deep/er/x.vrm", "a/z.glb"]


def test_inputs_named_twice_by_folders_and_patterns_are_baked_once(tree: Path, tmp_path: Path) -> None:
    arguments: list[str | Path] = [tree, f"{tree}/**", f"{tree}/**/*.glb", tree]
    result = invoke("bake", *arguments, "--out-dir", tmp_path / "out", "--json")
    assert [file["input"] for file in document(result)["files"]] == [str(tree / name) for name in EVERYTHING]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["one", "two", "--out-dir", "out"],
            "/x.glb: take another --out-dir for one, or name a folder above",
        ),
        (["one", "two/x.glb", "--out-dir", "out"], "would both become"),
        (["one/*", "two", "--out-dir", "out"], "would both become"),
        (["one", "--out-dir", "one"], "is the input; use --in-place"),
        (["one/**", "--out-dir", "one"], "is the input; use --in-place"),
        (["nest", "--out-dir", "."], "is also an input"),
        (["nest", "--out-dir", "-"], "--out-dir needs the name of a folder, not -"),
        (["one", "--out-dir", "nest/x.glb"], "--out-dir nest/x.glb is a file, not a folder"),
        (["nest", "-o", "a.glb"], "-o takes one input"),
        (["nest/**/*.glb", "-o", "a.glb"], "-o takes one input"),
    ],
)
def test_what_cannot_go_together_is_said_before_anything_is_written(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "one/x.glb", "two/x.glb", "nest/x.glb", "nest/nest/x.glb")
    before = {name: (tmp_path / name).read_bytes() for name in files(tmp_path)}
    monkeypatch.chdir(tmp_path)
    result = invoke("bake", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert {name: (tmp_path / name).read_bytes() for name in files(tmp_path)} == before


def test_outputs_of_one_name_in_other_letters_meet_where_the_disk_ignores_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "one/Hero.glb", "two/hero.glb")
    arguments: list[str | Path] = ["bake", tmp_path / "one", tmp_path / "two", "--out-dir", tmp_path / "out"]
    monkeypatch.setattr("skinbake.files.urls.IGNORES_CASE", True)
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert "would both become" in result.stderr
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr("skinbake.files.urls.IGNORES_CASE", False)
    assert invoke(*arguments).exit_code == 0


@LINKS
def test_outputs_that_meet_through_a_linked_folder_are_refused(tmp_path: Path) -> None:
    put(tmp_path, "in/a/x.glb", "in/b/x.glb")
    (tmp_path / "out/a").mkdir(parents=True)
    (tmp_path / "out/b").symlink_to("a")
    result = invoke("bake", tmp_path / "in", "--out-dir", tmp_path / "out")
    assert result.exit_code == 2
    assert "would both become" in result.stderr


@LINKS
def test_an_output_that_is_a_link_to_another_output_is_refused(tmp_path: Path) -> None:
    put(tmp_path, "in/a.glb", "in/b.glb", "out/a.glb")
    (tmp_path / "out/b.glb").symlink_to("a.glb")
    result = invoke("bake", tmp_path / "in", "--out-dir", tmp_path / "out")
    assert result.exit_code == 2
    assert "would both become" in result.stderr
    assert (tmp_path / "out/a.glb").read_bytes() == SEAM.read_bytes()


def test_an_output_that_is_a_hard_link_of_another_input_is_refused(tmp_path: Path) -> None:
    put(tmp_path, "in/a.glb", "in/b.glb")
    (tmp_path / "out").mkdir()
    os.link(tmp_path / "in/b.glb", tmp_path / "out/a.glb")
    result = invoke("bake", tmp_path / "in", "--out-dir", tmp_path / "out")
    assert result.exit_code == 2
    assert f"{tmp_path / 'out/a.glb'}, which is also an input" in result.stderr


def test_outputs_that_are_hard_links_of_each_other_are_replaced_one_by_one(tmp_path: Path) -> None:
    put(tmp_path, "in/a.glb", "in/b.glb", "out/a.glb")
    os.link(tmp_path / "out/a.glb", tmp_path / "out/b.glb")
    assert invoke("bake", tmp_path / "in", "--out-dir", tmp_path / "out").exit_code == 0
    assert all(
        read(tmp_path / "out" / name).has_attribute("_SKINBAKE_ALPHA_0") for name in ("a.glb", "b.glb")
    )
    assert not (tmp_path / "out/a.glb").samefile(tmp_path / "out/b.glb")


def test_one_file_of_a_folder_may_go_to_a_name(tmp_path: Path) -> None:
    put(tmp_path, "in/x.glb")
    assert invoke("bake", tmp_path / "in", "-o", tmp_path / "out.glb").exit_code == 0
    assert read(tmp_path / "out.glb").has_attribute("_SKINBAKE_ALPHA_0")


def test_a_folder_that_cannot_be_opened_is_an_error_and_the_others_are_baked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path / "in", "a.glb", "closed/b.glb", "z/c.glb")
    closed = str(tmp_path / "in" / "closed")
    scandir = os.scandir

    def refusing(folder: str) -> object:
        if folder == closed:  # rights do not stop root
            raise PermissionError(13, "Permission denied", folder)
        return scandir(folder)

    monkeypatch.setattr(os, "scandir", refusing)
    result = invoke("bake", tmp_path / "in", "--out-dir", tmp_path / "out")
    assert files(tmp_path / "out") == ["a.glb", "z/c.glb"]
    assert result.exit_code == 3
    assert f"error: {closed}: this folder cannot be read: Permission denied" in result.stderr


def two_of_one_name(tmp_path: Path) -> list[Path]:
    """Make two .gltf files in two folders, each with a picture of the same name as the other's."""
    made = []
    for folder, name, content in (("first", "a.gltf", b"red"), ("second", "b.gltf", b"blue")):
        path = copied(SHARED, tmp_path / folder)
        model = read(path)
        model.content["images"] = [{"uri": "skin.png"}]
        (tmp_path / folder / "skin.png").write_bytes(content)
        path.unlink()
        made.append(rewritten(model, tmp_path / folder / name))
    return made


def test_only_files_that_may_copy_to_one_place_take_turns(tmp_path: Path) -> None:
    first, second = two_of_one_name(tmp_path)
    whole = copied("seam.glb", tmp_path / "third")
    assert in_turns(expanded([str(path) for path in (first, whole, second)])) == [0, 2]
    assert in_turns(expanded([str(first), str(second)])) == [0, 1]
    assert in_turns(expanded([str(tmp_path)])) == []


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_files_beside_of_one_name_stay_apart_whoever_is_first(
    jobs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skinbake.cli.runners.WORTHWHILE", 0.0)
    first, second = two_of_one_name(tmp_path)
    for order in ([first, second], [second, first]):
        out = tmp_path / f"out-{order[0].stem}"
        assert invoke("bake", *order, "--out-dir", out, "--jobs", jobs).exit_code == 0
        for path in order:
            (image,) = read(out / path.name).content["images"]
            assert (out / image["uri"]).read_bytes() == (path.parent / "skin.png").read_bytes()
            assert (image["uri"] == "skin.png") == (path == order[0])
