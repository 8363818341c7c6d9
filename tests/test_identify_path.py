"""How a recorded run leaves its program's path: simulated controllers with known corners, lag, ramps and look-ahead; other
runs refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recordings import Recording, executed_run, write_recording
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, InputError, OutputError
from planner.cell.robot import read_robot
from planner.export.controllers import CONTROLLERS
from planner.export.krl import to_kuka
from planner.export.languages import LANGUAGES
from planner.export.player.model import ABB, MotionModel
from planner.export.player.play import play
from planner.feedback.identify_command import main
from planner.feedback.identify_findings import findings
from planner.feedback.identify_path import CommandedPath, FollowedPath, ShownValue, follow, off_commands
from planner.feedback.identify_robot_file import robots_of, write_controller
from planner.feedback.identify_run import (
    PlannedRun,
    path_of_program,
    path_of_samples,
    planned_run,
    recorded_run,
)
from planner.feedback.readings import counting, run_starts
from planner.feedback.recordings import read_log
from planner.plan import Plan
from planner.plan.seal import sealed
from planner.planning.files import write
from planner.planning.pipeline import solve
from tests.identify_fixtures import cell_of, table_text
from tests.solved import small_plan, small_problem
from tests.test_player import CELL, program_through

NOISE = np.radians(0.01)
RPI = Path(__file__).resolve().parents[2] / "shared" / "data" / "rpi"
ZIGZAG = np.array([[0.0, 0.009 * k, 0.03 * (k % 2)] for k in range(1, 25)])
ZONES = np.tile([0.5e-3, 2e-3, 5e-3, 5e-3], 6)
JOINTS = MotionModel("joints alone", lag=0.0197, depth=0.87)


def dense(*moves: float, length: float = 0.06) -> tuple[Array, list[int]]:
    """Targets of lines to and fro, each in moves of one length [m], and those at which the robot rests."""
    y, side, points, stops = 0.0, 1.0, [], []
    for move in moves:
        for _ in range(round(length / move)):
            y += side * move
            points.append([0.0, y, 0.0])
        stops.append(len(points) - 1)
        side = -side
    return np.array(points), stops


def run_of(
    points: Array, model: MotionModel, noise: float = NOISE, rests: tuple[int, ...] = (), cell=CELL, **program
) -> tuple[CommandedPath, FollowedPath]:
    """A path, and what an arm of a model has done along it."""
    wait = np.zeros(len(points))
    wait[list(rests)] = 0.3
    asked = program_through(points, fine=rests, wait=wait, **program)
    played = play(asked, cell, model)
    t, q = executed_run(asked, played, model, noise=noise)
    path = path_of_program(asked, cell)
    return path, follow(path, t, q, cell)


# ---- deviation ----------------------------------------------------------------------------------------------------


def test_an_arm_that_keeps_to_the_path_shows_no_deviation():
    path, followed = run_of(ZIGZAG, MotionModel("exact", depth=0.0), speed=0.05, zone=ZONES)
    found = findings(path, followed)
    assert not found.tip.shown and found.tip.mean < 0.02e-3 < followed.noise
    assert followed.way[-1] == pytest.approx(np.linalg.norm(np.diff(path.tip, axis=0), axis=1).sum(), abs=1e-4)
    assert followed.noise == pytest.approx(np.linalg.norm(followed.off, axis=1).std(), rel=0.8)


def test_a_path_aside_is_that_far_off_whatever_the_noise():
    line, _ = dense(0.005)
    path, _ = run_of(line, ABB, speed=0.05)
    shifted = replace(path, tip=path.tip + [0.0, 0.0, 4e-4], q=path.q)
    asked = program_through(line, speed=0.05)
    for noise in (0.0, NOISE):
        t, q = executed_run(asked, play(asked, CELL, ABB), ABB, noise=noise)
        found = findings(shifted, follow(shifted, t, q, CELL))
        assert found.tip.mean == pytest.approx(4e-4, rel=0.03) and found.tip.most >= 0.9 * found.tip.mean


def test_joints_are_told_apart():
    line, _ = dense(0.005)
    path, _ = run_of(line, ABB, speed=0.05)
    asked = program_through(line, speed=0.05)
    t, q = executed_run(asked, play(asked, CELL, ABB), ABB, noise=0.0)
    q[:, 5] += np.radians(0.2)
    joints = findings(path, follow(path, t, q, CELL)).joints
    assert joints[5].mean == pytest.approx(np.radians(0.2), rel=0.02)
    assert all(each.most < np.radians(0.03) for each in joints[:5])


def test_a_way_there_and_back_is_followed_in_order():
    points, rests = dense(0.8e-3, 1.5e-3, 3e-3)
    _, followed = run_of(points, ABB, speed=0.1, rests=tuple(rests))
    assert followed.way[-1] == pytest.approx(0.18, abs=2e-4)
    stands = np.histogram(followed.way, np.array([-1.0, 59.5, 60.5, 119.5, 120.5, 181.0]) * 1e-3)[0]
    assert stands[1] > 70 and stands[3] > 70  # rests of 0.3 s at 60 and 120 mm


@pytest.mark.parametrize("late", [0.0, 0.04, 0.2])
def test_how_far_joints_leave_their_commands_does_not_count_how_late_they_are(late: float):
    points, rests = dense(0.8e-3, 1.5e-3)
    program = program_through(points, speed=0.1, fine=rests)
    played = play(program, CELL, ABB)
    t, told = executed_run(program, played, ABB, noise=0.0)
    done = np.column_stack([np.interp(t - late, t, column) for column in told.T])
    noise = np.random.default_rng(1).normal(0.0, NOISE, done.shape)
    tip, joints = off_commands(t, done + noise, told, CELL)
    assert not tip.shown and not any(each.shown for each in joints)
    done[:, 1] += np.radians(0.3) * (t > 1.5)
    tip, joints = off_commands(t, done + noise, told, CELL)
    assert joints[1].most == pytest.approx(np.radians(0.3), rel=0.15)
    assert tip.most > 1e-3


# ---- corners ------------------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("speed", [0.04, 0.1])
def test_corners_show_depth_and_lag(speed: float):
    path, followed = run_of(ZIGZAG, ABB, speed=speed, zone=ZONES)
    found = findings(path, followed)
    assert [zone.zone for zone in found.corners] == pytest.approx([0.5e-3, 2e-3, 5e-3])
    assert found.corners[0].mean < found.corners[1].mean < found.corners[2].mean
    assert found.depth.told and found.depth.value == pytest.approx(ABB.depth, rel=0.15)
    assert found.lag.told and found.lag.value == pytest.approx(ABB.lag, abs=4e-3)
    assert found.tip.shown and found.tip.most < found.corners[2].most


def test_corners_of_one_kind_do_not_tell_depth_from_lag():
    path, followed = run_of(ZIGZAG, ABB, speed=0.1, zone=np.full(24, 0.3e-3))
    found = findings(path, followed)
    assert len(found.corners) == 1 and not found.depth.told and "do not show" in found.depth.reason
    assert found.lag.value == pytest.approx(ABB.lag, abs=4e-3)


def test_without_corners_nothing_is_told_of_them():
    line, _ = dense(0.005)
    found = findings(*run_of(line, ABB, speed=0.05))
    assert found.corners == () and not found.depth.told and not found.lag.told


# ---- braking and look-ahead ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_how_long_before_a_stop_it_brakes(noise: float):
    points, rests = dense(0.02, 0.02, 0.02, 0.02, length=0.08)
    found = findings(*run_of(points, ABB, noise, tuple(rests), speed=0.1))
    (brakes,) = found.brakes
    assert brakes.count == 4 and brakes.speed == pytest.approx(0.1, rel=0.02)
    assert brakes.time == pytest.approx(ABB.ramp * 0.1 ** (1 / 3), abs=0.012)
    assert brakes.way == pytest.approx(0.5 * brakes.speed * brakes.time)


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("moves", [2, 3])
@pytest.mark.parametrize("model", [ABB, JOINTS], ids=lambda model: model.name)
def test_a_controller_that_knows_few_moves_ahead_shows_how_many(model: MotionModel, moves: int):
    slow = replace(CELL, limits=replace(CELL.limits, acceleration=0.15 * CELL.limits.acceleration))
    cell = slow if model is JOINTS else CELL
    points, rests = dense(0.8e-3, 1.5e-3)
    few = replace(model, ahead_moves=moves, move_time=0.0)
    ahead = findings(*run_of(points, few, NOISE, tuple(rests), cell, speed=0.15, zone=1e-3)).ahead
    # the model of ABB's controller slows down by steeper ramps than those by which it stops
    assert ahead.told and ahead.value == pytest.approx(moves, abs=1.5) and ahead.error >= 1.0


@pytest.mark.parametrize("moves", [10, 10**6])
def test_a_controller_that_knows_enough_shows_what_it_needs_at_least(moves: int):
    points, rests = dense(0.8e-3, 1.5e-3)
    ample = replace(ABB, ahead_moves=moves, move_time=0.0)
    ahead = findings(*run_of(points, ample, NOISE, tuple(rests), speed=0.15, zone=1e-3)).ahead
    assert not ahead.told and ahead.reason == "at least" and 3 < ahead.value <= 10


@pytest.mark.skipif(not RPI.is_dir(), reason="the public recordings are not here")
def test_a_real_robot_brakes_as_its_model_has_it():
    """An IRB 6640 at 1,100 mm/s; its targets are where it went, so that deviation says nothing (benchmarks/controller.py)."""
    from benchmarks.controller import cell_of_recordings, curves, recorded

    cell = cell_of_recordings()
    (recording,) = (each for each in curves(cell, RPI) if "curve 2" in each.name)
    t, q, tip = recorded(cell, RPI / "c2run0.csv")
    path = path_of_program(recording.program, cell)
    first = int(np.argmin(np.linalg.norm(tip - path.tip[0], axis=1)))
    found = findings(path, follow(path, t[first:], q[first:], cell))
    (brakes,) = found.brakes
    assert brakes.speed == pytest.approx(1.07, rel=0.03)
    assert brakes.time == pytest.approx(ABB.ramp * brakes.speed ** (1 / 3), rel=0.15)
    assert not found.ahead.told and found.ahead.value >= 3 and found.tip.most < 1.5e-3


def test_a_limit_of_each_move_is_no_look_ahead():
    """A controller that takes its time for each move is as far ahead on short moves as on longer ones, by one or two."""
    points, rests = dense(0.8e-3, 1.5e-3)
    ahead = findings(*run_of(points, replace(ABB, lag=0.03), NOISE, tuple(rests), speed=0.1, zone=1e-3)).ahead
    assert not ahead.told


@pytest.mark.slow
def test_a_corner_whose_samples_go_back_and_forth_is_passed_by():
    path, followed = run_of(ZIGZAG, ABB, speed=0.05, zone=ZONES)
    way = followed.way + 0.012 * np.sin(40.0 * followed.time)
    assert isinstance(findings(path, replace(followed, way=way)).corners, tuple)


# ---- recordings of plans ------------------------------------------------------------------------------------------


@cache
def planned() -> tuple[Plan, Array, Array]:
    """A plan, and how an arm has run its program: time and joints."""
    plan = small_plan()
    language = LANGUAGES["rapid"]
    program, cell = language.program(plan, language.write(plan)), language.plan(plan).cell
    t, q = executed_run(program, play(program, cell, ABB), ABB)
    return plan, t, q


def written(folder: Path, change: Callable[[Array, Array], tuple[Array, Array]] | None = None, unit="deg") -> Path:
    plan, t, q = planned()
    t, q = (t, q) if change is None else change(t.copy(), q.copy())
    scale = np.degrees(1.0) if unit == "deg" else 1.0
    head = ["t_s", *(f"{name}_deg" for name in plan.joint_names)]
    return write_recording(folder / "run.csv", Recording(t, q, q), head, scale)


def run_and_log(folder: Path, file: Path) -> tuple[PlannedRun, object]:
    plan, _, _ = planned()
    run = planned_run(str(plan.save(folder / "small.plan")), plan.problem, plan.cell)
    return run, recorded_run(read_log(file, plan.cell), run, plan.cell)


@pytest.mark.slow
def test_a_run_of_a_plan_is_found_in_its_recording(tmp_path: Path):
    _, t, _ = planned()
    run, recorded = run_and_log(tmp_path, written(tmp_path))
    found = findings(run.path, recorded.followed)
    assert found.laid is not None and 0.1e-3 < found.laid.most < 0.8e-3 and found.laid.mean < 0.3e-3
    assert len(recorded.followed.time) < len(t) and recorded.remarks[0].startswith("columns t_s")


@pytest.mark.slow
def test_a_robot_that_was_at_home_before_is_followed_from_where_it_leaves_for_good(tmp_path: Path):
    def away_and_back(t: Array, q: Array) -> tuple[Array, Array]:
        swing = np.radians(8.0) * np.sin(np.linspace(0.0, np.pi, 500))[:, None] * np.ones(q.shape[1])
        q = np.concatenate([q[:100], q[:1] + swing, q])
        return 0.004 * np.arange(len(q)), q

    plain = run_and_log(tmp_path, written(tmp_path))[1]
    (tmp_path / "again").mkdir()
    again = run_and_log(tmp_path / "again", written(tmp_path / "again", away_and_back))[1]
    assert again.followed.way[-1] == pytest.approx(plain.followed.way[-1], abs=1e-4)
    assert again.lines[0] > 500


def _order(t: Array, q: Array) -> tuple[Array, Array]:
    q[:, [1, 3]] = q[:, [3, 1]]
    return t, q


def _gap(t: Array, q: Array) -> tuple[Array, Array]:
    keep = np.append(np.arange(len(t) // 2), np.arange(len(t) // 2 + 30, len(t)))
    return t[keep], q[keep]


def _jump(t: Array, q: Array) -> tuple[Array, Array]:
    t[len(t) // 2 :] += 3.0
    return t, q


def _elsewhere(t: Array, q: Array) -> tuple[Array, Array]:
    q[:, 0] += np.linspace(-0.5, 0.5, len(t)).clip(0.0)
    return t, q


REFUSED = {
    "order": (_order, "columns are in another order: joint_2 is where joint_4 should be"),
    "gap": (_gap, "1 gap between samples, the longest 0.124 s"),
    "jump": (_jump, "1 gap between samples, the longest 3.004 s: samples are missing, or the clock jumped"),
    "elsewhere": (_elsewhere, r"another program: it leaves the plan's path by [34][0-9] mm after .* %"),
    "short": (lambda t, q: (t[: len(t) // 2], q[: len(t) // 2]), r"ends after .* % of the path"),
    "other start": (lambda t, q: (t, q + 0.3), "it never begins where the plan does; at the nearest .* is 17.2 degrees away"),
    "still": (lambda t, q: (t, q[:1] + 0.0 * q), "it never begins where the plan does|ends after"),
}  # fmt: skip


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("case", REFUSED)
def test_recordings_of_something_else_are_refused(tmp_path: Path, case: str):
    change, said = REFUSED[case]
    with pytest.raises(InputError, match=said):
        run_and_log(tmp_path, written(tmp_path, change))


def test_a_saved_plan_of_a_resumed_print_is_one_of_its_problem(tmp_path: Path):
    plan = solve(small_problem(), first_bead=2, baseline=False)
    assert plan.name == "small_from_2"
    assert planned_run(str(plan.save(tmp_path / "rest.plan")), plan.problem, plan.cell).language == "rapid"


def test_another_unit_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="joints are in radians, but its header says degrees"):
        run_and_log(tmp_path, written(tmp_path, unit="rad"))


def test_another_unit_is_told_beside_a_rail(tmp_path: Path):
    """Its millimetres are right where the arm's degrees are radians."""
    _, cell = cell_of("rail_panel")
    t = 0.01 * np.arange(400)
    q = cell.home + 0.5 * (1.0 - np.cos(t))[:, None] * np.array([0.2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    run = PlannedRun(path_of_samples(q, cell), cell, "", "the plan's samples")
    head = ",".join(["t_s", "rail_mm", *(f"joint_{k}_deg" for k in range(1, 7))])
    (tmp_path / "run.csv").write_text(table_text(head, np.column_stack([t, 1e3 * q[:, 0], q[:, 1:]])))
    with pytest.raises(InputError, match="joints are in radians, but its header says degrees"):
        recorded_run(read_log(tmp_path / "run.csv", cell), run, cell)


def test_what_is_no_plan_is_refused(tmp_path: Path):
    plan, _, _ = planned()
    (tmp_path / "notes.txt").write_text("no plan")
    (tmp_path / "empty").mkdir()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "plan.json").write_text('{"problem": "another"}')
    for given, said in (
        ("missing", "no such file or folder"),
        ("notes.txt", "is no plan"),
        ("empty", "holds no plan.json"),
        ("other", "is a plan of another"),
    ):
        with pytest.raises(InputError, match=said):
            planned_run(str(tmp_path / given), plan.problem, plan.cell)


@pytest.mark.slow
def test_the_command_reads_a_run_of_a_folder_of_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    plan, _, _ = planned()
    write(plan, tmp_path / "out")
    server = files("planner.link").joinpath("BeadwiseStream.mod").read_text("ascii")
    (tmp_path / "out" / "BeadwiseStream.mod").write_text(server, "ascii")  # of stream --server
    monkeypatch.chdir(tmp_path)
    written(tmp_path)
    arguments = ["read", "run.csv", str(plan.problem.file), "--plan", "out"]
    assert main(arguments) == EXIT_VERIFIED
    said = capsys.readouterr().out
    assert "compared with the RAPID program in the folder" in said and "where material is laid: mean 0." in said
    assert "look-ahead: not shown" in said
    for module in (tmp_path / "out").glob("*.mod"):
        module.unlink()
    assert main(arguments) == EXIT_VERIFIED and "compared with trajectory.csv" in capsys.readouterr().out
    (tmp_path / "out" / "trajectory.csv").write_text("t_s\n0\n")
    assert main(arguments) == EXIT_INPUT and "is no trajectory of this cell" in capsys.readouterr().err


def test_a_path_of_samples_has_no_corners():
    plan, t, q = planned()
    path = path_of_samples(plan.q, plan.cell)
    found = findings(path, follow(path, t[200:], q[200:], plan.cell))
    assert found.corners == () and found.laid is None and not found.ahead.told


def test_joints_as_kuka_counts_are_read_beside_samples(tmp_path: Path):
    def as_kuka(t: Array, q: Array) -> tuple[Array, Array]:
        q[:, own] = to_kuka(q[:, own])
        return t, q

    plan, _, _ = planned()
    own, cell = plan.cell.own, replace(plan.cell, arm_robot=replace(plan.cell.arm_robot, language="krl"))
    run = PlannedRun(path_of_samples(plan.q, cell), cell, "", "trajectory.csv")
    log = read_log(written(tmp_path, as_kuka), cell)
    assert "joints are counted as the controller does" in recorded_run(log, run, cell).remarks


# ---- what forecasts use -------------------------------------------------------------------------------------------


def test_what_a_controller_does_is_written_and_forecasts_use_it(tmp_path: Path):
    plan, _, _ = planned()
    (arm, _) = robots_of(plan.problem, plan.cell)
    found = findings(*run_of(ZIGZAG, replace(ABB, lag=0.03), speed=0.1, zone=ZONES))
    source = tmp_path / "run.csv"
    source.write_text("t_s\n")
    file = write_controller(arm, found, ["lag: some"], source, tmp_path / "mine")
    text, robot = file.read_text(encoding="utf-8"), read_robot(file)
    assert text.startswith("# Its controller, measured by `beadwise identify` from run.csv") and "# lag: some" in text
    assert robot.measured == "controller from run.csv"
    held = dict(robot.controller)
    assert held["lag"] == pytest.approx(0.03, abs=4e-3) and held["depth"] == pytest.approx(ABB.depth, rel=0.15)
    usual = CONTROLLERS["krl"]
    own = usual.measured(robot.controller)
    assert own.motion.lag == held["lag"] and own.motion.move_time == usual.motion.move_time
    assert "lag" not in own.motion.assumed and "move_time" in own.motion.assumed
    assert usual.measured(()) is usual and usual.measured((("ahead_moves", 4.0),)).motion.ahead_moves == 4
    with pytest.raises(OutputError, match="cannot write"):
        write_controller(arm, found, [], source, tmp_path / "mine")


def test_a_later_run_keeps_what_it_does_not_show(tmp_path: Path):
    plan, _, _ = planned()
    (arm, _) = robots_of(plan.problem, plan.cell)
    found = findings(*run_of(ZIGZAG, replace(ABB, lag=0.03), speed=0.1, zone=ZONES))
    (tmp_path / "run.csv").write_text("t_s\n")
    first = write_controller(arm, found, [], tmp_path / "run.csv", tmp_path / "mine")
    hidden = ShownValue(0.0, 0.0, False)
    stops = replace(
        found, lag=hidden, depth=replace(found.depth, value=0.5), brakes=(), ahead=ShownValue(3.2, 0.5, True)
    )
    later = replace(arm, path=first, robot=read_robot(first))
    again = read_robot(write_controller(later, stops, [], tmp_path / "run.csv", tmp_path / "later"))
    had, has = dict(read_robot(first).controller), dict(again.controller)
    assert has == had | {"depth": 0.5, "ahead_moves": 3.0} and "lag" in has
    assert again.measured == "controller from run.csv; before: controller from run.csv"


def test_nothing_is_left_of_a_controller_that_no_robot_may_have(tmp_path: Path):
    plan, _, _ = planned()
    found = findings(*run_of(ZIGZAG, replace(ABB, lag=0.03), speed=0.1, zone=ZONES))
    late = replace(found, lag=replace(found.lag, value=0.4))
    (tmp_path / "run.csv").write_text("t_s\n")
    with pytest.raises(InputError, match="lag_ms"):
        write_controller(robots_of(plan.problem, plan.cell)[0], late, [], tmp_path / "run.csv", tmp_path / "mine")
    assert not any((tmp_path / "mine").iterdir())


@pytest.mark.slow
def test_a_measured_lag_is_in_the_forecast(tmp_path: Path):
    plan, _, _ = planned()
    arm = replace(plan.cell.arm_robot, controller=(("lag", 0.06),))
    late = sealed(replace(plan, cell=replace(plan.cell, arm_robot=arm)))
    off = []
    for k, each in enumerate((plan, late)):
        write(each, tmp_path / str(k))
        off.append(json.loads((tmp_path / str(k) / "forecast.json").read_text())["forecasts"]["rapid"]["off_mm"])
    assert off[1] > 1.5 * off[0]


def test_a_run_may_begin_in_degrees_and_in_radians_where_it_begins_near_nought(tmp_path: Path):
    """Which of both it is, is told by the one that goes on."""
    plan, t, q = planned()
    head = ["t_s", *(f"J{k}" for k in range(1, 7)), "E1"]
    file = write_recording(tmp_path / "run.csv", Recording(t, 8.0 * (q - q[0]), q), head, 1.0)
    starts = run_starts(read_log(file, plan.cell), plan.cell, counting(plan.cell, ""), np.zeros(7))
    assert {float(start.reading.scale[0]) for start in starts} == {1.0, float(np.radians(1.0))}
