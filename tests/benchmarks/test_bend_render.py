"""The figures of the rendered bend are those of the replay, and those that the page quotes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.bend_picture import strongest_bend
from tests.support.webgpu import NAGA

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]
TIMEOUT_SECONDS = 300
_FIGURES = re.compile(r"(\w+): mean ([\d.]+)°, p95 ([\d.]+)°, max ([\d.]+)°")


@pytest.fixture(scope="module")
def printed() -> dict[str, list[float]]:
    """Mean, p95 and max in degrees of each lighting, as the script prints them: in a process of its own."""
    driver = str(NAGA.require())
    process = subprocess.run(
        [sys.executable, "-m", "benchmarks.bend_render", "--figures"],
        env={
            **os.environ,
            "VK_DRIVER_FILES": driver,
            "VK_ICD_FILENAMES": driver,
            "PYTHONIOENCODING": "utf-8",
        },
        cwd=REPOSITORY,
        capture_output=True,
        encoding="utf-8",
        timeout=TIMEOUT_SECONDS,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return _figures(process.stdout)


def test_the_shaders_have_the_errors_of_the_replay(printed: dict[str, list[float]]) -> None:
    expected = dict(zip(("standard", "accurate"), strongest_bend().summaries, strict=True))
    assert printed.keys() == expected.keys()
    for lighting, summary in expected.items():
        # Printed to two digits, of float32; the worst vertex lies in a fold, where normals are least certain.
        assert printed[lighting][:2] == pytest.approx([summary.mean, summary.p95], abs=0.006)
        assert printed[lighting][2] == pytest.approx(summary.max, abs=0.05)


def test_the_page_quotes_them(printed: dict[str, list[float]]) -> None:
    text = " ".join((REPOSITORY / "docs" / "shaders.md").read_text(encoding="utf-8").split())
    quoted = re.search(r"is ([\d.]+)° with standard lighting and ([\d.]+)° with accurate", text)
    assert quoted
    for figure, lighting in zip(quoted.groups(), ("standard", "accurate"), strict=True):
        assert float(figure) == pytest.approx(printed[lighting][0], abs=0.006)


def _figures(text: str) -> dict[str, list[float]]:
    return {found[1]: [float(figure) for figure in found.groups()[1:]] for found in _FIGURES.finditer(text)}
