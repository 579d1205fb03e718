from __future__ import annotations

import subprocess
import sys


def test_verify_imports_without_its_heavy_libraries() -> None:
    program = (
        "import sys, skinbake.verify.operator, skinbake.verify.reference, skinbake.verify.metrics\n"
        "print(*{'igl', 'scipy', 'pygltflib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "\n", "")
