"""The texts of ``skinbake shader`` that the page may need, for its own file and for files dropped on it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

from skinbake.choices import Encoding, Frame, Language, Lighting, Method, Morphs
from skinbake.shaders.choices import ShaderChoices
from skinbake.shaders.text import shader_made

INFLUENCES = (4, 8)
"""The influences of a vertex that the page draws: WebGL 2 has room for the attributes of two sets."""

MORPHS = {
    Frame.NORMAL: (Morphs.NONE, Morphs.NORMAL, Morphs.FRAMES, Morphs.FRAMES_NORMAL),
    Frame.TANGENT: (Morphs.NONE, Morphs.NORMAL, Morphs.TANGENT, Morphs.FRAMES, Morphs.FRAMES_NORMAL),
}


@cache
def packed_texts() -> dict[str, Any]:
    """Return all lines, each once, paragraphs as numbers of lines, texts by name as numbers of paragraphs."""
    lines: dict[str, int] = {}
    paragraphs: dict[tuple[int, ...], int] = {}
    texts = {}
    for name, choices in shown_choices():
        parts = [part.split("\n") for part in shader_made(choices)[0].split("\n\n")]
        numbers = [tuple(lines.setdefault(line, len(lines)) for line in part) for part in parts]
        texts[name] = [paragraphs.setdefault(one, len(paragraphs)) for one in numbers]
    return {"lines": list(lines), "paragraphs": list(paragraphs), "texts": texts}


def shown_choices() -> Iterator[tuple[str, ShaderChoices]]:
    """Yield each choice that the page can make, under the name that its ``textName`` gives.

    Layouts are not a choice here: the page has put texture coordinates together before it draws.
    """
    for frame, morphs in MORPHS.items():
        for influences in INFLUENCES:
            for morph in morphs:
                usual = ShaderChoices(Language.GLSL, influences=influences, frame=frame, morphs=morph)
                yield from _algorithms(usual)


def _algorithms(usual: ShaderChoices) -> Iterator[tuple[str, ShaderChoices]]:
    if not usual.morphs.moves_frame:  # engines know nothing of the numbers
        yield _named(usual, Method.LBS, Lighting.STANDARD, Encoding.FLOAT32)
    for encoding in Encoding:
        yield _named(usual, Method.LBS, Lighting.ACCURATE, encoding)
        yield _named(usual, Method.LBS, Lighting.ACCURATE, encoding, mirrored=True)
        yield _named(usual, Method.DQS, Lighting.EXACT, encoding)
        # It turns normals only where joints do mirror, so that one text serves all.
        yield _named(usual, Method.DQS, Lighting.EXACT, encoding, mirrored=True, scaled=True)


def _named(
    usual: ShaderChoices,
    method: Method,
    lighting: Lighting,
    encoding: Encoding,
    *,
    mirrored: bool = False,
    scaled: bool = False,
) -> tuple[str, ShaderChoices]:
    choices = ShaderChoices(
        Language.GLSL,
        method,
        lighting,
        usual.influences,
        usual.frame,
        mirrored_joints=mirrored,
        scaled_joints=scaled,
        encoding=encoding,
        morphs=usual.morphs,
        normal_map=lighting is not Lighting.STANDARD,
    )
    parts = (choices.stem, usual.influences, usual.frame, encoding, usual.morphs)
    return "/".join([*map(str, parts), "mirrored" if mirrored else "plain"]), choices
