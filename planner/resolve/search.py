"""The search through the ladder graph: dynamic programming over rungs and over all beads, and the routes it finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags, Ints
from planner.base.compiled import inner_njit, njit
from planner.base.geometry import TURN
from planner.cell.cell import Limits
from planner.resolve.joint_path import MARGIN, SampledTasks
from planner.resolve.nodes import Grid, Nodes
from planner.resolve.prices import DIP_PRICE, FAR, FAR_PRICE, PAUSE_PRICE, TRAVEL_PRICE, TURN_PRICE
from planner.resolve.reach import nearest_turn

# ----------------------------------------------------------------------------------------------------
# Compiled body of the search through the ladder graph.

SPEED_SHARE = 0.9  # share of a joint's speed that an edge may use: motion between rungs needs the rest
JUMP = 2.5  # rad that a joint may turn from rung to rung: more is another posture, or another whole turn
_ORDER = (4, 0, 1, 2, 3, 5, 6, 7, 8)  # of the nine neighbours, the one with the same roll and holder first


class LadderNumbers(NamedTuple):
    """The ladder graph: R rungs, each a window of A rolls, B holder angles and C branches, and their tasks.

    q (R, A, B, C, na) [rad], price (R, A, B, C) [s]      of the nodes, as in `Nodes`
    roll_from, holder_from (R), periodic, holder_step     of their grid, as in `Grid`
    task_rungs, time (R)                                  as in `SampledTasks`
    """

    q: NDArray[np.float32]
    price: Array
    roll_from: Ints
    holder_from: Ints
    periodic: bool
    holder_step: float
    task_rungs: Ints
    time: Array


class TurnsCounted(NamedTuple):
    """Joints (m) whose whole turns are part of a node, so that a route keeps to their ranges along a bead.

    joint (m)            index among the arm's, or their number for the swept one
    least (m), number (m) the fewest whole turns that may be added to a node's angle, and how many choices there are
    low, high (m)        ends of the ranges, in the nodes' angles [rad]
    """

    joint: Ints
    least: Ints
    number: Ints
    low: Array
    high: Array


class TravelLimits(NamedTuple):
    """Speed v [rad/s] and acceleration a [rad/s^2] (na + 1) of the arm's joints, then of the swept one.

    wraps (na)      which arm joints can turn so far that their angles are compared modulo a whole turn
    far, jump       turns from rung to rung [rad] beyond which an edge costs extra, and beyond which there is none
    round, middle   whether the swept joint can go all the way round; if not, the middle of its range [rad], in the
                    grid's angles
    """

    v: Array
    a: Array
    wraps: Flags
    far: float
    jump: float
    round: bool = True
    middle: float = 0.0


@inner_njit
def travel_price(
    qa: NDArray[np.float32], qb: NDArray[np.float32], turn: float, v: Array, a: Array, wraps: NDArray[np.bool_]
) -> float:
    """Price [s] of travel between postures (na) and over `turn` of the holder: the slowest joint's, rest to rest."""
    worst = 0.0
    na = wraps.size
    for j in range(na + 1):
        d = abs(turn) if j == na else abs(float(qa[j]) - float(qb[j]))
        if j < na and wraps[j]:
            d = abs(d - 2.0 * np.pi * np.rint(d / (2.0 * np.pi)))
        if d * a[j] < v[j] * v[j]:
            worst = max(worst, 2.0 * np.sqrt(d / a[j]))
        else:
            worst = max(worst, d / v[j] + v[j] / a[j])
    return TRAVEL_PRICE * worst


@inner_njit
def edge_price(q0, q1, q1_straight, turn: float, time: float, limits) -> float:
    """Price [s] of the edge from q0 to q1 (na) in `time`, where keeping roll and holder would lead to q1_straight.

    A mild quadratic price for the speeds that a change of roll or holder requires; where a joint is too slow, the time
    actually lost; and more where one turns very far. Infinite if a joint jumps, since no continuous motion leads there.
    """
    v, wraps = limits.v, limits.wraps
    need = abs(turn) / (SPEED_SHARE * v[wraps.size])  # s
    turned, far = need, limits.far
    for j in range(wraps.size):
        d = float(q1[j]) - float(q0[j])
        e = float(q1[j]) - float(q1_straight[j])
        if wraps[j]:
            d -= 2.0 * np.pi * np.rint(d / (2.0 * np.pi))
            e -= 2.0 * np.pi * np.rint(e / (2.0 * np.pi))
        if abs(d) > limits.jump:
            return np.inf
        far = max(far, abs(d))
        need = max(need, abs(d) / (SPEED_SHARE * v[j]))
        turned = max(turned, abs(e) / (SPEED_SHARE * v[j]))
    share = min(turned / time, 1.0)
    lost = (1.0 + DIP_PRICE) * max(0.0, need - time)
    return TURN_PRICE * time * share * share + lost + FAR_PRICE * (far - limits.far)


