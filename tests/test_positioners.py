"""Whatever holds the part: nothing, one axis, two axes, a second arm; and arms that are no ABB arms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from solved import solve_alone

from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.cell.cell import Cell, build_cell
from planner.export.languages import LANGUAGES, chosen
from planner.export.plan_json import cell_screws
from planner.export.rapid.reader import read_rapid, read_rapid_files
from planner.export.rapid.writer import rapid, rapid_files
from planner.export.write import write_robot_code
from planner.plan import Plan
from planner.problem import Problem, load_problem
from planner.report.summary import print_summary
from planner.resolve.ladder import guide_route, ladder
from planner.resolve.table_path import _angles
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import make_tasks, tasks_of
from planner.verify.executed import executed_motion
from planner.verify.verdict import verify

JOINTS = tuple(f"joint_{i}" for i in range(1, 7))
# The second arm reaches towards the first one, its flange leaning back from upright: a wrist bent and a part in reach.
HOLD = dict(zip(JOINTS, (0, 10, 50, 0, -80, 0), strict=True))
NOZZLE = "{tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}"
ABB = f"  arm: irb1200_07\n  nozzle: {NOZZLE}\n  home_deg: [0, 0, 0, 0, 45, 0]\n"
A250 = "  positioner: {robot: irbp_a250, origin_mm: [550, 0, 300], part_mm: [10, 5, 20], free: [%s]}\n"
OTHERS = {
    "ur5": ("[180, -90, 90, -90, -90, 0]", "[450, 0, 100]"),
    "panda": ("[0, -30, 0, -120, 0, 100, 45]", "[450, 0, 200]"),
    "iiwa": ("[0, 30, 0, -80, 0, 60, 0]", "[550, 0, 250]"),
}


def second_arm(free: tuple[str, ...], **hold: float) -> str:
    """The cell whose part is held by an IRB 1200 that faces the arm, its joints free or held as `HOLD` says."""
    angles = HOLD | hold
    home = ", ".join(f"{name}: {angles[name]}" for name in free)
    held = ", ".join(f"{name}: {angles[name]}" for name in JOINTS if name not in free)
    return ABB + (
        "  positioner:\n    robot: irb1200_07\n    base_mm: [900, 20, -10]\n    turn_deg: 170\n"
        f"    free: [{', '.join(free)}]\n    home_deg: {{{home}}}\n    held_deg: {{{held}}}\n"
        "    part_mm: [5, -3, 20]\n    part_rpy_deg: [10, -20, 30]\n"
    )


CELLS = {
    "bed": ABB + "  bed_mm: [550, 0, 300]\n",
    "bed_turned": ABB + "  bed_mm: [540, 20, 300]\n  bed_rpy_deg: [10, -8, 25]\n",
    "one": ABB + A250 % "rotation",
    "two": ABB + A250 % "tilt, rotation",
    "arm_held": second_arm(()),
    "arm_some": second_arm(("joint_1", "joint_5", "joint_6")),
    "arm_all": second_arm(JOINTS),
    **{
        arm: f"  arm: {arm}\n  nozzle: {NOZZLE}\n  home_deg: {home}\n  bed_mm: {bed}\n"
        for arm, (home, bed) in OTHERS.items()
    },
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the waypoints of a short wave on a plane."""
    keep = tmp_path_factory.mktemp("positioners")
    t = np.linspace(0.0, 1.0, 61)
    points = np.column_stack([40 * t - 20, 6 * np.sin(2 * np.pi * t)])
    (keep / "wave.txt").write_text("".join(f"{x:.4f} {y:.4f} 0 0 0 1\n" for x, y in points))
    return keep


def problem_of(folder: Path, cell: str, *overrides: str) -> Problem:
    path = folder / "case.yaml"
    path.write_text(
        f"""\
name: wave
cell:
{cell}layers:
  source: {{waypoints: wave.txt}}
process:
  speed_mm_s: 20
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
resolve: {{roll_step_deg: 30, table_step_deg: 30, rung_mm: 5}}
strategy: sqp
"""
    )
    return load_problem(path, overrides)


