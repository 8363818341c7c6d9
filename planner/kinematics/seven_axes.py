"""Closed-form inverse kinematics of seven-axis arms with a spherical shoulder, for one joint's angle given.

Neighbouring axes are square to each other; axes 1, 2, 3 meet in the shoulder S, axes 5 and 6 in the wrist W. With
theta_i = q_i + offset, the frame on axis 7 is in the shoulder's frame (origin S, z along axis 1, y along axis 2)

    Rz(th1) Ry(th2) Rz(th3) (a3, 0, d3) Ry(th4) (a4, 0, d5) Rz(th5) Ry(th6) (a6, y6, 0) Rz(th7)

Given th7 (Panda, and any other): W is known, the distance SW gives th4 (two), S seen from the wrist gives th6 (two)
and th5, the rest is Rz Ry Rz and gives th1, th2, th3 (two). So He and Liu, "Analytical inverse kinematics for
Franka Emika Panda", 2021, by another geometry. Given th3 (a6 = y6 = 0, such as LBR iiwa): W is known from the pose
alone, SW gives th4, the height of W gives th2 (two) and th1, the rest is Rz Ry Rz and gives th5, th6, th7 (two).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kinematics.axes import (
    REACH_ROUNDING,
    STRAIGHT,
    OtherGeometry,
    about_y,
    about_z,
    at,
    axes_at_zero,
    between,
    from_zy,
    wrap,
)
from planner.kinematics.chain import Chain, mul4

Array = NDArray[np.float64]
BRANCHES = 8
ELBOW_NEGATIVE, SHOULDER_OTHER, WRIST_OTHER = 4, 2, 1  # bits of a branch number
_LENGTHS, _OFFSETS, _SHOULDER, _FRAME_7 = 6, 13, 29, 45  # ends of the pieces of the parameters
THIRD, SEVENTH = 2, 6  # the joints that can be given, counted from 0
_SAME = 1e-7  # m


@dataclass(frozen=True)
class SevenAxes:
    """Lengths [m] and angle offsets of an arm; poses are those of the flange in the arm's base frame.

    parameters       (46): a3, d3, a4, d5, a6, y6; offsets (7) of theta = q + offset; T_shoulder_base (16) and
                     T_flange_7 (16) by rows; redundant_joint once more, for the kernel
    redundant_joint  index of the joint whose angle is given from outside: 2 or 6
    rest             its angle where nobody gives one [rad]
    """

    parameters: Array
    redundant_joint: int
    rest: float = 0.0

    @property
    def joints(self) -> int:
        """Seven."""
        return 7

    @property
    def branch_count(self) -> int:
        """Eight for each angle of the redundant joint."""
        return BRANCHES

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, 7)."""
        return _poses(self.parameters, np.ascontiguousarray(q))

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All eight postures q (m, 8, 7) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, 8).

        redundant (m) are the redundant joint's angles [rad], `rest` if not given. The index of a posture is its
        branch number: 4 elbow bent the negative way; with joint 7 given, 2 theta_2 negative, 1 the shoulder behind
        axis 6, seen from the hand; with joint 3 given, 2 wrist behind axis 1, 1 theta_6 negative. Joint limits are
        not looked at. Where two axes fall into one, the first joint of the two (of 5 and 7: joint 5) is at the
        zero of its theta.
        """
        return _solve(self.parameters, self._given(T_base_flange, redundant), np.ascontiguousarray(T_base_flange))

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, 7)."""
        return _branches(self.parameters, np.ascontiguousarray(q))

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the wrist lies outside what the arm reaches with these redundant angles [m]; 0 within."""
        given = self._given(T_base_flange, redundant)
        return _out_of_reach(self.parameters, given, np.ascontiguousarray(T_base_flange))

    def track(self, T_base_flange: Array, redundant: Array, q_start: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Postures q (m, 7) along a path of poses (m, 4, 4) on the branch of q_start (7), and where they exist (m).

        Joints are continuous in whole turns, from q_start on; the last posture is held where there is none.
        """
        solutions, exists = self.solve(T_base_flange, redundant)
        branch = int(self.branches(q_start[None])[0])
        return _continued(solutions[:, branch], exists[:, branch], q_start), exists[:, branch]

    def _given(self, T: Array, redundant: Array | None) -> Array:
        return np.full(len(T), self.rest) if redundant is None else np.ascontiguousarray(redundant, dtype=np.float64)