@inner_njit
def _shift(index: int, window: int, periodic: bool) -> int:
    """Index in a window, modulo its width if it is periodic; -1 outside."""
    if periodic:
        return index % window
    return index if 0 <= index < window else -1


@inner_njit
def _turn(holder_from, r1: int, b1: int, r0: int, b0: int, holder_step: float, limits) -> float:
    """The holder's turn from node b0 at rung r0 to node b1 at rung r1, the short way if it can go all the way round."""
    i1, i0 = holder_from[r1] + b1, holder_from[r0] + b0
    if limits.round:
        turn = (i1 - i0) * holder_step
        return turn - 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
    return nearest_turn(i1 * holder_step, limits.middle) - nearest_turn(i0 * holder_step, limits.middle)


@inner_njit
def _from_travel(ladder, r: int, arrived, limits, cost, back) -> None:
    """Start a bead at rung r: each node's cheapest predecessor among all ends (at rung r - 1) of the previous bead.

    The price of travel is a metric, so an end that is reached more cheaply through another end can be left out: few
    remain. They are tried in order of cost, until an end by itself costs more than the best way found.
    """
    q, price, holder_from, holder_step = ladder.q, ladder.price, ladder.holder_from, ladder.holder_step
    v, a, wraps = limits.v, limits.a, limits.wraps
    _, A, B, C = price.shape
    flat = arrived.ravel()
    kept = np.empty(flat.size, dtype=np.int64)
    n_kept = 0
    for k in np.argsort(flat):
        if flat[k] == np.inf:
            break
        i1, b1, c1 = k // (C * B), (k // C) % B, k % C
        dominated = False
        for m in range(n_kept):
            j = kept[m]
            i0, b0, c0 = j // (C * B), (j // C) % B, j % C
            turn = _turn(holder_from, r - 1, b1, r - 1, b0, holder_step, limits)
            if flat[j] + travel_price(q[r - 1, i0, b0, c0], q[r - 1, i1, b1, c1], turn, v, a, wraps) <= flat[k]:
                dominated = True
                break
        if not dominated:
            kept[n_kept] = k
            n_kept += 1
    for i in range(A):
        for b in range(B):
            for c in range(C):
                if price[r, i, b, c] == np.inf:
                    continue
                best, best_k = np.inf, -1
                for m in range(n_kept):
                    k = kept[m]
                    if flat[k] >= best:
                        break
                    i0, b0, c0 = k // (C * B), (k // C) % B, k % C
                    turn = _turn(holder_from, r, b, r - 1, b0, holder_step, limits)
                    t = flat[k] + travel_price(q[r - 1, i0, b0, c0], q[r, i, b, c], turn, v, a, wraps)
                    if t < best:
                        best, best_k = t, k
                if best_k >= 0:
                    cost[i, b, c] = best + price[r, i, b, c]
                    back[i, b, c] = best_k


@inner_njit
def _neighbours(window: int, shift: int, periodic: bool):
    """Indices (window, 3) of one step less, the same and one step more, in the previous window, which begins `shift`
    steps earlier, and in this one; -1 outside."""
    before, here = np.empty((window, 3), dtype=np.int64), np.empty((window, 3), dtype=np.int64)
    for i in range(window):
        for m in range(3):
            before[i, m], here[i, m] = _shift(i + shift + m - 1, window, periodic), _shift(i + m - 1, window, periodic)
    return before, here


@inner_njit
def _held(turns, label: int, q, angle: float) -> bool:
    """Whether joints whose turns are counted are in their ranges, at a node's joints q and angle of the swept one."""
    for k in range(turns.joint.size):
        j = turns.joint[k]
        own = (angle if j == q.size else float(q[j])) + 2.0 * np.pi * (turns.least[k] + label % turns.number[k])
        if not turns.low[k] <= own <= turns.high[k]:
            return False
        label //= turns.number[k]
    return True


