"""Interlayer time: what lies on what, the order and the waits that keep its age within a window, and the checks of it."""

from __future__ import annotations

import itertools
import json
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from solved import solve_alone, write_small

import planner.motion.interlayer
import planner.planning.pipeline
from planner.base.arrays import Array, Ints
from planner.base.errors import InputError
from planner.export.plan_json import plan_json
from planner.motion.interlayer import Lags, _longest, lags_of
from planner.plan import Plan, Trajectory
from planner.plan.by_layer import AGES, layer_times
from planner.planning.candidates import _too_slow_for_its_window
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.report.channels import channels
from planner.report.charts import time_charts
from planner.report.html import write_report
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.contacts import BeadContacts, contacts
from planner.toolpath.interlayer import ArrangedSurface, _improved, _OneLayer, with_interlayer_order
from planner.verify.verdict import verify

MM = 1e-3
THREE = ("  count: 1", "  count: 3")
SPEED = "  speed_mm_s: 40\n"
WINDOW = "  interlayer_time: {least_s: 6, most_s: 8}\n"


def problem_of(process: str, *changes: tuple[str, str]) -> Problem:
    with tempfile.TemporaryDirectory() as folder:
        return load_problem(write_small(Path(folder), THREE, (SPEED, SPEED + process), *changes))


def toolpath_of(process: str, *changes: tuple[str, str]) -> Toolpath:
    with tempfile.TemporaryDirectory() as folder:
        return build_toolpath(load_problem(write_small(Path(folder), THREE, (SPEED, SPEED + process), *changes)))


