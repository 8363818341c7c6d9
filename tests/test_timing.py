"""Timing: the fastest profile against toppra, linear programming and closed forms; limits by differences of samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import toppra
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline
from scipy.ndimage import uniform_filter1d
from scipy.optimize import linprog
from toppra import algorithm, constraint

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.motion.timing.profile import HEADROOM
from planner.motion.timing.timed_path import TimedPath, bound_time, fastest_without_jerk, time_path
from planner.resolve.joint_path import JointPath, spread
from planner.toolpath.task import NozzleTask

DT = 0.004


def path_of(q: Array, s: Array, speed: float, runs: int = 0) -> JointPath:
    """Joints q (n, 7) along arc length s (n), with so many samples in each run; where the tip is does not matter here."""
    n = len(q)
    frames, first, last = np.tile(np.eye(3), (n, 1, 1)), runs, n - 1 - runs
    task = NozzleTask(0, "path", 0, np.zeros((n, 3)), frames, s - s[first], first, last, speed)
    return JointPath(task, np.zeros(n), np.zeros((n, 2)), q, 0)


class Samples(NamedTuple):
    """A timed path every DT from its start on: joints, arc length, speed between half a sample before and after."""

    timed: TimedPath
    q: Array
    s: Array
    s_dot: Array


def sampled(cell: Cell, path: JointPath, dt: float = DT) -> Samples:
    return samples_of(time_path(cell, path), dt)


def samples_of(timed: TimedPath, dt: float = DT) -> Samples:
    t = np.arange(int(np.ceil(timed.duration / dt - 1e-9)) + 1) * dt
    edges = timed.at(np.append(t - 0.5 * dt, t[-1] + 0.5 * dt))[1]
    return Samples(timed, *timed.at(t), np.diff(edges) / dt)


def ratios(timed: TimedPath, cell: Cell, dt: float = DT) -> tuple[float, float, float]:
    """Largest share of the velocity, acceleration and jerk limits, by differences of samples at rest at both ends."""
    q = timed.joints(np.arange(-3, int(np.ceil(timed.duration / dt)) + 4) * dt)
    limits = (cell.limits.velocity, cell.limits.acceleration, cell.limits.jerk)
    worst = [float(np.abs(np.diff(q, k, axis=0) / dt**k / limit).max()) for k, limit in enumerate(limits, start=1)]
    return worst[0], worst[1], worst[2]


@st.composite
def paths(draw: st.DrawFn) -> JointPath:
    """Smooth joint paths as `spread` makes them: with rests (repeated values), reversals, and samples that draw
    together to a tenth of their distance, as at a corner; from 0.1 mm to 0.3 m long."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.normal(size=(draw(st.integers(2, 12)), 7)) * 10 ** draw(st.floats(-3, 0.3))
    shape = draw(st.sampled_from(["plain", "rests", "there and back", "one joint"]))
    if shape == "rests":
        values = np.repeat(values, draw(st.integers(2, 8)), axis=0)
    elif shape == "there and back":
        values = np.vstack([values, values[::-1]])
    elif shape == "one joint":
        values[:, 1:] = values[0, 1:]
    n = 8 * len(values) + draw(st.integers(50, 90))
    length, speed = 10 ** draw(st.floats(-4, -0.5)), 10 ** draw(st.floats(-2.5, -0.5))
    steps = np.ones(n - 1)
    if draw(st.booleans()):
        u = np.linspace(-1.0, 1.0, n - 1)
        steps -= 0.9 * np.exp(-(((u - draw(st.floats(-0.5, 0.5))) / 0.3) ** 2))
    s = np.concatenate([[0.0], np.cumsum(steps)])
    return path_of(spread(values, n, np.linspace(0.0, 1.0, len(values))), s * length / s[-1], speed)


