"""Orders beads within layers so that the material below has the required age when the next bead is laid on it.

If every layer is laid in the order and direction of the one before, each place is one layer time old when the next bead
is laid on it. The order that travels least reverses at each layer instead: ages then range from zero to twice that.
Neither is always best, so orders are compared by how they suit the window: when their last bead is finished, including
the waits for the least age, and by how much places would be too old.

Times here are estimates: length over commanded speed, and a typical time from bead to bead. The actual waits are set
when the motion is timed (`planner.motion.interlayer`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from planner.base.arrays import Array, Flags, Ints, ReadOnlyArrays
from planner.problem import Problem
from planner.problem.by_layer import InterlayerTimeSpec
from planner.problem.layers import GcodeLayersSpec, VolumeLayersSpec, WaypointLayersSpec
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Surface, SurfaceOver, Toolpath
from planner.toolpath.contacts import BeadContacts, contacts
from planner.toolpath.ordering import rank
from planner.toolpath.runs import least_travel_time
from planner.toolpath.speeds import commanded_speeds

AS_THE_FILE_SAYS = (GcodeLayersSpec, WaypointLayersSpec)  # sources whose beads are laid in their own order
_WALLS_FIRST = ("*wall*",)  # default order of a filled mesh
_TO_TRAVEL = 0.16  # s, besides the runs and the distance itself: to speed up, lift and slow down
_BY_HOME = 3.0  # s to go home for another material and come back
_TOO_OLD = 1e3  # s of print time that each second of excess age costs
_OUT_OF_ORDER = 1e6  # s of print time that each bead before its rank costs
_MOST_SEARCHED = 60  # beads: orders of larger layers are not improved bead by bead
_ROUNDS = 60  # of improvement at most
_LITTLE = 0.01  # × a layer's time: an order that loses less is not improved
_GAIN = 1e-6  # s: least gain that counts as an improvement
_BINS = 4.0  # × bead width: bins along lower beads for the lower bound on age
_SURE = 0.99  # × the bound: it is computed from places a quarter of a width apart


def with_interlayer_order(problem: Problem, toolpath: Toolpath, fixed: int = 0) -> Toolpath:
    """Order the beads of each layer so that ages stay within the window.

    The order is unchanged if no window is given, or if the source fixes it.

    fixed: number of beads that always come first
    Raises InputError for struts, which lie on no layer, and for a window that no order of the beads can satisfy.
    """
    process, spec = problem.process, problem.process.interlayer_time
    if spec is None:
        return toolpath
    if any(bead.round for bead in toolpath.beads):
        reason = "struts in space lie on no layer below, so that there is no time between layers"
        raise problem.error("process.interlayer_time", reason, "leave it out")
    touching, blocks = contacts(toolpath.beads), _blocks(toolpath.beads, fixed)
    speeds = commanded_speeds(process, toolpath)
    if spec.most is not None:
        _check_most(problem, toolpath, touching, blocks, speeds, spec.most)
    if isinstance(problem.layers, AS_THE_FILE_SAYS):
        note = "beads are laid in the file's own order: process.interlayer_time is kept by waits alone"
        return replace(toolpath, notes=(*toolpath.notes, note))
    estimate = _Estimate.of(problem, toolpath, speeds)
    order, turned = _arranged(estimate, touching, blocks, spec)
    return _in_this_order(toolpath, order, turned)


def _blocks(beads: Sequence[Bead], fixed: int) -> list[range]:
    """Ranges of consecutive beads of one layer; the first `fixed` beads are kept separate."""
    edges = [0, *(i for i in range(1, len(beads)) if i == fixed or beads[i].layer != beads[i - 1].layer), len(beads)]
    return [range(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


# ----------------------------------------------------------------------------------------------------
# Estimated times.


@dataclass(frozen=True)
class _Estimate:
    """Beads (k): their length [m], speed [m/s], both ends (k, 2, 3) [m], rank and material; and the process, from which
    travel is estimated."""

    process: ProcessSpec
    length: Array
    speed: Array
    ends: Array
    rank: Ints
    material: Ints

    @staticmethod
    def of(problem: Problem, toolpath: Toolpath, speeds: Array) -> _Estimate:
        """The estimate for a toolpath whose beads are laid at speeds (k) [m/s]."""
        process, beads = problem.process, toolpath.beads
        own = problem.layers.material or next(iter(process.materials), "")
        names = [bead.material or own for bead in beads]
        filled = isinstance(problem.layers, VolumeLayersSpec) and len(set(names)) == 1  # else lines may come first
        patterns = process.order or (_WALLS_FIRST if filled else ())
        return _Estimate(
            process,
            np.array([bead.length for bead in beads]),
            speeds,
            np.array([[bead.points[0], bead.points[-1]] for bead in beads]),
            np.array([rank(bead.name, patterns) for bead in beads]),
            np.unique(names, return_inverse=True)[1],
        )

    @property
    def time(self) -> Array:
        """Time to lay each bead (k) [s]."""
        return self.length / self.speed

    def travel(self, before: Ints, after: Ints) -> Array:
        """Time (...) [s] from the end of beads `before` (...) to the start of beads `after` (...).

        Both are numbers of directed beads: twice the bead's, plus one if it runs backwards.
        """
        start, end = self.ends[after // 2, after % 2], self.ends[before // 2, 1 - before % 2]
        way = np.linalg.norm(end - start, axis=-1) / self.process.travel_speed
        runs = self.process.run_in * (1.0 / self.speed[before // 2] + 1.0 / self.speed[after // 2])
        time = np.maximum(way + runs + _TO_TRAVEL, least_travel_time(self.process))
        change = self.material[before // 2] != self.material[after // 2]
        return np.asarray(time + np.where(change, self.process.change.time + _BY_HOME, 0.0))

    def travel_within(self, block: range) -> Callable[[Ints, Ints], Array]:
        """The same for a block's directed beads, numbered within it; tabulated if orders will be compared."""
        first = 2 * block.start
        if len(block) > _MOST_SEARCHED:
            return lambda before, after: self.travel(first + before, first + after)
        both = np.arange(first, 2 * block.stop)
        table = self.travel(both[:, None], both[None])
        return lambda before, after: np.asarray(table[before, after])

    def when(self, bead: Ints, s: Array, turned: Flags) -> Array:
        """Time (m) [s] from a bead's start until it is laid at arc length s (m) [m]."""
        return np.where(turned, self.length[bead] - s, s) / self.speed[bead]


