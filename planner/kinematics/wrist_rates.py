"""The Jacobian of a spherical-wrist arm, and its inverse, in closed form, compiled.

Where three axes meet, joints 1 to 3 alone move that point and joints 4 to 6 only turn about it: the Jacobian there is
block triangular, and both blocks are those of a few lines and angles. Symbols are those of `spherical_wrist`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.readonly import Array

Ten = tuple[float, float, float, float, float, float, float, float, float, float]
_SINGULAR = 1e-12  # m, m^2 or sine: what must not vanish is no more than rounding


@njit(cache=True, nogil=True, error_model="numpy")
def sines_of(q: Array) -> Ten:
    """Sine and cosine of joint 1, joint 2, theta_2 + theta_3, joint 4, and joint 5 of a posture q (6)."""
    theta23 = q[1] + q[2] + 0.5 * np.pi
    return (
        np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1]), np.sin(theta23), np.cos(theta23),
        np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4]),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def jacobian(p: Array, sines: Ten, tip: Array, out: Array) -> None:
    """Fill out (6, 6): the twist of a joint's rate, linear part first; arguments as in `inverse_jacobian`."""
    a1, a2, b, c1, c2, c3 = p[0], p[1], p[2], p[3], p[4], p[5]
    s1, co1, s2, co2, s23, c23, s4, c4, s5, c5 = sines
    r2, z2 = c2 * s2, c2 * co2
    r3, z3 = a1 + r2 + c3 * s23 + a2 * c23, c1 + z2 + c3 * c23 - a2 * s23  # the wrist's centre
    r, t, z = co1 * tip[0] + s1 * tip[1], co1 * tip[1] - s1 * tip[0], tip[2]
    six_r, six_t, six_z = s5 * c4 * c23 + c5 * s23, s5 * s4, c5 * c23 - s5 * c4 * s23
    # along r, t and z: a direction of each axis, and the way from a point of it to the tip
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


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_jacobian(p: Array, sines: Ten, tip: Array, out: Array) -> bool:
    """Fill out (6, 6): rates of the joints for a twist, linear part first; it is in the arm's base frame.

    p (7) lengths [m]; sines of the posture; tip (3) the point that moves with the flange, in that frame. False if the arm
    is singular to rounding.
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
    # and of 4 to 6, which undo the turn that comes with that
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
