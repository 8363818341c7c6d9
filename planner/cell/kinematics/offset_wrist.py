"""Closed-form inverse kinematics of six-axis arms with an offset wrist (Universal Robots): all branches, compiled.

Axis 1 meets axis 2; axes 2, 3, 4 are parallel; axis 4 meets axis 5 and axis 5 meets axis 6, each time square to it.
With theta_i = +-q_i + offset, the frame K at the crossing of axes 5 and 6, its y along axis 6, has in the shoulder's
frame (crossing of axes 1 and 2, z along axis 1) the pose

    R = Rz(th1) Ry(phi) Rz(th5) Ry(th6),                        phi = th2 + th3 + th4
    p = Rz(th1) (a2 sin th2 + a3 sin th23 + d5 sin phi, d4, a2 cos th2 + a3 cos th23 + d5 cos phi)

The shoulder's y coordinate of p gives th1 (two solutions), the y row of Rz(-th1) R gives th5 (two) and th6, the rest of
it phi, and a triangle in the plane of the upper arm and the forearm remains (two). Hawkins, "Analytic inverse
kinematics for the Universal Robots UR-5/UR-10 arms", 2013, takes the same steps with Denavit-Hartenberg matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import njit
from planner.cell.kinematics.axes import (
    REACH_ROUNDING,
    STRAIGHT,
    OtherGeometry,
    SixJoints,
    about_y,
    about_z,
    at,
    axes_at_zero,
    between,
    from_zy,
    inverse_of,
    wrap,
)
from planner.cell.kinematics.chain import Chain, mul4

BRANCHES = 8
BEHIND_AXIS_1, ELBOW_NEGATIVE, AXIS_5_NEGATIVE = 4, 2, 1  # bits of a branch number


@dataclass(frozen=True)
class OffsetWrist(SixJoints):
    """Lengths [m] and angle offsets of an arm; poses are those of the flange in the arm's base frame.

    parameters  (48): a2, a3, d4, d5; signs (6) and offsets (6) of theta = sign * q + offset;
                T_shoulder_base (16) and T_flange_k (16) by rows
    """

    parameters: Array

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, 6)."""
        return _poses(self.parameters, np.ascontiguousarray(q))

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All eight postures q (m, 8, 6) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, 8).

        The index of a posture is its branch number: 4 wrist behind axis 1, 2 elbow bent the negative way, 1 axis 5
        negative; angles as theta above. Joint limits are not checked. Where axis 6 is parallel to axes 2, 3, 4, there
        are infinitely many postures; the one with q6 = 0 (or pi) is returned if it is within reach.
        """
        return _solve(self.parameters, np.ascontiguousarray(T_base_flange))

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, 6)."""
        return _branches(self.parameters, np.ascontiguousarray(q))

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """By how much (m) the arm is too short or too long, on its better shoulder and wrist [m]; 0 within reach."""
        return _out_of_reach(self.parameters, np.ascontiguousarray(T_base_flange))


def read_offset_wrist(chain: Chain) -> OffsetWrist:
    """Read lengths and offsets off a chain from base to flange; OtherGeometry if it is not of this kind."""
    if len(chain) != 6:
        raise OtherGeometry(f"it has {len(chain)} joints, not 6")
    lines, T_base_flange = axes_at_zero(chain)
    T_base_shoulder = from_zy(lines.meet(0, 1), lines.directions[0], lines.directions[1])
    lines = lines.seen_from(T_base_shoulder)
    signs = np.ones(6)
    signs[2], signs[3] = lines.parallel(1, 2), lines.parallel(1, 3)
    (x3, _, z3), (x4, _, z4) = lines.points[2], lines.points[3]
    Q, P = lines.meet(3, 4), lines.meet(4, 5)
    a2, a3 = np.hypot(x3, z3), np.hypot(x4 - x3, z4 - z3)
    if min(a2, a3) < 1e-3:
        raise OtherGeometry("axes 2, 3 and 4 are not three distinct lines")
    th2, th23 = np.arctan2(x3, z3), np.arctan2(x4 - x3, z4 - z3)
    phi = np.arctan2(lines.directions[4, 0], lines.directions[4, 2])
    d4, d5 = Q[1], (P - Q) @ lines.directions[4]
    axis_6 = about_y(phi)[:3, :3].T @ lines.directions[5]
    th5 = np.arctan2(-axis_6[0], axis_6[1])
    offsets = np.array([0.0, th2, th23 - th2, phi - th23, th5, 0.0])
    T_shoulder_k = at(*P) @ about_y(phi) @ about_z(th5)
    T_flange_k = np.linalg.inv(T_base_flange) @ T_base_shoulder @ T_shoulder_k
    T_shoulder_base = np.linalg.inv(T_base_shoulder)
    return OffsetWrist(np.concatenate([[a2, a3, d4, d5], signs, offsets, T_shoulder_base.ravel(), T_flange_k.ravel()]))


