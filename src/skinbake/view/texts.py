"""The texts of ``skinbake shader`` that the page may need, for its own file and for files dropped on it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
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


ALGORITHMS: tuple[tuple[Method, Lighting, dict[str, Any]], ...] = (
    (Method.LBS, Lighting.ACCURATE, {}),
    (Method.LBS, Lighting.ACCURATE, {"mirrored_joints": True}),
    (Method.DQS, Lighting.EXACT, {}),
    # It turns normals only where joints do mirror, so that one text serves all.
    (Method.DQS, Lighting.EXACT, {"mirrored_joints": True, "scaled_joints": True}),
)
"""What the page draws by α and β of each encoding."""


def shown_choices() -> Iterator[tuple[str, ShaderChoices]]:
    """Yield each choice that the page can make, under the name that its ``textName`` gives.

    Layouts are not a choice here: the page has put texture coordinates together before it draws.
    """
    for frame, morphs in MORPHS.items():
        for influences, morph in product(INFLUENCES, morphs):
            drawn = [(encoding, *one) for encoding, one in product(Encoding, ALGORITHMS)]
            if not morph.moves_frame:  # engines know nothing of the numbers
                drawn.insert(0, (Encoding.FLOAT32, Method.LBS, Lighting.STANDARD, {}))
            for encoding, method, lighting, joints in drawn:
                choices = ShaderChoices(
                    Language.GLSL,
                    method,
                    lighting,
                    influences,
                    frame,
                    encoding=encoding,
                    morphs=morph,
                    normal_map=lighting is not Lighting.STANDARD,
                    **joints,
                )
                sides = "mirrored" if joints else "plain"
                yield "/".join(map(str, (choices.stem, influences, frame, encoding, morph, sides))), choices
