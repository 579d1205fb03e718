"""Help in groups, shell completion, and the man page: all from the declarations of the commands."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest

from skinbake.cli.help import Helpful, grouped, manual
from skinbake.cli.main import COMMANDS, main
from tests.support.command_line import invoke
from tests.support.tools import required_program

TOP = click.Context(main, info_name="skinbake")


def command_of(name: str) -> tuple[Helpful, click.Context]:
    command = main.get_command(TOP, name)
    assert isinstance(command, Helpful)
    return command, click.Context(command, TOP, info_name=name, help_option_names=["-h", "--help"])


def help_of(name: str) -> str:
    return invoke(name, "--help-all" if command_of(name)[0].usual else "--help").stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_one_group_and_examples_end_the_help(name: str) -> None:
    command, ctx = command_of(name)
    shown = list(grouped(command, ctx))
    options = [param for param in command.get_params(ctx) if isinstance(param, click.Option)]
    assert sum(len(rows) for _, rows in shown) == len(options)
    text = help_of(name)
    for option in options:
        assert re.search(rf"^  .*{re.escape(option.opts[-1])}\b", text, re.MULTILINE)
    examples = text.partition("\nExamples:\n")[2].splitlines()
    assert examples == [f"  {line}" for line in command.examples]
    assert examples


@pytest.mark.parametrize("name", ["bake", "verify", "shader"])
def test_help_shows_the_usual_options_and_an_example_and_names_the_rest(name: str) -> None:
    command, _ = command_of(name)
    text = invoke(name, "--help").stdout
    shown = set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", text, re.MULTILINE))
    usual = {f"--{param.opts[-1].lstrip('-')}" for param in command.params if param.name in command.usual}
    assert shown == {*usual, "--help", "--help-all"}
    assert len(usual) == len(command.usual) <= 13
    assert f"Show all {len(command.params) - 1 - (name != 'shader')} options" in text
    assert "Examples:" in text


def test_help_before_a_command_is_its_help() -> None:
    assert invoke("help", "bake").stdout == invoke("bake", "--help").stdout
    assert invoke("help", "bake", "--help-all").stdout == invoke("bake", "--help-all").stdout
    assert invoke("help").stdout == invoke("--help").stdout
    unknown = invoke("help", "bkae")
    assert (unknown.exit_code, "Did you mean 'bake'?" in unknown.stderr) == (2, True)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_an_option_names_only_options_of_its_command(name: str) -> None:
    command, ctx = command_of(name)
    own = {opt for param in command.get_params(ctx) for opt in param.opts}
    for param in command.get_params(ctx):
        if isinstance(param, click.Option):
            assert set(re.findall(r"(?<!\S)--[a-z][a-z-]+", param.help or "")) <= own, param.name


@pytest.mark.parametrize("name", COMMANDS)
def test_the_value_of_an_option_has_a_name_of_ours(name: str) -> None:
    """Without one, click writes INTEGER RANGE, FLOAT RANGE or TEXT."""
    named = re.findall(r"^  (?:-\w, )?--[a-z-]+ ([A-Z].*?)(?:  |$)", help_of(name), re.MULTILINE)
    assert [value for value in named if re.search(r"RANGE|INTEGER|FLOAT\b|TEXT", value)] == []
    assert named


@pytest.mark.parametrize("name", COMMANDS)
def test_the_examples_are_commands(name: str) -> None:
    """click takes each of them; nothing is run."""
    command, _ = command_of(name)
    for line in command.examples:
        program, asked, *arguments = shlex.split(line)
        assert (program, asked) == ("skinbake", name)
        command.make_context(name, arguments, parent=TOP)


@pytest.mark.parametrize(
    ("name", "option", "heading"),
    [
        ("verify", "--cap X", "Measurement"),
        ("shader", "--cap [X]", "Shader"),
        ("shader", "--influences N", "Shader"),
        ("cost", "--influences N", "Reports"),
    ],
)
def test_an_option_stands_where_its_command_needs_it(name: str, option: str, heading: str) -> None:
    found = [title for title, rows in grouped(*command_of(name)) if option in dict(rows)]
    assert found == [heading]


def completions(line: str, word: str) -> list[str]:
    words = f"{line} {word}"
    result = invoke(
        env={
            "_SKINBAKE_COMPLETE": "bash_complete",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(line.split())),
        }
    )
    return result.stdout.split()


def test_commands_values_and_paths_are_completed() -> None:
    assert completions("skinbake", "b") == ["plain,bake"]
    assert completions("skinbake help", "b") == ["plain,bake"]
    assert completions("skinbake bake --gradients", "f") == ["plain,fitted"]
    assert "plain,--encoding" in completions("skinbake bake", "--e")
    assert completions("skinbake bake", "he") == ["file,he"]
    assert completions("skinbake bake hero.glb --out-dir", "bu") == ["dir,bu"]
    assert completions("skinbake verify --html", "re") == ["file,re"]


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell_completes(shell: str, tmp_path: Path) -> None:
    environment = {**os.environ, "_SKINBAKE_COMPLETE": f"{shell}_source"}
    command = [sys.executable, "-c", "from skinbake.cli.main import entry_point; entry_point()"]
    made = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert f"_SKINBAKE_COMPLETE={shell}_complete" in made
    program = required_program(shell)
    if shell != "bash":
        subprocess.run([program, "-n"], input=made, text=True, check=True)
        return
    (tmp_path / "skinbake").write_text(f'#!/bin/sh\nexec {shlex.join(command)} "$@"\n')
    (tmp_path / "skinbake").chmod(0o755)
    ask = "COMP_WORDS=(skinbake ver); COMP_CWORD=1; _skinbake_completion skinbake; echo ${COMPREPLY[@]}"
    found = subprocess.run(
        [program, "--norc", "-c", f"{made}\n{ask}"],
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.split() == ["verify"]


def test_the_documented_lines_are_those_of_click() -> None:
    page = (Path(__file__).parents[2] / "docs/reference/command-line.md").read_text("utf-8")
    for shell in ("bash", "zsh", "fish"):
        assert f"_SKINBAKE_COMPLETE={shell}_source skinbake" in page


class TestManual:
    def test_the_manual_has_every_command_option_and_example(self) -> None:
        page = manual(main).replace("\\-", "-")
        for name in COMMANDS:
            command, ctx = command_of(name)
            assert f".SS skinbake {name} " in page
            for _, rows in grouped(command, ctx):
                assert all(f".TP\n.B {option}\n" in page for option, _ in rows)
            assert all(f"\n{line}\n" in page for line in command.examples)
        assert "Exit codes: 0 fine" in page

    def test_groff_accepts_it(self) -> None:
        groff = required_program("groff")
        process = subprocess.run(
            [groff, "-man", "-Tutf8", "-k", "-ww", "-z"],
            input=manual(main).encode(),
            capture_output=True,
            check=True,
        )
        assert process.stderr == b""