# ----------------------------------------------------------------------------------------------------
# The order within layers.


@dataclass(frozen=True)
class _OneLayer:
    """What decides the order of a layer's beads (n); bead b is two directed ones: 2 b, and 2 b + 1 backwards.

    time (2n)                how long each takes [s]
    travel, to (2n)          travel time from some to others, and to each as the first one [s]
    earliest, latest (2n)    when each may begin at the earliest, and should begin at the latest [s]
    rank (2n)
    begin                    when the previous bead is finished [s]
    """

    time: Array
    travel: Callable[[Ints, Ints], Array]
    to: Array
    earliest: Array
    latest: Array
    rank: Ints
    begin: float

    def starts(self, rows: Ints) -> Array:
        """Start times (c, n) [s] of the directed beads in orders (c, n)."""
        out = np.empty(rows.shape)
        ways = np.column_stack([self.to[rows[:, 0]], self.travel(rows[:, :-1], rows[:, 1:])])
        now = np.full(len(rows), self.begin)
        for k, own in enumerate(rows.T):
            out[:, k] = np.maximum(now + ways[:, k], self.earliest[own])
            now = out[:, k] + self.time[own]
        return out

    def costs(self, rows: Ints) -> Array:
        """Costs (c) of orders (c, n) [s]: end of the last bead, plus penalties for excess age and beads out of rank."""
        starts = self.starts(rows)
        old = np.maximum(starts - self.latest[rows], 0.0).sum(axis=1)
        wrong = (np.diff(self.rank[rows], axis=1) < 0).sum(axis=1)
        return np.asarray(starts[:, -1] + self.time[rows[:, -1]] + _TOO_OLD * old + _OUT_OF_ORDER * wrong)


