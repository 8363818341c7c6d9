"""Strategy `ladder`: dynamic programming over roll, holder angle and branch, coarse guides first, then dense."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import Refusal
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem.settings import ResolveSpec
from planner.resolve.infeasible import refuse_collision, refuse_rung
from planner.resolve.joint_path import JointPath, SampledTasks, choose_turns, postures, sample_tasks, spread, upright
from planner.resolve.nodes import Grid, Nodes, evaluate, full_grid, nodes_to_fill
from planner.resolve.prices import TRAVEL_PRICE
from planner.resolve.reach import CLEAR_ROOM
from planner.resolve.search import LadderRoute, Route, angles_along, best_route, joint_limits
from planner.resolve.splines import NARROW
from planner.resolve.table_first import ARM_SHARES, slowed, upright_table
from planner.toolpath.task import NozzleTask

# ----------------------------------------------------------------------------------------------------
# What the ways from and to home cost, for each node at which a print could start or end.

_LOOKS = 9  # postures along a way, by which the tip's way is measured


def home_travel_costs(cell: Cell, tasks: Sequence[NozzleTask], nodes: Nodes, share: float = 1.0) -> tuple[Array, Array]:
    """Prices [s] (rolls, holders, c) of the ways from home to the first rung's nodes, and from the last one's home.

    The holder rests meanwhile. share: of the print that these nodes stand for, if they are those of some of its beads.
    """
    speed = tasks[0].travel_speed
    return (
        share * TRAVEL_PRICE * _times(cell, nodes, 0, speed),
        share * TRAVEL_PRICE * _times(cell, nodes, -1, speed),
    )


def _times(cell: Cell, nodes: Nodes, rung: int, speed: float) -> Array:
    """Time [s] (rolls, holders, c) of the way between home and a rung's nodes, all joints together: the slowest joint's
    from rest to rest, or the tip's at the speed [m/s] that it may have; 0 where there is no posture."""
    v, a, wraps = joint_limits(nodes, cell.limits)
    there = np.isfinite(nodes.price[rung])
    home = cell.home[: len(wraps)]
    way = nodes.q[rung][there].astype(float) - home
    way -= np.where(wraps, 2.0 * np.pi * np.round(way / (2.0 * np.pi)), 0.0)
    v, a, far = v[:-1], a[:-1], np.abs(way)
    by_joints = np.where(far * a < v * v, 2.0 * np.sqrt(far / a), far / v + v / a).max(axis=1, initial=0.0)
    shares = np.linspace(0.0, 1.0, _LOOKS)[:, None]
    postures = home + shares[None] * way[:, None]
    tips = (cell.arm.poses(postures.reshape(-1, len(home))) @ cell.T_flange_nozzle)[:, :3, 3].reshape(-1, _LOOKS, 3)
    by_tip = np.linalg.norm(np.diff(tips, axis=1), axis=2).sum(axis=1) / speed
    times = np.zeros(there.shape)
    times[there] = np.maximum(by_joints, by_tip)
    return times


# ----------------------------------------------------------------------------------------------------
# How far a ladder's route can be from the best one on its whole fine grid: a price that no route can go below.

PIECE = 24  # rungs that are searched at once: what the whole fine grid of so many takes still fits in memory


def lower_bound(
    cell: Cell, found: LadderRoute, min_sigma: float, piece: int = PIECE, obstacles: Obstacles = NOTHING
) -> float:
    """A lower bound [s] of the price of any route on the whole grid that has the found route's steps.

    Every task is cut into pieces of at most `piece` rungs. Each is searched exactly over all rolls, all angles of
    the swept joint and all branches; edges between pieces and travel between tasks, whose prices are never
    negative, are left out. Other chosen joints are held as in the found route: the bound is for that choice only.
    """
    demand, grid = found.demand, found.nodes.grid
    swept = grid.swept if cell.chosen else None
    total = 0.0
    for k in range(len(demand.task_rungs) - 1):
        rungs = demand.rungs_of(k)
        count = int(np.ceil((rungs.stop - rungs.start) / piece))
        for part in np.array_split(np.arange(rungs.start, rungs.stop), count):
            few = demand.only(part, [0, len(part)])
            held = None if grid.held is None else grid.held[part]
            whole = full_grid(few, grid.roll_step, grid.holder_step, swept is not None, swept, held)
            route, _ = best_route(evaluate(cell, few, whole, min_sigma, obstacles), few, cell.limits)
            if route is None:  # rounding alone: the found route lies on this grid
                return 0.0
            total += route.price
    return total


