"""Why there is no path, and what would help: the rung that ran out of candidates, and changes that were tried."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, Flags
from planner.base.errors import Blocked, Change, MovedBy, Refusal
from planner.base.processes import cores
from planner.cell.cell import Cell, near_ends, translation
from planner.cell.robot import chain_of
from planner.collision.scene import NOTHING, PART, Obstacles
from planner.resolve.drawn import SLIGHT, repeated
from planner.resolve.joint_path import (
    JointPath,
    SampledTasks,
    flange_poses,
    leaned_on_part,
    postures,
    refuse_at,
    rolled,
    spread,
    turned_from,
    turned_to_middle,
    upright,
)
from planner.resolve.nodes import Grid, Nodes, evaluate, full_grid
from planner.resolve.reach import CLEAR_ROOM
from planner.resolve.search import LadderRoute, Route, angles_along, best_route
from planner.toolpath.task import NozzleTask

# ----------------------------------------------------------------------------------------------------
# What would help where there is no path: other tilts, positioner angles and positions of the part, each tried out.
#
# Nothing here is guessed: a change is suggested only after the same nodes and the same search have been tried with it.

TILTS = (5.0, 10.0, 20.0)  # deg from the surface normal
_FINE = 0.1  # mm of missing clearance, below which two significant digits are printed
NEARER = (1e-3, 0.5e-3, 0.2e-3, 0.0)  # m: smaller clearances of nozzle and head to try where more is required
_AZIMUTHS = 12  # directions in which the nozzle is tilted
_TURN_STEP, _MOST_TURN = 15.0, 180.0  # deg: steps of a held axis from its present angle, and how far they go
_MOVES = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)  # m that the part is moved, on top of the missing reach where that is known
_MORE, _ROUND_MM = 0.01, 5.0  # m added to such a move; mm, to a multiple of which it is then rounded up
_HALVINGS = 3  # bisections of the last step of such a move
_FINER, _FINEST = 2.0, 2.0  # divisor of the steps of a finer grid; smallest step to suggest [deg]
_FEW = 24  # rungs at which a change must give a posture before a full search is worth its time
_ENOUGH = 8  # changes of one kind that give postures but no path, after which no more are tried
_HERE, _ALONG = 1, 2  # what a change gives: a posture at the place, or a path through everything


@dataclass(frozen=True)
class Stuck:
    """Where a search ended: its tasks, demand, grid and rung.

    min_sigma: the least singular value it required; obstacles: what was in its way
    rough: the grid's steps as a multiple of the settings'
    """

    cell: Cell
    tasks: tuple[NozzleTask, ...]
    demand: SampledTasks
    grid: Grid
    rung: int
    min_sigma: float
    obstacles: Obstacles = NOTHING
    rough: float = 1.0

    def serves(self, cell: Cell) -> int:
        """What the same search gives in a changed cell: 0 for nothing, _HERE or _ALONG."""
        if not np.isfinite(self._prices(cell, self.demand, np.array([self.rung]))).any():
            return 0
        r = len(self.demand.rung)
        some = np.unique(np.linspace(0, r - 1, min(r, _FEW)).round().astype(np.int64))
        if not np.isfinite(self._prices(cell, self.demand, some)).any(axis=(1, 2, 3)).all():
            return _HERE
        nodes = evaluate(cell, self.demand, self._grid(self.demand, slice(None)), self.min_sigma, self._around(cell))
        route, _ = best_route(nodes, self.demand, cell.limits)
        return _HERE if route is None or not self._holds_between(cell, nodes, route) else _ALONG

    def _holds_between(self, cell: Cell, nodes: Nodes, route: Route) -> bool:
        """Whether the arm also reaches the samples between a route's rungs."""
        grid = nodes.grid
        chosen = LadderRoute(self.demand, nodes, route).chosen(len(cell.chosen))
        for k, task in enumerate(self.tasks):
            rungs = self.demand.rungs_of(k)
            roll = angles_along(grid, route.roll[rungs], grid.rolls, grid.roll_step)
            n, places, branch = len(task), self.demand.place[rungs], int(route.branch[rungs][0])
            rolls, angles, tilt = spread(roll, n, places), spread(chosen[rungs], n, places), upright(task)
            first = int(self.demand.rung[rungs.start])
            frames = self.demand.frames[first : first + n]
            if self.demand.lean < 1.0 or not np.array_equal(frames, task.frames):
                stand = leaned_on_part(cell, frames, angles[:, : len(cell.holder)], self.demand.lean)
                rolls, tilt = turned_from(task.frames, stand @ rolled(rolls))
            try:
                postures(cell, task, rolls, angles, branch, tilt)
            except Refusal:
                return False
        return True

    def has_postures_near_ends(self) -> bool:
        """Whether the cell has a posture at the place, closer to the ends of joints' ranges than the search goes."""
        nearer = replace(self, cell=near_ends(self.cell))
        return bool(np.isfinite(nearer._prices(nearer.cell, self.demand, np.array([self.rung]))).any())

    def serves_tilted(self, tilt: float) -> bool:
        """Whether the cell has a posture at the place with the nozzle tilted by this much [rad] in some direction."""
        sample = self.demand.rung[self.rung]
        for azimuth in np.linspace(0.0, 2.0 * np.pi, _AZIMUTHS, endpoint=False):
            frames = self.demand.frames.copy()
            turn = Rotation.from_rotvec(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])).as_matrix()
            frames[sample] = frames[sample] @ turn
            prices = self._prices(self.cell, replace(self.demand, frames=frames), np.array([self.rung]))
            if np.isfinite(prices).any():
                return True
        return False

    def _around(self, cell: Cell) -> Obstacles:
        """The obstacles of a changed cell."""
        if cell is self.cell:
            return self.obstacles
        there = self.obstacles.of(cell)
        return there.but_head_on_part if self.demand.cones.tilt > 0.0 else there

    def _prices(self, cell: Cell, demand: SampledTasks, rungs: NDArray[np.int64]) -> Array:
        few = demand.only(rungs, [0, len(rungs)])
        return evaluate(cell, few, self._grid(few, rungs), self.min_sigma, self._around(cell)).price

    def _grid(self, demand: SampledTasks, rungs: NDArray[np.int64] | slice) -> Grid:
        grid = self.grid
        held = None if grid.held is None else grid.held[rungs]
        has_holder = len(self.cell.chosen) > 0 and grid.swept is not None
        return full_grid(
            demand, self.cell.inverse.branch_count, grid.roll_step, grid.holder_step, has_holder, grid.swept, held
        )


