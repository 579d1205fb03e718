"""Write the generated module of engines/playcanvas anew, after a change of the templates.

Usage: python -m tests.playcanvas.write_package
"""

from __future__ import annotations

from pathlib import Path

from skinbake.shaders.text import playcanvas_package

FOLDER = Path(__file__).resolve().parents[2] / "engines" / "playcanvas"


def main() -> None:
    """Replace the file."""
    for name, text in playcanvas_package().items():
        (FOLDER / name).write_bytes(text.encode("ascii"))


if __name__ == "__main__":
    main()
