"""Strategy `sqp`: the ladder's paths, refined continuously over all free variables, in windows that overlap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from planner.base.arrays import Array
from planner.base.processes import Job, cores, in_turn
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem.settings import ResolveSpec
from planner.resolve.infeasible import SLIGHT
from planner.resolve.joint_path import MARGIN, JointPath, choose_turns
from planner.resolve.ladder import ladder, runs_backwards
from planner.resolve.quadratic import solve_qp
from planner.resolve.refine import CONE_ROOM, QPSolver, calmed, evaluate, evaluate_samples, refine_stretch
from planner.resolve.segment import HOLDER, ROLL, ROOM, TILT, Model, PathSegment, PathState, model_of
from planner.resolve.splines import LEAST_SAMPLES, Basis, Clock, basis_over, clock_of, knots_along
from planner.toolpath.task import NozzleTask

# ----------------------------------------------------------------------------------------------------
# A long bead in windows of control values that overlap: each second one first, then those between them.

WINDOW = 240  # control values that move at once: fewer, and their seams cost more; more, and cores wait for each other
OVERLAP = 40  # of a window with each neighbour


@dataclass(frozen=True)
class SplinePath:
    """A path as splines: its task, clock and basis, control values c (k, m), where they
    were given (anchor), joints q (n, nj), and price [s]."""

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
    """A refined window: the state over some samples and control values of a track."""

    samples: slice
    controls: slice
    state: PathState


def windows(controls: int) -> list[tuple[int, int]]:
    """Ranges of control values that move together; each second one is apart from the others."""
    if controls <= WINDOW + OVERLAP:
        return [(0, controls)]
    stride = WINDOW - OVERLAP
    count = -(-(controls - OVERLAP) // stride)
    return [(k * stride, min(k * stride + WINDOW, controls)) for k in range(count)]


class Windowed:
    """A track whose windows are refined by several threads: which may begin, and what each begins with.

    A window that lies between two others waits for these alone, so what comes out does not depend on the threads.
    """

    def __init__(self, track: SplinePath) -> None:
        self._track = track
        self.edges = windows(track.basis.controls)
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
        """Take a refined window, or None where there is nothing to refine; windows that may begin now, and whether this
        was the last one."""
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
        c, q = self._track.c.copy(), self._track.q.copy()
        for piece in filter(None, (self._pieces.get(k) for k in numbers)):
            c[piece.controls], q[piece.samples] = piece.state.c, piece.state.q
        return replace(self._track, c=c, q=q)


# ----------------------------------------------------------------------------------------------------
# Strategy `sqp`: the ladder's paths, refined continuously over all free variables.

SAMPLES_PER_CONTROL = 4  # at least: what moves between control values must be resolved by the samples
_TURN = 2.0 * np.pi
_PAD = 4  # samples on both sides of a window that its derivatives look at
_FLOOR = 1.0 + 1e-3  # times the least singular value that was given: the program may miss a bound by less


def sqp(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING
) -> tuple[JointPath, ...]:
    """The ladder's paths, their free variables refined until no step lowers the price (see `price_kernels`).

    No path comes back that costs more than the ladder's. Layers follow each other: a bead starts from the
    refined one below it, where that is cheaper. Raises Refusal as `ladder` does.
    """
    return refine_paths(cell, ladder(cell, tasks, settings, obstacles), settings, obstacles)


def refine_paths(
    cell: Cell, paths: Sequence[JointPath], settings: ResolveSpec, obstacles: Obstacles = NOTHING
) -> tuple[JointPath, ...]:
    """Refine every path: beads that lie on each other in turn, all else that does not wait for others at the same time."""
    given = given_prices(model_of(cell, obstacles), paths, settings)
    return choose_turns(cell, refine_beads(cell, paths, settings, obstacles, given, sigma_floor(given, settings)))


def refine_beads(
    cell: Cell,
    paths: Sequence[JointPath],
    settings: ResolveSpec,
    obstacles: Obstacles,
    given: dict[int, Priced],
    floor: float,
) -> list[JointPath]:
    """Refine paths with the prices of `given_prices` down to a floor of `sigma_floor`; turns are still to be chosen.

    A bead does not depend on beads of other names.
    """
    model, solver = model_of(cell, obstacles), qp_solver(settings.qp)
    done = list(paths)

    def start(chain: Sequence[int], below: SplinePath | None) -> Sequence[Job]:
        bead = Windowed(start_track(model, settings.knot, floor, paths[chain[0]], below))
        return [partial(refine, chain, bead, k) for k in bead.first]

    def refine(chain: Sequence[int], bead: Windowed, k: int) -> Sequence[Job]:
        piece = _refine_window(model, floor, bead.before(k), bead.edges[k], solver)
        ready, last = bead.done(k, piece)
        if not last:
            return [partial(refine, chain, bead, j) for j in ready]
        i, *above = chain
        track = bead.after()
        return [partial(start, above, track)] * bool(above) + [partial(keep, i, track)]

    def keep(i: int, track: SplinePath) -> Sequence[Job]:
        done[i] = cheaper(cell, paths[i], given[i], track, floor, obstacles)
        return []

    in_turn([partial(start, chain, None) for chain in _chains(paths, given)])
    return done


def qp_solver(name: str) -> QPSolver:
    """The solver of quadratic programs that the settings name."""
    if name == "osqp":
        from planner.resolve.reference.osqp import solve_with_osqp

        return solve_with_osqp
    return solve_qp


def given_prices(model: Model, paths: Sequence[JointPath], settings: ResolveSpec) -> dict[int, Priced]:
    """What the paths that are long enough to be refined cost as they are, by their index."""
    long_enough = [i for i, path in enumerate(paths) if len(path.task) >= LEAST_SAMPLES]
    with ThreadPoolExecutor(cores()) as pool:
        prices = pool.map(lambda i: given_price(model, paths[i], settings.min_sigma), long_enough)
        return dict(zip(long_enough, prices, strict=True))


def sigma_floor(given: dict[int, Priced], settings: ResolveSpec) -> float:
    """The least singular value that refined paths must keep, from what `given_prices` says."""
    return _FLOOR * max(settings.min_sigma, min((path.sigma for path in given.values()), default=0.0))


def cheaper(
    cell: Cell,
    path: JointPath,
    given: Priced,
    track: SplinePath,
    floor: float,
    obstacles: Obstacles = NOTHING,
) -> JointPath:
    """A refined track as a path if it costs less than the path that was given and keeps what it kept, else that."""
    if not np.isfinite(track.price):
        return path
    refined = path_of(cell, track)
    least = _least_margin(refined, obstacles)
    # who has room everywhere lacks no clearance that would have a price
    cost = given_price(model_of(cell, NOTHING if least >= ROOM else obstacles), refined, floor)
    better = cost.price < given.price and cost.sigma >= min(floor / _FLOOR, given.sigma) and _within(cell, refined)
    # cones about gravity have but a price in the program, if a high one
    better = better and cost.beyond <= max(given.beyond, 0.0)
    as_clear = least >= -SLIGHT or least >= _least_margin(path, obstacles)
    return refined if better and as_clear else path


def _least_margin(path: JointPath, obstacles: Obstacles) -> float:
    """The least clearance of a path beyond what is needed [m], if below ROOM."""
    # what is round about the nozzle's axis is as near to the part in all upright paths of a task
    if path.task.cones.tilt == 0.0:
        obstacles = obstacles.but_round_on_part
    return float(obstacles.margins(path.q, path.task.moments, ROOM)[0].min())


def _within(cell: Cell, path: JointPath) -> bool:
    """Whether a path keeps to the joints' ranges and to its tilt: in the program both have a price, if a high one."""
    inside = (path.q >= cell.limits.q_min + MARGIN) & (path.q <= cell.limits.q_max - MARGIN)
    return bool(inside.all() and (np.hypot(*path.tilt.T) <= path.task.cones.tilt).all())