def stuck_at(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    demand: SampledTasks,
    grid: Grid,
    rung: int,
    min_sigma: float,
    obstacles: Obstacles = NOTHING,
    rough: float = 1.0,
) -> Stuck:
    """Where a search over these tasks ended; of tasks of one name only one layer's are kept, as others repeat them."""
    at = int(np.searchsorted(demand.task_rungs, rung, side="right") - 1)
    layer = {tasks[at].name: tasks[at].layer}
    for task in tasks:
        layer.setdefault(task.name, task.layer)
    kept = [k for k, task in enumerate(tasks) if task.layer == layer[task.name]]
    rungs = np.concatenate([np.arange(demand.task_rungs[k], demand.task_rungs[k + 1]) for k in kept])
    counts = [demand.task_rungs[k + 1] - demand.task_rungs[k] for k in kept]
    fewer = demand.only(rungs, [0, *np.cumsum(counts).tolist()])
    here = int(np.searchsorted(rungs, rung))
    held = None if grid.held is None else grid.held[rungs]
    own = tuple(tasks[k] for k in kept)
    return Stuck(cell, own, fewer, replace(grid, held=held), here, min_sigma, obstacles, rough)


def place_hints(stuck: Stuck, point: Array, missing: float | None = None) -> tuple[str, ...]:
    """Changes that would give the cell a posture at the place, or better a path: the smallest one of each kind.

    point (3) in the part frame [m]; missing: how far it is out of reach [m], if it is.
    """
    moves = _move_hints(stuck, point, missing, _HERE)
    return (*_turn_hints(stuck, _HERE), *moves, *_tilt_hints(stuck), *_nearer_hints(stuck))


