"""Six-axis arms with a spherical wrist: all branches in closed form, and the Jacobian with its inverse; compiled."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.kinematics.axes import REACH_ROUNDING, TURN, SixJoints, wrap
from planner.cell.kinematics.chain import Chain

# ----------------------------------------------------------------------------------------------------
# The Jacobian of a spherical-wrist arm, and its inverse, in closed form, compiled.
#
# Joints 1 to 3 alone move the point where the last three axes meet, and joints 4 to 6 only turn about it: the Jacobian
# there is block triangular, and both blocks take only a few lines and angles. Symbols as in the closed form below.

Ten = tuple[float, float, float, float, float, float, float, float, float, float]
_SINGULAR = 1e-12  # m, m^2 or sine: a divisor below this is mere rounding


@inner_njit
def sines_of(q: Array) -> Ten:
    """Sine and cosine of joint 1, joint 2, theta_2 + theta_3, joint 4, and joint 5 of a posture q (6)."""
    theta23 = q[1] + q[2] + 0.5 * np.pi
    return (
        np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1]), np.sin(theta23), np.cos(theta23),
        np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4]),
    )  # fmt: skip


@inner_njit
def jacobian(p: Array, sines: Ten, tip: Array, out: Array) -> None:
    """Fill out (6, 6) with the twist for each joint's rate, linear part first; arguments as in `inverse_jacobian`."""
    a1, a2, b, c1, c2, c3 = p[0], p[1], p[2], p[3], p[4], p[5]
    s1, co1, s2, co2, s23, c23, s4, c4, s5, c5 = sines
    r2, z2 = c2 * s2, c2 * co2
    r3, z3 = a1 + r2 + c3 * s23 + a2 * c23, c1 + z2 + c3 * c23 - a2 * s23  # the wrist's centre
    r, t, z = co1 * tip[0] + s1 * tip[1], co1 * tip[1] - s1 * tip[0], tip[2]
    six_r, six_t, six_z = s5 * c4 * c23 + c5 * s23, s5 * s4, c5 * c23 - s5 * c4 * s23
    # along r, t and z: the direction of each axis, and the vector from a point on it to the tip
    lines = (
        (0.0, 0.0, 1.0, r, t, z),
        (0.0, 1.0, 0.0, r - a1, t, z - c1),
        (0.0, 1.0, 0.0, r - a1 - r2, t, z - c1 - z2),
        (s23, 0.0, c23, r - r3, t - b, z - z3),
        (-s4 * c23, c4, s4 * s23, r - r3, t - b, z - z3),
        (six_r, six_t, six_z, r - r3, t - b, z - z3),
    )
    for j in range(6):
        d_r, d_t, d_z, x, y, w = lines[j]
        v_r, v_t = d_t * w - d_z * y, d_z * x - d_r * w
        out[0, j], out[1, j], out[2, j] = co1 * v_r - s1 * v_t, s1 * v_r + co1 * v_t, d_r * y - d_t * x
        out[3, j], out[4, j], out[5, j] = co1 * d_r - s1 * d_t, s1 * d_r + co1 * d_t, d_z


