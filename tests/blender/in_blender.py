"""Runs in Blender: installs the zip, exports characters in many ways, and writes down what happened.

``python in_blender.py ZIP FOLDER [MODEL ...]``, with a Python that has the module bpy. FOLDER receives
``results.json``, the exported files, and the normals that Blender itself evaluates.
"""

from __future__ import annotations

import json
import math
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

MODULE = "bl_ext.user_default.skinbake"
FPS = 24
Results = dict[str, Any]


def install(zip_file: Path) -> Results:
    """Install and enable the add-on as a user does, and return where it and skinbake have come from."""
    bpy.ops.extensions.package_install_files(
        filepath=str(zip_file), repo="user_default", enable_on_install=True
    )
    import skinbake

    validated = subprocess.run(
        [sys.executable, *_blenders_tool(), "validate", str(zip_file)],
        capture_output=True,
        text=True,
        check=False,
    )
    return {
        "valid": validated.returncode,
        "validation": validated.stdout + validated.stderr,
        "blender": bpy.app.version_string,
        "numpy": np.__version__,
        "enabled": MODULE in bpy.context.preferences.addons,
        "skinbake": skinbake.__file__,
        "addon": sys.modules[MODULE].__file__,
    }


def _blenders_tool() -> list[str]:
    """Return Blender's own program for the zips of extensions."""
    import bl_pkg

    return [str(Path(bl_pkg.__file__).parent / "cli" / "blender_ext.py")]


def clear() -> None:
    """Remove all objects, and set the options of the add-on back."""
    for kind in ("objects", "meshes", "armatures", "actions", "materials", "images"):
        bpy.data.batch_remove(list(getattr(bpy.data, kind)))
    if hasattr(bpy.types.Scene, "skinbake"):
        for name in list(bpy.context.scene.skinbake.keys()):
            bpy.context.scene.skinbake.property_unset(name)


def export(path: Path, enabled: bool = True, settings: Results | None = None, **options: Any) -> Results:
    """Export the scene. Return the outcome that the panel shows, and the error that a script gets."""
    kept = bpy.context.scene.skinbake
    kept.enabled = enabled
    for name, value in (settings or {}).items():
        setattr(kept, name, value)
    raised = None
    try:
        bpy.ops.export_scene.gltf(filepath=str(path), **options)
    except RuntimeError as error:
        raised = str(error)
    for name in settings or {}:
        kept.property_unset(name)
    shown = bpy.context.window_manager.skinbake
    lines = [[line.level, line.text] for line in shown.lines]
    return {
        "path": shown.path,
        "status": shown.status,
        "gain": shown.gain,
        "lines": lines,
        "raised": raised,
        "panel": panel(),
    }


def bent_arm() -> None:
    """Make an arm of three bones in Blender's own way, which bends and twists from frame 0 to frame 10."""
    armature = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    arm = bpy.data.objects.new("arm", _tube(around=48, along=96, radius=0.3, length=3.0))
    for thing in (armature, arm):
        bpy.context.scene.collection.objects.link(thing)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for i in range(3):
        bone = armature.data.edit_bones.new(f"bone{i}")
        bone.head, bone.tail = (0, 0, i), (0, 0, i + 1)
        bone.parent = armature.data.edit_bones[i - 1] if i else None
    bpy.ops.object.mode_set(mode="OBJECT")
    _weigh(arm)
    arm.parent = armature
    arm.modifiers.new("armature", "ARMATURE").object = armature
    for i, turn in ((1, (0.9, 0.0, 0.3)), (2, (0.2, 0.6, -0.8))):
        bone = armature.pose.bones[f"bone{i}"]
        bone.rotation_mode = "XYZ"
        for frame, share in ((0, 0.0), (10, 1.0)):
            bone.rotation_euler = [share * angle for angle in turn]
            bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 0, 10