@inner_njit
def _label_before(turns, label: int, q0, q1, angle0: float, angle1: float) -> int:
    """The label at the previous node from which a label here follows, no joint jumping; -1 if there is none."""
    out, unit = 0, 1
    for k in range(turns.joint.size):
        j = turns.joint[k]
        d = angle1 - angle0 if j == q0.size else float(q1[j]) - float(q0[j])
        digit = label % turns.number[k] + int(np.rint(d / (2.0 * np.pi)))
        if not 0 <= digit < turns.number[k]:
            return -1
        out += unit * digit
        unit *= turns.number[k]
        label //= turns.number[k]
    return out


@inner_njit
def _from_rung(ladder, r: int, arrived, limits, turns, cost, back) -> None:
    """Each node's cheapest predecessor among its nine neighbours at rung r - 1; on a tie, the first in their order.

    Keeping roll and holder makes the cheapest edge, so that neighbour comes first: those that cost more even without
    their edge are skipped.
    """
    q, price, holder_step, time = ladder.q, ladder.price, ladder.holder_step, ladder.time[r]
    A, B, C, L = cost.shape
    counting = turns.number.size > 0
    need = holder_step / (SPEED_SHARE * limits.v[limits.wraps.size])  # s that a step of the swept joint costs any edge
    step_price = TURN_PRICE * time * min(need / time, 1.0) ** 2 + (1.0 + DIP_PRICE) * max(0.0, need - time)
    from_a, straight_a = _neighbours(A, ladder.roll_from[r] - ladder.roll_from[r - 1], ladder.periodic)
    from_b, straight_b = _neighbours(B, ladder.holder_from[r] - ladder.holder_from[r - 1], ladder.periodic)
    for i in range(A):
        for b in range(B):
            angle = (ladder.holder_from[r] + b) * holder_step
            for c in range(C):
                own = price[r, i, b, c]
                if own == np.inf:
                    continue
                for label in range(L):
                    if counting and not _held(turns, label, q[r, i, b, c], angle):
                        continue
                    best, best_k, straight_k = np.inf, -1, -1
                    for which in range(9):
                        turn = _ORDER[which]
                        m, n = turn // 3, turn % 3
                        i0, b0 = from_a[i, m], from_b[b, n]
                        if i0 < 0 or b0 < 0 or straight_a[i, m] < 0 or straight_b[b, n] < 0 or (n != 1 and B == 1):
                            continue
                        label0 = 0
                        if counting:
                            angle0 = (ladder.holder_from[r - 1] + b0) * holder_step
                            label0 = _label_before(turns, label, q[r - 1, i0, b0, c], q[r, i, b, c], angle0, angle)
                        before = arrived[i0, b0, c, label0] if label0 >= 0 else np.inf
                        if before == np.inf or before + (step_price if n != 1 else 0.0) + own > best:
                            continue
                        if price[r, straight_a[i, m], straight_b[b, n], c] == np.inf:
                            continue
                        t = before + edge_price(
                            q[r - 1, i0, b0, c], q[r, i, b, c], q[r, straight_a[i, m], straight_b[b, n], c],
                            (n - 1) * holder_step, time, limits,
                        ) + own  # fmt: skip
                        if t < best or (t == best and turn < 4 and best_k == straight_k and t < np.inf):
                            best, best_k = t, ((i0 * B + b0) * C + c) * L + label0
                        if turn == 4:
                            straight_k = best_k
                    if best_k >= 0:
                        cost[i, b, c, label] = best
                        back[r, i, b, c, label] = best_k


@inner_njit
def _start(ladder, r: int, turns, first, first_back, cost, back) -> None:
    """Begin a bead at rung r with its nodes' costs, first (A, B, C), at any whole turns."""
    A, B, C, L = cost.shape
    for i in range(A):
        for b in range(B):
            angle = (ladder.holder_from[r] + b) * ladder.holder_step
            for c in range(C):
                for label in range(L):
                    if first[i, b, c] < np.inf and _held(turns, label, ladder.q[r, i, b, c], angle):
                        cost[i, b, c, label] = first[i, b, c]
                        back[r, i, b, c, label] = first_back[i, b, c]


