"""Limits of robots from recordings: known truth found again through noise, lag and uneven clocks; other files refused."""

from __future__ import annotations

import json
import re
import time as clock
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks.recordings import Recording, TrueRobot, commands, recorded, write_recording
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, OutputError
from planner.cell.cell import Cell, build_cell
from planner.cell.robot import read_robot
from planner.collision.scene import NOTHING, obstacles_of
from planner.export.joint_trajectory import at_times, read_joint_trajectory
from planner.export.krl import from_kuka
from planner.feedback.identify_command import main
from planner.feedback.identify_fit import fit_delay, fit_joints
from planner.feedback.identify_log import RobotLog, column_of, read_log
from planner.feedback.identify_match import MatchedLog, match
from planner.feedback.identify_profile import MotionLimits, move_profile
from planner.feedback.identify_program import (
    AskedMove,
    AskedMoves,
    asked_moves,
    asked_text,
    counting,
    free_spaces,
    greatest_lengths,
    language_of,
    moves_enough,
    program_files,
    read_asked,
    start_posture,
)
from planner.feedback.identify_robot_file import robots_of, write_measured
from planner.problem import Problem, load_problem

Array = NDArray[np.float64]

NOISE = np.radians(0.01)
RPI = Path(__file__).resolve().parents[2] / "shared" / "data" / "rpi"


@cache
def cell_of(name: str, *overrides: str) -> tuple[Problem, Cell]:
    problem = load_problem(name, overrides)
    return problem, build_cell(problem)


@cache
def asked_of(
    name: str, language: str | None = None, joints: tuple[int, ...] | None = None, most: float = 180.0, overrides=()
) -> AskedMoves:
    """What is asked of a cell in which nothing is in the way, of some of its joints."""
    problem, cell = cell_of(name, *overrides)
    spaces = free_spaces(cell, NOTHING, cell.home, greatest_lengths(cell, [most]))
    asked = asked_moves(problem, cell, cell.home, spaces, counting(cell, language_of(problem, cell, language)))
    kept = asked.moves if joints is None else tuple(move for move in asked.moves if move.joint in joints)
    return replace(asked, moves=kept)


def truth_of(cell: Cell, seed: int = 1, **more: float) -> TrueRobot:
    """A robot that is not that of the file: slower, its accelerations and jerks others."""
    random, limits, n = np.random.default_rng(seed), cell.limits, len(cell.joint_names)
    return TrueRobot(
        0.85 * limits.velocity,
        limits.acceleration * random.uniform(0.6, 1.4, n),
        limits.jerk * random.uniform(0.25, 0.7, n),
        **more,
    )


def header(cell: Cell, unit: str = "deg", commanded: bool = False) -> list[str]:
    names = [f"{name}_{unit}" for name in cell.joint_names]
    return ["t_s", *names, *([f"target_{name}" for name in names] if commanded else [])]


def found_in(path: Path, asked: AskedMoves, cell: Cell, recording: Recording, commanded: bool = False):
    """What is read from a recording that was written and read back."""
    file = write_recording(path / "run.csv", recording, header(cell, commanded=commanded), commanded=commanded)
    log = match(read_log(file, cell), asked)
    limits = cell.limits
    return fit_joints(log, asked, (limits.velocity, limits.acceleration, limits.jerk))


# Profiles


@given(
    distance=st.floats(1e-3, 4.0),
    speed=st.floats(0.2, 6.0),
    acceleration=st.floats(1.0, 40.0),
    jerk=st.floats(20.0, 3000.0),
)
def test_a_profile_is_that_of_ruckig(distance: float, speed: float, acceleration: float, jerk: float) -> None:
    own = move_profile(distance, MotionLimits(speed, acceleration, jerk, acceleration, jerk))
    asked = ruckig.InputParameter(1)
    asked.current_position, asked.target_position = [0.0], [distance]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [speed], [acceleration], [jerk]
    found = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(asked, found)
    assert own.total == pytest.approx(found.duration, rel=1e-9)
    t = np.linspace(0.0, found.duration, 40)
    np.testing.assert_allclose(own.at(t), [found.at_time(s)[0][0] for s in t], atol=1e-8 * distance)


@pytest.mark.parametrize("lag", [0.002, 0.03])
def test_a_servo_follows_a_profile_as_a_first_order_system(lag: float) -> None:
    limits = MotionLimits(3.0, 15.0, 750.0, 9.0, 300.0, lag)
    profile, behind = move_profile(0.8, replace(limits, lag=0.0)), move_profile(0.8, limits)
    step = 1e-5
    t = np.arange(0.0, profile.total + 6.0 * lag, step)
    told, at = profile.at(t), behind.at(t)
    np.testing.assert_allclose(np.diff(at) / step, (told - at)[1:] / lag, atol=step * 20.0 / lag + 1e-3)
    assert at[-1] == pytest.approx(0.8, rel=1e-2) and behind.at(np.array([-0.1, 0.0])).tolist() == [0.0, 0.0]


@given(
    distance=st.floats(1e-3, 4.0),
    acceleration=st.floats(1.0, 40.0),
    braking=st.floats(0.4, 2.0),
    mean=st.integers(4, 300).map(lambda ms: 1e-3 * ms),
)
def test_a_mean_of_a_trapezoid_is_what_summing_up_gives(
    distance: float, acceleration: float, braking: float, mean: float
) -> None:
    one, limits = np.ones(1), MotionLimits(2.0, acceleration, acceleration / mean, braking * acceleration, 0.0)
    profile = move_profile(distance, replace(limits, averaged=True))
    truth = TrueRobot(2.0 * one, acceleration * one, one, braking * acceleration * one, mean=mean)
    asked = replace(asked_of("peer_cap", joints=()), moves=(AskedMove(0, 0.0, distance, 1.0),), start=np.zeros(1))
    t, q = commands(asked, truth)
    begin = float(asked.rests[0])
    np.testing.assert_allclose(profile.at(t - begin), q[:, 0], atol=5e-3 * distance)
    assert profile.total == pytest.approx(t[np.argmax(q[:, 0] > distance - 1e-9)] - begin, abs=0.01)
    assert profile.states_at(np.array([profile.total]))[0] == pytest.approx([distance, 0.0, 0.0], abs=1e-6)
    jerks = np.abs(6.0 * profile.coefficients[:, 3])
    assert jerks[0] == pytest.approx(acceleration / mean) and jerks.max() <= (1.0 + braking) * jerks[0] * 1.0001