@cache
def plan_with(process: str) -> Plan:
    """The small print in three layers, of all its materials in turn, solved once for each process."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        problem = load_problem(write_small(Path(folder), THREE, (SPEED, SPEED + process)))
        if problem.process.materials:
            patch.setattr(planner.planning.pipeline, "build_toolpath", in_turn)
        return solve_alone(problem)


def in_turn(problem: Problem) -> Toolpath:
    toolpath, names = build_toolpath(problem), list(problem.process.materials)
    beads = (replace(bead, material=names[bead.layer % len(names)]) for bead in toolpath.beads)
    return replace(toolpath, beads=tuple(beads))


def failed(plan: Plan) -> set[str]:
    checks = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory).checks
    return {check.name for check in checks if not check.ok}


def line(layer: int, start: tuple[float, float], end: tuple[float, float], name: str = "line", n: int = 61) -> Bead:
    """A level bead 0.6 wide and 0.5 high between places [mm] of its layer."""
    points = np.column_stack([np.linspace(start, end, n), np.full(n, 0.5 * (layer + 1))]) * MM
    s = np.linalg.norm(points - points[0], axis=1)
    up, along = np.tile([0.0, 0.0, 1.0], (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    sizes = np.full(n, 0.6 * MM), np.full(n, 0.5 * MM)
    return Bead(name, layer, s, points, up, along, points, *sizes, closed=False)


# --- the problem file --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("window", "field", "reason", "hint"),
    [
        ("{}", "process.interlayer_time", "give least_s, most_s or both", "least_s: 20"),
        ("{least_s: 9, most_s: 8}", "process.interlayer_time", "least_s is 9, more than most_s 8", "a window"),
        ("{least_s: -1}", "process.interlayer_time.least_s", "-1", "0.1 to 86400"),
        ("{most_s: soon}", "process.interlayer_time.most_s", "soon", "a number"),
        ("{least: 9}", "process.interlayer_time.least", "unknown key", "least_s"),
        ("20", "process.interlayer_time", "must be a section", "least_s, most_s"),
    ],
)
def test_what_cannot_be_asked(window: str, field: str, reason: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        problem_of(f"  interlayer_time: {window}\n")
    error = caught.value
    assert error.field is not None and error.field.startswith(field)
    assert reason in error.reason
    assert hint in f"{error.reason} {error.hint}"


def test_struts_lie_on_no_layer() -> None:
    problem = problem_of(WINDOW)
    toolpath = toolpath_of("")
    struts = replace(toolpath, beads=tuple(replace(bead, round=True) for bead in toolpath.beads))
    with pytest.raises(InputError, match="struts in space lie on no layer"):
        with_interlayer_order(problem, struts)


def test_a_window_that_no_order_holds_is_refused_with_the_least_that_may_be() -> None:
    toolpath = toolpath_of("")
    time = sum(bead.length for bead in toolpath.beads if bead.layer == 0) / 0.04
    with pytest.raises(InputError) as caught:
        toolpath_of("  interlayer_time: {most_s: 2}\n")
    error = caught.value
    assert error.field == "process.interlayer_time.most_s"
    least = float(str(error.hint).split()[2].rstrip(","))
    assert (
        0.97 * time < least <= 1.01 * time + 0.1
    )  # the same in each layer: as long as the beads take, whatever the order
    assert any(bead.layer == 2 for bead in toolpath_of(f"  interlayer_time: {{most_s: {1.02 * time}}}\n").beads)


# --- what lies on what -------------------------------------------------------------------------------------


def test_lines_lie_on_those_beneath_them_and_bridges_on_nothing() -> None:
    beads = [
        line(0, (0, 0), (30, 0)),
        line(0, (0, 6), (30, 6)),
        line(1, (30, 0), (0, 0)),  # the other way
        line(1, (10, -5), (10, 12)),  # across both
        line(1, (0, 6.3), (30, 6.3)),  # half a width beside
        line(1, (0, 9), (30, 9)),  # on nothing
    ]
    found = contacts(beads)
    assert set(map(tuple, found.pairs.tolist())) == {(2, 0), (3, 0), (3, 1), (4, 1)}
    own = (found.upper == 2) & (found.lower == 0)
    assert found.at[own] + found.below[own] == pytest.approx(np.full(own.sum(), 30 * MM), abs=0.16 * MM)
    across = found.at[(found.upper == 3) & (found.lower == 1)]
    assert across.min() == pytest.approx((11 - 0.48) * MM, abs=0.16 * MM)
    assert across.max() == pytest.approx((11 + 0.48) * MM, abs=0.16 * MM)


def test_a_place_between_two_lines_lies_on_both() -> None:
    beads = [line(0, (0, 0), (20, 0)), line(0, (0, 0.6), (20, 0.6)), line(1, (0, 0.3), (20, 0.3))]
    assert set(map(tuple, contacts(beads).pairs.tolist())) == {(2, 0), (2, 1)}


def test_the_start_of_a_closed_bead_does_not_lie_on_the_end_of_the_one_below() -> None:
    beads = toolpath_of("  interlayer_time: {most_s: 4.2}\n").beads  # each layer as the one before
    found = contacts(beads)
    closed = np.array([bead.closed for bead in beads])[found.upper]
    lengths = np.array([bead.length for bead in beads])
    share = found.at / lengths[found.upper] - found.below / lengths[found.lower]
    assert closed.any() and np.abs(share[closed]).max() < 0.02


def test_a_spiral_lies_on_its_own_earlier_turn() -> None:
    a = np.linspace(0.0, 6 * np.pi, 600)
    points = np.column_stack([10 * np.cos(a), 10 * np.sin(a), 0.5 + 0.5 * a / (2 * np.pi)]) * MM
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    up, along = np.tile([0.0, 0.0, 1.0], (600, 1)), np.tile([1.0, 0.0, 0.0], (600, 1))
    sizes = np.full(600, 0.6 * MM), np.full(600, 0.5 * MM)
    found = contacts([Bead("spiral", 0, s, points, up, along, points, *sizes, closed=False)])
    assert found.pairs.tolist() == [[0, 0]]
    assert found.at - found.below == pytest.approx(np.full(len(found), 20 * np.pi * MM), abs=0.8 * MM)
    assert found.at.min() == pytest.approx(20 * np.pi * MM, rel=0.02)


# --- the order ---------------------------------------------------------------------------------------------


def test_layers_in_step_repeat_and_the_plain_order_stays_without_need() -> None:
    plain, stepped = toolpath_of(""), toolpath_of("  interlayer_time: {most_s: 4.2}\n")

    def layer(toolpath: Toolpath, number: int) -> list[tuple[str, bool]]:
        """Names of a layer's beads, and whether they run as in the first one."""
        first = {bead.name: bead.points[1] - bead.points[0] for bead in toolpath.beads if bead.layer == 0}
        own = [bead for bead in toolpath.beads if bead.layer == number]
        return [(bead.name, bool((bead.points[1] - bead.points[0]) @ first[bead.name] > 0.0)) for bead in own]

    assert layer(plain, 1) == [(name, False) for name, _ in reversed(layer(plain, 0))]
    assert layer(stepped, 1) == layer(stepped, 0) == layer(stepped, 2)
    assert isinstance(stepped.surface, ArrangedSurface)
    assert any("in an order or direction other than" in note for note in stepped.notes)
    idle = toolpath_of("  interlayer_time: {most_s: 60}\n")
    assert layer(idle, 1) == layer(plain, 1)
    assert not isinstance(idle.surface, ArrangedSurface)