def path_hints(stuck: Stuck, point: Array) -> tuple[str, ...]:
    """Changes that would give the cell a path where it has a posture at the place, be it on a finer grid only."""
    return (*_finer_hints(stuck), *_turn_hints(stuck, _ALONG), *_move_hints(stuck, point, None, _ALONG))


def _finer_hints(stuck: Stuck) -> tuple[str, ...]:
    roll, table = stuck.grid.roll_step / _FINER, stuck.grid.holder_step / _FINER
    asked = np.degrees([roll, table]) / stuck.rough  # as steps of the settings
    if asked.min() < _FINEST:
        return ()
    if replace(stuck, grid=replace(stuck.grid, roll_step=roll, holder_step=table)).serves(stuck.cell) != _ALONG:
        return ()
    swept = len(stuck.cell.chosen) > 0 and stuck.grid.swept is not None
    steps = {"roll_step_deg": f"{asked[0]:g}"} | ({"table_step_deg": f"{asked[1]:g}"} if swept else {})
    what = f"resolve: {{{', '.join(f'{key}: {value}' for key, value in steps.items())}}}"
    return (_change(_ALONG, (what, tuple((f"resolve.{key}", value) for key, value in steps.items()))),)


def _tilt_hints(stuck: Stuck) -> tuple[str, ...]:
    """The smallest tilt that gives a posture, and larger ones that may give a path."""
    clear = replace(stuck, obstacles=stuck.obstacles.but_head_on_part)
    leans = stuck.demand.cones.tilt == 0.0 and clear.serves(stuck.cell) > 0
    what = "lets the nozzle lean clear here" if leans else "gives the nozzle a posture here"
    for tilt in TILTS:
        if np.radians(tilt) > stuck.demand.cones.tilt and stuck.serves_tilted(np.radians(tilt)):
            key = "process.cones.nozzle_normal_deg"
            more = tuple((f"{key}: {each:g}", ((key, f"{each:g}"),)) for each in TILTS if each >= tilt)
            return (Change(f"{key}: {tilt:g} {what}", more),)
    return ()


def _nearer_hints(stuck: Stuck) -> tuple[str, ...]:
    """The largest clearance of nozzle and head that would do: less than required, but still no contact."""
    found: tuple[int, float] = (0, 0.0)
    for nozzle in NEARER:
        nearer = stuck.obstacles.with_nozzle_at(stuck.cell, nozzle)
        gives = 0 if nearer is None else replace(stuck, obstacles=nearer).serves(stuck.cell)
        if gives > found[0]:
            found = gives, nozzle
        if gives == _ALONG:
            break
    return nearer_hint(found[1], _GIVES[found[0]]) if found[0] else ()


def nearer_hint(kept: float, gives: str) -> tuple[Change, ...]:
    """The hint to keep this clearance of nozzle and head [m], or the next smaller ones; empty where they touch."""
    key = "collision.nozzle_mm"
    tries = tuple((f"{key}: {each * 1e3:g}", ((key, f"{each * 1e3:g}"),)) for each in NEARER if each <= kept)
    return (Change(f"{tries[0][0]} {gives}", tries),) if tries else ()


def _change(gives: int, *tries: tuple[str, tuple[tuple[str, Any], ...]]) -> Change:
    """The hint for a change; the first and smallest of its variants gives this in the coarse search."""
    return Change(f"{tries[0][0]} {_GIVES[gives]}", tries)


