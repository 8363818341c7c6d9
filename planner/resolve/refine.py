"""Refinement of a path's free variables: sequential quadratic programs over B-splines.

The free variables z (roll, tilt, holder joints, given arm joints) are splines, so a few control values determine many
samples; the arm's joints follow from the task exactly. Around a path, the rates of all joints are modelled as linear in
the control values (derivatives of the inverse kinematics) and the price as convex piecewise quadratic, so minimising it
in a trust region is one banded quadratic program. Steps that do not lower the true price are not taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.base.arrays import Array, Ints
from planner.resolve.cone_kernels import FACETS
from planner.resolve.follow import PosturesFollowed, follow
from planner.resolve.price_kernels import (
    RowPlaces,
    RowsFilled,
    differentiate,
    foreseen,
    places_of,
    rate_slopes,
    slack_of,
)
from planner.resolve.prices import PEAK
from planner.resolve.quadratic import QuadraticProgram, Solution, Status, solve_qp
from planner.resolve.segment import Expansion, Model, PathSegment, PathState, Rows, Step, Watch, clearances
from planner.resolve.splines import spline_values
from planner.toolpath.task import Cones

QPSolver = Callable[[QuadraticProgram], Solution]

_TRUST = 0.15  # rad that a control value may move in the first step
_MOST_TRUST, _LEAST_TRUST = 0.6, 2e-3
_STEPS = 40
_ROUNDS = 4  # rounds of solving a program and adding rows for the bounds that its solution violates
_ENOUGH = 5e-4  # share of the price: a step that promises less is not worth taking
_NEGLIGIBLE = 1e-4  # seconds per second of printing, likewise
_LOOSE = 0.3  # share of its descent that a program stopped early may be off by, for its step to be tried
_PEAK_SHARE = 0.8  # share of the greatest speed at the start: with a much lower peak, nothing else would count
_LEAP = 0.3  # rad that a joint may turn from sample to sample: with more, the nozzle leaves the path in between
CONE_ROOM = 1e-3  # rad kept from the cones: between waypoints, normals are known no better
_MOST_ROOM = 0.1  # share of a cone that is kept from it, at most


def bounded_cones(cones: Cones) -> tuple[Ints, Array]:
    """Which of the three leans of `follow` are bounded (b), and by what (b) [rad]."""
    half = np.array([cones.nozzle_gravity, cones.layer_gravity, cones.tilt if cones.tilt > 0.0 else np.pi])
    bounded = np.flatnonzero(half < np.pi)
    return bounded, half[bounded]


def evaluate(model: Model, stretch: PathSegment, c: Array, q_near: Array, least_sigma: float) -> PathState | None:
    """The path with control values c (k, m), by Newton's method from q_near; None if there is none."""
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
    lean, lean_slope = np.empty((n, 3, 2)), np.empty((n, 3, 2, m))
    lost = follow(
        model.numbers, model.holder, model.given, stretch.tip, stretch.frames, stretch.normals, z, active,
        PosturesFollowed(q, G, sigma, sigma_slope, lean, lean_slope),
    )  # fmt: skip
    if lost >= 0:
        return None
    bounded, half = bounded_cones(stretch.cones)
    cones = half - np.minimum(CONE_ROOM, _MOST_ROOM * half)
    lean, lean_slope = np.ascontiguousarray(lean[:, bounded]), np.ascontiguousarray(lean_slope[:, bounded])
    # with an upright nozzle, bodies that are round about its axis cannot change their clearance from the part
    obstacles = model.obstacles if stretch.cones.tilt > 0.0 else model.obstacles.but_round_on_part
    first = int(np.argmax(stretch.step > 0.0))
    near = clearances(obstacles, q, G, stretch.now, stretch.tip, first, held=c.shape[1] > 0)
    rates, slack = np.empty((n, 3, nj)), np.empty(n)
    differentiate(q, stretch.centre, stretch.D, rates)
    slack_of(rates, model.limits, slack)
    state = PathState(c, q, G, sigma, sigma_slope, rates, slack, lean, lean_slope, cones, near, least_sigma)
    return _priced(model, stretch, state)


def _priced(model: Model, stretch: PathSegment, state: PathState) -> PathState:
    """A state with its price, the sum of all terms."""
    return replace(state, price=float(sum(term.price(model, stretch, state) for term in model.terms)))


def calmed(model: Model, stretch: PathSegment, state: PathState) -> tuple[PathSegment, PathState]:
    """Stretch and state with a price on peaks of the joints' speed, unless time is lost there, which costs more."""
    counted = stretch.step > 0.0
    if state.slack[counted & (stretch.deposits > 0.0)].any():
        return stretch, state
    peak = max(PEAK, _PEAK_SHARE * float(np.abs(state.rates[counted, 0]).max()))
    stretch = replace(stretch, peak=peak)
    return stretch, _priced(model, stretch, state)


def watched(model: Model, stretch: PathSegment, state: PathState, trust: float) -> Watch:
    """What a program with steps of at most `trust` [rad] watches from the start."""
    watch = Watch(
        rates=np.zeros((*state.rates.shape, 2), dtype=np.bool_),
        facets=np.zeros((*state.lean.shape[:2], FACETS.size), dtype=np.bool_),
        ends=np.zeros((len(state.q), model.arm), dtype=np.bool_),
    )
    for term in model.terms:
        term.watch(model, stretch, state, trust, watch)
    return watch


