"""Strategy `ladder`: dynamic programming over roll, holder angle and branch, coarse guides first, then dense."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import Blocked, Refusal
from planner.base.geometry import TURN, wrap_angle
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.problem.settings import ResolveSpec
from planner.resolve.by_nozzle import nozzles_of, with_each_nozzle
from planner.resolve.guides import guides_of, runs_backwards, zeros_apart
from planner.resolve.infeasible import refuse_collision, refuse_rung
from planner.resolve.joint_path import (
    MARGIN,
    JointPath,
    SampledTasks,
    at_rest,
    choose_turns,
    gone_along,
    leaned_on_part,
    least_cone,
    postures,
    refuse_at,
    rolled,
    sample_tasks,
    spread,
    turned_from,
    upright,
)
from planner.resolve.nodes import Grid, Nodes, evaluate, full_grid, nodes_to_fill
from planner.resolve.prices import FAR, HOME_PRICE
from planner.resolve.reach import CLEAR_ROOM, grid_scale, looked_at
from planner.resolve.search import (
    LadderRoute,
    Route,
    angles_along,
    best_route,
    joint_limits,
    label_turns,
    may_be_counted,
    turns_counted,
)
from planner.resolve.table_path import BINDING, carried, table_path
from planner.toolpath.task import Cones, NozzleTask

# ----------------------------------------------------------------------------------------------------
# What the ways from and to home cost, for each node at which a print could start or end.

_LOOKS = 9  # postures along a way at which the tip's way is measured and checked for obstacles
_DETOUR = 1.2  # m added to the tip's way where something is in it: up, across and down


def home_travel_costs(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    nodes: Nodes,
    share: float = 1.0,
    obstacles: Obstacles = NOTHING,
    counted: Sequence[int] = (),
) -> tuple[Array, Array]:
    """Prices [s] (rolls, holders, c, labels) of the ways from home to the first rung's nodes and from the last's home.

    The holder rests meanwhile. share: of the print that these nodes stand for, if they cover only some of its beads
    counted: joints whose turns are counted, see `best_route`; the others take the shortest turn
    """
    price, speed = share * HOME_PRICE, tasks[0].travel_speed
    turns = label_turns(turns_counted(nodes, cell.limits, counted))
    ends = (0, float(tasks[0].moments[0])), (-1, float(tasks[-1].moments[-1]))
    out, back = (
        price * np.stack([_times(cell, nodes, rung, speed, now, obstacles, counted, own) for own in turns], axis=3)
        for rung, now in ends
    )
    return out, back


def _times(
    cell: Cell,
    nodes: Nodes,
    rung: int,
    speed: float,
    now: float,
    obstacles: Obstacles,
    counted: Sequence[int],
    turns: Ints,
) -> Array:
    """Time [s] (rolls, holders, c) of the way between home and a rung's nodes; 0 where there is no posture.

    All joints move together: the slowest one counts, from rest to rest, or the tip at its travel speed [m/s] if that
    takes longer, with a detour where something is in the way. turns: of the counted joints
    """
    v, a, wraps, *_ = joint_limits(nodes, cell.limits)
    there = np.isfinite(nodes.price[rung])
    home = cell.home[: len(wraps)]
    way = nodes.q[rung][there].astype(float) - home
    around = np.where(wraps, -TURN * np.round(way / TURN), 0.0)
    for j, turn in zip(counted, turns, strict=True):
        if j < len(home):
            around[:, j] = TURN * turn
    way += around
    v, a, far = v[:-1], a[:-1], np.abs(way)
    by_joints = np.where(far * a < v * v, 2.0 * np.sqrt(far / a), far / v + v / a).max(axis=1, initial=0.0)
    shares = np.linspace(0.0, 1.0, _LOOKS)[:, None]
    postures = home + shares[None] * way[:, None]
    tips = cell.arm.poses(postures.reshape(-1, len(home)))[:, :3, 3].reshape(-1, _LOOKS, 3)
    by_tip = np.linalg.norm(np.diff(tips, axis=1), axis=2).sum(axis=1)
    if obstacles.any:
        holder = nodes.holder_joints(cell, rung)[there.nonzero()[1]]
        between = postures[:, 1:-1].reshape(-1, len(home))
        whole = np.hstack([between, np.repeat(holder, _LOOKS - 2, axis=0)])
        margins = obstacles.margins(whole, np.full(len(whole), now), 0.0)[0].reshape(-1, _LOOKS - 2)
        by_tip += np.where((margins < 0.0).any(axis=1), _DETOUR, 0.0)
    times = np.zeros(there.shape)
    times[there] = np.maximum(by_joints, by_tip / speed)
    return times


# ----------------------------------------------------------------------------------------------------
# How far a ladder's route can be from the best one on its whole fine grid: a price that no route can go below.

PIECE = 24  # rungs searched at once: the whole fine grid of so many still fits in memory


def lower_bound(cell: Cell, found: LadderRoute, min_sigma: float, piece: int = PIECE) -> float:
    """A lower bound [s] on the price of any route on the whole grid with the found route's steps.

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
            steps = grid.roll_step, grid.holder_step
            whole = full_grid(few, cell.inverse.branch_count, *steps, swept is not None, swept, held)
            route, _ = best_route(evaluate(cell, few, whole, min_sigma), few, cell.limits)
            if route is None:  # only by rounding: the found route lies on this grid
                return 0.0
            total += route.price
    return total


