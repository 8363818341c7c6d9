"""Head-room under uncertainty: the part really stands elsewhere, bounds are slopes, and what does not hold is told."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solved import small_problem, write_small

from planner.base.arrays import Array
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, Refusal
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING
from planner.motion.travel.plan import Travel
from planner.plan import Check, Trajectory
from planner.plan.robustness import Displacement, Robustness, Tolerance, TriedDisplacement, parse_tolerance
from planner.planning.pipeline import _elsewhere, solve, trajectory_of
from planner.planning.robustness import (
    AS_PLANNED,
    _try,
    assess_robustness,
    beneath,
    displaced,
    displacement_slopes,
    displacements,
    first_order,
    followed,
    middle_of,
)
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.report.robustness import robustness_section
from planner.resolve.joint_path import JointPath
from planner.resolve.strategies import STRATEGIES
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of
from planner.verify.executed import executed_motion
from planner.verify.verdict import Report, verify

DT = 0.004
AROUND = Tolerance(2e-3, math.radians(1.0))
CELLS = {
    # an axis that turns under the part, which does not stand on it straight
    "table": "  arm: irb1200_07\n  nozzle: {tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}\n"
    "  home_deg: [0, 0, 0, 0, 45, 0]\n"
    "  positioner: {robot: irbp_a250, origin_mm: [550, 0, 300], part_mm: [10, 5, 20], part_rpy_deg: [8, -5, 20], "
    "free: [rotation]}\n",
    "seven_axes": "  arm: panda\n  nozzle: {tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}\n"
    "  home_deg: [0, -30, 0, -120, 0, 100, 45]\n  bed_mm: [450, 0, 200]\n",
}
WAVE = """\
name: wave
cell:
{cell}layers:
  source: {{waypoints: wave.txt}}
process:
  speed_mm_s: 20
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
  cones: {{nozzle_normal_deg: 4}}
resolve: {{roll_step_deg: 30, table_step_deg: 30, rung_mm: 5}}
strategy: {strategy}
"""


@dataclass(frozen=True)
class Case:
    """A problem and its joint paths, before they are timed."""

    problem: Problem
    cell: Cell
    toolpath: Toolpath
    paths: tuple[JointPath, ...]

    @cached_property
    def planned(self) -> tuple[Trajectory, Sequence[Travel]]:
        """The trajectory as planned, and its travels."""
        return trajectory_of(self.problem, self.cell, self.toolpath, self.paths, NOTHING, DT, False)

    def again(self, cell: Cell, paths: Sequence[JointPath]) -> Report:
        """Time paths, carry the travel along, join and verify."""
        trajectory = _elsewhere(self.problem, cell, self.toolpath, paths, self.planned[1], DT)
        return verify(self.problem, cell, self.toolpath, trajectory)

    def judged(self, tolerance: Tolerance) -> Robustness:
        """The head-room of the paths."""
        planned = verify(self.problem, self.cell, self.toolpath, self.planned[0])
        return assess_robustness(tolerance, self.problem, self.cell, self.toolpath, self.paths, planned, self.again)


def case_of(problem: Problem) -> Case:
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    tasks = tasks_of(problem, toolpath)
    return Case(problem, cell, toolpath, STRATEGIES[problem.strategy](cell, tasks, problem.resolve, NOTHING))


@cache
def small() -> Case:
    """Three curves on a turning cylinder."""
    return case_of(small_problem())


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    """A wave on a plane by arms and holders of several kinds, the nozzle tilted."""
    folder = tmp_path_factory.mktemp("waves")
    t = np.linspace(0.0, 1.0, 61)
    points = np.column_stack([40 * t - 20, 6 * np.sin(2 * np.pi * t)])
    (folder / "wave.txt").write_text("".join(f"{x:.4f} {y:.4f} 0 0 0 1\n" for x, y in points))
    out = {}
    for name, cell in CELLS.items():
        (folder / f"{name}.yaml").write_text(WAVE.format(cell=cell, strategy="sqp"))
        out[name] = case_of(load_problem(folder / f"{name}.yaml"))
    return out


def least_sigma(cell: Cell, q: Array) -> Array:
    """Smallest singular values of the arm's Jacobian along postures, here by numpy from the whole matrix."""
    return np.linalg.svd(cell.arm.jacobians(q[:, : len(cell.arm)]), compute_uv=False)[:, -1]


# What a displacement is


