"""Test programs that show limits: where joints go, what controllers are asked, and the file that says so."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING, obstacles_of
from planner.export.joint_trajectory import at_times, read_joint_trajectory
from planner.export.krl import from_kuka
from planner.feedback.identify_program import (
    FreeSpace,
    asked_moves,
    asked_text,
    common_space,
    free_spaces,
    greatest_lengths,
    language_of,
    moves_enough,
    program_files,
    read_asked,
    start_posture,
)
from tests.identify_fixtures import (
    UR,
    asked_of,
    cell_of,
)
from tests.test_nozzles import TWO, problem_of

# ---- what is asked -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_moves_stay_clear_of_the_cell_and_within_ranges() -> None:
    problem, cell = cell_of("cylinder_logo", "layers.count=1")
    from planner.toolpath.build import build_toolpath

    obstacles = obstacles_of(problem, cell, build_toolpath(problem))
    start = start_posture(cell, [20.0, 10.0, 35.0, 80.0, -80.0, 60.0, 10.0])
    spaces = free_spaces(cell, obstacles, start, greatest_lengths(cell, None))
    asked = asked_moves(problem, cell, start, spaces, "rapid")
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
    with pytest.raises(InputError, match=r"are .* mm too close at the start posture"):
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
    asked = asked_moves(problem, cell, cell.home, spaces, "rapid")
    assert not moves_enough(cell, 0, spaces[0]) and {move.joint for move in asked.moves} == set(range(1, 7))
    with pytest.raises(InputError, match="no joint has space"):
        asked_moves(problem, cell, cell.home, free_spaces(cell, NOTHING, cell.home, 0.0 * most), "rapid")


# ---- programs ------------------------------------------------------------------------------------------------------


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
    slow = [line for line in text.splitlines() if "[9999,100,9999,100]" in line]
    assert len(slow) == 4, "joints 1 and 2, there and back, at half of 200 degrees a second"


def test_all_joints_come_to_the_start_at_a_tenth_of_their_speed() -> None:
    """The rail too, whose metres a second are no degrees."""
    asked, (_, cell) = asked_of("rail_panel", "rapid"), cell_of("rail_panel")
    (text,) = program_files(cell, asked, "").values()
    first = next(line for line in text.splitlines() if "MoveAbsJ" in line)
    arm = 0.1 * np.degrees(cell.limits.velocity[1:].min())
    rail = 1e2 * cell.limits.velocity[0]
    np.testing.assert_allclose(_numbers(first.split("NoEOffs,")[1])[:4], [100.0, arm, rail, arm], atol=1e-3)
    slow = [line for line in text.splitlines() if f"[9999,9999,{500.0 * cell.limits.velocity[0]:g},9999]" in line]
    assert len(slow) == 2, "the rail alone, there and back, at half of its speed"


def test_a_second_arm_that_stands_still_is_no_unit() -> None:
    held = ("cell.positioner.free=[]",)
    asked, (_, cell) = asked_of("fibre_plane", "rapid", overrides=held), cell_of("fibre_plane", *held)
    (text,) = program_files(cell, asked, "").values()
    assert "MoveAbsJ" in text and "ActUnit" not in text and "DeactUnit" not in text


def test_a_krl_program_says_what_is_asked_as_kuka_counts() -> None:
    asked, (_, cell) = asked_of("peer_cap", "krl"), cell_of("peer_cap")
    (text,) = program_files(cell, asked, "").values()
    targets = [re.findall(r"A[1-6] (-?[0-9.]+)", line) for line in text.splitlines() if "PTP {" in line]
    np.testing.assert_allclose(from_kuka(np.radians(np.array(targets, float))), asked.postures, atol=1e-6)
    np.testing.assert_allclose(
        asked.counted.signs[:6] * asked.postures + asked.counted.offsets,
        np.radians(np.array(targets, float)),
        atol=1e-6,
    )
    assert "BAS(#VEL_PTP,100)" in text and "BAS(#VEL_PTP,25)" in text


def test_a_urscript_program_says_what_is_asked() -> None:
    asked, (_, cell) = asked_of("peer_cap", overrides=UR), cell_of("peer_cap", *UR)
    (text,) = program_files(cell, asked, "").values()
    lines = [line for line in text.splitlines() if "movej" in line]
    np.testing.assert_allclose([_numbers(line.partition("a=")[0])[:6] for line in lines], asked.postures, atol=1e-6)
    a, v, _ = np.array([_numbers(line.partition("], ")[2]) for line in lines[1:]]).T
    joints = [move.joint for move in asked.moves]
    np.testing.assert_allclose(a, cell.limits.acceleration[joints], rtol=1e-4)
    np.testing.assert_allclose(v, [m.share * cell.limits.velocity[m.joint] for m in asked.moves], rtol=1e-3)


@pytest.mark.slow
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
    with pytest.raises(InputError, match="not a Universal Robots arm"):
        language_of(problem, cell, "urscript")


@pytest.mark.parametrize("language", ["rapid", "krl", "joint_trajectory"])
def test_neither_nozzles_nor_what_a_run_has_taught_matter_to_joints(language: str) -> None:
    problem = problem_of(*TWO)
    taught = problem.model_copy(update={"as_run": {}})
    assert language_of(taught, build_cell(problem), language) == language


def test_what_is_free_is_free_with_every_nozzle() -> None:
    one, other = FreeSpace(-1.0, 2.0, ("a", "b")), FreeSpace(-0.5, 3.0, ("c", "d"))
    assert common_space([one, other]) == FreeSpace(-0.5, 2.0, ("c", "b"))
    assert common_space([one]) == one


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
        (lambda data: data.pop("moves"), "does not say what a test program asked"),
        (lambda data: data.pop("language"), "does not say what a test program asked"),
        (lambda data: data.update(moves=[]), "it has no moves"),
        (lambda data: data["moves"][0].update(joint="joint_9"), "does not say what a test program asked"),
        (lambda data: data["joints"].pop(), "is for joints"),
        (lambda data: data["joints"][0].update(unit="mm"), "slide"),
        (lambda data: data["joints"][0].update(start="x"), "does not say what a test program asked"),
        (lambda data: data["joints"][0].update(start=10**400), "does not say what a test program asked"),
        (lambda data: data["moves"][0].update(to=10**400), "does not say what a test program asked"),
        (lambda data: data["moves"][0].update(to=data["moves"][0]["from"] + 1e-6), "a move that goes nowhere"),
        (lambda data: data["moves"][0].update(to=float("inf")), "a move that goes nowhere, or endlessly far"),
        (lambda data: [joint.update(asked_speed=-1.0) for joint in data["joints"]], "one of its limits is not above 0"),
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


def test_every_move_that_is_asked_is_read_back(tmp_path: Path) -> None:
    """The shortest of all cells too: a joint that begins near an end of its space."""
    for name in ("cylinder_logo", "rail_panel", "peer_cap"):
        problem, cell = cell_of(name)
        for most in (8.0, 100.0):
            asked = asked_of(name, most=most)
            (tmp_path / "asked.json").write_text(asked_text(asked), encoding="utf-8")
            np.testing.assert_allclose(
                read_asked(tmp_path / "asked.json", problem, cell).postures, asked.postures, atol=1e-7
            )
