"""From gradients of joints to α and β of influence slots, joints of neighbours adopted into free ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skinbake.bake.gradients import VertexGradients
from skinbake.bake.influences import NO_JOINT, WeightField
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray

ADOPT, DROP = "adopt", "drop"

NEGLIGIBLE = 1e-4
"""Share of a vertex's gradient below which a neighbour's joint is not worth a slot.

It changes the correction of a tangent by a ten-thousandth: at a correction as long as the tangent itself
less than 0.01°.
"""


@dataclass(frozen=True, slots=True)
class SlotGradients:
    """α and β of every slot, and what the slots could not hold.

    alpha, beta (V, K) float64, slot 0 included. adopted (V, K) int64: the joint that a slot adopts, −1
    elsewhere. overflowing: vertices with more foreign joints than free slots (all that have any, where
    none are adopted). lost: share of the summed gradient magnitude that no slot holds, which falls to s0.
    """

    alpha: Float64Array
    beta: Float64Array
    adopted: npt.NDArray[np.int64]
    overflowing: int
    lost: float


def assign(
    gradients: VertexGradients,
    classes: npt.NDArray[np.int64],
    field: WeightField,
    frame: tuple[FloatArray, FloatArray],
    *,
    neighbours: str,
) -> SlotGradients:
    """Return α and β per slot of V vertices.

    classes (V,) names each vertex's row of ``gradients``; field holds its normalised influences (V, K);
    frame its t0 and b0, each (V, 3). A slot carries the gradient of the joint that it names; where
    ``neighbours`` is ``adopt``, joints that vary around the vertex and are not among its influences of
    positive weight move into slots of weight zero, the largest gradients first.
    """
    foreign = _foreign_entries(gradients, classes, field)
    adopted = np.full(field.joints.shape, NO_JOINT, dtype=np.int64)
    named = field.joints
    if neighbours == ADOPT:
        adopted = _adopt(foreign, field)
        named = np.where(adopted != NO_JOINT, adopted, np.where(field.weights > 0, field.joints, NO_JOINT))
        named = _with_unchanged_slots(named, field)
    alpha, beta, held = _project(gradients, classes, named, frame)
    overflowing, lost = _losses(gradients, classes, foreign, named, held)
    return SlotGradients(alpha, beta, adopted, overflowing, lost)


@dataclass(frozen=True, slots=True)
class _Foreign:
    """Joints that vary at a vertex without being its own: vertex, joint, gradient magnitude, all (F,)."""

    vertices: npt.NDArray[np.int64]
    joints: npt.NDArray[np.int64]
    magnitudes: Float64Array


def _entries(
    gradients: VertexGradients, classes: npt.NDArray[np.int64], rank: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the vertices that have an entry of this rank, and the entries' numbers."""
    entry = gradients.offsets[classes] + rank
    vertices = np.flatnonzero(entry < gradients.offsets[classes + 1])
    return vertices, entry[vertices]


def _ranks(gradients: VertexGradients) -> range:
    return range(int(np.diff(gradients.offsets).max(initial=0)))


def _foreign_entries(
    gradients: VertexGradients, classes: npt.NDArray[np.int64], field: WeightField
) -> _Foreign:
    magnitude = np.linalg.norm(gradients.gradients, axis=1)
    total = _row_sums(gradients, magnitude)[classes]
    vertices, joints, magnitudes = [], [], []
    for rank in _ranks(gradients):
        vertex, entry = _entries(gradients, classes, rank)
        joint = gradients.joints[entry]
        own = ((field.joints[vertex] == joint[:, None]) & (field.weights[vertex] > 0)).any(axis=1)
        foreign = ~own & (magnitude[entry] > NEGLIGIBLE * total[vertex])
        vertices.append(vertex[foreign])
        joints.append(joint[foreign])
        magnitudes.append(magnitude[entry[foreign]])
    if not vertices:
        empty = np.empty(0, dtype=np.int64)
        return _Foreign(empty, empty, np.empty(0))
    return _Foreign(np.concatenate(vertices), np.concatenate(joints), np.concatenate(magnitudes))


def _row_sums(gradients: VertexGradients, values: Float64Array) -> Float64Array:
    running = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(running[gradients.offsets[1:]] - running[gradients.offsets[:-1]])


def _adopt(foreign: _Foreign, field: WeightField) -> npt.NDArray[np.int64]:
    """Return the joint that each free slot adopts (V, K): the largest gradients into the first free slots."""
    order = np.lexsort((foreign.joints, -foreign.magnitudes, foreign.vertices))
    vertices, joints = foreign.vertices[order], foreign.joints[order]
    rank = np.arange(len(vertices)) - np.searchsorted(vertices, vertices)
    free = field.weights == 0
    free_first = np.argsort(~free[vertices], axis=1, kind="stable")
    fits = rank < np.count_nonzero(free, axis=1)[vertices]
    slot = free_first[fits, rank[fits]]
    adopted = np.full(field.joints.shape, NO_JOINT, dtype=np.int64)
    adopted[vertices[fits], slot] = joints[fits]
    return adopted


def _with_unchanged_slots(named: npt.NDArray[np.int64], field: WeightField) -> npt.NDArray[np.int64]:
    """Let free slots that adopt nothing keep the joint they name in the file, unless it stands elsewhere."""
    named = named.copy()
    for slot in range(named.shape[1]):
        joint = field.joints[:, slot]
        stays = (named[:, slot] == NO_JOINT) & ~(named == joint[:, None]).any(axis=1)
        named[stays, slot] = joint[stays]
    return named


def _project(
    gradients: VertexGradients,
    classes: npt.NDArray[np.int64],
    named: npt.NDArray[np.int64],
    frame: tuple[FloatArray, FloatArray],
) -> tuple[Float64Array, Float64Array, BoolArray]:
    """Return α, β (V, K), and which entries of which vertices a slot holds, as a flat mask by rank."""
    alpha, beta = np.zeros(named.shape), np.zeros(named.shape)
    held = []
    for rank in _ranks(gradients):
        vertex, entry = _entries(gradients, classes, rank)
        at = named[vertex] == gradients.joints[entry][:, None]
        row, slot = np.nonzero(at)
        gradient = gradients.gradients[entry[row]]
        alpha[vertex[row], slot] = np.einsum("ij,ij->i", gradient, frame[0][vertex[row]])
        beta[vertex[row], slot] = np.einsum("ij,ij->i", gradient, frame[1][vertex[row]])
        held.append(at.any(axis=1))
    return alpha, beta, np.concatenate(held) if held else np.zeros(0, dtype=np.bool_)


def _losses(
    gradients: VertexGradients,
    classes: npt.NDArray[np.int64],
    foreign: _Foreign,
    named: npt.NDArray[np.int64],
    held: BoolArray,
) -> tuple[int, float]:
    """Return at how many vertices a foreign joint found no slot, and the share of the gradient lost."""
    placed = (named[foreign.vertices] == foreign.joints[:, None]).any(axis=1)
    overflowing = len(np.unique(foreign.vertices[~placed]))
    entries = [_entries(gradients, classes, rank)[1] for rank in _ranks(gradients)]
    magnitude = np.linalg.norm(gradients.gradients[np.concatenate(entries)], axis=1) if entries else np.zeros(0)
    whole = float(magnitude.sum())
    return overflowing, float(magnitude[~held].sum()) / whole if whole else 0.0
