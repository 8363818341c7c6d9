"""The smallest singular value of many small matrices, compiled: LAPACK spends most of its time on call overhead.

A matrix is reduced to a bidiagonal B by reflections (Golub and Kahan 1965). Starting at 0, Laguerre's method approaches
the smallest eigenvalue of the tridiagonal B^T B from below, tripling the number of correct digits with each step
(Parlett, The Symmetric Eigenvalue Problem, section 7.5); B^T B - x is factored from B's own elements (Fernando and
Parlett 1994, dstqds).
"""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit

_STEPS = 200  # at most; three to six are usual
_DONE = 1e-15  # relative: a step that no longer changes the value
# × the step before. Once a step is below this share, the next one's share is the cube of its own (cubic convergence),
# so its size is known without taking it. A step so near the eigenvalue may overshoot by rounding, and cost many more.
_FALLING = 1e-2


def least_singular_values(matrices: Array) -> Array:
    """Smallest singular values (n) of matrices (n, r, c); NaN for a matrix with an element that is not finite."""
    tall = matrices if matrices.shape[1] >= matrices.shape[2] else np.swapaxes(matrices, 1, 2)
    out = np.empty(len(tall))
    _fill(np.ascontiguousarray(tall, dtype=float), out)
    return out


@njit
def _fill(matrices: Array, out: Array) -> None:
    """Fill `out` (n) for tall matrices (n, r, c)."""
    n, r, c = matrices.shape
    A, q, e = np.empty((r, c)), np.empty(c), np.empty(c)
    for i in range(n):
        for a in range(r):
            for b in range(c):
                A[a, b] = matrices[i, a, b]
        out[i] = least_singular_value(A, q, e)


@inner_njit
def least_singular_value(A: Array, q: Array, e: Array) -> float:
    """Smallest singular value of a tall matrix A (r, c), which is overwritten; NaN if an element is not finite.

    q and e (c) are work space.
    """
    r, c = A.shape
    largest = 0.0
    for a in range(r):
        for b in range(c):
            largest = max(largest, abs(A[a, b])) if np.isfinite(A[a, b]) else np.inf
    if not 0.0 < largest < np.inf:
        return 0.0 if largest == 0.0 else np.nan
    _bidiagonal(A, q, e)
    return np.sqrt(_least_eigenvalue(q, e))


@inner_njit
def _bidiagonal(A: Array, q: Array, e: Array) -> None:
    """Reduce a tall A (r, c) to a bidiagonal matrix with the same singular values; A is overwritten.

    Fills q (c) with the squares of its diagonal, and e (c) with those of its superdiagonal, the last of which is 0.
    """
    r, c = A.shape
    for k in range(c):
        square = 0.0
        for i in range(k, r):
            square += A[i, k] * A[i, k]
        q[k] = square
        if square > 0.0 and k < r - 1:
            A[k, k] += np.copysign(np.sqrt(square), A[k, k])
            scale = 0.0
            for i in range(k, r):
                scale += A[i, k] * A[i, k]
            for j in range(k + 1, c):
                along = 0.0
                for i in range(k, r):
                    along += A[i, k] * A[i, j]
                along *= 2.0 / scale
                for i in range(k, r):
                    A[i, j] -= along * A[i, k]
        square = 0.0
        for j in range(k + 1, c):
            square += A[k, j] * A[k, j]
        e[k] = square
        if square > 0.0 and k < c - 2:
            A[k, k + 1] += np.copysign(np.sqrt(square), A[k, k + 1])
            scale = 0.0
            for j in range(k + 1, c):
                scale += A[k, j] * A[k, j]
            for i in range(k + 1, r):
                along = 0.0
                for j in range(k + 1, c):
                    along += A[k, j] * A[i, j]
                along *= 2.0 / scale
                for j in range(k + 1, c):
                    A[i, j] -= along * A[k, j]


@inner_njit
def _least_eigenvalue(q: Array, e: Array) -> float:
    """Smallest eigenvalue of B^T B, given the squares of B's diagonal q (c) and of its superdiagonal e (c)."""
    c, x, low, high = q.size, 0.0, 0.0, np.inf
    before, share = 0.0, np.inf
    for _ in range(_STEPS):
        # d: pivots of B^T B - x, each q + s; s1, s2: first and second derivatives of s with respect to x
        s, s1, s2, d, first, second = -x, -1.0, 0.0, 0.0, 0.0, 0.0
        for i in range(c):
            d = q[i] + s
            if d <= 0.0:
                break
            inverse = 1.0 / d
            ratio = s1 * inverse
            first -= ratio
            second += ratio * ratio - s2 * inverse
            left, slope = e[i] * inverse, q[i] * inverse
            s, s1, s2 = left * s - x, left * slope * s1 - 1.0, left * slope * (s2 - 2.0 * s1 * ratio)
        if d > 0.0:
            # first and second are the sums of 1 / (eigenvalue - x), and of its square
            step = c / (first + np.sqrt(max((c - 1) * (c * second - first * first), 0.0)))
            if step <= _DONE * x:
                break
            low, x = x, x + step
            share, last = step / before, share
            if high == np.inf and last <= 1.0 and share <= _FALLING and step * share**3 <= _DONE * x:
                break
            before = step
        else:  # overshot by rounding, noticeable only if all eigenvalues are close together
            high = x
        if x >= high:
            x = 0.5 * (low + high)
            if not low < x < high:
                return low
    return x
