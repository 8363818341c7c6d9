"""A lower bound on the deposition time over all choices, not only along the joint paths that were found.

Whatever the roll, chosen joints and branch at a place of the path, and however fast they change there, the joints'
limits on speed and acceleration imply a greatest speed along the path. No plan with an upright nozzle is faster
anywhere, so the time at these speeds bounds the time of all plans from below. The motion from place to place, jerk,
clearance and singularities are not considered: they can only cost more time.

Let u be the speed over the commanded one, f the rates of roll and chosen joints, and G the Jacobian of the arm minus
that of the holder, with twists about the nozzle's tip. A posture then moves with

    G q'  = u X + f_roll Z
    G q'' = u' X + f_roll' Z + d(u, f),    d quadratic in (u, f)

X is the path's twist, Z the nozzle's axis. u' and f' are free, so they are projected away. In the four rows that
remain, what |q''| <= a_max can reach is a zonotope, each facet of which is a linear condition on d (see `_facets`). The
rates f that allow a given u are a polytope. It is checked in cells, each with a tolerance for its width, so nothing is
missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Ints
from planner.base.compiled import inner_njit, njit
from planner.base.processes import in_blocks
from planner.cell.cell import Cell
from planner.cell.kinematics.chain import chain_state, invert6, jacobian_at, mul4, pose_of
from planner.cell.kinematics.inverse import ON_RAIL, SPHERICAL_WRIST, branches_of, solve_one
from planner.resolve.by_nozzle import nozzles_of
from planner.resolve.joint_path import sample_tasks
from planner.resolve.reach import arm_numbers, flange_pose, nearest_turns
from planner.toolpath.task import NozzleTask

MOST_WAYPOINTS = 20_000  # waypoints of a print for which the bound is computed: a second or two
MOST_CHOSEN = 3  # chosen joints of a cell for which it is computed: with more rates there would be too many cells
_ROLLS = 24  # rolls tried, all the way round; the best ones are then moved between them
_ANGLES = (24, 8, 5)  # angles tried of each chosen joint, if there are one, two or three of them
_FEW = 64  # poses, from the last good one on, that are tried first
_SCANS = 30_000  # poses tried at all hard samples together; samples that are left out count as at full speed
_ANY_RUNG = 0.1  # m between rungs, which play no part here
_BLOCK = 64  # consecutive samples that are processed together
_CELLS = (33, 13, 7, 5)  # cells of each rate, of roll and chosen joints, by the number of chosen joints
_STARTS = 12  # best poses that are moved off the grid
_NEAR = 0.9  # share of the best speed: poses below it are not moved
_CLIMBS = 5  # halvings of the grid's steps
_HALVINGS = 9  # bisections of the interval in which the greatest speed is sought; its upper end is the result
_LEAST = 1e-3  # share of the commanded speed: lower speeds count as this
_BETWEEN = 1.01  # × the speed found, for what may be missed between the last steps
_FLAT = 1e-10  # normals and reaches of facets below this are rounding


class PathNumbers(NamedTuple):
    """Samples (n): tip (n, 3), frames (n, 3, 3), and, about the tip in the part frame at the commanded speed, the twist
    of the nozzle (n, 6) and its time derivative (n, 6), linear rows first."""

    tip: Array
    frames: Array
    twist: Array
    rate: Array


class CellNumbers(NamedTuple):
    """The holder's chain, as in `Chain`, and the limits (nj) of all joints, the arm's na, then the holder's.

    chosen (m)                  indices of the chosen joints; cells (1 + m): numbers of cells into which the rates of
                                roll and of each of these are divided
    triples (k, 3), tuples (l, 2 + m)   joints that span a facet of the accelerations, and of the speeds
    """

    placements: Array
    axes: Array
    T_last_tip: Array
    q_min: Array
    q_max: Array
    velocity: Array
    acceleration: Array
    turns: NDArray[np.bool_]
    chosen: Ints
    cells: Ints
    triples: Ints
    tuples: Ints


class BoundRoom(NamedTuple):
    """Scratch for one thread, refilled at each pose."""

    postures: Array
    ok: NDArray[np.bool_]
    lines: Array
    Ja: Array
    Jh: Array
    R: Array
    J6: Array
    Ji: Array
    T: Array
    G: Array
    world: Array
    e: Array
    h: Array
    facets: Array
    M: Array
    small: Array
    A: Array


@inner_njit
def _room(na, nh, m, facets, branches):
    nj = na + nh
    return BoundRoom(
        np.empty((branches, na)), np.empty(branches, dtype=np.bool_), np.empty((2, nj, 3)), np.empty((6, na)),
        np.empty((6, nh)), np.empty((3, 3)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 4, 4)), np.empty((nj, 6)),
        np.empty((7, 6)),
        np.empty((m + 2, nj)), np.empty((m + 2, m + 2, 6)), np.empty((facets, m + 2, m + 2)), np.empty((4, nj)),
        np.empty((12, 8)), np.empty((6, 6)),
    )  # fmt: skip


@inner_njit
def _bracket(V, W, factor, out) -> None:
    """Add to out (6) factor times the rate of a screw W (6) that moves with a twist V (6); linear rows first."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        out[k] += factor * (V[3 + a] * W[b] - V[3 + b] * W[a] + V[a] * W[3 + b] - V[b] * W[3 + a])
        out[3 + k] += factor * (V[3 + a] * W[3 + b] - V[3 + b] * W[3 + a])


