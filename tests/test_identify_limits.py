"""Limits and delays of robots from recordings: known truth found again through noise, lag and uneven clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ruckig
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.recordings import Recording, TrueRobot, commands, recorded, write_recording
from planner.feedback.identify_delay import fit_delay
from planner.feedback.identify_fit import _limit, fit_joints
from planner.feedback.identify_match import match
from planner.feedback.identify_profile import MotionLimits, move_profile
from planner.feedback.identify_program import (
    AskedMove,
)
from planner.feedback.recordings import read_log
from tests.identify_fixtures import (
    NOISE,
    UR,
    asked_of,
    cell_of,
    found_in,
    header,
    truth_of,
)

# ---- profiles ------------------------------------------------------------------------------------------------------


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


# ---- limits --------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("braking", "error", "told"),
    [(525.0, 0.03, 525.0), (525.0, 0.057, None), (745.0, 0.057, 750.0), (400.0, 0.6, 750.0), (900.0, 0.057, 750.0)],
)
def test_the_greater_limit_is_not_told_where_the_lesser_is_less_but_not_well_known(
    braking: float, error: float, told: float | None
) -> None:
    """A jerk of 750 ±4 % in speeding up, beside one in braking: what may as well be noise takes nothing away."""
    values, errors = np.array([750.0, braking]), np.array([0.04, error])
    found = _limit(values, errors, np.ones(2, dtype=np.bool_), 1e4, None)
    assert found.told == (told is not None)
    assert found.value == pytest.approx(told or 525.0 * np.exp(-2.0 * 0.057))


@pytest.mark.slow
def test_a_servo_that_lags_does_not_lower_the_jerk(tmp_path: Path) -> None:
    _, cell = cell_of("cylinder_logo")
    truth, asked = truth_of(cell, lag=0.03), asked_of("cylinder_logo", joints=(5,))
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth))
    assert fit.lag == pytest.approx(0.03, abs=5e-4)
    _assert_near(truth, [fit], 0.05)


@pytest.mark.slow
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


# ---- delays --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
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


@given(
    distance=st.floats(1e-4, 4.0),
    logs=st.tuples(*[st.floats(-20.0, 20.0)] * 5),
    averaged=st.booleans(),
)
def test_a_profile_of_any_limits_that_a_search_tries_is_finite(
    distance: float, logs: tuple[float, ...], averaged: bool
) -> None:
    speed, acceleration, jerk, braking, braking_jerk = np.exp(logs).tolist()
    profile = move_profile(distance, MotionLimits(speed, acceleration, jerk, braking, braking_jerk, 0.0, averaged))
    assert np.isfinite(profile.at(np.linspace(0.0, 10.0, 50))).all()


@pytest.mark.slow
def test_braking_that_is_as_speeding_up_is_not_told(tmp_path: Path) -> None:
    """Commands have no noise, so that a model with braking of its own explains more, by nothing that counts."""
    _, cell = cell_of("cylinder_logo")
    whole = asked_of("cylinder_logo", joints=(3,), most=30.0)
    asked = replace(whole, moves=whole.moves[:1] + whole.moves[-7:])
    truth = truth_of(cell, delay=0.02)
    _, (fit,) = found_in(tmp_path, asked, cell, recorded(asked, truth), commanded=True)
    assert fit.braking is None and fit.acceleration.value == pytest.approx(truth.acceleration[3], rel=1e-3)
