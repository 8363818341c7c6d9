"""Extrusion: cross-sections, volumes along a bead, and what the motor has to push for them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.motion.extrusion import (
    bead_area,
    cross_section,
    deposited_volume,
    extruded_volume,
    feed,
    filament_area,
    flow,
)
from planner.plan import Event
from planner.toolpath.bead import Bead

MM = 1e-3
DT = 0.004
FILAMENT = np.pi * (1.75 * MM) ** 2 / 4.0


def bead_of(s: Array, width: Array | float = 0.6 * MM, height: Array | float = 0.5 * MM) -> Bead:
    """A straight bead along x."""
    n, zero = len(s), np.zeros(len(s))
    up = np.column_stack([zero, zero, zero + 1.0])
    points = np.column_stack([s, zero, zero])
    return Bead("line", 0, s, points, up, up, points, np.full(n, width), np.full(n, height), False)


def process_of(section: str = "rectangle", motor: str = "e_axis", lag: float = 0.0, speed: float = 0.04) -> Any:
    return SimpleNamespace(
        section=section, filament_diameter=1.75 * MM, speed=speed, extruder=SimpleNamespace(motor=motor, lag=lag)
    )


# --- cross-sections ----------------------------------------------------------------------------------------


def test_areas_of_the_three_sections() -> None:
    width, height = np.array([0.6, 2.0, 0.5]) * MM, np.array([0.5, 0.4, 0.5]) * MM
    rectangle, rounded, fibre = (
        cross_section(name, width, height, 1.75 * MM) / MM**2 for name in ("rectangle", "rounded", "fibre")
    )
    assert rectangle == pytest.approx([0.3, 0.8, 0.25], rel=1e-12)
    # half a circle at both sides of a rectangle; as wide as high it is a circle
    assert rounded == pytest.approx([0.1 * 0.5 + np.pi * 0.25**2, 1.6 * 0.4 + np.pi * 0.2**2, np.pi * 0.25**2])
    assert fibre == pytest.approx([np.pi * 0.875**2] * 3)


def test_a_rounded_bead_is_not_higher_than_wide() -> None:
    with pytest.raises(InputError, match=r"0\.4 mm wide and 0\.5 mm high") as caught:
        cross_section("rounded", np.array([0.6, 0.4]) * MM, np.array([0.5, 0.5]) * MM, 1.75 * MM)
    assert caught.value.hint == "at least as wide as high"


# --- volume along a bead -----------------------------------------------------------------------------------


def test_constant_measures_give_area_times_length_to_the_last_digit() -> None:
    bead = bead_of(np.sort(np.append(0.0, np.random.default_rng(1).uniform(0.0, 0.05, 300))))
    s = np.linspace(-0.01, 0.06, 1000)
    expected = bead.width[0] * bead.height[0] * np.clip(s, 0.0, bead.length)
    np.testing.assert_array_equal(deposited_volume(bead, bead_area(bead, process_of()), s), expected)


@pytest.mark.parametrize("section", ["rectangle", "rounded"])
def test_volume_of_a_bead_that_varies_is_the_integral_of_its_area(section: str) -> None:
    rng = np.random.default_rng(2)
    s = np.append(0.0, np.cumsum(rng.uniform(0.01, 1.5, 25))) * MM
    bead = bead_of(s, rng.uniform(0.6, 2.0, 26) * MM, rng.uniform(0.2, 0.6, 26) * MM)
    area = bead_area(bead, process_of(section))
    places = np.concatenate([rng.uniform(0.0, s[-1], 40), s])
    found = deposited_volume(bead, area, places)
    for place, volume in zip(places, found, strict=True):
        inner = s[(s > 0.0) & (s < place)]
        true = sum(
            quad(lambda x: float(np.interp(x, s, area)), a, b)[0]
            for a, b in zip(np.append(0.0, inner), np.append(inner, place), strict=True)
        )
        assert volume == pytest.approx(true, rel=1e-9, abs=1e-18)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.floats(1e-9, 1.0), st.floats(0.01, 50.0)), min_size=1, max_size=20),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)
def test_volume_only_grows_and_at_the_area_between_least_and_greatest(
    steps: list[tuple[float, float]], a: float, b: float
) -> None:
    s = np.append(0.0, np.cumsum([step for step, _ in steps])) * MM
    bead = bead_of(s, np.array([steps[0][1], *(width for _, width in steps)]) * MM)
    area = bead_area(bead, process_of())
    places = np.sort([a, b]) * bead.length
    (first, last), length = deposited_volume(bead, area, places), places[1] - places[0]
    assert length * area.min() * (1 - 1e-9) - 1e-18 <= last - first <= length * area.max() * (1 + 1e-9) + 1e-18
    ends = deposited_volume(bead, area, np.array([-1.0, 0.0, bead.length, bead.length + 1.0]))
    assert ends[0] == ends[1] == 0.0
    assert ends[2] == ends[3]


def test_flow_is_what_passes_in_a_sample() -> None:
    np.testing.assert_allclose(flow(np.array([0.0, 1.0, 4.0, 4.0]) * 1e-9, DT), np.array([250.0, 750.0, 0.0]) * 1e-9)


def test_a_motor_that_is_on_or_off_takes_no_notice_of_a_dip() -> None:
    bead = bead_of(np.linspace(0.0, 0.02, 60), np.linspace(0.4, 0.8, 60) * MM)
    t = np.linspace(0.0, 1.0, 201)
    s = np.where(t < 0.25, 0.04 * t, np.where(t < 0.75, 0.01 + 0.01 * (t - 0.25), 0.015 + 0.04 * (t - 0.75)))
    end = 0.75 + 0.005 / 0.04
    on = extruded_volume(bead, process_of(motor="on_off"), t, s)
    rate = 0.6 * 0.5 * 40.0 * MM**3  # of the mean cross-section
    assert on == pytest.approx(rate * np.minimum(t, end))
    follows = extruded_volume(bead, process_of(motor="speed_demand"), t, s)
    assert follows[-1] == pytest.approx(0.6 * 0.5 * 20.0 * MM**3)
    assert on[-1] / follows[-1] == pytest.approx(end / 0.5)  # as long as it takes, over what it should take


# --- feed --------------------------------------------------------------------------------------------------


def laid(speed: Array, area: float = 0.3 * MM**2, before: int = 50) -> tuple[Array, NDArray[np.int32], Array, Array]:
    """Times, beads, volume laid and flow of one bead with travel on both sides; speed (m) in its samples [m/s]."""
    bead = np.concatenate([np.full(before, -1), np.zeros(len(speed)), np.full(before, -1)]).astype(np.int32)
    rate = np.concatenate([np.zeros(before), speed * area, np.zeros(before)])
    edges = np.append(0.0, np.cumsum(rate) * DT)
    return np.arange(len(bead)) * DT, bead, 0.5 * (edges[1:] + edges[:-1]), rate


def test_filament_without_anything_else_is_what_is_laid() -> None:
    t, bead, volume, rate = laid(np.full(300, 0.04))
    np.testing.assert_array_equal(feed(t, bead, volume, rate, (), FILAMENT, 0.0), volume / FILAMENT)
    assert filament_area(process_of()) == FILAMENT


def test_primes_and_retracts_are_pushed_evenly() -> None:
    t, bead, volume, rate = laid(np.full(300, 0.04))
    events = (
        Event("heat", -1, 0.0, 0.05, 0.0),
        Event("prime", 0, 0.121, 0.07, 2.0 * MM),
        Event("retract", 0, 1.397, 0.05, -1.5 * MM),
    )
    besides = feed(t, bead, volume, rate, events, FILAMENT, 0.0) - volume / FILAMENT
    share = np.clip((t - 0.121) / 0.07, 0.0, 1.0)
    assert besides == pytest.approx(2.0 * MM * share - 1.5 * MM * np.clip((t - 1.397) / 0.05, 0.0, 1.0), abs=1e-15)
    assert besides[-1] == pytest.approx(0.5 * MM)


def test_fibre_is_fed_up_to_its_cut_and_drawn_from_there() -> None:
    # 60 mm at 40 mm/s; the nozzle rests for 0.4 s at 40 mm, where the fibre is cut 20 mm behind the tip
    fibre = np.pi * MM**2 / 4.0
    speed = np.concatenate([np.full(250, 0.04), np.zeros(100), np.full(125, 0.04)])
    t, bead, volume, rate = laid(speed, fibre)
    cut = t[50] + 250 * DT
    events = (Event("prime", 0, 0.0, 0.1, 20.0 * MM), Event("cut", 0, cut, 0.4, 0.0))
    fed = feed(t, bead, volume, rate, events, fibre, 0.0)
    assert fed[49] == pytest.approx(20.0 * MM)
    inside = (t > t[50]) & (t < cut)
    assert np.diff(fed[inside]) == pytest.approx(0.04 * DT)  # 1:1
    assert np.ptp(fed[t > cut + DT]) < 1e-12
    assert fed[-1] == pytest.approx(60.0 * MM)  # as long as the bead


def test_two_cuts_each_stop_their_own_bead() -> None:
    t, bead, volume, rate = laid(np.full(100, 0.04), FILAMENT)
    t = np.arange(2 * len(t)) * DT
    bead, rate = np.concatenate([bead, np.where(bead < 0, -1, 1)]).astype(np.int32), np.concatenate([rate, rate])
    volume = np.concatenate([volume, volume + volume[-1]])
    cuts = (Event("cut", 0, t[75], 0.0, 0.0), Event("cut", 1, t[325], 0.0, 0.0))
    fed = feed(t, bead, volume, rate, cuts, FILAMENT, 0.0)
    assert fed[199] == pytest.approx(volume[75] / FILAMENT)
    assert fed[-1] - fed[199] == pytest.approx((volume[325] - volume[199]) / FILAMENT)


def lagged(t: Array, fed: Array, lag: float) -> Array:
    """Rate (m) [m/s] of filament that leaves a nozzle that lags its motor, worked out in 20 steps a sample."""
    fine = np.linspace(t[0], t[-1], 20 * (len(t) - 1) + 1)
    pushed = np.diff(np.interp(fine, t, fed)) / (fine[1] - fine[0])
    leaves, out = 0.0, []
    keep = np.exp(-(fine[1] - fine[0]) / lag)
    for rate in pushed:
        leaves = keep * leaves + (1.0 - keep) * rate
        out.append(leaves)
    return np.array(out).reshape(-1, 20).mean(axis=1)


@pytest.mark.parametrize("lag", [0.02, 0.05, 0.12])
def test_running_ahead_makes_up_for_the_lag(lag: float) -> None:
    """The melt follows the motor late; fed ahead of it, it flows as it should a lag after the start, in dips too."""
    k = np.arange(600)
    speed = 0.04 * (1.0 - 0.7 * np.exp(-(((k - 400) / 12.0) ** 2)))
    t, bead, volume, rate = laid(speed)
    wanted = 0.5 * (rate[1:] + rate[:-1]) / FILAMENT
    fed = feed(t, bead, volume, rate, (), FILAMENT, lag)
    ahead, behind = lagged(t, fed, lag), lagged(t, volume / FILAMENT, lag)
    inside = (t[1:] > t[50] + lag + 2 * DT) & (t[1:] < t[649] - lag)
    assert np.abs(ahead[inside] / wanted[inside] - 1.0).max() < 0.01
    assert np.abs(behind[inside] / wanted[inside] - 1.0).max() > 0.05
    assert fed[0] == 0.0
    assert fed[-1] == pytest.approx(volume[-1] / FILAMENT, abs=1e-12)
    # pressure comes and goes around the ends of the bead and is gone well within the lag
    resting = (t < t[50] - 0.5 * lag) | (t > t[649] + 0.5 * lag)
    np.testing.assert_allclose(fed[resting], (volume / FILAMENT)[resting], atol=1e-12)


def test_a_start_between_samples_is_made_up_for_as_well() -> None:
    for part in (0.5, 0.7, 1.2, 1.5):  # of its own dt: what a bead's first sample may carry
        speed = np.full(400, 0.04)
        speed[0] *= part
        t, bead, volume, rate = laid(speed)
        out = lagged(t, feed(t, bead, volume, rate, (), FILAMENT, 0.05), 0.05)
        inside = (t[1:] > t[50] + 0.05 + 2 * DT) & (t[1:] < t[449] - 0.05)
        assert np.abs(out * FILAMENT / (0.04 * 0.3 * MM**2) - 1.0)[inside].max() < 0.005