def test_the_part_is_turned_about_its_middle_and_then_shifted() -> None:
    middle = np.array([0.03, -0.02, 0.5])
    T = Displacement("", (1e-3, 2e-3, -3e-3), (0.0, 0.0, math.radians(90.0))).matrix(middle)
    np.testing.assert_allclose(T[:3, :3] @ middle + T[:3, 3], middle + [1e-3, 2e-3, -3e-3], atol=1e-15)
    beside = T[:3, :3] @ (middle + [0.01, 0.0, 0.0]) + T[:3, 3]
    np.testing.assert_allclose(beside, middle + [1e-3, 12e-3, -3e-3], atol=1e-15)


@pytest.mark.parametrize("name", ["table", "seven_axes"])
def test_the_displaced_nozzle_stands_where_the_displaced_part_asks_for(cases: dict[str, Case], name: str) -> None:
    case = cases[name]
    path, middle = case.paths[0], middle_of(case.toolpath)
    shift, turn = np.array([1e-3, -2e-3, 1.5e-3]), np.radians([0.5, 0.8, -1.0])
    T = Displacement("", tuple(shift), tuple(turn)).matrix(middle)
    elsewhere = displaced(case.cell, T)
    moved = followed(elsewhere, path)
    na = len(case.cell.arm)
    # by hand: the planned pose over the part, carried along by the displacement, seen in the world
    planned = case.cell.T_part_nozzle(path.q)
    R = Rotation.from_rotvec(turn).as_matrix()
    T_world_part = case.cell.holder.poses(path.q[:, na:])
    tip = planned[:, :3, 3]
    wanted = (
        np.einsum("nij,nj->ni", T_world_part[:, :3, :3], (tip - middle) @ R.T + middle + shift) + T_world_part[:, :3, 3]
    )
    found = case.cell.arm.poses(moved.q[:, :na])
    np.testing.assert_allclose(found[:, :3, 3], wanted, atol=1e-9)
    np.testing.assert_allclose(found[:, :3, :3], T_world_part[:, :3, :3] @ R @ planned[:, :3, :3], atol=1e-9)
    assert np.abs(found[:, :3, 3] - case.cell.arm.poses(path.q[:, :na])[:, :3, 3]).max() > 1e-3
    np.testing.assert_array_equal(moved.q[:, case.cell.chosen], path.q[:, case.cell.chosen])
    assert np.abs(moved.q - path.q).max() < 0.2, "the same branch and the same turns"


@pytest.mark.parametrize("name", ["table", "seven_axes"])
def test_the_verifier_sees_the_part_where_it_was_put(cases: dict[str, Case], name: str) -> None:
    case = cases[name]
    T = Displacement("", (2e-3, 0.0, 0.0), (0.0, 0.0, 0.0)).matrix(middle_of(case.toolpath))
    elsewhere = displaced(case.cell, T)
    trajectory = case.planned[0]
    here, there = executed_motion(case.cell, trajectory), executed_motion(elsewhere, trajectory)
    np.testing.assert_allclose(there.tip, here.tip - [2e-3, 0.0, 0.0], atol=1e-12)
    failed = {check.name for check in verify(case.problem, elsewhere, case.toolpath, trajectory).checks if not check.ok}
    assert "tip on the path" in failed, "the old joints do not print on the displaced part"
    assert all(check.ok for check in case.again(elsewhere, [followed(elsewhere, path) for path in case.paths]).checks)


def test_out_of_reach_is_refused_with_the_place() -> None:
    case = small()
    far = displaced(case.cell, Displacement("", (2.0, 0.0, 0.0)).matrix(middle_of(case.toolpath)))
    with pytest.raises(Refusal, match=r"bead 0, .*out of the arm's reach by [\d.]+ mm .*layer 1, path 'zigzag'"):
        followed(far, case.paths[0])
    tried = _try(Displacement("far", (2.0, 0.0, 0.0)), far, case.paths, case.again)
    assert not tried.verified
    assert "out of the arm's reach" in tried.failures[0]