# ----------------------------------------------------------------------------------------------------
# The best clear route, for which clearance is only looked at where a route leads.
#
# Whether a posture is clear costs several times what all else about a node costs, and most routes lead past everything.
# So routes are searched as if nothing were in the way; around what blocks them nodes are looked at, and the search is
# done again. A route that is found clear so is the one that a search among clear nodes alone would find.

_REACH = 4  # rungs to each side of a blocked one that are looked at first; four times as many each time after
_WIDER = 4


class ClearSearch:
    """Searches on one grid. `nodes` are those of `evaluate` as far as a search has looked at their clearance."""

    def __init__(
        self, cell: Cell, demand: SampledTasks, grid: Grid, min_sigma: float, obstacles: Obstacles = NOTHING
    ) -> None:
        self._cell, self._demand = cell, demand
        self._obstacles = obstacles.but_head_on_part if demand.cones.tilt > 0.0 else obstacles
        self.nodes, self._fill = nodes_to_fill(cell, demand, grid, min_sigma)
        r = len(demand.rung)
        self._fill(np.arange(r), NOTHING)
        self._looked: Flags = np.full(r, not obstacles.any)

    def best(self, demand: SampledTasks, home: tuple[Array, Array] | None = None) -> tuple[Route | None, int]:
        """As `best_route` for this demand, or one that differs from the search's in time only, on clear nodes."""
        reach = _REACH
        while True:
            route, stuck = best_route(self.nodes, demand, self._cell.limits, home)
            if route is None and self._looked.all():
                return None, stuck
            if route is None:
                self.look(np.arange(len(self._looked)))
                continue
            blocked = self._blocked(route)
            if not len(blocked):
                return route, stuck
            around = (blocked[:, None] + np.arange(-reach, reach + 1)).ravel()
            self.look(np.unique(around[(around >= 0) & (around < len(self._looked))]))
            reach *= _WIDER

    def look(self, rungs: Ints) -> Nodes:
        """Take what is not clear at some rungs out of the nodes, which come back."""
        rungs = rungs[~self._looked[rungs]]
        self._fill(rungs, self._obstacles)
        self._looked[rungs] = True
        return self.nodes

    def _blocked(self, route: Route) -> Ints:
        """Rungs not looked at yet where a route's node, or the one that keeps to the angles before, is not clear."""
        grid, demand = self.nodes.grid, self._demand
        at = np.flatnonzero(~self._looked)
        before = np.where(np.isin(at, demand.task_rungs), at, np.maximum(at - 1, 0))
        column = np.argmax(grid.branch[at] == route.branch[at, None], axis=1)
        blocked = np.zeros(len(at), dtype=np.bool_)
        for angles_of in (at, before):
            roll, holder = route.roll[angles_of] - grid.roll_from[at], route.holder[angles_of] - grid.holder_from[at]
            if grid.periodic:
                roll, holder = roll % grid.rolls, holder % grid.holders
            q = self.nodes.q[at, roll, holder, column].astype(float)
            chosen = grid.chosen(len(demand.rung), len(self._cell.chosen))[at]
            if self._cell.chosen and grid.swept is not None:
                chosen[:, grid.swept] = route.holder[angles_of] * grid.holder_step
            now = demand.now[demand.rung[at]]
            whole = np.hstack([q, chosen[:, : len(self._cell.holder)]])
            blocked |= self._obstacles.margins(whole, now, 0.0, CLEAR_ROOM)[0] < 0.0
        return at[blocked]


# ----------------------------------------------------------------------------------------------------
# Strategy `ladder`: dynamic programming over roll, holder angle and branch, coarse guides first, then dense.

# Of the second search: coarse steps are divided by the first number, and the guide may be left by the second one of
# those to each side in roll, by the third one in the chosen joint. A guide that turns by a coarse step a rung is too
# quick for dense steps: wider in roll, which is what turns quickly, then in both, then coarse.
CORRIDORS = ((3, 4, 4), (3, 12, 4), (3, 12, 12), (1, 1, 1))
_SPARSE = 5  # times as far as the settings' rungs stand those of the first look at several chosen joints
_ROUGH = 2.0  # times the settings' steps in that first look, and where the grid would be too large
_MOST_NODES = 3e6  # of the guide's grid: 100 MB, and a second; the second search is finer anyway
_FEW = 50  # times as far stand those at which postures of a holder of many joints are tried, if home does not do
_DRAWN = 400  # of those postures
_LATTICE = 9  # angles at which a chosen joint is held there, at most


