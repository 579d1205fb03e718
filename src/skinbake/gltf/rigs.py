"""The rig of a skin: the hierarchy of its joints, and the points about which they turn."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skinbake.errors import BudgetError, Chosen, InputError, Message, Notice
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.animation import Skeleton, read_skeleton, rest_pose
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import MOST
from skinbake.gltf.primitives import PrimitiveSource
from skinbake.wording import counted


def fitting_rig(document: Document, source: PrimitiveSource) -> Rig | None:
    """Return the rig of the skin that draws a primitive; tell why if it has none to fit to, and return None.

    Nothing is fitted, and nothing is told, for a skin of one joint. Raises InputError if the rig would take
    more memory than the file may have.
    """
    try:
        rig, others = rig_of_mesh(document, source.mesh)
        if len(rig.parents) == 1:
            return None
        reason = "no inverse bind matrix of the skin can be inverted"
    except BudgetError:
        raise
    except InputError as error:
        rig, others, reason = None, 0, f"the skeleton cannot be read ({error.message})"
    if rig is None or not np.isfinite(rig.pivots).all(axis=1).any():
        surface = Chosen("gradients", "surface")
        why = Message(f"{reason}: α/β are the gradients of the surface, as with ", surface)
        document.notices.tell(Notice("no-rig", why, source.place))
        return None
    if others:
        others_draw = "another skin draws" if others == 1 else f"{others} other skins draw"
        message = f"{others_draw} the mesh with other joints or bind poses: α/β are fitted to the first skin"
        document.notices.tell(Notice("rig-of-first-skin", message, source.place))
    return rig


def rig_of_mesh(document: Document, mesh: int) -> tuple[Rig, int]:
    """Return the rig of the first skin that draws a mesh, in mesh space, and the number of other rigs.

    A node that is listed twice carries itself. Joints whose inverse bind matrix is singular have no pivot.
    Raises InputError if the nodes form a circle, or if a matrix cannot be read.
    """
    skeletons = {
        id(one): one for one in (read_skeleton(document, skin) for skin in document.asset.skins_of(mesh))
    }
    first, *others = (_rig_of(document, skeleton) for skeleton in skeletons.values())
    return first, len({rig.digest for rig in others} - {first.digest})


TURNED = float(np.radians(1.0))
"""The turn of a joint against the one that carries it, in radians, from which on the stored pose counts.

Exporters round inverse bind matrices. The stored pose of a file that rests in its bind pose is off by less. A
scale that changes the norm of a matrix as much counts too: one by 1.4 % in all directions.
"""


@once_a_document
def _rig_of(document: Document, skeleton: Skeleton) -> Rig:
    """Return the rig of a skeleton of the document, which is made once for all meshes."""
    # For each joint the next joint above it. Nodes that are not joints are passed over.
    positions = skeleton.joints.tolist()
    joint_at: dict[int, int] = {}
    for joint, position in enumerate(positions):
        joint_at.setdefault(position, joint)
    above = [NO_PARENT] * len(skeleton.parents)
    for position, parent in enumerate(skeleton.parents):  # parents come before their children
        if parent >= 0:
            above[position] = joint_at.get(parent, above[parent])
    parents = np.empty(len(positions), dtype=np.int32)
    parents[:] = [
        above[position] if joint_at[position] == joint else joint_at[position]
        for joint, position in enumerate(positions)
    ]
    with document.budget.passing():
        nodes, joints = len(skeleton.nodes), len(skeleton.joints)
        what = f"the stored pose of {counted(nodes, 'node')} and {counted(joints, 'joint')}"
        # A file of two bytes for each joint can list one node as many joints.
        work = Cost.NODE_MATRIX * nodes + Cost.JOINT_MATRIX * joints
        document.budget.claim(work, what, document.place)
        # The origins of the joints in mesh space (J, 3), NaN for a matrix that cannot be inverted.
        pivots = np.full((len(skeleton.inverse_bind), 3), np.nan)
        usable = np.flatnonzero(np.isfinite(skeleton.inverse_bind).all(axis=(1, 2)))
        usable = usable[np.linalg.det(skeleton.inverse_bind[usable, :3, :3]) != 0.0]
        linear, moved = skeleton.inverse_bind[usable, :3, :3], skeleton.inverse_bind[usable, :3, 3:]
        pivots[usable] = -np.linalg.solve(linear, moved)[..., 0]
        pivots[~np.isfinite(pivots).all(axis=1)] = np.nan
        rig = Rig(parents, pivots, _stored_pose(skeleton, parents))
    document.budget.claim(Cost.RIG_JOINT * joints, f"the rig of {counted(joints, 'joint')}", document.place)
    return rig


def _stored_pose(skeleton: Skeleton, parents: npt.NDArray[np.int32]) -> Float64Array | None:
    """Return the upper rows of the joint matrices (J, 3, 4) of the nodes as stored, NaN where there is none.

    Return None if no joint is turned or scaled against the joint that carries it.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # scales may be past all floats
        stored = rest_pose(skeleton)[0, :, :3]
        held = np.flatnonzero(parents != NO_PARENT)
        turned = stored[held, :, :3] - stored[parents[held], :, :3]
        sizes = np.linalg.norm(stored[parents[held], :, :3], axis=(1, 2))
        # A turn by a small angle changes the norm of a rotation, √3, by √2 times the angle.
        counts = np.linalg.norm(turned, axis=(1, 2)) > np.sqrt(2.0 / 3.0) * TURNED * sizes
        held_by_float32 = (np.abs(stored) <= MOST).all(axis=(1, 2))
    if not counts.any():
        return None
    stored[~held_by_float32] = np.nan
    return stored
