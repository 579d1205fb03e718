"""Pictures as the bytes of a file, PNG, WebP or GIF, and the words in them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from skinbake.render.studio import BACKGROUND, STOPS, Look, Picture

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


INK = (74, 72, 68)
PAPER = (round(255 * BACKGROUND[0]), round(255 * BACKGROUND[1]), round(255 * BACKGROUND[2]))
"""The colour round words, which may lie on a dark part of a character."""
LEAST = (160, 100)
"""The size in pixels of one lighting's picture from which on there is room for words."""


def captioned(picture: Picture, sides: Sequence[str], look: Look) -> Picture:
    """Return a picture with words on each of two lightings, and, in mode ``error``, a scale of degrees.

    A picture without room for words is returned as it is.
    """
    from PIL import Image, ImageDraw, ImageFont

    width = look.width // len(sides)
    has_scale = look.mode == "error"
    if width < LEAST[0] or look.height < LEAST[1] or (len(sides) == 1 and not has_scale):
        return picture
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    size = max(12, round(look.height / 26))
    outlined: dict[str, Any] = {"stroke_width": max(1, size // 6), "stroke_fill": PAPER}
    font, edge = ImageFont.load_default(size), look.height - size
    if len(sides) > 1:
        for number, lighting in enumerate(sides):
            draw.text((number * width + size, edge), lighting, INK, font, anchor="ls", **outlined)
    if has_scale:
        # The colours of errors from the least to the largest.
        places = np.linspace(0.0, len(STOPS) - 1.0, 4 * size)
        channels = [np.interp(places, range(len(STOPS)), channel) for channel in np.array(STOPS).T]
        colours: npt.NDArray[np.float64] = np.stack(channels, axis=1)
        bar = np.tile(colours.round().astype(np.uint8), (size // 2, 1, 1))
        last = f"{look.legend:g}°"
        right = len(sides) * width - size
        draw.text((right, edge), last, INK, font, anchor="rs", **outlined)
        left = right - round(draw.textlength(last, font)) - size // 2 - bar.shape[1]
        image.paste(Image.fromarray(bar), (left, edge - bar.shape[0] - size // 8))
        draw.text((left - size // 2, edge), "0°", INK, font, anchor="rs", **outlined)
    return np.asarray(image)
