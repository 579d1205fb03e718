"""Reading documents: refusals, and that untouched data is written as it was read."""

from __future__ import annotations

import io
import json
import struct
import sys
from pathlib import Path
from typing import Any

import pytest

from fixtures.builder import pack_glb
from skinbake import strip
from skinbake.errors import InputError, UnsupportedFeatureError, printable
from skinbake.gltf.document import Document, parse_glb, parse_gltf, read_document
from skinbake.gltf.writing.output import plan_output
from tests.support.models import FOLDER, KEY, SHARED, bake, copied, edited

ASSET = '"asset": {"version": "2.0"}'


def parse(text: str | bytes) -> Document:
    return parse_gltf(text if isinstance(text, bytes) else text.encode(), "model.gltf", Path())


@pytest.mark.parametrize("name", ["model.obj", "model", "model.glb.bak", "gltf"])
def test_an_unknown_suffix_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(f"{{{ASSET}}}")
    with pytest.raises(InputError, match=r"\.glb, \.gltf, \.vrm|OBJ is not glTF"):
        read_document(str(tmp_path / name))


@pytest.mark.parametrize("name", ["MODEL.GLB", "avatar.vrm", "avatar.VRM"])
def test_the_suffix_tells_a_glb_whatever_its_case(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes((FOLDER / "seam.glb").read_bytes())
    assert read_document(str(tmp_path / name)).is_glb


@pytest.mark.parametrize(
    "name", ["missing.glb", "missing/model.gltf", "folder.glb", "nul\0.glb", "x" * 300 + ".glb"]
)
def test_what_cannot_be_opened_is_an_input_error_that_names_it(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(InputError, match="cannot be read: ") as caught:
        read_document(str(tmp_path / name))
    assert str(caught.value).startswith(printable(str(tmp_path / name)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it is empty"),
        ("{", "cannot be parsed: it ends too early; the file may be cut short"),
        (f'{{{ASSET}, "a": "b', "cannot be parsed: it ends too early"),
        (f'{{{ASSET}, "a":\n', "cannot be parsed: it ends too early"),
        (b"{\xe9}", "cannot be parsed: its byte 1 is 0xe9, which is not UTF-8 text"),
        (f"{{{ASSET}}}\n trailing", "cannot be parsed: line 2, column 2: expected nothing after the last"),
        (f'{{{ASSET},\n "a": nul}}', "line 2, column 7: expected a value"),
        (f'{{{ASSET} "a": 1}}', "line 1, column 30: expected ',' delimiter"),
        (f'{{{ASSET}, "a": "\t"}}', "line 1, column 37: a control character in a text"),
        (f'{{{ASSET}, "a": NaN}}', "NaN is not valid JSON"),
        (f'{{{ASSET}, "a": -Infinity}}', "-Infinity is not valid JSON"),
        (f'{{{ASSET}, "a": {"[" * 100_000}{"]" * 100_000}}}', "cannot be parsed"),
        (f'{{{ASSET}, "a": {"1" * 5000}}}', "cannot be parsed"),
        ("[]", "not an object"),
        ("null", "not an object"),
        ("{}", '"asset.version" is missing'),
        ('{"asset": []}', '"asset" must be an object'),
        ('{"asset": {"version": 2.0}}', '"version" must be a string'),
        ('{"asset": {"version": "2.0", "minVersion": 2}}', '"minVersion" must be a string'),
        ("glTF\x02\0\0\0", r"name it \.glb"),
    ],
)
def test_what_is_no_gltf_is_refused(text: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse(text)
    assert str(caught.value).startswith("model.gltf: ")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "this is not glTF, but a PNG picture"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF\0", "a JPEG picture"),
        (b"Kaydara FBX Binary  \0\x1a\0", "FBX: Blender exports it as glTF"),
        (b"; FBX 7.3.0 project file\n", "FBX: Blender exports it as glTF"),
        (b"BLENDER-v300REND", "a file of Blender: export it"),
        (b"PK\x03\x04\x14\0\0\0\x08\0", "a ZIP archive: unpack it"),
        (b"version https://git-lfs.github.com/spec/v1\n", "fetch it with git lfs pull"),
        (b"<!DOCTYPE html>\n<html>", "a web page or XML"),
        (b"\xef\xbb\xbf\r\n\n<html><body>Not Found", "a web page or XML"),
        ('{"asset": {}}'.encode("utf-16"), "text in UTF-16"),
    ],
)
def test_a_file_of_another_kind_is_named(data: bytes, message: str) -> None:
    for parse_one, name in ((parse_gltf, "model.gltf"), (parse_glb, "model.glb")):
        with pytest.raises(InputError, match=message) as caught:
            parse_one(data, name, Path())
        assert str(caught.value).startswith(f"{name}: ")


def test_a_buffer_that_git_lfs_has_not_fetched_is_named(tmp_path: Path) -> None:
    """A .gltf is text, so that only its buffers are kept in Git LFS."""
    (tmp_path / "hero.bin").write_text(
        "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9999\n"
    )
    content = {"asset": {"version": "2.0"}, "buffers": [{"uri": "hero.bin", "byteLength": 9999}]}
    document = parse_gltf(json.dumps(content).encode(), "model.gltf", tmp_path)
    with pytest.raises(InputError) as caught:
        document.buffer(0)
    assert str(caught.value) == (
        'model.gltf: buffer 0, "hero.bin", is the pointer that Git LFS left in its place: '
        "fetch it with git lfs pull"
    )


@pytest.mark.parametrize("version", ["1.0", "1.1", "3.0", "", "20"])
def test_versions_of_gltf_but_2_0_are_unsupported(version: str) -> None:
    with pytest.raises(UnsupportedFeatureError, match=r'needs glTF version ".*"; only 2\.0'):
        parse(json.dumps({"asset": {"version": version}}))


@pytest.mark.parametrize("version", [0.8, 1, 1.0])
def test_the_number_of_an_old_version_is_told(version: float) -> None:
    """glTF 0.8 wrote a number. Text is wanted of version 2 only."""
    with pytest.raises(UnsupportedFeatureError, match=f'needs glTF version "{version}"; only 2'):
        parse(json.dumps({"asset": {"version": version}}))
    for other in (2, 2.0, True):
        with pytest.raises(InputError, match='"version" must be a string, found'):
            parse(json.dumps({"asset": {"version": other}}))


def test_a_newer_minimal_version_is_unsupported() -> None:
    with pytest.raises(UnsupportedFeatureError, match=r'version "2\.1"'):
        parse('{"asset": {"version": "2.1", "minVersion": "2.1"}}')
    assert parse('{"asset": {"version": "2.1", "minVersion": "2.0"}}').objects("meshes") == []


@pytest.mark.parametrize("value", ["{}", "3", '"text"', "[1]", "[{}, null]"])
def test_a_top_level_array_of_anything_but_objects_is_refused(value: str) -> None:
    document = parse(f'{{{ASSET}, "meshes": {value}}}')
    with pytest.raises(InputError, match='"meshes" must be an array of objects'):
        document.objects("meshes")


@pytest.mark.parametrize(
    ("buffer", "message"),
    [
        ({"byteLength": 4}, "no URI and there is no BIN chunk"),
        ({"byteLength": 5, "uri": "data:;base64,AAAAAA=="}, "declares 5 bytes, but only 4 are there"),
        ({"byteLength": 5, "uri": "data:;base64,AA=="}, "declares 5 bytes, but only 1 is there"),
        ({"byteLength": 0, "uri": "data:;base64,AAAAAA=="}, '"byteLength" must be'),
        ({"uri": "data:;base64,AAAAAA=="}, '"byteLength" must be'),
        ({"byteLength": True, "uri": "data:;base64,AAAAAA=="}, '"byteLength" must be'),
        ({"byteLength": 4, "uri": 4}, '"uri" must be a string'),
        ({"byteLength": 2**53, "uri": "data:;base64,AAAAAA=="}, "4 are there"),
        ({"byteLength": 10**30, "uri": "data:;base64,AAAAAA=="}, '"byteLength" must be'),
    ],
)
def test_a_buffer_without_its_bytes_is_refused(buffer: dict[str, Any], message: str) -> None:
    document = parse(json.dumps({"asset": {"version": "2.0"}, "buffers": [buffer]}))
    with pytest.raises(InputError, match=message):
        document.buffer(0)


def test_a_buffer_ends_where_it_says() -> None:
    uri = "data:;base64,AQIDBA=="
    buffers = [{"byteLength": 2, "uri": uri}]
    document = parse(json.dumps({"asset": {"version": "2.0"}, "buffers": buffers}))
    assert bytes(document.buffer(0)) == b"\x01\x02"


def test_only_the_first_buffer_of_a_glb_is_its_bin_chunk() -> None:
    content = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4}, {"byteLength": 4}]}
    document = parse_glb(pack_glb(content, b"data"), "model.glb", Path())
    assert bytes(document.buffer(0)) == b"data"
    with pytest.raises(InputError, match="buffer 1 has no URI"):
        document.buffer(1)