@cache
def plan_of(folder: Path, name: str) -> Plan:
    return solve_alone(problem_of(folder, CELLS[name]))


def test_a_tilt_at_home_at_the_end_of_a_narrow_range_stays_there(folder: Path) -> None:
    """No other angle of the lattice at which it may rest is within 20 deg."""
    problem = problem_of(folder, CELLS["two"] + "  limits: {tilt: {range_deg: [0, 20]}}\n")
    cell = build_cell(problem)
    found = guide_route(cell, tasks_of(problem, build_toolpath(problem)), problem.resolve)
    assert found.chosen(2)[:, 0].max() < 1e-5


def random_postures(cell: Cell, m: int) -> Array:
    low, high = np.maximum(cell.limits.q_min, -np.pi), np.minimum(cell.limits.q_max, np.pi)
    return np.random.default_rng(5).uniform(low, high, (m, len(low)))


def flange(model: pin.Model, tip: str, q: Array) -> pin.SE3:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(tip)]


# Placement


@pytest.mark.slow(keep=("free2",))
@pytest.mark.parametrize("free", [JOINTS, ("joint_1", "joint_5", "joint_6"), ()])
def test_a_second_arm_carries_the_part_as_pinocchio_says(folder: Path, free: tuple[str, ...]) -> None:
    cell = build_cell(problem_of(folder, second_arm(free)))
    x, y, z = np.radians([10.0, -20.0, 30.0])
    turned = pin.utils.rotate("z", z) @ pin.utils.rotate("y", y) @ pin.utils.rotate("x", x)
    base = pin.SE3(pin.utils.rotate("z", np.radians(170.0)), np.array([0.9, 0.02, -0.01]))
    on_flange = pin.SE3(turned, np.array([0.005, -0.003, 0.02]))
    nozzle = pin.SE3(pin.utils.rotate("y", np.radians(45.0)), np.array([0.0, 0.0, 0.1]))
    q = random_postures(cell, 20)
    seen = cell.T_part_nozzle(q)
    motion = executed_motion(cell, replace_trajectory(plan_of(folder, "bed"), q).trajectory)
    for k, row in enumerate(q):
        held = np.radians([HOLD[name] for name in JOINTS])
        held[[JOINTS.index(name) for name in free]] = row[6:]
        T_world_part = base * flange(cell.holder_robot.model, "tool0", held) * on_flange
        T_world_nozzle = flange(cell.arm_robot.model, "tool0", row[:6]) * nozzle
        expected = (T_world_part.inverse() * T_world_nozzle).homogeneous
        np.testing.assert_allclose(seen[k], expected, atol=1e-9)
        np.testing.assert_allclose(motion.tip[k], expected[:3, 3], atol=1e-9)
        np.testing.assert_allclose(motion.rotation[k], expected[:3, :3], atol=1e-9)


def replace_trajectory(plan: Plan, q: Array) -> Plan:
    """The plan with other joints in its first samples, and no others; poses are not brought along."""
    values = vars(plan.trajectory).items()
    rows = {name: value[: len(q)] if isinstance(value, np.ndarray | tuple) else value for name, value in values}
    return replace(plan, trajectory=replace(plan.trajectory, **(rows | {"q": q})))