def _turn_hints(stuck: Stuck, wanted: int) -> tuple[str, ...]:
    """For each held axis of the positioner, the nearest angle that helps."""
    hints: list[Change] = []
    for name, now in stuck.cell.held.items():
        found: tuple[int, float] = (0, 0.0)
        no_path = 0
        for angle in _angles_around(stuck.cell, name, now):
            gives = stuck.serves(_turned(stuck.cell, name, angle))
            if gives > found[0]:
                found = gives, angle
            no_path += gives == _HERE
            if gives == _ALONG or no_path == _ENOUGH:
                break
        if found[0] >= wanted:
            key, angle_deg = "cell.positioner.held_deg", f"{np.degrees(found[1]):g}"
            what = f"{key}: {{{name}: {angle_deg}}}"
            hints.append(_change(found[0], (what, ((f"{key}.{name}", angle_deg),))))
    return tuple(hints)


def _angles_around(cell: Cell, name: str, now: float) -> Iterator[float]:
    robot = cell.holder_robot
    if robot is None:
        return
    if robot.slides[robot.joint_names.index(name)]:
        return
    low, high = cell.held_range[name]
    for away in np.arange(_TURN_STEP, _MOST_TURN + 1e-9, _TURN_STEP):
        for sign in (-1.0, 1.0):
            if low <= now + sign * np.radians(away) <= high:
                yield now + sign * float(np.radians(away))


def _turned(cell: Cell, name: str, angle: float) -> Cell:
    """The cell with a held axis of its positioner at another angle [rad]."""
    if cell.holder_robot is None:
        return cell
    held = {**cell.held, name: angle}
    holder = chain_of(cell.holder_robot, cell.T_world_holder_base, cell.T_plate_part, cell.holder.names, held)
    return replace(cell, holder=holder, held=held, T_world_holder=holder.poses(np.zeros((1, len(holder))))[0])


def _move_hints(stuck: Stuck, point: Array, missing: float | None, wanted: int) -> tuple[str, ...]:
    """The smallest move of the part that helps: towards the base first, then in the other directions."""
    least = missing or 0.0
    steps = [*([least] if least else []), *(least + d for d in _MOVES)]
    ways = _directions(stuck.cell, point)
    found: tuple[int, str, float] = (0, "", 0.0)
    below, no_path = 0.0, 0
    for k, (way, direction) in itertools.product(range(len(steps)), ways.items()):
        gives = stuck.serves(_moved(stuck.cell, steps[k] * direction))
        if gives > found[0]:
            found, below = (gives, way, steps[k]), steps[k - 1] if k else 0.0
        no_path += gives == _HERE
        if gives == _ALONG or no_path == _ENOUGH:
            break
    if found[0] < wanted:
        return ()
    for _ in range(_HALVINGS):
        middle = 0.5 * (below + found[2])
        if stuck.serves(_moved(stuck.cell, middle * ways[found[1]])) >= found[0]:
            found = found[0], found[1], middle
        else:
            below = middle
    gives, way, distance = found
    # rungs are not the whole path: suggest a little more than the smallest move, where that serves as well
    mm = _ROUND_MM * np.ceil((distance + _MORE) * 1e3 / _ROUND_MM)
    if stuck.serves(_moved(stuck.cell, mm * 1e-3 * ways[way])) < gives:
        mm = round(distance * 1e3, 1)
    field = "cell.bed_mm" if stuck.cell.holder_robot is None else "cell.positioner.origin_mm"
    x, y, z = (round(float(v), 1) + 0.0 for v in mm * ways[way])
    what = f"{field}: the part moved {mm:g} mm {way}, by [{x:g}, {y:g}, {z:g}],"
    return (_change(gives, (what, ((field, MovedBy((x, y, z))),))),)


