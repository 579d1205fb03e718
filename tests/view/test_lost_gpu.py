"""A browser without WebGL, and one that loses the GPU while it shows a page, and has it back later."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from fixtures.make_fixtures import FOLDER
from tests.support import browser
from tests.view.pages import normals, shown, take

pytestmark = pytest.mark.slow

TUBE = FOLDER / "bent_tube.glb"


@pytest.fixture
def browsing() -> Iterator[browser.Page]:
    with shown(TUBE) as page:
        yield page


def lose(page: browser.Page) -> None:
    """Take the GPU from the page, and wait until the page knows."""
    page.call(
        """(() => new Promise((done) => {
            canvas.addEventListener('webglcontextlost', () => setTimeout(done), { once: true });
            window.lost = application.renderer.gl.getExtension('WEBGL_lose_context');
            lost.loseContext();
        }))"""
    )


def test_a_browser_without_webgl_is_told(browsing: browser.Page) -> None:
    """Its figures are there all the same."""
    found = browsing.call(
        """(async () => {
            HTMLCanvasElement.prototype.getContext = () => null;
            const script = document.createElement('script');
            script.type = 'module';
            script.textContent = document.querySelector('script[type=module]').textContent;
            window.ready = undefined;
            document.body.append(script);
            while (!window.ready) await new Promise((done) => setTimeout(done, 10));
            await window.ready.catch(() => {});
            return [message.textContent, gain.textContent];
        })"""
    )
    assert found[0].startswith(
        "The model cannot be shown: it is drawn by WebGL 2, which this browser does not"
    )
    assert found[1] == "Clear gain"


def test_a_page_without_a_gpu_measures_nothing(browsing: browser.Page) -> None:
    browsing.call("(() => application.choose(application.scene.clips[1]))")
    lose(browsing)
    assert browsing.call("(() => message.textContent)").startswith("The browser has lost the GPU.")
    known = (
        """(() => [...application.measures.get(application.clip).lines.standard].filter((mean) => mean))"""
    )
    before = browsing.call(known)
    browsing.call("(() => new Promise((done) => setTimeout(done, 500)))")
    assert browsing.call(known) == before
    take(browsing, TUBE)
    assert browsing.call("(() => [document.title, message.hidden])") == ["bent_tube.glb – skinbake", False]
    assert browsing.call("(() => application.isShown)") is False


def test_a_sample_that_was_under_way_is_left_out(browsing: browser.Page) -> None:
    """The browser says later that it lost the GPU: until then what is read back is zeros."""
    known = browsing.call(
        """(() => {
            const { renderer, scene } = application; const [clip] = scene.clips;
            application.measures.delete(clip); application.choose(clip); const captured =
            renderer.captured.bind(renderer); for (const lighting of ['standard', 'fitted', 'surface', 'dqs'])
            captured(scene.parts[0], lighting); renderer.captured = (...given) => {
                renderer.gl.getExtension('WEBGL_lose_context').loseContext();
                return captured(...given);
            };
            while (application.measureNext(clip));
            return application.measures.get(clip).lines.standard.filter((mean) => mean !== undefined);
        })"""
    )
    assert known == []


def test_the_model_comes_back_with_the_gpu(browsing: browser.Page) -> None:
    before = normals(browsing, "fitted", clip=0, time=0.4)
    lose(browsing)
    browsing.call(
        """(async () => {
            lost.restoreContext();
            while (!application.isShown) await new Promise((done) => setTimeout(done, 10));
        })"""
    )
    assert browsing.call("(() => message.hidden)") is True
    assert np.array_equal(normals(browsing, "fitted", clip=0, time=0.4), before)
