"""Rows over faces: nothing left out of reach, nothing crossed, on the true surface."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from formula_faces import FormulaFace, box, circle, polygon
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.toolpath.coverage import measures
from planner.toolpath.coverage.measures import SurfaceLine
from planner.toolpath.coverage.rows import REACH, TooSmallError, cover
from planner.toolpath.coverage.sheet import Rim, Row, Stroke, fields_of, inside, march, rows_at, sheet_of
from planner.toolpath.coverage.stitch import Joint, chosen_joints, evenly, possible_joints, row_chains, smooth

SPACING, SPEED = 0.01, 0.04


def plane(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack([u, v, 0.0 * u], axis=-1)


def face(formula, *loops: np.ndarray) -> FormulaFace:
    return FormulaFace(formula, loops)


PLATE = face(plane, box((0.0, 0.1), (0.0, 0.06), 50, 30))
HOLE = face(plane, box((0.0, 0.1), (0.0, 0.08), 50, 40), circle(0.045, 0.04, 0.015, 48))
ANGLE = face(
    plane,
    polygon(
        np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.04], [0.04, 0.04], [0.04, 0.1], [0.0, 0.1]]), (50, 20, 30, 30, 20, 50)
    ),
)
DISC = face(plane, circle(0.0, 0.0, 0.04, 120))
SADDLE = face(lambda u, v: np.stack([u, v, 4.0 * u * v], axis=-1), box((-0.05, 0.05), (-0.05, 0.05), 50, 50))
BUMP = face(
    lambda u, v: np.stack([u, v, 0.02 * np.exp(-((u - 0.05) ** 2 + (v - 0.04) ** 2) / 4e-4)], axis=-1),
    box((0.0, 0.1), (0.0, 0.08), 60, 50),
)
WAVE = face(
    lambda u, v: np.stack([0.03 * np.sin(u / 0.02), v, 0.3 * u], axis=-1), box((-0.07, 0.07), (0.0, 0.06), 120, 30)
)
TUBE = face(
    lambda u, v: np.stack([0.03 * np.cos(u), 0.03 * np.sin(u), v], axis=-1), box((0.0, 2 * np.pi), (0.0, 0.05), 94, 25)
)
BENT = (  # two plates that meet at an edge, 40 degrees apart
    face(plane, box((0.0, 0.05), (0.0, 0.06), 25, 30)),
    face(
        lambda u, v: np.stack([0.05 + u * np.cos(0.7), v, u * np.sin(0.7)], axis=-1),
        box((0.0, 0.04), (0.0, 0.06), 20, 30),
    ),
)
ALL = {
    "plate": (PLATE,),
    "hole": (HOLE,),
    "angle": (ANGLE,),
    "disc": (DISC,),
    "saddle": (SADDLE,),
    "bump": (BUMP,),
    "wave": (WAVE,),
    "tube": (TUBE,),
    "bent": BENT,
}


def lines(strokes: list[Stroke]) -> list[SurfaceLine]:
    return [SurfaceLine(stroke.points, stroke.normals, stroke.closed) for stroke in strokes]


def looked_at(patch: FormulaFace, count: int = 150) -> np.ndarray:
    """Points (n, 3) all over a face and on its edges."""
    low, high = patch.loops[0].min(axis=0), patch.loops[0].max(axis=0)
    u, v = np.meshgrid(*(np.linspace(low[i], high[i], count) for i in range(2)))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    kept = inside(patch.loops[0], uv)
    for hole in patch.loops[1:]:
        kept &= ~inside(hole, uv)
    return patch.points(np.vstack([uv[kept], *patch.loops]))


def check(patches: tuple[FormulaFace, ...], strokes: list[Stroke]) -> None:
    """All that rows promise."""
    assert not len(measures.crossings(lines(strokes)))
    assert measures.farthest(lines(strokes), np.vstack([looked_at(patch) for patch in patches])) <= REACH * SPACING
    for stroke in strokes:
        for k, patch in enumerate(patches):
            on = stroke.patch == k
            assert np.array_equal(stroke.points[on], patch.points(stroke.parameters[on]))
            assert stroke.normals[on] == pytest.approx(patch.normals(stroke.parameters[on]))
        step = np.linalg.norm(np.diff(stroke.points, axis=0), axis=1)
        assert step.min() > 0.0 and step.max() < 0.2 * SPACING


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_rows_reach_everything_and_cross_nothing(name: str) -> None:
    strokes = cover(ALL[name], SPACING, SPEED)
    check(ALL[name], strokes)
    assert len(strokes) <= (2 if name == "hole" else 1)


@pytest.mark.slow
def test_rows_run_along_a_plate() -> None:
    """Six rows of 100 mm, not ten of 60: fewer turns; each turn as wide as may be."""
    stroke = cover((PLATE,), SPACING, SPEED)[0]
    assert measures.turns(lines([stroke]), SPACING)[0] == 10
    assert measures.length(lines([stroke])) == pytest.approx(0.64, abs=0.01)


def test_rows_go_on_over_a_seam() -> None:
    stroke = cover(BENT, SPACING, SPEED)[0]
    assert set(stroke.patch.tolist()) == {0, 1}
    assert np.count_nonzero(np.diff(stroke.patch)) <= 6


@pytest.mark.slow
def test_rows_are_the_same_each_time() -> None:
    one, other = (cover((PLATE,), SPACING, SPEED)[0] for _ in range(2))
    assert np.array_equal(one.points, other.points)


def test_a_face_too_small_for_a_row_is_refused() -> None:
    with pytest.raises(TooSmallError, match="too small"):
        cover((face(plane, box((0.0, 0.001), (0.0, 0.001), 4, 4)),), SPACING, SPEED)


@pytest.mark.slow
@settings(deadline=None, max_examples=5)
@given(
    st.floats(0.05, 0.1), st.floats(0.04, 0.08), st.floats(-6.0, 6.0), st.floats(0.25, 0.75), st.floats(0.004, 0.012)
)
def test_any_curved_plate_with_a_hole(width: float, depth: float, bend: float, place: float, radius: float) -> None:
    curved = face(
        lambda u, v: np.stack([u, v, bend * u * (u - width) + 0.5 * bend * v * v], axis=-1),
        box((0.0, width), (0.0, depth), int(width / 0.002), int(depth / 0.002)),
        circle(place * width, 0.5 * depth, radius, 40),
    )
    check((curved,), cover((curved,), SPACING, SPEED))


def test_distance_is_that_along_the_surface() -> None:
    """From one edge of a part of a cylinder: to 10 um along it, to a percent across it."""
    radius = 0.03
    rolled = face(
        lambda u, v: np.stack([radius * np.sin(u / radius), v, radius * np.cos(u / radius)], axis=-1),
        box((0.0, 0.09), (0.0, 0.05), 45, 25),
    )
    sheet = sheet_of([rolled], 0.0025)
    u = radius * np.arctan2(sheet.points[:, 0], sheet.points[:, 2])
    start = np.where(np.abs(sheet.points[:, 1]) < 1e-9, 0.0, np.inf)
    assert march(sheet.points, sheet.triangles, start) == pytest.approx(sheet.points[:, 1], abs=1e-5)
    start = np.where(u < 1e-9, 0.0, np.inf)
    assert march(sheet.points, sheet.triangles, start) == pytest.approx(
        np.mod(u, 2 * np.pi * radius), rel=0.01, abs=1e-5
    )


def test_triangles_without_area_spoil_no_distance() -> None:
    """A net may have three points in a line along a straight rim."""
    sheet = sheet_of([PLATE], 0.005)
    a, b = sheet.triangles[:, 0], sheet.triangles[:, 1]
    between = len(sheet.points) + np.arange(len(a))
    flat = replace(
        sheet,
        points=np.vstack([sheet.points, 0.5 * (sheet.points[a] + sheet.points[b])]),
        triangles=np.vstack([sheet.triangles, np.column_stack([a, b, between])]),
        patch=np.tile(sheet.patch, 2),
        corners=np.concatenate([sheet.corners, sheet.corners]),
        material=np.tile(sheet.material, 2),
    )
    rim = Rim.of(sheet)
    with np.errstate(all="raise"):
        fields = fields_of(flat, rim, SPACING)
    assert len(fields) == len(fields_of(sheet, rim, SPACING))


def test_faces_are_sewn_and_holes_are_no_material() -> None:
    sheet = sheet_of([HOLE], 0.0025)
    assert len(Rim.of(sheet).around) == 2
    corners = sheet.points[sheet.triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert area.sum() == pytest.approx(0.008, rel=1e-6)
    assert area[sheet.material].sum() == pytest.approx(0.008 - np.pi * 0.015**2, rel=2e-3)
    assert len(Rim.of(sheet_of(BENT, 0.0025)).around) == 1
    assert sorted(Rim.of(sheet_of([TUBE], 0.0025)).around) == pytest.approx([0.06 * np.pi] * 2, rel=1e-3)


def test_a_row_ends_where_the_material_does() -> None:
    sheet = sheet_of([HOLE], 0.0025)
    rows = rows_at(sheet, Rim.of(sheet), sheet.points[:, 1].copy(), 0.0401, 3.0)
    assert sorted(round(row.length, 3) for row in rows) == [0.03, 0.04]
    assert all(row.ends is not None and row.ends[0][0] != row.ends[1][0] for row in rows)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 1), st.integers(0, 4), st.integers(0, 1)), max_size=9))
def test_as_many_joints_as_can_be(ends: list[tuple[int, int, int, int]]) -> None:
    joints = [Joint((a, i), (b, j), 0, 0.0, 0.001 * (k + 1)) for k, (a, i, b, j) in enumerate(ends) if a != b]

    def allowed(taken: list[Joint]) -> bool:
        used = [end for joint in taken for end in (joint.first, joint.second)]
        if len(used) != len(set(used)):
            return False
        group = list(range(5))
        for joint in taken:
            a, b = group[joint.first[0]], group[joint.second[0]]
            if a == b:
                return False
            group = [a if g == b else g for g in group]
        return True

    subsets = (
        [joint for joint, on in zip(joints, bits, strict=True) if on] for bits in product((0, 1), repeat=len(joints))
    )
    best = max((len(taken), -sum(joint.length for joint in taken)) for taken in subsets if allowed(taken))
    found = chosen_joints(joints, SPACING)
    assert allowed(found)
    assert (len(found), -sum(joint.length for joint in found)) == pytest.approx(best)
    assert sorted(row for chain in row_chains(5, found) for row, _ in chain) == [0, 1, 2, 3, 4]


def test_only_rows_next_to_each_other_are_joined() -> None:
    def row(level: float, left: float, right: float) -> Row:
        return Row(np.zeros((2, 3)), level, ((0, left), (0, right)))

    rows = [row(0.0, 0.09, 0.01), row(1.0, 0.08, 0.02), row(3.0, 0.07, 0.03)]
    found = {frozenset((joint.first, joint.second)) for joint in possible_joints(rows, np.array([0.2]), SPACING)}
    assert found == {frozenset(((0, 1), (1, 1))), frozenset(((0, 0), (1, 0)))}


def test_smoothing_keeps_straight_lines_and_ends() -> None:
    straight = np.array([[0.0, 0.0, 0.0], [0.03, 0.01, 0.02]])
    found = smooth(straight, 0.004, 0.00025, False)
    assert found[[0, -1]] == pytest.approx(straight)
    assert np.abs(np.cross(found, straight[1])).max() < 1e-15
    corner = smooth(np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.02, 0.02, 0.0]]), 0.004, 0.00025, False)
    bend = np.diff(np.unwrap(np.arctan2(*np.diff(corner[:, :2], axis=0).T[::-1])))
    assert bend.sum() == pytest.approx(np.pi / 2) and bend.max() < np.radians(15.0)
    ring = evenly(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0], [0.0, 0.01, 0.0]]), 0.001, True)
    assert len(ring) == 40
