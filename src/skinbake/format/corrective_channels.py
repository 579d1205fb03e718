"""The keys of a node's morph weights, with those of correctives behind them (glTF 2.0, §3.11).

One sampler holds the weights of all targets of a node. So what a file animates already and the correctives
get keys at the union of their times:

- LINEAR stays LINEAR: the values between two keys are the same with further keys on the line.
- CUBICSPLINE stays CUBICSPLINE: a cubic piece is cut into two with the same values and slopes, and each
  straight piece of the correctives is a cubic piece with one slope.
- STEP becomes LINEAR, with the former value held until the last float before each key.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skinbake.geometry import poses
from skinbake.geometry.skinned import Float32Array


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of a sampler: times (N,), values (N, T), or (N, 3, T) for CUBICSPLINE, and the method."""

    times: Float32Array
    values: Float32Array
    method: str


def with_correctives(there: Keys, times: Float32Array, weights: Float32Array) -> Keys:
    """Return keys for all targets: those that are there, then correctives of weights (M, K) at times (M,).

    Where there are no correctives before their first or after their last key, the value stays.
    """
    own, kept = there.times.astype(np.float64), np.append(np.diff(there.times) > 0, True)
    union = np.union1d(there.times, times).astype(np.float32)
    if there.method == poses.STEP:
        held = np.nextafter(there.times[1:], np.float32(-np.inf))
        union = np.union1d(union, held[held >= there.times[0]]).astype(np.float32)
    at = union.astype(np.float64)
    straight = [np.interp(at, times, column) for column in weights.T.astype(np.float64)]
    ours = np.stack(straight, axis=1).astype(np.float32)
    former = there.values.astype(np.float64)
    if there.method != poses.CUBICSPLINE:
        found = poses.interpolated(own, former, at, method=there.method, rotation=False).astype(np.float32)
        # Keys that are there keep their bits. Of two at one time, the last counts from there on.
        found[np.searchsorted(union, there.times[kept])] = there.values[kept]
        return Keys(union, np.concatenate([found, ours], axis=1), poses.LINEAR)
    cubic = np.zeros((len(union), 3, former.shape[2] + ours.shape[1]), dtype=np.float32)
    cubic[:, 1, former.shape[2] :] = ours
    slopes = np.diff(ours, axis=0) / np.diff(at)[:, None]
    cubic[1:, 0, former.shape[2] :] = slopes
    cubic[:-1, 2, former.shape[2] :] = slopes
    values = poses.interpolated(own, former, at, method=there.method, rotation=False)
    # The derivatives (P, T) of a spline of values (N, 3, T), 0 outside its keys.
    before = np.clip(np.searchsorted(own, at, side="right") - 1, 0, max(len(own) - 2, 0))
    after = np.minimum(before + 1, len(own) - 1)
    span = own[after] - own[before]
    inside = (at >= own[0]) & (at <= own[-1]) & (span > 0)
    span = np.where(span > 0, span, 1.0)
    s = ((at - own[before]) / span)[:, None]
    left, right = former[before], former[after]
    slope = (
        (6 * s * s - 6 * s) * (left[:, 1] - right[:, 1]) / span[:, None]
        + (3 * s * s - 4 * s + 1) * left[:, 2]
        + (3 * s * s - 2 * s) * right[:, 0]
    )
    slope = np.where(inside[:, None], slope, 0.0)
    cubic[:, :, : former.shape[2]] = np.stack([slope, values, slope], axis=1)
    cubic[np.searchsorted(union, there.times[kept]), :, : former.shape[2]] = there.values[kept]
    # Before the first and after the last key that were there, the value stays.
    if union[0] < there.times[0]:
        cubic[np.searchsorted(union, there.times[0]), 0, : former.shape[2]] = 0.0
    if union[-1] > there.times[-1]:
        cubic[np.searchsorted(union, there.times[-1]), 2, : former.shape[2]] = 0.0
    return Keys(union, cubic, poses.CUBICSPLINE)
