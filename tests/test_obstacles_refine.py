"""Refinement and travel keep clear of obstacles."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from collision_cells import coal_distance, placed, with_bodies

from planner.base.errors import Blocked, Refusal
from planner.cell.cell import Cell, build_cell
from planner.cell.solids import Body, Capsule
from planner.collision import scene
from planner.collision.point_tree import point_tree
from planner.collision.print_body import TipRoom
from planner.collision.scene import NOTHING, Around, Obstacles, _assembled, obstacles_of
from planner.motion.cubics import Cubics, JointState
from planner.motion.timing.timed_path import TimedPath, time_path
from planner.motion.travel import detours, plan, ways
from planner.motion.travel.clearance import travel_clearance
from planner.motion.travel.detours import ClearSpace, around, shorter
from planner.motion.travel.plan import TravelTask, no_way, plan_travels, quickest, too_near
from planner.motion.travel.ways import Ends, bounds_of
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ladder
from planner.resolve.segment import clearances, shortage
from planner.resolve.sqp import refine_paths, sqp
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import Cones, NozzleTask, tasks_of

ASIDE = [0.0, 0.3, 0.3]  # m
SLIGHT = 2e-4  # m: what may lack between the instants that are looked at


def at(place: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = place
    return T


@pytest.fixture(scope="module")
def problem() -> Problem:
    return load_problem("cylinder_logo", ["layers.count=1"])


@pytest.fixture(scope="module")
def toolpath(problem: Problem) -> Toolpath:
    whole = build_toolpath(problem)
    return replace(whole, beads=whole.beads[:2])


@pytest.fixture(scope="module")
def bare(problem: Problem) -> Cell:
    return with_bodies(build_cell(problem))


@pytest.fixture(scope="module")
def tasks(problem: Problem, toolpath: Toolpath) -> tuple[NozzleTask, ...]:
    return tasks_of(problem, toolpath)


def least(cell: Cell, fixture: Body, q: np.ndarray) -> float:
    """Least distance of a fixture from arm and head at postures q (n, nj), by coal."""
    return min(
        coal_distance(body.solid, body.T, fixture.solid, fixture.T_frame_solid)
        for each in q
        for (name, _), body in placed(cell, each).items()
        if name != fixture.name
    )


def head_at(cell: Cell, q: np.ndarray) -> np.ndarray:
    """Where the middle of the print head is (3) at a posture."""
    return next(body.T[:3, 3] for (name, _), body in placed(cell, q).items() if name == "print head")


# --- refinement -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_refined_paths_keep_clear_of_a_post(
    problem: Problem, bare: Cell, toolpath: Toolpath, tasks: tuple[NozzleTask, ...]
) -> None:
    unaware = sqp(bare, tasks, problem.resolve)
    middle = unaware[0].q[len(unaware[0].q) // 2]
    post = Body("post", Capsule(0.01, 0.1), at(head_at(bare, middle) + [0.0, 0.0, 0.03]))
    cell = replace(bare, fixtures=(post,))
    assert least(cell, post, unaware[0].q[::20]) < 0.0
    obstacles = obstacles_of(problem, cell, toolpath)
    aware = sqp(cell, tasks, problem.resolve, obstacles)
    assert min(least(cell, post, path.q[::20]) for path in aware) > problem.collision.nozzle - SLIGHT
    for path in aware:
        assert obstacles.margins(path.q, path.task.moments, 1.0)[0].min() > -SLIGHT


@pytest.mark.slow
def test_a_window_looks_from_its_first_sample_that_counts(
    problem: Problem, bare: Cell, toolpath: Toolpath, tasks: tuple[NozzleTask, ...]
) -> None:
    """What lacks there has a weight, and every sample that counts is stood for."""
    path = ladder(bare, tasks, problem.resolve)[0]
    n, first = len(path.q), 4
    post = Body("post", Capsule(0.01, 0.1), at(head_at(bare, path.q[first]) + [0.0, 0.0, 0.03]))
    obstacles = obstacles_of(problem, replace(bare, fixtures=(post,)), toolpath)
    G = np.ones((n, path.q.shape[1], 1))
    for held in (True, False):
        near = clearances(obstacles, path.q, G, path.task.moments, path.task.tip, first, held=held)
        assert not near.time[:first].any()
        assert near.time[first] > 0.0
        assert near.time.sum() == n - first
        assert near.sample.min() == first
        assert shortage(near)[first] > 0.0


@pytest.mark.slow
def test_no_refined_path_gives_up_the_clearance_that_was_found(
    problem: Problem, bare: Cell, toolpath: Toolpath, tasks: tuple[NozzleTask, ...]
) -> None:
    """A ball where the refined head is and the one that was given is not: without rows the refinement runs into it."""
    given = ladder(bare, tasks, problem.resolve)
    free = refine_paths(bare, given, problem.resolve)
    heads = [np.array([head_at(bare, q) for q in path.q[::20]]) for path in (given[0], free[0])]
    away = np.linalg.norm(heads[1] - heads[0], axis=1)

    def margin(path: JointPath) -> float:
        return float(obstacles.margins(path.q, path.task.moments, 1.0)[0].min())

    for k in np.argsort(-away):  # where the two are farthest apart, unless the given one passes there elsewhere
        beyond = heads[1][k] + 0.023 * (heads[1][k] - heads[0][k]) / away[k]
        cell = replace(bare, fixtures=(Body("ball", Capsule(0.005, 0.0), at(beyond)),))
        obstacles = obstacles_of(problem, cell, toolpath)
        if margin(given[0]) > margin(free[0]):
            break
    kept = refine_paths(cell, given, problem.resolve, obstacles)
    assert margin(given[0]) > margin(free[0])
    assert margin(kept[0]) > min(margin(given[0]), 0.0) - SLIGHT
    assert kept[0] is not given[0]


def wall_beside(bare: Cell) -> Obstacles:
    """A wall of the part from 5 mm beside a line along y on, 25 mm high."""
    y, z = np.meshgrid(np.arange(-0.04, 0.0405, 1e-3), np.arange(0.0, 0.0255, 1e-3), indexing="ij")
    points = np.column_stack([np.full(y.size, 5e-3), y.ravel(), z.ravel()]) + [0.0, 0.0, 0.15]
    return _assembled(bare, Around(2e-3, 5e-3, TipRoom(np.full(1, 4e-4), np.zeros(1)), point_tree(points, 1e-4)))


def line_task(tilt: float) -> NozzleTask:
    """A line of 40 mm along y at a height of 150 mm over the table, the nozzle upright."""
    n = 161
    s = np.linspace(0.0, 0.04, n)
    tip = np.column_stack([np.zeros(n), s - 0.02, np.full(n, 0.15)])
    frames = np.tile(np.diag([1.0, -1.0, -1.0]), (n, 1, 1))
    return NozzleTask(0, "line", 0, tip, frames, s, 0, n - 1, 0.04, Cones(tilt))


@pytest.mark.slow
def test_the_nozzle_leans_away_from_a_wall(problem: Problem, bare: Cell) -> None:
    obstacles = wall_beside(bare)
    task = line_task(np.radians(30.0))
    (given,) = ladder(bare, [task], problem.resolve, obstacles)
    (out,) = refine_paths(bare, [given], problem.resolve, obstacles)
    (free,) = refine_paths(bare, [given], problem.resolve)
    before, after = (obstacles.margins(path.q, task.moments, 1.0)[0].min() for path in (given, out))
    assert before < -1e-3
    assert after > -SLIGHT
    # joint 4 is drawn to the end of its range, beyond which it would come to rest behind the bead: there is room for that
    v = np.abs(np.diff(out.q[:2, 3])[0]) / np.diff(task.s)[0] * task.speed
    a, jerk = (each[3] for each in (bare.limits.acceleration, bare.limits.jerk))
    assert out.q[0, 3] + v**2 / (2.0 * a) + v * a / (2.0 * jerk) <= bare.limits.q_max[3]
    axis = bare.T_part_nozzle(out.q)[:, :3, 2]  # into the part: the nozzle itself is the other way
    assert (-axis[20:-20, 0] < -np.sin(np.radians(5.0))).all()
    unaware = bare.T_part_nozzle(free.q)[:, :3, 2]
    assert (-unaware[20:-20, 0] > -np.sin(np.radians(5.0))).any()  # it is the wall that asks for it
    with pytest.raises(Refusal, match="collision of nozzle with part or print"):
        ladder(bare, [line_task(0.0)], problem.resolve, obstacles)


@pytest.mark.slow
@pytest.mark.parametrize("free", ["[rotation]", "[tilt, rotation]"])
def test_what_is_in_the_way_of_every_posture_is_named(free: str) -> None:
    """A nozzle on the normal touches the wall wherever the table is: that is no matter of branches."""
    given = load_problem(
        "cylinder_logo", ["layers.count=1", "cell.positioner.held_deg={}", f"cell.positioner.free={free}"]
    )
    cell = with_bodies(build_cell(given))
    with pytest.raises(Blocked, match="collision of nozzle with part or print: every posture tried here") as caught:
        ladder(cell, [line_task(0.0)], given.resolve, wall_beside(cell))
    assert any(hint.startswith("process.cones.nozzle_normal_deg: ") for hint in caught.value.hints)


@pytest.mark.slow
def test_the_distance_that_would_do_is_named() -> None:
    """A wall 5 mm beside a line: the nozzle is free of it, but not by 2 mm."""
    given = load_problem("cylinder_logo", ["layers.count=1"])
    cell = with_bodies(build_cell(given))
    obstacles = wall_beside(cell)
    with pytest.raises(Blocked) as caught:
        ladder(cell, [line_task(0.0)], given.resolve, obstacles)
    (hint,) = (hint for hint in caught.value.hints if hint.startswith("collision.nozzle_mm: "))
    named = float(hint.split()[1]) * 1e-3
    assert 0.0 <= named < 2e-3
    nearer = obstacles.with_nozzle_at(cell, named)
    assert nearer is not None
    (path,) = ladder(cell, [line_task(0.0)], given.resolve, nearer)
    assert nearer.margins(path.q, path.task.moments, 1.0)[0].min() > -SLIGHT
    assert obstacles.margins(path.q, path.task.moments, 1.0)[0].min() < 0.0
    assert obstacles.with_nozzle_at(cell, 2e-3) is None


# --- travel -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def timed(problem: Problem, bare: Cell, tasks: tuple[NozzleTask, ...]) -> list[TimedPath]:
    return [time_path(bare, path) for path in ladder(bare, tasks, problem.resolve)]


def along(motion: Cubics) -> np.ndarray:
    return motion.joints(np.linspace(0.0, motion.duration, 150))


def beside_a_wall(problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]) -> tuple[Body, TravelTask]:
    """A travel that turns the arm by 70 degrees, and a post in between."""
    start, end = timed[0].start.q, timed[0].start.q.copy()
    end[0] += 1.2
    both = np.stack([start, end])
    wall = Body("wall", Capsule(0.04, 0.5), at(head_at(bare, both.mean(axis=0))))
    cell = replace(bare, fixtures=(wall,))
    states = [JointState(q, np.zeros_like(q), np.zeros_like(q)) for q in both]
    space = travel_clearance(cell, toolpath.surface.before(0), 0.0, problem.process.lift, *states)
    ends = Ends(states[0], states[1], 0.0, bounds_of(cell))
    return wall, TravelTask(cell, ends, space, 0.2, obstacles_of(problem, cell, toolpath), 0.0, -1e-4)


@pytest.mark.slow
def test_travel_goes_round_a_post(problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]) -> None:
    wall, task = beside_a_wall(problem, bare, toolpath, timed)
    unaware, aware = quickest(replace(task, obstacles=NOTHING)), quickest(task)
    assert unaware is not None
    assert aware is not None
    assert least(task.cell, wall, along(unaware)) < 0.0
    assert least(task.cell, wall, along(aware)) > problem.collision.nozzle - SLIGHT
    q = aware.joints(np.linspace(0.0, aware.duration, 3000))
    assert task.obstacles.margins(q, np.zeros(3000), 1.0)[0].min() > -SLIGHT
    assert np.allclose(aware.end.q, unaware.end.q)


def test_a_travel_keeps_all_of_its_clearance(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]
) -> None:
    """A ball beside the quickest way from home lacks half of what was once passed over."""

    def way_beside(radius: float) -> tuple[Cubics, float]:
        ball = Body("ball", Capsule(radius, 0.0), at(middle + ASIDE))
        cell = replace(bare, fixtures=(ball,))
        obstacles = obstacles_of(problem, cell, toolpath)
        (motion,) = plan_travels(cell, timed, toolpath, problem.process, [0], obstacles)
        assert isinstance(motion, Cubics)
        q = motion.joints(np.linspace(0.2, 0.8, 10_000) * motion.duration)  # the part is near at its end
        return motion, float(obstacles.margins(q, np.zeros(len(q)), 1.0)[0].min())

    (free,) = plan_travels(bare, timed, toolpath, problem.process, [0])
    assert isinstance(free, Cubics)
    middle = head_at(bare, free.joints(np.array([0.5 * free.duration]))[0])
    point = Body("ball", Capsule(1e-3, 0.0), at(middle + ASIDE))
    distance = least(replace(bare, fixtures=(point,)), point, along(free))
    radius = 1e-3 + distance - max(problem.collision.nozzle, problem.collision.arm) - 1e-3
    beside, room = way_beside(radius)
    assert np.array_equal(beside.coefficients, free.coefficients)
    assert 0.0 < room < 7e-3
    away, left = way_beside(radius + room + 5e-5)
    assert left >= 0.0
    assert away.duration >= free.duration


def test_margins_by_the_tip_may_change_by_a_quarter_more_than_what_moves(
    bare: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A distance and what is asked for, which grows with that from the tip."""
    found: list[np.ndarray] = []
    monkeypatch.setattr(scene, "hit_along", lambda table, q, gone, *_: found.append(gone) or -1)
    whole, q = wall_beside(bare), bare.home + np.linspace(0.0, 0.1, 5)[:, None]
    for obstacles in (whole, whole.but_head_on_part):
        assert obstacles.hit(q, 0.0, 0.0) == -1
    by_the_tip, beyond = found
    assert beyond[-1] == pytest.approx(0.1 * whole.swing.sum())
    assert by_the_tip == pytest.approx(1.25 * beyond)


