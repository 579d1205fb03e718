"""Names that a user gives: a URL is no path, and has a canonical form too."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skinbake.files.urls import is_url, named_file, on_disk


@pytest.mark.parametrize(
    ("url", "form"),
    [
        ("s3://bucket/a/../hero.glb", "s3://bucket/hero.glb"),
        ("memory://hero.glb", "memory://hero.glb"),
        ("https://host/a//./hero.glb", "https://host/a/hero.glb"),
    ],
)
def test_a_url_has_no_dots_in_its_canonical_form(url: str, form: str) -> None:
    assert is_url(url)
    assert on_disk(url) is None
    assert named_file(url).place == form


def test_a_path_its_url_and_its_links_are_one_file(tmp_path: Path) -> None:
    (tmp_path / "hero.glb").touch()
    (tmp_path / "link.glb").symlink_to("hero.glb")
    (tmp_path / "folder").symlink_to(tmp_path)
    whole = named_file(str(tmp_path / "hero.glb"))
    assert whole.place.casefold() == os.path.realpath(tmp_path / "hero.glb").casefold()
    for name in ("link.glb", "folder/hero.glb", "folder/link.glb", f"folder/../{tmp_path.name}/hero.glb"):
        for start in ("", "file://"):
            other = named_file(f"{start}{tmp_path}/{name}")
            assert other == whole._replace(given=other.given), name
            assert whole.is_same(other)


def test_a_hard_link_has_another_place_and_is_the_same_file(tmp_path: Path) -> None:
    (tmp_path / "hero.glb").touch()
    (tmp_path / "copy.glb").touch()
    os.link(tmp_path / "hero.glb", tmp_path / "hard.glb")
    hero, hard, copy = (named_file(str(tmp_path / name)) for name in ("hero.glb", "hard.glb", "copy.glb"))
    assert hero.is_same(hard)
    assert hero.place != hard.place
    assert not hero.is_same(copy)


def test_the_names_of_what_is_not_there_have_one_key_and_are_no_file(tmp_path: Path) -> None:
    (tmp_path / "dangling.glb").symlink_to("none.glb")
    missing, dangling = (named_file(str(tmp_path / name)) for name in ("none.glb", "dangling.glb"))
    assert missing.key == missing.place == dangling.key
    assert missing.identity is None
    assert not missing.is_same(dangling)


@pytest.mark.parametrize("name", ["-", "a\0b.glb", "x" * 300])
def test_a_name_of_no_disk_is_no_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "-").touch()
    assert named_file(name).identity is None
    assert not named_file(name).is_same(named_file(name))


@pytest.mark.parametrize("path", ["C:\\\\a\\hero.glb", "c:/hero.glb", "a/b://c.glb", "hero.glb"])
def test_a_drive_or_a_folder_is_no_scheme(path: str) -> None:
    assert not is_url(path)
    assert on_disk(path) == path
