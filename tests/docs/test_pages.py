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


def options() -> Iterator[str]:
    context = click.Context(main)
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert command is not None
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                yield max(parameter.opts, key=len)


def test_one_table_names_every_option() -> None:
    short = {"--output": "-o", "--verbose": "-v", "--quiet": "-q"}
    page = text(REFERENCE / "options.md")
    missing = {option for option in options() if f"`{short.get(option, option)}" not in page}
    assert missing <= {"--help"}


def test_the_rows_of_shared_options_name_the_commands_that_have_them() -> None:
    context = click.Context(main)
    names = main.list_commands(context)
    having: dict[str, set[str]] = {}
    for name in names:
        command = main.get_command(context, name)
        assert command is not None
        for parameter in command.params:
            for option in parameter.opts if isinstance(parameter, click.Option) else ():
                having.setdefault(option, set()).add(name)
    who, found = "", 0
    for first, rest in re.findall(
        r"^\|(?: ([^|]+?))? \| (.*)$", text(REFERENCE / "options.md"), re.MULTILINE
    ):
        who = first or who
        listed = set(re.findall(r"`([a-z]+)`", who))
        if who.startswith("all"):
            listed = set(names) - listed
        for option in re.findall(r"`(-[-a-z]+)", rest.split(" | ")[0]) if len(listed) > 1 else ():
            assert having[option] == listed, option
            found += 1
    assert found == 20


def test_the_readme_takes_two_minutes() -> None:
    assert len(text(REPOSITORY / "README.md").split()) < 900


def test_json_page_names_every_member_of_bake() -> None:
    page = text(REFERENCE / "json.md")
    for schema in (schemas.BAKE, schemas.INSPECT, schemas.STRIP):
        for member in schema["properties"]:
            assert f"`{member}" in page
