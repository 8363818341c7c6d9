"""Nodes of the ladder graph: postures at rungs, with what each would cost while it is held.

A node is a roll, a holder angle and a branch. Its price is in seconds: the time that the joints' limits would
take away from a print at the commanded speed if roll and holder rested there, plus margins' worth of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.cell import Cell, rigid_inverse
from planner.kinematics.spherical_wrist import BRANCHES
from planner.resolve.demand import Demand
from planner.resolve.node_kernel import evaluate_nodes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Which rolls, holder angles and branches are tried at each rung (r rungs).

    roll_step, holder_step [rad]; roll_from, holder_from (r) first grid index of each rung's window, so that a
    node's roll is (roll_from + i) * roll_step; rolls, holders: the window's widths; periodic: the windows are
    the whole circle; branch (r, c) branch numbers to try
    """

    roll_step: float
    holder_step: float
    roll_from: NDArray[np.int64]
    holder_from: NDArray[np.int64]
    rolls: int
    holders: int
    periodic: bool
    branch: NDArray[np.int64]


@dataclass(frozen=True)
class Nodes:
    """q (r, rolls, holders, c, 6) arm joints, each within pi of the middle of its range; price (same less 6) [s],
    infinite where there is no posture; the grid that they stand on."""

    grid: Grid
    q: NDArray[np.float32]
    price: NDArray[np.float64]


def full_grid(demand: Demand, roll_step: float, holder_step: float, has_holder: bool) -> Grid:
    """All rolls, all holder angles, all branches at every rung; steps are rounded to divide the circle."""
    r = len(demand.rung)
    rolls = int(np.ceil(2 * np.pi / roll_step - 1e-9))
    holders = int(np.ceil(2 * np.pi / holder_step - 1e-9)) if has_holder else 1
    zero = np.zeros(r, dtype=np.int64)
    branch = np.tile(np.arange(BRANCHES), (r, 1))
    return Grid(2 * np.pi / rolls, 2 * np.pi / holders, zero, zero, rolls, holders, True, branch)


def evaluate(cell: Cell, demand: Demand, grid: Grid, min_sigma: float) -> Nodes:
    """Postures and prices of every node of a grid."""
    wrist, T_base_before, axis, T_after, T_nozzle_flange = _geometry(cell)
    limits = cell.limits
    r = len(demand.rung)
    shape = (r, grid.rolls, grid.holders, grid.branch.shape[1])
    q = np.zeros((*shape, 6), dtype=np.float32)
    price = np.full(shape, np.inf)
    evaluate_nodes(
        wrist, T_base_before, axis, T_after, T_nozzle_flange,
        limits.q_min[:6], limits.q_max[:6], limits.velocity[:6], limits.acceleration[:6],
        demand.tip, demand.frames, demand.twist, demand.rate, demand.weight,
        demand.rung, demand.start, demand.stop,
        grid.roll_step, grid.holder_step, grid.roll_from, grid.holder_from, grid.branch,
        min_sigma, q, price,
    )  # fmt: skip
    return Nodes(grid, q, price)


def _geometry(cell: Cell) -> tuple[Array, Array, Array, Array, Array]:
    """Constant transforms of the cell, flat, for the kernel; a fixed bed is a holder that never turns."""
    if len(cell.holder):
        before, axis, after = cell.holder.placements[0], cell.holder.axes[0], cell.holder.T_last_tip
    else:
        before, axis, after = cell.T_world_holder, np.array([0.0, 0.0, 1.0]), np.eye(4)
    return (
        cell.wrist.parameters,
        rigid_inverse(cell.T_world_base) @ before,
        axis,
        after,
        rigid_inverse(cell.T_flange_nozzle),
    )