def _arranged(
    estimate: _Estimate, touching: BeadContacts, blocks: Sequence[range], spec: InterlayerTimeSpec
) -> tuple[Ints, Flags]:
    """The order in which beads are laid, and which of them (by number) run backwards."""
    order, turned = np.empty(0, dtype=np.int64), np.zeros(len(estimate.length), dtype=bool)
    start = np.full(len(estimate.length), np.nan)  # of the beads placed so far
    last, now = -1, 0.0
    for block in blocks:
        both = np.arange(2 * block.start, 2 * block.stop)
        beneath = _beneath(estimate, touching, block, start, turned, spec)
        layer = _OneLayer(
            np.repeat(estimate.time[block.start : block.stop], 2),
            estimate.travel_within(block),
            np.zeros(len(both)) if last < 0 else estimate.travel(np.full(len(both), last), both),
            beneath.earliest,
            beneath.latest,
            np.repeat(estimate.rank[block.start : block.stop], 2),
            now,
        )
        taken = _best(layer, beneath) if np.isfinite(beneath.age).any() else np.arange(0, len(both), 2)
        begins = layer.starts(taken[None])[0]
        beads = block.start + taken // 2
        order, turned[beads], start[beads] = np.append(order, beads), taken % 2 == 1, begins
        last, now = int(both[taken[-1]]), float(begins[-1] + layer.time[taken[-1]])
    return order, turned


@dataclass(frozen=True)
class _Beneath:
    """What lies beneath a block's beads (n); bead b is two directed ones: 2 b, and 2 b + 1 backwards.

    earliest, latest (2n)  when each may begin at the earliest, and should begin at the latest [s]
    age (n)                when the material that a bead follows in step was laid: mean, each time less what the bead
                           itself takes to get there [s]; NaN if it lies on nothing
    back (n)               whether it is in step when it runs backwards
    """

    earliest: Array
    latest: Array
    age: Array
    back: Flags


def _beneath(
    estimate: _Estimate, touching: BeadContacts, block: range, start: Array, turned: Flags, spec: InterlayerTimeSpec
) -> _Beneath:
    """What lies beneath a block; beads placed so far begin at `start` (k) [s], some of them `turned` (k)."""
    n = len(block)
    rows = np.arange(*np.searchsorted(touching.upper, [block.start, block.stop]))
    rows = rows[~np.isnan(start[touching.lower[rows]])]
    upper, lower = touching.upper[rows], touching.lower[rows]
    own = upper - block.start
    laid = start[lower] + estimate.when(lower, touching.below[rows], turned[lower])
    earliest, latest = np.full((n, 2), -np.inf), np.full((n, 2), np.inf)
    count = np.bincount(own, minlength=n)
    mean, spread = np.full((2, n), np.nan), np.full((2, n), np.nan)
    on = count > 0
    for back in (0, 1):
        begin = laid - estimate.when(upper, touching.at[rows], np.full(len(rows), bool(back)))
        np.maximum.at(earliest[:, back], own, begin + (-np.inf if spec.least is None else spec.least))
        np.minimum.at(latest[:, back], own, begin + (np.inf if spec.most is None else spec.most))
        mean[back, on] = np.bincount(own, begin, minlength=n)[on] / count[on]
        spread[back, on] = np.bincount(own, begin**2, minlength=n)[on] / count[on] - mean[back, on] ** 2
    in_step = spread[1] < spread[0] - _GAIN
    return _Beneath(earliest.ravel(), latest.ravel(), np.where(in_step, mean[1], mean[0]), in_step)