def test_a_refusal_of_travel_names_the_bodies(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]
) -> None:
    _, task = beside_a_wall(problem, bare, toolpath, timed)
    assert re.match(r"collision of .* with wall on the way to or from this bead", no_way(task, quickest))


def test_a_bead_that_ends_in_something_is_told_so(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rather than that there is no way from there, where there is none."""
    _, task = beside_a_wall(problem, bare, toolpath, timed)
    wall = Body("wall", Capsule(0.04, 0.5), at(head_at(bare, timed[-1].end.q)))
    cell = replace(bare, fixtures=(wall,))
    obstacles = obstacles_of(problem, cell, toolpath)
    monkeypatch.setattr(plan, "quickest", lambda task: None)
    with pytest.raises(
        Refusal, match=r"and wall lack \d+\.\d mm of clearance where this bead ends, and no way"
    ) as refused:
        plan_travels(cell, timed, toolpath, problem.process, [len(timed)], obstacles)
    assert refused.value.bead == timed[-1].path.task.bead
    at_wall = replace(task, cell=cell, obstacles=obstacles, ends=replace(task.ends, end=timed[-1].end))
    assert too_near(at_wall).endswith("where this bead begins, and no way from there is clear")


def test_a_start_posture_in_something_is_refused_by_its_name(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]
) -> None:
    away = bare.home.copy()
    away[0] += 1.5
    wall = Body("wall", Capsule(0.04, 0.5), at(head_at(bare, away)))
    cell = replace(bare, fixtures=(wall,), home=away)
    obstacles = obstacles_of(problem, cell, toolpath)
    with pytest.raises(Refusal, match=r"and wall lack \d+\.\d mm of clearance at home$") as refused:
        plan_travels(cell, timed, toolpath, problem.process, [0], obstacles)
    assert refused.value.hints == ("choose a cell.home_deg that is clear of part and print",)


def test_ways_round_are_tried_until_one_is_clear(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each shortened, then with more room, then as it was found, then from higher up: what was looked at coarsely may graze."""
    _, task = beside_a_wall(problem, bare, toolpath, timed)
    whole = [task.ends.start.q + share * (task.ends.end.q - task.ends.start.q) for share in (0.3, 0.5, 0.7)]
    monkeypatch.setattr(ClearSpace, "clear", lambda *_: True)
    monkeypatch.setattr(detours, "_connect", lambda *_: whole)
    monkeypatch.setattr(detours, "shorter", lambda space, way: way[::2])
    found = list(around(task.space, task.ends))
    assert [len(way) for way in found] == 3 * [2, 2, 3]
    looks = iter([False, False, True])
    monkeypatch.setattr(plan, "_ways", lambda *_: iter(()))
    monkeypatch.setattr(plan, "_look", lambda *_: (next(looks), 0.0))
    monkeypatch.setattr(plan, "cut_short", lambda task, vias, motion: motion)
    motion = quickest(task)
    assert motion is not None
    assert np.abs(motion.joints(motion.times) - whole[1]).max(axis=1).min() < 1e-9


def test_detours_are_cut_short_where_that_is_clear(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]
) -> None:
    wall, task = beside_a_wall(problem, bare, toolpath, timed)
    space = task.space
    (vias,) = itertools.islice(around(space, task.ends), 1)
    rng = np.random.default_rng(4)
    apart = [np.linspace(a, b, 3)[:-1] for a, b in itertools.pairwise(vias)]
    crooked = [q + rng.normal(scale=0.03, size=q.shape) for q in np.vstack(apart)[1:]]
    crooked = [vias[0], *crooked, vias[-1]]
    short = shorter(space, crooked)
    assert np.array_equal(short[0], vias[0]) and np.array_equal(short[-1], vias[-1])
    before, after = (space.seconds(np.array(way)).sum() for way in (crooked, short))
    assert after < 0.7 * before
    way = np.concatenate([np.linspace(a, b, 60) for a, b in itertools.pairwise(short)])
    assert least(task.cell, wall, way[::4]) > problem.collision.nozzle - 5e-3
    assert all(np.array_equal(a, b) for a, b in zip(short, shorter(space, crooked), strict=True))


