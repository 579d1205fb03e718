"""One version everywhere."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import pytest
import yaml

from release.bump import bump, versions
from release.contents import REPOSITORY
from skinbake.version import __version__


def test_all_files_that_are_published_have_one_version() -> None:
    found = versions(REPOSITORY)
    assert set().union(*found.values()) == {__version__}
    packages = {path.relative_to(REPOSITORY).as_posix() for path in REPOSITORY.glob("engines/*/package.json")}
    assert packages < found.keys()
    for name in packages:
        assert json.loads((REPOSITORY / name).read_text(encoding="utf-8"))["version"] == __version__
    assert f"\n## [{__version__}] " in (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")


def copy_of_places(folder: Path) -> Path:
    for name in versions(REPOSITORY):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / name, folder / name)
    return folder


def test_a_bump_changes_the_version_and_nothing_else(tmp_path: Path) -> None:
    copy = copy_of_places(tmp_path)
    bump(copy, "10.20.30")
    assert set().union(*versions(copy).values()) == {"10.20.30"}
    for name in versions(copy):
        text = (copy / name).read_text(encoding="utf-8")
        assert __version__ not in text, name
        restored = text.replace("10.20.30", __version__)
        assert restored == (REPOSITORY / name).read_text(encoding="utf-8"), name


def test_a_bump_refuses_what_is_no_version(tmp_path: Path) -> None:
    copy = copy_of_places(tmp_path)
    with pytest.raises(ValueError, match="v1: expected three numbers"):
        bump(copy, "v1")


def test_a_bump_changes_nothing_where_a_file_has_lost_its_version(tmp_path: Path) -> None:
    copy = copy_of_places(tmp_path)
    (copy / "CITATION.cff").write_text("title: skinbake\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"CITATION.cff: expected one version each"):
        bump(copy, "0.2.0")
    assert versions(copy)["src/skinbake/version.py"] == {__version__}


def test_the_workflow_of_releases_tries_before_it_publishes() -> None:
    text = (REPOSITORY / ".github/workflows/release.yml").read_text(encoding="utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    needs = {name: job.get("needs", []) for name, job in jobs.items()}
    before = {name: {named} if isinstance(named, str) else set(named) for name, named in needs.items()}

    def all_before(name: str) -> set[str]:
        return before[name].union(*(all_before(one) for one in before[name]))

    for name, job in jobs.items():
        if "write" in job.get("permissions", {}).values():
            assert {"build", "try"} <= all_before(name), name
    trusted = [job for job in jobs.values() if job.get("environment") == "release"]
    assert len(trusted) == 2
    assert all(job["permissions"] == {"id-token": "write"} for job in trusted)


def test_the_notice_goes_along_with_the_package() -> None:
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["project"]["license-files"] == ["LICENSE", "NOTICE"]
    notice = (REPOSITORY / "NOTICE").read_text(encoding="utf-8")
    with (REPOSITORY / "engines/blender/build.py").open(encoding="utf-8") as file:
        [libraries] = [line for line in file if line.startswith("LIBRARIES = ")]
    for library in libraries.partition("(")[2].rstrip(")\n").split(", "):
        assert library.strip('"') in notice
