"""What a viewer draws of a file with correctives, by a reader of targets and weights of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skinbake.gltf.document import read_document
from skinbake.gltf.reading.clips import clip_poses, read_clips
from skinbake.gltf.reading.skins import read_skeleton
from tests.support import gltf_reading
from tests.support.characters import Array, unit


@dataclass(frozen=True)
class Drawn:
    """A primitive as a node draws it: its numbers, the changed normals (V, 3), T (V, 3, 3), the positions.

    at_rest (V, 3) are the positions as morph targets leave them, before skinning.
    """

    mesh: int
    primitive: int
    node: int
    changed: Array
    blended: Array
    positions: Array
    at_rest: Array

    @property
    def normals(self) -> Array:
        """The unit normals (V, 3) in the scene."""
        return unit(np.einsum("vij,vj->vi", self.blended, self.changed))


def weights_at(file: gltf_reading.GltfFile, clip: int, node: int, time: float) -> Array | None:
    """Return the morph weights of a node in a clip, None if no channel moves them (glTF 2.0, appendix C)."""
    animation = file.content["animations"][clip]
    for channel in animation["channels"]:
        if channel["target"] == {"node": node, "path": "weights"}:
            sampler = animation["samplers"][channel["sampler"]]
            times = file.values(sampler["input"])[:, 0]
            values = file.values(sampler["output"]).reshape(len(times), -1)
            time = min(max(time, times[0]), times[-1])
            before = min(max(int(np.searchsorted(times, time, side="right")) - 1, 0), len(times) - 1)
            after = min(before + 1, len(times) - 1)
            span = times[after] - times[before]
            share = (time - times[before]) / span if span else 0.0
            if sampler.get("interpolation") == "STEP":
                share = 0.0
            if sampler.get("interpolation") == "CUBICSPLINE":
                count = values.shape[1] // 3
                p0, m0 = values[before, count : 2 * count], span * values[before, 2 * count :]
                p1, m1 = values[after, count : 2 * count], span * values[after, :count]
                s = share
                return np.asarray(
                    (2 * s**3 - 3 * s**2 + 1) * p0
                    + (s**3 - 2 * s**2 + s) * m0
                    + (3 * s**2 - 2 * s**3) * p1
                    + (s**3 - s**2) * m1
                )
            return np.asarray((1 - share) * values[before] + share * values[after])
    return None


def drawn(
    path: Path, clip: int, time: float, *, corrected: bool = True, store: str = "difference"
) -> Iterator[Drawn]:
    """Yield what each skinned node draws of each primitive at a time of a clip, in the scene.

    store is how an engine keeps a target's normal: as the ``difference`` of the file, or as the ``direction``
    of the whole normal. Without ``corrected``, the targets that skinbake has added do nothing.
    """
    file = gltf_reading.read(path)
    document = read_document(str(path))
    moving = next(one for one in read_clips(document) if one.number == clip)
    for node, content in enumerate(file.content["nodes"]):
        if "skin" not in content or "mesh" not in content:
            continue
        skeleton = read_skeleton(document, content["skin"])
        matrices = clip_poses(skeleton, moving, np.array([time]))[0]
        mesh = file.content["meshes"][content["mesh"]]
        at_rest = content.get("weights", mesh.get("weights", []))
        weights = weights_at(file, clip, node, time)
        weights = np.array(at_rest) if weights is None else weights
        if not corrected:
            added = mesh["extras"]["skinbake"]["targets"]
            weights = np.append(weights[:-added], np.zeros(added))
        for number, primitive in enumerate(mesh["primitives"]):
            joints, shares = file.influences(content["mesh"], number)
            shares = shares / shares.sum(axis=1, keepdims=True)
            joints = np.where(joints < len(matrices), joints, 0)
            blended = np.einsum("vk,vkij->vij", shares, matrices[joints])
            base = file.attribute("NORMAL", content["mesh"], number)
            changed, positions = base.copy(), file.attribute("POSITION", content["mesh"], number).copy()
            for weight, target in zip(weights, primitive.get("targets", []), strict=True):
                if "POSITION" in target:
                    positions += weight * file.values(target["POSITION"])
                if "NORMAL" in target:
                    difference = file.values(target["NORMAL"])
                    if store == "direction":
                        difference = unit(base + difference) - unit(base)
                    changed += weight * difference
            posed = np.einsum("vij,vj->vi", blended[:, :3, :3], positions) + blended[:, :3, 3]
            yield Drawn(content["mesh"], number, node, changed, blended[:, :3, :3], posed, positions)
