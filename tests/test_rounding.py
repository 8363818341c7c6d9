"""Corner rounding: within tolerance both ways, smooth, and the best that the tolerance allows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline, make_interp_spline

from planner.base.arrays import Array
from planner.toolpath.plane_paths import ROUNDING_LENGTH, PlaneCurve, round_corners
from planner.toolpath.svg.outlines import PlanePath

TOLERANCE = 0.2e-3
MM = 1e-3


def rounded(points: object, closed: bool = False, tolerance: float = TOLERANCE) -> PlaneCurve:
    return round_corners(PlanePath("path", np.array(points, dtype=float), closed), tolerance)


def spline_of(points: Array) -> BSpline:
    return make_interp_spline(np.arange(len(points), dtype=float), points, k=5)


def dense(points: Array) -> Array:
    """Points of the smooth curve through uniform samples, four times as many."""
    return np.asarray(spline_of(points)(np.linspace(0.0, len(points) - 1.0, 4 * len(points) - 3)))


def distances(points: Array, polyline: Array) -> Array:
    """Distances (n) of points from a polyline: every point against every segment."""
    a, d = polyline[:-1], np.diff(polyline, axis=0)
    t = ((points[:, None] - a) * d).sum(axis=-1) / np.maximum((d * d).sum(axis=-1), 1e-300)
    return np.linalg.norm(points[:, None] - a - np.clip(t, 0.0, 1.0)[..., None] * d, axis=-1).min(axis=1)


def arc_of(points: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def sources(curve: PlaneCurve) -> tuple[Array, float]:
    """The place (n, 2) on the input path that each sample stands for, and their distance along it."""
    arc = arc_of(curve.source)
    u = np.linspace(0.0, arc[-1], len(curve.points))
    return np.column_stack([np.interp(u, arc, x) for x in curve.source.T]), float(u[1])


def curvature(spline: BSpline, u: Array) -> Array:
    d1, d2 = spline(u, 1), spline(u, 2)
    return np.asarray((d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / np.hypot(*d1.T) ** 3)


@st.composite
def polylines(draw: st.DrawFn) -> tuple[Array, bool]:
    """Two to eight corners on a grid of 0.25 mm: right angles, reversals and crossings are all likely."""
    closed = draw(st.booleans())
    cell = st.tuples(st.integers(0, 48), st.integers(0, 24))
    corners = draw(st.lists(cell, min_size=3 if closed else 2, max_size=8))
    kept = [a for i, a in enumerate(corners) if i == 0 or a != corners[i - 1]]
    while closed and len(kept) > 1 and kept[-1] == kept[0]:
        kept.pop()
    assume(len(kept) >= (3 if closed else 2))
    points = 0.25 * MM * np.array(kept + kept[:1] * closed, dtype=float)
    return points, closed


# --- tolerance --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(polylines())
@settings(max_examples=60)
def test_deviation_is_within_tolerance_both_ways(path: tuple[Array, bool]) -> None:
    points, closed = path
    curve = rounded(points, closed)
    line = dense(curve.points)
    assert distances(line, points).max() <= TOLERANCE  # no point of the curve is far from the drawing
    every = np.vstack([points[:-1] + t * np.diff(points, axis=0) for t in np.linspace(0.0, 1.0, 9)])
    assert distances(every, line).max() <= TOLERANCE  # no point of the drawing, corners included, far from the curve


@given(polylines())
@settings(max_examples=30)
def test_samples_stay_near_their_own_place(path: tuple[Array, bool]) -> None:
    """In order, so that nothing is skipped: a Frechet bound, not only one of sets."""
    curve = rounded(*path)
    places, _ = sources(curve)
    assert np.hypot(*(curve.points - places).T).max() <= TOLERANCE


@pytest.mark.parametrize("tolerance", [0.02 * MM, 0.1 * MM, 0.5 * MM])
def test_tolerance_is_held_and_used(tolerance: float) -> None:
    corner = np.array([[0, 0], [20, 0], [20, 20]]) * MM
    line = dense(rounded(corner, tolerance=tolerance).points)
    assert 0.9 * tolerance < distances(corner[1:2], line)[0] <= tolerance


def test_corners_between_samples_are_within_tolerance() -> None:
    for length in np.linspace(10.0, 10.1, 11):
        corner = np.array([[0, 0], [length, 0], [length - 6.0, 4.0]]) * MM
        line = dense(rounded(corner).points)
        assert distances(corner, line).max() <= TOLERANCE


# --- ends and seams ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@given(polylines())
@settings(max_examples=40)
def test_ends_are_kept_and_loops_closed(path: tuple[Array, bool]) -> None:
    points, closed = path
    curve = rounded(points, closed)
    assert curve.closed == closed
    np.testing.assert_array_equal(curve.source, points)
    if closed:
        np.testing.assert_array_equal(curve.points[0], curve.points[-1])
    else:
        np.testing.assert_allclose(curve.points[[0, -1]], points[[0, -1]], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "loop",
    [
        [[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]],  # the seam on a corner
        [[10, 0], [20, 0], [20, 10], [0, 10], [0, 0], [10, 0]],  # in the middle of an edge
        [[0, 0], [1, 0], [0.5, 1], [0, 0]],  # shorter than the rounding length
    ],
)
def test_closed_curves_are_smooth_across_the_seam(loop: list[list[float]]) -> None:
    P = rounded(np.array(loop) * MM, closed=True).points
    before, after = P[-13:-1], P[1:13]  # neither side sees the other one
    for order, share in ((1, 1e-3), (2, 1e-3), (3, 3e-2)):
        largest = np.abs(np.diff(P, order, axis=0)).max()
        left = spline_of(before)(12.0, order)  # extrapolated by one sample to the seam
        right = spline_of(after)(-1.0, order)
        assert np.abs(left - right).max() < share * largest, order
    around = np.vstack([P[-9:-1], P[:9]])
    elsewhere = np.abs(np.diff(P, 4, axis=0)).max()
    assert np.abs(np.diff(around, 4, axis=0)).max() <= 1.01 * elsewhere


def test_the_seam_of_a_loop_does_not_matter() -> None:
    """Wherever a square's path starts, the same curve comes out."""
    square = np.array([[0, 0], [16, 0], [16, 16], [0, 16], [0, 0]]) * MM
    started = np.array([[8, 0], [16, 0], [16, 16], [0, 16], [0, 0], [8, 0]]) * MM
    a, b = rounded(square, closed=True).points, rounded(started, closed=True).points
    quarter = (len(a) - 1) // 8
    np.testing.assert_allclose(np.roll(a[:-1], -quarter, axis=0), b[:-1], rtol=0, atol=1e-5 * MM)


