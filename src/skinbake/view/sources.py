"""The page's own files: HTML, style and modules, put together into one text that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent / "templates" / "page"
INDEX = Path(__file__).parent / "templates" / "index"

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
"""The modules, each after the modules that it imports. No two of them have a top-level name in common."""

IMPORT = re.compile(r"^import \{[^}]*\} from '\./[a-z]+\.js';\n", re.MULTILINE)
EXPORT = re.compile(r"^export (?=const |class |function |async function )", re.MULTILINE)
MARK = re.compile(r"@\{(\w+)\}")


@cache
def script() -> str:
    """Return all modules as one. Browsers import no module of a page that was opened as a file."""
    modules = (EXPORT.sub("", IMPORT.sub("", _text(name))) for name in MODULES)
    return "\n".join(text.strip("\n") + "\n" for text in modules)


@cache
def _text(name: str, folder: Path = FOLDER) -> str:
    return (folder / name).read_text(encoding="utf-8")


def filled_page(values: dict[str, str]) -> str:
    """Return the page with its style and script, and with ``values`` in the places of their names.

    The values must be safe where they stand: HTML as text, and in scripts no ``<``.
    """
    return _filled(_text("page.html"), _text("page.css"), script(), values)


def filled_index(values: dict[str, str]) -> str:
    """Return the index of several pages, filled like the page itself."""
    page, style, code = (_text(f"index.{kind}", INDEX) for kind in ("html", "css", "js"))
    return _filled(page, style, code, values)


def _filled(page: str, style: str, code: str, values: dict[str, str]) -> str:
    """Return a page with a policy that lets the browser run its own script and no other, and load nothing."""
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data: blob:; "
        f"style-src '{_digest(style)}'; script-src '{_digest(code)}'"
    )
    known = {**values, "style": style, "script": code, "policy": policy}
    return MARK.sub(lambda found: known[found[1]], page)


def _digest(text: str) -> str:
    """Return the source expression of an inline text (Content Security Policy Level 3, §2.3.1)."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