def _directions(cell: Cell, point: Array) -> dict[str, Array]:
    """Named unit vectors (3) in the world, as seen from a point of the part with everything at home."""
    T_world_part = cell.holder.poses(cell.home[None, len(cell.arm) :])[0]
    to_base = cell.T_world_foot_home[:3, 3] - (T_world_part[:3, :3] @ point + T_world_part[:3, 3])
    level = np.array([to_base[0], to_base[1], 0.0])
    length = float(np.linalg.norm(level))
    nearer = level / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, nearer)
    return {
        "towards the arm's base": nearer,
        "away from the arm's base": -nearer,
        "up": up,
        "down": -up,
        "sideways": side,
        "sideways, the other way": -side,
    }


def _moved(cell: Cell, by: Array) -> Cell:
    """The cell with everything that holds the part moved in the world by a vector (3) [m]."""
    T = translation(by)
    holder = cell.holder
    if len(holder):
        placements = holder.placements.copy()
        placements[0] = T @ placements[0]
        holder = replace(holder, placements=placements)
    else:
        holder = replace(holder, T_last_tip=T @ holder.T_last_tip)
    return replace(
        cell,
        holder=holder,
        T_world_holder=T @ cell.T_world_holder,
        T_world_holder_base=T @ cell.T_world_holder_base,
    )


_GIVES = {_HERE: "gives postures here, but no complete path", _ALONG: "gives a path in the coarse search"}


# ----------------------------------------------------------------------------------------------------
# Why there is no path: which rung ran out of candidates, and for what reason.

STEEP = np.radians(20.0)  # descent at which the nozzle face's edge is a third of its radius beneath the path behind it
_TRIED = 72  # rolls, and as many holder angles, that the diagnosis tries
# Rungs checked for a place beyond the joints' ranges: spread over the print, and on each side of a given rung.
_PLACES, _NEXT = 48, 8


@dataclass(frozen=True)
class _Tried:
    """Postures that the diagnosis tries at a sample of a task.

    T_base_flange (m, 4, 4), holder joints (m, nh), redundant (m, k): angles of the given joints, if there are any
    q (m, b, na): all branches, turned into the joints' ranges
    ok, inside (m, b): which of these exist, and which lie within the ranges
    """

    task: NozzleTask
    sample: int
    T_base_flange: Array
    holder: Array
    redundant: Array | None
    q: Array
    ok: Flags
    inside: Flags

    def best(self, merit: Array) -> Array:
        """Joints (nj) of the posture with the greatest merit (m, b) among those that exist."""
        a, b = np.unravel_index(int(np.where(self.ok, merit, -np.inf).argmax()), self.ok.shape)
        return np.concatenate([self.q[a, b], self.holder[a]])


def _tried_at(cell: Cell, tasks: Sequence[NozzleTask], demand: SampledTasks, nodes: Nodes, rung: int) -> _Tried:
    k = int(np.searchsorted(demand.task_rungs, rung, side="right") - 1)
    i = int(demand.rung[rung]) - sum(len(t) for t in tasks[:k])
    na, nh, grid = len(cell.arm), len(cell.holder), nodes.grid
    angles = np.linspace(0.0, 2.0 * np.pi, _TRIED, endpoint=False)
    roll, swept = (x.ravel() for x in np.meshgrid(angles, _swept_angles(cell, grid, angles), indexing="ij"))
    chosen = np.tile(grid.chosen(len(demand.rung), len(cell.chosen))[rung], (len(roll), 1))
    if cell.chosen and grid.swept is not None:
        zero, unit = nodes.scale
        chosen[:, grid.swept] = zero + unit * swept
    holder = chosen[:, :nh]
    frames = np.repeat(demand.frames[demand.rung[rung], None], len(roll), axis=0)
    if demand.lean < 1.0:
        frames = leaned_on_part(cell, frames, holder, demand.lean)
    spot = replace(repeated(tasks[k], i, len(roll)), frames=frames)
    T = flange_poses(cell, spot, roll, upright(spot), holder)
    redundant = chosen[:, nh:] if cell.given else None
    q, ok = cell.inverse.solve(T, redundant)
    q = turned_to_middle(cell.limits, q)
    low, high = cell.limits.q_min[:na], cell.limits.q_max[:na]
    return _Tried(tasks[k], i, T, holder, redundant, q, ok, ok & ((q >= low) & (q <= high)).all(axis=2))


