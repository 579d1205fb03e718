"""The sheet of several files: a picture of each by both lightings, and how much each gains."""

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
    """One file of the sheet: its name, the link to its page (None: it has none), its pictures and figures.

    pictures are PNGs of the whole figure and of its best place, each by standard lighting and by the bake's,
    or none. standard and accurate are mean errors in degrees by triangles, gain is their ratio; None if they
    were not measured. outcome is passed, failed, or not baked. remark says why a file failed, or why it has
    no figures. verdict and step conclude. byte_length is that of α and β.
    """

    name: str
    link: str | None
    pictures: Sequence[bytes] = ()
    outcome: str
    remark: str = ""
    verdict: str = ""
    step: str = ""
    standard: float | None = None
    accurate: float | None = None
    gain: float | None = None
    byte_length: int | None = None


def pages(target: str, inputs: Sequence[str]) -> list[Path]:
    """Return the paths of the pages of several inputs: in a folder beside their index, ``target``."""
    real = Path(os.path.realpath(target))
    folder = real.with_suffix("")
    if folder.suffix or folder == real:
        folder = folder.with_name(f"{folder.name}-pages")
    names = (UNSAFE.sub("_", PurePath(source).stem)[:80] for source in inputs)
    return [folder / f"{number:04}-{name}.html" for number, name in enumerate(names, 1)]


def sheet(files: Sequence[Listed], limits: str, command: str) -> bytes:
    """Return the sheet as UTF-8: files that failed first, then by gain, the largest first.

    limits is a sentence on the limits, command the one that writes the sheet.
    """
    outcomes = Counter(one.outcome for one in files)
    parts = [f"{outcomes[word]:,} {word}" for word in ("not baked", "failed") if outcomes[word]]
    summary = ", ".join([counted(len(files), "file"), *(parts or ["all passed"])])
    values = {
        "version": html.escape(__version__),
        "command": command,
        "summary": summary,
        "limits": html.escape(limits),
        "rows": "\n".join(map(_row, sorted(files, key=_order))),
    }
    return filled_index(values).encode("utf-8", "backslashreplace")


def _order(one: Listed) -> tuple[bool, float, str]:
    """Order files that failed first. Files without a gain come last."""
    return one.outcome != "failed", math.inf if one.gain is None else -one.gain, one.name


def _row(one: Listed) -> str:
    name, figures = html.escape(printable(one.name)), (one.standard, one.accurate)
    words = f'{_pictures(one)}<span class="name">{name}</span>'
    shown = words if one.link is None else f'<a href="{html.escape(one.link)}">{words}</a>'
    told = one.verdict or one.outcome
    lines = [(one.outcome if one.outcome == "failed" else told.replace(" ", "-"), told.capitalize())]
    remarks = [one.outcome if one.verdict else "", one.remark, f"Next: {one.step}." if one.step else ""]
    lines += [("quiet", remark) for remark in remarks if remark]
    said = "<br>".join(
        f'<span class="{html.escape(kind)}">{html.escape(printable(line))}</span>' for kind, line in lines
    )
    cells = [
        f'<td class="file">{shown}</td>',
        f'<td class="told" data-value="{one.outcome}">{said}</td>',
        *(
            _number(label, value, "{:.2f}°".format)
            for label, value in zip(("Standard", "Accurate"), figures, strict=True)
        ),
        _number("Gain", one.gain, lambda gain: f"{gain_in_words(gain)}×"),
        _number("Bytes", one.byte_length, lambda size: f"{size / 1000:,.1f} kB"),
    ]
    return f"<tr>{''.join(cells)}</tr>"


def _pictures(one: Listed) -> str:
    """Return pictures by standard lighting and by the bake's in turns. They say no more than the figures."""
    found = ""
    for number, png in enumerate(one.pictures):
        data, side = base64.b64encode(png).decode(), ("standard", "accurate")[number % 2]
        image = f'<img class="picture" src="data:image/png;base64,{data}" width="176" height="176" alt="">'
        found += f'<span class="quiet">{image}{side}</span>'
    return f'<span class="pictures">{found}</span>'


def _number(label: str, value: float | None, shown: Callable[[float], str]) -> str:
    text = "—" if value is None else shown(value)
    key = -1.0 if value is None else value
    return f'<td class="number" data-label="{label}" data-value="{key!r}">{text}</td>'