@inner_njit
def _any_turns(cost):
    """Least costs (A, B, C) of nodes over their labels, and which labels have them."""
    A, B, C, L = cost.shape
    least, which = np.full(A * B * C, np.inf).reshape((A, B, C)), np.full(A * B * C, 0).reshape((A, B, C))
    for i in range(A):
        for b in range(B):
            for c in range(C):
                for label in range(L):
                    if cost[i, b, c, label] < least[i, b, c]:
                        least[i, b, c], which[i, b, c] = cost[i, b, c, label], label
    return least, which


# Sums, minima and creation of arrays with four axes each take numba seconds to compile, so loops do that.


@inner_njit
def _add(more, cost) -> None:
    """Add other costs to costs (A, B, C, labels)."""
    A, B, C, L = cost.shape
    for i in range(A):
        for b in range(B):
            for c in range(C):
                for label in range(L):
                    cost[i, b, c, label] += more[i, b, c, label]


@inner_njit
def _least(cost):
    """Flat index of the first least cost, and that cost."""
    flat = cost.ravel()
    least = 0
    for k in range(flat.size):
        if flat[k] < flat[least]:
            least = k
    return least, flat[least]


@inner_njit
def _leave(ladder, r: int, limits, turns, cost, back) -> None:
    """Let the nozzle leave the bead at rung r from the cheapest node, and come back in any posture, with any turns.

    Nodes reached that way have values below -1 in `back`.
    """
    q, price, holder_from = ladder.q, ladder.price, ladder.holder_from
    A, B, C, L = cost.shape
    k, least = _least(cost)
    i0, b0, c0 = k // (L * C * B), (k // (L * C)) % B, (k // L) % C
    paused = least + PAUSE_PRICE
    for i in range(A):
        for b in range(B):
            angle = (holder_from[r] + b) * ladder.holder_step
            turn = _turn(holder_from, r, b, r, b0, ladder.holder_step, limits)
            for c in range(C):
                if price[r, i, b, c] == np.inf:
                    continue
                t = paused + travel_price(q[r, i0, b0, c0], q[r, i, b, c], turn, limits.v, limits.a, limits.wraps)
                for label in range(L):
                    if t < cost[i, b, c, label] and _held(turns, label, q[r, i, b, c], angle):
                        cost[i, b, c, label] = t
                        back[r, i, b, c, label] = -2 - k


@inner_njit
def _trace(back, k: int, came, left) -> None:
    """Fill the nodes and labels (R, 4) at which a route arrives and from which it goes on, back from its last one k."""
    R, A, B, C, L = back.shape
    flat = back.reshape((R, A * B * C * L))
    for r in range(R - 1, -1, -1):
        left[r, 0], left[r, 1], left[r, 2], left[r, 3] = k // (L * C * B), (k // (L * C)) % B, (k // L) % C, k % L
        if flat[r, k] < -1:
            k = -2 - flat[r, k]
        came[r, 0], came[r, 1], came[r, 2], came[r, 3] = k // (L * C * B), (k // (L * C)) % B, (k // L) % C, k % L
        k = flat[r, k]


@njit
def search_best(ladder, limits, turns, may, out, back_home):
    """The cheapest route over all beads.

    Returns the window indices, branch column and label (R, 4) at which it arrives at each rung, those from which it
    goes on, its price, and -1 or the rung where it got stuck.

    ladder: LadderNumbers, limits: TravelLimits, turns: TurnsCounted
    may (R): rungs inside a bead at which the nozzle may leave it, at a price above all others; only there may it go on
    from another node than the one it arrived at
    out, back_home (A, B, C, labels): prices of the ways to the first rung's nodes and from the last one's.

    Where turns are counted, nodes carry a label: how many each of these joints has made. It follows from that of the
    previous node; between beads turns are free.
    """
    price, task_rungs = ladder.price, ladder.task_rungs
    R, A, B, C = price.shape
    L = 1
    for k in range(turns.number.size):
        L *= turns.number[k]
    n = A * B * C
    back = np.full(R * n * L, -1, dtype=np.int32).reshape((R, A, B, C, L))
    came, left = np.full(R * 4, -1).reshape((R, 4)), np.full(R * 4, -1).reshape((R, 4))
    cost = np.full(n * L, np.inf).reshape((A, B, C, L))
    for task in range(len(task_rungs) - 1):
        for r in range(task_rungs[task], task_rungs[task + 1]):
            arrived = cost
            cost = np.full(n * L, np.inf).reshape((A, B, C, L))
            if r == 0:
                _start(ladder, r, turns, price[0], np.full(n, -1).reshape((A, B, C)), cost, back)
                _add(out, cost)
            elif r == task_rungs[task]:
                least, which = _any_turns(arrived)
                first, first_back = np.full(n, np.inf).reshape((A, B, C)), np.full(n, -1)
                _from_travel(ladder, r, least, limits, first, first_back.reshape((A, B, C)))
                ends = which.ravel()
                for at in range(n):
                    if first_back[at] >= 0:
                        first_back[at] = first_back[at] * L + ends[first_back[at]]
                _start(ladder, r, turns, first, first_back.reshape((A, B, C)), cost, back)
            else:
                _from_rung(ladder, r, arrived, limits, turns, cost, back)
            _, least_cost = _least(cost)
            if not np.isfinite(least_cost):
                return came, left, np.inf, r
            if may[r]:
                _leave(ladder, r, limits, turns, cost, back)
    _add(back_home, cost)
    k, least_cost = _least(cost)
    _trace(back, k, came, left)
    return came, left, least_cost, -1