def test_a_bead_that_runs_backwards_keeps_its_normals() -> None:
    toolpath = toolpath_of("  interlayer_time: {most_s: 4.2}\n")
    assert isinstance(toolpath.surface, ArrangedSurface)
    assert np.isfinite(toolpath.surface.turned).any()
    for i, bead in enumerate(toolpath.beads):
        assert bead.s[0] == 0.0 and (np.diff(bead.s) > 0).all()
        found = toolpath.surface.normals_on(i, bead.s, bead.points)
        assert found == pytest.approx(bead.normals, abs=1e-9)
    assert sum(bead.length for bead in toolpath.beads) == pytest.approx(toolpath_of("").length)


def test_an_order_that_is_asked_for_stays() -> None:
    toolpath = toolpath_of("  order: [wave, '*']\n  interlayer_time: {most_s: 5}\n")
    for layer in range(3):
        assert next(bead.name for bead in toolpath.beads if bead.layer == layer) == "wave"


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_orders_that_are_improved_come_near_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 4
    spots = rng.uniform(0.0, 10.0, (2 * n, 2))
    time = np.repeat(rng.uniform(1.0, 4.0, n), 2)
    travel = 0.2 * np.linalg.norm(spots[:, None] - spots[None], axis=2)
    earliest, latest = rng.uniform(0.0, 15.0, 2 * n), rng.uniform(15.0, 40.0, 2 * n)
    layer = _OneLayer(
        time, lambda a, b: np.asarray(travel[a, b]), travel[0], earliest, latest, np.zeros(2 * n, dtype=np.int64), 1.0
    )
    orders, ways = itertools.permutations(range(n)), list(itertools.product((0, 1), repeat=n))
    every = np.array([2 * np.array(order) + way for order in orders for way in ways])
    costs = layer.costs(every)
    begun = [2 * np.arange(n), 2 * np.arange(n)[::-1] + 1]
    found = min(float(layer.costs(_improved(layer, row)[None])[0]) for row in begun)
    assert found >= costs.min() - 1e-9
    assert found <= 1.35 * costs.min()
    starts = layer.starts(every)
    assert (starts >= earliest[every] - 1e-12).all()
    assert (np.diff(starts, axis=1) >= time[every[:, :-1]] - 1e-12).all()