def test_what_the_print_lies_on_moves_with_it_and_nothing_else_does() -> None:
    turned = "cell.bed_rpy_deg=[0, 0, 30]"
    bed = "bed: {box_mm: [400, 400, 20], centre_mm: [560, -93, 280]}"
    post = "post: {cylinder: {radius_mm: 20, height_mm: 300}, centre_mm: [560, 200, 150]}"
    problem = load_problem("planar_gcode", [turned, f"cell.fixtures={{{bed}, {post}}}"])
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    along = beneath(cell, toolpath, problem.collision.nozzle)
    assert along == ("bed",)
    middle = middle_of(toolpath)
    down = displaced(cell, Displacement("", (0.0, 0.0, -2e-3)).matrix(middle), along)
    aside = displaced(cell, Displacement("", (2e-3, 0.0, 0.0)).matrix(middle), along)
    for there, moved in ((down, [0.0, 0.0, -2e-3]), (aside, [2e-3 * math.cos(math.pi / 6), 1e-3, 0.0])):
        by_name = {body.name: body.T_frame_solid for body in there.fixtures}
        for body in cell.fixtures:
            expected = body.T_frame_solid[:3, 3] + (np.array(moved) if body.name == "bed" else 0.0)
            np.testing.assert_allclose(by_name[body.name][:3, 3], expected, atol=1e-12)
    far = load_problem("planar_gcode", ["cell.fixtures={bed: {box_mm: [400, 400, 20], centre_mm: [560, -93, 270]}}"])
    assert beneath(build_cell(far), toolpath, problem.collision.nozzle) == (), "10 mm below the print"
    assert beneath(small().cell, small().toolpath, 1.0) == (), "where the part turns, nothing that stands carries it"


# Bounds to first order


@pytest.mark.parametrize("name", ["table", "seven_axes"])
@pytest.mark.parametrize("seed", range(3))
def test_slopes_are_what_small_displacements_do(cases: dict[str, Case], name: str, seed: int) -> None:
    case = cases[name]
    path, middle = case.paths[0], middle_of(case.toolpath)
    slopes, sigma = displacement_slopes(case.cell, path, slice(0, len(path.task)), middle)
    np.testing.assert_allclose(sigma, least_sigma(case.cell, path.q), rtol=1e-9)
    way = np.random.default_rng(seed).normal(size=6)
    h = 1e-5
    ends = []
    for sign in (1.0, -1.0):
        each = Displacement("", tuple(sign * h * way[:3]), tuple(sign * h * way[3:]))
        ends.append(followed(displaced(case.cell, each.matrix(middle)), path).q)
    solved = list(case.cell.solved)
    by_joint = (ends[0] - ends[1])[:, solved] / (2.0 * h)
    np.testing.assert_allclose(slopes[:, :-1] @ way, by_joint, rtol=1e-5, atol=1e-5)
    by_sigma = (least_sigma(case.cell, ends[0]) - least_sigma(case.cell, ends[1])) / (2.0 * h)
    np.testing.assert_allclose(slopes[:, -1] @ way, by_sigma, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["table", "seven_axes"])
def test_bounds_are_reached_by_their_own_displacement_and_by_no_other(cases: dict[str, Case], name: str) -> None:
    case = cases[name]
    path, middle = case.paths[0], middle_of(case.toolpath)
    little = AROUND.times(0.05)
    bounds = first_order(case.cell, case.paths, little, middle, 0.0)
    assert [bound.joint for bound in bounds[:-1]].count("") == 0
    assert len(bounds) == 7
    rng = np.random.default_rng(1)
    others = [_random_within(little, rng) for _ in range(30)]
    for bound in bounds:
        i = int(np.argmin(np.abs(path.task.s - bound.s)))
        j = case.cell.joint_names.index(bound.joint) if bound.joint else -1

        def change(each: Displacement, i: int = i, j: int = j) -> float:
            q = followed(displaced(case.cell, each.matrix(middle)), path).q[i : i + 1]
            if j < 0:
                return float((least_sigma(case.cell, path.q[i : i + 1]) - least_sigma(case.cell, q))[0])
            return float(abs(q[0, j] - path.q[i, j]))

        assert change(bound.worst) == pytest.approx(bound.change, rel=0.02)
        assert max(change(each) for each in others) < 1.02 * bound.change
        room = least_sigma(case.cell, path.q[i : i + 1])[0]
        if bound.joint:
            room = min(path.q[i, j] - case.cell.limits.q_min[j], case.cell.limits.q_max[j] - path.q[i, j])
        assert bound.room == pytest.approx(room)
        assert bound.factor == pytest.approx(bound.room / bound.change)