def read_seven_axes(chain: Chain, redundant_joint: int) -> SevenAxes:
    """Read lengths and offsets off a chain from base to flange; OtherGeometry if it is not of this kind."""
    if len(chain) != 7:
        raise OtherGeometry(f"it has {len(chain)} joints, not 7")
    lines, T_base_flange = axes_at_zero(chain)
    T = T_base_shoulder = from_zy(lines.meet(0, 1), lines.directions[0], lines.directions[1])
    local = lines.seen_from(T)
    local.square(1, 2)
    if np.linalg.norm(np.cross(local.points[2], local.directions[2])) > _SAME:
        raise OtherGeometry("axes 1, 2, 3 do not meet in one point")
    offsets = np.zeros(7)
    for i in range(1, 6):  # theta_i turns the frame so that its z (even i: its y) is the axis of joint i + 1
        local = lines.seen_from(T)
        local.square(i, i + 1)
        x, y, z = local.directions[i + 1]
        offsets[i] = np.arctan2(x, z) if i % 2 else np.arctan2(-x, y)
        T = T @ (about_y(offsets[i]) if i % 2 else about_z(offsets[i]))
        if i == 2:
            a3, _, d3 = lines.seen_from(T).points[3]
            T = T @ at(a3, 0.0, d3)
        elif i == 3:
            local = lines.seen_from(T)
            a4, aside, _ = local.points[4]
            d5 = local.meet(4, 5)[2]
            if abs(aside) > _SAME:
                raise OtherGeometry("the forearm's axis passes beside the elbow's plane")
            T = T @ at(a4, 0.0, d5)
    a6, y6, _ = lines.seen_from(T).points[6]
    if redundant_joint not in (THIRD, SEVENTH):
        raise OtherGeometry("the redundant joint can be joint 3 or joint 7")
    if redundant_joint == THIRD and np.hypot(a6, y6) > _SAME:
        raise OtherGeometry("axes 5, 6, 7 do not meet in one point: the redundant joint can only be joint 7")
    T_flange_7 = np.linalg.inv(T_base_flange) @ T @ at(a6, y6, 0.0)
    lengths = [a3, d3, a4, d5, a6, y6]
    frames = [np.linalg.inv(T_base_shoulder).ravel(), T_flange_7.ravel()]
    return SevenAxes(np.concatenate([lengths, offsets, *frames, [redundant_joint]]), redundant_joint)


def _continued(q: Array, ok: NDArray[np.bool_], q_start: Array) -> Array:
    """Postures q (m, n) with whole turns added so that each is next to the one before; held where not ok."""
    out = np.empty_like(q)
    before = q_start
    for i in range(len(q)):
        if ok[i]:
            before = before + np.remainder(q[i] - before + np.pi, 2.0 * np.pi) - np.pi
        out[i] = before
    return out


@njit(cache=True)
def _euler(R: Array, first: Array) -> None:
    """Fill first (3) with the angles of R = Rz(first0) Ry(first1) Rz(first2), first1 >= 0; first0 = 0 if straight."""
    sine = np.sqrt(R[0, 2] * R[0, 2] + R[1, 2] * R[1, 2])
    first[1] = np.arctan2(sine, R[2, 2])
    first[0] = np.arctan2(R[1, 2], R[0, 2]) if sine > STRAIGHT else 0.0
    # from the first angle, not from R's last row: exact however straight it is
    s, c = np.sin(first[0]), np.cos(first[0])
    first[2] = np.arctan2(c * R[1, 0] - s * R[0, 0], c * R[1, 1] - s * R[0, 1])


