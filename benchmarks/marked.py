"""The part of a page between two marks, which a script writes."""

from __future__ import annotations

from pathlib import Path


def write_between(page: Path, start: str, end: str, text: str) -> None:
    """Replace the lines between two marks of a page. Raises ValueError if the page lacks a mark."""
    before, rest = page.read_text(encoding="utf-8").split(start)
    _, after = rest.split(end)
    page.write_text(f"{before}{start}\n{text}\n{end}{after}", encoding="utf-8")
