"""Part and print as points in print order: where they lie, how densely, and from when on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from planner.cell.cell import build_cell
from planner.cell.solids import Body, Box
from planner.collision.point_tree import FROM_THE_START
from planner.collision.print_body import (
    CLEARANCE,
    CORNER_AREA,
    MERGED,
    PrintBody,
    _is_near,
    _sides,
    _tips,
    merged,
    print_body,
    split,
    standing,
)
from planner.problem import load_problem
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import make_bead


@pytest.fixture(scope="module")
def logo() -> tuple[Toolpath, PrintBody]:
    toolpath = build_toolpath(load_problem("cylinder_logo", ["layers.count=2"]))
    return toolpath, print_body(toolpath)


def _of(body: PrintBody, name: str) -> np.ndarray:
    """Positions in the tree of the points of one thing."""
    return np.flatnonzero([body.name_of(i) == name for i in range(len(body.tree.points))])


@pytest.mark.slow
def test_the_substrate_is_there_from_the_start_and_dense_near_beads(logo: tuple[Toolpath, PrintBody]) -> None:
    toolpath, body = logo
    part = _of(body, "part")
    points = body.tree.points[part]
    assert (body.tree.time[part] == FROM_THE_START).all()
    assert np.abs(toolpath.surface.before(0).signed_distance(points)).max() < 1.1e-5
    # from no place of the wall beneath a bead is the nearest point farther than its radius makes up for
    wall = np.concatenate([bead.points - bead.height[:, None] * bead.normals for bead in toolpath.beads[:3]])[::7]
    away = np.linalg.norm(wall[:, None] - points[None], axis=2)
    nearest = away.argmin(axis=1)
    reach = np.sqrt((CLEARANCE + body.tree.radius[part][nearest]) ** 2 - CLEARANCE**2)
    assert (away.min(axis=1) <= reach).all()


@pytest.mark.slow
def test_beads_are_rows_of_balls_that_come_in_print_order(logo: tuple[Toolpath, PrintBody]) -> None:
    toolpath, body = logo
    for i in (0, 41):
        bead = toolpath.beads[i]
        mine = _of(body, f"bead {i}")
        time = body.tree.time[mine]
        assert time.min() == i and time.max() == pytest.approx(i + 1.0)
        assert body.tree.radius[mine] == pytest.approx(0.25e-3)
        share = np.sort(time) - i
        assert np.diff(share).max() * bead.length <= 0.5e-3 + 1e-9
        # half a height beneath the tip
        where = np.column_stack([np.interp((time - i) * bead.length, bead.s, bead.points[:, k]) for k in range(3)])
        assert np.linalg.norm(body.tree.points[mine] - where, axis=1) == pytest.approx(0.25e-3, abs=2e-5)


def test_a_wide_bead_has_balls_beside_each_other() -> None:
    toolpath = build_toolpath(load_problem("hemisphere_honeycomb", ["process.bead.width_mm=1.5", "layers.count=1"]))
    body = print_body(toolpath)
    bead = toolpath.beads[0]
    mine = _of(body, "bead 0")
    first = mine[body.tree.time[mine] == 0.0]
    assert len(first) == 3
    spread = np.linalg.norm(body.tree.points[first] - body.tree.points[first].mean(axis=0), axis=1)
    assert spread.max() + 0.25e-3 == pytest.approx(0.75e-3)  # the bead's outermost edge
    assert np.linalg.norm(body.tree.points[first].mean(axis=0) - bead.points[0]) == pytest.approx(0.25e-3, abs=1e-5)


def test_known_by_waypoints_only_the_substrate_lies_under_the_first_layer() -> None:
    toolpath = build_toolpath(load_problem("peer_cap"))
    body = print_body(toolpath)
    bead = toolpath.beads[0]
    part = body.tree.points[_of(body, "part")]
    beneath = bead.points - bead.height[:, None] * bead.normals
    away = np.linalg.norm(beneath[:, None] - part[None], axis=2).min(axis=1)
    assert away.max() < bead.width.max()


@pytest.mark.slow
def test_what_stands_on_a_fixed_bed_is_seen_in_the_part_frame() -> None:
    bed = "cell.fixtures={bed: {box_mm: [200, 200, 20], centre_mm: [560, -93, 280]}}"
    problem = load_problem("planar_gcode", [bed])
    found = standing(build_cell(problem))
    assert [body.name for body in found] == ["bed"]
    assert found[0].T_frame_solid[:3, 3] == pytest.approx([0.0, 0.0, -0.01])
    body = print_body(build_toolpath(problem), found)
    top = body.tree.points[_of(body, "bed")]
    assert top[:, 2].max() == pytest.approx(0.0, abs=1e-9)
    middle = top[(np.abs(top[:, :2]) < 0.02).all(axis=1) & (top[:, 2] > -1e-6)]
    assert len(middle) > 40 * 40  # near beads a millimetre apart
    assert isinstance(found[0], Body) and isinstance(found[0].solid, Box)


def _area(triangles: np.ndarray) -> float:
    sides = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * float(np.linalg.norm(np.cross(*sides), axis=1).sum())


def test_no_place_of_a_surface_is_farther_from_a_point_than_is_said() -> None:
    rng = np.random.default_rng(3)
    given = rng.uniform(-20e-3, 20e-3, (12, 3, 3))
    fine = split(given, 1.5e-3)
    assert np.linalg.norm(np.roll(fine, -1, axis=1) - fine, axis=2).max() <= 1.5e-3
    assert _area(fine) == pytest.approx(_area(given))
    points, far = merged(fine, 0.2e-3)
    assert len(points) < 0.7 * len(fine)
    cubes = np.floor((points - fine.min(axis=(0, 1))) / 0.2e-3).astype(int)
    assert len(np.unique(cubes, axis=0)) == len(points)
    share = rng.dirichlet(np.ones(3), len(fine))
    places = np.einsum("nk,nkj->nj", share, fine)[::11]
    away = np.linalg.norm(places[:, None] - points[None], axis=2)
    assert (away - far).min(axis=1).max() <= 1e-12
    assert away.min(axis=1).max() > 0.5 * far.max()  # and it is not said of much more


@pytest.mark.parametrize(
    ("height", "width", "wide", "near", "far"),
    [
        (0.5e-3, 0.6e-3, 0.05, 1.4e-3, 4e-3),
        (0.5e-3, 0.6e-3, 0.3, 1.732e-3, 4e-3),
        (0.5e-3, 0.6e-3, 0.7, 1.849e-3, 4.041e-3),
        (0.05e-3, 0.1e-3, 0.05, 0.525e-3, 4e-3),  # bears 0.056 mm, 0.375 of what 1.4 mm will do for
        (0.05e-3, 0.1e-3, 0.12, 0.597e-3, 4e-3),
    ],
)
def test_balls_on_a_bed_are_no_larger_than_beads_bear(
    height: float, width: float, wide: float, near: float, far: float
) -> None:
    """Right beneath the nozzle of the first layer there is a bead's height, and what the rule for the tip lets it lack."""
    bed = wide * np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    borne = 0.75 * (height + 0.25 * width)
    sides = _sides([bed], [np.ones(2, dtype=bool)], borne)
    assert sides == pytest.approx((near, far), rel=1e-3)
    _, spread = merged(split(np.ascontiguousarray(bed * 0.02 / wide), sides[0]), MERGED * sides[0])
    assert np.hypot(CLEARANCE, spread).max() - CLEARANCE <= borne