def test_a_glb_comes_from_stdin(monkeypatch: pytest.MonkeyPatch) -> None:
    data = (FOLDER / "seam.glb").read_bytes()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    document = read_document("-")
    assert (document.name, document.raw) == ("<stdin>", data)


@pytest.mark.parametrize("indent", [None, 1, 2, 4, "\t"])
def test_the_indentation_stays(tmp_path: Path, indent: int | str | None) -> None:
    source = copied(SHARED, tmp_path)
    content = json.loads(source.read_text(encoding="utf-8"))
    source.write_text(json.dumps(content, indent=indent), encoding="utf-8")
    bake(source, tmp_path / "baked.gltf")
    first, *lines = (tmp_path / "baked.gltf").read_text(encoding="utf-8").split("\n")
    if indent is None:
        assert lines == []
    else:
        assert first == "{"
        white = indent if isinstance(indent, str) else " " * indent
        assert lines[0].startswith(f'{white}"')


@pytest.mark.parametrize("name", ["seam.glb", SHARED])
@pytest.mark.parametrize("ascii_only", [False, True])
def test_escapes_of_names_stay(tmp_path: Path, name: str, ascii_only: bool) -> None:
    """Blender escapes names that are not ASCII; other tools do not."""
    source, is_glb = copied(name, tmp_path), name.endswith(".glb")
    data = source.read_bytes()
    start, end = (20, 20 + int.from_bytes(data[12:16], "little")) if is_glb else (0, len(data))
    content = json.loads(data[start:end])
    content["meshes"][0]["name"] = "日本 😀 Ärmel"
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=ascii_only).encode("utf-8")
    if is_glb:
        text += b" " * (-len(text) % 4)
        length = len(data) - end + 20 + len(text)
        text = struct.pack("<4sIII4s", b"glTF", 2, length, len(text), b"JSON") + text + data[end:]
    source.write_bytes(text)
    baked, restored = (tmp_path / f"{stem}{source.suffix}" for stem in ("baked", "restored"))
    bake(source, baked)
    strip(str(baked), str(restored))
    assert restored.read_bytes() == text


