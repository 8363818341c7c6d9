"""Orders in which to visit the samples of a face, and what measures them, against brute force."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
from formula_faces import CURVED_PLATE, FormulaFace, box, sampled
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.toolpath.coverage import measures
from planner.toolpath.coverage.measures import SurfaceLine
from planner.toolpath.coverage.tours import (
    MOST_SAMPLES,
    ORDERS,
    SampledSurface,
    TooManySamplesError,
    VisitRule,
    along_surface,
    greedy,
    tour,
    weighted_greedy,
    without_jumps,
)

SPACING = 0.01


def flat(uv: np.ndarray, rows: np.ndarray | None = None) -> SampledSurface:
    """Samples of a plane."""
    n = len(uv)
    return SampledSurface(
        np.column_stack([uv, np.zeros(n)]),
        np.tile([0.0, 0.0, 1.0], (n, 1)),
        uv,
        np.zeros(n, dtype=np.int64),
        np.zeros(n, dtype=np.int64) if rows is None else rows,
        (SPACING, SPACING),
    )


def grid(across: int, along: int) -> SampledSurface:
    u, v = np.meshgrid(np.arange(across), np.arange(along), indexing="ij")
    return flat(SPACING * np.stack([u.ravel(), v.ravel()], axis=1).astype(float), u.ravel())


def line(*xy: tuple[float, float], closed: bool = False) -> SurfaceLine:
    points = np.array([[x, y, 0.0] for x, y in xy])
    return SurfaceLine(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), closed)


def crosses(*lines: SurfaceLine) -> bool:
    return len(measures.crossings(lines)) > 0


clouds = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40)), min_size=2, max_size=14, unique=True).map(
    lambda places: flat(0.002 * np.array(places, dtype=float))
)


@settings(deadline=None, max_examples=25)
@given(clouds)
def test_every_order_visits_each_sample_once(surface: SampledSurface) -> None:
    for order in (greedy, weighted_greedy):
        assert measures.visits_each_once(order(surface), len(surface.points))


def test_greedy_goes_to_the_nearest_sample() -> None:
    surface = flat(np.array([[0.0, 0.0], [0.03, 0.0], [0.009, 0.0], [0.0, 0.008], [0.0, 0.02]]))
    assert greedy(surface).tolist() == [0, 3, 4, 2, 1] or greedy(surface).tolist() == [0, 3, 2, 4, 1]
    assert greedy(surface)[1] == 3


def test_weights_keep_to_the_row() -> None:
    """Where the next row is nearer than the next sample of this one, only the weighted choice stays."""
    uv = np.array([[u, v] for u in (0.0, 0.007) for v in (0.0, 0.01, 0.02)])
    surface = flat(uv, np.repeat([0, 1], 3))
    assert greedy(surface)[1] == 3
    assert weighted_greedy(surface).tolist() == [0, 1, 2, 5, 4, 3]


def test_weighted_greedy_runs_from_side_to_side() -> None:
    surface = grid(4, 6)
    order = weighted_greedy(surface)
    assert np.array_equal(surface.row[order], np.repeat(np.arange(4), 6))
    found = [measures.laid(surface, order)]
    assert not crosses(*found)
    count, total = measures.turns(found, SPACING)
    assert (count, total) == (6, pytest.approx(6 * np.pi / 2))


def test_rows_of_other_lengths_leave_nothing_behind() -> None:
    """Where the next row is longer or shorter, its last sample comes first, though its last but one may be nearer."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        lengths = 8 + np.cumsum(rng.integers(-1, 2, 12))
        uv = np.concatenate([[[u, v] for v in range(n)] for u, n in enumerate(lengths)]) * SPACING
        surface = flat(uv, np.repeat(np.arange(12), lengths))
        order = weighted_greedy(surface)
        assert measures.visits_each_once(order, len(uv))
        assert len(without_jumps(surface, order)) == 1
        assert not crosses(measures.laid(surface, order))


def test_a_path_starts_where_it_is_told_and_leaves_a_row_for_its_weight() -> None:
    surface = grid(4, 6)
    last = len(surface.points) - 1
    assert weighted_greedy(surface, VisitRule(start=last))[0] == last
    uv = np.array([[u, v] for u in (0.0, 0.007) for v in (0.0, 0.01, 0.02)])
    assert weighted_greedy(flat(uv, np.repeat([0, 1], 3)), VisitRule(weight=0.0))[1] == 3


def test_a_path_is_cut_where_the_next_sample_is_no_neighbour() -> None:
    surface = flat(SPACING * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 0.0], [10.0, 0.0]]))
    pieces = without_jumps(surface, np.arange(5))
    assert [piece.tolist() for piece in pieces] == [[0, 1, 2], [3, 4]]


