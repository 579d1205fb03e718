"""What release.check says is missing, and the address of the repository in every file that names it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from release.address import address, packages, write_address
from release.check import of_npm, of_release, of_site
from release.contents import REPOSITORY
from skinbake.version import __version__
from tests.support.tools import required_program

URL = "https://github.com/someone/skinbake"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what names the address or is published by npm."""
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md", "docs/pipelines.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(REPOSITORY / name, tmp_path / name)
    shutil.copytree(REPOSITORY / "engines", tmp_path / "engines")
    return tmp_path


def test_one_address_reaches_every_file_and_a_second_one_replaces_it(tree: Path) -> None:
    write_address(tree, "https://github.com/other/skinbake")
    paths = [path for path in tree.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    first = {path: path.read_bytes() for path in paths}
    write_address(tree, URL)
    assert address(tree) == URL
    for path, data in first.items():
        renamed = data.replace(b"github.com/other/", b"github.com/someone/")
        assert path.read_bytes() == renamed.replace(b"uses: other/", b"uses: someone/")
    for path in [*packages(tree).values(), tree / "engines" / "unity" / "package.json"]:
        package = json.loads(path.read_text("utf-8"))
        assert package["repository"]["url"] == f"git+{URL}.git"
        assert (tree / package["repository"]["directory"] / "package.json").samefile(path)
    assert yaml.safe_load((tree / "CITATION.cff").read_text("utf-8"))["repository-code"] == URL
    pipelines = (tree / "docs/pipelines.md").read_text("utf-8")
    assert "uses: someone/skinbake@" in pipelines
    assert f"repo: {URL}\n" in pipelines


@pytest.mark.parametrize("url", ["someone/skinbake", f"{URL}.git", f"{URL}/tree/main"])
def test_an_address_that_is_none_changes_nothing(tree: Path, url: str) -> None:
    before = {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match="expected the address of a repository"):
        write_address(tree, url)
    assert {path: path.read_bytes() for path in before} == before


def test_nothing_is_missing_of_packages_and_release_once_address_and_date_are_given(tree: Path) -> None:
    assert any("is not given" in fault for fault in of_release(tree, {}))
    assert sorted({fault.partition(" ")[0] for fault in of_npm(tree)}) == sorted(packages(tree))
    write_address(tree, URL)
    changes = tree / "CHANGELOG.md"
    dated = changes.read_text("utf-8").replace(
        f"[{__version__}] – unreleased", f"[{__version__}] – 2026-12-01"
    )
    changes.write_text(dated, "utf-8")
    there = {"GITHUB_REPOSITORY": "Someone/skinbake", "GITHUB_REF_NAME": f"v{__version__}"}
    assert [*of_release(tree, there), *of_npm(tree)] == []
    elsewhere = {"GITHUB_REPOSITORY": "fork/skinbake", "GITHUB_REF_NAME": "v9.9.9"}
    assert len([*of_release(tree, elsewhere)]) == 2
    (tree / "engines/three/core.js").unlink()
    assert [*of_npm(tree)] == ["skinbake-three: core.js is missing"]
    assert [*of_site(tree)] == [f"{tree} has no front page: make docs"]


@pytest.mark.slow
def test_npm_packs_each_package_with_its_repository(tree: Path) -> None:
    npm = required_program("npm")
    write_address(tree, URL)
    for name, path in packages(tree).items():
        packed = subprocess.run(
            [npm, "pack", "--dry-run", "--json"], cwd=path.parent, capture_output=True, text=True, check=True
        )
        [listed] = json.loads(packed.stdout)
        assert (listed["name"], listed["version"]) == (name, __version__)
        assert {one["path"] for one in listed["files"]} == {one.name for one in path.parent.iterdir()}


def test_the_workflow_checks_before_it_publishes_and_no_registry_waits_for_another() -> None:
    jobs = yaml.safe_load((REPOSITORY / ".github/workflows/release.yml").read_text("utf-8"))["jobs"]
    assert "make release-check" in [step.get("run") for step in jobs["build"]["steps"]]
    for name in ("pypi", "npm", "site", "attest"):
        assert jobs[name]["needs"] == "try"


def test_pypi_reads_whole_links_once_the_address_is_given(tree: Path) -> None:
    for name in ("setup.py", "README.md", "src/skinbake/version.py"):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / name, tree / name)
    write_address(tree, URL)
    command = [sys.executable, "-c", "import setup; print(setup.readme())"]
    text = subprocess.run(command, cwd=tree, capture_output=True, text=True, check=True).stdout
    assert f"]({URL}/blob/v{__version__}/docs/why.md)" in text
    assert f"]({URL}/raw/v{__version__}/docs/view.webp)" in text
    assert "](docs/" not in text
    with (tree / "pyproject.toml").open("rb") as file:
        assert "readme" in tomllib.load(file)["project"]["dynamic"]
