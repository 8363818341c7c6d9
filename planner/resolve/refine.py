"""Refinement of a path's free variables: sequential quadratic programs over B-splines.

The free variables z (roll, tilt, holder joints, given arm joints) are splines, so a few control values decide over
many samples; the arm's joints follow from the task exactly. Around a path the rates of all joints are linear in the
control values (derivatives of the inverse kinematics), the price is convex piecewise quadratic, and its minimum in a
trust region is one banded quadratic program. Steps that do not lower the true price are not taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags, Ints
from planner.resolve.cone_kernels import FACETS, watch_leans, watch_missed_leans
from planner.resolve.follow import PosturesFollowed, follow
from planner.resolve.price_kernels import (
    JointBounds,
    PathSlopes,
    RowsFilled,
    RowsWatched,
    SplineSamples,
    bound_rows,
    count_rows,
    differentiate,
    foreseen,
    peak_price,
    price_of,
    price_tilt,
    rate_slopes,
    smooth_price,
    watch_missed,
    watch_missed_ends,
    watch_near,
    watch_near_ends,
)
from planner.resolve.prices import ANCHOR, HARD_PRICE, PEAK, TILT_PRICE
from planner.resolve.quadratic import QuadraticProgram, solve_qp
from planner.resolve.segment import (
    HOLDER,
    TILT,
    Model,
    PathSegment,
    PathState,
    Watch,
    clearance_rows,
    clearances,
    near_sides,
    shortage,
    side_normals,
    side_room,
)
from planner.resolve.splines import spline_values

QPSolver = Callable[[QuadraticProgram], tuple[Array, int]]

_TRUST = 0.15  # rad that a control value may move in the first step
_MOST_TRUST, _LEAST_TRUST = 0.6, 2e-3
_STEPS = 40
_ROUNDS = 4  # of solving a program and watching what its solution has missed
_ENOUGH = 5e-4  # share of the price: a step that promises less is not worth taking
_NEGLIGIBLE = 1e-4  # seconds a second of printing, likewise
_PEAK_SHARE = 0.8  # of the greatest speed at the start: far below it nothing else would count any more
CONE_ROOM = 1e-3  # rad kept from the cones about gravity: between waypoints normals are known no better


def evaluate(model: Model, stretch: PathSegment, c: Array, q_near: Array, least_sigma: float) -> PathState | None:
    """The path that control values c (k, m) make, starting Newton's method from q_near; None if there is none."""
    active = model.active(stretch.cones)
    z = np.zeros((len(stretch.tip), model.columns))
    z[:, active] = spline_values(stretch.first, stretch.B, c)
    return evaluate_samples(model, stretch, c, z, q_near, least_sigma)


def evaluate_samples(
    model: Model, stretch: PathSegment, c: Array, z: Array, q_near: Array, least_sigma: float
) -> PathState | None:
    """The same for free variables z (n, columns) given at every sample."""
    active = model.active(stretch.cones)
    n, nj, m = len(stretch.tip), q_near.shape[1], len(active)
    q = q_near.copy()
    G, sigma, sigma_slope = np.empty((n, nj, m)), np.empty(n), np.empty((n, m))
    lean, lean_slope = np.empty((n, 2, 2)), np.empty((n, 2, 2, m))
    lost = follow(
        model.numbers, model.holder, model.given, stretch.tip, stretch.frames, z, active,
        PosturesFollowed(q, G, sigma, sigma_slope, lean, lean_slope),
    )  # fmt: skip
    if lost >= 0:
        return None
    limits = np.array([stretch.cones.nozzle_gravity, stretch.cones.layer_gravity])
    bounded = limits < np.pi
    cones = limits[bounded] - CONE_ROOM
    lean, lean_slope = np.ascontiguousarray(lean[:, bounded]), np.ascontiguousarray(lean_slope[:, bounded])
    # upright, what is round about the nozzle's axis keeps the clearance from the part that it has
    obstacles = model.obstacles if stretch.cones.tilt > 0.0 else model.obstacles.but_round_on_part
    first = int(np.argmax(stretch.step > 0.0))
    near = clearances(obstacles, q, G, stretch.now, stretch.tip, first, held=c.shape[1] > 0)
    tilt = z[:, list(TILT)] if stretch.cones.tilt > 0.0 else np.zeros((n, 0))
    rates, slack = np.empty((n, 3, nj)), np.empty(n)
    differentiate(q, stretch.centre, stretch.D, rates)
    price = price_of(
        rates, model.limits, stretch.step, stretch.deposits, q, *model.arm_range,
        sigma, least_sigma, np.hstack([np.hypot(lean[..., 0], lean[..., 1]) - cones, shortage(near)]), stretch.peak, slack,
    )  # fmt: skip
    price += TILT_PRICE * float(stretch.step @ (tilt**2).sum(axis=1))
    if c.shape[1]:
        price += ANCHOR * float(stretch.hold @ ((c - stretch.anchor) ** 2).sum(axis=1))
    return PathState(c, q, G, sigma, sigma_slope, rates, slack, lean, lean_slope, cones, tilt, near, float(price))


