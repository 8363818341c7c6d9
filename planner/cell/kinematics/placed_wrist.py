"""Six-axis arms with a spherical wrist as URDFs have them: any zero, axis senses and frames; lengths read off the axes.

Axes 2 and 3 are parallel and square to axis 1; axes 4, 5, 6 meet in the wrist's centre, neighbours square to each
other. Between a frame on axis 1 and one on axis 6, such an arm is that of `spherical_wrist`, its joints counted as
theta_i = +-q_i + offset: upper arm upright and forearm level at 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.cell.kinematics import spherical_wrist
from planner.cell.kinematics.axes import (
    JointAxes,
    OtherGeometry,
    SixJoints,
    about_y,
    about_z,
    axes_at_zero,
    between,
    from_zy,
    inverse_of,
    wrap,
)
from planner.cell.kinematics.chain import Chain, mul4
from planner.cell.kinematics.spherical_wrist import BRANCHES, SphericalWrist, branch_of, pose_one

_LENGTHS, _SIGNS, _OFFSETS, _BASE, _FLANGE = slice(0, 7), slice(7, 13), slice(13, 19), slice(19, 35), slice(35, 51)
_NEAR = 5e-3  # m: axes of a wrist pass each other by no more than this, as in a measured arm
_SHORTEST = 1e-3  # m: least length of an upper arm, and of a forearm
_SAME = 1e-12  # rad and m: rounding by which frames and offsets may differ from those of `SphericalWrist`
_solve_one = spherical_wrist.solve_one


@dataclass(frozen=True)
class PlacedWrist(SixJoints):
    """An arm with a spherical wrist between two frames; poses are those of the flange in the arm's base frame.

    parameters  (51): the seven lengths of `SphericalWrist` [m]; signs (6) and offsets (6) of theta = sign * q + offset;
                T_foot_base (16) and T_flange_end (16) by rows: foot and end are the frames of `SphericalWrist`
    """

    parameters: Array

    @property
    def arm(self) -> SphericalWrist:
        """The arm as if its joints were counted as theta, from foot to end."""
        return SphericalWrist(*self.parameters[_LENGTHS].tolist())

    @property
    def usual(self) -> bool:
        """Whether it is just `arm`: base, flange, zero and senses are those of a `SphericalWrist`."""
        same = np.concatenate([np.zeros(6), np.eye(4).ravel(), np.eye(4).ravel()])
        return bool((self.signs == 1.0).all() and np.abs(self.parameters[13:] - same).max() < _SAME)

    @property
    def signs(self) -> Array:
        """Senses (6) of the joints, 1 or -1."""
        return self.parameters[_SIGNS]

    @property
    def offsets(self) -> Array:
        """theta (6) at zero [rad]."""
        return self.parameters[_OFFSETS]

    @property
    def T_base_foot(self) -> Array:
        """Pose (4, 4) of the foot of `arm` in the base frame: its z along axis 1."""
        return inverse_of(self.parameters[_BASE])

    @property
    def T_end_flange(self) -> Array:
        """The flange in the frame (4, 4) at the end of `arm`, whose z is axis 6."""
        return inverse_of(self.parameters[_FLANGE])

    def counted(self, q: Array) -> Array:
        """theta (..., 6) of postures q (..., 6) [rad]."""
        return np.asarray(q * self.signs + self.offsets)

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, 6)."""
        return _poses(self.parameters, np.ascontiguousarray(q))

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All eight postures q (m, 8, 6) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, 8).

        Branches are numbered as by `SphericalWrist`, from theta. Joint limits are not checked. With a straight wrist,
        theta_4 is 0.
        """
        return _solve(self.parameters, np.ascontiguousarray(T_base_flange))

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, 6)."""
        return _branches(self.parameters, np.ascontiguousarray(q))

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the wrist centre lies outside the arm's reach on its better shoulder [m]; 0 within."""
        T_flange_end = self.parameters[_FLANGE].reshape(4, 4)
        return self.arm.out_of_reach(self.parameters[_BASE].reshape(4, 4) @ T_base_flange @ T_flange_end)


# ----------------------------------------------------------------------------------------------------
# Reading off a chain. Of the ways to count theta, that of data sheets is used: z up, axis 2 ahead of axis 1, forearm
# forwards, and the rest nearest to the URDF's own zero.