def ladder(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING
) -> tuple[JointPath, ...]:
    """The best joint paths on the grid, over all beads together, travel included, and clear of obstacles.

    A first search over the whole coarse grid guides a second one, three times as fine, in a corridor around
    it. Beads that repeat from layer to layer share the guide of the first of them.
    Raises Refusal where a bead cannot be followed.
    """
    refusal: Refusal | None = None
    for found in _routes(cell, tasks, settings, obstacles):
        try:
            paths = paths_of(cell, tasks, found)
            refuse_collision(cell, paths, obstacles)
            return paths
        except Refusal as between_rungs:  # what the rungs allow, the path between them may not: try the next corridor
            refusal = refusal or between_rungs
    if refusal is None:
        raise RuntimeError("a search without routes must refuse by itself")
    raise refusal


def ladder_route(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING
) -> LadderRoute:
    """The route that `ladder` tries first to make its paths of. Raises Refusal where there is none."""
    return next(_routes(cell, tasks, settings, obstacles))


def _routes(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles
) -> Iterator[LadderRoute]:
    """Dense routes, one for each corridor that has any; Refusal where none has."""
    guides = first_of_each_name(tasks)
    guide = guide_route(cell, guides, settings, obstacles, len(guides) / len(tasks))
    guide_of = {task.name: i for i, task in enumerate(guides)}
    all_demand = sample_tasks(tasks, settings.rung)
    any_route = False
    one_angle = guide.nodes.grid.holders == 1
    for corridor in dict.fromkeys((refine, roll, 0 if one_angle else holder) for refine, roll, holder in CORRIDORS):
        grid = _corridor(cell, tasks, all_demand, guides, guide, guide_of, *corridor)
        dense = ClearSearch(cell, all_demand, grid, settings.min_sigma, obstacles)
        home = home_travel_costs(cell, tasks, dense.nodes)
        demands: Iterable[SampledTasks] = [all_demand]
        if grid.held is not None and grid.swept is None:
            demands = map(partial(slowed, cell, all_demand, grid.held), ARM_SHARES)
        for demand in demands:
            best, stuck = dense.best(demand, home)
            if best is not None:
                any_route = True
                yield LadderRoute(demand, dense.nodes, best)
                break
    if not any_route:
        refuse_rung(cell, tasks, all_demand, dense.nodes, stuck, settings.min_sigma, obstacles)


def guide_route(
    cell: Cell, guides: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING, share: float = 1.0
) -> LadderRoute:
    """The best route on the coarse grid; share: of the print's beads that are guides. Raises Refusal where there is none.

    With several chosen joints a full grid would not fit. One of them at a time is searched together with roll and
    branch: first the one next to the part, on sparse rungs, for a lattice of angles at which the others rest; then
    each other one while the rest follow the path found before. Where the layer must stay nearly upright, the table's path is
    found first, and roll and branch alone are searched with it.
    """
    k = len(cell.chosen)
    if k < 2:
        demand, grid = _coarse_grid(cell, guides, settings, _MOST_NODES)
        search = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
        route, stuck = search.best(demand, home_travel_costs(cell, guides, search.nodes, share))
        if route is None:
            refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles)
        return LadderRoute(demand, search.nodes, route)
    demand = sample_tasks(guides, settings.rung)
    if len(cell.holder) > 1 and demand.cones.layer_gravity < NARROW:
        return _after_table(cell, guides, demand, settings, obstacles)
    found = _first_look(cell, guides, settings, obstacles)
    first = found.nodes.grid.swept
    for swept in [*(j for j in range(k) if j != first), first]:
        held = _between_rungs(found, demand, k)
        grid = full_grid(demand, settings.roll_step, settings.table_step, True, swept, held)
        search = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
        route, stuck = search.best(demand)
        if route is not None:
            found = LadderRoute(demand, search.nodes, route)
    # a joint that finds no way alone leaves the path as it was; one of them must find one
    if found.demand is not demand:
        refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles)
    return found


