"""The index of the pages of several files: which passed, and how much each gains."""

from __future__ import annotations

import base64
import html
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath

from skinbake.errors import printable
from skinbake.version import __version__
from skinbake.view.sources import filled_index
from skinbake.wording import counted, gain_in_words

UNSAFE = re.compile("[^A-Za-z0-9._-]+")
"""The characters of a file's name that its page's name does not have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Listed:
    """One file of the index: its name, the link to its page and a small PNG (None: it has none), its figures.

    standard and accurate are mean errors in degrees by triangles, gain is their ratio; None if they were not
    measured. outcome is passed, failed, or not baked. remark says why a file failed, or why it has no
    figures.
    """

    name: str
    link: str | None
    picture: bytes | None = None
    outcome: str
    remark: str = ""
    standard: float | None = None
    accurate: float | None = None
    gain: float | None = None


def pages(target: str, inputs: Sequence[str]) -> list[Path]:
    """Return the paths of the pages of several inputs: in a folder beside their index, ``target``."""
    real = Path(os.path.realpath(target))
    folder = real.with_suffix("")
    if folder.suffix or folder == real:
        folder = folder.with_name(f"{folder.name}-pages")
    names = (UNSAFE.sub("_", PurePath(source).stem)[:80] for source in inputs)
    return [folder / f"{number:04}-{name}.html" for number, name in enumerate(names, 1)]


def index(files: Sequence[Listed], limits: str) -> bytes:
    """Return the index as UTF-8: files that failed first, then by gain, the smallest first.

    limits is a sentence on the limits.
    """
    outcomes = Counter(one.outcome for one in files)
    parts = [f"{outcomes[word]:,} {word}" for word in ("not baked", "failed") if outcomes[word]]
    summary = ", ".join([counted(len(files), "file"), *(parts or ["all passed"])])
    values = {
        "version": html.escape(__version__),
        "summary": summary,
        "limits": html.escape(limits),
        "rows": "\n".join(map(_row, sorted(files, key=_order))),
    }
    return filled_index(values).encode("utf-8", "backslashreplace")


def _order(one: Listed) -> tuple[bool, float, str]:
    """Order files that failed first. Without a gain, a file that failed comes first, and others come last."""
    has_failed = one.outcome == "failed"
    without = 0.0 if has_failed else math.inf
    return not has_failed, without if one.gain is None else one.gain, one.name


def _row(one: Listed) -> str:
    name = html.escape(printable(one.name))
    words = f'{_picture(one.picture)}<span class="name">{name}</span>'
    shown = words if one.link is None else f'<a href="{html.escape(one.link)}">{words}</a>'
    style = one.outcome.replace(" ", "-")
    remark = f" {html.escape(printable(one.remark))}" if one.remark else ""
    cells = [
        f'<td class="file">{shown}</td>',
        f'<td data-value="{one.outcome}"><span class="{style}">{one.outcome}</span>{remark}</td>',
        _number("Standard", one.standard, "{:.2f}°".format),
        _number("Accurate", one.accurate, "{:.2f}°".format),
        _number("Gain", one.gain, lambda gain: f"{gain_in_words(gain)}×"),
    ]
    return f"<tr>{''.join(cells)}</tr>"


def _picture(png: bytes | None) -> str:
    """Return a picture, or the empty place of one. It says no more than the name beside it."""
    if png is None:
        return '<span class="picture"></span>'
    data = base64.b64encode(png).decode()
    return f'<img class="picture" src="data:image/png;base64,{data}" width="96" height="72" alt="">'


def _number(label: str, value: float | None, shown: Callable[[float], str]) -> str:
    text = "—" if value is None else shown(value)
    key = -1.0 if value is None else value
    return f'<td class="number" data-label="{label}" data-value="{key!r}">{text}</td>'
