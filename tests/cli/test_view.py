"""``skinbake view``: the page as a file, and served; what it refuses, and what it leaves alone."""

from __future__ import annotations

import http.client
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.cli import exit_codes
from skinbake.commands.shown import baked_in_memory
from skinbake.commands.view import view_file
from skinbake.errors import OutputError
from skinbake.gltf.document import read_document
from skinbake.gltf.json_access import JsonObject
from tests.support.baked_files import Editable
from tests.support.command_line import LINUX, invoke
from tests.support.compressed import draco_twin
from tests.support.models import bake, edited, sheet, write_model

TUBE = FOLDER / "bent_tube.glb"


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_file_that_is_not_baked_is_baked_in_memory_only(tmp_path: Path) -> None:
    source = tmp_path / "tube.glb"
    source.write_bytes(TUBE.read_bytes())
    before = files(tmp_path)
    result = invoke("view", source, "-o", tmp_path / "page.html")
    assert result.exit_code == 0
    assert re.fullmatch(r".*tube\.glb -> .*page\.html: [\d,]+ bytes, baked in memory\n", result.stdout)
    after = files(tmp_path)
    page = after.pop("page.html").decode()
    assert after == before
    assert "This page baked it in memory" in page


@pytest.mark.slow
def test_the_storage_of_a_bake_in_memory_is_no_news(tmp_path: Path) -> None:
    source = draco_twin(FOLDER / "two_sets.glb", tmp_path / "two.glb", sequential=False)
    assert "sequential method" in invoke("bake", source, "--dry-run").stderr
    result = invoke("view", source, "-o", tmp_path / "page.html")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "sequential method" not in (tmp_path / "page.html").read_text(encoding="utf-8")
    document = read_document(str(source))
    baked_in_memory(document)  # as render does
    assert not list(document.notices)


@pytest.mark.slow
def test_a_baked_file_is_shown_as_it_is(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb", encoding="packed8")
    result = invoke("view", tmp_path / "tube.glb", "-o", tmp_path / "page.html")
    assert result.stdout.endswith(" bytes\n")
    assert "baked it in memory" not in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_damaged_bake_is_said_and_replaced_in_memory(tmp_path: Path) -> None:
    bake(TUBE, tmp_path / "tube.glb")
    file = Editable(tmp_path / "tube.glb")
    del file.primitive()["attributes"]["_SKINBAKE_ALPHA_0"]  # as an optimiser leaves it
    file.write(tmp_path / "lost.glb")
    result = invoke("view", tmp_path / "lost.glb", "-o", tmp_path / "page.html")
    assert result.exit_code == 0
    assert result.stdout.endswith(" bytes, baked in memory\n")
    assert "its bake is damaged or old, and one made in memory is shown" in " ".join(result.stderr.split())
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The bake of the file is damaged. This page baked it in memory" in page
    assert "The file was not baked" not in page
    document = read_document(str(tmp_path / "lost.glb"))
    baked_in_memory(document)  # as render does
    assert [notice.code for notice in document.notices] == ["bake-damaged"]


@pytest.mark.slow
def test_the_same_file_gives_the_same_page(tmp_path: Path) -> None:
    pages = [invoke("view", TUBE, "-o", "-").stdout_bytes for _ in range(2)]
    assert pages[0] == pages[1]
    assert pages[0].startswith(b"<!doctype html>")


@pytest.mark.slow
def test_the_page_names_nothing_on_the_network(tmp_path: Path) -> None:
    page = invoke("view", TUBE, "-o", "-").stdout
    assert "default-src 'none'" in page
    addresses = set(re.findall(r"""https?://[^\s"'<)]+""", page))
    assert addresses == {"http://www.w3.org/2000/svg"}


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["{tube}", "-o", "page.glb"], exit_codes.USAGE, "page.glb is the name of a model"),
        (["{tube}", "-o", "page.png"], exit_codes.USAGE, "page.png: expected a name that ends in .html or"),
        (
            ["{tube}", "-o", "page"],
            exit_codes.USAGE,
            "page: expected a name that ends in .html or .htm, or - for stdout",
        ),
        (["{tube}", "-o", "{folder}"], exit_codes.USAGE, "is a folder"),
        (["model.obj"], exit_codes.USAGE, "OBJ is not glTF: OBJ has no skin"),
        (["{folder}/none.glb", "-o", "{folder}/page.html"], exit_codes.INPUT, "cannot be read"),
        (["{tube}", "-o", "{tube}/page.html"], exit_codes.OUTPUT, "is a file, not a folder"),
        (["{tube}", "-o", "{folder}/page.html", "--port", "8000"], exit_codes.USAGE, "a page that is served"),
        (["{tube}", "-o", "{folder}/page.html", "--no-browser"], exit_codes.USAGE, "a page that is served"),
        (
            ["{tube}", "--port", "70000"],
            exit_codes.USAGE,
            "expected a whole number from 0 to 65535, found 70000",
        ),
    ],
)
def test_view_refuses(tmp_path: Path, arguments: list[str], code: int, words: str) -> None:
    given = [argument.format(tube=TUBE, folder=tmp_path) for argument in arguments]
    result = invoke("view", *given)
    assert result.exit_code == code
    assert words in " ".join(result.stderr.split())
    assert files(tmp_path) == {}


