"""Write tests/shaders/golden and the shader text in engines/ anew, after a change of templates.

Usage: python -m tests.shaders.write_golden
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from skinbake.choices import Frame, Language, Lighting, Method, Morphs, Stage
from skinbake.shaders.choices import ALGORITHMS, ShaderChoices
from skinbake.shaders.engines import engines_folder
from skinbake.shaders.text import shader_made, targets
from tests.shaders.combinations import label
from tests.support.whole_fields import shader_text

FOLDER = Path(__file__).parent / "golden"
IN_ENGINES = {
    "three": "three/shaders.js",
    "babylon": "babylon/shaders.js",
    "playcanvas": "playcanvas/shaders.js",
    "galacean": "galacean/shaders.js",
    "godot": "godot/addons/skinbake/skinbake.gdshaderinc",
    "bevy": "bevy/src/skinbake.wgsl",
}
"""The generated shader text of each target that has a package in engines/.

A package for npm also has a copy of bake.js. All else there is written by hand.
"""
FRAMES = [Frame.NORMAL, Frame.TANGENT] * 3


def golden_choices() -> list[ShaderChoices]:
    """Return one of each algorithm and language, of joints that scale, blends and compute passes.

    The two frames take turns.
    The other combinations are compiled and run, not compared: a change of a template shows here once.
    """
    return [
        ShaderChoices(language, method, lighting, frame=frame)
        for language in Language
        for (method, lighting), frame in zip(ALGORITHMS, FRAMES, strict=True)
    ] + [
        one
        for language in Language
        for one in (
            ShaderChoices(language, Method.DQS, Lighting.EXACT, mirrored_joints=True, scaled_joints=True),
            ShaderChoices(language, Method.BLEND, mirrored_joints=True, scaled_joints=True),
            ShaderChoices(language, frame=Frame.TANGENT, morphs=Morphs.TANGENT, stage=Stage.COMPUTE),
        )
    ]


@cache
def golden_files() -> dict[Path, str]:
    """Return every file and the text that it should hold."""
    files = {FOLDER / f"{label(one)}.{one.language}": shader_text(one) for one in golden_choices()}
    for target, name in IN_ENGINES.items():
        choices = ShaderChoices(targets()[target][0], target=target)
        files[engines_folder() / name] = shader_made(choices, package=True)[0]
        if name.endswith(".js"):
            shared = engines_folder() / "bake.js"
            files[(engines_folder() / name).with_name(shared.name)] = shared.read_text(encoding="ascii")
    return files


def main() -> None:
    """Replace the files, and remove what no choices name any more."""
    files = golden_files()
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.iterdir():
        if path not in files:
            path.unlink()
    for path, text in files.items():
        path.write_bytes(text.encode("ascii"))


if __name__ == "__main__":
    main()
