"""Pictures as the bytes of a file: PNG, WebP or GIF."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

from skinbake.render.studio import Picture

SUFFIXES = {".png": "PNG", ".webp": "WEBP", ".gif": "GIF"}
OPTIONS: dict[str, dict[str, Any]] = {".png": {"optimize": True}, ".webp": {"quality": 90}, ".gif": {}}
MOVING = (".webp", ".gif")
MILLISECONDS = 50
"""The time of a picture in an animation: GIF counts in hundredths of a second."""


def encoded(pictures: Sequence[Picture], suffix: str) -> bytes:
    """Return a file of one picture, or an animation of several that repeats."""
    from PIL import Image

    images = [Image.fromarray(picture) for picture in pictures]
    data = io.BytesIO()
    if suffix == ".gif":
        # One palette for all pictures, so that colours do not flicker.
        palette = images[len(images) // 2].quantize(255)
        images = [image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for image in images]
    options = dict(OPTIONS[suffix])
    if len(images) > 1:
        options |= {"save_all": True, "append_images": images[1:], "duration": MILLISECONDS, "loop": 0}
    images[0].save(data, SUFFIXES[suffix], **options)
    return data.getvalue()
