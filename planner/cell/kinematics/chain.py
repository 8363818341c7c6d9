"""Serial chains: forward kinematics, Jacobians and Newton's method for many postures at once, compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags
from planner.base.compiled import inner_njit, njit

# ----------------------------------------------------------------------------------------------------
# Six by six matrices, compiled: the inverse, and an estimate of the largest singular value.

_SINGULAR = 1e-12  # pivot below which a matrix has no inverse
_SQUARINGS = 3


@inner_njit
def invert6(A: Array, B: Array) -> bool:
    """Fill B with the inverse of A (6, 6), which is overwritten; False if A is singular to rounding (Gauss-Jordan, in
    place: a column that has become one of the unit matrix is replaced by one of the inverse)."""
    for k in range(6):
        best, most = k, abs(A[k, k])
        for i in range(k + 1, 6):
            if abs(A[i, k]) > most:
                best, most = i, abs(A[i, k])
        if not most >= _SINGULAR:
            return False
        B[0, k] = best  # noted here until B is filled
        if best != k:
            for j in range(6):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        scale = 1.0 / A[k, k]
        A[k, k] = 1.0
        for j in range(6):
            A[k, j] *= scale
        for i in range(6):
            if i != k:
                f = A[i, k]
                A[i, k] = 0.0
                for j in range(6):
                    A[i, j] -= f * A[k, j]
    for k in range(5, -1, -1):  # rows swapped in A are columns to swap in the inverse
        best = int(B[0, k])
        if best != k:
            for i in range(6):
                A[i, k], A[i, best] = A[i, best], A[i, k]
    for i in range(6):
        for j in range(6):
            B[i, j] = A[i, j]
    return True


@inner_njit
def largest_singular_value(B: Array, M: Array, S: Array) -> float:
    """Largest singular value of B (6, 6), up to 2 % too low, for prices only; M, S (6, 6) are scratch.

    The column of (B B^T)^8 with the greatest diagonal entry is close to the dominant singular vector; a Rayleigh
    quotient with it gives the value.
    """
    for i in range(6):
        for j in range(6):
            S[i, j], M[i, j] = B[j, i], 0.0
    for i in range(6):  # whole rows, since a processor adds several numbers at once, but not to each other
        for k in range(6):
            b = B[i, k]
            for j in range(6):
                M[i, j] += b * S[k, j]
    for _ in range(_SQUARINGS):
        trace = 0.0
        for i in range(6):
            trace += M[i, i]
        for i in range(6):
            for j in range(6):
                S[i, j] = 0.0
            for k in range(6):
                m = M[i, k]
                for j in range(6):
                    S[i, j] += m * M[k, j]
        scale = 1.0 / (trace * trace)
        for i in range(6):
            for j in range(6):
                M[i, j] = S[i, j] * scale
    best = 0
    for i in range(6):
        if M[i, i] > M[best, best]:
            best = i
    above, below = 0.0, 0.0
    for i in range(6):
        below += M[i, best] * M[i, best]
        w = 0.0
        for k in range(6):
            w += B[k, i] * M[k, best]
        above += w * w
    return np.sqrt(above / below)


# ----------------------------------------------------------------------------------------------------
# Serial chains: forward kinematics and geometric Jacobians of many postures at once, compiled.

Nine = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True)
class Chain:
    """Joints in series, from the world to a tip frame.

    Attributes:
        names: Names (n) of the joints.
        placements: Pose (n, 4, 4) of each joint's frame in the previous link's frame; the first one in the world.
        axes: Motion (n, 6) of each joint in its own frame: the unit axis that it turns about (3) and zeros, or zeros
            and the unit direction that it slides along (3).
        T_last_tip: Pose (4, 4) of the tip in the last link's frame (in the world, where n = 0).
    """

    names: tuple[str, ...]
    placements: Array
    axes: Array
    T_last_tip: Array

    def __len__(self) -> int:
        return len(self.names)

    @property
    def slides(self) -> Flags:
        """Which joints (n,) slide, so that their positions are in metres."""
        return np.asarray(~self.axes[:, :3].any(axis=1))

    @property
    def screws(self) -> Array:
        """A point on each joint's axis and its direction, in the world with all joints at 0 (n, 6) [m]."""
        T, out = np.eye(4), np.empty((len(self), 6))
        for i in range(len(self)):
            T = T @ self.placements[i]
            out[i] = *T[:3, 3], *(T[:3, :3] @ (self.axes[i, 3:] if self.slides[i] else self.axes[i, :3]))
        return out

    def poses(self, q: Array) -> Array:
        """Tip poses in the world.

        Args:
            q: Postures (m, n) [rad; m for sliding joints].

        Returns:
            T_world_tip (m, 4, 4) for each posture.
        """
        return chain_poses(self.placements, self.axes, self.T_last_tip, np.ascontiguousarray(q))

    def jacobians(self, q: Array) -> Array:
        """Geometric Jacobians at the tip, world axes, linear rows first.

        Args:
            q: Postures (m, n) [rad; m for sliding joints].

        Returns:
            Jacobians (m, 6, n) [m and rad per rad or m].
        """
        return chain_jacobians(self.placements, self.axes, self.T_last_tip, np.ascontiguousarray(q))


