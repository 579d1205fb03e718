"""Write tests/shaders/golden anew, after a change of the templates that is meant: then read the difference.

Usage: python -m tests.shaders.write_golden
"""

from __future__ import annotations

from pathlib import Path

from skinbake.choices import Frame, Language
from skinbake.shaders.choices import ALGORITHMS, ShaderChoices
from tests.shaders.combinations import label
from tests.support.whole_fields import shader_text

FOLDER = Path(__file__).parent / "golden"
FRAMES = [Frame.NORMAL, Frame.TANGENT] * 3


def golden_choices() -> list[ShaderChoices]:
    """Return one of each algorithm and language; the two frames take turns.

    The other combinations are compiled and run, not compared: a change of a template shows here once.
    """
    return [
        ShaderChoices(language, method, lighting, frame=frame)
        for language in Language
        for (method, lighting), frame in zip(ALGORITHMS, FRAMES, strict=True)
    ]


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
