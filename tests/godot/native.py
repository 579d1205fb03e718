"""Godot itself, as Debian has it: its editor's import, and its renderers on Mesa's software drivers.

`make setup-godot` puts its packages into a folder. Nothing of that folder is installed: Godot starts by the
folder's own dynamic linker, with the folder's own libraries.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.support.corpus_folder import REPOSITORY
from tests.support.strictness import missing_tool
from tests.support.tools import required_program

FOLDER = Path(os.environ.get("SKINBAKE_GODOT", REPOSITORY / "build" / "godot"))
"""What `make setup-godot` made."""
TIMEOUT_SECONDS = 900


def version() -> str:
    """Return the version of the package, "" if there is none."""
    file = FOLDER / "version"
    return file.read_text("utf-8").strip() if file.is_file() else ""


class Godot:
    """Godot with a home of its own."""

    def __init__(self, home: Path, display: str) -> None:
        root = FOLDER / "root" / "usr"
        (self.linker,) = root.glob("lib*/ld-linux-*.so.*")
        (vulkan,) = root.glob("lib/*/libvulkan_lvp.so")
        (self.program,) = root.glob("bin/godot")
        self.libraries = vulkan.parent
        driver = home / "driver.json"
        told = {"file_format_version": "1.0.1", "ICD": {"library_path": str(vulkan), "api_version": "1.3.0"}}
        driver.write_text(json.dumps(told))
        self.environment = {
            "HOME": str(home),
            "PATH": os.defpath,
            "DISPLAY": display,
            "VK_DRIVER_FILES": str(driver),
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "LIBGL_DRIVERS_PATH": str(self.libraries / "dri"),
        }

    def run(self, project: Path, *words: str) -> str:
        """Run it in a project, and return what it says."""
        libraries = f"{self.libraries}:{self.libraries / 'pulseaudio'}"
        command = [self.linker, "--library-path", libraries, self.program, "--audio-driver", "Dummy"]
        done = subprocess.run(
            [*map(str, command), "--path", str(project), *words],
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            timeout=TIMEOUT_SECONDS,
            check=False,
        )
        assert done.returncode == 0, done.stdout
        return done.stdout


@contextmanager
def opened(home: Path) -> Iterator[Godot]:
    """Open a virtual screen for Godot; skip without either, or fail under SKINBAKE_STRICT=1."""
    if not version():
        missing_tool("Godot is not there: run `make setup-godot`")
    xvfb = required_program("Xvfb", "xvfb")
    read, write = os.pipe()
    command = [xvfb, "-displayfd", str(write), "-screen", "0", "64x64x24", "-nolisten", "tcp"]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as screen:
        os.close(write)
        try:
            with os.fdopen(read) as numbers:
                number = numbers.readline().strip()
            assert number, "Xvfb did not start"
            yield Godot(home, f":{number}")
        finally:
            screen.terminate()