def joint_move(axis: Array, q: float) -> Array:
    """Transform (4, 4) of a joint at an angle or position q [rad, m]; axis (6) as in Chain."""
    T = np.eye(4)
    if axis[:3].any():
        rotate_about(axis[:3], q, T)
    T[:3, 3] = q * axis[3:]
    return T


@njit
def rotate_about(axis: Array, angle: float, R: Array) -> None:
    """Fill R (at least 3, 3) with the rotation about a unit axis (Rodrigues)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    t = 1.0 - c
    R[0, 0], R[0, 1], R[0, 2] = t * x * x + c, t * x * y - s * z, t * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = t * x * y + s * z, t * y * y + c, t * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = t * x * z - s * y, t * y * z + s * x, t * z * z + c


@inner_njit
def mul4(A: Array, B: Array, C: Array) -> None:
    """Fill C (4, 4) with the product of two rigid transforms; C is neither of them."""
    for i in range(3):
        for j in range(4):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        C[i, 3] += A[i, 3]
    C[3, 0], C[3, 1], C[3, 2], C[3, 3] = 0.0, 0.0, 0.0, 1.0


@inner_njit
def pose_of(R: Array, t: Array, T: Array) -> None:
    """Fill T (4, 4) with the rigid transform of a rotation R (3, 3) and an origin t (3)."""
    for i in range(3):
        for j in range(3):
            T[i, j] = R[i, j]
        T[i, 3] = t[i]
    T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0


@inner_njit
def turn(T: Array, R: Array, out: Array) -> None:
    """Fill out (4, 4) with the rigid transform T, its frame turned by the rotation R (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = T[i, 0] * R[0, j] + T[i, 1] * R[1, j] + T[i, 2] * R[2, j]
        out[i, 3] = T[i, 3]
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@inner_njit
def _times(R: Nine, S: Nine) -> Nine:
    """The product of two matrices (3, 3), row by row."""
    return (
        R[0] * S[0] + R[1] * S[3] + R[2] * S[6], R[0] * S[1] + R[1] * S[4] + R[2] * S[7], R[0] * S[2] + R[1] * S[5] + R[2] * S[8],
        R[3] * S[0] + R[4] * S[3] + R[5] * S[6], R[3] * S[1] + R[4] * S[4] + R[5] * S[7], R[3] * S[2] + R[4] * S[5] + R[5] * S[8],
        R[6] * S[0] + R[7] * S[3] + R[8] * S[6], R[6] * S[1] + R[7] * S[4] + R[8] * S[7], R[6] * S[2] + R[7] * S[5] + R[8] * S[8],
    )  # fmt: skip


@inner_njit
def chain_state(
    placements: Array, axes: Array, T_last_tip: Array, q: Array, origins: Array, directions: Array, T_tip: Array
) -> None:
    """Fill origins, directions (n, 3) of the joints and T_tip (4, 4) for one posture.

    For a sliding joint, the direction, which is that of rotation, is 0, and the origin is the shift per metre of
    travel. The pose so far stays in the processor's registers: as arrays, this would take twice as long.
    """
    n = q.size
    R = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    t0, t1, t2 = 0.0, 0.0, 0.0
    for i in range(n + 1):
        P = placements[i] if i < n else T_last_tip
        x, y, z = P[0, 3], P[1, 3], P[2, 3]
        t0 += R[0] * x + R[1] * y + R[2] * z
        t1 += R[3] * x + R[4] * y + R[5] * z
        t2 += R[6] * x + R[7] * y + R[8] * z
        R = _times(R, (P[0, 0], P[0, 1], P[0, 2], P[1, 0], P[1, 1], P[1, 2], P[2, 0], P[2, 1], P[2, 2]))
        if i == n:
            break
        x, y, z = axes[i, 0], axes[i, 1], axes[i, 2]
        if x == 0.0 and y == 0.0 and z == 0.0:
            x, y, z = axes[i, 3], axes[i, 4], axes[i, 5]
            x, y, z = R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z
            origins[i, 0], origins[i, 1], origins[i, 2] = x, y, z
            directions[i, 0], directions[i, 1], directions[i, 2] = 0.0, 0.0, 0.0
            t0, t1, t2 = t0 + q[i] * x, t1 + q[i] * y, t2 + q[i] * z
            continue
        origins[i, 0], origins[i, 1], origins[i, 2] = t0, t1, t2
        directions[i, 0] = R[0] * x + R[1] * y + R[2] * z
        directions[i, 1] = R[3] * x + R[4] * y + R[5] * z
        directions[i, 2] = R[6] * x + R[7] * y + R[8] * z
        c, s = np.cos(q[i]), np.sin(q[i])
        u, v, w = (1.0 - c) * x, (1.0 - c) * y, (1.0 - c) * z
        turned = (
            u * x + c, u * y - s * z, u * z + s * y,
            u * y + s * z, v * y + c, v * z - s * x,
            u * z - s * y, v * z + s * x, w * z + c,
        )  # fmt: skip
        R = _times(R, turned)
    T_tip[0, 0], T_tip[0, 1], T_tip[0, 2], T_tip[0, 3] = R[0], R[1], R[2], t0
    T_tip[1, 0], T_tip[1, 1], T_tip[1, 2], T_tip[1, 3] = R[3], R[4], R[5], t1
    T_tip[2, 0], T_tip[2, 1], T_tip[2, 2], T_tip[2, 3] = R[6], R[7], R[8], t2
    T_tip[3, 0], T_tip[3, 1], T_tip[3, 2], T_tip[3, 3] = 0.0, 0.0, 0.0, 1.0


@inner_njit
def jacobian_at(origins: Array, directions: Array, p: Array, J: Array) -> None:
    """Fill J (6, n), linear rows first, at a point p (3), from the results of `chain_state`."""
    for j in range(J.shape[1]):
        d = directions[j]
        if d[0] == 0.0 and d[1] == 0.0 and d[2] == 0.0:
            J[0, j], J[1, j], J[2, j] = origins[j, 0], origins[j, 1], origins[j, 2]
            J[3, j], J[4, j], J[5, j] = 0.0, 0.0, 0.0
            continue
        x, y, w = p[0] - origins[j, 0], p[1] - origins[j, 1], p[2] - origins[j, 2]
        J[0, j] = d[1] * w - d[2] * y
        J[1, j] = d[2] * x - d[0] * w
        J[2, j] = d[0] * y - d[1] * x
        J[3, j], J[4, j], J[5, j] = d[0], d[1], d[2]


@njit
def chain_poses(placements: Array, axes: Array, T_last_tip: Array, q: Array) -> Array:
    """Compiled body of `Chain.poses`."""
    m, n = q.shape
    out = np.empty((m, 4, 4))
    origins, directions = np.empty((n, 3)), np.empty((n, 3))
    for k in range(m):
        chain_state(placements, axes, T_last_tip, q[k], origins, directions, out[k])
    return out


@njit
def chain_jacobians(placements: Array, axes: Array, T_last_tip: Array, q: Array) -> Array:
    """Compiled body of `Chain.jacobians`."""
    m, n = q.shape
    out = np.empty((m, 6, n))
    origins, directions, T_tip = np.empty((n, 3)), np.empty((n, 3)), np.empty((4, 4))
    for k in range(m):
        chain_state(placements, axes, T_last_tip, q[k], origins, directions, T_tip)
        jacobian_at(origins, directions, T_tip[:3, 3], out[k])
    return out


# ----------------------------------------------------------------------------------------------------
# Newton's method on a chain, compiled: find a posture for a pose from one nearby.
#
# Damped as by Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method", 2011: the
# damping falls with the squared error, so that the last steps are plain Newton's.

EXACT = 1e-11  # m and rad: with an error below this, a posture has the pose
_LEAST_DAMPING = 1e-13
_LONGEST_STEP = 0.5  # rad in one joint


@inner_njit
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
    """Change q (n) until its pose has rotation R (3, 3) and origin t (3); return whether it got there.

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


@inner_njit
def _pose_and_jacobian(
    placements: Array, axes: Array, T_last_tip: Array, q: Array, tip: Array, J: Array, lines: Array
) -> None:
    """Fill tip (4, 4) and its geometric Jacobian J (6, n) for one posture q (n); lines (2, n, 3) is scratch."""
    chain_state(placements, axes, T_last_tip, q, lines[0], lines[1], tip)
    jacobian_at(lines[0], lines[1], tip[:3, 3], J)


@inner_njit
def solve_symmetric(A: Array, b: Array) -> None:
    """Replace b (n) by the solution x of A x = b; A (n, n), positive definite, is overwritten (Cholesky)."""
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


@inner_njit
def _error(T: Array, R: Array, t: Array, e: Array) -> float:
    """Fill e (6) with the error from pose T to (R, t): shift [m], then rotation vector [rad]; its squared length."""
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