def test_a_way_by_rests_is_cut_short_and_kept_where_it_cannot_be(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, task = beside_a_wall(problem, bare, toolpath, timed)
    (vias,) = itertools.islice(around(task.space, task.ends), 1)
    aside = vias[0].copy()
    aside[0] -= 0.5
    far = [vias[0], aside, *vias]
    resting = ways.resting_at(task.cell, task.ends, far, task.speed, plan.free_caps(task.cell))
    assert resting is not None
    short = plan.cut_short(task, far, resting.motion)
    assert short.duration < resting.motion.duration - 0.5
    assert plan.within_limits(task.cell, short) and task.hit(short) < 0
    monkeypatch.setattr(plan, "_look", lambda *_: (False, 0.0))
    assert plan.cut_short(task, far, resting.motion) is resting.motion


def test_a_search_finds_a_way_round_a_wall(
    problem: Problem, bare: Cell, toolpath: Toolpath, timed: list[TimedPath]
) -> None:
    wall, task = beside_a_wall(problem, bare, toolpath, timed)
    cell, ends = task.cell, task.ends
    start, end = ends.start.q, ends.end.q
    vias, again = (next(around(task.space, ends)) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(vias, again, strict=True))
    assert len(vias) > 2
    way = np.concatenate(
        [a + np.linspace(0.0, 1.0, 60)[:, None] * (b - a) for a, b in zip(vias, vias[1:], strict=False)]
    )
    assert least(cell, wall, way[::4]) > problem.collision.nozzle - 5e-3
    direct = start + np.linspace(0.0, 1.0, 60)[:, None] * (end - start)
    assert least(cell, wall, direct[::4]) < 0.0