@njit(cache=True)
def _times_ry(R: Array, angle: float) -> None:
    """R (3, 3) becomes R Ry(angle)."""
    s, c = np.sin(angle), np.cos(angle)
    for i in range(3):
        R[i, 0], R[i, 2] = c * R[i, 0] - s * R[i, 2], s * R[i, 0] + c * R[i, 2]


@njit(cache=True)
def _times_rz(R: Array, angle: float) -> None:
    """R (3, 3) becomes R Rz(angle)."""
    s, c = np.sin(angle), np.cos(angle)
    for i in range(3):
        R[i, 0], R[i, 1] = c * R[i, 0] + s * R[i, 1], c * R[i, 1] - s * R[i, 0]


@njit(cache=True)
def _wrist_centre(p: Array, given: float, F: Array, W: Array) -> None:
    """Fill W (3) with the wrist in the shoulder's frame; F (4, 4), the frame on axis 7, is turned back by theta_7
    where that is given."""
    if p[45] == SEVENTH:
        _times_rz(F[:3, :3], -(given + p[12]))
    for i in range(3):
        W[i] = F[i, 3] - p[4] * F[i, 0] - p[5] * F[i, 1]


@njit(cache=True)
def _elbow_of(p: Array) -> tuple[float, float, float]:
    """Constant and amplitude of |SW|^2 = constant + amplitude cos(theta_4 - middle), and the middle."""
    a3, d3, a4, d5 = p[0], p[1], p[2], p[3]
    cosine, sine = 2.0 * (a3 * a4 + d3 * d5), 2.0 * (a3 * d5 - d3 * a4)
    return a3 * a3 + d3 * d3 + a4 * a4 + d5 * d5, np.sqrt(cosine * cosine + sine * sine), np.arctan2(sine, cosine)