@pytest.mark.slow
@settings(deadline=None, max_examples=12)
@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=2, max_size=7, unique=True))
def test_a_tour_of_few_samples_is_the_shortest(places: list[tuple[int, int]]) -> None:
    surface = flat(0.002 * np.array(places, dtype=float))
    n = len(places)
    distance = along_surface(surface, surface.links(), np.arange(n))
    every = np.array(list(permutations(range(n))))
    shortest = distance[every[:, :-1], every[:, 1:]].sum(axis=1).min()
    order = tour(surface)
    assert measures.visits_each_once(order, n)
    assert distance[order[:-1], order[1:]].sum() <= shortest * (1.0 + 1e-6) + 1e-6 * n * SPACING


@pytest.mark.slow
def test_a_tour_does_not_cross_and_is_the_same_each_time() -> None:
    surface = flat(np.random.default_rng(3).uniform(0.0, 0.06, (60, 2)))
    order = tour(surface)
    assert np.array_equal(order, tour(surface))
    assert not crosses(measures.laid(surface, order))
    by_hand = measures.length([measures.laid(surface, greedy(surface))])
    assert measures.length([measures.laid(surface, order)]) < 0.95 * by_hand


def test_a_tour_over_too_many_samples_is_refused() -> None:
    with pytest.raises(TooManySamplesError, match=str(MOST_SAMPLES)):
        tour(flat(np.zeros((MOST_SAMPLES + 1, 2))))


def test_distance_runs_along_the_sheet_not_through_the_air() -> None:
    """Two leaves of a folded sheet 4 mm apart: over the fold it is farther."""
    s = np.arange(0.0, 0.1001, 0.004)
    bottom = np.column_stack([s, 0 * s, 0 * s])
    points = np.vstack([bottom, bottom[::-1] + [0.0, 0.0, 0.004]])
    normals = np.vstack([np.tile([0.0, 0.0, -1.0], (len(s), 1)), np.tile([0.0, 0.0, 1.0], (len(s), 1))])
    normals[len(s) - 1] = normals[len(s)] = [1.0, 0.0, 0.0]
    n = len(points)
    names = np.zeros(n, dtype=np.int64)
    surface = SampledSurface(points, normals, points[:, :2], names, names, (0.004, 0.004))
    way = along_surface(surface, surface.links(), np.array([0]))[0]
    assert way[-1] > 0.15


def _exactly_crosses(path: list[tuple[int, int]]) -> bool:
    """Whether a polyline of whole numbers crosses, touches or runs back over itself."""

    def side(p: tuple[int, int], q: tuple[int, int], r: tuple[int, int]) -> int:
        return int(np.sign((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])))

    def on(p: tuple[int, int], q: tuple[int, int], r: tuple[int, int]) -> bool:
        within = all(min(p[i], q[i]) <= r[i] <= max(p[i], q[i]) for i in range(2))
        return side(p, q, r) == 0 and within

    pieces = list(zip(path[:-1], path[1:], strict=True))
    for i, j in combinations(range(len(pieces)), 2):
        (a, b), (c, d) = pieces[i], pieces[j]
        if j == i + 1:
            if on(a, b, d) or on(c, d, a):
                return True
            continue
        if side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0:
            return True
        if on(a, b, c) or on(a, b, d) or on(c, d, a) or on(c, d, b):
            return True
    return False


@settings(deadline=None, max_examples=200)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=3, max_size=7, unique=True))
def test_crossings_are_those_of_brute_force(path: list[tuple[int, int]]) -> None:
    assert crosses(line(*(0.01 * np.array(path)).tolist())) == _exactly_crosses(path)


def test_lines_cross_each_other_and_closed_ones_themselves() -> None:
    one, other = line((0.0, 0.0), (0.02, 0.0)), line((0.01, -0.01), (0.01, 0.01))
    assert crosses(one, other)
    assert not crosses(one, line((0.0, 0.001), (0.02, 0.001)))
    square = [(0.0, 0.0), (0.01, 0.0), (0.01, 0.01), (0.0, 0.01)]
    assert not crosses(line(*square, closed=True))
    bow = [(0.0, 0.0), (0.01, 0.01), (0.02, 0.0), (0.01, 0.0), (0.005, 0.01)]
    assert not crosses(line(*bow[:4])) and crosses(line(*bow, closed=True))


def _rolled(radius: float) -> FormulaFace:
    """Part of a cylinder with u and v in metres: straight in (u, v) is straight on it."""
    return FormulaFace(
        lambda u, v: np.stack([radius * np.sin(u / radius), v, radius * np.cos(u / radius)], axis=-1),
        (box((-0.1, 0.1), (0.0, 0.06), 100, 30),),
    )


