"""The compiled loops, which pyproject.toml cannot describe: their flags differ by compiler.

Without a compiler the package installs all the same, and `bake` runs on numpy alone.
"""

import sys

from setuptools import Extension, setup

# No fast-math and no fused multiply-adds: the same input gives the same bytes on every machine. The last two
# switches let compilers use vectors and change no result, since the loops ask for neither errno nor traps.
MICROSOFT = ["/O2", "/fp:precise"]
OTHERS = ["-O3", "-std=c11", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi"]

setup(
    ext_modules=[
        Extension(
            "skinbake.gradients._kernel",
            ["src/skinbake/gradients/_kernel.c"],
            extra_compile_args=MICROSOFT if sys.platform == "win32" else OTHERS,
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
