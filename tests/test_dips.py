"""Dips: closed forms of cause and remedies, remedies tried by timing the same joints anew, estimates by solving anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from solved import small_plan, small_problem

from planner.base.arrays import Array
from planner.cell.cell import Cell, Limits
from planner.collision.scene import obstacles_of
from planner.motion.dips import AT_SPEED, MERGE, find_dips
from planner.motion.timing.profile import HEADROOM
from planner.motion.timing.timed_path import time_path
from planner.plan import TRAVEL, Dip, Remedy, Trajectory
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.task import NozzleTask, Stop, make_tasks

DT = 0.004
SPEED = 0.04
LENGTH = 0.1
AREA = 0.3e-6
FIELDS = {"speed_deg_s": "velocity", "acceleration_rad_s2": "acceleration", "jerk_rad_s3": "jerk"}


# --- one straight bead, its joints given ------------------------------------------------------------------------


def line_of(q: Callable[[Array], Array], run: float = 0.01, n: int = 1200, **more: object) -> JointPath:
    """A straight path with runs, its joints a function of the arc length."""
    s = np.linspace(-run, LENGTH + run, n)
    inside = np.flatnonzero((s >= -1e-12) & (s <= LENGTH + 1e-12))
    tip = np.column_stack([s, np.zeros((n, 2))])
    frames = np.tile(np.eye(3), (n, 1, 1))
    task = NozzleTask(0, "line", 0, tip, frames, s, int(inside[0]), int(inside[-1]), SPEED, **more)  # type: ignore[arg-type]
    return JointPath(task, np.zeros(n), np.zeros((n, 2)), q(s), 0)


def bead_of(turn: float = 0.0) -> Bead:
    """The bead under such a path; the drawn one turns aside in its middle by an angle [rad]."""
    s = np.linspace(0.0, LENGTH, 501)
    points = np.column_stack([s, np.zeros((len(s), 2))])
    up = np.tile([0.0, 0.0, 1.0], (len(s), 1))
    along = np.tile([1.0, 0.0, 0.0], (len(s), 1))
    drawn = points + np.column_stack([0 * s, np.tan(turn) * np.maximum(s - 0.5 * LENGTH, 0.0), 0 * s])
    return Bead("line", 0, s, points, up, along, drawn, 0.6e-3 + 0 * s, 0.5e-3 + 0 * s, False)


def samples(s: Array, flow: Array | None = None) -> Trajectory:
    """A trajectory that passes these arc lengths, one every DT; the bead lies between 0 and LENGTH."""
    n = len(s)
    bead = np.where((s >= 0.0) & (s <= LENGTH), 0, TRAVEL).astype(np.int32)
    speed = np.gradient(s, DT)
    zeros, rows = np.zeros(n), np.zeros((n, 3))
    return Trajectory(
        dt=DT, t=np.arange(n) * DT, bead=bead, layer=np.zeros(n, dtype=np.int32), deposit=bead == 0, s=s,
        q=np.zeros((n, 7)), tip=rows, quat=np.zeros((n, 4)), axis=rows, branch=np.zeros(n, dtype=np.int8), speed=speed,
        flow=AREA * speed if flow is None else flow, extruded=zeros, feed=zeros,
    )  # fmt: skip


def slowed(*dips: tuple[float, float, float], run: float = 0.01) -> Trajectory:
    """Along the line at the commanded speed, but for dips (from, to, speed) where it is the given one."""
    s, out = -run, [-run]
    while s < LENGTH + run:
        s += DT * next((v for a, b, v in dips if a <= s < b), SPEED)
        out.append(s)
    return samples(np.array(out))


def with_limits(cell: Cell, **changes: Array) -> Cell:
    return replace(cell, limits=replace(cell.limits, **changes))


def dips_of(
    cell: Cell, path: JointPath, trajectory: Trajectory, bead: Bead | None = None, **process: float
) -> tuple[Dip, ...]:
    problem = small_problem()
    problem = problem.model_copy(update={"process": problem.process.model_copy(update=process)})
    return find_dips(problem, cell, Toolpath((bead or bead_of(),), None), (path,), trajectory)  # type: ignore[arg-type]


def remedy(dip: Dip, kind: str) -> Remedy:
    return next(each for each in dip.remedies if each.kind == kind)


def bump(joint: int, height: float, width: float, at: float = 0.05) -> Callable[[Array], Array]:
    """A Gaussian swing of one joint at a place."""

    def q(s: Array) -> Array:
        out = np.zeros((len(s), 7))
        out[:, joint] = height * np.exp(-(((s - at) / width) ** 2))
        return out

    return q


# greatest derivatives of exp(-x^2): of the first, second and third order
PEAKS = (
    np.sqrt(2.0) * np.exp(-0.5),
    2.0,
    float(np.max(np.abs(np.polyval([-8, 0, 12, 0], x := np.linspace(0, 2, 200001)) * np.exp(-(x**2))))),
)
ROOM = 1e6  # of limits that shall not bind


@pytest.mark.parametrize("order", [1, 2, 3])
def test_cause_and_remedies_of_one_swing_in_closed_form(cell: Cell, order: int) -> None:
    joint, height, width = 3, 0.05, 2e-3
    name = ("velocity", "acceleration", "jerk")[order - 1]
    rate = height * PEAKS[order - 1] / width**order
    bound = np.full(7, ROOM**order)
    bound[joint] = rate * (0.5 * SPEED) ** order / HEADROOM  # half the commanded speed is just possible
    free = {"velocity": np.full(7, 1e9), "acceleration": np.full(7, 1e9), "jerk": np.full(7, 1e12)}
    tight = with_limits(cell, **(free | {name: bound}))
    path = line_of(bump(joint, height, width))
    (dip,) = dips_of(tight, path, slowed((0.044, 0.056, 0.02)))
    assert (dip.bead, dip.joint, dip.limit) == (0, "joint_4", name)
    assert dip.cause == f"joint_4 {name}"
    assert (dip.from_s, dip.to_s) == pytest.approx((0.044, 0.056), abs=1.1 * SPEED * DT)
    assert dip.speed == pytest.approx(0.02, rel=1e-9)
    assert dip.lost == pytest.approx(0.5 * 0.012 / 0.02, abs=2 * DT)
    assert dip.over_extruded == 0.0
    speed = remedy(dip, "speed")
    assert speed.exact
    assert speed.changes[0][1] == pytest.approx(0.5 * SPEED * 1e3, rel=1.01e-2)
    assert speed.changes[0][1] <= 0.5 * SPEED * 1e3
    limits = remedy(dip, "limits")
    unit = np.pi / 180.0 if order == 1 else 1.0
    ((field, value),) = limits.changes
    assert limits.exact
    assert field == f"cell.limits.joint_4.{next(k for k, v in FIELDS.items() if v == name)}"
    assert value * unit == pytest.approx(bound[joint] * 2.0**order, rel=1.01e-2)  # three digits, rounded up
    assert value * unit >= bound[joint] * 2.0**order * (1 - 1e-4)


def test_derivatives_are_by_arc_length_however_samples_stand(cell: Cell) -> None:
    """Samples that draw together within the dip change nothing."""
    even = line_of(bump(2, 0.05, 2e-3))
    u = np.linspace(0.0, 1.0, 1200)
    s = -0.01 + 0.12 * (u + 0.12 * np.sin(2 * np.pi * u) / (2 * np.pi) * 5)
    assert (np.diff(s) > 0).all()
    drawn = replace(even, task=replace(even.task, s=s), q=bump(2, 0.05, 2e-3)(s))
    trajectory = slowed((0.044, 0.056, 0.02))
    a, b = (dips_of(cell, path, trajectory)[0] for path in (even, drawn))
    assert (a.joint, a.limit) == (b.joint, b.limit)
    for kind in ("speed", "limits"):
        for (field, x), (other, y) in zip(remedy(a, kind).changes, remedy(b, kind).changes, strict=True):
            assert field == other
            assert x == pytest.approx(y, rel=1.1e-2)


def test_dips_near_each_other_are_one(cell: Cell) -> None:
    path = line_of(bump(2, 0.05, 4e-3))
    step = SPEED * DT
    near = slowed((0.040, 0.042, 0.02), (0.042 + (MERGE - 1) * step, 0.0460, 0.01))
    (one,) = dips_of(cell, path, near)
    assert one.speed == pytest.approx(0.01)
    assert one.from_s == pytest.approx(0.040, abs=1.1 * step)
    assert one.to_s == pytest.approx(0.046, abs=1.1 * step)
    far = dips_of(cell, path, slowed((0.040, 0.042, 0.02), (0.042 + (MERGE + 2) * step, 0.0460, 0.01)))
    assert len(far) == 2
    assert far[0].to_s < far[1].from_s


def test_a_trajectory_at_speed_has_no_dip(cell: Cell) -> None:
    assert dips_of(cell, line_of(bump(2, 0.05, 4e-3)), slowed()) == ()
    assert dips_of(cell, line_of(bump(2, 0.05, 4e-3)), slowed((0.04, 0.05, 0.981 * SPEED))) == ()


def test_rest_within_the_bead_is_said_instead_of_a_joint(cell: Cell) -> None:
    path = line_of(bump(2, 1e-6, 0.05), run=0.0)
    first, last = dips_of(cell, path, slowed((-1.0, 0.005, 0.02), (0.092, 1.0, 0.03), run=0.0))
    assert (first.joint, first.limit, first.cause) == ("", "start", "starts from rest")
    assert (last.joint, last.limit, last.cause) == ("", "end", "comes to rest")
    assert first.from_s == 0.0
    assert last.to_s == LENGTH
    run = remedy(first, "run_in")
    assert not run.exact
    assert run.words == "process.run_in_mm: about 8.2"  # 3 mm, and the 5.1 mm of the dip
    stop = line_of(bump(2, 0.05, 2e-3), stops=(Stop(0.05, 0.1, "cut"),))
    (dip,) = dips_of(cell, stop, slowed((0.044, 0.056, 0.02)))
    assert (dip.joint, dip.limit, dip.cause, dip.remedies) == ("", "stop", "stops here", ())


def test_a_joint_that_is_short_at_the_start_is_named(cell: Cell) -> None:
    """Where a dip reaches into a run, what asks for it may stand in the run; a longer run is the remedy there."""
    path = line_of(bump(4, 0.2, 2e-3, at=-0.001))
    (dip,) = dips_of(cell, path, slowed((-1.0, 0.004, 0.02)), corner_tolerance=1e-3)
    assert dip.joint == "joint_5"
    assert [each.kind for each in dip.remedies] == ["speed", "limits"]  # the swing reaches far into the bead
    path = line_of(bump(4, 0.01, 1e-3, at=-0.002))
    (dip,) = dips_of(cell, path, slowed((-1.0, 0.001, 0.02)), corner_tolerance=1e-3, run_in=0.01)
    assert [(each.kind, each.exact) for each in dip.remedies] == [
        ("speed", False),
        ("limits", False),
        ("run_in", False),
    ]
    assert remedy(dip, "run_in").changes[0][1] > 10.0


def test_a_run_that_is_short_since_it_has_to_be_is_not_told_to_be_longer(cell: Cell) -> None:
    rest, at_rest = line_of(bump(2, 1e-6, 0.05), run=0.0), slowed((-1.0, 0.005, 0.02), (0.092, 1.0, 0.03), run=0.0)
    swing, slow = line_of(bump(4, 0.01, 1e-3, at=-0.002)), slowed((-1.0, 0.001, 0.02))
    for short in ((False, False), (True, False), (False, True)):
        bead = replace(bead_of(), short_runs=short)
        told = [[each.kind for each in dip.remedies] for dip in dips_of(cell, rest, at_rest, bead)]
        assert told == [[] if each else ["run_in"] for each in short]
        (dip,) = dips_of(cell, swing, slow, bead, corner_tolerance=1e-3, run_in=0.01)
        assert ("run_in" in [each.kind for each in dip.remedies]) is not short[0]


@pytest.mark.parametrize("tight", [1.0, 0.02])
def test_corner_tolerance_is_named_where_rounding_shapes_the_path(cell: Cell, tight: float) -> None:
    cell = with_limits(cell, jerk=tight * cell.limits.jerk)
    path, trajectory = line_of(bump(2, 0.02, 2e-3)), slowed((0.044, 0.056, 0.02))
    (smooth,) = dips_of(cell, path, trajectory, bead_of(np.radians(15.0)))
    (corner,) = dips_of(cell, path, trajectory, bead_of(np.radians(30.0)))
    assert "corner_tolerance" not in [each.kind for each in smooth.remedies]
    about = remedy(corner, "corner_tolerance")
    assert not about.exact
    assert about.words.startswith("process.corner_tolerance_mm: about ")
    # second derivatives fall with the tolerance, third ones with its square
    limits = dict(remedy(corner, "limits").changes)
    grown = [
        limits.get("cell.limits.joint_3.acceleration_rad_s2", 0.0) / cell.limits.acceleration[2],
        np.sqrt(limits.get("cell.limits.joint_3.jerk_rad_s3", 0.0) / cell.limits.jerk[2]),
    ]
    assert int(np.argmax(grown)) == (0 if tight == 1.0 else 1)
    assert about.changes[0][1] == pytest.approx(0.2 * max(grown), rel=0.1)  # told with two digits, rounded up


def test_what_the_problem_file_cannot_hold_is_not_named(cell: Cell) -> None:
    path = line_of(bump(2, 2.0, 1e-4))
    (dip,) = dips_of(cell, path, slowed((0.044, 0.056, 0.02)), corner_tolerance=0.05e-3)
    assert [each.kind for each in dip.remedies] == ["speed"]


def test_a_motor_that_does_not_slow_down_lays_too_much(cell: Cell) -> None:
    trajectory = slowed((0.044, 0.056, 0.02))
    constant = replace(trajectory, flow=np.where(trajectory.deposit, AREA * SPEED, 0.0))
    (dip,) = dips_of(cell, line_of(bump(2, 0.05, 2e-3)), constant)
    assert dip.over_extruded == pytest.approx(AREA * 0.012, rel=0.03)  # at half the speed twice as much


def test_places_where_samples_coincide_are_passed_over(cell: Cell) -> None:
    path = line_of(bump(2, 0.05, 2e-3))
    s = path.task.s.copy()
    s[600:606] = s[600]
    (dip,) = dips_of(cell, replace(path, task=replace(path.task, s=s)), slowed((0.044, 0.056, 0.02)))
    assert all(np.isfinite(value) for each in dip.remedies for _, value in each.changes)


# --- a print ----------------------------------------------------------------------------------------------------


@cache
def small_paths() -> tuple[JointPath, ...]:
    problem, plan = small_problem(), small_plan()
    tasks = make_tasks(plan.toolpath, problem.process.speed, problem.process.run_in)
    return tuple(
        STRATEGIES[plan.strategy](plan.cell, tasks, problem.resolve, obstacles_of(problem, plan.cell, plan.toolpath))
    )


def test_dips_of_a_plan_hold_every_slow_sample_once() -> None:
    plan, t = small_plan(), small_plan().trajectory
    commanded = plan.problem.process.speed
    slow = t.deposit & (t.speed < AT_SPEED * commanded)
    assert len(plan.dips) >= 3
    held = np.zeros(len(t), dtype=int)
    for dip in plan.dips:
        inside = (t.bead == dip.bead) & (t.s >= dip.from_s) & (t.s <= dip.to_s)
        held += inside
        i = int(np.rint(dip.t / t.dt))
        assert inside[i]
        assert t.speed[i] == dip.speed == t.speed[inside].min()
        assert t.s[i] == dip.at_s
        assert dip.layer == t.layer[i]
        assert dip.lost == pytest.approx((1.0 - t.speed[inside] / commanded).sum() * t.dt, rel=1e-9)
    assert (held[slow] == 1).all()
    assert [dip.t for dip in plan.dips] == sorted(dip.t for dip in plan.dips)
    lost = plan.metrics["deposition_time_s"] - plan.metrics["ideal_deposition_time_s"]
    assert sum(dip.lost for dip in plan.dips) == pytest.approx(
        lost, abs=0.1 * lost + 2 * t.dt * len(plan.toolpath.beads)
    )


def test_bounds_of_a_plan() -> None:
    m = small_plan().metrics
    assert m["ideal_deposition_time_s"] <= m["bound_deposition_time_s"] * (1 + 1e-6)
    assert m["bound_deposition_time_s"] <= m["deposition_time_s"] + 2 * DT * m["beads"]


def slowest_between(cell: Cell, path: JointPath, dip: Dip) -> float:
    """The lowest speed [m/s] where the dip was, when a path is timed anew."""
    timed = time_path(cell, path)
    s = timed.at(np.arange(0.0, timed.duration, 0.5 * DT))[1]
    speed = np.diff(s) / (0.5 * DT)
    return float(speed[(s[1:] >= dip.from_s) & (s[:-1] <= dip.to_s)].min())


def raised(cell: Cell, changes: tuple[tuple[str, float], ...]) -> Cell:
    """The cell with limits as a problem file would hold them."""
    limits: Limits = cell.limits
    for field, value in changes:
        _, _, joint, key = field.split(".")
        array = getattr(limits, FIELDS[key]).copy()
        array[cell.joint_names.index(joint)] = np.radians(value) if key == "speed_deg_s" else value
        limits = replace(limits, **{FIELDS[key]: array})
    return replace(cell, limits=limits)


# Limits many times the robot's let accelerations change by most of their limit within a step of the timing's grid.
REACHED = {"speed": AT_SPEED, "limits": 0.7}


@pytest.mark.parametrize("kind", ["speed", "limits"])
def test_exact_remedies_avoid_the_dip_on_the_same_joint_path(kind: str) -> None:
    plan = small_plan()
    paths = small_paths()
    tried = 0
    for dip in plan.dips:
        path = paths[dip.bead]
        commanded = path.task.speed
        assert slowest_between(plan.cell, path, dip) < AT_SPEED * commanded
        for each in dip.remedies:
            if each.kind != kind:
                continue
            tried += 1
            cell = plan.cell
            if kind == "speed":
                ((field, value),) = each.changes
                assert field == "process.speed_mm_s"
                path = replace(path, task=replace(path.task, speed=value * 1e-3))
            else:
                cell = raised(cell, each.changes)
            assert slowest_between(cell, path, dip) >= REACHED[kind] * path.task.speed, (dip.cause, each.words)
    assert tried >= 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["corner_tolerance", "run_in"])
def test_estimates_are_of_the_right_order(kind: str) -> None:
    """Solved anew with the estimate, the dip costs a third or less; with a tenth of the change it is still there."""
    short = ["process.run_in_mm=1.0"] if kind == "run_in" else []
    plan = solve(load_problem(small_plan().problem.file, short))
    dip = max((dip for dip in plan.dips if kind in [each.kind for each in dip.remedies]), key=lambda dip: dip.lost)
    ((field, value),) = remedy(dip, kind).changes
    now = 1e3 * {"corner_tolerance": plan.problem.process.corner_tolerance, "run_in": plan.problem.process.run_in}[kind]

    def lost(setting: float) -> float:
        again = solve(load_problem(plan.problem.file, [*short, f"{field}={setting:g}"]))
        near = [d for d in again.dips if d.bead == dip.bead and abs(d.at_s - dip.at_s) < 3e-3]
        return sum(d.lost for d in near)

    assert lost(value) <= dip.lost / 3.0
    assert lost(now + (value - now) / 10.0) > 0.3 * dip.lost
