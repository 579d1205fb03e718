"""A page on which an engine draws baked characters, and what the tests of each engine ask of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skinbake.format.encodings import GradientFormat
from tests.support import browser
from tests.support.characters import AS_USUAL, Character, Placement, Pose, baked
from tests.support.node import SUPPORT
from tests.support.strictness import missing_tool


class Stage:
    """The page, and the models that it can load."""

    unasked: tuple[str, ...] = ("Failed to load resource",)
    """How lines of the console begin that fail no test. The corpus has no images beside its models."""

    def __init__(self, page: browser.Page, models: Path) -> None:
        self.page, self.models = page, models

    def character(
        self,
        source: Path,
        pose: Pose,
        frame: str = "auto",
        storage: GradientFormat = AS_USUAL,
        *,
        morphs: tuple[float, ...] = (),
    ) -> Character:
        """Bake a file, so that the page can load it."""
        return Character(baked(source, self.models, frame, storage), pose, morphs)

    def call(self, function: str, options: dict[str, Any]) -> Any:
        """Call a function of the page; whatever the console says of it fails the test."""
        value = self.page.call(function, options)
        said = self.messages()
        assert not said, said
        return value

    def messages(self) -> list[str]:
        """Return the lines of the console since the last time, without those that fail no test.

        The browser may say once that reading pixels is slow.
        """
        said = [line for line in self.page.messages() if "GPU stall due to ReadPixels" not in line]
        return [line for line in said if not line.startswith(self.unasked)]

    def normals(self, character: Character, **options: object) -> dict[str, Any]:
        """Draw a character, and return its normals and what the page reports of it."""
        return dict(self.call("normals", {**character.told(Placement()), **options}))


def page_of(
    module: str, imports: Mapping[str, str] | None = None, *, scripts: Sequence[str] = (), **others: object
) -> str:
    """Return a page that imports a module, and is ready when that is done.

    ``imports`` and ``others`` are members of its import map. ``scripts`` run before the module.
    """
    parts = ["<!doctype html>", '<meta charset="utf-8">', '<link rel="icon" href="data:,">']
    if imports:
        parts.append(f'<script type="importmap">{json.dumps({"imports": imports, **others})}</script>')
    parts += [f'<script src="{script}"></script>' for script in scripts]
    return "\n".join(
        [*parts, f"<body><script type=\"module\">window.ready = import('{module}');</script>", ""]
    )


@contextmanager
def opened_page(
    page: str, folder: Path, served: Mapping[str, Path], arguments: Sequence[str] = ()
) -> Iterator[tuple[browser.Page, Path]]:
    """Open a page, and yield it with the folder of models that it can load.

    ``folder`` has no models yet. ``served`` are the folders beside /models and /support, as for
    ``browser.opened``.
    """
    models, profile = folder / "models", folder / "profile"
    for made in (models, profile):
        made.mkdir()
    folders = {"models": models, "support": SUPPORT, **served}
    with browser.opened(page, folders, profile, arguments) as shown:
        yield shown, models


def require_backend(stage: Stage, backend: str) -> None:
    """Skip where the browser has no WebGPU, and another backend would draw in its place."""
    if stage.page.call("backend", backend) != backend:
        missing_tool("this browser has no WebGPU adapter")
