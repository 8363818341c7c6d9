"""Samples that no robot can have made: single wrong ones and held ones are left out and told, others refused, true motion kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.feedback.filters import noise_of
from planner.feedback.glitches import CleanedSamples, cleaned
from planner.feedback.identify_profile import MotionLimits, move_profile

NAMES = ("J1", "J2")
NOISE = np.radians(0.01)


def moving(rate: float = 250.0, noise: float = NOISE, seed: int = 1, distance: float = 0.8) -> tuple[Array, Array]:
    """Two joints: one goes out and back with rests between, as quickly as an arm does, the other waves."""
    profile = move_profile(distance, MotionLimits(4.0, 20.0, 800.0, 15.0, 500.0))
    time = np.arange(0.0, 2.0 * profile.total + 1.5, 1.0 / rate)
    out = profile.at(time - 0.5) - profile.at(time - 1.0 - profile.total)
    q = np.column_stack([out, 0.3 * np.sin(5.0 * time)])
    return time, q + np.random.default_rng(seed).normal(0.0, 1.0, q.shape) * noise


def clean(time: Array, q: Array) -> CleanedSamples:
    return cleaned(Path("run.csv"), np.arange(2, len(time) + 2), time, q, NAMES)


@settings(max_examples=60)
@given(
    rate=st.sampled_from([80.0, 125.0, 250.0, 1000.0]),
    noise=st.sampled_from([0.0, 1e-6, NOISE, 5.0 * NOISE]),
    seed=st.integers(0, 100),
    distance=st.sampled_from([0.0045, 0.02, 0.2, 1.5]),
    digits=st.sampled_from([8, 5, 3]),
    late=st.sampled_from([0.0, 0.4, 0.7]),
)
def test_true_motion_is_kept(rate: float, noise: float, seed: int, distance: float, digits: int, late: float) -> None:
    """Of short and long moves, with noise, few digits and stamps that are late by a share of a step."""
    time, q = moving(rate, noise, seed, distance)
    time = time + np.random.default_rng(seed).uniform(0.0, late / rate, len(time))
    assert clean(time, np.round(np.degrees(q), digits)).kept.all()


@settings(max_examples=60)
@given(
    k=st.integers(5, 300),
    size=st.sampled_from([-3.0, -0.3, 0.3, 20.0]),
    length=st.sampled_from([1, 2]),
    noise=st.sampled_from([0.0, NOISE]),
)
def test_what_is_wrong_for_an_instant_is_left_out(k: int, size: float, length: int, noise: float) -> None:
    time, q = moving(noise=noise)
    q[k : k + length, 0] += size
    found = clean(time, q)
    assert np.flatnonzero(~found.kept).tolist() == list(range(k, k + length))
    assert f"the first in line {k + 2}: column J1" in found.remarks[0]


@pytest.mark.parametrize("held", [4, 20])
def test_samples_that_were_held_are_left_out(held: int) -> None:
    time, q = moving()
    q[200 : 200 + held] = q[200]
    found = clean(time, q)
    assert np.flatnonzero(~found.kept).tolist() == list(range(201, 200 + held)) and "stood still" in found.remarks[0]


def test_a_step_or_two_that_are_held_do_no_harm() -> None:
    time, q = moving()
    q[200:203:2] = q[199:202:2]
    assert clean(time, q).kept.all()


def test_where_samples_are_missing_nothing_is_judged() -> None:
    time, q = moving()
    kept = np.ones(len(time), dtype=bool)
    kept[190:240] = False
    assert clean(time[kept], q[kept]).kept.all()


def _noughts(q: Array) -> None:
    q[200:230] = 0.0


def _one_held(q: Array) -> None:
    q[200:240, 1] = q[200, 1]


def _many(q: Array) -> None:
    q[10::20, 0] += 1.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_noughts, r"run\.csv:202: column 'J[12]' leaps from one sample to the next as no joint can"),
        (_one_held, r"run\.csv:242: column 'J2' leaps"),
        (_many, r"run\.csv:12: [0-9]+ of [0-9]+ samples cannot be a joint's: column 'J1' leaps and comes back"),
    ],
)
def test_what_cannot_be_put_right_is_refused(change, said: str) -> None:
    time, q = moving()
    change(q)
    with pytest.raises(InputError, match=said):
        clean(time, q)


def test_a_recording_with_few_samples_a_second_is_not_judged() -> None:
    time, q = moving(rate=40.0)
    q[20, 0] += 1.0
    assert clean(time, q).kept.all()


@given(noise=st.floats(1e-6, 1e-2), seed=st.integers(0, 50))
def test_noise_is_told_whatever_the_motion(noise: float, seed: int) -> None:
    _, q = moving(noise=noise, seed=seed)
    assert noise_of(q)[1] == pytest.approx(noise, rel=0.25)


def test_too_few_samples_have_no_noise() -> None:
    for count in range(4):
        assert noise_of(np.ones((count, 2))).tolist() == [0.0, 0.0]
    _, q = moving()
    never = np.arange(len(q)) % 4 > 0  # three in a row
    assert not noise_of(q, never).any() and noise_of(q, np.ones(len(q), dtype=bool)).tolist() == noise_of(q).tolist()
