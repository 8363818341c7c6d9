"""Strategy `sqp`: prices and programs against finite differences, refined paths against what they must keep."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields, replace
from itertools import product

import numpy as np
import pytest

from planner.base.arrays import Array, Ints
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem import Problem, load_problem
from planner.resolve.cone_kernels import FACETS
from planner.resolve.guides import runs_backwards
from planner.resolve.joint_path import JointPath, postures, rolled
from planner.resolve.ladder import ladder
from planner.resolve.price_kernels import (
    allowed,
    lost,
    lost_slope,
    price_effort,
    price_joint_limits,
    price_singularity,
    price_time_lost,
    slack_of,
    watch_missed_ends,
)
from planner.resolve.prices import (
    DIP,
    DIP_PRICE,
    EFFORT,
    HARD_PRICE,
    LIMIT_COMFORT,
    LIMIT_PRICE,
    PEAK_PRICE,
    SIGMA_COMFORT,
    SIGMA_PRICE,
)
from planner.resolve.quadratic import QuadraticProgram, Solution, Status, solve_qp
from planner.resolve.refine import calmed, evaluate, expand, program_around, refine_stretch, watched
from planner.resolve.segment import Model, PathSegment, PathState, Watch
from planner.resolve.sqp import (
    Priced,
    SplinePath,
    Windowed,
    given_price,
    judged,
    refine_paths,
    start_track,
    whole,
    windows,
)
from planner.resolve.terms import model_of
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, cones_of, make_tasks, tasks_of

BACKGROUND, WINDOWS = sys.modules["planner.base.processes"], sys.modules["planner.resolve.sqp"]
MODULE = sys.modules["planner.resolve.sqp"]  # the package's attribute of that name is the strategy


# --- price and program ------------------------------------------------------------------------------------------


def test_price_against_plain_numpy() -> None:
    rng = np.random.default_rng(1)
    for n, nj, na, fast, peak in ((40, 7, 6, 1, np.inf), (25, 9, 7, 1, 60.0), (25, 7, 6, 0.02, 0.5)):
        limits = rng.uniform(1.0, 50.0, (3, nj))
        rates = rng.normal(size=(n, 3, nj)) * limits * fast * rng.choice([0.3, 1.0, 3.0], (n, 1, 1))
        step, deposits = rng.uniform(0.0, 0.02, n), (rng.random(n) < 0.7).astype(float)
        q, low, high = rng.uniform(-2.1, 2.1, (n, nj)), np.full(na, -2.0), np.full(na, 2.0)
        sigma, least = rng.uniform(0.04, 0.4, n), 0.06
        slack, soft = np.empty(n), 0.3
        slack_of(rates, limits, slack)
        share = np.abs(rates) / limits
        need = np.maximum((share ** (1.0 / np.array([1, 2, 3])[:, None])).max(axis=(1, 2)) - 1.0, 0.0)
        np.testing.assert_allclose(slack, need, rtol=0, atol=1e-12)
        room = np.minimum(q[:, :na] - low, high - q[:, :na])
        effort = (share**2 / (1 + share**2)).sum(axis=2) @ np.broadcast_to(EFFORT, 3) / nj
        effort += PEAK_PRICE * ((np.abs(rates[:, 0]) / peak) ** 8).mean(axis=1)
        late = deposits * (need + DIP_PRICE * need / (need + DIP))
        close = soft * SIGMA_PRICE * np.maximum(SIGMA_COMFORT / sigma - 1, 0) ** 2
        close += HARD_PRICE * deposits * np.maximum(least - sigma, 0)
        near = soft * LIMIT_PRICE * np.maximum(1 - room / LIMIT_COMFORT, 0) ** 2 + HARD_PRICE * np.maximum(-room, 0)
        for price, plain in (
            (price_time_lost(step, deposits, slack), late),
            (price_effort(rates, limits, step, peak), effort),
            (price_singularity(soft, step, deposits, sigma, least), close),
            (price_joint_limits(soft, step, q, low, high), near.sum(axis=1)),
        ):
            assert price == pytest.approx(float(step @ plain), rel=1e-9)


def test_what_the_program_says_of_slack_is_never_too_little() -> None:
    """Tangents: above the price of slack, which is concave, and below the rates that slack allows."""
    s = np.linspace(0.0, 4.0, 41)
    for at in (0.0, 0.02, 0.5, 3.0):
        assert all(lost(at) + lost_slope(at) * (x - at) >= lost(x) - 1e-12 for x in s)
        assert lost_slope(at) == pytest.approx((lost(at + 1e-6) - lost(at)) / 1e-6, rel=1e-4)
        for order in (0, 1, 2):
            bound, slope = allowed(order, at)
            assert bound == pytest.approx((1.0 + at) ** (order + 1))
            assert all(bound + slope * (x - at) <= allowed(order, x)[0] + 1e-12 for x in s)
            assert slope == pytest.approx((allowed(order, at + 1e-6)[0] - bound) / 1e-6, rel=1e-4)


TWO_AXES = ("cell.positioner.held_deg={}", "cell.positioner.free=[tilt, rotation]")
TILT = "process.cones={nozzle_normal_deg: 20}"
SETUPS = {
    "plain": (),
    "fast": ("process.speed_mm_s=150",),
    "fast, tilt": ("process.speed_mm_s=150", TILT),
    "two axes, gravity": (
        *TWO_AXES, "process.speed_mm_s=120",
        "process.cones={nozzle_normal_deg: 20, nozzle_gravity_deg: 80, layer_gravity_deg: 85}",
    ),
    "narrow": (TILT, "process.speed_mm_s=100", "cell.limits={joint_1: {range_deg: [-20, 40]}}"),
    "seven axes": ("cell.arm=iiwa", "cell.home_deg=[10, 30, -20, -80, 15, 60, 0]"),
}  # fmt: skip
Setup = tuple[Cell, Problem, tuple[JointPath, ...]]


@pytest.fixture(scope="module")
def setup_of(drawing_problem: Problem, toolpath: Toolpath) -> Callable[[str], Setup]:
    """Cell, problem and the ladder's paths of two layers of the drawing, by the name of a setup."""
    known: dict[str, Setup] = {}

    def make(name: str) -> Setup:
        if name not in known:
            steps = ["resolve.rung_mm=10", "resolve.roll_step_deg=30", "resolve.table_step_deg=30"]
            problem = load_problem("cylinder_logo", [*steps, *SETUPS[name]])
            cell = build_cell(problem)
            tasks = make_tasks(toolpath, problem.process.speed, 5e-3, cones_of(problem.process.cones))
            known[name] = cell, problem, ladder(cell, tasks, problem.resolve)
        return known[name]

    return make


