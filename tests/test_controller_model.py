"""The model of a controller: ramps, corners, look-ahead and planning on hand-computed cases, and recordings where they are."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.controller import played_deviation
from planner.export.controllers import CONTROLLERS
from planner.export.forecast import FORMAT, forecast, forecast_json, judged
from planner.export.languages import LANGUAGES
from planner.export.player.model import ABB, PLAIN, MotionModel
from planner.export.player.pace import ramp, turned_at
from planner.export.player.path import corner_depth, lagging_both_ways
from planner.export.player.play import limited, play
from planner.export.player.played import TIMES, laid_moves
from planner.export.program import Trigger
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.writer import rapid
from tests.export_fixtures import make_plan
from tests.test_player import CELL, SPEED, program_through

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "rpi"
STRAIGHT = np.column_stack([np.zeros(40), 1e-3 * np.arange(1, 41), np.zeros(40)])
RAMPS = MotionModel("ramps alone", ramp=0.2)


def speed_at_knots(played):
    """Speed of the tip where each way begins (k) [m/s]."""
    return played.phases[:, 0]


# ---- ramps --------------------------------------------------------------------------------------------------------


def test_a_ramp_takes_time_by_the_cube_root_of_its_speed():
    over = np.array([1.0, 0.125, 0.001])
    even = ramp(over, np.full(3, np.inf), RAMPS)
    assert over / even == pytest.approx([0.2, 0.1, 0.02])
    assert ramp(np.array([1.0]), np.array([2.0]), replace(RAMPS, peak=2.0)) == pytest.approx([1.0])  # the joints'


@pytest.mark.parametrize("speed", [0.02, 0.05, 0.1])
def test_one_line_from_rest_to_rest_loses_one_ramp(speed):
    strong = replace(CELL, limits=replace(CELL.limits, acceleration=1e3 * CELL.limits.acceleration))
    played = play(program_through([[0, 0.08, 0]], speed=speed), strong, RAMPS)
    assert played.duration == pytest.approx(0.08 / speed + 0.2 * speed ** (1 / 3), rel=1e-3)


def test_a_line_too_short_for_its_speed_is_slower_still():
    strong = replace(CELL, limits=replace(CELL.limits, acceleration=1e3 * CELL.limits.acceleration))
    length, speed = 1e-3, 0.2
    played = play(program_through([[0, length, 0]], speed=speed), strong, RAMPS)
    top = (length / 0.2) ** 0.75  # what two ramps of 0.2 v^(1/3) s reach in it
    assert speed_at_knots(played).max(initial=0.0) < speed
    assert played.duration == pytest.approx(2 * length / top, rel=0.1)


def test_the_plain_model_is_the_one_of_a_program_alone():
    program = program_through([[0, 0.02, 0], [0.02, 0.02, 0]], speed=0.2)
    assert play(program, CELL).duration == play(program, CELL, PLAIN).duration
    assert play(program, CELL, ABB).duration > play(program, CELL).duration


# ---- corners ------------------------------------------------------------------------------------------------------


def test_a_turn_has_the_time_of_its_zone_and_what_joints_have_beside():
    share, reach = np.array([4.0]), np.array([0.01])
    model = MotionModel("turns", corner=0.5, settling=0.04)
    v = float(np.sqrt(turned_at(share, reach, np.array([True]), model))[0])
    assert v / 4.0 == pytest.approx(0.5 * (2 * 0.01 / v + 0.04))  # change of speed = acceleration times time
    inner = float(np.sqrt(turned_at(share, reach, np.array([False]), model))[0])
    assert inner**2 == pytest.approx(2 * 0.01 * 4.0)  # on a curve there is no such turn
    assert turned_at(np.array([np.inf]), reach, np.array([True]), model) == np.inf


@pytest.mark.parametrize("gap", [1, 2, 5])
def test_a_dense_straight_line_keeps_its_speed(gap):
    model = replace(ABB, move_time=0.0)
    played = play(program_through(STRAIGHT[gap - 1 :: gap]), CELL, model)
    v = speed_at_knots(played)
    middle = (played.leave[:-1] > 0.2) & (played.leave[:-1] < played.duration - 0.2)
    assert middle.any()
    assert v[middle].min() == pytest.approx(SPEED, rel=2e-3)


def test_a_corner_slows_down_and_a_wider_zone_less():
    least = []
    for zone in (0.3e-3, 1e-3, 5e-3):
        played = play(program_through([[0, 0.04, 0], [0.04, 0.04, 0]], speed=0.2, zone=zone), CELL, ABB)
        least.append(speed_at_knots(played)[played.target[0]])
    assert least[0] < least[1] < least[2] < 0.2


POINT = st.tuples(*[st.integers(-15, 15)] * 3)
WAYS = st.lists(POINT, min_size=2, max_size=7).map(lambda points: 2e-3 * np.array(points))


@settings(max_examples=40, deadline=None)
@given(WAYS, st.sampled_from([0.02, 0.05, 0.2]), st.sampled_from([0.3e-3, 1e-3, 3e-3]))
def test_a_larger_zone_is_never_slower(points, speed, zone):
    narrow, wide = (
        play(program_through(points, speed=speed, zone=each), CELL, ABB).duration for each in (zone, 2.0 * zone)
    )
    assert wide <= narrow * 1.01 + 1e-6  # ramps are found in rounds, to within a per cent


@settings(max_examples=40, deadline=None)
@given(WAYS, st.sampled_from([0.02, 0.05, 0.2]), st.booleans())
def test_a_model_asks_no_more_of_the_program_and_its_joints_than_they_have(points, speed, stop):
    program = program_through(points, speed=speed, fine=[0] if stop else [])
    played = play(program, CELL, ABB)
    there = played.at(played.arrive).position
    assert np.linalg.norm(there - program.position, axis=1).max() < 1e-8
    dt = max(played.duration, 1e-3) / 1500
    motion = played.at(np.arange(1501) * dt)
    assert np.linalg.norm(np.diff(motion.position, axis=0), axis=1).max() <= speed * dt * (1 + 1e-6)
    assert (np.abs(np.diff(motion.q, axis=0)) <= CELL.limits.velocity * dt * (1 + 1e-6)).all()
    assert played.duration >= play(program, CELL, PLAIN).duration * (1 - 1e-6)


@settings(max_examples=25, deadline=None)
@given(WAYS, st.integers(1, 3))
def test_knowing_more_moves_is_never_slower(points, moves):
    few, more = (
        play(program_through(points, speed=0.2), CELL, replace(ABB, ahead_moves=each, move_time=0.0)).duration
        for each in (moves, moves + 2)
    )
    assert more <= few * 1.01 + 1e-6


# ---- look-ahead and planning --------------------------------------------------------------------------------------


def test_a_look_ahead_that_is_too_short_slows_down():
    """Moves of 1 mm, one of them known ahead: the robot is never faster than it can stop from within two of them."""
    model = replace(RAMPS, ahead_moves=1)
    played = play(program_through(STRAIGHT, speed=0.2), CELL, model)
    even = 0.2 ** (2 / 3) / 0.2
    assert speed_at_knots(played).max() <= np.sqrt(2 * even * 2e-3) * (1 + 1e-6)
    longer = play(program_through(STRAIGHT, speed=0.2), CELL, replace(model, ahead_moves=40))
    assert longer.duration < 0.8 * played.duration


def test_moves_take_the_time_that_planning_them_takes():
    played = play(program_through(STRAIGHT, speed=0.2), CELL, MotionModel("plans", move_time=0.02, ahead_moves=5))
    took = np.bincount(played.move, played.phases[:, TIMES].sum(axis=1))
    assert took[5:-5] == pytest.approx(np.full(30, 0.02), rel=1e-6)
    assert {played.limits[k] for k in played.limit} == {"the planning of moves"}
    slow = play(program_through(STRAIGHT, speed=0.04), CELL, MotionModel("plans", move_time=0.02, ahead_moves=5))
    assert "the planning of moves" not in {slow.limits[k] for k in slow.limit}


def test_one_short_move_among_long_ones_is_planned_in_time():
    points = np.cumsum([[0, 4e-3, 0]] * 5 + [[0, 0.2e-3, 0]] + [[0, 4e-3, 0]] * 5, axis=0)
    quick = MotionModel("plans", move_time=0.02, ahead_moves=4)
    assert play(program_through(points), CELL, quick).duration == play(program_through(points), CELL).duration


def test_what_plans_moves_is_named():
    program = laid(program_through(STRAIGHT, speed=0.2))
    found = limited(program, play(program, CELL, MotionModel("plans", move_time=0.02, ahead_moves=5)))
    assert "the planning of moves" in {each.by for each in found}


# ---- path ---------------------------------------------------------------------------------------------------------


def test_a_corner_is_cut_by_its_zone_and_by_the_lag():
    program = program_through([[0, 0.04, 0], [0.04, 0.04, 0]], zone=2e-3)
    played = play(program, CELL)
    depth = 0.25 * 2e-3 * np.sqrt(2.0)
    assert corner_depth(program, played)[0] == pytest.approx(depth, rel=1e-3)
    model = MotionModel("zones alone", depth=0.8)
    assert played_deviation(program, played, model).at == pytest.approx([0.8 * depth, 0.0], rel=1e-3)
    lagging = played_deviation(program, played, MotionModel("late", depth=0.0, lag=0.02)).at[0]
    speed = speed_at_knots(played)[played.target[0]]
    # half of lag, speed and change of direction; less where the corner lies between two ticks, or the robot slows down
    assert 0.5 * 0.02 * speed * np.sqrt(2.0) * 0.85 < lagging < 0.5 * 0.02 * SPEED * np.sqrt(2.0) * 1.05
    both = played_deviation(program, played, MotionModel("both", depth=0.8, lag=0.02)).at[0]
    assert both == pytest.approx(np.hypot(lagging, 0.8 * depth), rel=1e-6)


def test_a_straight_line_is_not_left_whatever_the_lag():
    program = program_through(STRAIGHT, fine=[20])
    off = played_deviation(program, play(program, CELL, ABB), ABB)
    assert off.off.max() < 1e-6
    assert off.at.max() < 1e-6


def test_a_circle_is_cut_by_lag_and_acceleration():
    angle = np.linspace(0.0, 2 * np.pi, 241)[1:]
    radius = 0.02
    points = radius * np.column_stack([np.sin(angle), 1 - np.cos(angle), 0 * angle])
    program = program_through(points, speed=0.05)
    strong = replace(CELL, limits=replace(CELL.limits, acceleration=1e3 * CELL.limits.acceleration))
    played = play(program, strong)
    off = played_deviation(program, played, MotionModel("late", lag=0.01))
    middle = (off.t > 0.2 * played.duration) & (off.t < 0.8 * played.duration)
    assert np.median(off.off[middle]) == pytest.approx(0.01**2 * 0.05**2 / radius, rel=0.05)


# ---- forecasts ----------------------------------------------------------------------------------------------------


def laid(program):
    """The same program with the extruder on from its first target to its last but one."""
    m = len(program.linear)
    on, off = Trigger(0.0, False, True, "doOne"), Trigger(0.0, False, False, "doOne")
    return replace(program, triggers={0: (on,), m - 2: (off,)})


def test_a_forecast_counts_what_a_plan_s_program_asks_for():
    plan = make_plan(dip=False)
    program = read_rapid(rapid(plan))
    controller = CONTROLLERS["rapid"]
    played = play(program, plan.cell, controller.motion)
    told = forecast(program, plan.cell, controller)
    on = laid_moves(played)
    assert told.targets == len(program.linear)
    assert told.laid == on.sum()
    assert told.time == played.duration
    assert told.least <= told.mean <= told.programmed * (1 + 1e-4)
    assert 0.0 <= told.share <= 1.0
    assert told.closest <= 1.0 / told.per_second
    assert told.most <= told.laid
    assert not told.assumed
    saved = json.loads(forecast_json({"rapid": told}))
    assert saved["format"] == FORMAT
    assert saved["forecasts"]["rapid"]["targets"] == told.targets
    assert saved["forecasts"]["rapid"]["words"] == list(told.words)


def test_targets_that_come_too_fast_are_warned_of_and_slower_ones_are_not():
    quick, slow = laid(program_through(STRAIGHT, speed=0.2)), laid(program_through(STRAIGHT, speed=0.04))
    controller = replace(CONTROLLERS["rapid"], motion=replace(ABB, move_time=0.0))
    told = judged(quick, play(quick, CELL, controller.motion), controller)
    assert told.closest == pytest.approx(0.005, rel=0.01)
    assert told.close > 20
    assert any("less than 16 ms" in warning for warning in told.warnings)
    assert f"WARNING: {told.warnings[0]}" in told.words
    calm = judged(slow, play(slow, CELL, controller.motion), controller)
    assert calm.warnings == ()
    assert calm.mean == pytest.approx(0.04, rel=0.01)
    assert calm.share > 0.98
    assert calm.closest == pytest.approx(0.025, rel=0.01)
    assert calm.most in (40, len(STRAIGHT) - 2)


def test_a_program_longer_than_a_controller_takes_is_warned_of():
    program = laid(program_through(STRAIGHT, speed=0.04))
    controller = replace(CONTROLLERS["urscript"], most_targets=39)
    told = forecast(program, CELL, controller)
    assert any("40 targets in one program" in warning for warning in told.warnings)
    assert told.assumed
    assert "by an assumed model" in told.words[0]


def test_a_program_without_beads_has_a_forecast():
    told = forecast(program_through([[0, 0.02, 0]]), CELL, CONTROLLERS["rapid"])
    assert told.laid == 0
    assert told.warnings == ()
    assert "none on beads" in told.words[0]


def test_a_slow_corner_is_the_least_speed_and_lowers_the_share():
    points = [[0, 0.01, 0], [0, 0.04, 0], [0.03, 0.04, 0], [0.04, 0.04, 0]]
    program = laid(program_through(points, speed=0.2))
    told = forecast(program, CELL, CONTROLLERS["rapid"])
    played = play(program, CELL, ABB)
    assert told.least <= speed_at_knots(played)[played.target[1]] * (1 + 1e-6)
    assert told.share < 0.9
    assert told.off > 0.1e-3


@pytest.mark.parametrize(("moving", "slope"), [(False, 0.0), (True, 0.02)])
def test_what_comes_before_and_after_counts_by_its_time(moving, slope):
    """A way that rests, or goes straight on, for long beyond what is bent."""
    k, keep = np.arange(1000), 0.9
    way = slope * k[:, None] + np.zeros(2)
    way[400:600] += np.random.default_rng(0).normal(size=(200, 2))
    weights = (1.0 - keep) / (1.0 + keep) * keep ** np.abs(k[400:600, None] - k)
    found = lagging_both_ways(way, keep, moving)
    np.testing.assert_allclose(found[400:600], weights @ way, atol=1e-9)
    np.testing.assert_allclose(found[[0, -1]], way[[0, -1]], atol=1e-9)


def test_every_row_of_controllers_is_sound():
    for controller in CONTROLLERS.values():
        assert 0.0 < controller.warned_time <= 0.025  # the least time of a move by default
        assert controller.most_per_second * controller.warned_time == pytest.approx(1.0)
        assert controller.motion.ahead_moves >= 1
        assert set(controller.motion.assumed) <= set(vars(controller.motion))


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_language_of_controllers_has_a_forecast(name):
    arm = {"urscript": "ur5e", "rapid": "irb140"}.get(name, "kr6_r900")
    plan = make_plan(dip=False, positioner=False, arm=arm)
    told = forecast(LANGUAGES[name].program(plan, LANGUAGES[name].write(plan)), plan.cell, CONTROLLERS[name])
    assert told.controller == CONTROLLERS[name].title
    assert told.mean == pytest.approx(told.programmed, rel=0.02)
    assert told.laid > 0


# ---- recordings ---------------------------------------------------------------------------------------------------

HELD_OUT = [0.05, 0.3, 0.5]  # m/s: up to here all held-out runs are as near as they should be


@pytest.fixture(scope="module")
def runs():
    if not (DATA / "cmd.csv").is_file():
        pytest.skip("the recordings are not here")
    from benchmarks.controller import compared

    return compared(DATA)


@pytest.mark.slow
def test_real_curves_take_the_time_that_is_predicted(runs):
    for each in runs:
        if each.recording.name.startswith("curve"):
            time, mean, least = np.abs(each.errors)
            assert time < 0.03, each.recording.name
            assert mean < 0.03, each.recording.name
            assert least < 0.15, each.recording.name


@pytest.mark.slow
def test_corners_of_held_out_runs_are_predicted(runs):
    found = [each for each in runs if each.recording.corner is not None and not each.recording.fitted]
    if not found:
        pytest.skip("the recordings of corners are not here")
    errors = np.array([np.abs(each.errors) for each in found if each.recording.program.speed[0, 0] in HELD_OUT])
    assert errors[:, 0].max() < 0.02
    assert errors[:, 1].max() < 0.02
    assert np.nanmax(errors[:, 2]) < 0.16


def test_a_forecast_s_distance_is_that_of_an_arm_whose_joints_follow_late():
    """A right angle at constant speed v, rounded by a lag alone, is missed by half of lag times v times the square root of 2."""
    still = replace(CELL, limits=replace(CELL.limits, acceleration=1e6 * CELL.limits.acceleration))
    steps = 1e-3 * np.arange(1, 31)
    corner = np.vstack([np.outer(steps, [0, 1, 0]), [0, 0.03, 0] + np.outer(steps, [1, 0, 0])])
    program = laid(program_through(corner, speed=0.04, zone=1e-6))
    late = replace(CONTROLLERS["rapid"], motion=MotionModel("late", lag=0.02))
    assert forecast(program, still, late).off == pytest.approx(0.5 * 0.02 * 0.04 * np.sqrt(2.0), rel=0.05)
    assert forecast(program, still, replace(late, motion=PLAIN)).off < 4e-5