# What is asked


@pytest.mark.slow
def test_moves_stay_clear_of_the_cell_and_within_ranges() -> None:
    problem, cell = cell_of("cylinder_logo", "layers.count=1")
    from planner.toolpath.build import build_toolpath

    obstacles = obstacles_of(problem, cell, build_toolpath(problem))
    start = start_posture(cell, [20.0, 10.0, 35.0, 80.0, -80.0, 60.0, 10.0])
    spaces = free_spaces(cell, obstacles, start, greatest_lengths(cell, None))
    asked = asked_moves(problem, cell, start, spaces, counting(cell, "rapid"))
    random = np.random.default_rng(1)
    for move in asked.moves:
        q = np.tile(start, (300, 1))
        q[:, move.joint] = random.uniform(*sorted((move.start, move.end)), 300)
        assert (q >= cell.limits.q_min).all() and (q <= cell.limits.q_max).all()
        margin, _ = obstacles.margins(q, np.full(300, np.inf), 1e-3)
        assert margin.min() > -1e-4
    blocked = [space for space in spaces if any(" near " in words for words in space.bounds)]
    assert blocked, "nothing of the cell is in the way: another posture tells more"
    np.testing.assert_array_equal(asked.postures[-1], start)


def test_a_start_that_is_not_clear_is_refused() -> None:
    problem, cell = cell_of("peer_cap")
    from planner.toolpath.build import build_toolpath

    obstacles = obstacles_of(problem, cell, build_toolpath(problem))
    down = cell.home + np.radians([0.0, 80.0, 30.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"lack .* mm of their clearance at the start posture"):
        free_spaces(cell, obstacles, down, greatest_lengths(cell, None))


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda cell: start_posture(cell, [0.0] * 3), "3 values for 7 joints"),
        (lambda cell: start_posture(cell, [0.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0]), "joint_2 is outside its range"),
        (lambda cell: greatest_lengths(cell, [1.0, 2.0]), "2 values for 7 joints"),
    ],
)
def test_values_that_do_not_fit_the_cell_are_refused(ask: Callable[[Cell], Array], said: str) -> None:
    with pytest.raises(InputError, match=said):
        ask(cell_of("cylinder_logo")[1])


def test_a_joint_without_space_is_left_out() -> None:
    problem, cell = cell_of("cylinder_logo")
    most = greatest_lengths(cell, [1.0, 40.0, 40.0, 40.0, 40.0, 40.0, 40.0])
    spaces = free_spaces(cell, NOTHING, cell.home, most)
    asked = asked_moves(problem, cell, cell.home, spaces, counting(cell, "rapid"))
    assert not moves_enough(cell, 0, spaces[0]) and {move.joint for move in asked.moves} == set(range(1, 7))
    with pytest.raises(InputError, match="no joint has space"):
        asked_moves(
            problem, cell, cell.home, free_spaces(cell, NOTHING, cell.home, 0.0 * most), counting(cell, "rapid")
        )


# Programs


def _numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?[0-9.]+(?:E[0-9]+)?", text)]


def test_a_rapid_program_says_what_is_asked() -> None:
    asked, (_, cell) = asked_of("cylinder_logo", "rapid"), cell_of("cylinder_logo")
    (text,) = program_files(cell, asked, "STN1").values()
    targets = [_numbers(line)[:8] for line in text.splitlines() if "MoveAbsJ" in line]
    # the positioner's tilt is held, its rotation is the last joint
    q = np.degrees(asked.postures)
    np.testing.assert_allclose(np.array(targets)[:, [0, 1, 2, 3, 4, 5, 7]], q, atol=2e-4)
    waits = [float(line.split(",")[1].rstrip(";")) for line in text.splitlines() if "WaitTime" in line]
    np.testing.assert_allclose(waits, asked.rests)
    slow = [line for line in text.splitlines() if "[9999,100,1745.33,100]" in line]
    assert len(slow) == 4, "joints 1 and 2, there and back, at half of 200 degrees a second"


def test_a_krl_program_says_what_is_asked_as_kuka_counts() -> None:
    asked, (_, cell) = asked_of("peer_cap", "krl"), cell_of("peer_cap")
    (text,) = program_files(cell, asked, "").values()
    targets = [re.findall(r"A[1-6] (-?[0-9.]+)", line) for line in text.splitlines() if "PTP {" in line]
    np.testing.assert_allclose(from_kuka(np.radians(np.array(targets, float))), asked.postures, atol=1e-6)
    np.testing.assert_allclose(
        asked.signs[:6] * asked.postures + asked.offsets, np.radians(np.array(targets, float)), atol=1e-6
    )
    assert "BAS(#VEL_PTP,100)" in text and "BAS(#VEL_PTP,25)" in text


UR = ("cell.arm=ur5e", "cell.limits={}", "cell.home_deg=[0, -90, 90, -90, -90, 0]")


def test_a_urscript_program_says_what_is_asked() -> None:
    asked, (_, cell) = asked_of("peer_cap", overrides=UR), cell_of("peer_cap", *UR)
    (text,) = program_files(cell, asked, "").values()
    lines = [line for line in text.splitlines() if "movej" in line]
    np.testing.assert_allclose([_numbers(line.partition("a=")[0])[:6] for line in lines], asked.postures, atol=1e-6)
    a, v, _ = np.array([_numbers(line.partition("], ")[2]) for line in lines[1:]]).T
    joints = [move.joint for move in asked.moves]
    np.testing.assert_allclose(a, cell.limits.acceleration[joints], rtol=1e-4)
    np.testing.assert_allclose(v, [m.share * cell.limits.velocity[m.joint] for m in asked.moves], rtol=1e-3)