def start(
    cell: Cell, path: JointPath, floor: float, knot: float = 2.5e-3
) -> tuple[Model, SplinePath, PathSegment, PathState]:
    model = model_of(cell)
    track = start_track(model, knot, floor, path, None)
    stretch = whole(track.task, track.clock, track.basis, track.anchor)
    state = evaluate(model, stretch, track.c, track.q, floor)
    assert state is not None
    return model, track, stretch, state


def perturbed(model: Model, stretch: PathSegment, state: PathState, floor: float, size: float, seed: int) -> PathState:
    """Smoothly, so that the joints keep following."""
    rng = np.random.default_rng(seed)
    k, m = state.c.shape
    wave = np.sin(np.linspace(0.0, 3.0, k)[:, None] * rng.uniform(0.5, 2.0, m) + rng.uniform(0, 6, m))
    out = evaluate(model, stretch, state.c + size * wave * rng.uniform(-1, 1, m), state.q, floor)
    assert out is not None
    return out


def everything(state: PathState) -> Watch:
    return Watch(
        np.ones((*state.rates.shape, 2), dtype=np.bool_),
        np.ones((*state.lean.shape[:2], FACETS.size), dtype=np.bool_),
        np.ones((len(state.q), 6), dtype=np.bool_),
    )


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", ["plain", "fast, tilt", "two axes, gravity"])
def test_rows_of_the_program_are_derivatives_of_the_rates(name: str, setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of(name)
    floor = 0.1
    model, _, stretch, state = start(cell, paths[0], floor)
    state = perturbed(model, stretch, state, floor, 0.02, 1)
    stretch = replace(stretch, free=(np.arange(len(state.c)) % 5 != 2).astype(float))
    watch = everything(state)
    qp = program_around(model, stretch, state, expand(model, stretch, state), 0.1, watch)
    np.testing.assert_array_equal(qp.box, 0.1)
    nj = state.rates.shape[2]
    rng = np.random.default_rng(2)
    laid = np.flatnonzero(stretch.deposits)
    x = rng.normal(size=state.c.shape)
    held = stretch.free == 0.0
    h = 1e-5
    moved = x * stretch.free[:, None]
    sides = [evaluate(model, stretch, state.c + s * h * moved, state.q, floor) for s in (1.0, -1.0)]
    assert sides[0] is not None
    assert sides[1] is not None
    by = (sides[0].rates - sides[1].rates) / (2 * h) / model.limits
    scale = np.abs(by).max(axis=(0, 2))
    w = qp.A.shape[1]
    starts = np.flatnonzero(np.diff(qp.group) == 6 * nj)  # a sample's rates are a group of this many
    assert len(starts) == len(laid)
    for k, i in zip(starts, laid, strict=True):
        rows = slice(qp.group[k], qp.group[k + 1])
        at = int(qp.at[qp.group[k]])
        slopes = np.array([allowed(o, state.slack[i])[1] for o in range(3)])
        seen = (qp.A[rows] @ x.ravel()[at : at + w]).reshape(3, nj, 2) * slopes[:, None, None]
        np.testing.assert_allclose(seen[:, :, 0], -seen[:, :, 1], rtol=0, atol=1e-12)
        assert (np.abs(seen[:, :, 0] - by[i]) < np.array([2e-3, 5e-3, 4e-2])[:, None] * scale[:, None]).all()
        share = state.rates[i] / model.limits
        bound = np.array([allowed(o, state.slack[i])[0] for o in range(3)])
        room = (qp.b[rows].reshape(3, nj, 2) + state.slack[i]) * slopes[:, None, None]
        np.testing.assert_allclose(room[:, :, 0], bound[:, None] - share, rtol=0, atol=1e-9)
        np.testing.assert_allclose(room[:, :, 1], bound[:, None] + share, rtol=0, atol=1e-9)
    columns = np.repeat(held, x.shape[1])
    for r in range(len(qp.b)):
        assert not qp.A[r, columns[qp.at[r] : qp.at[r] + w]].any()  # control values that are held
    assert not qp.g[columns].any()
    assert (qp.H[columns, 0] > 0.0).all()


@pytest.mark.slow(keep=3)
@pytest.mark.parametrize("name", ["plain", "fast, tilt", "two axes, gravity", "narrow"])
@pytest.mark.parametrize("floor", [0.1, 0.19])
def test_program_is_the_price_to_first_order_and_not_below(
    name: str, floor: float, setup_of: Callable[[str], Setup]
) -> None:
    cell, _, paths = setup_of(name)
    for path in paths[:2]:
        model, _, stretch, state = start(cell, path, floor, 5e-3)  # round bends half of that
        state = perturbed(model, stretch, state, floor, 0.03, 3)
        watch = everything(state)
        qp = program_around(model, stretch, state, expand(model, stretch, state), 0.1, watch)
        typical, now = float(stretch.step.mean()), qp.value(np.zeros(len(qp.g)))
        rng = np.random.default_rng(4)
        k = np.arange(len(state.c))[:, None]
        for _ in range(6):
            x = np.sin(k * rng.uniform(0.1, 1.0, state.c.shape[1]) + rng.uniform(0, 6, state.c.shape[1]))
            errors, changes = [], []
            for h in (2e-3, 2e-4, 2e-5):
                moved = evaluate(model, stretch, state.c + h * x, state.q, floor)
                assert moved is not None
                change = typical * (qp.value(h * x.ravel()) - now)
                errors.append((moved.price - state.price - change) / h)
                changes.append(abs(change) / h)
            # the stencils' own error aside, what the program leaves out is of second order
            # the steps are a tenth of each other: what the program leaves out is of second order
            assert abs(errors[2]) < 0.25 * abs(errors[1]) + 3e-4 * changes[2] + 1e-5
            # and, where it is not, the program asks too much rather than too little
            assert errors[0] < 0.02 * max(changes) + 0.03


def test_peaks_are_in_the_program_to_second_order(setup_of: Callable[[str], Setup]) -> None:
    """What they add to the price, and to the program, with all rates linear in the control values."""
    cell, _, paths = setup_of("plain")
    model, _, stretch, state = start(cell, paths[0], 0.1)
    dear = replace(stretch, peak=0.7)
    priced = evaluate(model, dear, state.c, state.q, 0.1)
    assert priced is not None
    with_them, without = (
        program_around(model, s, priced, expand(model, s, priced), 0.1, everything(state)) for s in (dear, stretch)
    )

    def peaks(rates: Array) -> float:
        return PEAK_PRICE * float(stretch.step @ ((rates[:, 0] / 0.7) ** 8).mean(axis=1))

    assert priced.price - state.price == pytest.approx(peaks(state.rates))
    x = np.random.default_rng(6).normal(size=state.c.shape)
    sides = [evaluate(model, stretch, state.c + s * 1e-5 * x, state.q, 0.1) for s in (1.0, -1.0)]
    assert sides[0] is not None
    assert sides[1] is not None
    slope = (sides[0].rates - sides[1].rates) / 2e-5
    h = 1e-4
    by = [peaks(state.rates + k * h * slope) for k in (-1.0, 0.0, 1.0)]
    typical = float(stretch.step.mean())
    added = [typical * (with_them.value(k * x.ravel()) - without.value(k * x.ravel())) for k in (-1.0, 0.0, 1.0)]
    assert added[2] - added[0] == pytest.approx((by[2] - by[0]) / h, rel=0.01)
    assert added[2] - 2 * added[1] + added[0] == pytest.approx((by[2] - 2 * by[1] + by[0]) / h**2, rel=0.02)


def test_peaks_of_the_joints_speed_are_lower_where_nothing_is_lost() -> None:
    """On the cap that ships, which the ladder's path follows without a dip."""
    problem = load_problem("peer_cap")
    cell = build_cell(problem)
    (path,) = ladder(cell, tasks_of(problem, build_toolpath(problem)), problem.resolve)
    model, _, stretch, state = start(cell, path, 0.05)
    assert not state.slack[stretch.deposits > 0.0].any()
    dear, given = calmed(model, stretch, state)
    assert given.price > state.price
    plain, calm = refine_stretch(model, stretch, state), refine_stretch(model, dear, given)
    assert calm.price < given.price
    assert np.abs(calm.rates[:, 0]).max() < 0.99 * np.abs(plain.rates[:, 0]).max()
    assert not calm.slack[stretch.deposits > 0.0].any()


def test_lost_time_is_dearer_than_peaks(setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of("fast")
    model, _, stretch, state = start(cell, paths[0], 0.1)
    assert state.slack[stretch.deposits > 0.0].any()
    same, given = calmed(model, stretch, state)
    assert same is stretch
    assert given is state


def test_ends_of_ranges_join_where_a_step_goes_beyond_them(setup_of: Callable[[str], Setup]) -> None:
    """Those are watched from the start that most of a step may reach; of others, the end that is nearer now."""
    cell, _, paths = setup_of("plain")
    model, _, stretch, state = start(cell, paths[0], 0.1)
    reach = 0.1 * np.abs(state.G[:, : model.arm]).sum(axis=2)
    nearest = int(state.q[:, 1].argmin())
    low = model.low.copy()
    low[1] = state.q[nearest, 1] - 0.5 * reach[nearest, 1]
    narrow = replace(model, low=low)
    watch = watched(narrow, stretch, state, 0.1)
    counted = stretch.step > 0.0
    room = np.minimum(state.q[:, :6] - narrow.low[:6], narrow.high[:6] - state.q[:, :6])
    assert watch.ends[:, 1].any()
    np.testing.assert_array_equal(watch.ends, (room < 0.7 * reach) & counted[:, None])
    assert not watched(model, stretch, state, 0.0).ends.any()
    watch.ends[:] = False
    ranges = narrow.low[:6], narrow.high[:6], stretch.step, watch.ends
    assert watch_missed_ends(state.q, state.q, *ranges) == 0
    beyond = state.q - np.eye(state.q.shape[1])[1] * (room[:, 1].min() + 0.01)
    over = counted & (beyond[:, 1] < narrow.low[1] - 1e-5)
    farther = state.q + np.eye(state.q.shape[1])[1] * 10.0  # beyond the end that has no row
    assert watch_missed_ends(state.q, farther, *ranges) == 0
    assert watch_missed_ends(state.q, beyond, *ranges) == over.sum() > 0
    np.testing.assert_array_equal(watch.ends[:, 1], over)
    qp = program_around(narrow, stretch, state, expand(narrow, stretch, state), 0.1, watch)
    moved = np.random.default_rng(8).normal(size=state.c.shape)
    by = np.einsum("nm,nb,nbm->n", state.G[:, 1], stretch.B[:, 0], moved[stretch.first[:, None] + np.arange(6)])
    rows = np.flatnonzero(np.isclose(qp.b[:, None], room[over, 1]).any(axis=1))
    assert len(rows) >= over.sum()
    w = qp.A.shape[1]
    seen = [qp.A[r] @ moved.ravel()[qp.at[r] : qp.at[r] + w] for r in rows]
    assert all(np.isclose(seen, -value, rtol=1e-9, atol=1e-12).any() for value in by[over])  # towards the lower end


@pytest.mark.slow
def test_tilt_stays_in_its_cone_though_few_facets_are_watched(setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of("fast, tilt")
    shares = []
    for path in paths[:3]:
        model, _, stretch, state = start(cell, path, 0.1)
        done = refine_stretch(model, stretch, state)
        assert done.price < state.price
        most = np.hypot(*done.lean[:, -1].T).max()
        assert most <= stretch.cones.tilt
        narrow = replace(stretch, cones=replace(stretch.cones, tilt=0.4 * most))
        begin = evaluate(model, narrow, state.c, state.q, 0.1)
        assert begin is not None
        shares.append(np.hypot(*refine_stretch(model, narrow, begin).lean[:, -1].T).max() / narrow.cones.tilt)
    assert max(shares) <= 1.0
    assert min(shares) > 0.8  # it would have leaned farther


# --- refining ---------------------------------------------------------------------------------------------------


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", SETUPS)
def test_refining_never_raises_the_price(name: str, setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of(name)
    gained = 0
    for path in paths[:2]:
        floor = 0.1
        model, _, stretch, state = start(cell, path, floor)
        for size, seed in ((0.0, 0), (0.05, 1)):
            given = perturbed(model, stretch, state, floor, size, seed)
            out = refine_stretch(model, stretch, given)
            assert out.price <= given.price
            gained += out.price < 0.8 * given.price
            again = evaluate(model, stretch, out.c, out.q, floor)
            assert again is not None
            assert again.price == pytest.approx(out.price, rel=1e-6)  # and it is the price of what came back
    assert gained >= 2


def test_a_useless_solver_changes_nothing(setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of("fast")
    model, _, stretch, state = start(cell, paths[0], 0.1)
    rng = np.random.default_rng(1)
    for answer in (
        lambda qp: np.full(len(qp.g), np.nan),
        lambda qp: np.zeros(len(qp.g)),
        lambda qp: rng.uniform(-1, 1, len(qp.g)) * qp.box,
        lambda qp: qp.box * 20.0,
    ):
        out = refine_stretch(model, stretch, state, lambda qp, answer=answer: Solution(answer(qp), 0))
        assert out.price <= state.price
        assert np.isfinite(out.q).all()


def test_programs_that_are_not_solved_are_tried_in_a_smaller_region(setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of("fast")
    model, _, stretch, state = start(cell, paths[0], 0.1)
    boxes: list[float] = []

    def fails_at_first(qp: QuadraticProgram) -> Solution:
        boxes.append(float(qp.box[0]))
        good = solve_qp(qp)
        return replace(good, x=0.5 * good.x, status=Status.STOPPED, gap=1e3) if len(boxes) < 3 else good

    def never(qp: QuadraticProgram) -> Solution:
        boxes.append(float(qp.box[0]))
        return replace(solve_qp(qp), status=Status.FAILED)

    def near(qp: QuadraticProgram) -> Solution:
        return replace(solve_qp(qp, 1e-5), status=Status.STOPPED)

    out = refine_stretch(model, stretch, state, fails_at_first)
    assert out.price < 0.9 * state.price
    np.testing.assert_allclose(boxes[:3], 0.15 * 0.3 ** np.arange(3))
    boxes.clear()
    assert refine_stretch(model, stretch, state, never) is state
    assert len(boxes) < 6
    assert refine_stretch(model, stretch, state, near).price == pytest.approx(out.price, rel=0.05)


def lean(cell: Cell, path: JointPath, rows: slice = slice(None)) -> tuple[float, float]:
    """Largest angles between nozzle axis and gravity, and between surface normal and the vertical [rad]."""
    na, q = len(cell.arm), path.q[rows]
    axis = -cell.arm.poses(q[:, :na])[:, 2, 2]
    normal = (cell.holder.poses(q[:, na:])[:, :3, :3] @ path.task.normals[rows, :, None])[:, 2, 0]
    return float(np.arccos(np.clip(axis, -1, 1)).max()), float(np.arccos(np.clip(normal, -1, 1)).max())


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", SETUPS)
def test_refined_paths_cost_less_and_keep_every_bound(name: str, setup_of: Callable[[str], Setup]) -> None:
    cell, problem, paths = setup_of(name)
    model, least = model_of(cell), problem.resolve.min_sigma
    out = refine_paths(cell, paths, problem.resolve)
    assert [p.task for p in out] == [p.task for p in paths]
    before, after = ([given_price(model, p, least) for p in some] for some in (paths, out))
    assert sum(p.price for p in after) < 0.8 * sum(p.price for p in before)
    worst = min(p.sigma for p in before)
    for path, given, price in zip(out, before, after, strict=True):
        assert price.price <= given.price
        task = path.task
        T = cell.T_part_nozzle(path.q)
        np.testing.assert_allclose(T[:, :3, 3], task.tip, rtol=0, atol=1e-9)
        tilt = 2.0 * np.arcsin(0.5 * np.linalg.norm(T[:, :3, 2] - task.frames[:, :, 2], axis=1))
        assert tilt.max() <= task.cones.tilt + 1e-9
        np.testing.assert_allclose(tilt, np.hypot(*path.tilt.T), rtol=0, atol=1e-9)
        judged = np.arccos(np.clip(-(T[:, :3, 2] * task.normals).sum(axis=1), -1.0, 1.0))[task.first : task.last + 1]
        assert judged.max() <= task.cones.tilt + 1e-7
        sigma = np.linalg.svd(cell.arm.jacobians(path.q[:, : len(cell.arm)]), compute_uv=False)[:, -1]
        assert sigma.min() > min(max(worst, least), given[1]) - 1e-9
        assert (path.q > cell.limits.q_min).all()
        assert (path.q < cell.limits.q_max).all()
        nozzle, layer = lean(cell, path)
        assert nozzle < task.cones.nozzle_gravity + 1e-9
        assert layer < task.cones.layer_gravity + 1e-9


def test_no_path_comes_back_that_leans_too_far_from_the_vertical(
    setup_of: Callable[[str], Setup], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless the path that was given leans farther."""
    cell, _, paths = setup_of("two axes, gravity")
    path = paths[0]
    model, cones = model_of(cell), path.task.cones
    laid = slice(path.task.first, path.task.last + 1)
    nozzle, layer = lean(cell, path, laid)
    known = given_price(model, path, 0.1)
    T = cell.T_part_nozzle(path.q[laid])
    tilt = np.arccos(-(T[:, :3, 2] * path.task.normals[laid]).sum(axis=1)).max()
    over = nozzle - cones.nozzle_gravity, layer - cones.layer_gravity, tilt - cones.tilt
    assert known.beyond == pytest.approx(max(over), abs=1e-6)
    _, track, _, _ = start(cell, path, 0.1)
    for beyond, given, kept in ((-1e-3, -2e-3, True), (1e-4, -1e-3, False), (1e-4, 1e-3, True)):
        monkeypatch.setattr(MODULE, "given_price", lambda *_, beyond=beyond: Priced(0.0, 1.0, beyond))
        assert (MODULE.judged(cell, path, Priced(1.0, 0.1, given), track, 0.1, model)[0] is not path) == kept
    monkeypatch.setattr(MODULE, "given_price", lambda *_: Priced(0.0, 1.0, -1.0))
    lost = replace(track, price=np.inf)  # could not be followed
    assert MODULE.judged(cell, path, Priced(1.0, 0.1, -1.0), lost, 0.1, model)[0] is path


def test_no_path_comes_back_that_leaves_a_range_or_its_cone(
    setup_of: Callable[[str], Setup], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What must not be exceeded has a price in the program; whatever that buys, it is not sold."""
    cell, problem, paths = setup_of("fast, tilt")
    cell = replace(cell, limits=replace(cell.limits, q_min=cell.limits.q_min.copy(), q_max=cell.limits.q_max.copy()))
    cell.limits.q_min[6], cell.limits.q_max[6] = paths[0].q[:, 6].min() - 0.1, paths[0].q[:, 6].max() + 0.1
    monkeypatch.setattr(MODULE, "refine_window", lambda *_: None)

    def priced(model: Model, path: JointPath, least: float) -> Priced:
        return Priced(-float(np.ptp(path.roll)), 1.0, float(np.hypot(*path.tilt.T).max() - path.task.cones.tilt))

    monkeypatch.setattr(MODULE, "given_price", priced)
    for column, by in ((3, 0.2), (1, 0.4), (3, 0.05), (1, 0.3)):

        def shifted(*given: object, column: int = column, by: float = by) -> SplinePath:
            track = start_track(*given)  # type: ignore[arg-type]
            c = track.c.copy()
            c[:, column] += by
            c[0, 0] -= 10.0  # cheaper, by the price above
            q = track.q.copy()
            q[:, 6] += by if column == 3 else 0.0
            return replace(track, c=c, q=q)

        monkeypatch.setattr(MODULE, "start_track", shifted)
        (out,) = refine_paths(cell, paths[:1], problem.resolve)
        assert (out.roll is paths[0].roll) == (by in (0.2, 0.4))


def test_layers_start_from_the_one_below_either_way_round(setup_of: Callable[[str], Setup]) -> None:
    cell, _, paths = setup_of("fast, tilt")
    floor, model = 0.1, model_of(cell)
    seen = set()
    for lower in paths[:3]:
        upper = next(p for p in paths[3:] if p.task.name == lower.task.name)
        _, track, stretch, state = start(cell, lower, floor)
        done = refine_stretch(model, stretch, state)
        below = replace(track, c=done.c, q=done.q)
        alone = start_track(model, 2.5e-3, floor, upper, None)
        if below.c.shape != alone.c.shape:
            continue
        for turn in (0.0, 2.0 * np.pi):  # the table of the bead below may have been left a turn further
            turned = replace(below, c=below.c.copy(), q=below.q.copy())
            turned.c[:, -1] += turn
            turned.q[:, -1] += turn
            both = start_track(model, 2.5e-3, floor, upper, turned)
            assert both.price < 0.8 * alone.price
            assert np.abs(both.q[:, -1] - alone.q[:, -1]).max() < np.pi
        np.testing.assert_array_equal(both.anchor, alone.anchor)
        quarter = rolled(np.array([0.5 * np.pi]))[0]  # by which the zero of roll of the bead above stands elsewhere
        task = replace(upper.task, frames=upper.task.frames @ quarter)
        counted = replace(upper, task=task, roll=upper.roll - 0.5 * np.pi, tilt=upper.tilt @ quarter[:2, :2])
        assert start_track(model, 2.5e-3, floor, counted, below).price < 0.8 * alone.price
        seen.add(runs_backwards(upper.task, lower.task))
        other = start_track(model, 2.5e-3, floor, replace(upper, branch=upper.branch ^ 1), below)
        assert other.price == alone.price  # of no use on another branch
    assert True in seen


# --- windows ----------------------------------------------------------------------------------------------------


def test_windows_cover_everything_and_stay_apart() -> None:
    for controls, short in product(
        (2, 7, 23, 30, 42, 160, 200, 201, 240, 241, 280, 281, 999, 1000, 2003), (False, True)
    ):
        edges = windows(controls, short=short)
        assert (edges[0][0], edges[-1][1]) == (0, controls)
        for (a0, a1), (b0, b1) in zip(edges[:-1], edges[1:], strict=True):
            assert a0 < b0 < a1 < b1  # neighbours overlap
        for colour in (edges[::2], edges[1::2]):
            for (_, a1), (b0, _) in zip(colour[:-1], colour[1:], strict=True):
                assert b0 - a1 > 2 * 6  # more than the B-splines of both sides reach
        most = WINDOWS.SHORT_WINDOW + WINDOWS.SHORT_OVERLAP if short else WINDOWS.WINDOW + WINDOWS.OVERLAP
        assert max(b - a for a, b in edges) <= most


@pytest.mark.parametrize("seed", range(6))
def test_a_window_waits_for_both_its_neighbours_and_for_nothing_else(
    seed: int, setup_of: Callable[[str], Setup], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, _, paths = setup_of("fast, tilt")
    monkeypatch.setattr(WINDOWS, "WINDOW", 10 + 2 * seed)
    monkeypatch.setattr(WINDOWS, "OVERLAP", 4)
    model, track, _, _ = start(cell, paths[0], 0.1, knot=1e-3)
    bead = Windowed(model, track)
    rng = np.random.default_rng(seed)
    ready, done, ended = list(bead.first), set[int](), False
    while ready:
        assert not ended
        k = ready.pop(rng.integers(len(ready)))
        assert k not in done
        done.add(k)
        more, ended = bead.done(k, None)
        ready += more
        free = {j for j in range(1, len(bead.edges), 2) if {j - 1, j + 1} & set(range(len(bead.edges))) <= done}
        assert free == (done | set(ready)) & set(range(1, len(bead.edges), 2))
    assert ended
    assert done == set(range(len(bead.edges)))
    np.testing.assert_array_equal(bead.after().c, track.c)


def priced(cell: Cell, paths: tuple[JointPath, ...]) -> float:
    model = model_of(cell)
    return sum(given_price(model, path, 0.05)[0] for path in paths)


@pytest.mark.parametrize("name", ["fast, tilt", "narrow"])
def test_small_windows_come_near_to_one_large_one(
    name: str, setup_of: Callable[[str], Setup], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With knots so close that the windows are many; in "narrow" joints come near the ends of their ranges."""
    cell, problem, paths = setup_of(name)
    settings = problem.resolve.model_copy(update={"knot": 1e-3})
    large = refine_paths(cell, paths[:1], settings)
    monkeypatch.setattr(WINDOWS, "WINDOW", 28)
    monkeypatch.setattr(WINDOWS, "OVERLAP", 8)
    assert len(windows(54)) == 3
    small = refine_paths(cell, paths[:1], settings)
    given, one, many = (priced(cell, p) for p in (paths[:1], large, small))
    assert one < 0.7 * given
    assert given - many > 0.6 * (given - one)


def test_a_window_sees_the_rates_of_the_whole_path(
    setup_of: Callable[[str], Setup], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever it counts them; and it counts all samples that its control values touch."""
    cell, _, paths = setup_of("fast, tilt")
    model, track, stretch, state = start(cell, paths[0], 0.1, knot=1e-3)
    seen: list[tuple[PathSegment, PathState]] = []

    def capture(model: Model, stretch: PathSegment, state: PathState, *_: object) -> PathState:
        seen.append((stretch, state))
        return state

    monkeypatch.setattr(MODULE, "refine_stretch", capture)
    for window in ((0, 20), (15, 35), (30, len(track.c))):
        piece = MODULE.refine_window(model, 0.1, track, window, MODULE.by_programs(solve_qp))
        part, its = seen.pop()
        counted = part.step > 0.0
        np.testing.assert_allclose(its.rates[counted], state.rates[piece.samples][counted], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(its.slack[counted], state.slack[piece.samples][counted], rtol=0, atol=1e-6)
        np.testing.assert_array_equal(part.step[counted], stretch.step[piece.samples][counted])
        assert not part.deposits[~counted].any()
        np.testing.assert_array_equal(np.flatnonzero(part.free) + piece.controls.start, np.arange(*window))
        first, width = track.basis.first, track.basis.B.shape[2]
        touched = np.flatnonzero((first + width > window[0]) & (first < window[1]))
        reach = np.unique(np.clip(touched[:, None] + np.arange(-2, 3), 0, len(first) - 1))
        assert set(reach) <= set(np.arange(len(first))[piece.samples][counted])
        bead = Windowed(model, track)
        bead.done(0, piece)
        assert bead.after().c.shape == track.c.shape


class Unseen(Obstacles):
    """Something that the refinement does not look at, in the way of all postures but the given ones in a part of a bead."""

    @property
    def any(self) -> bool:
        return False

    @classmethod
    def beside(cls, path: JointPath, share: tuple[float, float]) -> Unseen:
        made = cls(**{field.name: getattr(NOTHING, field.name) for field in fields(NOTHING)})
        n = len(path.task)
        object.__setattr__(made, "kept", (path, slice(int(share[0] * n), int(share[1] * n))))
        return made

    def margins(self, q: Array, now: Array, enough: float, more: float = 0.0) -> tuple[Array, Ints]:
        path, part = self.kept  # type: ignore[attr-defined]
        at = np.round(np.interp(now, path.task.moments, np.arange(len(path.task)))).astype(int)
        near = (at >= part.start) & (at < part.stop)
        away = np.abs(q - path.q[at]).max(axis=1)
        return np.where(near & (away > 0.02), -0.01, enough), np.full(len(q), -1)


@pytest.mark.slow
def test_where_one_place_is_not_clear_the_rest_is_refined(setup_of: Callable[[str], Setup]) -> None:
    cell, problem, paths = setup_of("fast, tilt")
    settings = problem.resolve.model_copy(update={"knot": 1e-3})
    path = max(paths, key=lambda path: len(path.task))
    unseen = Unseen.beside(path, (0.45, 0.55))
    free, held = (refine_paths(cell, [path], settings, way)[0] for way in (NOTHING, unseen))
    assert unseen.margins(free.q, path.task.moments, 1.0)[0].min() < 0.0
    assert unseen.margins(held.q, path.task.moments, 1.0)[0].min() > 0.0
    saved = [priced(cell, (path,)) - priced(cell, (out,)) for out in (free, held)]
    assert saved[1] > 0.3 * saved[0] > 0.0
    everywhere = Unseen.beside(path, (0.0, 1.0))
    (same,) = refine_paths(cell, [path], settings, everywhere)
    assert everywhere.margins(same.q, path.task.moments, 1.0)[0].min() > 0.0


def test_a_start_outside_its_cone_is_repaired(setup_of: Callable[[str], Setup]) -> None:
    """Also at a price that is higher: by how little the start is beyond the cone does not matter."""
    cell, problem, paths = setup_of("fast, tilt")
    floor = 0.1
    wide = refine_paths(cell, paths[:1], problem.resolve)[0]
    leans = np.hypot(*wide.tilt.T)
    for share in (0.98, 0.6):
        task = replace(wide.task, cones=replace(wide.task.cones, tilt=share * float(leans.max())))
        given = replace(wide, task=task)
        before = given_price(model_of(cell), given, floor)
        assert before.beyond > 1e-3
        (out,) = refine_paths(cell, [given], problem.resolve)
        assert given_price(model_of(cell), out, floor).beyond <= 0.0
    # as if the start had cost next to nothing
    model = model_of(cell)
    track = start_track(model, 2.5e-3, floor, out, None)
    cheap = Priced(1e-6, before.sigma, before.beyond)
    assert judged(cell, given, cheap, track, floor, model)[0] is not given
    assert judged(cell, given, cheap._replace(beyond=0.0), track, floor, model)[0] is given


@pytest.mark.slow
def test_threads_do_not_matter(setup_of: Callable[[str], Setup], monkeypatch: pytest.MonkeyPatch) -> None:
    cell, problem, paths = setup_of("fast")
    monkeypatch.setattr(WINDOWS, "WINDOW", 14)
    monkeypatch.setattr(WINDOWS, "OVERLAP", 4)
    results = []
    for threads in (1, 2, 5):
        for module in (MODULE, BACKGROUND):
            monkeypatch.setattr(module, "cores", lambda threads=threads: threads)
        results.append(refine_paths(cell, paths, problem.resolve))
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(a.q, b.q)
            np.testing.assert_array_equal(a.roll, b.roll)


def test_a_long_bead(cell: Cell) -> None:
    """Twelve turns round the cylinder, 850 control values, in windows of the size that ships."""
    path = spiral_path(cell, turns=12.0, n=4300)
    settings = load_problem("cylinder_logo").resolve
    track = start_track(model_of(cell), settings.knot, 0.05, path, None)
    assert len(windows(track.basis.controls)) > 4
    (out,) = refine_paths(cell, [path], settings)
    assert given_price(model_of(cell), out, 0.05)[0] < 0.8 * given_price(model_of(cell), path, 0.05)[0]
    assert (np.abs(np.diff(out.q, 4, axis=0)).max(axis=0) < 2e-3).all()  # no seams between windows


@pytest.mark.parametrize("n", [2, 4, 5, 6, 9, 30])
def test_short_beads(cell: Cell, n: int) -> None:
    """Too short for a stencil: left alone. Otherwise at least as good as before."""
    path = spiral_path(cell, turns=0.003 * n, n=n)
    settings = load_problem("cylinder_logo").resolve
    long = spiral_path(cell, turns=0.2, n=100)
    out, _ = refine_paths(cell, [path, long], settings)
    assert out.q.shape == path.q.shape
    assert np.isfinite(out.q).all()
    if n < 5:
        np.testing.assert_array_equal(out.q, path.q)
    else:
        assert given_price(model_of(cell), out, 0.05)[0] <= given_price(model_of(cell), path, 0.05)[0]
    assert refine_paths(cell, [path], settings)[0].q.shape == path.q.shape


def spiral_path(cell: Cell, turns: float, n: int) -> JointPath:
    """A nozzle that stands on a cylinder's side while the table turns, with a needless swing of roll and table."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, n)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(n)
    radius, rise = 0.034, 0.01 * angle / (2.0 * np.pi)
    tip = np.column_stack([0.0314 + radius * c, 0.037 + radius * s, 0.03 + 0.2 * rise])
    down = np.column_stack([zero, zero, zero - 1.0])
    z = np.column_stack([-c, -s, zero])
    frames = np.stack([np.cross(z, down) * -1.0, down, z], axis=-1)
    frames[:, :, 0] = np.cross(frames[:, :, 1], z)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    task = NozzleTask(0, f"spiral {n}", 0, tip, frames, arc, 0, n - 1, 0.04)
    # the arm's z axis horizontal, towards the cylinder, as at home; the table turns the point there
    swing = 0.15 * np.sin(np.linspace(0.0, 40.0 * turns, n))
    home = cell.arm.poses(cell.home[None, :6])[0, :3, :3]
    towards = np.arctan2(-home[1, 2], -home[0, 2])
    table = towards - angle + swing
    q = postures(cell, task, 0.3 * swing, table[:, None], 0)
    return JointPath(task, 0.3 * swing, np.zeros((n, 2)), q, 0)
