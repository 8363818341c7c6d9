"""An arm on a rail: kinematics, problem files, and programs with an external axis that slides."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import coal_bodies
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from solved import promises_kept, solve_alone, write_small

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.shipped import PROBLEMS
from planner.cell.cell import Cell, build_cell, rigid_inverse
from planner.cell.kinematics.inverse import OnRail, kind_of, solve_one, solver_of
from planner.cell.solids import Body, Box
from planner.collision.margins import nearest_margins
from planner.collision.scene import NOTHING, PART, collision_bodies, may_touch, obstacles_of
from planner.export.languages import LANGUAGES
from planner.export.plan_json import plan_json
from planner.export.program import ProblemSetup
from planner.place.rating import course_of, score
from planner.plan import TRAVEL, Plan, Trajectory
from planner.problem import Problem, load_problem
from planner.problem.as_run import AsRunSpec
from planner.register.finding import scene_of
from planner.register.fitting import Placement
from planner.register.places import reachable
from planner.register.telling import place_words
from planner.resolve.baselines import fixed
from planner.resolve.drawn import postures_drawn
from planner.resolve.follow import PosturesFollowed, follow
from planner.resolve.infeasible import _directions, _postures_at
from planner.resolve.joint_path import at_rest
from planner.resolve.ladder import _rest_angles, _with_one_joint, coarse_grid, paths_of
from planner.resolve.reach import looked_at
from planner.resolve.sqp import free_variables
from planner.resolve.terms import model_of
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import tasks_of
from planner.verify.as_run import as_run
from planner.verify.bodies import CellBodies, pairs
from planner.verify.verdict import verify

ROWS = 6  # nearest pairs of a posture that are looked at
FAR = """\
<robot name="far">
  <link name="foot"/><link name="arm"/>
  <link name="plate"><collision><origin xyz="0 0 -0.02"/><geometry><box size="0.2 0.2 0.04"/></geometry></collision></link>
  <joint name="swing" type="revolute">
    <parent link="foot"/><child link="arm"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="0"/>
  </joint>
  <joint name="out" type="prismatic">
    <parent link="arm"/><child link="plate"/><axis xyz="1 0 0"/><limit lower="0" upper="2.5" velocity="1" effort="0"/>
  </joint>
</robot>
"""
FAR_TABLE = "far.yaml, base_mm: [800, 900, 0], free: [swing, out], home_mm: {out: 200}"
FAR_LIMITS = "acceleration_rad_s2: [1, 2]\njerk_rad_s3: [10, 20]\n"
PANEL = (PROBLEMS / "rail_panel.yaml").read_text(encoding="utf-8")
COLUMN = """\
<robot name="column">
  <link name="foot"><collision><origin xyz="0 0 0.1"/><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="slide"/>
  <link name="boom"><collision><origin xyz="0.3 0 0"/><geometry><box size="0.5 0.1 0.1"/></geometry></collision></link>
  <link name="place"/>
  <joint name="up" type="prismatic">
    <parent link="foot"/><child link="slide"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
    <limit lower="-0.2" upper="1" velocity="0.5" effort="0"/>
  </joint>
  <joint name="swing" type="revolute">
    <parent link="slide"/><child link="boom"/><origin xyz="0 0 0.1" rpy="0.1 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="1" effort="0"/>
  </joint>
  <joint name="end" type="fixed"><parent link="boom"/><child link="place"/><origin xyz="0.6 0 0.05" rpy="0 0.2 0"/></joint>
</robot>
"""
COLUMN_YAML = "name: column\nurdf: column.urdf\ntip: place\nacceleration_rad_s2: [1, 2]\njerk_rad_s3: [10, 20]\n"
SKEW_PLACES = ("0 0 0.245", "0 0 0", "0 0 0.54", "0 0 0", "0.54 0 0", "0 -0.15 0")  # of a Fanuc CRX-10iA
SKEW_AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
SKEW = (
    '<robot name="skew"><link name="link_0"/>'
    + "".join(
        f'<link name="link_{k}"/><joint name="joint_{k}" type="revolute"><parent link="link_{k - 1}"/><child link="link_{k}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="2" effort="0"/></joint>'
        for k, (place, axis) in enumerate(zip(SKEW_PLACES, SKEW_AXES, strict=True), 1)
    )
    + '<link name="flange"/><joint name="face" type="fixed"><parent link="link_6"/><child link="flange"/>'
    '<origin xyz="0.16 0 0" rpy="0 1.5707963267948966 0"/></joint></robot>'
)
SKEW_YAML = (
    "name: skew\nurdf: skew.urdf\ntip: flange\ninverse_kinematics: skew_wrist\ncontroller: {lag_ms: 19.7}\n"
    "measured: by its log\nacceleration_rad_s2: [10, 10, 10, 10, 10, 10]\njerk_rad_s3: [500, 500, 500, 500, 500, 500]\n"
)
GANTRY = """\
    robot: gantry_xy
    free: [gantry_y, gantry_x]
    home_mm: {gantry_x: 1500, gantry_y: 1000}
"""
HOME = "    home_mm: {rail: 1500}                 # where it is before and after the print\n"
BASE = PANEL[PANEL.index("    robot: track_3m") : PANEL.index(HOME) + len(HOME)]


def problem(folder: Path, *changes: tuple[str, str]) -> Problem:
    """The panel's problem with pieces of its text exchanged, beside a column of two joints."""
    text = PANEL.replace("rail_panel.txt", str(PROBLEMS / "rail_panel.txt"))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "column.urdf").write_text(COLUMN, encoding="utf-8")
    (folder / "column.yaml").write_text(COLUMN_YAML, encoding="utf-8")
    (folder / "skew.urdf").write_text(SKEW, encoding="utf-8")
    (folder / "skew.yaml").write_text(SKEW_YAML, encoding="utf-8")
    (folder / "own.yaml").write_text(text, encoding="utf-8")
    return load_problem(folder / "own.yaml")


def on_column(free: str, **given: str) -> tuple[str, str]:
    """The change that puts the arm on the column."""
    return BASE, "".join(f"    {k}: {v}\n" for k, v in {"robot": "column.yaml", "free": free, **given}.items())