def read_spherical_wrist(chain: Chain, T_base_stand: Array | None = None) -> PlacedWrist:
    """Read lengths, senses and offsets off a chain from base to flange; OtherGeometry if it is not of this kind.

    T_base_stand (4, 4): pose in the chain's base of the arm's own, with which its foot is level; default: identity
    """
    if len(chain) != 6:
        raise OtherGeometry(f"it has {len(chain)} joints, not 6")
    lines, T_base_flange = axes_at_zero(chain)
    for i, j in ((0, 1), (2, 3), (3, 4), (4, 5)):
        lines.square(i, j)
    lines.parallel(1, 2)
    wrist = _wrist_centre(lines)
    T_base_foot, ahead = _foot(lines, np.eye(4) if T_base_stand is None else T_base_stand)
    y = T_base_foot[:3, :3] @ about_z(ahead)[:3, 1]
    signs = np.ones(6)
    signs[0] = _sense(lines.directions[0], T_base_foot[:3, 2])
    signs[1], signs[2] = _sense(lines.directions[1], y), _sense(lines.directions[2], y)
    T_arm = T_base_foot @ about_z(ahead)
    local = lines.seen_from(T_arm)
    (a1, _, c1), (x3, _, z3) = local.points[1], local.points[2]
    centre = T_arm[:3, :3].T @ (wrist - T_arm[:3, 3])
    c2 = float(np.hypot(x3 - a1, z3 - c1))
    theta2 = np.arctan2(x3 - a1, z3 - c1)
    to_wrist = np.array([centre[0] - x3, centre[2] - z3])
    along = local.directions[3][[0, 2]] / np.linalg.norm(local.directions[3][[0, 2]])
    signs[3] = -1.0 if along @ to_wrist < -_SHORTEST else 1.0
    along = signs[3] * along
    theta23 = np.arctan2(along[0], along[1])
    c3, a2 = float(along @ to_wrist), float(along[1] * to_wrist[0] - along[0] * to_wrist[1])
    if c2 < _SHORTEST or np.hypot(c3, a2) < _SHORTEST:
        raise OtherGeometry("axes 2, 3 and the wrist's centre are not three different places")
    T_forearm = T_arm @ about_y(theta23)
    signs[4], theta4 = _fifth(lines.seen_from(T_forearm).directions[4])
    T_bend = T_forearm @ about_z(theta4)
    out = _out_of_flange(lines, T_base_flange, wrist)
    signs[5] = _sense(lines.directions[5], out)
    axis_6 = T_bend[:3, :3].T @ out
    theta5 = np.arctan2(axis_6[0], axis_6[2])
    c4 = float((T_base_flange[:3, 3] - wrist) @ out)
    T_end = T_bend @ about_y(theta5)
    T_end[:3, 3] = wrist + c4 * T_end[:3, 2]
    T_end_flange = np.linalg.inv(T_end) @ T_base_flange
    offsets = np.array([ahead, theta2, theta23 - theta2 - 0.5 * np.pi, theta4, theta5, 0.0])
    offsets = np.array([float(wrap(value)) for value in offsets])
    lengths = np.array([a1, a2, centre[1], c1, c2, c3, c4])
    frames = [np.linalg.inv(T_base_foot).ravel(), np.linalg.inv(T_end_flange).ravel()]
    return PlacedWrist(np.concatenate([lengths, signs, offsets, *frames]))


def _sense(axis: Array, along: Array) -> float:
    """1 if an axis points along a direction, -1 if against it."""
    return 1.0 if axis @ along >= 0.0 else -1.0


def _wrist_centre(lines: JointAxes) -> Array:
    """The point (3) where axes 4, 5 and 6 meet: that nearest to all three. OtherGeometry if they do not."""
    projections = [np.eye(3) - np.outer(d, d) for d in lines.directions[3:]]
    centre = np.linalg.solve(sum(projections), sum(P @ p for P, p in zip(projections, lines.points[3:], strict=True)))
    misses = [np.linalg.norm(P @ (centre - p)) for P, p in zip(projections, lines.points[3:], strict=True)]
    if max(misses) > _NEAR:
        aside = float(np.linalg.norm(lines.meet(3, 4) - lines.meet(4, 5)))
        raise OtherGeometry(
            f"axes 4, 5, 6 do not meet in one point: 4 and 6 are {aside * 1e3:.0f} mm apart along axis 5"
        )
    return np.asarray(centre)


