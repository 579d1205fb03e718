"""Print what an installation weighs, package by package, for docs/install.md.

``python -m benchmarks.install_size`` installs the tree, without extras, into a new virtual environment. It
adds up the files that each package brought and those that Python compiled from them, by the record of pip.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]

BROUGHT_BY = {"pygments": "rich", "markdown-it-py": "rich", "mdurl": "rich", "markupsafe": "jinja2"}

WEIGH = """
import importlib.metadata, json
sizes = {}
for found in importlib.metadata.distributions():
    files = [found.locate_file(path) for path in found.files or []]
    sizes[found.name.lower()] = [found.version, sum(path.stat().st_size for path in files if path.is_file())]
print(json.dumps(sizes))
"""


def weigh(folder: Path) -> dict[str, tuple[str, int]]:
    """Install into a folder. Return the version and the bytes of each package."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, str(REPOSITORY)], check=True)
    told = subprocess.run([python, "-c", WEIGH], check=True, capture_output=True, text=True)
    return {name: (version, size) for name, (version, size) in json.loads(told.stdout).items()}


def table(sizes: dict[str, tuple[str, int]]) -> str:
    """Return the table in Markdown, the heaviest first."""
    together: dict[str, int] = {}
    for name, (_, size) in sizes.items():
        owner = BROUGHT_BY.get(name, name)
        together[owner] = together.get(owner, 0) + size
    rows = [
        f"| {name} {sizes[name][0]} | {size / 1e6:.1f} |"
        for name, size in sorted(together.items(), key=lambda item: -item[1])
        if size >= 50_000
    ]
    rows.append(f"| all | {sum(together.values()) / 1e6:.1f} |")
    return "\n".join(["| package | MB |", "|---|--:|", *rows]) + "\n"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        written = table(weigh(Path(name)))
    print(written)


if __name__ == "__main__":
    main()
