"""Waits between beads, so that the material below is neither too fresh nor too old when a bead is laid on it.

The time between two places, one on top of the other, follows from the start times of their beads and the time the
nozzle takes from each start to the place. So a window of ages bounds the difference of two start times for each pair of
beads that touch: together with the durations of beads and travels, a system of difference constraints. Its least
solution, found by longest paths from the first bead (Bellman and Ford), gives the earliest start of each bead: it waits
only where it must, and no longer than needed. If the system has no solution, the greatest age is raised to the least
value that has one, and the verifier reports it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import NegativeCycleError, bellman_ford

from planner.base.arrays import Array, Ints
from planner.base.compiled import njit
from planner.cell.cell import Cell
from planner.collision.scene import Obstacles
from planner.motion.timing.timed_path import TimedPath
from planner.motion.travel.plan import Travel, ViaRest, plan_travels
from planner.motion.visits import Visit, visits
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.contacts import BeadContacts, contacts

_STEP = 2e-3  # s between instants at which a bead's arc length is known
_SPARE = 5e-3  # s by which the window is narrowed: places are checked only every quarter of a bead width
_SLIGHT = 1e-3  # s: shorter waits are left out
_CLOSE = 0.01  # s: tolerance to which the least feasible window is found
_SWEEPS = 200
_MOST_WORK = 2_000_000_000  # beads × lags: up to this size, infeasibility is proved
_ROUNDING = 1e-9  # s
_ROUNDS = 8  # of replacing travels by travels with a rest


@dataclass(frozen=True)
class Lags:
    """How much later (p) one bead must begin than another, at least and at most [s]; indices among the timed beads."""

    before: Ints
    after: Ints
    least: Array
    most: Array


def lags_of(process: ProcessSpec, toolpath: Toolpath, timed: Sequence[TimedPath], touching: BeadContacts) -> Lags:
    """Bounds that the window sets on the starts of beads; timed: all beads, or the last ones."""
    spec, first = process.interlayer_time, len(toolpath.beads) - len(timed)
    least = 0.0 if spec is None or spec.least is None else spec.least + _SPARE
    most = np.inf if spec is None or spec.most is None else spec.most - _SPARE
    ends = np.zeros(
        (2, 2, len(touching))
    )  # of upper and lower beads: when the nozzle reaches each place, and leaves it
    for k, (number, at, around) in enumerate(
        ((touching.upper, touching.at, touching.around), (touching.lower, touching.below, touching.beneath))
    ):
        order = np.argsort(number, kind="stable")
        edges = np.searchsorted(number[order], np.arange(first, len(toolpath.beads) + 1))
        for path, a, b in zip(timed, edges[:-1], edges[1:], strict=True):
            rows = order[a:b]
            rows = rows[touching.upper[rows] != touching.lower[rows]]  # a bead on its own earlier turn cannot wait
            if len(rows):
                times, way = _instants(path)
                ends[k, 0, rows] = np.interp(at[rows] - around[rows], way, times)
                ends[k, 1, rows] = np.interp(at[rows] + around[rows], way, times)
    low, _ = touching.extremes(ends[0, 0] - ends[1, 1])
    _, high = touching.extremes(ends[0, 1] - ends[1, 0])
    upper, lower = touching.pairs.T - first if len(touching) else (np.empty(0, int),) * 2
    there = (lower >= 0) & (lower < upper)
    return Lags(lower[there], upper[there], least - low[there], most - high[there])


def _instants(path: TimedPath) -> tuple[Array, Array]:
    """Instants (k) [s] of a bead, and the arc length (k) [m] reached by then, which never decreases."""
    times = np.linspace(0.0, path.duration, int(np.ceil(path.duration / _STEP)) + 2)
    return times, np.maximum.accumulate(path.at(times)[1])


def begins(
    process: ProcessSpec, toolpath: Toolpath, timed: Sequence[TimedPath], travels: Sequence[Travel], lags: Lags
) -> Array:
    """Earliest start (n) of each bead's run-in [s], counted from the first one's, if the robot may rest before each.

    travels: as planned, without waits for the material below. If no waits satisfy the greatest lags, all of these are
    raised by the same amount, the least that suffices.
    """
    n, by_home = len(timed), visits(process, toolpath.beads, timed)
    first = len(toolpath.beads) - n
    follows = np.array(
        [timed[k - 1].duration + _least(process, travels[k], by_home.get(first + k)) for k in range(1, n)]
    )
    before, after, least = [np.arange(n - 1), lags.before], [np.arange(1, n), lags.after], [follows, lags.least]
    for i, visit in by_home.items():
        if visit.layer_before is not None and process.layer_time is not None:
            k, own = i - first, visit.layer_before - first
            begun = timed[own].when(0.0) - timed[k].when(0.0)
            before, after = [*before, np.array([own])], [*after, np.array([k])]
            least.append(np.array([process.layer_time.least + begun]))
    edges = np.concatenate(before), np.concatenate(after), np.concatenate(least)
    found = _longest(n, edges, lags, 0.0)
    if found is not None:
        return found
    free = _longest(n, edges, lags, np.inf)
    if free is None:
        raise RuntimeError("beads would have to begin before those that they follow")
    low, high = 0.0, float(np.max(free[lags.after] - free[lags.before] - lags.most))
    while high - low > _CLOSE:
        middle = 0.5 * (low + high)
        if _longest(n, edges, lags, middle) is None:
            low = middle
        else:
            high = middle
    found = _longest(n, edges, lags, high)
    return free if found is None else found


def _longest(n: int, edges: tuple[Ints, Ints, Array], lags: Lags, more: float) -> Array | None:
    """Earliest starts (n) of beads that obey the least delays in `edges` and the greatest lags plus `more` [s].

    None if there are none.
    """
    before, after, least = edges
    if np.isfinite(more):
        bound = np.isfinite(lags.most)
        before = np.concatenate([before, lags.after[bound]])
        after = np.concatenate([after, lags.before[bound]])
        least = np.concatenate([least, -lags.most[bound] - more])
    found = _swept(n, before, after, least)
    if found is not None or len(before) * n > _MOST_WORK:
        return found
    key = before.astype(np.int64) * n + after
    order = np.lexsort((-least, key))
    taken = order[np.append(True, np.diff(key[order]) != 0)[: len(order)]]  # of parallel edges the strictest
    graph = coo_array((-least[taken], (before[taken], after[taken])), shape=(n, n)).tocsr()
    try:
        return np.asarray(-bellman_ford(graph, indices=0))
    except NegativeCycleError:
        return None


def _swept(n: int, before: Ints, after: Ints, least: Array) -> Array | None:
    """The same by a few sweeps over all edges in the order of beads, where that suffices.

    One sweep carries every change through to the end; only edges that lead back, those of greatest lags, call for
    another. None if the sweeps do not suffice, or if there is no solution.
    """
    order = np.argsort(after, kind="stable")
    before, after, least = before[order], after[order], least[order]
    chain = np.full(n - 1, -np.inf)
    next_ = after == before + 1
    np.maximum.at(chain, before[next_], least[next_])
    usual = np.append(0.0, np.cumsum(chain))
    more, start = least - (usual[after] - usual[before]), np.zeros(n)
    for _ in range(_SWEEPS):
        later = _sweep(start, before, after, more)
        if start[0] > _ROUNDING:
            return None
        if not later:
            return start + usual
    return None


@njit
def _sweep(start: Array, before: Ints, after: Ints, more: Array) -> bool:
    """Delay starts (n) as the previous bead and edges, sorted by the beads they lead to, require; whether any was."""
    later, k, due = False, 0, start[0]
    for j in range(len(start)):
        due = max(due, start[j])
        while k < len(after) and after[k] == j:
            due = max(due, start[before[k]] + more[k])
            k += 1
        if due > start[j] + _ROUNDING:
            start[j], later = due, True
    return later


def _least(process: ProcessSpec, travel: Travel, visit: Visit | None) -> float:
    """Least duration of a travel [s], including its pause and change of material."""
    if not isinstance(travel, ViaRest):
        return travel.duration
    visit = visit or Visit()
    pause = 0.0 if visit.pause is None else visit.pause.time
    return travel.out.duration + travel.back.duration + pause + (process.change.time if visit.change else 0.0)


def with_rests(
    cell: Cell,
    timed: Sequence[TimedPath],
    toolpath: Toolpath,
    process: ProcessSpec,
    travels: Sequence[Travel],
    obstacles: Obstacles,
    touching: BeadContacts,
) -> list[Travel]:
    """The travels, with a rest in each one after which a bead would be laid on material that is too fresh.

    The rest is at home or, where the way there and back takes longer than the wait, lifted above the previous bead.
    Where neither can be reached, the travel is slower instead.
    """
    lags, out = lags_of(process, toolpath, timed, touching), list(travels)
    for _ in range(_ROUNDS):
        within = _too_short(begins(process, toolpath, timed, out, lags), timed, out)
        if not within:
            break
        fresh = plan_travels(cell, timed, toolpath, process, sorted(within), obstacles, within)
        for k, travel in zip(sorted(within), fresh, strict=True):
            out[k] = travel
    return out


def _too_short(start: Array, timed: Sequence[TimedPath], travels: Sequence[Travel]) -> Mapping[int, float]:
    """Travels without a rest that would have to take longer, by number, and their required duration [s]."""
    ends = start[:-1] + [path.duration for path in timed[:-1]]
    time = start[1:] - ends
    return {
        k + 1: float(time[k])
        for k in range(len(time))
        if not isinstance(travels[k + 1], ViaRest) and time[k] > travels[k + 1].duration + _SLIGHT
    }


def contacts_within(process: ProcessSpec, toolpath: Toolpath) -> BeadContacts | None:
    """Which places lie on which, if the process sets a window of ages; else None."""
    return None if process.interlayer_time is None else contacts(toolpath.beads)
