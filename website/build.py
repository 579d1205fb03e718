"""Build the documentation as a site into build/site/html: ``python -m website.build``.

The pages are those that a Git host shows: plain Markdown with relative links. docs/README.md lists them, and
its headings become the parts of the site. The README is the front page, and one page is added: the help of
each command, from its declaration. A warning is an error, and so is a link to nowhere within the site.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import click

from release.contents import LOOPS, PACKAGE
from release.cross import BROWSER, compile_loops
from release.wheels import zipped
from skinbake.cli.help import EVERYTHING
from skinbake.cli.main import main as main_command

REPOSITORY = Path(__file__).resolve().parents[1]
CONTENTS = Path("docs/README.md")
COMMANDS = Path("docs/reference/commands.md")
"""The page of the commands' help, which is made here."""

COMMANDS_HEAD = """# Help of each command

Made from the declarations of the options. `skinbake COMMAND --help-all` prints the same.
"""

WIDTH = 80
"""The columns of help, as many as a page of the site is wide."""

SITE = REPOSITORY / "build" / "site"
LINK = re.compile(r"\]\(([^)\s#:]+)(#[^)\s]*)?\)")
"""A relative link in Markdown: its path, and its anchor."""


PYODIDE = REPOSITORY / "tests" / "support" / "node_modules" / "pyodide"
"""The Pyodide of the page, as npm brings it for the tests."""

COMPILE = """
import { loadPyodide } from %s;
const python = await loadPyodide();
python.mountNodeFS('/here', %s);
python.runPython(`
    import compileall, py_compile
    mode = py_compile.PycInvalidationMode.UNCHECKED_HASH
    assert compileall.compile_dir('/here', quiet=1, legacy=True, stripdir='/here', invalidation_mode=mode)
`);
"""

ITEM = re.compile(r"^- \[(.*)\]\((.*)\)$", re.MULTILINE)
"""A page in docs/README.md: its name there, and its path."""


def parts() -> dict[str, dict[Path, str]]:
    """Return the names of the pages by path in the repository, by the heading of docs/README.md."""
    found: dict[str, dict[Path, str]] = {}
    for section in re.split(r"^## ", (REPOSITORY / CONTENTS).read_text("utf-8"), flags=re.MULTILINE)[1:]:
        heading, _, listed = section.partition("\n")
        found[heading] = {_beside(CONTENTS, target): name for name, target in ITEM.findall(listed)}
    return found


def _beside(page: Path, target: str) -> Path:
    return Path(os.path.normpath(page.parent / target))


def _links(page: Path) -> set[Path]:
    """Return the files of the repository that a page shows or links to."""
    found = LINK.findall((REPOSITORY / page).read_text("utf-8"))
    linked = {_beside(page, target) for target, _ in found}
    return {path for path in linked if (REPOSITORY / path).is_file()}


def lay_out(source: Path) -> None:
    """Copy the pages into a folder as the repository has them, with all that they show and link to."""
    contents = parts()
    pages = [Path("README.md"), *(page for listed in contents.values() for page in listed)]
    there = {path.relative_to(REPOSITORY) for path in (REPOSITORY / "docs").rglob("*.md")}
    linked_pages = {linked for page in pages for linked in _links(page) if linked.suffix == ".md"}
    unlisted = (there | linked_pages) - {*pages, CONTENTS}
    if unlisted:
        names = ", ".join(path.as_posix() for path in sorted(unlisted))
        raise SystemExit(f"{CONTENTS} does not list {names}")
    for page in pages:
        for path in {page, *_links(page)} - {CONTENTS}:
            _put(source / path, (REPOSITORY / path).read_bytes())
    front = (source / "README.md").rename(source / "index.md")
    _put(source / COMMANDS, commands().encode("utf-8"))
    contents["Reference"][COMMANDS] = "Help of each command"
    trees = [tree(heading, listed) for heading, listed in contents.items()]
    front.write_text("\n".join([front.read_text("utf-8"), *trees]), encoding="utf-8")
    for page in source.rglob("*.md"):
        _follow(page, source)


