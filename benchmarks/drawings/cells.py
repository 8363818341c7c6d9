"""Drawings of a real cell: its frames, and one nozzle pose at several rolls."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # after the choice of its backend
import numpy as np

from benchmarks.drawings.scene import (
    INK,
    PART,
    Shape,
    add_arrow,
    add_frame,
    add_shapes,
    arm_shapes,
    cylinder,
    frame_view,
    holder_shapes,
    shape_of,
)
from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell, rigid_inverse
from planner.cell.solids import Body, Capsule
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of

PROBLEM = "cylinder_logo"
CAP, CAP_RADIUS, CAP_PLACE = "peer_cap", 0.1195, 0.9  # a ball, its radius below the beads and a place on its spiral [m]
ROLLS = (60.0, 160.0, 180.0, 240.0)  # deg
DPI = 130
TABLE = 60.0  # deg, of the positioner in these drawings


def _cell() -> tuple[Cell, NozzleTask]:
    """The cell of the logo, and the task of one of its beads."""
    problem = load_problem(PROBLEM, ["layers.count=1"])
    tasks = tasks_of(problem, build_toolpath(problem))
    return build_cell(problem), max(tasks, key=len)


def postures(cell: Cell, task: NozzleTask, sample: int, roll: float, free: Array) -> tuple[Array, Array]:
    """Arm postures (k, 6) within their ranges that reach a sample at a roll [rad], and their least singular values (k);
    free (h): angles of whatever holds the part [rad]."""
    c, s = np.cos(roll), np.sin(roll)
    T_part_nozzle = np.eye(4)
    T_part_nozzle[:3, :3] = task.frames[sample] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    T_part_nozzle[:3, 3] = task.tip[sample]
    T_world_nozzle = cell.holder.poses(free[None]) @ T_part_nozzle
    flange = rigid_inverse(cell.T_world_base[None]) @ T_world_nozzle @ rigid_inverse(cell.T_flange_nozzle[None])
    q, there = cell.inverse.solve(flange)
    low, high = cell.limits.q_min[:6], cell.limits.q_max[:6]
    good = q[0][there[0] & np.all((q[0] >= low) & (q[0] <= high), axis=1)]
    sigma = np.linalg.svd(cell.arm.jacobians(good), compute_uv=False)[:, -1] if len(good) else np.zeros(0)
    return good, sigma


def frames(picture: Path) -> None:
    """All frames of the logo's cell, while a bead is laid."""
    cell, task = _cell()
    table = np.radians([TABLE])
    sample = int(np.argmin(np.abs(task.s - 0.5 * task.s[task.last])))
    good, sigma = postures(cell, task, sample, np.pi, table)
    q = good[int(np.argmax(sigma))]
    T_world_nozzle = cell.arm.poses(q[None])[0]
    T_world_flange = T_world_nozzle @ rigid_inverse(cell.T_flange_nozzle[None])[0]
    T_world_part = cell.holder.poses(table[None])[0]
    T_world_plate = T_world_part @ rigid_inverse(cell.T_plate_part[None])[0]

    figure = plt.figure(figsize=(8.4, 4.1))
    wall = cylinder(T_world_part, (0.0314, 0.037), 0.034, 0.1)
    shapes = [*arm_shapes(cell, q), *holder_shapes(cell, table), wall]
    whole = figure.add_axes((0.0, 0.0, 0.56, 1.0), projection="3d")
    add_shapes(whole, shapes)
    add_frame(whole, np.eye(4), "world, base", 0.2, (0.02, 0.1, -0.13))
    add_frame(whole, T_world_flange, "flange", 0.1, (0.0, 0.0, 0.1))
    add_frame(whole, T_world_plate, "plate", 0.1, (-0.12, 0.0, -0.05))
    add_arrow(whole, np.zeros(3), T_world_flange[:3, 3], "T_world_flange", (0.0, 0.2, 0.3))
    add_arrow(whole, np.zeros(3), T_world_plate[:3, 3], "T_world_plate", (0.0, 0.1, -0.12))
    frame_view(whole, (-0.2, -0.4, -0.1), (0.9, 0.4, 0.85), 1.25)

    near = figure.add_axes((0.54, 0.0, 0.46, 1.0), projection="3d")
    add_shapes(near, shapes)
    add_frame(near, T_world_flange, "flange", 0.05, (0.0, 0.0, 0.03))
    add_frame(near, T_world_nozzle, "nozzle", 0.04, (0.0, 0.0, -0.03))
    add_frame(near, T_world_part, "part", 0.05, (0.0, 0.0, -0.03))
    add_arrow(near, T_world_part[:3, 3], T_world_nozzle[:3, 3], "T_part_nozzle", (0.0, 0.1, 0.0))
    middle = T_world_nozzle[:3, 3]
    frame_view(near, tuple(middle - 0.15), tuple(middle + 0.15), 1.35)
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)


def rolls(picture: Path) -> None:
    """One nozzle pose on the cap, four rolls: the arm stands elsewhere, tip and axis do not."""
    problem = load_problem(CAP)
    cell, task = build_cell(problem), tasks_of(problem, build_toolpath(problem))[0]
    sample = int(np.argmin(np.abs(task.s - CAP_PLACE)))
    figure = plt.figure(figsize=(8.6, 2.7))
    nothing = np.zeros(0)
    cap = shape_of(Body("cap", Capsule(CAP_RADIUS, 0.0), np.eye(4)), cell.T_world_holder, PART)
    above = cap.corners[:, :, 2].min(axis=1) > cell.T_world_holder[2, 3] - 0.01  # the plate's top
    cap = Shape(cap.corners[above], cap.colours[above])
    for k, degrees in enumerate(ROLLS):
        good, sigma = postures(cell, task, sample, np.radians(degrees), nothing)
        axes = figure.add_axes((k / 4, 0.08, 1 / 4, 0.92), projection="3d")
        shapes = [*holder_shapes(cell, nothing), cap]
        title = f"roll {degrees:.0f}°: no posture"
        if len(good):
            best = int(np.argmax(sigma))
            shapes += arm_shapes(cell, good[best])
            title = f"roll {degrees:.0f}°: σ = {sigma[best]:.3f}"
        add_shapes(axes, shapes)
        frame_view(axes, (-0.15, -0.35, 0.0), (0.7, 0.35, 0.85), 1.5)
        axes.set_title(title, fontsize=10, color=INK, y=-0.09)
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)