def test_a_joint_trajectory_keeps_the_limits_that_it_asks() -> None:
    asked, (_, cell) = asked_of("peer_cap", "joint_trajectory"), cell_of("peer_cap")
    (text,) = program_files(cell, asked, "").values()
    read = read_joint_trajectory(text)
    assert read.joint_names == cell.joint_names
    t = np.arange(0.0, read.knots.time[-1], 1e-3)
    q, speed, acceleration = at_times(read.knots, t)
    assert (np.abs(speed).max(axis=0) <= 1.001 * cell.limits.velocity).all()
    assert (np.abs(acceleration).max(axis=0) <= 1.001 * cell.limits.acceleration).all()
    jerk = np.abs(np.diff(acceleration, axis=0)).max(axis=0) / 1e-3
    assert (jerk <= 1.01 * cell.limits.jerk).all() and (jerk > 0.9 * cell.limits.jerk).all()
    # and it goes where it was asked to
    for posture in asked.postures[:: len(asked.postures) // 9]:
        assert np.abs(q - posture).max(axis=1).min() < 1e-4


def test_languages_that_do_not_do_are_refused() -> None:
    problem, cell = cell_of("peer_cap")
    with pytest.raises(InputError, match="test programs are written in"):
        language_of(problem, cell, "val3")
    with pytest.raises(InputError, match="no arm of Universal Robots"):
        language_of(problem, cell, "urscript")


def test_what_was_asked_is_read_back(tmp_path: Path) -> None:
    problem, cell = cell_of("rail_panel")
    asked = asked_of("rail_panel")
    file = tmp_path / "asked.json"
    file.write_text(asked_text(asked), encoding="utf-8")
    read = read_asked(file, problem, cell)
    assert read.sliding == (0,) and read.asked == (None, None, None)
    np.testing.assert_allclose(read.postures, asked.postures, atol=1e-7)
    np.testing.assert_allclose(read.rests, asked.rests)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data.update(format="other"), "its format is 'other'"),
        (lambda data: data.pop("moves"), "is not what a test program asked"),
        (lambda data: data.update(moves=[]), "it has no moves"),
        (lambda data: data["moves"][0].update(joint="joint_9"), "is not what a test program asked"),
        (lambda data: data["joints"].pop(), "was asked of"),
        (lambda data: data["joints"][0].update(unit="mm"), "slide"),
        (lambda data: data["joints"][0].update(start="x"), "is not what a test program asked"),
    ],
)
def test_another_file_than_what_was_asked_is_refused(
    tmp_path: Path, change: Callable[[dict], object], said: str
) -> None:
    problem, cell = cell_of("cylinder_logo")
    data = json.loads(asked_text(asked_of("cylinder_logo")))
    change(data)
    file = tmp_path / "asked.json"
    file.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_asked(file, problem, cell)


# Names of columns


@pytest.mark.parametrize(
    ("name", "role", "joint", "unit"),
    [
        ("t_s", "time", None, 1.0),
        ("Timestamp", "time", None, np.nan),
        ("time (ms)", "time", None, 1e-3),
        ("header.stamp.nsecs", "time", None, 1e-9),
        ("joint_3_deg", "executed", 2, np.pi / 180.0),
        ("J3", "executed", 3, np.nan),
        ("actual_q_3", "executed", 3, np.nan),
        ("target_q_0", "commanded", 0, np.nan),
        ("Feedback joint 2 [rad]", "executed", 2, 1.0),
        ("$AXIS_ACT.A3", "executed", 3, np.nan),
        ("cmd j1 (deg)", "commanded", 1, np.pi / 180.0),
        ("/joint_states/joint_4/position", "executed", 3, np.nan),
        ("positioner_joint_1", None, None, None),
        ("actual_qd_0", None, None, None),
        ("joint_1_velocity", None, None, None),
        ("target_current_2", None, None, None),
        ("cmd_num", None, None, None),
        ("", None, None, None),
    ],
)
def test_names_of_columns(name: str, role: str | None, joint: int | None, unit: float | None) -> None:
    found = column_of(0, name, cell_of("cylinder_logo")[1])
    if role is None:
        assert found is None or found.named == 0  # positioner_joint_1 is another's joint_1 by its name
        return
    assert found is not None and found.role == role
    np.testing.assert_equal(found.unit, unit)
    assert joint is None or joint in (found.named, found.number)


@given(st.text(max_size=30))
def test_any_name_of_a_column_is_looked_at(name: str) -> None:
    found = column_of(0, name, cell_of("cylinder_logo")[1])
    assert found is None or found.role in ("time", "executed", "commanded")


# Limits


def _assert_near(truth: TrueRobot, fits: Sequence, within: float = 0.03) -> None:
    for fit in fits:
        expected = (truth.speed, truth.acceleration, truth.jerk)
        for found, values in zip(fit.limits, expected, strict=True):
            assert found.told and found.value == pytest.approx(values[fit.joint], rel=within)
            assert abs(found.value - values[fit.joint]) < 4.0 * found.error


@pytest.mark.slow
@pytest.mark.parametrize("rate", [125.0, 250.0, 500.0])
def test_limits_are_found_through_noise(tmp_path: Path, rate: float) -> None:
    _, cell = cell_of("cylinder_logo")
    asked, truth = asked_of("cylinder_logo", joints=(3,)), truth_of(cell)
    log, fits = found_in(tmp_path, asked, cell, recorded(asked, truth, rate))
    _assert_near(truth, fits)
    assert log.noise[3] == pytest.approx(NOISE, rel=0.1) and fits[0].braking is None
    assert fits[0].residual == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides"), [("cylinder_logo", ()), ("peer_cap", UR), ("peer_cap", ("cell.arm=irb2600",))]
)
@pytest.mark.parametrize("rate", [125.0, 250.0])
def test_limits_of_whole_cells(tmp_path: Path, name: str, overrides: tuple[str, ...], rate: float) -> None:
    _, cell = cell_of(name, *overrides)
    asked, truth = asked_of(name, overrides=overrides), truth_of(cell, 2, lag=0.008)
    _, fits = found_in(tmp_path, asked, cell, recorded(asked, truth, rate))
    assert len(fits) == len(cell.joint_names)
    for fit in fits:
        for found, values in zip(fit.limits, (truth.speed, truth.acceleration, truth.jerk), strict=True):
            if found.told:
                assert found.value == pytest.approx(values[fit.joint], rel=0.1)
            else:
                assert found.value <= 1.02 * values[fit.joint]  # what was reached at least
        assert fit.acceleration.told