def _after_table(
    cell: Cell, guides: Sequence[NozzleTask], demand: SampledTasks, settings: ResolveSpec, obstacles: Obstacles
) -> LadderRoute:
    """The best route of roll and branch while the table follows a path that holds the layer upright."""
    held = upright_table(cell, guides, demand)
    grid = full_grid(demand, settings.roll_step, 1.0, False, None, held)
    search = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
    for share in ARM_SHARES:
        slow = slowed(cell, demand, held, share)
        route, stuck = search.best(slow)
        if route is not None:
            return LadderRoute(slow, search.nodes, route)
    refuse_rung(cell, guides, slow, search.nodes, stuck, settings.min_sigma, obstacles)


def _first_look(cell: Cell, guides: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles) -> LadderRoute:
    """The best route on sparse rungs with all chosen joints but one at rest, at any angles of a lattice."""
    k, nh = len(cell.chosen), len(cell.holder)
    demand = sample_tasks(guides, _SPARSE * settings.rung)
    swept = max(nh - 1, 0)
    others = [j for j in range(k) if j != swept]
    home = cell.home[list(cell.chosen)]
    best: LadderRoute | None = None

    def search_at(rest: Array, demand: SampledTasks) -> ClearSearch:
        held = np.tile(home, (len(demand.rung), 1))
        held[:, others] = rest
        grid = full_grid(demand, _ROUGH * settings.roll_step, _ROUGH * settings.table_step, True, swept, held)
        return ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)

    lattice = [_rest_angles(cell, j, _ROUGH * settings.table_step, len(others)) for j in others]
    for rest in itertools.product(*lattice):
        search = search_at(np.array(rest), demand)
        route, stuck = search.best(demand)
        if route is not None and (best is None or route.price < best.route.price):
            best = LadderRoute(demand, search.nodes, route)
    if best is None and len(others) > 1:  # home does not do: look around it, at few rungs first
        few = sample_tasks(guides, _FEW * settings.rung)
        for rest in _around_home(cell, others):
            reached = search_at(rest, few).look(np.arange(len(few.rung)))
            if np.isfinite(reached.price).any(axis=(1, 2, 3)).all():
                elsewhere = search_at(rest, demand)
                route, _ = elsewhere.best(demand)
                if route is not None:
                    return LadderRoute(demand, elsewhere.nodes, route)
    if best is None:
        refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles)
    return best


def _around_home(cell: Cell, chosen: Sequence[int]) -> Array:
    """Angles (m, len(chosen)) of chosen joints, drawn ever further from home within their ranges."""
    joints = [cell.chosen[j] for j in chosen]
    home = cell.home[joints]
    low = np.maximum(cell.limits.q_min[joints], home - np.pi)
    high = np.minimum(cell.limits.q_max[joints], home + np.pi)
    drawn = np.random.default_rng(0).uniform(low, high, (_DRAWN, len(joints)))
    return home + np.linspace(0.0, 1.0, _DRAWN)[:, None] * (drawn - home)