def _chains(paths: Sequence[JointPath], indices: Iterable[int]) -> list[list[int]]:
    """Indices of beads that lie on each other, from below: those of the same name."""
    chains: dict[str, list[int]] = {}
    for i in indices:
        chains.setdefault(paths[i].task.name, []).append(i)
    return list(chains.values())


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
    return PathSegment(
        task.tip, task.frames, task.cones, clock.step, deposits, clock.centre, clock.D,
        basis.first, basis.B, np.ones(basis.controls), anchor, hold, task.moments,
    )  # fmt: skip


class Priced(NamedTuple):
    """What a path costs: its price [s]; in deposition its least singular value, and how far it leans beyond the cones
    about gravity at most, negative within them [rad]."""

    price: float
    sigma: float
    beyond: float


def given_price(model: Model, path: JointPath, least_sigma: float) -> Priced:
    """What a path costs as it is; everything, where the kernels cannot follow it."""
    clock = clock_of(path.task.s / path.task.speed)
    stretch = whole(path.task, clock, basis_over(clock, np.array([0.0, 1.0])), np.zeros((2, 0)))
    state = evaluate_samples(model, stretch, np.zeros((2, 0)), free_variables(model, path), path.q, least_sigma)
    if state is None:
        return Priced(np.inf, 0.0, np.inf)
    laid = stretch.deposits > 0.0
    over = np.hypot(state.lean[laid, :, 0], state.lean[laid, :, 1]) - (state.cones + CONE_ROOM)
    return Priced(state.price, float(state.sigma[laid].min()), float(over.max(initial=-np.inf)))


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
        flip = slice(None, None, -1 if runs_backwards(task, below.task) else 1)
        near = below.q[flip][np.round(np.linspace(0, len(below.q) - 1, n)).astype(int)]
        turns = np.round((c[0] - below.c[flip][0]) / _TURN) * _TURN  # they were chosen for each bead
        other = evaluate(model, stretch, below.c[flip] + turns, near, floor)
        if other is not None and (best is None or other.price < best.price):
            best = other
    if best is None:
        return SplinePath(task, path.branch, clock, basis, c, path.q, c, np.inf)
    return SplinePath(task, path.branch, clock, basis, best.c, best.q, c, best.price)