def test_what_first_order_calls_worst_is_worse_than_others_over_the_whole_tolerance() -> None:
    case = small()
    middle = middle_of(case.toolpath)
    bounds = first_order(case.cell, case.paths, AROUND, middle, 0.0)
    limits = case.cell.limits
    j = case.cell.joint_names.index(bounds[0].joint)

    def margins(each: Displacement) -> tuple[float, float]:
        """Least room of the tightest joint along all beads, and least singular value along the bead that is named for it."""
        elsewhere = displaced(case.cell, each.matrix(middle))
        paths = [followed(elsewhere, path) for path in case.paths]
        room = min(np.minimum(p.q - limits.q_min, limits.q_max - p.q)[:, j].min() for p in paths)
        named = paths[bounds[-1].bead]
        sigma = least_sigma(elsewhere, named.q[named.task.first : named.task.last + 1]).min()
        return float(room), float(sigma)

    rng = np.random.default_rng(2)
    others = np.array([margins(_random_within(AROUND, rng)) for _ in range(40)]).min(axis=0)
    planned = np.array(margins(AS_PLANNED))
    found = np.array([margins(bounds[0].worst)[0], margins(bounds[-1].worst)[1]])
    assert (found < planned).all()
    assert (found <= others + 0.02 * (planned - others)).all(), "a hair may be left to what is not linear"
    assert found[0] == pytest.approx(bounds[0].room - bounds[0].change, abs=0.02 * bounds[0].change)


def _random_within(tolerance: Tolerance, rng: np.random.Generator) -> Displacement:
    """A displacement on the edge of a tolerance."""
    parts = []
    for size in (tolerance.shift, tolerance.turn):
        way = rng.normal(size=3)
        x, y, z = size * way / np.linalg.norm(way)
        parts.append((float(x), float(y), float(z)))
    return Displacement("", *parts)


def test_factors_scale_with_the_tolerance() -> None:
    case = small()
    once, twice = (
        first_order(case.cell, case.paths, AROUND.times(k), middle_of(case.toolpath), 0.05) for k in (1.0, 2.0)
    )
    for a, b in zip(once, twice, strict=True):
        assert (a.joint, a.bead, a.s) == (b.joint, b.bead, b.s)
        assert b.factor == pytest.approx(a.factor / 2.0)


# Where it is tried


def test_twelve_extremes_and_eight_corners_whose_signs_are_balanced() -> None:
    tried = displacements(AROUND)
    assert len(tried) == 20
    assert len({(each.shift, each.turn) for each in tried}) == 20
    assert len({each.name for each in tried}) == 20
    sizes = np.array([[np.linalg.norm(each.shift), np.linalg.norm(each.turn)] for each in tried])
    np.testing.assert_allclose(np.sort(sizes.max(axis=0)), np.sort([AROUND.shift, AROUND.turn]))
    np.testing.assert_allclose(sizes[12:], [[AROUND.shift, AROUND.turn]] * 8)
    for k in range(3):
        extremes = [
            each for each in tried[:12] if abs(each.shift[k]) == AROUND.shift or abs(each.turn[k]) == AROUND.turn
        ]
        assert len(extremes) == 4
    signs = np.sign([[*each.shift, *each.turn] for each in tried[12:]])
    for a, b in combinations(range(6), 2):
        pairs, counts = np.unique(signs[:, [a, b]], axis=0, return_counts=True)
        assert len(pairs) == 4
        assert (counts == 2).all()


def test_displacements_that_are_alike_are_tried_once() -> None:
    assert len(displacements(Tolerance(2e-3, 0.0))) == 6 + 8
    assert len(displacements(Tolerance(0.0, 0.01))) == 6 + 4
    assert displacements(Tolerance(0.0, 0.0)) == ()
    assert displacements(AROUND)[0].name == "2 mm along +x"
    assert displacements(AROUND)[-1].name == "2 mm along -x-y-z, 1 deg about +x+y+z"


@pytest.mark.slow
def test_no_tolerance_is_the_plan_itself() -> None:
    case = small()
    room = case.judged(Tolerance(0.0, 0.0))
    assert [each.displacement for each in room.tried] == [AS_PLANNED]
    assert room.holds
    planned = verify(case.problem, case.cell, case.toolpath, case.planned[0])
    assert room.tried[0].metrics == planned.metrics
    for name, (value, where) in room.worst_metrics.items():
        assert value == planned.metrics[name]
        assert where is AS_PLANNED
    # followed anew without being displaced, everything is the same but for rounding
    again = _try(AS_PLANNED, case.cell, case.paths, case.again)
    assert again.verified
    assert again.metrics is not None
    assert again.metrics.keys() == planned.metrics.keys()
    for name, value in planned.metrics.items():
        assert again.metrics[name] == pytest.approx(value, rel=1e-4, abs=1e-6), name


