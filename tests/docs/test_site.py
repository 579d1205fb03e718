"""The site of the documentation: ``make docs`` builds it strictly, and these are its parts."""

from __future__ import annotations

from pathlib import Path

import pytest

from skinbake.cli.main import COMMANDS
from website import build


def test_the_contents_list_every_page_once() -> None:
    listed = [page for pages in build.parts().values() for page in pages]
    assert len(listed) == len(set(listed)) > 30
    assert all((build.REPOSITORY / page).is_file() for page in listed)


def test_a_page_that_is_not_listed_stops_the_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    contents = build.parts()
    del contents["Begin"][Path("docs/why.md")]
    monkeypatch.setattr(build, "parts", lambda: contents)
    with pytest.raises(SystemExit, match=r"docs/README.md does not list docs/why\.md"):
        build.lay_out(tmp_path)


def test_the_laid_out_pages_have_the_help_and_lead_to_the_front_page(tmp_path: Path) -> None:
    build.lay_out(tmp_path)
    help_page = (tmp_path / build.COMMANDS).read_text("utf-8")
    assert [f"\n## {name}\n" in help_page for name in COMMANDS] == [True] * len(COMMANDS)
    assert "--neighbours [adopt|extend|drop]" in help_page
    front = (tmp_path / "index.md").read_text("utf-8")
    assert "\nthree.js <engines/three/README>\n" in front
    assert (tmp_path / "docs" / "view.webp").is_file()
    assert "](../index.md#cite)" in (tmp_path / "docs" / "why.md").read_text("utf-8")
