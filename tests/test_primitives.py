"""Lines and arcs between targets: as few as can be, as near to the path as asked, and none too short in time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solved import bed_plan, small_plan

from planner.base.arrays import Array, Indices
from planner.export.arcs import LinesAndArcs, segments
from planner.export.fit import angle, continuous, from_matrix, lean_and_roll, slerp
from planner.export.moves import (
    AXIS_TOLERANCE,
    FREE_TOLERANCE,
    SHORTER,
    corners,
    fit_of,
    plan_moves,
    run_tolerance,
)
from planner.export.primitives import (
    LEAST_CHORD,
    LEAST_SWEPT,
    MOST_SWEPT,
    OFF,
    TERMS,
    FitRules,
    Fitted,
    SampledWay,
    fit,
    misfits,
)
from planner.export.speeds import STEPS, TIME_TOLERANCE, even_speeds
from planner.plan import Plan

CHORD = 0.02e-3  # m
LONG = 1.0  # m, rad, s: a tolerance that nothing reaches
BY_CHORD = np.array([CHORD, *[LONG] * (len(TERMS) - 1)])
LINES, ARCS = FitRules(False, 0.0, 1.0), FitRules(True, 0.0, 1.0)
SPEED = 0.04  # m/s
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


def way_of(
    tip: Array, quat: Array | None = None, station: Array | None = None, tolerance: Array = BY_CHORD
) -> SampledWay:
    """A path (n, 3) that material is laid along at an even pace, the nozzle upright unless it is said."""
    n = len(tip)
    quat = np.tile(UPRIGHT, (n, 1)) if quat is None else quat
    table = np.column_stack([tip, quat, np.zeros((n, 1)) if station is None else station])
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    both = np.array([tolerance, tolerance])
    return SampledWay(table, table, path / SPEED, path, np.zeros(n), np.ones(n, dtype=bool), both, np.array([LONG]))


def fitted(way: SampledWay, kept: list[int], rules: FitRules = ARCS) -> Fitted:
    return fit(way, np.array(kept[:-1]), np.array(kept[1:]), rules)


def ways_of(way: SampledWay, found: Fitted, first: int = 0) -> tuple[Indices, LinesAndArcs]:
    """All targets, and the lines and arcs between them, by other code than that which chose them."""
    sample = np.concatenate([[first], found.sample])
    p = way.pose[sample, :3]
    return sample, segments(p[:-1], found.via, p[1:], found.circular)


def round_path(radius: float, turn: float, step: float = 0.05e-3) -> Array:
    phi = np.linspace(0.0, turn, round(radius * turn / step) + 1)
    return radius * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])


def curve(seed: int, bend: float, n: int = 300) -> Array:
    """A curve in space of any bend [1/m], and with bends that change; samples 0.1 mm apart."""
    random = np.random.default_rng(seed)
    heading = np.cumsum(bend * np.cumsum(random.normal(size=(n, 2)), axis=0) / 10.0 * 0.1e-3, axis=0)
    step = np.column_stack([np.cos(heading[:, 0]), np.sin(heading[:, 0]), np.sin(heading[:, 1])])
    out: Array = np.cumsum(0.1e-3 * step, axis=0)
    return out


# ---- geometry -----------------------------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    radius=st.floats(0.1e-3, 1.0),
    turn=st.floats(0.02, 6.2),
    middle=st.floats(0.1, 0.9),
    u=st.floats(0.0, 1.0),
)
def test_an_arc_is_the_circle_through_its_points(
    seed: int, radius: float, turn: float, middle: float, u: float
) -> None:
    random = np.random.default_rng(seed)
    R, centre = Rotation.random(random_state=random).as_matrix(), random.normal(size=3)

    def at(share: float) -> Array:
        out: Array = centre + radius * (R[0] * np.cos(share * turn) + R[1] * np.sin(share * turn))
        return out

    one = segments(at(0.0)[None], at(middle)[None], at(1.0)[None], np.array([True]))
    close = 1e-7 * max(radius, 1e-2) / turn
    assert one.length[0] == pytest.approx(radius * turn, rel=1e-5)
    np.testing.assert_allclose(one.at(np.array([u]))[0], at(u), rtol=0, atol=close)
    assert one.fraction(at(u)[None], np.array([0.5]))[0] == pytest.approx(u, abs=1e-5 / turn)
    direction = R[1] * np.cos(turn) - R[0] * np.sin(turn)
    np.testing.assert_allclose(one.tangents(at_end=True)[0], direction, rtol=0, atol=1e-4)


def test_three_points_on_a_line_are_a_line() -> None:
    p = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    for via in (p[1], p[0], p[2]):
        one = segments(p[:1], via[None], p[2:], np.array([True]))
        assert not one.circular[0] and one.length[0] == 2.0


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), lean=st.floats(0.0, 0.02), roll=st.floats(0.0, 0.02))
def test_lean_and_roll_are_told_apart(seed: int, lean: float, roll: float) -> None:
    random = np.random.default_rng(seed)
    start, towards = Rotation.random(random_state=random), random.uniform(0.0, 2.0 * np.pi)
    leans = Rotation.from_rotvec([lean * np.cos(towards), lean * np.sin(towards), 0.0])
    end = start * leans * Rotation.from_rotvec([0.0, 0.0, roll])
    found = lean_and_roll(start.as_quat()[None], end.as_quat()[None])
    assert found[0][0] == pytest.approx(lean, abs=1e-6 + 1e-3 * lean)
    assert found[1][0] == pytest.approx(roll, abs=1e-6 + 1e-3 * roll)


# ---- how few ------------------------------------------------------------------------------------------------------


def test_lines_on_an_arc_are_as_few_as_theory_has_it() -> None:
    tip = round_path(0.02, np.pi)
    found = fitted(way_of(tip), [0, len(tip) - 1], LINES)
    least = np.pi / (2.0 * np.arccos(1.0 - CHORD / 0.02))
    assert least < len(found.sample) <= 1.01 * least + 1
    assert not found.circular.any()


@pytest.mark.parametrize(("turn", "count"), [(0.1, 1), (2.0, 1), (np.pi, 2), (6.2, 3)])
def test_an_arc_is_one_arc_up_to_half_a_circle(turn: float, count: int) -> None:
    tip = round_path(0.02, turn)
    found = fitted(way_of(tip), [0, len(tip) - 1])
    assert len(found.sample) == count and found.circular.all()
    np.testing.assert_allclose(np.linalg.norm(found.via, axis=1), 0.02, rtol=0, atol=1e-7)


def least_lines(way: SampledWay) -> int:
    """The fewest lines with ends on the path: all pairs of samples are tried."""
    n = len(way.clock)
    count = np.full(n, np.inf)
    count[0] = 0.0
    for b in range(1, n):
        for a in range(b):
            p, q, inner = way.pose[a, :3], way.pose[b, :3], way.pose[a : b + 1, :3]
            u = np.clip((inner - p) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
            if np.linalg.norm(p + u[:, None] * (q - p) - inner, axis=1).max() <= CHORD:
                count[b] = min(count[b], count[a] + 1.0)
    return int(count[-1])


@pytest.mark.slow(keep=("0",))
@pytest.mark.parametrize("seed", range(6))
def test_lines_are_as_few_as_all_pairs_of_samples_give(seed: int) -> None:
    way = way_of(curve(seed, 400.0, 160))
    assert len(fitted(way, [0, 159], LINES).sample) == least_lines(way)


def test_arcs_are_fewer_where_the_path_bends() -> None:
    u = np.linspace(0.0, 1.0, 1001)
    way = way_of(np.column_stack([0.1 * u, 0.01 * np.sin(20.0 * u), 0.0 * u]))
    lines, arcs = (len(fitted(way, [0, 1000], rules).sample) for rules in (LINES, ARCS))
    assert arcs <= 0.5 * lines


def test_turning_targets_outwards_saves_a_fifth_where_orientations_count() -> None:
    """A straight line along which the nozzle leans to and fro: only that asks for targets."""
    s = np.linspace(0.0, 0.2, 2001)
    tip, swing = np.column_stack([s, 0.0 * s, 0.0 * s]), 0.2 * np.sin(s / 0.01)
    quat = np.column_stack([0.0 * s, np.sin(0.5 * swing), 0.0 * s, np.cos(0.5 * swing)])
    tolerance = BY_CHORD.copy()
    tolerance[1] = AXIS_TOLERANCE
    way = way_of(tip, quat=quat, tolerance=tolerance)
    found = fitted(way, [0, 2000])
    # chords of the angle's curve, whose ends may lie beside it: as many as half as large a tolerance again needs
    bend = 0.2 * np.abs(np.sin(s / 0.01)) / 0.01**2
    on_it = float(np.sum(np.sqrt(bend / (8.0 * AXIS_TOLERANCE))) * s[1])
    assert len(found.sample) <= on_it / np.sqrt(1.0 + OFF) * 1.1
    off = angle(found.aim[found.sample, 3:7], quat[found.sample])
    assert 0.8 * OFF * AXIS_TOLERANCE < off.max() <= OFF * AXIS_TOLERANCE * (1.0 + 1e-6)


# ---- how near -----------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    bend=st.floats(0.0, 800.0),
    kept=st.lists(st.integers(1, 298), max_size=3),
    arcs=st.booleans(),
)
def test_path_and_primitives_are_within_the_tolerance(seed: int, bend: float, kept: list[int], arcs: bool) -> None:
    way = way_of(curve(seed, bend))
    must = sorted({0, 299, *kept})
    found = fitted(way, must, FitRules(arcs, 0.0, 1.0))
    sample, ways = ways_of(way, found)
    assert set(must) <= set(sample.tolist())
    assert arcs or not found.circular.any()
    for i, (a, b) in enumerate(pairwise(sample)):
        own, inner = ways.take(np.full(b - a + 1, i)), way.pose[a : b + 1, :3]
        u = own.fraction(inner, np.linspace(0.0, 1.0, b - a + 1))
        assert np.linalg.norm(own.at(u) - inner, axis=1).max() <= CHORD * (1.0 + 1e-6)
        if found.circular[i]:
            assert LEAST_SWEPT - 1e-6 <= ways.swept[i] <= MOST_SWEPT + 1e-6
            assert np.linalg.norm(inner[-1] - inner[0]) >= LEAST_CHORD
    used = misfits(way, sample[:-1], sample[1:], found.circular, found.via)
    assert used.max() <= 1.0 + 1e-6


# ---- the least time -----------------------------------------------------------------------------------------------


def small_circle(radius: float) -> SampledWay:
    """A letter's hole: samples of 4 ms, the nozzle's axis turning with the place as on a cylinder of 34 mm."""
    n = round(2.0 * np.pi * radius / (SPEED * 4e-3))
    phi = np.linspace(0.0, 2.0 * np.pi, n + 1)
    tip = radius * np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])
    lean = Rotation.from_rotvec(np.column_stack([0.0 * phi, tip[:, 0] / 0.034, 0.0 * phi]))
    tolerance = np.array([0.05e-3, AXIS_TOLERANCE, FREE_TOLERANCE, LONG, TIME_TOLERANCE, LONG, LONG, LONG])
    return way_of(tip, quat=lean.as_quat(), tolerance=tolerance)


@pytest.mark.parametrize("radius", [1.4e-3, 1.6e-3, 2.5e-3, 5.0e-3])
def test_tolerances_grow_for_the_least_time(radius: float) -> None:
    way, least = small_circle(radius), 25e-3
    n = len(way.clock) - 1
    close, wide = (fitted(way, [0, n], FitRules(True, least, widest)) for widest in (1.0, 2.0))
    for found, widest in ((close, 1.0), (wide, 2.0)):
        sample, _ = ways_of(way, found)
        used = misfits(way._replace(aim=found.aim), sample[:-1], sample[1:], found.circular, found.via)
        assert used.max() <= widest + 1e-6
    took = np.diff(way.clock[np.concatenate([[0], wide.sample])])
    assert took.min() >= least - 1e-9
    assert len(wide.sample) <= len(close.sample)


def test_what_no_tolerance_lets_be_longer_stays_short() -> None:
    """A corner of two straight lines between targets that must be there, 3 mm and 0.4 mm long."""
    leg = np.column_stack([np.arange(0.0, 3e-3, 0.16e-3), *[np.zeros(19)] * 2])
    corner = leg[-1] + np.column_stack([np.zeros(4), np.arange(1, 5) * 0.1e-3, np.zeros(4)])
    way = way_of(np.vstack([leg, corner]))
    found = fitted(way, [0, 18, 22], FitRules(True, 25e-3, 2.0))
    assert found.sample.tolist() == [18, 22]


# ---- speeds -------------------------------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(
    moves=st.lists(st.tuples(st.floats(8e-3, 0.5), st.floats(1e-3, 0.2)), min_size=1, max_size=60),
    cut=st.integers(0, 59),
    least=st.sampled_from([0.0, 25e-3, 0.1]),
)
def test_targets_are_passed_on_time_with_few_speeds(moves: list[tuple[float, float]], cut: int, least: float) -> None:
    took, real = np.array(moves).T
    group = np.where(np.arange(len(took)) < cut, 1, 2)
    speed = even_speeds(real * took, took, group, np.full(len(took), SPEED), least)
    late = np.cumsum(real * took / speed - took)
    if 0 < cut < len(took):
        late[cut:] -= late[cut - 1]
    # a speed is a multiple of a step: what that changes in the time of one move comes on top
    step = np.select([speed >= STEPS[0][0], speed >= STEPS[1][0]], [STEPS[0][1], STEPS[1][1]], STEPS[2][1])
    assert (np.abs(late) <= TIME_TOLERANCE + (took + TIME_TOLERANCE) * step / speed).all()
    assert np.abs(speed / step - np.round(speed / step)).max() < 1e-6
    steady = even_speeds(
        np.full(50, SPEED * 0.05), np.full(50, 0.05), np.ones(50, dtype=np.intp), np.full(50, SPEED), least
    )
    assert (steady == (SPEED if least < 0.05 else steady)).all()


@pytest.mark.parametrize("took", [5e-3, 17.5e-3, 45e-3])
def test_a_brief_bead_is_as_quick_as_planned_whatever_the_least_time(took: float) -> None:
    one, parts = np.array([took]), np.array([0.4, 0.6]) * took
    assert even_speeds(SPEED * one, one, np.array([1]), np.full(1, SPEED), 0.1) == pytest.approx(SPEED, rel=0.01)
    assert even_speeds(SPEED * parts, parts, np.array([1, 1]), np.full(2, SPEED), 0.1) == pytest.approx(SPEED, rel=0.01)


# ---- a plan -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("chord", "most"), [(1e-3, 0.3e-3), (0.05e-3, 0.3e-3), (0.0125e-3, 0.075e-3)])
def test_runs_are_followed_as_finely_as_their_beads(chord: float, most: float) -> None:
    assert run_tolerance(chord) == pytest.approx(most)


@pytest.mark.parametrize("plan_of", [small_plan, bed_plan])
@pytest.mark.parametrize("arcs", [True, False])
def test_a_plan_is_left_only_within_its_tolerances(plan_of: Callable[[], Plan], arcs: bool) -> None:
    plan = plan_of()
    spec, t, moves = plan.problem.program, plan.trajectory, plan_moves(plan, arcs=arcs)
    at = np.concatenate([[0], moves.sample])
    assert moves.circular.any() == arcs
    np.testing.assert_array_equal(moves.targets.position, t.tip[at])
    turned = angle(moves.targets.quat, continuous(t.quat)[at])
    assert turned.max() <= OFF * AXIS_TOLERANCE * (1.0 + 1e-6)
    assert (turned.max() > 0.0) == arcs  # lines are short enough for the chord
    # exact where the extruder is switched, at rests, and at both ends of joint moves
    exact = np.append(True, moves.on_end | moves.off_end | moves.fine | ~moves.linear)
    exact[:-1] |= moves.on_start | ~moves.linear
    assert exact.sum() > 15 and not exact.all()
    assert turned[exact].max() == 0.0
    # and the joints that are written, or whose quarters are named, hold the nozzle there
    T = plan.cell.T_part_nozzle(moves.q)
    np.testing.assert_allclose(T[:, :3, 3], moves.targets.position, rtol=0, atol=1e-9)
    assert angle(from_matrix(T[:, :3, :3]), moves.targets.quat).max() < 1e-7
    # every sample between, against what a controller makes of lines and arcs
    ways, grown = moves.segments, spec.widening * (1.0 + 1e-6)
    for i in np.flatnonzero(moves.laid):
        inner = np.arange(moves.start[i], moves.sample[i] + 1)
        own = ways.take(np.full(len(inner), i))
        u = own.fraction(t.tip[inner], np.linspace(0.0, 1.0, len(inner)))
        assert np.linalg.norm(own.at(u) - t.tip[inner], axis=1).max() <= spec.chord * grown
        begin, end = np.repeat(moves.targets.quat[i : i + 2, None], len(u), axis=1)
        lean, roll = lean_and_roll(slerp(begin, end, u), continuous(t.quat)[inner])
        assert lean.max() <= AXIS_TOLERANCE * grown and roll.max() <= FREE_TOLERANCE * grown
    found = fit_of(plan, moves)
    took = moves.length / moves.speed
    assert set(found.short) == set(np.flatnonzero(moves.laid & (took < spec.least_time - SHORTER)))
    planned = t.t[moves.sample] - t.t[moves.start]
    assert (took[moves.laid] >= np.minimum(planned[moves.laid], spec.least_time) - SHORTER).all()
    assert found.off <= spec.chord * grown and found.turned <= AXIS_TOLERANCE * grown


def test_smooth_joints_of_lines_and_arcs_turn_little() -> None:
    """A controller flies from one to the next without slowing down: 2 degrees run clean on a real robot."""
    tip = np.vstack([round_path(0.02, 1.5), round_path(0.02, 1.5)[-1] + np.arange(1, 200)[:, None] * 0.05e-3 * np.array(
        [-np.sin(1.5), np.cos(1.5), 0.0])])  # fmt: skip
    way = way_of(tip)
    _, ways = ways_of(way, fitted(way, [0, len(tip) - 1]))
    assert np.degrees(corners(ways)[1]).max() < 5.0