@inner_njit
def inverse_jacobian(p: Array, sines: Ten, tip: Array, out: Array) -> bool:
    """Fill out (6, 6) with the joints' rates for a twist in the arm's base frame, linear part first.

    p (7) lengths [m]; sines of the posture; tip (3) the point that moves with the flange, in the base frame. False if
    the arm is singular to rounding.
    """
    a1, a2, b, c1, c2, c3 = p[0], p[1], p[2], p[3], p[4], p[5]
    s1, co1, s2, co2, s23, c23, s4, c4, s5, c5 = sines
    # axes r, t, z: away from axis 1, along axis 2, upwards. From elbow and from shoulder to the wrist's centre:
    r3, z3 = c3 * s23 + a2 * c23, c3 * c23 - a2 * s23
    r2, z2 = r3 + c2 * s2, z3 + c2 * co2
    radial = a1 + r2
    plane = z3 * r2 - z2 * r3
    if abs(radial) < _SINGULAR or abs(plane) < _SINGULAR or abs(s5) < _SINGULAR:
        return False
    # from the tip to the wrist's centre
    d_r = radial - (co1 * tip[0] + s1 * tip[1])
    d_t = b - (co1 * tip[1] - s1 * tip[0])
    d_z = c1 + z2 - tip[2]
    # the wrist's axes: joint 4 turns about w, joint 5 about v, joint 6 about s5 u + c5 w
    u_r, u_t, u_z = c4 * c23, s4, -c4 * s23
    v_r, v_t, v_z = -s4 * c23, c4, s4 * s23
    # rates of joints 1 to 3 for a velocity of the wrist's centre along each axis
    r_2, r_3 = -r3 / plane, r2 / plane
    t_1 = 1.0 / radial
    t_2, t_3 = b * t_1 * r_2, b * t_1 * r_3
    z_2, z_3 = -z3 / plane, z2 / plane
    # and of joints 4 to 6, which undo the rotation that comes with that
    back_r, back_t, back_z = -(r_2 + r_3), -(t_2 + t_3), -(z_2 + z_3)
    inv5 = 1.0 / s5
    r_5, r_6 = v_t * back_r, u_t * back_r * inv5
    t_5, t_6 = v_t * back_t - v_z * t_1, (u_t * back_t - u_z * t_1) * inv5
    z_5, z_6 = v_t * back_z, u_t * back_z * inv5
    r_4, t_4, z_4 = -c5 * r_6, -c23 * t_1 - c5 * t_6, -c5 * z_6
    along_r = (0.0, r_2, r_3, r_4, r_5, r_6)
    along_t = (t_1, t_2, t_3, t_4, t_5, t_6)
    along_z = (0.0, z_2, z_3, z_4, z_5, z_6)
    six_r, six_t, six_z = u_r * inv5, u_t * inv5, u_z * inv5
    about_r = (0.0, 0.0, 0.0, s23 - c5 * six_r, v_r, six_r)
    about_t = (0.0, 0.0, 0.0, -c5 * six_t, v_t, six_t)
    about_z = (0.0, 0.0, 0.0, c23 - c5 * six_z, v_z, six_z)
    for j in range(6):
        # a turn about the tip moves the wrist's centre
        turn_r = about_r[j] + d_t * along_z[j] - d_z * along_t[j]
        turn_t = about_t[j] + d_z * along_r[j] - d_r * along_z[j]
        out[j, 0] = co1 * along_r[j] - s1 * along_t[j]
        out[j, 1] = s1 * along_r[j] + co1 * along_t[j]
        out[j, 2] = along_z[j]
        out[j, 3] = co1 * turn_r - s1 * turn_t
        out[j, 4] = s1 * turn_r + co1 * turn_t
        out[j, 5] = about_z[j] + d_r * along_t[j] - d_t * along_r[j]
    return True


# ----------------------------------------------------------------------------------------------------
# Closed-form inverse kinematics of six-axis arms with a spherical wrist: all branches, compiled.
#
# Geometry and symbols after Brandstötter, Angerer, Hofbaur, "An analytical solution of the inverse kinematics
# problem of industrial serial manipulators with an ortho-parallel basis and a spherical wrist", 2014 (OPW).
# The robots' joint 3 is 0 with the forearm horizontal, so theta_3 = q_3 + 90 deg; the other joints are equal.

BRANCHES = 8
BEHIND_AXIS_1, BEHIND_LOWER_ARM, AXIS_5_NEGATIVE = 4, 2, 1  # the bits of a branch number are those of ABB's cfx
ALL_ROUND = 1e3  # rad: a range from -ALL_ROUND to ALL_ROUND is no bound
_STRAIGHT_WRIST = 1e-9  # rad; below it only q4 + q6 is defined, and q4 is set to 0


