"""What the refinement works on: a cell's model, a segment of a path, its state, and clearance along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.geometry import arc_lengths
from planner.base.processes import in_blocks
from planner.collision.margins import nearest_margins
from planner.collision.scene import BLOCK, NOTHING, Obstacles
from planner.resolve.follow import HolderNumbers
from planner.resolve.price_kernels import RowPlaces, RowsFilled
from planner.resolve.prices import CLEARANCE_UNIT
from planner.resolve.reach import ArmNumbers
from planner.toolpath.task import Cones

# ----------------------------------------------------------------------------------------------------
# Clearance in the refinement: the least margins of a path, how they change with its free variables, rows of a program.
#
# Only near bodies are checked: where all postures are far from everything, there is nothing to hold.

COMFORT = 15e-3  # m of margin above which nothing is held: three times what arms keep
COMFORT_OF_POINTS = 2e-3  # m, the same for part and print: looking farther around the nozzle takes five times as long
EVERY = 1e-3  # m that the tip moves between samples that are checked, where margins are small
SPARSE = 4  # × EVERY elsewhere
_SMALL = 6e-3  # m
ROOM = 2e-4  # m of margin that is required, since paths are only checked at samples
_ROWS = 4  # pairs of a sample that are held
_FEW = 2  # blocks of postures that are checked sooner than threads start
_STILL = 1e-6  # m/rad: margins that change by less do not change


Rows = tuple[Array, Array, Ints, Array]  # of a program: A (r, w), b (r), at (r), price (r)


@dataclass(frozen=True)
class Clearances:
    """Margins below COMFORT along n samples: sample (k) and margin (k) [m] of each, slope (k, m) by free variables
    [m/rad]; time (n): how many samples each checked one stands for."""

    time: Array
    sample: Ints
    margin: Array
    slope: Array


def clearances(
    obstacles: Obstacles, q: Array, G: Array, now: Array, tip: Array, first: int = 0, *, held: bool = True
) -> Clearances:
    """The least margins of postures q (n, nj) at times now (n), the nozzle's tip at tip (n, 3); G (n, nj, m) is dq/dz.

    first: the sample to begin with; those before are ignored.
    held: whether margins are to be held; if not, only those that fall short are returned.
    """
    n, nj = q.shape
    if not obstacles.any:
        return Clearances(np.zeros(n), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, G.shape[2])))
    gone = arc_lengths(tip) // EVERY
    begins = np.concatenate([np.ones(1, dtype=np.bool_), np.diff(gone) > 0.0])
    begins[:first], begins[first] = False, True
    fine = np.flatnonzero(begins)
    margin, slope = np.empty((n, _ROWS)), np.empty((n, _ROWS, nj))
    which = np.empty((n, _ROWS), dtype=np.int64)
    wanted, comfort = np.zeros(n, dtype=np.bool_), (COMFORT, COMFORT_OF_POINTS) if held else (ROOM, ROOM)

    def look(at: Ints) -> None:
        mask = np.zeros(n, dtype=np.bool_)
        mask[at] = wanted[at] = True
        in_blocks(
            lambda b: nearest_margins(obstacles.table, q[b], now[b], mask[b], *comfort, margin[b], slope[b], which[b]),
            n,
            BLOCK,
            _FEW,
        )

    if held:
        look(fine[::SPARSE])
        look(fine[_beside_small(margin[fine[::SPARSE]], slope[fine[::SPARSE]], len(fine))])
    else:
        look(fine)
    group = np.cumsum(wanted)[first:] - 1
    time = np.zeros(n)
    time[first:] = np.where(wanted[first:], np.bincount(group)[group], 0)
    margin[~wanted] = np.inf
    sample, row = np.nonzero(margin < comfort[0])
    return Clearances(time, sample, margin[sample, row], np.einsum("kj,kjm->km", slope[sample, row], G[sample]))


def _beside_small(margin: Array, slope: Array, count: int) -> Ints:
    """Which of `count` samples are next to one with a small margin that can change.

    Every SPARSE-th sample has margins (k, rows) with slopes (k, rows, nj); those between it and its neighbours count.
    """
    small = ((margin < _SMALL) & (np.abs(slope).sum(axis=2) > _STILL)).any(axis=1)
    between = np.repeat(small | np.append(small[1:], False), SPARSE)[:count]
    between[::SPARSE] = False
    return np.flatnonzero(between)


def shortage(near: Clearances) -> Array:
    """Missing clearance (n), in the units of a cone's excess."""
    lacking = np.zeros(len(near.time))
    np.add.at(lacking, near.sample, CLEARANCE_UNIT * near.time[near.sample] * np.maximum(ROOM - near.margin, 0.0))
    return lacking


def clearance_rows(near: Clearances, step: Array, first: Ints, B: Array, free: Array, trust: float) -> Rows:
    """Rows A (r, w) x <= b (r) that keep margins, their first variables (r), and the time each stands for (r) [s].

    Only margins that a step within `trust` [rad] could use up have rows.
    """
    reach = trust * np.abs(near.slope).sum(axis=1)
    held = np.flatnonzero((reach > near.margin - ROOM) & (reach > trust * _STILL))
    i, m, width = near.sample[held], near.slope.shape[1], B.shape[2]
    moved = B[i, 0] * free[first[i][:, None] + np.arange(width)]
    A = -CLEARANCE_UNIT * moved[:, :, None] * near.slope[held][:, None, :]
    return (
        A.reshape(len(held), width * m),
        CLEARANCE_UNIT * (near.margin[held] - ROOM),
        first[i] * m,
        near.time[i] * step[i],
    )


# ----------------------------------------------------------------------------------------------------
# What the refinement works on: a cell's model, a stretch of samples, a path over it, and what a program watches of it.