def test_a_turned_positioner_keeps_its_plate_where_it_is(folder: Path) -> None:
    straight, turned = (
        build_cell(problem_of(folder, CELLS["two"], f"cell.positioner.turn_deg={deg}")) for deg in (0, 90)
    )
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    plate, part = np.array([0.55, 0.0, 0.3]), np.array([0.01, 0.005, 0.02])
    np.testing.assert_allclose(straight.T_world_holder[:3, 3], plate + part, atol=1e-12)
    np.testing.assert_allclose(turned.T_world_holder[:3, 3], plate + quarter @ part, atol=1e-12)
    q = random_postures(straight, 10)[:, 6:]
    one, other = straight.holder.poses(q), turned.holder.poses(q)
    np.testing.assert_allclose(other[:, :3, :3], quarter @ one[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(other[:, :3, 3] - plate, (one[:, :3, 3] - plate) @ quarter.T, atol=1e-12)


def test_joints_of_two_arms_of_one_kind_are_told_apart(folder: Path) -> None:
    limits = "cell.limits={positioner_joint_2: {speed_deg_s: 7}, joint_2: {speed_deg_s: 9}}"
    cell = build_cell(problem_of(folder, CELLS["arm_all"], limits))
    assert len(set(cell.joint_names)) == 12
    np.testing.assert_allclose(np.degrees(cell.limits.velocity[[1, 7]]), [9.0, 7.0])
    np.testing.assert_allclose(np.degrees(cell.home[6:]), list(HOLD.values()))
    screws = cell_screws(cell)
    assert [joint["name"] for joint in screws["joints"]] == list(cell.joint_names)
    np.testing.assert_allclose(screws["T_world_part_zero"], cell.T_world_holder, atol=1e-11)


@pytest.mark.parametrize(
    ("override", "field", "words"),
    [
        ("cell.positioner.origin_mm=[0, 0, 0]", "origin_mm", "exactly one"),
        ("cell.positioner.base_mm=null", "cell.positioner", "neither origin_mm nor base_mm"),
        ("cell.positioner.turn_deg=400", "turn_deg", "-360 to 360"),
        ("cell.positioner.part_rpy_deg=[0, 0]", "part_rpy_deg", "3 numbers"),
        ("cell.positioner.home_deg={joint_7: 0}", "home_deg", "no axis 'joint_7'"),
        ("cell.positioner.home_deg={joint_2: 0}", "home_deg.joint_2", "held_deg"),
        ("cell.positioner.home_deg={joint_1: 171}", "home_deg.joint_1", "-170 to 170"),
        ("cell.positioner.held_deg={joint_2: 136}", "held_deg.joint_2", "-100 to 135"),
        (
            "cell.positioner={robot: panda, base_mm: [1200, 0, 0], free: []}",
            "held_deg.panda_joint4",
            "0, its default, is outside its range (-176 to -4 deg)",
        ),
        (
            "cell.limits={positioner_joint_2: {range_mm: [0, 10]}}",
            "cell.limits.positioner_joint_2",
            "this joint turns",
        ),
        ("cell.limits={joint_8: {speed_deg_s: 7}}", "cell.limits.joint_8", "no such joint"),
    ],
)
def test_mistakes_are_told_with_their_field(folder: Path, override: str, field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        build_cell(problem_of(folder, CELLS["arm_some"], override))
    assert field in str(caught.value)
    assert words in str(caught.value)


def test_a_held_axis_may_have_a_range_of_ones_own(folder: Path) -> None:
    beyond = "cell.positioner.held_deg={joint_2: 136}"
    own = "cell.limits={positioner_joint_2: {range_deg: [-100, {}]}}"
    cell = build_cell(problem_of(folder, CELLS["arm_some"], beyond, own.replace("{}", "140")))
    assert cell.held["joint_2"] == pytest.approx(np.radians(136.0))
    with pytest.raises(InputError, match="-100 to 120 deg"):
        build_cell(problem_of(folder, CELLS["arm_some"], beyond, own.replace("{}", "120")))


# Plans


@pytest.mark.slow
@pytest.mark.parametrize("name", CELLS)
def test_every_kind_of_cell_prints_a_verified_wave(folder: Path, name: str) -> None:
    plan = plan_of(folder, name)
    assert [check.name for check in plan.checks if not check.ok] == []
    assert plan.strategy == "sqp"
    assert plan.metrics["at_speed_fraction"] > 0.9
    assert plan.trajectory.q.shape[1] == len(plan.cell.joint_names)
    assert ("wrist_margin_deg" in plan.metrics) == (len(plan.cell.arm) == 6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one", "two", "arm_some", "arm_all"])
def test_what_moves_the_part_reads_back_from_rapid(folder: Path, name: str) -> None:
    plan = plan_of(folder, name)
    files = rapid_files(plan)
    program = read_rapid_files(files)
    cell, axes = plan.cell, plan.cell.holder_robot.joint_names
    assert np.isnan(program.start[6 + len(axes) :]).all()
    for k, axis in enumerate(axes):
        if axis in cell.held:
            expected = cell.held[axis]
        else:
            expected = plan.trajectory.q[0, 6 + cell.holder.names.index(axis)]
        assert program.start[6 + k] == pytest.approx(expected, abs=1e-5)
    np.testing.assert_allclose(program.oframe[:3], cell.T_plate_part[:3, 3], atol=1e-6)
    text = files["Wave.mod"]
    assert ("MultiMove" in text) == ("Wave_Rob2.mod" in files) == name.startswith("arm")
    assert (f"eax_{'abcdef'[len(axes) - 1]} {axes[-1]}" in text) == (cell.second_arm is None)


@pytest.mark.slow
def test_a_turned_bed_stands_in_every_export(folder: Path, tmp_path: Path) -> None:
    plan = plan_of(folder, "bed_turned")
    x, y, z = np.radians([10.0, -8.0, 25.0])
    T_world_part = np.eye(4)
    T_world_part[:3, :3] = pin.utils.rotate("z", z) @ pin.utils.rotate("y", y) @ pin.utils.rotate("x", x)
    T_world_part[:3, 3] = [0.54, 0.02, 0.3]
    np.testing.assert_allclose(plan.cell.T_world_holder, T_world_part, atol=1e-12)
    np.testing.assert_allclose(plan.cell.T_world_holder_base, T_world_part, atol=1e-12)
    np.testing.assert_allclose(cell_screws(plan.cell)["T_world_part_zero"], T_world_part, atol=1e-11)
    program = read_rapid(rapid(plan))
    np.testing.assert_allclose(program.uframe[:3], T_world_part[:3, 3], atol=1e-6)
    np.testing.assert_allclose(pin.Quaternion(program.uframe[3:]).matrix(), T_world_part[:3, :3], atol=1e-6)
    np.testing.assert_allclose(program.oframe, [0, 0, 0, 0, 0, 0, 1], atol=0)
    # where flange and nozzle really are, part frame by part frame: a bead's first point, by Pinocchio alone
    q = plan.trajectory.q[np.argmax(plan.trajectory.deposit)]
    T_world_nozzle = flange(plan.cell.arm_robot.model, "tool0", q).homogeneous @ plan.cell.T_flange_nozzle
    first = (np.linalg.inv(T_world_part) @ T_world_nozzle)[:3, 3]
    assert np.linalg.norm(plan.toolpath.beads[0].points - first, axis=1).min() < 1e-3
    write_robot_code(plan, tmp_path)  # compares before it writes


@pytest.mark.slow
def test_robot_code_of_a_second_arm_repeats_the_plan(folder: Path, tmp_path: Path) -> None:
    written = write_robot_code(plan_of(folder, "arm_all"), tmp_path)  # compares before it writes
    both = ["Wave.mod", "Wave_Rob2.mod", "Wave.pgf", "Wave_Rob2.pgf"]
    assert [path.name for path in written] == [*both, "extrusion.gcode"]


def test_a_second_arm_need_not_start_where_it_can_work(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(folder, second_arm(JOINTS, joint_1=60, joint_2=-60, joint_3=-60))
    cell, toolpath = build_cell(problem), build_toolpath(problem)
    tasks = make_tasks(toolpath, problem.process.speed, problem.process.run_in)
    paths = ladder(cell, tasks, problem.resolve)
    away = np.degrees(np.abs(paths[0].q[0, 6:] - cell.home[6:]).max())
    assert away > 5.0
    monkeypatch.setattr(import_module("planner.resolve.ladder"), "_DRAWN", 0)
    with pytest.raises(Refusal, match="reach"):
        ladder(cell, tasks, problem.resolve)


@pytest.mark.parametrize("axis", range(6))
def test_the_lattice_of_a_held_layer_keeps_off_the_ends_of_an_axis(folder: Path, axis: int) -> None:
    limits = "cell.limits={positioner_joint_1: {range_deg: [-1, 2]}}"
    cell = build_cell(problem_of(folder, CELLS["arm_all"], limits))
    angles, turns = _angles(cell, axis, np.radians(5.0))
    low, high = cell.limits.q_min[6 + axis], cell.limits.q_max[6 + axis]
    if turns:
        assert high - low >= 2 * np.pi
    else:
        assert low < angles.min() <= angles.max() < high
        assert np.diff(angles).max() <= np.radians(5.0) + 1e-12


@pytest.mark.slow
def test_a_second_arm_holds_the_layer_upright(folder: Path) -> None:
    free = plan_of(folder, "arm_all")
    assert lean_of(free) > 10.0
    plan = solve_alone(problem_of(folder, CELLS["arm_all"], "process.cones={layer_gravity_deg: 10}"))
    assert plan.verified
    assert lean_of(plan) < 10.05


def lean_of(plan: Plan) -> float:
    """The greatest angle [deg] of the printed plane's normal from the vertical."""
    q = plan.trajectory.q[plan.trajectory.deposit]
    normal = plan.cell.holder.poses(q[:, len(plan.cell.arm) :])[:, :3, 2]
    return float(np.degrees(np.arccos(normal[:, 2].min())))


# Arms that are not ABB's


@pytest.mark.slow
@pytest.mark.parametrize("arm", OTHERS)
def test_arms_that_do_not_speak_rapid_get_the_language_that_they_speak(
    folder: Path, tmp_path: Path, arm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_of(folder, arm)
    if arm == "ur5":
        own, title = ["Wave.script"], "URScript"
    else:
        own, title = ["wave_joint_trajectory.json", "wave_extruder.json"], "ROS JointTrajectory"
    assert [path.name for path in write_robot_code(plan, tmp_path)] == [*own, "extrusion.gcode"]
    foretold = {"forecast.json"} if title == "URScript" else set()
    assert {path.name for path in tmp_path.iterdir()} == {*own, "extrusion.gcode"} | foretold
    print_summary(replace(plan, timing_s={"total": 1.0}), tmp_path, chosen(plan).words)
    assert f"; programs: {title}, the extruder's G-code;" in " ".join(capsys.readouterr().out.split())
    with pytest.raises(ValueError, match="spherical wrist"):
        LANGUAGES["rapid"].write(plan)


@pytest.mark.slow
@pytest.mark.parametrize("arm", OTHERS)
def test_another_branch_is_noticed_on_every_kind_of_arm(folder: Path, arm: str) -> None:
    plan = plan_of(folder, arm)
    cell, t = plan.cell, plan.trajectory
    joint = cell.inverse.redundant_joint
    T_base_flange = (
        np.linalg.inv(cell.T_world_base) @ cell.arm.poses(t.q) @ np.linalg.inv(cell.T_flange_nozzle)
    )  # fmt: skip
    solutions, exists = cell.inverse.solve(T_base_flange, None if joint is None else t.q[:, joint])
    own = int(t.branch[t.deposit][0])
    half = np.flatnonzero(t.deposit)[t.deposit.sum() // 2]
    tried = 0
    for branch in range(cell.inverse.branch_count):
        # neighbours in the numbering differ by one bit: one singularity lies between
        if bin(branch ^ own).count("1") != 1 or not exists[half:, branch].all():
            continue
        q = t.q.copy()
        q[half:] = solutions[half:, branch]
        report = verify(plan.problem, cell, plan.toolpath, replace(t, q=q))
        check = next(check for check in report.checks if check.name == "branch changes in deposition")
        assert not check.ok
        poses = next(check for check in report.checks if check.name == "recorded poses")
        assert poses.ok
        tried += 1
    assert tried
