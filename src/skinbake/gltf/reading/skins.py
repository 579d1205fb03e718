"""Skins: their skeletons in poses, and the rigs that they make (glTF 2.0, §3.7.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from skinbake.errors import BudgetError, Chosen, InputError, Message, Notice
from skinbake.geometry import poses
from skinbake.geometry.rig import NO_PARENT, Rig
from skinbake.geometry.skinned import Float64Array
from skinbake.gltf.asset import PrimitiveSource
from skinbake.gltf.budget import Cost
from skinbake.gltf.document import Document, once_a_document
from skinbake.gltf.json_access import MOST
from skinbake.gltf.reading.accessors import read_wide
from skinbake.wording import counted

PATHS = {"translation": 3, "rotation": 4, "scale": 3}
TURN = "turn"
"""A path of our own: a rotation after the transform of a node."""


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """The joints of a skin and all their ancestors, parents before children.

    nodes (N,) are indices in the document. parents (N,) are positions in this list, or −1. translations,
    rotations (w first) and scales belong to the nodes at rest, each (N, 3 or 4). matrices holds, by
    position, the nodes that have a matrix instead. joints (J,) are positions of the joints of the skin,
    inverse_bind (J, 4, 4) their matrices.
    """

    nodes: tuple[int, ...]
    parents: tuple[int, ...]
    translations: Float64Array
    rotations: Float64Array
    scales: Float64Array
    joints: npt.NDArray[np.int64]
    inverse_bind: Float64Array
    matrices: dict[int, Float64Array] = field(default_factory=dict)

    def joint_matrices(
        self, animated: dict[tuple[int, str], Float64Array], turned: Float64Array | None, count: int
    ) -> Float64Array:
        """Return joint matrices (P, J, 4, 4): global transform × inverse bind matrix.

        animated maps (node of the document, path) to its values in P poses. turned (J, P, 4) are rotations to
        add to those of the joints, or None. The transform of the node that draws the mesh has no effect.
        """
        return self.bound(self.transforms(animated, turned, count))

    def bound(self, transforms: Float64Array) -> Float64Array:
        """Return joint matrices (P, J, 4, 4) from the global transforms (N, P, 4, 4) of the nodes."""
        joints = poses.product(transforms[self.joints], self.inverse_bind[:, None])
        return np.ascontiguousarray(np.swapaxes(joints, 0, 1))

    def transforms(
        self, animated: dict[tuple[int, str], Float64Array], turned: Float64Array | None, count: int
    ) -> Float64Array:
        """Return the global transforms (N, P, 4, 4) of the nodes: what skins of the same joints share."""
        # The transforms (N, P, 4, 4) of nodes relative to their parents.
        parts = []
        for path, rest in zip(PATHS, (self.translations, self.rotations, self.scales), strict=True):
            values = np.repeat(rest[:, None], count, axis=1)
            for position, node in enumerate(self.nodes):
                if (node, path) in animated:
                    values[position] = animated[node, path]
            parts.append(values)
        local = poses.composed(*parts)
        for position, matrix in self.matrices.items():
            local[position] = matrix
        turning = [position for position, node in enumerate(self.nodes) if (node, TURN) in animated]
        if turning:
            turns = np.stack([animated[self.nodes[position], TURN] for position in turning])
            turns_of = poses.rotation_matrices(turns)
            local[turning, :, :3, :3] = poses.product(local[turning, :, :3, :3], turns_of)
        if turned is not None:
            extra = np.zeros((*turned.shape[:2], 4, 4))
            extra[..., :3, :3] = poses.rotation_matrices(turned)
            extra[..., 3, 3] = 1.0
            local[self.joints] = poses.product(local[self.joints], extra)
        return poses.global_transforms(local, self.parents)


def rest_pose(skeleton: Skeleton) -> Float64Array:
    """Return the joint matrices (1, J, 4, 4) of the nodes as stored in the file."""
    return skeleton.joint_matrices({}, None, 1)


def random_poses(skeleton: Skeleton, count: int, *, angle: float, seed: int) -> Float64Array:
    """Return joint matrices (P, J, 4, 4) with every joint turned at random by up to ``angle`` radians."""
    turned = poses.random_rotations((len(skeleton.joints), count), angle, seed)
    return skeleton.joint_matrices({}, turned, count)


def read_skeleton(document: Document, skin: int) -> Skeleton:
    """Return the joints of a skin with their ancestors. Skins that say the same share them.

    Raises InputError if the hierarchy or the matrices are broken. A broken skin too is read only once.
    """
    known = _skeletons(document)
    if skin not in known:
        one = document.asset.skins[skin]
        try:
            key = one.joints, one.inverse_bind
            if key not in known:
                known[key] = _read_skeleton(document, f"skin {skin}", *key)
            known[skin] = known[key]
        except InputError as error:
            known[skin] = error
    found = known[skin]
    if isinstance(found, InputError):
        raise found.with_traceback(None)
    return found


@once_a_document
def _skeletons(document: Document) -> dict[object, Skeleton | InputError]:
    """Return the skeletons that were read, by skin, and by joints and inverse bind matrices."""
    return {}


def read_node(document: Document, node: int) -> Skeleton:
    """Return a node with its ancestors as a skeleton of one joint, in the space of the node."""
    return _read_skeleton(document, f"node {node}", [node], None)


def _read_skeleton(
    document: Document, owner: str, joints: Sequence[int], matrices_in: int | None
) -> Skeleton:
    nodes, parents = document.asset.nodes, document.asset.parents
    # The joints and the nodes above them, parents first.
    order: dict[int, None] = {}
    for joint in joints:
        chain: dict[int, None] = {}
        node: int | None = joint
        while node is not None and node not in order:
            if node in chain:
                raise InputError(f"node {node} is its own ancestor", document.place)
            chain[node] = None
            node = parents.get(node)
        order.update(dict.fromkeys(reversed(chain)))
    what = f"the joints of {owner} and those above"
    document.budget.claim(Cost.NODE * len(order), what, document.place)
    where = {node: position for position, node in enumerate(order)}
    matrices = {
        position: nodes[node].stored("matrix").reshape(4, 4).T
        for position, node in enumerate(order)
        if nodes[node].has_matrix
    }
    rotations = np.stack([nodes[node].stored("rotation") for node in order])
    # glTF stores matrices by columns.
    count = len(joints)
    inverse_bind = np.broadcast_to(np.eye(4), (count, 4, 4))
    if matrices_in is not None:
        values = read_wide(document, matrices_in, document.place)
        if values.shape[1] != 16 or len(values) < count or not np.isfinite(values[:count]).all():
            message = f"inverseBindMatrices must be {count} finite 4 × 4 matrices"
            raise InputError(message, document.place)
        inverse_bind = np.swapaxes(values[:count].reshape(-1, 4, 4), 1, 2)
    return Skeleton(
        nodes=tuple(order),
        parents=tuple(where[parents[node]] if node in parents else -1 for node in order),
        translations=np.stack([nodes[node].stored("translation") for node in order]),
        rotations=poses.normalised(rotations[:, [3, 0, 1, 2]]),
        scales=np.stack([nodes[node].stored("scale") for node in order]),
        joints=np.array([where[joint] for joint in joints]),
        inverse_bind=inverse_bind,
        matrices=matrices,
    )


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
        with np.errstate(all="ignore"):  # singular matrices, and numbers past all floats
            # By Cramer's rule, as the last digits of LAPACK depend on the processor.
            a, b, c, moved = np.moveaxis(skeleton.inverse_bind[usable, :3], 2, 0)
            adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
            determinants = (a * adjugate[:, 0]).sum(axis=1)
            pivots[usable] = -(adjugate * moved[:, None]).sum(axis=2) / determinants[:, None]
        pivots[~np.isfinite(pivots).all(axis=1)] = np.nan
        # The upper rows of the joint matrices (1, J, 3, 4) of the nodes as stored, NaN for none. There is no
        # such pose if no joint is turned or scaled against the joint that carries it.
        with np.errstate(over="ignore", invalid="ignore"):  # scales may be past all floats
            stored = rest_pose(skeleton)[:, :, :3]
            held = np.flatnonzero(parents != NO_PARENT)
            turned = stored[0, held, :, :3] - stored[0, parents[held], :, :3]
            sizes = np.linalg.norm(stored[0, parents[held], :, :3], axis=(1, 2))
            # A turn by a small angle changes the norm of a rotation, √3, by √2 times the angle.
            counts = np.linalg.norm(turned, axis=(1, 2)) > np.sqrt(2.0 / 3.0) * TURNED * sizes
            stored[~(np.abs(stored) <= MOST).all(axis=(2, 3))] = np.nan
        rig = Rig(parents, pivots, stored if counts.any() else stored[:0])
    document.budget.claim(Cost.RIG_JOINT * joints, f"the rig of {counted(joints, 'joint')}", document.place)
    return rig
