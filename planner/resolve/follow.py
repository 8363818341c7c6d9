"""Compiled: postures that hold a task for given free variables, and how they change with them.

Works for any arm whose Jacobian, without the columns of joints that are themselves free, is 6 x 6: Newton's method on
the kinematic chain, from a posture nearby, so that the branch does not change. For a spherical wrist, posture and
Jacobian are in closed form, unless no posture of the branch is nearby.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.cell.kinematics.chain import chain_state, invert6, jacobian_at, mul4, rotate_about
from planner.cell.kinematics.inverse import ON_RAIL, SPHERICAL_WRIST
from planner.cell.kinematics.spherical_wrist import (
    ALL_ROUND,
    branch_of,
    inverse_jacobian,
    jacobian,
    sines_of,
    solve_within,
)
from planner.resolve.cone_kernels import gram, lean_of, lean_slope_of, power, sigma_slope_by_joints, square, to_unit

CONVERGED = 1e-12  # m and rad: error of the nozzle's pose that counts as zero
_STEPS = 12  # of Newton's method; from a neighbouring sample's posture, three or four are enough
_LONGEST = 0.5  # rad that a joint may move in a step
_POWER_STEPS = 4  # of the power method for the smallest singular value, each worth four; starts from the sample before


class HolderNumbers(NamedTuple):
    """The holder, as in Chain: from the world to the part frame, nh joints."""

    placements: Array
    axes: Array
    T_last_tip: Array


class PosturesFollowed(NamedTuple):
    """What `follow` fills along n samples, for m columns of z.

    q (n, nj)                          on entry a posture nearby for each sample, on exit the posture [rad]
    G (n, nj, m)                       dq/dz
    sigma (n), sigma_slope (n, m)      smallest singular value of the arm's Jacobian at the tip, and d sigma / dz
    lean (n, 3, 2), lean_slope (n, 3, 2, m)   where three directions lean, see `lean_of`, and their slopes: the reversed
                                              nozzle axis and the surface normal from the vertical, and that axis from
                                              that normal
    """

    q: Array
    G: Array
    sigma: Array
    sigma_slope: Array
    lean: Array
    lean_slope: Array


class _NewtonRoom(NamedTuple):
    """Scratch for Newton's method: the chain's origins, directions (na, 3) and nozzle (4, 4), the rotation vector that
    turns the nozzle to its target (3), the pose's error e (6), and the joints' step (6)."""

    origins: Array
    directions: Array
    T_world_nozzle: Array
    turn: Array
    e: Array
    step: Array


@inner_njit
def _cross(a, b, out) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inner_njit
def rotation_error(R_to, R_from, w) -> None:
    """Fill w (3) with the rotation vector that turns R_from into R_to, in the outer frame; half a turn is about x."""
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
        w[0] = np.pi  # about any axis: after a step, Newton's method sees the right one


@inner_njit
def _upright_on(normal, beside, basis) -> None:
    """Fill basis (3, 3) with orthonormal rows: the last one along a unit normal (3), the first one close to `beside`
    (3), which is roughly at right angles to it."""
    along = beside[0] * normal[0] + beside[1] * normal[1] + beside[2] * normal[2]
    size = 0.0
    for a in range(3):
        basis[2, a] = normal[a]
        basis[0, a] = beside[a] - along * normal[a]
        size += basis[0, a] * basis[0, a]
    size = np.sqrt(size)
    for a in range(3):
        basis[0, a] /= size
    _cross(basis[2], basis[0], basis[1])


@inner_njit
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


@inner_njit
def _inverse_at(origins, directions, T_world_nozzle, solved, J, J6, Ji) -> bool:
    """Fill J (6, na) with the Jacobian at the nozzle, and Ji with the inverse of its columns `solved`; False if there
    is none. J6 is scratch."""
    jacobian_at(origins, directions, T_world_nozzle[:3, 3], J)
    for k in range(6):
        for a in range(6):
            J6[a, k] = J[a, solved[k]]
    return invert6(J6, Ji)


@inner_njit
def _near_in_closed_form(
    p, T_base_world, T_world_nozzle, T_nozzle_flange, q, low, high, eight, ok, wanted, T_base_nozzle, T_base_flange
) -> bool:
    """Replace the posture q (6) by the one of its branch for a nozzle pose; False, with q unchanged, if none is nearby.

    It is exact as far as p holds the chain's lengths. low, high (6) bound nothing; eight (8, 6), ok, wanted (8) are
    scratch; the last two arguments are filled.
    """
    mul4(T_base_world, T_world_nozzle, T_base_nozzle)
    mul4(T_base_nozzle, T_nozzle_flange, T_base_flange)
    k = branch_of(p, q)
    wanted[:] = False
    wanted[k] = True
    solve_within(p, T_base_flange[:3, :3], T_base_flange[:3, 3], low, high, wanted, eight, ok)
    if not ok[k]:
        return False
    for j in range(6):
        away = q[j] - eight[k, j]
        eight[k, j] += 2.0 * np.pi * np.rint(away / (2.0 * np.pi))
        if not abs(q[j] - eight[k, j]) < _LONGEST:
            return False
    for j in range(6):
        q[j] = eight[k, j]
    return True


@inner_njit
def _out_of_base(T_base_world, J, Ji) -> None:
    """Turn a Jacobian (6, 6) and its inverse from the arm's base frame into the world."""
    R = T_base_world
    for k in range(6):
        for first in (0, 3):
            x, y, z = J[first, k], J[first + 1, k], J[first + 2, k]
            u, v, w = Ji[k, first], Ji[k, first + 1], Ji[k, first + 2]
            for a in range(3):
                J[first + a, k] = R[0, a] * x + R[1, a] * y + R[2, a] * z
                Ji[k, first + a] = R[0, a] * u + R[1, a] * v + R[2, a] * w