def expand(model: Model, stretch: PathSegment, state: PathState) -> Expansion:
    """The price around a state, see `Expansion`. Control values that are held have a one on the diagonal."""
    (n, nj, m), k, width = state.G.shape, len(state.c), stretch.B.shape[2]
    around = Expansion(np.zeros((k * m, width * m)), np.zeros(k * m), np.empty((n, 3 * nj, width * m)))
    rate_slopes(model.limits, state.G, stretch.centre, stretch.D, stretch.first, stretch.B, stretch.free, around.slopes)
    around.H[np.repeat(stretch.free == 0.0, m), 0] = 1.0
    for term in model.terms:
        term.expand(model, stretch, state, around)
    return around


def program_around(
    model: Model, stretch: PathSegment, state: PathState, around: Expansion, trust: float, watch: Watch
) -> QuadraticProgram:
    """The quadratic program whose solution moves the control values of a state by at most `trust` [rad].

    Only what is watched has rows, in the order of samples.
    """
    w = around.H.shape[1]
    counts = [(term, own) for term in model.terms if (own := term.count(stretch, state, watch)) is not None]
    none = np.zeros((0, len(stretch.step)), dtype=np.int64)
    rows_at, rows = places_of(np.vstack([none, *(own for _, (own, _) in counts)]))
    groups_at, groups = places_of(np.vstack([none, *(own for _, (_, own) in counts)]))
    further = _further_rows(model, stretch, state, w, trust)
    extra = len(further[1])
    A, b, at = np.empty((rows + extra, w)), np.empty(rows + extra), np.empty(rows + extra, dtype=np.int64)
    group, price = np.zeros(groups + extra + 1, dtype=np.int64), np.empty(groups + extra)
    filled = RowsFilled(A, b, at, group, price)
    for (term, _), row, own_group in zip(counts, rows_at, groups_at, strict=True):
        term.fill(model, stretch, state, around, watch, RowPlaces(row, own_group), filled)
    A[rows:], b[rows:], at[rows:], price[groups:] = further
    group[groups + 1 :] = rows + 1 + np.arange(extra)
    # in units of a sample's time, so that the solver sees numbers near 1
    typical = float(stretch.step.mean())
    box = np.full(len(around.g), trust)
    return QuadraticProgram(around.H / typical, around.g / typical, box, A, b, at, group, price / typical)


def _further_rows(model: Model, stretch: PathSegment, state: PathState, width: int, trust: float) -> Rows:
    """The terms' rows with slacks of their own."""
    none = np.zeros((0, width)), np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0)
    parts = [none, *(rows for term in model.terms if (rows := term.further(model, stretch, state, trust)) is not None)]
    A, b, at, price = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(at, kind="stable")  # the solver sums rows that begin at the same variable
    return A[order], b[order], at[order], price[order]


def _best_step(
    model: Model,
    stretch: PathSegment,
    state: PathState,
    around: Expansion,
    trust: float,
    watch: Watch,
    solver: QPSolver,
) -> tuple[Step, float] | None:
    """The step that lowers the model's price most, and by how much the price falls [s]; None where a program's
    solution cannot be trusted.

    A sample has some forty bounds, few of which matter: those that a solution violates are added to `watch`.
    """
    for _ in range(_ROUNDS):
        program = program_around(model, stretch, state, around, trust, watch)
        solution = solver(program)
        x = solution.x
        if not _trusted(program, solution):
            return None
        moved = spline_values(stretch.first, stretch.B, x.reshape(state.c.shape))
        step = Step(x, foreseen(state.q, state.G, moved))
        if not sum(term.missed(model, stretch, state, around, step, watch) for term in model.terms):
            break
    return step, float(stretch.step.mean()) * (program.value(np.zeros(len(x))) - program.value(x))


def _trusted(program: QuadraticProgram, solution: Solution) -> bool:
    """Whether a program was solved, or stopped so close to its solution that its step is nearly the best one."""
    if solution.status is not Status.STOPPED:
        return solution.status is Status.SOLVED
    descent = program.value(np.zeros(len(solution.x))) - program.value(solution.x)
    return solution.gap + 2.0 * solution.residual < _LOOSE * descent


def refine_stretch(model: Model, stretch: PathSegment, state: PathState, solver: QPSolver = solve_qp) -> PathState:
    """Lower the price of a state step by step; the result never costs more than the given state."""
    trust = _TRUST
    enough = _NEGLIGIBLE * float(stretch.step.sum())
    for _ in range(_STEPS):
        around, watch = expand(model, stretch, state), watched(model, stretch, state, trust)
        while True:
            best = _best_step(model, stretch, state, around, trust, watch, solver)
            if best is not None:
                step, promised = best
                if promised < enough + _ENOUGH * state.price:
                    return state
                trial = evaluate(model, stretch, state.c + step.x.reshape(state.c.shape), step.q, state.least_sigma)
                leaps = trial is not None and _furthest(trial) > max(_LEAP, _furthest(state))
                gained = -np.inf if trial is None or leaps else state.price - trial.price
                if trial is not None and gained > 0.1 * promised:
                    state = trial
                    if gained > 0.7 * promised:
                        trust = min(2.0 * trust, _MOST_TRUST)
                    break
            # neither a disappointing step nor a program far from solved means that there is nothing to gain
            trust *= 0.3
            if trust < _LEAST_TRUST:
                return state
    return state


def _furthest(state: PathState) -> float:
    """How far a joint turns from sample to sample at most [rad]."""
    return float(np.abs(np.diff(state.q, axis=0)).max())
