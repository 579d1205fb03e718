"""Materials on the page: real characters as three.js draws them, and what blends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support import browser, corpus
from tests.support.characters import Array
from tests.support.transparent import (
    LIMBS,
    REAL,
    SCENES,
    TOLERANCE,
    Primitives,
    Three,
    body,
    flat,
    share_apart,
    three,
)
from tests.view.pages import picture, shown, take

pytestmark = pytest.mark.slow

LEVELS = 3
"""Of 255."""
FILTERED = 0.02
"""The share of pixels that filtering changes: thin stripes of CesiumMan."""
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
            const { scene } = application;
            const still = { name: '', start: 0, end: 0, channels: [] };
            application.choose(scene.model.clips.length ? scene.clips[0] : still);
            application.stopMeasuring();
            application.seek(time, true);
            for (const side of [left, right]) side.value = 'standard';
            application.chooseSides();
            divided.checked = true;
            application.goHome();
            application.ground = [0, 0, 0, 0];
        })""",
        time,
    )
    found = picture(page)[::-1].astype(np.float64)
    aspect = found.shape[1] / found.shape[0]
    matrix = page.call("((aspect) => [...application.camera.projected(aspect)])", aspect)
    return found, np.array(matrix).reshape(4, 4).T


@pytest.mark.parametrize("source", REAL)
def test_a_character_without_light_is_drawn_as_by_three(
    browsing: browser.Page, drawing: Three, tmp_path: Path, source: str
) -> None:
    """Images, factors, colours of vertices, masks and sides, and which surface is before which."""
    as_by_three(browsing, drawing, flat(corpus.require_corpus() / source, tmp_path / "flat.glb"))


def test_a_moved_image_is_drawn_as_by_three(browsing: browser.Page, drawing: Three, tmp_path: Path) -> None:
    moved = {"offset": [0.3, -0.2], "rotation": 0.7, "scale": [0.9, 0.6]}
    image = {"index": 0, "extensions": {"KHR_texture_transform": moved}}
    material = {"pbrMetallicRoughness": {"baseColorTexture": image}}
    source = corpus.require_corpus() / "public/CesiumMan/CesiumMan.glb"
    as_by_three(browsing, drawing, flat(source, tmp_path / "moved.glb", material=material))


def as_by_three(browsing: browser.Page, drawing: Three, path: Path) -> None:
    found, matrix = drawn(browsing, path, 0.3)
    wanted = drawing.picture(path, 0.3, matrix, (found.shape[1], found.shape[0]))
    assert share_apart(found, wanted) < FILTERED


@pytest.mark.parametrize("source", REAL[:3])
@pytest.mark.parametrize("alpha", [0.8, 0.95])
def test_a_whole_character_that_blends_shows_its_nearest_surface(
    browsing: browser.Page, tmp_path: Path, source: str, alpha: float
) -> None:
    """Its triangles come in any order. What lies behind shows by as much as they let through, not more."""
    path = corpus.require_corpus() / source
    blended = {"alphaMode": "BLEND", "doubleSided": True}
    pictures = [
        drawn(browsing, flat(path, tmp_path / f"{mode['alphaMode']}.glb", alpha, mode), 0.3)[0]
        for mode in ({**blended, "alphaMode": "OPAQUE"}, blended)
    ]
    assert share_apart(pictures[1], pictures[0], 255 * (1 - alpha) + TOLERANCE) < FILTERED


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