def _tube(around: int, along: int, radius: float, length: float) -> Any:
    """Return a smooth open tube along z, of triangles, thinner at some places than at others."""
    angles = 2 * np.pi * np.arange(around) / around
    heights = np.linspace(0, length, along)
    radii = radius * (1 + 0.1 * np.cos(3 * angles + 2 * heights[:, None]))
    points = np.stack(
        [radii * np.cos(angles), radii * np.sin(angles), np.broadcast_to(heights[:, None], radii.shape)], -1
    )
    grid = np.arange(around * along).reshape(along, around)
    beside = np.roll(grid, -1, axis=1)
    corners = grid[:-1], beside[:-1], beside[1:], grid[1:]
    triangles = np.stack([corners[i] for i in (0, 1, 2, 0, 2, 3)], -1).reshape(-1, 3)
    mesh = bpy.data.meshes.new("arm")
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], triangles.tolist())
    mesh.shade_smooth()
    return mesh


def _weigh(arm: Any) -> None:
    """Let one bone take over from the other along z, within half a unit."""
    heights = np.array([vertex.co.z for vertex in arm.data.vertices])
    second, third = (1 / (1 + np.exp(-(heights - border) / 0.12)) for border in (1.0, 2.0))
    for i, weights in enumerate((1 - second, second - third, third)):
        group = arm.vertex_groups.new(name=f"bone{i}")
        for vertex, weight in enumerate(weights.tolist()):
            group.add([vertex], max(weight, 0.0), "REPLACE")


def evaluated_normals(path: Path, frame: int) -> None:
    """Write the corners of the skinned mesh as Blender evaluates them: at rest, and at a frame.

    Positions and normals (corners, 3) are those of the scene in the axes of glTF.
    """
    [armature] = [thing for thing in bpy.context.scene.objects if thing.type == "ARMATURE"]
    [skinned] = [thing for thing in bpy.context.scene.objects if thing.find_armature() is not None]
    bpy.context.scene.frame_set(frame)
    arrays = {}
    for pose, kind in (("rest", "REST"), ("posed", "POSE")):
        armature.data.pose_position = kind
        bpy.context.view_layer.update()
        arrays[f"{pose}_positions"], arrays[f"{pose}_normals"] = _corners(skinned)
    np.savez(path, **arrays, time=frame / FPS)


def _corners(thing: Any) -> tuple[Any, Any]:
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    vertices, count = np.empty(3 * len(mesh.vertices)), len(mesh.loops)
    normals, indices = np.empty(3 * count), np.empty(count, int)
    mesh.vertices.foreach_get("co", vertices)
    mesh.corner_normals.foreach_get("vector", normals)
    mesh.loops.foreach_get("vertex_index", indices)
    evaluated.to_mesh_clear()
    world = np.array(evaluated.matrix_world)
    y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    positions = vertices.reshape(-1, 3)[indices] @ world[:3, :3].T + world[:3, 3]
    return positions @ y_up.T, normals.reshape(-1, 3) @ np.linalg.inv(world[:3, :3]) @ y_up.T


class Recorder:
    """Stands in for a layout of Blender's dialogs, which draw nothing without a window.

    It checks every property and icon against Blender's own lists.
    """

    ICONS = frozenset(bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys())

    def __init__(self, drawn: list[list[str]]) -> None:
        self.drawn = drawn
        self.active, self.use_property_split = True, True

    def panel(self, name: str, default_closed: bool) -> tuple[Recorder, Recorder]:
        """Open a panel."""
        return Recorder(self.drawn), Recorder(self.drawn)

    def column(self, align: bool = False) -> Recorder:
        """Begin a column."""
        return Recorder(self.drawn)

    def prop(self, data: Any, name: str, text: str | None = None) -> None:
        """Draw a property."""
        self.drawn.append(["prop", data.bl_rna.properties[name].name])

    def label(self, text: str, icon: str = "NONE") -> None:
        """Draw a text."""
        if icon not in self.ICONS:
            raise ValueError(icon)
        self.drawn.append([icon, text])


