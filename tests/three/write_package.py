"""Write the generated modules of engines/three anew, after a change of the templates.

Usage: python -m tests.three.write_package
"""

from __future__ import annotations

from pathlib import Path

from skinbake.shaders.text import three_package

FOLDER = Path(__file__).resolve().parents[2] / "engines" / "three"


def main() -> None:
    """Replace the files."""
    for name, text in three_package().items():
        (FOLDER / name).write_bytes(text.encode("ascii"))


if __name__ == "__main__":
    main()
