"""Compiled body of `seven_axes`: frames, symbols and the order of the parameters are explained there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags
from planner.base.compiled import inner_njit, njit
from planner.cell.kinematics.axes import REACH_ROUNDING, STRAIGHT, between, inverse_of, wrap
from planner.cell.kinematics.chain import mul4

BRANCHES = 8
ELBOW_NEGATIVE, SHOULDER_OTHER, WRIST_OTHER = 4, 2, 1  # bits of a branch number
THIRD, SEVENTH = 2, 6  # the joints that can be given, counted from 0
_ASIDE = 1e-8  # m by which rounding can move a point off the axis that a straight elbow turns it about


@inner_njit
def _euler(R: Array, first: Array) -> None:
    """Fill first (3) with the angles of R = Rz(first0) Ry(first1) Rz(first2), first1 >= 0; first0 = 0 if straight."""
    sine = np.sqrt(R[0, 2] * R[0, 2] + R[1, 2] * R[1, 2])
    first[1] = np.arctan2(sine, R[2, 2])
    first[0] = np.arctan2(R[1, 2], R[0, 2]) if sine > STRAIGHT else 0.0
    # from the first angle, not from R's last row: exact however straight it is
    s, c = np.sin(first[0]), np.cos(first[0])
    first[2] = np.arctan2(c * R[1, 0] - s * R[0, 0], c * R[1, 1] - s * R[0, 1])


@inner_njit
def _identity(A: Array) -> None:
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = 1.0 if i == j else 0.0


@inner_njit
def _times_ry(R: Array, angle: float) -> None:
    """R (3, 3) becomes R Ry(angle)."""
    s, c = np.sin(angle), np.cos(angle)
    for i in range(3):
        R[i, 0], R[i, 2] = c * R[i, 0] - s * R[i, 2], s * R[i, 0] + c * R[i, 2]


@inner_njit
def _times_rz(R: Array, angle: float) -> None:
    """R (3, 3) becomes R Rz(angle)."""
    s, c = np.sin(angle), np.cos(angle)
    for i in range(3):
        R[i, 0], R[i, 1] = c * R[i, 0] + s * R[i, 1], c * R[i, 1] - s * R[i, 0]


@inner_njit
def _wrist_centre(p: Array, given: float, F: Array, W: Array) -> None:
    """Fill W (3) with the wrist in the shoulder's frame; F (4, 4), the frame on axis 7, is turned back by theta_7
    where that is given."""
    if p[45] == SEVENTH:
        _times_rz(F[:3, :3], -(given + p[12]))
    for i in range(3):
        W[i] = F[i, 3] - p[4] * F[i, 0] - p[5] * F[i, 1]


@inner_njit
def _elbow_of(p: Array) -> tuple[float, float, float]:
    """Constant and amplitude of |SW|^2 = constant + amplitude cos(theta_4 - middle), and the middle."""
    a3, d3, a4, d5 = p[0], p[1], p[2], p[3]
    cosine, sine = 2.0 * (a3 * a4 + d3 * d5), 2.0 * (a3 * d5 - d3 * a4)
    return a3 * a3 + d3 * d3 + a4 * a4 + d5 * d5, np.sqrt(cosine * cosine + sine * sine), np.arctan2(sine, cosine)


@njit
def solve_one(p: Array, given: float, R: Array, t: Array, q: Array, ok: Flags) -> None:
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


@inner_njit
def _given_seventh(
    p: Array, given: float, G: Array, W: Array, th4: float, wx: float, wz: float, q: Array, ok: Flags
) -> None:
    """The four postures q (4, 7) of one elbow angle; G is the frame before theta_7."""
    s4, c4 = np.sin(th4), np.cos(th4)
    ex, ez = -(c4 * wx - s4 * wz), -(s4 * wx + c4 * wz)  # the shoulder seen from the wrist, before theta_5
    vx = -(G[0, 0] * W[0] + G[1, 0] * W[1] + G[2, 0] * W[2])  # and seen from the hand, after theta_6
    vy = -(G[0, 1] * W[0] + G[1, 1] * W[1] + G[2, 1] * W[2])
    vz = -(G[0, 2] * W[0] + G[1, 2] * W[1] + G[2, 2] * W[2])
    x2 = ex * ex - vy * vy
    if abs(vy) > abs(ex) + _ASIDE:
        return
    side = 1.0 if ex > 0.0 else -1.0
    R, angles = np.empty((3, 3)), np.empty(3)
    for wrist in range(2):
        x = np.sqrt(max(x2, 0.0)) * (1.0 if wrist == 0 else -1.0)
        th6 = np.arctan2(x, ez) - np.arctan2(vx, vz)
        th5 = np.arctan2(-vy * side, x * side)
        for i in range(3):
            for j in range(3):
                R[i, j] = G[i, j]
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


@inner_njit
def _given_third(
    p: Array, given: float, F: Array, W: Array, th4: float, wx: float, wz: float, q: Array, ok: Flags
) -> None:
    """The four postures q (4, 7) of one elbow angle; F is the frame after theta_7."""
    th3 = given + p[8]
    ux, uy = wx * np.cos(th3), wx * np.sin(th3)  # the wrist after theta_2
    rho2 = W[0] * W[0] + W[1] * W[1]
    x2 = rho2 - uy * uy
    if abs(uy) > np.sqrt(rho2) + _ASIDE:
        return
    R, T, angles = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for shoulder in range(2):
        x = np.sqrt(max(x2, 0.0)) * (1.0 if shoulder == 0 else -1.0)
        th2 = np.arctan2(x, W[2]) - np.arctan2(ux, wz)
        th1 = np.arctan2(W[1], W[0]) - np.arctan2(uy, x) if rho2 > 0.0 else 0.0
        _identity(R)
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


@njit
def solve(p: Array, given: Array, T: Array) -> tuple[Array, Flags]:
    """All branches' joints (m, BRANCHES, 7) [rad] for flange poses T (m, 4, 4) in the arm's base, and which of them
    exist (m, BRANCHES). given (m): the redundant joint [rad]; p: see `solve_one`."""
    m = T.shape[0]
    q = np.zeros((m, BRANCHES, 7))
    ok = np.zeros((m, BRANCHES), dtype=np.bool_)
    for i in range(m):
        solve_one(p, given[i], T[i, :3, :3], T[i, :3, 3], q[i], ok[i])
    return q, ok


@njit
def poses(p: Array, q: Array) -> Array:
    """Flange poses (n, 4, 4) in the arm's base at postures q (n, 7) [rad]."""
    T_base_shoulder = inverse_of(p[13:29])
    T_7_flange = inverse_of(p[29:45])
    out = np.empty((q.shape[0], 4, 4))
    F, T = np.empty((4, 4)), np.empty((4, 4))
    for k in range(q.shape[0]):
        _identity(F)
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


@njit
def branches(p: Array, q: Array) -> NDArray[np.int8]:
    """Branches (n) of postures q (n, 7) [rad], as `solve` numbers them."""
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


@njit
def out_of_reach(p: Array, given: Array, T: Array) -> Array:
    """How far (n) [m] the wrist centre of flange poses T (n, 4, 4) is out of reach, with the redundant joint given (n)
    [rad]; 0 within reach."""
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