ROLL, TILT, HOLDER = 0, (1, 2), 3  # columns of z; given arm joints come after the holder's


@dataclass(frozen=True)
class Model:
    """What the kernels need of a cell: arm, holder, limits, obstacles.

    numbers, holder: of the arm and of what holds the part; given (k): arm joints that are free themselves
    limits (3, nj) of velocity, acceleration, jerk, `RATE_SHARES` of the cell's
    low, high (nj): ends of the joints' ranges; arm: number of the arm's joints; names (nj) of all joints
    terms, whose sum is the price of a path
    """

    numbers: ArmNumbers
    holder: HolderNumbers
    given: Ints
    limits: Array
    low: Array
    high: Array
    arm: int
    names: tuple[str, ...]
    terms: tuple[Term, ...]
    obstacles: Obstacles = NOTHING

    @property
    def arm_range(self) -> tuple[Array, Array]:
        """Ends (na) of the ranges of the arm's joints."""
        return self.low[: self.arm], self.high[: self.arm]

    @property
    def columns(self) -> int:
        """Number of columns of z."""
        return HOLDER + len(self.low) - self.arm + len(self.given)

    def active(self, cones: Cones) -> Ints:
        """Columns of z that may be chosen."""
        tilt = TILT if cones.tilt > 0.0 else ()
        return np.array([ROLL, *tilt, *range(HOLDER, self.columns)])


@dataclass(frozen=True)
class PathSegment:
    """A stretch of a task's n samples, and the k control values that it depends on.

    tip, frames, normals, cones   of the task
    step (n)                  time that a sample stands for at the commanded speed [s]; 0: ignored here
    deposits (n)              1 where material is laid down, else 0
    centre (n), D (n, 3, 5)   as in Clock; first (n), B (n, 4, degree + 1) as in Basis
    free (k)                  1 for control values that may move, else 0
    now (n)                   when samples are reached, see `NozzleTask.moments`
    anchor (k, m), hold (k)   where the path's ends were given, and 1 for control values that are ends, else 0
    peak                      speed of joints that counts as a peak, see `refine.calmed`; inf: none does
    """

    tip: Array
    frames: Array
    normals: Array
    cones: Cones
    step: Array
    deposits: Array
    centre: Ints
    D: Array
    first: Ints
    B: Array
    free: Array
    anchor: Array
    hold: Array
    now: Array
    peak: float = np.inf


@dataclass(frozen=True)
class PathState:
    """A path over a stretch: control values c (k, m), what follows from them (see the kernels), and its price [s].

    least_sigma: the least singular value that it must keep
    lean (n, b, 2), lean_slope (n, b, 2, m), cones (b): of the directions that are bounded, and by what [rad]; where the
    nozzle may tilt the last one is its lean from the surface normal
    near: the least clearances
    """

    c: Array
    q: Array
    G: Array
    sigma: Array
    sigma_slope: Array
    rates: Array
    slack: Array
    lean: Array
    lean_slope: Array
    cones: Array
    near: Clearances
    least_sigma: float
    price: float = 0.0


@dataclass(frozen=True)
class Watch:
    """What a program watches: rates (n, 3, nj, 2), upwards and downwards, facets (n, b, FACETS.size) of b cones, and
    the arm's joints (n, na) for the nearer end of their range."""

    rates: Flags
    facets: Flags
    ends: Flags


# ----------------------------------------------------------------------------------------------------
# What a term of the price does. The terms themselves: `terms`.


@dataclass(frozen=True)
class Expansion:
    """A path's price around it, except for its bounds: control values that move by x add g x + x H x / 2.

    H (k m, w) lower band, g (k m); slopes (n, 3 nj, w): of the rates, as shares of their limits
    """

    H: Array
    g: Array
    slopes: Array


@dataclass(frozen=True)
class Step:
    """A step of the control values: x (k m), and the joints q (n, nj) that it leads to, to first order."""

    x: Array
    q: Array


class Term:
    """One term of a path's price: a frozen dataclass that overrides what it needs of these methods.

    A term adds its smooth part to the quadratic program around a path (`expand`), and rows for its bounds: either
    sample by sample, among other terms' rows (`watch`, `missed`, `count`, `fill`), or rows of its own (`further`). To
    first order, the program changes as `price` does.
    """

    name: ClassVar[str]

    def price(self, model: Model, stretch: PathSegment, state: PathState) -> float:
        """What a path costs [s]."""
        raise NotImplementedError

    def expand(self, model: Model, stretch: PathSegment, state: PathState, around: Expansion) -> None:
        """Add the smooth part of the price around a state to H and g."""

    def watch(self, model: Model, stretch: PathSegment, state: PathState, trust: float, watch: Watch) -> None:
        """Mark what needs rows from the start, for control values that move by at most `trust` [rad]."""

    def missed(
        self, model: Model, stretch: PathSegment, state: PathState, around: Expansion, step: Step, watch: Watch
    ) -> int:
        """Mark the bounds without a row that a step violates; returns how many."""
        return 0

    def count(self, stretch: PathSegment, state: PathState, watch: Watch) -> tuple[Ints, Ints] | None:
        """Numbers of rows (n), and of groups that share a slack (n), at each sample; None if there are never any."""
        return None

    def fill(
        self,
        model: Model,
        stretch: PathSegment,
        state: PathState,
        around: Expansion,
        watch: Watch,
        places: RowPlaces,
        rows: RowsFilled,
    ) -> None:
        """Write the counted rows to their places."""

    def further(self, model: Model, stretch: PathSegment, state: PathState, trust: float) -> Rows | None:
        """Rows A (r, w) x <= b (r), first variable at (r) and price (r) [s per unit], each with a slack of its own."""
        return None
