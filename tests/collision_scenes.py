"""Small cells in which something hits something, or just does not: trajectories are given, not planned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.collision.print_body import print_body, standing
from planner.plan import TRAVEL, Approach, Check, Trajectory
from planner.problem import Problem, load_problem
from planner.toolpath.bead import Bead, Toolpath
from planner.verify.checks import Judged
from planner.verify.collision import keep_apart, sweep_cell
from planner.verify.executed import executed_motion
from planner.verify.nozzle import beyond, by_the_tip

DT = 0.004

YAML = """\
name: scene
cell:
  arm: irb140
  nozzle: {tip_mm: [0, 0, 150], axis: [0, 0, 1], diameter_mm: 0.6}
  home_deg: [0, 0, 0, 0, 90, 0]
%s
part:
  plane: {size_mm: [100, 100]}
layers:
  source: {curves: [{degree: 2, points_mm: [[-20, 0], [0, 5], [20, 0]]}]}
  project: z
  count: 1
  height_mm: 0.5
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {width_mm: 0.6}
"""


@dataclass(frozen=True)
class Found:
    """What the checks say."""

    checks: dict[str, Check]
    metrics: dict[str, float]
    approaches: tuple[Approach, ...]
    clearance: Array

    @property
    def failed(self) -> set[str]:
        """Names of the checks that do not hold, without what they have in common."""
        return {name for name, check in self.checks.items() if not check.ok}


def problem_of(folder: Path, cell: str, nozzle: str = "}") -> Problem:
    """A problem whose cell has these lines too, in a folder; nozzle: what ends the line of the nozzle."""
    path = folder / "scene.yaml"
    path.write_text((YAML % cell).replace("diameter_mm: 0.6}", "diameter_mm: 0.6" + nozzle), encoding="utf-8")
    return load_problem(path)


def straight_bead(start: Array, end: Array, name: str = "bead", layer: int = 0) -> Bead:
    """A bead between two places of the part frame, 0.6 mm wide and 0.5 mm high, laid from above."""
    n = 60
    s = np.linspace(0.0, float(np.linalg.norm(end - start)), n)
    points = start + (s / s[-1])[:, None] * (end - start)
    up, x = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    return Bead(name, layer, s, points, up, x, points, np.full(n, 0.6e-3), np.full(n, 0.5e-3), False)


def postures(cell: Cell, poses: Array, holder: tuple[float, ...] = ()) -> Array:
    """Postures (n, nq) that bring the nozzle to poses (n, 4, 4) in the part frame, each near the one before."""
    T_world_part = cell.holder.poses(np.array([holder]))[0]
    T_base_flange = np.linalg.inv(cell.T_world_base) @ T_world_part @ poses @ np.linalg.inv(cell.T_flange_nozzle)
    q, there = cell.inverse.solve(T_base_flange)
    before, out = cell.home[: len(cell.arm)], []
    for branches, ok in zip(q, there, strict=True):
        reached = branches[ok]
        before = reached[np.abs(reached - before).sum(axis=1).argmin()]
        out.append(np.concatenate([before, holder]))
    return np.array(out)


def upright(tips: Array) -> Array:
    """Nozzle poses (n, 4, 4) with the tip at tips (n, 3), pointing down."""
    T = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(tips), 1, 1))
    T[:, :3, 3] = tips
    return T


def between(a: Array, b: Array, step: float) -> Array:
    """Rows from a to b, none farther from the next than `step`."""
    count = max(2, int(np.ceil(float(np.linalg.norm(b - a)) / step)) + 1)
    return np.asarray(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))


@dataclass(frozen=True)
class Piece:
    """A stretch of a trajectory: postures (n, nq), and of which bead it lays arc lengths (n); TRAVEL lays none."""

    q: Array
    bead: int = TRAVEL
    s: Array | None = None


def laying(cell: Cell, toolpath: Toolpath, i: int, speed: float = 0.04, dt: float = DT) -> Piece:
    """Bead i, laid from above at a speed."""
    bead = toolpath.beads[i]
    s = np.append(np.arange(0.0, bead.length, speed * dt), bead.length)
    tips = np.column_stack([np.interp(s, bead.s, bead.points[:, k]) for k in range(3)])
    return Piece(postures(cell, upright(tips), tuple(cell.home[len(cell.arm) :])), i, s)


def look(problem: Problem, cell: Cell, toolpath: Toolpath, pieces: list[Piece], dt: float = DT) -> Found:
    """What the checks say of a trajectory."""
    q = np.concatenate([piece.q for piece in pieces])
    n = len(q)
    bead = np.concatenate([np.full(len(piece.q), piece.bead) for piece in pieces]).astype(np.int32)
    s = np.concatenate([np.zeros(len(piece.q)) if piece.s is None else piece.s for piece in pieces])
    zeros = np.zeros(n)
    whole = Trajectory(
        dt, np.arange(n) * dt, bead, np.zeros(n, dtype=np.int32), bead >= 0, s, q, np.zeros((n, 3)), np.zeros((n, 4)),
        np.zeros((n, 3)), np.zeros(n, dtype=np.int8), zeros, zeros, zeros, zeros,
    )  # fmt: skip
    motion = executed_motion(cell, whole)
    whole = replace(whole, tip=motion.tip.copy(), axis=motion.axis)  # frozen ones would compile checks once more
    body = print_body(toolpath, standing(cell))
    apart = sweep_cell(problem, cell, toolpath, whole, body)
    judged = Judged(problem, cell, toolpath, whole, motion, body)
    found, approaches = keep_apart(judged, (by_the_tip(judged), beyond(judged)), apart)
    return Found({check.name: check for check in found.checks}, found.metrics, approaches, found.series["clearance_mm"])


def scene(folder: Path, cell: str, nozzle: str = "}") -> tuple[Problem, Cell]:
    """A problem and its cell; see problem_of."""
    problem = problem_of(folder, cell, nozzle)
    return problem, build_cell(problem)
