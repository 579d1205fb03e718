"""Run the glTF-Transform command line: what happens to a baked file downstream."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from tests.support.node import Script, package_folder
from tests.support.node import require_node as _require_node

PACKAGE = "@gltf-transform/cli"
TRANSFORMER = Script("transform.mjs", PACKAGE)
TIMEOUT_SECONDS = 600


def require_node() -> str:
    """Return the path of node where glTF-Transform can run; else skip, or fail under SKINBAKE_STRICT=1."""
    return _require_node(PACKAGE)


def run(arguments: Sequence[str | Path]) -> subprocess.CompletedProcess[str]:
    """Run ``gltf-transform`` with arguments such as ``["quantize", source, target]``.

    Returns the finished process, its exit code unchecked.
    """
    return subprocess.run(
        [require_node(), str(package_folder(PACKAGE) / "bin" / "cli.js"), *map(str, arguments)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=TIMEOUT_SECONDS,
        check=False,
    )


def transform(jobs: Sequence[tuple[Path, Path, str]]) -> list[str]:
    """Apply functions of glTF-Transform, (source, target, command) each, in a process that stays.

    Returns why each failed, an empty string where it did not. Commands are those of transform.mjs.
    """
    answers = TRANSFORMER.ask(
        [
            {"source": str(source), "target": str(target), "command": command}
            for source, target, command in jobs
        ]
    )
    return [answer.get("failure", "") for answer in answers]
