"""Compiled bodies of a placement's score: the margin of every posture, and the best worst case of any way through them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planner.kinematics.chain import chain_state, jacobian_at, mul4, pose_of, rotate_about, turn
from planner.kinematics.inverse import SPHERICAL_WRIST, solve_one
from planner.kinematics.six import invert6, largest_singular_value
from planner.obstacles.kernel import FIRST, NO, first_lacking, head_lacking
from planner.obstacles.table import room_for
from planner.readonly import Array
from planner.resolve.node_kernel import (
    CLEAR_ROOM,
    LIMIT_ROOM,
    into_part,
    nearest_turn,
    nearest_turns,
)

NO_WRIST, SPHERICAL, OFFSET = 0, 1, 2  # how joint 5 tells how near the wrist is to its singularity


@njit(cache=True, nogil=True, error_model="numpy")
def _speed_share(Ji, solved, twist, rate, weight, samples, v_max, a_max) -> float:
    """Mean share of the commanded speed that speeds and accelerations of the joints allow over some samples.

    Ji (6, 6) the Jacobian's inverse at one posture; samples are indices, -1 where there are fewer.
    """
    time, needed = 0.0, 0.0
    for i in samples:
        if i < 0 or weight[i] == 0.0:
            continue
        most = 1.0  # of the squared commanded speed
        for k in range(6):
            j = solved[k]
            speed, acceleration = 0.0, 0.0
            for m in range(6):
                speed += Ji[k, m] * twist[i, m]
                acceleration += Ji[k, m] * rate[i, m]
            if speed * speed * most > v_max[j] * v_max[j]:
                most = (v_max[j] / speed) ** 2
            if abs(acceleration) * most > a_max[j]:
                most = a_max[j] / abs(acceleration)
        time += weight[i]
        needed += weight[i] / np.sqrt(most)
    return time / needed if time > 0.0 else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_margins(
    first, last, kind, p, solved, redundant, wrist_kind, T_base_world, T_nozzle_flange, arm_placements, arm_axes, arm_tip,
    T_before, axis, T_after, sweeps, swept_joint, held_holder, swept_low, swept_high, held_redundant, least_upright,
    q_min, q_max, v_max, a_max, table, now, tip, frames, twist, rate, weight, rung, samples,
    roll_step, holder_step, comfort, floor, lacking, q_out, terms,
):  # fmt: skip
    """Fill q_out (r, rolls, holders, 8, na) and terms (r, rolls, holders, 8, 4) of every posture of rungs first .. last.

    terms are sigma, the least angle to a joint's limit, the wrist's angle [rad], and the share of the commanded speed.
    Where there is no posture, or one that is not clear of obstacles, or whose first three terms over comfort (3) are
    not above floor, sigma stays 0.
    lacking (r, rolls): whether the head lacks clearance from part and print, which only roll decides: -1 where that is
    not known yet, which is filled. Angles are as in the ladder's nodes (`resolve.node_kernel`), so are the arguments; samples (r, m) are those whose
    rates a rung answers for.
    """
    n_rolls, n_holders, na = q_out.shape[1], q_out.shape[2], q_out.shape[4]
    middle = 0.5 * (q_min + q_max)
    crowded = len(table.pair) + len(table.look) > 0
    for r in range(first, last):
        R = np.empty((3, 3))
        eight = np.empty((8, na))
        ok = np.empty(8, dtype=np.bool_)
        known = np.empty(8, dtype=np.bool_)
        sigmas, shares = np.empty(8), np.empty(8)
        J, J6, Jp, Ji = np.empty((6, na)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
        T_held, T_world_part, T_world_task = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
        T_rolled, T_base_nozzle, T_base_flange = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
        origins, directions = np.empty((na, 3)), np.empty((na, 3))
        z_axis = np.array((0.0, 0.0, 1.0))
        posture, bodies = np.empty((1, na + held_holder.shape[1])), room_for(table)
        for h in range(held_holder.shape[1]):
            posture[0, na + h] = held_holder[r, h]
        T_part_task = np.empty((4, 4))
        pose_of(frames[rung[r]], tip[rung[r]], T_part_task)
        for b in range(n_holders):
            swept = b * holder_step
            if sweeps > 0 and swept_high - swept_low < 2.0 * np.pi:
                swept = nearest_turn(swept, 0.5 * (swept_low + swept_high))
                if min(swept - swept_low, swept_high - swept) < LIMIT_ROOM:
                    continue
            if sweeps == 1:
                posture[0, swept_joint] = swept
            rotate_about(axis, swept if sweeps == 1 else 0.0, R)
            turn(T_before[r], R, T_held)
            mul4(T_held, T_after[r], T_world_part)
            mul4(T_world_part, T_part_task, T_world_task)
            if -T_world_task[2, 2] < least_upright:
                continue
            for a in range(n_rolls):
                rotate_about(z_axis, a * roll_step, R)
                turn(T_world_task, R, T_rolled)
                mul4(T_base_world, T_rolled, T_base_nozzle)
                mul4(T_base_nozzle, T_nozzle_flange, T_base_flange)
                given = swept if sweeps == 2 else held_redundant[r]
                solve_one(kind, p, given, T_base_flange[:3, :3], T_base_flange[:3, 3], eight, ok)
                known[:] = False
                for c in range(8):
                    if not ok[c]:
                        continue
                    room = nearest_turns(eight[c], middle, q_min, q_max)
                    wrist = np.inf
                    if wrist_kind == SPHERICAL:
                        wrist = abs(eight[c, 4])
                    elif wrist_kind == OFFSET:
                        wrist = np.arcsin(abs(np.sin(eight[c, 4])))
                    if room < LIMIT_ROOM or room <= floor * comfort[1] or wrist <= floor * comfort[2]:
                        continue
                    # a spherical wrist turned over has the same axes, one of them reversed: the same rates and sigma
                    pair = c // 2 if kind == SPHERICAL_WRIST else c
                    if not known[pair]:
                        chain_state(arm_placements, arm_axes, arm_tip, eight[c], origins, directions, T_held)
                        jacobian_at(origins, directions, T_world_task[:3, 3], J)
                        into_part(J, solved, T_world_part, Jp)
                        sigmas[pair], shares[pair] = 0.0, 0.0
                        if invert6(Jp, Ji):
                            sigmas[pair] = 1.0 / largest_singular_value(Ji, J6, Jp)
                        if sigmas[pair] > floor * comfort[0]:
                            shares[pair] = _speed_share(Ji, solved, twist, rate, weight, samples[r], v_max, a_max)
                        known[pair] = True
                    if sigmas[pair] <= floor * comfort[0]:
                        continue
                    if crowded:
                        for j in range(na):
                            posture[0, j] = eight[c, j]
                        if lacking[r, a] < 0:
                            lacking[r, a] = 1 if head_lacking(table, bodies, posture, FIRST, now[rung[r]]) >= 0 else 0
                        if (
                            lacking[r, a]
                            or first_lacking(table, bodies, posture, FIRST, now[rung[r]], CLEAR_ROOM, NO) >= 0
                        ):
                            continue
                    terms[r, a, b, c] = (sigmas[pair], room, wrist, shares[pair])
                    for j in range(na):
                        q_out[r, a, b, c, j] = eight[c, j]


@njit(cache=True)
def _reachable_in(q0, q1, turn: float, time: float, v: Array, wraps: NDArray[np.bool_]) -> bool:
    """Whether the joints, and the swept one by `turn`, can go from q0 to q1 (na) in a time [s] at speeds v (na + 1)."""
    if abs(turn) > v[wraps.size] * time:
        return False
    for j in range(wraps.size):
        d = abs(float(q1[j]) - float(q0[j]))
        if wraps[j]:
            d = abs(d - 2.0 * np.pi * np.rint(d / (2.0 * np.pi)))
        if d > v[j] * time:
            return False
    return True


@njit(cache=True)
def bottleneck(q, margin, holder_step, task_rungs, time, v, wraps, floor, came):
    """Greatest margin that some way along each task never falls below (tasks), 0 where there is no way.

    margin (r, rolls, holders, 8), 0 or less where there is no posture. A way keeps its branch and changes roll and
    holder by one step at most from rung to rung, both round the circle, as fast as the joints can. The search ends at
    the first task whose margin is not above floor. came (like margin)
    is filled with the step that each node was reached by: 3 (roll step + 1) + holder step + 1.
    """
    A, B, C = margin.shape[1], margin.shape[2], margin.shape[3]
    n = task_rungs.size - 1
    out = np.zeros(n)
    ends = np.full(n, -1, dtype=np.int64)
    for task in range(n):
        first = task_rungs[task]
        best = margin[first].copy()
        for r in range(first + 1, task_rungs[task + 1]):
            arrived = best
            best = np.zeros((A, B, C), dtype=np.float32)
            for a in range(A):
                for b in range(B):
                    for c in range(C):
                        own = margin[r, a, b, c]
                        if own <= 0.0:
                            continue
                        least = np.float32(0.0)
                        for step in (4, 1, 7, 3, 5, 0, 2, 6, 8):  # straight on first: of equals the calmest
                            da, db = step // 3 - 1, step % 3 - 1
                            if (db != 0 and B == 1) or (da != 0 and A == 1):
                                continue
                            a0, b0 = (a - da) % A, (b - db) % B
                            through = min(arrived[a0, b0, c], own)
                            if through <= least:
                                continue
                            if _reachable_in(q[r - 1, a0, b0, c], q[r, a, b, c], db * holder_step, time[r], v, wraps):
                                least = through
                                came[r, a, b, c] = step
                        best[a, b, c] = least
        ends[task] = best.argmax()
        out[task] = best.max()
        if out[task] <= floor:
            break
    return out, ends


@njit(cache=True)
def way_back(ends, came, task_rungs):
    """Nodes (r, 3) roll, holder and branch of the ways that `bottleneck` found."""
    A, B, C = came.shape[1], came.shape[2], came.shape[3]
    picked = np.empty((task_rungs[-1], 3), dtype=np.int64)
    for task in range(ends.size):
        k = ends[task]
        a, b, c = k // (B * C), (k // C) % B, k % C
        for r in range(task_rungs[task + 1] - 1, task_rungs[task] - 1, -1):
            picked[r] = (a, b, c)
            if r > task_rungs[task]:
                step = came[r, a, b, c]
                a, b = (a - (step // 3 - 1)) % A, (b - (step % 3 - 1)) % B
    return picked
