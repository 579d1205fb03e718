"""The tests that finds name are there."""

from __future__ import annotations

import re
from pathlib import Path

from fuzz.mended import MENDED, mended

REPOSITORY = Path(__file__).resolve().parents[2]


def test_each_find_names_a_test_that_is_there() -> None:
    named = [path for words in MENDED.values() for path in re.findall(r"tests/\S+\.py", words)]
    assert len(named) >= 10
    assert all((REPOSITORY / path).is_file() for path in named)


def test_a_find_is_known_by_how_its_name_begins() -> None:
    assert "padding" in mended("twice-other-bytes-in-accessors-bufferViews-buffers-meshes-2dad2b93")
    assert mended("crash-strip-exit-70-12345678") == ""