@pytest.mark.slow
def test_a_rail_is_measured_in_metres(tmp_path: Path) -> None:
    _, cell = cell_of("rail_panel")
    asked, truth = asked_of("rail_panel", joints=(0,)), truth_of(cell)
    recording = recorded(asked, truth, noise=np.append(2e-5, np.full(6, NOISE)))
    scale = np.append(1e3, np.full(len(cell.joint_names) - 1, np.degrees(1.0)))
    names = [f"{cell.joint_names[0]}_mm", *(f"{name}_deg" for name in cell.joint_names[1:])]
    file = write_recording(tmp_path / "run.csv", recording, ["time_s", *names], scale)
    limits = cell.limits
    log = match(read_log(file, cell), asked)
    _, fits = fit_joints(log, asked, (limits.velocity, limits.acceleration, limits.jerk))
    assert fits[0].acceleration.value == pytest.approx(truth.acceleration[0], rel=0.03)
    assert fits[0].jerk.value == pytest.approx(truth.jerk[0], rel=0.05)


@pytest.mark.slow
def test_braking_that_differs_is_found_and_the_lesser_told(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    plain = truth_of(cell)
    truth = replace(plain, braking=0.7 * plain.acceleration)
    asked = asked_of("cylinder_logo", joints=(4,))
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.braking is not None and fit.braking[0] == pytest.approx(0.7 * plain.acceleration[4], rel=0.01)
    assert fit.acceleration.value == pytest.approx(0.7 * plain.acceleration[4], rel=0.01)
    assert fit.jerk.value == pytest.approx(truth.jerk[4], rel=0.05)


@pytest.mark.slow
def test_a_servo_that_lags_does_not_lower_the_jerk(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell, lag=0.03), asked_of("cylinder_logo", joints=(5,))
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.lag == pytest.approx(0.03, abs=5e-4)
    _assert_near(truth, [fit], 0.05)


def test_a_few_moves_tell_a_mean_from_a_limited_jerk(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    whole = asked_of("cylinder_logo", joints=(3,), most=30.0)
    asked = replace(whole, moves=whole.moves[:1] + whole.moves[-7:])
    truth = truth_of(cell, mean=0.05)
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.averaged is not None and fit.either is None
    assert fit.jerk.value == pytest.approx(truth.acceleration[3] / 0.05, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mean", "lag", "rate"), [(0.02, 0.0, 250.0), (0.04, 0.0, 250.0), (0.05, 0.015, 125.0), (0.1, 0.03, 250.0)]
)
def test_a_mean_over_a_fixed_time_is_told_from_a_limited_jerk(
    tmp_path: Path, mean: float, lag: float, rate: float
) -> None:
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell, mean=mean, lag=lag), asked_of("cylinder_logo", joints=(3, 6))
    _, fits = found_in(tmp_path, asked, cell, recorded(asked, truth, rate))
    for fit in fits:
        assert fit.averaged is not None and fit.either is None
        assert fit.averaged[0] == pytest.approx(mean, abs=4.0 * fit.averaged[1] + 1e-4)
        assert fit.acceleration.value == pytest.approx(truth.acceleration[fit.joint], rel=0.01)
        assert fit.jerk.value == pytest.approx(truth.acceleration[fit.joint] / mean, rel=0.1, abs=4.0 * fit.jerk.error)
        assert fit.lag == pytest.approx(lag, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("mean", [0.013, 0.08])
def test_commands_tell_a_mean_to_the_last_digit(tmp_path: Path, mean: float) -> None:
    """Times of a few samples too, from which a search that begins with a sudden acceleration does not come away."""
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell, mean=mean), asked_of("cylinder_logo", joints=(0,))
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth), commanded=True)
    assert fit.averaged is not None and fit.averaged[0] == pytest.approx(mean, rel=1e-4)
    assert fit.acceleration.value == pytest.approx(truth.acceleration[0], rel=1e-3)


@pytest.mark.slow
def test_a_mean_with_braking_that_differs_gives_the_lesser_jerk(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    plain, asked = truth_of(cell, mean=0.06), asked_of("cylinder_logo", joints=(4,))
    truth = replace(plain, braking=0.7 * plain.acceleration)
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.averaged is not None and fit.averaged[0] == pytest.approx(0.06, rel=0.02)
    assert fit.acceleration.value == pytest.approx(0.7 * plain.acceleration[4], rel=0.01)
    assert fit.jerk.value == pytest.approx(0.7 * plain.acceleration[4] / 0.06, rel=0.03)


@pytest.mark.slow
def test_kinds_of_profiles_that_noise_hides_give_the_lesser_jerk(tmp_path: Path) -> None:
    """Of moves of more than twice the ramps' length both kinds are the same."""
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell, mean=0.03), asked_of("cylinder_logo", joints=(3,))
    long = tuple(move for move in asked.moves if abs(move.end - move.start) > 0.9)
    asked = replace(asked, moves=long, start=np.where(np.arange(7) == 3, long[0].start, asked.start))
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.either is not None and fit.either >= fit.jerk.value
    assert fit.jerk.value == pytest.approx(truth.acceleration[3] / 0.03, rel=0.1)


@pytest.mark.slow
def test_moves_that_differ_give_the_least_limits(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell), asked_of("cylinder_logo", joints=(4,))
    weak = replace(truth, acceleration=0.8 * truth.acceleration)
    one, other = recorded(asked, truth), recorded(asked, weak)
    assert len(one.time) < len(other.time)
    # outwards with one, back with the other, as an arm whose weight helps it down
    pieces = [recorded(replace(asked, start=posture, moves=(move,)), weak if move.end > move.start else truth, noise=0.0)
              for move, posture in zip(asked.moves, asked.postures, strict=False)]  # fmt: skip
    q = np.concatenate([piece.executed for piece in pieces])
    q = q + np.random.default_rng(1).normal(0.0, NOISE, q.shape)
    _, (fit,) = found_in(tmp_path, asked, cell, Recording(0.004 * np.arange(len(q)), q, q))
    assert fit.acceleration.spread[0] == pytest.approx(weak.acceleration[4], rel=0.05)
    assert fit.acceleration.spread[1] == pytest.approx(truth.acceleration[4], rel=0.05)
    assert fit.acceleration.value == fit.acceleration.spread[0]


@pytest.mark.slow
def test_uneven_stamps_of_even_samples_are_evened(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell), asked_of("cylinder_logo", joints=(3,))
    recording = recorded(asked, truth, 125.0)
    late = np.random.default_rng(4).uniform(0.0, 3e-3, len(recording.time))
    log, fits = found_in(tmp_path, asked, cell, replace(recording, time=recording.time + late))
    assert "stamps are uneven" in log.remarks[-1]
    _assert_near(truth, fits)