def test_numbers_and_strings_stay_what_they_were(tmp_path: Path) -> None:
    odd = {
        "integer": 1,
        "float": 1.0,
        "negative zero": -0.0,
        "small": 5e-324,
        "exact": 0.1,
        "long": 1234567890123456789012345678901234567890,
        "text": 'α "quoted" \\ \u2028 \x7f 😀',
        "": {"": None},
        "nested": [[], [{}], True, False],
    }
    source = edited(SHARED, tmp_path, lambda content: content["extras"].update(odd))
    bake(source, tmp_path / "baked.gltf")
    extras = json.loads((tmp_path / "baked.gltf").read_text(encoding="utf-8"))["extras"]
    assert json.dumps({key: extras[key] for key in odd}) == json.dumps(odd)


def test_lone_surrogates_are_written_as_escapes(tmp_path: Path) -> None:
    source = edited(SHARED, tmp_path, lambda content: content["extras"].update(odd="\ud800 α"))
    bake(source, tmp_path / "baked.gltf")
    assert b'"\\ud800 \\u03b1"' in (tmp_path / "baked.gltf").read_bytes()


def test_a_byte_order_mark_is_read_over(tmp_path: Path) -> None:
    source = copied(SHARED, tmp_path)
    source.write_bytes(b"\xef\xbb\xbf" + source.read_bytes())
    bake(source, tmp_path / "baked.gltf")
    assert KEY in (tmp_path / "baked.gltf").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [SHARED, "seam.glb"])
def test_a_document_that_nobody_edits_is_written_byte_for_byte(tmp_path: Path, name: str) -> None:
    source = copied(name, tmp_path)
    plan_output(read_document(str(source)), str(tmp_path / f"copy{source.suffix}")).write()
    assert (tmp_path / f"copy{source.suffix}").read_bytes() == source.read_bytes()
