"""Serial chains: forward kinematics and geometric Jacobians of many postures at once, compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


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


@njit(cache=True)
def chain_poses(placements: Array, axes: Array, T_last_tip: Array, q: Array) -> Array:
    """Compiled body of `Chain.poses`."""
    m, n = q.shape
    out = np.empty((m, 4, 4))
    R = np.empty((3, 3))
    before, after = np.eye(4), np.eye(4)
    for k in range(m):
        after[:] = 0.0
        for i in range(4):
            after[i, i] = 1.0
        for i in range(n):
            mul4(after, placements[i], before)
            rotate_about(axes[i], q[k, i], R)
            turn(before, R, after)
        mul4(after, T_last_tip, out[k])
    return out


@njit(cache=True, nogil=True)
def chain_jacobians(placements: Array, axes: Array, T_last_tip: Array, q: Array) -> Array:
    """Compiled body of `Chain.jacobians`."""
    m, n = q.shape
    out = np.empty((m, 6, n))
    origins = np.empty((n, 3))
    directions = np.empty((n, 3))
    R = np.empty((3, 3))
    before, after, tip = np.eye(4), np.eye(4), np.eye(4)
    for k in range(m):
        after[:] = 0.0
        for i in range(4):
            after[i, i] = 1.0
        for i in range(n):
            mul4(after, placements[i], before)
            for j in range(3):
                directions[i, j] = before[j, 0] * axes[i, 0] + before[j, 1] * axes[i, 1] + before[j, 2] * axes[i, 2]
                origins[i, j] = before[j, 3]
            rotate_about(axes[i], q[k, i], R)
            turn(before, R, after)
        mul4(after, T_last_tip, tip)
        for i in range(n):
            z = directions[i]
            x, y, w = tip[0, 3] - origins[i, 0], tip[1, 3] - origins[i, 1], tip[2, 3] - origins[i, 2]
            out[k, 0, i] = z[1] * w - z[2] * y
            out[k, 1, i] = z[2] * x - z[0] * w
            out[k, 2, i] = z[0] * y - z[1] * x
            out[k, 3, i], out[k, 4, i], out[k, 5, i] = z[0], z[1], z[2]
    return out


@njit(cache=True)
def chain_state(
    placements: Array, axes: Array, T_last_tip: Array, q: Array, origins: Array, directions: Array, T_tip: Array,
    before: Array, after: Array, R: Array,
) -> None:  # fmt: skip
    """Fill origins, directions (n, 3) of the joints and T_tip (4, 4) for one posture; the last three are room."""
    after[:] = 0.0
    for i in range(4):
        after[i, i] = 1.0
    for i in range(q.size):
        mul4(after, placements[i], before)
        for j in range(3):
            directions[i, j] = before[j, 0] * axes[i, 0] + before[j, 1] * axes[i, 1] + before[j, 2] * axes[i, 2]
            origins[i, j] = before[j, 3]
        rotate_about(axes[i], q[i], R)
        turn(before, R, after)
    mul4(after, T_last_tip, T_tip)


@njit(cache=True)
def jacobian_at(origins: Array, directions: Array, p: Array, J: Array) -> None:
    """Fill J (6, n), linear rows first, at a point p (3), from what `chain_state` gives."""
    for j in range(J.shape[1]):
        d = directions[j]
        x, y, w = p[0] - origins[j, 0], p[1] - origins[j, 1], p[2] - origins[j, 2]
        J[0, j] = d[1] * w - d[2] * y
        J[1, j] = d[2] * x - d[0] * w
        J[2, j] = d[0] * y - d[1] * x
        J[3, j], J[4, j], J[5, j] = d[0], d[1], d[2]