def cells(folder: Path) -> dict[str, Cell]:
    """Arms of several kinds on a track, and on either joint of the column."""
    upside = ("base_mm: [0, 0, 0] ", "base_mm: [100, 200, 300]\n  base_rpy_deg: [20, -30, 40]")
    ur = ("arm: irb1600_12 ", "arm: ur10 ")
    found = {
        "track": problem(folder),
        "tilted": problem(folder, upside),
        "measured": problem(folder, ur, upside),
        "lift": problem(folder, on_column("[up]", held_deg="{swing: 30}", home_mm="{up: 500}"), upside),
        "swing": problem(folder, on_column("[swing]", held_mm="{up: 700}", home_deg="{swing: -20}")),
        "both": problem(folder, on_column("[swing, up]", home_mm="{up: 500}", home_deg="{swing: -20}"), upside),
        "gantry": problem(folder, (BASE, GANTRY), upside),
        "skew": problem(folder, ("arm: irb1600_12 ", "arm: skew.yaml "), upside),
        "seven": problem(folder, ("arm: irb1600_12 ", "arm: iiwa "), ("home_deg: [90,", "home_deg: [90, 0,"), upside),
    }
    return {name: build_cell(each) for name, each in found.items()}


def postures(cell: Cell, n: int) -> Array:
    limits, na = cell.limits, len(cell.arm)
    return np.random.default_rng(5).uniform(limits.q_min[:na], limits.q_max[:na], (n, na))


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cell]:
    return cells(tmp_path_factory.mktemp("cells"))