@njit(cache=True)
def solve_one(p: Array, given: float, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (8, 7) and ok (8) with the postures for one flange pose, rotation R (3, 3) and origin t (3), with the
    redundant joint's angle given."""
    ok[:] = False
    F, room, W = np.empty((4, 4)), np.empty((2, 4, 4)), np.empty(3)
    between(p[13:29].reshape(4, 4), R, t, p[29:45].reshape(4, 4), room, F)
    _wrist_centre(p, given, F, W)
    constant, amplitude, middle = _elbow_of(p)
    cosine = (W[0] * W[0] + W[1] * W[1] + W[2] * W[2] - constant) / amplitude
    if not abs(cosine) <= 1.0 + REACH_ROUNDING:
        return
    bend = np.arctan2(np.sqrt(max(1.0 - cosine * cosine, 0.0)), cosine)
    for elbow in range(2):
        th4 = middle + (bend if elbow == 0 else -bend)
        s4, c4 = np.sin(th4), np.cos(th4)
        # the wrist seen from the shoulder, in the frame before theta_4
        wx, wz = p[0] + p[2] * c4 + p[3] * s4, p[1] - p[2] * s4 + p[3] * c4
        i = ELBOW_NEGATIVE * elbow
        if p[45] == SEVENTH:
            _given_seventh(p, given, F, W, th4, wx, wz, q[i : i + 4], ok[i : i + 4])
        else:
            _given_third(p, given, F, W, th4, wx, wz, q[i : i + 4], ok[i : i + 4])


@njit(cache=True)
def _given_seventh(p, given, G, W, th4, wx, wz, q, ok):
    """The four postures q (4, 7) of one elbow angle; G is the frame before theta_7."""
    s4, c4 = np.sin(th4), np.cos(th4)
    ex, ez = -(c4 * wx - s4 * wz), -(s4 * wx + c4 * wz)  # the shoulder seen from the wrist, before theta_5
    vx = -(G[0, 0] * W[0] + G[1, 0] * W[1] + G[2, 0] * W[2])  # and seen from the hand, after theta_6
    vy = -(G[0, 1] * W[0] + G[1, 1] * W[1] + G[2, 1] * W[2])
    vz = -(G[0, 2] * W[0] + G[1, 2] * W[1] + G[2, 2] * W[2])
    x2 = ex * ex - vy * vy
    if x2 < -REACH_ROUNDING * (ex * ex + ez * ez):
        return
    side = 1.0 if ex > 0.0 else -1.0
    R, angles = np.empty((3, 3)), np.empty(3)
    for wrist in range(2):
        x = np.sqrt(max(x2, 0.0)) * (1.0 if wrist == 0 else -1.0)
        th6 = np.arctan2(x, ez) - np.arctan2(vx, vz)
        th5 = np.arctan2(-vy * side, x * side)
        R[:, :] = G[:3, :3]
        _times_ry(R, -th6)
        _times_rz(R, -th5)
        _times_ry(R, -th4)
        _euler(R, angles)
        for shoulder in range(2):
            i = SHOULDER_OTHER * shoulder + WRIST_OTHER * wrist
            turn = np.pi * shoulder
            q[i, 0], q[i, 1], q[i, 2] = angles[0] + turn, angles[1] * (1.0 - 2.0 * shoulder), angles[2] + turn
            q[i, 3], q[i, 4], q[i, 5] = th4, th5, th6
            for j in range(6):
                q[i, j] = wrap(q[i, j] - p[6 + j])
            q[i, 6] = wrap(given)
            ok[i] = True


@njit(cache=True)
def _given_third(p, given, F, W, th4, wx, wz, q, ok):
    """The four postures q (4, 7) of one elbow angle; F is the frame after theta_7."""
    th3 = given + p[8]
    ux, uy = wx * np.cos(th3), wx * np.sin(th3)  # the wrist after theta_2
    rho2 = W[0] * W[0] + W[1] * W[1]
    x2 = rho2 - uy * uy
    if x2 < -REACH_ROUNDING * (rho2 + W[2] * W[2]):
        return
    R, T, angles = np.eye(3), np.empty((3, 3)), np.empty(3)
    for shoulder in range(2):
        x = np.sqrt(max(x2, 0.0)) * (1.0 if shoulder == 0 else -1.0)
        th2 = np.arctan2(x, W[2]) - np.arctan2(ux, wz)
        th1 = np.arctan2(W[1], W[0]) - np.arctan2(uy, x) if rho2 > 0.0 else 0.0
        R[:, :] = np.eye(3)
        _times_rz(R, th1)
        _times_ry(R, th2)
        _times_rz(R, th3)
        _times_ry(R, th4)
        for i in range(3):
            for j in range(3):
                T[i, j] = R[0, i] * F[0, j] + R[1, i] * F[1, j] + R[2, i] * F[2, j]
        _euler(T, angles)
        for wrist in range(2):
            i = SHOULDER_OTHER * shoulder + WRIST_OTHER * wrist
            turn = np.pi * wrist
            q[i, 0], q[i, 1], q[i, 3] = th1, th2, th4
            q[i, 4], q[i, 5], q[i, 6] = angles[0] + turn, angles[1] * (1.0 - 2.0 * wrist), angles[2] + turn
            for j in range(7):
                q[i, j] = wrap(q[i, j] - p[6 + j])
            q[i, 2] = wrap(given)
            ok[i] = True


@njit(cache=True)
def _solve(p: Array, given: Array, T: Array) -> tuple[Array, NDArray[np.bool_]]:
    m = T.shape[0]
    q = np.zeros((m, BRANCHES, 7))
    ok = np.zeros((m, BRANCHES), dtype=np.bool_)
    for i in range(m):
        solve_one(p, given[i], T[i, :3, :3], T[i, :3, 3], q[i], ok[i])
    return q, ok


@njit(cache=True)
def _poses(p: Array, q: Array) -> Array:
    T_base_shoulder = np.linalg.inv(p[13:29].copy().reshape(4, 4))
    T_7_flange = np.linalg.inv(p[29:45].copy().reshape(4, 4))
    out = np.empty((q.shape[0], 4, 4))
    F, T = np.eye(4), np.empty((4, 4))
    for k in range(q.shape[0]):
        F[:, :] = np.eye(4)
        R = F[:3, :3]
        for j in range(7):
            if j % 2 == 0:
                _times_rz(R, q[k, j] + p[6 + j])
            else:
                _times_ry(R, q[k, j] + p[6 + j])
            x = p[0] if j == 2 else p[2] if j == 3 else p[4] if j == 5 else 0.0
            y = p[5] if j == 5 else 0.0
            z = p[1] if j == 2 else p[3] if j == 3 else 0.0
            for i in range(3):
                F[i, 3] += R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
        mul4(T_base_shoulder, F, T)
        mul4(T, T_7_flange, out[k])
    return out


@njit(cache=True)
def _branches(p: Array, q: Array) -> NDArray[np.int8]:
    _, _, middle = _elbow_of(p)
    out = np.empty(q.shape[0], dtype=np.int8)
    for i in range(q.shape[0]):
        th = q[i] + p[6:13]
        s4, c4 = np.sin(th[3]), np.cos(th[3])
        wx, wz = p[0] + p[2] * c4 + p[3] * s4, p[1] - p[2] * s4 + p[3] * c4
        branch = ELBOW_NEGATIVE if wrap(th[3] - middle) < 0.0 else 0
        if p[45] == SEVENTH:
            if wrap(th[1]) < 0.0:
                branch += SHOULDER_OTHER
            if -(c4 * wx - s4 * wz) * np.cos(th[4]) < 0.0:
                branch += WRIST_OTHER
        else:
            if np.cos(th[1]) * np.cos(th[2]) * wx + np.sin(th[1]) * wz < 0.0:
                branch += SHOULDER_OTHER
            if wrap(th[5]) < 0.0:
                branch += WRIST_OTHER
        out[i] = branch
    return out


@njit(cache=True)
def _out_of_reach(p: Array, given: Array, T: Array) -> Array:
    constant, amplitude, middle = _elbow_of(p)
    longest, shortest = np.sqrt(constant + amplitude), np.sqrt(max(constant - amplitude, 0.0))
    out = np.empty(T.shape[0])
    F, room, W = np.empty((4, 4)), np.empty((2, 4, 4)), np.empty(3)
    for k in range(T.shape[0]):
        between(p[13:29].reshape(4, 4), T[k, :3, :3], T[k, :3, 3], p[29:45].reshape(4, 4), room, F)
        _wrist_centre(p, given[k], F, W)
        far2 = W[0] * W[0] + W[1] * W[1] + W[2] * W[2]
        far = np.sqrt(far2)
        out[k] = max(far - longest, shortest - far, 0.0)
        if out[k] > 0.0:
            continue
        bend = np.arccos(min(max((far2 - constant) / amplitude, -1.0), 1.0))
        least = np.inf
        for th4 in (middle + bend, middle - bend):
            s4, c4 = np.sin(th4), np.cos(th4)
            wx, wz = p[0] + p[2] * c4 + p[3] * s4, p[1] - p[2] * s4 + p[3] * c4
            if p[45] == SEVENTH:
                aside = abs(F[0, 1] * W[0] + F[1, 1] * W[1] + F[2, 1] * W[2])
                least = min(least, max(aside - abs(c4 * wx - s4 * wz), 0.0))
            else:
                aside = abs(wx * np.sin(given[k] + p[8]))
                least = min(least, max(aside - np.hypot(W[0], W[1]), 0.0))
        out[k] = least
    return out
