"""Names that a user gives: a URL is no path, and has a canonical form too."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skinbake.files.urls import canonical, is_url, on_disk


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
    assert canonical(url) == form


def test_a_path_and_its_url_are_one_file(tmp_path: Path) -> None:
    (tmp_path / "hero.glb").touch()
    (tmp_path / "link.glb").symlink_to("hero.glb")
    path = os.path.realpath(tmp_path / "hero.glb")
    assert canonical(str(tmp_path / "link.glb")) == canonical(f"file://{tmp_path}/link.glb") == path


@pytest.mark.parametrize("path", ["C:\\\\a\\hero.glb", "c:/hero.glb", "a/b://c.glb", "hero.glb"])
def test_a_drive_or_a_folder_is_no_scheme(path: str) -> None:
    assert not is_url(path)
    assert on_disk(path) == path