@pytest.mark.slow
@given(paths())
@settings(max_examples=80)
def test_limits_hold_at_the_samples(cell: Cell, path: JointPath) -> None:
    timed = time_path(cell, path)
    assert max(ratios(timed, cell)) <= 1.0
    assert max(ratios(timed, cell, dt=5e-4)) <= 1.0


@pytest.mark.slow
@given(paths())
@settings(max_examples=80)
def test_from_rest_to_rest_forwards_and_never_too_fast(cell: Cell, path: JointPath) -> None:
    timed = sampled(cell, path)
    assert timed.s_dot[0] >= 0.0
    assert -1e-9 <= timed.s_dot[-1] <= timed.s_dot.max()
    assert (timed.s_dot >= -1e-9).all()
    assert timed.s_dot.max() <= path.task.speed * (1.0 + 5e-3)  # the limit is set at grid points
    assert (np.diff(timed.s) >= -1e-12).all()
    scale = 1e-9 * max(1.0, float(np.abs(path.q).max()))
    np.testing.assert_allclose(timed.q[[0, -1]], path.q[[0, -1]], rtol=0, atol=scale)
    np.testing.assert_allclose(timed.s[[0, -1]], path.task.s[[0, -1]], rtol=0, atol=1e-12)


@pytest.mark.slow
@given(paths())
@settings(max_examples=25)
def test_samples_lie_on_the_path_that_was_given(cell: Cell, path: JointPath) -> None:
    timed = sampled(cell, path)
    u = np.arange(len(path.task), dtype=float)
    both = make_interp_spline(u, np.column_stack([path.q, path.task.s]), k=5)
    fine = both(np.linspace(0.0, u[-1], 4000))
    for j in range(7):
        expected = np.interp(timed.s, fine[:, -1], fine[:, j])
        assert np.abs(timed.q[:, j] - expected).max() < 1e-4 * max(float(np.ptp(path.q[:, j])), 1e-6)


def test_speed_and_acceleration_are_continuous(timed: tuple[TimedPath, ...]) -> None:
    """Second differences over ever shorter steps settle: no jump hides between the samples."""
    for piece in timed:
        for dt in (1e-3, 2e-4):
            q = piece.joints(np.arange(int(piece.duration / dt)) * dt)
            change = np.abs(np.diff(q, 3, axis=0)) / dt**2
            assert change.max() < 1.1 * 50.0 * 30.0 * dt  # of acceleration, at the greatest jerk, in a step


# --- closed forms -----------------------------------------------------------------------------------------------


def test_straight_joint_motion_is_the_s_curve(cell: Cell) -> None:
    """One joint in proportion to the way: jerk, acceleration and jerk again up to the commanded speed, which is held.

    The closed form is that of the quickest change of speed; where acceleration has no time to reach its limit, it
    rises and falls with the greatest jerk.
    """
    length, speed, n = 0.1, 0.04, 400
    s = np.linspace(0.0, length, n)
    for turn in (1.5, 12.0):
        q = np.zeros((n, 7))
        q[:, 5] = turn * s / length
        timed = sampled(cell, path_of(q, s, speed))
        a, jerk = (HEADROOM * limit[5] * length / turn for limit in (cell.limits.acceleration, cell.limits.jerk))
        ramp = speed / a + a / jerk if speed > a**2 / jerk else 2.0 * np.sqrt(speed / jerk)
        assert timed.timed.duration == pytest.approx(
            length / speed + ramp, abs=0.06 * ramp
        )  # jerk changes at grid points
        t = np.arange(len(timed.s)) * DT
        middle = (t > 1.2 * ramp + DT) & (t < timed.timed.duration - 1.2 * ramp - DT)
        np.testing.assert_allclose(timed.s_dot[middle], speed, rtol=2e-3)