@inner_njit
def _normal(rows, size, A, out) -> bool:
    """Fill out (size) with a vector at right angles to the first size - 1 rows; False where they span less.

    A (size, size) is scratch.
    """
    last = size - 1
    for i in range(last):
        for j in range(size):
            A[i, j] = rows[i, j]
    column = np.empty(8, dtype=np.int64)
    for j in range(size):
        column[j] = j
    for k in range(last):
        most, row, at = 0.0, k, k
        for i in range(k, last):
            for j in range(k, size):
                if abs(A[i, column[j]]) > most:
                    most, row, at = abs(A[i, column[j]]), i, j
        if most <= _FLAT:
            return False
        column[k], column[at] = column[at], column[k]
        if row != k:
            for j in range(size):
                A[k, j], A[row, j] = A[row, j], A[k, j]
        for i in range(k + 1, last):
            share = A[i, column[k]] / A[k, column[k]]
            for j in range(k, size):
                A[i, column[j]] -= share * A[k, column[j]]
    out[column[last]] = 1.0
    for k in range(last - 1, -1, -1):
        total = A[k, column[last]]
        for j in range(k + 1, last):
            total += A[k, column[j]] * out[column[j]]
        out[column[k]] = -total / A[k, column[k]]
    return True


@inner_njit
def _bend(x, nj, na, X, X1, Z, turned, room, out) -> None:
    """Fill out (6) with d at the rates x = (u, roll, chosen ...), see the module's docstring."""
    G, e, V, W = room.G, room.e, room.small[0], room.small[1]
    for k in range(6):
        out[k] = x[0] * x[0] * X1[k] + x[0] * x[1] * turned[k]
        V[k] = 0.0
    for j in range(na):
        rate = 0.0
        for a in range(x.size):
            rate += x[a] * e[a, j]
        _bracket(V, G[j], -rate, out)
        for k in range(6):
            V[k] += rate * G[j, k]
    for k in range(6):
        V[k] = 0.0
    for j in range(na, nj):  # their columns in G have the opposite sign
        rate = 0.0
        for a in range(x.size):
            rate += x[a] * e[a, j]
        _bracket(V, G[j], -rate, out)
        for k in range(6):
            V[k] -= rate * G[j, k]
    for k in range(6):
        W[k] = x[0] * X[k] + x[1] * Z[k]
    _bracket(V, W, 1.0, out)


@inner_njit
def _rates(cell, arm, X, Z, room) -> bool:
    """Fill room.e (2 + m, nj): rates of the joints for u = 1, roll = 1, and each chosen joint; False if singular."""
    G, e, Ji = room.G, room.e, room.Ji
    solved, chosen, nj = arm.solved, cell.chosen, len(cell.velocity)
    for j in range(6):
        for k in range(6):
            room.J6[k, j] = G[solved[j], k]
    if not invert6(room.J6, Ji):
        return False
    for a in range(2 + len(chosen)):
        for j in range(nj):
            e[a, j] = 0.0
        if a >= 2:
            e[a, chosen[a - 2]] = 1.0
        for j in range(6):
            total = 0.0
            for k in range(6):
                wanted = X[k] if a == 0 else (Z[k] if a == 1 else -G[chosen[a - 2], k])
                total += Ji[j, k] * wanted
            e[a, solved[j]] = total
    return True


