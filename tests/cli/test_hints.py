"""Messages that tell what was meant, and lines that fit a terminal."""

from __future__ import annotations

import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import click
import pytest

from skinbake.cli.terminal import fitted, with_colours
from skinbake.wording import counted
from tests.support.command_line import document, invoke
from tests.support.models import FOLDER, bake, sheet, write_model

SEAM = FOLDER / "seam.glb"


def said(*arguments: str | Path) -> tuple[int, str]:
    """Return the exit code and what was said, on one line."""
    result = invoke(*arguments)
    return result.exit_code, " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("arguments", "question"),
    [
        (["bkae", "x.glb"], "No such command 'bkae'. Did you mean 'bake'?"),
        (["veiw", "x.glb"], "Did you mean 'view'?"),
        (["BAKE", "x.glb"], "Did you mean 'bake'?"),
        (["bake", "x.glb", "--gradients", "fited"], "Did you mean 'fitted'?"),
        (["bake", "x.glb", "--encoding", "snorm6"], "Did you mean 'snorm16'?"),
        (["bake", "x.glb", "--color", "allways"], "Did you mean 'always'?"),
        (["shader", "--target", "threee"], "Did you mean 'three'?"),
        (["shader", "--target", "unrael"], "Bake with --correctives: docs/unreal.md"),
        (["shader", "--target", "Unity"], "Bake with --correctives: docs/unity.md"),
        (["render", "x.glb", "-o", "x.png", "--mode", "shade"], "Did you mean 'shaded'?"),
        (["bake", "x.glb", "--gardients", "fitted"], "Did you mean '--gradients'?"),
        (["--versoin"], "Did you mean '--version'?"),
        (["-v", "bake", "x.glb"], "No such option '-v'. The options of a command stand after its name"),
        (["A.GLB"], "No such command 'A.GLB'. A command comes before the file, like skinbake view A.GLB"),
    ],
)
def test_a_mistyped_word_is_asked_about(arguments: list[str], question: str) -> None:
    code, text = said(*arguments)
    assert code == 2
    assert text.endswith(question)


def test_a_word_like_no_other_is_not_asked_about() -> None:
    for arguments in (["frobnicate"], ["bake", "x.glb", "--gradients", "normal"]):
        code, text = said(*arguments)
        assert code == 2
        assert "id you mean" not in text


@pytest.mark.parametrize("command", [["bake", "--dry-run"], ["verify"], ["inspect"], ["view", "-o", "-"]])
def test_a_file_that_is_not_there_is_asked_about(command: list[str], tmp_path: Path) -> None:
    for name in ("animated_cat.glb", "animated_cta.txt", "rock.glb"):
        shutil.copyfile(SEAM, tmp_path / name)
    code, text = said(*command, tmp_path / "animated_cta.glb")
    assert code == 3
    assert "cannot be read: No such file or directory; did you mean 'animated_cat.glb'?" in text
    code, text = said(*command, tmp_path / "hero.glb")
    assert code == 3
    assert "id you mean" not in text
    assert "id you mean" not in said(*command, tmp_path / "none" / "animated_cta.glb")[1]


@pytest.mark.parametrize(
    "arguments",
    [["inspect", ""], ["verify", SEAM, ""], ["bake", "", "--dry-run"], ["view", ""]],
)
def test_an_empty_name_asks_about_the_script(arguments: list[str | Path]) -> None:
    code, text = said(*arguments)
    assert code == 2
    assert text.endswith("Error: the name of an input is empty; is a variable of your script not set?")


@pytest.mark.parametrize(
    "arguments",
    [
        ["bake", SEAM, "--dry-run", "--allow-outside", ""],
        ["bake", SEAM, "--dry-run", "--config", ""],
        ["bake", SEAM, "--dry-run", "--out-dir", ""],
        ["strip", SEAM, "--in-place", "--output", ""],
        ["verify", SEAM, "--skip-unchanged", "--state", ""],
        ["view", SEAM, "--output", ""],
    ],
)
def test_an_option_with_an_empty_name_asks_about_the_script(arguments: list[str | Path]) -> None:
    code, text = said(*arguments)
    assert code == 2
    assert text.endswith(f"Error: {arguments[-2]}: the name is empty; is a variable of your script not set?")