# ----------------------------------------------------------------------------------------------------
# The best clear route, with clearance checked only where a route leads.
#
# Checking a posture's clearance costs several times as much as all else about a node, and most routes lead past
# everything. So routes are searched as if nothing were in the way; nodes around blocked rungs are then checked, and the
# search is repeated. A clear route found in this way is the one that a search among clear nodes only would find.

_REACH = 4  # rungs to each side of a blocked one that are checked first; _WIDER times as many each time after
_WIDER = 4


class ClearSearch:
    """Searches on one grid.

    nodes: those of `evaluate`, as far as a search has checked their clearance
    wound: the last route found that winds a joint further than its range
    """

    def __init__(
        self, cell: Cell, demand: SampledTasks, grid: Grid, min_sigma: float, obstacles: Obstacles = NOTHING
    ) -> None:
        self._cell, self._demand = cell, demand
        self._obstacles = obstacles.but_head_on_part if demand.cones.tilt > 0.0 else obstacles
        self.nodes, self._fill = nodes_to_fill(cell, demand, grid, min_sigma)
        r = len(demand.rung)
        self._fill(np.arange(r), NOTHING)
        self._looked: Flags = np.full(r, not obstacles.any)
        self.wound: Route | None = None

    def best(
        self, tasks: Sequence[NozzleTask] = (), share: float = 1.0, *, past: bool = True
    ) -> tuple[Route | None, int]:
        """As `best_route`, on clear nodes, among routes that wind no joint further along a bead than its range.

        Where a joint winds too far, or would have to be wound up beforehand or unwound afterwards, its turns are
        counted and the search is repeated, if it fits in memory. If there is no way then, or it does not fit, `wound`
        is the route that winds too far.

        tasks, share: as for `home_travel_costs`, if the ways from and to home have a price; past: including detours
        """
        counted = set[int]()
        while True:
            which = sorted(counted)
            home = None
            if tasks:
                in_the_way = self._obstacles if past else NOTHING
                home = home_travel_costs(self._cell, tasks, self.nodes, share, in_the_way, which)
            route, stuck = self._clear(home, which)
            if route is None:
                return None, stuck
            found = LadderRoute(self._demand, self.nodes, route)
            over = overwound(self._cell, found)
            if over - counted:
                self.wound = route
            more = over | (wound_from_home(self._cell, found) if tasks else set())
            if not more - counted:
                return route, stuck
            counted |= more
            if not may_be_counted(self.nodes, turns_counted(self.nodes, self._cell.limits, sorted(counted))):
                return (None, len(self._looked) - 1) if over else (route, stuck)

    def _clear(self, home: tuple[Array, Array] | None, counted: Sequence[int]) -> tuple[Route | None, int]:
        reach = _REACH
        while True:
            route, stuck = best_route(self.nodes, self._demand, self._cell.limits, home, counted)
            if route is None:  # nor will there be one with fewer nodes
                return None, stuck
            blocked = self._blocked(route)
            if not len(blocked):
                return route, stuck
            around = (blocked[:, None] + np.arange(-reach, reach + 1)).ravel()
            self.look(np.unique(around[(around >= 0) & (around < len(self._looked))]))
            reach *= _WIDER

    def look(self, rungs: Ints) -> Nodes:
        """Remove what is not clear at some rungs from the nodes, and return them."""
        rungs = rungs[~self._looked[rungs]]
        self._fill(rungs, self._obstacles)
        self._looked[rungs] = True
        return self.nodes

    def _blocked(self, route: Route) -> Ints:
        """Unchecked rungs where a route's node, or the one that keeps the previous angles, is not clear."""
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
                chosen[:, grid.swept] = self.nodes.swept_at(route.holder[angles_of])
            now = demand.now[demand.rung[at]]
            whole = np.hstack([q, chosen[:, : len(self._cell.holder)]])
            blocked |= self._obstacles.margins(whole, now, 0.0, CLEAR_ROOM)[0] < 0.0
        return at[blocked]