@njit
def solve_one(p: Array, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (8, 6) and ok (8) with the postures for one flange pose, rotation R (3, 3) and origin t (3)."""
    a2, a3, d4, d5 = p[0], p[1], p[2], p[3]
    sign, offset = p[4:10], p[10:16]
    ok[:] = False
    K, room = np.empty((4, 4)), np.empty((2, 4, 4))
    between(p[16:32].reshape(4, 4), R, t, p[32:48].reshape(4, 4), room, K)
    x, y, z = K[0, 3], K[1, 3], K[2, 3]
    radial2 = x * x + y * y - d4 * d4
    if radial2 < -REACH_ROUNDING * (x * x + y * y):
        return
    radius = np.sqrt(max(radial2, 0.0))
    lead, skew = np.arctan2(y, x), np.arctan2(d4, radius)
    for shoulder in range(2):
        th1 = lead - skew if shoulder == 0 else lead + skew - np.pi
        radial = radius if shoulder == 0 else -radius
        s1, c1 = np.sin(th1), np.cos(th1)
        # y row of Rz(-th1) R: sin th5 cos th6, cos th5, sin th5 sin th6
        r0, r1, r2 = c1 * K[1, 0] - s1 * K[0, 0], c1 * K[1, 1] - s1 * K[0, 1], c1 * K[1, 2] - s1 * K[0, 2]
        sin5 = np.sqrt(r0 * r0 + r2 * r2)
        for wrist in range(2):
            th5 = np.arctan2(sin5, r1)
            th6 = np.arctan2(r2, r0) if sin5 > STRAIGHT else 0.0
            if wrist == 1:
                th5, th6 = -th5, th6 + np.pi
            s6, c6 = np.sin(th6), np.cos(th6)
            # phi from th6, not independently: exact however close to parallel axes 6 and 4 are
            sin_phi = c6 * (c1 * K[0, 2] + s1 * K[1, 2]) - s6 * (c1 * K[0, 0] + s1 * K[1, 0])
            cos_phi = c6 * K[2, 2] - s6 * K[2, 0]
            phi = np.arctan2(sin_phi, cos_phi)
            across, up = radial - d5 * np.sin(phi), z - d5 * np.cos(phi)
            cos3 = (across * across + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
            if abs(cos3) > 1.0 + REACH_ROUNDING:
                continue
            sin3 = np.sqrt(max(1.0 - cos3 * cos3, 0.0))
            for elbow in range(2):
                th3 = np.arctan2(sin3 if elbow == 0 else -sin3, cos3)
                th2 = np.arctan2(across, up) - np.arctan2(a3 * np.sin(th3), a2 + a3 * np.cos(th3))
                i = BEHIND_AXIS_1 * shoulder + ELBOW_NEGATIVE * elbow + AXIS_5_NEGATIVE * wrist
                q[i, 0], q[i, 1], q[i, 2] = th1, th2, th3
                q[i, 3], q[i, 4], q[i, 5] = phi - th2 - th3, th5, th6
                for j in range(6):
                    q[i, j] = wrap(sign[j] * (q[i, j] - offset[j]))
                ok[i] = True


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
    a2, a3, d4, d5 = p[0], p[1], p[2], p[3]
    T_base_shoulder = inverse_of(p[16:32])
    T_k_flange = inverse_of(p[32:48])
    out = np.empty((q.shape[0], 4, 4))
    K, T = np.zeros((4, 4)), np.empty((4, 4))
    K[3, 3] = 1.0
    for i in range(q.shape[0]):
        th = p[4:10] * q[i] + p[10:16]
        th23 = th[1] + th[2]
        phi = th23 + th[3]
        s1, c1, s, c = np.sin(th[0]), np.cos(th[0]), np.sin(phi), np.cos(phi)
        s5, c5, s6, c6 = np.sin(th[4]), np.cos(th[4]), np.sin(th[5]), np.cos(th[5])
        # Rz(th1) Ry(phi) by Rz(th5) Ry(th6), whose columns are (c5 c6, s5 c6, -s6), (-s5, c5, 0), (c5 s6, s5 s6, c6)
        for k, (x, y, z) in enumerate(((c1 * c, -s1, c1 * s), (s1 * c, c1, s1 * s), (-s, 0.0, c))):
            K[k, 0], K[k, 1], K[k, 2] = (
                x * c5 * c6 + y * s5 * c6 - z * s6,
                y * c5 - x * s5,
                x * c5 * s6 + y * s5 * s6 + z * c6,
            )
        radial = a2 * np.sin(th[1]) + a3 * np.sin(th23) + d5 * s
        K[0, 3], K[1, 3] = c1 * radial - s1 * d4, s1 * radial + c1 * d4
        K[2, 3] = a2 * np.cos(th[1]) + a3 * np.cos(th23) + d5 * c
        mul4(T_base_shoulder, K, T)
        mul4(T, T_k_flange, out[i])
    return out


@njit
def _branches(p: Array, q: Array) -> NDArray[np.int8]:
    out = np.empty(q.shape[0], dtype=np.int8)
    for i in range(q.shape[0]):
        th = p[4:10] * q[i] + p[10:16]
        th23 = th[1] + th[2]
        branch = 0
        if p[0] * np.sin(th[1]) + p[1] * np.sin(th23) + p[3] * np.sin(th23 + th[3]) < 0.0:
            branch += BEHIND_AXIS_1
        if wrap(th[2]) < 0.0:
            branch += ELBOW_NEGATIVE
        if wrap(th[4]) < 0.0:
            branch += AXIS_5_NEGATIVE
        out[i] = branch
    return out


@njit
def _out_of_reach(p: Array, T: Array) -> Array:
    a2, a3, d4, d5 = p[0], p[1], p[2], p[3]
    out = np.empty(T.shape[0])
    K, room = np.empty((4, 4)), np.empty((2, 4, 4))
    for i in range(T.shape[0]):
        between(p[16:32].reshape(4, 4), T[i, :3, :3], T[i, :3, 3], p[32:48].reshape(4, 4), room, K)
        x, y, z = K[0, 3], K[1, 3], K[2, 3]
        rho = np.sqrt(x * x + y * y)
        radius = np.sqrt(max(rho * rho - d4 * d4, 0.0))
        lead, skew = np.arctan2(y, x), np.arctan2(d4, radius)
        out[i] = np.inf
        for shoulder in range(2):
            th1 = lead - skew if shoulder == 0 else lead + skew - np.pi
            radial = radius if shoulder == 0 else -radius
            s1, c1 = np.sin(th1), np.cos(th1)
            th6 = np.arctan2(c1 * K[1, 2] - s1 * K[0, 2], c1 * K[1, 0] - s1 * K[0, 0])
            s6, c6 = np.sin(th6), np.cos(th6)
            sin_phi = c6 * (c1 * K[0, 2] + s1 * K[1, 2]) - s6 * (c1 * K[0, 0] + s1 * K[1, 0])
            cos_phi = c6 * K[2, 2] - s6 * K[2, 0]
            for side in (1.0, -1.0):
                far = np.hypot(radial - side * d5 * sin_phi, z - side * d5 * cos_phi)
                gap = max(far - (a2 + a3), abs(a2 - a3) - far, 0.0)
                out[i] = min(out[i], max(gap, abs(d4) - rho))
    return out