def calmed(stretch: PathSegment, state: PathState) -> tuple[PathSegment, PathState]:
    """Both with a price on peaks of the joints' speed, if no time is lost there: lost time is dearer."""
    counted = stretch.step > 0.0
    if state.slack[counted & (stretch.deposits > 0.0)].any():
        return stretch, state
    peak = max(PEAK, _PEAK_SHARE * float(np.abs(state.rates[counted, 0]).max()))
    return replace(stretch, peak=peak), replace(state, price=state.price + peak_price(state.rates, stretch.step, peak))


def watched(model: Model, stretch: PathSegment, state: PathState, trust: float) -> Watch:
    """What a program watches from the start, whose steps are at most `trust` [rad]."""
    rates = np.zeros((*state.rates.shape, 2), dtype=np.bool_)
    watch_near(state.rates, model.limits, stretch.deposits, state.slack, rates)
    facets = np.zeros((*state.lean.shape[:2], FACETS.size), dtype=np.bool_)
    watch_leans(stretch.step, state.lean, state.cones, facets)
    ends = np.zeros((len(state.q), model.arm), dtype=np.bool_)
    low, high = model.arm_range
    watch_near_ends(state.q, state.G, low, high, stretch.step, trust, ends)
    return Watch(rates, facets, near_sides(model, stretch, state.c), ends)


@dataclass(frozen=True)
class Expansion:
    """A path's price around it, but for its bounds: control values that move by x add g x + x H x / 2.

    H (k m, w) lower band, g (k m), slopes (n, 3 nj, w): of the rates, as shares of their limits
    """

    H: Array
    g: Array
    slopes: Array


def _bounds(model: Model) -> JointBounds:
    return JointBounds(model.limits, *model.arm_range)


def _samples(stretch: PathSegment) -> SplineSamples:
    return SplineSamples(stretch.step, stretch.deposits, stretch.first, stretch.B, stretch.free)


def _slopes(state: PathState) -> PathSlopes:
    return PathSlopes(
        state.rates, state.slack, state.q, state.G, state.sigma, state.sigma_slope,
        state.lean, state.lean_slope, state.cones,
    )  # fmt: skip


def expand(model: Model, stretch: PathSegment, state: PathState) -> Expansion:
    """The price around a state, see `Expansion`."""
    (n, nj, m), k, width = state.G.shape, len(state.c), stretch.B.shape[2]
    H, g, slopes = np.empty((k * m, width * m)), np.empty(k * m), np.empty((n, 3 * nj, width * m))
    rate_slopes(model.limits, state.G, stretch.centre, stretch.D, stretch.first, stretch.B, stretch.free, slopes)
    smooth_price(_bounds(model), _samples(stretch), _slopes(state), stretch.peak, slopes, H, g)
    pull = 2.0 * ANCHOR * np.repeat(stretch.hold * stretch.free, m)
    H[:, 0] += pull
    g += pull * (state.c - stretch.anchor).ravel()
    if state.tilt.shape[1]:
        columns = np.searchsorted(model.active(stretch.cones), TILT)
        price_tilt(stretch.step, state.tilt, TILT_PRICE, stretch.first, stretch.B, stretch.free, columns, H, g)
    return Expansion(H, g, slopes)


def program_around(
    model: Model,
    stretch: PathSegment,
    state: PathState,
    around: Expansion,
    least_sigma: float,
    trust: float,
    watch: Watch,
) -> QuadraticProgram:
    """The quadratic program whose solution moves the control values of a state, at most by `trust` [rad].

    Only what is watched has rows in it.
    """
    w = around.H.shape[1]
    rows, groups = count_rows(
        stretch.step, stretch.deposits, watch.rates, watch.ends, state.sigma, least_sigma, watch.facets
    )
    own_A, own_b, own_at, own_price = _further_rows(model, stretch, state, w, trust, watch)
    extra = len(own_b)
    A, b, at = np.empty((rows + extra, w)), np.empty(rows + extra), np.empty(rows + extra, dtype=np.int64)
    group, price = np.empty(groups + extra + 1, dtype=np.int64), np.empty(groups + extra)
    bound_rows(
        _bounds(model), least_sigma, _samples(stretch), _slopes(state), around.slopes,
        RowsWatched(watch.rates, watch.ends, watch.facets), RowsFilled(A, b, at, group, price),
    )  # fmt: skip
    A[rows:], b[rows:], at[rows:] = own_A, own_b, own_at
    group[groups + 1 :] = rows + 1 + np.arange(extra)
    typical = float(stretch.step.mean())
    price[groups:] = HARD_PRICE * own_price
    # in units of a sample's time, so that the solver sees numbers near 1
    box = np.full(len(around.g), trust)
    return QuadraticProgram(around.H / typical, around.g / typical, box, A, b, at, group, price / typical)


