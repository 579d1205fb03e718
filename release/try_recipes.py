"""Run the commands of docs/pipelines.md for pipx, uvx and a container in an empty Debian, as root.

``python -m release.try_recipes FOLDER`` has debootstrap make the system in the folder, unless it is there.
The wheel comes from dist/, the model from fixtures/.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

from release.build import TARGET
from release.contents import REPOSITORY

PAGE = REPOSITORY / "docs" / "pipelines.md"
WHEEL = "skinbake-*-manylinux_2_17_x86_64.whl"
BLOCK = re.compile(r"```(sh|dockerfile)\n(apt-get .*?|FROM .*?)^```", re.DOTALL | re.MULTILINE)
IN_SHELL = {"RUN": "{}", "COPY": "cp {}", "ENV": "export {}"}
"""What a line of a container's recipe does, as a command of a shell in the system."""

SETTINGS = ("etc/resolv.conf", "etc/ssl/certs/ca-certificates.crt")
"""How this system reaches its mirror and the package index."""

USED = ("skinbake bake art --out-dir build", "skinbake verify build")

ENVIRONMENT = {"HOME": "/root", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive"}
ENVIRONMENT |= dict.fromkeys(("PIP_CERT", "SSL_CERT_FILE"), "/etc/ssl/certs/ca-certificates.crt")


def scripts() -> list[str]:
    """Return the commands of the page: those of the shell, then those of the container's recipe."""
    found = dict(BLOCK.findall(PAGE.read_text("utf-8")))
    lines = [line.split(" ", 1) for line in found["dockerfile"].splitlines()]
    container = [IN_SHELL[word].format(rest) for word, rest in lines if word in IN_SHELL]
    return [found["sh"], "\n".join([*container, "cd /srv; rm -rf build", *USED])]


def main(root: Path) -> None:
    """Make the system, and run both scripts there. Ends at the first command that fails."""
    if not root.exists():
        small = ["--variant=minbase", "--include=ca-certificates"]
        subprocess.run(["debootstrap", *small, "bookworm", root], check=True)
    for name in SETTINGS:
        shutil.copyfile(Path("/", name), root / name)
    [wheel] = TARGET.glob(WHEEL)
    for file, folder in ((wheel, "dist"), (REPOSITORY / "fixtures" / "bent_tube.glb", "art")):
        (root / "srv" / folder).mkdir()
        shutil.copy(file, root / "srv" / folder)
    for script in scripts():
        command = f"mount -t proc proc /proc; cd /srv\n{script}"
        inside = ["chroot", str(root), "bash", "-exc", command]
        # A new space of mounts ends with the command.
        subprocess.run(["unshare", "--mount", *inside], check=True, env=ENVIRONMENT)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
