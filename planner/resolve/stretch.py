"""What the refinement works on: a cell's model, a stretch of samples, a path over it, and what a program watches of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.cell import Cell, rigid_inverse
from planner.kinematics.inverse import kind_of
from planner.obstacles import NOTHING, Obstacles
from planner.readonly import Array, Flags, Ints
from planner.resolve.clearance import Clearances
from planner.task import Cones

ROLL, TILT, HOLDER = 0, (1, 2), 3  # columns of z; given arm joints come after the holder's
CONE_SIDES = 12  # of the polygon inside the circle that bounds tilt
_NEAR_SIDE = 0.3  # of the cone about tilt: who is as near to a side of its polygon has it watched from the start
_MISSED_SIDE = 1e-5  # rad beyond a side that the program must go before it watches it too
_RANGE_ROOM = 1e-4  # rad kept from the ends of the joints' ranges


@dataclass(frozen=True)
class Model:
    """What the kernels need of a cell: chains, limits, which arm joints follow from the task or are given, obstacles.

    chains: the first ten arguments of `follow_kernel.follow`, of the arm, its closed form, and the holder
    limits (3, nj) of velocity, acceleration, jerk; low, high (nj) ends of the joints' ranges; arm: its joints
    """

    chains: tuple[Array, Array, Array, Array, Array, Array, int, Array, Array, Array]
    solved: Ints
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
    arm, holder, limits = cell.arm, cell.holder, cell.limits
    forward = (arm.placements, arm.axes, arm.T_last_tip, holder.placements, holder.axes, holder.T_last_tip)
    ends = (rigid_inverse(cell.T_world_base), rigid_inverse(cell.T_flange_nozzle))
    return Model(
        chains=(*forward, kind_of(cell.inverse), cell.inverse.parameters, *ends),
        solved=np.array(cell.solved),
        given=np.array([j for j in cell.chosen if j < na], dtype=np.int64),
        limits=np.stack([limits.velocity, limits.acceleration, limits.jerk]),
        low=limits.q_min + _RANGE_ROOM,
        high=limits.q_max - _RANGE_ROOM,
        arm=na,
        obstacles=obstacles,
    )


@dataclass(frozen=True)
class Stretch:
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
class State:
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

    def add_sides(self, model: Model, stretch: Stretch, state: State, x: Array) -> int:
        """Watch the sides that a step x of the control values goes beyond; returns how many."""
        room = side_room(model, stretch, state.c + x.reshape(state.c.shape))
        missed = (room < -_MISSED_SIDE) & (stretch.free[:, None] > 0.0) & ~self.sides
        self.sides[missed] = True
        return int(missed.sum())


def side_room(model: Model, stretch: Stretch, c: Array) -> Array:
    """How far control values c (k, m) are inside the sides (k, CONE_SIDES) of the polygon about tilt [rad]."""
    if stretch.cones.tilt == 0.0:
        return np.zeros((len(c), 0))
    tilt = c[:, np.searchsorted(model.active(stretch.cones), TILT)]
    return stretch.cones.tilt * np.cos(np.pi / CONE_SIDES) - tilt @ side_normals().T


def near_sides(model: Model, stretch: Stretch, c: Array) -> Flags:
    """Sides (k, CONE_SIDES) that control values c (k, m) are near."""
    return np.asarray(side_room(model, stretch, c) < _NEAR_SIDE * stretch.cones.tilt)


def side_normals() -> Array:
    """Outward unit normals (CONE_SIDES, 2) of the polygon about tilt."""
    angle = np.arange(CONE_SIDES) * 2.0 * np.pi / CONE_SIDES
    return np.column_stack([np.cos(angle), np.sin(angle)])
