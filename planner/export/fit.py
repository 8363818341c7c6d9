"""Orientations between targets, and the fewest targets whose interpolation meets all samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices

# ----------------------------------------------------------------------------------------------------
# Unit quaternions, x y z w, in batches.


def continuous(quat: Array) -> Array:
    """Quaternions (n, 4), normalised, each with the sign that is nearer to its predecessor."""
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    flips = np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0.0
    sign = np.concatenate([[1.0], np.cumprod(np.where(flips, -1.0, 1.0))])
    out: Array = quat * sign[:, None]
    return out


def slerp(a: Array, b: Array, u: Array) -> Array:
    """Quaternions (n, 4) at the fraction u (n) of the shorter great arc from a to b (n, 4)."""
    dot = np.einsum("ij,ij->i", a, b)
    b = np.where(dot[:, None] < 0.0, -b, b)
    omega = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    near = omega < 1e-6  # sin(k w) / sin(w) tends to k
    sine = np.where(near, 1.0, np.sin(omega))
    wa = np.where(near, 1.0 - u, np.sin((1.0 - u) * omega) / sine)
    wb = np.where(near, u, np.sin(u * omega) / sine)
    out: Array = wa[:, None] * a + wb[:, None] * b
    return out


def lerp(values: Array, a: Indices, b: Indices, u: Array) -> Array:
    """Values (n, ...) at the fraction u (n) of the way from rows a (n) to rows b (n) of a table."""
    out: Array = values[a] + u.reshape(-1, *[1] * (values.ndim - 1)) * (values[b] - values[a])
    return out


def angle(a: Array, b: Array) -> Array:
    """Angles (n) between orientations a and b (n, 4) [rad]."""
    sign = np.where(np.einsum("ij,ij->i", a, b) < 0.0, -1.0, 1.0)[:, None]
    # from half the chord on the quaternion sphere, which stays accurate where arccos does not
    out: Array = 4.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - sign * b, axis=1), 0.0, 1.0))
    return out


def lean_and_roll(a: Array, b: Array) -> tuple[Array, Array]:
    """Angle between the z axes of orientations a and b (n, 4), and unsigned rotation about z from a to b (n) [rad].

    For small angles, up to a degree or so: the components of the rotation vector across and along z.
    """
    x0, y0, z0, w0 = a.T
    x1, y1, z1, w1 = b.T
    across = np.hypot(w0 * x1 - x0 * w1 - y0 * z1 + z0 * y1, w0 * y1 + x0 * z1 - y0 * w1 - z0 * x1)
    return 2.0 * np.arcsin(np.minimum(across, 1.0)), 2.0 * np.arcsin(
        np.minimum(np.abs(w0 * z1 - x0 * y1 + y0 * x1 - z0 * w1), 1.0)
    )


def from_matrix(R: Array) -> Array:
    """Quaternions (n, 4), w >= 0, of rotation matrices (n, 3, 3): the largest component is found first (Shepperd)."""
    d = np.einsum("nii->ni", R)
    trace = d.sum(axis=1)
    squares = 0.25 * np.column_stack([1.0 + 2.0 * d - trace[:, None], 1.0 + trace])
    K = np.empty((len(R), 4, 4))  # q q^T: each row is the quaternion, times one of its own components
    for i in range(4):
        K[:, i, i] = squares[:, i]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[:, i, j] = K[:, j, i] = 0.25 * (R[:, i, j] + R[:, j, i])
        K[:, k, 3] = K[:, 3, k] = 0.25 * (R[:, j, i] - R[:, i, j])
    largest = np.argmax(squares, axis=1)
    q = K[np.arange(len(R)), largest]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    out: Array = np.where(q[:, 3:] < 0.0, -q, q)
    return out


def to_matrix(quat: Array) -> Array:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quat.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


# ----------------------------------------------------------------------------------------------------
# The fewest targets: spans of samples are split until interpolation meets every sample between.

# (first, last, k) → how far interpolation between samples first and last misses sample k, in tolerances
Misfit = Callable[[Indices, Indices, Indices], Array]
# (first, last) → the worst of these over the samples in between; 0 if there are none
Judge = Callable[[Indices, Indices], Array]
MOST_PARTS = 4
LANE = 200  # targets chosen one after the other; all lanes advance at the same time
ENOUGH = 0.95  # a span with at least this misfit (within tolerance) counts as the longest
SHORTER = 0.98  # × the longest span as estimated from the misfit
GUESSES = 4  # estimates of the longest span before bisection of its bounds


def fewest(kept: Indices, judge: Judge) -> Indices:
    """Like `thin`, with fewer targets at a higher cost.

    `thin` leaves many spans that fit better than they need to. Lanes of some hundreds of spans are therefore chosen
    again, each target as far from the previous one as it can be.
    """
    found = thin(kept, judge)
    within = np.arange(len(found)) - np.searchsorted(found, kept)[np.searchsorted(kept, found, side="right") - 1]
    lanes = found[within % LANE == 0]
    reached = _farthest(lanes, judge)
    fewer = np.diff(np.searchsorted(reached, lanes)) < np.diff(np.searchsorted(found, lanes))
    return np.unique(np.concatenate([lanes, _within(lanes, found, ~fewer), _within(lanes, reached, fewer)]))


def _within(lanes: Indices, found: Indices, chosen: NDArray[np.bool_]) -> Indices:
    """The targets of `found` that lie in the chosen lanes."""
    owner = np.clip(np.searchsorted(lanes, found, side="right") - 1, 0, len(chosen) - 1)
    return found[chosen[owner]]


def _farthest(lanes: Indices, judge: Judge) -> Indices:
    """Targets of each lane, each as far from the previous one as the misfit allows, or nearly."""
    found = [lanes]
    at, end = lanes[:-1].copy(), lanes[1:]
    fits, misses, tried = at + 1, end + 1, np.zeros(len(at), dtype=np.intp)  # bounds of the longest span's end
    guess = np.minimum(at + np.maximum((end - at) // LANE, 1), end)
    going = np.flatnonzero(at < end)
    while len(going):
        a, g = at[going], guess[going]
        worst = judge(a, g)
        good = worst <= 1.0
        fits[going] = np.where(good, g, fits[going])
        misses[going] = np.where(good, misses[going], g)
        tried[going] += 1
        low, high = fits[going], misses[going]
        done = (high - low <= 1) | (low == end[going]) | (good & (worst >= ENOUGH))
        step = (g - a) * SHORTER / np.sqrt(np.maximum(worst, 0.05))
        ahead = np.where(tried[going] < GUESSES, a + step.astype(np.intp), (low + high) // 2)
        guess[going] = np.clip(ahead, low + 1, np.maximum(high - 1, low + 1))
        arrived = going[done]
        length = fits[arrived] - at[arrived]
        at[arrived] = fits[arrived]
        found.append(fits[arrived])
        fits[arrived], misses[arrived], tried[arrived] = at[arrived] + 1, end[arrived] + 1, 0
        guess[arrived] = np.minimum(at[arrived] + length, end[arrived])
        going = going[at[going] < end[going]]
    return _balanced(lanes, np.unique(np.concatenate(found)), judge)


def _balanced(lanes: Indices, found: Indices, judge: Judge) -> Indices:
    """The same targets, with the last two spans of each lane made equally long where both then fit."""
    last = np.searchsorted(found, lanes[1:])
    last = last[last - np.searchsorted(found, lanes[:-1]) >= 2]
    begin, end = found[last - 2], found[last]
    middle = (begin + end) // 2
    fits = np.maximum(judge(begin, middle), judge(middle, end)) <= 1.0
    found[last[fits] - 1] = middle[fits]
    return found


def by_samples(misfit: Misfit) -> Judge:
    """A judge of spans by the misfit of each sample in them."""

    def judge(first: Indices, last: Indices) -> Array:
        out = np.zeros(len(first))
        inner = last - first - 1
        some = inner > 0
        if some.any():
            first, last, inner = first[some], last[some], inner[some]
            offset = np.concatenate([[0], np.cumsum(inner)[:-1]])
            k = np.arange(int(inner.sum())) - np.repeat(offset - first - 1, inner)
            out[some] = np.maximum.reduceat(misfit(np.repeat(first, inner), np.repeat(last, inner), k), offset)
        return out

    return judge


def thin(kept: Indices, judge: Judge) -> Indices:
    """Sorted sample indices: `kept` (sorted, unique, never dropped) and those needed to bring the misfit to <= 1.

    All spans are judged at once, level by level. A span that misses by e tolerances is cut into about sqrt(e) equal
    parts, which gives few targets in few passes.
    """
    found = [kept]
    first, last = kept[:-1], kept[1:]
    while True:
        worst = judge(first, last)
        bad = ~(worst <= 1.0)
        if not bad.any():
            return np.unique(np.concatenate(found))
        first, last, worst = first[bad], last[bad], worst[bad]
        parts = np.clip(np.ceil(np.sqrt(worst)), 2, np.minimum(MOST_PARTS, last - first)).astype(np.intp)
        owner = np.repeat(np.arange(len(first)), parts)
        part = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
        length = (last - first)[owner]
        first, last = (
            first[owner] + length * part // parts[owner],
            first[owner] + length * (part + 1) // parts[owner],
        )
        found.append(first)
