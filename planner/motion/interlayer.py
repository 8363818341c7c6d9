"""Waits between beads, so that what lies below is neither too fresh nor too old when it is laid on.

The time from one place to a place above it is the time between the beginnings of their beads, and what the nozzle takes into
each. So a window of ages is a bound on the difference of two beginnings for each pair of beads of which one lies on the other:
a system of difference constraints, together with what each bead and each travel takes. Its least solution, by the longest
paths from the first bead on (Bellman and Ford), is the earliest that each bead can begin: the waits in it are where they are
needed, and no longer. Where the system has none, the greatest age that is asked for is raised to the least that has one, and
the verifier tells.
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
_SPARE = 5e-3  # s by which a window is held more closely than asked: places are looked at a quarter of a width apart
_SLIGHT = 1e-3  # s that nobody waits for
_CLOSE = 0.01  # s to which the least window is found
_SWEEPS = 200
_MOST_WORK = 2_000_000_000  # beads times lags, up to which it is made sure that there is no solution
_ROUNDING = 1e-9  # s
_ROUNDS = 8  # of travels that become ones with a rest


@dataclass(frozen=True)
class Lags:
    """How much later (p) a bead begins than another, by their places among those that are timed, at least and at most [s]."""

    before: Ints
    after: Ints
    least: Array
    most: Array


def lags_of(process: ProcessSpec, toolpath: Toolpath, timed: Sequence[TimedPath], touching: BeadContacts) -> Lags:
    """What the window asks of the beginnings of beads; timed: all beads, or the last ones."""
    spec, first = process.interlayer_time, len(toolpath.beads) - len(timed)
    least = 0.0 if spec is None or spec.least is None else spec.least + _SPARE
    most = np.inf if spec is None or spec.most is None else spec.most - _SPARE
    ends = np.zeros(
        (2, 2, len(touching))
    )  # of upper and lower beads: when the nozzle comes to each place, and leaves it
    for k, (number, at, around) in enumerate(
        ((touching.upper, touching.at, touching.around), (touching.lower, touching.below, touching.beneath))
    ):
        order = np.argsort(number, kind="stable")
        edges = np.searchsorted(number[order], np.arange(first, len(toolpath.beads) + 1))
        for path, a, b in zip(timed, edges[:-1], edges[1:], strict=True):
            rows = order[a:b]
            rows = rows[touching.upper[rows] != touching.lower[rows]]  # a bead on its own earlier turn is as it is
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
    """Instants (k) [s] of a bead, and its arc length (k) [m] then, which never falls."""
    times = np.linspace(0.0, path.duration, int(np.ceil(path.duration / _STEP)) + 2)
    return times, np.maximum.accumulate(path.at(times)[1])


def begins(
    process: ProcessSpec, toolpath: Toolpath, timed: Sequence[TimedPath], travels: Sequence[Travel], lags: Lags
) -> Array:
    """When each bead (n) begins with its run-in at the earliest, from the first one's on [s], if there is a rest before each.

    travels: as they are, without waits for what is below. Where no waits keep the greatest lags, these are taken as much
    longer as they must be, all alike.
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
        raise RuntimeError("beads that follow each other begin before each other")
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
    """The earliest beginnings (n) of beads, each of which follows others (edges) by so much at least, and others by what their
    lags are at most, and `more` [s]; None where there are none."""
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
    taken = order[np.append(True, np.diff(key[order]) != 0)[: len(order)]]  # of several the one that asks for most
    graph = coo_array((-least[taken], (before[taken], after[taken])), shape=(n, n)).tocsr()
    try:
        return np.asarray(-bellman_ford(graph, indices=0))
    except NegativeCycleError:
        return None


def _swept(n: int, before: Ints, after: Ints, least: Array) -> Array | None:
    """The same in few sweeps over all edges in the order of beads, where it can be had so: a sweep takes whatever changes to
    the end at once, and only edges that lead back, of greatest lags, ask for more of them. None where it cannot, or there is
    no solution."""
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
    """Put beginnings (n) off where edges, sorted by the beads that they lead to, or the bead before ask for it; whether any
    has been."""
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
    """How long a travel takes at least [s], with the pause and the change of material in it."""
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
    """The travels with a rest in each before which what is below has to grow older: at home, or where the way there and back
    takes longer than the wait, lifted above the bead before; or slower ones, where neither can be reached."""
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
    """Travels without a rest, by their number, that would have to take longer, and how long [s]."""
    ends = start[:-1] + [path.duration for path in timed[:-1]]
    time = start[1:] - ends
    return {
        k + 1: float(time[k])
        for k in range(len(time))
        if not isinstance(travels[k + 1], ViaRest) and time[k] > travels[k + 1].duration + _SLIGHT
    }


def contacts_within(process: ProcessSpec, toolpath: Toolpath) -> BeadContacts | None:
    """Which places lie on which, where the process asks for a window of ages; else None."""
    return None if process.interlayer_time is None else contacts(toolpath.beads)
