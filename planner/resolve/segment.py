"""What the refinement works on: a cell's model, a segment of a path, its state, and clearance along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.processes import in_blocks
from planner.cell.cell import Cell
from planner.collision.margins import nearest_margins
from planner.collision.scene import BLOCK, NOTHING, Obstacles
from planner.resolve.follow import HolderNumbers
from planner.resolve.prices import CLEARANCE_UNIT
from planner.resolve.reach import ArmNumbers, arm_numbers
from planner.toolpath.task import Cones

# ----------------------------------------------------------------------------------------------------
# Clearance in the refinement: the least margins of a path, how they change with its free variables, rows of a program.
#
# Only what is near is looked at: where all postures are far from everything there is nothing to hold.

COMFORT = 15e-3  # m of margin above which nothing is held: three times what arms keep
COMFORT_OF_POINTS = 2e-3  # m, the same of part and print: to look farther around the nozzle takes five times as long
EVERY = 1e-3  # m of the tip's way from one sample that is looked at to the next, where margins are small
SPARSE = 4  # times as far elsewhere
_SMALL = 6e-3  # m
ROOM = 2e-4  # m of margin that is asked for, since paths are looked at in samples
_ROWS = 4  # pairs of a sample that are held
_FEW = 2  # blocks of postures that are looked at sooner than threads begin
_STILL = 1e-6  # m/rad: margins that change by less do not change


@dataclass(frozen=True)
class Clearances:
    """Margins below COMFORT along n samples: sample (k) and margin (k) [m] of each, slope (k, m) by free variables
    [m/rad]; time (n): what a sample stands for among those that are looked at, in samples."""

    time: Array
    sample: Ints
    margin: Array
    slope: Array


def clearances(
    obstacles: Obstacles, q: Array, G: Array, now: Array, tip: Array, first: int = 0, *, held: bool = True
) -> Clearances:
    """The least margins of postures q (n, nj) at times now (n), the nozzle's tip at tip (n, 3); G (n, nj, m) is dq/dz.

    first: the sample to begin with; those before are of no concern.
    held: whether margins are to be held; if not, only those that lack something come back.
    """
    n, nj = q.shape
    if not obstacles.any:
        return Clearances(np.zeros(n), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, G.shape[2])))
    gone = np.concatenate([np.zeros(1), np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))]) // EVERY
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
    """Which of `count` samples, each SPARSE-th of which has margins (k, rows) with slopes (k, rows, nj), lie between
    two of them one of which has a small margin that can change."""
    small = ((margin < _SMALL) & (np.abs(slope).sum(axis=2) > _STILL)).any(axis=1)
    between = np.repeat(small | np.append(small[1:], False), SPARSE)[:count]
    between[::SPARSE] = False
    return np.flatnonzero(between)


def shortage(near: Clearances) -> Array:
    """What lacks (n, 1), in the units of a cone's excess."""
    lacking = np.zeros(len(near.time))
    np.add.at(lacking, near.sample, CLEARANCE_UNIT * near.time[near.sample] * np.maximum(ROOM - near.margin, 0.0))
    return lacking[:, None]


