"""What pyproject.toml cannot describe: compiled loops, whose flags differ by compiler, and files beside src/.

Without a compiler the package installs all the same, and `bake` and `verify` run on numpy alone. With
`SKINBAKE_PURE=1` in the environment the loops are left out on purpose: the wheel then fits every platform.
"""

import os
import re
import sys
import tomllib
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py

# No fast-math and no fused multiply-adds: the same input gives the same bytes on every machine. The last two
# switches let compilers use vectors and change no result, since the loops ask for neither errno nor traps.
MICROSOFT = ["/O2", "/fp:precise"]
OTHERS = ["-O3", "-g0", "-std=c11", "-Wno-psabi"]
OTHERS += ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]


def loops(name: str, source: str) -> Extension:
    """Return one module of compiled loops. Its headers stand in loops/ beside its source, and above that."""
    headers = sorted(Path("src/skinbake").glob("*.h")) + sorted(Path(source).parent.glob("loops/*.h"))
    return Extension(
        name,
        [source],
        depends=[header.as_posix() for header in headers],
        extra_compile_args=MICROSOFT if sys.platform == "win32" else OTHERS,
        py_limited_api=True,
        optional=True,
    )


def readme() -> str:
    """Return README.md for PyPI, where links into the repository need its address, if it is given."""
    text = Path("README.md").read_text("utf-8")
    settings = tomllib.loads(Path("pyproject.toml").read_text("utf-8"))
    url = settings["project"]["urls"].get("Repository")
    [version] = re.findall(
        r'^__version__ = "(.+)"', Path("src/skinbake/version.py").read_text("utf-8"), re.MULTILINE
    )
    links = r"(!?)(\[[^\]]*\]\()(?!https?://|#)([^)]+\))"
    whole = rf"\g<1>\g<2>{url}/KIND/v{version}/\g<3>"
    shown = re.sub(
        links, lambda found: found.expand(whole).replace("KIND", "raw" if found[1] else "blob"), text
    )
    return shown if url else text


class WithEngines(build_py):
    """Put the JavaScript of engines/ into the package. An editable install reads it where it is."""

    def run(self) -> None:
        """Build as usual, then copy the files."""
        super().run()
        if self.editable_mode:
            return
        for source in sorted(Path("engines").glob("*/*.js")):
            target = Path(self.build_lib, "skinbake", source)
            self.mkpath(str(target.parent))
            self.copy_file(str(source), str(target))


if __name__ == "__main__":  # release/ imports the flags
    compiled = {
        "ext_modules": [
            loops("skinbake.gradients._kernel", "src/skinbake/gradients/_kernel.c"),
            loops("skinbake.truth._loops", "src/skinbake/truth/_loops.c"),
        ],
        "options": {"bdist_wheel": {"py_limited_api": "cp311"}},
    }
    pure = os.environ.get("SKINBAKE_PURE") == "1"
    described = {"long_description": readme(), "long_description_content_type": "text/markdown"}
    setup(cmdclass={"build_py": WithEngines}, **described, **({} if pure else compiled))
