"""The few targets that leave the least of many changes of normals, the same bits on every processor.

The changes are a matrix of samples × vertices. Its singular vectors are the best targets in the mean square.
They come from the small matrix of samples × samples (its Gram matrix). LAPACK and BLAS add in an order that
depends on the processor, so:

- The Gram matrix is made of whole numbers that BLAS multiplies and adds without rounding.
- Its largest eigenvectors come from the iteration of a block of vectors, and the small symmetric matrix of
  each block from Jacobi's rotations (Golub and Van Loan, *Matrix Computations*, §8.2.4 and §8.5). All sums
  there are numpy's pairwise sums of one contiguous axis, whose order is fixed.
- Alternating least squares then weight each change as the angle counts that it leaves (``refined``).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from skinbake.geometry.skinned import BoolArray, Float32Array, Float64Array, FloatArray, blocks

STEPS = 2.0**20
"""The whole numbers of the Gram matrix go up to here. The sum of 2 × ``ROWS`` products is exact below 2⁵³."""

ROWS = 1 << 12

BLOCK, ITERATIONS, SETTLED = 6, 60, 1e-15
"""The vectors beside the wanted ones that are iterated with them, and how often at most.

They are settled when the wanted ones, in the share of their eigenvalues, change by no more: that is rounding.
"""

SWEEPS = 12
"""The sweeps of Jacobi's rotations at most: a small matrix is diagonal to the last bit after about six."""

REFINEMENTS = 4
"""The rounds of alternating least squares."""

RIDGE = 1e-6
"""The pull of least squares to 0, relative to the mean diagonal: targets of a vertex may all be alike."""


def gram(changes: Float32Array, areas: FloatArray) -> Float64Array:
    """Return the products of samples, (R, R), of changes (R, V, 2) weighted by areas (V,). NaN counts as 0.

    It is right to one in a million of the largest weighted change, and up to one factor common to all.
    """
    root = np.sqrt(areas).astype(np.float64)
    largest = 0.0
    for rows in blocks(len(root), ROWS):
        weighted = np.nan_to_num(changes[:, rows]) * root[rows, None]
        largest = max(largest, float(np.abs(weighted).max(initial=0.0)))
    total = np.zeros((len(changes), len(changes)))
    if largest == 0.0:
        return total
    for rows in blocks(len(root), ROWS):
        whole = np.rint(np.nan_to_num(changes[:, rows]) * (root[rows, None] * (STEPS / largest)))
        flat = whole.reshape(len(changes), -1)
        total += flat @ flat.T  # whole numbers: exact in any order
    return total


