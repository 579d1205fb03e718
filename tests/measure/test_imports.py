from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.baked_files import baked, source


@pytest.mark.slow
def test_verify_imports_without_its_heavy_libraries() -> None:
    program = (
        "import sys, skinbake.truth.operator, skinbake.truth.truths, skinbake.truth.areas\n"
        "print(*{'igl', 'scipy', 'pygltflib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "\n", "")


@pytest.mark.slow
def test_verify_runs_without_what_takes_longer_to_import_than_a_file_to_verify(tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from skinbake.measure.options import VerifyOptions\n"
        "from skinbake.commands.verify import verify_file\n"
        "assert verify_file(sys.argv[1], VerifyOptions()).passed\n"
        "from skinbake.truth import kernel\n"
        "heavy = {'scipy.spatial', 'scipy.sparse.csgraph'}\n"
        "heavy = {'scipy', 'igl', 'skinbake.gradients.fit'} if kernel.IS_COMPILED else heavy\n"
        "unneeded = {'xml.etree', 'skinbake.format.strip'}\n"
        "print(*(heavy | unneeded) & set(sys.modules))"
    )
    path = baked(source("bent_tube.glb"), tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr
