"""NURBS curves: what they are, how finely they are divided, and which are refused."""

from __future__ import annotations

from math import comb
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import Problem, load_problem
from planner.problem.drawings import CurveSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.nurbs import FLATNESS, Cusp, NurbsCurve, flatten

SQRT_HALF = float(np.sqrt(0.5))
CIRCLE = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0))
CIRCLE_KNOTS = (0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4)


def spec(
    degree: int,
    points: Array | list[tuple[float, float]] | tuple[tuple[float, float], ...],
    weights: tuple[float, ...] | None = None,
    knots: tuple[float, ...] | None = None,
) -> CurveSpec:
    """A curve with points in metres."""
    rows = tuple((float(x), float(y)) for x, y in points)
    return CurveSpec.model_construct(degree=degree, points=rows, weights=weights, knots=knots)


def by_the_book(knots: Array, degree: int, i: int, u: float) -> float:
    """Cox and de Boor: the i-th B-spline at u, the last piece closed on the right."""
    if degree == 0:
        last = knots[i] < knots[i + 1] == knots[-1] == u
        return float(knots[i] <= u < knots[i + 1] or last)
    total = 0.0
    if knots[i + degree] > knots[i]:
        total += (u - knots[i]) / (knots[i + degree] - knots[i]) * by_the_book(knots, degree - 1, i, u)
    if knots[i + degree + 1] > knots[i + 1]:
        share = (knots[i + degree + 1] - u) / (knots[i + degree + 1] - knots[i + 1])
        total += share * by_the_book(knots, degree - 1, i + 1, u)
    return total


points_of_a_curve = st.lists(st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)), min_size=5, max_size=8, unique=True)


@settings(max_examples=40)
@given(st.integers(1, 4), points_of_a_curve, st.data())
def test_a_curve_is_what_the_definition_says(
    degree: int, points: list[tuple[float, float]], data: st.DataObject
) -> None:
    n = len(points)
    weights = data.draw(st.lists(st.floats(0.1, 10.0), min_size=n, max_size=n))
    steps = data.draw(st.lists(st.floats(0.1, 2.0), min_size=n - degree, max_size=n - degree))
    inner = np.concatenate([[0.0], np.cumsum(steps)])
    knots = np.concatenate([np.repeat(inner[0], degree), inner, np.repeat(inner[-1], degree)])
    curve = NurbsCurve.of(spec(degree, points, tuple(weights), tuple(knots)))
    for u in np.linspace(0.0, 1.0, 7):
        basis = np.array([by_the_book(knots / knots[-1], degree, i, float(u)) for i in range(n)]) * weights
        expected = basis @ np.array(points) / basis.sum()
        np.testing.assert_allclose(curve.at(np.array([u]))[0], expected, atol=1e-12)


def test_without_knots_and_weights_four_points_of_degree_three_are_a_bezier_curve() -> None:
    points = np.array([[0.0, 0.0], [0.01, 0.03], [0.04, -0.02], [0.05, 0.01]])
    u = np.linspace(0.0, 1.0, 11)
    bernstein = np.stack([comb(3, k) * u**k * (1.0 - u) ** (3 - k) for k in range(4)], axis=1)
    np.testing.assert_allclose(NurbsCurve.of(spec(3, points)).at(u), bernstein @ points, atol=1e-15)


def test_a_rational_curve_is_an_exact_circle_that_closes() -> None:
    radius = 0.02
    weights = tuple(SQRT_HALF if i % 2 else 1.0 for i in range(9))
    path = flatten(NurbsCurve.of(spec(2, radius * np.array(CIRCLE), weights, CIRCLE_KNOTS)), "circle")
    assert path.closed
    assert np.array_equal(path.points[0], path.points[-1])
    middle = 0.5 * (path.points[1:] + path.points[:-1])
    np.testing.assert_allclose(np.hypot(*path.points.T), radius, atol=1e-12)
    assert np.hypot(*middle.T).min() >= radius - FLATNESS
    assert np.hypot(*np.diff(path.points, axis=0).T).sum() == pytest.approx(2.0 * np.pi * radius, rel=1e-4)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(2, 4), points_of_a_curve)
