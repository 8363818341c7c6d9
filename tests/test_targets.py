"""Targets beside the path: fewer of them, and every line as near to the path as it was asked to be."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from export_fixtures import make_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.export.fit import (
    OFF,
    Poses,
    SampledWay,
    angle,
    chosen_targets,
    continuous,
    fewest,
    from_matrix,
    misfits,
    slerp,
)
from planner.export.moves import ANGLE_TOLERANCE, plan_moves
from planner.plan import Plan

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

CHORD = 0.02e-3  # m
LONG = 1.0  # m, rad, s: a tolerance that nothing reaches
BY_CHORD = np.array([CHORD, LONG, LONG, LONG, LONG, LONG, LONG])


def way_of(
    tip: Array, quat: Array | None = None, station: Array | None = None, tolerance: Array = BY_CHORD
) -> SampledWay:
    """A path (n, 3) that material is laid along at an even pace, the nozzle upright unless it is said."""
    n = len(tip)
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)) if quat is None else quat
    table = np.column_stack([tip, quat, np.zeros((n, 1)) if station is None else station])
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    return SampledWay(Poses(table), 25.0 * path, path, np.zeros(n), np.ones(n, dtype=bool), tolerance)


def no_joint_moves(first: Indices, last: Indices) -> Array:
    assert not len(first) and not len(last)
    return np.zeros(0)


def chosen(way: SampledWay, kept: list[int], zones: bool = False) -> tuple[Indices, Poses]:
    n = len(way.clock)
    return chosen_targets(way, np.array(kept), np.full(n - 1, True), np.full(n, zones), no_joint_moves, CHORD)


def on_the_path(way: SampledWay, kept: list[int]) -> Indices:
    """The fewest targets that lie on the path itself."""
    return fewest(np.array(kept), lambda a, b: misfits(way, way.poses, a, b).max(axis=1, initial=0.0))


def arc(radius: float, turn: float, step: float = 0.05e-3) -> Array:
    phi = np.linspace(0.0, turn, round(radius * turn / step) + 1)
    return radius * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])


# ---- how few ------------------------------------------------------------------------------------------------------


def test_an_arc_takes_as_few_as_theory_has_it() -> None:
    """Chords whose middles are 0.02 mm inside of it, their ends 0.01 mm outside."""
    tip = arc(0.02, np.pi)
    sample, targets = chosen(way_of(tip), [0, len(tip) - 1])
    least = np.pi / (2.0 * np.arccos((0.02 - CHORD) / (0.02 + OFF * CHORD)))
    assert least < len(sample) - 1 <= 1.03 * least + 1
    far = np.linalg.norm(targets.position, axis=1) - 0.02
    assert far[[0, -1]] == pytest.approx(0.0, abs=1e-12)
    assert np.median(far) == pytest.approx(OFF * CHORD, rel=0.1)
    assert far.max() <= OFF * CHORD * (1.0 + 1e-9) and far.min() >= -1e-9


def test_orientations_and_axes_too() -> None:
    """A straight line along which the nozzle, or the station, turns to and fro: only that asks for targets."""
    s = np.linspace(0.0, 0.2, 2001)
    tip, swing = np.column_stack([s, 0.0 * s, 0.0 * s]), 0.2 * np.sin(s / 0.01)
    quat = np.column_stack([0.0 * s, np.sin(0.5 * swing), 0.0 * s, np.cos(0.5 * swing)])
    tolerance = BY_CHORD.copy()
    tolerance[[1, 2]] = ANGLE_TOLERANCE
    for way in (way_of(tip, quat=quat, tolerance=tolerance), way_of(tip, station=swing, tolerance=tolerance)):
        sample, targets = chosen(way, [0, 2000])
        before = len(on_the_path(way, [0, 2000]))
        assert len(sample) <= before / np.sqrt(1.0 + OFF) * 1.06
        planned = Poses(way.poses.table[sample])
        off = np.maximum(angle(targets.quat, planned.quat), np.abs(targets.station - planned.station).max(axis=1))
        assert 0.8 * OFF * ANGLE_TOLERANCE < off.max() <= OFF * ANGLE_TOLERANCE * (1.0 + 1e-6)


def least_lines(tip: Array, steps: int) -> int:
    """The fewest lines that could do, the target of each sample free across the path: a grid of places is tried."""
    n = len(tip)
    tangent = np.gradient(tip[:, :2], axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.linalg.norm(tangent, axis=1)[:, None]
    shifts = OFF * CHORD * np.linspace(-1.0, 1.0, steps)
    places = tip[:, None, :2] + shifts[:, None] * normal[:, None]
    places[[0, -1]] = tip[[0, -1], None, :2]
    count = np.full((n, steps), np.inf)
    count[0] = 0.0
    for b in range(1, n):
        for a in range(b - 1, -1, -1):
            p, q = places[a][:, None, None], places[b][None, :, None]
            along = q - p
            inner = tip[a + 1 : b, :2]
            u = np.clip(((inner - p) * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)[..., None]
            off = np.linalg.norm(p + u * along - inner, axis=-1).max(axis=-1, initial=0.0)
            fits = off <= CHORD
            if not fits.any() and b - a > 2 and off.min() > 3.0 * CHORD:
                break
            count[b] = np.minimum(count[b], np.where(fits, count[a][:, None] + 1.0, np.inf).min(axis=0))
    return int(count[-1].min())


@pytest.mark.parametrize("shape", ["wave", "spiral"])
def test_nearly_as_few_as_trying_all_places_finds(shape: str) -> None:
    u = np.linspace(0.0, 1.0, 241)
    x, y = {
        "wave": (0.03 * u, 0.004 * np.sin(9.0 * u)),
        "spiral": ((0.004 + 0.006 * u) * np.cos(5.0 * u), (0.004 + 0.006 * u) * np.sin(5.0 * u)),
    }[shape]
    way = way_of(np.column_stack([x, y, 0.0 * u]))
    lines, before = len(chosen(way, [0, 240])[0]) - 1, len(on_the_path(way, [0, 240])) - 1
    least = least_lines(way.poses.position, 5)
    assert least <= lines <= 1.1 * least + 1
    assert lines < before


# ---- how near -----------------------------------------------------------------------------------------------------


def apart(p: Array, line: Array) -> Array:
    """Distance of points p (k, 3) from a polyline (m, 3) [m]."""
    best = np.full(len(p), np.inf)
    for a, b in pairwise(line):
        along = b - a
        u = np.clip((p - a) @ along / max(along @ along, 1e-18), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(a + u[:, None] * along - p, axis=1))
    return best


def dense(line: Array, parts: int = 8) -> Array:
    u = np.linspace(0.0, 1.0, parts, endpoint=False)[:, None]
    return np.vstack([a + u * (b - a) for a, b in pairwise(line)])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bend=st.floats(0.0, 800.0), kept=st.lists(st.integers(1, 298), max_size=3))
def test_both_ways_within_the_tolerance_and_exact_where_they_must_be(seed: int, bend: float, kept: list[int]) -> None:
    """Curves in space, of any bend [1/m] and with bends that change: line and path within the chord of each other."""
    random = np.random.default_rng(seed)
    rates = bend * np.cumsum(random.normal(size=(300, 2)), axis=0) / 10.0 * 0.1e-3
    heading = np.cumsum(rates, axis=0)
    step = np.column_stack([np.cos(heading[:, 0]), np.sin(heading[:, 0]), np.sin(heading[:, 1])])
    tip = np.cumsum(0.1e-3 * step, axis=0)
    way = way_of(tip)
    must = sorted({0, 299, *kept})
    sample, targets = chosen(way, must)
    assert set(must) <= set(sample.tolist())
    np.testing.assert_array_equal(targets.table[np.isin(sample, must)], way.poses.table[must])
    for a, b in pairwise(must):
        line = targets.position[(sample >= a) & (sample <= b)]
        assert apart(tip[a : b + 1], line).max() <= CHORD * (1.0 + 1e-6)
        assert apart(dense(line), tip[a : b + 1]).max() <= CHORD * (1.0 + 1e-6) + 1e-9
        assert len(line) <= len(on_the_path(way, [a, b]))


def test_straight_lines_stay_where_they_are() -> None:
    tip = np.column_stack([np.linspace(0.0, 0.1, 501), np.zeros(501), np.zeros(501)])
    sample, targets = chosen(way_of(tip), [0, 200, 500])
    assert sample.tolist() == [0, 200, 500]
    np.testing.assert_array_equal(targets.table, way_of(tip).poses.table[sample])


@pytest.mark.parametrize("positioner", [True, False])
def test_a_plan_is_left_only_within_its_lines(positioner: bool) -> None:
    plan: Plan = make_plan(positioner=positioner)
    t, moves = plan.trajectory, plan_moves(plan)
    at = np.concatenate([[0], moves.sample])
    off = np.linalg.norm(moves.targets.position - t.tip[at], axis=1)
    turned = angle(moves.targets.quat, continuous(t.quat)[at])
    moved = np.abs(moves.targets.station - t.q[at, 6:]).max(axis=1, initial=0.0)
    chord = plan.problem.program.chord
    assert 0.5 * OFF * chord < off.max() <= OFF * chord
    assert max(turned.max(), moved.max()) <= OFF * ANGLE_TOLERANCE * (1.0 + 1e-6)
    # where the extruder is switched, at rests, and at both ends of joint moves
    exact = np.append(True, moves.on_end | moves.off_end | moves.fine | ~moves.linear)
    exact[:-1] |= moves.on_start | ~moves.linear
    assert exact.sum() > 20 and not exact.all()
    assert off[exact].max() == 0.0 and turned[exact].max() == 0.0 and moved[exact].max(initial=0.0) == 0.0
    # and the joints that are written, or whose quarters are named, hold the nozzle there
    T = plan.cell.T_part_nozzle(moves.q)
    np.testing.assert_allclose(T[:, :3, 3], moves.targets.position, rtol=0, atol=1e-9)
    assert angle(from_matrix(T[:, :3, :3]), moves.targets.quat).max() < 1e-7
    assert 0.0 < np.abs(moves.q - t.q[at]).max() < 1e-3
    # every sample between, against what a controller makes of the lines
    for i in np.flatnonzero(moves.linear):
        a, b = moves.start[i], moves.sample[i]
        p, q = moves.targets.position[i : i + 2]
        inner = np.arange(a, b + 1)
        u = np.clip((t.tip[inner] - p) @ (q - p) / max((q - p) @ (q - p), 1e-18), 0.0, 1.0)
        assert np.linalg.norm(p + u[:, None] * (q - p) - t.tip[inner], axis=1).max() <= chord
        begin, end = np.repeat(moves.targets.quat[i : i + 2, None], len(u), axis=1)
        assert angle(slerp(begin, end, u), continuous(t.quat)[inner]).max() <= ANGLE_TOLERANCE * (1.0 + 1e-6)


def test_zones_at_turns_are_held_against_the_path() -> None:
    """A bend as sharp as its samples: the parabola in the zone passes within the chord of where it was planned."""
    way = way_of(arc(0.15e-3, np.pi, 0.02e-3))
    sample, targets = chosen(way, [0, len(way.clock) - 1], zones=True)
    p = targets.position
    a, b = p[1:-1] - p[:-2], p[2:] - p[1:-1]
    long_a, long_b = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    reach = np.minimum(0.3e-3, 0.5 * np.minimum(long_a, long_b))[:, None]
    middle = p[1:-1] + 0.25 * reach * (b / long_b[:, None] - a / long_a[:, None])
    assert np.linalg.norm(middle - way.poses.position[sample[1:-1]], axis=1).max() <= CHORD
