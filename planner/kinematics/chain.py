"""Serial chains: forward kinematics and geometric Jacobians of many postures at once, compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from planner.readonly import Array

Nine = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True)
class Chain:
    """Revolute joints in series, from the world to a tip frame.

    names       (n) joint names
    placements  (n, 4, 4) pose of joint i's frame in the previous link's frame; the first one in the world
    axes        (n, 3) unit joint axes, each in its own joint frame
    T_last_tip  (4, 4) pose of the tip in the last link's frame (in the world, where n = 0)
    """

    names: tuple[str, ...]
    placements: Array
    axes: Array
    T_last_tip: Array

    def __len__(self) -> int:
        return len(self.names)

    @property
    def screws(self) -> Array:
        """A point of each joint's axis and its direction, in the world with all joints at 0 (n, 6) [m]."""
        T, out = np.eye(4), np.empty((len(self), 6))
        for i in range(len(self)):
            T = T @ self.placements[i]
            out[i] = *T[:3, 3], *(T[:3, :3] @ self.axes[i])
        return out

    def poses(self, q: Array) -> Array:
        """Tip poses T_world_tip (m, 4, 4) of postures q (m, n) [rad]."""
        return chain_poses(self.placements, self.axes, self.T_last_tip, np.ascontiguousarray(q))

    def jacobians(self, q: Array) -> Array:
        """Geometric Jacobians (m, 6, n) at the tip, world axes, linear rows first [m/rad, rad/rad]."""
        return chain_jacobians(self.placements, self.axes, self.T_last_tip, np.ascontiguousarray(q))


@njit(cache=True)
def rotate_about(axis: Array, angle: float, R: Array) -> None:
    """Fill R (at least 3, 3) with the rotation about a unit axis (Rodrigues)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    t = 1.0 - c
    R[0, 0], R[0, 1], R[0, 2] = t * x * x + c, t * x * y - s * z, t * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = t * x * y + s * z, t * y * y + c, t * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = t * x * z - s * y, t * y * z + s * x, t * z * z + c


@njit(cache=True)
def mul4(A: Array, B: Array, C: Array) -> None:
    """Fill C (4, 4) with the product of two rigid transforms; C is neither of them."""
    for i in range(3):
        for j in range(4):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        C[i, 3] += A[i, 3]
    C[3, 0], C[3, 1], C[3, 2], C[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True)
def pose_of(R: Array, t: Array, T: Array) -> None:
    """Fill T (4, 4) with the rigid transform of a rotation R (3, 3) and an origin t (3)."""
    for i in range(3):
        for j in range(3):
            T[i, j] = R[i, j]
        T[i, 3] = t[i]
    T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True)
def turn(T: Array, R: Array, out: Array) -> None:
    """Fill out (4, 4) with the rigid transform T, its frame turned by the rotation R (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = T[i, 0] * R[0, j] + T[i, 1] * R[1, j] + T[i, 2] * R[2, j]
        out[i, 3] = T[i, 3]
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _times(R: Nine, S: Nine) -> Nine:
    """The product of two matrices (3, 3), row by row."""
    return (
        R[0] * S[0] + R[1] * S[3] + R[2] * S[6], R[0] * S[1] + R[1] * S[4] + R[2] * S[7], R[0] * S[2] + R[1] * S[5] + R[2] * S[8],
        R[3] * S[0] + R[4] * S[3] + R[5] * S[6], R[3] * S[1] + R[4] * S[4] + R[5] * S[7], R[3] * S[2] + R[4] * S[5] + R[5] * S[8],
        R[6] * S[0] + R[7] * S[3] + R[8] * S[6], R[6] * S[1] + R[7] * S[4] + R[8] * S[7], R[6] * S[2] + R[7] * S[5] + R[8] * S[8],
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def chain_state(
    placements: Array, axes: Array, T_last_tip: Array, q: Array, origins: Array, directions: Array, T_tip: Array
) -> None:
    """Fill origins, directions (n, 3) of the joints and T_tip (4, 4) for one posture.

    The pose on the way stays in the processor's registers: as arrays it would take twice as long.
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


@njit(cache=True, nogil=True, error_model="numpy")
def jacobian_at(origins: Array, directions: Array, p: Array, J: Array) -> None:
    """Fill J (6, n), linear rows first, at a point p (3), from what `chain_state` gives."""
    for j in range(J.shape[1]):
        d = directions[j]
        x, y, w = p[0] - origins[j, 0], p[1] - origins[j, 1], p[2] - origins[j, 2]
        J[0, j] = d[1] * w - d[2] * y
        J[1, j] = d[2] * x - d[0] * w
        J[2, j] = d[0] * y - d[1] * x
        J[3, j], J[4, j], J[5, j] = d[0], d[1], d[2]


@njit(cache=True, nogil=True)
def chain_poses(placements: Array, axes: Array, T_last_tip: Array, q: Array) -> Array:
    """Compiled body of `Chain.poses`."""
    m, n = q.shape
    out = np.empty((m, 4, 4))
    origins, directions = np.empty((n, 3)), np.empty((n, 3))
    for k in range(m):
        chain_state(placements, axes, T_last_tip, q[k], origins, directions, out[k])
    return out


@njit(cache=True, nogil=True)
def chain_jacobians(placements: Array, axes: Array, T_last_tip: Array, q: Array) -> Array:
    """Compiled body of `Chain.jacobians`."""
    m, n = q.shape
    out = np.empty((m, 6, n))
    origins, directions, T_tip = np.empty((n, 3)), np.empty((n, 3)), np.empty((4, 4))
    for k in range(m):
        chain_state(placements, axes, T_last_tip, q[k], origins, directions, T_tip)
        jacobian_at(origins, directions, T_tip[:3, 3], out[k])
    return out