def _best(layer: _OneLayer, beneath: _Beneath) -> Ints:
    """The cheapest order of directed beads (n): the source's, its reverse, or the one in step with the layer below.

    If there is enough to gain and the layer is small enough, all three are improved first.
    """
    n = len(layer.time) // 2
    source = 2 * np.arange(n)
    plans = [source, source[::-1] + 1, _in_step(layer, beneath)]
    costs = layer.costs(np.array(plans))
    free = replace(layer, earliest=np.full(2 * n, -np.inf), latest=np.full(2 * n, np.inf)).costs(source[None])[0]
    if costs.min() > free + _LITTLE * (free - layer.begin) and n <= _MOST_SEARCHED:
        plans = [_improved(layer, each) for each in plans]
        costs = layer.costs(np.array(plans))
    return plans[int(np.argmax(costs <= costs.min() + _GAIN))]


def _in_step(layer: _OneLayer, beneath: _Beneath) -> Ints:
    """Directed beads (n), by rank, in the order in which the material below them was laid.

    A bead on nothing comes after the one before it in the source.
    """
    known = ~np.isnan(beneath.age)
    before = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    key = np.where(before >= 0, beneath.age[before], -np.inf)
    order = np.lexsort((np.arange(len(known)), key, layer.rank[::2]))
    return np.asarray(2 * order + beneath.back[order])


def _improved(layer: _OneLayer, row: Ints) -> Ints:
    """Improve an order (n) until no reversal of a bead or stretch, and no move of a bead, gains anything."""
    cost = layer.costs(row[None])[0]
    places, turned = _moves(len(row))
    for _ in range(_ROUNDS):
        others = row[places] ^ turned
        costs = layer.costs(others)
        k = int(np.argmin(costs))
        if costs[k] > cost - _GAIN:
            break
        row, cost = others[k], costs[k]
    return row


@lru_cache(maxsize=8)
def _moves(n: int) -> tuple[Ints, Ints]:
    """Neighbours (c, n) of an order of n beads: indices into it, and 1 where the bead is reversed.

    In a neighbour, a stretch is reversed, or one bead is moved elsewhere, in either direction.
    """
    places: list[Ints] = []
    turned: list[Ints] = []
    row, none = np.arange(n), np.zeros(n, dtype=np.int64)
    for i in range(n):
        for j in range(i, n):
            places.append(np.concatenate([row[:i], row[i : j + 1][::-1], row[j + 1 :]]))
            turned.append(((row >= i) & (row <= j)).astype(np.int64))
        rest = np.delete(row, i)
        for j in range(n):
            if j != i:
                places += [np.insert(rest, j, i)] * 2
                turned += [none, (row == j).astype(np.int64)]
    return np.array(places), np.array(turned)


# ----------------------------------------------------------------------------------------------------
# A window that no order can satisfy.


def _check_most(
    problem: Problem, toolpath: Toolpath, touching: BeadContacts, blocks: Sequence[range], speeds: Array, most: float
) -> None:
    """Raise InputError if places exceed the greatest age on average, whatever their order."""
    worst, where = 0.0, 0
    block_of = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    pauses = {pause.before_layer - 1: pause.time for pause in problem.process.pauses}
    for k, block in enumerate(blocks):
        rows = np.arange(*np.searchsorted(touching.upper, [block.start, block.stop]))
        order = rows[np.lexsort((touching.at[rows], touching.upper[rows]))]
        again = (np.diff(touching.upper[order]) == 0) & (np.diff(touching.at[order]) == 0.0)
        rows = order[np.append(True, ~again)[: len(order)]]  # one contact of each place
        beneath = block_of[touching.lower[rows]]
        for j in np.unique(beneath[beneath < k]).tolist():
            layer = toolpath.beads[block.start].layer
            age = _mean_age(touching, rows[beneath == j], toolpath, speeds) + pauses.get(layer, 0.0)
            worst, where = (age, layer) if age > worst else (worst, where)
    if _SURE * worst > most:
        reason = (
            f"is {most:g} s, and places below layer {where + 1} are {worst:.1f} s old on average when beads are laid on them, "
            "whatever the order of beads"
        )
        hint = f"at least {np.ceil(worst * 10.0) / 10.0:g} plus the time for travel, a higher speed_mm_s, or less in a layer"
        raise problem.error("process.interlayer_time.most_s", reason, hint)


