"""A change of a text shows as a difference of files: ``python -m tests.shaders.write_golden`` writes them."""

from __future__ import annotations

from tests.shaders.write_golden import FOLDER, golden_files


def test_the_texts_are_the_files_and_no_file_is_left_over() -> None:
    files = golden_files()
    for path, wanted in files.items():
        text = path.read_bytes().decode("ascii")
        assert wanted.splitlines() == text.splitlines(), path
        assert wanted == text, path
    assert set(FOLDER.iterdir()) <= set(files)