def test_a_page_that_links_to_a_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "hero.gltf").write_text("{}")
    (tmp_path / "page.html").symlink_to(tmp_path / "hero.gltf")
    result = invoke("view", TUBE, "-o", tmp_path / "page.html")
    assert result.exit_code == exit_codes.USAGE
    assert "page.html is the name of a model" in result.stderr
    assert (tmp_path / "hero.gltf").read_text() == "{}"


@pytest.mark.slow
def test_view_replaces_pages_of_skinbake_only(tmp_path: Path) -> None:
    page = tmp_path / "hero.html"
    page.write_text("<!doctype html>my own page")
    result = invoke("view", TUBE, "-o", page)
    assert result.exit_code == exit_codes.USAGE
    assert "exists and was not written by an earlier run" in " ".join(result.stderr.split())
    assert page.read_text() == "<!doctype html>my own page"
    page.write_bytes(b"")
    for _ in range(2):
        assert invoke("view", TUBE, "-o", page).exit_code == exit_codes.OK


@pytest.mark.slow
def test_pages_of_view_and_reports_of_verify_replace_each_other(tmp_path: Path) -> None:
    page = tmp_path / "hero.html"
    for command, option in (("verify", "--html"), ("view", "-o")) * 2:
        assert invoke(command, TUBE, option, page).exit_code == exit_codes.OK


@pytest.mark.slow
def test_the_short_suffix_is_one_of_a_page_too(tmp_path: Path) -> None:
    assert invoke("view", TUBE, "-o", tmp_path / "page.HTM").exit_code == exit_codes.OK


def test_a_file_without_anything_skinned_is_an_input_error(tmp_path: Path) -> None:
    def unskinned(content: JsonObject) -> None:
        for node in content["nodes"]:
            node.pop("skin", None)

    path = edited("bent_tube.glb", tmp_path / "models", unskinned)
    result = invoke("view", path, "-o", tmp_path / "page.html")
    assert result.exit_code == exit_codes.INPUT
    assert "nothing in it can be shown: it has joints, but no node" in result.stderr
    assert not (tmp_path / "page.html").exists()


def test_a_page_may_not_replace_a_file_of_the_model(tmp_path: Path) -> None:
    def rename(content: JsonObject) -> None:
        content["buffers"][0]["uri"] = "data.html"

    path = edited("shared_accessors.gltf", tmp_path, rename)
    (tmp_path / "shared accessors.bin").rename(tmp_path / "data.html")
    with pytest.raises(OutputError, match="it is a file of the input"):
        view_file(str(path), str(tmp_path / "data.html"))


@pytest.mark.slow
def test_a_missing_image_is_said_and_left_out(tmp_path: Path) -> None:
    def with_image(content: JsonObject) -> None:
        content["images"] = [{"uri": "skin.png"}]

    path = write_model(tmp_path / "sheet.glb", [sheet()], change=with_image)
    result = invoke("view", path, "-o", tmp_path / "page.html")
    assert result.exit_code == 0
    assert "The page is without this image" in result.stderr
    (tmp_path / "skin.png").write_bytes(b"\x89PNG and so on")
    assert invoke("view", path, "-o", tmp_path / "page.html").stderr == ""


def test_an_image_that_may_not_be_read_is_called_an_image(tmp_path: Path) -> None:
    def with_image(content: JsonObject) -> None:
        content["images"] = [{"uri": "a\\b.png"}]

    path = write_model(tmp_path / "sheet.glb", [sheet()], change=with_image)
    said = " ".join(invoke("view", path, "-o", tmp_path / "page.html").stderr.split())
    assert 'its image "a\\b.png" is not read: it holds a backslash' in said
    assert said.endswith("The page is without this image")


def test_what_bake_and_verify_both_say_is_said_once(tmp_path: Path) -> None:
    path = write_model(tmp_path / "half.glb", [sheet(WEIGHTS_0=np.full((20, 4), 0.125, np.float32))])
    said = invoke("view", path, "-o", tmp_path / "page.html").stderr
    assert said.count("do not sum to 1") == 1
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("do not sum to 1") == 1