def test_chords_leave_a_curve_by_less_than_the_flatness(degree: int, points: list[tuple[float, float]]) -> None:
    curve = NurbsCurve.of(spec(degree, points))
    try:
        path = flatten(curve, "any")
    except Cusp:
        return
    dense = curve.at(np.linspace(0.0, 1.0, 501))[:, None]
    chords = np.diff(path.points, axis=0)
    away = dense - path.points[:-1]
    share = np.clip((away * chords).sum(axis=2) / (chords * chords).sum(axis=1), 0.0, 1.0)
    off = np.linalg.norm(away - share[..., None] * chords, axis=2).min(axis=1)
    assert off.max() <= 1.5 * FLATNESS  # a piece is judged at three places
    np.testing.assert_allclose(path.points[[0, -1]], np.array(points)[[0, -1]], atol=1e-9)


def test_segments_are_shorter_where_the_radius_is_smaller() -> None:
    """A parabola's radius grows from its top: so do the chords, as the root of it."""
    path = flatten(NurbsCurve.of(spec(2, [(-0.05, 0.05), (0.0, -0.05), (0.05, 0.05)])), "parabola")
    size = np.hypot(*np.diff(path.points, axis=0).T)
    middle = 0.5 * (path.points[1:] + path.points[:-1])[:, 0]
    top, ends = size[np.abs(middle) < 0.005].mean(), size[np.abs(middle) > 0.045].mean()
    assert ends > 2.0 * top


def test_a_double_knot_makes_a_corner_and_stays_a_vertex() -> None:
    points = [(0.0, 0.0), (0.01, 0.0), (0.02, 0.0), (0.02, 0.01), (0.02, 0.02)]
    path = flatten(NurbsCurve.of(spec(2, points, None, (0, 0, 0, 1, 1, 2, 2, 2))), "corner")
    assert np.hypot(*(path.points - [0.02, 0.0]).T).min() < 1e-12


@pytest.mark.parametrize(
    "points",
    [
        [(0.0, 0.0), (0.01, 0.01), (0.0, 0.01), (0.01, 0.0)],  # a cubic whose derivative vanishes in its middle
        [(0.0, 0.0), (0.02, 0.0), (0.0, 0.0), (0.01, 0.0)],  # along a line, to and fro
    ],
)
def test_a_curve_with_a_cusp_is_refused(points: list[tuple[float, float]]) -> None:
    with pytest.raises(Cusp) as caught:
        flatten(NurbsCurve.of(spec(3, points)), "cusp")
    assert np.isfinite(caught.value.place).all()


# In a problem

GOOD = "[{degree: 2, points_mm: [[-70, 0], [-25, 35], [25, -35], [70, 0]]%s}]"


def problem(curves: str, *more: str) -> Problem:
    return load_problem("fibre_plane", (f"layers.source.curves={curves}", *more))


