"""Beads that cross on the surface: counted by brute force too, refused where that is asked, and not where they only meet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from solved import solve_alone, write_small

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.plan import Plan
from planner.problem import load_problem
from planner.verify.crossing import CROSSINGS, crossings_of
from planner.verify.interlayer import LaidPlaces

WIDTH, STEP = 0.6e-3, 0.15e-3
SPEED = "  speed_mm_s: 40\n"
FIGURES = {
    "cross": '<path id="a" d="M2,12 L28,12"/><path id="b" d="M15,2 L15,22"/>',
    "tee": '<path id="a" d="M2,12 L28,12"/><path id="b" d="M15,2 L15,12"/>',
    "knot": '<path id="a" d="M2,6 C40,24 -10,24 28,6"/>',
    "ring": '<circle id="a" cx="15" cy="12" r="8"/><path id="b" d="M26,2 L29,22"/>',
}
PLACES = {"cross": 1, "tee": 0, "knot": 1, "ring": 0}


def places_of(*lines: Array, layers: tuple[int, ...] = ()) -> LaidPlaces:
    """Places a quarter of a bead's width apart along polylines (n, 3) [m], one after the other."""
    tips, run = [], []
    for number, line in enumerate(lines):
        s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
        at = np.append(np.arange(0.0, s[-1], STEP), s[-1])
        tips.append(np.column_stack([np.interp(at, s, line[:, k]) for k in range(3)]))
        run.append(np.full(len(at), number))
    tip, which = np.concatenate(tips), np.concatenate(run)
    n = len(tip)
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    layer = np.array(layers or (0,) * len(lines))[which]
    size = np.full(n, WIDTH)
    return LaidPlaces(tip, tip, up, size, size, which, layer, np.arange(n), np.arange(n, dtype=float), which)


def line(*xy: tuple[float, float]) -> Array:
    """A polyline of the plane [mm]."""
    return np.array([[x, y, 0.0] for x, y in xy]) * 1e-3


def count(*lines: Array, layers: tuple[int, ...] = ()) -> int:
    return len(crossings_of(places_of(*lines, layers=layers))[0])


def by_hand(lines: list[Array]) -> int:
    """Crossings of the segments of polylines, all pairs of which are looked at; away from the polylines' ends."""
    found = 0
    pieces = [
        (k, i, a, b) for k, each in enumerate(lines) for i, (a, b) in enumerate(zip(each, each[1:], strict=False))
    ]
    for m, (k, i, a, b) in enumerate(pieces):
        for n, j, c, d in pieces[m + 1 :]:
            if k == n and abs(i - j) < 2:
                continue
            u, v = b - a, d - c
            slant = u[0] * v[1] - u[1] * v[0]
            if slant == 0.0:
                continue
            s = ((c - a)[0] * v[1] - (c - a)[1] * v[0]) / slant
            t = ((c - a)[0] * u[1] - (c - a)[1] * u[0]) / slant
            found += 0.0 < s < 1.0 and 0.0 < t < 1.0
    return found


def test_lines_cross_or_only_meet() -> None:
    across, up = line((0, 5), (10, 5)), line((5, 0), (5, 10))
    assert count(across, up) == 1
    assert count(across, line((5, 0), (5, 5))) == 0  # ends on it
    assert count(across, line((5, 0), (5, 5.2))) == 0  # and a little behind
    assert count(across, line((5, 0), (5, 6))) == 1
    assert count(across, up, layers=(0, 1)) == 0  # one above the other
    assert count(line((0, 0), (10, 0), (10, 5), (5, 5), (5, -5))) == 1  # itself
    assert count(line((0, 0), (10, 0), (10, 5), (0, 5), (0, 0))) == 0  # a closed one
    assert count(line((0, 0), (10, 0), (10, 0.6), (0, 0.6))) == 0  # side by side
    comb = [line((x, 0), (x, 10)) for x in range(1, 10)]
    assert count(across, *comb) == 9


def test_the_place_is_where_the_later_line_crosses() -> None:
    places = places_of(line((0, 5), (10, 5)), line((5, 0), (5, 10)))
    (one,), (other,) = crossings_of(places)
    assert places.bead[one] == 1 and places.bead[other] == 0
    assert np.linalg.norm(places.tip[one] - [5e-3, 5e-3, 0.0]) <= STEP


def test_lines_cross_on_a_ball_and_not_through_a_sheet() -> None:
    angle = np.linspace(-0.5, 0.5, 400)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(400)
    ball = places_of(0.03 * np.column_stack([s, zero, c]), 0.03 * np.column_stack([zero, s, c]))
    assert len(crossings_of(replace(ball, normal=ball.tip / 0.03))[0]) == 1
    sheet = places_of(line((0, 5), (10, 5)), line((5, 0), (5, 10)))
    sides = np.where(sheet.run[:, None] == 0, 1.0, -1.0) * sheet.normal
    assert len(crossings_of(replace(sheet, normal=sides))[0]) == 0


corners = st.lists(st.tuples(st.integers(0, 20), st.integers(0, 20)), min_size=2, max_size=7)


@given(st.lists(corners, min_size=1, max_size=3))
def test_as_many_as_by_hand(drawn: list[list[tuple[int, int]]]) -> None:
    """Corners stand on a grid, moved so that no two lines meet at one and none ends near another one."""
    rng = np.random.default_rng(sum(x + 31 * y for each in drawn for x, y in each))
    lines = [line(*(2.0 * np.array(each) + rng.uniform(0.2, 1.8, (len(each), 2))).tolist()) for each in drawn]
    ends = np.array([end for each in lines for end in (each[0], each[-1])])
    others = [(k, a, b) for k, each in enumerate(lines) for a, b in zip(each, each[1:], strict=False)]
    for number, end in enumerate(ends):
        for k, a, b in others:
            own = k == number // 2 and (np.allclose(a, end) or np.allclose(b, end))
            share = np.clip(((end - a) @ (b - a)) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
            if not own and np.linalg.norm(end - a - share * (b - a)) < WIDTH:
                return  # whether that is a crossing is a matter of the width
    assert count(*lines) == by_hand(lines)


def plan_of(tmp_path: Path, figure: str, asked: str | None) -> Plan:
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="24mm" viewBox="0 0 30 24">{FIGURES[figure]}</svg>'
    change = () if asked is None else ((SPEED, f"{SPEED}  crossings: {asked}\n"),)
    return solve_alone(load_problem(write_small(tmp_path, *change, svg=svg)))


@pytest.mark.slow(keep=("ring",))
@pytest.mark.parametrize("figure", ["cross", "tee", "knot", "ring"])
def test_a_print_that_crosses_is_refused_where_that_is_asked(figure: str, tmp_path: Path) -> None:
    plan = plan_of(tmp_path, figure, "refused")
    (check,) = (each for each in plan.checks if each.name == CROSSINGS)
    assert (check.worst, check.ok) == (PLACES[figure], PLACES[figure] == 0)
    assert plan.metrics["bead_crossings"] == PLACES[figure]
    if PLACES[figure]:
        assert not plan.verified and "over bead 0" in check.where and check.sample >= 0


@pytest.mark.slow
def test_crossings_are_told_or_not_looked_for(tmp_path: Path) -> None:
    told = plan_of(tmp_path / "told", "cross", "told")
    assert told.metrics["bead_crossings"] == 1 and told.verified
    none = plan_of(tmp_path / "none", "cross", None)
    assert "bead_crossings" not in none.metrics and none.verified


def test_another_word_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="crossings") as caught:
        load_problem(write_small(tmp_path, (SPEED, f"{SPEED}  crossings: refuse\n")))
    assert "refused" in str(caught.value)
