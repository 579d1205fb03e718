"""Runs in Blender: poses three bones in many ways, and writes down where *Preserve Volume* takes points.

``python preserve_volume.py FILE``, with a Python that has the module bpy. FILE receives an object by the kind
of scales of the bones: points at rest, their weights, the joint matrices and the points in the pose.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

TURNS = [(0.3, 0.2, -0.4), (0.9, -0.3, 0.5), (-0.6, 0.8, 0.2)]
SCALES = [(1.4, 0.8, 1.1), (0.7, 1.2, 1.3), (1.1, 1.5, 0.6)]
KINDS = ("none", "uniform", "along its axes", "mirrored", "sheared")
"""A bone that takes on the uneven scale of a turned parent shears."""


def posed(kind: str) -> dict[str, Any]:
    """Build a rig with points, pose it, and return what Blender makes of it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    armature = bpy.data.armatures.new("armature")
    rig = bpy.data.objects.new("rig", armature)
    bpy.context.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for joint in range(3):
        bone = armature.edit_bones.new(f"bone{joint}")
        bone.head, bone.tail = ((0.1 * at, 0.05 * at * at, at) for at in (joint, joint + 1))
        bone.roll, bone.parent = 0.3 * joint, parent
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    points = np.random.default_rng(1).uniform((-0.5, -0.5, 0), (0.5, 0.5, 3), (200, 3))
    weights = np.exp(-4 * (points[:, 2:] - np.arange(3) - 0.5) ** 2) + 0.01
    weights /= weights.sum(axis=1, keepdims=True)
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata(points.tolist(), [], [])
    skin = bpy.data.objects.new("skin", mesh)
    bpy.context.collection.objects.link(skin)
    skin.parent = rig
    modifier = skin.modifiers.new("armature", "ARMATURE")
    modifier.object, modifier.use_deform_preserve_volume = rig, True
    for joint, (turn, scale) in enumerate(zip(TURNS, SCALES, strict=True)):
        group = skin.vertex_groups.new(name=f"bone{joint}")
        for vertex, weight in enumerate(weights[:, joint]):
            group.add([vertex], weight, "REPLACE")
        bone = rig.pose.bones[f"bone{joint}"]
        bone.rotation_mode, bone.rotation_euler = "XYZ", turn
        x, y, z = (1, 1, 1) if kind == "none" else (scale[0],) * 3 if kind == "uniform" else scale
        bone.scale = (-x if kind == "mirrored" and joint == 1 else x, y, z)
        armature.bones[joint].inherit_scale = "FULL" if kind == "sheared" else "NONE"
    bpy.context.view_layer.update()
    evaluated = skin.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    bones = [(rig.pose.bones[bone.name], bone) for bone in armature.bones]
    return {
        "points": [list(vertex.co) for vertex in mesh.vertices],
        "weights": [[group.weight for group in vertex.groups] for vertex in mesh.vertices],
        "joints": [np.array(now.matrix @ rest.matrix_local.inverted()).tolist() for now, rest in bones],
        "posed": [list(vertex.co) for vertex in evaluated.vertices],
    }


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps({kind: posed(kind) for kind in KINDS}), encoding="utf-8")