def overwound(cell: Cell, found: LadderRoute) -> set[int]:
    """Joints that a route winds so far along a bead that no whole turns bring them into their range.

    Indices of the arm's joints; the swept one is given as the number of these.
    """
    q, joints = _joints_along(cell, found)
    least, most = cell.limits.q_min[joints] + MARGIN, cell.limits.q_max[joints] - MARGIN
    over = set[int]()
    for i in range(len(found.demand.task_rungs) - 1):
        angles = q[found.demand.rungs_of(i)]
        lowest, highest = angles.min(axis=0), angles.max(axis=0)
        # the turns that bring the lowest angle into the range
        turns = np.where(cell.limits.turns[joints], np.ceil((least - lowest) / TURN) * TURN, 0.0)
        over.update(np.flatnonzero(highest + turns > most).tolist())
    return over


def wound_from_home(cell: Cell, found: LadderRoute) -> set[int]:
    """Arm joints that a route of one bead winds so far that the ways from and to home take over half a turn more than
    with the shortest turn at each end."""
    if len(found.demand.task_rungs) > 2:
        return set()  # they can unwind between beads
    na = len(cell.arm)
    q = _joints_along(cell, found)[0][:, :na] - cell.home[:na]
    start, end = q[0], q[-1]
    short = sum(np.abs(wrap_angle(x)) for x in (start, end))
    turned = [-TURN * np.round(x / TURN) for x in (start, end)]
    least = np.min([np.abs(start + turn) + np.abs(end + turn) for turn in turned], axis=0)
    return set(np.flatnonzero((least > short + np.pi) & cell.limits.turns[:na]).tolist())


def _joints_along(cell: Cell, found: LadderRoute) -> tuple[Array, list[int]]:
    """Arm joints and the swept one (r, na or na + 1) along a route, continuous along each task, and their indices."""
    nodes, route, demand = found.nodes, found.route, found.demand
    grid, na = nodes.grid, len(cell.arm)
    r = np.arange(len(route.roll))
    roll, holder = route.roll - grid.roll_from, route.holder - grid.holder_from
    if grid.periodic:
        roll, holder = roll % grid.rolls, holder % grid.holders
    column = np.argmax(grid.branch == route.branch[:, None], axis=1)
    q = nodes.q[r, roll, holder, column].astype(float)
    joints = [*range(na)]
    if grid.swept is not None and cell.chosen:
        joints.append(cell.chosen[grid.swept])
        q = np.hstack([q, found.chosen(len(cell.chosen))[:, grid.swept, None]])
    for i in range(len(demand.task_rungs) - 1):
        rungs = demand.rungs_of(i)
        q[rungs] = np.where(cell.limits.turns[joints], np.unwrap(q[rungs], axis=0), q[rungs])
    return q, joints


# ----------------------------------------------------------------------------------------------------
# Strategy `ladder`: dynamic programming over roll, holder angle and branch, coarse guides first, then dense.

# Corridors of the second search, in the order in which they are tried: the divisor of the coarse steps, and how many of
# the resulting steps a route may leave the guide by, to each side, in roll and in the chosen joint. A guide that turns
# by a coarse step a rung is too quick for dense steps: so wider in roll, which turns quickly, then in both, then
# coarse.
CORRIDORS = ((3, 4, 4), (3, 12, 4), (3, 12, 12), (1, 1, 1))
_SPARSE = 5  # × the settings' rung spacing: for the first look at several chosen joints
_ROUGH = 2.0  # × the settings' steps: in that first look, and where the grid would be too large
MOST_NODES = 3e6  # nodes of the guide's grid: 100 MB, and a second; the second search is finer anyway
_FEW = 50  # × the settings' rung spacing: to try postures of a holder with many joints where home will not do
_DRAWN = 400  # such postures
_SLIDING_SHARE = 0.7  # share of a sliding joint's speed that a grid step from rung to rung may take
_TURN_SHARE = 0.7  # share of the table's grid step by which the normal may turn from rung to rung
_LATTICE = 9  # angles at which a chosen joint is held in the first look, at most


