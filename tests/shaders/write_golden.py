"""Write tests/shaders/golden anew, after a change of the templates that is meant: then read the difference.

Usage: python -m tests.shaders.write_golden
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from skinbake.geometry.frames import NORMAL_FRAME, TANGENT_FRAME
from skinbake.replay.surface import DEFAULT_CAP
from skinbake.shaders.choices import ALGORITHMS, Language, Lighting, Method, Morphs, ShaderChoices
from skinbake.shaders.text import shader_text
from tests.shaders.combinations import label

FOLDER = Path(__file__).parent / "golden"


def golden_choices() -> list[ShaderChoices]:
    """Return a few that show every template: each algorithm, both frames, one to three sets, every option."""
    found = []
    for language in Language:
        fours = [ShaderChoices(language, method, lighting) for method, lighting in ALGORITHMS]
        found += [
            replace(choices, frame=frame)
            for choices, frame in zip(fours, [NORMAL_FRAME, TANGENT_FRAME] * 3, strict=True)
        ]
        accurate = ShaderChoices(language, Method.LBS, Lighting.ACCURATE, frame=TANGENT_FRAME)
        found += [replace(accurate, influences=count) for count in (1, 5, 12)]
        found.append(replace(accurate, cap=DEFAULT_CAP, mirrored_joints=True))
        found.append(ShaderChoices(language, Method.DQS, Lighting.EXACT, 8, NORMAL_FRAME, cap=DEFAULT_CAP))
        found.append(ShaderChoices(language, Method.DQS, Lighting.EXACT, 1))
        found.append(ShaderChoices(language, encoding="packed8", scale=2.5))
        found.append(ShaderChoices(language, encoding="snorm16", influences=8))
        found.append(ShaderChoices(language, layout="texcoord"))
        found.append(ShaderChoices(language, morphs=Morphs.NORMAL))
        found.append(
            ShaderChoices(language, Method.DQS, Lighting.EXACT, 4, TANGENT_FRAME, morphs=Morphs.TANGENT)
        )
    return found


def golden_files() -> dict[str, str]:
    """Return every file's name and the text that it should hold."""
    return {f"{label(choices)}.{choices.language}": shader_text(choices) for choices in golden_choices()}


def main() -> None:
    """Replace the files, and remove what no choices name any more."""
    files = golden_files()
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.iterdir():
        if path.name not in files:
            path.unlink()
    for name, text in files.items():
        (FOLDER / name).write_bytes(text.encode("ascii"))


if __name__ == "__main__":
    main()