def _rest_angles(cell: Cell, chosen: int, step: float, others: int) -> Array:
    """Angles at which a chosen joint may rest: a lattice over its range if it is the only one to rest, else home."""
    joint = cell.chosen[chosen]
    home = cell.home[joint]
    if others > 1:
        return np.array([home])
    low, high = max(cell.limits.q_min[joint], home - np.pi), min(cell.limits.q_max[joint], home + np.pi)
    around = home + step * np.arange(-_LATTICE // 2 + 1, _LATTICE // 2 + 1)
    return around[(around > low) & (around < high)]


def _between_rungs(found: LadderRoute, demand: SampledTasks, k: int) -> Array:
    """Angles (r, k) of the chosen joints of a route, at the rungs of another demand of the same tasks."""
    angles = found.chosen(k)
    out = np.empty((len(demand.rung), k))
    for i in range(len(demand.task_rungs) - 1):
        theirs, own = found.demand.rungs_of(i), demand.rungs_of(i)
        for j in range(k):
            out[own, j] = np.interp(demand.place[own], found.demand.place[theirs], angles[theirs, j])
    return out


def first_of_each_name(tasks: Sequence[NozzleTask]) -> list[NozzleTask]:
    """The first task of every name: those of the layers above repeat it."""
    seen: dict[str, NozzleTask] = {}
    for task in tasks:
        seen.setdefault(task.name, task)
    return list(seen.values())


def coarse_nodes(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    settings: ResolveSpec,
    most: float = np.inf,
    obstacles: Obstacles = NOTHING,
) -> tuple[SampledTasks, Nodes]:
    """The whole grid of the settings' steps at the settings' rungs, or of twice those steps if it has too many nodes.

    Of several chosen joints the one next to the part is tried, the others rest at home.
    """
    demand, grid = _coarse_grid(cell, tasks, settings, most)
    return demand, evaluate(cell, demand, grid, settings.min_sigma, obstacles)


def _coarse_grid(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, most: float = np.inf
) -> tuple[SampledTasks, Grid]:
    demand = sample_tasks(tasks, settings.rung)
    held = np.tile(cell.home[list(cell.chosen)], (len(demand.rung), 1))
    swept = max(len(cell.holder) - 1, 0)
    for rough in (1.0, _ROUGH):
        steps = rough * settings.roll_step, rough * settings.table_step
        grid = full_grid(demand, *steps, len(cell.chosen) > 0, swept, held)
        if len(demand.rung) * grid.rolls * grid.holders * grid.branch.shape[1] <= most:
            break
    return demand, grid


def _corridor(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    demand: SampledTasks,
    guides: Sequence[NozzleTask],
    guide: LadderRoute,
    guide_of: dict[str, int],
    refine: int,
    roll_room: int,
    holder_room: int,
) -> Grid:
    """A fine grid whose windows follow the guide route of the bead of the same name, either way round."""
    coarse, route = guide.nodes.grid, guide.route
    k = len(cell.chosen)
    chosen = guide.chosen(k)
    r = len(demand.rung)
    roll_from, holder_from = np.zeros(r, dtype=np.int64), np.zeros(r, dtype=np.int64)
    branch = np.zeros((r, 1), dtype=np.int64)
    held = np.zeros((r, k))
    for i, task in enumerate(tasks):
        g = guide_of[task.name]
        own, theirs = demand.rungs_of(i), guide.demand.rungs_of(g)
        backwards = runs_backwards(task, guides[g])
        flip = slice(None, None, -1 if backwards else 1)
        at, there = demand.place[own], guide.demand.place[theirs]
        there = 1.0 - there[::-1] if backwards else there
        for target, index, period, room in (
            (roll_from, route.roll, coarse.rolls, roll_room),
            (holder_from, route.holder, coarse.holders, holder_room),
        ):
            along = angles_along(coarse, index[theirs], period, 1.0)[flip]
            target[own] = np.round(refine * np.interp(at, there, along)).astype(np.int64) - room
        for j in range(k):
            held[own, j] = np.interp(at, there, chosen[theirs][flip, j])
        branch[own] = route.branch[theirs][0]
    if coarse.holders == 1:
        holder_from[:] = 0
    return Grid(
        coarse.roll_step / refine,
        coarse.holder_step / refine,
        roll_from,
        holder_from,
        2 * roll_room + 1,
        2 * holder_room + 1,
        False,
        branch,
        coarse.swept,
        held,
    )


def runs_backwards(task: NozzleTask, guide: NozzleTask) -> bool:
    """Whether a task runs its guide's bead the other way (for a loop: turns the other way)."""
    here, there = task.tip[task.first : task.last], guide.tip[guide.first : guide.last]
    n = 64
    a = here[np.linspace(0, len(here) - 1, n).astype(int)]
    b = there[np.linspace(0, len(there) - 1, n).astype(int)]
    return bool(((a - b[::-1]) ** 2).sum() < ((a - b) ** 2).sum())


def paths_of(cell: Cell, tasks: Sequence[NozzleTask], found: LadderRoute) -> tuple[JointPath, ...]:
    """Smooth joint paths along a route: its grid values control splines of roll and chosen joints."""
    paths = []
    grid, route = found.nodes.grid, found.route
    chosen = found.chosen(len(cell.chosen))
    for i, task in enumerate(tasks):
        rungs = found.demand.rungs_of(i)
        n, places = len(task), found.demand.place[rungs]
        roll = spread(angles_along(grid, route.roll[rungs], grid.rolls, grid.roll_step), n, places)
        branch = int(route.branch[rungs][0])
        q = postures(cell, task, roll, spread(chosen[rungs], n, places), branch)
        paths.append(JointPath(task, roll, upright(task), q, branch))
    return choose_turns(cell, paths)