@inner_njit
def _speed_limit(cell, room) -> float:
    """The greatest u that the joints' speeds allow, over all rates of roll and chosen joints.

    Sums of joints' rates u e0 + sum f e, weighted so that f drops out, bound u.
    """
    e, v, rows, weights, A = room.e, cell.velocity, room.small[4:9], room.small[9], room.A
    size = cell.tuples.shape[1]
    least = np.inf
    for t in range(len(cell.tuples)):
        for a in range(size - 1):
            for b in range(size):
                rows[a, b] = e[a + 1, cell.tuples[t, b]]
        if not _normal(rows, size, A, weights):
            continue
        reach, push = 0.0, 0.0
        for b in range(size):
            j = cell.tuples[t, b]
            reach += abs(weights[b]) * v[j]
            push += weights[b] * e[0, j]
        if abs(push) * least > reach:
            least = reach / abs(push)
    return least


@inner_njit
def _facets(cell, X, X1, Z, na, room) -> int:
    """Fill room.facets (k, 2 + m, 2 + m), upper triangles: |sum x_a x_b facet| <= 1 of the rates x = (u, roll, chosen).

    In the four rows without u' and roll', G q'' is the sum of a column for each joint, times at most its a_max. A facet
    is spanned by three of these columns, and is as far out along its normal as all of them reach together.
    """
    G, h, M, facets, small, a_max = room.G, room.h, room.M, room.facets, room.small, cell.acceleration
    nj, size = len(a_max), 2 + len(cell.chosen)
    turned, x = small[2], small[3]
    for k in range(6):
        turned[k] = 0.0
    _bracket(X, Z, 1.0, turned)
    rates = x[:size]
    for a in range(size):
        rates[:] = 0.0
        rates[a] = 1.0
        _bend(rates, nj, na, X, X1, Z, turned, room, h[a, a])
    for a in range(size):
        for b in range(a + 1, size):
            rates[:] = 0.0
            rates[a], rates[b] = 1.0, 1.0
            _bend(rates, nj, na, X, X1, Z, turned, room, h[a, b])
            for k in range(6):
                h[a, b, k] -= h[a, a, k] + h[b, b, k]
    # rows at right angles to X and Z, by Gram-Schmidt from the coordinate axes
    Q = room.world
    count = 0
    for given in range(8):
        row = Q[count]
        if given < 2:
            for k in range(6):
                row[k] = X[k] if given == 0 else Z[k]
        else:
            row[:] = 0.0
            row[given - 2] = 1.0
        for _ in range(2):
            for other in range(count):
                along = 0.0
                for k in range(6):
                    along += row[k] * Q[other, k]
                for k in range(6):
                    row[k] -= along * Q[other, k]
        norm = 0.0
        for k in range(6):
            norm += row[k] * row[k]
        norm = np.sqrt(norm)
        if norm > 1e-6:
            for k in range(6):
                row[k] /= norm
            count += 1
        if count == 6:
            break
    if count < 6:
        return 0
    for r in range(4):
        for j in range(nj):
            total = 0.0
            for k in range(6):
                total += Q[r + 2, k] * G[j, k]
            M[r, j] = total * a_max[j]
    rows, normal, A = small[4:9], small[9], room.A
    n = 0
    for t in range(len(cell.triples)):
        for b in range(3):
            for r in range(4):
                rows[b, r] = M[r, cell.triples[t, b]]
        if not _normal(rows, np.int64(4), A, normal):
            continue
        reach = 0.0
        for j in range(nj):
            along = 0.0
            for r in range(4):
                along += normal[r] * M[r, j]
            reach += abs(along)
        if reach <= _FLAT:
            continue
        for a in range(size):
            for b in range(a, size):
                total = 0.0
                for r in range(4):
                    for k in range(6):
                        total += normal[r] * Q[r + 2, k] * h[a, b, k]
                facets[n, a, b] = total / reach
        n += 1
    return n


@inner_njit
def _beyond(facet, x, half) -> bool:
    """Whether all rates within `half` of x (the first one exact) are beyond a facet."""
    size = x.size
    value, room = 0.0, 0.0
    for a in range(size):
        slope = 0.0
        for b in range(size):
            c = facet[a, b] if a <= b else facet[b, a]
            slope += (2.0 if a == b else 1.0) * c * x[b]
            if b >= a:
                value += c * x[a] * x[b]
                room += abs(c) * half[a] * half[b]
        room += abs(slope) * half[a]
    return abs(value) > 1.0 + room