@with_each_nozzle
def ladder(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING
) -> tuple[JointPath, ...]:
    """The best joint paths on the grid, over all beads together, travel included, and clear of obstacles.

    A first search over the whole coarse grid guides a second one, three times as fine, in a corridor around
    it. Beads that repeat from layer to layer share the guide of the lowest of them.
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
        raise RuntimeError("a search that finds no route must raise a Refusal itself")
    raise refusal


def ladder_route(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec) -> LadderRoute:
    """The first route that `ladder` would try if nothing were in the way; raises Refusal if there is none."""
    return next(_routes(cell, tasks, settings, NOTHING))


def _routes(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles
) -> Iterator[LadderRoute]:
    """Dense routes, one for each corridor that has any; Refusal where none has."""
    guides, guide_of = guides_of(tasks)
    guide = guide_route(cell, guides, settings, obstacles, len(guides) / len(tasks))
    all_demand = sample_tasks(tasks, _rung(cell, tasks, settings, CORRIDORS[0][0]), _turn(cell, settings))
    any_route = False
    one_angle = guide.nodes.grid.holders == 1
    for corridor in dict.fromkeys((refine, roll, 0 if one_angle else holder) for refine, roll, holder in CORRIDORS):
        grid = _corridor(cell, tasks, all_demand, guides, guide, guide_of, *corridor)
        demand = all_demand
        if grid.held is not None and binds_table(cell, demand.cones):
            demand = carried(cell, tasks, demand, grid.held)
        dense = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
        best, stuck = dense.best(tasks)
        if best is not None:
            any_route = True
            yield LadderRoute(demand, dense.nodes, best)
    if not any_route and dense.wound is not None:
        yield LadderRoute(demand, dense.nodes, dense.wound)  # whose paths are refused with the joint's name
    elif not any_route:
        refuse_rung(cell, tasks, demand, dense.nodes, stuck, settings.min_sigma, obstacles)


def may_be_found(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles) -> bool:
    """Whether the coarse search that guides `ladder` finds a way; if not, neither does `ladder`, which takes several
    times as long."""
    try:
        for own, which in nozzles_of(cell, tasks):
            guides, _ = guides_of([tasks[i] for i in which])
            guide_route(own, guides, settings, obstacles.for_nozzle(cell, own), len(guides) / len(which))
    except Refusal:
        return False
    return True


def guide_route(
    cell: Cell, guides: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles = NOTHING, share: float = 1.0
) -> LadderRoute:
    """The best route on the coarse grid; share: of the print's beads that are guides. Raises Refusal if there is none.

    With several chosen joints a full grid would not fit, see `_one_after_the_other`. Where cones about the vertical
    bind the table, its path is found by `table_path`, and roll, branch and the arm's given joints are searched with it.
    """
    if len(cell.chosen) < 2:
        return _with_one_joint(cell, guides, settings, obstacles, share)
    demand = sample_tasks(guides, _rung(cell, guides, settings), _turn(cell, settings))
    if binds_table(cell, demand.cones):
        return _after_table(cell, guides, demand, settings, obstacles, share)
    # moving all joints is not always better than moving one: neither search covers the whole grid
    found, refusal = None, None
    try:
        found = _one_after_the_other(cell, guides, demand, settings, obstacles, share)
    except Refusal as none:
        refusal = none
    try:
        alone = _with_one_joint(cell, guides, settings, obstacles, share)
    except Refusal as none:
        if found is None:
            # what blocks every posture with one joint moving mostly blocks all postures
            raise none if refusal is None or isinstance(none, Blocked) else refusal from none
        return found
    both = [alone] if found is None else [found, alone]
    return _best(cell, both)


def _best(cell: Cell, found: Sequence[LadderRoute]) -> LadderRoute:
    """The cheapest route, preferably one that winds no joint too far."""
    return min(found, key=lambda each: (bool(overwound(cell, each)), each.route.price))


def _with_one_joint(
    cell: Cell, guides: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles, share: float
) -> LadderRoute:
    """The best route on the whole coarse grid of roll, branch and the chosen joint next to the part, others at home."""
    demand, grid = coarse_grid(cell, guides, settings, MOST_NODES)
    return _best_on(grid, cell, guides, demand, settings, obstacles, share)


def _best_on(
    grid: Grid,
    cell: Cell,
    guides: Sequence[NozzleTask],
    demand: SampledTasks,
    settings: ResolveSpec,
    obstacles: Obstacles,
    share: float,
) -> LadderRoute:
    """The best route on a grid, or one that winds a joint too far, which is refused by that joint's name later."""
    search = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
    route, stuck = search.best(guides, share)
    route = route or search.wound
    if route is None:
        rough = max(round(grid.roll_step / settings.roll_step), 1)
        refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles, rough)
    return LadderRoute(demand, search.nodes, route)