def fit(basis: Basis, values: Array) -> Array:
    """Control values (k, m) whose splines are nearest to values (n, m), in the least-squares sense."""
    width = basis.B.shape[2]
    N, rhs = np.zeros((width, basis.controls)), np.zeros((basis.controls, values.shape[1]))
    for e in range(width):
        np.add.at(rhs, basis.first + e, basis.B[:, 0, e, None] * values)
        for f in range(e, width):
            np.add.at(N[f - e], basis.first + e, basis.B[:, 0, e] * basis.B[:, 0, f])
    return np.ascontiguousarray(solveh_banded(N, rhs, lower=True))


def _refine_window(
    model: Model, floor: float, track: SplinePath, window: tuple[int, int], solver: QPSolver = solve_qp
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
        if inner:  # their stencils reach out of the window
            step[edge] = deposits[edge] = 0.0
    free = np.zeros(controls.stop - controls.start)
    free[k0 - controls.start : k1 - controls.start] = 1.0
    stretch = PathSegment(
        all_of_it.tip[samples], all_of_it.frames[samples], all_of_it.cones, step, deposits,
        np.clip(track.clock.centre[samples] - a, 2, b - a - 3), track.clock.D[samples],
        first[samples] - controls.start, track.basis.B[samples], free,
        track.anchor[controls], all_of_it.hold[controls], all_of_it.now[samples],
    )  # fmt: skip
    state = evaluate(model, stretch, track.c[controls], track.q[samples], floor)
    if state is None:
        return None
    return RefinedWindow(samples, controls, refine_stretch(model, *calmed(stretch, state), floor, solver))


def path_of(cell: Cell, track: SplinePath) -> JointPath:
    """The joint path of a track."""
    model = model_of(cell)
    z = np.zeros((len(track.task), model.columns))
    z[:, model.active(track.task.cones)] = track.basis.values(track.c)
    return JointPath(track.task, z[:, ROLL], z[:, list(TILT)], track.q, track.branch)