@inner_njit
def _allowed(u, cell, most, facets, n, room, last) -> bool:
    """Whether any rates of roll and chosen joints, each at most `most`, allow u.

    last (1): the facet that ruled it out last time
    """
    e, v = room.e, cell.velocity
    size = 2 + len(cell.chosen)
    x, half = room.small[2][:size], room.small[3][:size]
    x[0], half[0] = u, 0.0
    count = 1
    for a in range(1, size):
        count *= cell.cells[a - 1]
        half[a] = most[a] / cell.cells[a - 1]
    for c in range(count):
        rest = (c + count // 2) % count  # the middle, at rest, first
        for a in range(1, size):
            x[a] = -most[a] + half[a] * (2 * (rest % cell.cells[a - 1]) + 1)
            rest //= cell.cells[a - 1]
        if n > 0 and _beyond(facets[last[0]], x, half):
            continue
        fits = True
        for j in range(v.size):
            rate, give = 0.0, 0.0
            for a in range(size):
                rate += x[a] * e[a, j]
                give += half[a] * abs(e[a, j])
            if abs(rate) > v[j] + give:
                fits = False
                break
        if not fits:
            continue
        for k in range(n):
            if _beyond(facets[k], x, half):
                last[0] = k
                fits = False
                break
        if fits:
            return True
    return False


@inner_njit
def _greatest(i, roll, angles, floor, arm, cell, path, room, last) -> float:
    """The greatest u at sample i, at most 1, over all branches at a roll and angles (m) of chosen joints; -1 if it is
    below `floor` or there is no posture."""
    na, nh = len(arm.placements), len(cell.placements)
    nj, T, G, chosen = na + nh, room.T, room.G, cell.chosen
    q = np.zeros(nj)
    given, n_given = np.zeros(len(chosen) + 1), 0
    for c in range(len(chosen)):
        q[chosen[c]] = angles[c]
        if chosen[c] < na:
            given[n_given] = angles[c]
            n_given += 1
    origins, directions = room.lines[0], room.lines[1]
    chain_state(cell.placements, cell.axes, cell.T_last_tip, q[na:], origins[na:], directions[na:], T[0])
    pose_of(path.frames[i], path.tip[i], T[1])
    mul4(T[0], T[1], T[2])
    flange_pose(arm.T_base_world, arm.T_nozzle_flange, T[2], np.array((0.0, 0.0, 1.0)), roll, room.R, T[3], T[4], T[5])
    solve_one(arm.kind, arm.solver, arm.parameters, given[: max(n_given, 1)], T[5], room.postures, room.ok)
    tip = T[2][:3, 3]
    X, X1, Z = np.empty(6), np.empty(6), np.zeros(6)
    twist, rate = path.twist[i], path.rate[i]
    for k in range(3):
        Z[3 + k] = T[2][k, 2]
        X[k], X[3 + k], X1[k], X1[3 + k] = 0.0, 0.0, 0.0, 0.0
        for r in range(3):
            a, b = (r + 1) % 3, (r + 2) % 3
            X[k] += T[0][k, r] * twist[r]
            X[3 + k] += T[0][k, r] * twist[3 + r]
            # about a fixed point, not about the moving tip
            X1[k] += T[0][k, r] * (rate[r] - twist[3 + a] * twist[b] + twist[3 + b] * twist[a])
            X1[3 + k] += T[0][k, r] * rate[3 + r]
    if nh > 0:
        jacobian_at(origins[na:], directions[na:], tip, room.Jh)
        for j in range(nh):
            for k in range(6):
                G[na + j, k] = -room.Jh[k, j]
    middle = 0.5 * (cell.q_min + cell.q_max)
    paired = arm.kind == SPHERICAL_WRIST or arm.kind == ON_RAIL + SPHERICAL_WRIST
    best, done, most = -1.0, -1, np.empty(2 + len(chosen))
    for branch in range(len(room.ok)):
        if not room.ok[branch] or (paired and done == branch // 2):
            continue
        away = nearest_turns(room.postures[branch], middle[:na], cell.q_min[:na], cell.q_max[:na], cell.turns[:na])
        if away < -_FLAT:
            continue
        done = branch // 2  # a flipped spherical wrist has the same axes
        chain_state(
            arm.placements, arm.axes, arm.T_last_tip, room.postures[branch], origins[:na], directions[:na], T[3]
        )
        jacobian_at(origins[:na], directions[:na], tip, room.Ja)
        for j in range(na):
            for k in range(6):
                G[j, k] = room.Ja[k, j]
        if not _rates(cell, arm, X, Z, room):
            continue
        low = max(floor, best)
        high = min(1.0, _speed_limit(cell, room))
        if high <= low and low < 1.0:
            continue
        most[1] = np.inf
        for c in range(len(chosen)):
            most[2 + c] = cell.velocity[chosen[c]]
        for j in range(nj):
            give = cell.velocity[j] + abs(room.e[0, j])
            for c in range(len(chosen)):
                give += most[2 + c] * abs(room.e[2 + c, j])
            if abs(room.e[1, j]) * most[1] > give:
                most[1] = give / abs(room.e[1, j])
        n = _facets(cell, X, X1, Z, na, room)
        last[0] = last[0] if last[0] < n else 0
        if high >= 1.0 and _allowed(1.0, cell, most, room.facets, n, room, last):
            return 1.0
        if low >= 1.0 or not _allowed(max(low, _LEAST), cell, most, room.facets, n, room, last):
            continue
        low = max(low, _LEAST)
        if high < 1.0 and _allowed(high, cell, most, room.facets, n, room, last):
            low = high
        for _ in range(_HALVINGS):
            if high - low < 1e-3 * high:
                break
            half = 0.5 * (low + high)
            if _allowed(half, cell, most, room.facets, n, room, last):
                low = half
            else:
                high = half
        best = max(best, high)
    return best


@inner_njit
def _at(index, rolls, lattice, angles) -> float:
    """Roll of the pose of an index; its chosen joints' angles fill `angles`."""
    row = index // rolls
    for c in range(angles.size):
        angles[c] = lattice[row, c]
    return 2.0 * np.pi * (index % rolls) / rolls


@njit
def at_full_speed(samples, few, arm, cell, path, rolls, lattice, good) -> None:
    """Fill good (k) for samples (k): the index of a pose that allows the commanded speed, or -1.

    Tries the `few` poses from the last good one on.
    """
    m = lattice.shape[1]
    room = _room(len(arm.placements), len(cell.placements), m, len(cell.triples), branches_of(arm.kind))
    poses, now, last, angles = rolls * len(lattice), 0, np.zeros(1, dtype=np.int64), np.empty(m)
    for k in range(samples.size):
        good[k] = -1
        for step in range(min(few, poses)):
            # if there are many angles of chosen joints, try some from all over
            index = (now + step + (step // rolls) * rolls * max(len(lattice) // 7, 0)) % poses
            roll = _at(index, rolls, lattice, angles)
            if _greatest(samples[k], roll, angles, 1.0, arm, cell, path, room, last) >= 1.0:
                good[k], now = index, index
                break


@njit
def greatest_rates(samples, arm, cell, path, rolls, lattice, steps, rates) -> None:
    """Fill rates (k) for samples (k): the greatest speed over the commanded one that any pose allows, at most 1."""
    m = lattice.shape[1]
    room = _room(len(arm.placements), len(cell.placements), m, len(cell.triples), branches_of(arm.kind))
    poses, now, last, angles = rolls * len(lattice), 0, np.zeros(1, dtype=np.int64), np.empty(m)
    starts, found = np.empty(_STARTS, dtype=np.int64), np.empty(_STARTS)
    place, trial = np.empty(1 + m), np.empty(1 + m)
    for k in range(samples.size):
        i, best = samples[k], 0.0
        found[:] = -1.0
        for step in range(poses):
            index = (now + step) % poses
            roll = _at(index, rolls, lattice, angles)
            u = _greatest(i, roll, angles, _NEAR * best, arm, cell, path, room, last)
            if u < 0.0:
                continue
            worst = int(np.argmin(found))
            if u > found[worst]:
                found[worst], starts[worst] = u, index
            if u > best:
                best, now = u, index
                if u >= 1.0:
                    break
        for s in range(_STARTS):
            if best >= 1.0:
                break
            if found[s] < _NEAR * best:
                continue
            place[0] = _at(starts[s], rolls, lattice, angles)
            for c in range(m):
                place[1 + c] = angles[c]
            here, share = found[s], 0.5
            for _ in range(_CLIMBS):
                for way in range(2 * (1 + m)):
                    for c in range(1 + m):
                        trial[c] = place[c]
                    trial[way // 2] += (1.0 if way % 2 else -1.0) * share * steps[way // 2]
                    if way >= 2:
                        j = cell.chosen[way // 2 - 1]
                        trial[way // 2] = min(max(trial[way // 2], cell.q_min[j]), cell.q_max[j])
                    u = _greatest(i, trial[0], trial[1:], here, arm, cell, path, room, last)
                    if u > here:
                        here = u
                        for c in range(1 + m):
                            place[c] = trial[c]
                share *= 0.5
            best = max(best, here)
        rates[k] = min(1.0, _BETWEEN * max(best, _LEAST)) if best > 0.0 else 1.0


def bound_any_path(cell: Cell, tasks: Sequence[NozzleTask]) -> float:
    """Least time [s] that deposition takes, whatever the roll, chosen joints and branch anywhere on the path.

    The nozzle is taken to be upright: not for tasks that may tilt it. For cells with at most MOST_CHOSEN chosen joints.
    Never less than the length over the commanded speed.
    """
    return sum(_bound_of(own, [tasks[i] for i in which]) for own, which in nozzles_of(cell, tasks))


def _bound_of(cell: Cell, tasks: Sequence[NozzleTask]) -> float:
    """The same for the tasks of the nozzle in use."""
    demand = sample_tasks(tasks, _ANY_RUNG)
    lattice, steps = _lattice(cell)
    arm, numbers = arm_numbers(cell), _cell_numbers(cell)
    path = PathNumbers(demand.tip, demand.frames, demand.twist, demand.rate)
    laid = np.flatnonzero(demand.weight > 0.0)
    good = np.empty(len(laid), dtype=np.int64)

    def easy(block: slice) -> None:
        at_full_speed(laid[block], _FEW, arm, numbers, path, _ROLLS, lattice, good[block])

    in_blocks(easy, len(laid), _BLOCK)
    hard = _within_budget(laid[good < 0], _ROLLS * len(lattice))
    found = np.empty(len(hard))

    def slow(block: slice) -> None:
        greatest_rates(hard[block], arm, numbers, path, _ROLLS, lattice, steps, found[block])

    in_blocks(slow, len(hard), _BLOCK)
    rates = np.ones(len(demand.weight))
    rates[hard] = found
    total, offset = 0.0, 0
    for task in tasks:
        own = rates[offset + task.first : offset + task.last + 1]
        time = np.diff(task.s[task.first : task.last + 1]) / task.speed
        total += float((time / np.maximum(own[1:], own[:-1])).sum())  # between samples, the faster one's
        offset += len(task)
    return total


def _within_budget(hard: Ints, poses: int) -> Ints:
    """As many blocks of the hard samples, evenly chosen, as the budget allows."""
    blocks, most = -(-len(hard) // _BLOCK), max(_SCANS // (poses * _BLOCK), 1)
    if blocks <= most:
        return hard
    taken = np.unique(np.linspace(0, blocks - 1, most).astype(int))
    return np.concatenate([hard[b * _BLOCK : (b + 1) * _BLOCK] for b in taken])


def _lattice(cell: Cell) -> tuple[Array, Array]:
    """Angles (p, m) of the chosen joints to try, and the steps (1 + m) of roll and of each joint."""
    m = len(cell.chosen)
    each, steps = [], [2.0 * np.pi / _ROLLS]
    for joint in cell.chosen:
        count = _ANGLES[m - 1]
        low, high = float(cell.limits.q_min[joint]), float(cell.limits.q_max[joint])
        if joint not in cell.limits.sliding and high - low > 2.0 * np.pi:  # whole turns lead to the same posture
            low = float(cell.home[joint]) - np.pi
            values = low + 2.0 * np.pi * np.arange(count) / count
        else:
            values = np.linspace(low, high, count)
        each.append(values)
        steps.append(float(values[1] - values[0]))
    if not each:
        return np.zeros((1, 0)), np.array(steps)
    return np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, m), np.array(steps)


def _cell_numbers(cell: Cell) -> CellNumbers:
    limits, m, nj = cell.limits, len(cell.chosen), len(cell.limits.velocity)
    cells = np.full(1 + m, _CELLS[m])
    return CellNumbers(
        cell.holder.placements, cell.holder.axes, cell.holder.T_last_tip,
        limits.q_min, limits.q_max, limits.velocity, limits.acceleration, limits.turns,
        np.array(cell.chosen, dtype=np.int64), cells,
        np.array(list(combinations(range(nj), 3))), np.array(list(combinations(range(nj), 2 + m))),
    )  # fmt: skip
