"""Weight gradients fitted to poses and to the turns of a rig, by least squares in numpy.

The gradient of a weight moves the tangents of algorithm 3 exactly if the surface and the weights are
smooth. On a coarse mesh a better number exists: the one with which the tangents follow the deformed
triangles. This module finds it for some poses (``posed_rings``) and for small turns of all joints, each
about its own pivot (``ring_turns``), by one least squares. Then α and β shrink as far as standard lighting
is better. ``loops/vertex_fit.h`` does the same in its pass over the vertices; this module is the
definition.

A vertex p has weights w_i, joint matrices M_i, and the frame t, b, n at rest. The mesh has the derivative
Σ_k c_k f_k of any function f along t. For each joint, the tangent of the deformed mesh and that of the
shader differ by

    Σ_k c_k (w_ki − w_i) (p_k − p)  +  w_i (a − t)        a = Σ_k c_k p_k, the mesh's own tangent

The second term is the authored frame, which the true normals carry along. The first one is as large as the
rest where a weight changes over one edge. Two kinds of terms tell how far the shader's tangents leave the
mesh. In a pose with T = Σ w_i M_i:

    t'(α)  = T t + Σ_s α_s (M_s p − M_last p)   the α of the fitted slots sum to 0: the last is left out
    n'     = F t × F b, of length 1             F: from the ring's derivatives at rest to those in the pose
    v      = 2 / (|t'(∇)|² + |b'(∇)|²)          ∇ the gradients of the surface; v is bounded in folds

    the mean over the poses of   v ( (n' · t'(α))² + λ |t'(α) − t'(∇)|² )

The derivatives in the pose are sums over the ring that are linear in M_i, so no mesh is posed. F also maps
the unit vector across the ring to the one in the pose, times the root of how the area grows, and to the
other side where joints mirror.

Turn joint j, and all joints below it, by a small ω about its pivot. To first order all is linear in ω, so
the expectation over all turns is a sum over j, without samples.

    i ⪯ j    i is j, or below j        ᾱ_j   Σ_{i⪯j} α_i        x_j = p − pivot of j     e_k = p_k − p
    ΔS_kj = Σ_{i⪯j} (w_ki − w_i)       ∇̄_j   Σ_{i⪯j} ∇_i
    a_k   how the true normal tilts along t as neighbour k moves (the arms of ``ring_turns``)

    R_j = x_j × ᾱ_j n − [ x_j × Σ_k ΔS_kj a_k + Σ_k ΔS_kj e_k × a_k ]          the tilt that is left

    θ² ( Σ_j |R_j|² + 10 Σ_C |Σ_{j∈C} R_j|² + λ Σ_j |x_j|² (ᾱ_j − ∇̄_j)² )

with θ = 0.2 radians, λ = 0.25 and the long chains C.

α minimises the sum of both, and so does β along b. A rigid turn has ΔS = 0, and gets exactly no correction.
A change of the gradients far below their size is noise of the least squares, so the changes of a vertex are
multiplied by c² / (c² + (0.02 g)²), with its largest change c and its largest gradient g.

Standard lighting is α = β = 0. Along the ray s α, s β the tilts are E(s) = E0 − 2 s A + s² B, over all
these poses and turns, both tangents and all copies of a point. So α and β are multiplied by s = 1.5 A / B,
at most 1. At 2 A / B the fit would be as good as standard lighting, at A / B best for these poses, and
worse for others. A and B of the turns alone allow twice as much, 3 A / B: what harms most turns must not
stay because it helps a clip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skinbake.geometry.rig import NO_CHAIN, Lineage, Rig
from skinbake.geometry.skinned import BoolArray, Float64Array, FloatArray, IntArray, bincount
from skinbake.gradients.fit_rules import (
    BOUNDED,
    COLLAPSED,
    EVEN,
    FLAT,
    FLAT_TILT,
    RAY,
    SMALL,
    STIFFNESS,
    TOGETHER,
    TURN,
    UNFELT,
)
from skinbake.gradients.posed_rings import moved, posed_rings
from skinbake.gradients.ring_turns import RingTurns
from skinbake.gradients.surface import NO_JOINT, Surface, WeightField
from skinbake.gradients.weight_gradients import VertexGradients, summed_rows

MOST_TURNS = 128
"""The joints that turn around a vertex, and those above. With more of these, a vertex keeps its gradients."""

MOST_FITTED = 64
"""The joints of a vertex. With more of them, the vertex keeps its gradients."""


@dataclass(frozen=True, slots=True)
class FittedVertices:
    """V vertices to fit, those of a whole surface.

    classes (V,) are their weld classes. field has their influences (V, K), named (V, K) the joint whose
    gradient each slot holds, −1 for none. positions and the tangents and bitangents t0, b0 of the shader are
    (V, 3). alpha, beta (V, K) are the surface's gradients along them.
    """

    classes: IntArray
    field: WeightField
    named: IntArray
    positions: FloatArray
    frame: tuple[FloatArray, FloatArray]
    alpha: Float64Array
    beta: Float64Array


def fitted(
    vertices: FittedVertices, surface: Surface, gradients: VertexGradients, turns: RingTurns
) -> tuple[Float64Array, Float64Array]:
    """Return α and β for which the tangents follow the poses and the turns of the surface's rig best.

    The fitted gradients of a vertex sum to 0. A vertex that cannot be fitted keeps its α and β.
    """
    assert surface.rig is not None
    # The slots (V, K) that are fitted.
    owner, entry = _entries(gradients.offsets, vertices.classes)
    lengths = np.linalg.norm(gradients.gradients[entry], axis=1)
    total = bincount(owner, lengths, len(vertices.classes))
    row, slot = np.nonzero(vertices.named[owner] == gradients.joints[entry, None])
    # The weight of the slot's joint, 0 where the slot adopts.
    weights = vertices.field.weights * (vertices.named == vertices.field.joints)
    presence = np.where(vertices.named >= 0, weights, 0.0)
    # Its share of all gradients at the vertex.
    whole = total[owner]
    shares = np.divide(lengths, whole, out=np.zeros_like(lengths), where=whole > 0.0)
    presence[owner[row], slot] += shares[row]
    chosen: BoolArray = presence > UNFELT
    few = np.count_nonzero(chosen, axis=1) <= MOST_FITTED
    named = np.where(chosen & few[:, None], vertices.named, NO_JOINT)
    given = _gradients_of_slots(vertices, gradients, turns)
    # What no slot holds goes to the first one, as in the shader.
    given[:, 0] = -given[:, 1:].sum(axis=1)
    given[named < 0] = 0.0
    pairs, ends = _turning_pairs(vertices, named, turns, surface.rig)
    usable = few & ends & turns.sound[vertices.classes]
    unknowns = named >= 0
    unknowns[np.arange(len(named)), pairs.last] = False
    # The squared tilts and the pulls to ∇, in the poses and by the turns.
    tilts, pulls = _Form.zeros(*named.shape), _Form.zeros(*named.shape)
    _add_turns(tilts, pulls, vertices, turns, pairs, unknowns, given)
    turned = _Form(tilts.matrix.copy(), tilts.right.copy())
    _add_poses(tilts, pulls, vertices, surface, turns, named, pairs.last, given)
    system = _Form(*(one + STIFFNESS * other for one, other in zip(tilts, pulls, strict=True)))
    # A pull of each unknown alone decides where nothing else does.
    trace = np.where(unknowns, np.einsum("vkk->vk", system.matrix), 0.0).sum(axis=1)
    diagonal = np.arange(named.shape[1])
    system.matrix[:, diagonal, diagonal] += EVEN * trace[:, None]
    system.right[:] += EVEN * trace[:, None, None] * given
    own, numbers = given.copy(), np.count_nonzero(unknowns, axis=1)
    for count in np.unique(numbers):
        rows = np.flatnonzero((numbers == count) & usable)
        if count == 0 or len(rows) == 0:
            continue
        slots = np.nonzero(unknowns[rows])[1].reshape(len(rows), count)
        here = rows[:, None]
        matrix = system.matrix[here[:, :, None], slots[:, :, None], slots[:, None, :]]
        values = _solved(matrix, system.right[here, slots])
        fits = np.isfinite(values).all(axis=(1, 2))
        own[here[fits], slots[fits]] = values[fits]
        own[rows[fits], pairs.last[rows[fits]]] = -values[fits].sum(axis=1)
    change = own - given
    change *= shares_of_changes(change, given, turns.slopes[vertices.classes])[:, None, None]
    # The rays to standard lighting.
    own = np.where(unknowns[:, :, None], given + change, 0.0)
    share = np.minimum(
        *(
            _kept(most, form.along(own), usable, vertices.classes)
            for most, form in ((RAY, tilts), (2.0 * RAY, turned))
        )
    )
    moves = np.einsum("vkt,vti->vki", change, turns.tangents[vertices.classes])
    alpha, beta = (
        share * (plain + np.einsum("vki,vi->vk", moves, axis))
        for plain, axis in zip((vertices.alpha, vertices.beta), vertices.frame, strict=True)
    )
    return alpha, beta


def _kept(
    most: float, along: tuple[Float64Array, Float64Array], usable: BoolArray, classes: IntArray
) -> Float64Array:
    """Return the part of α and β (V, 1) that is ``most`` times the best one, from 0 to 1.

    along are A and B of the vertices, E(s) = E0 − 2 s A + s² B. All copies of a point go as far.
    """
    rays = np.where(usable[:, None], np.stack(along, axis=1), 0.0)
    a, b = summed_rows(classes, rays, int(classes.max(initial=-1)) + 1).T
    shares = np.divide(most * a, b, out=np.ones_like(b), where=b > FLAT_TILT)
    return np.where(np.isnan(shares), 1.0, shares.clip(0.0, 1.0))[classes, None]


def shares_of_changes(changes: Float64Array, given: Float64Array, slopes: Float64Array) -> Float64Array:
    """Return the shares (V,) that are kept of the changes (V, K, 2) of gradients, given (V, K, 2).

    It is c² / (c² + (SMALL g)²) for the longest change c and gradient g of a vertex. No change stays longer
    than BOUNDED times g or slopes (V,). All of a vertex are shortened alike, so that they still sum to 0.
    """
    change, gradient = (np.square(each).sum(axis=2).max(axis=1, initial=0.0) for each in (changes, given))
    whole = change + SMALL * SMALL * gradient
    kept = np.divide(change, whole, out=np.zeros_like(change), where=change > 0.0)
    lengths, most = np.sqrt(change), BOUNDED * np.maximum(np.sqrt(gradient), slopes)
    bound = np.divide(most, lengths, out=np.ones_like(most), where=lengths > most)
    return np.asarray(np.minimum(kept, bound))


def _solved(matrix: Float64Array, right: Float64Array) -> Float64Array:
    """Return the solutions (V, U, 2) of V symmetric systems of U unknowns, NaN for one in doubt.

    That is a system of which float64 leaves rounding: elimination takes all of a diagonal entry but FLAT².
    """
    least = FLAT * FLAT * np.einsum("vii->vi", matrix)
    left, found = matrix.copy(), right.copy()
    # Elimination from the top, without pivoting: the systems are symmetric and positive.
    for row in range(matrix.shape[1]):
        pivot = left[:, row, row]
        pivot[~(pivot > least[:, row])] = np.nan
        factors = left[:, row + 1 :, row] / pivot[:, None]
        left[:, row + 1 :] -= factors[:, :, None] * left[:, None, row]
        found[:, row + 1 :] -= factors[:, :, None] * found[:, None, row]
    # The unknowns from the last to the first.
    for row in reversed(range(matrix.shape[1])):
        known = np.einsum("vu,vut->vt", left[:, row, row + 1 :], found[:, row + 1 :])
        found[:, row] = (found[:, row] - known) / left[:, row, row, None]
    return found


@dataclass(frozen=True, slots=True)
class _Pairs:
    """The pairs (N,) of a vertex and a joint whose turn parts the fitted joints of the vertex.

    vertices (N,) are indices of the vertices. levers (N, 3) go from the joint's pivot to the vertex. arms,
    spins (N, 2, 3) are the sums over all joints that the turning joint carries. carries (N, K) tells which
    slots it carries. chains (N,) is the long chain of the turning joint, −1 for none. named (V, K) are the
    fitted joints of the slots, −1 for the others, and last (V,) is the last slot of them, which takes minus
    the sum of the others.
    """

    vertices: IntArray
    levers: Float64Array
    arms: Float64Array
    spins: Float64Array
    carries: BoolArray
    chains: IntArray
    named: IntArray
    last: IntArray


def _turning_pairs(
    vertices: FittedVertices, named: IntArray, turns: RingTurns, rig: Rig
) -> tuple[_Pairs, BoolArray]:
    """Return the pairs of V vertices, and which vertices (V,) have no more turns than MOST_TURNS.

    Joints that the rig does not have stand apart and never turn.

    The turn of a joint takes along all joints that it carries, and so do its arms and spins: each entry of
    ``turns`` goes up the rig, and is added to those of every joint on its way. The way ends below the lowest
    joint that carries all joints around the vertex. From there on a turn is rigid. An example:

        joint 0     The weights of 2, 3 and 4 vary around a vertex. The slots of 3 and 4 are fitted.
        └ 1         It carries 2, 3 and 4, so the ways end below it: 2; 3, 2; 4.
          ├ 2       The entries of 2 and 3 are summed up. Of the slots it carries the first.
          │ └ 3     The entry of 3. It carries the first slot.
          └ 4       The entry of 4. It carries the second slot.

    All three carry one slot and not the other: they part the slots, and make three pairs. The second slot is
    the last. Its α is minus α of the first, so ᾱ is α of the first for 2 and 3, and minus that for 4. These
    factors 1, 1 and −1 are ``_TurnEffects.signs``. If the slots were those of 3 and 2, only 3 would make a
    pair: 2 carries both slots, and 4 carries none.
    """
    owner, entry = _entries(turns.offsets, vertices.classes)
    felt = turns.arms[entry].any(axis=(1, 2)) | turns.spins[entry].any(axis=(1, 2))
    owner, entry = owner[felt], entry[felt]
    row, slot = np.nonzero(named >= 0)
    # Each entry is a vertex, a joint, and the arms and spins of the joint alone.
    vertex = np.concatenate([owner, row])
    joint = np.concatenate([turns.joints[entry], named[row, slot]])
    values = np.concatenate([turns.arms[entry], turns.spins[entry]], axis=1).reshape(-1, 12)
    # The turns of a fitted joint count even if its weight does not vary around the vertex.
    values = np.concatenate([values, np.zeros((len(row), 12))])
    lineage, count = Lineage(rig), len(named)
    # How many joints each way passes.
    climbs = lineage.depths[joint] - lineage.depths[lineage.lowest_above(vertex, joint, count)[vertex]]
    # A vertex whose ways are very long is left unfitted.
    too_many = np.zeros(count, dtype=np.bool_)
    too_many[vertex[climbs > MOST_TURNS]] = True
    repeated, above = lineage.upwards(joint, np.where(too_many[vertex], 0, climbs))
    size = len(rig.parents)
    # Added up by vertex and turning joint.
    keys, place = np.unique(vertex[repeated] * size + above, return_inverse=True)
    sums = summed_rows(place, values[repeated], len(keys))
    at, turning = np.divmod(keys, size)
    # A turn parts the slots if it carries some of them and not all.
    fitted_at = named[at] >= 0
    carries = lineage.carries(turning[:, None], named[at]) & fitted_at
    parting = carries.any(axis=1) & (carries != fitted_at).any(axis=1)
    parting &= np.isfinite(rig.pivots[turning]).all(axis=1)
    ends = ~too_many & (bincount(at, minlength=count) <= MOST_TURNS)
    parting &= ends[at]
    at, turning, both = at[parting], turning[parting], sums[parting].reshape(-1, 4, 3)
    found = _Pairs(
        vertices=at,
        levers=vertices.positions[at].astype(np.float64) - rig.pivots[turning],
        arms=both[:, :2],
        spins=both[:, 2:],
        carries=carries[parting],
        chains=rig.chains[turning],
        named=named,
        last=named.shape[1] - 1 - (named >= 0)[:, ::-1].argmax(axis=1),
    )
    return found, ends


def _entries(offsets: IntArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    """Return the places of all entries of some rows like CSR, each with the index of its row."""
    count = offsets[rows + 1] - offsets[rows]
    owner = np.repeat(np.arange(len(rows)), count)
    return owner, np.arange(len(owner)) + np.repeat(offsets[rows] - np.cumsum(count) + count, count)


def _gradients_of_slots(
    vertices: FittedVertices, gradients: VertexGradients, turns: RingTurns
) -> Float64Array:
    """Return the surface's gradient of each slot's joint along the class's two tangents, (V, K, 2)."""
    owner, entry = _entries(gradients.offsets, vertices.classes)
    along = np.einsum("eti,ei->et", turns.tangents[vertices.classes[owner]], gradients.gradients[entry])
    # The slot that names the joint of the entry.
    row, slot = np.nonzero(vertices.named[owner] == gradients.joints[entry, None])
    found = np.zeros((*vertices.named.shape, 2))
    found[owner[row], slot] = along[row]
    return found


