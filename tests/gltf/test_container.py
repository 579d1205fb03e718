"""From one container to the other, and into other folders: every byte and every URI still found."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from fixtures.builder import JsonObject, pack_glb
from skinbake.commands.strip import strip_file
from skinbake.errors import OutputError
from skinbake.gltf.writing.beside import files_of_extensions
from skinbake.gltf.writing.copies import NAME as NOTES
from tests.support.baking import bake_file
from tests.support.command_line import invoke
from tests.support.gltf_reading import GltfFile, read
from tests.support.khronos import validate
from tests.support.models import (
    FOLDER,
    SHARED,
    SHARED_BIN,
    assert_buffers_kept,
    assert_only_added,
    bake,
    baked,
    copied,
    edited,
    rewritten,
    without_additions,
)

ALPHA = "_SKINBAKE_ALPHA_0"
PNG = b"\x89PNG\r\n\x1a\n"
ONE_PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


def names(folder: Path) -> list[str]:
    """Return the files of a folder, without the notes of copies."""
    found = (path for path in folder.rglob("*") if path.is_file() and path.name != NOTES)
    return sorted(path.relative_to(folder).as_posix() for path in found)


def uris(content: JsonObject, array: str = "buffers") -> list[str | None]:
    return [entry.get("uri") for entry in content.get(array, [])]


def with_image(folder: Path, uri: str, file: str | None, name: str = SHARED) -> Path:
    """Copy a fixture and add an image of this URI, in this file (none for None)."""
    path = edited(name, folder, lambda content: content.setdefault("images", []).append({"uri": uri}))
    if file is not None:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(PNG + file.encode())
    return path


def assert_same_accessors(before: GltfFile, after: GltfFile) -> None:
    """Check that every accessor of the first file has the same values in the second, at the same number."""
    for number, accessor in enumerate(before.content["accessors"]):
        assert after.content["accessors"][number]["count"] == accessor["count"]
        assert np.array_equal(before.stored(number), after.stored(number))


def embed(content: JsonObject, folder: Path) -> None:
    """Make data: URIs of all buffers, and add three images, of which one is broken."""
    for buffer in content["buffers"]:
        data = (folder / unquote(buffer["uri"])).read_bytes() if "," not in buffer["uri"] else None
        if data is not None:
            buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    image = base64.b64encode(ONE_PIXEL).decode()
    content["images"] = [
        {"name": "a", "uri": f"data:image/png;base64,{image}"},
        {"uri": "data:image/png;base64,*"},
        {"uri": "data:image/webp;base64,UklGRg=="},
    ]


class TestEmbedded:
    @pytest.fixture
    def source(self, tmp_path: Path) -> Path:
        copied(SHARED, tmp_path / "from")
        return edited(SHARED, tmp_path / "in", lambda content: embed(content, tmp_path / "from"))

    def test_embedded_buffers_and_images_go_into_the_bin_chunk(self, source: Path, tmp_path: Path) -> None:
        before, after = read(source), baked(source, tmp_path / "out.glb")
        assert len(before.content["buffers"]) == 2
        assert uris(after.content) == [None]
        assert uris(after.content, "images") == [None, "data:image/png;base64,*", None]
        first, _, last = after.content["images"]
        assert (first["name"], first["mimeType"], last["mimeType"]) == ("a", "image/png", "image/webp")
        view = after.content["bufferViews"][first["bufferView"]]
        start = view.get("byteOffset", 0)
        assert (after.binary_chunk or b"")[start : start + view["byteLength"]] == ONE_PIXEL
        assert_same_accessors(before, after)
        assert after.has_attribute(ALPHA)

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "options",
        [
            "",
            "--encoding packed8 --layout custom",
            "--correctives auto",
            "--compress meshopt",
            "--compress draco",
        ],
    )
    def test_an_embedded_gltf_stays_one_file(self, options: str, tmp_path: Path) -> None:
        model = read(FOLDER / "bent_tube.glb")
        data = base64.b64encode(model.buffer(0)).decode()
        model.content["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
        folder = tmp_path / "tube"
        folder.mkdir()
        source = rewritten(model, folder / "tube.gltf")
        given = source.read_bytes()
        target = tmp_path / "out" / "tube.gltf"
        target.parent.mkdir()
        for path, given_as in ((target, ("-o", target)), (source, ("--in-place",))):
            result = invoke("bake", source, *given_as, *options.split())
            assert result.exit_code == 0, result.stderr
            assert names(path.parent) == ["tube.gltf"]
            assert all(uri is None or uri.startswith("data:") for uri in uris(read(path).content))
            assert invoke("verify", path).exit_code == 0
        assert source.read_bytes() == target.read_bytes()
        assert invoke("strip", "--in-place", source).exit_code == 0
        assert names(folder) == ["tube.gltf"]
        if "compress" not in options:
            assert source.read_bytes() == given

    def test_strip_keeps_them_there(self, source: Path, tmp_path: Path) -> None:
        bake(source, tmp_path / "a.glb")
        strip_file(str(source), str(tmp_path / "b.glb"))
        strip_file(str(tmp_path / "a.glb"), str(tmp_path / "c.glb"))
        assert (tmp_path / "b.glb").read_bytes() == (tmp_path / "c.glb").read_bytes()

    @pytest.mark.slow
    def test_the_validator_finds_no_data_uri_in_the_glb(self, source: Path, tmp_path: Path) -> None:
        model = read(source)
        del model.content["images"][1:]
        path = rewritten(model, source)
        bake(path, tmp_path / "out.glb")
        report = validate(tmp_path / "out.glb")
        assert not report["errors"]
        assert "DATA_URI_GLB" not in {finding.code for finding in report["warnings"]}


class TestGltfToGlb:
    def test_the_first_buffer_becomes_the_bin_chunk(self, tmp_path: Path) -> None:
        def move(content: JsonObject) -> None:
            content["buffers"][1]["uri"] = "more.bin"

        source = edited(SHARED, tmp_path / "in", move)
        (source.parent / "more.bin").write_bytes(read(FOLDER / SHARED).buffer(1))
        before, after = read(source), baked(source, tmp_path / "out.glb")
        expected = json.loads(json.dumps(before.content))
        del expected["buffers"][0]["uri"]
        assert json.dumps(without_additions(expected, after.content)) == json.dumps(expected)
        assert (after.binary_chunk or b"").startswith((FOLDER / SHARED_BIN).read_bytes())
        assert_buffers_kept(before, after)
        assert names(tmp_path) == ["in/more.bin", f"in/{SHARED_BIN}", f"in/{SHARED}", "more.bin", "out.glb"]

    def test_alpha_and_beta_are_those_of_the_gltf(self, tmp_path: Path) -> None:
        source = copied(SHARED, tmp_path / "in")
        first, second = baked(source, tmp_path / "out.gltf"), baked(source, tmp_path / "out.glb")
        for part in range(2):
            assert (first.attribute(ALPHA, 0, part) == second.attribute(ALPHA, 0, part)).all()

    def test_further_buffer_files_are_copied_along(self, tmp_path: Path) -> None:
        def move(content: JsonObject) -> None:
            content["buffers"][1]["uri"] = "more.bin"

        indices = read(FOLDER / SHARED).buffer(1)
        source = edited(SHARED, tmp_path / "in", move)
        (source.parent / "more.bin").write_bytes(indices)
        (tmp_path / "out").mkdir()
        after = baked(source, tmp_path / "out" / "model.glb")
        assert uris(after.content) == [None, "more.bin"]
        assert names(tmp_path / "out") == ["model.glb", "more.bin"]
        assert after.buffer(1) == indices

    def test_the_binary_is_padded_and_its_length_kept(self, tmp_path: Path) -> None:
        """Where nothing is baked, the buffer keeps a length that is no multiple of four."""
        content = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 5, "uri": "data:;base64,AQIDBAU="}],
        }
        (tmp_path / "five.gltf").write_text(json.dumps(content), encoding="utf-8")
        bake(tmp_path / "five.gltf", tmp_path / "five.glb")
        after = read(tmp_path / "five.glb")
        assert after.content["buffers"] == [{"byteLength": 5}]
        assert after.binary_chunk == b"\x01\x02\x03\x04\x05\0\0\0"

    def test_a_document_without_buffers_has_no_bin_chunk(self, tmp_path: Path) -> None:
        (tmp_path / "empty.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="utf-8")
        bake(tmp_path / "empty.gltf", tmp_path / "empty.glb")
        assert read(tmp_path / "empty.glb").binary_chunk is None
        assert read(tmp_path / "empty.glb").content == {"asset": {"version": "2.0"}}

    def test_vrm_is_a_glb(self, tmp_path: Path) -> None:
        copied("seam.glb", tmp_path).rename(tmp_path / "avatar.vrm")
        bake(tmp_path / "avatar.vrm", tmp_path / "baked.vrm")
        bake(copied("seam.glb", tmp_path), tmp_path / "baked.glb")
        assert (tmp_path / "baked.vrm").read_bytes() == (tmp_path / "baked.glb").read_bytes()


class TestGlbToGltf:
    def test_the_bin_chunk_becomes_a_file_named_after_the_target(self, tmp_path: Path) -> None:
        before, after = read(FOLDER / "seam.glb"), baked(FOLDER / "seam.glb", tmp_path / "my model.gltf")
        first, second = uris(after.content)
        assert first == "my%20model.bin"
        assert names(tmp_path) == sorted(["my model.bin", "my model.gltf", str(second)])
        assert (tmp_path / "my model.bin").read_bytes() == before.binary_chunk
        expected = json.loads(json.dumps(before.content))
        expected["buffers"][0]["uri"] = first
        assert json.dumps(without_additions(expected, after.content)) == json.dumps(expected)

    def test_the_file_ends_where_the_buffer_does(self, tmp_path: Path) -> None:
        """The BIN chunk's padding is the container's, not the buffer's."""
        content = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 5}]}
        (tmp_path / "five.glb").write_bytes(pack_glb(content, b"12345"))
        bake(tmp_path / "five.glb", tmp_path / "five.gltf")
        assert (tmp_path / "five.bin").read_bytes() == b"12345"

    def test_glb_to_gltf_and_back_is_the_same_document(self, tmp_path: Path) -> None:
        bake(FOLDER / "seam.glb", tmp_path / "model.gltf")
        strip_file(str(tmp_path / "model.gltf"), str(tmp_path / "back.glb"))
        before, after = read(FOLDER / "seam.glb"), read(tmp_path / "back.glb")
        assert json.dumps(after.content) == json.dumps(before.content)
        assert after.binary_chunk == before.binary_chunk

    def test_baking_twice_is_baking_once(self, tmp_path: Path) -> None:
        bake(FOLDER / "foreign_joints.glb", tmp_path / "model.gltf")
        before = {name: (tmp_path / name).read_bytes() for name in names(tmp_path)}
        bake(tmp_path / "model.gltf", tmp_path / "model.gltf")
        assert {name: (tmp_path / name).read_bytes() for name in names(tmp_path)} == before

    def test_an_existing_bin_of_that_name_is_not_overwritten(self, tmp_path: Path) -> None:
        (tmp_path / "model.bin").write_bytes(b"somebody's")
        after = baked(FOLDER / "seam.glb", tmp_path / "model.gltf")
        assert (tmp_path / "model.bin").read_bytes() == b"somebody's"
        first = uris(after.content)[0]
        assert first is not None
        assert first.startswith("model-")
        assert after.buffer(0) == read(FOLDER / "seam.glb").binary_chunk

    def test_an_existing_bin_of_the_same_content_serves(self, tmp_path: Path) -> None:
        (tmp_path / "model.bin").write_bytes(read(FOLDER / "seam.glb").binary_chunk or b"")
        stamp = (tmp_path / "model.bin").stat().st_mtime_ns
        after = baked(FOLDER / "seam.glb", tmp_path / "model.gltf")
        assert uris(after.content)[0] == "model.bin"
        assert (tmp_path / "model.bin").stat().st_mtime_ns == stamp

    @pytest.mark.parametrize("folder", ["in", "out"])
    def test_a_second_buffer_of_that_name_is_not_confused_with_it(self, folder: str, tmp_path: Path) -> None:
        """The GLB's second buffer is the file whose name the BIN chunk would get."""
        model = read(FOLDER / "seam.glb")
        model.content["buffers"].append({"byteLength": 8, "uri": "model.bin"})
        for place in ("in", "out"):
            (tmp_path / place).mkdir()
        source = rewritten(model, tmp_path / "in" / "source.glb")
        (tmp_path / "in" / "model.bin").write_bytes(b"original")
        after = baked(source, tmp_path / folder / "model.gltf")
        assert after.buffer(1)[:8] == b"original"
        assert after.buffer(0)[: len(model.binary_chunk or b"")] == model.binary_chunk
        assert (tmp_path / "in" / "model.bin").read_bytes() == b"original"

    def test_what_a_gltf_cannot_hold_is_said(self, tmp_path: Path) -> None:
        data = (FOLDER / "seam.glb").read_bytes()
        chunk = struct.pack("<I4s4s", 4, b"XTRA", b"abcd")
        path = tmp_path / "odd.glb"
        path.write_bytes(data[:8] + struct.pack("<I", len(data) + 12) + data[12:] + chunk + b"tail")
        result = bake(path, tmp_path / "out.gltf")
        (notice,) = result.notices
        assert notice.code == "chunks-dropped"
        assert "1 GLB chunk of unknown type and 4 trailing bytes have no place" in notice.message

    def test_a_bin_chunk_that_no_buffer_means_is_not_lost_in_silence(self, tmp_path: Path) -> None:
        model = read(FOLDER / "seam.glb")
        (tmp_path / "body.bin").write_bytes(model.binary_chunk or b"")
        model.content["buffers"][0]["uri"] = "body.bin"
        path = tmp_path / "odd.glb"
        path.write_bytes(pack_glb(model.content, b"UNKNOWN!"))
        assert [notice.code for notice in bake(path, tmp_path / "out.gltf").notices] == ["chunks-dropped"]


