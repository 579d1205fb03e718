"""Say what PyPI, npm and the site would refuse, before anything is published: ``python -m release.check``.

It looks at what `make dist` and `make docs` have built, and at package.json of each package. On the Git host
the tag and the repository are those of the environment (GITHUB_REF_NAME, GITHUB_REPOSITORY).
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from email.parser import BytesParser
from pathlib import Path
from zipfile import ZipFile

from release.address import ADDRESS, address, packages
from release.contents import REPOSITORY, faults
from skinbake.version import __version__

RELATIVE = re.compile(r"\]\((?!https?://|#|mailto:)[^)]+\)")
"""A link in Markdown that leads nowhere outside the repository."""


def of_release(repository: Path, environment: Mapping[str, str]) -> Iterator[str]:
    """Yield what any publication lacks: the address, the tag, the date."""
    url = address(repository)
    if url is None:
        yield "the address of the repository is not given: python -m release.address https://github.com/OWNER/skinbake"
    elif (here := environment.get("GITHUB_REPOSITORY")) and ADDRESS.sub(r"\1", url).lower() != here.lower():
        yield f"pyproject.toml names {url}, and this is {here}: python -m release.address"
    if (tag := environment.get("GITHUB_REF_NAME")) and tag != f"v{__version__}":
        yield f"the tag is {tag}, and the version {__version__}: python -m release.bump"
    changes = (repository / "CHANGELOG.md").read_text("utf-8")
    if not re.search(rf"^## \[{re.escape(__version__)}\] – \d{{4}}-\d\d-\d\d$", changes, re.MULTILINE):
        yield f"CHANGELOG.md has no date for {__version__}"


def of_pypi(dist: Path) -> Iterator[str]:
    """Yield what PyPI would refuse of the sdist and the wheels, or show wrongly."""
    from trove_classifiers import classifiers

    files = sorted(dist.glob("skinbake-*")) if dist.is_dir() else []
    if not files:
        yield f"{dist} has no files: make dist"
        return
    for path in files:
        yield from (f"{path.name} {fault}" for fault in faults(path))
        if f"-{__version__}" not in path.name:
            yield f"{path.name} is of another version than {__version__}"
    twine = [sys.executable, "-m", "twine", "check", "--strict", *map(str, files)]
    checked = subprocess.run(twine, capture_output=True, text=True, check=False)
    if checked.returncode:
        yield "twine check: " + " ".join((checked.stdout + checked.stderr).split())
    for path in (
        files[:1] if files[0].suffix == ".whl" else [one for one in files if one.suffix == ".whl"][:1]
    ):
        with ZipFile(path) as wheel:
            [name] = [one for one in wheel.namelist() if one.endswith(".dist-info/METADATA")]
            metadata = BytesParser().parsebytes(wheel.read(name))
        unknown = set(metadata.get_all("Classifier", [])) - classifiers
        yield from (f"PyPI knows no classifier {one}" for one in sorted(unknown))
        body = metadata.get_payload(decode=True)
        if lost := RELATIVE.findall(body.decode("utf-8") if isinstance(body, bytes) else ""):
            yield f"{len(lost)} links of the description lead nowhere on PyPI, such as {lost[0][1:]}"


def of_npm(repository: Path) -> Iterator[str]:
    """Yield what npm would refuse of each package, with ``--provenance``, or leave out."""
    url = address(repository)
    for name, path in packages(repository).items():
        package = json.loads(path.read_text("utf-8"))
        folder = path.parent
        expected = {
            "type": "git",
            "url": f"git+{url}.git",
            "directory": folder.relative_to(repository).as_posix(),
        }
        if package.get("repository") != expected:
            yield f"{name} does not name its repository: python -m release.address"
        if package["version"] != __version__:
            yield f"{name} has the version {package['version']}: python -m release.bump"
        listed = {"package.json", *package["files"]}
        for file in sorted(listed ^ {one.name for one in folder.iterdir()}):
            yield f"{name}: {file} is {'missing' if file in listed else 'not in its files'}"


def of_site(site: Path) -> Iterator[str]:
    """Yield what the site lacks."""
    if not (site / "index.html").is_file():
        yield f"{site} has no front page: make docs"


def main() -> None:
    """Print what is missing, by registry. Exit 1 if anything is."""
    found = {
        "any registry": of_release(REPOSITORY, os.environ),
        "PyPI": of_pypi(REPOSITORY / "dist"),
        "npm": of_npm(REPOSITORY),
        "the site": of_site(REPOSITORY / "build" / "site" / "html"),
    }
    missing = [f"{registry}: {fault}" for registry, each in found.items() for fault in each]
    print("\n".join(missing) or "nothing is missing")
    sys.exit(bool(missing))


if __name__ == "__main__":
    main()
