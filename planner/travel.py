"""Travel between beads: lift along the normal, move, lower; jerk-limited, and clear of the part."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import ruckig
from numpy.typing import NDArray

from planner.cell import Cell
from planner.cubics import Cubics, chain, from_ruckig, rest
from planner.errors import Refusal
from planner.problem import ProcessSpec
from planner.resolve.jointpath import JointPath, flange_poses
from planner.task import NozzleTask
from planner.timing import HEADROOM, TimedPath
from planner.toolpath.bead import Surface, Toolpath

Array = NDArray[np.float64]

CLEARANCE = 2e-3  # m between nozzle and printed part while it moves from one lifted pose to the next
LIFTS = (1.0, 2.0, 4.0, 8.0, 16.0)  # of the least lift, tried in turn until the way is clear
VIAS = ("straight", "drawn back", "home", "drawn back and home")  # ways to try, the quickest first
DRAW_BACK = 0.5  # rad of the lower arm, backwards: lifts the nozzle off the part and towards the arm's base
NOZZLE_POINTS = (0.0, 0.01, 0.03, 0.06, 0.1)  # m behind the tip, along the nozzle, that must keep clear
LOOK = 4e-3  # s between the instants of a move that are looked at
_SLOWER_TRIES = 12  # each brings the tip's speed down to the limit or close to it


def plan_travels(
    cell: Cell,
    timed: Sequence[TimedPath],
    toolpath: Toolpath,
    process: ProcessSpec,
    which: range | None = None,
) -> list[Cubics]:
    """The way from home to the first bead, between beads, and home: one more than there are beads; or `which` of them.

    Raises Refusal if no lift brings the nozzle clear of the part and of what has been printed on it.
    """
    travels, paths = [], [each.path for each in timed]
    surfaces = [toolpath.surface.before(i) for i in range(len(paths) + 1)]
    heights = [
        float(surface.signed_distance(bead.points).max())
        for surface, bead in zip(surfaces[1:], toolpath.beads, strict=True)
    ]
    printed = list(itertools.accumulate(heights, max, initial=0.0))  # how far the part has grown before each bead
    for i in range(len(paths) + 1) if which is None else which:
        leave = paths[i - 1] if i > 0 else None
        reach = paths[i] if i < len(paths) else None
        height, lift, speed = printed[i], process.lift, process.travel_speed
        travels.append(_travel(cell, leave, reach, surfaces[i], height, lift, speed))
    return travels


def _travel(
    cell: Cell,
    leave: JointPath | None,
    reach: JointPath | None,
    surface: Surface,
    height: float,
    lift: float,
    travel_speed: float,
) -> Cubics:
    for factor, via in itertools.product(LIFTS, VIAS):
        start = [_home_beside(cell, reach, 0)] if leave is None else _lifted(cell, leave, -1, factor * lift)
        end = [_home_beside(cell, leave, -1)] if reach is None else _lifted(cell, reach, 0, factor * lift)[::-1]
        if not start or not end:
            continue
        stops = [start[-1], *_via(cell, via, start[-1], end[0]), end[0]]
        across = _through(cell, stops, travel_speed)
        if _clear(cell, _sampled(across), surface, height):
            up, down = _through(cell, start, travel_speed), _through(cell, end, travel_speed)
            return chain([up, across, down])
    beside = leave if reach is None else reach
    raise Refusal(
        "no lift brings the nozzle clear of the part on the way to or from this bead",
        bead=None if beside is None else beside.task.bead,
    )


def _home_beside(cell: Cell, path: JointPath | None, end: int) -> Array:
    """Home for the arm; the holder stays where that end of the bead has it."""
    home = cell.home.copy()
    if path is not None and len(cell.holder):
        home[len(cell.arm) :] = path.q[end, len(cell.arm) :]
    return home


def _via(cell: Cell, name: str, a: Array, b: Array) -> list[Array]:
    """Postures between a and b that one of VIAS goes through."""
    back_a, back_b = a.copy(), b.copy()
    for q in (back_a, back_b):
        q[1] = max(q[1] - DRAW_BACK, cell.limits.q_min[1])
    home = np.concatenate([cell.home[: len(cell.arm)], b[len(cell.arm) :]])
    return {
        "straight": [],
        "drawn back": [back_a, back_b],
        "home": [home],
        "drawn back and home": [back_a, home, back_b],
    }[name]


def _lifted(cell: Cell, path: JointPath, end: int, lift: float) -> list[Array]:
    """Postures at an end of a path and lifted from there along the normal; empty if that is out of reach."""
    task, q = path.task, path.q[end]
    na = len(cell.arm)
    one = NozzleTask(
        task.bead, task.name, task.layer, (task.tip[end] - lift * task.frames[end, :, 2])[None],
        task.frames[end][None], np.zeros(1), 0, 0, task.speed,
    )  # fmt: skip
    redundant = cell.inverse.redundant_joint
    given = None if redundant is None else q[None, redundant]
    T_base_flange = flange_poses(cell, one, path.roll[[end]], path.tilt[[end]], q[None, na:])
    solutions, ok = cell.inverse.solve(T_base_flange, given)
    if not ok[0, path.branch]:
        return []
    arm = solutions[0, path.branch]
    arm = q[:na] + np.remainder(arm - q[:na] + np.pi, 2.0 * np.pi) - np.pi
    limits = cell.limits
    if np.any(arm < limits.q_min[:na]) or np.any(arm > limits.q_max[:na]):
        return []
    return [q, np.concatenate([arm, q[na:]])]


def _through(cell: Cell, stops: Sequence[Array], travel_speed: float) -> Cubics:
    """Joints from posture to posture, resting at each; a single posture takes no time."""
    return chain([rest(stops[0], 0.0), *(move(cell, a, b, travel_speed) for a, b in itertools.pairwise(stops))])


def _sampled(motion: Cubics) -> Array:
    return motion.joints(np.linspace(0.0, motion.duration, int(np.ceil(motion.duration / LOOK)) + 1))


def move(cell: Cell, a: Array, b: Array, travel_speed: float) -> Cubics:
    """Joints from rest at a to rest at b, jerk-limited, the tip no faster than `travel_speed` [m/s].

    All joints start and stop together. Tip speed is relative to the part.
    """
    n = len(a)
    fastest_joint = HEADROOM * cell.limits.velocity
    for _ in range(_SLOWER_TRIES):
        inputs = ruckig.InputParameter(n)
        inputs.current_position, inputs.target_position = list(a), list(b)
        inputs.max_velocity = list(fastest_joint)
        inputs.max_acceleration = list(HEADROOM * cell.limits.acceleration)
        inputs.max_jerk = list(HEADROOM * cell.limits.jerk)
        trajectory = ruckig.Trajectory(n)
        result = ruckig.Ruckig(n).calculate(inputs, trajectory)
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise Refusal(f"travel between two postures was refused by the motion generator ({result})")
        motion = from_ruckig(trajectory)
        q = _sampled(motion)
        dt = motion.duration / max(len(q) - 1, 1)
        fastest = _tip_speed(cell, q, dt) if dt > 0.0 else 0.0
        if fastest <= travel_speed:
            return motion
        reached = np.abs(np.diff(q, axis=0)).max(axis=0) / dt
        fastest_joint = np.maximum(0.98 * travel_speed / fastest * reached, 1e-3)
    raise Refusal(f"travel between two postures cannot be held below {travel_speed * 1e3:.0f} mm/s")


def _tip_speed(cell: Cell, q: Array, dt: float) -> float:
    tip = cell.T_part_nozzle(q)[:, :3, 3]
    return float(np.linalg.norm(np.diff(tip, axis=0), axis=1).max(initial=0.0) / dt)


def _clear(cell: Cell, q: Array, surface: Surface, height: float) -> bool:
    """Whether the nozzle keeps its distance from the part on the way."""
    T = cell.T_part_nozzle(q)
    behind = [T[:, :3, 3] - back * T[:, :3, 2] for back in NOZZLE_POINTS]
    return bool(surface.signed_distance(np.vstack(behind)).min() - height >= CLEARANCE)