KINDS = ("track", "tilted", "measured", "lift", "swing", "both", "gantry", "skew", "seven")
GIVEN = {"both": (0, 1), "gantry": (0, 1), "seven": (0, 3)}  # joints that are chosen, if not the first alone


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("kind", KINDS)
def test_chain_and_closed_form_are_pinocchios(carried: dict[str, Cell], kind: str) -> None:
    cell = carried[kind]
    q = postures(cell, 40)
    model, data = cell.arm_robot.model, cell.arm_robot.model.createData()
    frame = model.getFrameId(cell.arm_robot.tip)
    J = cell.arm.jacobians(q)
    for i, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        T = cell.T_world_base @ data.oMf[frame].homogeneous
        np.testing.assert_allclose(T @ cell.T_flange_nozzle, cell.arm.poses(q[i : i + 1])[0], atol=1e-9)
        np.testing.assert_allclose(rigid_inverse(cell.T_world_base) @ T, cell.inverse.poses(q)[i], atol=1e-9)
        for j in range(len(row)):
            step = np.zeros(len(row))
            step[j] = 1e-6
            a, b = cell.arm.poses(np.stack([row - step, row + step]))
            spin = (b[:3, :3] - a[:3, :3]) @ cell.arm.poses(q[i : i + 1])[0, :3, :3].T / 2e-6
            np.testing.assert_allclose(J[i, :3, j], (b[:3, 3] - a[:3, 3]) / 2e-6, atol=1e-7)
            np.testing.assert_allclose(J[i, 3:, j], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_inverse_of_a_pose_on_the_rail_has_that_pose(carried: dict[str, Cell], kind: str) -> None:
    cell = carried[kind]
    inverse, q = cell.inverse, postures(cell, 60)
    assert isinstance(inverse, OnRail)
    given = list(GIVEN.get(kind, (0,)))
    assert cell.chosen == tuple(given)
    solved = list(cell.solved)
    assert sorted([*solved, *given]) == list(range(len(cell.arm)))
    T = inverse.poses(q)
    found, exists = inverse.solve(T, q[:, given])
    own = inverse.branches(q)
    assert exists[np.arange(len(q)), own].mean() > 0.9  # measured arms have none beside singularities
    for j in given:
        assert (found[exists][:, j] == np.broadcast_to(q[:, j, None], exists.shape)[exists]).all()
    i, k = np.nonzero(exists)
    np.testing.assert_allclose(inverse.poses(found[i, k]), T[i], atol=1e-8)
    there = exists[np.arange(len(q)), own]
    off = (found[np.arange(len(q)), own] - q)[there][:, solved]
    np.testing.assert_allclose(np.remainder(off + np.pi, 2.0 * np.pi) - np.pi, 0.0, atol=1e-6)
    one, ok = np.empty((inverse.branch_count, len(cell.arm))), np.empty(inverse.branch_count, dtype=np.bool_)
    for i in range(len(q)):
        solve_one(kind_of(inverse), solver_of(inverse), inverse.parameters, q[i, given], T[i], one, ok)
        assert (ok == exists[i]).all()
        np.testing.assert_allclose(one[ok], found[i][ok], atol=1e-9)
    assert (inverse.out_of_reach(T, q[:, given]) < 1e-9).all()
    rest, _ = inverse.solve(T)
    assert (rest[:, :, given] == cell.home[given]).all()


def test_an_arm_on_a_rail_is_what_its_file_says(carried: dict[str, Cell]) -> None:
    robot = carried["skew"].arm_robot
    assert robot.controller == (("lag", 0.0197),) and robot.measured == "by its log"


def test_home_and_limits_are_those_of_both(carried: dict[str, Cell]) -> None:
    track, lift, swing = carried["track"], carried["lift"], carried["swing"]
    assert track.joint_names[:2] == ("rail", "joint_1")
    np.testing.assert_allclose(track.home[:2], [1.5, np.pi / 2])
    assert track.limits.sliding == (0,)
    assert (track.limits.q_min[0], track.limits.q_max[0], track.limits.velocity[0]) == (0.0, 3.0, 1.5)
    assert (lift.home[0], lift.limits.sliding) == (0.5, (0,))
    assert swing.limits.sliding == ()
    gantry, both = carried["gantry"], carried["both"]
    assert gantry.joint_names[:3] == (
        "gantry_x",
        "gantry_y",
        "joint_1",
    )  # from the floor on, whatever their order in `free`
    assert (gantry.rails, gantry.limits.sliding, gantry.besides) == (2, (0, 1), (0, 1))
    np.testing.assert_allclose(gantry.home[:2], [1.5, 1.0])
    np.testing.assert_allclose(both.home[:2], [0.5, np.radians(-20)])
    assert both.limits.sliding == (0,)
    np.testing.assert_allclose(swing.home[0], np.radians(-20))
    assert track.arm_robot.name == "ABB IRB 1600-x/1.2 on linear track of 3 m"


def test_a_part_is_moved_towards_where_the_arm_is_at_home(carried: dict[str, Cell]) -> None:
    way = _directions(carried["track"], np.zeros(3))["towards the arm's base"]
    np.testing.assert_allclose(way, [0.0, -1.0, 0.0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ("lift", "swing", "both"))
def test_bodies_ride_where_the_carrier_has_them(carried: dict[str, Cell], kind: str) -> None:
    """The boom's middle is where the column's own model has it, however the arm stands."""
    cell = carried[kind]
    assert cell.carrier is not None
    own = cell.carrier.robot
    q = postures(cell, 5)
    for row in q:
        values = dict(cell.carrier.held) | dict(zip(cell.carrier.free, row, strict=False))
        data = own.model.createData()
        pin.forwardKinematics(own.model, data, np.array([values[name] for name in own.joint_names]))
        expected = cell.T_world_base @ data.oMi[2].homogeneous @ [0.3, 0.0, 0.0, 1.0]
        boxes = [body for body in coal_bodies.placed(cell.arm_robot, row, cell.T_world_base) if "boom" in body[1]]
        assert len(boxes) == 1
        np.testing.assert_allclose(boxes[0][3].getTranslation(), expected[:3], atol=1e-9)


def test_a_carrier_that_stands_only_moves_the_base(tmp_path: Path) -> None:
    cell = build_cell(problem(tmp_path, ("free: [rail]", "free: []"), (HOME, "    held_mm: {rail: 700}\n")))
    assert len(cell.arm) == 6
    np.testing.assert_allclose(cell.T_world_base[:3, 3], [0.7, 0.0, 0.3], atol=1e-12)
    assert len(cell.arm_robot.bodies[0]) > 4  # the track's as well


@pytest.mark.parametrize(
    "joints",
    [
        "free: [gantry_x, gantry_y]",
        "free: [gantry_x]\n    held_mm: {gantry_y: 1000}",
        "free: []\n    held_mm: {gantry_x: 1500, gantry_y: 1000}",
    ],
    ids=["free", "one held", "held"],
)
def test_what_is_checked_of_a_carrier_is_the_same_whichever_joints_are_held(tmp_path: Path, joints: str) -> None:
    """The arm's foot hangs from the trolley: frame and bridge are no neighbours of its first link."""
    cell = build_cell(problem(tmp_path, (BASE, f"    robot: gantry_xy\n    {joints}\n")))
    cell = replace(cell, fixtures=())
    bodies, planned = CellBodies.of(cell), collision_bodies(cell)
    checked = {(bodies.things[pair.a].link, bodies.things[pair.b].link) for pair in pairs(bodies, 2e-3, 5e-3)}
    searched = {
        (a.body.link, b.body.link)
        for a, b in itertools.combinations(planned, 2)
        if may_touch(a, b, len(cell.arm)) and a.body.link and b.body.link
    }
    for found in (checked, searched):
        assert {a for a, b in found if b == "link_1"} == {"frame", "bridge"}
        assert {"frame", "bridge", "trolley"} <= {a for a, b in found if b == "link_2"}
        assert not {("frame", "bridge"), ("bridge", "trolley")} & found


WRONG = {
    "unknown joint": ("free: [rail]", "free: [rial]", "cell.base.free", "did you mean rail?"),
    "two joints": ("free: [rail]", "free: [rail, other]", "cell.base.free", "joints: rail"),
    "home of a stranger": ("{rail: 1500}", "{rails: 1500}", "cell.base.home_mm", "did you mean rail?"),
    "home out of range": ("{rail: 1500}", "{rail: 3500}", "cell.base.home_mm.rail", "0 to 3000 mm"),
    "home in degrees": ("home_mm: {rail: 1500}", "home_deg: {rail: 15}", "cell.base.home_deg.rail", "home_mm"),
    "held and free": ("home_mm: {rail: 1500}", "held_mm: {rail: 15}", "cell.base.held_mm.rail", "is free"),
    "unknown robot": ("robot: track_3m ", "robot: trak_3m ", "cell.base.robot", "did you mean track_3m?"),
    "an arm": ("robot: track_3m ", "robot: irb140 ", "cell.base.robot", "is an arm, and cannot carry one"),
    "seven angles": ("home_deg: [90,", "home_deg: [90, 90,", "cell.home_deg", "has 6 joints, not 7"),
    "angles of a rail": (
        "  bed_mm", "  limits: {rail: {speed_deg_s: 10}}\n  bed_mm", "cell.limits.rail", "this joint slides",
    ),
    "a range away from home": (
        "  bed_mm", "  limits: {rail: {range_mm: [0, 900]}}\n  bed_mm", "cell.base.home_mm.rail", "0 to 900 mm",
    ),
    "places of an arm": (
        "  bed_mm", "  limits: {joint_1: {speed_mm_s: 10}}\n  bed_mm", "cell.limits.joint_1", "this joint turns",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_a_base_is_told_with_its_field(name: str, tmp_path: Path) -> None:
    old, new, field, said = WRONG[name]
    with pytest.raises(InputError) as caught:
        build_cell(problem(tmp_path, (old, new)))
    assert caught.value.exit_code == 2
    assert caught.value.field == field
    assert said in str(caught.value)


WRONG_TABLE = {
    "angle of a slide": ("home_mm: {rail: 1500}", "home_deg: {rail: 15}", "home_deg.rail", "home_mm"),
    "home of a held one": ("free: [rail], home_mm", "free: [], home_mm", "home_mm.rail", "goes in held_mm"),
    "held and free": ("home_mm: {rail: 1500}", "held_mm: {rail: 1500}", "free", "both free and held"),
    "held out of range": (
        "free: [rail], home_mm: {rail: 1500}",
        "free: [], held_mm: {rail: -2}",
        "held_mm.rail",
        "0 to 3000",
    ),
    "home out of range": ("{rail: 1500}", "{rail: 3001}", "home_mm.rail", "0 to 3000 mm"),
}


@pytest.mark.parametrize("name", WRONG_TABLE)
def test_what_is_wrong_with_a_sliding_table_is_told_with_its_field(name: str, tmp_path: Path) -> None:
    old, new, field, said = WRONG_TABLE[name]
    assert old in SLIDING
    (tmp_path / "slide.yaml").write_text(SLIDING.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        build_cell(load_problem(tmp_path / "slide.yaml"))
    assert caught.value.field == f"cell.positioner.{field}"
    assert said in str(caught.value)


def test_limits_of_a_rail_are_millimetres(tmp_path: Path) -> None:
    own = "limits: {rail: {range_mm: [200, 2900], speed_mm_s: 500, acceleration_mm_s2: 800, jerk_mm_s3: 9000}}"
    cell = build_cell(problem(tmp_path, ("  bed_mm", f"  {own}\n  bed_mm")))
    rows = [cell.limits.q_min, cell.limits.q_max, cell.limits.velocity, cell.limits.acceleration, cell.limits.jerk]
    np.testing.assert_allclose([row[0] for row in rows], [0.2, 2.9, 0.5, 0.8, 9.0])


@pytest.mark.parametrize(
    ("home", "range_mm", "at"),
    [("", "[500, 2500]", 0.5), ("    home_mm: {rail: 4000}\n", "[0, 6000]", 4.0), ("", "[-900, -200]", -0.2)],
)
def test_home_of_a_rail_is_within_the_range_that_the_problem_gives(
    tmp_path: Path, home: str, range_mm: str, at: float
) -> None:
    own = ("  bed_mm", f"  limits: {{rail: {{range_mm: {range_mm}}}}}\n  bed_mm")
    assert build_cell(problem(tmp_path, (HOME, home), own)).home[0] == pytest.approx(at)


def test_a_held_rail_stands_within_the_range_that_the_problem_gives(tmp_path: Path) -> None:
    changes = ("free: [rail]", "free: []"), (HOME, "    held_mm: {rail: 4000}\n")
    own = "  limits: {rail: {range_mm: [0, 6000]}}\n  bed_mm"
    assert build_cell(problem(tmp_path, *changes, ("  bed_mm", own))).T_world_base[0, 3] == pytest.approx(4.0)
    with pytest.raises(InputError, match="this joint slides"):
        build_cell(problem(tmp_path, *changes, ("  bed_mm", own.replace("range_mm: [0, 6000]", "range_deg: [0, 90]"))))


# ----------------------------------------------------------------------------------------------------
# A small print on a positioner, by an arm on a track beside it.

ON_TRACK = (
    (
        "  nozzle:",
        "  base_mm: [0, -1500, -300]\n  base_rpy_deg: [0, 0, 90]\n"
        "  base: {robot: track_3m, free: [rail], home_mm: {rail: 1500}}\n  nozzle:",
    ),
    ("home_deg: [30,", "home_deg: [-60,"),
    ("strategy: ladder", "strategy: sqp"),
)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Solved for all tests here: track, arm and rotation all free."""
    return solve_alone(load_problem(write_small(tmp_path_factory.mktemp("small"), *ON_TRACK)))


@pytest.mark.slow
def test_a_print_with_rail_and_positioner_is_verified(plan: Plan) -> None:
    promises_kept(plan)
    assert plan.cell.joint_names[0] == "rail" and plan.cell.joint_names[-1] == "rotation"
    assert np.ptp(plan.q[:, 0]) > 0.02 and np.ptp(plan.q[:, -1]) > 0.02
    assert plan.metrics["rail_margin_mm"] > 1000.0
    (at_rail,) = (check for check in plan.checks if check.name == "rail range")
    assert (at_rail.unit, at_rail.ok) == ("mm", True)


@pytest.mark.slow
def test_sigma_is_that_of_the_arm_without_its_rail(plan: Plan) -> None:
    J = plan.cell.arm.jacobians(np.ascontiguousarray(plan.q[plan.deposit][:, :7]))
    least = np.linalg.svd(J[:, :, 1:], compute_uv=False)[:, -1].min()
    np.testing.assert_allclose(plan.metrics["sigma_min"], least, rtol=1e-9)
    assert np.linalg.svd(J, compute_uv=False)[:, -1].min() > least


@pytest.mark.slow
def test_a_rail_beyond_its_end_fails(plan: Plan) -> None:
    """The same motion, on a track that is said to end before it."""
    limits = plan.cell.limits
    short = replace(limits, q_max=np.where(np.arange(8) == 0, plan.q[:, 0].max() - 0.01, limits.q_max))
    cell = replace(plan.cell, limits=short)
    found = {check.name: check for check in verify(plan.problem, cell, plan.toolpath, plan.trajectory).checks}
    assert not found["rail range"].ok
    np.testing.assert_allclose(found["rail range"].worst, -10.0, atol=1e-6)
    assert found["joint range"].ok


@pytest.mark.slow
def test_a_carriage_away_from_home_is_told_in_millimetres(plan: Plan) -> None:
    cell = replace(plan.cell, home=plan.cell.home + 0.1 * (np.arange(8) == 0))
    found = {check.name: check for check in verify(plan.problem, cell, plan.toolpath, plan.trajectory).checks}
    at_home = found["starts and ends at home"]
    assert (at_home.ok, at_home.unit) == (False, "mm")
    np.testing.assert_allclose(at_home.worst, 100.0, atol=1e-6)


@pytest.mark.slow
def test_plan_json_says_what_slides_and_its_screws_give_every_pose(plan: Plan) -> None:
    cell = json.loads(plan_json(plan))["cell"]
    assert [joint["type"] for joint in cell["joints"]] == ["prismatic"] + 7 * ["revolute"]
    T = {"nozzle": np.eye(4), "part": np.eye(4)}
    row = plan.q[len(plan.q) // 2]
    for joint, value in zip(cell["joints"], row, strict=True):
        along, at = np.array(joint["direction"]), np.array(joint["origin_m"])
        turns = joint["type"] == "revolute"
        twist = np.concatenate([np.cross(at, along), along]) if turns else np.concatenate([along, np.zeros(3)])
        T[joint["moves"]] = T[joint["moves"]] @ pin.exp6(twist * value).homogeneous
    nozzle, part = T["nozzle"] @ cell["T_world_nozzle_zero"], T["part"] @ cell["T_world_part_zero"]
    np.testing.assert_allclose(np.linalg.inv(part) @ nozzle, plan.cell.T_part_nozzle(row[None])[0], atol=1e-9)


PROGRAMS = {
    "rapid": (r"(MoveL \[\[.*\],\[)(\d+\.\d+)(,0\.0000,)", "external"),
    "krl": (r"(LIN .*,E1 )(\d+\.\d+)(,E2)", "external"),
    "joint_trajectory": (r'("positions":\[)(\d+\.\d+)(,)', "a joint"),
}


@pytest.mark.slow
@pytest.mark.parametrize("language", PROGRAMS)
def test_programs_say_where_the_rail_is(plan: Plan, language: str) -> None:
    """What is written is read back; a target that has the rail elsewhere is noticed."""
    pattern, said = PROGRAMS[language]
    chosen = LANGUAGES[language]
    assert chosen.unsupported(plan) is None
    files = chosen.write(plan)
    assert chosen.differences(plan, files) == []
    ((name, text),) = ((name, text) for name, text in files.items() if re.search(pattern, text))
    places = [float(match[2]) for match in re.finditer(pattern, text)]
    unit = 1.0 if language == "joint_trajectory" else 1e-3
    assert plan.q[:, 0].min() - 1e-6 <= min(places) * unit < max(places) * unit <= plan.q[:, 0].max() + 1e-6
    away = re.sub(pattern, lambda match: f"{match[1]}{float(match[2]) + 0.02 / unit:.4f}{match[3]}", text, count=1)
    assert any(said in words for words in chosen.differences(plan, files | {name: away}))


@pytest.mark.slow
def test_headers_say_where_the_arm_stands_on_its_rail(plan: Plan) -> None:
    """URDF of the track: the arm's base is 300 mm above its own."""
    T = plan.cell.T_world_base.copy()
    T[2, 3] += 0.3
    np.testing.assert_allclose(plan.cell.T_world_foot, T, atol=1e-12)
    for language, told in (("rapid", "! The robot's base on it"), ("krl", "; $ROBROOT on it")):
        lines = "".join(LANGUAGES[language].write(plan).values()).split("\n")
        (at,) = (i for i, line in enumerate(lines) if line.strip().startswith(told))
        place = [float(value) for value in re.findall(r"-?\d+\.\d+", lines[at + 1])[:3]]
        np.testing.assert_allclose(place, T[:3, 3] * 1e3, atol=1e-3)


@pytest.mark.parametrize("language", ("urscript", "axes"))
def test_languages_without_a_rail_say_so(language: str, tmp_path: Path) -> None:
    machine = "program: {machine: {flavour: linuxcnc, type: robot}}\nstrategy: sqp"
    changes = (*ON_TRACK, ("arm: irb140", "arm: ur5e"), ("strategy: sqp", machine))
    own = load_problem(write_small(tmp_path, *changes))
    reason = LANGUAGES[language].unsupported(ProblemSetup(own, build_cell(own)))
    assert reason is not None and "rail" in reason


@pytest.mark.slow
def test_a_slow_rail_is_searched_on_fewer_rungs(tmp_path: Path) -> None:
    """A rail that goes no faster than the nozzle follows a long bead, however densely that is sampled."""
    x = np.linspace(-1200.0, 1200.0, 2401)
    (tmp_path / "line.txt").write_text("".join(f"{at:.3f} -100 50 0 0 1\n" for at in x), encoding="utf-8")
    text = (str(PROBLEMS / "rail_panel.txt"), "line.txt")
    slow = ("  bed_mm", "  limits: {rail: {speed_mm_s: 100}}\n  bed_mm")
    found = solve_alone(problem(tmp_path, text, slow), "ladder")
    promises_kept(found)
    assert np.ptp(found.q[:, 0]) > 0.49
    assert found.metrics["at_speed_fraction"] > 0.5


# ----------------------------------------------------------------------------------------------------
# An arm that hangs from a gantry, over a panel that it reaches from no one place.

RIBS = """\
name: ribs
cell:
  arm: irb1600_12
  base: {robot: gantry_xy, free: [gantry_x, gantry_y], home_mm: {gantry_x: 1500, gantry_y: 1000}}
  nozzle: {tip_mm: [0, 0, 250], axis: [0, 0, 1], diameter_mm: 3}
  home_deg: [0, 0, 10, 0, 80, 0]
  bed_mm: [1500, 1000, 900]
layers:
  source: {waypoints: ribs.txt}
process:
  speed_mm_s: 80
  travel_speed_mm_s: 300
  bead: {width_mm: 4, height_mm: 1.5}
resolve: {roll_step_deg: 30, table_step_deg: 15, rung_mm: 40}
strategy: ladder
"""


@pytest.fixture(scope="module")
def hanging(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    folder = tmp_path_factory.mktemp("ribs")
    x = np.linspace(-1200.0, 1200.0, 600)
    y = 600.0 * np.sin(x / 1200.0 * np.pi)
    np.savetxt(folder / "ribs.txt", np.column_stack([x, y, 0 * x, 0 * x, 0 * x, 1 + 0 * x]), fmt="%.4f")
    (folder / "ribs.yaml").write_text(RIBS, encoding="utf-8")
    return solve_alone(load_problem(folder / "ribs.yaml"))


@pytest.mark.slow
def test_a_print_under_a_gantry_is_verified(hanging: Plan) -> None:
    promises_kept(hanging)
    assert hanging.joint_names[:2] == ("gantry_x", "gantry_y")
    assert np.ptp(hanging.q[:, 0]) > 0.2 and np.ptp(hanging.q[:, 1]) > 0.2
    assert hanging.metrics["at_speed_fraction"] > 0.99
    least = np.linalg.svd(hanging.cell.arm.jacobians(hanging.q[hanging.deposit])[:, :, 2:], compute_uv=False)[
        :, -1
    ].min()
    np.testing.assert_allclose(hanging.metrics["sigma_min"], least, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("language", PROGRAMS)
def test_programs_say_where_the_gantry_is(hanging: Plan, language: str) -> None:
    """Both axes are written and read back; a target that has one elsewhere is noticed."""
    chosen = LANGUAGES[language]
    files = chosen.write(hanging)
    assert chosen.differences(hanging, files) == []
    pattern, unit = {
        "rapid": (r"(MoveL \[\[.*\],\[\d+\.\d+,)(\d+\.\d+)(,9E9)", 1e-3),
        "krl": (r"(LIN .*,E2 )(\d+\.\d+)(\})", 1e-3),
        "joint_trajectory": (r'("positions":\[\d+\.\d+,)(\d+\.\d+)(,)', 1.0),
    }[language]
    ((name, text),) = ((name, text) for name, text in files.items() if re.search(pattern, text))
    places = [float(match[2]) * unit for match in re.finditer(pattern, text)]
    assert hanging.q[:, 1].min() - 1e-6 <= min(places) < max(places) <= hanging.q[:, 1].max() + 1e-6
    away = re.sub(pattern, lambda match: f"{match[1]}{float(match[2]) + 0.02 / unit:.4f}{match[3]}", text, count=1)
    assert chosen.differences(hanging, files | {name: away})


@pytest.fixture
def at_an_end(tmp_path: Path) -> Problem:
    """A short line in reach of the gantry's corner, where both of its axes are at home."""
    np.savetxt(tmp_path / "ribs.txt", [[x, 0.0, 0.0, 0.0, 0.0, 1.0] for x in range(-20, 20)], fmt="%.4f")
    corner = RIBS.replace(", home_mm: {gantry_x: 1500, gantry_y: 1000}", "")
    corner = corner.replace("bed_mm: [1500, 1000, 900]", "bed_mm: [600, 0, 900]").replace("rung_mm: 40", "rung_mm: 10")
    (tmp_path / "corner.yaml").write_text(corner, encoding="utf-8")
    return load_problem(tmp_path / "corner.yaml")


def test_an_axis_whose_home_is_an_end_rests_near_it(at_an_end: Problem) -> None:
    cell, tasks = build_cell(at_an_end), tasks_of(at_an_end, build_toolpath(at_an_end))
    assert (cell.home[:2] == cell.limits.q_min[:2]).all()
    found = _with_one_joint(cell, tasks, at_an_end.resolve, NOTHING, 1.0)
    (path,) = paths_of(cell, tasks, found)
    np.testing.assert_allclose(path.q[:, 1], cell.limits.room, atol=1e-5)


def test_a_place_is_rated_with_an_axis_at_rest_near_its_end(at_an_end: Problem) -> None:
    cell, tasks = build_cell(at_an_end), tasks_of(at_an_end, build_toolpath(at_an_end))
    assert score(cell, course_of(tasks, 10, np.radians(30.0), at_an_end.resolve.rung), 0.05) > 0.1


def test_an_axis_with_hardly_any_range_rests_in_its_middle(at_an_end: Problem) -> None:
    cell = build_cell(at_an_end)
    cell = replace(cell, limits=replace(cell.limits, q_max=np.append([0.05, 0.05], cell.limits.q_max[2:])))
    np.testing.assert_allclose(at_rest(cell), [0.025, 0.025])
    np.testing.assert_allclose(_rest_angles(cell, 1, np.radians(144.0), 1), [0.005, 0.025, 0.045])


def test_all_of_a_range_is_looked_at_from_an_end(at_an_end: Problem) -> None:
    """By postures drawn at random, and by the lattice at which the other axis rests, whose steps are a twelfth of it."""
    cell, (task,) = build_cell(at_an_end), tasks_of(at_an_end, build_toolpath(at_an_end))
    low, high = looked_at(cell)
    np.testing.assert_array_equal(low, cell.limits.q_min[:2])
    np.testing.assert_array_equal(high, cell.limits.q_max[:2])
    assert postures_drawn(cell, task, 20, 4_000)[:, 1].max() > 1.0  # of 2 m
    np.testing.assert_allclose(_rest_angles(cell, 0, np.radians(30.0), 1), 0.07 + 0.25 * np.arange(9), atol=1e-5)


def test_urscript_says_that_it_knows_no_gantry(tmp_path: Path) -> None:
    own = problem(tmp_path, (BASE, GANTRY), ("arm: irb1600_12 ", "arm: ur10e "))
    reason = LANGUAGES["urscript"].unsupported(ProblemSetup(own, build_cell(own)))
    assert reason is not None and "gantry_x" in reason


# ----------------------------------------------------------------------------------------------------
# A part on a table that slides past an arm, which reaches a half of it.

SLIDING = """\
name: slide
cell:
  arm: irb1600_12
  positioner: {robot: track_3m, base_mm: [-1500, 900, 0], free: [rail], home_mm: {rail: 1500}, part_mm: [0, 0, 60]}
  nozzle: {tip_mm: [0, 0, 250], axis: [0, 0, 1], diameter_mm: 3}
  home_deg: [90, 0, 10, 0, 80, 0]
layers:
  source: {waypoints: long.txt}
process:
  speed_mm_s: 80
  travel_speed_mm_s: 300
  bead: {width_mm: 4, height_mm: 1.5}
resolve: {roll_step_deg: 30, table_step_deg: 15, rung_mm: 40}
strategy: sqp
"""


def test_where_to_touch_on_a_table_that_slides(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "long.txt", [[x, 0, 0, 0, 0, 1] for x in (-200, 0, 200)])
    (tmp_path / "slide.yaml").write_text(SLIDING, encoding="utf-8")
    here = scene_of(load_problem(tmp_path / "slide.yaml"))
    places = reachable(here.cell, here.start, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    low, high = here.cell.limits.q_min[6], here.cell.limits.q_max[6]
    assert np.ptp(places.q) > 0.4 * (high - low)
    assert f", rail {places.q[0, 0] * 1e3:.0f} mm, nozzle" in place_words(here, places, 0, here.start)


def test_where_to_touch_from_a_track_that_has_to_be_driven_there(tmp_path: Path) -> None:
    """Both ends of a panel of 2.6 m, in whose middle the track is at home, and its middle from the track's end."""
    ends = np.array([[-1.25, 0.0, 0.0], [0.0, 0.0, 0.0], [1.25, 0.0, 0.0]])
    for home in (1500, 0):
        cell = build_cell(problem(tmp_path, ("{rail: 1500}", f"{{rail: {home}}}")))
        places = reachable(cell, Placement(cell.T_world_holder, np.zeros(3)), ends, np.tile([0.0, 0.0, 1.0], (3, 1)))
        np.testing.assert_array_equal(places.points, ends)


@pytest.fixture(scope="module")
def slid(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    folder = tmp_path_factory.mktemp("slide")
    x = np.linspace(-1200.0, 1200.0, 600)
    y = 60.0 * np.sin(x / 300.0 * np.pi)
    np.savetxt(folder / "long.txt", np.column_stack([x, y, 0 * x, 0 * x, 0 * x, 1 + 0 * x]), fmt="%.4f")
    (folder / "slide.yaml").write_text(SLIDING, encoding="utf-8")
    return solve_alone(load_problem(folder / "slide.yaml"))


@pytest.mark.slow
def test_a_print_on_a_table_that_slides_is_verified(slid: Plan) -> None:
    promises_kept(slid)
    assert slid.joint_names[-1] == "rail" and slid.cell.limits.sliding == (6,)
    assert np.ptp(slid.q[:, 6]) > 1.0
    assert slid.metrics["at_speed_fraction"] > 0.99
    assert slid.metrics["rail_margin_mm"] > 100.0
    joints = json.loads(plan_json(slid))["cell"]["joints"]
    assert [(joint["type"], joint["moves"]) for joint in joints[5:]] == [("revolute", "nozzle"), ("prismatic", "part")]


@pytest.mark.slow
@pytest.mark.parametrize("language", PROGRAMS)
def test_programs_say_where_the_table_is(slid: Plan, language: str) -> None:
    chosen = LANGUAGES[language]
    files = chosen.write(slid)
    assert chosen.differences(slid, files) == []
    pattern, unit = {
        "rapid": (r"(MoveL \[\[.*\],\[)(\d+\.\d+)(,9E9)", 1e-3),
        "krl": (r"(LIN .*,E1 )(\d+\.\d+)(\})", 1e-3),
        "joint_trajectory": (r'("positions":\[(?:-?\d+\.\d+,){6})(\d+\.\d+)(\])', 1.0),
    }[language]
    ((name, text),) = ((name, text) for name, text in files.items() if re.search(pattern, text))
    places = [float(match[2]) * unit for match in re.finditer(pattern, text)]
    assert slid.q[:, 6].min() - 1e-4 <= min(places) < max(places) <= slid.q[:, 6].max() + 1e-4
    away = re.sub(pattern, lambda match: f"{match[1]}{float(match[2]) + 0.02 / unit:.4f}{match[3]}", text, count=1)
    assert chosen.differences(slid, files | {name: away})


def test_fixed_holds_the_rail_where_it_was_searched(tmp_path: Path) -> None:
    """The range of 3 m is spread over the grid's circle, 24 steps of 15 deg."""
    line = "".join(f"{x} 0 50 0 0 1\n" for x in range(-100, 101, 5))
    (tmp_path / "line.txt").write_text(line, encoding="utf-8")
    own = problem(tmp_path, (str(PROBLEMS / "rail_panel.txt"), "line.txt"))
    (path,) = fixed(build_cell(own), tasks_of(own, build_toolpath(own)), own.resolve)
    assert np.ptp(path.q[:, 0]) == 0.0
    np.testing.assert_allclose(np.remainder(path.q[0, 0] / (3.0 / 24), 1.0), 0.0, atol=1e-9)


@pytest.fixture
def short_slide(tmp_path: Path) -> Problem:
    """A short line on the table that slides."""
    np.savetxt(tmp_path / "long.txt", [[x, 0.0, 0.0, 0.0, 0.0, 1.0] for x in range(-20, 20)], fmt="%.4f")
    (tmp_path / "slide.yaml").write_text(SLIDING, encoding="utf-8")
    return load_problem(tmp_path / "slide.yaml")


def test_a_refusal_judges_postures_with_the_table_where_it_was_searched(short_slide: Problem) -> None:
    cell, settings = build_cell(short_slide), short_slide.resolve
    tasks = tasks_of(short_slide, build_toolpath(short_slide))
    demand, grid = coarse_grid(cell, tasks, settings)
    q = _postures_at(cell, demand, grid, 1, settings.min_sigma)
    tips = cell.T_part_nozzle(q)[:, :3, 3]
    np.testing.assert_allclose(tips, np.tile(demand.tip[demand.rung[1]], (len(q), 1)), atol=1e-6)
    assert np.ptp(q[:, -1]) > 0.5


def test_a_post_stands_in_the_way_of_a_part_that_slides(short_slide: Problem) -> None:
    cell = build_cell(short_slide)
    aside = cell.home + [*np.zeros(6), 0.5]
    post = Body("post", Box((0.1, 0.1, 0.02)), cell.holder.poses(aside[None, 6:])[0])
    obstacles = obstacles_of(short_slide, replace(cell, fixtures=(post,)), build_toolpath(short_slide))
    margin, which = obstacles.margins(np.stack([cell.home, aside]), np.full(2, 2.0), np.inf)
    assert margin[0] > 0.0 > margin[1]
    assert obstacles.names(int(which[1])) == ("post", PART)


def test_a_slide_lengthens_what_turns_before_it(tmp_path: Path) -> None:
    """The bound of how far anything moves, against postures: a table turns and slides, its foot on a column."""
    text = SLIDING.replace("track_3m, base_mm: [-1500, 900, 0], free: [rail], home_mm: {rail: 1500}", FAR_TABLE)
    (tmp_path / "far.urdf").write_text(FAR, encoding="utf-8")
    (tmp_path / "far.yaml").write_text("name: far\nurdf: far.urdf\ntip: plate\n" + FAR_LIMITS, encoding="utf-8")
    (tmp_path / "slide.yaml").write_text(text, encoding="utf-8")
    np.savetxt(tmp_path / "long.txt", [[x, 0.0, 0.0, 0.0, 0.0, 1.0] for x in range(-20, 20)], fmt="%.4f")
    own = load_problem(tmp_path / "slide.yaml")
    cell = build_cell(own)
    assert (cell.joint_names[6:], cell.limits.sliding) == (("swing", "out"), (7,))
    swing = obstacles_of(own, cell, build_toolpath(own)).swing[6:]
    ends = np.stack([cell.home, cell.home])
    ends[1, 6] += 1e-3
    ends[:, 7] = cell.limits.q_max[7]
    a, b = cell.holder.poses(np.ascontiguousarray(ends[:, 6:]))[:, :3, 3]
    assert 1e-3 * swing[0] >= np.linalg.norm(b - a) > 1e-3 * 2.0
    assert swing[1] == 1.0
    bodies = CellBodies.of(cell)
    plate = next(thing for thing in bodies.things if "plate" in thing.name)
    assert 1e-3 * bodies.swing(plate)[6] >= np.linalg.norm(b - a)


@pytest.mark.slow
def test_slopes_along_a_path_are_those_of_differences(plan: Plan) -> None:
    """Of joints and of the least singular value, by roll, rotation and rail."""
    model, path = model_of(plan.cell), plan.paths[0]
    some = slice(100, 160)
    z = free_variables(model, path)[some]
    active = model.active(path.task.cones)
    assert z.shape[1] == 5 and active.tolist() == [0, 3, 4]

    def at(z: Array) -> PosturesFollowed:
        n, nj, m = len(z), path.q.shape[1], len(active)
        out = PosturesFollowed(
            path.q[some].copy(), np.empty((n, nj, m)), np.empty(n), np.empty((n, m)), np.empty((n, 3, 2)),
            np.empty((n, 3, 2, m)),
        )  # fmt: skip
        tip, frames = np.ascontiguousarray(path.task.tip[some]), np.ascontiguousarray(path.task.frames[some])
        normals = np.ascontiguousarray(path.task.normals[some])
        assert follow(model.numbers, model.holder, model.given, tip, frames, normals, z, active, out) == -1
        return out

    here = at(z)
    J = plan.cell.arm.jacobians(np.ascontiguousarray(here.q[:, :7]))[:, :, 1:]
    np.testing.assert_allclose(here.sigma, np.linalg.svd(J, compute_uv=False)[:, -1], rtol=1e-6)
    for c, column in enumerate(active):
        step = np.zeros(5)
        step[column] = 1e-5
        after, before = at(z + step), at(z - step)
        np.testing.assert_allclose(here.G[:, :, c], (after.q - before.q) / 2e-5, atol=1e-6)
        np.testing.assert_allclose(here.sigma_slope[:, c], (after.sigma - before.sigma) / 2e-5, atol=1e-4)


@pytest.mark.slow
def test_slopes_of_clearance_are_those_of_differences(plan: Plan) -> None:
    """How the nearest distance of anything changes with the rail, and with all other joints."""
    table = obstacles_of(plan.problem, plan.cell, plan.toolpath).table
    q = np.ascontiguousarray(plan.q[:: max(len(plan.q) // 12, 1)])
    n, nj = q.shape

    def at(q: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        margin, slope = np.empty((n, ROWS)), np.empty((n, ROWS, nj))
        which = np.empty((n, ROWS), dtype=np.int64)
        nearest_margins(table, q, np.zeros(n), np.ones(n, dtype=np.bool_), 1.0, 1.0, margin, slope, which)
        return margin, slope, which

    _, slope, which = at(q)
    compared = 0
    for j in range(nj):
        step = np.zeros(nj)
        step[j] = 1e-5
        (after, _, same), (before, _, too) = at(q + step), at(q - step)
        known = (which >= 0) & (which == same) & (which == too)
        off = np.abs((after - before) / 2e-5 - slope[:, :, j])[known]
        assert np.median(off) < 1e-4
        compared += int(known.sum())
    assert compared > 20
    assert np.abs(slope[:, :, 0]).max() > 0.1


@pytest.mark.parametrize(("beyond", "fails"), [(-1e-3, False), (1e-3, True)])
def test_programs_ask_a_rail_for_no_place_beyond_its_end(tmp_path: Path, beyond: float, fails: bool) -> None:
    made = problem(tmp_path)
    (tmp_path / "corrections.csv").write_text("bead,s_mm,dx_mm,dy_mm,dz_mm\n", encoding="utf-8")
    learned = AsRunSpec.model_construct(corrections=tmp_path / "corrections.csv", most=1e-3)
    cell, toolpath = build_cell(made), build_toolpath(made)
    q = np.tile(cell.home, (9, 1))
    q[4, 0] = cell.limits.q_max[0] + beyond
    T, none, travel = cell.T_part_nozzle(q), np.zeros(9), np.full(9, TRAVEL, dtype=np.int32)
    still = Trajectory(
        dt=0.004, t=0.004 * np.arange(9), bead=travel, layer=np.zeros(9, dtype=np.int32), deposit=travel >= 0, s=none, q=q,
        tip=T[:, :3, 3].copy(), quat=np.zeros((9, 4)), axis=T[:, :3, 2].copy(), branch=none.astype(np.int8), speed=none,
        flow=none, extruded=none, feed=none,
    )  # fmt: skip
    found = as_run(made.model_copy(update={"as_run": learned}), cell, toolpath, still, still)
    (check,) = (check for check in found.checks if check.name == "asked rail range")
    assert check.ok != fails
    assert check.worst == pytest.approx(-beyond * 1e3)
