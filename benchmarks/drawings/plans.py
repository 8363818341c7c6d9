"""Drawings of real plans: the map of roll over a path with what strategies chose, and a dip with its cause."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # after the choice of its backend
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from benchmarks.drawings.cells import CAP, DPI
from benchmarks.drawings.scene import INK
from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell, rigid_inverse
from planner.collision.print_body import print_body, standing
from planner.collision.scene import NOTHING, obstacles_of
from planner.motion.timing.timed_path import time_path
from planner.problem import load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of

PLACES, ROLLS = 320, 180  # of the map
SHOWN = {"sqp": ("white", "-", 2.4), "ladder": ("#ff8c42", "--", 1.3)}
LOGO = ("cylinder_logo", "layers.count=1")
LETTER = "E"  # the bead that is shown
AROUND = 5e-3  # m to either side of its slowest place
RATES = (("velocity", "#2456a6", "--"), ("acceleration", "#1b7837", "-."), ("jerk", "#b3261e", "-"))


def _sigmas(cell: Cell, task: NozzleTask, samples: NDArray[np.int64], rolls: Array, branch: int) -> Array:
    """Least singular value (rolls, samples) of one branch's postures; NaN where there is none within the ranges."""
    found = np.full((len(rolls), len(samples)), np.nan)
    T = np.tile(np.eye(4), (len(samples), 1, 1))
    T[:, :3, 3] = task.tip[samples]
    before = rigid_inverse(cell.T_world_base[None]) @ cell.T_world_holder
    after = rigid_inverse(cell.T_flange_nozzle[None])
    for k, roll in enumerate(rolls):
        c, s = np.cos(roll), np.sin(roll)
        T[:, :3, :3] = task.frames[samples] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        q, there = cell.inverse.solve(before @ T @ after)
        own, good = q[:, branch], there[:, branch]
        good = good & np.all((own >= cell.limits.q_min) & (own <= cell.limits.q_max), axis=1)
        found[k, good] = np.linalg.svd(cell.arm.jacobians(own[good]), compute_uv=False)[:, -1]
    return found


def roll_map(picture: Path) -> None:
    """Over the spiral on the cap: how far each roll is from a singularity, and the rolls that strategies chose."""
    problem = load_problem(CAP)
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    tasks = tasks_of(problem, toolpath)
    obstacles = obstacles_of(problem, cell, toolpath, print_body(toolpath, standing(cell)))
    paths = {name: STRATEGIES[name](cell, tasks, problem.resolve, obstacles)[0] for name in SHOWN}
    task = tasks[0]
    samples = np.linspace(task.first, task.last, PLACES).astype(np.int64)
    rolls = np.radians(np.linspace(-180.0, 180.0, ROLLS, endpoint=False))
    sigma = _sigmas(cell, task, samples, rolls, paths["sqp"].branch)

    figure, axes = plt.subplots(figsize=(7.6, 3.9), layout="constrained")
    axes.set_facecolor("#d9d9d9")
    length = task.s[samples] * 1e3
    image = axes.pcolormesh(
        length, np.degrees(rolls), sigma, cmap="cividis_r", vmin=0.0, shading="nearest", rasterized=True
    )
    figure.colorbar(image, ax=axes, label="σ: distance from a singularity", pad=0.01)
    for name, (colour, style, width) in SHOWN.items():
        path = paths[name]
        angle = (np.degrees(path.roll[samples]) + 180.0) % 360.0 - 180.0
        angle[1:][np.abs(np.diff(angle)) > 180.0] = np.nan  # the map's edge
        label = name if path.branch == paths["sqp"].branch else f"{name} (on another branch)"
        axes.plot(length, angle, color=INK, linewidth=width + 1.6)
        axes.plot(length, angle, color=colour, linestyle=style, linewidth=width, label=label)
    axes.set(xlabel="place along the spiral, mm", ylabel="roll, °", ylim=(-180, 180), yticks=range(-180, 181, 60))
    axes.legend(loc="upper left", facecolor="#5b6b7b", labelcolor="white", framealpha=0.9)
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)


