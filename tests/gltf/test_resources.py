"""The bytes that URIs stand for (RFC 2397 and 3986; glTF 2.0 specification, §2.8 and §3.6.1)."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from urllib.parse import unquote

import pytest

from skinbake.errors import InputError, Place
from skinbake.files.bounds import BESIDE, Bounds, is_relative, path_uri
from skinbake.gltf.resources import decode_data_uri, encode_data_uri, read_resource

HERE = Place("model.gltf")
EVERY_BYTE = bytes(range(256))
BASE64 = base64.b64encode(EVERY_BYTE).decode()


def uncounted(size: int) -> None:
    """Let a file of any size be read."""


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


@pytest.mark.parametrize("count", range(7))
def test_padding_may_be_missing(count: int) -> None:
    data = EVERY_BYTE[250 - count : 250]
    digits = base64.b64encode(data).decode().rstrip("=")
    assert decode_data_uri(f"data:;base64,{digits}", HERE) == data


def test_bits_after_the_last_byte_are_dropped_as_in_browsers() -> None:
    assert decode_data_uri("data:;base64,AB", HERE) == b"\0"
    assert decode_data_uri("data:;base64,//9", HERE) == b"\xff\xff"


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
        "data:;base64,A",
        "data:;base64,AAAAA",
        "data:;base64,AA=",
        "data:;base64,AAA==",
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
        decode_data_uri(uri, HERE)


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
        ("version.bin?v=3", "version.bin?v=3"),
        ("part.bin#start", "part.bin#start"),
        ("a%23b%3Fc.bin", "a#b?c.bin"),
        ("b-c_d.e~f!g$h&i'j(k)l*m+n,o;p=q@r.bin", "b-c_d.e~f!g$h&i'j(k)l*m+n,o;p=q@r.bin"),
    ],
)
def test_relative_uris_name_files_beside_the_document(tmp_path: Path, uri: str, name: str) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / name).write_bytes(b"content")
    assert read_resource(uri, tmp_path, BESIDE, HERE, uncounted) == b"content"


def test_a_file_that_carries_the_encoded_name_is_found(tmp_path: Path) -> None:
    (tmp_path / "a%20b.bin").write_bytes(b"literal")
    assert read_resource("a%20b.bin", tmp_path, BESIDE, HERE, uncounted) == b"literal"


def test_the_decoded_name_comes_first(tmp_path: Path) -> None:
    (tmp_path / "a%20b.bin").write_bytes(b"literal")
    (tmp_path / "a b.bin").write_bytes(b"decoded")
    assert read_resource("a%20b.bin", tmp_path, BESIDE, HERE, uncounted) == b"decoded"


@pytest.mark.parametrize(
    ("uri", "reason"),
    [
        ("", "it names no file"),
        ("/etc/hostname", "it is an absolute path"),
        ("%2Fetc%2Fhostname", "it is an absolute path"),
        ("//host/share.bin", "it is an absolute path"),
        ("\\\\host\\share.bin", "it holds a backslash"),
        ("%5C%5Chost%5Cshare.bin", "it holds a backslash"),
        ("http://example.org/a.bin", "it has a scheme"),
        ("HTTPS://example.org/a.bin", "it has a scheme"),
        ("file:///etc/hostname", "it has a scheme"),
        ("ftp+x.y-z:a.bin", "it has a scheme"),
        ("C:/Windows/win.ini", "it has a drive"),
        ("c%3A/Windows/win.ini", "it has a drive"),
        ("a.bin:stream", "it has a"),
        ("%00.bin", "it holds a NUL"),
        ("nul\0.bin", "it holds a NUL"),
        ("sub/NUL", "is a device on Windows"),
        ("lpt1.bin", "is a device on Windows"),
        ("com¹.bin", "is a device on Windows"),
        ("sub/.. /a.bin", "is not a valid file name"),
        ("sub/", "it names no file"),
        (".", "it names no file"),
        ("../secret.bin", "it leads out of"),
        ("%2e%2e/secret.bin", "it leads out of"),
        ("%2E%2E%2Fsecret.bin", "it leads out of"),
        ("sub/../../secret.bin", "it leads out of"),
        ("x#/../../secret.bin", "it leads out of"),
        ("x?/../../secret.bin", "it leads out of"),
        ("out.bin", "a link on the way leads out"),
        ("absolute.bin", "a link on the way leads out"),
        ("up/secret.bin", "a link on the way leads out"),
        ("fifo", "it is not a regular file"),
    ],
)
def test_what_no_document_may_have_read(tmp_path: Path, uri: str, reason: str) -> None:
    home = tmp_path / "home"
    for folder in ("sub", "x#", "x?", "x#/../sub"):
        (home / folder).mkdir(parents=True, exist_ok=True)
    (tmp_path / "secret.bin").write_bytes(b"secret")
    (home / "out.bin").symlink_to("../secret.bin")
    (home / "absolute.bin").symlink_to(tmp_path / "secret.bin")
    (home / "up").symlink_to("..")
    os.mkfifo(home / "fifo")
    with pytest.raises(InputError) as caught:
        read_resource(uri, home, BESIDE, HERE, uncounted)
    assert reason in str(caught.value)
    assert str(caught.value).startswith("model.gltf: ")


def test_percent_encoding_is_undone_once(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "secret.bin").write_bytes(b"secret")
    with pytest.raises(InputError, match=r"cannot read .* beside it"):
        read_resource("%252e%252e/secret.bin", tmp_path / "home", BESIDE, HERE, uncounted)


def test_a_link_that_stays_inside_is_followed(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.bin").write_bytes(b"content")
    (tmp_path / "link.bin").symlink_to("sub/../sub/a.bin")
    assert read_resource("link.bin", tmp_path, BESIDE, HERE, uncounted) == b"content"


def test_files_in_the_root_or_an_allowed_folder_are_read(tmp_path: Path) -> None:
    home, shared = tmp_path / "art" / "hero", tmp_path / "shared"
    home.mkdir(parents=True)
    shared.mkdir()
    (tmp_path / "art" / "a.bin").write_bytes(b"in the root")
    (shared / "b.bin").write_bytes(b"allowed")
    within_root = Bounds(str(tmp_path / "art"))
    assert read_resource("../a.bin", home, within_root, HERE, uncounted) == b"in the root"
    with pytest.raises(InputError, match=r"--allow-outside DIR"):
        read_resource("../../shared/b.bin", home, within_root, HERE, uncounted)
    allowed = Bounds(allowed=(str(shared),))
    assert read_resource("../../shared/b.bin", home, allowed, HERE, uncounted) == b"allowed"
    with pytest.raises(InputError, match=r"--allow-outside DIR"):
        read_resource("../a.bin", home, allowed, HERE, uncounted)


@pytest.mark.parametrize("uri", ["missing.bin", "folder", "x" * 5000, "%78" * 300, "\ud800.bin"])
def test_what_cannot_be_read_is_an_input_error_that_names_it(tmp_path: Path, uri: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"^model\.gltf: cannot read .* beside it: ") as caught:
        read_resource(uri, tmp_path, BESIDE, HERE, uncounted)
    assert len(str(caught.value)) < 300


def test_of_a_missing_buffer_it_is_said_what_to_do(tmp_path: Path) -> None:
    told = '"a.bin" beside it: No such file or directory'
    with pytest.raises(InputError) as caught:
        read_resource("a.bin", tmp_path, BESIDE, HERE, uncounted)
    remedy = "; copy it there too, or export a .glb, which is one file"
    assert str(caught.value) == f"model.gltf: cannot read {told}{remedy}"
    with pytest.raises(InputError, match=f"{told}$"):
        read_resource("a.bin", tmp_path, BESIDE, HERE, uncounted, of="image")


def test_relative_uris_are_told_from_others() -> None:
    assert is_relative("../a.bin")
    assert not is_relative("http://example.org/a.bin")


@pytest.mark.parametrize("name", ["plain.bin", "a b.bin", "ä/α#1?.bin", "50%.bin", "%20.bin", "a'b(c).bin"])
def test_paths_become_uris_that_any_reader_decodes(name: str) -> None:
    uri = path_uri(name)
    assert unquote(uri) == name
    assert uri.isascii()
    assert not set(uri) & set(' #?"<>\\^`{|}')