class _Form(NamedTuple):
    """A quadratic form of α at V vertices: αᵀ matrix α − 2 α · right, added up over both tangents.

    matrix (V, K, K), right (V, K, 2). The last fitted slot is left out, as its α is minus the sum of the
    others.
    """

    matrix: Float64Array
    right: Float64Array

    @classmethod
    def zeros(cls, vertices: int, slots: int) -> _Form:
        """Return a form that is 0 everywhere."""
        return cls(np.zeros((vertices, slots, slots)), np.zeros((vertices, slots, 2)))

    def along(self, own: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return A and B (V,) for which the form of s × own (V, K, 2) is s² B − 2 s A."""
        a = np.einsum("vkt,vkt->v", own, self.right)
        b = np.einsum("vkt,vkl,vlt->v", own, self.matrix, own)
        return a, b


def _add_poses(
    tilts: _Form,
    pulls: _Form,
    vertices: FittedVertices,
    surface: Surface,
    turns: RingTurns,
    named: IntArray,
    last: IntArray,
    given: Float64Array,
) -> None:
    """Add the means over the poses of v (n' · t')², the tilts, and of v |t' − t'∇|², the pulls.

    t' are the tangents of algorithm 3, t'∇ those by the surface's gradients, given (V, K, 2). v is
    2 / (|t'∇|² + |b'∇|²), but where a fold collapses tangents it grows no more.
    """
    assert surface.rig is not None
    classes, every = vertices.classes, np.arange(len(named))
    fits: BoolArray = named >= 0
    positions = vertices.positions.astype(np.float64)[:, None]
    for matrices in surface.rig.poses:
        posed = posed_rings(surface, turns, matrices)
        normals, still = posed.normals[classes], posed.still[classes]
        counts: BoolArray = np.asarray(normals.any(axis=1))
        # What a unit of each slot's α moves: where its joint takes the vertex, from where the last one does.
        seen: BoolArray = fits & counts[:, None]
        ends = moved(matrices[np.maximum(named, 0)], positions)
        over = np.where(seen[:, :, None], ends - ends[every, last, None], 0.0)
        shift = np.einsum("vku,vki->vui", given, over)
        length = np.square(still + shift).sum(axis=(1, 2))
        length = np.maximum(length, 2.0 * COLLAPSED * posed.rigid[classes])
        v = np.divide(2.0, length, out=np.zeros(len(length)), where=counts) / len(surface.rig.poses)
        # How far that lifts a tangent out of the surface, and how far it is out without.
        lift, tilt = np.einsum("vki,vi->vk", over, normals), np.einsum("vui,vi->vu", still, normals)
        raised, weighted = v[:, None] * lift, v[:, None, None] * over
        tilts.matrix[:] += raised[:, :, None] * lift[:, None, :]
        tilts.right[:] -= raised[:, :, None] * tilt[:, None, :]
        pulls.matrix[:] += np.einsum("vki,vli->vkl", weighted, over)
        pulls.right[:] += np.einsum("vki,vui->vku", weighted, shift)


def _add_turns(
    tilts: _Form,
    pulls: _Form,
    vertices: FittedVertices,
    turns: RingTurns,
    pairs: _Pairs,
    unknowns: BoolArray,
    given: Float64Array,
) -> None:
    """Add Σ_j |R_j|² + 10 Σ_C |Σ_{j ∈ C} R_j|² to the tilts, and Σ_j |x_j|² (ᾱ_j − ∇̄_j)² to the pulls.

    Both are for turns by the angle TURN. C are the long chains, whose joints turn alike.
    """
    effects = _effects_of_turns(pairs, unknowns, turns.normals[vertices.classes], given)
    at, signs = pairs.vertices, effects.signs
    products = signs[:, :, None] * signs[:, None, :]
    levers = TURN * TURN * effects.squared_levers
    squares, aims = (TURN * TURN * each for each in (effects.squares, effects.aims))
    np.add.at(tilts.matrix, at, products * squares[:, None, None])
    np.add.at(tilts.right, at, signs[:, :, None] * aims[:, None, :])
    np.add.at(pulls.matrix, at, products * levers[:, None, None])
    np.add.at(pulls.right, at, signs[:, :, None] * (levers[:, None] * effects.carried)[:, None, :])
    # How a turn tilts the tangents for each unit of a slot's gradient, (N, K, 3), and should, (N, 2, 3).
    rows = np.flatnonzero(pairs.chains != NO_CHAIN)
    size = int(pairs.chains.max(initial=0)) + 1
    # The pairs of one vertex and one long chain are a group. One of a single pair is left out.
    keys, place, counts = np.unique(
        pairs.vertices[rows] * size + pairs.chains[rows], return_inverse=True, return_counts=True
    )
    several = counts > 1
    alike = signs[:, :, None] * effects.tilt[:, None], effects.wanted
    totals = [np.zeros((len(keys), *values.shape[1:])) for values in alike]
    for total, values in zip(totals, alike, strict=True):
        np.add.at(total, place, values[rows])
    at, tilted, wanted = keys[several] // size, *(total[several] for total in totals)
    factor = TOGETHER * TURN * TURN
    np.add.at(tilts.matrix, at, factor * np.einsum("mki,mli->mkl", tilted, tilted))
    np.add.at(tilts.right, at, factor * np.einsum("mki,mti->mkt", tilted, wanted))


@dataclass(frozen=True, slots=True)
class _TurnEffects:
    """What the turn of each of N pairs does to the two tangents of its vertex, and what it should do.

    - tilt (N, 3) is x × n. A turn by ω tilts a tangent along the normal by ω · tilt ᾱ.
    - wanted (N, 2, 3) is r. A turn by ω should tilt the tangents by ω · wanted.
    - signs (N, K) are 1, −1 or 0. ᾱ is the sum of signs × α over the slots.
    - carried (N, 2) is ∇̄, which is ᾱ by the surface's gradients.
    - squared_levers (N,) are |x|².
    """

    signs: Float64Array
    tilt: Float64Array
    wanted: Float64Array
    carried: Float64Array
    squared_levers: Float64Array

    @property
    def squares(self) -> Float64Array:
        """Return |tilt|² (N,), the factor of ᾱ² in |R|²."""
        return np.asarray(np.einsum("ni,ni->n", self.tilt, self.tilt))

    @property
    def aims(self) -> Float64Array:
        """Return tilt · wanted (N, 2). |R|² is least if ᾱ |tilt|² equals it."""
        return np.asarray(np.einsum("ni,nti->nt", self.tilt, self.wanted))


def _effects_of_turns(
    pairs: _Pairs, unknowns: BoolArray, normals: Float64Array, given: Float64Array
) -> _TurnEffects:
    """Return the effects of all pairs, from the normals (V, 3) of the vertices' classes.

    unknowns (V, K) are all fitted slots but the last. α of the last one is minus the sum of the others. So a
    turn that carries the last slot takes 1 from the sign of every unknown.
    """
    at = pairs.vertices
    # α of the last slot is minus the sum of the unknowns.
    carries_last = pairs.carries[np.arange(len(at)), pairs.last[at]]
    signs = np.where(unknowns[at], pairs.carries.astype(np.float64) - carries_last[:, None], 0.0)
    return _TurnEffects(
        signs=signs,
        tilt=np.cross(pairs.levers, normals[at]),
        wanted=np.cross(pairs.levers[:, None], pairs.arms) + pairs.spins,
        carried=np.einsum("nk,nkt->nt", pairs.carries, given[at]),
        squared_levers=np.einsum("ni,ni->n", pairs.levers, pairs.levers),
    )
