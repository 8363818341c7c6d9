"""What differs by layer: speeds of layers and beads, how long a layer takes at least, pauses; in the plan, in what is checked
and in what is written."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from solved import small_plan, solve_alone, write_small

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.extruder import FILE, differences, gcode
from planner.export.languages import LANGUAGES
from planner.export.plan_json import plan_json
from planner.export.program import resumed
from planner.motion.visits import visits
from planner.plan import Event, Plan
from planner.planning.check_command import one_layer
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.by_layer import LayerTimeSpec, SpeedSpec
from planner.problem.process import ProcessSpec
from planner.report import plots
from planner.report.channels import channels
from planner.report.charts import time_charts
from planner.report.places import dip_place, dips_section
from planner.report.summary import print_summary
from planner.report.wording import resumed_words
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.speeds import commanded_speeds, mean_speed
from planner.toolpath.split import split_toolpath
from planner.verify.checks import asked_speeds
from planner.verify.verdict import verify

MM = 1e-3
THREE = ("  count: 1", "  count: 3")
SPEED = "  speed_mm_s: 40\n"
SPEEDS = """\
  speeds:
    - {to_layer: 1, speed_mm_s: 20}
    - {beads: 'ri?g*', from_layer: 2, speed_mm_s: 30}
"""
PAUSE = "  pauses: [{before_layer: 3, wait_s: 3, for: put the nut in, purge_mm: 10}]\n"
COOL = "  layer_time: {least_s: 12, slowest_mm_s: 15}\n"
ALL = SPEED + SPEEDS + PAUSE + COOL + "  retract: {length_mm: 1}\n  prime: {length_mm: 1}\n"


def problem_of(process: str, *changes: tuple[str, str]) -> Problem:
    with tempfile.TemporaryDirectory() as folder:
        return load_problem(write_small(Path(folder), THREE, (SPEED, process), *changes))


def toolpath_of(process: str, *changes: tuple[str, str], overrides: tuple[str, ...] = ()) -> tuple[Problem, Toolpath]:
    with tempfile.TemporaryDirectory() as folder:
        problem = load_problem(write_small(Path(folder), THREE, (SPEED, process), *changes), overrides)
        return problem, build_toolpath(problem)


@cache
def by_layer() -> Plan:
    """The small print in three layers with all that can be asked of layers, solved once."""
    with tempfile.TemporaryDirectory() as folder:
        return solve_alone(load_problem(write_small(Path(folder), THREE, (SPEED, ALL))))


def test_a_layer_that_was_begun_before_the_rest_is_not_begun_again() -> None:
    """Beads of layers 1 and 3 in turn: the pause before layer 3 is over when the last two are printed alone."""
    problem, toolpath = toolpath_of(SPEED + PAUSE)
    of_layer = [[bead for bead in toolpath.beads if bead.layer == layer] for layer in (0, 2)]
    beads = [bead for pair in zip(*of_layer, strict=True) for bead in pair][:4]
    timed: list[Any] = [None] * 4  # nobody asks how long they take
    assert {i: visit.pause for i, visit in visits(problem.process, beads, timed).items()} == {
        1: problem.process.pauses[0]
    }
    assert visits(problem.process, beads, timed[:2]) == {}


def failed(plan: Plan) -> set[str]:
    checks = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory).checks
    return {check.name for check in checks if not check.ok}


def begins(plan: Plan) -> Array:
    """When layers begin [s]."""
    t = plan.trajectory
    laid = np.flatnonzero(t.deposit)
    return np.array([t.t[laid[t.layer[laid] == layer][0]] for layer in range(3)])


def test_the_least_time_of_a_layer_is_told_and_of_a_single_layer_none() -> None:
    for plan in (by_layer(), small_plan()):
        process = plan.problem.process.model_copy(update={"layer_time": LayerTimeSpec(least_s=2.0)})
        problem = plan.problem.model_copy(update={"process": process})
        checks = verify(problem, plan.cell, plan.toolpath, plan.trajectory).checks
        (check,) = (check for check in checks if check.name == "time of a layer")
        assert check.ok
        if plan is by_layer():
            assert check.worst == pytest.approx(np.diff(begins(plan)).min())
        else:
            assert (check.worst, check.where) == (2.0, "everywhere")


# --- the problem file --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("process", "field", "reason", "hint"),
    [
        ("  speeds: [{speed_mm_s: 20, from_layer: 3, to_layer: 2}]\n", "process.speeds.from_layer", "to_layer is 2", "a later one"),
        ("  speeds: [{from_layer: 3}]\n", "process.speeds.speed_mm_s", "is missing", "speed of the nozzle"),
        ("  speeds: [{speed: 20}]\n", "process.speeds.speed", "unknown key", "speed_mm_s"),
        ("  speeds: 20\n", "process.speeds", "must be a list", "other speeds"),
        ("  speeds: [{speed_mm_s: 20}, {speed_mm_s: 0}]\n", "process.speeds.speed_mm_s", "0", "0.1 to 2000"),
        ("  speeds: [{speed_mm_s: 201}]\n", "process.travel_speed_mm_s", "travel_speed_mm_s is 200, below a speed_mm_s of 201", "run-ins"),
        ("  layer_time: {}\n", "process.layer_time.least_s", "is missing", "least time from a layer's start"),
        ("  layer_time: {least_s: 9, slowest_mm_s: 41}\n", "process.layer_time", "slowest_mm_s is 41", "a lower one"),
        ("  pauses: [{before_layer: 1, wait_s: 3}]\n", "process.pauses.before_layer", "1", "2 to 100000"),
        ("  pauses: [{before_layer: 2, wait_s: 3}, {before_layer: 2, wait_s: 4}]\n", "process.pauses", "two pauses before layer 2", "one of them"),
        ("  pauses: [{before_layer: 2, wait_s: 3, for: 'Öffnen'}]\n", "process.pauses.for", "cannot be", "plain letters"),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_of_layers(process: str, field: str, reason: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        problem_of(SPEED + process)
    error = caught.value
    assert (error.field, error.line is not None) == (field, True)
    assert reason in error.reason
    assert hint in (error.hint or "")


@pytest.mark.parametrize(
    ("process", "field", "reason", "hint"),
    [
        ("  speeds: [{speed_mm_s: 20, from_layer: 4}]\n", "process.speeds.from_layer", "there is no layer 4", "there are 3"),
        ("  speeds: [{speed_mm_s: 20, beads: rign}]\n", "process.speeds.beads", "no bead is called 'rign'", "did you mean ring?"),
        ("  speeds: [{speed_mm_s: 20, beads: 'top*'}]\n", "process.speeds.beads", "no bead is called 'top*'", "wave"),
        ("  pauses: [{before_layer: 4, wait_s: 3}]\n", "process.pauses.before_layer", "there is no layer 4", "there are 3"),
    ],
)  # fmt: skip
def test_layers_and_beads_that_there_are_not(process: str, field: str, reason: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        toolpath_of(SPEED + process)
    assert (caught.value.field, caught.value.reason) == (field, reason)
    assert hint in (caught.value.hint or "")


def test_a_draft_of_some_layers_ignores_what_is_asked_of_others() -> None:
    process = SPEED + "  speeds: [{speed_mm_s: 20, from_layer: 3}]\n" + PAUSE
    problem, toolpath = toolpath_of(process, overrides=("layers.count=1",))
    assert [bead.commanded(problem.process.speed) for bead in toolpath.beads] == [0.04] * 3
    one = one_layer(problem_of(process)).process
    assert (one.speeds, one.pauses, one.layer_time) == ((), (), None)


# --- speeds ------------------------------------------------------------------------------------------------


def test_of_several_speeds_of_a_bead_the_last_counts() -> None:
    problem, toolpath = toolpath_of(
        SPEED + SPEEDS + "    - {beads: wave, from_layer: 3, to_layer: 3, speed_mm_s: 60}\n"
    )
    found = {(bead.layer, bead.name): bead.commanded(problem.process.speed) / MM for bead in toolpath.beads}
    assert found == pytest.approx(
        {(0, name): 20 for name in ("zigzag", "ring", "wave")}
        | {(k, "zigzag"): 40 for k in (1, 2)}
        | {(k, "ring"): 30 for k in (1, 2)}
        | {(1, "wave"): 40, (2, "wave"): 60}
    )
    lengths = np.array([bead.length for bead in toolpath.beads])
    time = (lengths / commanded_speeds(problem.process, toolpath)).sum()
    assert mean_speed(problem.process, toolpath) == pytest.approx(lengths.sum() / time)


def test_names_are_patterns_of_stars_and_question_marks_alone() -> None:
    def covers(beads: str, name: str) -> bool:
        return SpeedSpec(speed_mm_s=20, beads=beads).covers(name, 0)

    assert covers("path * (*infill)", "path 3 (Solid infill)")
    assert covers("bead [a]", "bead [a]")
    assert not covers("bead [a]", "bead a")
    assert not covers("bead.", "beads")
    assert covers("*", "any\nname")


def test_a_layer_that_would_be_too_quick_is_laid_more_slowly_but_for_the_last_one() -> None:
    problem, toolpath = toolpath_of(SPEED + SPEEDS + "  layer_time: {least_s: 4, slowest_mm_s: 10}\n")
    speeds = np.array([bead.commanded(problem.process.speed) for bead in toolpath.beads])
    lengths, layers = np.array([bead.length for bead in toolpath.beads]), np.array([b.layer for b in toolpath.beads])
    times = np.bincount(layers, lengths / speeds)
    assert times[0] > 4.0  # at 20 mm/s it takes long enough
    assert times[1] == pytest.approx(4.0)
    assert times[2] < 4.0
    assert speeds[layers == 1].min() / speeds[layers == 1].max() == pytest.approx(30 / 40)
    assert any("layer 2 is laid more slowly than asked" in note for note in toolpath.notes)
    slow = (
        SPEED
        + "  speeds: [{beads: ring, from_layer: 3, speed_mm_s: 1}]\n  layer_time: {least_s: 4, slowest_mm_s: 10}\n"
    )
    (note,) = [note for note in toolpath_of(slow)[1].notes if "more slowly" in note]
    lowest = min(bead.speed for bead in toolpath_of(slow)[1].beads if bead.layer < 2 and bead.speed is not None)
    assert f"down to {lowest / MM:.3g} mm/s" in note  # not the 1 mm/s that was asked for


@given(
    rules=st.lists(
        st.tuples(
            st.floats(0.1, 2000), st.integers(1, 3), st.integers(0, 2), st.sampled_from(["*", "r?ng", "w*", "*g*"])
        ),
        max_size=4,
    ),
    least=st.none() | st.floats(0.1, 3600),
)
def test_the_verifier_asks_for_the_same_speeds(rules: list[tuple[float, int, int, str]], least: float | None) -> None:
    process, toolpath = plain()
    specs = tuple(
        SpeedSpec(speed_mm_s=v, from_layer=k, to_layer=k + more if more else None, beads=beads)
        for v, k, more, beads in rules
    )
    time = None if least is None else {"least_s": least}
    changed = process.model_copy(update={"speeds": specs, "layer_time": time and LayerTimeSpec(**time)})
    assert asked_speeds(changed, toolpath) == pytest.approx(commanded_speeds(changed, toolpath), rel=1e-9)


@cache
def plain() -> tuple[ProcessSpec, Toolpath]:
    problem, toolpath = toolpath_of(SPEED)
    return problem.process, toolpath


def test_pieces_of_a_bead_are_as_quick_as_it_was() -> None:
    problem, toolpath = toolpath_of(SPEED + SPEEDS + COOL)
    ring = next(i for i, bead in enumerate(toolpath.beads) if (bead.layer, bead.name) == (1, "ring"))
    pieces = split_toolpath(toolpath, {ring: [(0.5 * toolpath.beads[ring].length, "a test")]})
    assert [bead.name for bead in pieces.beads[ring : ring + 2]] == ["ring, piece 1", "ring, piece 2"]
    own = [bead.commanded(problem.process.speed) for bead in pieces.beads]
    assert own == pytest.approx(asked_speeds(problem.process, pieces), rel=1e-6)


# --- the plan ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_motion_has_the_speeds_times_and_pauses_that_are_asked_for() -> None:
    plan, t = by_layer(), by_layer().trajectory
    assert plan.verified
    assert plan.commanded / MM == pytest.approx([15] * 6 + [40, 40, 30])
    for i, speed in enumerate(plan.commanded):
        assert np.quantile(t.speed[t.bead == i], 0.7) == pytest.approx(speed, rel=0.02)
        assert t.speed[t.bead == i].max() <= 1.02 * speed
    first, second = np.diff(begins(plan))
    assert first == pytest.approx(12.0, abs=2 * t.dt)
    assert second > 12.0
    (cool,) = [event for event in t.events if event.kind == "cool"]
    assert cool.bead == 3
    (pause,) = [event for event in t.events if event.kind == "pause"]
    assert (pause.bead, pause.duration, pause.note) == (6, 3.0, "put the nut in")
    (purge,) = [event for event in t.events if event.kind == "purge"]
    assert (purge.bead, purge.start, purge.amount) == (6, pytest.approx(pause.start + 3.0), pytest.approx(10 * MM))
    resting = (t.t >= pause.start) & (t.t <= pause.start + 5.0)
    assert np.ptp(t.q[resting], axis=0).max() < 1e-9
    arm = len(plan.cell.arm)
    assert t.q[resting, :arm] == pytest.approx(np.tile(plan.cell.home[:arm], (resting.sum(), 1)), abs=1e-9)
    lengths = np.array([bead.length for bead in plan.toolpath.beads])
    assert plan.metrics["ideal_deposition_time_s"] == pytest.approx((lengths / plan.commanded).sum())
    assert plan.metrics["at_speed_fraction"] > 0.8


@pytest.mark.slow
def test_dips_are_below_the_speed_of_their_own_bead() -> None:
    plan = by_layer()
    slow = {dip.bead for dip in plan.dips}
    assert all(dip.speed < 0.99 * plan.commanded[dip.bead] for dip in plan.dips)
    assert slow  # of the zig-zag at 40 mm/s at least
    for dip in plan.dips:
        assert plan.toolpath.beads[dip.bead].speed is None or all(remedy.kind != "speed" for remedy in dip.remedies)
    assert all(each.kind != "speed" for each in plan.advice)


def with_events(plan: Plan, change: Callable[[Event], Event | None]) -> Plan:
    events = [change(event) for event in plan.trajectory.events]
    told = tuple(event for event in events if event is not None)
    return replace(plan, trajectory=replace(plan.trajectory, events=told))


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("overrides", "check"),
    [
        ("process.layer_time.least_s=13.0", "time of a layer"),
        ("process.pauses=[{before_layer: 3, wait_s: 3.1, purge_mm: 10}]", "pauses before layers"),
        ("process.pauses=[{before_layer: 3, wait_s: 3, purge_mm: 11}]", "pauses before layers"),
        ("process.pauses=[{before_layer: 2, wait_s: 3, purge_mm: 10}]", "pauses before layers"),
        ("process.speeds=[{to_layer: 1, speed_mm_s: 14}, {beads: ring, from_layer: 2, speed_mm_s: 30}]", "speed in deposition"),
        ("process.speeds=[{beads: ring, speed_mm_s: 20}]", "speed in deposition"),
    ],
)  # fmt: skip
def test_the_verifier_holds_a_motion_against_what_is_asked(overrides: str, check: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        other = load_problem(write_small(Path(folder), THREE, (SPEED, ALL)), [overrides])
    assert failed(replace(by_layer(), problem=other)) == {check}


@pytest.mark.slow(keep=("<lambda>0", "<lambda>3"))
@pytest.mark.parametrize(
    "change",
    [
        lambda event: None if event.kind == "pause" else event,
        lambda event: replace(event, start=event.start - 1.0) if event.kind == "pause" else event,
        lambda event: replace(event, start=event.start + 1.0) if event.kind == "pause" else event,
        lambda event: replace(event, duration=2.0) if event.kind == "pause" else event,
        lambda event: replace(event, duration=np.nan) if event.kind == "pause" else event,
        lambda event: replace(event, bead=5) if event.kind == "pause" else event,
        lambda event: replace(event, kind="pause") if event.kind == "cool" else event,
    ],
)
def test_a_pause_that_is_not_one_fails(change: Callable[[Event], Event | None]) -> None:
    assert "pauses before layers" in failed(with_events(by_layer(), change))


def test_a_pause_away_from_home_fails() -> None:
    plan, t = by_layer(), by_layer().trajectory
    (pause,) = [event for event in t.events if event.kind == "pause"]
    q = t.q.copy()
    q[(t.t >= pause.start - 1e-9) & (t.t <= pause.start + 5.0)] += 1e-3
    assert "pauses before layers" in failed(replace(plan, trajectory=replace(t, q=q)))


@pytest.mark.slow
def test_a_print_that_is_resumed_has_the_pauses_that_are_left() -> None:
    with tempfile.TemporaryDirectory() as folder:
        problem = load_problem(write_small(Path(folder), THREE, (SPEED, ALL)))
        rest, last = solve(problem, first_bead=4, baseline=False), solve(problem, first_bead=6, baseline=False)
    assert rest.verified
    assert last.verified
    assert [event.bead for event in rest.trajectory.events if event.kind == "pause"] == [6]
    assert [event.kind for event in last.trajectory.events if event.kind in ("pause", "cool")] == []


def test_a_rest_that_begins_behind_a_pause_leaves_it_to_the_user() -> None:
    """Of three layers with three beads each: bead 6 begins the third, before which a nut is put in."""
    whole = by_layer()
    before, rest, later = (replace(whole, trajectory=replace(whole.trajectory, first_bead=k)) for k in (5, 6, 7))
    assert resumed_words(rest).endswith("; before the start, as in the pause before layer 3: put the nut in")
    assert resumed(rest) == [
        "Resumes at bead 6: those before it must be there",
        "Before the start, as in the pause before layer 3: put the nut in",
    ]
    for plan in (before, later):
        assert "nut" not in resumed_words(plan) and len(resumed(plan)) == 1
    assert resumed(whole) == []


@pytest.mark.slow
def test_a_motor_that_is_on_or_off_runs_at_the_rate_of_each_bead() -> None:
    with tempfile.TemporaryDirectory() as folder:
        process = SPEED + SPEEDS + "  extruder: {motor: on_off, flow_tolerance: 10}\n"
        plan = solve_alone(load_problem(write_small(Path(folder), THREE, (SPEED, process))))
    assert plan.verified, failed(plan)
    t = plan.trajectory
    rates = np.array([np.median(t.flow[t.bead == i]) for i in range(len(plan.beads))])
    assert rates / 0.3e-6 == pytest.approx(plan.commanded, rel=1e-3)
    assert set(plan.commanded) == {0.02, 0.03, 0.04}


# --- what is written ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("sync", ["signal", "free"])
def test_the_extruders_board_pauses_too(sync: str) -> None:
    plan = by_layer()
    board = plan.problem.program.board.model_copy(update={"sync": sync})
    program = plan.problem.program.model_copy(update={"board": board})
    plan = replace(plan, problem=plan.problem.model_copy(update={"program": program}))
    text = gcode(plan)
    assert "; pause: put the nut in, bead 6\n" in text
    assert "; cool, bead 3\n" in text
    assert differences(plan, {FILE: text}) == []
    assert differences(plan, {FILE: text.replace("; purge, bead 6\n", "; purge, bead 6\nG4 P500\n")}) != []


@pytest.mark.parametrize("language", ["rapid", "krl"])
def test_programs_rest_for_pauses_and_cooling(language: str) -> None:
    plan = by_layer()
    written = LANGUAGES[language].write(plan)
    text = "\n".join(written.values())
    assert "put the nut in" in text
    assert LANGUAGES[language].differences(plan, written) == []


def test_plan_and_summary_tell_what_is_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = by_layer()
    told = json.loads(plan_json(plan))["events"]
    assert [event["note"] for event in told if event["kind"] == "pause"] == ["put the nut in"]
    print_summary(replace(plan, timing_s={"total": 1.0}), tmp_path)
    said = " ".join(capsys.readouterr().out.split())
    assert "1 x pause (3 s)" in said
    assert "layers are laid more slowly than asked" in said
    names = {check["name"] for check in json.loads(plan_json(plan))["checks"]}
    assert {"time of a layer", "pauses before layers"} <= names


# --- seams and order ---------------------------------------------------------------------------------------


def starts_of(toolpath: Toolpath) -> Array:
    """Where closed beads start (k, 3) [m]."""
    return np.array([bead.points[0] for bead in toolpath.beads if bead.closed])


SQUARE = """\
<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="24mm" viewBox="0 0 30 24">
  <rect id="frame" x="1" y="1" width="28" height="22"/>
  <circle id="ring" cx="9" cy="12" r="5"/>
  <path id="line" d="M18,4 L24,20"/>