# --- the waits ---------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000))
def test_beginnings_are_the_earliest_that_keep_all_lags(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    follows = rng.uniform(0.5, 3.0, n - 1)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n) if rng.random() < 0.4] or [(0, n - 1)]
    before, after = (np.array(each) for each in zip(*pairs, strict=True))
    least = rng.uniform(0.0, 6.0, len(pairs))
    lags = Lags(before, after, least, least + rng.uniform(0.0, 6.0, len(pairs)))
    edges = np.concatenate([np.arange(n - 1), before]), np.concatenate([np.arange(1, n), after]), np.concatenate([follows, least])  # fmt: skip
    found = _longest(n, edges, lags, 0.0)
    rows, bounds = [], []
    for a, b, w in zip(*edges, strict=True):
        rows.append(np.eye(n)[a] - np.eye(n)[b])
        bounds.append(-w)
    for a, b, w in zip(before, after, lags.most, strict=True):
        rows.append(np.eye(n)[b] - np.eye(n)[a])
        bounds.append(w)
    best = linprog(np.ones(n), A_ub=np.array(rows), b_ub=bounds, bounds=[(0.0, 0.0), *[(0.0, None)] * (n - 1)])
    assert (found is None) == (best.status == 2)
    if found is not None:
        assert found == pytest.approx(best.x, abs=1e-6)


