"""The order of beads within layers, so that what lies below has the age that the process asks for when it is laid on.

Where every layer is laid in the order and the direction of the one before, each place is as old as a layer takes when the
next bead comes to lie on it. The order that travels least turns about at each layer instead: then ages go from nothing to
twice that. Neither is always best, so orders are compared by what the window makes of them: when their last bead is laid,
with the waits that the least age asks for, and by how much places would be too old.

Times are estimates here: length over commanded speed, and a usual time from bead to bead. How long is waited is decided when
the motion is timed (`planner.motion.interlayer`).
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
_WALLS_FIRST = ("*wall*",)  # of a filled mesh, where no order is asked for
_TO_TRAVEL = 0.16  # s beside runs and the way itself: to speed up, lift, and slow down
_BY_HOME = 3.0  # s to go home for another material, and come back
_TOO_OLD = 1e3  # s of print that a second too old is worth
_OUT_OF_ORDER = 1e6  # s that a bead before its rank is worth
_MOST_SEARCHED = 60  # beads of a layer up to which orders are improved bead by bead
_ROUNDS = 60  # of improvements
_LITTLE = 0.01  # of a layer's time: an order that loses less is not improved
_GAIN = 1e-6  # s that an improvement gains at least
_BINS = 4.0  # bead's widths in which beads are taken together for the bound
_SURE = 0.99  # of the bound: places are counted a quarter of a width apart


def with_interlayer_order(problem: Problem, toolpath: Toolpath, fixed: int = 0) -> Toolpath:
    """The toolpath whose layers are laid in such an order that ages stay within the window; as it is where none is asked for,
    and where the source's own order stands.

    fixed: so many beads come first whatever is asked for.
    Raises InputError for struts, which lie on no layer, and for a window that no order of the beads can hold.
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
    """Beads of one layer that come one after another; the first `fixed` of all stand apart."""
    edges = [0, *(i for i in range(1, len(beads)) if i == fixed or beads[i].layer != beads[i - 1].layer), len(beads)]
    return [range(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


# ----------------------------------------------------------------------------------------------------
# What takes how long, about.


@dataclass(frozen=True)
class _Estimate:
    """Of beads (k): how long they take to lay [s], their speed [m/s], both ends (k, 2, 3) [m], rank and material; and what
    all travel is estimated from."""

    process: ProcessSpec
    length: Array
    speed: Array
    ends: Array
    rank: Ints
    material: Ints

    @staticmethod
    def of(problem: Problem, toolpath: Toolpath, speeds: Array) -> _Estimate:
        """Of a toolpath whose beads are laid at speeds (k) [m/s]."""
        process, beads = problem.process, toolpath.beads
        own = problem.layers.material or next(iter(process.materials), "")
        names = [bead.material or own for bead in beads]
        filled = isinstance(problem.layers, VolumeLayersSpec) and len(set(names)) == 1  # else lines may come first, too
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
        """How long beads (k) are laid [s]."""
        return self.length / self.speed

    def travel(self, before: Ints, after: Ints) -> Array:
        """How long it takes (...) [s] from the end of beads `before` to the start of those `after` (...), both as numbers of
        directed beads: twice the bead's, and one more where it runs backwards."""
        start, end = self.ends[after // 2, after % 2], self.ends[before // 2, 1 - before % 2]
        way = np.linalg.norm(end - start, axis=-1) / self.process.travel_speed
        runs = self.process.run_in * (1.0 / self.speed[before // 2] + 1.0 / self.speed[after // 2])
        time = np.maximum(way + runs + _TO_TRAVEL, least_travel_time(self.process))
        change = self.material[before // 2] != self.material[after // 2]
        return np.asarray(time + np.where(change, self.process.change.time + _BY_HOME, 0.0))

    def travel_within(self, block: range) -> Callable[[Ints, Ints], Array]:
        """The same of a block's directed beads by their numbers in it; looked up where orders will be compared."""
        first = 2 * block.start
        if len(block) > _MOST_SEARCHED:
            return lambda before, after: self.travel(first + before, first + after)
        both = np.arange(first, 2 * block.stop)
        table = self.travel(both[:, None], both[None])
        return lambda before, after: np.asarray(table[before, after])

    def when(self, bead: Ints, s: Array, turned: Flags) -> Array:
        """How long (m) after its start a bead is laid at arc length s (m) [s]."""
        return np.where(turned, self.length[bead] - s, s) / self.speed[bead]


# ----------------------------------------------------------------------------------------------------
# The order within layers.


@dataclass(frozen=True)
class _OneLayer:
    """What decides the order of a layer's beads (n), of which there are two directed ones each: 2 b, and backwards 2 b + 1.

    time (2n)                how long each takes [s]
    travel, to (2n)          how long it takes from some to others, and to the first one [s]
    earliest, latest (2n)    when each may begin at the earliest, and is to begin at the latest [s]
    rank (2n)
    begin                    when the bead before has been laid [s]
    """

    time: Array
    travel: Callable[[Ints, Ints], Array]
    to: Array
    earliest: Array
    latest: Array
    rank: Ints
    begin: float

    def starts(self, rows: Ints) -> Array:
        """When (c, n) each directed bead of some orders (c, n) begins [s]."""
        out = np.empty(rows.shape)
        ways = np.column_stack([self.to[rows[:, 0]], self.travel(rows[:, :-1], rows[:, 1:])])
        now = np.full(len(rows), self.begin)
        for k, own in enumerate(rows.T):
            out[:, k] = np.maximum(now + ways[:, k], self.earliest[own])
            now = out[:, k] + self.time[own]
        return out

    def costs(self, rows: Ints) -> Array:
        """What orders (c, n) cost [s]: when their last bead ends, places that are too old, and beads before their rank."""
        starts = self.starts(rows)
        old = np.maximum(starts - self.latest[rows], 0.0).sum(axis=1)
        wrong = (np.diff(self.rank[rows], axis=1) < 0).sum(axis=1)
        return np.asarray(starts[:, -1] + self.time[rows[:, -1]] + _TOO_OLD * old + _OUT_OF_ORDER * wrong)


def _arranged(
    estimate: _Estimate, touching: BeadContacts, blocks: Sequence[range], spec: InterlayerTimeSpec
) -> tuple[Ints, Flags]:
    """The beads in the order in which they are laid, and which of them (by their number) run backwards."""
    order, turned = np.empty(0, dtype=np.int64), np.zeros(len(estimate.length), dtype=bool)
    start = np.full(len(estimate.length), np.nan)  # of the beads that have their place
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
    """What lies beneath a block's beads (n), of which there are two directed ones each: 2 b, and backwards 2 b + 1.

    earliest, latest (2n)  when each may begin at the earliest, and is to begin at the latest [s]
    age (n)                when what a bead follows in step was laid, on an average, counted from the bead's own beginning [s];
                           not a number where it lies on nothing
    back (n)               whether it is in step backwards
    """

    earliest: Array
    latest: Array
    age: Array
    back: Flags


def _beneath(
    estimate: _Estimate, touching: BeadContacts, block: range, start: Array, turned: Flags, spec: InterlayerTimeSpec
) -> _Beneath:
    """What lies beneath a block, where beads that have their place begin at `start` (k) [s], some of them `turned` (k)."""
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
    """The order of directed beads (n) that costs least, of the source's, the same backwards, and the one in step with what is
    below, each improved as long as there is something to gain."""
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
    """Directed beads (n) in the order in which what is below them was laid, by rank; those on nothing behind the one that comes
    before them in the source."""
    known = ~np.isnan(beneath.age)
    before = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    key = np.where(before >= 0, beneath.age[before], -np.inf)
    order = np.lexsort((np.arange(len(known)), key, layer.rank[::2]))
    return np.asarray(2 * order + beneath.back[order])


def _improved(layer: _OneLayer, row: Ints) -> Ints:
    """An order (n) from which no bead that is turned round or moved, and no stretch that is turned round, gains anything."""
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
    """Orders (c, n) beside one of n beads, as its places, and 1 where the bead is turned round: a stretch run backwards, or a
    bead at another place, either way round."""
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
# A window that no order can hold.


def _check_most(
    problem: Problem, toolpath: Toolpath, touching: BeadContacts, blocks: Sequence[range], speeds: Array, most: float
) -> None:
    """Raise the InputError of a greatest age that places exceed on an average, whatever their order."""
    worst, where = 0.0, 0
    block_of = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    pauses = {pause.before_layer - 1: pause.time for pause in problem.process.pauses}
    for k, block in enumerate(blocks):
        rows = np.arange(*np.searchsorted(touching.upper, [block.start, block.stop]))
        order = rows[np.lexsort((touching.at[rows], touching.upper[rows]))]
        again = (np.diff(touching.upper[order]) == 0) & (np.diff(touching.at[order]) == 0.0)
        rows = order[np.append(True, ~again)[: len(order)]]  # one below each place
        beneath = block_of[touching.lower[rows]]
        for j in np.unique(beneath[beneath < k]).tolist():
            layer = toolpath.beads[block.start].layer
            age = _mean_age(touching, rows[beneath == j], toolpath, speeds) + pauses.get(layer, 0.0)
            worst, where = (age, layer) if age > worst else (worst, where)
    if _SURE * worst > most:
        reason = (
            f"is {most:g} s, and places below layer {where + 1} are {worst:.1f} s old on an average when they are laid on, "
            "in whatever order beads are laid"
        )
        hint = (
            f"at least {np.ceil(worst * 10.0) / 10.0:g} and what travel takes, a higher speed_mm_s, or less in a layer"
        )
        raise problem.error("process.interlayer_time.most_s", reason, hint)


def _mean_age(touching: BeadContacts, rows: Ints, toolpath: Toolpath, speeds: Array) -> float:
    """The least mean age [s] that places (m) of one layer can have, which lie on another one, without any travel.

    The later half of what is below cannot all be laid last, nor the earlier half of what is above first: the mean time of
    the places above is half of what they take behind the layer's beginning at least, and that of the places below, each
    counted as often as it is laid on, as far before the layer's end as if the ones counted most often came last.
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
    """The toolpath with its beads in an order, some of them run backwards; a note tells how many layers that changes."""
    moved = (order != np.arange(len(order))) | turned[order]
    if not moved.any():
        return toolpath
    beads = tuple(_turned(toolpath.beads[i]) if turned[i] else toolpath.beads[i] for i in order.tolist())
    length = np.array([bead.length for bead in beads])
    surface = ArrangedSurface(toolpath.surface, order, np.where(turned[order], length, np.nan))
    count = len({beads[i].layer for i in np.flatnonzero(moved).tolist()})
    layers = "1 layer is" if count == 1 else f"{count} layers are"
    note = f"{layers} laid in another order or direction than travels least, so that ages stay within process.interlayer_time"
    return replace(toolpath, beads=beads, surface=surface, notes=(*toolpath.notes, note))


def _turned(bead: Bead) -> Bead:
    """The same bead, run backwards."""
    backwards = {
        name: getattr(bead, name)[::-1].copy()
        for name in ("points", "normals", "roll_zero", "source", "width", "height")
    }
    return replace(bead, s=bead.length - bead.s[::-1], short_runs=bead.short_runs[::-1], **backwards)


@dataclass(frozen=True)
class ArrangedSurface(ReadOnlyArrays, SurfaceOver):
    """The surface beneath a toolpath whose layers are laid in another order.

    origin (k)  number that each bead had;  turned (k)  its length where it runs backwards [m], else not a number
    """

    origin: Ints
    turned: Array

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Normals on which a bead is laid."""
        length = float(self.turned[bead])
        return self.surface.normals_on(int(self.origin[bead]), s if np.isnan(length) else length - s, tips)

    def before(self, bead: int) -> Surface:
        """The surface when so many beads have been printed: it knows of whole layers, and each is still in its place."""
        return self.surface.before(bead)
