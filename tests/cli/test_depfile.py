"""--depfile: the rules that Make and Ninja read, held against both of them."""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from skinbake.errors import OutputError
from skinbake.report.depfile import depfile
from tests.support.command_line import document, invoke
from tests.support.gltf_reading import read
from tests.support.models import FOLDER, SHARED, SHARED_BIN, copied, edited
from tests.support.tools import required_program

BUFFER = SHARED_BIN.replace(" ", "\\ ")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a folder with a .gltf, its buffer, and an image; it is the current folder."""
    source = edited(
        SHARED, tmp_path / "art", lambda content: content.update(images=[{"uri": "skin%20%231.png"}])
    )
    source.rename(source.with_name("hero.gltf"))
    (tmp_path / "art" / "skin #1.png").write_bytes(b"\x89PNG")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rules(path: str) -> dict[str, str]:
    """Return what stands after each name of a depfile, up to its colon."""
    lines = [line for line in Path(path).read_text(encoding="utf-8").splitlines() if line]
    return {line.partition(":")[0]: line.partition(":")[2].strip() for line in lines}


class TestFilesRead:
    def test_buffers_and_copied_images(self, here: Path) -> None:
        assert (
            invoke("bake", "art/hero.gltf", "-o", "out/hero.gltf", "--depfile", "deps/hero.d").exit_code == 0
        )
        art = [f"art/{BUFFER}", "art/skin\\ \\#1.png"]
        assert rules("deps/hero.d") == {
            "out/hero.gltf": " ".join(["art/hero.gltf", *art]),
            "art/hero.gltf": "",
            **dict.fromkeys(art, ""),
        }

    def test_an_image_counts_if_it_is_read(self, here: Path) -> None:
        invoke("bake", "art/hero.gltf", "-o", "art/plain.glb", "--depfile", "hero.d")
        assert rules("hero.d")["art/plain.glb"] == f"art/hero.gltf art/{BUFFER}"
        invoke("bake", "art/hero.gltf", "-o", "art/packed.glb", "--pack", "--depfile", "hero.d")
        assert rules("hero.d")["art/packed.glb"] == f"art/hero.gltf art/{BUFFER} art/skin\\ \\#1.png"

    def test_absolute_inputs_have_absolute_rules(self, here: Path) -> None:
        invoke("bake", here / "art" / "hero.gltf", "-o", here / "art" / "a.glb", "--depfile", "hero.d")
        buffer = str(here / "art" / SHARED_BIN).replace(" ", "\\ ")
        assert rules("hero.d")[str(here / "art" / "a.glb")] == f"{here / 'art' / 'hero.gltf'} {buffer}"

    def test_each_output_of_a_folder_has_a_rule(self, here: Path) -> None:
        shutil.copyfile(FOLDER / "seam.glb", "art/seam.glb")
        assert invoke("bake", "art", "--out-dir", "out", "--depfile", "all.d").exit_code == 0
        found = rules("all.d")
        assert found["out/seam.glb"] == "art/seam.glb"
        assert found["out/hero.gltf"].startswith("art/hero.gltf art/shared")

    def test_a_run_in_which_one_file_fails_has_rules_for_those_that_worked(self, here: Path) -> None:
        shutil.copyfile(FOLDER / "seam.glb", "art/seam.glb")
        call = ["bake", "art", "--out-dir", "out", "--depfile", "all.d"]
        assert invoke(*call).exit_code == 0
        before = Path("all.d").read_text(encoding="utf-8")
        buffer = Path("art", SHARED_BIN)
        buffer.write_bytes(buffer.read_bytes()[:8])
        assert invoke(*call).exit_code == 3
        after = Path("all.d").read_text(encoding="utf-8")
        assert after.startswith("out/seam.glb: art/seam.glb")
        assert "out/hero.gltf:" in before
        assert "out/hero.gltf:" not in after

    @pytest.mark.parametrize("before", [None, "a.glb: art/broken.glb\n", ""])
    @pytest.mark.parametrize("command", ["bake", "strip"])
    def test_a_run_that_writes_no_output_leaves_the_depfile(
        self, command: str, before: str | None, here: Path
    ) -> None:
        Path("art/broken.glb").write_bytes(b"no glTF")
        if before is not None:
            Path("a.d").write_text(before, encoding="utf-8")
        assert invoke(command, "art/broken.glb", "-o", "a.glb", "--depfile", "a.d").exit_code == 3
        after = Path("a.d").read_text(encoding="utf-8") if Path("a.d").exists() else None
        assert after == before

    @pytest.mark.slow
    def test_files_of_poses_count_for_each_output(self, here: Path) -> None:
        copied(SHARED, here / "clips")
        shutil.copyfile(FOLDER / "seam.glb", "art/seam.glb")
        options = ["--gradients", "fitted", "--fit-poses", f"clips/{SHARED}"]
        result = invoke("bake", "art/seam.glb", "-o", "a.glb", "--depfile", "a.d", *options)
        assert result.exit_code == 0, result.stderr
        assert rules("a.d")["a.glb"] == f"art/seam.glb clips/{SHARED} clips/{BUFFER}"

    def test_a_file_that_is_up_to_date_keeps_its_rule(self, here: Path) -> None:
        call = [
            "bake",
            "art/hero.gltf",
            "--out-dir",
            "out",
            "--skip-unchanged",
            "--json",
            "--depfile",
            "hero.d",
        ]
        assert document(invoke(*call))["files"][0]["status"] == "baked"
        first = Path("hero.d").read_bytes()
        Path("hero.d").unlink()
        assert document(invoke(*call))["files"][0]["status"] == "up-to-date"
        assert Path("hero.d").read_bytes() == first

    def test_strip_has_it_too(self, here: Path) -> None:
        invoke("bake", "art/hero.gltf", "-o", "art/baked.gltf")
        assert invoke("strip", "art/baked.gltf", "-o", "back.glb", "--depfile", "b.d").exit_code == 0
        assert rules("b.d")["back.glb"].startswith(f"art/baked.gltf art/{BUFFER} art/skinbake-")

    @pytest.mark.slow
    def test_in_several_processes(self, here: Path, workers: list[int]) -> None:
        shutil.copyfile(FOLDER / "seam.glb", "art/seam.glb")
        for number, jobs in enumerate(("1", "2")):
            assert (
                invoke("strip", "art", "--out-dir", "out", "--depfile", f"{number}.d", "-j", jobs).exit_code
                == 0
            )
        assert Path("0.d").read_bytes() == Path("1.d").read_bytes()
        assert workers == [2]

    def test_a_dry_run_writes_nothing(self, here: Path) -> None:
        for target in ([], ["-o", "a.glb"]):
            assert invoke("bake", "art/hero.gltf", *target, "--dry-run", "--depfile", "a.d").exit_code == 0
        assert [path.name for path in here.iterdir()] == ["art"]


class TestRefused:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["bake", "-", "-o", "a.glb", "--depfile", "a.d"], "needs files as inputs and outputs, not -"),
            (
                ["bake", "art/hero.gltf", "-o", "-", "--depfile", "a.d"],
                "needs files as inputs and outputs, not -",
            ),
            (["bake", "memory://a.glb", "-o", "a.glb", "--depfile", "a.d"], "and no URLs"),
            (["bake", "art", "--in-place", "--depfile", "a.d"], "each file would depend on itself"),
            (["strip", "art", "--in-place", "--depfile", "a.d"], "each file would depend on itself"),
            (["bake", "art", "--out-dir", "o", "--dask", "tcp://a:1", "--depfile", "a.d"], "give only one"),
            (
                ["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "art/hero.gltf"],
                "is the name of a model",
            ),
            (["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "link"], "is the name of a model"),
            (["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "hard"], "is an input"),
            (["strip", "art/hero.gltf", "-o", "a.glb", "--depfile", "hard"], "is an input"),
            (
                ["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", f"art/{SHARED_BIN}"],
                "exists and was not",
            ),
            (["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "Makefile"], "exists and was not"),
            (
                ["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "s", "--summary", "s"],
                "the file of --summary",
            ),
        ],
    )
    def test_usage(self, arguments: list[str], message: str, here: Path) -> None:
        Path("link").symlink_to("art/hero.gltf")
        os.link("art/hero.gltf", "hard")
        Path("Makefile").write_text("all.glb: a\n\tskinbake bake a -o all.glb\n", encoding="utf-8")
        before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
        result = invoke(*arguments)
        assert result.exit_code == 2
        assert message in " ".join(result.stderr.split())
        assert before == {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}

    @pytest.mark.parametrize(
        "name", ["a;b.glb", "a=b.glb", "a|b.glb", "a*b.glb", "a\nb.glb", "a%b.glb", "a\\#b.glb"]
    )
    def test_a_name_that_no_rule_can_hold(self, name: str, here: Path) -> None:
        Path(name).write_bytes((FOLDER / "seam.glb").read_bytes())
        result = invoke("bake", name, "--out-dir", "out", "--depfile", "a.d")
        assert result.exit_code == 4
        assert "cannot stand in a depfile" in " ".join(result.stderr.split())
        assert not Path("a.d").exists()
        assert not Path("out").exists(), "the name was known before the bake"

    @pytest.mark.parametrize("command", ["bake", "strip"])
    def test_the_name_of_a_buffer_that_no_rule_can_hold(self, command: str, here: Path) -> None:
        """Nothing is written: an output without its rule would count as new at the next build."""
        edited(SHARED, here / "art", lambda content: content["buffers"][0].update(uri="a=b.bin"))
        (here / "art" / SHARED_BIN).rename(here / "art" / "a=b.bin")
        result = invoke(command, f"art/{SHARED}", "-o", "a.glb", "--depfile", "a.d")
        assert result.exit_code == 4
        assert "a=b.bin: its name cannot stand in a depfile" in " ".join(result.stderr.split())
        assert not Path("a.glb").exists()
        assert not Path("a.d").exists()

    def test_the_name_of_a_configuration_file(self, here: Path) -> None:
        Path("a=b.toml").touch()
        call = ["bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "a.d", "--config", "a=b.toml"]
        result = invoke(*call)
        assert result.exit_code == 4
        assert "a=b.toml: its name cannot stand in a depfile" in " ".join(result.stderr.split())
        assert not Path("a.glb").exists()

    def test_a_depfile_that_cannot_be_written(self, here: Path) -> None:
        Path("file").touch()
        result = invoke("bake", "art/hero.gltf", "-o", "a.glb", "--depfile", "file/a.d")
        assert result.exit_code == 4
        assert Path("a.glb").exists()


MAKEFILE = """
-include hero.d
{target}: art/hero.gltf
\t@{python} -m skinbake bake -q art/hero.gltf -o {quoted} --depfile hero.d && echo built
"""

NINJA = """
rule bake
  command = {python} -m skinbake bake -q $in --out-dir out --depfile $depfile
  depfile = all.d
  deps = gcc