def _one_after_the_other(
    cell: Cell,
    guides: Sequence[NozzleTask],
    demand: SampledTasks,
    settings: ResolveSpec,
    obstacles: Obstacles,
    share: float,
) -> LadderRoute:
    """A route over roll, branch and several chosen joints, searched one joint at a time.

    First the one next to the part, on sparse rungs, for a lattice of angles at which the others rest; then each of the
    others, while the rest follow the path found before.
    """
    k = len(cell.chosen)
    found = _first_look(cell, guides, settings, obstacles, share)
    first = found.nodes.grid.swept
    for swept in [*(j for j in range(k) if j != first), first]:
        held = _between_rungs(found, demand, k)
        grid = full_grid(demand, cell.inverse.branch_count, settings.roll_step, settings.table_step, True, swept, held)
        search = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
        route, stuck = search.best(guides, share)
        if route is not None:
            found = LadderRoute(demand, search.nodes, route)
    # a joint for which no way is found leaves the path unchanged; one must be found for at least one of them
    if found.demand is not demand:
        refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles)
    return found


def binds_table(cell: Cell, cones: Cones) -> bool:
    """Whether cones about the vertical bind the table, so that `table_path` finds its path."""
    return len(cell.holder) > 1 and not cell.holder.slides[-2:].any() and least_cone(cones) < BINDING


def _rung(cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, refine: int = 1) -> float:
    """Distance between rungs [m]: the settings', or more where a chosen joint slides.

    From rung to rung it must be able to move by a grid step, divided by `refine`: its steps are long, since their
    number is not to grow with its range.
    """
    rung, limits = settings.rung, cell.limits
    for j in cell.chosen:
        if j in limits.sliding:
            step = grid_scale(limits, j)[1] * settings.table_step / refine
            time = max(step / (_SLIDING_SHARE * limits.velocity[j]), float(np.sqrt(step / limits.acceleration[j])))
            rung = max(rung, time * max(task.speed for task in tasks))
    return rung


def _turn(cell: Cell, settings: ResolveSpec) -> float:
    """How far the normal may turn from rung to rung [rad]: a table that follows it moves by at most a grid step."""
    return _TURN_SHARE * settings.table_step if cell.chosen else np.inf


def _after_table(
    cell: Cell,
    guides: Sequence[NozzleTask],
    demand: SampledTasks,
    settings: ResolveSpec,
    obstacles: Obstacles,
    share: float,
) -> LadderRoute:
    """The best route of heading and branch while the table follows a path that the cones allow.

    At first the arm's given joints rest or, where that does not work, rails go along with the nozzle; then they are
    searched one by one, while the others follow the path found before.
    """
    k, nh = len(cell.chosen), len(cell.holder)
    held = table_path(cell, guides, demand)
    demand = carried(cell, guides, demand, held)
    T = cell.holder.poses(held[:, :nh])
    tip = np.einsum("nij,nj->ni", T[:, :3, :3], demand.tip[demand.rung]) + T[:, :3, 3]
    along = np.hstack([held[:, :nh], gone_along(cell, tip)])
    steps = settings.roll_step, settings.table_step
    found: list[LadderRoute] = []
    for swept in (None, *range(nh, k)):
        grid = full_grid(demand, cell.inverse.branch_count, *steps, swept is not None, swept, held)
        search = ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)
        route, stuck = search.best(guides, share)
        route = route or search.wound
        if route is not None:
            found.append(LadderRoute(demand, search.nodes, route))
        held = _best(cell, found).chosen(k) if found else along
    if not found:
        refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles)
    return _best(cell, found)


