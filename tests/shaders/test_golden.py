"""A change of a text shows as a difference of files: ``python -m tests.shaders.write_golden`` writes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.shaders.write_golden import FOLDER, golden_files


def test_no_file_is_left_over() -> None:
    assert set(FOLDER.iterdir()) <= set(golden_files())


@pytest.mark.parametrize("path", golden_files(), ids=lambda path: f"{path.parent.name}/{path.name}")
def test_the_text_is_the_file(path: Path) -> None:
    text = path.read_bytes().decode("ascii")
    assert golden_files()[path].splitlines() == text.splitlines()
    assert golden_files()[path] == text
