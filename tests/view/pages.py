"""Pages of files in a browser, and what a test asks of them."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.commands.view import view_file
from tests.support import browser
from tests.support.characters import Array

DEGREES = 0.01
"""Between the page and the replay: the page has joint matrices, and the shader all else, in float32."""

BASE64 = """window.base64Of = (values) => {
    const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
    let letters = '';
    for (let i = 0; i < bytes.length; i += 8192) {
        letters += String.fromCharCode(...bytes.subarray(i, i + 8192));
    }
    return btoa(letters);
};"""

NORMALS = """((clip, time, lighting) => {
    const { scene, renderer } = application;
    application.choose(scene.clips[clip]);
    application.stopMeasuring();
    application.seek(time, true);
    application.applyPose();
    return base64Of(renderer.captured(scene.parts[0], lighting).normals);
})"""


@contextmanager
def shown(source: Path) -> Iterator[browser.Page]:
    """Yield the page of a file, open in the browser from the disk."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "page.html")
        path.write_bytes(view_file(str(source)).page)
        scratch = Path(folder, "profile")
        scratch.mkdir()
        with browser.opened_file(path, scratch) as page:
            page.call(f"(() => {{ {BASE64} }})")
            yield page


def normals(page: browser.Page, lighting: str, *, clip: int, time: float) -> Array:
    """Return the unit normals (V, 3) that the page's vertex shader gives the first primitive."""
    return numbers(page.call(NORMALS, clip, time, lighting))


def numbers(text: str) -> Array:
    """Return float32 numbers in base64 as vectors (V, 3)."""
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(-1, 3).astype(np.float64)


def take(page: browser.Page, *files: Path) -> None:
    """Drop files on the page, and wait until it has shown them."""
    held: list[Any] = [[path.name, base64.b64encode(path.read_bytes()).decode()] for path in files]
    page.call(
        """(async (...held) => {
            const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
            await application.take(held.map(([name, text]) => new File([bytes(text)], name)));
        })""",
        *held,
    )


def picture(page: browser.Page) -> npt.NDArray[np.uint8]:
    """Return what the canvas shows now, as pixels (H, W, 4)."""
    width, height, text = page.call(
        """(() => {
            application.draw();
            const { gl, canvas } = application.renderer;
            const pixels = new Uint8Array(4 * canvas.width * canvas.height);
            gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
            return [canvas.width, canvas.height, base64Of(pixels)];
        })"""
    )
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)
