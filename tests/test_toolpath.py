"""From plane curves to beads: wrapping, order, layers, run-in and run-out."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline
from scipy.spatial import cKDTree
from scipy.special import ellipeinc

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import Problem
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.ordering import reverse, shorten_travel
from planner.toolpath.plane_paths import PlaneCurve, arc_length, round_corners, with_seam
from planner.toolpath.runs import RISE_PER_LENGTH, BeadRun, with_runs
from planner.toolpath.svg.outlines import PlanePath
from planner.toolpath.task import NozzleTask, make_tasks
from planner.toolpath.wrapped import Cylinder, wrap_layer

MM = 1e-3
CYLINDER = Cylinder(0.034, 0.1, np.array([0.0314, 0.037]))


def curve_of(points: object, closed: bool = False, name: str = "curve") -> PlaneCurve:
    points = np.array(points, dtype=float)
    return PlaneCurve(name, points, points, closed)


def travel_length(curves: Sequence[PlaneCurve]) -> float:
    """Straight-line travel between the curves in their order [m]."""
    return sum(float(np.hypot(*(b.points[0] - a.points[-1]))) for a, b in itertools.pairwise(curves))


def line(start: tuple[float, float], end: tuple[float, float], n: int = 101) -> PlaneCurve:
    return curve_of(np.linspace(start, end, n))


# --- the cylinder and wrapping ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_signed_distance_against_points_of_the_surface() -> None:
    rng = np.random.default_rng(1)
    cylinder = Cylinder(0.03, 0.05, np.array([0.01, -0.02]))
    angle, up = rng.uniform(0, 2 * np.pi, 400_000), rng.uniform(0, 0.05, 400_000)
    mantle = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), up])
    r = 0.03 * np.sqrt(rng.uniform(0, 1, 200_000))
    caps = np.column_stack(
        [r * np.cos(angle[:200_000]), r * np.sin(angle[:200_000]), 0.05 * rng.integers(0, 2, 200_000)]
    )
    tree = cKDTree(np.vstack([mantle, caps]) + [0.01, -0.02, 0.0])
    points = rng.uniform([-0.05, -0.08, -0.03], [0.07, 0.04, 0.08], (2000, 3))
    inside = (np.hypot(points[:, 0] - 0.01, points[:, 1] + 0.02) < 0.03) & (points[:, 2] > 0) & (points[:, 2] < 0.05)
    assert inside.any()
    expected = np.where(inside, -1.0, 1.0) * tree.query(points)[0]
    np.testing.assert_allclose(cylinder.signed_distance(points), expected, rtol=0, atol=0.4 * MM)
    assert np.array_equal(cylinder.signed_distance(points) < 0, inside)


def test_wrapped_points_lie_on_their_layer() -> None:
    rng = np.random.default_rng(2)
    plane = rng.uniform([-0.1, -0.04], [0.1, 0.04], (500, 2))
    for layer in (0, 1, 9):
        (bead,) = wrap_layer([curve_of(plane)], CYLINDER, layer, 0.5 * MM, 0.6 * MM, 0.5 * MM)
        out = bead.points[:, :2] - CYLINDER.centre
        np.testing.assert_allclose(np.hypot(*out.T), 0.034 + (layer + 1) * 0.5 * MM, rtol=0, atol=1e-12)
        np.testing.assert_allclose(bead.points[:, 2], plane[:, 1] + 0.05, rtol=0, atol=1e-12)
        # x is arc length on the bare mantle, counter-clockwise from the part's x axis
        turned = np.remainder(np.arctan2(out[:, 1], out[:, 0]) - plane[:, 0] / 0.034 + np.pi, 2 * np.pi) - np.pi
        assert np.abs(turned).max() < 1e-12
        expected = np.column_stack([out / np.hypot(*out.T)[:, None], np.zeros(len(out))])
        np.testing.assert_allclose(bead.normals, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(bead.normals, CYLINDER.normals(bead.points), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(bead.roll_zero, np.tile([0.0, 0.0, 1.0], (len(out), 1)))
        np.testing.assert_allclose(CYLINDER.signed_distance(bead.points), (layer + 1) * 0.5 * MM, rtol=0, atol=1e-12)


def test_bead_keeps_what_it_is_told() -> None:
    (bead,) = wrap_layer([line((0, 0), (0.02, 0.01))], CYLINDER, 3, 0.5 * MM, 0.6 * MM, 0.4 * MM)
    assert (bead.name, bead.layer, bead.closed) == ("curve", 3, False)
    assert bead.width.tolist() == [0.6 * MM] * len(bead.s)
    assert bead.height.tolist() == [0.4 * MM] * len(bead.s)


@pytest.mark.parametrize("end", [(0.05, 0.0), (0.0, 0.03), (0.2, 0.05), (-0.03, 0.02)])
@pytest.mark.parametrize("layer", [0, 7])
def test_length_of_a_helix(end: tuple[float, float], layer: int) -> None:
    """A straight line becomes a helix of length sqrt((x (r + rise) / r)^2 + y^2)."""
    (bead,) = wrap_layer([line((0, 0), end, 400)], CYLINDER, layer, 0.5 * MM, 0.6 * MM, 0.5 * MM)
    stretched = end[0] * (0.034 + (layer + 1) * 0.5 * MM) / 0.034
    assert bead.length == pytest.approx(np.hypot(stretched, end[1]), abs=1e-11)
    np.testing.assert_allclose(bead.s, np.linspace(0.0, bead.length, 400), rtol=0, atol=1e-11)


def test_arc_length_of_an_ellipse() -> None:
    """Uniform in the parameter, not in arc length: the closed form is an elliptic integral."""
    t = np.linspace(0.0, 2.0, 300)
    a, b = 0.02, 0.05
    points = np.column_stack([a * np.cos(t), b * np.sin(t), np.zeros(300)])
    np.testing.assert_allclose(arc_length(points), b * ellipeinc(t, 1.0 - (a / b) ** 2), rtol=0, atol=1e-11)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_arc_length_of_a_piece_of_few_samples(count: int) -> None:
    points = np.linspace([0.0, 0.0, 0.0], [3e-3, 4e-3, 0.0], count)
    np.testing.assert_allclose(arc_length(points), np.linspace(0.0, 5e-3, count), rtol=0, atol=1e-15)


def test_source_is_the_input_polyline_wrapped() -> None:
    corners = np.array([[-0.02, 0.0], [0.01, 0.0], [0.01, 0.015]])
    curve = round_corners(PlanePath("corner", corners, False), 0.2 * MM)
    (bead,) = wrap_layer([curve], CYLINDER, 0, 0.5 * MM, 0.6 * MM, 0.5 * MM)
    np.testing.assert_allclose(CYLINDER.signed_distance(bead.source), 0.5 * MM, rtol=0, atol=1e-12)
    wrapped, _, _ = CYLINDER.wrap(corners, 0.5 * MM)
    assert cKDTree(bead.source).query(wrapped)[0].max() < 1e-12
    legs = np.linalg.norm(np.diff(bead.source, axis=0), axis=1).sum()
    assert legs == pytest.approx(0.03 * 34.5 / 34 + 0.015, abs=1e-7)


def distance_between(points: Array, polyline: Array) -> Array:
    """Distances (n) of points from a 3-D polyline, every point against every segment."""
    a, d = polyline[:-1], np.diff(polyline, axis=0)
    out = np.empty(len(points))
    for k, p in enumerate(points):
        t = np.clip(((p - a) * d).sum(axis=1) / (d * d).sum(axis=1), 0.0, 1.0)
        out[k] = np.linalg.norm(p - a - t[:, None] * d, axis=1).min()
    return out


@pytest.mark.parametrize("layer", [0, 11])
def test_every_layer_holds_the_corner_tolerance_in_its_own_metric(drawing: Callable[..., Problem], layer: int) -> None:
    """Tall layers on a thin cylinder: the outermost one is 1.6 times as wide as the mantle under the first."""
    problem = drawing(
        '<path d="M0,0 L20,0 L12,3 L20,6 L0,6 L6,3 Z"/>', 40,
        "layers.count=12", "layers.height_mm=0.5", "part.cylinder.radius_mm=10",
    )  # fmt: skip
    bead = build_toolpath(problem).beads[layer]
    assert bead.layer == layer
    tolerance = problem.process.corner_tolerance
    assert distance_between(bead.points[::3], bead.source).max() <= tolerance
    assert distance_between(bead.source[::3], bead.points).max() <= tolerance


# --- order ------------------------------------------------------------------------------------------------------


def random_curves(rng: np.random.Generator, n: int) -> list[PlaneCurve]:
    curves = []
    for i in range(n):
        if rng.random() < 0.3:
            start = rng.uniform(0, 1, 2)
            curves.append(curve_of([start, start + 0.1, start + [0.1, 0.0], start], closed=True, name=str(i)))
        else:
            curves.append(curve_of(rng.uniform(0, 1, (3, 2)), name=str(i)))
    return curves


def least_travel(curves: Sequence[PlaneCurve]) -> float:
    best = np.inf
    for order in itertools.permutations(curves):
        # by bead: travel so far, ending at its end and (turned round) at its start
        forwards = backwards = 0.0
        for a, b in itertools.pairwise(order):
            starts = {
                side: min(
                    forwards + float(np.hypot(*(b.points[side] - a.points[-1]))),
                    backwards + float(np.hypot(*(b.points[side] - a.points[0]))),
                )
                for side in (0, -1)
            }
            forwards, backwards = starts[0], starts[-1]
        best = min(best, forwards, backwards)
    return best


def nearest_neighbour_travel(curves: Sequence[PlaneCurve]) -> float:
    left, here, total = list(curves[1:]), curves[0].points[-1], 0.0
    while left:
        gaps = [(float(np.hypot(*(c.points[side] - here))), i, side) for i, c in enumerate(left) for side in (0, -1)]
        gap, i, side = min(gaps)
        total += gap
        here = left.pop(i).points[-1 if side == 0 else 0]
    return total


@pytest.fixture(scope="module")
def ordered() -> list[tuple[list[PlaneCurve], list[PlaneCurve]]]:
    rng = np.random.default_rng(4)
    jobs = [random_curves(rng, n) for n in (2, 3, 4, 5, 6) for _ in range(24)]
    return [(job, shorten_travel(job)) for job in jobs]


def test_every_curve_is_printed_once_forwards_or_backwards(
    ordered: list[tuple[list[PlaneCurve], list[PlaneCurve]]],
) -> None:
    for before, after in ordered:
        assert sorted(c.name for c in after) == sorted(c.name for c in before)
        for curve in after:
            own = before[int(curve.name)]
            assert any(np.array_equal(curve.points, p) for p in (own.points, own.points[::-1]))
            assert curve.closed == own.closed
            np.testing.assert_array_equal(curve.points[[0, -1]], curve.source[[0, -1]])


@pytest.mark.slow
def test_travel_against_brute_force(ordered: list[tuple[list[PlaneCurve], list[PlaneCurve]]]) -> None:
    """2-opt is a local search: the least travel of all in most cases, and never worse than where it started."""
    travels = []
    for before, after in ordered:
        found, least = travel_length(after), least_travel(before)
        assert least - 1e-9 <= found <= nearest_neighbour_travel(before) + 1e-9
        travels.append((found, least))
    all_found, all_least = np.array(travels).T
    assert np.mean(all_found < all_least + 1e-9) > 0.7
    assert all_found.sum() < 1.08 * all_least.sum()


def test_no_stretch_can_be_turned_round_with_gain(ordered: list[tuple[list[PlaneCurve], list[PlaneCurve]]]) -> None:
    for _, after in ordered:
        travel = travel_length(after)
        for i, j in itertools.combinations(range(len(after) + 1), 2):
            turned = after[:i] + [reverse(c) for c in after[i:j][::-1]] + after[j:]
            assert travel_length(turned) > travel - 1e-8


def test_order_of_none_and_one() -> None:
    assert shorten_travel([]) == []
    one = line((0, 0), (1, 0))
    assert shorten_travel([one]) == [one]


def test_a_row_of_lines_is_printed_as_a_zigzag() -> None:
    rows = [line((0, y), (10, y)) for y in (0, 3, 1, 2)]
    assert travel_length(shorten_travel(rows)) == pytest.approx(3.0)


# --- layers -----------------------------------------------------------------------------------------------------


def test_layers_are_the_same_beads_in_reverse(toolpath: Toolpath, drawing_problem: Problem) -> None:
    assert toolpath.layers == 2
    first, second = ([b for b in toolpath.beads if b.layer == k] for k in (0, 1))
    assert [b.name for b in first] == [b.name for b in second][::-1]
    assert [b.layer for b in toolpath.beads] == sorted(b.layer for b in toolpath.beads)
    height = drawing_problem.layers.height
    for below, above in zip(first, second[::-1], strict=True):
        np.testing.assert_allclose(above.points[::-1], below.points + height * below.normals, rtol=0, atol=1e-12)
        assert above.closed == below.closed
    # so the way from layer to layer is one layer's height
    step = second[0].points[0] - first[-1].points[-1]
    assert np.linalg.norm(step) == pytest.approx(height, abs=1e-12)


def test_arc_length_of_every_bead_is_that_of_its_points(toolpath: Toolpath) -> None:
    for bead in toolpath.beads:
        assert bead.s[0] == 0.0
        assert (np.diff(bead.s) > 0).all()
        chords = np.linalg.norm(np.diff(bead.points, axis=0), axis=1)
        assert (np.diff(bead.s) >= chords - 1e-9).all()
        assert bead.length == pytest.approx(chords.sum(), rel=1e-4)


# --- seams ------------------------------------------------------------------------------------------------------


def corner_gaps(points: Array) -> tuple[Array, float]:
    """Arc length of corners of a closed polyline, and its whole length."""
    d = np.diff(points, axis=0)
    d = d[np.hypot(*d.T) > 1e-12]
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*d.T))])
    heading = np.arctan2(d[:, 1], d[:, 0])
    turn = np.abs(np.remainder(heading - np.roll(heading, 1) + np.pi, 2 * np.pi) - np.pi)
    return arc[:-1][turn > np.radians(10.0)], float(arc[-1])


@given(
    radii=st.lists(st.floats(0.5, 1.5), min_size=3, max_size=9),
    shift=st.integers(0, 8),
)
@settings(max_examples=60)
def test_seam_is_as_far_from_corners_as_it_can_be(radii: list[float], shift: int) -> None:
    angle = 2 * np.pi * np.arange(len(radii)) / len(radii)
    loop = np.roll(np.array(radii)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]), shift, axis=0)
    path = PlanePath("loop", np.vstack([loop, loop[:1]]), True)
    moved = with_seam(path).points
    np.testing.assert_array_equal(moved[0], moved[-1])
    corners, length = corner_gaps(path.points)
    after, same_length = corner_gaps(moved)
    assert same_length == pytest.approx(length)
    if len(corners):
        gaps = np.diff(np.append(corners, corners[0] + length))
        assert min(after[0], same_length - after[-1]) == pytest.approx(0.5 * gaps.max())
    area = [0.5 * np.sum(p[:-1, 0] * p[1:, 1] - p[1:, 0] * p[:-1, 1]) for p in (path.points, moved)]
    assert area[0] == pytest.approx(area[1])  # the same loop, the same way round


def test_seam_of_a_loop_without_corners_stays() -> None:
    angle = np.linspace(0, 2 * np.pi, 101)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    circle[-1] = circle[0]
    np.testing.assert_array_equal(with_seam(PlanePath("circle", circle, True)).points, circle)


def test_seam_on_a_vertex_repeats_no_point() -> None:
    square = np.array([[0, 0], [8, 0], [16, 0], [16, 16], [0, 16], [0, 0]]) * MM
    moved = with_seam(PlanePath("square", square, True)).points
    assert np.hypot(*np.diff(moved, axis=0).T).min() > 1e-9


# --- what does not fit ------------------------------------------------------------------------------------------


def test_drawing_wider_than_the_circumference(drawing: Callable[..., Problem]) -> None:
    shape = '<path d="M0,0 L20,0 L20,2"/>'
    around = 2 * np.pi * 34
    assert build_toolpath(drawing(shape, around - 0.1, "layers.count=1")).beads
    with pytest.raises(InputError) as caught:
        build_toolpath(drawing(shape, around + 0.1, "layers.count=1"))
    assert "layers.source.width_mm" in (caught.value.field or "")
    assert caught.value.hint is not None
    assert f"{around:.1f}" in caught.value.hint


@pytest.mark.parametrize(
    "height",
    [
        31.1,
        30.7,
        31.3,
        29.9,
    ],
)
def test_drawing_higher_than_the_cylinder_and_the_width_that_would_fit(
    drawing: Callable[..., Problem], height: float
) -> None:
    shape = f'<path d="M0,0 L20,0 L20,{height}"/>'
    with pytest.raises(InputError) as caught:
        build_toolpath(drawing(shape, 78, "layers.count=1"))
    assert "layers.source.width_mm" in (caught.value.field or "")
    advice = re.search(r"at most ([\d.]+)", caught.value.hint or "")
    assert advice is not None
    width = float(advice[1])
    assert width == pytest.approx(100 * 20 / height, abs=0.11)
    assert build_toolpath(drawing(shape, width, "layers.count=1")).beads  # who follows the advice is helped


def test_loop_smaller_than_the_corner_tolerance_is_refused_by_name(drawing: Callable[..., Problem]) -> None:
    with pytest.raises(InputError) as caught:
        build_toolpath(drawing('<path d="M0,0 L20,0 L20,9"/><circle id="dot" r="0.1"/>', 20, "layers.count=1"))
    assert "dot" in str(caught.value)
    assert "corner_tolerance_mm" in str(caught.value)


# --- run-in and run-out -----------------------------------------------------------------------------------------

RUN = 3.0 * MM


@pytest.fixture(scope="module")
def runs(toolpath: Toolpath) -> list[tuple[Bead, BeadRun]]:
    straight = [line((0, 0), (0.02, 0.0), 200), line((0, 0), (0, 0.02), 200), line((0, 0), (0.01, -0.02), 200)]
    beads = [*toolpath.beads, *wrap_layer(straight, CYLINDER, 0, 0.5 * MM, 0.6 * MM, 0.5 * MM)]
    return [(bead, with_runs(bead, RUN)) for bead in beads]


def test_the_bead_itself_is_untouched(runs: list[tuple[Bead, BeadRun]]) -> None:
    for bead, run in runs:
        inside = slice(run.first, run.last + 1)
        np.testing.assert_array_equal(run.points[inside], bead.points)
        np.testing.assert_allclose(run.normals[inside], bead.normals, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.roll_zero[inside], bead.roll_zero, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.s[inside], bead.s, rtol=0, atol=1e-9)


def test_arc_length_is_negative_before_the_start(runs: list[tuple[Bead, BeadRun]]) -> None:
    for bead, run in runs:
        assert run.s[run.first] == 0.0
        assert run.s[run.last] == pytest.approx(bead.length, abs=1e-9)
        assert (np.diff(run.s) > 0).all()
        for length in (-run.s[0], run.s[-1] - run.s[run.last]):
            assert RUN <= length < 1.25 * RUN
        chords = np.linalg.norm(np.diff(run.points, axis=0), axis=1)
        np.testing.assert_allclose(np.diff(run.s), chords, rtol=2e-3)
        spline = make_interp_spline(np.arange(len(run.s)), run.points, k=5)
        whole = np.linalg.norm(spline(np.linspace(0, len(run.s) - 1, 40 * len(run.s)), 1), axis=1).mean()
        assert run.s[-1] - run.s[0] == pytest.approx(whole * (len(run.s) - 1), rel=1e-4)


@pytest.mark.parametrize("which", ["points", "normals", "roll_zero"])
def test_runs_join_with_continuous_second_derivatives(runs: list[tuple[Bead, BeadRun]], which: str) -> None:
    """By second differences: no step from one side to the other, and no spike between, as a kink would make."""
    for _, run in runs:
        rows = getattr(run, which)
        for joint in (run.first, run.last):
            bends = np.diff(rows[joint - 12 : joint + 13], 2, axis=0)  # bends[11] is centred on the joint
            scale = np.abs(bends).max() + 1e-9
            steps = np.linalg.norm(np.diff(rows[joint - 12 : joint + 13], axis=0), axis=1)
            # of each side's own samples alone, extrapolated to the joint by a cubic
            left = np.polynomial.polynomial.polyfit([-4, -3, -2, -1], bends[[7, 8, 9, 10]], 3)[0]
            right = np.polynomial.polynomial.polyfit([1, 2, 3, 4], bends[[12, 13, 14, 15]], 3)[0]
            assert np.abs(left - right).max() < 0.06 * scale
            spike = bends[11] - 0.5 * (bends[10] + bends[12])
            assert np.abs(spike).max() < 0.06 * scale
            if which == "points":
                assert np.abs(np.diff(steps)).max() < 0.05 * steps.max()


def test_runs_rise_from_the_surface(runs: list[tuple[Bead, BeadRun]]) -> None:
    for bead, run in runs:
        height = CYLINDER.signed_distance(run.points) - (bead.layer + 1) * 0.5 * MM
        for end, joint, step in ((0, run.first, -1), (-1, run.last, 1)):
            # the cube of the distance; a straight run leaves the round mantle by up to l^2 / 2r on top of it
            assert RISE_PER_LENGTH * RUN * 0.9 < height[end] < RISE_PER_LENGTH * RUN * 1.3 + RUN**2 / (2 * 0.034)
            way = height[joint::step]
            assert way.min() > -1e-9  # never into what has been printed
            assert (np.diff(way) > -1e-9).all()


def test_straight_runs_have_the_height_of_a_cube() -> None:
    """Up the mantle nothing curves: the run is the parabola of the formula itself."""
    (bead,) = wrap_layer([line((0, 0), (0, 0.02), 201)], CYLINDER, 0, 0.5 * MM, 0.6 * MM, 0.5 * MM)
    run = with_runs(bead, RUN)
    beyond = run.points[run.last :, 2] - bead.points[-1, 2]
    np.testing.assert_allclose(beyond, 0.1 * MM * np.arange(len(beyond)), rtol=0, atol=1e-9)
    height = CYLINDER.signed_distance(run.points[run.last :]) - 0.5 * MM
    np.testing.assert_allclose(height, 0.5 * RUN * (beyond / RUN) ** 3, rtol=0, atol=1e-9)


def test_frames_are_right_handed_and_look_into_the_part(tasks: tuple[NozzleTask, ...], toolpath: Toolpath) -> None:
    for i, (task, bead) in enumerate(zip(tasks, toolpath.beads, strict=True)):
        assert (task.bead, task.name, task.layer) == (i, bead.name, bead.layer)
        R = task.frames
        np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
        inside = slice(task.first, task.last + 1)
        np.testing.assert_allclose(R[inside, :, 2], -bead.normals, rtol=0, atol=1e-12)
        np.testing.assert_allclose(R[inside, :, 0], bead.roll_zero, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(task.tip[inside], bead.points)


def test_commanded_speed_is_carried_along(toolpath: Toolpath) -> None:
    assert {task.speed for task in make_tasks(toolpath, 0.037, RUN)} == {0.037}
