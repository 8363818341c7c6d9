"""Where a part stands: the rating of a place, the search for the best one, and the command."""

from __future__ import annotations

import csv
import errno
import itertools
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import Normalize
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from solved import BED, small_problem, write_small
from test_nozzles import TWO, two_nozzles

from planner.base.arrays import Array
from planner.base.distribution import crew
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, OutputError
from planner.base.shipped import PROBLEMS
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING, obstacles_of
from planner.place.command import PICTURE, TABLE, _field, best_of, main
from planner.place.rating import (
    COMFORT,
    Course,
    best_worst,
    bottleneck,
    course_of,
    rate,
    score,
    score_of_paths,
    way_back,
)
from planner.place.search import Axis, ScoredPoint, lattice, one_by_one, polish, well_apart
from planner.place.site import (
    PartPlace,
    StudyRequest,
    _at_the_foot,
    axes_of,
    changed_fields,
    moved_cell,
    own_site,
    place_of,
    reach,
    site_of,
    surroundings,
)
from planner.place.study import LAID_LIMITS, PlaceOutcome, Slice, crew_of
from planner.planning.pipeline import try_out
from planner.problem import Problem, load_problem
from planner.problem.rewrite import changed_text, write_changed
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of
from planner.verify.verdict import Report

STEP = np.radians(30.0)


