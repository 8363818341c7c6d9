"""Curves in space, and curves that fall along normals or in a direction: where they land, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from solved import promises_kept, solve_alone

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import Problem, load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.substrate.bodies import Ball, Corrugation, Ellipsoid, Plane
from planner.toolpath.substrate.falling import along

MM = 1e-3
SPACE = "[{degree: 2, points_mm: [[-40, -30, 70], [-10, 30, 95], [20, -30, 80], [50, 10, 60]]}]"
BALL = "part={sphere: {radius_mm: 80, centre_mm: [5, -3, -20]}}"
CENTRE, RADIUS = np.array([5.0, -3.0, -20.0]) * MM, 80.0 * MM


def bowl(*changes: str, curves: str = SPACE) -> Problem:
    return load_problem("fibre_bowl", (f"layers.source.curves={curves}", *changes))


def points_of(problem: Problem) -> Array:
    """Middle lines (n, 3) of the first layer's beads, brought down by a layer."""
    beads = build_toolpath(problem).beads
    return np.vstack([bead.points - problem.layers.height * bead.normals for bead in beads])  # type: ignore[union-attr]


def drawn(count: int = 20001) -> Array:
    """Points (n, 3) [m] of SPACE: a clamped quadratic spline of two spans, by its Bezier pieces."""
    p = np.array([[-40, -30, 70], [-10, 30, 95], [20, -30, 80], [50, 10, 60]]) * MM
    middle, u = 0.5 * (p[1] + p[2]), np.linspace(0.0, 1.0, count)[:, None]
    pieces = [(p[0], p[1], middle), (middle, p[2], p[3])]
    return np.vstack([(1 - u) ** 2 * a + 2 * u * (1 - u) * b + u**2 * c for a, b, c in pieces])


def farthest(points: Array, line: Array) -> float:
    """Greatest distance of points (n, 3) from the nearest of many of a line (m, 3)."""
    from scipy.spatial import cKDTree

    return float(cKDTree(line).query(points)[0].max())


def test_curves_in_space_fall_along_z() -> None:
    landed = points_of(bowl(BALL))
    line = drawn()
    flat = line[:, :2] - CENTRE[:2]
    line[:, 2] = CENTRE[2] + np.sqrt(RADIUS**2 - (flat**2).sum(axis=1))
    assert farthest(landed, line) < 0.05 * MM


def test_along_normals_each_point_falls_to_the_nearest_place() -> None:
    landed = points_of(bowl(BALL, "layers.project=normal"))
    away = drawn() - CENTRE
    assert farthest(landed, CENTRE + RADIUS * away / np.linalg.norm(away, axis=1)[:, None]) < 0.05 * MM


def test_in_a_direction_points_fall_to_where_their_line_meets_the_part_first() -> None:
    way = np.array([0.5, 0.2, -1.0]) / np.linalg.norm([0.5, 0.2, -1.0])
    landed = points_of(bowl(BALL, "layers.project=direction", "layers.direction=[0.5, 0.2, -1]"))
    off = drawn() - CENTRE
    b = off @ way
    root = -b - np.sqrt(b**2 - (off**2).sum(axis=1) + RADIUS**2)
    assert farthest(landed, CENTRE + off + root[:, None] * way) < 0.05 * MM


def test_a_part_may_lie_metres_beneath_the_curve() -> None:
    landed = along(Ball(0.5, np.zeros(3)), np.array([[0.3, 0.0, 2.5]]), np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(landed, [[0.3, 0.0, 0.4]], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    "body",
    [
        Ball(0.05, np.array([0.0, 0.01, -0.02])),
        Ellipsoid(np.zeros(3), np.array([0.09, 0.05, 0.03])),
        Plane(np.array([0.0, 0.0, 0.01]), np.array([0.3, -0.2]), np.array([0.2, 0.2])),
        Corrugation(np.zeros(3), 0.006, 100.0, np.array([0.8, 0.6]), np.array([0.3, 0.3])),
    ],
    ids=lambda body: type(body).__name__,
)
def test_lines_meet_a_body_where_they_enter_it(body: Ball | Ellipsoid | Plane | Corrugation) -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-0.02, 0.02, (200, 3))
    way = np.array([0.6, 0.1, -0.8]) / np.linalg.norm([0.6, 0.1, -0.8])
    feet = along(body, points, way)
    assert np.abs(body.signed_distance(feet)).max() < 1e-8
    assert np.linalg.norm(np.cross(feet - points, way), axis=1).max() < 1e-12
    before = feet[:, None] - np.linspace(1e-4, 0.3, 500)[:, None] * way
    assert body.signed_distance(before.reshape(-1, 3)).min() > 0.0, "nothing is met before"


