"""What blends on the page: drawn as three.js draws it, and a body that is solid as a solid body."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support import browser
from tests.support.characters import Array
from tests.support.transparent import LIMBS, SCENES, Primitives, Three, body, share_apart, three
from tests.view.pages import picture, shown, take

pytestmark = pytest.mark.slow

LEVELS = 3
"""Of 255."""
APART = 0.01
"""The share of pixels, beside edges, that lighting or sampling changes."""


@pytest.fixture(scope="module")
def browsing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[browser.Page]:
    """Open a page, on which the tests drop others. Its ground is out of sight."""
    first = body(tmp_path_factory.mktemp("first") / "first.glb", LIMBS, {})
    with shown(first) as page:
        page.show_as(900, 640, "light")
        page.call(
            """(async () => {
                while (innerWidth !== 900 || canvas.width !== canvas.clientWidth) {
                    await new Promise(requestAnimationFrame);
                }
                moving.checked = false;
            })"""
        )
        yield page
        assert page.messages() == []


@pytest.fixture(scope="module")
def drawing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Three]:
    """Open a page of three.js."""
    with three(tmp_path_factory.mktemp("three")) as page:
        yield page


def drawn(page: browser.Page, path: Path, time: float) -> tuple[Array, Array]:
    """Return the page's picture (H, W, 4) of a file, and the matrix to its screen."""
    take(page, path)
    page.call(
        """((time) => {
            application.choose(application.scene.clips[0]);
            application.stopMeasuring();
            application.seek(time, true);
            for (const side of [left, right]) side.value = 'standard';
            application.chooseSides();
            application.goHome();
            application.ground = [0, 0, 0, 0];
        })""",
        time,
    )
    found = picture(page)[::-1].astype(np.float64)
    aspect = found.shape[1] / found.shape[0]
    matrix = page.call("((aspect) => [...application.camera.projected(aspect)])", aspect)
    return found, np.array(matrix).reshape(4, 4).T


@pytest.mark.parametrize("is_double", [True, False], ids=["seen from both sides", "from one side"])
def test_a_body_that_blends_and_is_solid_looks_like_a_solid_body(
    browsing: browser.Page, drawing: Three, tmp_path: Path, is_double: bool
) -> None:
    """As its opaque copy, by the page and by three.js, which itself draws hidden limbs of what blends."""
    found, wanted = (
        drawn(
            browsing,
            body(tmp_path / f"{mode}.glb", LIMBS, {"alphaMode": mode, "doubleSided": is_double}),
            0.0,
        )
        for mode in ("BLEND", "OPAQUE")
    )
    assert np.abs(found[0] - wanted[0]).max() <= LEVELS
    height, width = found[0].shape[:2]
    other = drawing.picture(tmp_path / "OPAQUE.glb", 0.0, found[1], (width, height))
    assert share_apart(found[0], other) < APART


@pytest.mark.parametrize(("primitives", "time", "is_double"), SCENES)
def test_what_blends_is_drawn_as_by_three(
    browsing: browser.Page,
    drawing: Three,
    tmp_path: Path,
    primitives: Primitives,
    time: float,
    is_double: bool,
) -> None:
    path = body(tmp_path / "body.glb", primitives, {"alphaMode": "BLEND", "doubleSided": is_double})
    found, matrix = drawn(browsing, path, time)
    wanted = drawing.picture(path, time, matrix, (found.shape[1], found.shape[0]))
    assert share_apart(found, wanted) < APART
