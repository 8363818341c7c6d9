"""Shared by all parts of the verifier: the input, the findings, and checks that name the worst sample."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.collision.print_body import PrintBody
from planner.plan import Check, Trajectory
from planner.plan.plan import by_nozzle
from planner.problem import Problem
from planner.problem.cell import FARTHEST_KEPT_MM
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.verify.executed import ExecutedMotion
from planner.verify.scanned import drawn_tips

SPEED_TOLERANCE = 0.02  # × the commanded speed: a sample off by no more counts as at speed
DIGITS = 1e-9  # relative tolerance of comparisons with limits, for rounding
FAR = 1e-3 * FARTHEST_KEPT_MM  # m: greatest distance reported; anything farther away counts as this far
TOLERANCE = 1e-4  # m: the least distance found may exceed the true one by this much
_PIECE = re.compile(r", piece \d+$")  # suffix of a drawn bead's name where it is laid in pieces
_SKIRT = re.compile(r"skirt [1-9]\d*")
EVERYWHERE = "everywhere"  # the place named by a check that has no worst one


@dataclass(frozen=True)
class Judged:
    """The trajectory under test (n samples), and what it is judged by.

    trajectory   every number in it is finite
    motion       what the joints of the trajectory do, by Pinocchio
    body         part and print as obstacles, and the bodies that stand with them
    """

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    trajectory: Trajectory
    motion: ExecutedMotion
    body: PrintBody

    @cached_property
    def samples(self) -> list[NDArray[np.intp]]:
        """Samples of each bead of the toolpath: see `samples_of`."""
        return samples_of(self.trajectory, len(self.toolpath.beads))

    @cached_property
    def stretches(self) -> tuple[tuple[Cell, slice], ...]:
        """The cell with each nozzle that comes into use, and the samples while it is in use: see `by_nozzle`."""
        return by_nozzle(self.cell, self.trajectory.events, self.trajectory.t)

    def cell_at(self, sample: int) -> Cell:
        """The cell with the nozzle in use at a sample."""
        return next(cell for cell, rows in self.stretches if sample < rows.stop)

    @cached_property
    def commanded(self) -> Array:
        """Speed (k) [m/s] that the problem sets for each bead of the toolpath: see `asked_speeds`."""
        return asked_speeds(self.problem.process, self.toolpath)

    @cached_property
    def drawn_tip(self) -> Array:
        """The tip (n, 3) [m] as it would be if the scanned print below were exactly as drawn."""
        spec = self.problem.as_printed
        return self.motion.tip if spec is None else drawn_tips(spec, self.toolpath, self.trajectory, self.motion)


@dataclass(frozen=True)
class Findings:
    """What a part of the verifier finds: checks, metrics (units in their names), and series by sample (n)."""

    checks: tuple[Check, ...] = ()
    metrics: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Array] = field(default_factory=dict)


def drawn_name(bead: Bead) -> str:
    """The name of the drawn bead; also of one that is a piece of it."""
    return _PIECE.sub("", bead.name)


def lines_around(problem: Problem, toolpath: Toolpath) -> int:
    """How many of the first beads are skirt lines around the first layer, by their names; 0 without a skirt."""
    count, layer = 0, toolpath.beads[0].layer
    while problem.process.skirt is not None and count < len(toolpath.beads):
        bead = toolpath.beads[count]
        if bead.layer != layer or not _SKIRT.fullmatch(drawn_name(bead)):
            break
        count += 1
    return count


def asked_speeds(process: ProcessSpec, toolpath: Toolpath) -> Array:
    """Speed (k) [m/s] that the process sets for each bead, by its layer, its name, and the least time of its layer."""
    names = [drawn_name(bead) for bead in toolpath.beads]
    layers = np.array([bead.layer for bead in toolpath.beads])
    speeds = np.full(len(names), process.speed)
    for spec in process.speeds:
        pattern = spec.beads.replace("[", "[[]")  # only * and ? are wildcards
        called = np.array([fnmatchcase(name, pattern) for name in names])
        last = np.inf if spec.to_layer is None else spec.to_layer
        speeds[called & (layers + 1 >= spec.from_layer) & (layers + 1 <= last)] = spec.speed
    if process.layer_time is None:
        return speeds
    which = np.unique(layers, return_inverse=True)[1]
    length = np.array([bead.length for bead in toolpath.beads])
    share = np.minimum(np.bincount(which, length / speeds)[which] / process.layer_time.least, 1.0)
    share[layers == layers[np.argmax([np.argmax(layers == layer) for layer in layers])]] = 1.0  # the layer begun last
    lowest = np.minimum(speeds, process.layer_time.floor(process.speed))
    return np.asarray(np.maximum(share * speeds, lowest))


def joined(parts: Sequence[Findings]) -> Findings:
    """The findings of several parts as one, in the order of the parts."""
    return Findings(
        tuple(check for part in parts for check in part.checks),
        {name: value for part in parts for name, value in part.metrics.items()},
        {name: values for part in parts for name, values in part.series.items()},
    )


def place(trajectory: Trajectory, i: int) -> str:
    """Time and place of a sample in words."""
    bead = int(trajectory.bead[i])
    spot = f"bead {bead}, {trajectory.s[i] * 1e3:.1f} mm" if bead >= 0 else "travel"
    return f"t = {trajectory.t[i]:.3f} s, {spot}"


def samples_of(t: Trajectory, beads: int) -> list[NDArray[np.intp]]:
    """Samples of each bead, in order of time; beads may occur in any order, and more than once."""
    order = np.argsort(t.bead, kind="stable")
    bounds = np.searchsorted(t.bead[order], np.arange(beads + 1))
    return [order[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def check_most(t: Trajectory, name: str, values: Array, limit: float, unit: str) -> Check:
    """The check that no value (n) exceeds the limit, at the worst sample. NaN fails."""
    i = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    worst = float(values[i])
    return Check(name, worst, limit, unit, bool(worst <= limit * (1.0 + DIGITS)), place(t, i), sample=i)


def check_least(t: Trajectory, name: str, values: Array, limit: float, unit: str) -> Check:
    """The check that no value (n) falls below the limit, at the worst sample. NaN fails."""
    i = int(np.argmin(np.where(np.isnan(values), -np.inf, values)))
    worst = float(values[i])
    ok = bool(worst >= limit - DIGITS * abs(limit))
    return Check(name, worst, limit, unit, ok, place(t, i), least=True, sample=i)


def bead_errors(toolpath: Toolpath, t: Trajectory, lean: Array) -> Array:
    """Height error (n) [m] at a bead's edges where the nozzle leans from the surface normal by lean (n) [rad].

    A nozzle's end face is a plane through the tip, perpendicular to its axis. Where the axis leans by an angle a, a
    point of the face at distance r from the tip, up or down the slope, is r sin(a) higher or lower than the tip. The
    face shapes a bead of width w out to r = w/2: leaning across the bead, it leaves one edge (w/2) sin(a) too high and
    the other as much too low; leaning along the bead, its trailing rim leaves the whole bead that much too high or too
    low. The tip itself stays on its line, so the lean does not change the height there.
    """
    width = np.zeros(len(t))
    for at, bead in zip(samples_of(t, len(toolpath.beads)), toolpath.beads, strict=True):
        width[at] = np.interp(t.s[at], bead.s, bead.width)
    return np.asarray(0.5 * width * np.sin(lean))