def test_lines_that_miss_have_no_foot() -> None:
    assert np.isnan(along(Ball(0.05, np.zeros(3)), np.array([[0.2, 0.0, 0.1]]), np.array([0.0, 0.0, -1.0]))).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (("layers.project=direction",), "project is direction, but no direction is given (give direction, for example"),
        (("layers.direction=[0, 0, -1]",), "project is z (leave out direction)"),
        (("layers.project=direction", "layers.direction=[0, 0.1, 1]"), "points upwards"),
        (("layers.project=direction", "layers.direction=[0, 0, 0]"), "zero vector"),
        (("layers.project=normals",), "did you mean normal?"),
        (
            ("part={mesh: {file: dome.stl}}", "layers.project=normal"),
            "layers.project: normal and a mesh do not go together (it goes with sphere, ellipsoid, plane, corrugation; turn",
        ),
    ],
)
def test_settings_are_checked(changes: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError) as caught:
        bowl(*changes)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("points", "changes", "words"),
    [
        ("[[0, 0, 90], [200, 0, 90]]", ("layers.project=direction", "layers.direction=[0, 0.1, -1]"), "curve 1 misses"),
        ("[[0, 0, -90], [20, 0, -90]]", ("layers.project=normal",), "onto the underside of the part at x 0.0"),
        (
            "[[-20, 0, 1], [20, 0, 1]]",
            ("part={sphere: {radius_mm: 60}}", "layers.project=normal"),
            "jumps from one place",
        ),
        (
            "[[0, 0, 90], [30, 0, 60]]",
            ("layers.project=direction", "layers.direction=[1, 0, -1]"),
            "falls onto a single point of the part",
        ),
    ],
)
def test_curves_that_fall_nowhere_are_refused(points: str, changes: tuple[str, ...], words: str) -> None:
    with pytest.raises(InputError) as caught:
        build_toolpath(bowl(*changes, curves=f"[{{degree: 1, points_mm: {points}}}]"))
    assert words in str(caught.value) and "layers.project" in str(caught.value)


GOOD = '{"curves": [\n  {"degree": 2, "points_mm": [[-40, -30, 70], [-10, 30, 95], [20, -30, 80], [50, 10, 60]]}\n]}'


def of_file(path: Path) -> Problem:
    return load_problem("fibre_bowl", (f"layers.source={{nurbs: '{path}'}}", BALL, "layers.project=normal"))


def test_a_file_holds_the_same_curves(tmp_path: Path) -> None:
    path = tmp_path / "curves.json"
    path.write_text(GOOD.replace("  ", "\t"), encoding="utf-8-sig")
    np.testing.assert_array_equal(points_of(of_file(path)), points_of(bowl(BALL, "layers.project=normal")))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "layers.source.nurbs: cannot read curves.json"),
        (b"\xff\xfe\x00", "layers.source.nurbs: curves.json is not text"),
        ("[1, 2]", 'has no list of curves (for example {"curves"'),
        ("{", "curves.json:1"),
        ('{"curves": []}', "an empty list"),
        (GOOD.replace('"degree": 2', '"degree": 26'), "curves.json:2: curves.degree: 26 is too large"),
        (GOOD.replace("70]", "NaN]"), "curves.json:2"),
        (GOOD.replace('"degree"', '"degre"'), "curves.json:2"),
        (GOOD.replace("[50, 10, 60]", "[50, 10]"), "point 4 has 2 numbers"),
        (GOOD.replace("]}\n", '], "knots": [0, 0, 1, 1, 1]}\n'), "5 knots instead of 7"),
    ],
)
def test_mistakes_in_a_file_are_told_with_their_line(tmp_path: Path, text: str | bytes | None, words: str) -> None:
    path = tmp_path / "curves.json"
    if text is not None:
        path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(InputError) as caught:
        build_toolpath(of_file(path))
    assert words in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes", [("layers.project=normal",), ("layers.project=direction", "layers.direction=[0.2, 0, -1]")]
)
def test_curves_in_space_are_printed_and_verified(changes: tuple[str, ...]) -> None:
    plan = solve_alone(bowl(*changes, "process.start={}", "strategy=ladder"))
    promises_kept(plan)
