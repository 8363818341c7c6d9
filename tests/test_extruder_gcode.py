"""What the extruder's board is told besides filament: the cut's macro, heating that waits, and the fan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from gcodeparser import parse_gcode_lines
from solved import solve_alone

from planner.base.errors import InputError
from planner.export.extruder import FILE, LONGEST_S, _chunks, differences, gcode, read_gcode
from planner.motion.extrusion import feed, filament_area
from planner.plan import Event, Plan
from planner.problem import load_problem
from planner.problem.process import ProcessSpec
from tests.export_fixtures import make_plan, with_board
from tests.solved import small_problem

CUT = ["M106 P0 S1", "G4 P500", "M106 P0 S0", "G4 P500"]


def gcode_differences(plan: Plan, text: str) -> list[str]:
    """What the extruder's program says otherwise than its plan."""
    return differences(plan, {FILE: text})


def with_process(plan: Plan, **changes: object) -> Plan:
    """A plan whose process is told otherwise, by the keys of the file, and whose board runs by time alone."""
    usual = {"speed_mm_s": 40, "travel_speed_mm_s": 200, "bead": {"width_mm": 0.6, "height_mm": 0.5}}
    own = ProcessSpec(**usual | changes)
    problem = type(plan.problem)(**vars(plan.problem) | {"process": own})
    return with_board(replace(plan, problem=problem), sync="free")


def heated(**start: object) -> Plan:
    plan = with_process(make_plan(), start=start)
    return replace(plan, trajectory=replace(plan.trajectory, events=(Event("heat", -1, 0.0, 0.0, 0.0),)))


@cache
def with_fibre() -> Plan:
    return solve_alone(load_problem(small_problem().file, ["process.fibre={cut_length_mm: 12, cut_wait_s: 2.5}"]))


def times_of(text: str) -> list[tuple[float, str]]:
    """When each line is said [s]: a reader that shares nothing with the planner's."""
    now, said = 0.0, []
    for line in text.splitlines():
        words = {word[0]: word[1:] for word in line.split(";")[0].split()}
        said.append((now, line))
        if words.get("G") == "4":
            now += float(words["P"]) / 1000.0
        elif words.get("G") == "1":
            now += 60.0 * abs(float(words["E"])) / float(words["F"])
    return said


@pytest.mark.slow
def test_fibre_is_cut_by_the_published_macro_in_the_wait_that_is_planned() -> None:
    plan = with_board(with_fibre(), sync="free")
    text = gcode(plan)
    assert gcode_differences(plan, text) == []
    lines, said = text.splitlines(), times_of(text)
    cuts = [event for event in plan.trajectory.events if event.kind == "cut"]
    assert len(cuts) == 3
    for event in cuts:
        i = lines.index(f"; cut, bead {event.bead}")
        assert lines[i + 1 : i + 5] == CUT
        begins = event.start + 0.5 * (event.duration - 1.0)
        assert said[i][0] == pytest.approx(begins, abs=plan.trajectory.dt + 2e-3), "the cutter's second in the middle"
        moved = max(at for at, line in said[:i] if line.startswith(("G1", "G4")))
        assert moved <= event.start + plan.trajectory.dt + 2e-3
        moves = next((at for at, line in said[i:] if line.startswith("G1")), plan.trajectory.t[-1])
        assert moves - event.start >= event.duration - 2e-3, "no fibre moves while it is cut"
    # gcodeparser, which is somebody else's, sums up the same filament
    parsed = [each for each in parse_gcode_lines(text) if each.command == ("G", 1)]
    assert sum(each.params["E"] for each in parsed) == pytest.approx(plan.trajectory.feed[-1] * 1e3, abs=1e-3)


