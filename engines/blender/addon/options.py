"""The options of ``skinbake bake`` in the panel: their declarations, and Blender's words for them."""

from __future__ import annotations

NO_SKINBAKE = (
    "this Blender has no skinbake ({reason}). Install the zip that holds it, "
    "or install it with pip into Blender's Python"
)

try:
    from skinbake.options import BAKE  # it imports no numpy
except ImportError as missing:
    raise ImportError(NO_SKINBAKE.format(reason=missing)) from missing

DECLARED = {option.name: option for option in BAKE}
"""Defaults and ranges."""

Item = tuple[str, str, str, int]
"""A value, its label, its description, and its number. Scenes save the number, so it keeps its meaning."""

CHOICES: dict[str, tuple[str, tuple[Item, ...]]] = {
    "correctives": (
        "Correctives",
        (
            ("none", "None", "Bake α and β, for engines that have the shader of skinbake", 0),
            (
                "auto",
                "Automatic",
                "For Unity, Unreal and other engines without that shader: up to 4 morph targets of normals, "
                "which the exported animations play",
                -1,
            ),
            *(
                (str(count), str(count), f"At most {count} such morph targets", count)
                for count in (1, 2, 4, 8)
            ),
        ),
    ),
    "gradients": (
        "Gradients",
        (
            (
                "fitted",
                "Fitted",
                "Fitted to the exported animations and to turns of the bones: lights coarse meshes better",
                0,
            ),
            ("surface", "Of the surface", "The gradients of the weights on the surface, as in the paper", 1),
        ),
    ),
    "frame": (
        "Tangent frame",
        (
            ("auto", "Automatic", "From tangents if the export has good ones, else from normals", 0),
            ("tangent", "Tangents", "From tangents: needs Data > Mesh > Tangents in the exporter", 1),
            ("normal", "Normals", "From normals alone", 2),
        ),
    ),
    "encoding": (
        "Encoding",
        (
            ("float32", "32-bit floats", "24 bytes for each vertex of four influences", 0),
            ("snorm16", "16-bit integers", "16 bytes for each vertex of four influences", 1),
            ("packed8", "8-bit integers", "8 bytes for each vertex of four influences", 2),
        ),
    ),
    "layout": (
        "Layout",
        (
            ("attributes", "Own attributes", "_SKINBAKE_ALPHA_0 and _SKINBAKE_BETA_0", 0),
            ("texcoord", "UV sets", "Free texture coordinate sets: for engines that pass nothing else", 1),
            ("custom", "Custom (Godot)", "_CUSTOM0 and _CUSTOM1: for Godot", 2),
        ),
    ),
    "neighbours": (
        "Bones of neighbours",
        (
            ("adopt", "Adopt", "A vertex takes them into free slots, with weights too small to see", 0),
            (
                "extend",
                "Extend",
                "Adopt, and add a set of four influences to meshes with too few free slots",
                1,
            ),
            ("drop", "Leave out", "Weights and joints stay as they were exported", 2),
        ),
    ),
    "weld": (
        "Weld",
        (
            ("mesh", "Each mesh", "Each mesh is a surface of its own", 0),
            ("skin", "Meshes of an armature", "For characters that are cut into several meshes", 1),
        ),
    ),
    "limit_influences": (
        "Influences",
        (
            ("0", "As exported", "As many for each vertex as the exporter writes", 0),
            ("4", "At most 4", "The four largest of each vertex. Says what that costs", 1),
            ("8", "At most 8", "The eight largest of each vertex. Says what that costs", 2),
        ),
    ),
}
"""By name: the label, and the values. Where the declared default is none, it is the first."""

WITH_CORRECTIVES = "correctives", "frame", "encoding"
"""The options that a bake of correctives reads."""

CREASE_LABEL = "Crease angle"
"""The name of the crease angle, which is a number."""