@pytest.mark.parametrize(
    ("curves", "field", "words"),
    [
        ("[]", "curves", "an empty list"),
        ("3", "curves", "must be a list of curves"),
        ("[3]", "curves", "must be a section"),
        ("[{degree: 2}]", "points_mm", "is missing"),
        ("[{points_mm: [[0, 0], [9, 9], [0, 9]]}]", "degree", "is missing"),
        ("[{degree: 2, points_mm: 5}]", "points_mm", "list of points"),
        ("[{degree: 2, points_mm: [1, 2, 3]}]", "points_mm", "list of points"),
        (
            "[{degree: 2, points_mm: [[0, 0], [1, 2, 3], [3, 4]]}]",
            "points_mm",
            "point 2 has 3 numbers, but point 1 has 2",
        ),
        ("[{degree: 2, points_mm: [[0, 0], [.nan, 2], [3, 4]]}]", "points_mm", "finite"),
        ("[{degree: 2, points_mm: [[0, 0], [1, 1]]}]", "points_mm", "at least 3 control points, not 2"),
        ("[{degree: 0, points_mm: [[0, 0], [1, 1]]}]", "degree", "too small"),
        ("[{degree: 2.5, points_mm: [[0, 0], [1, 1], [2, 0]]}]", "degree", "whole number"),
        (GOOD % ", weights: [1, 1, 1]", "weights", "3 weights for 4 control points"),
        (GOOD % ", weights: [1, 0, 1, 1]", "weights", "too small"),
        (GOOD % ", weights: [1, -1, 1, 1]", "weights", "too small"),
        (GOOD % ", knots: [0, 0, 0, 1, 1, 1]", "knots", "6 knots instead of 7"),
        (GOOD % ", knots: [0, 0, 0.5, 1, 1]", "knots", "leave out the first and the last"),
        (GOOD % ", knots: [0, 0, 0, 2, 1, 1, 1]", "knots", "knot 5 (1) is less than the one before it (2)"),
        (GOOD % ", knots: [0, 1, 2, 3, 4, 5, 6]", "knots", "does not begin at its first control point"),
        (GOOD % ", knots: [0, 0, 0, 0, 1, 1, 1]", "knots", "breaks the curve apart"),
        (GOOD % ", knots: [0, 0, 0, 0, 0, 0, 0]", "knots", "does not begin"),
        (
            "[{degree: 2, points_mm: [[0, 0], [9, 0], [9, 9], [0, 9], [0, 18], [9, 18]], "
            "knots: [0, 0, 0, 1, 1, 1, 2, 2, 2]}]",
            "knots",
            "3 times in the list, which breaks",
        ),
        (GOOD % ", wieghts: [1, 1, 1, 1]", "wieghts", "did you mean weights"),
    ],
)
def test_bad_curves_are_refused_by_field(curves: str, field: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        problem(curves)
    assert caught.value.exit_code == 2
    assert field in str(caught.value.field)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("curves", "words"),
    [
        ("[{degree: 3, points_mm: [[0, 0], [90, 90], [0, 90], [90, 0]]}]", "curve 1 turns back on itself at x 45.00"),
        ("[{degree: 2, points_mm: [[0, 0], [0, 0], [0, 0]]}]", "'curve 1' is only 0.000 mm long"),
        ("[{degree: 2, points_mm: [[0, 0], [50, 0], [200, 0]]}]", "'curve 1' leaves the part at x 110.0"),
        ("[{degree: 2, points_mm: [[0, 0], [10, 5], [20, 0]]}]", "too short for cut fibre"),
    ],
)
def test_curves_that_cannot_be_laid_are_refused_and_nothing_is_written(
    curves: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["fibre_plane", "--set", f"layers.source.curves={curves}", "--out", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert words in said
    assert "Traceback" not in said
    assert not out.exists()


def test_a_mistake_in_a_curve_is_told_with_its_line(tmp_path: Path) -> None:
    shipped = load_problem("fibre_plane").file.read_text()
    wrong = shipped.replace("weights: [1, 1.5, 1.5, 1]", "weights: [1, 1.5, 1.5]")
    file = tmp_path / "wrong.yaml"
    file.write_text(wrong)
    with pytest.raises(InputError) as caught:
        load_problem(file)
    assert caught.value.line == 1 + [("1.5" in line) for line in wrong.splitlines()].index(True)
    cusp = shipped.replace("{degree: 2, points_mm: [[-70, 40], ", "{degree: 3, points_mm: [[-70, -10], ").replace(
        "[-25, 5], [25, 75], [70, 40]", "[20, 80], [-70, 80], [20, -10]"
    )
    file.write_text(cusp)
    with pytest.raises(InputError, match="curve 5 turns back") as caught:
        build_toolpath(load_problem(file))
    assert caught.value.line == 1 + [("degree: 3" in line) for line in cusp.splitlines()].index(True)


def test_a_source_is_named_once() -> None:
    with pytest.raises(InputError, match="both"):
        load_problem("fibre_plane", ("layers.source.pattern=zigzag",))


def test_beads_follow_the_curves_and_are_as_many() -> None:
    toolpath = build_toolpath(load_problem("fibre_plane"))
    assert sorted(bead.name for bead in toolpath.beads) == [f"curve {i}" for i in range(1, 6)]
    turned = build_toolpath(load_problem("fibre_plane", ("layers.turn_deg=90", "layers.centre_mm=[5, 10]")))
    for a, b in zip(toolpath.beads, turned.beads, strict=True):
        assert a.length == pytest.approx(b.length, rel=1e-6)
        np.testing.assert_allclose(b.points[0], [0.005 - a.points[0, 1], 0.01 + a.points[0, 0], 0.0003], atol=1e-9)