@pytest.mark.parametrize("name", ["hero.gbl", "hero.gtlf", "hreo.glb2"])
def test_a_mistyped_suffix_is_asked_about(name: str, tmp_path: Path) -> None:
    shutil.copyfile(SEAM, tmp_path / "hero.glb")
    code, text = said("inspect", tmp_path / name)
    assert code == 2
    assert text.endswith(
        f"{name}: expected a name that ends in .glb, .gltf, .vrm, or - for stdin; did you mean 'hero.glb'?"
    )
    (tmp_path / name).touch()
    assert "id you mean" not in said("inspect", tmp_path / name)[1], "it is there"


def test_a_broken_link_is_not_meant_itself(tmp_path: Path) -> None:
    (tmp_path / "hero.glb").symlink_to("gone.glb")
    assert "id you mean" not in said("inspect", tmp_path / "hero.glb")[1]


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("hero.fbx", "FBX is not glTF: Blender exports it as glTF (File > Export > glTF 2.0), and FBX2glTF"),
        ("hero.FBX", "FBX is not glTF"),
        ("hero.obj", "obj2gltf"),
        ("hero.blend", "export it from Blender"),
        ("hero.usd", "Blender imports USD"),
        ("hero.usdz", "USDZ is not glTF: Blender imports USD"),
        ("hero.stl", "STL has no skin"),
        ("hero.7z", "7Z is not glTF: unpack it"),
        ("hero.txt", "expected a name that ends in .glb, .gltf, .vrm"),
    ],
)
@pytest.mark.parametrize("command", [["bake", "--dry-run"], ["verify"], ["view"], ["inspect"]])
def test_a_file_of_another_format_says_the_way_to_gltf(name: str, way: str, command: list[str]) -> None:
    code, text = said(*command, name)
    assert code == 2
    assert way in text