# What is told


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two displacements and those that first order calls worst, not twenty: each is verified in full."""
    monkeypatch.setattr("planner.planning.robustness.displacements", lambda tolerance: displacements(tolerance)[:2])


@pytest.fixture(scope="module")
def beside_a_stop() -> tuple[Case, str]:
    """The small print, and a joint whose range ends 0.2 degrees beyond what it uses along the beads."""
    case = small()
    bounds = first_order(case.cell, case.paths, AROUND, middle_of(case.toolpath), 0.0)
    name = max(bounds[:-1], key=lambda bound: bound.change).joint
    j = case.cell.joint_names.index(name)
    limits = case.cell.limits
    q_max = limits.q_max.copy()
    q_max[j] = max(path.q[:, j].max() for path in case.paths) + math.radians(0.2)
    cell = replace(case.cell, limits=replace(limits, q_max=q_max))
    return replace(case, cell=cell), name


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_beside_a_joint_limit_it_does_not_hold_and_names_the_joint(beside_a_stop: tuple[Case, str]) -> None:
    case, joint = beside_a_stop
    room = case.judged(AROUND)
    assert room.tried[0].verified, "as planned it holds"
    assert not room.holds
    assert room.bounds[0].joint == joint
    assert math.degrees(room.bounds[0].room) == pytest.approx(0.2, abs=1e-6)
    assert room.bounds[0].factor < 1.0
    failed = [each for each in room.tried if not each.verified]
    assert all(f"{joint} leaves its range by" in each.failures[0] for each in failed)
    assert any(each.displacement is room.bounds[0].worst for each in failed)
    assert case.judged(AROUND.times(0.9 * room.bounds[0].factor)).holds, "within the head-room it does"


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_the_command_refuses_what_does_not_hold_and_says_why(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # as published, joints follow from the part alone: a range that ends beside them changes nothing of the plan
    path = write_small(tmp_path, ("strategy: ladder", "strategy: as_published"))
    plan = solve(load_problem(path))
    q = np.degrees(plan.trajectory.q[:, 4])
    low, high = float(q.min()) - 40.0, float(q.max()) + 0.2
    stop = ["--set", f"cell.limits.joint_5.range_deg=[{low}, {high}]", "--quiet", "--out", str(tmp_path / "out")]
    assert main([str(path), *stop]) == EXIT_VERIFIED
    assert (tmp_path / "out" / "Small.mod").exists()
    capfd.readouterr()
    assert main([str(path), *stop, "--tolerance", "2mm,1deg"]) == EXIT_NOT_VERIFIED
    assert not (tmp_path / "out" / "Small.mod").exists()
    out = capfd.readouterr().out
    assert "tolerance 2mm,1deg: does not hold at" in out
    assert "to first order the range of joint_5 holds up to 0." in out
    assert "joint_5 leaves its range by" in out
    assert "verified as planned, but NOT within 2mm,1deg: no robot code was written" in out
    data = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert data["verified"] is False
    assert all(check["ok"] for check in data["checks"])
    assert data["tolerance"]["holds"] is False
    assert data["tolerance"]["first_order"][0]["joint"] == "joint_5"
    assert [each["verified"] for each in data["tolerance"]["placements"]].count(False) > 0
    report = (tmp_path / "out" / "report.html").read_text()
    assert "Not verified within the tolerance" in report
    assert "joint_5 leaves its range by" in report
    assert "--tolerance 2mm,1deg" in report


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_the_command_says_that_it_holds(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write_small(tmp_path)
    arguments = [str(path), "--quiet", "--tolerance", "0.5 mm", "--out", str(tmp_path / "out")]
    assert main(arguments) == EXIT_VERIFIED
    out = capfd.readouterr().out
    assert "tolerance 0.5mm,0deg: holds at all 4 placements tried" in out
    assert "within 0.5mm,0deg too" in out
    assert "least nozzle tip outside the part" in out
    data = json.loads((tmp_path / "out" / "plan.json").read_text())
    tried = data["tolerance"]["placements"]
    assert len(tried) == 5
    for name, told in data["tolerance"]["worst"].items():
        values = [each["metrics"][name] for each in tried]
        assert told["value"] in (min(values), max(values))
        assert (told["value"] == min(values)) or name in (
            "print_time_s",
            "deposition_time_s",
            "branch_changes_in_deposition",
        )
    assert data["tolerance"]["worst"]["sigma_min"]["value"] < data["metrics"]["sigma_min"]
    assert (tmp_path / "out" / "Small.mod").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_two_processes_say_the_same_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = small_problem()
    one = solve(problem, tolerance=AROUND)
    monkeypatch.setattr("planner.planning.pipeline.WORTH_HALVES", 0)
    two = solve(problem, tolerance=AROUND, second_process=True)
    assert one.headroom is not None
    assert one.headroom == two.headroom


@pytest.mark.parametrize(
    "text", ["2", "2mm,1mm", "2mm 1deg", "-1mm", "1cm", "nanmm", "", "mm", "200mm", "11deg", "1e9mm"]
)
def test_the_command_refuses_what_is_no_tolerance(text: str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["cylinder_logo", f"--tolerance={text}"])
    assert stop.value.code == 2
    error = capfd.readouterr().err
    assert "--tolerance" in error
    assert "Traceback" not in error


def test_worst_checks_are_those_that_fail_or_are_nearest_to_their_limits() -> None:
    def check(name: str, worst: float, limit: float, least: bool = False) -> Check:
        return Check(name, worst, limit, "", worst >= limit if least else worst <= limit, "", least)

    at = [Displacement(str(k)) for k in range(3)]

    def at_least(b: float, c: float, of_c: float) -> tuple[Check, Check]:
        return check("b", b, 1.0, least=True), check("c", c, of_c, least=True)

    tried = (
        TriedDisplacement(at[0], (check("a", 0.5, 1.0), *at_least(5.0, 3.0, 2.9))),
        TriedDisplacement(
            at[1], (check("a", 0.9, 1.0), *at_least(2.0, 1.0, 0.5)), {"sigma_min": 0.2, "gap_clearance_mm": 3.0}
        ),
        TriedDisplacement(
            at[2], (check("a", 0.7, 1.0), *at_least(0.5, 1.0, 0.5)), {"sigma_min": 0.3, "gap_clearance_mm": 2.0}
        ),
    )
    room = Robustness(AROUND, (0.0, 0.0, 0.0), (), tried)
    assert {found.name: where.name for found, where in room.worst_checks} == {"a": "1", "b": "2", "c": "0"}
    assert not room.holds
    assert {name: where.name for name, (_, where) in room.worst_metrics.items()} == {
        "sigma_min": "1",
        "gap_clearance_mm": "2",
    }


@pytest.mark.slow
def test_the_report_says_nothing_where_nobody_asked() -> None:
    assert robustness_section(solve(small_problem(), "as_published")) == ""


# How it is written


@given(
    st.floats(0.0, 100.0).map(lambda x: float(f"{x:.6g}")),
    st.floats(0.0, 10.0).map(lambda x: float(f"{x:.6g}")),
    st.sampled_from(["", " ", "  "]),
    st.booleans(),
)
def test_a_tolerance_is_read_as_it_is_written(shift: float, turn: float, blank: str, turned: bool) -> None:
    terms = [f"{shift:.12f}{blank}mm", f"{turn:.12f}{blank}deg"]
    read = parse_tolerance(f",{blank}".join(reversed(terms) if turned else terms))
    assert read.shift * 1e3 == pytest.approx(shift, abs=1e-11)
    assert math.degrees(read.turn) == pytest.approx(turn, abs=1e-11)
    alone = parse_tolerance(terms[0])
    assert (alone.shift, alone.turn) == (read.shift, 0.0)


@given(st.floats(1e-3, 99.0), st.floats(1e-3, 9.9))
def test_the_words_of_a_tolerance_can_be_read_again(shift: float, turn: float) -> None:
    tolerance = Tolerance(shift / 1e3, math.radians(turn))
    read = parse_tolerance(tolerance.words)
    assert read.shift == pytest.approx(tolerance.shift, rel=1e-5)
    assert read.turn == pytest.approx(tolerance.turn, rel=1e-5)


@given(st.text(alphabet="0123456789.,-+e mdgcm°\u0661", max_size=12))
def test_any_text_is_a_tolerance_or_is_refused_with_a_reason(text: str) -> None:
    try:
        read = parse_tolerance(text)
    except ValueError as error:
        assert "toleran" in str(error) or "twice" in str(error)
    else:
        assert 0.0 <= read.shift <= 0.1
        assert 0.0 <= read.turn <= math.radians(10.0)
