"""Nodes of the ladder graph: postures at rungs, with what each would cost while it is held.

A node is a roll, a holder angle and a branch. Its price is in seconds: the time that the joints' limits would
take away from a print at the commanded speed if roll and holder rested there, plus margins' worth of time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.background import in_threads
from planner.cell import Cell, rigid_inverse
from planner.kinematics.chain import Chain
from planner.kinematics.inverse import kind_of
from planner.obstacles import NOTHING, Obstacles
from planner.readonly import Array, Ints
from planner.resolve.demand import Demand
from planner.resolve.node_kernel import evaluate_nodes

BRANCHES = 8  # of every kind of arm


@dataclass(frozen=True)
class Grid:
    """Which rolls, branches and angles of one chosen joint are tried at each rung (r rungs).

    The chosen joint that is tried, the swept one, is called the holder here, which it mostly is.

    roll_step, holder_step [rad]; roll_from, holder_from (r) first grid index of each rung's window, so that a
    node's roll is (roll_from + i) * roll_step; rolls, holders: the window's widths; periodic: the windows are
    the whole circle; branch (r, c) branch numbers to try
    swept: which of the cell's chosen joints is tried, None: none of them; held (r, k): angles of all chosen joints, used for the others
    """

    roll_step: float
    holder_step: float
    roll_from: NDArray[np.int64]
    holder_from: NDArray[np.int64]
    rolls: int
    holders: int
    periodic: bool
    branch: NDArray[np.int64]
    swept: int | None = 0
    held: Array | None = None

    def chosen(self, r: int, k: int) -> Array:
        """Held angles (r, k) of a cell with k chosen joints: 0 where none were given."""
        return np.zeros((r, k)) if self.held is None else self.held


@dataclass(frozen=True)
class Nodes:
    """q (r, rolls, holders, c, na) arm joints, each within pi of the middle of its range; price (same less 6) [s],
    infinite where there is no posture; the grid that they stand on; joint: index of the swept one among all joints,
    beyond them where there is none."""

    grid: Grid
    q: NDArray[np.float32]
    price: NDArray[np.float64]
    joint: int = 6


def full_grid(
    demand: Demand,
    roll_step: float,
    holder_step: float,
    has_holder: bool,
    swept: int | None = 0,
    held: Array | None = None,
) -> Grid:
    """All rolls, all angles of the swept joint, all branches at every rung; steps are rounded to divide the circle."""
    r = len(demand.rung)
    rolls = int(np.ceil(2 * np.pi / roll_step - 1e-9))
    holders = int(np.ceil(2 * np.pi / holder_step - 1e-9)) if has_holder else 1
    zero = np.zeros(r, dtype=np.int64)
    branch = np.tile(np.arange(BRANCHES), (r, 1))
    return Grid(2 * np.pi / rolls, 2 * np.pi / holders, zero, zero, rolls, holders, True, branch, swept, held)


def evaluate(cell: Cell, demand: Demand, grid: Grid, min_sigma: float, obstacles: Obstacles = NOTHING) -> Nodes:
    """Postures and prices of every node of a grid. Where the nozzle may tilt, that may give the head its clearance from
    part and print, which is not asked for here then."""
    nodes, fill = nodes_to_fill(cell, demand, grid, min_sigma)
    fill(np.arange(len(demand.rung)), obstacles)
    return nodes


def nodes_to_fill(
    cell: Cell, demand: Demand, grid: Grid, min_sigma: float
) -> tuple[Nodes, Callable[[Ints, Obstacles], None]]:
    """Nodes without a posture yet, and what evaluates those of some rungs, as `evaluate` does; also once more."""
    limits, na, nh = cell.limits, len(cell.arm), len(cell.holder)
    r = len(demand.rung)
    held = grid.chosen(r, len(cell.chosen))
    swept = grid.swept if cell.chosen else None
    sweeps = 0 if swept is None else (1 if swept < nh else 2)
    T_before, axis, T_after = holder_around(cell, nh if swept is None else swept, held[:, :nh])
    joint = len(cell.joint_names) if swept is None else cell.chosen[swept]
    low, high = (-np.inf, np.inf) if swept is None else (limits.q_min[joint], limits.q_max[joint])
    redundant = cell.inverse.redundant_joint
    shape = (r, grid.rolls, grid.holders, grid.branch.shape[1])
    q = np.zeros((*shape, na), dtype=np.float32)
    price = np.full(shape, np.inf)
    before = (
        kind_of(cell.inverse), cell.inverse.parameters, np.array(cell.solved), -1 if redundant is None else redundant,
        rigid_inverse(cell.T_world_base), rigid_inverse(cell.T_flange_nozzle),
        cell.arm.placements, cell.arm.axes, cell.arm.T_last_tip,
        T_before, axis, T_after, sweeps, -1 if swept is None else joint, held[:, :nh].copy(),
        low, high, np.zeros(r) if redundant is None else held[:, nh].copy(),
        np.cos(min(demand.cones.layer_gravity, demand.cones.nozzle_gravity)),
        limits.q_min[:na], limits.q_max[:na], limits.velocity[:na], limits.acceleration[:na],
    )  # fmt: skip
    after = (
        demand.now,
        demand.tip, demand.frames, demand.twist, demand.rate, demand.weight,
        demand.rung, demand.start, demand.stop,
        grid.roll_step, grid.holder_step, grid.roll_from, grid.holder_from, grid.branch,
        min_sigma, q, price,
    )  # fmt: skip

    def fill(rungs: Ints, obstacles: Obstacles) -> None:
        table = (obstacles.but_head_on_part if demand.cones.tilt > 0.0 else obstacles).table
        price[rungs] = np.inf

        def part(first: int, last: int) -> None:
            some = rungs[first:last]
            for run in np.split(some, np.flatnonzero(np.diff(some) != 1) + 1):
                evaluate_nodes(run[0], run[-1] + 1, *before, table, *after)

        if len(rungs):
            in_threads(part, len(rungs))

    return Nodes(grid, q, price, joint), fill


def holder_around(cell: Cell, swept: int, held: Array) -> tuple[Array, Array, Array]:
    """World to part as T_before Rot(axis, angle of the swept joint) T_after, the other axes held (r, nh).

    Where no holder joint is swept, T_before is the whole way and the axis any.
    """
    r = len(held)
    holder = cell.holder
    if swept >= len(holder):
        return holder.poses(held), np.array([0.0, 0.0, 1.0]), np.tile(np.eye(4), (r, 1, 1))
    first = Chain(holder.names[:swept], holder.placements[:swept], holder.axes[:swept], holder.placements[swept])
    rest = Chain(holder.names[swept + 1 :], holder.placements[swept + 1 :], holder.axes[swept + 1 :], holder.T_last_tip)
    return first.poses(held[:, :swept]), holder.axes[swept], rest.poses(held[:, swept + 1 :])
