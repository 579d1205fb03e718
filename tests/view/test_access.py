"""The page for all of its readers: axe-core finds nothing, at two sizes, dark and light, in every state."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fixtures.make_fixtures import FOLDER
from tests.support import browser
from tests.support.node import package_folder, require_node
from tests.view.pages import shown

RUN = """(async () => {
    const { violations, passes } = await axe.run(document, { resultTypes: ['violations', 'passes'] });
    const found = violations.map(({ id, nodes }) => [id, ...nodes.map(({ html }) => html.slice(0, 200))]);
    return { found, passed: passes.map(({ id }) => id) };
})"""
STATES = {
    "shaded": "",
    "error": "document.querySelector('input[value=error]').click(); application.tell('A message.');",
    "dragging": "document.getElementById('drop').hidden = false;",
}
SIZES = [(1280, 800), (390, 844)]


@pytest.fixture(scope="module")
def browsing() -> Iterator[browser.Page]:
    """Open the page of a fixture, with axe-core in it."""
    require_node("axe-core")
    axe = (package_folder("axe-core") / "axe.min.js").read_text(encoding="utf-8")
    with shown(FOLDER / "bent_tube.glb") as page:
        page.call(f"(() => {{ {axe} }})")
        page.call("(() => application.play(false))")
        yield page


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_axe_finds_nothing(browsing: browser.Page, size: tuple[int, int], scheme: str, state: str) -> None:
    browsing.show_as(*size, scheme)
    browsing.call(f"(() => {{ {STATES[state]} }})")
    result = browsing.call(RUN)
    browsing.call("(() => document.querySelector('input[value=shaded]').click())")
    browsing.call("(() => { application.tell(''); document.getElementById('drop').hidden = true; })")
    assert result["found"] == []
    assert {"color-contrast", "label", "select-name", "aria-valid-attr-value"} <= set(result["passed"])


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_no_part_is_wider_than_the_page_and_targets_are_large(
    browsing: browser.Page, size: tuple[int, int]
) -> None:
    browsing.show_as(*size, "light")
    wide, small = browsing.call(
        """(() => {
            const seen = [...document.querySelectorAll('button, select, label.button, input[type=range]')];
            const small = seen.filter((element) => element.getBoundingClientRect().height < 36);
            return [document.documentElement.scrollWidth, small.map(({ id }) => id)];
        })"""
    )
    assert wide <= size[0]
    assert small == []


def test_every_control_can_be_reached_by_keyboard(browsing: browser.Page) -> None:
    browsing.show_as(1280, 800, "light")
    reached = []
    browsing.call("(() => document.activeElement.blur())")
    for _ in range(40):
        browsing.press("Tab")
        reached.append(browsing.call("(() => document.activeElement.id || document.activeElement.value)"))
    wanted = "open canvas left right shaded textures moving divided home flip play time clip speed table"
    assert set(wanted.split()) <= set(reached)


def test_keys_turn_and_zoom_the_model(browsing: browser.Page) -> None:
    before = browsing.call(
        "(() => { canvas.focus(); application.goHome(); return [...application.camera.eye]; })"
    )
    for key in ("ArrowLeft", "ArrowUp", "+"):
        browsing.press(key)
    assert browsing.call("(() => [...application.camera.eye])") != before
    browsing.press("0")
    assert browsing.call("(() => [...application.camera.eye])") == before


@pytest.mark.slow
def test_no_part_moves_while_the_page_loads_or_is_used() -> None:
    """The browser's own measure of layout shifts."""
    with shown(FOLDER / "bent_tube.glb") as page:
        shift = page.call(
            """(async () => {
                let sum = 0;
                const take = (list) => list.getEntries().forEach(({ value }) => (sum += value));
                new PerformanceObserver(take).observe({ type: 'layout-shift', buffered: true });
                const wait = (time) => new Promise((done) => setTimeout(done, time));
                for (const mode of ['error', 'normals', 'reflections', 'shaded']) {
                    document.querySelector(`input[value=${mode}]`).click();
                    await wait(100);
                }
                application.play(true);
                await wait(3000);
                return sum;
            })"""
        )
    assert shift == 0
