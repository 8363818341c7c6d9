"""Orientations as three angles, in the conventions of controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from planner.base.arrays import Array

LEVEL = 1e-9  # sine or cosine below which two of the angles turn about the same axis (gimbal lock)


def fixed_xyz(R: Array) -> Array:
    """Turns about fixed x, y, z (m, 3) [rad] of rotations (m, 3, 3): R = Rz Ry Rx. x is 0 where y is a right angle."""
    level = np.hypot(R[:, 0, 0], R[:, 1, 0])
    upright = level < LEVEL
    z = np.where(upright, np.arctan2(-R[:, 0, 1], R[:, 1, 1]), np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    x = np.where(upright, 0.0, np.arctan2(R[:, 2, 1], R[:, 2, 2]))
    return np.column_stack([x, np.arctan2(-R[:, 2, 0], level), z])


def from_fixed_xyz(angles: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of turns about fixed x, y, z (m, 3) [rad]."""
    x, y, z = (_about(axis, angles[:, axis]) for axis in range(3))
    return product(product(z, y), x)


def turning_xyz(R: Array) -> Array:
    """Turns about x, then the new y, then the new z (m, 3) [rad]: R = Rx Ry Rz. x is 0 where y is a right angle."""
    back = fixed_xyz(R.transpose(0, 2, 1))  # of the inverse, whose turns come in reverse order
    level = np.hypot(R[:, 0, 0], R[:, 0, 1])
    upright = level < LEVEL
    x = np.where(upright, 0.0, np.arctan2(-R[:, 1, 2], R[:, 2, 2]))
    z = np.where(upright, np.arctan2(R[:, 1, 0], R[:, 1, 1]), -back[:, 2])
    return np.column_stack([x, np.arctan2(R[:, 0, 2], level), z])


def from_turning_xyz(angles: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of turns about x, the new y and the new z (m, 3) [rad]."""
    x, y, z = (_about(axis, angles[:, axis]) for axis in range(3))
    return product(product(x, y), z)


def turning_zyz(R: Array) -> Array:
    """Turns about z, the new y, the new z (m, 3) [rad]: R = Rz Ry Rz. The first is 0 where the second is 0 or pi."""
    level = np.hypot(R[:, 0, 2], R[:, 1, 2])
    straight = level < LEVEL
    o = np.where(straight, 0.0, np.arctan2(R[:, 1, 2], R[:, 0, 2]))
    t = np.where(straight, np.arctan2(R[:, 1, 0], R[:, 1, 1]), np.arctan2(R[:, 2, 1], -R[:, 2, 0]))
    return np.column_stack([o, np.arctan2(level, R[:, 2, 2]), t])


def from_turning_zyz(angles: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of turns about z, the new y, the new z (m, 3) [rad]."""
    o, a, t = (_about(axis, angles[:, k]) for k, axis in enumerate((2, 1, 2)))
    return product(product(o, a), t)


def read_pose(values: Iterable[str | float], of_angles: Callable[[Array], Array]) -> Array:
    """x y z [m], quaternion x y z w (7) from x y z [mm] and three angles [deg], which `of_angles` converts."""
    numbers = [float(value) for value in values]
    return np.concatenate([np.array(numbers[:3]) * 1e-3, of_angles(np.radians([numbers[3:]]))[0]])


def written(angles: Array, decimals: int) -> Array:
    """Angles [rad] in degrees, rounded; half a turn is always positive, so that all processors give the same value."""
    out: Array = np.round(np.degrees(angles), decimals).astype(np.float64) + 0.0
    out[out == -180.0] = 180.0
    return out


def product(a: Array, b: Array) -> Array:
    """Quaternion products a b (m, 4) x y z w: turn a, then turn b about the axes as turned by a."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.column_stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def _about(axis: int, angle: Array) -> Array:
    """Quaternions (m, 4) of turns about a coordinate axis (m) [rad]."""
    out = np.zeros((len(angle), 4))
    out[:, axis], out[:, 3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
    return out