build {outputs}: bake art
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="names with these characters do not exist there")
class TestRealBuilds:
    def test_make_rebuilds_what_changed(self, here: Path) -> None:
        make = required_program("make")
        target = "out #1 of 5/a b.gltf"
        escaped = target.replace("#", "\\#").replace(" ", "\\ ")
        quoted = f"'{target}'"
        (here / "Makefile").write_text(
            MAKEFILE.format(target=escaped, quoted=quoted, python=sys.executable), encoding="utf-8"
        )

        def built() -> bool:
            done = subprocess.run([make, target], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            return "built" in done.stdout

        assert [built(), built()] == [True, False]
        for name in (SHARED_BIN, "skin #1.png", "hero.gltf"):
            os.utime(here / "art" / name, (4e9, 4e9))
            assert built(), name
            os.utime(here / "art" / name, (1e9, 1e9))
            os.utime(here / target)
            assert not built(), name
        (here / "art" / "skin #1.png").unlink()
        assert [built(), built()] == [True, False]  # and not an error: the rule without a recipe is there

    def test_ninja_rebuilds_what_changed(self, here: Path) -> None:
        ninja = required_program("ninja")
        shutil.copyfile(FOLDER / "seam.glb", here / "art" / "a b#d:e.glb")
        outputs = "out/a$ b#d$:e.glb out/hero.gltf"
        (here / "build.ninja").write_text(
            NINJA.format(outputs=outputs, python=sys.executable), encoding="utf-8"
        )

        def built() -> bool:
            done = subprocess.run([ninja], capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stdout
            return "no work to do" not in done.stdout

        assert [built(), built()] == [True, False]
        for name in (SHARED_BIN, "skin #1.png", "a b#d:e.glb"):
            os.utime(here / "art" / name)
            assert [built(), built()] == [True, False], name
        (here / "art" / "skin #1.png").unlink()
        assert [built(), built()] == [True, False]
        assert read(here / "out" / "a b#d:e.glb").has_attribute("_SKINBAKE_ALPHA_0")


PIECES = (
    *"aZ09_-+.,/@!{}()~ #:=&'\"%?[]*$|;<>^`\\\t",
    *(
        "\n",
        "\x7f",
        "é",
        "\u00a0",
        "\u2028",
        "\ufeff",
        "😀",
        "..",
        "--",
        " (1)",
        "&:",
        "$$",
        "$(shell touch ran)",
        "%.o",
        ".c",
        ".c.o",
    ),
    *("include ", "-include ", "export ", "define ", "endif", "ifeq", "override ", "private ", "load "),
)
"""What names are made of. The words are those that Make reads at the beginning of a line."""

SPECIAL = (
    *(".PHONY", ".SUFFIXES", ".DEFAULT", ".PRECIOUS", ".INTERMEDIATE", ".SECONDARY", ".SECONDEXPANSION"),
    *(".DELETE_ON_ERROR", ".IGNORE", ".LOW_RESOLUTION_TIME", ".SILENT", ".EXPORT_ALL_VARIABLES"),
    *(".NOTPARALLEL", ".ONESHELL", ".POSIX", ".WAIT", ".MAKE", ".NOTINTERMEDIATE", ".BEGIN", ".END"),
    *(".c", ".c.o", ".o", ".sh", ".y.c", ".glb"),
)
"""Targets by which GNU Make, POSIX or BSD change other rules, and suffix rules, which may have recipes."""

RULES_OF_MAKE = """
.SECONDEXPANSION:
{output}: ; @echo built
failing:
\t@false
\t@echo went on
-include out.d
"""

RULES_OF_NINJA = """
rule r
  command = cp out.d copy.d; echo built
  depfile = copy.d
  deps = gcc
build {output}: r
"""


def odd_names(seed: int, count: int) -> list[str]:
    """Return names of files: each piece alone, first, last and between, and pieces drawn at random."""
    drawn = random.Random(seed)
    names = [text for piece in PIECES for text in (piece, f"{piece}b", f"a{piece}", f"a{piece}b")]
    names += ["".join(drawn.choices(PIECES, k=drawn.randint(2, 6))) for _ in range(count)]
    inside = [name for name in dict.fromkeys(names) if {".", ".."}.isdisjoint(name.split("/"))]
    return [name for name in inside if os.path.normpath(name) == name and not name.startswith("/")]


def holds(output: str, read: list[str]) -> str | None:
    """Return the rule of an output, None if it is refused."""
    try:
        return depfile([(output, read)])
    except OutputError:
        return None


class Tools:
    """A folder with one output, and Make and Ninja, which have its depfile."""

    def __init__(self, folder: Path, output: str, read: Sequence[str]) -> None:
        self._folder, self._output, self._read = folder, output, read
        self._programs = required_program("make"), required_program("ninja")
        for name in (output, *read):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).touch()
        (folder / "out.d").write_text(depfile([(output, read)]), encoding="utf-8")
        of_make, of_ninja = output, output
        for escaped in " #:":
            of_make = of_make.replace(escaped, f"\\{escaped}")
        for escaped in " :":
            of_ninja = of_ninja.replace(escaped, f"${escaped}")
        (folder / "Makefile").write_text(RULES_OF_MAKE.format(output=of_make), encoding="utf-8")
        (folder / "build.ninja").write_text(RULES_OF_NINJA.format(output=of_ninja), encoding="utf-8")
        self._aged()
        self._run(self._programs[1])  # Ninja knows no rule before its first build

    def builds(self, *, newer: str | None = None, without: str | None = None) -> tuple[str, ...]:
        """Return the tools that build the output, where one file read is newer, or was removed."""
        found = []
        for program in self._programs:
            self._aged()
            if newer is not None:
                os.utime(self._folder / newer, (3e9, 3e9))
            if without is not None:
                (self._folder / without).unlink()
            if "built\n" in self._run(program):
                found.append(Path(program).name)
            if without is not None:
                (self._folder / without).touch()
        return tuple(found)

    def failing(self) -> tuple[int, str]:
        """Make a target of the same Makefile whose recipe fails."""
        done = self._called(self._programs[0], "failing")
        return done.returncode, done.stdout

    def _aged(self) -> None:
        for name in self._read:
            os.utime(self._folder / name, (1e9, 1e9))
        os.utime(self._folder / self._output, (2e9, 2e9))

    def _run(self, program: str) -> str:
        done = self._called(program, *(["--", self._output] if program.endswith("make") else []))
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def _called(self, *call: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(call, cwd=self._folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="names with these characters do not exist there")
class TestNames:
    """Each name, as output and as prerequisite, is refused, or is exactly that file to Make and to Ninja."""

    @pytest.mark.parametrize("seed", range(4))
    def test_of_files_read(self, seed: int, tmp_path: Path) -> None:
        names = [name for name in odd_names(seed, 150) if holds("out.glb", [name])][seed::4]
        assert len(names) > 25
        for number in range(0, len(names), 8):
            folder = tmp_path / str(number)
            some = list(dict.fromkeys(["in.glb", *names[number : number + 8], "last.bin"]))
            folder.mkdir()
            some = [name for name in some if not any(other.startswith(f"{name}/") for other in some)]
            tools = Tools(folder, "out.glb", some)
            assert tools.builds() == ()
            for name in some:
                assert tools.builds(newer=name) == ("make", "ninja"), name
                assert tools.builds(without=name) == ("make", "ninja"), name
            assert tools.failing() == (2, "")
            assert not (folder / "ran").exists()

    @pytest.mark.parametrize("seed", range(2))
    def test_of_outputs(self, seed: int, tmp_path: Path) -> None:
        names = [name for name in odd_names(seed, 100) if holds(name, ["in.glb"])][seed::2]
        assert len(names) > 25
        for number, name in enumerate(names):
            (tmp_path / str(number)).mkdir()
            tools = Tools(tmp_path / str(number), name, ["in.glb"])
            assert tools.builds() == (), name
            assert tools.builds(newer="in.glb") == ("make", "ninja"), name
            assert tools.failing() == (2, ""), name


@pytest.mark.parametrize("folder", ["", "./", ".//", "././"])
def test_a_name_that_is_a_target_of_make_for_other_rules(folder: str) -> None:
    for name in SPECIAL:
        assert holds("out.glb", [f"{folder}{name}"]) is None
        assert holds(f"{folder}{name}", ["in.glb"]) is None
        assert holds("out.glb", [f"art/{name}"]) is not None


def test_an_archive_is_in_no_rule_also_in_two_names() -> None:
    assert holds("out.glb", ["lib(a", "b)"]) is None
    assert holds("out.glb", ["texture (1).png"]) == "out.glb: texture\\ (1).png\n\ntexture\\ (1).png:\n"


def test_a_name_is_listed_once() -> None:
    assert depfile([("a.glb", ["b", "c", "b"]), ("d.glb", ["c"])]) == "a.glb: b c\nd.glb: c\n\nb:\n\nc:\n"
    with pytest.raises(OutputError, match="Rename"):
        depfile([("a.glb", ["b>c"])])
    with pytest.raises(OutputError, match=re.escape("')'")):
        depfile([("a.glb", ["lib(member)"])])