@pytest.mark.slow
def test_normals_that_were_generated_are_said(tmp_path: Path) -> None:
    path = write_model(tmp_path / "bare.glb", [sheet(NORMAL=None)])
    said = invoke("view", path, "-o", tmp_path / "page.html").stderr
    assert said.count("it has no NORMAL: smooth normals are generated here") == 1


def test_an_image_that_is_named_often_is_held_once(tmp_path: Path) -> None:
    def with_images(content: JsonObject) -> None:
        content["images"] = [{"uri": "skin.png"}] * 200

    path = write_model(tmp_path / "sheet.glb", [sheet()], change=with_images)
    (tmp_path / "skin.png").write_bytes(b"\x89PNG" + bytes(100_000))
    assert invoke("view", path, "-o", tmp_path / "page.html").exit_code == 0
    assert (tmp_path / "page.html").stat().st_size < 600_000


@pytest.mark.slow
def test_images_in_ktx2_and_influences_that_are_too_many_are_said(tmp_path: Path) -> None:
    def with_image(content: JsonObject) -> None:
        content["images"] = [{"uri": "skin.ktx2"}]
        content["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]

    (tmp_path / "skin.ktx2").write_bytes(b"\xabKTX 20\xbb")
    attributes: dict[str, Any] = {}
    for number in range(3):
        attributes[f"WEIGHTS_{number}"] = np.full((20, 4), 1 / 12, np.float32)
        attributes[f"JOINTS_{number}"] = np.full((20, 4), 4 * number, np.uint8) + np.arange(4, dtype=np.uint8)
    twelve = sheet(**attributes)
    path = write_model(tmp_path / "twelve.glb", [twelve], joints=12, change=with_image)
    result = invoke("view", path, "-o", tmp_path / "page.html")
    assert result.exit_code == 0
    said = " ".join(result.stderr.split())
    assert "texture 0 is in KTX2, which is not decoded. The page is without this image" in said
    assert "it has up to 12 influences for a vertex, and a page draws 8" in said
    eight = sheet(**{name: array for name, array in twelve.attributes.items() if name[-1] in "01"})
    assert "WEIGHTS_2" not in eight.attributes
    fewer = invoke(
        "view", write_model(tmp_path / "eight.glb", [eight], joints=12), "-o", tmp_path / "page.html"
    )
    assert "influences" not in fewer.stderr


@LINUX
@pytest.mark.slow
def test_view_serves_the_page_to_this_machine_until_ctrl_c() -> None:
    command = [sys.executable, "-u", "-m", "skinbake", "view", str(TUBE), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/ \(Ctrl-C ends\)\n", process.stdout.readline())
            assert address is not None
            port = int(address[1])
            assert asked(port, "/")[0] == 200
            assert asked(port, "/")[1].startswith(b"<!doctype html>")
            assert asked(port, "/../pyproject.toml")[0] == 404
            assert asked(port, "/", host="evil.example")[0] == 404
            taken = invoke("view", TUBE, "--no-browser", "--port", str(port))
            assert taken.exit_code == exit_codes.OUTPUT
            assert "choose another --port" in taken.stderr
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(20) == exit_codes.INTERRUPTED


@LINUX
@pytest.mark.slow
def test_view_answers_a_browser_that_runs_in_the_terminal(tmp_path: Path) -> None:
    browser, got = tmp_path / "browser.py", tmp_path / "got.html"
    browser.write_text(
        "import sys, urllib.request\n"
        "page = urllib.request.urlopen(sys.argv[1], timeout=20).read()\n"
        f"open({str(got)!r}, 'wb').write(page)\n"
    )
    environment = {**os.environ, "BROWSER": f"{sys.executable} {browser} %s"}
    command = [sys.executable, "-u", "-m", "skinbake", "view", str(TUBE)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            deadline = time.monotonic() + 25
            while not (got.exists() and got.stat().st_size) and time.monotonic() < deadline:
                time.sleep(0.05)
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(20) == exit_codes.INTERRUPTED
    assert got.read_bytes().startswith(b"<!doctype html>")


def asked(port: int, path: str, host: str | None = None) -> tuple[int, bytes]:
    """Return the status and the body of one request."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request("GET", path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    return answer.status, answer.read()


@pytest.mark.slow
def test_a_page_that_takes_longer_than_its_timeout_is_given_up(tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    result = invoke("view", TUBE, "-o", target, "--timeout", "0.001")
    assert result.exit_code == 3
    assert "it took longer than 0.001 s (--timeout)" in result.stderr
    assert not target.exists()
    assert invoke("view", TUBE, "-o", target, "--timeout", "600").exit_code == 0
    assert target.exists()
    assert invoke("view", "-", "-o", target, "--timeout", "1").exit_code == 2
