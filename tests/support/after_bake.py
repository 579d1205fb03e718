"""What other tools make of a baked file, for the tests of each engine."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import gltf_transform
from tests.support.baked_files import Editable
from tests.support.characters import baked

SPARED = ("--pattern", "{POSITION,NORMAL,TANGENT}")
COMMANDS = {
    "welded": [["weld"]],
    "quantised": [["quantize", *SPARED]],
    "quantised with all attributes": [["quantize"]],
    "sorted": [["quantize", "--pattern", "NORMAL"]],
    "dequantised": [["quantize", *SPARED], ["dequantize"]],
    "sorted and dequantised": [["quantize", "--pattern", "NORMAL"], ["dequantize"]],
    "simplified": [["simplify", "--ratio", "0.5", "--error", "0.01"]],
    "optimised": [["optimize", "--compress", "quantize", "--texture-compress", "false"]],
}
SORTED = "a tool has changed the order of its joints since its bake: bake last"
REASONS = {
    "welded": "",
    "quantised": "a tool has changed the type of its positions since its bake: bake last",
    "quantised with all attributes": "bake last",
    "sorted": SORTED,
    "sorted and dequantised": SORTED,
    "dequantised": "a tool has changed the bounds of its positions since its bake: bake last",
    "simplified": "a tool has changed its triangles since its bake: bake last",
    "optimised": "bake last",
}
"""What the reason says for which a mesh is lit standard; empty if it is lit accurately."""

AGAIN = "the metadata of its bake is damaged: bake it again"
DAMAGES: dict[str, tuple[dict[str, object], str]] = {
    "frame": ({"frame": "other"}, "its frame is other, and"),
    "frame of a name that objects have": ({"frame": "constructor"}, "its frame is constructor, and"),
    "layout": ({"layout": "other"}, "its layout is other, and"),
    "scale": ({"encoding": "packed8", "scale": -1}, "the metadata of its bake lacks the scale"),
    "no alpha": ({"alpha": None}, AGAIN),
    "no influences": ({"influences": None}, AGAIN),
    "too many names": ({"alpha": ["_SKINBAKE_ALPHA_0", "_SKINBAKE_BETA_0"]}, AGAIN),
    "one name twice": ({"beta": ["_SKINBAKE_ALPHA_0"]}, AGAIN),
}
"""Members of metadata, None if there is none, and what the reason says."""

each = pytest.mark.parametrize("kind", COMMANDS)
each_damage = pytest.mark.parametrize("kind", DAMAGES)


def changed(source: Path, folder: Path, kind: str, frame: str = "auto") -> Path:
    """Bake a file, and let glTF-Transform change it in one of these ways. Return the path in the folder."""
    path = baked(source, folder, frame)
    for command, *options in COMMANDS[kind]:
        target = folder / f"{kind.replace(' ', '-')}-{command}-{source.name}"
        done = gltf_transform.run([command, path, target, *options])
        assert done.returncode == 0, done.stderr
        path = target
    return path


def simplified_in_part(source: Path, folder: Path) -> Path:
    """Bake a file of two primitives, and let the bake of the second one be for other triangles."""
    file = Editable(baked(source, folder))
    file.metadata(1)["positions"]["corners"] += 3
    return file.write(folder / f"in-part-{source.name}")


def damaged(source: Path, folder: Path, kind: str) -> Path:
    """Bake a file and damage its metadata in one of these ways. Return the path in the folder."""
    file = Editable(baked(source, folder))
    noted = file.metadata()
    noted.update(DAMAGES[kind][0])
    for member in [name for name, value in noted.items() if value is None]:
        del noted[member]
    return file.write(folder / f"damaged-{kind.replace(' ', '-')}-{source.name}")
