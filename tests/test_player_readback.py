"""Read-back by playing: a plan's own program has nothing to complain of, and whatever is tampered with is found."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from planner.base.errors import InputError
from planner.export.arcs import segments
from planner.export.languages import LANGUAGES
from planner.export.player.play import ACCELERATION, limited, play
from planner.export.player.played import laid_moves, laid_spans, laid_targets
from planner.export.rapid.extruder import flow
from planner.export.rapid.reader import read_rapid, read_rapid_files
from planner.export.rapid.text import ZONES
from planner.export.rapid.writer import rapid, rapid_files, zones_of
from planner.export.readback import ROUNDED, judge, readback
from planner.export.speeds import TIME_TOLERANCE
from tests.export_fixtures import demand_plan, make_plan, socket_plan, written_with

PLAN = make_plan()
PROGRAM = read_rapid(rapid(PLAN))
ON, OFF = (
    next(i for i in sorted(PROGRAM.triggers) if PROGRAM.triggers[i][0].value == value) for value in (True, False)
)
INSIDE = ON + 1  # the target of an arc within the first bead
LINE = ON + 3  # and of a line there
TRAVEL = 12  # a target of a joint move


def put(name, at, value):
    """The program with one row of an array changed, by a value or by a function of the row."""
    array = getattr(PROGRAM, name).copy()
    array[at] = value(array[at]) if callable(value) else value
    return replace(PROGRAM, **{name: array})


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"positioner": False},
        {"free": ("tilt", "rotation")},
        {"materials": ("pla", "pva")},
        {"dip": False, "beads": 5},
    ],
)
def test_a_plan_s_own_program_is_what_was_planned(options):
    plan = make_plan(**options)
    program = read_rapid(rapid(plan))
    found = judge(plan, program, play(program, plan.cell))
    assert found.differences() == []
    assert abs(found.laid - 1.0) < 0.02
    assert abs(found.worst - 1.0) < 0.02
    assert found.agreement.path < 0.06e-3
    assert found.agreement.axis < np.radians(0.105)
    assert found.agreement.late <= 8e-3
    assert found.agreement.event < 0.1e-3
    assert readback(plan, program) == []


def test_lines_are_sent_when_they_were_planned():
    plan = socket_plan()
    files = rapid_files(plan)
    program = read_rapid(next(text for name, text in files.items() if name.endswith(".mod")))
    assert readback(plan, program) == []
    played = play(program, plan.cell)
    sent = [event for event in played.events if event.kind == "send"]
    planned = [line.split(",", 4) for line in files["OneBead_lines.csv"].splitlines()[1:]]
    assert [event.text for event in sent] == [text for *_, text in planned]
    on = laid_spans(played)[0, 0]
    begin = plan.trajectory.t[np.flatnonzero(plan.trajectory.deposit)[0]]
    for event, (_, bead, _, t, _) in zip(sent, planned, strict=True):
        if bead == "0":  # travel has other times, ramps to the bead too
            assert event.t - on == pytest.approx(float(t) - begin, abs=0.03)
    differences = LANGUAGES["rapid"].differences
    assert differences(plan, files) == []
    text = files["OneBead.mod"]
    line = next(line for line in text.splitlines() if "G1 E" in line)
    with pytest.raises(InputError):
        differences(plan, files | {"OneBead.mod": text.replace(line + "\n", "", 1)})


def test_the_flow_that_is_asked_for_lays_what_was_planned():
    plan = demand_plan()
    files = rapid_files(plan)
    program = read_rapid_files(files)
    assert LANGUAGES["rapid"].differences(plan, files) == []
    played = play(program, plan.cell)
    asked = [event for event in played.events if event.kind == "demand"]
    assert len(asked) > 2
    assert asked[-1].value == 0.0
    t = np.array([event.t for event in asked])
    assert (np.diff(t) >= 0.0).all()
    volume = (np.array([event.value for event in asked])[:-1] * np.diff(t)).sum() / plan.problem.program.demand_scale
    planned = 1e9 * flow(plan) * plan.trajectory.dt  # mm3 of each sample
    late = planned.max() / plan.trajectory.dt * TIME_TOLERANCE  # speeds are even as long as they keep the clock
    assert volume == pytest.approx(planned.sum(), abs=late)


def moved_trigger(program, at, by):
    trigger = program.triggers[at][0]
    return replace(program, triggers=program.triggers | {at: (replace(trigger, distance=by),)})


def _rolled(q, angle):
    x, y, z, w = q
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return np.array([c * x + s * y, c * y - s * x, c * z + s * w, c * w - s * z])


def _turned(q, angle):
    x, y, z, w = q
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    return np.array([c * x + s * w, c * y + s * z, c * z - s * y, c * w - s * x])


TAMPERED = {
    "a target shifted by 0.2 mm": (put("position", INSIDE, lambda p: p + [0.2e-3, 0, 0]), "path differs"),
    "another shifted off its bead": (put("position", LINE, lambda p: p + [0, 0, 0.2e-3]), "path differs"),
    "an arc's point on the way shifted": (put("arcs", INSIDE, lambda p: p + [0.2e-3, 0, 0]), "path differs"),
    "another's shifted up": (put("arcs", OFF, lambda p: p + [0, 0, 0.2e-3]), "path differs"),
    "a line in place of an arc": (put("arcs", INSIDE, np.nan), "path differs"),
    "an arc in place of a line": (
        put("arcs", LINE, 0.5 * (PROGRAM.position[LINE - 1] + PROGRAM.position[LINE]) + [0.2e-3, 0, 0]),
        "path differs",
    ),
    "an arc the other way round": (
        put("arcs", INSIDE, lambda p: PROGRAM.position[INSIDE - 1] + PROGRAM.position[INSIDE] - p),
        "path differs",
    ),
    "a bead's end 0.2 mm early": (put("position", OFF, lambda p: p + [0, 0, 0.2e-3]), "event differs"),
    "too slow": (put("speed", INSIDE, lambda v: v * [0.8, 1, 1, 1]), "late differs"),
    "too quick": (put("speed", INSIDE, lambda v: v * [1.2, 1, 1, 1]), "late differs"),
    "a dip in speed left out": (put("speed", LINE, lambda v: v * [2.1, 1, 1, 1]), "late differs"),
    "travel too quick": (put("speed", TRAVEL, lambda v: v * [1.5, 1, 1, 1]), "pace differs"),
    "travel too slow": (put("speed", TRAVEL, lambda v: v * [0.5, 1, 1, 1]), "pace differs"),
    "a joint move in a bead": (put("linear", LINE, False), "swerves differs by 1 moves in beads"),
    "reorientation too slow": (replace(PROGRAM, speed=PROGRAM.speed * [1, 0.01, 1, 1]), "time of deposition"),
    "axis too slow": (replace(PROGRAM, speed=PROGRAM.speed * [1, 1, 1, 0.05]), "time of deposition"),
    "a stop within a bead": (put("fine", INSIDE, True), "stops at 1 targets within beads"),
    "a wide zone in travel": (
        replace(put("position", TRAVEL, lambda p: p + [0.02, 0, 0]), zone=np.where(PROGRAM.fine, 0.0, 0.02)),
        "a corner in travel is cut",
    ),
    "a trigger moved by 0.2 mm": (moved_trigger(PROGRAM, OFF, 0.2e-3), "event differs"),
    "a trigger at the wrong end": (moved_trigger(PROGRAM, ON, 10.0), "event differs"),
    "no trigger": (replace(PROGRAM, triggers={k: v for k, v in PROGRAM.triggers.items() if k != OFF}), "path differs"),
    "wrist flipped on a line": (put("conf", INSIDE, lambda c: c ^ [0, 0, 0, 1]), "not reached in their configuration"),
    "wrist flipped in travel": (put("conf", TRAVEL, lambda c: c ^ [0, 0, 0, 1]), "conf differs"),
    "a turn of axis 6 too many": (put("conf", TRAVEL, lambda c: c + [0, 0, 4, 0]), "conf differs"),
    "a wrong quarter of axis 4": (
        put("conf", INSIDE, lambda c: c + [0, 1, 0, 0]),
        "not reached in their configuration",
    ),
    "no configuration": (put("conf", INSIDE, lambda c: c + [0, 0, 0, 8]), "cannot be played"),
    "a swapped quaternion": (put("quat", INSIDE, lambda q: q[[1, 0, 2, 3]]), "axis differs"),
    "a leaning target": (put("quat", INSIDE, lambda q: _turned(q, np.radians(0.3))), "axis differs"),
    "a target turned about the nozzle": (put("quat", INSIDE, lambda q: _rolled(q, np.radians(0.6))), "roll differs"),
    "the table elsewhere": (put("external", INSIDE, lambda e: e + [0, 0.01, 0, 0, 0, 0]), "external differs"),
    "a held axis moved": (put("external", INSIDE, lambda e: e + [0.01, 0, 0, 0, 0, 0]), "cannot be played"),
    "another tool": (replace(PROGRAM, tool=PROGRAM.tool + [1e-4, 0, 0, 0, 0, 0, 0]), "frames differs"),
    "another work object": (replace(PROGRAM, oframe=PROGRAM.oframe + [0, 0, 1e-4, 0, 0, 0, 0]), "frames differs"),
    "out of reach": (put("position", INSIDE, lambda p: p + [0, 0, 3.0]), "cannot be played"),
    "a wait": (put("wait", INSIDE, 0.5), "wait differs"),
    "another start": (put("start", 2, lambda q: q + 0.01), "frames differs"),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_whatever_is_tampered_with_is_found(what):
    program, named = TAMPERED[what]
    differences = readback(PLAN, program)
    assert differences
    assert any(named in difference for difference in differences), differences


def test_a_wide_zone_at_a_corner_is_found():
    plan = written_with(PLAN, arcs=False)
    program, at = read_rapid(rapid(plan)), ON + 5
    zone, position = np.minimum(program.zone, 0.1e-3), program.position.copy()
    zone[at] = 5e-3
    way = position[at] - position[at - 1]
    position[at + 1] = position[at] + np.cross(way, [0, 0, 1.0])
    spoilt = replace(program, zone=zone, position=position)
    found = judge(plan, spoilt, play(spoilt, plan.cell))
    half = 0.5 * np.linalg.norm(np.diff(position, axis=0)[at - 1 : at + 1], axis=1).min()
    assert found.corner == pytest.approx(0.25 * half * np.sqrt(2.0), rel=0.01)
    assert any("corner in a bead is cut" in difference for difference in found.differences())


def test_spans_of_deposition_are_those_of_any_output():
    played = play(PROGRAM, PLAN.cell)
    spans = laid_spans(played)
    assert spans.shape == (2, 2)
    assert (np.diff(spans.ravel()) > 0.0).all()
    inside, edges = laid_targets(played)
    assert np.flatnonzero(edges).tolist() == sorted(PROGRAM.triggers)
    laid = laid_moves(played)
    assert np.flatnonzero(laid)[[0, -1]].tolist() == [ON + 1, max(PROGRAM.triggers)]
    assert (laid == (inside | (edges & np.append(False, inside[:-1])))).all()
    assert laid_spans(replace(played, events=())).shape == (0, 2)


def test_what_slows_a_program_down_is_named():
    assert limited(PROGRAM, play(PROGRAM, PLAN.cell)) == ()
    for column, by in ((1, "reorientation"), (3, "an axis of the station")):
        speed = PROGRAM.speed.copy()
        speed[INSIDE : INSIDE + 3, column] *= 0.01
        program = replace(PROGRAM, speed=speed)
        found = limited(program, play(program, PLAN.cell))
        assert found[0].by == by
        assert found[0].first == INSIDE
        assert found[0].moves == 3
        assert found[0].reached < 0.5
        assert by in found[0].words
    slow = replace(PLAN.cell, limits=replace(PLAN.cell.limits, velocity=0.02 * PLAN.cell.limits.velocity))
    names = {f"the speed limit of {name}" for name in slow.joint_names}
    found = {each.by for each in limited(PROGRAM, play(PROGRAM, slow))}
    assert found & names
    assert found <= names | {ACCELERATION}
    weak = replace(PLAN.cell, limits=replace(PLAN.cell.limits, acceleration=0.02 * PLAN.cell.limits.acceleration))
    assert [each.by for each in limited(PROGRAM, play(PROGRAM, weak))] == [ACCELERATION]


def turning(turn, size):
    """Two lines of one size [m] that turn by an angle [deg]."""
    turned = np.radians(turn)
    p = size * np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [np.cos(turned), np.sin(turned), 0.0]])
    lines = np.ones(2, dtype=bool)
    return SimpleNamespace(
        segments=segments(p[:-1], p[1:], p[1:], ~lines), linear=lines, fine=np.array([False, True]), sample=np.arange(2)
    )


@pytest.mark.parametrize(
    ("turn", "size", "zone"),
    [
        (0.0, 4e-3, "z5"),  # nothing is cut off: the zone covers half of the lines
        (0.0, 0.5e-3, "z0"),
        (5.0, 20e-3, "z1"),
        (20.0, 4e-3, "z0"),
        (45.0, 4e-3, "zon0_1"),
        (170.0, 0.4e-3, "zon0_1"),
    ],
)
def test_zones_are_as_wide_as_lines_and_corners_let_them(turn, size, zone):
    """Corners are cut by r tan(a / 4)."""
    assert zones_of(PLAN, turning(turn, size)) == [zone, "fine"]
    if zone != "zon0_1":  # the smallest there is
        assert min(ZONES[zone], 0.5 * size) * np.tan(0.25 * np.radians(turn)) <= PLAN.problem.program.chord


@pytest.mark.parametrize(
    ("chord", "zone"), [(0.05e-3, "zon0_1"), (0.02e-3, "zon0_1"), (0.0125e-3, "zon0_02"), (0.005e-3, "zon0_02")]
)
def test_right_angles_of_fine_programs_have_the_finest_zone(chord, zone):
    """In zon0_1 the parabola passes 0.035 mm inside, in zon0_02 0.007 mm; twice the chord and 0.005 mm are read back."""
    program = PLAN.problem.program.model_copy(update={"chord": chord})
    plan = replace(PLAN, problem=SimpleNamespace(**vars(PLAN.problem) | {"program": program}))
    assert zones_of(plan, turning(90.0, 4e-3)) == [zone, "fine"]
    assert 0.25 * ZONES[zone] * np.sqrt(2.0) <= 2.0 * chord + ROUNDED
