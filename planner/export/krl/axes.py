"""KUKA's way to count: axes A1 to A6, angles A B C, Status and Turn.

Axes: at KUKA's zero the arm lies stretched out forwards, and A1, A4, A6 turn against our joints (ROS-Industrial,
kuka_experimental, whose URDF files follow the controllers). Angles: R = Rz(A) Ry(B) Rx(C).

Status: bit 0 is set where the wrist's centre lies behind axis 1, bit 1 where A3 is beyond the stretched arm (0 without
an offset between axes 3 and 4, else less by as much as that offset turns the forearm), bit 2 where A5 is negative
(Siemens, SINUMERIK ONE programming manual 6FC5398-2EP40, STAT, which has KUKA's bits). ISG has bit 2 the other way
round; a controller that reads it so finds A5's sign in Turn as well. Turn: bit i - 1 is set where axis i is negative.
LIN ignores both; they decide how a program is entered at a target, and PTP targets are axis angles here.
"""

from __future__ import annotations

import numpy as np

from planner.readonly import Array, Indices

SIGNS = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
OFFSETS = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
# bits of a branch, which are those of ABB's cfx (`Trajectory.branch`)
BEHIND_AXIS_1, BEHIND_LOWER_ARM, AXIS_5_NEGATIVE = 4, 2, 1


def to_kuka(q: Array) -> Array:
    """A1 to A6 (m, 6) [rad] of our joints (m, 6)."""
    out: Array = SIGNS * q + OFFSETS
    return out


def from_kuka(axes: Array) -> Array:
    """Our joints (m, 6) of A1 to A6 (m, 6) [rad]."""
    out: Array = SIGNS * (axes - OFFSETS)
    return out


def status(branch: Indices) -> Indices:
    """Status (m) of branches (m)."""
    behind, below, flipped = (branch & bit > 0 for bit in (BEHIND_AXIS_1, BEHIND_LOWER_ARM, AXIS_5_NEGATIVE))
    out: Indices = behind * 1 + ~below * 2 + flipped * 4
    return out


def branch_of(status_: Indices) -> Indices:
    """Branches (m) of Status (m)."""
    out: Indices = (
        (status_ & 1 > 0) * BEHIND_AXIS_1 + (status_ & 2 == 0) * BEHIND_LOWER_ARM + (status_ & 4 > 0) * AXIS_5_NEGATIVE
    )
    return out


def turn(q: Array) -> Indices:
    """Turn (m) of our joints (m, 6)."""
    out: Indices = (np.round(to_kuka(q), 9) < 0.0) @ (1 << np.arange(6))
    return out


def angles(R: Array) -> Array:
    """A B C (m, 3) [rad] of rotations (m, 3, 3); C is 0 where B is a right angle, and A and C are one."""
    level = np.hypot(R[:, 0, 0], R[:, 1, 0])
    upright = level < 1e-9
    a = np.where(upright, np.arctan2(-R[:, 0, 1], R[:, 1, 1]), np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    c = np.where(upright, 0.0, np.arctan2(R[:, 2, 1], R[:, 2, 2]))
    return np.column_stack([a, np.arctan2(-R[:, 2, 0], level), c])


def quaternions(abc: Array) -> Array:
    """Unit quaternions (m, 4) x y z w of A B C (m, 3) [rad]."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(0.5 * abc).T, np.sin(0.5 * abc).T
    return np.column_stack(
        [
            ca * cb * sc - sa * sb * cc,
            ca * sb * cc + sa * cb * sc,
            sa * cb * cc - ca * sb * sc,
            ca * cb * cc + sa * sb * sc,
        ]
    )
