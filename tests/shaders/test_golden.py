"""A change of a text shows as a difference of files: ``python -m tests.shaders.write_golden`` writes them."""

from __future__ import annotations

import pytest

from tests.shaders.write_golden import FOLDER, golden_files


def test_no_file_is_missing_or_left_over() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(golden_files())


@pytest.mark.parametrize("name", golden_files())
def test_the_text_is_the_file(name: str) -> None:
    text = (FOLDER / name).read_bytes().decode("ascii")
    assert golden_files()[name].splitlines() == text.splitlines()
    assert golden_files()[name] == text