# --- smoothness -------------------------------------------------------------------------------------------------


def test_right_angle_is_rounder_than_the_best_one_sided_blend() -> None:
    """A circle that touches both legs and passes the corner at the tolerance has radius d / (sqrt 2 - 1)."""
    curve = rounded(np.array([[0, 0], [20, 0], [20, 20]]) * MM)
    n = len(curve.points)
    bend = np.abs(curvature(spline_of(curve.points), np.linspace(20.0, n - 21.0, 20 * n)))
    assert 1.0 / bend.max() >= 1.4 * TOLERANCE / (np.sqrt(2.0) - 1.0)


@given(turn=st.floats(-np.pi, np.pi), legs=st.tuples(st.floats(5, 20), st.floats(5, 20)))
@settings(max_examples=40)
def test_third_derivative_of_any_corner_is_bounded(turn: float, legs: tuple[float, float]) -> None:
    """Of a right angle it is 0.012 / tolerance^2, and even a reversal stays below 0.06 / tolerance^2."""
    a, b = legs
    corner = np.array([[-a, 0.0], [0.0, 0.0], [b * np.cos(turn), b * np.sin(turn)]]) * MM
    curve = rounded(corner)
    _, step = sources(curve)
    assert np.abs(np.diff(curve.points, 3, axis=0)).max() / step**3 < 0.06 / TOLERANCE**2


