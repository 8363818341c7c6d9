"""Strategy `sqp`: the ladder's paths, refined continuously over all free variables, in windows that overlap."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from planner.base.arrays import Array
from planner.base.geometry import TURN
from planner.base.processes import MANY, Job, cores, in_halves, in_turn, of_each
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem.settings import ResolveSpec
from planner.resolve.by_nozzle import with_each_nozzle
from planner.resolve.drawn import SLIGHT
from planner.resolve.guides import runs_backwards, stacks_of, zeros_apart
from planner.resolve.joint_path import MARGIN, JointPath, choose_turns
from planner.resolve.ladder import ladder
from planner.resolve.own_terms import Own
from planner.resolve.quadratic import solve_qp
from planner.resolve.refine import QPSolver, bounded_cones, calmed, evaluate, evaluate_samples, refine_stretch
from planner.resolve.segment import HOLDER, ROLL, ROOM, TILT, Model, PathSegment, PathState, Term
from planner.resolve.splines import LEAST_SAMPLES, Basis, Clock, basis_over, clock_of, knots_along
from planner.resolve.terms import model_of, terms_of
from planner.toolpath.task import Cones, NozzleTask

Improve = Callable[[Model, PathSegment, PathState], PathState]  # to a state that costs no more, on the same branch

# ----------------------------------------------------------------------------------------------------
# A long bead in overlapping windows of control values: every second one first, then those between them.

WINDOW = 240  # control values that move at once: with fewer, seams cost more; with more, cores wait for each other
OVERLAP = 40  # control values that a window shares with each neighbour
# For a bead whose refinement as a whole is rejected: so short that little is lost where a window stays unrefined.
SHORT_WINDOW, SHORT_OVERLAP = 24, 5


@dataclass(frozen=True)
class SplinePath:
    """A path as splines: its task, clock and basis, control values c (k, m) and those it was given with (anchor),
    joints q (n, nj), and price [s]."""

    task: NozzleTask
    branch: int
    clock: Clock
    basis: Basis
    c: Array
    q: Array
    anchor: Array
    price: float


@dataclass(frozen=True)
class RefinedWindow:
    """A refined window: the states, before and after, over some samples and control values of a track."""

    samples: slice
    controls: slice
    before: PathState
    state: PathState


def windows(controls: int, *, short: bool = False) -> list[tuple[int, int]]:
    """Ranges of control values that move together; a window overlaps only the one before and the one after."""
    window, overlap = (SHORT_WINDOW, SHORT_OVERLAP) if short else (WINDOW, OVERLAP)
    if controls <= window + overlap:
        return [(0, controls)]
    stride = window - overlap
    count = -(-(controls - overlap) // stride)
    return [(k * stride, min(k * stride + window, controls)) for k in range(count)]


class Windowed:
    """A track whose windows are refined by several threads with a model: which may begin, and what each begins with.

    A window between two others waits for just those two, so the result does not depend on the threads.
    """

    def __init__(self, model: Model, track: SplinePath, *, short: bool = False) -> None:
        self.model = model
        self.track = track
        self.short = short
        self.edges = windows(track.basis.controls, short=short)
        self._pieces: dict[int, RefinedWindow | None] = {}
        self._lock = Lock()

    @property
    def first(self) -> range:
        """Numbers of the windows that may begin at once."""
        return range(0, len(self.edges), 2)

    def before(self, k: int) -> SplinePath:
        """The track that window k is refined on."""
        return self._with(() if k % 2 == 0 else (k - 1, k + 1))

    def done(self, k: int, piece: RefinedWindow | None) -> tuple[list[int], bool]:
        """Take a refined window, or None if there was nothing to refine; returns the windows that may begin now, and
        whether this was the last one."""
        n = len(self.edges)
        with self._lock:
            self._pieces[k] = piece
            between = [j for j in (k - 1, k + 1) if j % 2 and 0 < j < n]
            ready = [j for j in between if j - 1 in self._pieces and (j + 1 in self._pieces or j + 1 == n)]
            return ready, len(self._pieces) == n

    def after(self) -> SplinePath:
        """The track with all windows in their places."""
        return self._with((*self.first, *range(1, len(self.edges), 2)))

    def _with(self, numbers: Iterable[int]) -> SplinePath:
        c, q = self.track.c.copy(), self.track.q.copy()
        for piece in filter(None, (self._pieces.get(k) for k in numbers)):
            c[piece.controls], q[piece.samples] = piece.state.c, piece.state.q
        return replace(self.track, c=c, q=q)


# ----------------------------------------------------------------------------------------------------
# Strategy `sqp`: the ladder's paths, refined continuously over all free variables.

SAMPLES_PER_CONTROL = 4  # at least: samples must resolve the motion between control values
_PAD = 4  # samples on each side of a window that its derivatives depend on
_WORTH_IT = 5e-3  # share of the price that refining in short windows must be able to save
BEYOND = 8e-4  # rad beyond a cone from which a plan may fail verification, which allows 0.05 degrees
_NARROWER = 1.5  # ranges are narrowed by this multiple of the joints' overshoot,
_MOST_NARROWED = 0.2  # but at most by this share of their width
_FLOOR = 1.0 + 1e-3  # × the least singular value given: the program may miss a bound by less than that


def sqp(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING
) -> tuple[JointPath, ...]:
    """The ladder's paths, their free variables refined until no step lowers the price (see `terms`).

    No path costs more than the ladder's. Layers follow each other: a bead starts from the refined one below it where
    that is cheaper. Raises Refusal as `ladder` does.
    """
    return refine_paths(cell, ladder(cell, tasks, settings, obstacles), settings, obstacles)


@with_each_nozzle
def refine_paths(
    cell: Cell,
    paths: Sequence[JointPath],
    settings: ResolveSpec,
    obstacles: Obstacles = NOTHING,
    own: Sequence[Term] = (),
) -> tuple[JointPath, ...]:
    """Refine every path: beads that lie on each other one after another, all others in parallel.

    own: a user's own terms, which join those with the settings' weights
    """
    model = model_of(cell, obstacles, terms_of(settings.weights, own))
    given = given_prices(model, paths, settings)
    return choose_turns(cell, refine_beads(cell, model, paths, settings, given, sigma_floor(given, settings)))


def refine_beads(
    cell: Cell,
    model: Model,
    paths: Sequence[JointPath],
    settings: ResolveSpec,
    given: dict[int, Priced],
    floor: float,
    improve: Improve | None = None,
) -> list[JointPath]:
    """Refine paths with the prices of `given_prices` and the floor of `sigma_floor`; turns are still to be chosen.

    improve: refines a window; if not given, by quadratic programs with the settings' solver

    A bead depends only on those beneath it. One that cannot be accepted as a whole is refined again: with narrower
    ranges for joints that would leave theirs before they come to rest after it, then in short windows, of which those
    that keep within bounds as well as before are accepted.
    """
    improved = improve or by_programs(qp_solver(settings.qp))
    done = list(paths)

    def start(chain: Sequence[int], below: SplinePath | None) -> Sequence[Job]:
        bead = Windowed(model, start_track(model, settings.knot, floor, paths[chain[0]], below))
        return [partial(refine, chain, bead, k) for k in bead.first]

    def refine(chain: Sequence[int], bead: Windowed, k: int) -> Sequence[Job]:
        i, *above = chain
        piece = refine_window(bead.model, floor, bead.before(k), bead.edges[k], improved)
        if piece is not None and bead.short and not _keeps(cell, model, bead.track, piece, floor):
            piece = None
        ready, last = bead.done(k, piece)
        if not last:
            return [partial(refine, chain, bead, j) for j in ready]
        return [partial(start, above, bead.after())] * bool(above) + [partial(keep, i, bead)]

    def keep(i: int, bead: Windowed) -> Sequence[Job]:
        track = bead.after()
        done[i], missed = judged(cell, paths[i], given[i], track, floor, model)
        if bead.short or missed < _WORTH_IT * given[i].price:
            return []
        over = _overshoots(cell, track.task, slice(0, len(track.task)), track.q)
        if (over > 0.0).any() and bead.model is model:
            again = Windowed(_narrowed(model, over), bead.track)
        else:
            again = Windowed(model, bead.track, short=True)
            if len(again.edges) == 1:
                return []
        return [partial(refine, [i], again, k) for k in again.first]

    chains = _chains(paths, given)

    def part(first: int, last: int) -> dict[int, JointPath]:
        in_turn([partial(start, chain, None) for chain in chains[first:last]])
        return {i: done[i] for chain in chains[first:last] for i in chain}

    # threads that refine short beads wait for each other's Python code
    for found in in_halves(part, len(chains), worth_a_copy(model, len(chains))):
        for i, path in found.items():
            done[i] = replace(path, task=paths[i].task)  # one object per task, whichever process it comes from
    return done


def worth_a_copy(model: Model, count: int) -> bool:
    """Whether so many beads are worth a copy of this process; never with a user's own terms: their libraries may hang
    there, and whatever they record would be lost."""
    return count >= MANY and not any(isinstance(term, Own) for term in model.terms)


def qp_solver(name: str) -> QPSolver:
    """The solver of quadratic programs that the settings name."""
    if name == "osqp":
        from planner.resolve.reference.osqp import solve_with_osqp

        return solve_with_osqp
    return solve_qp


def by_programs(solver: QPSolver) -> Improve:
    """Refinement of a window by quadratic programs that this solver solves."""
    return lambda model, stretch, state: refine_stretch(model, *calmed(model, stretch, state), solver)


def given_prices(model: Model, paths: Sequence[JointPath], settings: ResolveSpec) -> dict[int, Priced]:
    """What paths that are long enough to be refined cost as they are, by their index."""
    long_enough = [i for i, path in enumerate(paths) if len(path.task) >= LEAST_SAMPLES]

    def price(i: int) -> Priced:
        return given_price(model, paths[i], settings.min_sigma)

    if worth_a_copy(model, len(long_enough)):
        return dict(zip(long_enough, of_each(price, long_enough), strict=True))
    with ThreadPoolExecutor(cores()) as pool:
        return dict(zip(long_enough, pool.map(price, long_enough), strict=True))


def sigma_floor(given: dict[int, Priced], settings: ResolveSpec) -> float:
    """The least singular value that refined paths must keep, from the result of `given_prices`."""
    return _FLOOR * max(settings.min_sigma, min((path.sigma for path in given.values()), default=0.0))


def judged(
    cell: Cell, path: JointPath, given: Priced, track: SplinePath, floor: float, model: Model
) -> tuple[JointPath, float]:
    """A refined track as a path if it costs less than the given path and is as well within bounds, else the given path.

    A track within the cones replaces a path that is not, at any price. Also returns what the track would have saved [s]
    if it is cheaper but less well within bounds, else 0. model: the one it was refined with
    """
    if not np.isfinite(track.price):
        return path, 0.0
    refined = path_of(cell, track)
    least = _least_margin(refined, model.obstacles)
    # a path with room everywhere pays nothing for clearance
    cost = given_price(replace(model, obstacles=NOTHING) if least >= ROOM else model, refined, floor)
    keeps = cost.sigma >= min(floor / _FLOOR, given.sigma) and _within(cell, refined.q)
    was, now = (_overshoots(cell, path.task, slice(0, len(path.task)), each.q).max() for each in (path, refined))
    keeps = keeps and now <= max(was, 0.0)
    # cones, too, are only priced in the program
    keeps = keeps and cost.beyond <= max(given.beyond, 0.0)
    keeps = keeps and (least >= -SLIGHT or least >= _least_margin(path, model.obstacles))
    # a path that leans too far to be printed is no bargain
    repaired = given.beyond > BEYOND and cost.beyond <= 0.0 and np.isfinite(cost.price)
    better = cost.price < given.price or repaired
    if keeps and better:
        return refined, 0.0
    return path, given.price - cost.price if better else 0.0


def _keeps(cell: Cell, model: Model, track: SplinePath, piece: RefinedWindow, floor: float) -> bool:
    """Whether a refined window is as well within bounds as before: singular value, cones, ranges, clearance."""
    task, before, after = track.task, piece.before, piece.state
    at = np.arange(piece.samples.start, piece.samples.stop)
    laid = (at >= task.first) & (at <= task.last)
    if laid.any():
        half = bounded_cones(task.cones)[1]
        was, now = (np.hypot(*np.moveaxis(each.lean[laid], 2, 0)) - half for each in (before, after))
        if now.max(initial=-np.inf) > max(was.max(initial=-np.inf), 0.0):
            return False
        if after.sigma[laid].min() < min(floor / _FLOOR, before.sigma[laid].min()):
            return False
    moments = task.moments[piece.samples]
    least = _least_of(after.q, moments, task, model.obstacles)
    as_clear = least >= -SLIGHT or least >= _least_of(before.q, moments, task, model.obstacles)
    overshoots = [_overshoots(cell, task, piece.samples, each.q).max() for each in (before, after)]
    return as_clear and _within(cell, after.q) and overshoots[1] <= max(overshoots[0], 0.0)


def _least_margin(path: JointPath, obstacles: Obstacles) -> float:
    """The least clearance of a path beyond what is needed [m], if below ROOM."""
    return _least_of(path.q, path.task.moments, path.task, obstacles)


def _least_of(q: Array, moments: Array, task: NozzleTask, obstacles: Obstacles) -> float:
    # bodies that are round about the nozzle's axis are as near to the part in all upright paths of a task
    if task.cones.tilt == 0.0:
        obstacles = obstacles.but_round_on_part
    return float(obstacles.margins(q, moments, ROOM)[0].min())


def _within(cell: Cell, q: Array) -> bool:
    """Whether joints (n, nj) keep to their ranges, between samples too: in the program, ranges are only priced."""
    peak = np.zeros_like(q)  # how far beyond a sample a parabola through it and its neighbours may reach
    peak[1:-1] = np.abs(np.diff(q, n=2, axis=0)) / 8.0
    low, high = cell.limits.q_min + MARGIN, cell.limits.q_max - MARGIN
    return bool(((q - peak >= low) & (q + peak <= high)).all())


def _overshoots(cell: Cell, task: NozzleTask, samples: slice, q: Array) -> Array:
    """How far [rad, m] each joint (nj) would leave its range in starting before the task or coming to rest after it.

    Beads are begun and left in motion. Only those ends of the task count that are among the samples. Joints with values
    that are not positive stay within their range.
    """
    limits, over = cell.limits, np.full(q.shape[1], -np.inf)
    for end, inner in ((0, 1), (len(task) - 1, len(task) - 2)):
        if not samples.start <= min(end, inner) or not max(end, inner) < samples.stop:
            continue
        here, within = q[end - samples.start], q[inner - samples.start]
        v = (here - within) / abs(task.s[end] - task.s[inner]) * task.speed  # out of the task
        way = v**2 / (2.0 * limits.acceleration) + np.abs(v) * limits.acceleration / (2.0 * limits.jerk)
        over = np.maximum(over, np.where(v > 0.0, here + way - limits.q_max, limits.q_min - here + way))
    return over


def _narrowed(model: Model, over: Array) -> Model:
    """A model with narrower ranges for joints that overshoot theirs by `over` (nj) [rad, m]."""
    room = np.minimum(_NARROWER * np.maximum(over, 0.0), _MOST_NARROWED * (model.high - model.low))
    return replace(model, low=model.low + room, high=model.high - room)


def _chains(paths: Sequence[JointPath], indices: Container[int]) -> list[list[int]]:
    """These indices, grouped by beads that lie on each other, from the bottom up."""
    stacks = stacks_of([path.task for path in paths])
    return sorted(filter(None, ([i for i in stack if i in indices] for stack in stacks)))


def free_variables(model: Model, path: JointPath) -> Array:
    """z (n, columns) of a path: roll, tilt, holder joints, given arm joints."""
    z = np.empty((len(path.task), model.columns))
    z[:, ROLL] = path.roll
    z[:, list(TILT)] = path.tilt
    holder = len(model.low) - model.arm
    z[:, HOLDER : HOLDER + holder] = path.q[:, model.arm :]
    z[:, HOLDER + holder :] = path.q[:, model.given]
    return z


def whole(task: NozzleTask, clock: Clock, basis: Basis, anchor: Array) -> PathSegment:
    """The stretch of a whole task."""
    deposits = np.zeros(len(task))
    deposits[task.first : task.last + 1] = 1.0
    hold = np.zeros(basis.controls)
    hold[[0, -1]] = 1.0
    normals = np.array(task.normals)  # read-only arrays are another type, for which `follow` would be compiled again
    return PathSegment(
        task.tip, task.frames, normals, task.cones, clock.step, deposits, clock.centre, clock.D,
        basis.first, basis.B, np.ones(basis.controls), anchor, hold, task.moments,
    )  # fmt: skip


class Priced(NamedTuple):
    """What a path costs: its price [s]; during deposition, its least singular value, its greatest lean beyond the cones
    [rad], negative within them, and the time lost [s]."""

    price: float
    sigma: float
    beyond: float
    lost: float = 0.0


def given_price(model: Model, path: JointPath, least_sigma: float) -> Priced:
    """What a path costs as it is; infinite where the kernels cannot follow it."""
    clock = clock_of(path.task.s / path.task.speed)
    stretch = whole(path.task, clock, basis_over(clock, np.array([0.0, 1.0])), np.zeros((2, 0)))
    state = evaluate_samples(model, stretch, np.zeros((2, 0)), free_variables(model, path), path.q, least_sigma)
    if state is None:
        return Priced(np.inf, 0.0, np.inf, np.inf)
    laid = stretch.deposits > 0.0
    over = np.hypot(state.lean[laid, :, 0], state.lean[laid, :, 1]) - bounded_cones(path.task.cones)[1]
    lost = float((stretch.step * stretch.deposits) @ state.slack)
    return Priced(state.price, float(state.sigma[laid].min()), float(over.max(initial=-np.inf)), lost)


def start_track(model: Model, knot: float, floor: float, path: JointPath, below: SplinePath | None) -> SplinePath:
    """The path as splines, or the refined path of the bead below it on this task, whichever costs less."""
    task = path.task
    n = len(task)
    clock = clock_of(task.s / task.speed)
    basis = basis_over(clock, knots_along(task, knot, SAMPLES_PER_CONTROL))
    c = fit(basis, free_variables(model, path)[:, model.active(task.cones)])
    stretch = whole(task, clock, basis, c)
    if below is None or below.branch != path.branch or below.c.shape != c.shape:
        # there is nothing to compare with: clearance does not count
        model, below = replace(model, obstacles=NOTHING), None
    best = evaluate(model, stretch, c, path.q, floor)
    if below is not None:
        backwards = runs_backwards(task, below.task)
        flip = slice(None, None, -1 if backwards else 1)
        lower = _counted_from(below.c[flip], zeros_apart(task, below.task, backwards), task.cones)
        near = below.q[flip][np.round(np.linspace(0, len(below.q) - 1, n)).astype(int)]
        turns = np.round((c[0] - lower[0]) / TURN) * TURN  # chosen for each bead separately
        other = evaluate(model, stretch, lower + turns, near, floor)
        if other is not None and (best is None or other.price < best.price):
            best = other
    if best is None:
        return SplinePath(task, path.branch, clock, basis, c, path.q, c, np.inf)
    return SplinePath(task, path.branch, clock, basis, best.c, best.q, c, best.price)


def _counted_from(c: Array, back: float, cones: Cones) -> Array:
    """Control values (k, m) for the same nozzle, with roll and tilt counted from a zero `back` [rad] earlier."""
    out = c.copy()
    out[:, ROLL] += back
    if cones.tilt > 0.0:
        cosine, sine = np.cos(back), np.sin(back)
        out[:, TILT] = c[:, TILT] @ np.array([[cosine, sine], [-sine, cosine]])
    return out


def fit(basis: Basis, values: Array) -> Array:
    """Control values (k, m) whose splines are nearest to values (n, m), in the least-squares sense."""
    width = basis.B.shape[2]
    N, rhs = np.zeros((width, basis.controls)), np.zeros((basis.controls, values.shape[1]))
    for e in range(width):
        np.add.at(rhs, basis.first + e, basis.B[:, 0, e, None] * values)
        for f in range(e, width):
            np.add.at(N[f - e], basis.first + e, basis.B[:, 0, e] * basis.B[:, 0, f])
    return np.ascontiguousarray(solveh_banded(N, rhs, lower=True))


def refine_window(
    model: Model, floor: float, track: SplinePath, window: tuple[int, int], improve: Improve
) -> RefinedWindow | None:
    """Refine the control values of a window, the others held; None where the track itself cannot be followed."""
    if not np.isfinite(track.price):
        return None
    k0, k1 = window
    first, width = track.basis.first, track.basis.B.shape[2]
    n = len(first)
    i0, i1 = int(np.searchsorted(first, k0 - width, side="right")), int(np.searchsorted(first, k1, side="left"))
    a, b = max(i0 - _PAD, 0), min(i1 + _PAD, n)
    samples, controls = slice(a, b), slice(int(first[a]), int(first[b - 1]) + width)
    all_of_it = whole(track.task, track.clock, track.basis, track.anchor)
    step, deposits = all_of_it.step[samples].copy(), all_of_it.deposits[samples].copy()
    for edge, inner in ((slice(0, 2), a > 0), (slice(b - a - 2, b - a), b < n)):
        if inner:  # their stencils reach beyond the window
            step[edge] = deposits[edge] = 0.0
    free = np.zeros(controls.stop - controls.start)
    free[k0 - controls.start : k1 - controls.start] = 1.0
    stretch = PathSegment(
        all_of_it.tip[samples], all_of_it.frames[samples], all_of_it.normals[samples], all_of_it.cones, step, deposits,
        np.clip(track.clock.centre[samples] - a, 2, b - a - 3), track.clock.D[samples],
        first[samples] - controls.start, track.basis.B[samples], free,
        track.anchor[controls], all_of_it.hold[controls], all_of_it.now[samples],
    )  # fmt: skip
    state = evaluate(model, stretch, track.c[controls], track.q[samples], floor)
    if state is None:
        return None
    return RefinedWindow(samples, controls, state, improve(model, stretch, state))


def path_of(cell: Cell, track: SplinePath) -> JointPath:
    """The joint path of a track."""
    model = model_of(cell)
    z = np.zeros((len(track.task), model.columns))
    z[:, model.active(track.task.cones)] = track.basis.values(track.c)
    return JointPath(track.task, z[:, ROLL], z[:, list(TILT)], track.q, track.branch)