def _first_look(
    cell: Cell, guides: Sequence[NozzleTask], settings: ResolveSpec, obstacles: Obstacles, share: float
) -> LadderRoute:
    """The best route on sparse rungs with all chosen joints but one at rest, at the best angles of a lattice."""
    k, nh = len(cell.chosen), len(cell.holder)
    demand = sample_tasks(guides, _SPARSE * _rung(cell, guides, settings), _ROUGH * _turn(cell, settings))
    swept = max(nh - 1, 0)
    others = [j for j in range(k) if j != swept]
    home = at_rest(cell)
    best: LadderRoute | None = None
    wound: LadderRoute | None = None

    def search_at(rest: Array, demand: SampledTasks) -> ClearSearch:
        held = np.tile(home, (len(demand.rung), 1))
        held[:, others] = rest
        steps = _ROUGH * settings.roll_step, _ROUGH * settings.table_step
        grid = full_grid(demand, cell.inverse.branch_count, *steps, True, swept, held)
        return ClearSearch(cell, demand, grid, settings.min_sigma, obstacles)

    lattice = [_rest_angles(cell, j, _ROUGH * settings.table_step, len(others)) for j in others]
    for rest in itertools.product(*lattice):
        search = search_at(np.array(rest), demand)
        route, stuck = search.best(guides, share, past=False)
        if route is not None and (best is None or route.price < best.route.price):
            best = LadderRoute(demand, search.nodes, route)
        elif search.wound is not None and (wound is None or search.wound.price < wound.route.price):
            wound = LadderRoute(demand, search.nodes, search.wound)
    best = best or wound
    if best is None and len(others) > 1:  # home will not do: look around it, at few rungs first
        few = sample_tasks(guides, _FEW * settings.rung)
        for rest in _around_home(cell, others):
            reached = search_at(rest, few).look(np.arange(len(few.rung)))
            if np.isfinite(reached.price).any(axis=(1, 2, 3)).all():
                elsewhere = search_at(rest, demand)
                route, _ = elsewhere.best(guides, share, past=False)
                if route is not None:
                    return LadderRoute(demand, elsewhere.nodes, route)
    if best is None:
        refuse_rung(cell, guides, demand, search.nodes, stuck, settings.min_sigma, obstacles, _ROUGH)
    return best


def _around_home(cell: Cell, chosen: Sequence[int]) -> Array:
    """Angles (m, len(chosen)) of chosen joints, drawn ever further from home within their ranges."""
    rest, low, high = (each[list(chosen)] for each in (at_rest(cell), *looked_at(cell)))
    drawn = np.random.default_rng(0).uniform(low, high, (_DRAWN, len(chosen)))
    return rest + np.linspace(0.0, 1.0, _DRAWN)[:, None] * (drawn - rest)


def _rest_angles(cell: Cell, chosen: int, step: float, others: int) -> Array:
    """Angles at which a chosen joint may rest: those of a lattice over its range that are nearest to home if it is the
    only one to rest, else home."""
    rest, (low, high) = at_rest(cell)[chosen], looked_at(cell)
    if others > 1:
        return np.array([rest])
    unit = grid_scale(cell.limits, cell.chosen[chosen])[1]
    around = rest + unit * step * np.arange(1 - _LATTICE, _LATTICE)
    inside = around[(around > low[chosen]) & (around < high[chosen])]
    return np.sort(inside[np.argsort(np.abs(inside - rest), kind="stable")[:_LATTICE]])


def _between_rungs(found: LadderRoute, demand: SampledTasks, k: int) -> Array:
    """Angles (r, k) of the chosen joints of a route, at the rungs of another demand of the same tasks."""
    angles = found.chosen(k)
    out = np.empty((len(demand.rung), k))
    for i in range(len(demand.task_rungs) - 1):
        theirs, own = found.demand.rungs_of(i), demand.rungs_of(i)
        for j in range(k):
            out[own, j] = np.interp(demand.place[own], found.demand.place[theirs], angles[theirs, j])
    return out


