"""NozzleTask: what a bead fixes for the robot, and what it leaves free."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from planner.errors import Complaint
from planner.problem import Problem
from planner.problem.process import ConesSpec, FibreSpec
from planner.process import cut_place, with_runs
from planner.readonly import Array, ReadOnlyArrays
from planner.toolpath.bead import Toolpath


@dataclass(frozen=True)
class Cones:
    """Half angles [rad] that bound the nozzle's and the layer's directions; pi where there is no bound.

    tilt            between nozzle axis and surface normal; 0: the axis stands on the surface exactly
    nozzle_gravity  between nozzle axis and gravity
    layer_gravity   between surface normal and the vertical
    """

    tilt: float = 0.0
    nozzle_gravity: float = math.pi
    layer_gravity: float = math.pi


FREE = Cones()


def cones_of(spec: ConesSpec) -> Cones:
    """The cones of a problem's process."""
    return Cones(spec.tilt, spec.nozzle_gravity, spec.layer_gravity)


@dataclass(frozen=True)
class Stop:
    """A place where the nozzle comes to rest within a bead: arc length s [m], wait [s], and what it does there."""

    s: float
    wait: float
    kind: str


@dataclass(frozen=True)
class NozzleTask(ReadOnlyArrays):
    """The nozzle's path along one bead with its runs, sampled uniformly in the path parameter (n samples).

    tip        (n, 3)    nozzle tip, part frame [m]
    frames     (n, 3, 3) orientation R_part_nozzle at roll 0: z is the nozzle axis, x the zero of roll
    s          (n,)      arc length, 0 at the bead's start [m]
    first, last          samples between which material is deposited
    speed                commanded [m/s]

    cones                what the nozzle's axis may do
    stops                where it comes to rest while material is deposited, in order of s
    travel_speed         the tip's at most between beads and from and to home [m/s]

    Fixed is the tip, and the axis up to its cones; free are roll about the axis (periodic), tilt within the cone,
    and the holder's joints.
    """

    bead: int
    name: str
    layer: int
    tip: Array
    frames: Array
    s: Array
    first: int
    last: int
    speed: float
    cones: Cones = FREE
    stops: tuple[Stop, ...] = ()
    travel_speed: float = math.inf

    def __len__(self) -> int:
        return len(self.s)

    @property
    def moments(self) -> Array:
        """When (n) the nozzle is at its samples, in beads: the number of this one and the share of it that is laid."""
        laid = (self.s - self.s[self.first]) / (self.s[self.last] - self.s[self.first])
        return np.asarray(self.bead + np.clip(laid, 0.0, 1.0))


def make_tasks(
    toolpath: Toolpath,
    speed: float,
    run_length: float,
    cones: Cones = FREE,
    ramp: float | None = None,
    fibre: FibreSpec | None = None,
    where: Complaint | None = None,
    travel_speed: float = math.inf,
) -> tuple[NozzleTask, ...]:
    """One task a bead, in print order; speeds [m/s], length of run-in and run-out [m], their ramp as in `with_runs`.

    Raises InputError, made by `where`, for the shortest bead if that is too short to be laid with this fibre.
    """
    if fibre is not None:
        cut_place(min(toolpath.beads, key=lambda bead: bead.length), fibre, where)
    tasks = []
    for i, bead in enumerate(toolpath.beads):
        stops = () if fibre is None else (Stop(cut_place(bead, fibre), fibre.cut_wait, "cut"),)
        run = with_runs(bead, run_length, ramp)
        z = -run.normals
        frames = np.stack([run.roll_zero, np.cross(z, run.roll_zero), z], axis=-1)
        samples = (run.points, frames, run.s, run.first, run.last)
        tasks.append(NozzleTask(i, bead.name, bead.layer, *samples, speed, cones, stops, travel_speed))
    return tuple(tasks)


def tasks_of(problem: Problem, toolpath: Toolpath) -> tuple[NozzleTask, ...]:
    """The tasks that a problem makes of its toolpath.

    Raises InputError for a bead that is too short for the problem's fibre.
    """
    process = problem.process
    where = partial(problem.error, "process.fibre.cut_length_mm")
    cones = cones_of(process.cones)
    return make_tasks(
        toolpath, process.speed, process.run_in, cones, process.ramp, process.fibre, where, process.travel_speed
    )
