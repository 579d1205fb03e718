"""Joints under which normals need care: those that mirror, that are not rigid, and that strain rounding."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skinbake.errors import Notice, Place
from skinbake.geometry.skinned import BoolArray
from skinbake.lighting.angles import not_rigid_joints
from skinbake.lighting.draws import Draw
from skinbake.lighting.identity import IDENTITY_TOLERANCE
from skinbake.lighting.poses import PoseSet
from skinbake.report.verify import Check
from skinbake.skinning.rest import RestPrimitive
from skinbake.skinning.run import joints_in_use
from skinbake.wording import counted


def mirrored(drawn: Sequence[Draw]) -> Iterator[Notice]:
    """Yield a notice for each draw with joints in use that mirror, and turn the surface inside out."""
    mirrors: dict[int, BoolArray] = {}
    for draw in drawn:
        key, matrices = id(draw.poses), draw.poses.joint_matrices
        if key not in mirrors:
            mirrors[key] = (np.linalg.det(matrices[..., :3, :3]) < 0).any(axis=0)
        count = int(np.count_nonzero(mirrors[key] & joints_in_use(draw.rest, matrices.shape[1])))
        if count:
            joints = counted(count, "joint mirrors", "joints mirror")
            message = (
                f"{joints} the surface (negative determinant): write the shader with --for this file, or "
                "with --mirrored-joints, so that normals stay outside"
            )
            yield Notice("joints-mirror", message, replace(draw.views[0].source.place, primitive=None), count)


def joints_without_dqs(rest: Sequence[RestPrimitive], poses: PoseSet) -> list[str]:
    """Return the names of the joints in use that dual quaternions cannot represent in these poses."""
    return [poses.joint_names[joint] for joint in not_rigid_joints(rest, poses.joint_matrices)]


def without_dqs(joints: Sequence[str]) -> str:
    """Return why dual quaternions cannot represent these joints, by name."""
    shown = ", ".join(joints[:4]) + (", …" if len(joints) > 4 else "")
    verb = "is" if len(joints) == 1 else "are"
    return f"{shown} {verb} not rigid up to one scale common to all joints"


def identity_check(angle: float, drawn: Sequence[Draw], place: Place) -> Check:
    """Return whether algorithms 2 and 3 agree. angle is the largest one between their normals, in degrees."""
    remark = f"direct and accurate (algorithms 2 and 3) agree within {angle:.1g}°"
    if angle <= IDENTITY_TOLERANCE:
        return Check("identity", "passed", (), remark)
    message = f"direct and accurate normals (algorithms 2 and 3) differ by {angle:.2g}°"
    strained = max((_strain(draw) for draw in drawn), default=(0.0, ""))
    if strained[0] > STRAINED:
        message += (
            f": its joint matrices are singular or too unlike in size, {strained[1]} most of all, and "
            "rounding takes over: mend the nodes, inverse bind matrices or animations that make them"
        )
    else:
        message += ", and should agree to rounding: this is a fault of skinbake, please report it"
    return Check("identity", "failed", (Notice("identity", message, place),))


STRAINED = 1e6
"""The ratio of joint matrix sizes above which rounding alone can separate algorithms 2 and 3."""


def _strain(draw: Draw) -> tuple[float, str]:
    """Return the ratio of the largest to the least scaling of a frame by joints, and the joint to blame."""
    matrices = draw.poses.joint_matrices
    stretches = np.linalg.svd(matrices[..., :3, :3], compute_uv=False)
    extent = max(float(np.abs(rest.positions).max(initial=0.0)) for rest in draw.rest)
    slope = max(float(np.abs([rest.alpha, rest.beta]).max(initial=0.0)) for rest in draw.rest)
    reach = stretches[..., 0] * extent + np.abs(matrices[..., :3, 3]).max(axis=-1)
    largest = (stretches[..., 0] + reach * slope).max(axis=0)
    least = stretches[..., 2].min(axis=0)
    # A joint that scales by 0 strains without limit.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        too_large, too_small = largest / np.median(largest), np.median(least) / least
        strain = float(largest.max() / least.min())
        worst = int(np.argmax(np.nan_to_num(np.maximum(too_large, too_small), nan=np.inf)))
    return (math.inf if math.isnan(strain) else strain), draw.poses.joint_names[worst]