@pytest.fixture(scope="module")
def bed(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return load_problem(write_small(tmp_path_factory.mktemp("bed"), *BED))


@pytest.fixture(scope="module")
def bed_tasks(bed: Problem) -> tuple[NozzleTask, ...]:
    return tasks_of(bed, build_toolpath(bed))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    return load_problem(write_small(tmp_path_factory.mktemp("table")))


def course(problem: Problem, tasks: tuple[NozzleTask, ...], rungs: int = 40) -> Course:
    return course_of(tasks, rungs, STEP, problem.resolve.rung)


# --- the best worst case ---------------------------------------------------------------------------------------------


def every_way(margin: Array, q: Array, holder_step: float, time: Array, v: Array) -> float:
    """The best worst case of one task by trying all ways."""
    r, A, B, C = margin.shape
    best = 0.0
    for c in range(C):
        for way in itertools.product(itertools.product(range(A), range(B)), repeat=r):
            least = min(margin[k, a, b, c] for k, (a, b) in enumerate(way))
            if least <= best:
                continue
            possible = True
            for k in range(1, r):
                (a0, b0), (a1, b1) = way[k - 1], way[k]
                da, db = (a1 - a0 + 1) % A - 1, (b1 - b0 + 1) % B - 1
                possible &= da in (-1, 0, 1) and db in (-1, 0, 1) and abs(db) * holder_step <= v[-1] * time[k]
                possible &= bool((np.abs(q[k, a1, b1, c] - q[k - 1, a0, b0, c]) <= v[:-1] * time[k]).all())
            if possible:
                best = least
    return float(best)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_best_worst_case_is_that_of_all_ways(seed: int) -> None:
    drawn = np.random.default_rng(seed)
    r, A, B, C = 4, 4, int(drawn.choice([1, 3])), 2
    margin = drawn.uniform(0.0, 1.0, (r, A, B, C)).astype(np.float32)
    margin[drawn.uniform(size=margin.shape) < 0.3] = 0.0
    q = drawn.uniform(-1.0, 1.0, (r, A, B, C, 2)).astype(np.float32)
    time, v = drawn.uniform(0.5, 1.5, r), np.array([1.2, 1.0, 0.9])
    came = np.zeros(margin.shape, dtype=np.int8)
    worst, ends = bottleneck(q, margin, 0.5, np.array([0, r]), time, v, np.zeros(2, dtype=bool), 0.0, came)
    assert worst[0] == np.float32(every_way(margin, q, 0.5, time, v))
    if worst[0] > 0.0:
        way = way_back(ends, came, np.array([0, r]))
        assert min(margin[k, a, b, c] for k, (a, b, c) in enumerate(way)) == worst[0]
        assert len({c for _, _, c in way}) == 1


def test_there_are_ways_and_none_in_those_cases() -> None:
    """What the brute force above compares is neither always 0 nor always reachable."""
    found = []
    for seed in range(12):
        drawn = np.random.default_rng(seed)
        r, A, B, C = 4, 4, int(drawn.choice([1, 3])), 2
        margin = drawn.uniform(0.0, 1.0, (r, A, B, C)).astype(np.float32)
        margin[drawn.uniform(size=margin.shape) < 0.3] = 0.0
        q = drawn.uniform(-1.0, 1.0, (r, A, B, C, 2)).astype(np.float32)
        found.append(every_way(margin, q, 0.5, drawn.uniform(0.5, 1.5, r), np.array([1.2, 1.0, 0.9])))
    assert len(set(found)) > 4


def test_a_joint_that_turns_all_round_goes_the_short_way() -> None:
    margin = np.ones((2, 1, 1, 1), dtype=np.float32)
    q = np.array([-3.1, 3.1], dtype=np.float32).reshape(2, 1, 1, 1, 1)
    args = (1.0, np.array([0, 2]), np.array([0.0, 0.1]), np.array([1.0, 1.0]))
    for wraps, expected in ((True, 1.0), (False, 0.0)):
        worst, _ = bottleneck(q, margin, *args, np.array([wraps]), 0.0, np.zeros(margin.shape, dtype=np.int8))
        assert worst[0] == expected


# --- the score of a place --------------------------------------------------------------------------------------------


def turned_round(task: NozzleTask) -> NozzleTask:
    """The same bead laid from its other end."""
    n = len(task) - 1
    return replace(
        task,
        tip=task.tip[::-1].copy(),
        frames=task.frames[::-1].copy(),
        s=task.s[-1] - task.s[::-1],
        first=n - task.last,
        last=n - task.first,
    )


@pytest.mark.slow
def test_score_does_not_depend_on_direction_or_order(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    cell = build_cell(bed)
    forwards = score(cell, course(bed, bed_tasks), 0.05)
    back = tuple(turned_round(task) for task in bed_tasks[::-1])
    assert forwards > 0.1
    assert score(cell, course(bed, back), 0.05) == pytest.approx(forwards, rel=0.05)


@pytest.mark.slow
def test_score_is_what_its_way_has(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    cell, looked_at = build_cell(bed), course(bed, bed_tasks)
    rating = rate(cell, looked_at, 0.05)
    assert rating.score == pytest.approx(score(cell, looked_at, 0.05))
    least = (np.array([rating.sigma, rating.limit, rating.wrist]) / COMFORT).min()
    assert least * rating.share - 1e-6 <= rating.score <= least + 1e-6
    assert np.abs(looked_at.demand.tip - rating.place).sum(axis=1).min() == 0.0


@pytest.mark.slow
def test_floor_changes_nothing_above_it(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    cell, looked_at = build_cell(bed), course(bed, bed_tasks)
    whole = score(cell, looked_at, 0.05)
    assert score(cell, looked_at, 0.05, 0.9 * whole) == pytest.approx(whole)
    assert score(cell, looked_at, 0.05, 1.01 * whole) == 0.0


@pytest.mark.slow
def test_terms_are_those_of_the_arm(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    """Sigma against singular values by numpy, on the paths of a strategy: the grid's best is no worse by much."""
    cell = build_cell(bed)
    paths = STRATEGIES["ladder"](cell, bed_tasks, bed.resolve)
    whole = score_of_paths(cell, paths)
    sigma, limit, wrist = np.inf, np.inf, np.inf
    for path in paths:
        q = path.q[path.task.first : path.task.last + 1]
        sigma = min(sigma, *(float(np.linalg.svd(cell.arm.jacobians(row[None])[0])[1][-1]) for row in q[:, :6]))
        limit = min(limit, float(np.minimum(q - cell.limits.q_min, cell.limits.q_max - q).min()))
        wrist = min(wrist, float(np.abs(q[:, 4]).min()))
    least = (np.array([sigma, limit, wrist]) / COMFORT).min()
    assert 0.3 * least < whole <= least
    assert score(cell, course(bed, bed_tasks, 200), 0.05) > 0.95 * whole


def test_out_of_reach_scores_nothing(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    cell, now = build_cell(bed), place_of(bed)
    away = moved_cell(cell, now, replace(now, x=now.x - 2.0 * reach(cell)))
    assert score(away, course(bed, bed_tasks), 0.05) == 0.0
    assert rate(away, course(bed, bed_tasks), 0.05).score == 0.0


def test_the_foot_is_around_axis_1_wherever_that_points(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    """On a wall it is level: what lies below it is no foot, what lies before the wall on it is."""
    on_wall = load_problem(bed.file, ["cell.base_mm=[0, 0, 900]", "cell.base_rpy_deg=[0, 90, 0]"])
    cell, now, looked_at = build_cell(on_wall), place_of(on_wall), [course(on_wall, bed_tasks)]
    for at, near in (((0.2, 0.0, 0.2), False), ((0.6, 0.0, 0.9), True), ((0.6, 0.6, 0.9), False)):
        place = PartPlace(*at, now.turn)
        assert _at_the_foot(moved_cell(cell, now, place), looked_at) == near, at
    standing, here = build_cell(bed), place_of(bed)
    assert _at_the_foot(moved_cell(standing, here, replace(here, x=0.1, y=0.0)), looked_at)


# --- arms that are carried, and several nozzles ---------------------------------------------------------------------

PANEL = (PROBLEMS / "rail_panel.yaml").read_text(encoding="utf-8").replace("rail_panel.txt", "line.txt")


def on_track(folder: Path, half_mm: float, *overrides: str) -> Problem:
    """The panel's cell, an arm on a track of 3 m, with a line along the track."""
    x = np.linspace(-half_mm, half_mm, 201)
    (folder / "line.txt").write_text("".join(f"{at:.3f} 0 50 0 0 1\n" for at in x), encoding="utf-8")
    (folder / "track.yaml").write_text(PANEL, encoding="utf-8")
    return load_problem(folder / "track.yaml", overrides)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "follows"), [(0.4, True), (0.2, False)])
def test_a_track_follows_as_fast_as_it_is(tmp_path: Path, speed: float, follows: bool) -> None:
    """A step of the grid is 0.25 m of a line of 2.4 m, for which there is 0.96 s from rung to rung: 0.29 m/s."""
    problem = on_track(tmp_path, 1200.0, "process.speed_mm_s=150", "resolve.rung_mm=20")
    cell, tasks = build_cell(problem), tasks_of(problem, build_toolpath(problem))
    velocity = cell.limits.velocity.copy()
    velocity[0] = speed
    at_speed = replace(cell, limits=replace(cell.limits, velocity=velocity))
    assert (score(at_speed, course(problem, tasks), 0.05) > 0.0) == follows


def test_the_wrist_of_an_arm_on_a_track_flips_as_any_other(tmp_path: Path) -> None:
    problem = on_track(tmp_path, 100.0)
    cell, tasks = build_cell(problem), tasks_of(problem, build_toolpath(problem))
    rating = rate(cell, course(problem, tasks), 0.05)
    assert 0.0 < rating.score * COMFORT[2] - 1e-6 <= rating.wrist < np.pi


def test_metres_to_a_tracks_end_are_no_angle(tmp_path: Path) -> None:
    problem = on_track(tmp_path, 100.0)
    cell, tasks = build_cell(problem), tasks_of(problem, build_toolpath(problem))
    paths = STRATEGIES["fixed"](cell, tasks, problem.resolve, NOTHING)
    low, high = cell.limits.q_min.copy(), cell.limits.q_max.copy()
    low[0], high[0] = paths[0].q[0, 0] - 1e-3, paths[0].q[0, 0] + 1e-3
    assert score_of_paths(cell, paths) > 0.1
    at_its_end = replace(cell, limits=replace(cell.limits, q_min=low, q_max=high))
    assert score_of_paths(at_its_end, paths) == score_of_paths(cell, paths)


def test_a_carried_arm_drives_away_from_where_its_foot_is_at_zero(tmp_path: Path) -> None:
    problem = on_track(tmp_path, 100.0)
    cell = build_cell(problem)
    site = site_of(StudyRequest(str(problem.file)), problem, cell, axes_of(problem, cell, place_of(problem), None, []))
    here = replace(site.now, x=0.0, y=0.4)
    assert np.hypot(here.x, here.y) < 0.25 * reach(cell)
    assert site.scored(site.coarse, here, 0.0) > 0.0


def test_each_nozzle_has_its_own_beads_to_reach(tmp_path: Path) -> None:
    problem = load_problem(write_small(tmp_path, *TWO))
    cell = build_cell(problem)
    site = site_of(StudyRequest(str(problem.file)), problem, cell, axes_of(problem, cell, place_of(problem), None, []))
    guides = tuple(
        replace(task, material=material) for task, material in zip(site.guides, ("pla", "pva", "pla"), strict=True)
    )
    site = replace(site, guides=guides, around=surroundings("greedy", problem, cell, site.toolpath))
    first, second = site.coarse
    assert (first.nozzle, second.nozzle) == (0, 1)
    each = score(cell, first, 0.05), score(cell, second, 0.05)
    assert each[1] == score(cell.with_nozzle(1), replace(second, nozzle=1), 0.05)
    assert each[1] != score(cell, replace(second, nozzle=0), 0.05)
    assert site.scored(site.coarse, site.now, 0.0) == min(each)
    assert site.rated(cell).score <= rate(cell, site.fine[1], 0.05).score


def test_paths_are_scored_by_the_nozzle_that_lays_them() -> None:
    plan = two_nozzles()
    mine = [path for path in plan.paths if path.task.material == "pva"]
    assert mine
    own = plan.cell.with_nozzle(1)
    assert score_of_paths(plan.cell, mine) == score_of_paths(replace(own, nozzles=()), mine)
    assert score_of_paths(plan.cell, mine) != score_of_paths(replace(plan.cell, nozzles=()), mine)


BLOCK = (
    "bed_mm: [-450, 450, 300]",
    "bed_mm: [-450, 450, 300]\n  fixtures: {block: {box_mm: [300, 300, 900], centre_mm: %s}}",
)


@pytest.mark.parametrize("centre, stands_in_it", [("[-330, 470, 300]", True), ("[-330, -430, 300]", False)])
def test_postures_that_touch_do_not_count(
    tmp_path: Path, bed_tasks: tuple[NozzleTask, ...], centre: str, stands_in_it: bool
) -> None:
    """A block around the part leaves no place there; at the part's mirror image it does not matter, until that is
    where the part stands."""
    problem = load_problem(write_small(tmp_path, *BED, (BLOCK[0], BLOCK[1] % centre)))
    cell, now = build_cell(problem), place_of(problem)
    obstacles = surroundings("ladder", problem, cell, build_toolpath(problem)).nearly
    looked_at = course(problem, bed_tasks)
    there = replace(now, y=-now.y)
    for place, blocked in ((now, stands_in_it), (there, not stands_in_it)):
        moved = moved_cell(cell, now, place)
        free = score(moved, looked_at, 0.05)
        clear = score(moved, looked_at, 0.05, 0.0, obstacles)
        assert free > 0.1
        assert clear == 0.0 if blocked else 0.5 * free < clear <= free
        assert rate(moved, looked_at, 0.05, obstacles).score == pytest.approx(clear)


def test_clearance_is_looked_for_where_margins_are_large_first(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    """What comes out of that is what looking everywhere gives."""
    fixtures = "cell.fixtures={post: {box_mm: [30, 30, 600], centre_mm: [-300, 420, 400]}}"
    problem = load_problem(bed.file, [fixtures])
    cell, now = build_cell(problem), place_of(problem)
    obstacles = obstacles_of(problem, cell, build_toolpath(problem))
    looked_at = course(problem, bed_tasks)
    differ = 0
    for x in np.linspace(-0.1, 0.1, 5):
        moved = moved_cell(cell, now, replace(now, x=now.x + x))
        whole = best_worst(moved, looked_at, 0.05, 0.0, obstacles.of(moved))[0].min()
        assert score(moved, looked_at, 0.05, 0.0, obstacles) == whole
        differ += whole != score(moved, looked_at, 0.05)
    assert differ > 0


def test_of_many_beads_those_far_apart_are_looked_at(bed: Problem, bed_tasks: tuple[NozzleTask, ...]) -> None:
    many = [replace(bed_tasks[1], name=f"{i}", tip=bed_tasks[1].tip + [0.0, 0.0, 1e-3 * i]) for i in range(40)]
    heights = course_of(many, 16, STEP, bed.resolve.rung).demand
    assert len(heights.task_rungs) - 1 == 4
    lifted = heights.tip[heights.rung[heights.task_rungs[:-1]], 2] - many[0].tip[0, 2]
    assert lifted.min() == 0.0 and lifted.max() == pytest.approx(39e-3)


# --- places and cells ------------------------------------------------------------------------------------------------


CELLS = {
    "bed": (BED, (0.03, -0.05, 0.02, 0.4, 0.0, 0.0)),
    "bed_turned": (
        (*BED, ("bed_mm: [-450, 450, 300]", "bed_mm: [-450, 450, 300]\n  bed_rpy_deg: [10, -8, 25]")),
        (-0.04, 0.05, 0.02, -0.3, 0.0, 0.0),
    ),
    "table": ((), (0.05, 0.02, -0.07, 0.5, 0.01, -0.02)),
    "base": (
        (("origin_mm: [633.5, 9.87, 380]", "base_mm: [600, 10, -500]\n    turn_deg: 15\n    part_mm: [5, 6, 7]"),),
        (0.05, 0.02, -0.07, 0.5, 0.01, -0.02),
    ),
}


@pytest.mark.parametrize("name", CELLS)
def test_a_moved_cell_is_the_cell_of_the_changed_file(tmp_path: Path, name: str) -> None:
    changes, by = CELLS[name]
    problem = load_problem(write_small(tmp_path / "here", *changes))
    cell, now = build_cell(problem), place_of(problem)
    there = PartPlace(*(a + b for a, b in zip(vars(now).values(), by, strict=True)))
    target = tmp_path / "elsewhere" / "moved.yaml"
    write_changed(problem, changed_fields(problem, there), target)
    written = load_problem(target)
    assert np.allclose(list(vars(place_of(written)).values()), list(vars(there).values()), atol=1e-9)
    expected, moved = build_cell(written), moved_cell(cell, now, there)
    for field in ("T_world_holder", "T_world_holder_base", "T_plate_part"):
        np.testing.assert_allclose(getattr(moved, field), getattr(expected, field), atol=1e-9)
    q = np.full((1, len(cell.holder)), 0.7)
    np.testing.assert_allclose(moved.holder.poses(q), expected.holder.poses(q), atol=1e-9)
    assert build_toolpath(written).length == build_toolpath(problem).length  # its drawing is found from there


def test_nothing_changes_where_nothing_moves(table: Problem) -> None:
    assert changed_fields(table, place_of(table)) == {}


# --- the written file ------------------------------------------------------------------------------------------------


def test_only_the_changed_value_changes(tmp_path: Path) -> None:
    path = write_small(tmp_path, ("origin_mm: [633.5, 9.87, 380]", "origin_mm: [633.5,9.87,   380] # of its plate"))
    problem = load_problem(path)
    text = changed_text(problem, {"cell.positioner.origin_mm": [600.0, -1.5, 0.25]}, tmp_path)
    old = path.read_text(encoding="utf-8")
    assert text == old.replace("[633.5,9.87,   380]", "[600, -1.5, 0.25]")


@pytest.mark.parametrize(
    "old, new",
    [
        (
            "    origin_mm: [633.5, 9.87, 380]\n",
            "    origin_mm:  # of its plate\n    - 633.5\n    - 9.87\n    - 380  # up\n",
        ),
        (
            "  positioner:\n    robot: irbp_a250\n    origin_mm: [633.5, 9.87, 380]\n    free: [rotation]\n",
            "  positioner: {robot: irbp_a250, origin_mm: [633.5, 9.87, 380], free: [rotation]}\n",
        ),
    ],
)
def test_other_layouts_are_changed_too(tmp_path: Path, old: str, new: str) -> None:
    problem = load_problem(write_small(tmp_path, (old, new)))
    fields = {"cell.positioner.origin_mm": [600.0, 0.0, 380.0], "cell.positioner.turn_deg": 30.0}
    target = tmp_path / "new.yaml"
    write_changed(problem, fields, target)
    positioner = load_problem(target).cell.positioner
    assert positioner is not None
    assert positioner.origin == pytest.approx((0.6, 0.0, 0.38)) and positioner.turn == pytest.approx(np.radians(30.0))
    assert positioner.free == ("rotation",)
    assert ("# of its plate" in new) == ("[600, 0, 380]  # of its plate" in target.read_text(encoding="utf-8"))


def test_a_file_is_never_overwritten(tmp_path: Path, table: Problem) -> None:
    target = tmp_path / "mine.yaml"
    target.write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match=r"mine\.yaml is there already"):
        write_changed(table, {}, target)
    assert target.read_text(encoding="utf-8") == "mine"


def test_nothing_is_left_of_a_file_for_which_there_is_no_room(
    tmp_path: Path, table: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    really = Path.open

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def opened(path: Path, *given: Any, **named: Any) -> Any:
        stream = really(path, *given, **named)
        if given == ("x",):
            stream.write = full
        return stream

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(OutputError, match=r"cannot write .*mine\.yaml: No space left"):
        write_changed(table, {}, tmp_path / "mine.yaml")
    assert list(tmp_path.glob("*.yaml")) == []


# --- the search ------------------------------------------------------------------------------------------------------

AXES = (Axis("x", -1.0, 1.0, 5, 1e-3), Axis("y", 0.0, 2.0, 5, 1e-3), Axis("turn", -np.pi, np.pi, 6, 1e-2, True))


def ridge(point: tuple[float, ...], floor: float) -> float:
    """A score with a ridge aslant, on which steps along the coordinates get stuck; best at (0.31, 0.77, 3.0)."""
    x, y, turn = point
    away = (turn - 3.0 + np.pi) % (2.0 * np.pi) - np.pi
    value = 2.0 - 3.0 * abs((x - 0.31) - (y - 0.77)) - 0.5 * abs(x - 0.31) - 0.3 * abs(away)
    return value if value > floor else 0.0


def test_search_finds_the_top_of_a_ridge() -> None:
    tried = [ScoredPoint(point, ridge(point, 0.0)) for point in lattice(AXES)]
    assert len(tried) == 150
    starts = well_apart(tried, 3, lambda a, b: abs(a[0] - b[0]) > 0.3)
    trails = [polish(AXES, one_by_one(ridge), start.point) for start in starts]
    best = max((trail[-1] for trail in trails), key=lambda each: each.score)
    assert best.score > 1.93
    assert [t.score for trail in trails for t in trail] != sorted(t.score for trail in trails for t in trail)
    for trail in trails:
        assert all(b.score > a.score for a, b in itertools.pairwise(trail))
    again = [polish(AXES, one_by_one(ridge), start.point) for start in starts]
    assert again == trails


def test_places_apart_are_kept_best_first() -> None:
    tried = [ScoredPoint((x,), s) for x, s in ((0.0, 1.0), (0.1, 2.0), (0.5, 0.5), (0.9, 0.0))]
    found = well_apart(tried, 5, lambda a, b: abs(a[0] - b[0]) > 0.2)
    assert found == [tried[1], tried[2]]


def test_an_axis_that_turns_has_no_ends() -> None:
    axis = AXES[2]
    assert len({round(np.cos(v), 1) + 1j * round(np.sin(v), 1) for v in axis.lattice()}) == 6
    assert axis.put(np.pi + 0.2) == pytest.approx(-np.pi + 0.2, abs=0.01)
    assert AXES[0].put(3.0) == 1.0


# --- options ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "free, ranges, parts",
    [
        (None, ["w=1:2"], ("--range w=1:2", "unknown coordinate 'w'", "choices: x, y, z, turn")),
        ("x,trun", [], ("--free x,trun", "did you mean turn?")),
        (None, ["x=5"], ("not of the form name=low:high",)),
        (None, ["x=5:four"], ("'5:four' is not two numbers",)),
        (None, ["x=5:4"], ("the first number must be less than the second",)),
        (None, ["x=5:5"], ("the first number must be less",)),
        (None, ["x=nan:5"], ("out of range", "mm")),
        (None, ["x=0:1e9"], ("out of range", "-100000 to 100000 mm")),
        (None, ["turn=-200:200"], ("more than a whole turn",)),
        ("y", ["x=1:2"], ("x has a range but is not free", "add x")),
        (None, ["part_x=1:2"], ("part_x is for parts on a table",)),
    ],
)
def test_wrong_options(bed: Problem, free: str | None, ranges: list[str], parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        axes_of(bed, build_cell(bed), place_of(bed), free, ranges)
    for part in parts:
        assert part in str(error.value)


def test_ranges_default_to_the_arms_reach(bed: Problem, table: Problem) -> None:
    cell = build_cell(bed)
    axes = axes_of(bed, cell, place_of(bed), None, [])
    assert [axis.name for axis in axes] == ["x", "y", "z", "turn"]
    assert [axis.turns for axis in axes] == [False, False, False, True]
    assert axes[0].high - axes[0].low == pytest.approx(reach(cell), abs=2e-3)
    q = np.random.default_rng(0).uniform(cell.limits.q_min, cell.limits.q_max, (2000, 6))
    tips = cell.arm.poses(q)[:, :2, 3] - cell.T_world_base[:2, 3]
    furthest = float(np.linalg.norm(tips, axis=1).max())
    assert furthest <= reach(cell) < 1.5 * furthest
    on_table = axes_of(table, build_cell(table), place_of(table), "part_x,turn", ["turn=-20:20"])
    assert [(axis.name, axis.turns) for axis in on_table] == [("turn", False), ("part_x", False)]


# --- the command -----------------------------------------------------------------------------------------------------

SMALL = ("--quiet", "--range", "x=-400:-380", "--range", "y=370:390")


@pytest.mark.slow
def test_command_finds_a_better_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From a bad start: what it writes loads, is verified, and keeps further away from what is to be avoided."""
    bad = ("bed_mm: [-450, 450, 300]", "bed_mm: [-540, 540, 300]")
    problem = write_small(tmp_path, *BED, bad)
    out = tmp_path / "out"
    assert main([str(problem), "--out", str(out), "--best", "1", *SMALL]) == EXIT_VERIFIED
    placed = out / "small_placed.yaml"
    assert str(placed) in capsys.readouterr().out
    scores = []
    for path in (problem, placed):
        loaded = load_problem(path)
        report = try_out(loaded, build_toolpath(loaded), loaded.strategy)
        assert all(check.ok for check in report.checks)
        scores.append(PlaceOutcome.of(place_of(loaded), 0.0, report).score)
    assert scores[1] > 1.1 * scores[0]

    rows = list(csv.DictReader((out / TABLE).read_text(encoding="utf-8").splitlines()))
    assert {row["kind"] for row in rows} == {"present", "best", "resolved", "lattice", "map"}
    assert (out / PICTURE).read_bytes().startswith(b"\x89PNG")
    lattice = [float(row["score"]) for row in rows if row["kind"] == "lattice"]
    assert float(next(row["score"] for row in rows if row["kind"] == "best")) >= 0.9 * max(lattice) > 0.0

    first = (out / TABLE).read_bytes(), (out / PICTURE).read_bytes()
    assert main([str(problem), "--out", str(out), "--best", "1", *SMALL]) == EXIT_INPUT
    assert "is there already" in capsys.readouterr().err
    again = tmp_path / "again"
    assert main([str(problem), "--out", str(again), "--best", "0", *SMALL]) == EXIT_VERIFIED
    assert first == tuple((again / name).read_bytes() for name in (TABLE, PICTURE))


def test_layers_above_the_first_make_another_site() -> None:
    digests = set()
    for problem in (small_problem(), small_problem().changed(["layers.count=2"])):
        cell = build_cell(problem)
        axes = axes_of(problem, cell, place_of(problem), None, [])
        digests.add(site_of(StudyRequest(str(problem.file)), problem, cell, axes).digest)
    assert len(digests) == 2


@pytest.mark.slow
def test_pieces_done_elsewhere_are_the_pieces_done_here(tmp_path: Path) -> None:
    """Another process has but the words of the command; it reads the files itself, and says so if they differ."""
    file = write_small(tmp_path, *BED)
    asked = StudyRequest(str(file), ranges=("x=-400:-380", "y=370:390"))
    problem = load_problem(file)
    cell, now = build_cell(problem), place_of(problem)
    site = site_of(asked, problem, cell, axes_of(problem, cell, now, None, asked.ranges))
    ticks: list[int] = []
    with crew() as over:
        here, there = (crew_of(asked, site, over, beside) for beside in (False, True))
        for kind, pieces in {"score": [(now, site.at((-0.4, 0.38)))], "follow": [(-0.4, 0.38), (-9.0, 9.0)]}.items():
            found = here(kind, pieces, lambda: None)
            assert found == there(kind, pieces, lambda: ticks.append(1)) and found[0]
        assert len(ticks) == 4
        write_small(tmp_path, *BED, ("speed_mm_s: 40", "speed_mm_s: 30"), ("radius_mm: 34", "radius_mm: 33"))
        own_site.cache_clear()
        with pytest.raises(InputError, match=r"small\.yaml.* differs on a worker"):
            there("score", [(now,)], lambda: None)


@pytest.mark.slow
def test_command_draws_the_map_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = write_small(tmp_path)
    options = ["--out", str(tmp_path / "out"), "--best", "0", "--quiet", "--range", "z=370:390"]
    assert main([str(problem), *options]) == EXIT_VERIFIED
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["manifest.json", TABLE, PICTURE]
    assert "as it stands" in capsys.readouterr().out


@pytest.mark.parametrize(("least", "lines"), [(1.2, 0), (0.8, 1)])
def test_the_line_of_comfort_is_drawn_where_there_is_one(least: float, lines: int) -> None:
    panel = Figure().subplots()
    scores = np.array([[least, 1.5], [1.5, 1.6]])
    u = np.array([0.0, 0.1])
    _field(panel, Slice("all", PartPlace(0.0, 0.0, 0.0, 0.0), u, u, scores), ("x", "y"), Normalize(0.0, 2.0))
    assert sum(isinstance(each, ContourSet) for each in panel.get_children()) == lines


def test_command_says_that_nothing_is_in_reach(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = write_small(tmp_path, *BED)
    options = ["--out", str(tmp_path / "out"), "--quiet", "--range", "x=5000:6000"]
    assert main([str(problem), *options]) == EXIT_NOT_VERIFIED
    said = capsys.readouterr().err
    assert "none of 9 places in the range reaches the whole part" in said
    assert "try: a range nearer to the arm" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", [["--best", "many"], ["--best", "11"], ["--strategy", "none"]])
def test_command_refuses_options(tmp_path: Path, option: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([str(write_small(tmp_path)), *option])
    assert stop.value.code == EXIT_INPUT


def test_the_best_is_verified_and_better_than_it_was() -> None:
    metrics = {"sigma_min": 0.2, LAID_LIMITS: 30.0, "wrist_margin_deg": 40.0}
    metrics |= {"ideal_deposition_time_s": 9.0, "deposition_time_s": 10.0}
    place = PartPlace(0.0, 0.0, 0.0, 0.0)
    good = PlaceOutcome(place, 1.0, metrics, None)
    better = replace(good, metrics=metrics | {"sigma_min": 0.21})
    assert good.score == pytest.approx(0.9)
    assert replace(good, metrics=metrics | {"wrist_margin_deg": 5.0}).score == pytest.approx(0.45, rel=0.01)
    assert best_of([good, replace(better, failure="not verified: jerk")]) is None
    assert best_of([replace(good, failure="no plan"), good, better]) == better


def test_home_near_the_end_of_a_range_is_no_matter_of_the_place() -> None:
    """Joint limits count while material is laid, as all else of the score."""
    metrics = {"sigma_min": 0.4, "joint_limit_margin_deg": 2.0}
    metrics |= {"ideal_deposition_time_s": 10.0, "deposition_time_s": 10.0}
    series = {"sigma": np.array([np.nan, 0.5, 0.4, np.nan]), "limit_margin_deg": np.array([2.0, 9.0, 15.0, 4.0])}
    outcome = PlaceOutcome.of(PartPlace(0.0, 0.0, 0.0, 0.0), 1.0, Report((), metrics, series, ()))
    assert outcome.failure is None
    assert outcome.metrics["joint_limit_margin_deg"] == 2.0 and outcome.metrics[LAID_LIMITS] == 9.0
    assert outcome.score == pytest.approx(np.radians(9.0) / COMFORT[1])


@pytest.mark.slow
def test_present_place_may_be_unreachable(bed: Problem, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    away = ("bed_mm: [-450, 450, 300]", "bed_mm: [-900, 900, 300]")
    problem = write_small(tmp_path, *BED, away)
    assert main([str(problem), "--out", str(tmp_path / "out"), "--best", "1", *SMALL]) == EXIT_VERIFIED
    assert "as it stands: no plan" in capsys.readouterr().out
    assert isinstance(build_cell(load_problem(tmp_path / "out" / "small_placed.yaml")), Cell)


def test_a_file_that_is_changed_meanwhile_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def changed(*_: object) -> list[PlaceOutcome]:
        write_small(tmp_path, *BED, ("  speed_mm_s: 40", "  speed_mm_s: 30"))
        return []

    for name in ("write_table", "draw_map"):
        monkeypatch.setattr(f"planner.place.command.{name}", lambda *_: None)
    monkeypatch.setattr("planner.place.command.study", lambda *_: SimpleNamespace(best=()))
    monkeypatch.setattr("planner.place.command.outcomes", changed)
    assert main([str(write_small(tmp_path, *BED)), "--out", str(tmp_path / "out"), *SMALL]) == EXIT_INPUT
    assert "small.yaml: was changed in the meantime" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    assert main([str(write_small(tmp_path)), "--quiet", "--out", str(tmp_path / "file")]) == EXIT_INPUT
    assert "cannot write into" in capsys.readouterr().err