def _further_rows(
    model: Model, stretch: PathSegment, state: PathState, width: int, trust: float, watch: Watch
) -> tuple[Array, Array, Ints, Array]:
    """Rows of control values and of clearances, and the time that each stands for [s], as the solver wants them."""
    A, b, at = _control_rows(model, stretch, state, width, trust, watch)
    price = np.full(len(b), float(stretch.step.mean()))
    if len(state.near.sample):
        own = clearance_rows(state.near, stretch.step, stretch.first, stretch.B, stretch.free, trust)
        A, b, at, price = (np.concatenate(each) for each in zip((A, b, at, price), own, strict=True))
    order = np.argsort(at, kind="stable")  # the solver sums rows that begin at the same variable
    return A[order], b[order], at[order], price[order]


def _control_rows(
    model: Model, stretch: PathSegment, state: PathState, width: int, trust: float, watch: Watch
) -> tuple[Array, Array, Ints]:
    """Bounds of single control values that a step within `trust` may reach: chosen joints' ranges, and what is watched
    of a polygon inside the tilt's cone.

    A B-spline stays in the hull of its control values, so these bound every sample.
    """
    k, m = state.c.shape
    active = list(model.active(stretch.cones))
    rows: list[tuple[NDArray[np.float64], Array, Flags]] = []
    every = np.ones(k, dtype=np.bool_)
    chosen = [*range(model.arm, len(model.low)), *model.given]
    for h, joint in enumerate(chosen):
        for sign, end in ((1.0, model.high[joint]), (-1.0, -model.low[joint])):
            if np.isfinite(end):
                row = np.zeros(m)
                row[active.index(HOLDER + h)] = sign
                rows.append((row, end - state.c @ row, every))
    if stretch.cones.tilt > 0.0:
        rooms = side_room(model, stretch, state.c)
        for side, normal in enumerate(side_normals()):
            row = np.zeros(m)
            row[[active.index(TILT[0]), active.index(TILT[1])]] = normal
            rows.append((row, rooms[:, side], watch.sides[:, side]))
    A, b, at = [np.zeros((0, width))], [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
    first = np.minimum(np.arange(k), k - width // m)
    for row, room, wanted in rows:
        near = np.flatnonzero(wanted & (room < trust * np.abs(row).sum()) & (stretch.free > 0.0))
        own = np.zeros((len(near), width // m, m))
        own[np.arange(len(near)), near - first[near]] = row
        A.append(own.reshape(len(near), width))
        b.append(room[near])
        at.append(first[near] * m)
    return np.concatenate(A), np.concatenate(b), np.concatenate(at)


def _best_step(
    model: Model, stretch: PathSegment, state: PathState, around: Expansion, least_sigma: float, trust: float, watch: Watch,
    solver: QPSolver,
) -> tuple[Array, Array, float]:  # fmt: skip
    """The step x that lowers the model's price most, the joints (n, nj) that it leads to, to first order, and by how much
    the price falls [s].

    A sample has some forty bounds, few of which matter: those that a solution goes beyond are added to `watch`.
    """
    low, high = model.arm_range
    for _ in range(_ROUNDS):
        program = program_around(model, stretch, state, around, least_sigma, trust, watch)
        x, _ = solver(program)
        q = foreseen(state.q, state.G, spline_values(stretch.first, stretch.B, x.reshape(state.c.shape)))
        missed = watch_missed(
            state.rates, model.limits, stretch.deposits, state.slack, around.slopes,
            stretch.first * state.c.shape[1], x, watch.rates,
        ) + watch_missed_leans(
            stretch.step, state.lean, state.lean_slope, state.cones, stretch.first, stretch.B, stretch.free, x,
            watch.facets,
        ) + watch.add_sides(model, stretch, state, x) + watch_missed_ends(state.q, q, low, high, stretch.step, watch.ends)  # fmt: skip
        if not missed:
            break
    return x, q, float(stretch.step.mean()) * (program.value(np.zeros(len(x))) - program.value(x))


def refine_stretch(
    model: Model, stretch: PathSegment, state: PathState, least_sigma: float, solver: QPSolver = solve_qp
) -> PathState:
    """Lower the price of a state step by step; what comes back never costs more than what was given."""
    trust = _TRUST
    enough = _NEGLIGIBLE * float(stretch.step.sum())
    for _ in range(_STEPS):
        around, watch = expand(model, stretch, state), watched(model, stretch, state, trust)
        while True:
            x, q, promised = _best_step(model, stretch, state, around, least_sigma, trust, watch, solver)
            if promised < enough + _ENOUGH * state.price:
                return state
            trial = evaluate(model, stretch, state.c + x.reshape(state.c.shape), q, least_sigma)
            gained = -np.inf if trial is None else state.price - trial.price
            if trial is not None and gained > 0.1 * promised:
                state = trial
                if gained > 0.7 * promised:
                    trust = min(2.0 * trust, _MOST_TRUST)
                break
            trust *= 0.3
            if trust < _LEAST_TRUST:
                return state
    return state
