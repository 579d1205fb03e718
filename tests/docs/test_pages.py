"""The pages for people against the code: links, codes of notices, exit codes, options, members of JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from skinbake.cli import exit_codes
from skinbake.cli.main import main
from tests.support import schemas

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCE = REPOSITORY / "src" / "skinbake"
REFERENCE = REPOSITORY / "docs" / "reference"
PAGES = sorted(
    [
        *REPOSITORY.glob("*.md"),
        *(REPOSITORY / "docs").rglob("*.md"),
        *(REPOSITORY / "fuzz").glob("*.md"),
        *(REPOSITORY / "examples").glob("*.md"),
    ]
)


def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub spells them."""
    headings = re.findall(r"^#+ (.+)$", text(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", text(page)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(linked), f"{page.name}: {target}"


def test_every_notice_is_listed_and_every_listed_one_exists() -> None:
    code = "\n".join(text(path) for path in SOURCE.rglob("*.py"))
    listed = set()
    for line in text(REFERENCE / "notices.md").splitlines():
        if line.startswith("| `"):
            listed.update(re.findall(r"`([a-z-]+)`", line.split("|")[1]))
    made = set(re.findall(r'Notice\(\s*"([a-z-]+)"', code))
    # Some codes stand in a table, and the notice is made from its rows.
    assert made <= listed
    assert {name for name in listed if f'"{name}"' not in code} == set()


def test_exit_codes_are_those_of_the_program() -> None:
    known = {value for name, value in vars(exit_codes).items() if name.isupper() and isinstance(value, int)}
    rows = re.findall(r"^\| ([\d, ]+) \|", text(REFERENCE / "command-line.md"), flags=re.MULTILINE)
    assert {int(number) for row in rows for number in row.split(",")} == known


def commands() -> dict[str, list[click.Option]]:
    """Return the options of each command, by its name."""
    context = click.Context(main)
    found = {name: main.get_command(context, name) for name in main.list_commands(context)}
    return {
        name: [one for one in command.params if isinstance(one, click.Option)]
        for name, command in found.items()
        if command is not None
    }


def rows_of_options() -> Iterator[tuple[set[str], list[str]]]:
    """Yield the commands and the options of each row of the table. An empty first cell repeats the last."""
    names, who = set(commands()), ""
    for first, rest in re.findall(
        r"^\|(?: ([^|]+?))? \| (.*)$", text(REFERENCE / "options.md"), re.MULTILINE
    ):
        who = first or who
        listed = set(re.findall(r"`([a-z]+)[` ]", who)) & names
        having = names - listed if who.startswith("all") else listed
        yield having, re.findall(r"`(-[-a-z0-9]+)", rest.split(" | ")[0])


@pytest.mark.parametrize("name", commands())
def test_the_rows_of_a_command_name_its_options(name: str) -> None:
    listed = {option for having, options in rows_of_options() if name in having for option in options}
    for option in commands()[name]:
        assert listed & set(option.opts) or option.name == "help", option.name


def test_the_rows_of_shared_options_name_the_commands_that_have_them() -> None:
    having: dict[str, set[str]] = {}
    for name, options in commands().items():
        for option in options:
            for spelling in option.opts:
                having.setdefault(spelling, set()).add(name)
    shared = [
        (listed, option) for listed, options in rows_of_options() for option in options if len(listed) > 1
    ]
    assert [(option, listed) for listed, option in shared] == [
        (option, having[option]) for _, option in shared
    ]
    assert len(shared) == 22


def test_the_readme_takes_two_minutes() -> None:
    assert len(text(REPOSITORY / "README.md").split()) <= 900


def test_pages_quote_errors_of_the_table_of_models() -> None:
    rows = re.findall(r"^\| \S+ .*\|$", text(REPOSITORY / "docs" / "lighting.md"), flags=re.MULTILINE)
    measured = {tuple(row.split(" | ")[at : at + 2]) for row in rows for at in (2, 6)}
    pages = "README.md", "CHANGELOG.md", "docs/why.md"
    told = [
        re.findall(r"([\d.]+)°(?: on average.*?is| to) ([\d.]+)°", text(REPOSITORY / one)) for one in pages
    ]
    assert [len(pairs) for pairs in told] == [1, 2, 3]
    assert {pair for pairs in told for pair in pairs} <= measured


def test_json_page_names_every_member_of_bake() -> None:
    page = text(REFERENCE / "json.md")
    for schema in (schemas.BAKE, schemas.INSPECT, schemas.STRIP):
        for member in schema["properties"]:
            assert f"`{member}" in page