def test_a_short_wait_shortens_the_pauses_and_own_code_is_said_as_it_stands() -> None:
    fibre = {"cut_length_mm": 12, "cut_wait_s": 0.4}
    assert with_process(make_plan(), fibre=fibre).problem.process.fibre.code[1::2] == ("G4 P200", "G4 P200")
    own = ["M280 P0 S90", "G4 P250", "M280 P0 S0"]
    change = f"process.fibre={{cut_length_mm: 12, cut_wait_s: 2.5, cut_code: [{', '.join(own)}]}}"
    assert load_problem(small_problem().file, [change]).process.fibre.code == tuple(own)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("process.fibre={cut_length_mm: 9, cut_wait_s: 1, cut_code: [G4 P1001]}", "take 1.001 s, but cut_wait_s is 1"),
        ("process.fibre={cut_length_mm: 9, cut_code: [G1 E5]}", "'G1 E5' cannot be used here"),
        ("process.fibre={cut_length_mm: 9, cut_code: [M106 P0 S1 G1 E5]}", "'M106 P0 S1 G1 E5' cannot be used here"),
        (
            "process.fibre={cut_length_mm: 9, cut_wait_s: 1, cut_code: [M106 P0 S1 G4 P700 M106 P0 S0 G4 P400]}",
            "take 1.1 s, but cut_wait_s is 1",
        ),
        ("process.fibre={cut_length_mm: 9, cut_code: [M112]}", "'M112' cannot be used here"),
        ("process.fibre={cut_length_mm: 9, cut_code: []}", "must be 1 to 20 lines, not 0"),
        ("process.start={heat: wait}", "heat is wait, but no temperature is given"),
        ("process.start={heat: wiat, bed_c: 60}", "did you mean wait?"),
        ("process.fan={from_layer: 0}", "too small"),
    ],
)
def test_what_a_board_cannot_be_told_is_refused(change: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        load_problem(small_problem().file, [change])
    assert says in str(refused.value)


def test_the_temperature_of_a_material_can_be_waited_for() -> None:
    materials = "process.materials={{pla: {{{}}}, pva: {{}}}}"
    changes = ["process.start={heat: wait}", materials.format("nozzle_c: 205")]
    assert load_problem(small_problem().file, changes).process.nozzle_c("pla") == 205.0
    with pytest.raises(InputError, match="heat is wait, but no temperature is given") as refused:
        load_problem(small_problem().file, [changes[0], materials.format("")])
    assert refused.value.field == "--set process.start: process.start.heat"


def test_the_cutter_is_no_fan() -> None:
    changes = ["process.fibre={cut_length_mm: 9}", "process.fan={}"]
    with pytest.raises(InputError, match="fan output 0 is taken by the cutter"):
        load_problem(small_problem().file, changes)
    assert load_problem(small_problem().file, [*changes[:1], "process.fan={number: 2}"]).process.fan.number == 2
    for code in ("M106 S1, G4 P500", "M107", "M106 S1 P0"):  # without P it is fan 0
        own = f"process.fibre={{cut_length_mm: 9, cut_code: [{code}]}}"
        with pytest.raises(InputError, match="fan output 0 is taken by the cutter"):
            load_problem(small_problem().file, [own, "process.fan={}"])


def test_heat_is_waited_for_before_time_begins() -> None:
    plan = heated(nozzle_c=280, bed_c=60, heat="wait")
    text = gcode(plan)
    lines = [line for line in text.splitlines() if not line.startswith(";")]
    assert lines[2:8] == ["M83", "T0", "M140 S60", "M104 S280", "M190 S60", "M109 S280"]
    assert gcode_differences(plan, text) == []
    late = text.replace("M109 S280\n", "G4 P1\nM109 S280\n", 1)
    with pytest.raises(InputError, match="out of step with the robot"):
        read_gcode(late)


def test_several_tools_are_waited_for_without_selecting_them() -> None:
    plan = make_plan(materials=("pla", "pva"))
    process = plan.problem.process
    start = process.start.model_copy(update={"heat": "wait"})
    problem = type(plan.problem)(**vars(plan.problem) | {"process": process.model_copy(update={"start": start})})
    text = gcode(replace(plan, problem=problem))
    assert "M104 T1 S195\nM104 T0 S190\nM116\n" in text and "M109" not in text


def test_the_fan_follows_the_layers() -> None:
    plan = with_process(make_plan(beads=5), fan={"speed": 0.6, "number": 1})
    t, text = plan.trajectory, gcode(plan)
    assert gcode_differences(plan, text) == []
    said = [(at, line) for at, line in times_of(text) if line.startswith("M106")]
    assert [line for _, line in said] == ["M106 P1 S153", "M106 P1 S0"]
    # two beads a layer: the third one is the first of the second layer
    begins, before = t.t[(t.bead == 2).argmax()], t.t[(t.bead == 1).nonzero()[0][-1]]
    assert before < said[0][0] < begins and begins - said[0][0] < 0.02
    assert said[1][0] == pytest.approx(t.t[-1], abs=2e-3)


def between_layers(plan: Plan) -> tuple[float, float]:
    """When the last bead of the first layer has ended, and the first one of the second begins [s]."""
    t = plan.trajectory
    last, first = int(np.flatnonzero(t.bead == 1)[-1]), int(np.flatnonzero(t.bead == 2)[0])
    return float(t.t[last]) + 0.5 * t.dt, float(t.t[first]) - 0.5 * t.dt


def fed_with(plan: Plan, events: tuple[Event, ...], sync: str) -> Plan:
    """A plan whose filament is moved by these events as well, and ahead by the lag of its process."""
    t, process = plan.trajectory, plan.problem.process
    fed = feed(t.t, t.bead, t.extruded, t.flow, events, filament_area(process), process.extruder.lag)
    return with_board(replace(plan, trajectory=replace(t, feed=fed, events=events)), sync=sync)


@pytest.mark.parametrize("sync", ["free", "signal"])
@pytest.mark.parametrize("retracted", [0.0, 0.6, 1.0])
def test_the_fan_is_switched_before_filament_that_moves_until_the_layer_begins(sync: str, retracted: float) -> None:
    """Retract and prime share the way between two layers, so that one begins where the bead or the other ends."""
    plan = with_process(make_plan(beads=5), fan={})
    begin, end = between_layers(plan)
    middle = begin + retracted * (end - begin)
    retract, prime = Event("retract", 1, begin, middle - begin, -2e-3), Event("prime", 2, middle, end - middle, 2e-3)
    plan = fed_with(plan, tuple(event for event in (retract, prime) if event.duration > 0.0), sync)
    lines = gcode(plan).splitlines()
    assert gcode_differences(plan, "\n".join(lines)) == []
    moved = next(line for line in lines[lines.index("M106 P0 S255") :] if line.startswith("G1"))
    assert float(moved.split()[1][1:]) == pytest.approx(-2.0 if retracted else 2.0, abs=0.03)


@pytest.mark.parametrize("sync", ["free", "signal"])
def test_the_fan_is_switched_before_pressure_is_built_up(sync: str) -> None:
    """That takes some hundredths of a second, however long the lag is."""
    plan = with_process(make_plan(beads=5, dip=False), fan={}, extruder={"lag_s": 1.5})
    plan = fed_with(plan, (), sync)
    text = gcode(plan)
    assert gcode_differences(plan, text) == []
    begin, end = between_layers(plan)
    if sync == "free":
        (at,) = [at for at, line in times_of(text) if line == "M106 P0 S255"]
        assert begin < end - 0.05 < at < end - 0.02


def test_flow_within_a_bead_has_its_steps_however_fast_pressure_is_built_up() -> None:
    """Twenty times as fast as material is laid, for 40 ms; later 5 % less is laid."""
    plan = with_process(make_plan(beads=1, dip=False), extruder={"lag_s": 1.0})
    t = plan.trajectory
    moved, inside = np.diff(t.feed), np.flatnonzero(np.diff(t.extruded) > 0.0)
    usual = float(np.median(moved[inside]))
    moved[inside[:10]] *= 20.0
    moved[inside[len(inside) // 2 :]] *= 0.95
    plan = replace(plan, trajectory=replace(t, feed=np.append(0.0, np.cumsum(moved))))
    text = gcode(plan)
    assert gcode_differences(plan, text) == []
    rates = [float(line.split("F")[1]) / 60e3 * t.dt / usual for line in text.splitlines() if line.startswith("G1")]
    for rate in (1.0, 0.95):
        assert any(each == pytest.approx(rate, rel=4e-3) for each in rates)


@pytest.mark.parametrize(
    ("old", "new", "difference"),
    [
        ("M106 P1 S153", "M106 P1 S255", "sent other orders"),
        ("M106 P1 S153\n", "", "sent other orders"),
        ("; fan on\nM106 P1 S153\n", "M106 P1 S153\nG4 P40\n", "it lasts"),
        ("T0\n", "T0\nM106 P0 S1\n", "sent other orders"),
    ],
)
def test_a_board_that_is_told_otherwise_is_found(old: str, new: str, difference: str) -> None:
    plan = with_process(make_plan(beads=5), fan={"speed": 0.6, "number": 1})
    text = gcode(plan)
    assert text.count(old) == 1
    assert any(difference in each for each in gcode_differences(plan, text.replace(old, new)))


def test_an_order_at_another_time_is_found() -> None:
    plan = with_process(make_plan(beads=5), fan={"speed": 0.6, "number": 1})
    lines = gcode(plan).splitlines()
    i = lines.index("M106 P1 S153")
    pause = next(k for k in range(i, 0, -1) if lines[k].startswith("G4"))
    moved = [*lines[:pause], lines[i], *lines[pause:i], *lines[i + 1 :]]
    assert any("off its time" in each for each in gcode_differences(plan, "\n".join(moved) + "\n"))


def test_what_flow_differs_by_within_a_step_does_not_add_up_along_a_bead() -> None:
    """Half a minute, the second half of it 0.4 % slower, which is no step of the flow: as one line it would be 0.03 s of flow
    behind in the middle, 15 s times half of 0.4 %; of lines of 10 s the second one is, by 5 s times that."""
    dt, n = 0.02, 1501
    fed = np.append(0.0, np.cumsum(np.where(np.arange(n - 1) < 750, 1.0, 0.996) * dt))
    bead = np.zeros(n, dtype=np.int32)
    t = SimpleNamespace(t=dt * np.arange(n), dt=dt, feed=fed, extruded=fed, bead=bead, events=())
    problem = SimpleNamespace(process=SimpleNamespace(extruder=SimpleNamespace(lag=0.0)))
    cuts, label = _chunks(SimpleNamespace(problem=problem, trajectory=t))  # type: ignore[arg-type]
    np.testing.assert_allclose(np.diff(cuts) * dt, LONGEST_S)
    assert set(label.tolist()) == {0}
    off = np.abs(np.interp(np.arange(n), cuts, fed[cuts]) - fed).max()
    assert off == pytest.approx(5.0 * 0.5 * 0.004, rel=1e-6)


def test_nothing_comes_before_relative_extrusion() -> None:
    text = gcode(make_plan())
    with pytest.raises(InputError, match="is not allowed before M83"):
        read_gcode(text.replace("M83\n", "", 1))


def moves_of(lines: list[str]) -> list[int]:
    return [k for k, line in enumerate(lines) if line.startswith("G1 E")]


def all_at_once(lines: list[str]) -> list[str]:
    """The whole filament in the first move, at the rate that lasts as long as all."""
    moves = moves_of(lines)
    words = [line.split() for line in (lines[k] for k in moves)]
    amounts, rates = ([float(word[i][1:]) for word in words] for i in (1, 2))
    seconds = sum(abs(amount) / rate for amount, rate in zip(amounts, rates, strict=True))
    out = [line for k, line in enumerate(lines) if k not in moves]
    out.insert(moves[0], f"G1 E{sum(amounts):.5f} F{sum(amounts) / seconds:.3f}")
    return out


def backwards(lines: list[str]) -> list[str]:
    """All moves and pauses in reversed order."""
    own = [k for k, line in enumerate(lines) if line.startswith(("G1 E", "G4 P"))]
    out = list(lines)
    for k, other in zip(own, reversed(own), strict=True):
        out[k] = lines[other]
    return out


def with_pause_moved(lines: list[str]) -> list[str]:
    """The longest pause between beads behind the next bead's last move."""
    pauses = [
        k for k, line in enumerate(lines) if line.startswith("G4 P") and moves_of(lines)[0] < k < moves_of(lines)[-1]
    ]
    longest = max(pauses, key=lambda k: int(lines[k][4:]))
    behind = next((k for k in pauses if k > longest), len(lines))
    return [*lines[:longest], *lines[longest + 1 : behind], lines[longest], *lines[behind:]]


@pytest.mark.slow(keep=("klipper-backwards",))
@pytest.mark.parametrize("spoil", [all_at_once, backwards, with_pause_moved])
@pytest.mark.parametrize("firmware", ["reprap", "klipper"])
def test_filament_that_moves_when_it_is_not_due_is_found(
    firmware: str, spoil: Callable[[list[str]], list[str]]
) -> None:
    """In all it is as much, and lasts as long."""
    problem = load_problem(small_problem().file, ["process.prime={length_mm: 1, speed_mm_s: 30}"])
    plan = with_board(solve_alone(problem), firmware=firmware, sync="free")
    text = gcode(plan)
    assert differences(plan, {FILE: text}) == []
    found = differences(plan, {FILE: "\n".join(spoil(text.splitlines())) + "\n"})
    assert any("less filament than planned has moved" in each for each in found)
