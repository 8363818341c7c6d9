"""Newton's method on a chain, compiled: postures for a pose from postures nearby.

Damped as by Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method", 2011: the
damping falls with the squared error, so that the last steps are plain Newton's.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.kinematics.chain import chain_state, jacobian_at
from planner.readonly import Array

EXACT = 1e-11  # m and rad: below, a posture has the pose
_LEAST_DAMPING = 1e-13
_LONGEST_STEP = 0.5  # rad in one joint


@njit(cache=True)
def refine(
    placements: Array,
    axes: Array,
    T_last_tip: Array,
    held: int,
    R: Array,
    t: Array,
    q: Array,
    iterations: int,
) -> bool:
    """Change q (n) until its pose is rotation R (3, 3) and origin t (3); whether it got there.

    held  joint that keeps its angle; -1 for none
    """
    n = q.size
    T, J, lines = np.empty((4, 4)), np.empty((6, n)), np.empty((2, n, 3))
    e, A, b = np.empty(6), np.empty((n, n)), np.empty(n)
    before = np.inf
    for _ in range(iterations):
        _pose_and_jacobian(placements, axes, T_last_tip, q, T, J, lines)
        square = _error(T, R, t, e)
        if square < EXACT * EXACT and square >= 0.01 * before:  # one step more than needed, while it still helps
            return True
        before = square
        damping = 0.5 * square + _LEAST_DAMPING
        for i in range(n):
            b[i] = 0.0
            for k in range(6):
                b[i] += J[k, i] * e[k]
            for j in range(n):
                A[i, j] = damping if i == j else 0.0
                if i == held or j == held:
                    A[i, j] = 1.0 if i == j else 0.0
                    continue
                for k in range(6):
                    A[i, j] += J[k, i] * J[k, j]
            if i == held:
                b[i] = 0.0
        solve_symmetric(A, b)
        longest = 0.0
        for i in range(n):
            longest = max(longest, abs(b[i]))
        scale = _LONGEST_STEP / longest if longest > _LONGEST_STEP else 1.0
        for i in range(n):
            q[i] += scale * b[i]
    _pose_and_jacobian(placements, axes, T_last_tip, q, T, J, lines)
    return bool(_error(T, R, t, e) < EXACT * EXACT)


@njit(cache=True)
def _pose_and_jacobian(
    placements: Array, axes: Array, T_last_tip: Array, q: Array, tip: Array, J: Array, lines: Array
) -> None:
    """Fill tip (4, 4) and its geometric Jacobian J (6, n) of one posture q (n); lines (2, n, 3) is spoilt."""
    chain_state(placements, axes, T_last_tip, q, lines[0], lines[1], tip)
    jacobian_at(lines[0], lines[1], tip[:3, 3], J)


@njit(cache=True)
def solve_symmetric(A: Array, b: Array) -> None:
    """b (n) becomes the x of A x = b with a positive definite A (n, n), which is spoilt (Cholesky)."""
    n = b.size
    for j in range(n):
        for i in range(j, n):
            for k in range(j):
                A[i, j] -= A[i, k] * A[j, k]
            if i == j:
                A[j, j] = np.sqrt(max(A[j, j], _LEAST_DAMPING))
            else:
                A[i, j] /= A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]


@njit(cache=True)
def _error(T: Array, R: Array, t: Array, e: Array) -> float:
    """Fill e (6) with the way from pose T to (R, t): shift [m], then turn [rad] as a vector; its squared length."""
    D = np.empty((3, 3))  # R T^T
    for i in range(3):
        e[i] = t[i] - T[i, 3]
        for j in range(3):
            D[i, j] = R[i, 0] * T[j, 0] + R[i, 1] * T[j, 1] + R[i, 2] * T[j, 2]
    e[3], e[4], e[5] = 0.5 * (D[2, 1] - D[1, 2]), 0.5 * (D[0, 2] - D[2, 0]), 0.5 * (D[1, 0] - D[0, 1])
    sine = np.sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])
    angle = np.arctan2(sine, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    scale = angle / sine if sine > 1e-12 else 1.0
    square = 0.0
    for i in range(3):
        e[3 + i] *= scale
        square += e[i] * e[i] + e[3 + i] * e[3 + i]
    return square
