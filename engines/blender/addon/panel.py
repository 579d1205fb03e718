"""The part of the glTF exporter's dialog that belongs to skinbake."""

from __future__ import annotations

import textwrap
from typing import Any

from .options import CHOICES, WITH_CORRECTIVES

CHARACTERS = 56
"""The width of the dialog's sidebar. Blender cuts off what is longer."""

ICONS = {"INFO": "INFO", "WARNING": "ERROR", "ERROR": "CANCEL"}
"""Blender's names: its icon ERROR is the triangle of a warning."""


def draw(context: Any, layout: Any) -> None:
    """Draw the options, and below them the outcome of the last export."""
    settings, outcome = context.scene.skinbake, context.window_manager.skinbake
    header, body = layout.panel("SKINBAKE_export", default_closed=False)
    header.use_property_split = False
    header.prop(settings, "enabled", text="")
    header.label(text="Correct lighting (skinbake)")
    if body is None:
        return
    read = {*WITH_CORRECTIVES, "measure"}
    for name in (*CHOICES, "crease_angle", "measure"):
        option = body.column()
        option.active = settings.enabled and (settings.correctives == "none" or name in read)
        option.prop(settings, name)
    for line in outcome.lines:
        _draw_line(body.column(align=True), line.level, line.text)


def _draw_line(column: Any, level: str, text: str) -> None:
    first, *others = textwrap.wrap(text, CHARACTERS) or [""]
    column.label(text=first, icon=ICONS[level])
    for other in others:
        column.label(text=other, icon="BLANK1")
