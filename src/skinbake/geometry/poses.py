"""Transforms of joints: interpolated, composed, passed down the hierarchy (glTF 2.0, §3.5, appendix C)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from skinbake.geometry.skinned import Float64Array

STEP, LINEAR, CUBICSPLINE = "STEP", "LINEAR", "CUBICSPLINE"

MORPH_STREAM = 1
"""The stream of random numbers for morph weights, separate from that of rotations, under one seed."""

FINGERS, SAME = 4, 1e-6
"""The numbers of a fingerprint, and the difference up to which they are the same.

Rounding by tools changes them by 1e-8, one joint that turns by a degree in one of 121 poses by 1e-5.
"""


def interpolated(
    times: Float64Array, values: Float64Array, at: Float64Array, *, method: str, rotation: bool
) -> Float64Array:
    """Return an animated property of M components at the times ``at`` (P,): (P, M).

    times (N,) ascend, in seconds. values are (N, M), or (N, 3, M) as in-tangent, value, out-tangent for
    CUBICSPLINE. Several properties with the same times may be one array (…, N, M), and the result is then (…,
    P, M). Before the first and after the last key the value stays. Rotations are quaternions (w, x, y, z),
    interpolated along the shorter arc for LINEAR, and normalised.
    """
    # The keys around each time, and how far it is from one to the other.
    last = len(times) - 1
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, max(last - 1, 0))
    after = np.minimum(before + 1, last)
    span = times[after] - times[before]
    share = np.divide(at - times[before], span, out=np.zeros_like(at), where=span > 0)
    share = np.clip(share, 0.0, 1.0)
    # The values at these keys.
    left, right = (values.take(key, axis=-3 if method == CUBICSPLINE else -2) for key in (before, after))
    s = share[:, None]
    if method == CUBICSPLINE:
        # The Hermite spline of glTF 2.0, appendix C.5. Its tangents count per second.
        s2, s3, seconds = s * s, s * s * s, span[:, None]
        result = (
            (2 * s3 - 3 * s2 + 1) * left[..., 1, :]
            + seconds * (s3 - 2 * s2 + s) * left[..., 2, :]
            + (3 * s2 - 2 * s3) * right[..., 1, :]
            + seconds * (s3 - s2) * right[..., 0, :]
        )
    elif method == STEP:
        result = np.where(s >= 1.0, right, left)
    elif rotation:
        # Appendix C.4. q and −q are one rotation: the nearer one is taken.
        left, right = normalised(left), normalised(right)
        cosine = (left * right).sum(axis=-1)
        right = np.where(cosine[..., None] < 0, -right, right)
        angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
        sine = np.sin(angle)
        # sin((1 − s) φ) / sin φ and sin(s φ) / sin φ, or their limits 1 − s and s.
        short = sine < 1e-9
        safe = np.where(short, 1.0, sine)
        a = np.where(short, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
        b = np.where(short, share, np.sin(share * angle) / safe)
        result = a[..., None] * left + b[..., None] * right
    else:
        result = left * (1.0 - s) + right * s
    return normalised(result) if rotation else result


def normalised(quaternions: Float64Array) -> Float64Array:
    """Return unit quaternions (…, 4); a quaternion without length becomes the identity (1, 0, 0, 0)."""
    length = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    identity = np.broadcast_to([1.0, 0.0, 0.0, 0.0], quaternions.shape).copy()
    return np.asarray(np.divide(quaternions, length, out=identity, where=length > 0))


def rotation_matrices(quaternions: Float64Array) -> Float64Array:
    """Return rotation matrices (…, 3, 3) of unit quaternions (…, 4) as (w, x, y, z)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def composed(translations: Float64Array, rotations: Float64Array, scales: Float64Array) -> Float64Array:
    """Return matrices (…, 4, 4) that scale (…, 3), rotate (…, 4; w first), then translate (…, 3)."""
    matrices = np.zeros((*translations.shape[:-1], 4, 4))
    matrices[..., :3, :3] = rotation_matrices(rotations) * scales[..., None, :]
    matrices[..., :3, 3] = translations
    matrices[..., 3, 3] = 1.0
    return matrices


def global_transforms(local: Float64Array, parents: Sequence[int]) -> Float64Array:
    """Return global transforms (N, P, 4, 4) of local ones; parents precede children, −1 means no parent."""
    result = np.empty_like(local)
    for node, parent in enumerate(parents):
        result[node] = local[node] if parent < 0 else product(result[parent], local[node])
    return result


def product(first: Float64Array, second: Float64Array) -> Float64Array:
    """Return products of matrices (…, R, N) and (…, N, C), each sum in the order of its terms.

    The last digits of a product by ``@`` depend on the processor, and a bake that is fitted to poses would
    too.
    """
    terms = (first[..., :, n, None] * second[..., None, n, :] for n in range(first.shape[-1]))
    return sum(terms, start=np.zeros(()))


def determinants(matrices: Float64Array) -> Float64Array:
    """Return the determinants (…) of the linear parts of matrices (…, 3 or 4, 3 or 4)."""
    a, b, c = np.moveaxis(matrices[..., :3, :3], -2, 0)
    return np.asarray((np.cross(a, b) * c).sum(axis=-1))


def random_rotations(shape: tuple[int, ...], angle: float, seed: int) -> Float64Array:
    """Return unit quaternions (…, 4), w first: uniform axes, angles uniform in ± ``angle`` radians."""
    generator = np.random.default_rng(seed)
    # Normal components, scaled to length 1, are uniform on the sphere.
    axes: npt.NDArray[np.float64] = generator.normal(size=(*shape, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    half = 0.5 * generator.uniform(-angle, angle, size=(*shape, 1))
    return np.concatenate([np.cos(half), np.sin(half) * axes], axis=-1)


def random_weights(resting: Float64Array, count: int, at_once: int, seed: int) -> Float64Array:
    """Return morph weights (P, N): in each pose ``at_once`` targets, or all, are random in 0 … 1.

    The others keep their resting weight (N,). The generator differs from that of ``random_rotations``, so
    joints turn the same with morph targets and without.
    """
    generator = np.random.default_rng([seed, MORPH_STREAM])
    weights = np.tile(resting, (count, 1))
    # The first entries of a random order are a choice without repetition.
    chosen = generator.random(weights.shape).argsort(axis=1)[:, :at_once]
    np.put_along_axis(weights, chosen, generator.random(chosen.shape), axis=1)
    return weights


def fingerprint(matrices: Sequence[Float64Array]) -> tuple[float, ...]:
    """Return a few numbers from −1 to 1 that change with any joint of any pose, but hardly by rounding.

    A digest would change when a tool writes a matrix as translation, rotation and scale. NaN counts as 0.
    """
    values = np.nan_to_num(np.concatenate([each.ravel() for each in matrices]))
    length = math.sqrt(math.fsum(values * values)) or 1.0  # inverse bind matrices may be zero
    # A few terms of a Fourier series of all numbers in a row.
    steps = np.arange(1, len(values) + 1)
    found = [math.fsum(values * np.cos(number * steps)) / length for number in range(1, FINGERS + 1)]
    return tuple(round(value, 9) for value in found)


def is_fingerprint_of(found: Sequence[float], noted: Sequence[float]) -> bool:
    """Tell whether a noted fingerprint is that of the poses with the fingerprint ``found``."""
    return len(noted) == FINGERS and bool(np.allclose(found, noted, rtol=0.0, atol=SAME))
