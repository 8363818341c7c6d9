"""NozzleTask: what a bead fixes for the robot, and what it leaves free."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.problem import ConesSpec
from planner.process import with_runs
from planner.readonly import ReadOnlyArrays
from planner.toolpath.bead import Toolpath

Array = NDArray[np.float64]


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

    def __len__(self) -> int:
        return len(self.s)


def make_tasks(toolpath: Toolpath, speed: float, run_length: float, cones: Cones = FREE) -> tuple[NozzleTask, ...]:
    """One task a bead, in print order; speed [m/s], length of run-in and run-out [m]."""
    tasks = []
    for i, bead in enumerate(toolpath.beads):
        run = with_runs(bead, run_length)
        z = -run.normals
        frames = np.stack([run.roll_zero, np.cross(z, run.roll_zero), z], axis=-1)
        tasks.append(NozzleTask(i, bead.name, bead.layer, run.points, frames, run.s, run.first, run.last, speed, cones))
    return tuple(tasks)