def _put(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def _follow(page: Path, source: Path) -> None:
    """Have the links of a page to the README and to the list of pages lead to the front page."""
    up = os.path.relpath(source / "index.md", page.parent).replace(os.sep, "/")

    def renamed(found: re.Match[str]) -> str:
        linked = _beside(page.relative_to(source), found[1])
        return f"]({up}{found[2] or ''})" if linked in {Path("README.md"), CONTENTS} else found[0]

    page.write_text(LINK.sub(renamed, page.read_text("utf-8")), encoding="utf-8")


def tree(heading: str, pages: Mapping[Path, str]) -> str:
    """Return a part of the site's contents, for the column beside each page."""
    listed = "\n".join(
        f"{name.replace('`', '')} <{page.with_suffix('').as_posix()}>" for page, name in pages.items()
    )
    return f"```{{toctree}}\n:hidden:\n:caption: {heading}\n\n{listed}\n```\n"


def commands() -> str:
    """Return the page of the commands: their help, with all options."""
    top = click.Context(main_command, info_name="skinbake", terminal_width=WIDTH)
    top.meta[EVERYTHING] = True
    text = [COMMANDS_HEAD]
    for name in main_command.list_commands(top):
        command = main_command.get_command(top, name)
        if command is None:
            raise SystemExit(f"skinbake lists {name} and has no such command")
        context = click.Context(
            command, top, info_name=name, terminal_width=WIDTH, help_option_names=["-h", "--help"]
        )
        text.append(f"## {name}\n\n```text\n{command.get_help(context)}\n```\n")
    return "\n".join(text)


def put_trial(target: Path) -> None:
    """Put the page that bakes in the browser into a folder, and skinbake with what it imports as a zip.

    Modules are compiled if npm has brought Pyodide. Else the page does it, a second longer.
    """
    shutil.copytree(Path(__file__).with_name("try"), target, dirs_exist_ok=True)
    contents = {"in_browser.py": Path(__file__).with_name("in_browser.py").read_bytes()}
    for path in PACKAGE.rglob("*"):
        if path.is_file() and path.suffix not in {".c", ".h", ".pyc", ".pyd", ".so"}:
            contents[path.relative_to(PACKAGE.parent).as_posix()] = path.read_bytes()
    with tempfile.TemporaryDirectory() as temporary:
        for module in LOOPS:
            name, compiled = compile_loops(module, REPOSITORY, BROWSER, Path(temporary))
            contents[f"skinbake/{name}"] = compiled
    for needed in ("click", "jinja2", "markupsafe"):
        for one in importlib.metadata.files(needed) or ():
            if one.suffix == ".py" or "licenses" in one.parts:
                contents[one.as_posix()] = Path(str(one.locate())).read_bytes()
    if shutil.which("node") and PYODIDE.is_dir():
        contents = _compiled(contents)
    (target / "skinbake.zip").write_bytes(zipped(contents, zipfile.ZIP_DEFLATED))


def _compiled(contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return files with the bytecode of the page's own Python in place of each module's source."""
    with tempfile.TemporaryDirectory() as temporary:
        for name, data in contents.items():
            _put(Path(temporary, name), data)
        script = COMPILE % (json.dumps((PYODIDE / "pyodide.mjs").as_uri()), json.dumps(temporary))
        subprocess.run(["node", "--input-type=module", "-e", script], check=True)
        made = {name: Path(temporary, f"{name}c") for name in contents if name.endswith(".py")}
        rest = {name: data for name, data in contents.items() if name not in made}
        return {**rest, **{f"{name}c": path.read_bytes() for name, path in made.items()}}


def build(site: Path = SITE) -> int:
    """Build the site anew. Return the exit code of Sphinx."""
    shutil.rmtree(site, ignore_errors=True)
    lay_out(site / "source")
    options = [
        "-W",
        "--keep-going",
        "--quiet",
        "--jobs",
        "auto",
        "-b",
        "html",
        "-c",
        str(Path(__file__).parent),
    ]
    sphinx = [sys.executable, "-m", "sphinx", *options, str(site / "source"), str(site / "html")]
    put_trial(site / "html" / "try")
    return subprocess.run(sphinx, check=False).returncode


if __name__ == "__main__":
    sys.exit(build())