def _swept_angles(cell: Cell, grid: Grid, angles: Array) -> Array:
    """Angles of the swept joint to try: all those given, or as many within its range where that is less than a turn."""
    if not cell.chosen or grid.swept is None:
        return angles[:1]
    j = cell.chosen[grid.swept]
    low, high = cell.limits.q_min[j], cell.limits.q_max[j]
    if j in cell.limits.sliding or high - low >= 2.0 * np.pi:
        return angles
    return np.linspace(low, high, len(angles))


def _beyond_ranges(
    cell: Cell, tasks: Sequence[NozzleTask], demand: SampledTasks, nodes: Nodes, rung: int
) -> int | None:
    """The nearest rung at which no posture is both in reach and within the joints' ranges, or None.

    Rungs near this one and some spread over all are checked; those on a bead before those in its runs, which can be
    shortened.
    """
    r, grid = len(demand.rung), nodes.grid
    around = np.arange(max(rung - _NEXT, 0), min(rung + _NEXT + 1, r))
    some = np.union1d(around, np.linspace(0, r - 1, min(r, _PLACES)).round().astype(np.int64))
    few = demand.only(some, [0, len(some)])
    held = None if grid.held is None else grid.held[some]
    swept = cell.chosen and grid.swept is not None
    steps = grid.roll_step, grid.holder_step
    whole = full_grid(few, cell.inverse.branch_count, *steps, bool(swept), grid.swept, held)
    bare = replace(cell, limits=replace(cell.limits, room=0.0))
    nowhere = some[~np.isfinite(evaluate(bare, few, whole, 0.0).price).any(axis=(1, 2, 3))]
    laid = np.concatenate([(np.arange(len(t)) >= t.first) & (np.arange(len(t)) <= t.last) for t in tasks])
    for at in sorted(nowhere.tolist(), key=lambda at: (not laid[demand.rung[at]], abs(at - rung))):
        if not _tried_at(cell, tasks, demand, nodes, at).inside.any():
            return int(at)
    return None