class TestAnotherFolder:
    def test_buffers_and_images_come_along(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "textures/skin%20%C3%A4.png", "textures/skin ä.png")
        (tmp_path / "out").mkdir()
        after = baked(source, tmp_path / "out" / "model.gltf")
        assert names(tmp_path / "out") == sorted(
            ["model.gltf", SHARED_BIN, str(uris(after.content)[2]), "textures/skin ä.png"]
        )
        assert (tmp_path / "out/textures/skin ä.png").read_bytes() == PNG + "textures/skin ä.png".encode()
        assert_only_added(read(source), after)

    def test_a_glb_takes_its_images_along_too(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "skin.png", "skin.png", "seam.glb")
        (tmp_path / "out").mkdir()
        after = baked(source, tmp_path / "out" / "model.glb")
        assert names(tmp_path / "out") == ["model.glb", "skin.png"]
        assert_only_added(read(source), after)

    def test_a_file_of_the_encoded_name_comes_along_under_that_name(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "a%20b.png", "a%20b.png")
        (tmp_path / "out").mkdir()
        baked(source, tmp_path / "out" / "model.gltf")
        assert "a%20b.png" in names(tmp_path / "out")

    def test_existing_files_of_other_content_are_left_alone(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "skin%20a.png", "skin a.png")
        (tmp_path / "out").mkdir()
        for name in (SHARED_BIN, "skin a.png"):
            (tmp_path / "out" / name).write_bytes(b"somebody's")
        after = baked(source, tmp_path / "out" / "model.gltf")
        for name in (SHARED_BIN, "skin a.png"):
            assert (tmp_path / "out" / name).read_bytes() == b"somebody's"
        assert_buffers_kept(read(source), after)
        (image,) = uris(after.content, "images")
        assert image is not None
        assert image.startswith("skin%20a-")
        assert (tmp_path / "out" / image.replace("%20", " ")).read_bytes() == PNG + b"skin a.png"

    @pytest.mark.parametrize("there", [None, b"the old output", PNG + b"out.gltf"])
    def test_an_image_with_the_name_of_the_target_gets_another_name(
        self, there: bytes | None, tmp_path: Path
    ) -> None:
        source = with_image(tmp_path / "in", "out.gltf", "out.gltf")
        (tmp_path / "out").mkdir()
        if there is not None:
            (tmp_path / "out" / "out.gltf").write_bytes(there)
        after = baked(source, tmp_path / "out" / "out.gltf")
        (image,) = uris(after.content, "images")
        digest = hashlib.sha256(PNG + b"out.gltf").hexdigest()[:16]
        assert image == f"out-{digest}.gltf"
        assert (tmp_path / "out" / image).read_bytes() == PNG + b"out.gltf"
        assert_buffers_kept(read(source), after)
        once = names(tmp_path / "out")
        assert uris(baked(source, tmp_path / "out" / "out.gltf").content, "images") == [image]
        assert names(tmp_path / "out") == once

    @pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
    def test_a_link_to_the_target_does_not_serve(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "skin.png", "skin.png")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "model.gltf").write_bytes(PNG + b"skin.png")
        (tmp_path / "out" / "skin.png").symlink_to("model.gltf")
        after = baked(source, tmp_path / "out" / "model.gltf")
        (image,) = uris(after.content, "images")
        assert (tmp_path / "out" / str(image)).read_bytes() == PNG + b"skin.png"

    def test_a_literal_name_is_encoded_if_its_decoded_form_is_the_target(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "a%20b.gltf", "a%20b.gltf")
        (tmp_path / "out").mkdir()
        after = baked(source, tmp_path / "out" / "a b.gltf")
        assert uris(after.content, "images") == ["a%2520b.gltf"]
        assert (tmp_path / "out" / "a%20b.gltf").read_bytes() == PNG + b"a%20b.gltf"

    def test_existing_files_of_the_same_content_serve(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "skin.png", "skin.png")
        (tmp_path / "out").mkdir()
        bake(source, tmp_path / "out" / "model.gltf")
        before = names(tmp_path / "out")
        stamps = [(tmp_path / "out" / name).stat().st_mtime_ns for name in (SHARED_BIN, "skin.png")]
        bake(source, tmp_path / "out" / "model.gltf")
        assert names(tmp_path / "out") == before
        assert [(tmp_path / "out" / name).stat().st_mtime_ns for name in (SHARED_BIN, "skin.png")] == stamps

    @pytest.mark.parametrize("uri", ["../textures/skin.png", "sub/../../textures/skin.png"])
    @pytest.mark.parametrize("target", ["out/deep", "in/deep", "."])
    def test_uris_that_lead_out_of_the_folder_are_rewritten(
        self, uri: str, target: str, tmp_path: Path
    ) -> None:
        source = with_image(tmp_path / "in", uri, "../textures/skin.png")
        (tmp_path / "in" / "sub").mkdir()
        (tmp_path / target).mkdir(parents=True, exist_ok=True)
        after = baked(source, tmp_path / target / "model.gltf")
        (image,) = uris(after.content, "images")
        assert image is not None
        found = tmp_path / target / image
        assert found.samefile(tmp_path / "textures" / "skin.png")
        assert names(tmp_path).count("textures/skin.png") == 1

    @pytest.mark.parametrize("uri", ["tex/../skin.png", "./skin.png", "tex/./../tex/../skin.png"])
    def test_a_way_around_inside_the_folder_is_still_a_way(self, uri: str, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", uri, "skin.png")
        (tmp_path / "in" / "tex").mkdir()
        (tmp_path / "out").mkdir()
        after = baked(source, tmp_path / "out" / "model.gltf")
        (image,) = uris(after.content, "images")
        # A reader of URIs resolves the dots before it asks the disk (RFC 3986, §5.2.4).
        found = Path(os.path.normpath(tmp_path / "out" / str(image)))
        assert found.read_bytes() == PNG + b"skin.png"

    def test_two_models_with_buffers_of_one_name_share_a_folder(self, tmp_path: Path) -> None:
        """As many exporters write them: scene.gltf and scene.bin, one pair a folder."""
        (tmp_path / "out").mkdir()
        models = []
        for name in ("seam.glb", "hard_edge.glb"):
            source = tmp_path / name[:-4] / name.replace(".glb", ".gltf")
            source.parent.mkdir()
            model = read(FOLDER / name)
            model.content["buffers"][0]["uri"] = "scene.bin"
            (source.parent / "scene.bin").write_bytes(model.binary_chunk or b"")
            rewritten(model, source)
            baked(source, tmp_path / "out" / source.name)
            models.append(source)
        for source in models:
            assert_buffers_kept(read(source), read(tmp_path / "out" / source.name))
        assert len(names(tmp_path / "out")) == 6

    def test_missing_images_are_counted_and_the_bake_goes_on(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "gone.png", None)
        (tmp_path / "out").mkdir()
        result = bake(source, tmp_path / "out" / "model.gltf")
        (notice,) = result.notices
        assert (notice.code, notice.count) == ("file-missing", 1)
        assert "gone.png" in notice.message

    def test_uris_that_name_no_file_are_counted_and_the_first_is_told(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "/one.png", None)
        (tmp_path / "out").mkdir()
        [alone] = bake(source, tmp_path / "out" / "one.gltf").notices
        assert alone.message == (
            '1 URI names no file beside it, and stays as it is: "/one.png": it is an absolute path'
        )
        model = read(source)
        model.content["images"].append({"uri": "/two.png"})
        [both] = bake(rewritten(model, source), tmp_path / "out" / "two.gltf").notices
        assert both.message == (
            "2 URIs name no file beside it, and stay as they are. The first is "
            '"/one.png": it is an absolute path'
        )

    @pytest.mark.parametrize(
        "uri", ["x" * 300 + ".png", "%00.png", "nul\0.png", "\ud800.png", "folder", "%2Fetc/x"]
    )
    def test_an_image_that_cannot_be_a_file_stops_nothing(self, uri: str, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", uri, None)
        (tmp_path / "in" / "folder").mkdir()
        (tmp_path / "out").mkdir()
        result = bake(source, tmp_path / "out" / "model.gltf")
        assert result.status == "baked"

    @pytest.mark.parametrize("uri", ["https://example.org/a.png", "data:image/png;base64,iVBORw0KGgo="])
    def test_uris_that_name_no_file_stay(self, uri: str, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", uri, None)
        (tmp_path / "out").mkdir()
        after = baked(source, tmp_path / "out" / "model.gltf")
        assert uris(after.content, "images") == [uri]

    def test_strip_brings_what_it_needs_and_no_more(self, tmp_path: Path) -> None:
        source = with_image(tmp_path / "in", "skin.png", "skin.png")
        bake(source, source)
        (tmp_path / "out").mkdir()
        strip_file(str(source), str(tmp_path / "out" / "model.gltf"))
        assert names(tmp_path / "out") == ["model.gltf", SHARED_BIN, "skin.png"]


class TestFilesOfExtensions:
    """Files that only extensions name stay where they are, and a notice says so."""

    @staticmethod
    def source(folder: Path) -> Path:
        def change(content: JsonObject) -> None:
            sounds: list[JsonObject] = [
                {"uri": "step.mp3"},
                {"uri": "data:audio/mpeg;base64,AA=="},
                {"uri": "step.mp3"},
            ]
            sounds += [{"uri": "https://example.org/a.mp3", "extras": {"uri": "note.txt"}}, {"uri": 3}]
            content["nodes"][0]["extensions"] = {"EXT_lights_ies": {"light": {"uri": "lamps/a%20b.ies"}}}
            content["extensions"] = {"KHR_audio_emitter": {"audio": sounds}, "X": {"b": [{"uri": "x"}]}}
            content["extensions"]["Y"] = {"uri": "y"}
            content["extras"] = {"uri": "mine.txt", "extensions": {"X": {"uri": "mine too.txt"}}}
            content["asset"]["uri"] = "no reference"

        return edited("seam.glb", folder, change)

    @pytest.mark.parametrize(
        ("target", "pack", "what"),
        [
            ("out/hero.glb", False, "not copied"),
            ("out/hero.gltf", False, "not copied"),
            ("out/hero.glb", True, "neither packed nor copied"),
            ("in/hero.glb", True, "not packed"),
            ("in/hero.glb", False, None),
        ],
    )
    def test_files_of_extensions_that_do_not_come_along_are_named(
        self, target: str, pack: bool, what: str | None, tmp_path: Path
    ) -> None:
        source = self.source(tmp_path / "in")
        before = read(source).content
        (tmp_path / "in" / "step.mp3").write_bytes(b"sound")
        result = bake(source, tmp_path / target, pack=pack)
        told = [(notice.code, notice.count, notice.message) for notice in result.notices]
        first = "lamps/a%20b.ies, step.mp3, x"
        message = f"4 files that its extensions name are {what}, and their URIs stay as they are: {first}, …"
        assert told == ([("uri-not-copied", 4, message)] if what else [])
        after = read(tmp_path / target).content
        assert all(after[key] == before[key] for key in ("extensions", "extras"))
        assert not (tmp_path / "out" / "step.mp3").exists()

    def test_files_of_extensions_are_found_at_any_depth(self) -> None:
        deep: JsonObject = {"uri": "deep.bin"}
        for _ in range(10_000):
            deep = {"inner": [deep]}
        assert files_of_extensions({"extensions": {"X": deep}}) == ["deep.bin"]

    def test_strip_names_them_too(self, tmp_path: Path) -> None:
        content = {"X": {"uri": "x.txt"}}
        source = edited("seam.glb", tmp_path / "in", lambda model: model.update(extensions=content))
        bake(source, source)
        (tmp_path / "out").mkdir()
        (notice,) = strip_file(str(source), str(tmp_path / "out" / "seam.glb")).notices
        assert (notice.code, notice.message) == (
            "uri-not-copied",
            "1 file that its extensions name is not copied, and its URI stays as it is: x.txt",
        )


class TestSameFolder:
    def test_a_bake_to_the_same_folder_copies_nothing_and_keeps_every_uri(self, tmp_path: Path) -> None:
        source = with_image(tmp_path, "../elsewhere/gone.png", None)
        before, after = read(source), baked(source, tmp_path / "baked.gltf")
        assert_only_added(before, after)
        assert bake(source, tmp_path / "baked.gltf").notices == ()

    def test_the_target_may_not_be_a_file_of_the_input(self, tmp_path: Path) -> None:
        source = with_image(tmp_path, "texture.glb", "texture.glb")
        with pytest.raises(OutputError, match="a file of the input"):
            bake_file(str(source), str(tmp_path / "texture.glb"))
        assert (tmp_path / "texture.glb").read_bytes() == PNG + b"texture.glb"

    def test_strip_does_not_write_over_a_file_of_the_input(self, tmp_path: Path) -> None:
        source = with_image(tmp_path, "texture.glb", "texture.glb")
        with pytest.raises(OutputError, match="a file of the input"):
            strip_file(str(source), str(tmp_path / "texture.glb"))
        assert (tmp_path / "texture.glb").read_bytes() == PNG + b"texture.glb"


class TestStandardStreams:
    def run(self, *arguments: str, data: bytes = b"") -> subprocess.CompletedProcess[bytes]:
        command = [sys.executable, "-m", "skinbake", *arguments]
        return subprocess.run(command, input=data, capture_output=True, check=False)

    @pytest.mark.slow
    def test_a_glb_flows_through(self, tmp_path: Path) -> None:
        process = self.run("bake", "-", "-o", "-", data=(FOLDER / "seam.glb").read_bytes())
        bake(FOLDER / "seam.glb", tmp_path / "baked.glb")
        assert (process.returncode, process.stdout) == (0, (tmp_path / "baked.glb").read_bytes())
        assert process.stderr.decode().startswith("-: baked: 1 primitive")
        back = self.run("strip", "-", "-o", "-", data=process.stdout)
        assert (back.returncode, back.stdout) == (0, (FOLDER / "seam.glb").read_bytes())

    @pytest.mark.slow
    def test_a_gltf_becomes_one_glb_with_everything_inside(self, tmp_path: Path) -> None:
        def move(content: JsonObject) -> None:
            content["buffers"][1]["uri"] = "more.bin"
            content["images"] = [{"uri": "skin.png"}, {"uri": "data:image/png;base64,"}]

        source = edited(SHARED, tmp_path / "in", move)
        (source.parent / "more.bin").write_bytes(read(FOLDER / SHARED).buffer(1))
        before = read(source)
        process = self.run("bake", str(source), "-o", "-")
        assert process.returncode == 0
        (tmp_path / "out.glb").write_bytes(process.stdout)
        after = read(tmp_path / "out.glb")
        assert uris(after.content) == [None]
        assert uris(after.content, "images") == ["skin.png", "data:image/png;base64,"]
        assert_same_accessors(before, after)
        assert after.has_attribute(ALPHA)
        assert b"1 image is a file" in process.stderr

    @pytest.mark.slow
    def test_stdin_goes_into_a_file_of_either_kind(self, tmp_path: Path) -> None:
        data = (FOLDER / "seam.glb").read_bytes()
        for name in ("out.glb", "out.gltf"):
            process = self.run("bake", "-", "-o", str(tmp_path / name), data=data)
            assert process.returncode == 0, process.stderr
            assert read(tmp_path / name).has_attribute(ALPHA)

    @pytest.mark.slow
    @pytest.mark.parametrize("data", [b"", b"{}", b"glTF\x02\0\0\0\xff\0\0\0"])
    def test_what_is_no_glb_on_stdin_is_an_input_error(self, data: bytes) -> None:
        process = self.run("bake", "-", "-o", "-", data=data)
        assert (process.returncode, process.stdout) == (3, b"")
        assert process.stderr.startswith(b"error: <stdin>: ")


def test_a_model_read_back_is_a_model(tmp_path: Path) -> None:
    """The reader that these tests trust does not pass everything."""
    model = GltfFile(
        tmp_path / "a.glb", {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4}]}, b"abcd"
    )
    other = GltfFile(model.path, model.content, b"abcX")
    with pytest.raises(AssertionError):
        assert_buffers_kept(model, other)