@dataclass(frozen=True)
class SphericalWrist(SixJoints):
    """OPW parameters [m] of an arm; poses are those of the flange in the arm's base frame."""

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float

    @property
    def parameters(self) -> Array:
        """The seven lengths (7) in the order a1 a2 b c1 c2 c3 c4 [m]."""
        return np.array(astuple(self))

    def chain(self, names: tuple[str, ...]) -> Chain:
        """The arm as joints in series, base to flange."""
        places = [(0, 0, 0), (self.a1, 0, self.c1), (0, 0, self.c2), (0, self.b, -self.a2), (self.c3, 0, 0), (0, 0, 0)]
        axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
        placements = np.tile(np.eye(4), (6, 1, 1))
        placements[:, :3, 3] = places
        tip = np.array([[0, 0, 1, self.c4], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]], dtype=float)
        return Chain(names, placements, np.hstack([np.array(axes, dtype=float), np.zeros((6, 3))]), tip)

    def poses(self, q: Array) -> Array:
        """Flange poses T_base_flange (m, 4, 4) of postures q (m, 6)."""
        return _poses(self.parameters, np.ascontiguousarray(q))

    def solve(self, T_base_flange: Array, redundant: Array | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """All eight postures q (m, 8, 6) in (-pi, pi] of flange poses (m, 4, 4), and which exist (m, 8).

        The index of a posture is its branch number: 4 wrist centre behind axis 1, 2 behind the lower arm,
        1 axis 5 negative. Joint limits are not checked. With a straight wrist, q4 is 0.
        """
        return _solve(self.parameters, np.ascontiguousarray(T_base_flange))

    def branches(self, q: Array) -> NDArray[np.int8]:
        """Branch numbers (m) of postures q (m, 6)."""
        return _branches(self.parameters, np.ascontiguousarray(q))

    def out_of_reach(self, T_base_flange: Array, redundant: Array | None = None) -> Array:
        """How far (m) the wrist centre lies outside the arm's reach on its better shoulder [m]; 0 within."""
        centre = T_base_flange[:, :3, 3] - self.c4 * T_base_flange[:, :3, 2]
        rho2 = centre[:, 0] ** 2 + centre[:, 1] ** 2 - self.b**2
        rho = np.sqrt(np.maximum(rho2, 0.0))
        k = np.hypot(self.a2, self.c3)
        gaps = []
        for radial in (rho - self.a1, rho + self.a1):
            reach = np.hypot(radial, centre[:, 2] - self.c1)
            gaps.append(np.maximum(np.maximum(reach - (self.c2 + k), abs(self.c2 - k) - reach), 0.0))
        return np.minimum(*gaps)


@njit
def solve_one(p: Array, R: Array, t: Array, q: Array, ok: NDArray[np.bool_]) -> None:
    """Fill q (8, 6), each angle in (-pi, pi], and ok (8) with all postures for one flange pose: see `solve_within`."""
    solve_within(p, R, t, np.full(6, -ALL_ROUND), np.full(6, ALL_ROUND), np.ones(8, np.bool_), q, ok)
    for i in range(8):
        if ok[i]:
            for j in range(6):
                q[i, j] = wrap(q[i, j])


@inner_njit
def solve_within(
    p: Array, R: Array, t: Array, low: Array, high: Array, wanted: NDArray[np.bool_], q: Array, ok: NDArray[np.bool_]
) -> None:
    """Fill q (8, 6) and ok (8) with the postures for one flange pose, rotation R (3, 3) and origin t (3): those of the
    wanted branches (8) whose first three joints can lie within low and high (6) [rad]. Angles are not wrapped.
    """
    a1, a2, b, c1, c2, c3, c4 = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    ok[:] = False
    cx, cy, h = t[0] - c4 * R[0, 2], t[1] - c4 * R[1, 2], t[2] - c4 * R[2, 2] - c1
    across2 = cx * cx + cy * cy
    rho2 = across2 - b * b
    if not rho2 >= -REACH_ROUNDING * across2:
        return
    rho = np.sqrt(max(rho2, 0.0))
    k = np.sqrt(a2 * a2 + c3 * c3)
    bend = np.arctan2(a2, c3) + 0.5 * np.pi  # of the joint, not of theta_3
    for shoulder in range(2):
        first = BEHIND_AXIS_1 * shoulder
        if not (wanted[first] or wanted[first + 1] or wanted[first + 2] or wanted[first + 3]):
            continue
        side = rho if shoulder == 0 else -rho
        radial = side - a1
        s2 = radial * radial + h * h
        cos3 = (s2 - c2 * c2 - k * k) / (2.0 * c2 * k)
        if not abs(cos3) <= 1.0 + REACH_ROUNDING:
            continue
        s1, co1 = 0.0, 1.0 if shoulder == 0 else -1.0  # the wrist's centre on axis 1: any angle will do
        if across2 > 0.0:
            s1, co1 = (cy * side - cx * b) / across2, (cx * side + cy * b) / across2
        theta1 = np.arctan2(s1, co1)
        if not _may_stand(theta1, low[0], high[0]):
            continue
        sin3 = np.sqrt(max(1.0 - cos3 * cos3, 0.0))
        phi3, ahead, above = np.arctan2(sin3, cos3), np.arctan2(radial, h), np.arctan2(k * sin3, c2 + k * cos3)
        for elbow in range(2):
            i = first + BEHIND_LOWER_ARM * elbow
            if not (wanted[i] or wanted[i + AXIS_5_NEGATIVE]):
                continue
            q2, q3 = (ahead - above, phi3 - bend) if elbow == 0 else (ahead + above, -phi3 - bend)
            if not (_may_stand(q2, low[1], high[1]) and _may_stand(q3, low[2], high[2])):
                continue
            s23, c23 = np.cos(q2 + q3), -np.sin(q2 + q3)  # theta_3 is a quarter turn more
            # wrist rotation W = (Rz(theta1) Ry(theta2 + theta3))^T R = Rz(q4) Ry(q5) Rz(q6)
            ahead0, ahead1 = co1 * R[0, 0] + s1 * R[1, 0], co1 * R[0, 1] + s1 * R[1, 1]
            ahead2 = co1 * R[0, 2] + s1 * R[1, 2]
            w02, w12 = c23 * ahead2 - s23 * R[2, 2], co1 * R[1, 2] - s1 * R[0, 2]
            w22 = s23 * ahead2 + c23 * R[2, 2]
            w00, w01 = c23 * ahead0 - s23 * R[2, 0], c23 * ahead1 - s23 * R[2, 1]
            w10, w11 = co1 * R[1, 0] - s1 * R[0, 0], co1 * R[1, 1] - s1 * R[0, 1]
            s5 = np.sqrt(w02 * w02 + w12 * w12)
            theta4, s4, c4_ = 0.0, 0.0, 1.0
            if s5 > _STRAIGHT_WRIST:
                theta4, s4, c4_ = np.arctan2(w12, w02), w12 / s5, w02 / s5
            theta5 = np.arctan2(s5, w22)
            # from q4, not from W's last row: exact however straight the wrist is
            theta6 = np.arctan2(c4_ * w10 - s4 * w00, c4_ * w11 - s4 * w01)
            for wrist in range(2):
                j = i + AXIS_5_NEGATIVE * wrist
                if wanted[j]:
                    q[j, 0], q[j, 1], q[j, 2] = theta1, q2, q3
                    q[j, 3], q[j, 4], q[j, 5] = theta4, theta5, theta6
                    if wrist:
                        q[j, 3], q[j, 4], q[j, 5] = theta4 + np.pi, -theta5, theta6 + np.pi
                    ok[j] = True


@inner_njit
def _may_stand(angle: float, low: float, high: float) -> bool:
    """Whether an angle, shifted by whole turns as near to the middle as possible, lies within a range."""
    away = angle - 0.5 * (low + high)
    return abs(away - TURN * np.rint(away / TURN)) <= 0.5 * (high - low)


@njit
def _solve(p: Array, T: Array) -> tuple[Array, NDArray[np.bool_]]:
    m = T.shape[0]
    q = np.zeros((m, BRANCHES, 6))
    ok = np.zeros((m, BRANCHES), dtype=np.bool_)
    for i in range(m):
        solve_one(p, T[i, :3, :3], T[i, :3, 3], q[i], ok[i])
    return q, ok


@inner_njit
def pose_one(p: Array, q: Array, T: Array) -> None:
    """Fill T (4, 4) with the flange pose of one posture q (6)."""
    a1, a2, b, c1, c2, c3, c4 = p[0], p[1], p[2], p[3], p[4], p[5], p[6]
    theta3 = q[2] + 0.5 * np.pi
    s1, co1 = np.sin(q[0]), np.cos(q[0])
    s2, co2 = np.sin(q[1]), np.cos(q[1])
    s23, c23 = np.sin(q[1] + theta3), np.cos(q[1] + theta3)
    radial = a1 + c2 * s2 + c3 * s23 + a2 * c23
    up = c1 + c2 * co2 + c3 * c23 - a2 * s23
    s4, c4_ = np.sin(q[3]), np.cos(q[3])
    s5, c5 = np.sin(q[4]), np.cos(q[4])
    s6, c6 = np.sin(q[5]), np.cos(q[5])
    # rows of the arm's rotation by columns of the wrist's; written out, since products and slices compile slowly
    arm = ((co1 * c23, -s1, co1 * s23), (s1 * c23, co1, s1 * s23), (-s23, 0.0, c23))
    wrist = (
        (c4_ * c5 * c6 - s4 * s6, s4 * c5 * c6 + c4_ * s6, -s5 * c6),
        (-c4_ * c5 * s6 - s4 * c6, -s4 * c5 * s6 + c4_ * c6, s5 * s6),
        (c4_ * s5, s4 * s5, c5),
    )
    for i in range(3):
        for j in range(3):
            T[i, j] = arm[i][0] * wrist[j][0] + arm[i][1] * wrist[j][1] + arm[i][2] * wrist[j][2]
    T[0, 3] = co1 * radial - s1 * b + c4 * T[0, 2]
    T[1, 3] = s1 * radial + co1 * b + c4 * T[1, 2]
    T[2, 3] = up + c4 * T[2, 2]
    T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0


@njit
def _poses(p: Array, q: Array) -> Array:
    out = np.empty((q.shape[0], 4, 4))
    for i in range(q.shape[0]):
        pose_one(p, q[i], out[i])
    return out


@inner_njit
def branch_of(p: Array, q: Array) -> int:
    """Branch number of one posture q (6)."""
    a1, a2, c2, c3 = p[0], p[1], p[4], p[5]
    theta2, theta3 = q[1], q[2] + 0.5 * np.pi
    phi3 = wrap(theta3 + np.arctan2(a2, c3))
    radial = a1 + c2 * np.sin(theta2) + c3 * np.sin(theta2 + theta3) + a2 * np.cos(theta2 + theta3)
    behind = 0
    if radial < 0.0:
        behind += BEHIND_AXIS_1
    if phi3 < 0.0:
        behind += BEHIND_LOWER_ARM
    if wrap(q[4]) < 0.0:
        behind += AXIS_5_NEGATIVE
    return behind


@njit
def _branches(p: Array, q: Array) -> NDArray[np.int8]:
    out = np.empty(q.shape[0], dtype=np.int8)
    for i in range(q.shape[0]):
        out[i] = branch_of(p, q[i])
    return out