def coarse_nodes(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    settings: ResolveSpec,
    most: float = np.inf,
    obstacles: Obstacles = NOTHING,
) -> tuple[SampledTasks, Nodes]:
    """The whole grid of the settings' steps at the settings' rungs, or of twice those steps if it has too many nodes.

    Of several chosen joints, the one next to the part varies; the others rest at home.
    """
    demand, grid = coarse_grid(cell, tasks, settings, most)
    return demand, evaluate(cell, demand, grid, settings.min_sigma, obstacles)


def coarse_grid(
    cell: Cell, tasks: Sequence[NozzleTask], settings: ResolveSpec, most: float = np.inf
) -> tuple[SampledTasks, Grid]:
    """The tasks at the settings' rungs and the grid at its steps, or at twice those if that has over `most` nodes."""
    demand = sample_tasks(tasks, _rung(cell, tasks, settings), _turn(cell, settings))
    held = np.tile(at_rest(cell), (len(demand.rung), 1))
    swept = max(len(cell.holder) - 1, 0)
    for rough in (1.0, _ROUGH):
        steps = rough * settings.roll_step, rough * settings.table_step
        grid = full_grid(demand, cell.inverse.branch_count, *steps, len(cell.chosen) > 0, swept, held)
        if len(demand.rung) * grid.rolls * grid.holders * grid.branch.shape[1] <= most:
            break
    return demand, grid


def _corridor(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    demand: SampledTasks,
    guides: Sequence[NozzleTask],
    guide: LadderRoute,
    guide_of: Sequence[int],
    refine: int,
    roll_room: int,
    holder_room: int,
) -> Grid:
    """A fine grid whose windows follow the guide route of the bead that each repeats, either way round."""
    coarse, route = guide.nodes.grid, guide.route
    k = len(cell.chosen)
    chosen = guide.chosen(k)
    r = len(demand.rung)
    roll_from, holder_from = np.zeros(r, dtype=np.int64), np.zeros(r, dtype=np.int64)
    branch = np.zeros((r, 1), dtype=np.int64)
    held = np.zeros((r, k))
    for i, task in enumerate(tasks):
        g = guide_of[i]
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
        if not binds_table(cell, demand.cones):  # there rolls are headings in the world
            apart = zeros_apart(task, guides[g], backwards)
            roll_from[own] += round(refine * apart / coarse.roll_step)
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


def paths_of(cell: Cell, tasks: Sequence[NozzleTask], found: LadderRoute) -> tuple[JointPath, ...]:
    """Smooth joint paths along a route: its grid values control splines of roll and chosen joints."""
    paths = []
    grid, route, demand = found.nodes.grid, found.route, found.demand
    chosen = found.chosen(len(cell.chosen))
    offset = 0
    for i, task in enumerate(tasks):
        rungs = demand.rungs_of(i)
        n, places = len(task), demand.place[rungs]
        roll = spread(angles_along(grid, route.roll[rungs], grid.rolls, grid.roll_step), n, places)
        angles = spread(chosen[rungs], n, places)
        branch = int(route.branch[rungs][0])
        frames, tilt = demand.frames[offset : offset + n], upright(task)
        offset += n
        if task.cones.tilt > 0.0:
            stand = leaned_on_part(cell, frames, angles[:, : len(cell.holder)], demand.lean)
            roll, tilt = turned_from(task.frames, stand @ rolled(roll))
        elif binds_table(cell, demand.cones):
            roll, _ = turned_from(task.frames, frames @ rolled(roll))
        q = postures(cell, task, roll, angles, branch, tilt)
        _refuse_jump(cell, task, q)
        paths.append(JointPath(task, roll, tilt, q, branch))
    return choose_turns(cell, paths)


def _refuse_jump(cell: Cell, task: NozzleTask, q: Array) -> None:
    """Refuse joints (n, nj) if one turns so far from sample to sample that the nozzle leaves its path in between."""
    steps = np.where(cell.limits.turns, np.abs(np.diff(q, axis=0)), 0.0)
    i, j = np.unravel_index(int(steps.argmax()), steps.shape)
    if steps[i, j] > FAR:
        turn, way = np.degrees(steps[i, j]), (task.s[i + 1] - task.s[i]) * 1e3
        name = cell.joint_names[j]
        refuse_at(task, int(i), f"{name} would turn by {turn:.0f} degrees over {way:.1f} mm, past a singular posture")
