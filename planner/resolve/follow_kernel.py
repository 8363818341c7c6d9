"""Compiled: postures that hold a task for given free variables, and how they change with them.

Works on any arm whose Jacobian, less the columns of joints that are themselves free, is 6 x 6: Newton's method on
the kinematic chain, from a posture nearby, so that the branch stays what it was.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kinematics.chain import chain_state, jacobian_at, rotate_about
from planner.kinematics.six import invert6, solve6
from planner.resolve.cone_kernel import lean_of, lean_slope_of

Array = NDArray[np.float64]

CONVERGED = 1e-12  # m and rad: error of the nozzle's pose that is none
_STEPS = 12  # of Newton's method; from a neighbouring sample's posture three or four do
_LONGEST = 0.5  # rad that a joint may move in a step
_POWER_STEPS = 16  # of the iteration for the smallest singular value, which starts from the sample before
_SETTLED = 1e-10  # by which a unit vector still changes in a step of it: nothing more to be had


@njit(cache=True, nogil=True, error_model="numpy")
def _cross(a, b, out) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, error_model="numpy")
def rotation_error(R_to, R_from, w) -> None:
    """Fill w (3) with the rotation vector that turns R_from into R_to, in the outer frame; half a turn's axis is x."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        up = 0.0
        down = 0.0
        for k in range(3):
            up += R_to[c, k] * R_from[b, k]
            down += R_to[b, k] * R_from[c, k]
        w[a] = 0.5 * (up - down)
    s = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    trace = 0.0
    for a in range(3):
        for k in range(3):
            trace += R_to[a, k] * R_from[a, k]
    if s > 1e-9:
        angle = np.arctan2(s, 0.5 * (trace - 1.0))
        for a in range(3):
            w[a] *= angle / s
    elif trace < 0.0:
        w[0] = np.pi  # whatever the axis: once Newton's method has moved, it sees the right one


