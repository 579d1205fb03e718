"""What URIs stand for (RFC 2397 and 3986; glTF 2.0 specification, §2.8 and §3.6.1)."""

from __future__ import annotations

import base64
from pathlib import Path
from urllib.parse import unquote

import pytest

from skinbake.errors import InputError, Place
from skinbake.gltf.resources import decode_data_uri, encode_data_uri, is_relative, path_uri, read_resource

HERE = Place("model.gltf")
EVERY_BYTE = bytes(range(256))
BASE64 = base64.b64encode(EVERY_BYTE).decode()


@pytest.mark.parametrize(
    "uri",
    [
        f"data:application/octet-stream;base64,{BASE64}",
        f"data:;base64,{BASE64}",
        f"DATA:application/gltf-buffer;charset=x;BASE64,{BASE64}",
        "data:application/octet-stream;base64," + BASE64.replace("+", "%2B").replace("/", "%2f"),
        "data:application/octet-stream;base64," + BASE64.replace("=", "%3D"),
        "data:application/octet-stream," + "".join(f"%{byte:02X}" for byte in EVERY_BYTE),
        "data:," + "".join(f"%{byte:02x}" for byte in EVERY_BYTE),
    ],
)
def test_data_uris_hold_bytes_in_base64_or_percent_encoded(uri: str) -> None:
    assert decode_data_uri(uri, HERE) == EVERY_BYTE
    assert read_resource(uri, Path("nowhere"), HERE) == EVERY_BYTE


def test_plain_text_and_commas_in_a_data_uri_stand_for_themselves() -> None:
    assert decode_data_uri("data:text/plain,a,b%2Cc;base64", HERE) == b"a,b,c;base64"


def test_bytes_become_a_data_uri_that_any_reader_decodes() -> None:
    head, payload = encode_data_uri(EVERY_BYTE).split(",")
    assert head == "data:application/octet-stream;base64"
    assert base64.b64decode(payload, validate=True) == EVERY_BYTE


@pytest.mark.parametrize(
    "uri",
    [
        "data:application/octet-stream;base64",
        "data:;base64,AAA",
        "data:;base64,A*==",
        "data:;base64,AA==AA==",
        "data:;base64,AA\nAA",
        "data:;base64,ÄÖÜß",
        "data:;base64,%FF%FF",
        "data:application/octet-stream,\ud800",
        "data:;base64,\ud800AAA",
    ],
)
def test_a_broken_data_uri_is_an_input_error(uri: str) -> None:
    with pytest.raises(InputError, match="data: URI"):
        read_resource(uri, Path(), HERE)


@pytest.mark.parametrize(
    ("uri", "name"),
    [
        ("plain.bin", "plain.bin"),
        ("with%20space.bin", "with space.bin"),
        ("with space.bin", "with space.bin"),
        ("%C3%A4%CE%B1.bin", "äα.bin"),
        ("äα.bin", "äα.bin"),
        ("50%25.bin", "50%.bin"),
        ("50%.bin", "50%.bin"),
        ("./sub/deep.bin", "sub/deep.bin"),
        ("sub/../plain.bin", "plain.bin"),
        ("version.bin?v=3", "version.bin"),
        ("part.bin#start", "part.bin"),
        ("a%23b%3Fc.bin", "a#b?c.bin"),
        ("b-c_d.e~f!g$h&i'j(k)l*m+n,o;p=q@r.bin", "b-c_d.e~f!g$h&i'j(k)l*m+n,o;p=q@r.bin"),
    ],
)
def test_relative_uris_name_files_beside_the_document(tmp_path: Path, uri: str, name: str) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / name).write_bytes(b"content")
    assert read_resource(uri, tmp_path, HERE) == b"content"


def test_a_file_that_carries_the_encoded_name_is_found(tmp_path: Path) -> None:
    (tmp_path / "a%20b.bin").write_bytes(b"literal")
    assert read_resource("a%20b.bin", tmp_path, HERE) == b"literal"


def test_the_decoded_name_comes_first(tmp_path: Path) -> None:
    (tmp_path / "a%20b.bin").write_bytes(b"literal")
    (tmp_path / "a b.bin").write_bytes(b"decoded")
    assert read_resource("a%20b.bin", tmp_path, HERE) == b"decoded"


@pytest.mark.parametrize(
    "uri",
    [
        "",
        "/etc/hostname",
        "//host/share.bin",
        "\\\\host\\share.bin",
        "http://example.org/a.bin",
        "HTTPS://example.org/a.bin",
        "file:///etc/hostname",
        "file:a.bin",
        "ftp+x.y-z:a.bin",
    ],
)
def test_schemes_and_absolute_paths_are_refused(tmp_path: Path, uri: str) -> None:
    assert not is_relative(uri)
    with pytest.raises(InputError, match=r"neither relative nor a data: URI"):
        read_resource(uri, tmp_path, HERE)


@pytest.mark.parametrize("uri", ["%2Fetc%2Fhostname", "%2fetc/hostname", "%5C%5Chost%5Cshare.bin"])
def test_an_absolute_path_does_not_get_through_by_percent_encoding(tmp_path: Path, uri: str) -> None:
    with pytest.raises(InputError, match=r"neither relative nor a data: URI"):
        read_resource(uri, tmp_path, HERE)


@pytest.mark.parametrize(
    "uri", ["missing.bin", "folder", "%00.bin", "nul\0.bin", "x" * 5000, "%78" * 300, "\ud800.bin"]
)
def test_what_cannot_be_read_is_an_input_error_that_names_it(tmp_path: Path, uri: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"^model\.gltf: cannot read .* beside it: ") as caught:
        read_resource(uri, tmp_path, HERE)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("name", ["plain.bin", "a b.bin", "ä/α#1?.bin", "50%.bin", "%20.bin", "a'b(c).bin"])
def test_paths_become_uris_that_any_reader_decodes(name: str) -> None:
    uri = path_uri(name)
    assert unquote(uri) == name
    assert uri.isascii()
    assert not set(uri) & set(' #?"<>\\^`{|}')