@inner_njit
def _by_steps(arm, p, R, q, room, J, J6, Ji) -> bool:
    """Move the solved joints of q (na) until its nozzle is at p (3) with orientation R (3, 3), and fill J (6, na) and
    Ji (6, 6) as `_inverse_at` does; False if no such posture is found. J6 (6, 6) is scratch as well."""
    placements, axes, T_last_tip, solved = arm.placements, arm.axes, arm.T_last_tip, arm.solved
    origins, directions, T_world_nozzle = room.origins, room.directions, room.T_world_nozzle
    turn, e, step = room.turn, room.e, room.step
    for _ in range(_STEPS):
        chain_state(placements, axes, T_last_tip, q, origins, directions, T_world_nozzle)
        if not _inverse_at(origins, directions, T_world_nozzle, solved, J, J6, Ji):
            return False
        rotation_error(R, T_world_nozzle, turn)
        size = 0.0
        for a in range(3):
            e[a] = p[a] - T_world_nozzle[a, 3]
            e[3 + a] = turn[a]
            size += abs(e[a]) + abs(e[3 + a])  # a sum, because max loses a NaN
        if not size < np.inf:
            return False
        if size < CONVERGED:
            return True
        longest = 0.0
        for k in range(6):
            step[k] = 0.0
            for a in range(6):
                step[k] += Ji[k, a] * e[a]
            longest = max(longest, abs(step[k]))
        if not longest < 1e6:
            return False
        scale = min(1.0, _LONGEST / longest) if longest > 0.0 else 1.0
        for k in range(6):
            q[solved[k]] += scale * step[k]
        if longest < 1e-14:
            return True  # no further digits to gain
    return False