@njit
def search_greedy(ladder, limits, low, high):
    """Greedy route, bead by bead.

    Returns picked (R, 3) window indices and branch column, its price, and -1 or the rung where it got stuck.

    low, high (na): the arm joints' ranges [rad]; winding a joint further along a bead is a dead end
    """
    q, price, task_rungs = ladder.q, ladder.price, ladder.task_rungs
    v, a, wraps = limits.v, limits.a, limits.wraps
    R, A, B, C = price.shape
    picked = np.full((R, 3), -1, dtype=np.int64)
    total = 0.0
    for task in range(len(task_rungs) - 1):
        r0 = task_rungs[task]
        starts = price[r0].copy()
        if r0 > 0:
            p = picked[r0 - 1]
            for i in range(A):
                for b in range(B):
                    turn = _turn(ladder.holder_from, r0, b, r0 - 1, p[1], ladder.holder_step, limits)
                    for c in range(C):
                        starts[i, b, c] += travel_price(q[r0 - 1, p[0], p[1], p[2]], q[r0, i, b, c], turn, v, a, wraps)
        flat = starts.ravel()
        furthest, done = r0, False
        for k in np.argsort(flat):  # the next best start, if this one leads into a dead end
            if flat[k] == np.inf:
                break
            picked[r0, 0], picked[r0, 1], picked[r0, 2] = k // (C * B), (k // C) % B, k % C
            spent, stuck = _follow(ladder, limits, low, high, r0, task_rungs[task + 1], picked)
            if stuck < 0:
                total += flat[k] + spent
                done = True
                break
            furthest = max(furthest, stuck)
        if not done:
            return picked, np.inf, furthest
    return picked, total, -1


@inner_njit
def _wound(wound, q, limits, low, high, further) -> bool:
    """Whether going on to joints q (na) winds one further than its range.

    wound (3, na): where they are now, and their least and greatest positions so far, turns included; further (3, na) is
    filled with the same after that step
    """
    for j in range(q.size):
        d = float(q[j]) - wound[0, j]
        if limits.wraps[j]:
            d -= 2.0 * np.pi * np.rint(d / (2.0 * np.pi))
        further[0, j] = wound[0, j] + d
        further[1, j], further[2, j] = min(wound[1, j], further[0, j]), max(wound[2, j], further[0, j])
        if limits.wraps[j]:
            turn = 2.0 * np.pi * np.ceil((low[j] - further[1, j]) / (2.0 * np.pi))
            if further[2, j] + turn > high[j]:
                return True
    return False


@inner_njit
def _put(values, into) -> None:
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            into[i, j] = values[i, j]


