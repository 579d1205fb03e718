"""The page's own files: HTML, style and modules, put together into one text that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent / "page"

MODULES = (
    "matrices.js",
    "reader.js",
    "poses.js",
    "truth.js",
    "shading.js",
    "renderer.js",
    "scene.js",
    "camera.js",
    "chart.js",
    "figures.js",
    "application.js",
)
"""The modules, each after the ones that it imports. No two of them have a top-level name in common."""

IMPORT = re.compile(r"^import \{[^}]*\} from '\./[a-z]+\.js';\n", re.MULTILINE)
EXPORT = re.compile(r"^export (?=const |class |function |async function )", re.MULTILINE)
MARK = re.compile(r"@\{(\w+)\}")


@cache
def script() -> str:
    """Return all modules as one. Browsers import no module of a page that was opened as a file."""
    return "\n".join(_unlinked(_text(name)) for name in MODULES)


def _unlinked(text: str) -> str:
    return EXPORT.sub("", IMPORT.sub("", text)).strip("\n") + "\n"


@cache
def _text(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def filled_page(values: dict[str, str]) -> str:
    """Return the page with its style and script, and with ``values`` in the places of their names.

    The values must be safe where they stand: HTML as text, and in scripts no ``<``. The policy lets the
    browser run the page's own script and no other, and load nothing.
    """
    style, code = _text("page.css"), script()
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data: blob:; "
        f"style-src '{_digest(style)}'; script-src '{_digest(code)}'"
    )
    known = {**values, "style": style, "script": code, "policy": policy}
    return MARK.sub(lambda found: known[found[1]], _text("page.html"))


def _digest(text: str) -> str:
    """Return the source expression of an inline text (Content Security Policy Level 3, §2.3.1)."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