def leading(matrix: Float64Array, count: int) -> tuple[Float64Array, Float64Array]:
    """Return the largest eigenvalues (K,) and their vectors (R, K) of a positive matrix (R, R), in order.

    The entry of a vector that is largest is positive.
    """
    size = min(count + BLOCK, len(matrix))
    # Columns that stand evenly apart span all samples.
    vectors = _orthonormal(matrix[:, np.arange(size) * len(matrix) // size])
    values = np.zeros(size)
    found = np.zeros((len(matrix), 0))
    for _ in range(ITERATIONS):
        vectors = _orthonormal(_product(matrix, vectors))
        values, turns = _jacobi(_product(vectors.T, _product(matrix, vectors)))
        vectors = _product(vectors, turns)
        order = np.argsort(-values, kind="stable")[:count]
        before, found = found, vectors[:, order]
        signs = np.sign(found[np.abs(found).argmax(axis=0), np.arange(found.shape[1])])
        found = found * np.where(signs == 0.0, 1.0, signs)
        shares = values[order] / max(float(values[order[0]]), 1e-300)
        if before.size and (np.abs(found - before) * np.abs(shares)).max() <= SETTLED:
            break
    return np.maximum(values[order], 0.0), found


def _product(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return a @ b, with sums in a fixed order."""
    columns = np.ascontiguousarray(b.T)
    return np.stack([(a * column).sum(axis=1) for column in columns], axis=1)


def _orthonormal(vectors: Float64Array) -> Float64Array:
    """Return columns (R, N) that are orthonormal or 0, by Gram and Schmidt, twice for the last digits."""
    found = np.ascontiguousarray(vectors.T)
    for _ in range(2):
        before = np.sqrt((found * found).sum(axis=1))
        for number in range(len(found)):
            length = float(np.sqrt((found[number] * found[number]).sum()))
            found[number] *= 1.0 / length if length > 1e-12 * before[number] else 0.0
            later = found[number + 1 :]
            later -= (later * found[number]).sum(axis=1)[:, None] * found[number]
    return np.ascontiguousarray(found.T)


def _jacobi(matrix: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the eigenvalues (N,) and vectors (N, N) of a small symmetric matrix, by cyclic rotations."""
    # For so few numbers, lists are faster than arrays.
    a, size = matrix.tolist(), len(matrix)
    vectors = np.eye(size).tolist()
    for _ in range(SWEEPS):
        is_diagonal = True
        for p in range(size):
            for q in range(p + 1, size):
                if abs(a[p][q]) <= 1e-20 * (abs(a[p][p]) + abs(a[q][q])):
                    continue  # nothing is left to rotate
                is_diagonal = False
                ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q])
                t = (1.0 if ratio >= 0.0 else -1.0) / (abs(ratio) + sqrt(1.0 + ratio * ratio))
                c = 1.0 / sqrt(1.0 + t * t)
                s = t * c
                one, two = a[p], a[q]
                a[p] = [c * x - s * y for x, y in zip(one, two, strict=True)]
                a[q] = [s * x + c * y for x, y in zip(one, two, strict=True)]
                for row in (*a, *vectors):
                    row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
                a[p][q] = a[q][p] = 0.0
        if is_diagonal:
            break
    return np.diag(a).copy(), np.array(vectors)


def refined(
    changes: Float32Array,
    normals: Float32Array | None,
    areas: FloatArray,
    shares: FloatArray,
    weights: Float64Array,
) -> tuple[Float64Array, Float64Array]:
    """Return targets (K, V, 2) and weights (R, K) that leave the least angles, from a start for the weights.

    changes (R, V, 2) are δ, NaN where a vertex has none in a sample. normals (R, V, 3) are what δ is added
    to, along the same two axes and the third; None: (0, 0, 1). areas (V,) weight the vertices, shares (R,)
    the samples. With a normal (0, 0, h), an error e of δ turns it by about h |e| / (h² + |δ|²). So folds,
    where a normal is nearly at right angles to where it should be, count little, and a missing δ not at all.
    """
    known = ~np.isnan(changes[..., 0])
    values = np.nan_to_num(changes).astype(np.float64)
    weighted = areas * shares[:, None] * known
    if normals is None:
        emphasis = weighted / np.square(1.0 + np.square(values).sum(axis=2))
    else:
        height = np.square(normals[..., 2].astype(np.float64))
        length = height + np.square(values + normals[..., :2]).sum(axis=2)
        emphasis = weighted * height / np.square(np.where(length > 0.0, length, 1.0))
    for _ in range(REFINEMENTS):
        targets = targets_of(values, emphasis, weights)
        weights = _weights_of(values, emphasis, targets)
    return targets_of(values, emphasis, weights), weights


def targets_of(values: Float64Array, emphasis: Float64Array, weights: Float64Array) -> Float64Array:
    """Return the targets (K, V, 2) that least squares give for weights (R, K), vertex by vertex.

    values (R, V, 2) are without NaN, emphasis is (R, V). Sums run over the samples in their order.
    """
    count = weights.shape[1]
    matrix, right = np.zeros((values.shape[1], count, count)), np.zeros((values.shape[1], count, 2))
    for of_sample, share, weight in zip(values, emphasis, weights, strict=True):
        by_target = share[:, None] * weight
        for one in range(count):
            for axis in range(2):
                right[:, one, axis] += by_target[:, one] * of_sample[:, axis]
            for other in range(one + 1):
                matrix[:, one, other] += by_target[:, one] * weight[other]
    return np.ascontiguousarray(_solved(matrix, right).transpose(1, 0, 2))


def _weights_of(values: Float64Array, emphasis: Float64Array, targets: Float64Array) -> Float64Array:
    """Return the weights (R, K) that least squares give for targets (K, V, 2), sample by sample."""
    count = len(targets)
    matrix, right = np.zeros((len(values), count, count)), np.zeros((len(values), count, 1))
    for one in range(count):
        right[:, one, 0] = (emphasis * (values * targets[one]).sum(axis=2)).sum(axis=1)
        for other in range(one + 1):
            matrix[:, one, other] = (emphasis * (targets[one] * targets[other]).sum(axis=1)).sum(axis=1)
    return _solved(matrix, right)[:, :, 0]


def _solved(matrix: Float64Array, right: Float64Array) -> Float64Array:
    """Solve N symmetric systems (N, K, K), given by their lower halves, for right sides (N, K, C).

    The elimination is that of L D Lᵀ. A system without a diagonal has the solution 0.
    """
    count = matrix.shape[1]
    a, found = matrix.copy(), right.copy()
    diagonal = np.arange(count)
    mean = a[:, diagonal, diagonal].sum(axis=1) / count
    is_empty = ~(mean > 0.0)
    a[:, diagonal, diagonal] += np.where(is_empty, 1.0, RIDGE * mean)[:, None]
    for k in range(count):
        for i in range(k + 1, count):
            factor = a[:, i, k] / a[:, k, k]
            for j in range(k + 1, i + 1):
                a[:, i, j] -= factor * a[:, j, k]
            found[:, i] -= factor[:, None] * found[:, k]
    for i in reversed(range(count)):
        for j in range(i + 1, count):
            found[:, i] -= a[:, j, i][:, None] * found[:, j]
        found[:, i] /= a[:, i, i][:, None]
    found[is_empty] = 0.0
    return found


def normalise(targets: Float64Array, weights: Float64Array, used: BoolArray) -> None:
    """Scale each target (K, V, 2) so that its longest vector has length 1, and its weights (R, K) against it.

    So weights stay below about 3. The arrays are changed. used (V,) are the vertices that count.
    """
    # Shorter targets with larger weights suit engines that keep the direction of a target's normal, by
    # theory. But at length 1 such storage adds 0.013° to CesiumMan's mean, at a sixteenth 0.001°. And large
    # weights do harm: Godot's Compatibility renderer turned normals inside out at weights of 30, Blender's
    # weights end at 10, and Unreal drops changes of 0.1 or less.
    for number in range(len(targets)):
        length = float(np.sqrt(np.square(targets[number, used]).sum(axis=1).max(initial=0.0)))
        if length > 0.0:
            targets[number] *= 1.0 / length
            weights[:, number] *= length
