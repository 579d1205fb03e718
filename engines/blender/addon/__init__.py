"""Bake skin-weight gradients into the files that Blender's glTF exporter writes."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import FrameType
from typing import Any

import bpy
import io_scene_gltf2

from . import panel, settings
from .baking import Line, Outcome, bake_export

GLTFPACK = Line(
    "WARNING", "the copy in the folder gltfpacked is not baked: gltfpack drops the attributes of a bake"
)


class glTF2ExportUserExtension:  # noqa: N801  # the exporter looks for this name
    """The hooks of Blender's glTF exporter, which makes one object for each export."""

    def pre_export_hook(self, export_settings: Mapping[str, Any]) -> None:
        """Forget the outcome of the export before. This one may have the bake off, or fail."""
        bpy.context.window_manager.skinbake.forget()

    def post_export_hook(self, export_settings: Mapping[str, Any]) -> None:
        """Bake the file, which the exporter has written and closed."""
        wanted = bpy.context.scene.skinbake
        if not wanted.enabled:
            return
        outcome = bake_export(export_settings["gltf_filepath"], wanted.options(), measure=wanted.measure)
        bpy.context.window_manager.skinbake.show(outcome)
        _report(outcome, GLTFPACK if export_settings.get("gltf_use_gltfpack") else None)


def _report(outcome: Outcome, further: Line | None) -> None:
    """Report as the exporter: to the Info editor, the status bar, and the terminal of a script.

    A line of level ERROR raises RuntimeError in a script that called the exporter.
    """
    exporter = _running_operator()
    for line in (*outcome.lines, *([further] if further else [])):
        if exporter is None:
            print(f"skinbake: {line.level}: {line.text}")  # noqa: T201  # nothing else is left to tell it
        else:
            exporter.report({line.level}, f"skinbake: {line.text}")


def _running_operator() -> Any:
    """Return the operator that exports, or None. The exporter does not pass it to its hooks."""
    frame: FrameType | None = sys._getframe()
    while frame is not None:
        if isinstance(found := frame.f_locals.get("self"), bpy.types.Operator):
            return found
        frame = frame.f_back
    return None


def register() -> None:
    """Add the options and the panel."""
    settings.register()
    io_scene_gltf2.exporter_extension_layout_draw["skinbake"] = panel.draw


def unregister() -> None:
    """Take away what ``register`` added."""
    io_scene_gltf2.exporter_extension_layout_draw.pop("skinbake", None)
    settings.unregister()