@pytest.mark.slow
@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000))
def test_crossings_are_found_on_the_face_not_in_projection(seed: int) -> None:
    """Walks over a roll that goes nearly all the way round (seen from any side it covers itself): as in its plane."""
    face = _rolled(0.035)
    surface = sampled(face, 0.006)
    rng = np.random.default_rng(seed)
    links = surface.links()
    walk = [int(rng.integers(len(surface.points)))]
    for _ in range(9):
        near = links.indices[links.indptr[walk[-1]] : links.indptr[walk[-1] + 1]]
        near = near[~np.isin(near, walk)]
        if not len(near):
            break
        walk.append(int(rng.choice(near)))
    order = np.array(walk)
    unrolled = np.rint(surface.parameters[order] / 1e-9).astype(int).tolist()
    wanted = _exactly_crosses([(u, v) for u, v in unrolled])
    margin = _clearance(surface.parameters[order])
    if wanted or margin > 2e-4:  # a hair from touching, rounding decides
        assert crosses(measures.laid(surface, order)) == wanted or margin < 2e-4


def _clearance(path: np.ndarray) -> float:
    """How near pieces of a plane polyline that do not follow each other come with their ends [m]."""
    nearest = np.inf
    for i, j in combinations(range(len(path) - 1), 2):
        if j == i + 1:
            continue
        for r, (p, q) in (
            (path[j], path[i : i + 2]),
            (path[j + 1], path[i : i + 2]),
            (path[i], path[j : j + 2]),
            (path[i + 1], path[j : j + 2]),
        ):
            t = np.clip((r - p) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
            nearest = min(nearest, float(np.linalg.norm(r - p - t * (q - p))))
    return nearest


def test_sheets_above_each_other_do_not_meet() -> None:
    up, down = np.tile([0.0, 0.0, 1.0], (2, 1)), np.tile([0.0, 0.0, -1.0], (2, 1))
    one = SurfaceLine(np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]), up)
    under = np.array([[0.01, -0.01, -0.002], [0.01, 0.01, -0.002]])
    assert not crosses(one, SurfaceLine(under, down))
    assert crosses(one, SurfaceLine(under, up))


def test_the_paths_of_the_paper_on_the_curved_plate() -> None:
    """Greedy choice crosses itself, the weighted choice does not."""
    surface = sampled(CURVED_PLATE, 0.01)
    found = {name: measures.laid(surface, ORDERS[name](surface)) for name in ("greedy", "weighted_greedy")}
    assert crosses(found["greedy"])
    assert not crosses(found["weighted_greedy"])


def test_chords_are_laid_onto_the_face() -> None:
    face = _rolled(0.05)
    surface = sampled(face, 0.008)
    laid = measures.laid(surface, weighted_greedy(surface))
    assert np.abs(np.hypot(laid.points[:, 0], laid.points[:, 2]) - 0.05).max() < 2e-4
    outward = laid.points * [1.0, 0.0, 1.0] / 0.05
    assert np.abs(np.einsum("ij,ij->i", laid.normals, outward)).min() > 0.995


def test_length_and_time() -> None:
    straight = line((0.0, 0.0), (0.04, 0.0), (0.08, 0.0))
    corner = line((0.0, 0.0), (0.04, 0.0), (0.04, 0.04))
    assert measures.length([straight]) == pytest.approx(0.08)
    assert measures.length([line((0.0, 0.0), (0.01, 0.0), (0.01, 0.01), (0.0, 0.01), closed=True)]) == pytest.approx(
        0.04
    )
    assert measures.seconds([straight], 0.04, 1e-4) == pytest.approx(2.0)
    tight, wide = (measures.seconds([corner], 0.04, tolerance) for tolerance in (1e-5, 1e-3))
    assert tight > wide == pytest.approx(2.0)
    assert measures.seconds([straight, corner], 0.04, 1e-3) > 5.0
    assert measures.turns([corner], SPACING) == (1, pytest.approx(np.pi / 2))
    assert measures.turns([straight], SPACING) == (0, 0.0)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000))
def test_distance_from_a_line_is_that_from_its_points_laid_densely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.uniform(0.0005, 0.001, (40, 3)), axis=0)  # of short steps, as strokes are
    dense = np.concatenate([np.linspace(a, b, 200) for a, b in zip(path[:-1], path[1:], strict=True)])
    points = rng.uniform(0.0, 0.04, (20, 3))
    wanted = np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1)
    assert measures.distances([path], points) == pytest.approx(wanted, abs=2e-5)
    assert measures.farthest([SurfaceLine(path, path)], points) == pytest.approx(wanted.max(), abs=2e-5)