def test_a_name_that_means_nothing_does_not_stop_the_others(tmp_path: Path) -> None:
    for name in ("notes.txt", "hero.fbx"):
        (tmp_path / name).touch()
    arguments = [tmp_path / "notes.txt", SEAM, tmp_path / "hero.fbx", tmp_path / "none.glb"]
    result = invoke("bake", *arguments, "--out-dir", tmp_path / "out", "--json")
    assert result.exit_code == 3
    assert [file["status"] for file in document(result)["files"]] == ["failed", "baked", "failed", "failed"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["seam.glb"]
    assert "notes.txt: expected a name that ends in" in result.stderr
    assert "hero.fbx: FBX is not glTF" in result.stderr
    result = invoke("verify", tmp_path / "notes.txt", tmp_path / "out" / "seam.glb", "--poses", "rest")
    assert result.exit_code == 3
    assert "seam.glb: passed" in result.stdout


@pytest.mark.parametrize("name", ["new/", ""])
def test_a_folder_for_a_file_says_what_to_use(name: str, tmp_path: Path) -> None:
    folder = f"{tmp_path}/{name}"
    code, text = said("bake", SEAM, "-o", folder)
    assert (code, f"use --out-dir {folder}, or name the file" in text) == (2, True)
    for arguments in (["shader", "--lang", "glsl"], ["view", SEAM], ["render", SEAM]):
        code, text = said(*arguments, "-o", folder)
        assert (code, f"{folder} is a folder: name the file" in text) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_a_mistyped_folder_is_asked_about(tmp_path: Path) -> None:
    (tmp_path / "build").mkdir()
    shutil.copyfile(SEAM, tmp_path / "knight.glb")
    for name, question in (
        ("buid", "no such file or folder; did you mean 'build'?"),
        ("knigth", "no such file or folder; did you mean 'knight.glb'?"),
        ("zebra", "no such file or folder"),
    ):
        for command in (["bake", "--dry-run"], ["verify"], ["inspect"], ["view"]):
            code, text = said(*command, tmp_path / name)
            assert (code, text.endswith(f"{name}: {question}")) == (2, True)
    code, text = said("inspect", SEAM, tmp_path / "buid")
    assert (code, "buid: no such file or folder; did you mean 'build'?" in text) == (3, True)


@pytest.mark.parametrize("command", [["render", "-o", "a.png"], ["shader", "--lang", "glsl", "--for"]])
@pytest.mark.parametrize("name", ["build", "pack.glb"])
def test_a_folder_for_one_file_says_so(command: list[str], name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    code, text = said(*command, tmp_path / name)
    assert (code, text.endswith(f"{name} is a folder: name one file in it")) == (2, True)


@pytest.mark.parametrize("command", ["bake", "strip"])
def test_an_output_without_its_option_is_seen(command: str, tmp_path: Path) -> None:
    own = shutil.copyfile(SEAM, tmp_path / "hero.glb")
    missing = "give one of -o/--output, --out-dir, --in-place"
    for name, option in (("out.glb", "-o"), ("build", "--out-dir")):
        path = tmp_path / name
        advice = f"{missing}; {path} was taken for a second input: write {option} {path}"
        code, text = said(command, own, path)
        assert (code, text.endswith(advice)) == (2, True)
    # Neither is an output: a file that exists, a further one of several, a pattern, another format.
    for names in (["hero.glb"], ["a.glb", "b.glb"], ["*.glb"], ["out.txt"]):
        code, text = said(command, own, *(tmp_path / name for name in names))
        assert (code, text.endswith(missing)) == (2, True)
    assert [path.name for path in tmp_path.iterdir()] == ["hero.glb"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["bake", "--", "-x.glb", "--dry-run"],
        ["bake", "-o", "a.glb", "--", "-x.glb", "--dry-run"],
        ["bake", "--", "-x.glb", "--out-dir=build"],
        ["bake", "--", "-x.glb", "-q"],
        ["verify", "--", "-x.glb", "--json"],
        ["shader", "--", "--lang"],
    ],
)
def test_an_option_after_two_hyphens_is_told_where_options_stand(arguments: list[str]) -> None:
    code, text = said(*arguments)
    why = "was taken for the name of a file, because it stands after --. Write options before --"
    assert (code, text.endswith(f"Error: {arguments[-1]} {why}")) == (2, True)


def test_a_file_may_have_the_name_of_an_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "--json").mkdir()
    shutil.copyfile(SEAM, tmp_path / "--json" / "-x.glb")
    assert said("inspect", "--", "--json")[0] == 0
    assert said("inspect", "--", "--json/-x.glb")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["shader", "--lang", "glsl", "b/a.glb"], "unexpected argument b/a.glb; write --for b/a.glb"),
        (["shader", "--lang", "glsl", "hero"], "unexpected argument hero"),
        (["view", "hero.glb", "hero.html"], "unexpected argument hero.html; write -o hero.html"),
        (["view", "hero.glb", "other.glb"], "unexpected argument other.glb"),
        (["cost", "a.glb", "b.glb"], "unexpected arguments a.glb b.glb"),
    ],
)
def test_a_name_too_many_says_its_option(arguments: list[str], message: str) -> None:
    code, text = said(*arguments)
    assert (code, text.endswith(f"Error: {message}")) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["bake", "-hero.glb", "-o", "o.glb"], "-hero.glb"),
        (["verify", "-Zoo.GLB"], "-Zoo.GLB"),
        (["inspect", "--hero.vrm"], "--hero.vrm"),
        (["bake", "-ohero.glb", "-e"], None),
        (["bake", "a.glb", "-e", "-o", "o.glb"], None),
        (["bake", "--in-palce", "-q"], None),
    ],
)
def test_a_name_with_a_dash_is_not_an_option(arguments: list[str], name: str | None) -> None:
    code, text = said(*arguments)
    assert code == 2
    assert "No such option" in text
    assert ("A name that begins with - is written" in text) == (name is not None)
    assert name is None or text.endswith(f" ./{name}")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["verify", "x.glb", "--min-gain", "1,5"], "'--min-gain': expected a number like 1.5, found '1,5'"),
        (["verify", "x.glb", "--timeout", "1min"], "expected a number like 1.5, found '1min'"),
        (["bake", "x.glb", "--crease-angle", "15°"], "expected a number like 1.5, found '15°'"),
        (["shader", "--cap", "x"], "expected a number like 1.5, found 'x'"),
        (["cost", "--influences", "four"], "expected a whole number like 4, found 'four'"),
        (["bake", "x.glb", "--position-bits", "12.5"], "expected a whole number like 4, found '12.5'"),
        (["view", "x.glb", "--port", "http"], "expected a whole number like 4, found 'http'"),
    ],
)
def test_a_number_is_asked_for_in_plain_words(arguments: list[str], message: str) -> None:
    code, text = said(*arguments)
    assert (code, text.endswith(message)) == (2, True)


def test_counts_are_singular_and_plural() -> None:
    assert [counted(n, "vertex", "vertices") for n in (0, 1, 2, 1000)] == [
        "0 vertices",
        "1 vertex",
        "2 vertices",
        "1,000 vertices",
    ]


