"""All that a process may ask for, in whole solves: verified, and said by the robot program, the G-code and plan.json."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from export_fixtures import with_board
from solved import sampled, small_problem, solve_alone

from planner.base.errors import InputError
from planner.export.extruder import gcode
from planner.export.plan_json import plan_json
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid
from planner.export.readback import compare
from planner.plan import Plan
from planner.planning.options import DEFAULT_DT
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.verify.verdict import verify

MM = 1e-3
COARSE = 0.02
ON_THE_NORMAL = 0.01 * MM  # m to the side, of a move along the part's normal
RESTS = 3e-3  # m/s of the tip: slower is a sample beside an instant of rest

RAMP = "process.ramp_deg=20"
PRIME = "process.prime={length_mm: 2, speed_mm_s: 20}"
RETRACT = "process.retract={length_mm: 1.5, speed_mm_s: 30}"
SLOW = ("process.prime={length_mm: 30, speed_mm_s: 5}", "process.retract={length_mm: 30, speed_mm_s: 5}")
START = "process.start={nozzle_c: 200, bed_c: 60, heat_wait_s: 4, purge_mm: 3, purge_speed_mm_s: 3}"
FIBRE = "process.fibre={cut_length_mm: 12, cut_wait_s: 2.5, clearance_mm: 20}"
PROCESSES = {
    "plain": (),
    "ramp": (RAMP,),
    "prime and retract": (PRIME, RETRACT),
    "slow prime and retract": SLOW,
    "start": (START,),
    "fibre": (FIBRE, "process.prime={speed_mm_s: 10}"),
    "fibre without a wait": ("process.fibre={cut_length_mm: 12, cut_wait_s: 0}",),
    "on or off": ("process.extruder={motor: on_off, flow_tolerance: 10}",),
    "speed demand": ("process.extruder.motor=speed_demand",),
    "lag": ("process.extruder.lag_s=0.05",),
    "rounded": ("process.bead.section=rounded",),
    "filament, all": (
        *(PRIME, RETRACT, START),
        "process.ramp_deg=45",
        "process.extruder={motor: speed_demand, lag_s: 0.05}",
        "process.bead.section=rounded",
    ),
    "fibre, all": (FIBRE, START, "process.ramp_deg=45", "process.extruder.motor=speed_demand"),
    "on or off, all": (
        *(RAMP, PRIME, START),
        "process.extruder={motor: on_off, flow_tolerance: 10}",
        "process.bead.section=rounded",
    ),
    "start and slow": (START, *SLOW),
}
FIBRES = [name for name in PROCESSES if name.startswith("fibre")]
# Checks that samples 20 ms apart may not hold, by where they fall: beside a cut, and with a lag of two and a half samples.
MAY_FAIL = {key: {"flow per millimetre", "fibre as long as its bead"} for key in FIBRES} | {
    "filament, all": {"flow per millimetre"}
}
# All of them at the two usual rates; very fine and very coarse only those that ask for everything, and fibres.
TOGETHER = ["plain", "start and slow", *(name for name in PROCESSES if name.endswith("all"))]
SAMPLED = [(name, dt) for name in PROCESSES for dt in (0.001, 0.004)]
SAMPLED += [(name, 0.0005) for name in TOGETHER] + [(name, COARSE) for name in dict.fromkeys([*TOGETHER, *FIBRES])]
REASON = "samples 20 ms apart may be too coarse"


@cache
def solved(name: str, dt: float = DEFAULT_DT) -> Plan:
    if dt != DEFAULT_DT:
        return sampled(solved(name), dt)
    return solve_alone(load_problem(small_problem().file, PROCESSES[name]))


def pushed(text: str) -> tuple[float, float]:
    """Filament [mm] that G-code pushes, and how long it lasts [s]."""
    total, seconds = 0.0, 0.0
    for line in text.splitlines():
        code = line.split(";")[0].strip()
        if move := re.fullmatch(r"G1 E(-?[\d.]+) F([\d.]+)", code):
            total += float(move[1])
            seconds += 60.0 * abs(float(move[1])) / float(move[2])
        elif pause := re.fullmatch(r"G4 P(\d+)", code):
            seconds += 1e-3 * int(pause[1])
        else:
            assert code in ("", "M83") or re.fullmatch(r"M1[04][04] S\d+|M106 P0 S[01]|M203 I0\.6|M595 R0|T0", code), (
                line
            )
    return total, seconds


def waits_of(text: str) -> list[tuple[str, float]]:
    """What the comment over each wait of a RAPID module says, and how long it is [s]."""
    found = re.findall(r"(?:! ([^\n]*)\n\s*)?WaitTime ([\d.]+);", text)
    return [(why, float(time)) for why, time in found]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plain", "fibre, all"])
def test_other_samples_are_those_of_another_solve(name: str) -> None:
    again, plan = solve_alone(load_problem(small_problem().file, PROCESSES[name]), dt=0.001), solved(name, 0.001)
    gap = {"bound_gap_fraction": 0.0}  # whose time was found with the other samples
    assert (plan.checks, plan.metrics | gap) == (again.checks, again.metrics | gap)
    for field, values in vars(again.trajectory).items():
        np.testing.assert_array_equal(getattr(plan.trajectory, field), values, err_msg=field)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "dt"), SAMPLED)
def test_a_whole_solve_holds_and_is_written_as_it_is(name: str, dt: float) -> None:
    plan = solved(name, dt)
    wrong = [check for check in plan.checks if not check.ok]
    if wrong and dt == COARSE:
        assert {check.name for check in wrong} <= MAY_FAIL.get(name, set())
        assert all("bead " in check.where and REASON in check.where for check in wrong)
        return
    assert wrong == []
    assert plan.metrics["jerk_ratio_max"] <= 1.0
    assert compare(plan, read_rapid(rapid(plan))).differences() == []

    t = plan.trajectory
    total, seconds = pushed(
        gcode(with_board(plan, sync="free"))
    )  # the other waits for the robot: its time is not its own
    assert total == pytest.approx(t.feed[-1] / MM, abs=1e-4)
    assert seconds == pytest.approx(t.t[-1], abs=2e-3)
    told = json.loads(plan_json(plan))["events"]
    assert [(e["kind"], e["bead"], e["start_s"]) for e in told] == [(e.kind, e.bead, e.start) for e in t.events]
    assert {e["kind"] for e in told} == kinds(name)


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.004, COARSE])
def test_a_check_that_fails_says_where_samples_are_coarse(dt: float) -> None:
    plan = solved("plain", dt)
    more = replace(plan.trajectory, feed=1.01 * plan.trajectory.feed)
    checks = verify(plan.problem, plan.cell, plan.toolpath, more).checks
    where = next(check.where for check in checks if check.name == "flow per millimetre" and not check.ok)
    assert (REASON in where) == (dt == COARSE)


def kinds(name: str) -> set[str]:
    """Events that a process asks for."""
    process = load_problem(small_problem().file, PROCESSES[name]).process
    asked = {
        "heat": process.start.heat_wait > 0.0,
        "purge": process.start.purge > 0.0,
        "prime": process.prime_length > 0.0,
        "retract": process.retract.length > 0.0,
        "cut": process.fibre is not None,
    }
    return {kind for kind, is_asked in asked.items() if is_asked}


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ((FIBRE, "process.extruder.motor=on_off"), "a motor that is only on or off cannot"),
        ((FIBRE, "process.extruder.lag_s=0.05"), "a fibre does not lag"),
        ((FIBRE, RETRACT), "there is fibre"),
        (("process.fibre={cut_length_mm: 100}",), "too short for cut fibre"),
        ((RETRACT, "process.extruder.motor=on_off"), "cannot pull filament back"),
        (("process.extruder={motor: on_off, lag_s: 0.05}",), "cannot make up for lag_s"),
        (("process.bead={width_mm: 0.4, height_mm: 0.5, section: rounded}",), "rounded bead cannot be"),
    ],
)
def test_what_makes_no_sense_together_is_refused(wrong: tuple[str, ...], named: str) -> None:
    with pytest.raises(InputError, match=named):
        solve(load_problem(small_problem().file, wrong))


# --- the robot program --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_heating_and_purge_are_waited_for_at_home() -> None:
    plan = solved("start")
    text = rapid(plan)
    assert waits_of(text) == [("heat", 4.0), ("purge", 1.0)]
    start = text[text.index("PROC Start()") :]
    assert start.index("WaitTime") < start.index("ENDPROC")
    assert np.ptp(plan.trajectory.q[plan.trajectory.t <= 5.0], axis=0).max() == 0.0


@pytest.mark.slow
def test_heating_lasts_as_long_as_it_may() -> None:
    plan = solve_alone(load_problem(small_problem().file, ["process.start.heat_wait_s=3600"]), dt=COARSE)
    assert plan.verified
    assert waits_of(rapid(plan)) == [("heat", 3600.0)]
    assert compare(plan, read_rapid(rapid(plan))).differences() == []


@pytest.mark.slow
@pytest.mark.parametrize("name", FIBRES)
def test_fibre_is_cut_at_rest_on_a_line_where_it_ends_at_the_end(name: str) -> None:
    plan = solved(name, 0.001)
    text, t = rapid(plan), plan.trajectory
    wait = plan.problem.process.fibre.cut_wait if plan.problem.process.fibre else 0.0
    assert [found for found in waits_of(text) if found[0].startswith("cut")] == [
        (f"cut, bead {i}", wait) for i in range(3) if wait > 0.0
    ]
    program = read_rapid(text)
    for event in (event for event in t.events if event.kind == "cut"):
        k = int(np.argmin(np.abs(t.t - event.start - 0.5 * event.duration)))
        assert t.deposit[k]
        assert t.s[k] == pytest.approx(plan.toolpath.beads[event.bead].length - 12.0 * MM, abs=1e-6)
        near = np.flatnonzero(np.linalg.norm(program.position - t.tip[k], axis=1) < 2e-6)
        (at,) = (int(i) for i in near if program.fine[i])
        assert program.linear[at]
        assert program.wait[at] == pytest.approx(wait)
        # signal of the extruder: on from the start of the bead to its cut, behind which fibre is drawn
        assert [each.value for each in program.triggers[at]] == [False]


@pytest.mark.slow(cases=("slow prime*", "start-WaitTime*", "fibre-WaitTime*"))
@pytest.mark.parametrize(
    ("name", "pattern", "change"),
    [
        ("start", r"WaitTime 4\.000;", "WaitTime 3.900;"),
        ("start", r" *WaitTime 1\.000;\n", ""),
        ("fibre", r"WaitTime 2\.500;", "WaitTime 2.400;"),
        ("fibre", r" *WaitTime 2\.500;\n", ""),
        ("fibre", r"fine(,tNozzle[^\n]*\n *! cut, bead 1)", r"z0\1"),
        ("fibre", r"TriggL([^\n]*),trgOff,(fine[^\n]*\n *! cut, bead 1)", r"MoveJ\1,\2"),
        ("fibre without a wait", r"fine(,tNozzle[^\n]*\n *! cut, bead 1)", r"z0\1"),
        ("slow prime and retract", r"WaitTime 11\.(\d)", r"WaitTime 12.\1"),
    ],
)
def test_a_program_that_waits_otherwise_is_found(name: str, pattern: str, change: str) -> None:
    plan = solved(name)
    text = rapid(plan).replace(plan.problem.program.tool, "tNozzle")
    assert compare(plan, read_rapid(text)).differences() == []
    spoilt, count = re.subn(pattern, change, text, count=1)
    assert count == 1
    assert any(difference.startswith("wait") for difference in compare(plan, read_rapid(spoilt)).differences())


def test_a_wait_at_another_place_is_found() -> None:
    plan = solved("fibre")
    lines = rapid(plan).splitlines()
    i = next(i for i, line in enumerate(lines) if "cut, bead 0" in line)
    lines[i - 1 : i + 2] = [lines[i], lines[i + 1], lines[i - 1]]  # the wait before the move to the cut
    assert any(text.startswith("wait") for text in compare(plan, read_rapid("\n".join(lines))).differences())


def test_nothing_is_laid_in_the_rests_at_cuts() -> None:
    plan = solved("fibre")
    t, rests = plan.trajectory, 3 * 2.5
    laid = t.deposit.sum() * t.dt - rests
    assert plan.metrics["deposition_time_s"] == pytest.approx(laid, abs=3 * 2 * t.dt)
    assert plan.metrics["bound_gap_fraction"] < 0.5 * rests / plan.metrics["bound_any_path_s"]


def test_a_wait_before_the_first_target_is_not_known() -> None:
    text = rapid(solved("start"))
    with pytest.raises(InputError, match="a wait before the first target"):
        read_rapid(text.replace("        SingArea", "        WaitTime 1.000;\n        SingArea", 1))


# --- between beads ------------------------------------------------------------------------------------------


@pytest.mark.slow(cases=("fibre, all",))
@pytest.mark.parametrize("name", FIBRES)
def test_fibre_is_left_and_reached_along_the_normal(name: str) -> None:
    plan = solved(name, 0.001)
    t, lift = plan.trajectory, plan.problem.process.lift
    for i in range(len(plan.toolpath.beads)):
        surface, at = plan.toolpath.surface.before(i + 1), np.flatnonzero(t.bead == i)
        for step, k in ((1, int(at[-1])), (-1, int(at[0]))):
            while t.speed[k + step] > RESTS:
                k += step
            run_end = t.tip[k + step]
            normal = surface.normals(run_end[None])[0]
            way = t.tip[k + step :: step] - run_end
            height = way @ normal
            clear = int(np.argmax(height > lift - 0.02 * MM))
            assert clear > 10
            aside = np.linalg.norm(way - height[:, None] * normal, axis=1)[: clear + 1]
            assert aside.max() < ON_THE_NORMAL
            assert (np.diff(height[: clear + 1]) > -1e-9).all()


def test_without_fibre_the_nozzle_moves_sideways_while_it_lifts() -> None:
    """So the test above can fail."""
    plan = solved("plain", 0.001)
    t, k = plan.trajectory, int(np.flatnonzero(plan.trajectory.bead == 0)[-1])
    while t.speed[k + 1] > RESTS:
        k += 1
    normal = plan.toolpath.surface.before(1).normals(t.tip[k][None])[0]
    way = t.tip[k:] - t.tip[k]
    height = way @ normal
    clear = int(np.argmax(height > 2.0 * MM))
    assert np.linalg.norm(way[clear] - height[clear] * normal) > ON_THE_NORMAL


@pytest.mark.slow
def test_a_slow_retract_is_waited_for_above_the_part() -> None:
    """30 mm of filament at 5 mm/s take 6 s, back and forth 12 s."""
    plan = solved("slow prime and retract")
    t = plan.trajectory
    switched = np.diff(t.deposit.astype(int))
    begins, ends = np.flatnonzero(switched > 0), np.flatnonzero(switched < 0)
    pauses = t.t[begins[1:]] - t.t[ends[:-1]]
    assert pauses == pytest.approx([12.0, 12.0], abs=0.02)
    height = plan.toolpath.surface.signed_distance(t.tip)
    for a, b in zip(ends[:-1], begins[1:], strict=True):
        low = height[a:b] < plan.problem.process.lift
        assert low.sum() * t.dt < 1.0  # runs, up and down again
    assert [why for why, _ in waits_of(rapid(plan))] == [
        "prime, bead 0",
        "retract, bead 0; prime, bead 1",
        "retract, bead 1; prime, bead 2",
        "retract, bead 2",
    ]


@pytest.mark.slow
def test_what_is_short_takes_no_longer() -> None:
    plain, primed = (solved(name).metrics["print_time_s"] for name in ("plain", "prime and retract"))
    assert primed == pytest.approx(plain, abs=0.2)


@pytest.mark.slow
def test_what_the_motor_does_is_no_matter_to_the_motion() -> None:
    for name in ("lag", "speed demand", "on or off", "rounded"):
        np.testing.assert_array_equal(solved("plain").trajectory.q, solved(name).trajectory.q)