def test_the_bound_of_straight_joint_motion_is_the_trapezoid(cell: Cell) -> None:
    length, speed, turn, n = 0.1, 0.04, 12.0, 400
    s = np.linspace(0.0, length, n)
    q = np.zeros((n, 7))
    q[:, 5] = turn * s / length
    gain = cell.limits.acceleration[5] * length / turn  # of the tip, m/s^2
    assert bound_time(cell, path_of(q, s, speed)) == pytest.approx(length / speed + speed / gain, rel=1e-3)
    met = bound_time(cell, path_of(q, s, speed, 9), (True, True))  # runs too short to gather that speed
    assert met == pytest.approx(length * 381 / 399 / speed, rel=1e-6)
    begun = bound_time(cell, path_of(q, s, speed), (True, True))  # and none: there it rests
    assert begun == pytest.approx(length / speed + speed / gain, rel=1e-3)


@pytest.mark.parametrize("runs", [0, 5])
def test_a_bead_is_begun_in_motion_along_a_run_alone(cell: Cell, runs: int) -> None:
    s = np.linspace(0.0, 0.05, 200)
    q = cell.home + np.outer(s, np.linspace(1.0, 7.0, 7))
    timed = time_path(cell, path_of(q, s, 0.04, runs), (True, True))
    assert timed.start.resting == timed.end.resting == (runs == 0)


def test_a_slow_joint_sets_the_speed(cell: Cell) -> None:
    n, length, turn = 400, 0.05, 10.0
    s = np.linspace(0.0, length, n)
    q = np.zeros((n, 7))
    q[:, 5] = turn * s / length
    timed = sampled(cell, path_of(q, s, 0.2))
    fastest = HEADROOM * cell.limits.velocity[5] * length / turn
    assert timed.s_dot.max() == pytest.approx(fastest, rel=2e-3)


def test_a_dip_is_local(cell: Cell) -> None:
    """A joint that swings in the middle of a long path costs speed there and nowhere else."""
    n, length, speed = 1000, 0.2, 0.04
    s = np.linspace(0.0, length, n)
    q = np.zeros((n, 7))
    q[:, 1] = 0.1 * np.exp(-(((s - 0.1) / 1.5e-3) ** 2))
    timed = sampled(cell, path_of(q, s, speed))
    dip = timed.s_dot < 0.98 * speed
    places = timed.s[dip & (timed.s > 0.02) & (timed.s < 0.18)]
    assert len(places) > 0
    assert places.min() > 0.09
    assert places.max() < 0.11


@pytest.mark.parametrize("closer", [1.0, 0.1, 0.01])
def test_joints_that_never_move_cost_no_time(cell: Cell, closer: float) -> None:
    """However close the samples are in the middle of the path, and then at its ends."""
    n = 300
    steps = np.where(np.abs(np.arange(n - 1) - 150) < 40, closer, 1.0)
    s = np.concatenate([[0.0], np.cumsum(uniform_filter1d(uniform_filter1d(steps, 15), 15))])
    s *= 0.1 / s[-1]
    timed = sampled(cell, path_of(np.tile(cell.home, (n, 1)), s, 0.04))
    assert np.isfinite(timed.q).all()
    assert timed.timed.duration < 0.1 / 0.04 * 1.04


# --- the profile itself -----------------------------------------------------------------------------------------


def random_spline(rng: np.random.Generator, n: int, joints: int = 7) -> tuple[Array, Callable[..., Array]]:
    """A smooth path through random points, over a parameter whose rate is about 1 when nothing limits."""
    knots = np.linspace(0.0, 6.0, 9)
    spline = make_interp_spline(knots, rng.normal(size=(9, joints)), k=5)
    return np.linspace(0.0, 6.0, n), spline


def duration(x: Array, step: float) -> float:
    rate = np.sqrt(x)
    return float((2.0 * step / (rate[1:] + rate[:-1])).sum())


