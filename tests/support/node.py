"""Find node and the npm packages that tests/support/package-lock.json pins."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.support.strictness import missing_tool

SUPPORT = Path(__file__).resolve().parent
INSTALL_COMMAND = "npm ci --prefix tests/support"


def package_folder(package: str) -> Path:
    """Return where npm puts this package, whether or not it is installed."""
    return SUPPORT / "node_modules" / package


def require_node(*packages: str) -> str:
    """Return the path of node, once every named package is installed too.

    Skips the test with a reason where something is missing, or fails it under SKINBAKE_STRICT=1.
    """
    node = shutil.which("node")
    if node is None:
        missing_tool("node is not installed")
    absent = [package for package in packages if not (package_folder(package) / "package.json").is_file()]
    if absent:
        missing_tool(f"{', '.join(absent)} not installed: run `{INSTALL_COMMAND}`")
    return node
