"""Travel: moves within all limits, from rest to rest, and clear of the part."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.cell import Cell
from planner.errors import Refusal
from planner.problem import Problem
from planner.resolve.jointpath import JointPath
from planner.timing import TimedPath, time_path
from planner.toolpath.bead import Surface, Toolpath
from planner.travel import Travel, move, plan_travels

Array = NDArray[np.float64]
DT = 0.004


def check_limits(cell: Cell, q: Array, dt: float = DT) -> None:
    """Velocity, acceleration and jerk by differences of the samples, with rest before and after."""
    limits = cell.limits
    q = np.vstack([q[:1]] * 3 + [q] + [q[-1:]] * 3)
    for order, limit in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        worst = np.abs(np.diff(q, order, axis=0)).max(axis=0) / dt**order / limit
        assert worst.max() <= 1.0, (order, worst)


def tip_speeds(cell: Cell, q: Array, dt: float = DT) -> Array:
    tip = cell.T_part_nozzle(q)[:, :3, 3]
    return np.linalg.norm(np.diff(tip, axis=0), axis=1) / dt


def postures(cell: Cell, seed: int, n: int) -> Array:
    low, high = np.maximum(cell.limits.q_min, -2.5), np.minimum(cell.limits.q_max, 2.5)
    return np.random.default_rng(seed).uniform(low, high, (n, len(low)))


@given(seed=st.integers(0, 2**32 - 1), speed=st.floats(0.02, 2.0), share=st.sampled_from([1.0, 0.3, 1e-2, 1e-5]))
@settings(max_examples=30)
def test_moves_keep_limits_and_tip_speed_from_rest_to_rest(cell: Cell, seed: int, speed: float, share: float) -> None:
    a, b = postures(cell, seed, 2)
    b = a + share * (b - a)
    q = move(cell, a, b, speed, DT)
    np.testing.assert_allclose(q[0], a, rtol=0, atol=1e-9)
    np.testing.assert_allclose(q[-1], b, rtol=0, atol=1e-9)
    check_limits(cell, q)
    if len(q) > 1:
        assert tip_speeds(cell, q).max() <= speed
    # joints go straight from one value to the other
    assert (q >= np.minimum(a, b) - 1e-9).all()
    assert (q <= np.maximum(a, b) + 1e-9).all()


def test_all_joints_stop_together(cell: Cell) -> None:
    a, b = postures(cell, 1, 2)
    q = move(cell, a, b, 2.0, DT)
    left = np.abs(b - q) / np.abs(b - a)
    assert (left[-2] < 0.01).all()
    assert (left[len(q) // 2] > 0.01).all()


def test_a_move_that_nothing_slows_is_as_fast_as_its_slowest_joint_can(cell: Cell) -> None:
    """One joint alone: the closed form of a jerk-limited move that reaches its top speed."""
    a = cell.home.copy()
    b = a.copy()
    b[5] += 4.0
    v, acc, jerk = (0.98 * limit[5] for limit in (cell.limits.velocity, cell.limits.acceleration, cell.limits.jerk))
    q = move(cell, a, b, 5.0, DT)
    assert (len(q) - 1) * DT == pytest.approx(4.0 / v + v / acc + acc / jerk, abs=1.01 * DT)


def test_the_tip_speed_is_made_use_of(cell: Cell) -> None:
    a, b = postures(cell, 2, 2)
    assert 0.5 * 0.2 < tip_speeds(cell, move(cell, a, b, 0.2, DT)).max() <= 0.2


def test_a_move_to_where_it_is_takes_no_time(cell: Cell) -> None:
    q = move(cell, cell.home, cell.home, 0.2, DT)
    np.testing.assert_allclose(q, cell.home[None], rtol=0, atol=1e-12)


def test_tip_speed_counts_relative_to_the_part(cell: Cell) -> None:
    """The table alone turns: the part moves under the nozzle."""
    b = cell.home.copy()
    b[6] += 1.0
    q = move(cell, cell.home, b, 0.05, DT)
    r = np.hypot(*(cell.arm.poses(cell.home[None, :6])[0, :2, 3] - [0.6335, 0.00987]))
    assert np.abs(np.diff(q[:, 6])).max() / DT * r <= 0.05 * 1.001
    assert np.abs(np.diff(q[:, 6])).max() / DT * r > 0.04


def test_a_speed_that_no_move_can_keep_is_refused(cell: Cell) -> None:
    with pytest.raises(Refusal):
        move(cell, cell.home, cell.home + 0.01, 1e-7, DT)


# --- travels of a print -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def travels(cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem) -> list[Travel]:
    return plan_travels(cell, [piece.path for piece in timed], toolpath, drawing_problem.process, DT)


def test_travels_join_home_and_beads(cell: Cell, timed: tuple[TimedPath, ...], travels: list[Travel]) -> None:
    assert len(travels) == len(timed) + 1
    np.testing.assert_allclose(travels[0].q[0, :6], cell.home[:6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(travels[-1].q[-1, :6], cell.home[:6], rtol=0, atol=1e-9)
    for before, piece, after in zip(travels[:-1], timed, travels[1:], strict=True):
        np.testing.assert_allclose(before.q[-1], piece.q[0], rtol=0, atol=1e-9)
        np.testing.assert_allclose(after.q[0], piece.q[-1], rtol=0, atol=1e-9)


def test_travels_keep_limits_and_speed(cell: Cell, travels: list[Travel], drawing_problem: Problem) -> None:
    for travel in travels:
        check_limits(cell, travel.q)
        assert (travel.q >= cell.limits.q_min).all()
        assert (travel.q <= cell.limits.q_max).all()
        assert tip_speeds(cell, travel.q).max() <= drawing_problem.process.travel_speed * (1 + 1e-9)


def test_the_whole_motion_keeps_velocity_and_acceleration(
    cell: Cell, timed: tuple[TimedPath, ...], travels: list[Travel]
) -> None:
    """Over the joints between travel and beads too."""
    rows = [travels[0].q]
    for piece, travel in zip(timed, travels[1:], strict=True):
        rows += [piece.q[1:], travel.q[1:]]
    q = np.vstack(rows)
    assert (np.abs(np.diff(q, axis=0)).max(axis=0) / DT <= cell.limits.velocity).all()
    assert (np.abs(np.diff(q, 2, axis=0)).max(axis=0) / DT**2 <= cell.limits.acceleration).all()


def distance_to_cylinder(points: Array, radius: float) -> Array:
    """From the upright cylinder of the problem, 100 mm high; negative inside."""
    radial = np.hypot(points[:, 0] - 0.0314, points[:, 1] - 0.037) - radius
    axial = np.maximum(points[:, 2] - 0.1, -points[:, 2])
    outside = np.hypot(np.maximum(radial, 0), np.maximum(axial, 0))
    return np.where((radial < 0) & (axial < 0), np.maximum(radial, axial), outside)


def test_travels_keep_clear_of_the_cylinder(cell: Cell, travels: list[Travel], toolpath: Toolpath) -> None:
    """Tip and nozzle, up to 100 mm behind the tip, and what has been printed by then."""
    for i, travel in enumerate(travels):
        layers = 0 if i == 0 else toolpath.beads[i - 1].layer + 1
        T = cell.T_part_nozzle(travel.q)
        for back in np.linspace(0.0, 0.1, 41):
            distance = distance_to_cylinder(T[:, :3, 3] - back * T[:, :3, 2], 0.034 + layers * 0.5e-3)
            assert distance.min() > 0.5e-3
        tip = distance_to_cylinder(T[:, :3, 3], 0.034 + layers * 0.5e-3)
        # lifted by 5 mm from the runs' ends, which are 1.5 mm up themselves
        assert tip.max() > 5e-3


def test_travel_starts_and_ends_along_the_normal(
    cell: Cell, travels: list[Travel], timed: tuple[TimedPath, ...]
) -> None:
    for travel, piece in zip(travels[1:], timed, strict=True):
        T = cell.T_part_nozzle(travel.q)
        normal = -piece.path.task.frames[-1, :, 2]
        way = T[:, :3, 3] - T[0, :3, 3]
        up = way @ normal
        first = up < 4.9e-3
        first[np.argmin(first) :] = False  # until it is lifted for the first time
        assert first.sum() > 5
        aside = np.linalg.norm(way[first] - np.outer(up[first], normal), axis=1)
        assert aside.max() < 0.5e-3
        assert (np.diff(up[first]) > -1e-9).all()


class Wall:
    """A surface that is everywhere too near."""

    def signed_distance(self, points: Array) -> Array:
        return np.zeros(len(points))

    def normals(self, points: Array) -> Array:
        return np.tile([1.0, 0.0, 0.0], (len(points), 1))

    def before(self, bead: int) -> Wall:
        return self


def test_no_way_round_is_a_refusal_that_names_the_bead(
    cell: Cell, timed: tuple[TimedPath, ...], toolpath: Toolpath, drawing_problem: Problem
) -> None:
    surface: Surface = Wall()
    with pytest.raises(Refusal) as caught:
        plan_travels(
            cell, [piece.path for piece in timed], Toolpath(toolpath.beads, surface), drawing_problem.process, DT
        )
    assert caught.value.bead == 0
    assert "clear" in str(caught.value)


def test_the_table_stays_where_the_last_bead_leaves_it(
    cell: Cell, joint_paths: dict[str, tuple[JointPath, ...]], toolpath: Toolpath, drawing_problem: Problem
) -> None:
    # As published the table does all the turning, so that it ends elsewhere than it began.
    timed = [time_path(cell, path, DT) for path in joint_paths["as_published"]]
    assert abs(timed[-1].q[-1, 6] - timed[-1].q[0, 6]) > 1e-3
    home = plan_travels(cell, [piece.path for piece in timed], toolpath, drawing_problem.process, DT)[-1]
    np.testing.assert_allclose(home.q[:, 6], timed[-1].q[-1, 6], rtol=0, atol=1e-9)