def _mean_age(touching: BeadContacts, rows: Ints, toolpath: Toolpath, speeds: Array) -> float:
    """Lower bound on the mean age [s] of one layer's places (m) when another layer is laid on them, without travel.

    Places below cannot all be laid last, nor those above first. On average, those above come at least half of their
    total time after their layer begins. Those below, weighted by how often they are laid on, come at least as long
    before their layer ends as if the ones with the most weight came last.
    """
    upper, lower = touching.upper[rows], touching.lower[rows]
    lengths = np.array([bead.length for bead in toolpath.beads])
    within = (touching.at[rows] > 0.0) & (touching.at[rows] < lengths[upper])  # at its ends a bead has half a step
    weight = np.where(within, 1.0, 0.5) * touching.around[rows] / speeds[upper]
    widths = np.array([float(bead.width.min()) for bead in toolpath.beads])
    size = _BINS * widths
    key = np.column_stack([lower, (touching.below[rows] / size[lower]).astype(np.int64)])
    bins, which = np.unique(key, axis=0, return_inverse=True)
    mass = np.bincount(which.ravel(), weight)
    whole = np.minimum(size[bins[:, 0]], lengths[bins[:, 0]] - bins[:, 1] * size[bins[:, 0]])
    time = np.maximum(whole, 1e-9) / speeds[bins[:, 0]]
    order = np.argsort(-mass / time)
    before_end = np.cumsum(time[order]) - 0.5 * time[order]
    return float(0.5 * weight.sum() + (mass[order] * before_end).sum() / mass.sum())


# ----------------------------------------------------------------------------------------------------
# The toolpath in another order.


def _in_this_order(toolpath: Toolpath, order: Ints, turned: Flags) -> Toolpath:
    """The toolpath with its beads in the given order, some reversed; a note says how many layers this changes."""
    moved = (order != np.arange(len(order))) | turned[order]
    if not moved.any():
        return toolpath
    beads = tuple(_turned(toolpath.beads[i]) if turned[i] else toolpath.beads[i] for i in order.tolist())
    length = np.array([bead.length for bead in beads])
    surface = ArrangedSurface(toolpath.surface, order, np.where(turned[order], length, np.nan))
    count = len({beads[i].layer for i in np.flatnonzero(moved).tolist()})
    layers = "1 layer is" if count == 1 else f"{count} layers are"
    note = f"{layers} laid in an order or direction other than that of least travel, so that ages stay within process.interlayer_time"
    return replace(toolpath, beads=beads, surface=surface, notes=(*toolpath.notes, note))


def _turned(bead: Bead) -> Bead:
    """The bead run backwards."""
    backwards = {
        name: getattr(bead, name)[::-1].copy()
        for name in ("points", "normals", "roll_zero", "source", "width", "height")
    }
    return replace(bead, s=bead.length - bead.s[::-1], short_runs=bead.short_runs[::-1], **backwards)


@dataclass(frozen=True)
class ArrangedSurface(ReadOnlyArrays, SurfaceOver):
    """The surface beneath a toolpath whose layers are laid in another order.

    origin (k)  number that each bead had;  turned (k)  its length if it runs backwards [m], otherwise NaN
    """

    origin: Ints
    turned: Array

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Normals beneath a bead."""
        length = float(self.turned[bead])
        return self.surface.normals_on(int(self.origin[bead]), s if np.isnan(length) else length - s, tips)

    def before(self, bead: int) -> Surface:
        """The surface after so many beads: it knows whole layers only, and these have kept their place."""
        return self.surface.before(bead)