</svg>
"""


def drawn(process: str, *overrides: str) -> Toolpath:
    with tempfile.TemporaryDirectory() as folder:
        path = write_small(Path(folder), THREE, (SPEED, SPEED + process), svg=SQUARE)
        return build_toolpath(load_problem(path, overrides))


def on_a_plane(process: str) -> Toolpath:
    overrides = (
        "part={plane: {size_mm: [60, 60]}}",
        "layers={source: {svg: small.svg, width_mm: 30}, project: z, count: 2, height_mm: 0.5}",
    )
    return drawn(process, *overrides)  # fmt: skip


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("lay", [drawn, on_a_plane])
def test_closed_beads_begin_where_the_seam_is_asked_for(lay: Callable[[str], Toolpath]) -> None:
    usual = lay("")
    for towards in ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0]):
        toolpath = lay(f"  seam: {{towards: {towards}}}\n")
        for bead, other in zip(sorted_by_name(toolpath), sorted_by_name(usual), strict=True):
            reach = bead.points @ np.array(towards)
            if not bead.closed:
                assert bead.length == pytest.approx(other.length, rel=1e-4)
            elif bead.name == "ring":
                assert reach[0] >= reach.max() - 0.01 * np.ptp(reach) - 1e-9
            else:  # a tenth of each side of the frame is kept free of seams
                assert reach[0] >= reach.max() - 0.35 * np.ptp(reach) - 1e-9
            assert bead.length == pytest.approx(other.length, rel=2e-3)  # where no corner is, none is rounded
        near = toolpath.beads[0].points.mean(axis=0) + np.array([0.0, 0.0, 0.05])
        at = lay(f"  seam: {{near_mm: {[round(float(x) * 1e3, 3) for x in near]}}}\n")
        for bead in at.beads:
            if bead.name == "ring":
                far = np.linalg.norm(bead.points - np.round(near * 1e3, 3) * MM, axis=1)
                assert far[0] <= far.min() + 1e-4


def sorted_by_name(toolpath: Toolpath) -> list[Bead]:
    return sorted(toolpath.beads, key=lambda bead: (bead.layer, bead.name))


def test_a_seam_never_stands_at_a_corner() -> None:
    frame = next(bead for bead in drawn("  seam: {towards: [0, 0, 1]}\n").beads if bead.name == "frame")
    tangents = np.diff(frame.points[[0, 1, -2, -1]], axis=0)[[0, 2]]
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    assert tangents[0] @ tangents[1] > np.cos(np.radians(5.0))


def test_beads_come_in_the_order_of_their_names() -> None:
    toolpath = drawn("  order: [ring, l*]\n")
    names = [bead.name for bead in toolpath.beads]
    assert names == ["ring", "line", "frame"] * 3
    assert [bead.name for bead in drawn("").beads] != names


@pytest.mark.slow
def test_walls_or_infill_of_a_mesh_come_first_as_asked() -> None:
    for order in ("['*wall*']", "['*infill*', '*wall*']"):
        toolpath = build_toolpath(load_problem("saddle_ring", [f"process.order={order}"]))
        for layer in range(toolpath.layers):
            kinds = ["infill" if "infill" in bead.name else "wall" for bead in toolpath.beads if bead.layer == layer]
            assert kinds == sorted(kinds, reverse="wall" in order[:8])


@pytest.mark.parametrize("override", ["process.seam={towards: [0, 0, 1]}", "process.order=['*infill*']"])
@pytest.mark.parametrize("problem", ["planar_gcode", "peer_cap", "shoehorn"])
def test_what_a_source_says_already_cannot_be_asked_for(problem: str, override: str) -> None:
    with pytest.raises(InputError, match="by this source already"):
        build_toolpath(load_problem(problem, [override]))


@pytest.mark.parametrize(
    ("process", "reason"),
    [
        ("  seam: {}\n", "give either near_mm or towards"),
        ("  seam: {near_mm: [0, 0, 0], towards: [0, 0, 1]}\n", "give either near_mm or towards"),
        ("  seam: {towards: [0, 0, 0]}\n", "must not be the zero vector"),
        ("  order: [ring, ring]\n", "appears twice in the list"),
    ],
)
def test_seams_and_orders_that_cannot_be(process: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        problem_of(SPEED + process)


def test_an_order_of_no_bead_is_refused() -> None:
    with pytest.raises(InputError, match="no bead is called 'rign'") as caught:
        drawn("  order: [rign]\n")
    assert caught.value.hint == "did you mean ring?"


@pytest.mark.slow
def test_the_verifier_sees_beads_out_of_order() -> None:
    plan = by_layer()
    names = [bead.name for bead in plan.beads]
    for order, wrong in ((("zigzag", "wave", "ring"), False), (("ring",), True)):
        process = plan.problem.process.model_copy(update={"order": order})
        told = failed(replace(plan, problem=plan.problem.model_copy(update={"process": process})))
        expected = [tuple(names[3 * k : 3 * k + 3]) for k in range(3)] != [order] * 3 if not wrong else True
        assert ("order of beads" in told) == expected


# --- the report --------------------------------------------------------------------------------------------


def test_the_report_holds_each_bead_to_its_own_speed(tmp_path: Path) -> None:
    plan = by_layer()
    kept = np.flatnonzero(plan.trajectory.deposit)
    (speed,) = [each for each in channels(plan, kept) if each["key"] == "speed"]
    assert speed["unit"] == "%"
    assert 90.0 < speed["max"] < 103.0
    assert "commanded" in json.dumps(time_charts(plan)[0], default=str)
    section = dips_section(plan, range(len(plan.dips)))
    for dip in plan.dips:
        assert f" of {plan.commanded[dip.bead] * 1e3:g}</td>" in section
        assert f" of {plan.commanded[dip.bead] * 1e3:g} mm/s" in dip_place(plan, dip).value


def test_plots_draw_the_speeds_that_are_commanded() -> None:
    plan = by_layer()
    axes = plots.speed(plan)
    lines = {line.get_label(): np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()}
    plt.close(axes.figure)
    assert {15.0, 40.0, 30.0} <= set(np.round(lines["commanded"][np.isfinite(lines["commanded"])], 6))


# --- travel ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_travel_that_is_upright_rises_along_the_normal_before_it_goes_across() -> None:
    with tempfile.TemporaryDirectory() as folder:
        process = SPEED + "  travel: upright\n  lift_mm: 8\n"
        plan = solve_alone(load_problem(write_small(Path(folder), (SPEED, process))))
    assert plan.verified
    t = plan.trajectory
    for i in range(len(plan.beads) - 1):
        (last,), (first,) = np.flatnonzero(t.bead == i)[-1:], np.flatnonzero(t.bead == i + 1)[:1]
        between = np.arange(last, first + 1)
        rise = plan.toolpath.surface.signed_distance(t.tip[between])
        ends = plan.paths[i].task.tip[-1], plan.paths[i + 1].task.tip[0]  # of run-out and run-in
        for end, half in ((ends[0], slice(None, len(between) // 2)), (ends[1], slice(len(between) // 2, None))):
            low = plan.toolpath.surface.signed_distance(end[None])[0]
            normal = plan.toolpath.surface.normals(end[None])[0]
            lifted = (rise[half] > low + 1e-3) & (rise[half] < 8e-3)  # it goes across at that height or above
            way = t.tip[between][half][lifted] - end
            assert len(way)
            assert np.linalg.norm(way - np.outer(way @ normal, normal), axis=1).max() < 1e-4
        assert rise.max() > 8e-3


@pytest.mark.parametrize(
    ("process", "reason"),
    [
        ("  travel: upright\n  hand_over: motion\n", "hand_over is motion, but travel is upright"),
        ("  travel: quickest\n  fibre: {cut_length_mm: 5}\n", "travel is quickest, but there is fibre"),
        ("  travel: straight\n", "unknown name 'straight'"),
    ],
)
def test_ways_of_travel_that_cannot_be(process: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        problem_of(SPEED + process)
