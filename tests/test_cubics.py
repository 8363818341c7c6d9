"""Piecewise cubics of time: evaluation, chaining, and the same motion as ruckig's."""

from __future__ import annotations

import numpy as np
import pytest
import ruckig
from hypothesis import given, reject
from hypothesis import strategies as st

from planner.motion.cubics import Cubics, chain, rest
from planner.motion.travel.moves import from_ruckig


def planned(seed: int, n: int = 4, share: float = 0.9, least: float | None = None) -> ruckig.Trajectory:
    """A move between random states; with a share above 1 it begins beyond the limits, so that it brakes first."""
    random = np.random.default_rng(seed)
    limits = [random.uniform(0.5, 5.0, n), random.uniform(5.0, 50.0, n), random.uniform(200.0, 2000.0, n)]
    inputs = ruckig.InputParameter(n)
    inputs.max_velocity, inputs.max_acceleration, inputs.max_jerk = (list(each) for each in limits)
    inputs.current_position, inputs.target_position = (list(random.uniform(-2.0, 2.0, n)) for _ in range(2))
    inputs.current_velocity = list(share * random.uniform(-1.0, 1.0, n) * limits[0])
    inputs.current_acceleration = list(share * random.uniform(-1.0, 1.0, n) * limits[1])
    inputs.target_velocity = list(0.5 * random.uniform(-1.0, 1.0, n) * limits[0])
    inputs.target_acceleration = list(0.2 * random.uniform(-1.0, 1.0, n) * limits[1])
    if least is not None:
        inputs.minimum_duration = least
    trajectory = ruckig.Trajectory(n)
    result = ruckig.Ruckig(n).calculate(inputs, trajectory)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        reject()
    return trajectory


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.0, 0.9, 1.8]), least=st.sampled_from([None, 3.0]))
def test_ruckigs_motion_is_read_exactly(seed: int, share: float, least: float | None) -> None:
    trajectory = planned(seed, share=share, least=least)
    cubics = from_ruckig(trajectory)
    assert cubics.duration == trajectory.duration
    t = np.sort(np.append(np.random.default_rng(0).uniform(0.0, cubics.duration, 400), [0.0, cubics.duration]))
    theirs = np.array([trajectory.at_time(each)[:3] for each in t])
    for ours, each in zip(cubics.state(t), np.moveaxis(theirs, 1, 0), strict=True):
        # a joint's acceleration may change by 1e3 rad/s^3 over the rounding of a time
        np.testing.assert_allclose(ours, each, rtol=0, atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from([0.0, 0.9, 1.8]))
def test_pieces_meet_to_the_acceleration(seed: int, share: float) -> None:
    cubics = from_ruckig(planned(seed, share=share))
    c3, c2, c1, c0 = cubics.coefficients
    tau = np.diff(cubics.times)[:, None]
    ends = (c0 + tau * (c1 + tau * (c2 + tau * c3)), c1 + tau * (2 * c2 + 3 * tau * c3), 2 * c2 + 6 * tau * c3)
    for end, begin in zip(ends, (c0, c1, 2 * c2), strict=True):
        np.testing.assert_allclose(end[:-1], begin[1:], rtol=0, atol=1e-9)


def test_states_are_the_derivatives_of_the_joints() -> None:
    cubics = from_ruckig(planned(3))
    h = 1e-5
    t = np.linspace(h, cubics.duration - h, 1001)
    apart = np.abs(t[:, None] - cubics.times).min(axis=1) > h  # from breakpoints, where the jerk jumps
    _, v, a = cubics.state(t[apart])
    before, here, after = (cubics.joints(t[apart] + d) for d in (-h, 0.0, h))
    np.testing.assert_allclose(v, (after - before) / (2 * h), rtol=0, atol=1e-6)
    np.testing.assert_allclose(a, (after - 2 * here + before) / h**2, rtol=0, atol=1e-3)


def test_ends_are_held_outside() -> None:
    cubics = from_ruckig(planned(4))
    t = np.array([-1.0, 0.0, cubics.duration, cubics.duration + 5.0])
    q = cubics.joints(t)
    np.testing.assert_array_equal(q[0], q[1])
    np.testing.assert_array_equal(q[2], q[3])
    np.testing.assert_array_equal(q[1], cubics.start.q)
    np.testing.assert_array_equal(q[2], cubics.end.q)


def test_a_chain_runs_through_its_pieces_one_after_the_other() -> None:
    pieces = [from_ruckig(planned(5)), rest(np.zeros(4), 0.7), rest(np.ones(4), 0.0), from_ruckig(planned(6))]
    whole = chain(pieces)
    assert whole.duration == pytest.approx(sum(piece.duration for piece in pieces), abs=1e-12)
    start = 0.0
    for piece in pieces:
        t = np.linspace(0.0, piece.duration, 50, endpoint=False) if piece.duration else np.empty(0)
        for ours, theirs in zip(whole.state(start + t[1:]), piece.state(t[1:]), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
        start += piece.duration
    np.testing.assert_allclose(whole.end.q, pieces[-1].end.q, rtol=0, atol=1e-9)


def test_no_time_at_all() -> None:
    still = rest(np.array([1.0, 2.0]), 0.0)
    for each in (still, chain([still, still])):
        assert each.duration == 0.0
        np.testing.assert_array_equal(each.joints(np.array([-1.0, 0.0, 3.0])), [[1.0, 2.0]] * 3)
        assert not np.any(each.end.v)


def test_a_move_to_where_it_is() -> None:
    inputs = ruckig.InputParameter(2)
    inputs.max_velocity, inputs.max_acceleration, inputs.max_jerk = [1.0, 1.0], [1.0, 1.0], [1.0, 1.0]
    inputs.current_position = inputs.target_position = [0.5, -0.5]
    trajectory = ruckig.Trajectory(2)
    ruckig.Ruckig(2).calculate(inputs, trajectory)
    cubics = from_ruckig(trajectory)
    np.testing.assert_array_equal(cubics.joints(np.array([0.0, 1.0])), [[0.5, -0.5]] * 2)


def test_arrays_cannot_be_changed() -> None:
    cubics = Cubics(np.array([0.0, 1.0]), np.zeros((4, 1, 2)))
    with pytest.raises(ValueError, match="read-only"):
        cubics.coefficients[0] = 1.0