def _foot(lines: JointAxes, T_base_stand: Array) -> tuple[Array, float]:
    """The foot's frame (4, 4) in the base: z along axis 1 and up as seen from the arm's own base, relative to which it
    turns as little as possible; and theta_1 at zero [rad]: the angle from its x to the arm, axis 2 ahead of axis 1."""
    T_base_own = T_base_stand.copy()
    if abs(lines.directions[0] @ T_base_own[:3, 2]) < 0.5:
        T_base_own[:3, :3] = np.eye(3)  # a link that was drawn lying down, which the URDF sets upright
    own = lines.seen_from(T_base_own)
    up = own.directions[0] * _sense(own.directions[0], np.array([0.0, 0.0, 1.0]))
    y = np.array([0.0, 1.0, 0.0]) if abs(up[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    level = own.points[0] - (own.points[0] @ up) * up  # as high as the origin of the arm's own base
    T = T_base_own @ from_zy(level, up, y)
    local = lines.seen_from(T)
    across = local.directions[1]
    a1 = local.points[1] @ np.array([across[1], -across[0], 0.0])
    side = -1.0 if a1 < -_SHORTEST or (abs(a1) <= _SHORTEST and across[1] < 0.0) else 1.0
    across = side * across
    return T, float(np.arctan2(-across[0], across[1]))


def _fifth(axis: Array) -> tuple[float, float]:
    """Sense of axis 5 and theta_4 at zero, from its direction in the forearm's frame: of the two ways to count, the one
    with the smaller angle."""
    theta4 = float(np.arctan2(-axis[0], axis[1]))
    if abs(theta4) <= 0.5 * np.pi + _SAME:
        return 1.0, theta4
    return -1.0, float(wrap(theta4 + np.pi))


def _out_of_flange(lines: JointAxes, T_base_flange: Array, centre: Array) -> Array:
    """Direction (3) of axis 6 out of the flange: along its z, or, if z is square, from the wrist to the flange."""
    axis = lines.directions[5]
    along = float(axis @ T_base_flange[:3, 2])
    if abs(along) < 0.5:
        along = float(axis @ (T_base_flange[:3, 3] - centre))
    return np.asarray(axis if along >= 0.0 else -axis)


# ----------------------------------------------------------------------------------------------------
# Compiled: the arm of `spherical_wrist` between its two frames.


@njit
def solve_one(p: Array, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (8, 6) and ok (8) with the postures for one flange pose, rotation R (3, 3) and origin t (3)."""
    room, T = np.empty((2, 4, 4)), np.empty((4, 4))
    between(p[19:35].reshape(4, 4), R, t, p[35:51].reshape(4, 4), room, T)
    _solve_one(p[:7], T[:3, :3], T[:3, 3], q, ok)
    for k in range(ok.size):
        if ok[k]:
            for j in range(6):
                q[k, j] = wrap(p[7 + j] * (q[k, j] - p[13 + j]))


@njit
def _solve(p: Array, T: Array) -> tuple[Array, NDArray[np.bool_]]:
    m = T.shape[0]
    q = np.zeros((m, BRANCHES, 6))
    ok = np.zeros((m, BRANCHES), dtype=np.bool_)
    for i in range(m):
        solve_one(p, T[i, :3, :3], T[i, :3, 3], q[i], ok[i])
    return q, ok


@njit
def _poses(p: Array, q: Array) -> Array:
    T_base_foot, T_end_flange = inverse_of(p[19:35]), inverse_of(p[35:51])
    out = np.empty((q.shape[0], 4, 4))
    end, T = np.empty((4, 4)), np.empty((4, 4))
    for i in range(q.shape[0]):
        pose_one(p[:7], p[7:13] * q[i] + p[13:19], end)
        mul4(T_base_foot, end, T)
        mul4(T, T_end_flange, out[i])
    return out


@njit
def _branches(p: Array, q: Array) -> NDArray[np.int8]:
    out = np.empty(q.shape[0], dtype=np.int8)
    for i in range(q.shape[0]):
        out[i] = branch_of(p[:7], p[7:13] * q[i] + p[13:19])
    return out
