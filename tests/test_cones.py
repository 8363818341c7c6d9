"""Cones about the vertical where they are narrow: rungs and knots where the normal turns, leans, and the polygon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.base.arrays import Array
from planner.resolve.cone_kernels import FACETS, facet, lean_of, lean_slope_of, watch_leans, watch_missed_leans
from planner.resolve.joint_path import spread
from planner.resolve.splines import basis_over, breaks_of, clock_of, places_along
from planner.toolpath.task import FREE, Cones, NozzleTask

NARROW_CONES = Cones(layer_gravity=np.radians(8.0))


def turning_task(cones: Cones, quick: float = 3.0) -> NozzleTask:
    """A straight path of 400 samples, 0.25 mm apart, whose normal turns by `quick` degrees a sample in its middle."""
    n = 400
    turn = np.radians(np.cumsum(np.where(np.abs(np.arange(n) - 200) < 10, quick, 0.0)))
    normal = np.column_stack([np.sin(turn), 0.0 * turn, np.cos(turn)])
    x = np.tile([0.0, 1.0, 0.0], (n, 1))
    s = 0.25e-3 * np.arange(n)
    frames = np.stack([x, np.cross(-normal, x), -normal], axis=-1)
    return NozzleTask(0, "line", 0, np.column_stack([s, 0 * s, 0 * s]), frames, s, 0, n - 1, 0.02, cones)


@pytest.mark.parametrize("fewest", [4, 8])
def test_places_are_dense_where_the_normal_turns_and_the_layer_must_stay_upright(fewest: int) -> None:
    task = turning_task(NARROW_CONES)
    even = places_along(replace(task, cones=FREE), 5e-3, fewest)
    np.testing.assert_allclose(np.diff(even), 1.0 / (len(even) - 1), rtol=1e-12)
    places = places_along(task, 5e-3, fewest)
    assert (places[0], places[-1]) == (0.0, 1.0)
    apart = np.diff(places) * (len(task) - 1)
    middle = 0.5 * (places[1:] + places[:-1]) * (len(task) - 1)
    assert apart.min() > 3.9
    assert apart[np.abs(middle - 200) < 8].max() < 5.0  # 20 samples apart elsewhere
    assert apart[np.abs(middle - 200) > 60].min() > 15.0
    # a normal that hardly turns asks for nothing
    np.testing.assert_allclose(places_along(turning_task(NARROW_CONES, 1e-3), 5e-3, fewest), even, rtol=0, atol=1e-9)


def test_splines_on_uneven_places() -> None:
    """What a rung says is felt where the rung stands; the refinement's basis knows its own derivatives."""
    places = places_along(turning_task(NARROW_CONES), 5e-3, 4)
    n, m = 400, len(places)
    np.testing.assert_allclose(breaks_of(places, m), places, rtol=0, atol=1e-15)
    at = np.linspace(0.0, 1.0, n)
    basis = basis_over(clock_of(at), places)
    for even in (places, np.linspace(0.0, 1.0, 40)):
        curve = spread(even, n, even)
        off = np.abs(curve - at)
        apart = np.maximum(np.append(np.diff(even), 0.0), np.append(0.0, np.diff(even)))
        assert (off < 1.0 * np.interp(at, even, apart)).all()  # less than a rung off, anywhere
        assert (np.diff(curve) > 0.0).all()
    one = np.zeros(m)
    k = int(np.argmin(np.abs(places - 0.5)))
    one[k] = 1.0
    felt = at[np.abs(spread(one, n, places)) > 1e-12]
    assert places[k - 4] < felt.min() < felt.max() < places[k + 4]
    # derivatives by time of what varies in time as the samples do, by differences of the values
    values = basis.values(np.sin(9.0 * places)[:, None])[:, 0]
    seen = (basis.B[:, 1] * np.sin(9.0 * places)[basis.first[:, None] + np.arange(6)]).sum(axis=1)
    np.testing.assert_allclose(seen[2:-2], np.gradient(values, at)[2:-2], rtol=0, atol=3e-3 * np.abs(seen).max())


def rotated(d: Array, spin: Array, h: float) -> Array:
    moved = d + h * np.cross(spin, d) + 0.5 * h * h * np.cross(spin, np.cross(spin, d))
    return np.asarray(moved / np.linalg.norm(moved))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.1, 1.2, 2.0, 3.0])
def test_lean_is_the_angle_and_its_slope_is_that_of_differences(angle: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        towards, spin = rng.uniform(0, 2 * np.pi), rng.normal(size=3)
        d = np.array([np.sin(angle) * np.cos(towards), np.sin(angle) * np.sin(towards), np.cos(angle)])
        lean, plus, minus, slope = np.empty(2), np.empty(2), np.empty(2), np.empty(2)
        lean_of(d, lean)
        np.testing.assert_allclose(lean, angle * np.array([np.cos(towards), np.sin(towards)]), rtol=0, atol=1e-9)
        lean_slope_of(d, spin, slope)
        h = 1e-5
        lean_of(rotated(d, spin, h), plus)
        lean_of(rotated(d, spin, -h), minus)
        np.testing.assert_allclose(slope, (plus - minus) / (2 * h), rtol=0, atol=1e-5)
    upside_down = np.empty(2)
    lean_of(np.array([0.0, 0.0, -1.0]), upside_down)
    assert np.hypot(*upside_down) == np.pi


def test_polygon_holds_the_circle_and_hugs_it_where_the_direction_leans() -> None:
    cone = 0.14
    lean = cone * np.array([np.cos(2.0), np.sin(2.0)])
    facets = np.array([facet(lean, k) for k in range(FACETS.size)])
    ways = np.linspace(-np.pi, np.pi, 721)
    round_ = np.column_stack([np.cos(2.0 + ways), np.sin(2.0 + ways)])
    reach = cone / (round_ @ facets.T).max(axis=1)  # from the middle to the polygon's edge
    assert (reach >= cone * (1 - 1e-12)).all()
    assert reach.max() < 2.0 * cone  # it is closed
    assert reach[np.abs(ways) < np.radians(5.0)].max() - cone < 1e-4


def test_facets_are_watched_once_a_step_goes_beyond_them() -> None:
    """One sample, one control value that moves the lean along x."""
    lean, cones = np.zeros((1, 1, 2)), np.array([0.1])
    lean[0, 0, 0] = 0.05
    slope = np.zeros((1, 1, 2, 1))
    slope[0, 0, 0, 0] = 1.0
    step, first, B, free = np.ones(1), np.zeros(1, dtype=np.int64), np.ones((1, 4, 1)), np.ones(1)
    watch = np.zeros((1, 1, FACETS.size), dtype=np.bool_)
    watch_leans(step, lean, cones, watch)
    assert not watch.any()  # half way to the cone
    assert watch_missed_leans(step, lean, slope, cones, first, B, free, np.array([0.04]), watch) == 0
    missed = watch_missed_leans(step, lean, slope, cones, first, B, free, np.array([0.06]), watch)
    assert watch[0, 0, 0]
    np.testing.assert_array_equal(watch[0, 0], 0.11 * np.cos(FACETS) > 0.1 + 1e-5)
    assert missed == watch.sum()
    assert watch_missed_leans(step, lean, slope, cones, first, B, free, np.array([0.06]), watch) == 0
    watch[:] = False
    watch_leans(step, 1.9 * lean, cones, watch)
    assert watch[0, 0, 0]
    watch[:] = False
    watch_leans(np.zeros(1), 1.9 * lean, cones, watch)
    assert not watch.any()  # a sample of no concern