@inner_njit
def _follow(ladder, limits, low, high, r0: int, stop: int, picked):
    """Walk from the node picked at rung r0 up to rung `stop`, always to the cheapest next one; returns the price, and
    the rung of a dead end or -1."""
    q, price, periodic, holder_step, time = ladder.q, ladder.price, ladder.periodic, ladder.holder_step, ladder.time
    roll_from, holder_from = ladder.roll_from, ladder.holder_from
    A, B = price.shape[1], price.shape[2]
    total = 0.0
    wound, further, ahead = np.empty((3, low.size)), np.empty((3, low.size)), np.empty((3, low.size))
    start = q[r0, picked[r0, 0], picked[r0, 1], picked[r0, 2]]
    for j in range(low.size):
        wound[0, j] = wound[1, j] = wound[2, j] = start[j]
    for r in range(r0 + 1, stop):
        i0, b0, c = picked[r - 1]
        straight_a = _shift(i0 + roll_from[r - 1] - roll_from[r], A, periodic)
        straight_b = _shift(b0 + holder_from[r - 1] - holder_from[r], B, periodic)
        best = np.inf
        if straight_a >= 0 and straight_b >= 0 and price[r, straight_a, straight_b, c] < np.inf:
            for da in range(-1, 2):
                i = _shift(straight_a + da, A, periodic)
                for db in range(-1, 2):
                    b = _shift(straight_b + db, B, periodic)
                    if i < 0 or b < 0 or (db != 0 and B == 1) or price[r, i, b, c] == np.inf:
                        continue
                    t = price[r, i, b, c] + edge_price(
                        q[r - 1, i0, b0, c], q[r, i, b, c], q[r, straight_a, straight_b, c],
                        db * holder_step, time[r], limits,
                    )  # fmt: skip
                    if t < best and not _wound(wound, q[r, i, b, c], limits, low, high, ahead):
                        best = t
                        picked[r, 0], picked[r, 1], picked[r, 2] = i, b, c
                        _put(ahead, further)
        if best == np.inf:
            return np.inf, r
        _put(further, wound)
        total += best
    return total, -1


# ----------------------------------------------------------------------------------------------------
# The search through the ladder graph: dynamic programming over rungs and over all beads.
#
# Within a bead, a path may keep its roll and holder index from rung to rung or change either or both by one step; the
# branch stays. Between beads, any end may be followed by any start, at the price of the travel between them.


@dataclass(frozen=True)
class Route:
    """A way through the ladder: at each rung (r) the absolute grid index of roll and holder, and the branch;
    price in seconds, as the search counts it."""

    roll: NDArray[np.int64]
    holder: NDArray[np.int64]
    branch: NDArray[np.int64]
    price: float


def best_route(
    nodes: Nodes,
    demand: SampledTasks,
    limits: Limits,
    home: tuple[Array, Array] | None = None,
    counted: Sequence[int] = (),
) -> tuple[Route | None, int]:
    """The cheapest route over all beads, and -1; or None, and the rung at which the last way ended.

    home: prices [s] (rolls, holders, c, labels) of the ways to the first rung's nodes and from the last one's, if these
    are to count; see `label_turns`
    counted: joints, the arm's or their number for the swept one, whose turns are counted, so that they keep to their
    ranges along every bead
    """
    turns = turns_counted(nodes, limits, counted)
    free = np.zeros((*nodes.price.shape[1:], len(label_turns(turns))))
    nowhere = np.zeros(len(nodes.price), dtype=np.bool_)
    picked, _, price, stuck = search_best(
        ladder_numbers(nodes, demand), joint_limits(nodes, limits), turns, nowhere, *(home or (free, free))
    )
    return _route(nodes, picked, price) if stuck < 0 else None, int(stuck)


def greedy_route(nodes: Nodes, demand: SampledTasks, limits: Limits) -> tuple[Route | None, int]:
    """Always the next best candidate, never looking ahead; on a dead end, the next best start.

    Returns the same as `best_route`; the rung is the furthest that any start reached.
    """
    looked_at = joint_limits(nodes, limits)._replace(far=JUMP)  # without looking ahead, no extra price for far turns
    arm = slice(0, nodes.q.shape[-1])
    picked, price, stuck = search_greedy(
        ladder_numbers(nodes, demand), looked_at, limits.q_min[arm] + limits.room, limits.q_max[arm] - limits.room
    )
    return _route(nodes, picked, price) if stuck < 0 else None, int(stuck)


def ladder_numbers(nodes: Nodes, demand: SampledTasks) -> LadderNumbers:
    """What the compiled searches need of the nodes, their grid and the tasks."""
    grid = nodes.grid
    return LadderNumbers(
        nodes.q, nodes.price, grid.roll_from, grid.holder_from, grid.periodic, grid.holder_step,
        demand.task_rungs, demand.time,
    )  # fmt: skip


