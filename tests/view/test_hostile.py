"""A model's names and texts are text on the page, whatever they hold."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from skinbake.commands.view import view_file
from skinbake.view.page import as_data
from tests.support import browser
from tests.support.models import edited
from tests.view.pages import shown, take

NAMES = [
    "</script><script>window.hacked = 1</script>",
    "<img src=x onerror='window.hacked = 1'>",
    "<!--<script>",
    '"><svg onload=window.hacked=1>',
    "'};window.hacked = 1;//",
    "@{script}@{model}",
    "\u2028window.hacked = 1\u2029\x00\ud800",
]
FILE = "<img src=x onerror=hacked=1>'&quot;.glb"


def hostile(folder: Path, name: str) -> Path:
    """Write a fixture whose names are all one text."""

    def rename(content: dict[str, Any]) -> None:
        for kind in ("nodes", "meshes", "skins", "animations", "materials", "accessors", "scenes"):
            for entry in content.get(kind, []):
                entry["name"] = name
                entry["extras"] = {name: name}
        content["asset"]["generator"] = name

    path = edited("bent_tube.glb", folder, rename)
    return path.rename(path.with_name(FILE))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_page_has_no_element_more(tmp_path: Path, name: str) -> None:
    """The elements of the page are those of the page of an innocent file."""
    innocent = elements(view_file(str(edited("bent_tube.glb", tmp_path / "innocent", lambda _: None))).page)
    found = elements(view_file(str(hostile(tmp_path / "hostile", name))).page)
    assert found == innocent


def elements(page: bytes) -> list[str]:
    """Return the tags of a page, as a parser finds them: in scripts there are none up to their end."""
    found: list[str] = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
            found.append(f"{tag} {sorted(key for key, _ in attributes)}")

        def handle_endtag(self, tag: str) -> None:
            found.append(f"/{tag}")

    Parser().feed(page.decode())
    return found


def test_data_in_a_script_stays_the_same_json() -> None:
    text = as_data({"names": NAMES})
    assert not re.search("[<>&\u2028\u2029]", text)
    assert json.loads(text) == {"names": NAMES}


@pytest.fixture(scope="module", params=NAMES[:2])
def browsing(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[browser.Page, str, Path]]:
    """Open the page of a hostile file."""
    path = hostile(tmp_path_factory.mktemp("hostile"), request.param)
    with shown(path) as page:
        yield page, request.param, path


def test_names_are_shown_as_text(browsing: tuple[browser.Page, str, Path]) -> None:
    page, name, path = browsing
    for again in (False, True):
        if again:
            take(page, path)
        found = page.call(
            """(async () => {
                return {
                    title: document.title,
                    heading: document.querySelector('h1').textContent,
                    clip: clip.options[0].textContent,
                    places: places.hidden ? '' : places.textContent,
                    hacked: window.hacked,
                    images: document.images.length,
                    scripts: document.scripts.length,
                };
            })"""
        )
        assert found["title"] == f"{FILE} – skinbake"
        assert found["heading"] == FILE
        assert found["clip"] == name
        assert again or name in found["places"]
        assert "hacked" not in found
        assert (found["images"], found["scripts"]) == (0, 4)
    assert page.messages() == []
    assert page.requests() == [page.address]


def test_the_policy_runs_no_script_that_comes_later(browsing: tuple[browser.Page, str, Path]) -> None:
    page, _, _ = browsing
    page.call(
        """(async () => {
            document.body.insertAdjacentHTML('beforeend', '<p onclick="window.hacked = 1" id="late"></p>');
            document.getElementById('late').click();
            const script = document.createElement('script');
            script.textContent = 'window.hacked = 1';
            document.body.append(script);
            script.remove();
            document.getElementById('late').remove();
            await fetch('https://example.com/').catch(() => {});
        })"""
    )
    assert page.call("(() => window.hacked ?? null)") is None
    refused = page.messages()
    assert len(refused) >= 3
    assert all("Content Security Policy" in line for line in refused)
