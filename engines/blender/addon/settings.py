"""The options of the panel, which a scene keeps, and the outcome of the last export."""

import math
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, PointerProperty, StringProperty

from .baking import Outcome
from .options import CHOICES, CREASE_LABEL, DECLARED, WITH_CORRECTIVES


def _choice(name: str) -> Any:
    label, items = CHOICES[name]
    return EnumProperty(name=label, items=items, default=str(DECLARED[name].default or items[0][0]))


class BakeSettings(bpy.types.PropertyGroup):
    """The options of the bake: ``scene.skinbake``."""

    enabled: BoolProperty(
        name="Bake on export",
        description="Add skin-weight gradients to the exported file, for correct lighting where joints bend",
        default=True,
    )
    measure: BoolProperty(
        name="Measure the gain",
        description="Verify the baked file, and measure its lighting over its animations",
        default=True,
    )
    correctives: _choice("correctives")
    gradients: _choice("gradients")
    frame: _choice("frame")
    encoding: _choice("encoding")
    layout: _choice("layout")
    neighbours: _choice("neighbours")
    weld: _choice("weld")
    crease_angle: FloatProperty(
        name=CREASE_LABEL,
        description="A larger angle between normals is a hard edge",
        subtype="ANGLE",
        min=math.radians(DECLARED["crease_angle"].values.least),
        max=math.radians(DECLARED["crease_angle"].values.most),
        default=math.radians(DECLARED["crease_angle"].default),
    )
    limit_influences: _choice("limit_influences")

    def options(self) -> dict[str, Any]:
        """Return the options as the Python API takes them."""
        chosen: dict[str, Any] = {name: getattr(self, name) for name in CHOICES}
        chosen["crease_angle"] = round(math.degrees(self.crease_angle), 4)
        chosen["limit_influences"] = int(self.limit_influences) or None
        if self.correctives == "none":
            return chosen | {"correctives": None}
        if self.correctives != "auto":
            chosen["correctives"] = int(self.correctives)
        return {name: chosen[name] for name in WITH_CORRECTIVES}


class BakeLine(bpy.types.PropertyGroup):
    """A sentence about the last export."""

    level: StringProperty()
    text: StringProperty()


class BakeOutcome(bpy.types.PropertyGroup):
    """The outcome of the last export: ``window_manager.skinbake``. It is not saved.

    status is ``baked``, ``unchanged`` or ``failed``. It is empty before the first export, and after one that
    was not baked because the box was off or the exporter failed. A gain of 0 was not measured, or nothing
    bends.
    """

    path: StringProperty()
    status: StringProperty()
    gain: FloatProperty()
    lines: bpy.props.CollectionProperty(type=BakeLine)

    def show(self, outcome: Outcome) -> None:
        """Keep an outcome for the panel and for scripts."""
        self.path, self.status, self.gain = outcome.path, outcome.status, outcome.gain or 0.0
        self.lines.clear()
        for line in outcome.lines:
            kept = self.lines.add()
            kept.level, kept.text = line.level, line.text

    def forget(self) -> None:
        """Go back to the state before the first export."""
        self.path, self.status, self.gain = "", "", 0.0
        self.lines.clear()


CLASSES = (BakeSettings, BakeLine, BakeOutcome)


def register() -> None:
    """Give scenes the options, and the window manager the outcome."""
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.skinbake = PointerProperty(type=BakeSettings)
    bpy.types.WindowManager.skinbake = PointerProperty(type=BakeOutcome)


def unregister() -> None:
    """Take both away."""
    del bpy.types.WindowManager.skinbake
    del bpy.types.Scene.skinbake
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