def refuse_rung(
    cell: Cell,
    tasks: Sequence[NozzleTask],
    demand: SampledTasks,
    nodes: Nodes,
    rung: int,
    min_sigma: float,
    obstacles: Obstacles = NOTHING,
    rough: float = 1.0,
) -> NoReturn:
    """Raise the Refusal that says why no way leads to this rung: reach, limits, singularity or collision.

    rough: the grid's steps as a multiple of the settings'

    It carries hints, found on demand: changes that were tried and would help. It also says whether there may be a way
    closer to the ends of joints' ranges, see `Refusal.near_ends`.
    """
    if demand.cones.tilt > 0.0:
        obstacles = obstacles.but_head_on_part
    tried = _tried_at(cell, tasks, demand, nodes, rung)
    task, i, q, ok = tried.task, tried.sample, tried.q, tried.ok
    na, nh = len(cell.arm), len(cell.holder)
    grid = nodes.grid

    stuck = stuck_at(cell, tasks, demand, grid, rung, min_sigma, obstacles, rough)

    def refuse(
        reason: str,
        posture: Array | None,
        missing: float | None = None,
        kind: type[Refusal] = Refusal,
        ends: bool = False,
    ) -> NoReturn:
        refuse_at(task, i, reason, missing, partial(place_hints, stuck, task.tip[i], missing), kind, ends, posture)

    if not ok.any():
        missing = float(cell.inverse.out_of_reach(tried.T_base_flange, tried.redundant).min())
        refuse("out of the arm's reach", None, missing)
    inner = np.minimum(q - cell.limits.q_min[:na], cell.limits.q_max[:na] - q)  # how far each is inside its range
    if not tried.inside.any():
        over = np.where(ok[:, :, None], -inner, np.inf)
        worst = over.max(axis=2)
        a, b = np.unravel_index(np.argmin(worst), worst.shape)
        joint = int(np.argmax(over[a, b]))
        reason = f"no posture within the joints' ranges; the nearest one exceeds that of {cell.arm.names[joint]}"
        far = worst[a, b]
        by = f"{1e3 * far:.1f} mm" if joint in cell.limits.sliding else f"{np.degrees(far):.1f} deg"
        refuse(f"{reason} by {by}", tried.best(-worst))
    if not np.isfinite(nodes.price[rung]).any():
        ends, room = stuck.has_postures_near_ends(), cell.limits.room
        away = (inner >= room).all(axis=2) & ok
        if not away.any():
            beyond = _beyond_ranges(cell, tasks, demand, nodes, rung)
            if beyond is not None:  # here the path is only close to what stops it there
                refuse_rung(cell, tasks, demand, nodes, beyond, min_sigma, obstacles, rough)
            slides = any(j < na for j in cell.limits.sliding)
            slid = f" ({1e3 * room:g} mm for one that slides)" if slides else ""
            reason = f"every posture is within {np.degrees(room):.1g} deg of the end of a joint's range"
            refuse(reason + slid, tried.best(inner.min(axis=2)), ends=ends)
        sigma = np.linalg.svd(cell.arm.jacobians(q[away])[:, :, list(cell.solved)], compute_uv=False)[:, -1]
        if sigma.max() < min_sigma:
            reason = f"every posture is too close to a singularity: sigma at most {sigma.max():.4f}"
            merit = np.full(ok.shape, -np.inf)
            merit[away] = sigma
            refuse(f"{reason}, resolve.min_sigma is {min_sigma:g}", tried.best(merit), ends=ends)
        there = _postures_at(cell, demand, grid, rung, min_sigma) if obstacles.any else np.zeros((0, na + nh))
        if len(there):
            now = np.full(len(there), demand.now[demand.rung[rung]])
            margin, which = obstacles.margins(there, now, np.inf, CLEAR_ROOM)
            k = int(np.argmax(margin))
            standing = obstacles.standing(cell, there[k], float(now[k]), float(margin[k]))
            every = _collision(obstacles, int(which[k]), float(margin[k]), "every posture tried here", standing)
            down = descent(task, i)
            if down > STEEP and task.first <= i <= task.last:  # run-ins descend anyway
                every += into_itself(down)
            refuse(every, there[k], kind=Blocked, ends=ends)
        reason = "no posture on the search's grid, though there are some between its steps: search more finely"
        refuse_at(task, i, reason, hints=partial(path_hints, stuck, task.tip[i]), near_ends=ends)
    if obstacles.any:
        free = evaluate(cell, demand, grid, min_sigma)
        without, _ = best_route(free, demand, cell.limits)
        if without is not None:
            worst, pair, lacking, posture = _hit(cell, LadderRoute(demand, free, without), obstacles)
            k = int(np.searchsorted(demand.task_rungs, worst, side="right") - 1)
            i = int(demand.rung[worst]) - sum(len(t) for t in tasks[:k])
            way = "no way leads past it, and the one that would be taken"
            refuse_at(
                tasks[k],
                i,
                _collision(obstacles, pair, lacking, way),
                hints=partial(path_hints, stuck, tasks[k].tip[i]),
                near_ends=True,
                posture=posture,
            )
    reason = "no branch leads up to here: each ends at a joint's range, a singularity or the arm's reach"
    refuse_at(task, i, reason, hints=partial(path_hints, stuck, task.tip[i]), near_ends=True)