@njit(cache=True, nogil=True, error_model="numpy")
def _tilted(frame, roll, tilt_x, tilt_y, R_tilt, axis, R_part_nozzle, slopes) -> None:
    """Fill R_part_nozzle = frame Exp(tilt) Rz(roll), and slopes (2, 3): the part-frame spin of each tilt's change."""
    angle = np.sqrt(tilt_x * tilt_x + tilt_y * tilt_y)
    if angle > 1e-12:
        axis[0], axis[1], axis[2] = tilt_x / angle, tilt_y / angle, 0.0
        rotate_about(axis, angle, R_tilt)
        one = (1.0 - np.cos(angle)) / (angle * angle)
        two = (angle - np.sin(angle)) / (angle * angle * angle)
    else:
        R_tilt[:] = 0.0
        R_tilt[0, 0], R_tilt[1, 1], R_tilt[2, 2] = 1.0, 1.0, 1.0
        one, two = 0.5, 1.0 / 6.0
    # left Jacobian of the exponential map: I + one [t]x + two [t]x^2, with t = (tilt_x, tilt_y, 0)
    for m in range(2):
        e0, e1 = (1.0, 0.0) if m == 0 else (0.0, 1.0)
        spin2 = one * (tilt_x * e1 - tilt_y * e0)
        along = tilt_x * e0 + tilt_y * e1
        square = angle * angle
        spin0 = e0 + two * (tilt_x * along - square * e0)
        spin1 = e1 + two * (tilt_y * along - square * e1)
        for k in range(3):
            slopes[m, k] = frame[k, 0] * spin0 + frame[k, 1] * spin1 + frame[k, 2] * spin2
    c, s = np.cos(roll), np.sin(roll)
    for k in range(3):
        x = frame[k, 0] * R_tilt[0, 0] + frame[k, 1] * R_tilt[1, 0] + frame[k, 2] * R_tilt[2, 0]
        y = frame[k, 0] * R_tilt[0, 1] + frame[k, 1] * R_tilt[1, 1] + frame[k, 2] * R_tilt[2, 1]
        z = frame[k, 0] * R_tilt[0, 2] + frame[k, 1] * R_tilt[1, 2] + frame[k, 2] * R_tilt[2, 2]
        R_part_nozzle[k, 0] = c * x + s * y
        R_part_nozzle[k, 1] = c * y - s * x
        R_part_nozzle[k, 2] = z


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    arm_placements, arm_axes, arm_tip, holder_placements, holder_axes, holder_tip, solved, given,
    tip, frames, z, active, q, G, sigma, sigma_slope, lean, lean_slope,
):  # fmt: skip
    """Postures along samples, and their slopes; returns the first sample where there is none, or -1.

    solved (6)      arm joints that follow from the task
    given (k)       arm joints that are free themselves
    z (n, 3+nh+k)   roll, two tilts, holder joints, given arm joints [rad]
    active (m)      columns of z whose slopes are wanted
    q (n, nj)       on entry a posture nearby for each sample, on exit the posture
    G (n, nj, m)    dq/dz
    sigma (n), sigma_slope (n, m)   smallest singular value of the arm's Jacobian at the tip, and d sigma / dz
    lean (n, 2, 2), lean_slope (n, 2, 2, m)   where the reversed nozzle axis and the surface normal lean, see `lean_of`,
                                              and their slopes
    """
    na, nh = len(arm_axes), len(holder_axes)
    o_arm, d_arm = np.empty((na, 3)), np.empty((na, 3))
    o_hold, d_hold = np.empty((nh, 3)), np.empty((nh, 3))
    before, after, R = np.eye(4), np.eye(4), np.empty((3, 3))
    T_world_part, T_world_nozzle, R_tilt = np.eye(4), np.eye(4), np.empty((3, 3))
    R_part_nozzle, R_target, slopes = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3))
    axis, p, e = np.empty(3), np.empty(3), np.empty(6)
    J, J6, Ji = np.empty((6, na)), np.empty((6, 6)), np.empty((6, 6))
    W, Wi = np.empty((6, 6)), np.empty((6, 6))
    u, w = np.full(6, 1.0), np.empty(6)
    v = np.empty(na)
    twist = np.empty(6)
    dJ = np.empty(6)
    slope_q = np.empty(na)
    a3, b3 = np.empty(3), np.empty(3)
    back, normal, slope = np.empty(3), np.empty(3), np.empty(2)
    for i in range(len(tip)):
        for h in range(nh):
            q[i, na + h] = z[i, 3 + h]
        for k in range(given.size):
            q[i, given[k]] = z[i, 3 + nh + k]
        chain_state(
            holder_placements, holder_axes, holder_tip, q[i, na:], o_hold, d_hold, T_world_part, before, after, R
        )
        _tilted(frames[i], z[i, 0], z[i, 1], z[i, 2], R_tilt, axis, R_part_nozzle, slopes)
        for a in range(3):
            p[a] = T_world_part[a, 3]
            for k in range(3):
                p[a] += T_world_part[a, k] * tip[i, k]
            for b in range(3):
                R_target[a, b] = 0.0
                for k in range(3):
                    R_target[a, b] += T_world_part[a, k] * R_part_nozzle[k, b]
        found = False
        for _ in range(_STEPS):
            chain_state(arm_placements, arm_axes, arm_tip, q[i, :na], o_arm, d_arm, T_world_nozzle, before, after, R)
            rotation_error(R_target, T_world_nozzle, a3)
            size = 0.0
            for a in range(3):
                e[a] = p[a] - T_world_nozzle[a, 3]
                e[3 + a] = a3[a]
                size += abs(e[a]) + abs(e[3 + a])  # a sum, because max loses a NaN
            if not size < np.inf:
                return i
            jacobian_at(o_arm, d_arm, T_world_nozzle[:3, 3], J)
            if size < CONVERGED:
                found = True
                break
            for k in range(6):
                for a in range(6):
                    J6[a, k] = J[a, solved[k]]
            if not solve6(J6, e):
                return i
            longest = 0.0
            for k in range(6):
                longest = max(longest, abs(e[k]))
            if not longest < 1e6:
                return i
            scale = min(1.0, _LONGEST / longest) if longest > 0.0 else 1.0
            for k in range(6):
                q[i, solved[k]] += scale * e[k]
            if longest < 1e-14:
                found = True  # no further digits to be had
                break
        if not found:
            return i
        for k in range(6):
            for a in range(6):
                J6[a, k] = J[a, solved[k]]
        if not invert6(J6, Ji):
            return i
        for a in range(3):
            back[a] = -R_target[a, 2]
            normal[a] = 0.0
            for k in range(3):
                normal[a] -= T_world_part[a, k] * frames[i, k, 2]
        lean_of(back, lean[i, 0])
        lean_of(normal, lean[i, 1])
        for c in range(active.size):
            m = active[c]
            for a in range(2):
                lean_slope[i, 0, a, c] = 0.0
                lean_slope[i, 1, a, c] = 0.0
            for j in range(q.shape[1]):
                G[i, j, c] = 0.0
            if m == 0:
                for a in range(3):
                    twist[a], twist[3 + a] = 0.0, R_target[a, 2]
            elif m < 3:
                for a in range(3):
                    twist[a] = 0.0
                    twist[3 + a] = 0.0
                    for k in range(3):
                        twist[3 + a] += T_world_part[a, k] * slopes[m - 1, k]
                lean_slope_of(back, twist[3:], slope)
                for a in range(2):
                    lean_slope[i, 0, a, c] = slope[a]
            elif m < 3 + nh:
                h = m - 3
                for a in range(3):
                    b3[a] = p[a] - o_hold[h, a]
                _cross(d_hold[h], b3, a3)
                for a in range(3):
                    twist[a], twist[3 + a] = a3[a], d_hold[h, a]
                lean_slope_of(back, twist[3:], slope)
                for a in range(2):
                    lean_slope[i, 0, a, c] = slope[a]
                lean_slope_of(normal, twist[3:], slope)
                for a in range(2):
                    lean_slope[i, 1, a, c] = slope[a]
                G[i, na + h, c] = 1.0
            else:
                joint = given[m - 3 - nh]
                for a in range(6):
                    twist[a] = -J[a, joint]
                G[i, joint, c] = 1.0
            for k in range(6):
                g = 0.0
                for a in range(6):
                    g += Ji[k, a] * twist[a]
                G[i, solved[k], c] = g
        # smallest singular value: the dominant eigenvector u of (J J^T)^-1, by the power method
        if na == 6:
            for a in range(6):
                for b in range(6):
                    Wi[a, b] = 0.0
                    for k in range(6):
                        Wi[a, b] += Ji[k, a] * Ji[k, b]
        else:
            for a in range(6):
                for b in range(6):
                    W[a, b] = 0.0
                    for k in range(na):
                        W[a, b] += J[a, k] * J[b, k]
            if not invert6(W, Wi):
                return i
        eigen = 1.0
        for _ in range(_POWER_STEPS if i else 10 * _POWER_STEPS):
            eigen = 0.0
            for a in range(6):
                w[a] = 0.0
                for b in range(6):
                    w[a] += Wi[a, b] * u[b]
                eigen += w[a] * w[a]
            eigen = np.sqrt(eigen)
            scale = 1.0 / eigen
            changed = 0.0
            for a in range(6):
                changed += abs(scale * w[a] - u[a])
                u[a] = scale * w[a]
            if changed < _SETTLED:
                break
        s = 1.0 / np.sqrt(eigen)
        sigma[i] = s
        for k in range(na):
            v[k] = 0.0
            for a in range(6):
                v[k] += J[a, k] * u[a] / s
        # d sigma / dq_k = u^T (dJ/dq_k) v; turning joint k moves what comes after it
        for k in range(na):
            for a in range(6):
                dJ[a] = 0.0
            for o in range(na):
                if k <= o:
                    _cross(d_arm[k], J[:3, o], a3)
                    _cross(d_arm[k], J[3:, o], b3)
                    for a in range(3):
                        dJ[a] += a3[a] * v[o]
                        dJ[3 + a] += b3[a] * v[o]
                else:
                    _cross(d_arm[o], J[:3, k], a3)
                    for a in range(3):
                        dJ[a] += a3[a] * v[o]
            slope_q[k] = 0.0
            for a in range(6):
                slope_q[k] += u[a] * dJ[a]
        for c in range(active.size):
            sigma_slope[i, c] = 0.0
            for k in range(na):
                sigma_slope[i, c] += slope_q[k] * G[i, k, c]
    return -1