@njit
def follow(arm, holder, given, tip, frames, normals, z, active, out) -> int:
    """Fill `out` with postures along samples, and their slopes; returns the first sample where there is none, or -1.

    arm: ArmNumbers, holder: HolderNumbers; given (k): arm joints that are free themselves
    tip, normals (n, 3), frames (n, 3, 3) of the task
    z (n, 3+nh+k): roll, two tilts, holder joints, given arm joints [rad]; active (m): columns whose slopes are wanted
    """
    kind, parameters, solved = arm.kind, arm.parameters, arm.solved
    T_base_world, T_nozzle_flange = arm.T_base_world, arm.T_nozzle_flange
    holder_placements, holder_axes, holder_tip = holder.placements, holder.axes, holder.T_last_tip
    q, G, sigma, sigma_slope, lean, lean_slope = out.q, out.G, out.sigma, out.sigma_slope, out.lean, out.lean_slope
    na, nh = len(arm.axes), len(holder_axes)
    first = int(parameters[0]) if kind >= ON_RAIL else 0  # first joint of the arm itself
    o_arm, d_arm = np.empty((na, 3)), np.empty((na, 3))
    o_hold, d_hold = np.empty((nh, 3)), np.empty((nh, 3))
    T_world_part, T_world_nozzle, R_tilt = np.eye(4), np.eye(4), np.empty((3, 3))
    R_part_nozzle, R_target, slopes = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3))
    T_target, eight, ok, wanted = np.eye(4), np.empty((8, na)), np.empty(8, dtype=np.bool_), np.zeros(8, dtype=np.bool_)
    T_base_nozzle, T_base_flange = np.empty((4, 4)), np.empty((4, 4))
    low, high = np.full(6, -ALL_ROUND), np.full(6, ALL_ROUND)
    axis, p, e = np.empty(3), np.empty(3), np.empty(6)
    J, J6, Ji = np.empty((6, na)), np.empty((6, 6)), np.empty((6, 6))
    W, Wi = np.empty((6, 6)), np.empty((6, 6))
    u, w = 1.0 + 0.1 * np.arange(6.0), np.empty(6)  # arbitrary, but orthogonal to nothing in particular
    v = np.empty(na)
    twist = np.empty(6)
    sum_before, sum_after = np.empty(6), np.empty(6)
    slope_q = np.empty(na)
    a3, b3 = np.empty(3), np.empty(3)
    newton_room = _NewtonRoom(o_arm, d_arm, T_world_nozzle, a3, e, twist)
    back, normal, slope = np.empty(3), np.empty(3), np.empty(2)
    basis, from_normal, spin = np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(len(tip)):
        for h in range(nh):
            q[i, na + h] = z[i, 3 + h]
        for k in range(given.size):
            q[i, given[k]] = z[i, 3 + nh + k]
        chain_state(holder_placements, holder_axes, holder_tip, q[i, na:], o_hold, d_hold, T_world_part)
        _tilted(frames[i], z[i, 0], z[i, 1], z[i, 2], R_tilt, axis, R_part_nozzle, slopes)
        for a in range(3):
            p[a] = T_world_part[a, 3]
            for k in range(3):
                p[a] += T_world_part[a, k] * tip[i, k]
            for b in range(3):
                R_target[a, b] = 0.0
                for k in range(3):
                    R_target[a, b] += T_world_part[a, k] * R_part_nozzle[k, b]
        closed = False
        if kind == SPHERICAL_WRIST:
            for a in range(3):
                for b in range(3):
                    T_target[a, b] = R_target[a, b]
                T_target[a, 3] = p[a]
            closed = _near_in_closed_form(
                parameters, T_base_world, T_target, T_nozzle_flange, q[i, :na], low, high, eight, ok, wanted,
                T_base_nozzle, T_base_flange,
            )  # fmt: skip
        if closed:
            sines = sines_of(q[i, :na])
            jacobian(parameters, sines, T_base_nozzle[:3, 3], J)
            if not inverse_jacobian(parameters, sines, T_base_nozzle[:3, 3], Ji):
                return i
            _out_of_base(T_base_world, J, Ji)
        elif not _by_steps(arm, p, R_target, q[i, :na], newton_room, J, J6, Ji):
            return i
        for a in range(3):
            back[a] = -R_target[a, 2]
            normal[a] = 0.0
            for k in range(3):
                normal[a] += T_world_part[a, k] * normals[i, k]
        lean_of(back, lean[i, 0])
        lean_of(normal, lean[i, 1])
        _upright_on(normals[i], frames[i, :, 0], basis)
        for a in range(3):
            from_normal[a] = 0.0
            for k in range(3):
                from_normal[a] -= basis[a, k] * R_part_nozzle[k, 2]
        lean_of(from_normal, lean[i, 2])
        for c in range(active.size):
            m = active[c]
            for a in range(2):
                lean_slope[i, 0, a, c] = 0.0
                lean_slope[i, 1, a, c] = 0.0
                lean_slope[i, 2, a, c] = 0.0
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
                for a in range(3):
                    spin[a] = 0.0
                    for k in range(3):
                        spin[a] += basis[a, k] * slopes[m - 1, k]
                lean_slope_of(from_normal, spin, slope)
                for a in range(2):
                    lean_slope[i, 2, a, c] = slope[a]
            elif m < 3 + nh:
                h = m - 3
                for a in range(3):
                    b3[a] = p[a] - o_hold[h, a]
                _cross(d_hold[h], b3, a3)
                slides = d_hold[h, 0] == 0.0 and d_hold[h, 1] == 0.0 and d_hold[h, 2] == 0.0
                for a in range(3):
                    twist[a], twist[3 + a] = o_hold[h, a] if slides else a3[a], d_hold[h, a]
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
        if na - first == 6:  # for an arm on a rail, only the arm itself counts
            gram(Ji, Wi)
        else:
            for a in range(6):
                for b in range(6):
                    W[a, b] = 0.0
                    for k in range(first, na):
                        W[a, b] += J[a, k] * J[b, k]
            if not invert6(W, Wi):
                return i
        square(Wi, W)
        square(W, J6)
        for _ in range(_POWER_STEPS if i else 10 * _POWER_STEPS):
            power(J6, u, w)
        to_unit(u)
        power(Wi, u, w)
        s = 1.0 / np.sqrt(to_unit(u))
        sigma[i] = s
        for k in range(na):
            v[k] = 0.0
            for a in range(6 if k >= first else 0):
                v[k] += J[a, k] * u[a] / s
        sigma_slope_by_joints(J, u, v, sum_before, sum_after, slope_q)
        for c in range(active.size):
            sigma_slope[i, c] = 0.0
            for k in range(na):
                sigma_slope[i, c] += slope_q[k] * G[i, k, c]
    return -1
