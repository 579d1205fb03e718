"""The figures beside the model: the truth with the smaller gain is the one that counts."""

from __future__ import annotations

import re

import pytest

from fixtures.make_fixtures import FOLDER
from skinbake.commands.verify import verify_file
from skinbake.lighting.measured import VerifyOptions
from tests.view.pages import shown

pytestmark = pytest.mark.slow


def test_the_headline_is_the_smaller_gain() -> None:
    normals = verify_file(str(FOLDER / "bent_tube.glb"), VerifyOptions()).normals
    assert normals is None, "the fixture is not baked: the page bakes it"
    with shown(FOLDER / "bent_tube.glb") as page:
        headline, words, table = page.call(
            """(() => [gain.textContent, document.getElementById('gain-words').textContent,
                [...document.querySelectorAll('#table tbody tr')].slice(0, 2).map((row) =>
                    [...row.querySelectorAll('td')].map((cell) => Number(cell.textContent)))])"""
        )
    (by_tangents, _, by_triangles, _), (tangents, _, triangles, _) = table
    assert by_triangles / triangles < by_tangents / tangents
    assert re.fullmatch(r"\d\d\.\d\d×", headline), "two decimals, as in the text of verify"
    assert float(headline.rstrip("×")) == pytest.approx(by_triangles / triangles, rel=0.05)
    assert f"{triangles:.2f}° instead of {by_triangles:.2f}° in the mean, by triangles. It is " in words