@pytest.mark.parametrize(
    ("change", "one", "two"),
    [
        ({0: [0.5, 0, 0, 0]}, "of 1 vertex do not sum to 1 (0.5)", "of 2 vertices do not sum"),
        ({0: [0, 0, 0, 0]}, "1 vertex has no weight at all", "bound to slot 0's joint; give them weights"),
        ({0: [1.5, -0.5, 0, 0]}, "1 vertex has negative weights", "2 vertices have negative weights"),
    ],
)
def test_warnings_of_one_vertex_are_singular(
    change: dict[int, list[float]], one: str, two: str, tmp_path: Path
) -> None:
    for count, words in ((1, one), (2, two)):
        part = sheet()
        weights = part.attributes["WEIGHTS_0"].copy()
        weights[:count] = change[0]
        path = write_model(tmp_path / f"{count}.glb", [sheet(WEIGHTS_0=weights)])
        assert words in said("bake", path, "--dry-run")[1]


class TestTerminal:
    def test_lines_break_between_words_and_paths_stay_whole(self) -> None:
        text = "  one two three four\nshort\n  a/very/long/path/that/is/wider x"
        assert fitted(text, 14) == (
            "  one two\n      three\n      four\nshort\n  a/very/long/path/that/is/wider\n      x"
        )
        assert fitted(text, None) == text
        assert fitted(text, 200) == text

    def test_colours_take_no_room(self) -> None:
        text = f"{click.style('warning:', fg='yellow')} one two three"
        assert click.unstyle(fitted(text, 16)) == "warning: one two\n    three"

    def test_verdicts_and_gains_have_colours(self) -> None:
        text = (
            "a.glb: FAILED\n  structure  passed  1 baked primitive\n  limits     failed\n"
            "  LBS gain          2.00x by tangents, 0.50x by triangles\n"
            '  LBS accurate  1.00  clip "9.99x"'
        )
        red, green = "\x1b[31m", "\x1b[32m"
        shown = with_colours(text)
        assert click.unstyle(shown) == text
        coloured = re.findall("(\x1b\\[3[12]m)([^\x1b]*)", shown)
        assert coloured == [
            (red, "FAILED"),
            (green, "passed"),
            (red, "failed"),
            (green, "2.00x"),
            (red, "0.50x"),
        ]

    @pytest.mark.slow
    @pytest.mark.skipif(sys.platform != "linux", reason="needs a pseudo terminal")
    def test_verify_fits_the_terminal(self, tmp_path: Path) -> None:
        import fcntl
        import pty
        import termios

        bake(SEAM, tmp_path / "a.glb")
        leader, follower = pty.openpty()
        fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 70, 0, 0))
        environment = {key: value for key, value in os.environ.items() if key not in {"COLUMNS", "NO_COLOR"}}
        subprocess.run(
            [sys.executable, "-m", "skinbake", "verify", "a.glb", "--poses", "rest", "-v"],
            cwd=tmp_path,
            env={**environment, "TERM": "xterm"},
            stdout=follower,
            stderr=follower,
            check=True,
        )
        os.close(follower)
        shown = os.read(leader, 20_000).decode()
        os.close(leader)
        assert "\x1b[32mpassed" in shown
        lines = click.unstyle(shown).splitlines()
        assert max(map(len, lines)) <= 70
        assert any("worst at" in line for line in lines)

    @pytest.mark.slow
    @pytest.mark.skipif(sys.platform != "linux", reason="needs a pseudo terminal")
    @pytest.mark.parametrize("no_color", [False, True])
    def test_bake_of_many_fits_the_terminal(self, no_color: bool, tmp_path: Path) -> None:
        import fcntl
        import pty
        import termios

        for number in range(6):
            shutil.copyfile(SEAM, tmp_path / f"character_of_a_game_{number}.glb")
        (tmp_path / "broken.glb").write_bytes(b"glTF")
        leader, follower = pty.openpty()
        fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 70, 0, 0))
        environment = {key: value for key, value in os.environ.items() if key not in {"COLUMNS", "NO_COLOR"}}
        subprocess.run(
            [sys.executable, "-m", "skinbake", "bake", ".", "--out-dir", "out"],
            cwd=tmp_path,
            env={**environment, "TERM": "xterm", **({"NO_COLOR": "1"} if no_color else {})},
            stdout=follower,
            stderr=follower,
            check=False,
        )
        os.close(follower)
        shown = os.read(leader, 20_000).decode()
        os.close(leader)
        assert ("\x1b[31m\x1b[1merror:" in shown, "\x1b[3" in shown) == (not no_color, not no_color)
        lines = click.unstyle(shown).splitlines()
        assert max(map(len, lines)) <= 70
        assert any(line.startswith("7 files: 6 baked, 1 failed, in ") for line in lines)
