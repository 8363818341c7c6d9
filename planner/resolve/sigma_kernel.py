"""Compiled: parts of the smallest singular value of a Jacobian along a path, by the power method, and of its slope."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def gram(B, out) -> None:
    """Fill out with B^T B (6, 6)."""
    for a in range(6):
        for b in range(6):
            out[a, b] = B[0, a] * B[0, b]
        for k in range(1, 6):
            for b in range(6):
                out[a, b] += B[k, a] * B[k, b]


@njit(cache=True, nogil=True, error_model="numpy")
def square(M, out) -> None:
    """Fill out with M M of a symmetric M (6, 6), scaled so that its diagonal sums to 1."""
    trace = 0.0
    for a in range(6):
        for b in range(a, 6):
            # written out, for a processor adds three numbers at once, but not to each other
            x = M[a, 0] * M[b, 0] + M[a, 1] * M[b, 1] + M[a, 2] * M[b, 2]
            out[a, b] = x + (M[a, 3] * M[b, 3] + M[a, 4] * M[b, 4] + M[a, 5] * M[b, 5])
            out[b, a] = out[a, b]
        trace += out[a, a]
    scale = 1.0 / trace
    for a in range(6):
        for b in range(6):
            out[a, b] *= scale


@njit(cache=True, nogil=True, error_model="numpy")
def power(M, u, w) -> None:
    """Replace u (6) by M u, with a symmetric M (6, 6). w (6) is room."""
    for a in range(6):
        w[a] = M[0, a] * u[0]
    for b in range(1, 6):
        for a in range(6):
            w[a] += M[b, a] * u[b]
    for a in range(6):
        u[a] = w[a]


@njit(cache=True, nogil=True, error_model="numpy")
def to_unit(u) -> float:
    """Scale u (6) to length 1; returns the length that it had."""
    length = np.sqrt((u[0] * u[0] + u[1] * u[1]) + (u[2] * u[2] + u[3] * u[3]) + (u[4] * u[4] + u[5] * u[5]))
    for a in range(6):
        u[a] /= length
    return length


@njit(cache=True, nogil=True, error_model="numpy")
def sigma_slope_by_joints(J, u, v, before, after, slope) -> None:
    """Fill slope (na) with d sigma / dq_k = u^T (dJ/dq_k) v, where v (na) is of unit length; before, after (6) are room.

    Turning joint k moves what comes after it: d_k x columns k and later, while column k moves its own lever as joints
    before it turn. Sums over both sides of k make that linear in the number of joints.
    """
    na = v.size
    for a in range(6):
        before[a], after[a] = 0.0, 0.0
    for k in range(na - 1, -1, -1):
        for a in range(6):
            after[a] += J[a, k] * v[k]
        d0, d1, d2 = J[3, k], J[4, k], J[5, k]
        slope[k] = (
            u[0] * (d1 * after[2] - d2 * after[1])
            + u[1] * (d2 * after[0] - d0 * after[2])
            + u[2] * (d0 * after[1] - d1 * after[0])
            + u[3] * (d1 * after[5] - d2 * after[4])
            + u[4] * (d2 * after[3] - d0 * after[5])
            + u[5] * (d0 * after[4] - d1 * after[3])
        )
    for k in range(na):
        d0, d1, d2 = before[3], before[4], before[5]
        slope[k] += (
            u[0] * (d1 * J[2, k] - d2 * J[1, k])
            + u[1] * (d2 * J[0, k] - d0 * J[2, k])
            + u[2] * (d0 * J[1, k] - d1 * J[0, k])
        )
        for a in range(6):
            before[a] += J[a, k] * v[k]