def panel() -> list[list[str]]:
    """Return what the exporter's dialog shows of the add-on."""
    import io_scene_gltf2

    drawn: list[list[str]] = []
    io_scene_gltf2.exporter_extension_layout_draw["skinbake"](bpy.context, Recorder(drawn))
    return drawn


def choices(folder: Path) -> Results:
    """Export with every option away from its default, and with Draco."""
    others = {
        "gradients": "surface",
        "frame": "normal",
        "encoding": "packed8",
        "layout": "custom",
        "neighbours": "drop",
        "weld": "skin",
        "limit_influences": "4",
        "crease_angle": math.radians(40),
        "measure": False,
    }
    return {
        "usual": export(folder / "usual.glb"),
        "correctives": export(
            folder / "correctives.glb",
            settings={"correctives": "auto", "neighbours": "drop", "layout": "custom"},
        ),
        "others": export(folder / "others.glb", settings=others),
        "separate": export(folder / "separate.gltf", export_format="GLTF_SEPARATE"),
        "draco": export(folder / "draco.glb", export_draco_mesh_compression_enable=True),
    }


def failures(folder: Path) -> Results:
    """Export where the bake cannot succeed, each time beside a plain export with the same options."""
    import skinbake

    found: Results = {}

    def attempt(name: str, around: Callable[[Callable[[], None]], None], **options: Any) -> None:
        found[f"{name}-plain"] = export(folder / f"{name}-plain.glb", enabled=False, **options)

        def run() -> None:
            found[name] = export(folder / f"{name}.glb", **options)

        around(run)

    def disk_full(run: Callable[[], None]) -> None:
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        plain = (folder / "disk_full-plain.glb").stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (plain + 1000, limits[1]))
        try:
            run()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    def without_skinbake(run: Callable[[], None]) -> None:
        sys.modules["skinbake"] = None  # type: ignore[assignment]  # as Python marks a module that is not to be found
        try:
            run()
        finally:
            sys.modules["skinbake"] = skinbake

    def defect(run: Callable[[], None]) -> None:
        usual, skinbake.bake = skinbake.bake, lambda *paths, **options: 1 / 0  # type: ignore[assignment]  # it returns nothing
        try:
            run()
        finally:
            skinbake.bake = usual

    def directly(run: Callable[[], None]) -> None:
        run()

    attempt("disk_full", disk_full)
    attempt("without_skinbake", without_skinbake)
    attempt("defect", defect)
    attempt("no_normals", directly, export_normals=False)
    attempt("no_skins", directly, export_skins=False)
    return found


def disable(folder: Path) -> Results:
    """Disable the add-on, and export once more."""
    import io_scene_gltf2

    bpy.ops.preferences.addon_disable(module=MODULE)
    bpy.ops.export_scene.gltf(filepath=str(folder / "disabled.glb"))
    return {
        "properties": hasattr(bpy.types.Scene, "skinbake") or hasattr(bpy.types.WindowManager, "skinbake"),
        "panel": "skinbake" in io_scene_gltf2.exporter_extension_layout_draw,
    }


def main(zip_file: Path, folder: Path, models: list[Path]) -> None:
    """Run everything in an order that leaves the add-on disabled at the end."""
    results: Results = {"install": install(zip_file), "characters": {}, "panel": panel()}
    bpy.context.scene.render.fps = FPS
    for model in models:
        clear()
        bpy.ops.import_scene.gltf(filepath=str(model))
        results["characters"][model.stem] = export(folder / f"{model.stem}.glb")
        evaluated_normals(folder / f"{model.stem}.npz", frame=FPS // 2)
    clear()
    bent_arm()
    results["characters"]["arm"] = export(folder / "arm.glb")
    evaluated_normals(folder / "arm.npz", frame=10)
    results["choices"] = choices(folder)
    results["failures"] = failures(folder)
    results["disabled"] = disable(folder)
    (folder / "results.json").write_text(json.dumps(results))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [Path(model) for model in sys.argv[3:]])
