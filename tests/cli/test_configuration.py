"""Configuration files: where they are found, what they may set, and that overrides reach their files."""

from __future__ import annotations

import os
import pickle
import re
import shutil
import time
import tomllib
from pathlib import Path
from typing import Any

import click
import pytest

from skinbake.choices import Encoding
from skinbake.cli.configuration import (
    PER_FILE,
    matches,
    options_of,
)
from skinbake.cli.main import COMMANDS, main
from skinbake.commands.bake_options import BakeOptions
from skinbake.jobs.bake import Bake
from skinbake.jobs.file_work import FileWork
from skinbake.jobs.work import Job
from skinbake.options import By
from tests.support.command_line import document, invoke, run
from tests.support.models import FOLDER
from tests.support.schemas import CONFIG, checked

SEAM = FOLDER / "seam.glb"
PAGE = Path(__file__).parents[2] / "docs" / "reference" / "configuration.md"
SIZES = {24: "float32", 16: "snorm16", 8: "packed8"}


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make the root of a repository with models, and go there."""
    folder = tmp_path / "project"
    for name in ("a.glb", "heroes/knight.glb", "heroes/crowd/pawn.glb"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(SEAM, folder / name)
    (folder / ".git").mkdir()
    monkeypatch.chdir(folder)
    return folder


def encodings(*arguments: str | Path) -> dict[str, str]:
    """Return the encoding of each baked file, from the bytes that α and β take."""
    found = document(invoke("bake", *arguments, "--dry-run", "--json"))["files"]
    return {file["input"]: SIZES[file["primitives"][0]["bytes_per_vertex"]] for file in found}


def refused(text: str, *command: str) -> str:
    """Return the message about a configuration, which ends the command."""
    Path("skinbake.toml").write_text(text, encoding="utf-8")
    result = invoke(*(command or ("bake", "a.glb", "--dry-run")))
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    return result.stderr.removeprefix("error: ").strip()


class TestSearch:
    def test_the_nearest_file_wins_alone(self, project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        assert encodings("a.glb") == {"a.glb": "snorm16"}
        monkeypatch.chdir("heroes/crowd")
        assert encodings("pawn.glb") == {"pawn.glb": "snorm16"}
        (project / "heroes" / "skinbake.toml").write_text("")
        assert encodings("pawn.glb") == {"pawn.glb": "float32"}

    def test_the_search_for_a_configuration_ends_at_the_root_of_a_repository(self, project: Path) -> None:
        (project.parent / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        assert encodings("a.glb") == {"a.glb": "float32"}
        (project / ".git").rmdir()
        assert encodings("a.glb") == {"a.glb": "snorm16"}

    def test_the_own_file_beats_that_of_the_project(self, project: Path) -> None:
        (project / "pyproject.toml").write_text('[tool.skinbake.bake]\nencoding = "packed8"\n')
        assert encodings("a.glb") == {"a.glb": "packed8"}
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        assert encodings("a.glb") == {"a.glb": "snorm16"}

    @pytest.mark.parametrize(
        "text",
        [
            "not TOML at all",
            '[project]\nname = "x"\n',
            '[project]\ndescription = "uses tool.skinbake"\n',
        ],
    )
    def test_a_project_without_the_table_does_not_count(
        self, text: str, project: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        (project / "heroes" / "pyproject.toml").write_text(text)
        monkeypatch.chdir("heroes")
        assert encodings("knight.glb") == {"knight.glb": "snorm16"}

    @pytest.mark.parametrize("header", ["[tool.skinbake.bake]", '[ tool . "skinbake" . bake ]'])
    def test_the_table_is_found_however_it_is_spelt(self, header: str, project: Path) -> None:
        (project / "pyproject.toml").write_text(f'{header}\nencoding = "packed8"\n')
        assert encodings("a.glb") == {"a.glb": "packed8"}

    def test_the_user_can_name_a_file_or_leave_it_out(self, project: Path) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        (project / "other.toml").write_text('[bake]\nencoding = "packed8"\n')
        assert encodings("a.glb", "--config", "other.toml") == {"a.glb": "packed8"}
        assert encodings("a.glb", "--no-config") == {"a.glb": "float32"}
        for order in (["--config", "other.toml", "--no-config"], ["--no-config", "--config", "other.toml"]):
            result = invoke("bake", "a.glb", "--dry-run", *order)
            assert result.exit_code == 2
            assert "--config and --no-config contradict each other" in result.stderr

    def test_a_named_project_file_needs_the_table(self, project: Path) -> None:
        (project / "pyproject.toml").write_text("[tool.other]\n")
        result = invoke("bake", "a.glb", "--dry-run", "--config", "pyproject.toml")
        assert result.exit_code == 2
        assert "--config: pyproject.toml has no [tool.skinbake]" in result.stderr

    def test_a_file_that_cannot_be_read_ends_the_command(self, project: Path) -> None:
        result = invoke("bake", "a.glb", "--dry-run", "--config", "none.toml")
        assert (result.exit_code, result.stderr) == (
            2,
            "error: none.toml cannot be read: No such file or directory\n",
        )
        (project / "skinbake.toml").mkdir()
        assert "skinbake.toml cannot be read: Is a directory" in invoke("cost").stderr

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
    def test_a_pipe_does_not_hang(self, project: Path) -> None:
        os.mkfifo("skinbake.toml")
        assert "skinbake.toml cannot be read: it is not a regular file" in invoke("cost").stderr
        Path("skinbake.toml").unlink()
        os.mkfifo("pyproject.toml")
        assert invoke("cost").exit_code == 0

    def test_help_and_completion_read_no_file(self, project: Path) -> None:
        (project / "skinbake.toml").write_text("no TOML")
        assert invoke("bake", "--help").exit_code == 0
        asked = {
            "_SKINBAKE_COMPLETE": "bash_complete",
            "COMP_WORDS": "skinbake bake --enc",
            "COMP_CWORD": "2",
        }
        assert "--encoding" in invoke(env=asked).stdout

    @pytest.mark.slow
    def test_tomllib_is_not_imported_without_a_configuration(self, project: Path) -> None:
        code = (
            "import sys\nfrom skinbake.cli.main import main\n"
            "main(['cost', '-q'], standalone_mode=False)\n"
            "print([name for name in sys.modules if 'tomllib' in name])"
        )
        (project / "pyproject.toml").write_text('[tool.other]\nskin = "bake"\n')
        assert run(command=("-c", code)).stdout == b"[]\n"
        (project / "skinbake.toml").write_text("")
        assert b"tomllib" in run(command=("-c", code)).stdout


class TestValues:
    def test_the_command_line_wins(self, project: Path) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        assert encodings("a.glb", "--encoding", "packed8") == {"a.glb": "packed8"}

    def test_the_mark_before_the_text_of_some_editors_is_passed_over(self, project: Path) -> None:
        (project / "skinbake.toml").write_bytes(b'\xef\xbb\xbf[bake]\r\nencoding = "snorm16"\r\n')
        assert encodings("a.glb") == {"a.glb": "snorm16"}
        (project / "skinbake.toml").write_bytes(b'\xef\xbb\xbf[bake]\nencoding = "snorm6"\n')
        result = invoke("bake", "a.glb", "--dry-run")
        assert result.exit_code == 2
        assert "skinbake.toml:2: bake.encoding" in result.stderr

    def test_v_and_q_of_the_command_line_win(self, project: Path) -> None:
        """Neither has an opposite on the command line."""
        (project / "skinbake.toml").write_text("[bake]\nquiet = true\n")
        assert invoke("bake", "a.glb", "--dry-run").stdout == ""
        assert "a.glb (dry run): baked" in invoke("bake", "a.glb", "--dry-run", "-v").stdout
        (project / "skinbake.toml").write_text("[bake]\nverbose = 2\n")
        assert "sets verbose" in invoke("bake", "a.glb", "--dry-run").stderr
        for arguments in (["-q"], ["-q", "-v"]):
            result = invoke("bake", "a.glb", "--dry-run", *arguments)
            assert (result.stdout, result.stderr) == ("", "")

    def test_each_command_has_its_table(self, project: Path) -> None:
        (project / "skinbake.toml").write_text("[cost]\ninfluences = 4\njson = true\n")
        assert document(invoke("cost"))["influences"] == 4
        assert encodings("a.glb") == {"a.glb": "float32"}

    @pytest.mark.parametrize(
        ("line", "message"),
        [
            ('encoding = "snorm6"', "bake.encoding: 'snorm6' is not one of"),
            ('encoding = "snorm6"', "Did you mean 'snorm16'?"),
            ("encoding = 16", "bake.encoding: 16: expected a text in quotes"),
            ("limit-influences = 4.5", "bake.limit-influences: 4.5: expected an integer"),
            ("limit-influences = true", "bake.limit-influences: true: expected an integer"),
            ("limit-influences = 3", "bake.limit-influences: expected a whole number of at least 4, found 3"),
            ('crease-angle = "15"', "bake.crease-angle: '15': expected a number"),
            ("crease-angle = nan", "bake.crease-angle: expected a number from 0 to 180, found nan"),
            ("crease-angle = 181", "bake.crease-angle: expected a number from 0 to 180, found 181"),
            ("require-baked = 1", "bake.require-baked: 1: expected true or false"),
            ('gradients = ["rig"]', "bake.gradients: ['rig']: expected a text in quotes"),
            ('fit-poses = "animations"', "bake.fit-poses: 'animations': expected an array of texts"),
            ("jobs = -1", "bake.jobs: expected a number of processes up to 256, or auto, found "),
            ("jobs = 100000", "bake.jobs: expected a number of processes up to 256, or auto, found "),
            ("jobs = 1.5", "bake.jobs: 1.5: expected an integer, or a text in quotes"),
            (
                "encodng = 1",
                "bake.encodng: unknown key: expected an option of skinbake bake",
            ),
            ("encodng = 1", "did you mean 'encoding'?"),
            ("generate_normals = true", "did you mean 'generate-normals'?"),
            ("config = 1", "bake.config: unknown key"),
        ],
    )
    def test_mistakes_name_the_line_and_the_key(self, line: str, message: str, project: Path) -> None:
        found = refused(f"# options\n[bake]\n\nwarnings-as-errors = false\n{line}\n")
        assert found.startswith("skinbake.toml:5: ")
        assert message in found

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("bake = 3\n", "skinbake.toml:1: bake: expected a table"),
            ("[bkae]\n", "skinbake.toml:1: bkae: unknown key"),
            ("[bkae]\n", "did you mean 'bake'?"),
            (
                "encoding = 1\n",
                "skinbake.toml:1: encoding: unknown key: expected the table",
            ),
            ("encoding = 1\n", "of a command, like [bake], or [[overrides]]"),
            (
                "[tool.skinbake.bake]\nencoding = 1\n",
                "skinbake.toml:1: tool: this is for pyproject.toml: name the tables [bake], [verify] …",
            ),
            ("[bake]\nencoding = \n", "skinbake.toml is not valid TOML: Invalid value (at line 2"),
            ("[bake]\nencoding = snorm16\n", "(at line 2, column 12); text stands in quotes"),
            ("[bake]\n\xe4\n", "skinbake.toml is not valid TOML"),
            ("[overrides]\n", "skinbake.toml:1: overrides: expected an array of tables"),
            ("overrides = [3]\n", "skinbake.toml:1: overrides[0]: expected a table"),
            ("[[overrides]]\n", 'skinbake.toml:1: overrides[0]: it needs files = ["…"]'),
            (
                "[[overrides]]\nfiles = 'a'\n",
                "skinbake.toml:2: overrides[0].files: expected an array of patterns",
            ),
            ("[[overrides]]\nfiles = []\n", "overrides[0].files: expected an array of patterns"),
            ("[[overrides]]\nfiles = ['/a']\n", "'/a': expected a path from the folder of skinbake.toml"),
            ("[[overrides]]\nfiles = ['../a']\n", "'../a': expected a path from the folder"),
            ("[[overrides]]\nfiles = ['a\\b']\n", "expected a path from the folder"),
            (
                "[[overrides]]\nfiles = ['a']\nbakes = {}\n",
                "skinbake.toml:3: overrides[0].bakes: unknown key",
            ),
            (
                "[[overrides]]\nfiles = ['a']\n[[overrides]]\nfiles = ['a']\nbake = { jobs = 2 }\n",
                "skinbake.toml:5: overrides[1].bake.jobs: this option is the same for all files",
            ),
            (
                "[[overrides]]\nfiles = ['a']\n[overrides.bake]\nencoding = 'x'\n",
                "skinbake.toml:4: overrides[0].bake.encoding: 'x' is not one of",
            ),
        ],
    )
    def test_mistakes_of_tables(self, text: str, message: str, project: Path) -> None:
        assert message in refused(text)

    def test_a_file_that_is_no_text(self, project: Path) -> None:
        (project / "skinbake.toml").write_bytes(b"glTF\x86\xff")
        result = invoke("bake", "a.glb", "--dry-run")
        assert result.stderr == "error: skinbake.toml is not valid TOML: it is not text in UTF-8\n"

    def test_lines_are_those_of_the_key_not_of_its_name(self, project: Path) -> None:
        text = (
            '# encoding\n[verify]\nposes = """\nrandom:2"""\n'
            '[bake]\nalpha-name = """_\nencoding = 1\n{set}"""\n'
            'layout = "custom"  # not encoding\nencoding = "no"\n'
        )
        assert refused(text).startswith("skinbake.toml:10: bake.encoding: 'no' is not one of")

    def test_a_line_of_the_project_s_file(self, project: Path) -> None:
        (project / "pyproject.toml").write_text(
            '[project]\nencoding = "no"\n[tool.skinbake.bake]\nencoding = "no"\n'
        )
        result = invoke("bake", "a.glb", "--dry-run")
        assert result.stderr.startswith("error: pyproject.toml:4: bake.encoding: 'no' is not one of")

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("#" + " " * (1 << 16), "larger than 65,536 bytes, too large for options"),
            ("a = " + "[" * 10_000, "not valid TOML: it is nested too deep"),
            ("[bake]\njobs = [{a = " + "9" * 5000 + "}]", "not valid TOML: Exceeds the limit (4300 digits)"),
        ],
    )
    def test_absurd_files_end_with_a_message(self, text: str, message: str, project: Path) -> None:
        assert refused(text).startswith(f"skinbake.toml is {message}")

    def test_a_number_past_all_floats_is_too_large(self, project: Path) -> None:
        found = refused(f"[bake]\ncrease-angle = {10**400}")
        assert found == "skinbake.toml:2: bake.crease-angle: the number is too large"

    @pytest.mark.slow
    @pytest.mark.parametrize("is_wrong", [False, True])
    def test_hundreds_of_overrides_and_mentions_are_parsed_a_few_times(
        self, is_wrong: bool, project: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Many overrides took minutes, to find the line of each."""
        override = '[[overrides]]\nfiles = ["*.glb"]\n[overrides.bake]\nencoding = "packed8"\n'
        text = override * 500 + "# encoding\n" * 1000
        text += override.replace("packed8", "no") if is_wrong else ""
        parsed, loads = list[int](), tomllib.loads

        def counted(some: str) -> Any:
            parsed.append(len(some))
            return loads(some)

        monkeypatch.setattr(tomllib, "loads", counted)
        (project / "skinbake.toml").write_text(text)
        result = invoke("bake", "a.glb", "--dry-run")
        assert result.exit_code == (2 if is_wrong else 0), result.stderr
        assert sum(parsed) < 60 * len(text)

    def test_an_error_of_many_overrides_names_those_that_win(self, project: Path) -> None:
        override = '[[overrides]]\nfiles = ["*.glb"]\n[overrides.bake]\nlimit-influences = 4\n'
        said = refused(5 * override + override.replace("limit-influences = 4", 'neighbours = "extend"'))
        assert "overrides[5]" in said
        assert "overrides[2]" not in said

    def test_a_file_of_the_largest_size_is_read(self, project: Path) -> None:
        (project / "skinbake.toml").write_text("[bake]\n#".ljust(1 << 16))
        assert invoke("bake", "a.glb", "--dry-run").exit_code == 0

    def test_a_contradiction_says_what_comes_from_the_file(self, project: Path) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\nskip-unchanged = true\n')
        result = invoke("bake", "a.glb", "--dry-run", "--layout", "texcoord", "--out-dir", "out")
        assert result.exit_code == 2
        assert "--layout texcoord needs --encoding float32" in result.stderr
        assert "(skinbake.toml:2 sets encoding; --no-config leaves it out)" in result.stderr
        result = invoke("bake", "a.glb", "-o", "b.glb")
        assert "--skip-unchanged needs --state FILE" in result.stderr
        assert "skinbake.toml:3 sets skip-unchanged;" in result.stderr

    @pytest.mark.parametrize(("typed", "is_told"), [([], True), (["--encoding", "packed8"], False)])
    def test_an_option_that_was_typed_is_not_blamed_on_the_file(
        self, typed: list[str], is_told: bool, project: Path
    ) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        result = invoke("bake", "a.glb", "--dry-run", "--layout", "texcoord", *typed)
        assert "--layout texcoord needs --encoding float32" in result.stderr
        assert ("skinbake.toml" in result.stderr) is is_told

    def test_an_output_is_made_of_the_file_too(self, project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        monkeypatch.chdir("heroes")
        invoke("bake", "knight.glb", "-o", "out.glb", "--depfile", "out.d")
        assert Path("out.d").read_text().startswith("out.glb: knight.glb ../skinbake.toml\n")
        absolute = project / "heroes" / "knight.glb"
        invoke("bake", absolute, "-o", "out.glb", "--depfile", "out.d")
        assert Path("out.d").read_text().startswith(f"out.glb: {absolute} {project}/skinbake.toml\n")
        invoke("bake", "knight.glb", "-o", "out.glb", "--depfile", "out.d", "--no-config")
        assert Path("out.d").read_text().startswith("out.glb: knight.glb\n")

    def test_v_names_the_file_and_the_options(self, project: Path) -> None:
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        assert "skinbake.toml sets encoding\n" in invoke("bake", "a.glb", "--dry-run", "-v").stderr
        assert "skinbake.toml" not in invoke("bake", "a.glb", "--dry-run").stderr


DANGEROUS = {
    "bake": (
        "output out-dir in-place dry-run state summary depfile dask max-memory allow-outside no-sync",
        {"in-place": "true", "dry-run": "true", "no-sync": "true", "allow-outside": '["/"]'},
    ),
    "verify": (
        "junit html dump-normals clip time sources state summary dask max-memory allow-outside no-sync",
        {"allow-outside": '["/"]'},
    ),
    "strip": (
        "output out-dir in-place depfile summary max-memory allow-outside no-sync",
        {"in-place": "true", "no-sync": "true"},
    ),
    "shader": ("for output max-memory allow-outside no-sync", {}),
    "view": ("output port no-browser max-memory allow-outside no-sync", {"port": "80"}),
    "render": ("output max-memory allow-outside no-sync", {}),
    "inspect": ("summary max-memory allow-outside no-sync", {"no-sync": "true"}),
    "example": ("output no-sync", {"no-sync": "true"}),
}


class TestTrust:
    """A stranger's file has nothing read or written that the user did not name."""

    @pytest.mark.parametrize(
        ("command", "key"), [(name, key) for name, (keys, _) in DANGEROUS.items() for key in keys.split()]
    )
    def test_a_file_cannot_decide_what_is_read_or_written(
        self, command: str, key: str, project: Path
    ) -> None:
        value = DANGEROUS[command][1].get(key, '"x.glb"')
        found = refused(f"[{command}]\n{key} = {value}\n", command, "a.glb")
        assert found.startswith(
            f"skinbake.toml:2: {command}.{key}: a configuration file cannot set this option,"
        )
        assert found.endswith(f"give --{key} on the command line")
        assert {path.name for path in project.iterdir()} == {".git", "a.glb", "heroes", "skinbake.toml"}

    def test_every_other_option_was_thought_about(self) -> None:
        """An option is dangerous by the table above, or settable by the program's; not both, nor neither."""
        top = click.Context(main)
        for name in COMMANDS:
            command = main.get_command(top, name)
            assert command is not None
            dangerous = set(DANGEROUS.get(name, ("", {}))[0].split())
            for key, option in options_of(command).items():
                assert (key in dangerous) != (By.TABLE in option.declared.by), f"{name} --{key}"

    def test_the_options_that_differ_by_file_exist(self) -> None:
        top = click.Context(main)
        for name in PER_FILE:
            command = main.get_command(top, name)
            assert command is not None
            options = options_of(command).values()
            assert any(By.OVERRIDE in option.declared.by for option in options)
            assert all(By.TABLE in one.declared.by for one in options if By.OVERRIDE in one.declared.by)

    @pytest.mark.parametrize(
        "value", ["clips.glb", "/dev/zero", "s3://a/b.glb", "random", "http:random:1.glb"]
    )
    def test_poses_to_fit_come_from_no_file_that_it_names(self, value: str, project: Path) -> None:
        found = refused(f'[bake]\ngradients = "fitted"\nfit-poses = ["{value}"]\n')
        assert found.startswith('skinbake.toml:3: bake.fit-poses: expected "animations" or "random:N"')

    @pytest.mark.slow
    @pytest.mark.parametrize("value", ["random:4", "animations", "animation"])
    def test_poses_without_a_file_are_fitted_to(self, value: str, project: Path) -> None:
        (project / "skinbake.toml").write_text(f'[bake]\ngradients = "fitted"\nfit-poses = ["{value}"]\n')
        found = document(invoke("bake", "a.glb", "--dry-run", "--json"))["files"][0]
        assert found["primitives"][0]["gradients"] == "fitted"

    def test_names_in_messages_cannot_control_a_terminal(self, project: Path) -> None:
        assert "\x1b" not in refused('[bake]\n"\\u001b[2J" = 1\n')


OVERRIDES = """
[bake]
encoding = "snorm16"
[[overrides]]
files = ["none.glb", "heroes/**"]
bake = { encoding = "float32" }
[[overrides]]
files = ["heroes/crowd/*.glb"]
[overrides.bake]
encoding = "packed8"
"""


class TestOverrides:
    def test_later_ones_win_and_the_command_line_wins_over_all(self, project: Path) -> None:
        (project / "skinbake.toml").write_text(OVERRIDES)
        assert encodings(".") == {
            "./a.glb": "snorm16",
            "./heroes/knight.glb": "float32",
            "./heroes/crowd/pawn.glb": "packed8",
        }
        assert set(encodings(".", "--encoding", "float32").values()) == {"float32"}

    def test_paths_start_at_the_file_however_inputs_are_named(
        self, project: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        (project / "skinbake.toml").write_text(OVERRIDES)
        (project.parent / "link").symlink_to(project / "heroes")
        monkeypatch.chdir("heroes/crowd")
        for name in ("../knight.glb", project / "heroes/knight.glb", project.parent / "link/knight.glb"):
            assert list(encodings(name).values()) == ["float32"]
        assert list(encodings((project / "heroes/knight.glb").as_uri()).values()) == ["float32"]

    def test_files_outside_match_nothing(self, project: Path) -> None:
        (project / "skinbake.toml").write_text(
            "[[overrides]]\nfiles = ['**']\nbake = { encoding = 'packed8' }\n"
        )
        shutil.copyfile(SEAM, project.parent / "b.glb")
        assert encodings("a.glb", "../b.glb") == {"a.glb": "packed8", "../b.glb": "float32"}

    def test_a_contradiction_names_the_override(self, project: Path) -> None:
        text = '[[overrides]]\nfiles = ["heroes/**"]\nbake = { encoding = "snorm16" }\n'
        found = refused(text, "bake", ".", "--dry-run", "--layout", "texcoord")
        assert found.startswith("skinbake.toml:2: overrides[0]: --layout texcoord needs --encoding float32")

    def test_a_contradiction_names_no_override_of_another_command(self, project: Path) -> None:
        other = '[[overrides]]\nfiles = ["heroes/**"]\nverify = { min-gain = 2 }\n'
        text = '[[overrides]]\nfiles = ["heroes/**"]\nbake = { encoding = "snorm16" }\n'
        found = refused(f"{other}{text}{other}", "bake", ".", "--dry-run", "--layout", "texcoord")
        assert found.startswith("skinbake.toml:5: overrides[1]: --layout texcoord needs --encoding float32")

    def test_limits_of_verify_differ_by_file(self, project: Path) -> None:
        invoke("bake", ".", "--in-place")
        text = "[[overrides]]\nfiles = ['heroes/crowd/**']\nverify = { max-mean-error = 0 }\n"
        (project / "skinbake.toml").write_text(text)
        result = invoke("verify", ".", "--poses", "random:1", "--json")
        assert result.exit_code == 1
        found = {file["input"]: file for file in document(result)["files"]}
        assert [name for name, file in found.items() if not file["passed"]] == ["./heroes/crowd/pawn.glb"]

    @pytest.mark.slow
    def test_pages_tell_the_limits_of_their_file(self, project: Path) -> None:
        invoke("bake", "a.glb", "heroes/knight.glb", "--in-place")
        text = (
            "[verify]\nmin-gain = 0\n[[overrides]]\nfiles = ['heroes/**']\nverify = { max-mean-error = 44 }\n"
        )
        (project / "skinbake.toml").write_text(text)
        invoke("verify", "a.glb", "heroes/knight.glb", "--poses", "random:1", "--html", "out.html")
        index = (project / "out.html").read_text("utf-8")
        assert "gain at least 0×" in index
        assert "mean error at most 44" not in index
        pages = {path.name: path.read_text("utf-8") for path in (project / "out").iterdir()}
        assert [name for name, page in pages.items() if "mean error at most 44" in page] == [
            "0002-knight.html"
        ]

    @pytest.mark.slow
    def test_a_changed_override_bakes_its_files_again(self, project: Path) -> None:
        def statuses() -> dict[str, str]:
            result = invoke("bake", ".", "--out-dir", "../out", "--skip-unchanged", "--json")
            return {file["input"]: file["status"] for file in document(result)["files"]}

        (project / "skinbake.toml").write_text(OVERRIDES)
        assert set(statuses().values()) == {"baked"}
        assert set(statuses().values()) == {"up-to-date"}
        (project / "skinbake.toml").write_text(OVERRIDES.replace("packed8", "snorm16"))
        assert [name for name, one in statuses().items() if one == "baked"] == ["./heroes/crowd/pawn.glb"]
        assert set(statuses().values()) == {"up-to-date"}

    @pytest.mark.slow
    def test_several_processes_heed_them(self, project: Path, workers: list[int]) -> None:
        (project / "skinbake.toml").write_text(OVERRIDES)
        for jobs in ("1", "2"):
            assert invoke("bake", ".", "--out-dir", f"../{jobs}", "--jobs", jobs).exit_code == 0
        assert workers == [2]
        one, two = (
            {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.glb")}
            for folder in (project.parent / "1", project.parent / "2")
        )
        assert one == two
        assert len({len(data) for data in one.values()}) == 3

    def test_the_work_can_be_sent(self, tmp_path: Path) -> None:
        """A cluster pickles it; each job finds its options there."""
        works = FileWork((Bake(), Bake(BakeOptions(encoding=Encoding.PACKED8))))
        sent = pickle.loads(pickle.dumps(works))
        for variant, size in ((0, 24), (1, 8)):
            result = sent(Job(str(SEAM), str(tmp_path / "out.glb"), variant=variant))
            assert result.primitives[0][1].bytes_per_vertex == size
            assert sent.lost(Job("x.glb", variant=variant), "gone").status == "failed"


@pytest.mark.parametrize(
    ("path", "pattern", "expected"),
    [
        ("a.glb", "a.glb", True),
        ("a.glb", "*.glb", True),
        ("b/a.glb", "*.glb", False),
        ("b/a.glb", "**/*.glb", True),
        ("a.glb", "**/*.glb", True),
        ("a.glb", "**", True),
        ("c/b/a.glb", "c/**", True),
        ("c", "c/**", False),
        ("cc/a.glb", "c/**", False),
        ("c/d/e/a.glb", "c/**/a.glb", True),
        ("c/a.glb", "c/**/a.glb", True),
        ("c/d/e/a.glb", "**/d/**", True),
        ("d/a.glb", "**/d/**", True),
        ("c/a.glb", "**/d/**", False),
        ("A.glb", "a.glb", False),
        ("a1.glb", "a[0-9].g?b", True),
        ("c/d/a.glb", "c/*", False),
        ("c/d/a.glb", "*/*/*", True),
        ("x.glb/a", "x.glb", False),
    ],
)
def test_patterns(path: str, pattern: str, expected: bool) -> None:
    assert matches(path.split("/"), pattern) is expected


def test_a_hostile_pattern_takes_no_time() -> None:
    start = time.process_time()
    assert not matches(["a"] * 100, "/".join(["**", "a"] * 40 + ["b"]))
    assert time.process_time() - start < 0.5


class TestCommand:
    def test_the_page_s_example(self, project: Path) -> None:
        blocks = re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
        example = next(text for kind, text in blocks if kind == "toml")
        expected = next(text for kind, text in blocks if kind == "text")
        (project / "skinbake.toml").write_text(example, encoding="utf-8")
        assert invoke("config", "--changed", "heroes/crowd/pawn.glb").stdout == expected
        assert encodings(".") == {
            "./a.glb": "snorm16",
            "./heroes/knight.glb": "float32",
            "./heroes/crowd/pawn.glb": "packed8",
        }
        # verify reads the outputs, which have the same overrides.
        printed = invoke("config", "--changed", "build/heroes/knight.glb").stdout
        assert re.search(
            r"^build/heroes/knight.glb: verify\n(?:  .*\n)*  min-gain +3 ", printed, re.MULTILINE
        )

    def test_the_same_in_the_project_s_file(self, project: Path) -> None:
        blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
        text = re.sub(r"^(\[+)", r"\1tool.skinbake.", blocks[0], flags=re.MULTILINE)
        (project / "pyproject.toml").write_text(text, encoding="utf-8")
        assert encodings("a.glb", "heroes/knight.glb") == {"a.glb": "snorm16", "heroes/knight.glb": "float32"}

    def test_every_option_of_every_command_is_told(self, project: Path) -> None:
        text = invoke("config").stdout
        assert text.startswith(f"no configuration file in {project}\n")
        sections = {part.split("\n")[0]: part for part in text.split("\n\n")[1:]}
        top = click.Context(main)
        for name in COMMANDS:
            command = main.get_command(top, name)
            assert command is not None
            for key in options_of(command):
                assert re.search(rf"^  {key} +\S+ +(default|environment)", sections[name], re.MULTILINE), key

    def test_json(self, project: Path) -> None:
        (project / "skinbake.toml").write_text(OVERRIDES)
        result = invoke("config", "--json", "a.glb", "heroes", env={"OMP_NUM_THREADS": "2"})
        found = checked(document(result), CONFIG)
        assert found["file"] == "skinbake.toml"
        assert found["commands"]["bake"]["encoding"] == {
            "value": "snorm16",
            "origin": "file",
            "place": "skinbake.toml:3",
            "pattern": None,
        }
        assert found["commands"]["verify"]["threads"]["place"] == "OMP_NUM_THREADS"
        files: dict[str, Any] = {file["input"]: file["commands"] for file in found["files"]}
        assert files["a.glb"]["bake"]["encoding"]["origin"] == "file"
        assert files["heroes/crowd/pawn.glb"]["bake"]["encoding"] == {
            "value": "packed8",
            "origin": "override",
            "place": "skinbake.toml:10",
            "pattern": "heroes/crowd/*.glb",
        }

    def test_only_what_is_not_the_default_is_told_on_request(
        self, project: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        (project / "skinbake.toml").write_text('[bake]\nencoding = "snorm16"\n')
        whole = document(invoke("config", "--json"))["commands"]
        found = document(invoke("config", "--json", "--changed"))["commands"]
        assert {name: list(options) for name, options in found.items() if options} == {"bake": ["encoding"]}
        assert found["bake"]["encoding"] == whole["bake"]["encoding"]
        assert (whole["bake"]["weighting"]["value"], whole["bake"]["weighting"]["origin"]) == (
            "max",
            "default",
        )
        text = invoke("config", "--changed").stdout
        assert [line.split() for line in text.splitlines()[1:] if line] == [
            ["bake"],
            ["encoding", '"snorm16"', "skinbake.toml:2"],
        ]

    def test_config_checks_the_tables_of_all_commands(self, project: Path) -> None:
        text = "[verify]\nmin-gain = true\n"
        assert refused(text, "config") == "skinbake.toml:2: verify.min-gain: true: expected a number"
        assert invoke("bake", "a.glb", "--dry-run").exit_code == 0

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            (
                '[bake]\nlimit-influences = 4\nneighbours = "extend"\n',
                'skinbake.toml:2: bake.limit-influences: limit-influences contradicts neighbours = "extend"',
            ),
            (
                "[bake]\nposition-bits = 12\n",
                'skinbake.toml:2: bake.position-bits: position-bits needs compress = "draco"',
            ),
            (
                '[bake]\nneighbours = "extend"\n[[overrides]]\nfiles = ["none/*"]\n'
                "bake.limit-influences = 4\n",
                'skinbake.toml:4: overrides[0]: limit-influences contradicts neighbours = "extend"',
            ),
            (
                '[shader]\nlighting = "exact"\n',
                'skinbake.toml:2: shader.lighting: method = "lbs" has no exact lighting',
            ),
            (
                '[shader]\nmorphs = "tangent"\nframe = "normal"\n',
                'skinbake.toml:2: shader.morphs: morphs = "tangent" needs frame = "tangent"',
            ),
        ],
    )
    def test_options_that_contradict_each_other(self, text: str, said: str, project: Path) -> None:
        assert refused(text, "config").startswith(said)

    def test_overrides_that_contradict_each_other_for_a_file(self, project: Path) -> None:
        text = (
            '[[overrides]]\nfiles = ["a.*"]\nbake.neighbours = "extend"\n'
            '[[overrides]]\nfiles = ["*.glb"]\nbake.limit-influences = 4\n'
        )
        said = "skinbake.toml:2: overrides[0], skinbake.toml:5: overrides[1]: limit-influences contradicts"
        assert refused(text, "config", "a.glb").startswith(said)
        assert invoke("config").exit_code == 0
        assert invoke("config", "heroes/knight.glb").exit_code == 0

    @pytest.mark.parametrize(
        "text",
        [
            '[shader]\nmorphs = "tangent"\n',  # --for has the frame
            '[shader]\ntarget = "three"\n',  # --lang is given on the command line
            '[shader]\nlayout = "custom"\nencoding = "snorm16"\n',
            '[bake]\nneighbours = "extend"\n'
            '[[overrides]]\nfiles = ["heroes/**"]\nbake.neighbours = "adopt"\n'
            '[[overrides]]\nfiles = ["heroes/crowd/*"]\nbake.limit-influences = 4\n',
        ],
    )
    def test_options_that_go_together_with_others_are_no_contradiction(
        self, text: str, project: Path
    ) -> None:
        Path("skinbake.toml").write_text(text, encoding="utf-8")
        result = invoke("config", "heroes/crowd/pawn.glb")
        assert result.exit_code == 0, result.stderr

    def test_an_input_that_is_not_there(self, project: Path) -> None:
        result = invoke("config", "a.glb", "none/*.glb")
        assert result.exit_code == 3
        assert "none/*.glb: no file that matches this pattern" in result.stderr
        assert "a.glb: bake" in result.stdout

    def test_where_nothing_was_found(self, project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir("heroes/crowd")
        text = invoke("config", "--changed").stdout
        assert text == f"no configuration file from {project}/heroes/crowd up to {project}\n"
