"""Joint axes of a chain as lines in space, and small helpers for angles and frames that the closed forms share.

The closed forms of `offset_wrist` and `seven_axes` read their lengths and angle offsets off these lines, so that
neither the zero posture of a URDF nor the orientation of its link frames matters to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.kinematics.chain import Chain, mul4

TURN = 2.0 * np.pi
STRAIGHT = 1e-9  # sine below which two axes count as one; only the sum of their angles is defined there
REACH_ROUNDING = 1e-10  # a cosine up to this far beyond 1 means a stretched arm, not a pose out of reach
_NEAR = 5e-3  # m: axes that should meet may pass each other by this much, as in a measured arm
_SQUARE = 0.02  # rad: tolerance of axes that should be square or parallel


class OtherGeometry(ValueError):
    """The arm is not of the kind that a closed form requires; the message says which axes do not fit."""


class SixJoints:
    """Properties that arms of six joints share; for most poses, a closed form finds eight postures."""

    @property
    def joints(self) -> int:
        """Six."""
        return 6

    @property
    def branch_count(self) -> int:
        """Eight."""
        return 8

    @property
    def redundant_joint(self) -> int | None:
        """None: six joints, six coordinates of a pose."""
        return None


@dataclass(frozen=True)
class JointAxes:
    """Joint axes at the zero posture in some frame: points (n, 3) on them [m], unit directions (n, 3).

    Axes that should be square, be parallel or meet need do so only nearly, as in a measured arm.
    """

    points: Array
    directions: Array

    def seen_from(self, frame: Array) -> JointAxes:
        """The same lines in the coordinates of a frame (4, 4) that is given in the current one."""
        R, origin = frame[:3, :3], frame[:3, 3]
        return JointAxes((self.points - origin) @ R, self.directions @ R)

    def meet(self, i: int, j: int, near: float = _NEAR) -> Array:
        """Point (3) on axis i where it meets axis j, to which it is square; OtherGeometry if it passes axis j by more
        than `near` [m]."""
        self.square(i, j)
        apart = self.points[j] - self.points[i]
        gap = abs(apart @ np.cross(self.directions[i], self.directions[j]))
        if gap > near:
            raise OtherGeometry(f"axes {i + 1} and {j + 1} pass each other by {gap * 1e3:.1f} mm")
        return np.asarray(self.points[i] + (apart @ self.directions[i]) * self.directions[i])

    def square(self, i: int, j: int) -> None:
        """Raise OtherGeometry unless axes i and j are square to each other."""
        if abs(self.directions[i] @ self.directions[j]) > _SQUARE:
            raise OtherGeometry(f"axes {i + 1} and {j + 1} are not square to each other")

    def parallel(self, i: int, j: int) -> float:
        """1 if axes i and j point the same way, -1 if opposite ways; OtherGeometry otherwise."""
        if np.linalg.norm(np.cross(self.directions[i], self.directions[j])) > _SQUARE:
            raise OtherGeometry(f"axes {i + 1} and {j + 1} are not parallel")
        return float(np.sign(self.directions[i] @ self.directions[j]))


def axes_at_zero(chain: Chain) -> tuple[JointAxes, Array]:
    """A chain's joint axes and its tip pose (4, 4) at zero, both in the frame that the chain starts from.

    Points are those nearest to that frame's origin: measured arms have link frames hundreds of metres away.
    """
    T = np.eye(4)
    points, directions = [], []
    for placement, axis in zip(chain.placements, chain.axes, strict=True):
        T = T @ placement
        along = T[:3, :3] @ axis[:3]
        points.append(T[:3, 3] - (T[:3, 3] @ along) * along)
        directions.append(along)
    return JointAxes(np.array(points), np.array(directions)), T @ chain.T_last_tip


def about_y(angle: float) -> Array:
    """Rotation about y as a transform (4, 4)."""
    T = np.eye(4)
    T[0, 0] = T[2, 2] = np.cos(angle)
    T[0, 2] = np.sin(angle)
    T[2, 0] = -T[0, 2]
    return T


def about_z(angle: float) -> Array:
    """Rotation about z as a transform (4, 4)."""
    T = np.eye(4)
    T[0, 0] = T[1, 1] = np.cos(angle)
    T[1, 0] = np.sin(angle)
    T[0, 1] = -T[1, 0]
    return T


def at(x: float, y: float, z: float) -> Array:
    """Translation as a transform (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def from_zy(origin: Array, z: Array, y: Array) -> Array:
    """Frame (4, 4) by its origin and the directions of z and y, which are nearly square to each other."""
    T = np.eye(4)
    y = y - (y @ z) * z
    y = y / np.linalg.norm(y)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = np.cross(y, z), y, z, origin
    return T


@njit
def wrap(angle: float) -> float:
    """Angle in (-pi, pi]."""
    return angle - TURN * np.ceil((angle - np.pi) / TURN)


@inner_njit
def between(T_left: Array, R: Array, t: Array, T_right: Array, room: Array, out: Array) -> None:
    """Fill out (4, 4) with T_left (R, t) T_right; room (2, 4, 4) is scratch."""
    for i in range(3):
        for j in range(3):
            room[0, i, j] = R[i, j]
        room[0, i, 3] = t[i]
    room[0, 3, 0], room[0, 3, 1], room[0, 3, 2], room[0, 3, 3] = 0.0, 0.0, 0.0, 1.0
    mul4(T_left, room[0], room[1])
    mul4(room[1], T_right, out)


@njit
def inverse_of(T: Array) -> Array:
    """Inverse (4, 4) of a rigid transform (16) by rows."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = T[4 * j + i]
            out[i, 3] -= T[4 * j + i] * T[4 * j + 3]
    out[3, 3] = 1.0
    return out