@pytest.mark.slow
def test_a_jerk_that_cannot_be_seen_is_not_told(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell), asked_of("cylinder_logo", joints=(3,), most=20.0)
    sudden = replace(truth, jerk=100.0 * truth.jerk)
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, sudden, 125.0))
    assert not fit.jerk.told and fit.jerk.value < sudden.jerk[3]
    assert not fit.speed.told and fit.speed.value < sudden.speed[3]  # 20 degrees are too short for it
    assert fit.acceleration.value == pytest.approx(sudden.acceleration[3], rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("commanded", [False, True])
def test_an_acceleration_that_the_jerk_never_allows_is_not_told(tmp_path: Path, commanded: bool) -> None:
    _, cell = cell_of("cylinder_logo")
    plain, asked = truth_of(cell), asked_of("cylinder_logo", joints=(3,))
    most = np.sqrt(plain.speed * plain.jerk)  # at the middle of speeding up, where the jerk turns over
    truth = replace(plain, acceleration=1.3 * most)
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth), commanded)
    assert not fit.acceleration.told and fit.acceleration.value == pytest.approx(most[3], rel=0.02)
    assert fit.jerk.value == pytest.approx(truth.jerk[3], rel=0.03)
    assert fit.speed.value == pytest.approx(truth.speed[3], rel=0.01)


@pytest.mark.slow
def test_limits_that_the_program_had_set_are_told_as_asked(tmp_path: Path) -> None:
    _, cell = cell_of("peer_cap", *UR)
    asked, limits = asked_of("peer_cap", joints=(5,), overrides=UR), cell.limits
    truth = TrueRobot(limits.velocity, limits.acceleration, 0.5 * limits.jerk)
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.speed.as_asked and fit.acceleration.as_asked and not fit.jerk.as_asked


# Delays


@pytest.mark.slow(keep=("0.012-0.02",))
@pytest.mark.parametrize(("delay", "lag"), [(0.033, 0.0), (0.012, 0.02), (0.0, 0.045), (0.1, 0.01)])
def test_delays_are_found_within_a_fraction_of_a_sample(tmp_path: Path, delay: float, lag: float) -> None:
    _, cell = cell_of("cylinder_logo")
    truth = truth_of(cell, delay=delay, lag=lag)
    asked = asked_of("cylinder_logo", joints=(3,), most=60.0)
    log, _ = found_in(tmp_path, asked, cell, recorded(asked, truth, 125.0), commanded=True)
    found = fit_delay(log, asked, 3)
    assert found is not None and found.total == pytest.approx(delay + lag, abs=3e-4)
    assert found.delay == pytest.approx(delay, abs=1e-3) and found.lag == pytest.approx(lag, abs=1e-3)


def test_without_commands_there_is_no_delay(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    asked = asked_of("cylinder_logo", joints=(3,), most=20.0)
    file = write_recording(tmp_path / "run.csv", recorded(asked, truth_of(cell)), header(cell))
    assert fit_delay(match(read_log(file, cell), asked), asked, 3) is None


# Files of robots and other tools


def _matched(tmp_path: Path, text: str, asked: AskedMoves, columns: Sequence[str] | None = None) -> MatchedLog:
    file = tmp_path / "run.csv"
    file.write_text(text, encoding="utf-8")
    return match(read_log(file, cell_of("cylinder_logo")[1], columns), asked)


@cache
def sample() -> tuple[AskedMoves, Recording]:
    asked = asked_of("cylinder_logo", joints=(1, 3, 6), most=20.0)
    return asked, recorded(asked, truth_of(cell_of("cylinder_logo")[1], delay=0.02))


def _text(head: str, table: Array, separator: str = ",") -> str:
    return "\n".join([head, *(separator.join(f"{v:.13g}" for v in row) for row in table)]) + "\n"


def test_recordings_are_read_as_tools_write_them(tmp_path: Path) -> None:
    asked, recording = sample()
    t, q, told = recording.time, recording.executed, recording.commanded
    degrees = np.degrees(q)
    numbers = np.arange(len(t))
    rtde = "timestamp " + " ".join(f"{role}_{name}" for role in ("target", "actual") for name in (*SIX, "e1"))
    stamps = 1.7e9 + t
    files = {
        "abb": _text("timestamp, cmd_num, J1, J2, J3, J4, J5, J6, E1", np.column_stack([t, numbers, degrees])),
        "kuka": _text("t_ms;A1;A2;A3;A4;A5;A6;E1", np.column_stack([1e3 * t, degrees]), ";"),
        "from zero": _text("time,q0,q1,q2,q3,q4,q5,rotation", np.column_stack([t, q])),
        "ros": _text(
            "header.stamp.secs,header.stamp.nsecs," + ",".join(f"/js/{n}/position" for n in asked.joint_names),
            np.column_stack([np.floor(stamps), np.round(1e9 * (stamps % 1.0)), q]),
        ),
        "order": _text(
            "rotation_rad\ttime\t" + "\t".join(f"joint_{k}" for k in range(6, 0, -1)),
            np.column_stack([q[:, 6], t, q[:, 5::-1]]), "\t",
        ),
    }  # fmt: skip
    for name, text in files.items():
        log = _matched(tmp_path, text, asked)
        assert len(log.rests) == len(asked.moves) + 1, name
        np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4, err_msg=name)
    log = _matched(tmp_path, _text(rtde, np.column_stack([t, told, q]), " "), asked)
    assert log.commanded is not None
    np.testing.assert_allclose(log.commanded, told, atol=1e-7)
    bare = _text("", np.column_stack([t, degrees])).lstrip()
    names = ["t_s", *(f"J{k}_deg" for k in range(1, 7)), "E1_deg"]
    np.testing.assert_allclose(_matched(tmp_path, bare, asked, names).postures, asked.postures, atol=2e-4)


def test_what_is_recorded_before_and_behind_the_program_does_not_matter(tmp_path: Path) -> None:
    asked, recording = sample()
    _, cell = cell_of("cylinder_logo")
    way = np.radians(7.0) * np.sin(np.linspace(0.0, 0.5 * np.pi, 500))[:, None] * np.ones(7)
    first, last = recording.executed[:100], recording.executed[-100:]
    before = np.concatenate([first[:1] + way[-1:].repeat(150, axis=0), first[:1] + way[::-1]])
    q = np.concatenate([before, recording.executed, last[-1:] + way, last + way[-1]])
    made = Recording(0.004 * np.arange(len(q)), q, q)
    log = match(read_log(write_recording(tmp_path / "run.csv", made, header(cell)), cell), asked)
    assert len(log.rests) == len(asked.moves) + 1 and log.rests[0, 0] >= len(before)
    np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4)


