"""--pack: images and buffers of files go into the BIN chunk, bit for bit, and only files that may be read."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import pytest

from fixtures.builder import JsonObject
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import GltfFile, read
from tests.support.khronos import validate
from tests.support.models import FOLDER, SHARED, edited, rewritten

ONE_PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
JPEG = b"\xff\xd8\xff\xe0 only its head counts here"
WEBP = b"RIFF\x10\0\0\0WEBPVP8L only its head"
KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n and more"


def with_files(folder: Path, files: dict[str, bytes], **images: str) -> Path:
    """Copy the .gltf fixture with two buffer files, and images of these files."""

    def change(content: JsonObject) -> None:
        content["buffers"][1]["uri"] = "more.bin"
        content["images"] = [{"uri": uri} for uri in images.values()]
        content["textures"] = [{"source": number} for number in range(len(images))]

    path = edited(SHARED, folder, change)
    (folder / "more.bin").write_bytes(read(FOLDER / SHARED).buffer(1))
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return path


def image_data(model: GltfFile, number: int) -> bytes:
    view = model.content["bufferViews"][model.content["images"][number]["bufferView"]]
    start = view.get("byteOffset", 0)
    return bytes(model.buffer(view["buffer"])[start : start + view["byteLength"]])


def packed(source: Path, target: Path, *options: str | Path) -> tuple[GltfFile, list[str]]:
    """Bake with --pack, and return the output and the codes of the notices."""
    (file,) = document(invoke("bake", source, "-o", target, "--pack", "--json", *options))["files"]
    assert file["status"] == "baked", file["error"]
    return read(target), [notice["code"] for notice in file["warnings"]]


def test_packed_files_are_inside_bit_for_bit(tmp_path: Path) -> None:
    files = {"skin.png": ONE_PIXEL, "a b.jpg": JPEG, "tex/c.webp": WEBP, "d.ktx2": KTX2}
    source = with_files(tmp_path / "in", files, a="skin.png", b="a%20b.jpg", c="tex/c.webp", d="d.ktx2")
    model, notices = packed(source, tmp_path / "out" / "hero.glb")
    assert notices == []
    assert [buffer.get("uri") for buffer in model.content["buffers"]] == [None]
    assert [image["mimeType"] for image in model.content["images"]] == [
        "image/png",
        "image/jpeg",
        "image/webp",
        "image/ktx2",
    ]
    assert all("uri" not in image for image in model.content["images"])
    assert [image_data(model, number) for number in range(4)] == list(files.values())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["hero.glb"]


def test_alpha_and_beta_are_those_of_the_unpacked_file(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"skin.png": ONE_PIXEL}, a="skin.png")
    model, _ = packed(source, tmp_path / "hero.glb")
    invoke("bake", source, "-o", tmp_path / "plain" / "hero.gltf")
    plain = read(tmp_path / "plain" / "hero.gltf")
    for name in ("_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0", "POSITION", "WEIGHTS_0"):
        assert (model.attribute(name) == plain.attribute(name)).all()


@pytest.mark.slow
def test_the_validator_finds_nothing(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"skin.png": ONE_PIXEL}, a="skin.png", b="skin.png")
    packed(source, tmp_path / "hero.glb")
    report = validate(tmp_path / "hero.glb")
    assert (report["errors"], [w.code for w in report["warnings"] if "URI" in w.code]) == ([], [])


def test_images_of_one_file_share_its_bytes(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"skin.png": ONE_PIXEL}, a="skin.png", b="skin.png")
    model, _ = packed(source, tmp_path / "hero.glb")
    first, second = model.content["images"]
    assert first == second
    assert (model.binary_chunk or b"").count(ONE_PIXEL) == 1


def test_the_bytes_decide_the_type_and_not_a_wrong_name(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"skin.jpg": ONE_PIXEL}, a="skin.jpg")
    model = read(source)
    model.content["images"][0] |= {"mimeType": "image/jpeg", "name": "Skin", "extras": {"kept": 1}}
    rewritten(model, source)
    after, _ = packed(source, tmp_path / "hero.glb")
    (image,) = after.content["images"]
    assert (image["mimeType"], image["name"], image["extras"]) == ("image/png", "Skin", {"kept": 1})


def test_an_image_outside_stays_outside_unless_it_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "skin.png").write_bytes(ONE_PIXEL)
    source = with_files(tmp_path / "in", {}, a="../textures/skin.png")
    model, notices = packed(source, tmp_path / "in" / "hero.glb")
    assert notices == ["image-not-packed"]
    assert model.content["images"] == [{"uri": "../textures/skin.png"}]
    assert ONE_PIXEL not in (model.binary_chunk or b"")
    model, notices = packed(source, tmp_path / "deep" / "er" / "hero.glb")
    assert notices == ["image-not-packed"]
    assert model.content["images"] == [{"uri": "../../textures/skin.png"}]
    allowed = packed(source, tmp_path / "a.glb", "--allow-outside", tmp_path / "textures")
    assert (image_data(allowed[0], 0), allowed[1]) == (ONE_PIXEL, [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("uri", "files", "why"),
    [
        ("gone.png", {}, "cannot be read: No such file"),
        ("odd.xyz", {"odd.xyz": b"what is this"}, "is in an unknown format"),
        ("none.png", {"none.png": b""}, "is empty"),
        ("https://example.org/a.png", {}, "is not a relative path"),
        ("/etc/hostname", {}, "is not a relative path"),
    ],
)
def test_an_image_that_cannot_be_packed_is_named(
    uri: str, files: dict[str, bytes], why: str, tmp_path: Path
) -> None:
    source = with_files(tmp_path / "in", files, a=uri)
    result = invoke("bake", source, "-o", tmp_path / "in" / "hero.glb", "--pack")
    assert result.exit_code == 0
    assert f'1 image stays a file: "{uri}" {why}' in " ".join(result.stderr.split())
    assert read(tmp_path / "in" / "hero.glb").content["images"] == [{"uri": uri}]
    assert invoke("bake", source, "--pack", "-o", tmp_path / "b.glb", "--warnings-as-errors").exit_code == 3


def test_an_image_has_one_notice_which_says_that_it_is_not_copied_either(tmp_path: Path) -> None:
    uris = {"a": "no.png", "b": "nor.png", "c": "../out.png", "d": "a:b.png", "e": "odd.xyz", "f": "no.png"}
    source = with_files(tmp_path / "in", {"odd.xyz": b"what is this"}, **uris)
    result = invoke("bake", source, "-o", tmp_path / "out" / "hero.glb", "--pack", "--json")
    notices = document(result)["files"][0]["warnings"]
    said = {notice["message"]: notice["count"] for notice in notices}
    assert {notice["code"] for notice in notices} == {"image-not-packed"}
    assert said == {
        '3 images stay files: "no.png" cannot be read: No such file or directory. It cannot be copied '
        "either. The others are nor.png": 3,
        f'1 image stays a file: "../out.png" is not read: it leads out of {tmp_path / "in"}. --allow-outside '
        "DIR names further folders. It is not copied either, and the output refers to the same place": 1,
        '1 image stays a file: "a:b.png" is not a relative path. Its URI stays as it is': 1,
        '1 image stays a file: "odd.xyz" is in an unknown format': 1,
    }
    assert (tmp_path / "out" / "odd.xyz").exists()


@pytest.mark.parametrize("moves", [False, True])
def test_a_missing_buffer_is_named_once(moves: bool, tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {}, a="no.png")
    model = read(source)
    model.content["buffers"] += [{"uri": uri, "byteLength": 4} for uri in ("gone.bin", "lost.bin")]
    rewritten(model, source)
    target = tmp_path / ("out" if moves else "in") / "hero.glb"
    (file,) = document(invoke("bake", source, "-o", target, "--pack", "--json"))["files"]
    why = "cannot be read: No such file or directory" + (". It cannot be copied either" if moves else "")
    assert [(notice["code"], notice["count"], notice["message"]) for notice in file["warnings"]] == [
        ("buffer-not-packed", 2, f'2 buffers stay files: "gone.bin" {why}. The others are lost.bin'),
        ("image-not-packed", 1, f'1 image stays a file: "no.png" {why}'),
    ]
    assert [buffer.get("uri") for buffer in read(target).content["buffers"]] == [None, "gone.bin", "lost.bin"]
    assert invoke("bake", source, "-o", target, "--pack", "--warnings-as-errors").exit_code == 3


def test_a_buffer_that_is_cut_short_is_named_and_copied(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"short.bin": b"123"})
    model = read(source)
    model.content["buffers"].append({"uri": "short.bin", "byteLength": 4})
    rewritten(model, source)
    result = invoke("bake", source, "-o", tmp_path / "out" / "hero.glb", "--pack", "--json")
    (notice,) = document(result)["files"][0]["warnings"]
    assert notice["code"] == "buffer-not-packed"
    assert notice["message"] == (
        '1 buffer stays a file: "short.bin" is not packed: buffer 2 is cut short: it declares 4 bytes, but '
        "only 3 are there"
    )
    assert (tmp_path / "out" / "short.bin").read_bytes() == b"123"


def test_a_view_that_is_compressed_under_both_names_moves_with_both(tmp_path: Path) -> None:
    """A reader that knows only one name must find the bytes too."""
    place = {"buffer": 1, "byteOffset": 4, "byteLength": 8}
    extensions = {f"{prefix}_meshopt_compression": place for prefix in ("KHR", "EXT")}
    uris = ["data:;base64,AAAAAA==", "data:;base64,AAAAAAAAAAAAAAAAAAAAAA=="]
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": length, "uri": uri} for length, uri in zip((4, 16), uris, strict=True)],
        "bufferViews": [{"buffer": 1, "byteLength": 16, "extensions": extensions}],
    }
    (tmp_path / "in.gltf").write_text(json.dumps(content))
    invoke("strip", tmp_path / "in.gltf", "-o", tmp_path / "out.glb")
    (view,) = read(tmp_path / "out.glb").content["bufferViews"]
    assert list(view["extensions"].values()) == [{"buffer": 0, "byteOffset": 8, "byteLength": 8}] * 2


def test_a_view_of_a_buffer_that_is_missing_is_an_error(tmp_path: Path) -> None:
    """Only its move into the chunk looks at the view, because nothing names it."""
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 3, "uri": "data:;base64,AAAA"}] * 2,
        "bufferViews": [{"buffer": 2, "byteLength": 1}],
    }
    (tmp_path / "in.gltf").write_text(json.dumps(content))
    result = invoke("strip", tmp_path / "in.gltf", "-o", tmp_path / "out.glb")
    assert result.exit_code == 3
    assert "a buffer view names buffer 2, and there is none" in result.stderr
    assert not (tmp_path / "out.glb").exists()


def test_a_glb_with_buffers_in_files_gets_a_chunk(tmp_path: Path) -> None:
    """Every second view is of a second file, in which all bytes come later."""
    model = read(FOLDER / "seam.glb")
    data = model.binary_chunk or b""
    model.content["buffers"] = [
        {"uri": "all.bin", "byteLength": len(data)},
        {"uri": "later.bin", "byteLength": len(data) + 8},
    ]
    for view in model.content["bufferViews"][::2]:
        view.update(buffer=1, byteOffset=view.get("byteOffset", 0) + 8)
    model.content["images"] = [{"uri": "skin.png"}]
    for name, content in {"all.bin": data, "later.bin": bytes(8) + data, "skin.png": ONE_PIXEL}.items():
        (tmp_path / name).write_bytes(content)
    path = rewritten(GltfFile(tmp_path / "hero.glb", model.content, None), tmp_path / "hero.glb")
    after, notices = packed(path, tmp_path / "out.glb")
    assert notices == []
    assert [buffer.get("uri") for buffer in after.content["buffers"]] == [None]
    for name in ("POSITION", "NORMAL"):
        assert (after.attribute(name) == read(FOLDER / "seam.glb").attribute(name)).all()
    assert image_data(after, 0) == ONE_PIXEL


def test_in_place_and_again(tmp_path: Path) -> None:
    source = with_files(tmp_path, {"skin.png": ONE_PIXEL}, a="skin.png")
    path = tmp_path / "hero.glb"
    assert invoke("bake", source, "-o", path).exit_code == 0
    assert read(path).content["images"] == [{"uri": "skin.png"}]
    assert invoke("bake", path, "--in-place", "--pack").exit_code == 0
    once = path.read_bytes()
    assert image_data(read(path), 0) == ONE_PIXEL
    (tmp_path / "skin.png").unlink()
    assert invoke("bake", path, "--in-place", "--pack").exit_code == 0
    assert path.read_bytes() == once


def test_a_file_without_a_skin_is_packed_too(tmp_path: Path) -> None:
    path = tmp_path / "bare.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "images": [{"uri": "skin.png"}]}', encoding="utf-8")
    (tmp_path / "skin.png").write_bytes(ONE_PIXEL)
    assert invoke("bake", path, "-o", tmp_path / "bare.glb", "--pack").exit_code == 0
    assert image_data(read(tmp_path / "bare.glb"), 0) == ONE_PIXEL


def test_pack_changes_no_file_that_has_nothing_to_pack(tmp_path: Path) -> None:
    for options in ([], ["--pack"]):
        assert (
            invoke("bake", FOLDER / "seam.glb", "-o", tmp_path / f"{len(options)}.glb", *options).exit_code
            == 0
        )
    assert (tmp_path / "0.glb").read_bytes() == (tmp_path / "1.glb").read_bytes()


@pytest.mark.parametrize(
    "arguments", [["{}", "-o", "out.gltf"], ["{}", "--out-dir", "out"], ["{}", "--in-place"]]
)
def test_a_gltf_is_refused_before_anything_is_written(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = with_files(tmp_path / "in", {"skin.png": ONE_PIXEL}, a="skin.png")
    monkeypatch.chdir(tmp_path)
    result = invoke("bake", "--pack", *(argument.format(source) for argument in arguments))
    assert result.exit_code == 2
    assert "--pack needs a .glb or .vrm as output" in " ".join(result.stderr.split())
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_an_image_counts_for_max_memory_before_it_is_read(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"skin.png": b""}, a="skin.png")
    with (tmp_path / "in" / "skin.png").open("wb") as file:
        file.truncate(1 << 40)  # a hole: a terabyte that no disk holds
    result = invoke("bake", source, "-o", tmp_path / "out.glb", "--pack", "--max-memory", "64M")
    assert result.exit_code == 3
    assert 'image "skin.png" would take 1 TiB' in " ".join(result.stderr.split())
    assert not (tmp_path / "out.glb").exists()


@pytest.mark.slow
def test_skip_unchanged_knows_the_option(tmp_path: Path) -> None:
    source = with_files(tmp_path / "in", {"skin.png": ONE_PIXEL}, a="skin.png")
    state = tmp_path / "s"
    call: list[str | Path] = ["bake", source, "-o", tmp_path / "hero.glb", "--json", "--skip-unchanged"]
    call += ["--state", state]
    statuses = [
        document(invoke(*call, *options))["files"][0]["status"]
        for options in ([], [], ["--pack"], ["--pack"])
    ]
    assert statuses == ["baked", "up-to-date", "baked", "up-to-date"]