def test_lags_over_many_layers_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two beads in each layer both lie on those below: none begins before the layer below has had its time."""
    monkeypatch.setattr(planner.motion.interlayer, "_MOST_WORK", 0)
    layers = 300
    n = 2 * layers
    lower, upper = np.arange(n - 2), np.arange(2, n)
    lags = Lags(lower, upper, np.full(n - 2, 5.0), np.full(n - 2, np.inf))
    edges = (
        np.concatenate([np.arange(n - 1), lower]),
        np.concatenate([np.arange(1, n), upper]),
        np.append(np.ones(n - 1), lags.least),
    )
    found = _longest(n, edges, lags, np.inf)
    assert found is not None
    assert found == pytest.approx(np.add.outer(5.0 * np.arange(layers), [0.0, 1.0]).ravel())


def test_a_spiral_that_lies_on_itself_alone_is_not_looked_at_in_time() -> None:
    """Nothing is asked of when it begins, and one of hours would have millions of instants."""
    own, step = np.zeros(2, dtype=np.int64), np.full(2, 0.01)
    touching = BeadContacts(own, own, np.array([0.2, 0.3]), np.array([0.1, 0.2]), step, step)
    process = SimpleNamespace(interlayer_time=SimpleNamespace(least=20.0, most=120.0))
    without_times = SimpleNamespace()
    lags = lags_of(process, SimpleNamespace(beads=(None,)), (without_times,), touching)  # type: ignore[arg-type]
    assert not len(lags.before) and not len(lags.least)


@pytest.mark.slow
def test_the_motion_keeps_to_the_window_and_waits_no_longer_than_it_must() -> None:
    plain, plan = plan_with(""), plan_with(WINDOW)
    assert plan.verified, failed(plan)
    assert plain.metrics["interlayer_time_min_s"] < 6.0 or plain.metrics["interlayer_time_max_s"] > 8.0
    assert 6.0 - plan.t[1] <= plan.metrics["interlayer_time_min_s"] < 6.1
    assert plan.metrics["interlayer_time_max_s"] <= 8.0 + plan.t[1]
    waits = [event for event in plan.trajectory.events if event.kind == "cool"]
    first = [i for i, bead in enumerate(plan.toolpath.beads) if i and bead.layer != plan.toolpath.beads[i - 1].layer]
    assert waits and waits[0].bead == first[0]
    for event in waits:
        resting = (plan.t > event.start + plan.t[1]) & (plan.t < event.start + event.duration - plan.t[1])
        assert np.ptp(plan.q[resting], axis=0).max(initial=0.0) < 1e-9
        arm, radius = len(plan.cell.arm), np.linalg.norm(plan.tip[resting, :2] - np.array([31.4, 37]) * MM, axis=1)
        at_home = np.abs(plan.q[resting, :arm] - plan.cell.home[:arm]).max() < 1e-6
        assert at_home or radius.min() > (34 + 4.9) * MM  # lifted by no less than travel is
    names = {check.name for check in plan.checks}
    assert {"interlayer time at least", "interlayer time at most"} <= names
    assert not any("interlayer" in check.name for check in plain.checks)


@pytest.mark.slow
def test_ages_are_those_of_a_plain_search() -> None:
    plan, t = plan_with(WINDOW), plan_with(WINDOW).trajectory
    laid = np.flatnonzero(t.deposit)
    down = t.tip + 0.5 * MM * t.axis
    ages = plan.series[AGES]
    assert np.isnan(ages[~t.deposit]).all() and np.isnan(ages[t.deposit & (t.layer == 0)]).all()
    off = []
    for i in laid[t.layer[laid] > 0][::29]:
        below = laid[t.layer[laid] == t.layer[i] - 1]
        away = np.linalg.norm(t.tip[below] - down[i], axis=1)
        assert away.min() < 0.3 * MM
        off.append(min(abs(ages[i] - (t.t[i] - t.t[k])) for k in below[away < away.min() + 0.05 * MM]))
    assert np.quantile(off, 0.95) < 0.02 and max(off) < 0.2


@pytest.mark.slow
def test_a_window_that_the_motion_cannot_hold_is_told_with_one_that_it_can() -> None:
    plan = plan_with("  interlayer_time: {most_s: 3}\n")
    (check,) = [check for check in plan.checks if not check.ok]
    assert check.name == "interlayer time at most"
    assert check.worst > 3.0 and "on bead" in check.where
    held = float(check.where.split("most_s: ")[1].split()[0])
    assert check.worst <= held + plan.t[1] and held < check.worst + 0.2
    assert not plan.verified
    assert f"most_s: {held:g} would hold" in check.where


@pytest.mark.slow
def test_no_other_strategy_is_asked_where_none_could_be_quick_enough() -> None:
    plan = plan_with("  interlayer_time: {most_s: 3}\n")
    report = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory)
    assert _too_slow_for_its_window(report)
    quick = plan_with(WINDOW)
    assert not _too_slow_for_its_window(verify(quick.problem, quick.cell, quick.toolpath, quick.trajectory))
    slow = replace(report, metrics=report.metrics | {"deposition_time_s": 9.0 * report.metrics["deposition_time_s"]})
    assert not _too_slow_for_its_window(slow)


# --- the verifier ------------------------------------------------------------------------------------------


def rows_of(t: Trajectory, rows: Ints) -> Trajectory:
    """A trajectory of other samples of it, in their order, evenly spaced in time."""
    arrays = {name: value[rows] for name, value in vars(t).items() if isinstance(value, np.ndarray)}
    return replace(t, **arrays | {"t": np.arange(len(rows)) * t.dt})


@pytest.mark.slow
def test_a_wait_that_is_cut_short_fails() -> None:
    plan, t = plan_with(WINDOW), plan_with(WINDOW).trajectory
    wait = next(event for event in t.events if event.kind == "cool")
    inside = (t.t > wait.start + t.dt) & (t.t < wait.start + wait.duration - t.dt)
    assert inside.sum() * t.dt > 0.5
    spoilt = replace(plan, trajectory=rows_of(t, np.flatnonzero(~inside)))
    assert "interlayer time at least" in failed(spoilt)


def test_a_rest_that_is_too_long_fails() -> None:
    plan, t = plan_with(WINDOW), plan_with(WINDOW).trajectory
    i = int(np.flatnonzero((t.bead == -1) & (t.layer == 1))[-1])
    rows = np.concatenate([np.arange(i), np.full(int(4.0 / t.dt), i), np.arange(i, len(t))])
    assert "interlayer time at most" in failed(replace(plan, trajectory=rows_of(t, rows)))


@pytest.mark.slow
def test_beads_in_another_order_fail() -> None:
    plan, t = plan_with(WINDOW), plan_with(WINDOW).trajectory
    a, b = (np.flatnonzero(t.bead == i) for i in (3, 4))
    rows = np.concatenate([np.arange(a[0]), b, np.arange(a[-1] + 1, b[0]), a, np.arange(b[-1] + 1, len(t))])
    found = failed(replace(plan, trajectory=rows_of(t, rows)))
    assert {"every bead complete", "interlayer time at least"} <= found


@pytest.mark.parametrize(
    ("window", "check"),
    [("{least_s: 6.1}", "interlayer time at least"), ("{most_s: 6}", "interlayer time at most")],
)
def test_the_verifier_asks_the_problem(window: str, check: str) -> None:
    plan = plan_with(WINDOW)
    assert failed(replace(plan, problem=problem_of(f"  interlayer_time: {window}\n"))) == {check}


# --- with all else that is asked of layers -----------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "process",
    [
        "  layer_time: {least_s: 9}\n",
        "  pauses: [{before_layer: 3, wait_s: 3, purge_mm: 5}]\n",
        "  travel: upright\n  retract: {length_mm: 1}\n  prime: {length_mm: 1}\n",
        "  hand_over: motion\n",
        "  materials: {red: {}, blue: {}}\n  change: {wait_s: 2, purge_mm: 5}\n",
        "  extruder: {motor: on_off, flow_tolerance: 10}\n",
    ],
)
def test_a_window_beside_other_things_that_are_asked(process: str) -> None:
    plan = plan_with(process + "  interlayer_time: {least_s: 8, most_s: 30}\n")
    assert plan.verified, failed(plan)
    assert plan.metrics["interlayer_time_min_s"] >= 8.0 - plan.t[1]
    changes = [event for event in plan.trajectory.events if event.kind == "change"]
    assert len(changes) == 2 * bool(plan.problem.process.materials)


@pytest.mark.slow
def test_a_print_that_is_resumed_knows_no_age_of_what_is_there() -> None:
    with tempfile.TemporaryDirectory() as folder:
        problem = load_problem(write_small(Path(folder), THREE, (SPEED, SPEED + WINDOW)))
        plan = solve(problem, first_bead=4, baseline=False)
    assert plan.verified, failed(plan)
    ages, t = plan.series[AGES], plan.trajectory
    on_what_is_there = np.isin(t.bead, [4, 5])
    assert np.isnan(ages[on_what_is_there]).all()
    assert np.isfinite(ages[t.bead == 8]).any()


# --- what is shown -----------------------------------------------------------------------------------------


def test_layers_are_told_one_by_one(tmp_path: Path) -> None:
    plan = plan_with(WINDOW)
    layers = layer_times(plan)
    assert [each.layer for each in layers] == [0, 1, 2]
    assert layers[0].least is None and layers[0].covered == 0.0
    assert layers[1].begin == pytest.approx(layers[0].begin + layers[0].time)
    assert layers[1].least == pytest.approx(plan.metrics["interlayer_time_min_s"], abs=0.1)
    assert layers[2].covered > 0.95
    told = json.loads(plan_json(plan))["layer_times"]
    assert [each["interlayer_min_s"] is None for each in told] == [True, False, False]
    write_report(plan, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Layer by layer" in text and "at least 6.0 s, at most 8.0 s" in text.replace("\n", " ")


def test_beads_can_be_coloured_by_the_age_of_what_is_below() -> None:
    plan = plan_with(WINDOW)
    kept = np.flatnonzero(plan.deposit)[::5]
    (channel,) = [each for each in channels(plan, kept) if each["key"] == AGES]
    assert 6.0 - 0.01 <= channel["min"] <= channel["max"] <= 8.01
    assert [chart["key"] for chart in time_charts(plan)].count("interlayer") == 1


@pytest.mark.slow
def test_a_print_of_one_layer_has_no_ages() -> None:
    with tempfile.TemporaryDirectory() as folder:
        plan = solve_alone(load_problem(write_small(Path(folder), (SPEED, SPEED + WINDOW))))
    assert plan.verified
    assert AGES not in plan.series
    assert not any(name.startswith("interlayer") for name in plan.metrics)
    assert [check.ok for check in plan.checks if "interlayer" in check.name] == [True, True]


def spread(values: Array) -> float:
    """From the least to the greatest."""
    return float(np.nanmax(values) - np.nanmin(values))


@pytest.mark.slow
def test_in_step_ages_hardly_spread() -> None:
    assert spread(plan_with(WINDOW).series[AGES]) < 0.5 * spread(plan_with("").series[AGES])