SIX = tuple(f"q_{k}" for k in range(6))


@given(text=st.text(alphabet="t_s,jJ123456;\n\"'0.5-e \t", max_size=400))
def test_any_text_is_read_or_refused(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "any.csv"
    file.write_text(text, encoding="utf-8")
    cell = cell_of("peer_cap")[1]
    for columns in (None, ["t_s", *(f"J{k}" for k in range(1, 7))]):
        with suppress(InputError):
            read_log(file, cell, columns)


@settings(max_examples=20)
@given(rows=st.lists(st.lists(st.sampled_from(["0", "1e400", "nan", "x", "-3.5", ""]), min_size=6, max_size=8), min_size=50,
                     max_size=60))  # fmt: skip
def test_any_numbers_are_read_or_refused(rows: list[list[str]], tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "rows.csv"
    file.write_text("\n".join(["t,J1,J2,J3,J4,J5,J6", *map(",".join, rows)]), encoding="utf-8")
    with suppress(InputError):
        match(read_log(file, cell_of("peer_cap")[1]), asked_of("peer_cap", joints=(0,)))


def test_two_arms_of_one_kind_have_a_file_each(tmp_path: Path) -> None:
    problem, cell = cell_of("fibre_bowl")
    names = [robot.target(tmp_path).name for robot in robots_of(problem, cell)]
    assert len(set(names)) == len(names) == 2


def _spoilt(change: str) -> tuple[str, str]:
    """A recording that something is wrong with, and what is said."""
    asked, recording = sample()
    t, q = recording.time.copy(), np.degrees(recording.executed)
    head = "t_s," + ",".join(f"{name}_deg" for name in asked.joint_names)
    table = np.column_stack([t, q])
    half = len(t) // 2
    moved = half + int(np.argmax(np.abs(np.diff(q[half:, 3])) > 0.3))
    if change == "radians":
        table[:, 1:] = np.radians(q)
        return _text(head, table), "joints are in radians, where its header says degrees"
    if change == "degrees":
        return _text(head.replace("_deg", "_rad"), table), "joints are in degrees, where its header says radians"
    if change == "order":
        table[:, [2, 4]] = table[:, [4, 2]]
        return _text(head, table), "that of joint_2 moves as joint_4 was asked to"
    if change == "turned":
        table[:, 4] *= -1.0
        return _text(head, table), "joint_4 moves the other way round"
    if change == "zero":
        table[:, 2] += 90.0
        return _text(head, table), "the zero of joint_2 is 90 degrees off"
    if change == "gap":
        return _text(
            head, np.delete(table, slice(moved, moved + 30), axis=0)
        ), "1 gap between samples, the longest 0.124"
    if change == "jump":
        table[half:, 0] += 2.0
        return _text(head, table), "the clock jumped"
    if change == "back":
        table[half:, 0] -= 2.0
        return _text(head, table), "the clock runs back by 1.996 s"
    if change == "still":
        table[moved : moved + 3, 0] = table[moved, 0]
        return _text(head, table), "the clock stands still"
    if change == "milliseconds":
        table[:, 0] *= 1e3
        return _text(head.replace("t_s", "time"), table), "goes on by 4 s from sample to sample"
    if change == "seconds":
        return _text(head.replace("t_s", "t_ms"), table), "goes on by 4e-06 s"
    if change == "microseconds":
        table[:, 0] *= 1e6
        return _text(head.replace("t_s", "timestamp"), table), "goes on by 4000 s"
    if change == "clock set":
        # at a new second of another clock in the middle of a move, as when a controller's is set
        table[moved:, 0] += 0.08
        return _text(head, table), "samples are missing, or the clock jumped"
    if change == "twice over":
        return _text(head, np.concatenate([table, table])), "the clock runs back"
    if change == "turns":
        table[:, 1:] = q / 360.0
        return _text(head, table), "another program|never rest|was asked to"
    if change == "all shifted":
        table[:, 1:] = np.roll(q, 1, axis=1)
        return _text(head, table), "columns are in another order"
    if change == "sparse":
        return _text(head, table[::5]), "too few samples: one every 20 ms"
    if change == "short":
        return _text(head, table[:20]), "holds 20 samples"
    if change == "cut":
        return _text(head, table[:half]), "ends after [0-9]+ of"
    if change == "program":
        table[:, 1:] = np.degrees(asked.start) + 20.0 * np.sin(0.3 * t[:, None])
        return _text(head, table), "never rest|another program"
    if change == "elsewhere":
        table[:, 3] += np.where(t > t[half], 3.0, 0.0)
        return _text(head, table), "moves are as asked, then joint_3 rests 3 degrees from where it was asked to"
    if change == "stray":
        table[moved : moved + 30, 5] += 2.0
        return _text(head, table), "joint_5 moves by 2.* while only joint_4 was asked to"
    if change == "no time":
        return _text(head.replace("t_s", "x"), table), "no column has the time"
    if change == "no joint":
        return _text(head.replace("joint_6_deg", "x"), table), "no column has joint_6"
    if change == "twice":
        return _text(head.replace("joint_6_deg", "J5"), table), "are both of joint_5"
    if change == "commands only":
        return _text(head.replace("joint", "cmd_joint").replace("rot", "cmd_rot"), table), "what joints were told"
    if change == "no header":
        return _text("", table).lstrip(), "a header that names the columns is missing"
    if change == "words":
        return _text(head, table).replace("\n0.4,", "\nstop,", 1), "could not convert string 'stop'"
    if change == "columns":
        return _text(head, table).replace("\n0.4,", "\n0.4,0,", 1), "has another number of columns"
    if change == "nan":
        return _text(head, table).replace("\n0.4,", "\nnan,", 1), "no finite number"
    if change == "comma":
        return _text(head, table, ";").replace(".", ","), "could not convert|number of columns"
    return "", "holds no samples"


SPOILT = (
    "radians", "degrees", "order", "turned", "zero", "gap", "jump", "back", "still", "milliseconds", "sparse", "short", "cut",
    "program", "elsewhere", "stray", "no time", "no joint", "twice", "commands only", "no header", "words", "columns", "nan",
    "comma", "empty", "seconds", "microseconds", "clock set", "twice over", "turns", "all shifted",
)  # fmt: skip


OTHER_KINDS = {
    "cloud.xyz": ("1 2 3\n4 5 6\n", "looks like a cloud of points"),
    "cloud.ply": ("ply\nformat ascii 1.0\n", "looks like a cloud of points"),
    "cloud.csv": ("x,y,z\n1,2,3\n", "looks like a cloud of points"),
    "named.csv": ("X [mm];Y [mm];Z [mm];intensity\n1;2;3;4\n", "looks like a cloud of points"),
    "bare.txt": ("1.5 2 3\n" * 60, "looks like a cloud of points"),
    "normals.txt": ("1.5 2 3 0 0.6 0.8\n" * 60, "looks like a cloud of points.*: with normals"),
    "scan.pcd": ("# .PCD v0.7\nFIELDS x y z\n", "looks like a cloud of points"),
    "part.stl": ("solid part\n", "is a mesh"),
    "program.mod": ("MODULE x\n", "is a program"),
    "plan.json": ("{}", "is no table"),
    "trajectory.csv": ("t_s,bead,layer,deposit,joint_1\n0,0,0,0,0\n", "is the trajectory of a plan"),
    "joints.txt": ("1.5 2 3 0 0.6 0.9\n" * 60, "a header that names the columns is missing"),
    "none.csv": (None, r"there is no file .*none.csv"),
}


@pytest.mark.parametrize("name", OTHER_KINDS)
def test_a_file_of_another_kind_is_told(tmp_path: Path, name: str) -> None:
    text, said = OTHER_KINDS[name]
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_log(tmp_path / name, cell_of("peer_cap")[1])


@pytest.mark.parametrize("name", ["cloud.npy", "cloud.npz"])
def test_a_cloud_in_an_array_is_told(tmp_path: Path, name: str) -> None:
    points = np.zeros((30, 3))
    (np.save if name.endswith("npy") else np.savez)(tmp_path / name, points)
    with pytest.raises(InputError, match="looks like a cloud of points"):
        read_log(tmp_path / name, cell_of("peer_cap")[1])


@pytest.mark.parametrize("change", SPOILT)
def test_what_is_no_recording_of_the_program_is_refused(tmp_path: Path, change: str) -> None:
    text, said = _spoilt(change)
    with pytest.raises(InputError, match=said):
        _matched(tmp_path, text, sample()[0])


def test_joints_as_the_controller_counts_them_are_understood(tmp_path: Path) -> None:
    asked, (_, cell) = asked_of("peer_cap", "krl", joints=(1, 3), most=20.0), cell_of("peer_cap")
    recording = recorded(asked, truth_of(cell))
    kuka = replace(recording, executed=recording.executed * asked.signs + asked.offsets)
    file = write_recording(tmp_path / "run.csv", kuka, ["t_s", *(f"A{k}" for k in range(1, 7))])
    log = match(read_log(file, cell), asked)
    np.testing.assert_allclose(log.postures, asked.postures, atol=2e-4)
    assert "joints are counted as the controller does" in log.remarks


def test_commands_that_rest_elsewhere_are_refused(tmp_path: Path) -> None:
    asked, recording = sample()
    _, cell = cell_of("cylinder_logo")
    off = replace(recording, commanded=recording.commanded + np.radians(5.0))
    file = write_recording(tmp_path / "run.csv", off, header(cell, commanded=True), commanded=True)
    with pytest.raises(InputError, match=r"commanded and executed joints rest up to 5.* degrees apart"):
        match(read_log(file, cell), asked)


def test_commands_long_before_the_motion_are_refused(tmp_path: Path) -> None:
    asked, recording = sample()
    _, cell = cell_of("cylinder_logo")
    early = replace(recording, commanded=np.roll(recording.commanded, -75, axis=0))
    file = write_recording(tmp_path / "run.csv", early, header(cell, commanded=True), commanded=True)
    with pytest.raises(InputError, match=r"commands begin to move more than|commanded and executed joints rest"):
        match(read_log(file, cell), asked)


@pytest.mark.skipif(not RPI.is_dir(), reason="the public recordings are not here")
def test_a_real_robots_recording_of_another_program_is_refused() -> None:
    """Of a real IRB 6640, whose file has no header, a gap, and stamps that jitter."""
    overrides = ("cell.arm=irb6640", "cell.home_deg=[0, 0, 0, 0, 30, 0]")
    _, cell = cell_of("peer_cap", *overrides)
    asked = asked_of("peer_cap", overrides=overrides)
    with pytest.raises(InputError, match="a header that names the columns is missing"):
        read_log(RPI / "run0_b.csv", cell)
    log = read_log(RPI / "run0_b.csv", cell, ["timestamp", "-", *(f"J{k}_deg" for k in range(1, 7))])
    assert 0.006 < log.step < 0.01 and log.commanded is None
    with pytest.raises(InputError, match=r"never rest|another program"):
        match(log, asked)


# Robots' files


def _fitted(tmp_path: Path, name: str, joints: tuple[int, ...]) -> tuple[RobotLog, list, dict]:
    _, cell = cell_of(name)
    asked = asked_of(name, joints=joints, most=60.0)
    recording = recorded(asked, truth_of(cell, delay=0.02))
    file = write_recording(tmp_path / "run.csv", recording, header(cell, commanded=True), commanded=True)
    read = read_log(file, cell)
    limits = cell.limits
    log, fits = fit_joints(match(read, asked), asked, (limits.velocity, limits.acceleration, limits.jerk))
    return read, fits, {fit.joint: fit_delay(log, asked, fit.joint) for fit in fits}


@pytest.mark.slow
def test_robots_files_are_copied_with_what_was_measured(tmp_path: Path) -> None:
    problem, cell = cell_of("cylinder_logo")
    read, fits, delays = _fitted(tmp_path, "cylinder_logo", (1, 6))
    robots, truth = robots_of(problem, cell), truth_of(cell)
    written = write_measured(robots, fits, delays, read.file, tmp_path / "mine")
    assert [path.name for path in written] == ["irb140_measured.yaml", "irbp_a250_measured.yaml"]
    arm, table = map(read_robot, written)
    old = read_robot(robots[0].path)
    assert arm.acceleration[1] == pytest.approx(truth.acceleration[1], rel=0.01)
    assert table.jerk[1] == pytest.approx(truth.jerk[6], rel=0.01) and table.jerk[0] == 250.0
    np.testing.assert_array_equal(arm.acceleration[[0, 2, 3, 4, 5]], old.acceleration[[0, 2, 3, 4, 5]])
    assert arm.measured.endswith("acceleration_rad_s2 of joint_2; jerk_rad_s3 of joint_2; from run.csv")
    assert "acceleration_rad_s2" in arm.assumed  # of the other joints it still is
    text, before = written[0].read_text(), robots[0].path.read_text()
    lost = [line for line in before.splitlines() if line not in text.splitlines()]
    assert {line.partition(":")[0] for line in lost} == {"urdf", "assumed", "acceleration_rad_s2", "jerk_rad_s3"}
    assert re.search(r"# joint_2: speed .* follows 20\.[0-9] ms late", text)
    with pytest.raises(OutputError, match="is there already"):
        from planner.feedback.identify_robot_file import check_targets

        check_targets(robots, tmp_path / "mine")


def test_a_measured_file_is_planned_with_and_measured_again(tmp_path: Path) -> None:
    problem, cell = cell_of("cylinder_logo")
    read, fits, delays = _fitted(tmp_path, "cylinder_logo", (3,))
    (path,) = write_measured(robots_of(problem, cell), fits, delays, read.file, tmp_path / "mine")
    again = load_problem("cylinder_logo", (f"cell.arm={path}",))
    assert build_cell(again).limits.acceleration[3] == pytest.approx(truth_of(cell).acceleration[3], rel=0.01)
    (second,) = write_measured(robots_of(again, build_cell(again)), fits, delays, read.file, tmp_path / "later")
    assert second.name == "irb140_measured.yaml" and "; before: " in read_robot(second).measured
    assert second.read_text().count("urdf:") == 1


@pytest.mark.slow
def test_nothing_is_left_where_a_file_cannot_be_written(tmp_path: Path) -> None:
    problem, cell = cell_of("cylinder_logo")
    read, fits, delays = _fitted(tmp_path, "cylinder_logo", (1, 6))
    (tmp_path / "irbp_a250_measured.yaml").write_text("mine")
    with pytest.raises(OutputError):
        write_measured(robots_of(problem, cell), fits, delays, read.file, tmp_path)
    assert not (tmp_path / "irb140_measured.yaml").exists()
    assert (tmp_path / "irbp_a250_measured.yaml").read_text() == "mine"


# The commands


@pytest.mark.slow
def test_the_commands_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["write", "cylinder_logo", "--most", "40"]) == EXIT_VERIFIED
    assert "joint_1" in capsys.readouterr().out
    problem, cell = cell_of("cylinder_logo")
    asked = read_asked(Path("out/cylinder_logo_identify/cylinder_logo_asked.json"), problem, cell)
    recording = recorded(asked, truth_of(cell, delay=0.02))
    write_recording(Path("run.csv"), recording, header(cell, commanded=True), commanded=True)
    assert main(["read", "run.csv", "cylinder_logo"]) == EXIT_VERIFIED
    said = capsys.readouterr().out
    assert "off the path of the commands: tip not shown" in said
    assert "joints follow their commands 20.0" in said and "irb140_measured.yaml" in said
    assert main(["read", "run.csv", "cylinder_logo"]) == EXIT_INPUT
    assert "is there already" in capsys.readouterr().err
    assert main(["read", "run.csv", "peer_cap"]) == EXIT_INPUT


def test_words_that_are_no_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["raed"]) == EXIT_INPUT and "did you mean read?" in capsys.readouterr().err
    assert main([]) == EXIT_INPUT
    assert main(["--help"]) == EXIT_VERIFIED and "write" in capsys.readouterr().out


