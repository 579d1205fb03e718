"""An incremental build is a clean build: copies that earlier bakes left beside outputs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from tests.support.command_line import document, invoke
from tests.support.models import FOLDER, SHARED, SHARED_BIN, edited
from tests.support.tools import required_program

PICTURE, PLAIN = "skins/skin #1.png", "prop.gltf"
NOTES = ".skinbake-copies.json"


def files(folder: Path) -> dict[str, bytes]:
    """Return all files of a folder by relative path, without notes of --skip-unchanged and of build tools."""
    own = (".ninja", ".d")
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".skinbake-state.jsonl" and not path.name.endswith(own)
    }


def change(path: Path, number: int = 1) -> Path:
    """Let an export write other data of the same size, some time later: small steps of its last floats."""
    data = bytearray(path.read_bytes())
    data[40] = (data[40] + number) % 256  # the lowest bits of a position, or any byte of a picture
    path.write_bytes(bytes(data))
    later = path.stat().st_mtime + number + 5
    os.utime(path, (later, later))
    return path


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder of a skinned model and a prop, which share a picture; it is the current folder."""
    source = edited(
        SHARED, tmp_path / "art", lambda content: content.update(images=[{"uri": "skins/skin%20%231.png"}])
    )
    source.rename(source.with_name("hero.gltf"))
    (tmp_path / "art" / "skins").mkdir()
    (tmp_path / "art" / PICTURE).write_bytes(bytes(range(64)))
    prop = {"asset": {"version": "2.0"}, "images": [{"uri": "skins/skin%20%231.png"}]}
    (tmp_path / "art" / PLAIN).write_text(json.dumps(prop), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def bake(target: str, *options: str, source: str = "art/hero.gltf") -> None:
    result = invoke("bake", source, "-o", target, *options)
    assert result.exit_code == 0, result.stderr


def clean(source: str = "art/hero.gltf") -> dict[str, bytes]:
    """Return the files of a build in an empty folder, at the same depth."""
    shutil.rmtree("clean", ignore_errors=True)
    bake(f"clean/{Path(source).name}", source=source)
    return files(Path("clean"))


EDITS: dict[str, Callable[[int], object]] = {
    "buffer": lambda number: change(Path("art", SHARED_BIN), number),
    "picture": lambda number: change(Path("art", PICTURE), number),
    "both": lambda number: [change(Path("art", name), number) for name in (SHARED_BIN, PICTURE)],
}


class TestOneSource:
    @pytest.mark.slow
    @pytest.mark.parametrize("what", EDITS)
    def test_four_edits_leave_a_clean_build(self, what: str, here: Path) -> None:
        bake("build/hero.gltf")
        for number in range(1, 5):
            EDITS[what](number)
            bake("build/hero.gltf")
            assert files(here / "build") == clean()

    def test_strip_in_an_incremental_build_is_that_of_a_clean_one(self, here: Path) -> None:
        bake("art/baked.gltf")
        for number in range(3):
            if number:
                change(here / "art" / SHARED_BIN, number)
            assert invoke("strip", "art/baked.gltf", "-o", "back/baked.gltf").exit_code == 0
        shutil.copytree("back", "before")
        shutil.rmtree("back")
        invoke("strip", "art/baked.gltf", "-o", "back/baked.gltf")
        assert files(here / "back") == files(here / "before")

    def test_what_passes_through_does_too(self, here: Path) -> None:
        bake("build/prop.gltf", source="art/prop.gltf")
        change(here / "art" / PICTURE)
        bake("build/prop.gltf", source="art/prop.gltf")
        assert files(here / "build") == clean("art/prop.gltf")

    def test_a_file_that_the_source_names_no_more_is_removed(self, here: Path) -> None:
        bake("build/hero.gltf")
        content = json.loads(Path("art/hero.gltf").read_text("utf-8"))
        content["images"] = []
        Path("art/hero.gltf").write_text(json.dumps(content), encoding="utf-8")
        bake("build/hero.gltf")
        assert files(here / "build") == clean()

    def test_gradients_of_an_earlier_bake_in_place_are_removed(self, here: Path) -> None:
        assert invoke("bake", "art/hero.gltf", "--in-place").exit_code == 0
        before = set(files(here / "art"))
        change(here / "art" / SHARED_BIN)
        assert invoke("bake", "art/hero.gltf", "--in-place", "--weighting", "area").exit_code == 0
        after = set(files(here / "art"))
        assert len(before - after) == len(after - before) == 1
        assert not Path("art", NOTES).exists()

    @pytest.mark.slow
    def test_two_documents_with_the_same_gradients_have_a_buffer_each(self, here: Path) -> None:
        shutil.copyfile("art/hero.gltf", "art/twin.gltf")
        for name in ("hero", "twin"):
            assert invoke("bake", f"art/{name}.gltf", "--in-place").exit_code == 0
        before = files(here / "art")
        assert invoke("bake", "art/hero.gltf", "--in-place", "--weighting", "area").exit_code == 0
        after = files(here / "art")
        (gone,) = before.keys() - after.keys()
        assert before.items() - after.items() == {(name, before[name]) for name in ("hero.gltf", gone)}
        assert invoke("strip", "art/hero.gltf", "--in-place").exit_code == 0
        assert len([name for name in files(here / "art") if name.startswith("skinbake-")]) == 1
        assert invoke("verify", "art/twin.gltf", "--poses", "random:1").exit_code == 0

    @pytest.mark.slow
    def test_a_copy_of_the_document_by_hand_can_be_baked_and_stripped_without_its_gradients(
        self, here: Path
    ) -> None:
        before = Path("art/hero.gltf").read_bytes()
        assert invoke("bake", "art/hero.gltf", "--in-place").exit_code == 0
        for name in ("copy", "other"):
            shutil.copyfile("art/hero.gltf", f"art/{name}.gltf")
        assert invoke("bake", "art/hero.gltf", "--in-place", "--weighting", "area").exit_code == 0
        assert invoke("strip", "art/other.gltf", "--in-place").exit_code == 0
        assert Path("art/other.gltf").read_bytes() == before
        assert invoke("bake", "art/copy.gltf", "--in-place").exit_code == 0
        assert invoke("verify", "art/copy.gltf", "--poses", "random:1").exit_code == 0

    def test_gradients_of_a_former_export_are_removed(self, here: Path) -> None:
        """The export has replaced the document that named them."""
        export = Path("art/hero.gltf").read_bytes()
        for weighting in ("angle", "area", "angle-area"):
            Path("art/hero.gltf").write_bytes(export)
            assert invoke("bake", "art/hero.gltf", "--in-place", "--weighting", weighting).exit_code == 0
            assert len([name for name in files(here / "art") if name.startswith("skinbake-")]) == 1

    @pytest.mark.slow
    def test_copies_of_a_glb_are_replaced_and_removed(self, here: Path) -> None:
        from pygltflib import GLTF2, Image

        pictures = ["skins/skin%20%231.png", "other/b.png"]
        (here / "art" / "other").mkdir()
        Path("art/other/b.png").write_bytes(b"b")
        for step in range(3):
            model = GLTF2().load(str(FOLDER / "seam.glb"))
            model.images = [Image(uri=uri) for uri in pictures[: 2 - step // 2]]
            model.save(str(here / "art/hero.glb"))
            change(here / "art" / PICTURE)
            bake("build/hero.glb", source="art/hero.glb")
            assert files(here / "build") == clean("art/hero.glb")

    @pytest.mark.slow
    def test_gradients_in_another_folder_than_the_buffers_are_replaced_too(self, here: Path) -> None:
        """A former target that names a buffer outside its own folder counted as none."""
        (here / "art" / "deep").mkdir()
        content = json.loads(Path("art/hero.gltf").read_text("utf-8"))
        for entry in (*content["buffers"], *content["images"]):
            entry["uri"] = entry["uri"] if entry["uri"].startswith("data:") else f"../{entry['uri']}"
        Path("art/deep/hero.gltf").write_text(json.dumps(content), encoding="utf-8")
        Path("art/hero.gltf").unlink()
        for encoding in ("float32", "snorm16", "packed8"):
            shutil.rmtree("clean", ignore_errors=True)
            for folder in ("build", "clean"):
                result = invoke("bake", "art", "--out-dir", folder, "--encoding", encoding)
                assert result.exit_code == 0, result.stderr
            assert files(here / "build") == files(here / "clean")

    def test_the_binary_part_of_a_glb_is_replaced(self, here: Path) -> None:
        """The buffer beside the target is that of a file too, which holds it."""
        shutil.copyfile(FOLDER / "seam.glb", "art/hero.glb")
        for number in range(3):
            if number:
                data = bytearray(Path("art/hero.glb").read_bytes())
                data[-40] ^= number  # the lowest bits of a number
                Path("art/hero.glb").write_bytes(data)
            shutil.rmtree("clean", ignore_errors=True)
            for folder in ("build", "clean"):
                bake(f"{folder}/hero.gltf", source="art/hero.glb")
            assert files(here / "build") == files(here / "clean")

    def test_gradients_of_a_removed_target_are_replaced(self, here: Path) -> None:
        bake("build/hero.gltf")
        Path("build/hero.gltf").unlink()
        shutil.rmtree("clean", ignore_errors=True)
        for folder in ("build", "clean"):
            bake(f"{folder}/hero.gltf", "--encoding", "snorm16")
        assert files(here / "build") == files(here / "clean")

    @pytest.mark.slow
    def test_a_removed_copy_is_made_again(self, here: Path) -> None:
        call = ["bake", "art", "--out-dir", "build", "--skip-unchanged", "--json"]
        assert invoke(*call).exit_code == 0
        whole = files(here / "build")
        for name in [name for name in whole if not name.endswith((".gltf", ".json"))]:
            (here / "build" / name).unlink()
            statuses = {one["status"] for one in document(invoke(*call))["files"]}
            assert statuses > {"up-to-date"} or statuses == {"baked", "unchanged"}, name
            assert files(here / "build") == whole, name
            assert {one["status"] for one in document(invoke(*call))["files"]} == {"up-to-date"}

    @pytest.mark.slow
    def test_passing_over_what_is_unchanged_leaves_a_clean_build(self, here: Path) -> None:
        call = ["bake", "art", "--out-dir", "build", "--skip-unchanged", "--json"]
        for number in range(1, 4):
            assert invoke(*call).exit_code == 0
            EDITS["both"](number)
        assert invoke(*call).exit_code == 0
        assert {one["status"] for one in document(invoke(*call))["files"]} == {"up-to-date"}
        assert invoke("bake", "art", "--out-dir", "clean").exit_code == 0
        assert files(here / "build") == files(here / "clean")


class TestTwoSources:
    def test_a_shared_picture_is_replaced_for_both(self, here: Path) -> None:
        for name in ("hero.gltf", PLAIN):
            bake(f"build/{name}", source=f"art/{name}")
        change(here / "art" / PICTURE)
        for name in ("hero.gltf", PLAIN):
            bake(f"build/{name}", source=f"art/{name}")
        for name in ("hero.gltf", PLAIN):
            bake(f"clean/{name}", source=f"art/{name}")
        assert files(here / "build") == files(here / "clean")

    @pytest.mark.slow
    def test_files_of_one_name_in_two_folders_are_replaced(self, here: Path) -> None:
        """Each target names a file of that name, and another target notes it."""
        content = json.loads(Path("art/hero.gltf").read_text("utf-8"))
        for number, name in enumerate(("hero", "villain")):
            (here / "art" / name).mkdir()
            shutil.copyfile(Path("art", SHARED_BIN), f"art/{name}/mesh.bin")
            change(Path(f"art/{name}/mesh.bin"), number)
            Path(f"art/{name}/skin.png").write_bytes(name.encode())
            content["buffers"] = [
                one if one["uri"].startswith("data:") else {**one, "uri": f"{name}/mesh.bin"}
                for one in content["buffers"]
            ]
            content["images"] = [{"uri": f"{name}/skin.png"}]
            Path(f"art/{name}.gltf").write_text(json.dumps(content), encoding="utf-8")
        for number in range(3):
            if number:
                change(Path("art/hero/mesh.bin"), number)
                Path("art/hero/skin.png").write_bytes(bytes([number]))
            shutil.rmtree("clean", ignore_errors=True)
            for folder in ("build", "clean"):
                for name in ("hero", "villain"):
                    bake(f"{folder}/{name}.gltf", source=f"art/{name}.gltf")
            assert files(here / "build") == files(here / "clean")

    def test_a_shared_picture_stays_when_one_of_two_sources_loses_it(self, here: Path) -> None:
        for name in ("hero.gltf", PLAIN):
            bake(f"build/{name}", source=f"art/{name}")
        Path("art", PLAIN).write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
        bake(f"build/{PLAIN}", source=f"art/{PLAIN}")
        assert Path("build", PICTURE).exists()

    def test_a_picture_of_another_source_is_not_touched(self, here: Path) -> None:
        """Both had the same bytes, and one copy served both outputs."""
        shutil.copytree("art", "other")
        bake("build/hero.gltf")
        bake("build/prop.gltf", source="other/prop.gltf")
        before = Path("build", PICTURE).read_bytes()
        for number in range(1, 3):
            change(here / "art" / PICTURE, number)
            bake("build/hero.gltf")
        assert Path("build", PICTURE).read_bytes() == before
        pictures = {path.read_bytes() for path in Path("build/skins").glob("*.png")}
        assert pictures == {before, Path("art", PICTURE).read_bytes()}

    @pytest.mark.slow
    @pytest.mark.parametrize("options", [(), ("--skip-unchanged",), ("--jobs", "2", "--isolate")])
    def test_a_shared_buffer_is_replaced_for_both_at_once(self, options: tuple[str, ...], here: Path) -> None:
        shutil.copyfile("art/hero.gltf", "art/twin.gltf")
        for number in range(3):
            if number:
                EDITS["both"](number)
            shutil.rmtree("clean", ignore_errors=True)
            assert invoke("bake", "art", "--out-dir", "build", *options).exit_code == 0
            assert invoke("bake", "art", "--out-dir", "clean").exit_code == 0
            assert files(here / "build") == files(here / "clean")

    @pytest.mark.slow
    def test_a_shared_buffer_stays_when_one_of_two_sources_loses_it(self, here: Path) -> None:
        (here / "art" / "deep").mkdir()
        content = json.loads(Path("art/hero.gltf").read_text("utf-8"))
        for entry in (*content["buffers"], *content["images"]):
            entry["uri"] = entry["uri"] if entry["uri"].startswith("data:") else f"../{entry['uri']}"
        Path("art/deep/twin.gltf").write_text(json.dumps(content), encoding="utf-8")
        assert invoke("bake", "art", "--out-dir", "build").exit_code == 0
        Path("art/hero.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
        assert invoke("bake", "art", "--out-dir", "build").exit_code == 0
        assert Path("build", SHARED_BIN).exists()
        Path("art/deep/twin.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
        assert invoke("bake", "art", "--out-dir", "build").exit_code == 0
        assert not Path("build", SHARED_BIN).exists()


class TestForeignFiles:
    """Nothing is replaced or removed that an earlier bake has not written."""

    @pytest.mark.slow
    def test_files_that_were_there_first(self, here: Path) -> None:
        (here / "build" / "skins").mkdir(parents=True)
        Path("build", SHARED_BIN).write_bytes(b"mine")
        shutil.copyfile(Path("art", PICTURE), Path("build", PICTURE))  # the same bytes: it serves
        before = files(here / "build")
        for number in range(1, 4):
            bake("build/hero.gltf")
            EDITS["both"](number)
        bake("build/hero.gltf")
        after = files(here / "build")
        assert before.items() <= after.items()
        assert len([name for name in after if name.endswith((".bin", ".png"))]) == 5

    def test_a_copy_that_was_edited(self, here: Path) -> None:
        bake("build/hero.gltf")
        Path("build", PICTURE).write_bytes(b"painted over")
        EDITS["both"](1)
        bake("build/hero.gltf")
        assert Path("build", PICTURE).read_bytes() == b"painted over"

    def test_a_document_that_names_no_file_of_ours_is_no_hindrance(self, here: Path) -> None:
        """It has an image of that name in itself, and a file of that name in another folder."""
        other = {
            "asset": {"version": "2.0"},
            "images": [{"name": "skin #1.png", "bufferView": 0}, {"uri": "other/skin%20%231.png"}],
        }
        for folder in ("build", "clean"):
            Path(folder).mkdir()
            Path(folder, "other.gltf").write_text(json.dumps(other), encoding="utf-8")
        bake("build/hero.gltf")
        EDITS["both"](1)
        for folder in ("build", "clean"):
            bake(f"{folder}/hero.gltf")
        assert files(here / "build") == files(here / "clean")

    @pytest.mark.slow
    @pytest.mark.skipif(sys.platform == "win32", reason="no FIFOs")
    @pytest.mark.parametrize("target", ["hero.gltf", "hero.glb"])
    def test_models_beside_the_target_are_not_opened(self, target: str, here: Path) -> None:
        """A FIFO took for ever, and a large file all memory."""
        bake(f"build/{target}")
        names = [path.name[:18] for path in Path("build").iterdir() if path.name.startswith("skinbake-")]
        begin = (names or ["skinbake-01234567-"])[0]
        stranger = [
            f"{one}/{name}" for one in ("build", "build/skins") for name in ("a.glb", "b.gltf", "c.vrm")
        ]
        stranger += [f"build/{begin}0123456789abcdef.bin"]
        large = ["build/d.gltf", "build/e.glb", f"build/{begin}fedcba9876543210.bin"]
        for name in stranger:
            os.mkfifo(name)
        for name in large:
            with Path(name).open("wb") as file:
                file.truncate(1 << 40)
        EDITS["both"](1)
        bake(f"build/{target}", "--weighting", "area", "--max-memory", "300M", "--timeout", "60")
        for name in (*stranger, *large):
            Path(name).unlink()
        bake(f"clean/{target}", "--weighting", "area")
        assert files(here / "build") == files(here / "clean")

    @pytest.mark.parametrize("link", ["symbolic", "hard"])
    def test_a_link_in_place_of_a_copy(self, link: str, here: Path) -> None:
        bake("build/hero.gltf")
        shutil.copyfile(Path("build", PICTURE), "mine.png")
        Path("build", PICTURE).unlink()
        if link == "symbolic":
            Path("build", PICTURE).symlink_to(here / "mine.png")
        else:
            os.link("mine.png", Path("build", PICTURE))
        before = Path("mine.png").read_bytes()
        EDITS["both"](1)
        bake("build/hero.gltf")
        assert Path("mine.png").read_bytes() == before

    @pytest.mark.parametrize("named", ["precious.bin", "skinbake-0123456789abcdef.bin", "../mine.bin"])
    def test_a_former_output_that_names_files_of_the_user(self, named: str, here: Path) -> None:
        (here / "build").mkdir()
        (here / "build" / named).write_bytes(b"mine")
        bake("build/hero.gltf")
        content = json.loads(Path("build/hero.gltf").read_text("utf-8"))
        content["buffers"].append({"uri": named, "byteLength": 4})
        Path("build/hero.gltf").write_text(json.dumps(content), encoding="utf-8")
        EDITS["both"](1)
        bake("build/hero.gltf")
        assert (here / "build" / named).read_bytes() == b"mine"

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "text",
        [
            "",
            "no JSON",
            "[" * 100_000,
            "[]",
            "{}",
            '{"kind": "skinbake copies/2"}',
            '{"kind": 1, "files": {}}',
        ],
    )
    def test_notes_that_are_none(self, text: str, here: Path) -> None:
        (here / "build").mkdir()
        Path("build", NOTES).write_text(text, encoding="utf-8")
        bake("build/hero.gltf")
        EDITS["both"](1)
        bake("build/hero.gltf")
        assert Path("build", NOTES).read_text("utf-8") == text

    def test_notes_of_a_file_with_other_content(self, here: Path) -> None:
        bake("build/hero.gltf")
        notes = json.loads(Path("build", NOTES).read_text("utf-8"))
        one = notes["files"][SHARED_BIN]
        for name in ("precious.bin", "../precious.bin"):
            notes["files"][name] = one
            (here / "build" / name).write_bytes(b"mine")
        Path("build", NOTES).write_text(json.dumps(notes), encoding="utf-8")
        EDITS["both"](1)
        bake("build/hero.gltf")
        for name in ("precious.bin", "../precious.bin"):
            assert (here / "build" / name).read_bytes() == b"mine"


def data_of(folder: Path) -> list[str | bytes]:
    """Return the content of each file that the document of a folder names. None is missing."""
    content = json.loads((folder / "hero.gltf").read_text("utf-8"))
    uris = [one["uri"] for one in [*content["buffers"], *content["images"]]]
    return [uri if uri.startswith("data:") else (folder / unquote(uri)).read_bytes() for uri in uris]


class Stopped(BaseException):
    """The process ends here."""


class TestInterrupted:
    @pytest.mark.slow
    def test_between_any_two_steps_the_output_is_whole(
        self, here: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """After each rename and each removal the process ends; then a bake leaves a clean build."""
        bake("build/hero.gltf")
        EDITS["both"](1)
        shutil.copytree("build", "first")
        old = data_of(here / "build")
        clean()
        new = data_of(here / "clean")
        for step in range(100):
            shutil.rmtree("build")
            shutil.copytree("first", "build")
            if not stopped_after(step, monkeypatch):
                break
            assert data_of(here / "build") in (old, new), step
            bake("build/hero.gltf")
            left = {n: d for n, d in files(here / "build").items() if ".tmp" not in n}
            assert left == clean(), step
        else:
            pytest.fail("it never ended")
        assert step > 8


def stopped_after(step: int, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Bake in this process, which ends after some calls that change names. Return whether it ended so."""
    left = step

    def counted(call: Callable[..., Any]) -> Callable[..., Any]:
        def counts(*arguments: Any, **named: Any) -> Any:
            nonlocal left
            if left == 0:
                raise Stopped
            left -= 1
            return call(*arguments, **named)

        return counts

    with monkeypatch.context() as patch:
        for name in ("replace", "link", "unlink", "rename"):
            patch.setattr(os, name, counted(getattr(os, name)))
        try:
            invoke("bake", "art/hero.gltf", "-o", "build/hero.gltf", "--no-sync")
        except Stopped:
            return True
        return left == 0


MAKEFILE = """
all: {all}
-include build/hero.gltf.d build/prop.gltf.d
build/%.gltf: art/%.gltf
\t@{python} -m skinbake bake -q $< -o $@ --depfile $@.d
"""

NINJA = """
rule bake
  command = {python} -m skinbake bake -q $in -o $out --depfile $out.d
  depfile = $out.d
  deps = gcc
build build/hero.gltf: bake art/hero.gltf
build build/prop.gltf: bake art/prop.gltf
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the rules are for a shell")
@pytest.mark.parametrize("tool", ["make", "ninja"])
def test_builds_by_real_tools(tool: str, here: Path) -> None:
    program = required_program(tool)
    outputs = "build/hero.gltf build/prop.gltf"
    Path("Makefile").write_text(MAKEFILE.format(all=outputs, python=sys.executable), encoding="utf-8")
    Path("build.ninja").write_text(NINJA.format(python=sys.executable), encoding="utf-8")
    subprocess.run([program], check=True, capture_output=True)
    for number, what in enumerate(["buffer", "picture", "both", "buffer"], 1):
        EDITS[what](number)
        subprocess.run([program], check=True, capture_output=True)
    for name in ("hero.gltf", PLAIN):
        bake(f"clean/{name}", source=f"art/{name}")
    assert files(here / "build") == files(here / "clean")