@given(angle=st.floats(0, 2 * np.pi), length=st.floats(0.6, 40))
@settings(max_examples=20)
def test_straight_line_stays_straight(angle: float, length: float) -> None:
    ends = np.array([[1.0, 2.0], [1.0 + length * np.cos(angle), 2.0 + length * np.sin(angle)]]) * MM
    curve = rounded(ends)
    places, _ = sources(curve)
    np.testing.assert_allclose(curve.points, places, rtol=0, atol=1e-7)


def test_far_from_corners_the_curve_is_the_drawing() -> None:
    curve = rounded(np.array([[0, 0], [60, 0], [60, 60]]) * MM)
    places, step = sources(curve)
    away = np.abs(np.arange(len(places)) * step - 60 * MM) > 10 * ROUNDING_LENGTH * TOLERANCE  # decays as e^(-u / 2 l)
    assert np.hypot(*(curve.points - places)[away].T).max() < 0.02 * TOLERANCE


def objective(points: Array, places: Array, step: float) -> float:
    stiffness = (ROUNDING_LENGTH * TOLERANCE / step) ** 3
    return float((stiffness**2 * np.diff(points, 3, axis=0) ** 2).sum() + ((points - places) ** 2).sum())


def test_no_other_curve_within_the_discs_is_smoother() -> None:
    """The problem is convex, so no step towards any curve within the discs may lead downhill."""
    path = np.array([[0, 0], [6, 0], [6, 5], [2, 2], [9, 2]]) * MM
    curve = rounded(path)
    places, step = sources(curve)
    best = objective(curve.points, places, step)
    rng = np.random.default_rng(1)
    n = len(places)
    # the disc that every sample has at least: a corner between two samples takes at most half a step of it
    room = 0.98 * TOLERANCE - 0.5 * step
    others = [places, rounded(path, tolerance=0.5 * TOLERANCE).points]
    u = np.linspace(0.0, 1.0, n)
    for _ in range(40):
        wave = sum(rng.normal(size=2) * np.sin(np.pi * k * u)[:, None] for k in range(1, 30))
        others.append(places + room * wave / np.hypot(*wave.T).max())
    for other in others:
        if len(other) != n:
            other = np.asarray(spline_of(other)(np.linspace(0.0, len(other) - 1.0, n)))
        assert np.hypot(*(other - places).T).max() <= TOLERANCE
        for t in (1e-3, 1e-2, 0.1, 1.0):
            mixed = curve.points + t * (other - curve.points)
            assert objective(mixed, places, step) > best - 10.0 * n * (0.98 * TOLERANCE) ** 2  # the barrier's own gap


# --- symmetries -------------------------------------------------------------------------------------------------

ZIGZAG = np.array([[0, 0], [7, 0], [7, 5], [1, 6], [9, 8]]) * MM


def test_scaling_path_and_tolerance_scales_the_curve() -> None:
    small, large = rounded(ZIGZAG), rounded(8.0 * ZIGZAG, tolerance=8.0 * TOLERANCE)
    np.testing.assert_allclose(8.0 * small.points, large.points, rtol=0, atol=1e-9)


def test_turning_and_moving_the_path_turns_and_moves_the_curve() -> None:
    c, s = np.cos(0.7), np.sin(0.7)
    turned = ZIGZAG @ np.array([[c, s], [-s, c]]) + [0.03, -0.05]
    expected = rounded(ZIGZAG).points @ np.array([[c, s], [-s, c]]) + [0.03, -0.05]
    np.testing.assert_allclose(rounded(turned).points, expected, rtol=0, atol=1e-4 * TOLERANCE)


def test_a_path_run_backwards_gives_the_curve_backwards() -> None:
    np.testing.assert_allclose(
        rounded(ZIGZAG[::-1]).points, rounded(ZIGZAG).points[::-1], rtol=0, atol=1e-4 * TOLERANCE
    )


def test_an_added_vertex_on_a_straight_changes_nothing() -> None:
    more = np.insert(ZIGZAG, 1, [3.3 * MM, 0.0], axis=0)
    np.testing.assert_allclose(rounded(more).points, rounded(ZIGZAG).points, rtol=0, atol=1e-4 * TOLERANCE)
