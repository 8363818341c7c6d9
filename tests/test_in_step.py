"""The extruder's board waits for the robot: what is written, what is found in a spoilt file, and how far both are apart."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.in_step import CASES, Case, apart, for_board, worst
from planner.base.errors import EXIT_INPUT, InputError
from planner.export.extruder import FILE, differences, gcode
from planner.export.in_step import READY, SEEN, SHARE, busy_ends, early, stretches
from planner.export.moves import passed
from planner.plan import Event, Plan
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.problem.settings import BoardSpec
from planner.simulate.board_file import GRACE, LEAST_SPEED, FileBoard, Output, print_file
from tests.export_fixtures import make_plan, resting_in_a_bead, with_board
from tests.solved import small_problem, solve_alone

APART = 0.020  # s
SHORT = make_plan(beads=1, length=0.020)
HELD = [
    case for case in CASES if case.words.startswith("in step") and not case.words.startswith("in step, Marlin, robot")
]


def spoilt(plan: Plan, text: str) -> list[str]:
    """What is found in another file."""
    try:
        return differences(plan, {FILE: text})
    except InputError as error:
        return [str(error)]


def commands(text: str) -> list[str]:
    return [line for line in text.splitlines() if not line.startswith(";")]


@given(st.lists(st.tuples(st.floats(-1.0, 12.0), st.floats(0.01, 3.0), st.floats(-5.0, 5.0)), max_size=20))
def test_what_events_move_comes_evenly_in_their_time(rows: list[tuple[float, float, float]]) -> None:
    """As a ramp over all samples for each of them."""
    t = 0.1 * np.arange(101)
    events = [Event("prime", -1, start, duration, amount) for start, duration, amount in rows]
    plain = np.zeros(101)
    for each in events:
        plain += each.amount * np.clip((t - each.start) / each.duration, 0.0, 1.0)
    np.testing.assert_allclose(passed(t, events, [each.amount for each in events]), plain, atol=1e-9)


def test_a_prime_comes_early_by_what_is_free_before_it() -> None:
    ends = [1.0, 4.0, 9.0]
    assert early(ends, 6.0, 2.0) == READY + 2.0 * SHARE  # since the event that ended at 4 s
    assert early(ends, 6.0, 5.0) == READY + 1.0 * SHARE
    assert early(ends, 9.0, 5.0) == 0.0 == early([], 5.0, 5.0)


def test_a_prime_does_not_come_before_the_end_of_a_bead_that_was_cut() -> None:
    t = resting_in_a_bead(make_plan(beads=2)).trajectory
    cut, end = t.events[0].start, float(t.t[np.flatnonzero(t.bead == 0)[-1]])
    assert early(busy_ends(t), end, cut) == 0.0
    assert early(busy_ends(t), end + 0.3, cut) == pytest.approx(READY + 0.3 * SHARE)


def test_the_board_waits_for_both_ends_of_each_bead() -> None:
    plan = make_plan(beads=3)
    lines = commands(gcode(plan))
    waits = [line for line in lines if line.startswith("M577")]
    assert waits == ["M577 P1 S1", "M577 P1 S0"] * 3
    assert lines[:5] == ["M203 I0.6", "M595 R0", "M83", "T0", "M577 P1 S1"]
    i = lines.index("M577 P1 S0")
    assert lines[i - 4] == "M400" and lines[i - 3].startswith("while sensors.gpIn[1].value == 1 && iterations < ")
    assert lines[i - 2].startswith("  G1 E") and lines[i - 1] == "  M400"
    assert spoilt(plan, gcode(plan)) == []


def test_each_material_has_an_input_of_its_own() -> None:
    plan = with_board(make_plan(materials=("pla", "pva")), input=4, tools=(0, 1))
    lines = commands(gcode(plan))
    assert [line for line in lines if line.startswith("M577")] == [f"M577 P{k} S{on}" for k in (4, 5) for on in (1, 0)]
    assert "doSupport to input 5" in gcode(plan)
    assert spoilt(plan, gcode(plan)) == []


@pytest.mark.parametrize("board", [{}, {"firmware": "marlin"}, {"rests": True}, {"sync": "free"}], ids=str)
def test_no_line_can_be_left_out(board: dict[str, object]) -> None:
    plan = with_board(make_plan(beads=2), **board)
    lines = gcode(plan).splitlines()
    assert spoilt(plan, "\n".join(lines) + "\n") == []
    for i, line in enumerate(lines):
        if line.startswith(";"):
            continue
        left = "\n".join(lines[:i] + lines[i + 1 :]) + "\n"
        # one M400 in front of what is repeated is enough
        assert spoilt(plan, left), f"line {i + 1}, {line}"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("M577 P1 S1", "M577 P2 S1", "it waits for robot signals other"),
        ("M577 P1 S0", "M577 P1 S1", "it waits for robot signals other"),
        ("M577", "M226", "it waits for robot signals other"),
        ("T0\n", "", "before a tool is selected"),
        ("T0\n", "T1\n", "tool T0 gets"),
        ("M595 R0\n", "", "it does not begin as"),
        ("gpIn[1]", "gpIn[2]", "too long, or depends on another output"),
        ("iterations < 13", "iterations < 999", "too long, or depends on another output"),
        ("  G1", "G1", "within a repetition"),
        ("  M400", "  G4 P5", "within a repetition"),
        ("M400\nwhile", "while", "without M400 before it"),
        ("M577 P1 S1\n; bead 0", "G4 P900\nM577 P1 S1\n; bead 0", "late for the bead"),
        ("G1 E0.99770 F299.310", "G1 E0.99770 F199.310", "s too long"),
        ("M577 P1 S0\n", "M577 P1 S0\nG1 E0.50000 F300.000\n", "tool T0 gets"),
    ],
)
def test_a_spoilt_file_is_told(old: str, new: str, says: str) -> None:
    plan = make_plan(beads=2, length=0.040) if "13" in old else make_plan(beads=2)
    text = gcode(plan)
    if "iterations" in old:
        old = next(line for line in text.splitlines() if "iterations" in line).partition("&& ")[2]
    assert old in text
    found = spoilt(plan, text.replace(old, new, 1))
    assert any(says in each for each in found), found


def test_filament_on_the_wrong_side_of_a_wait_is_told() -> None:
    plan = make_plan(beads=2)
    lines = gcode(plan).splitlines()
    i = lines.index("M577 P1 S1")
    moved = [*lines[:i], *lines[i + 1 : i + 3], lines[i], *lines[i + 3 :]]
    assert any("gets" in each for each in spoilt(plan, "\n".join(moved) + "\n"))


def test_marlin_begins_at_once() -> None:
    plan = with_board(make_plan(dip=False), firmware="marlin")
    text = gcode(plan)
    runs = [len([line for line in part.splitlines() if line.startswith("G1")]) for part in text.split("M226 P1 S1")[1:]]
    assert min(runs) >= 3 and "while" not in text and "M577" not in text and "\nT0\n" in text
    assert spoilt(plan, text) == []
    printed = print_file(text, FileBoard("marlin"), {1: Output(np.array([5.0, 20.0]), np.array([6.0, 21.0]))})
    assert not printed.warnings and printed.moves[0].start == pytest.approx(5.0, abs=APART)


def test_klipper_runs_by_time_from_rest_to_rest() -> None:
    plan = with_board(make_plan(), firmware="klipper", sync="free", acceleration_mm_s2=800)
    text = gcode(plan)
    assert spoilt(plan, text) == [] and "M595" not in text
    assert commands(text)[:2] == ["M83", "ACTIVATE_EXTRUDER EXTRUDER=extruder"]
    assert "as Klipper moves filament from rest to rest, at 800 mm/s2" in text
    printed = print_file(text, FileBoard("klipper", 800.0))
    reading = 2e-3 * len(text.splitlines())
    assert printed.end == pytest.approx(plan.trajectory.t[-1], abs=reading)
    # what it would take for the file of a board that joins moves
    longer = print_file(gcode(with_board(make_plan(), sync="free")), FileBoard("klipper", 800.0))
    assert longer.end > printed.end


def test_a_free_file_says_how_long_the_board_takes() -> None:
    plan = with_board(make_plan(beads=3), sync="free")
    (line,) = [line for line in gcode(plan).splitlines() if "by time alone" in line]
    duration = plan.trajectory.t[-1]
    assert f"{duration:.3f} s as RepRapFirmware joins moves; up to {duration + 3 * GRACE:.3f} s before 3.3" in line


def test_heat_of_several_tools_is_waited_for_one_by_one_where_there_is_no_m116() -> None:
    plan = make_plan(materials=("pla", "pva"))
    process = plan.problem.process
    start = process.start.model_copy(update={"heat": "wait"})
    problem = type(plan.problem)(**vars(plan.problem) | {"process": process.model_copy(update={"start": start})})
    mixed = type(plan)(**vars(plan) | {"problem": problem})
    text = gcode(with_board(mixed, firmware="marlin"))
    assert "M109 T1 S195\nM109 T0 S190\n" in text and "M116" not in text
    assert spoilt(with_board(mixed, firmware="marlin"), text) == []


def test_beads_between_which_the_output_is_hardly_off_are_one() -> None:
    plan = make_plan(beads=2)
    t = plan.trajectory
    deposit = t.deposit.copy()
    k = int(np.flatnonzero(deposit)[20])
    deposit[k : k + int(0.5 * SEEN / t.dt)] = False
    gap = type(plan)(**vars(plan) | {"trajectory": type(t)(**vars(t) | {"deposit": deposit})})
    assert stretches(gap) == stretches(plan)


@pytest.mark.parametrize("case", HELD, ids=[case.words for case in HELD])
@pytest.mark.parametrize("beads", [1, 5])
def test_board_and_robot_are_never_more_than_20_ms_apart(case: Case, beads: int) -> None:
    plan = make_plan(beads=beads, length=0.060)
    found = apart(plan, case)
    assert found.printed.waits is None and not found.printed.warnings
    limit = APART if "not told" not in case.words else 5 * APART
    assert abs(worst(found.begin)) <= APART
    assert abs(worst(found.end)) <= limit
    # what the robot is slower by is laid on top: the board knows no speed
    assert found.extra == pytest.approx(case.slower - 1.0, abs=0.015)


def test_a_free_file_leaves_the_robot() -> None:
    """Otherwise the limit above would say nothing."""
    plan = make_plan(beads=5, length=0.060)
    assert abs(worst(apart(plan, CASES[1]).begin)) > APART and abs(worst(apart(plan, CASES[2]).end)) > APART


@pytest.mark.slow(keep=("process.extruder.lag_s=0.05",))
@pytest.mark.parametrize(
    "change",
    [
        "process.retract={length_mm: 1, speed_mm_s: 30}",
        "process.extruder.lag_s=0.05",
        "process.fibre={cut_length_mm: 12, cut_wait_s: 2.5}",
        "process.fan={from_layer: 1}",
    ],
)
def test_primes_retracts_pressure_cuts_and_fans_keep_in_step(change: str) -> None:
    prime = ["process.prime={length_mm: 1, speed_mm_s: 30}"] if "retract" in change else []
    plan = solve_alone(load_problem(small_problem().file, [change, *prime]))
    text = gcode(plan)
    assert spoilt(plan, text) == []
    if "fibre" in change:
        parts = text.split("M577 P1 S1")
        assert "; cut, bead" not in parts[0] and len(parts) == 4
        assert all("; cut, bead" in part.split("M577 P1 S0")[1] for part in parts[1:])  # the output falls at the cut
    for slower in (1.0, 1.05):
        found = apart(plan, Case("", {}, slower=slower))
        assert found.printed.waits is None and abs(worst(found.begin)) <= APART
        if "fibre" not in change and ("lag" not in change or slower == 1.0):
            assert abs(worst(found.end)) <= APART + (0.02 if "lag" in change else 0.0)
    if not prime:
        return
    # a prime has ended before the robot begins, and a retract waits until the output is off
    its, printed = for_board(plan, BoardSpec()), apart(plan, Case("", {})).printed
    for event in (event for event in plan.trajectory.events if event.amount):
        amount = 1e3 * event.amount
        mine = [move for move in printed.moves if move.amount == pytest.approx(amount, abs=0.05)]
        near = min(mine, key=lambda move: abs(move.start - event.start))
        if event.kind == "prime":
            assert -0.3 < near.end - (event.start + event.duration) <= 0.01
        else:
            assert 0.0 <= near.start - event.start < APART
    assert len(stretches(its)) == len(plan.beads)


def test_a_board_without_a_tool_and_slow_filament() -> None:
    text = "M83\nG1 E1.0 F6.0\n"
    refused = print_file(text, FileBoard())
    assert refused.moves == () and "no tool selected" in refused.warnings[0]
    hasty = print_file("T0\n" + text, FileBoard())
    assert hasty.end == pytest.approx(1.0 / LEAST_SPEED, abs=0.05), "RepRapFirmware hurries below 0.5 mm/s"
    asked = print_file("M203 I0.6\nT0\n" + text, FileBoard())
    assert asked.end == pytest.approx(10.0, abs=0.05)


def test_a_board_waits_for_ever_for_an_output_that_nobody_switches() -> None:
    printed = print_file(gcode(make_plan()), FileBoard())
    assert printed.waits == 9 and printed.moves == ()
    klipper = print_file(gcode(make_plan()), FileBoard("klipper"))
    assert "M577 is no command" in klipper.warnings[0]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (["program.board={firmware: klipper}"], "klipper has no command that waits for an input"),
        (["program.board={tools: []}"], "a board without a tool moves no filament"),
        (["program.board={input: 56}"], "reprap has no input 56"),
        (["program.board={firmware: repetier}"], "choices: reprap, marlin, klipper"),
        (["program.board={sync: fre}"], "did you mean free?"),
        (
            ["process.materials={a: {}, b: {}}", "program.board={tools: [0]}"],
            "process.materials.b.tool: the board has no tool 1",
        ),
        (
            ["process.materials={a: {}, b: {}}", "program.board={input: 55}"],
            "2 materials need inputs up to 56, which reprap does not have",
        ),
        (
            ["program.board={firmware: klipper, sync: free}", "process.fan={number: 1}"],
            "Klipper's M106 has no fan 1",
        ),
        (
            [
                "program.board={firmware: klipper, sync: free}",
                "process.fibre={cut_length_mm: 9, cut_code: [M280 P0 S90]}",
            ],
            "Klipper has no M280",
        ),
    ],
)
def test_what_a_board_cannot_is_refused(changes: list[str], says: str) -> None:
    with pytest.raises(InputError) as refused:
        load_problem(small_problem().file, changes)
    assert says in str(refused.value)


def test_what_a_board_cannot_ends_with_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(small_problem().file), "--set", "program.board.firmware=klipper"]) == EXIT_INPUT
    said = capsys.readouterr().err
    assert "program.board.firmware" in said and "sync: free" in said and "Traceback" not in said


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_reader_of_garbled_files_finds_no_other_error(data: st.DataObject) -> None:
    plan = SHORT
    lines = gcode(plan).splitlines()
    k = data.draw(st.integers(0, len(lines) - 1))
    other = st.sampled_from(lines) | st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=30)
    line = data.draw(other)
    found = spoilt(plan, "\n".join([*lines[:k], line, *lines[k + 1 :]]) + "\n")
    same = line.strip() == lines[k].strip() and line.startswith(" ") == lines[k].startswith(" ")
    blank = not line.strip() or line.strip().startswith(";")
    if not same and not (blank and lines[k].startswith(";")):
        assert found or line.strip() in ("M83", "M400"), (k, line, lines[k])