@pytest.mark.parametrize("seed", range(6))
def test_fastest_profile_against_toppra(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid, spline = random_spline(rng, 801)
    v, a = rng.uniform(0.6, 2.0, 7), rng.uniform(2.0, 6.0, 7)
    with np.errstate(divide="ignore"):
        ceiling = np.minimum((v / np.abs(spline(grid, 1))).min(axis=1), 1.0) ** 2
    x = fastest_without_jerk(spline(grid, 1), spline(grid, 2), ceiling, a, grid[1], False, False)

    class Path(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        """The spline, and the parameter itself as a joint of its own: its speed limit is the commanded speed."""

        def __call__(self, u: Array, order: int = 0) -> Array:
            u = np.asarray(u)
            own = (u, np.ones_like(u), np.zeros_like(u))[order]
            return np.concatenate([spline(u, order), own[..., None]], axis=-1)

        @property
        def dof(self) -> int:
            return 8

        @property
        def path_interval(self) -> Array:
            return grid[[0, -1]]

        @property
        def waypoints(self) -> tuple[Array, Array]:
            return grid, self(grid)

    limits = [
        constraint.JointVelocityConstraint(np.column_stack([-np.append(v, 1.0), np.append(v, 1.0)])),
        constraint.JointAccelerationConstraint(
            np.column_stack([-np.append(a, 1e6), np.append(a, 1e6)]),
            discretization_scheme=constraint.DiscretizationType.Interpolation,
        ),
    ]
    rates = algorithm.TOPPRA(limits, Path(), gridpoints=grid).compute_parameterization(0.0, 0.0)[1]
    assert rates is not None
    assert duration(x, grid[1]) == pytest.approx(duration(rates**2, grid[1]), rel=5e-3)
    assert np.abs(x - rates**2).max() < 0.05


@pytest.mark.parametrize("moving", [(False, False), (True, True)], ids=["at rest", "moving"])
def test_toppra_times_a_path_within_speed_and_acceleration(cell: Cell, moving: tuple[bool, bool]) -> None:
    """It is as quick as the bound, which knows no jerk either, and no quicker; ours takes longer."""
    rng = np.random.default_rng(4)
    n, length, speed = 300, 0.1, 0.04
    s = np.linspace(0.0, length, n)
    knots = np.linspace(0.0, length, 9)
    q = cell.home + make_interp_spline(knots, rng.normal(scale=0.25, size=(9, 7)), k=5)(s)
    path = path_of(q, s, speed, 10 if any(moving) else 0)
    found, ours = time_path(cell, path, moving, "toppra"), time_path(cell, path, moving)
    assert found.duration < (1.01 if any(moving) else 1.0) * ours.duration  # its ends may be slower
    if moving == (False, False):
        assert found.duration == pytest.approx(bound_time(cell, path), rel=0.02)
    t = np.arange(0.0, found.duration, DT)
    joints, way = found.at(t)
    for k, limit in ((1, cell.limits.velocity), (2, cell.limits.acceleration)):
        assert (np.abs(np.diff(joints, k, axis=0)) / DT**k <= 1.01 * limit).all()
    assert (np.diff(way) / DT <= 1.001 * speed).all()
    np.testing.assert_allclose(way[-1], path.task.s[-1], atol=speed * DT)


def constraints(slopes: Array, bends: Array, a_max: Array, step: float) -> Array:
    """Rows A with A x <= 1: each joint's acceleration at both ends of every interval, which is linear in x."""
    n, joints = slopes.shape
    rows = []
    for i in range(n - 1):
        for end in (i, i + 1):
            for j in range(joints):
                row = np.zeros(n)
                row[i] -= slopes[end, j] / (2 * step)
                row[i + 1] += slopes[end, j] / (2 * step)
                row[end] += bends[end, j]
                rows += [row / a_max[j], -row / a_max[j]]
    return np.array(rows)


@pytest.mark.slow(keep=8)
@pytest.mark.parametrize("seed", range(25))
def test_fastest_profile_against_linear_programming(seed: int) -> None:
    """On tiny grids: it holds every limit, and nowhere can any profile be faster by more than a little.

    Where a joint turns back within one interval, no profile is the fastest everywhere at once; the forward pass is
    greedy there, as in TOPP-RA itself, so that equality is asked of most points and nearness of the whole time.
    """
    rng = np.random.default_rng(100 + seed)
    n = int(rng.integers(4, 9)) * 4 + 1
    joints = int(rng.integers(1, 4))
    _, spline = random_spline(rng, 400, joints)
    grid = np.linspace(0.5, 0.5 + 0.05 * (n - 1), n)
    slopes, bends = np.ascontiguousarray(spline(grid, 1)), np.ascontiguousarray(spline(grid, 2))
    a_max, v_max = rng.uniform(0.5, 4.0, joints), rng.uniform(0.3, 2.0, joints)
    ceiling = np.minimum((v_max / np.abs(slopes)).min(axis=1), rng.uniform(0.4, 1.5)) ** 2
    step = float(grid[1] - grid[0])
    free = seed % 2 == 1, seed % 4 > 1
    x = fastest_without_jerk(slopes, bends, ceiling, a_max, step, *free)
    assert (x[[0, -1]] > 0.0).tolist() == list(free)
    assert (x[1:-1] > 0.0).all()
    assert (x <= ceiling * (1 + 1e-9)).all()
    A = constraints(slopes, bends, a_max, step)
    assert (A @ x).max() <= 1.0 + 1e-6
    upper = ceiling.copy()
    upper[[0, -1]] *= free
    bounds = list(zip(np.zeros(n), upper, strict=True))
    highest = np.zeros(n)
    for k in range(n):
        best = linprog(-np.eye(n)[k], A_ub=A, b_ub=np.ones(len(A)), bounds=bounds)
        assert best.success
        highest[k] = -best.fun
    assert (x <= highest + 1e-6).all()
    assert np.mean(x > 0.999 * highest - 1e-9) > 0.6
    assert duration(x, step) < 1.03 * duration(highest, step)


# --- the shipped cell -------------------------------------------------------------------------------------------


def test_real_paths_hold_limits_and_speed(
    cell: Cell, timed: tuple[TimedPath, ...], joint_paths: dict[str, tuple[JointPath, ...]]
) -> None:
    for name, pieces in (
        ("ladder", timed),
        ("as_published", [time_path(cell, p) for p in joint_paths["as_published"]]),
    ):
        for piece in pieces:
            assert max(ratios(piece, cell)) <= 1.0, name
            assert samples_of(piece).s_dot.max() <= 0.04 * (1 + 2e-3)  # it is commanded at grid points


@pytest.mark.parametrize("moving", [(False, False), (True, True), (True, False)], ids=["at rest", "moving", "both"])
def test_jerk_costs_little_time(
    cell: Cell, joint_paths: dict[str, tuple[JointPath, ...]], moving: tuple[bool, bool]
) -> None:
    for path in joint_paths["sqp"]:
        if any(moving):  # with runs in which no speed could be gathered
            first, last = path.task.first - 2, path.task.last + 3
            kept = replace(path.task, **{key: getattr(path.task, key)[first:last] for key in ("tip", "frames", "s")})
            path = replace(path, task=replace(kept, first=2, last=last - first - 3), q=path.q[first:last])
        timed = time_path(cell, path, moving)
        length = path.task.s[path.task.last]
        t = np.linspace(0.0, timed.duration, 20001)
        start, end = np.interp([0.0, length], timed.at(t)[1], t)
        bound = bound_time(cell, path, moving)
        assert 0.9999 * bound <= end - start <= 1.03 * bound


def test_ladder_prints_faster_than_as_published(
    cell: Cell, timed: tuple[TimedPath, ...], joint_paths: dict[str, tuple[JointPath, ...]]
) -> None:
    published = sum(time_path(cell, p).duration for p in joint_paths["as_published"])
    assert sum(piece.duration for piece in timed) < published
