"""Bad inputs by the hundred: what comes is a valid motion or a clear refusal, never an exception, NaN or overrun."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from bad_cases import CAP, RADIUS, drawing_case, joint_case, waypoint_case
from scipy.interpolate import make_interp_spline
from solved import solve_alone

from planner.base.errors import InputError, PlannerError, Refusal
from planner.base.nearest import distance_to_polyline
from planner.cell.cell import Cell
from planner.motion.timing.timed_path import time_path
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath
from planner.toolpath.build import build_toolpath
from planner.toolpath.interpolation import interpolate
from planner.toolpath.task import NozzleTask
from planner.toolpath.waypoints.reader import SAME_PLACE, distinct
from planner.toolpath.waypoints.surfels import Surfels

DT = 0.004
SPEEDS = (5.0, 40.0, 200.0)  # mm/s


def waypoint_problem(folder: Path, seed: int) -> Problem:
    _, text, options = waypoint_case(seed)
    (folder / "bad.txt").write_text(text, encoding="utf-8")
    file = folder / "bad.yaml"
    file.write_text(CAP.format(options=options, speed=SPEEDS[seed % 3], strategy="ladder"), encoding="utf-8")
    return load_problem(file)


def drawing_problem_of(folder: Path, seed: int) -> Problem:
    _, text = drawing_case(seed)
    (folder / "bad.svg").write_text(text, encoding="utf-8")
    coarse = ["layers.count=1", "resolve.roll_step_deg=30", "resolve.table_step_deg=30", "resolve.rung_mm=10"]
    width = 10 ** np.random.default_rng(seed).uniform(0, 1.7)
    changes = [f"layers.source.svg={folder / 'bad.svg'}", f"layers.source.width_mm={width:.3f}"]
    speed = [f"process.speed_mm_s={SPEEDS[seed % 3]}", "strategy=ladder"]
    return load_problem("cylinder_logo", [*coarse, *changes, *speed])


MAKERS = {"waypoints": waypoint_problem, "drawing": drawing_problem_of}


def assert_clear(error: PlannerError) -> None:
    """A refusal says what and where."""
    assert len(str(error)) > 20
    if isinstance(error, InputError):
        assert error.field is not None or error.file is not None  # a field of --set stands in no file
    elif isinstance(error, Refusal):
        assert error.bead is not None


# Toolpaths


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("waypoints", 250), ("drawing", 60)])
def test_toolpaths_are_sound_or_refused(kind: str, count: int, tmp_path: Path) -> None:
    built = 0
    for seed in range(count):
        try:
            problem = MAKERS[kind](tmp_path, seed)
            toolpath = build_toolpath(problem)
        except PlannerError as error:
            assert_clear(error)
            continue
        built += 1
        tolerance = problem.process.corner_tolerance
        for bead in toolpath.beads:
            for name in ("points", "normals", "roll_zero", "s", "source"):
                assert np.isfinite(getattr(bead, name)).all(), (seed, name)
            assert (np.diff(bead.s) > 0.0).all(), seed
            assert bead.length > 0.3 * problem.process.bead.width, seed
            for unit in (bead.normals, bead.roll_zero):
                np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, atol=1e-9)
            assert distance_to_polyline(bead.points, bead.source).max() <= tolerance * (1.0 + 1e-9), seed
            k = np.arange(len(bead.s), dtype=float)
            forwards = make_interp_spline(k, bead.s, k=min(5, len(k) - 1))(np.linspace(0.0, k[-1], 12 * len(k)), 1)
            assert forwards.min() > 0.0, seed  # what timing makes of it
    assert built > count // 5


@pytest.mark.slow(keep=15)
@pytest.mark.parametrize("seed", range(60))
def test_the_curve_stays_beside_its_waypoints(seed: int) -> None:
    """Waypoints whose distances differ by 10,000: no point of the curve is far from the chords between them."""
    rng = np.random.default_rng(seed)
    steps = 10 ** rng.uniform(-6.5, -2.5, int(rng.integers(3, 40)))  # m
    turn = np.cumsum(rng.normal(size=len(steps)) * 10 ** rng.uniform(-2, 0))
    way = np.cumsum(np.column_stack([steps * np.cos(turn), steps * np.sin(turn), 0.0 * steps]), axis=0)
    points = np.vstack([np.zeros(3), way])
    points = points[distinct(points)]
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    curve = interpolate(points, normals, 2e-4, 3e-4, 3e-4)
    dense = np.vstack([np.linspace(a, b, 200) for a, b in zip(points[:-1], points[1:], strict=True)])
    bow = 0.25 * float(np.linalg.norm(np.diff(points, axis=0), axis=1).max())
    assert distance_to_polyline(curve.points, dense).max() < 2e-4 + bow
    assert distance_to_polyline(points, curve.source).max() < 1e-6


@pytest.mark.parametrize("creep", [0.0, 1e-12, 1e-9, 5e-8])  # m
def test_points_that_creep_are_one(creep: float) -> None:
    """However many of them there are: they say nothing of how densely the path is written."""
    rng = np.random.default_rng(1)
    path = np.column_stack([np.arange(20) * 1e-3, np.zeros(20), np.zeros(20)])
    points = np.repeat(path, 9, axis=0) + creep * rng.choice([-1.0, 0.0, 1.0], size=(180, 3)) / 2.0
    kept = points[distinct(points)]
    assert len(kept) == 20
    assert np.abs(kept - path).max() <= SAME_PLACE


def row(x: float, y: float, normal: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> str:
    return " ".join(f"{v:.6f}" for v in (x, y, RADIUS, *normal))


@pytest.mark.parametrize(
    ("rows", "line", "words"),
    [
        ([row(0, 0), row(0.1, 0), row(0.2, 0)], 1, "only 0.2000 mm long"),
        ([row(0, 0), row(1, 0), row(2, 0, (0.866, 0, -0.5)), row(3, 0)], 3, "turns by 120 degrees"),
        ([row(k, 0, (1, 0, 0)) for k in range(5)], 1, "runs along its normals"),
        (["# remark", row(0, 0), row(1, 0), row(2, 0, (1, 0, -0.2)), row(3, 0)], 4, "turns by 101 degrees"),
    ],
)
def test_what_is_no_bead_is_named_with_its_line(rows: list[str], line: int, words: str, tmp_path: Path) -> None:
    (tmp_path / "bad.txt").write_text("\n".join(rows), encoding="utf-8")
    (tmp_path / "bad.yaml").write_text(CAP.format(options="", speed=40, strategy="ladder"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        build_toolpath(load_problem(tmp_path / "bad.yaml", ["layers.source.kind=surface"]))
    assert words in caught.value.reason
    assert caught.value.line == line


@pytest.mark.slow
def test_a_step_up_to_the_next_layer_is_allowed(tmp_path: Path) -> None:
    rows = [row(k, 0) for k in range(12)]
    rows += [" ".join(map(str, (11 - k, 0.0, RADIUS + 0.5, 0, 0, 1))) for k in range(12)]
    (tmp_path / "bad.txt").write_text("\n".join(rows), encoding="utf-8")
    (tmp_path / "bad.yaml").write_text(CAP.format(options="", speed=40, strategy="ladder"), encoding="utf-8")
    plan = solve(load_problem(tmp_path / "bad.yaml"))
    assert len(plan.toolpath.beads) == 1
    assert plan.verified


# Timing


def bad_joint_path(seed: int) -> tuple[JointPath, bool]:
    """A joint path, and whether its arc length, as timing sees it, grows all along."""
    _, q, s, speed = joint_case(seed)
    n = len(q)
    run = n // 4 if n >= 8 and seed % 3 else 0  # samples of run-in and run-out
    frames = np.tile(np.eye(3), (n, 1, 1))
    task = NozzleTask(0, "bad", 0, np.zeros((n, 3)), frames, s, run, n - 1 - run, speed)
    u = np.linspace(0.0, n - 1.0, 40 * n)
    grows = bool(np.diff(make_interp_spline(np.arange(n), s, k=min(5, n - 1))(u)).min() >= -1e-9 * s[-1])
    return JointPath(task, np.zeros(n), np.zeros((n, 2)), q, 0), grows


def faults(cell: Cell, path: JointPath, dt: float = DT) -> list[str]:
    """What is wrong with the timing of a path, by differences of its samples; at rest before and after."""
    timed = time_path(cell, path)
    q, s = timed.at(np.arange(int(np.ceil(timed.duration / dt)) + 1) * dt)
    if not (np.isfinite(q).all() and np.isfinite(s).all()):
        return ["not finite"]
    p = np.vstack([q[:1], q[:1], q, q[-1:], q[-1:]])
    largest = {
        "velocity": (np.abs(p[3:-1] - p[1:-3]) / (2 * dt) / cell.limits.velocity).max(),
        "acceleration": (np.abs(np.diff(p[1:-1], 2, axis=0)) / dt**2 / cell.limits.acceleration).max(),
        "jerk": (np.abs(p[4:] - 2 * p[3:-1] + 2 * p[1:-3] - p[:-4]) / (2 * dt**3) / cell.limits.jerk).max(),
        "speed": np.diff(s).max() / dt / path.task.speed / 1.02,
        "backwards": 1.0 - 1e3 * np.diff(s).min() / dt / path.task.speed - 1e-6,
        "ends": np.abs(q[[0, -1]] - path.q[[0, -1]]).max() / 1e-6,
    }
    return [f"{name} {value:.4f}" for name, value in largest.items() if not value <= 1.0]


@pytest.mark.slow
def test_joint_paths_are_timed_within_limits(cell: Cell) -> None:
    tried, wrong = 0, {}
    for seed in range(220):
        path, grows = bad_joint_path(seed)
        if not grows:
            continue
        tried += 1
        try:
            found = faults(cell, path)
        except PlannerError as error:
            assert_clear(error)
            continue
        if found:
            wrong[seed] = found
    assert tried >= 80
    assert not wrong


def test_an_arc_length_that_falls_between_samples_is_refused(cell: Cell) -> None:
    """No toolpath gives such samples; whoever calls timing with them must be told."""
    paths = [path for path, grows in map(bad_joint_path, range(40)) if not grows]
    assert len(paths) > 10
    for path in paths:
        with pytest.raises(PlannerError):
            time_path(cell, path)


# The whole way


def judge(plan: Plan) -> set[str]:
    """Names of the checks that fail."""
    trajectory = plan.trajectory
    for field in fields(trajectory):
        value = getattr(trajectory, field.name)
        if isinstance(value, np.ndarray):
            assert np.isfinite(value).all(), field.name
    assert np.isfinite(list(plan.metrics.values())).all()
    for name in ("velocity", "acceleration", "jerk"):
        assert plan.metrics[f"{name}_ratio_max"] <= 1.0, name
    return {check.name for check in plan.checks if not check.ok}


@pytest.mark.slow
def test_a_long_step_may_bend_where_short_ones_are_nearer(tmp_path: Path) -> None:
    assert not judge(solve_alone(MAKERS["waypoints"](tmp_path, 23)))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("waypoints", 40), ("drawing", 10)])
def test_bad_cases_all_the_way(kind: str, count: int, tmp_path: Path) -> None:
    """Each is a verified plan or a refusal that says where: the verifier has nothing left to find."""
    planned, unverified = 0, {}
    for seed in range(count):
        try:
            plan = (solve_alone if seed % 4 else solve)(MAKERS[kind](tmp_path, seed))
        except PlannerError as error:
            assert_clear(error)
            continue
        planned += 1
        found = judge(plan)
        if found:
            unverified[seed] = found
    assert planned >= count // 5
    assert not unverified


@pytest.mark.slow
def test_a_bead_that_ends_while_it_grows_faster(tmp_path: Path) -> None:
    """A spiral of a millimetre: what its last step lays down is more than any of its samples tells."""
    _, text, options = waypoint_case(1054)
    (tmp_path / "bad.txt").write_text(text, encoding="utf-8")
    (tmp_path / "bad.yaml").write_text(CAP.format(options=options, speed=120, strategy="sqp"), encoding="utf-8")
    plan = solve(load_problem(tmp_path / "bad.yaml"))
    speed = plan.trajectory.speed[plan.trajectory.deposit]
    assert speed.argmax() == len(speed) - 1
    assert not judge(plan)


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize(("seed", "wrong"), [(226, "normals noise"), (154, "crosses itself")])
def test_the_axis_is_judged_by_its_own_pass(seed: int, wrong: str, tmp_path: Path) -> None:
    plan = solve(waypoint_problem(tmp_path, seed))
    assert plan.verified, wrong
    assert plan.metrics["axis_error_max_deg"] < 0.01, wrong


@pytest.mark.parametrize("lower", [0.3, 0.7])  # mm, beneath a pass that is 0.5 mm high
def test_a_path_beneath_another_pass_is_named_with_its_line(lower: float, tmp_path: Path) -> None:
    across = [" ".join(map(str, (6.0, k - 6.0, RADIUS - lower, 0, 0, 1))) for k in range(13)]
    (tmp_path / "bad.txt").write_text("\n".join([row(k, 0) for k in range(13)] + across), encoding="utf-8")
    options = ", split_mm: 2, kind: surface"
    (tmp_path / "bad.yaml").write_text(CAP.format(options=options, speed=40, strategy="ladder"), encoding="utf-8")
    problem = load_problem(tmp_path / "bad.yaml")
    if lower < 0.5:
        assert len(build_toolpath(problem).beads) == 2
        return
    with pytest.raises(InputError) as caught:
        build_toolpath(problem)
    assert f"path 2 runs {lower - 0.5:.2f} mm deep inside what another pass lies on" in caught.value.reason
    assert caught.value.line == 13 + 7


def test_how_far_layers_lie_apart_is_told_along_their_normals(tmp_path: Path) -> None:
    across = [" ".join(map(str, (6.0, k - 6.0, RADIUS - 4.0, 0, 0, 1))) for k in range(13)]
    (tmp_path / "bad.txt").write_text("\n".join([row(k, 0) for k in range(13)] + across), encoding="utf-8")
    (tmp_path / "two.yaml").write_text(
        CAP.format(options=", split_mm: 2", speed=40, strategy="ladder"), encoding="utf-8"
    )
    toolpath = build_toolpath(load_problem(tmp_path / "two.yaml"))
    upper, lower = toolpath.beads
    gap = np.linalg.norm(upper.points[:, None] - lower.points[None], axis=2)
    i = int(gap.min(axis=0).argmin())
    surface = toolpath.surface
    assert isinstance(surface, Surfels)
    assert surface.nearest_layer(lower.points[i]) == pytest.approx(gap.min(), rel=0.05)
    assert surface.nearest_layer(lower.points[i] + [0.0, 0.0, 0.5]) == np.inf
