"""Write the generated file of engines/godot anew, after a change of the templates.

Usage: python -m tests.godot.write_addon
"""

from __future__ import annotations

from pathlib import Path

from skinbake.shaders.text import godot_include

FOLDER = Path(__file__).resolve().parents[2] / "engines" / "godot"
ADDON = FOLDER / "addons" / "skinbake"
INCLUDE = ADDON / "skinbake.gdshaderinc"


def main() -> None:
    """Replace the file."""
    INCLUDE.write_bytes(godot_include().encode("ascii"))


if __name__ == "__main__":
    main()
