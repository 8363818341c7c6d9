"""External axes of a controller: the arm's carrier, then the part's holder, each with all of its axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.base.arrays import Array

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from planner.cell.cell import Cell
    from planner.cell.robot import Robot
    from planner.export.program import Setup


@dataclass(frozen=True)
class ExternalAxis:
    """An axis: its name, where it is held [rad, m] (None: it moves), and whether it slides."""

    name: str
    held: float | None
    slides: bool

    @property
    def words(self) -> str:
        """Its name, and whether it is in millimetres, or held."""
        return self.name + (" (mm)" if self.slides else "") + ("" if self.held is None else " (held)")


def carrying_axes(cell: Cell) -> tuple[ExternalAxis, ...]:
    """Axes of the arm's carrier; empty if the arm has none, or the carrier does not move."""
    if cell.carrier is None or not cell.carrier.free:
        return ()
    robot, held = cell.carrier.robot, cell.carrier.held
    return tuple(map(ExternalAxis, robot.joint_names, map(held.get, robot.joint_names), robot.slides))


def external_axes(cell: Cell) -> tuple[ExternalAxis, ...]:
    """All external axes, in the controller's order."""
    if cell.station is None:
        return carrying_axes(cell)
    own, slides = cell.station.joint_names, cell.station.slides
    names = [f"positioner_{name}" if name in cell.arm.names else name for name in own]  # as `Cell.joint_names` has them
    return (*carrying_axes(cell), *map(ExternalAxis, names, map(cell.held.get, own), slides))


def task_axes(cell: Cell) -> tuple[ExternalAxis, ...]:
    """External axes of the task that moves the nozzle; a second arm's joints belong to a task of its own."""
    return carrying_axes(cell) if cell.second_arm is not None else external_axes(cell)


def held_axes(cell: Cell) -> tuple[ExternalAxis, ...]:
    """All held axes of the arm's carrier and the part's holder, with names that no other joint has."""
    carrier, robot = cell.carrier, cell.holder_robot
    below = () if carrier is None else _held(carrier.robot, carrier.held, "base", cell.joint_names)
    taken = (*cell.arm.names, *(axis.name for axis in below))
    return (*below, *(() if robot is None else _held(robot, cell.held, "positioner", taken)))


def _held(robot: Robot, held: Mapping[str, float], prefix: str, taken: Collection[str]) -> tuple[ExternalAxis, ...]:
    slides = dict(zip(robot.joint_names, robot.slides, strict=True))
    return tuple(
        ExternalAxis(f"{prefix}_{name}" if name in taken else name, at, slides[name]) for name, at in held.items()
    )


def moving_unit(setup: Setup) -> str:
    """Name of the mechanical unit that moves the part; empty if none does."""
    cell = setup.cell
    return "" if cell.station is None else setup.problem.program.mover(cell.second_arm is not None)


def external_written(cell: Cell, station: Array) -> Array:
    """External axes (m, k) as in programs [deg, mm], from those that move (m, f) [rad, m]; held ones as held."""
    axes = external_axes(cell)
    if not axes:
        return np.empty((len(station), 0))
    moving = iter(station.T)
    columns = np.column_stack([next(moving) if a.held is None else np.full(len(station), a.held) for a in axes])
    slides = [a.slides for a in axes]
    out: Array = np.degrees(columns)
    out[:, slides] = columns[:, slides] * 1e3
    return out


def external_read(cell: Cell, external: Array) -> Array:
    """External axes (m, k) [rad, m] from a reader's (m, 6), which treats all of them as degrees."""
    scale = [np.degrees(1.0) * 1e-3 if a.slides else 1.0 for a in external_axes(cell)]
    out: Array = external[:, : len(scale)] * scale
    return out