def refuse_collision(cell: Cell, paths: Sequence[JointPath], obstacles: Obstacles) -> None:
    """Raise a Refusal if a path comes too close to anything: it names what, and the worst place of all paths.

    Where the nozzle may tilt, the head's clearance from part and print is not checked: tilt may still provide it.
    """
    if paths[0].task.cones.tilt > 0.0:
        obstacles = obstacles.but_head_on_part
    if not obstacles.any:
        return
    with ThreadPoolExecutor(cores()) as pool:
        margins = list(pool.map(lambda path: obstacles.margins(path.q, path.task.moments, 0.0), paths))
    worst = int(np.argmin([margin.min() for margin, _ in margins]))
    margin, which = margins[worst]
    i = int(np.argmin(margin))
    if margin[i] < -SLIGHT:
        what = _collision(obstacles, int(which[i]), float(margin[i]), "the best way found")
        refuse_at(paths[worst].task, i, what, posture=paths[worst].q[i])


def _collision(obstacles: Obstacles, which: int, margin: float, subject: str, standing: Sequence[str] = ()) -> str:
    """standing: bodies fixed in the part frame, if it is one of them that is too close, see `Obstacles.standing`."""
    one, other = obstacles.names(which)
    other = " or ".join(standing) if other == PART and standing else other
    lacks = -margin * 1e3
    size = f"{lacks:.1f}" if lacks > _FINE else f"{lacks:.2g}"  # never 0.0
    return f"collision of {one} with {other}: {subject} lacks {size} mm of clearance"


def into_itself(down: float) -> str:
    """What to say of a path that runs down its own normals at an angle [rad]."""
    return (
        f"; the path runs {np.degrees(down):.0f} deg down its own normals here, so that a nozzle on them dips "
        "into what it has just laid"
    )


def descent(task: NozzleTask, i: int) -> float:
    """Angle [rad] at which the path descends at sample i into the surface that its normal belongs to."""
    way = task.tip[min(i + 1, len(task) - 1)] - task.tip[max(i - 1, 0)]
    length = float(np.linalg.norm(way))
    return float(np.arcsin(np.clip(-(way @ task.normals[i]) / length, -1.0, 1.0))) if length > 0.0 else 0.0


def _postures_at(cell: Cell, demand: SampledTasks, grid: Grid, rung: int, min_sigma: float) -> Array:
    """Postures (m, nj) of a rung's nodes, obstacles ignored."""
    one = [rung]
    few = demand.only(np.array(one), [0, 1])
    held = grid.chosen(len(demand.rung), len(cell.chosen))[one]
    own = replace(
        grid, roll_from=grid.roll_from[one], holder_from=grid.holder_from[one], branch=grid.branch[one], held=held
    )
    nodes = evaluate(cell, few, own, min_sigma)
    found = np.nonzero(np.isfinite(nodes.price))
    chosen = np.repeat(held, len(found[0]), axis=0)
    if cell.chosen and grid.swept is not None:
        chosen[:, grid.swept] = nodes.swept_at(own.holder_from[0] + found[2])
    return np.hstack([nodes.q[found].astype(float), chosen[:, : len(cell.holder)]])


def _hit(cell: Cell, found: LadderRoute, obstacles: Obstacles) -> tuple[int, int, float, Array]:
    """The rung at which a route comes closest to obstacles, the pair, its margin [m], and the posture (nj)."""
    nodes, route, demand = found.nodes, found.route, found.demand
    grid = nodes.grid
    r = np.arange(len(route.roll))
    roll, holder = route.roll - grid.roll_from, route.holder - grid.holder_from
    column = np.argmax(grid.branch == route.branch[:, None], axis=1)
    arm = nodes.q[r, roll, holder, column].astype(float)
    q = np.hstack([arm, found.chosen(len(cell.chosen))[:, : len(cell.holder)]])
    margin, which = obstacles.margins(q, demand.now[demand.rung], np.inf, CLEAR_ROOM)
    worst = int(np.argmin(margin))
    return worst, int(which[worst]), float(margin[worst]), q[worst]
