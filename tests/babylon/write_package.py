"""Write the generated module of engines/babylon anew, after a change of the templates.

Usage: python -m tests.babylon.write_package
"""

from __future__ import annotations

from pathlib import Path

from skinbake.shaders.text import babylon_package

FOLDER = Path(__file__).resolve().parents[2] / "engines" / "babylon"


def main() -> None:
    """Replace the file."""
    for name, text in babylon_package().items():
        (FOLDER / name).write_bytes(text.encode("ascii"))


if __name__ == "__main__":
    main()