@pytest.mark.slow
def test_a_recording_that_tells_nothing_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot that follows the points of a trajectory shows what these asked, not what it can do."""
    monkeypatch.chdir(tmp_path)
    _, cell = cell_of("peer_cap")
    asked = asked_of("peer_cap", "joint_trajectory", joints=(5,))
    limits = cell.limits
    recording = recorded(asked, TrueRobot(limits.velocity, limits.acceleration, limits.jerk))
    write_recording(Path("run.csv"), recording, header(cell))
    Path("peer_cap_asked.json").write_text(asked_text(asked))
    code = main(["read", "run.csv", "peer_cap"])
    said = capsys.readouterr().out
    assert code == EXIT_NOT_VERIFIED and "nothing written" in said and "as asked" in said
    assert not list(tmp_path.glob("*.yaml"))


# The simulator of externally guided motion


@pytest.mark.slow
def test_the_lag_of_the_simulated_egm_robot_is_found(tmp_path: Path) -> None:
    from planner.link.egm_wire import egm_wire
    from planner.simulate.egm import PERIOD, TIME_CONSTANT, EgmRobot

    _, cell = cell_of("cylinder_logo")
    asked = asked_of("cylinder_logo", joints=(2,), most=20.0)
    t, told = commands(asked, truth_of(cell))
    told = told[:: round(PERIOD / (t[1] - t[0]))]
    rows = []
    with egm_wire("127.0.0.1", 0) as wire:
        # its station has two axes, of which the cell's is the second
        stand = np.degrees(np.insert(told[0], 6, 0.0))
        robot = EgmRobot(("127.0.0.1", wire.port), stand, pace=5.0)
        try:
            until = clock.monotonic() + 60.0
            while len(rows) < len(told) and clock.monotonic() < until:
                if (state := wire.newest()) is not None:
                    reference = np.insert(told[len(rows)], 6, 0.0)
                    wire.send(reference)
                    rows.append((state.clock, np.delete(state.joints, 6), told[len(rows)]))
        finally:
            robot.close()
    stamps, joints, references = (np.array(column) for column in zip(*rows, strict=True))
    joints = joints + np.random.default_rng(1).normal(0.0, NOISE, joints.shape)
    file = write_recording(
        tmp_path / "run.csv", Recording(stamps, joints, references), header(cell, commanded=True), commanded=True
    )
    log = match(read_log(file, cell), asked)
    found = fit_delay(log, asked, 2)
    # a reference is held for a period: half of one on average, and one more where a busy machine answers late
    assert found is not None and 0.0 < found.total - TIME_CONSTANT < 1.5 * PERIOD + 2e-3
    assert found.lag == pytest.approx(TIME_CONSTANT, abs=2e-3)