def turns_counted(nodes: Nodes, limits: Limits, counted: Sequence[int], room: float = MARGIN) -> TurnsCounted:
    """What the search needs to count turns: the whole turns that take any node's angle into a joint's range, less room
    [rad] at its ends."""
    na, grid = nodes.q.shape[-1], nodes.grid
    there = np.isfinite(nodes.price)
    ends = np.empty((4, len(counted)))
    for k, j in enumerate(counted):
        if j < na:
            angles, own = nodes.q[..., j][there].astype(float), np.array([limits.q_min[j], limits.q_max[j]])
        else:
            angles = np.concatenate([grid.holder_from, grid.holder_from + grid.holders - 1]) * grid.holder_step
            zero, unit = nodes.scale
            own = (np.array([limits.q_min[nodes.joint], limits.q_max[nodes.joint]]) - zero) / unit
        ends[:, k] = own[0] + room, own[1] - room, angles.min(initial=0.0), angles.max(initial=0.0)
    least = np.ceil((ends[0] - ends[3]) / TURN).astype(np.int64)
    number = np.maximum(np.floor((ends[1] - ends[2]) / TURN).astype(np.int64) - least + 1, 1)
    return TurnsCounted(np.array(counted, dtype=np.int64), least, number, ends[0], ends[1])


MOST_LABELLED = 8e8  # nodes × labels, 4 bytes each: a table that can make 200 turns has 200 labels


def may_be_counted(nodes: Nodes, turns: TurnsCounted) -> bool:
    """Whether a search whose nodes carry these turns fits in memory."""
    return nodes.price.size * float(np.prod(turns.number, dtype=float)) <= MOST_LABELLED


def label_turns(turns: TurnsCounted) -> Ints:
    """The whole turns (labels, m) of the counted joints that each label of a node stands for."""
    label, out = np.arange(int(np.prod(turns.number))), []
    for least, number in zip(turns.least, turns.number, strict=True):
        out.append(least + label % number)
        label = label // number
    return np.array(out, dtype=np.int64).reshape(len(turns.number), -1).T if out else np.zeros((1, 0), dtype=np.int64)


def joint_limits(nodes: Nodes, limits: Limits) -> TravelLimits:
    """The limits of the arm, then of the swept joint (arbitrary if there is none)."""
    na = nodes.q.shape[-1]
    arm = np.arange(na)
    v, a = np.ones(na + 1), np.ones(na + 1)
    v[:na], a[:na] = limits.velocity[arm], limits.acceleration[arm]
    width, j = limits.q_max - limits.q_min, nodes.joint
    goes_round, middle = True, 0.0
    if j < len(width):
        zero, unit = nodes.scale
        v[na], a[na] = limits.velocity[j] / unit, limits.acceleration[j] / unit
        goes_round = bool(limits.turns[j] and width[j] >= TURN)
        middle = float((0.5 * (limits.q_min[j] + limits.q_max[j]) - zero) / unit)
    return TravelLimits(v, a, limits.turns[arm] & (width[arm] > TURN), FAR, JUMP, goes_round, middle)


def _route(nodes: Nodes, picked: NDArray[np.int64], price: float) -> Route:
    grid = nodes.grid
    r = np.arange(len(picked))
    return Route(grid.roll_from + picked[:, 0], grid.holder_from + picked[:, 1], grid.branch[r, picked[:, 2]], price)


# ----------------------------------------------------------------------------------------------------
# LadderRoute: a route through the ladder graph with the demand and nodes it was found on, and its angles.


@dataclass(frozen=True)
class LadderRoute:
    """A route over some tasks' rungs, with the demand and nodes it was found on."""

    demand: SampledTasks
    nodes: Nodes
    route: Route

    def chosen(self, k: int) -> Array:
        """Angles (r, k) of the cell's chosen joints along the route, continuous along each task."""
        grid = self.nodes.grid
        angles = grid.chosen(len(self.demand.rung), k).copy()
        if k and grid.swept is not None:
            for i in range(len(self.demand.task_rungs) - 1):
                rungs = self.demand.rungs_of(i)
                along = angles_along(grid, self.route.holder[rungs], grid.holders, grid.holder_step)
                zero, unit = self.nodes.scale
                angles[rungs, grid.swept] = zero + unit * along
        return angles


def angles_along(grid: Grid, index: NDArray[np.int64], period: int, step: float) -> Array:
    """Angles [rad] of grid indices along a task, unwrapped where the grid covers the whole circle."""
    along = index.astype(float)
    return (np.unwrap(along, period=period) if grid.periodic and period > 1 else along) * step
