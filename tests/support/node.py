"""Find node and the npm packages that tests/support/package-lock.json pins, and ask scripts about files.

A script of this folder answers each line on its stdin with one on its stdout. It is started once and asked
again and again: node takes half a second to start, and is slow until it has compiled what it runs.
"""

from __future__ import annotations

import atexit
import json
import subprocess
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from tests.support.strictness import missing_tool
from tests.support.tools import required_program

SUPPORT = Path(__file__).resolve().parent
INSTALL_COMMAND = "npm ci --prefix tests/support"
PATIENCE_SECONDS = 600


def package_folder(package: str) -> Path:
    """Return where npm puts this package, whether or not it is installed."""
    return SUPPORT / "node_modules" / package


def require_node(*packages: str) -> str:
    """Return the path of node, once every named package is installed too.

    Skips the test with a reason where something is missing, or fails it under SKINBAKE_STRICT=1.
    """
    node = required_program("node")
    absent = [package for package in packages if not (package_folder(package) / "package.json").is_file()]
    if absent:
        missing_tool(f"{', '.join(absent)} not installed: run `{INSTALL_COMMAND}`")
    return node


def run_program(package: str, program: str, *arguments: str, folder: Path) -> None:
    """Run the program of a package in a folder; if it fails, its words fail the test."""
    done = subprocess.run(
        [require_node(package), str(package_folder(package) / "bin" / program), *arguments],
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def build_page(project: Path, entry: Path, packages: Mapping[str, str], **configuration: object) -> None:
    """Bundle a module into ``dist/app.js`` of an empty project by vite.

    ``packages`` are the files and folders that it imports by name. ``configuration`` are further members of
    vite's.
    """
    (project / f"app{entry.suffix}").write_bytes(entry.read_bytes())
    (project / "package.json").write_text('{"name": "project", "private": true, "type": "module"}')
    build = {"entry": f"app{entry.suffix}", "formats": ["es"], "fileName": "app"}
    told: dict[str, object] = {"build": {"minify": False, "lib": build}, "logLevel": "warn"}
    # Libraries of three.js bring it again. Pages of the tests import what is served as /support.
    told["resolve"] = {"alias": {**packages, "/support": str(SUPPORT)}, "dedupe": ["three"]}
    (project / "vite.config.mjs").write_text(f"export default {json.dumps(told | configuration)};")
    run_program("vite", "vite.js", "build", folder=project)


class Script:
    """A script of this folder that runs in a node process of its own, from its first question on."""

    def __init__(self, name: str, *packages: str) -> None:
        self._name = name
        self._packages = packages
        self._process: subprocess.Popen[str] | None = None
        self._said: IO[str] | None = None

    def ask_about(self, paths: Sequence[Path]) -> list[Any]:
        """Return the answer of the script, any JSON, about each file; raises as ``ask``."""
        return self.ask([str(path.resolve()) for path in paths])

    def ask(self, questions: Sequence[object]) -> list[Any]:
        """Return the answer of the script, any JSON, to each question, any JSON too.

        Raises RuntimeError where the script ends before it has answered.
        """
        if not questions:
            return []
        process = self._started()
        assert process.stdin is not None
        assert process.stdout is not None
        watch = threading.Timer(PATIENCE_SECONDS, process.kill)
        watch.start()
        try:
            answers = []
            for question in questions:
                process.stdin.write(json.dumps(question) + "\n")
                process.stdin.flush()
                answers.append(json.loads(process.stdout.readline()))
        except (OSError, ValueError) as error:
            said = self.stop()
            raise RuntimeError(
                f"{self._name} answered for {len(answers)} of {len(questions)} files: {said}"
            ) from error
        finally:
            watch.cancel()
        return answers

    def _started(self) -> subprocess.Popen[str]:
        node = require_node(*self._packages)
        if self._process is None:
            self._said = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115 - stop closes it
            self._process = subprocess.Popen(
                [node, str(SUPPORT / self._name)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                encoding="utf-8",
            )
            atexit.register(self.stop)
        return self._process

    def stop(self) -> str:
        """End the process, and return its words on stderr."""
        atexit.unregister(self.stop)
        process, said = self._process, self._said
        if process is None or said is None:
            return ""
        self._process = self._said = None
        process.kill()
        process.communicate()
        said.seek(0)
        with said:
            return said.read().strip()[-2000:]
