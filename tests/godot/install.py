"""Put Debian unstable's Godot, and the libraries it needs, into a folder (`make setup-godot`).

apt finds and checks the packages, as if nothing was installed, and they are unpacked: nothing of the system
changes, and no rights are needed. Godot starts by its own dynamic linker (``native.py``).
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from pathlib import Path

PACKAGES = ("godot", "mesa-vulkan-drivers", "libgl1-mesa-dri", "libgl1")
SUITES = ("unstable", "testing")
"""The second one, if the first one lacks a dependency today."""
USUAL_MIRROR = "http://deb.debian.org/debian/"
KEYS = Path("/usr/share/keyrings/debian-archive-keyring.gpg")


class Apt:
    """apt-get with the state, the cache and the sources of a folder, and the machine's settings otherwise."""

    def __init__(self, folder: Path, suite: str) -> None:
        self.folder = folder
        for name in ("lists/partial", "archives/partial"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / "status").write_text("")
        (folder / "sources.list").write_text(f"deb [signed-by={KEYS}] {mirror()} {suite} main\n")
        settings = {
            "Dir::State": folder,
            "Dir::State::status": folder / "status",
            "Dir::Cache": folder,
            "Dir::Etc::SourceList": folder / "sources.list",
            "Dir::Etc::SourceParts": "/dev/null",
            "Dir::Etc::Preferences": "/dev/null",
            "Dir::Etc::PreferencesParts": "/dev/null",
            "APT::Install-Recommends": "false",
            "APT::Sandbox::User": "root",
            "Acquire::IndexTargets::deb::DEP-11::DefaultEnabled": "false",
            "Acquire::Languages": "none",
            "Acquire::Retries": "3",
        }
        self.options = [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]

    def get(self, *words: str) -> None:
        """Run apt-get; raises CalledProcessError."""
        subprocess.run(["apt-get", "-qq", *self.options, *words], check=True)

    def packages(self) -> list[Path]:
        """Return the packages that were downloaded."""
        self.get("update")
        self.get("install", "--yes", "--download-only", *PACKAGES)
        return sorted((self.folder / "archives").glob("*.deb"))


def mirror() -> str:
    """Return where the machine takes its own Debian packages from, else the usual mirror."""
    fields = "$(REPO_URI) $(RELEASE) $(COMPONENT)"
    command = ["apt-get", "indextargets", "--format", fields, "Created-By: Packages"]
    listed = subprocess.run(command, capture_output=True, encoding="utf-8", check=True).stdout
    system = platform.freedesktop_os_release()
    own = f" {system.get('VERSION_CODENAME')} main"
    found = [line.split()[0] for line in listed.splitlines() if line.endswith(own)]
    return found[0] if found and system["ID"] == "debian" else USUAL_MIRROR


def missing() -> str:
    """Say what is not installed and is needed, "" if all is there."""
    absent = [name for name in ("apt-get", "dpkg-deb", "Xvfb") if shutil.which(name) is None]
    if not KEYS.is_file():
        absent.append(f"{KEYS} (Debian package debian-archive-keyring)")
    return ", ".join(absent)


def install(folder: Path) -> str:
    """Fill a folder, and return the version of Godot's package; raises CalledProcessError."""
    shutil.rmtree(folder, ignore_errors=True)
    for suite in SUITES:
        try:
            packages = Apt(folder / "apt", suite).packages()
            break
        except subprocess.CalledProcessError:
            if suite == SUITES[-1]:
                raise
    for package in packages:
        subprocess.run(["dpkg-deb", "--extract", package, folder / "root"], check=True)
    shutil.rmtree(folder / "apt")
    (godot,) = (package for package in packages if package.name.startswith("godot_"))
    version = godot.name.split("_")[1]
    (folder / "version").write_text(f"{version}\n")
    return version


def main() -> None:
    """Install it, or say what is missing for that."""
    folder = Path(sys.argv[1]).resolve()
    absent = missing()
    if absent:
        sys.stdout.write(f"not installed: {absent}. So the tests in Godot's own renderers are skipped\n")
    else:
        sys.stdout.write(f"Godot {install(folder)} in {folder}\n")


if __name__ == "__main__":
    main()
