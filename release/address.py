"""Write the address of the repository into every file that names it: ``python -m release.address URL``.

Whoever publishes gives it once. It stands in pyproject.toml first; npm refuses ``--provenance`` without it in
each package, and PyPI and Unity show it.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from pathlib import Path

from release.contents import REPOSITORY

ADDRESS = re.compile(r"https://[\w.-]+/([\w.-]+/[\w.-]+)")
"""The address of a repository on a Git host: the host, then the owner and the name."""


def address(repository: Path) -> str | None:
    """Return the address that is written down, None before anybody has given it."""
    with (repository / "pyproject.toml").open("rb") as file:
        urls: dict[str, str] = tomllib.load(file)["project"]["urls"]
    return urls.get("Repository")


def packages(repository: Path) -> dict[str, Path]:
    """Return the package.json of each package of npm by its name. Unity's is none of them."""
    paths = sorted(repository.glob("engines/*/package.json"))
    named = {json.loads(path.read_text("utf-8"))["name"]: path for path in paths}
    return {name: path for name, path in named.items() if name.startswith("skinbake-")}


def with_address(name: str, text: str, url: str) -> str:
    """Return the text of a file, by its name in the repository, with the address. It may have another one."""
    owner_and_name = ADDRESS.fullmatch(url)
    if owner_and_name is None or url.endswith(".git"):
        raise ValueError(
            f"{url}: expected the address of a repository, such as https://github.com/OWNER/skinbake"
        )
    if name.endswith("package.json"):
        folder = Path(name).parent.as_posix()
        line = f'  "repository": {{ "type": "git", "url": "git+{url}.git", "directory": "{folder}" }},\n'
        text = re.sub(r'^  "repository": .*\n', "", text, flags=re.MULTILINE)
        return re.sub(r'^  "license": .*\n', lambda found: found[0] + line, text, flags=re.MULTILINE)
    if name == "pyproject.toml":
        lines = f'Repository = "{url}"\nIssues = "{url}/issues"\n'
        text = re.sub(r'^(?:Repository|Issues) = ".*"\n', "", text, flags=re.MULTILINE)
        return text.replace("[project.urls]\n", f"[project.urls]\n{lines}")
    if name == "CITATION.cff":
        text = re.sub(r"^repository-code: .*\n", "", text, flags=re.MULTILINE)
        return re.sub(
            r"^license: .*\n", lambda found: f"{found[0]}repository-code: {url}\n", text, flags=re.M
        )
    # The Action and the hooks of docs/pipelines.md, with a word for the owner, or an earlier address.
    text = re.sub(r"uses: [\w.-]+/skinbake@", f"uses: {owner_and_name[1]}@", text)
    return re.sub(r"(- repo: )https://\S+/skinbake$", rf"\g<1>{url}", text, flags=re.MULTILINE)


def write_address(repository: Path, url: str) -> None:
    """Write the address into every file that names it. Raises ValueError, before anything is written."""
    paths = [repository / name for name in ("pyproject.toml", "CITATION.cff", "docs/pipelines.md")]
    paths += [*packages(repository).values(), repository / "engines" / "unity" / "package.json"]
    texts = {}
    for path in paths:
        name = path.relative_to(repository).as_posix()
        texts[path] = with_address(name, path.read_text("utf-8"), url)
    for path, text in texts.items():
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        write_address(REPOSITORY, sys.argv[1])
    except ValueError as error:
        sys.exit(str(error))