def test_points_on_a_bed_of_many_square_metres_stay_countable() -> None:
    bed = 5.0 * np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]]], dtype=float)
    near, _ = _sides([bed], [np.ones(1, dtype=bool)], 0.5e-3)
    assert 0.5 * 5.0**2 / (CORNER_AREA * near**2) == pytest.approx(1e6)


def _straight(length: float, samples: int) -> Bead:
    """A bead along x, 10 mm above z = 0."""
    points = np.column_stack([np.linspace(0.0, length, samples), np.zeros(samples), np.full(samples, 10e-3)])
    up, ahead = np.tile([0.0, 0.0, 1.0], (samples, 1)), np.tile([1.0, 0.0, 0.0], (samples, 1))
    return make_bead("line", 0, points, up, ahead, points, width=30e-3, height=10e-3)


@pytest.mark.parametrize(("length", "samples"), [(8.0, 9), (100.0, 5001)])
def test_a_surface_is_near_a_bead_all_along_however_long_that_is(length: float, samples: int) -> None:
    """Samples are 1 m apart; or 20 mm, of which one in five is taken: places 50 mm from these were not near."""
    tips = _tips(_straight(length, samples))
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() <= 20e-3 + 1e-9
    assert length - tips[-1, 0] <= 20e-3 + 1e-9
    places = np.linspace(0.0, length - 10e-3, 997)
    strip = np.array([[0, 0, 0], [10e-3, 0, 0], [0, 10e-3, 0]]) + places[:, None, None] * np.array([1.0, 0.0, 0.0])
    assert _is_near(strip, cKDTree(tips)).all()


def test_samples_alone_tell_what_is_near_where_they_are_close() -> None:
    bead = _straight(2.5, 2501)  # a millimetre apart: one in two is enough
    np.testing.assert_allclose(_tips(bead), bead.points[::2], rtol=0, atol=1e-12)