def clearance_rows(
    near: Clearances, step: Array, first: Ints, B: Array, free: Array, trust: float
) -> tuple[Array, Array, Ints, Array]:
    """Rows A (r, w) x <= b (r) that keep margins, from which variable on (r), and the time each stands for (r) [s].

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
CONE_SIDES = 12  # of the polygon inside the circle that bounds tilt
_NEAR_SIDE = 0.3  # of the cone about tilt: who is as near to a side of its polygon has it watched from the start
_MISSED_SIDE = 1e-5  # rad beyond a side that the program must go before it watches it too
_RANGE_ROOM = 1e-4  # rad kept from the ends of the joints' ranges


@dataclass(frozen=True)
class Model:
    """What the kernels need of a cell: arm, holder, limits, obstacles.

    numbers, holder: of the arm and of what holds the part; given (k): arm joints that are free themselves
    limits (3, nj) of velocity, acceleration, jerk; low, high (nj) ends of the joints' ranges; arm: its joints
    """

    numbers: ArmNumbers
    holder: HolderNumbers
    given: Ints
    limits: Array
    low: Array
    high: Array
    arm: int
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


def model_of(cell: Cell, obstacles: Obstacles = NOTHING) -> Model:
    """The kernels' view of a cell, and what is in its way."""
    na = len(cell.arm)
    holder, limits = cell.holder, cell.limits
    return Model(
        numbers=arm_numbers(cell),
        holder=HolderNumbers(holder.placements, holder.axes, holder.T_last_tip),
        given=np.array([j for j in cell.chosen if j < na], dtype=np.int64),
        limits=np.stack([limits.velocity, limits.acceleration, limits.jerk]),
        low=limits.q_min + _RANGE_ROOM,
        high=limits.q_max - _RANGE_ROOM,
        arm=na,
        obstacles=obstacles,
    )


@dataclass(frozen=True)
class PathSegment:
    """A stretch of a task's n samples, and the k control values that it depends on.

    tip, frames, cones        of the task
    step (n)                  time that a sample stands for at the commanded speed [s]; 0: of no concern here
    deposits (n)              1 where material is laid down, else 0
    centre (n), D (n, 3, 5)   as in Clock; first (n), B (n, 4, degree + 1) as in Basis
    free (k)                  1 for control values that may move, else 0
    now (n)                   when samples are reached, see `NozzleTask.moments`
    anchor (k, m), hold (k)   where the path's ends were given, and 1 for control values that are ends, else 0
    peak                      speed of joints that counts as a peak, see `refine.calmed`; inf: none does
    """

    tip: Array
    frames: Array
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

    lean (n, b, 2), lean_slope (n, b, 2, m), cones (b): of the directions that are bounded, and by what [rad]
    tilt (n, 2): of the nozzle [rad], if it may; near: the least clearances
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
    tilt: Array
    near: Clearances
    price: float


@dataclass(frozen=True)
class Watch:
    """What a program watches: rates (n, 3, nj, 2), upwards and downwards, facets (n, b, FACETS.size) of b cones, sides
    (k, CONE_SIDES) of the polygon about tilt, none where the nozzle may not, and the arm's joints (n, na) for the nearer
    end of their range."""

    rates: Flags
    facets: Flags
    sides: Flags
    ends: Flags

    def add_sides(self, model: Model, stretch: PathSegment, state: PathState, x: Array) -> int:
        """Watch the sides that a step x of the control values goes beyond; returns how many."""
        room = side_room(model, stretch, state.c + x.reshape(state.c.shape))
        missed = (room < -_MISSED_SIDE) & (stretch.free[:, None] > 0.0) & ~self.sides
        self.sides[missed] = True
        return int(missed.sum())


def side_room(model: Model, stretch: PathSegment, c: Array) -> Array:
    """How far control values c (k, m) are inside the sides (k, CONE_SIDES) of the polygon about tilt [rad]."""
    if stretch.cones.tilt == 0.0:
        return np.zeros((len(c), 0))
    tilt = c[:, np.searchsorted(model.active(stretch.cones), TILT)]
    return stretch.cones.tilt * np.cos(np.pi / CONE_SIDES) - tilt @ side_normals().T


def near_sides(model: Model, stretch: PathSegment, c: Array) -> Flags:
    """Sides (k, CONE_SIDES) that control values c (k, m) are near."""
    return np.asarray(side_room(model, stretch, c) < _NEAR_SIDE * stretch.cones.tilt)


def side_normals() -> Array:
    """Outward unit normals (CONE_SIDES, 2) of the polygon about tilt."""
    angle = np.arange(CONE_SIDES) * 2.0 * np.pi / CONE_SIDES
    return np.column_stack([np.cos(angle), np.sin(angle)])