def dip(picture: Path) -> None:
    """At a corner of a letter: how it is rounded, what 40 mm/s would ask of the joints there, and the speed."""
    problem = load_problem(*LOGO[:1], LOGO[1:])
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    i = next(k for k, bead in enumerate(toolpath.beads) if bead.name == LETTER)
    task = tasks_of(problem, toolpath)[i]
    path = STRATEGIES["sqp"](cell, [task], problem.resolve, NOTHING)[0]
    timed = time_path(cell, path)
    t = np.arange(0.0, timed.duration, 5e-4)
    s = timed.at(t)[1]
    speed = np.gradient(s, t)
    laid = (s > AROUND) & (s < task.s[task.last] - AROUND)
    place = float(s[laid][np.argmin(speed[laid])])
    near = np.abs(s - place) <= AROUND
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.7), layout="constrained", width_ratios=(1, 1.5))
    tip = np.column_stack([np.interp(s[near], task.s, task.tip[:, k]) for k in range(3)])
    _corner(left, tip, toolpath.beads[i].source, speed[near])
    _rates(right, cell, path, place, s[near], speed[near])
    figure.savefig(picture, dpi=DPI)
    plt.close(figure)


def _corner(axes: Axes, tip: Array, source: Array, speed: Array) -> None:
    """Drawn line and printed line, in the plane that they turn in."""
    middle = tip.mean(axis=0)
    plane = np.linalg.svd(tip - middle, full_matrices=False)[2][:2]
    drawn, printed = (source - middle) @ plane.T * 1e3, (tip - middle) @ plane.T * 1e3
    axes.plot(*drawn.T, color=INK, linewidth=1.0, label="as it was drawn")
    line = LineCollection(
        np.stack([printed[:-1], printed[1:]], axis=1), array=speed * 1e3, cmap="cividis_r", linewidth=5
    )
    axes.add_collection(line)
    plt.colorbar(line, ax=axes, label="speed, mm/s", location="bottom", pad=0.02, shrink=0.8)
    low, high = printed.min(axis=0) - 0.3, printed.max(axis=0) + 0.3
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
    axes.set_title("the corner, rounded by at most 0.2 mm", fontsize=10)
    axes.legend(loc="upper center", fontsize=8)


def _rates(axes: Axes, cell: Cell, path: JointPath, place: float, s: Array, speed: Array) -> None:
    """What a constant speed would ask of the joints, over their limits, and the speed that is kept."""
    curve = make_interp_spline(path.task.s, path.q, k=5)
    at = np.linspace(s[0], s[-1], 1200)
    for order, (name, colour, style) in enumerate(RATES, 1):
        asked = np.abs(curve(at, order)) * path.task.speed**order / getattr(cell.limits, name)
        axes.semilogy((at - place) * 1e3, asked.max(axis=1), color=colour, linestyle=style, label=f"{name} at 40 mm/s")
    axes.axhline(1.0, color=INK, linewidth=1.0, linestyle=":")
    axes.text((s[0] - place) * 1e3, 1.15, "limit", fontsize=8, color=INK)
    axes.set(xlabel="place along the bead, mm", ylabel="share of the limit, worst joint", ylim=(0.02, 200))
    right = axes.twinx()
    right.plot((s - place) * 1e3, speed * 1e3, color=INK, linewidth=2.6, label="speed that is kept")
    right.set(ylabel="speed, mm/s", ylim=(0, 70))
    most = f"40 mm/s would ask {asked.max():.1f} times a joint's jerk limit; the speed falls to {speed.min() * 1e3:.0f} mm/s"
    axes.set_title(most, fontsize=10)
    lines = [*axes.get_lines()[:3], *right.get_lines()]
    axes.legend(lines, [str(line.get_label()) for line in lines], loc="upper left", fontsize=8, ncols=2)
