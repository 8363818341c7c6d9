"""Least distances between robots, fixtures and print along a trajectory, by Pinocchio's poses and coal.

Conservative advancement: between two instants, the distance of a pair changes by no more than its joints' travel times
its swing. An interval that could hide too small a distance by that bound is halved, down to a fraction of a sample.

An instant is a time in fractions of a sample (_PARTS per sample); n counts samples, p pairs. Distances are in metres.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array, Ints
from planner.cell.bodies import NOZZLE, OF
from planner.cell.cell import Cell
from planner.cell.solids import Body, ConvexSolid, Mesh, Packed, packed
from planner.cell.urdf import link_frame
from planner.collision.point_tree import PointTree, SolidNumbers, least_distances, search_room
from planner.collision.print_body import PrintBody
from planner.plan import Approach, Check, Trajectory
from planner.plan.plan import by_nozzle
from planner.problem import Problem
from planner.toolpath.bead import Toolpath
from planner.verify.bodies import (
    ARM,
    BUILT,
    CARRIED,
    FIXTURE,
    HEAD,
    HOLDER,
    CellBodies,
    CheckedBody,
    Distances,
    Pair,
    all_at_home,
    many_postures,
    pairs,
)
from planner.verify.checks import DIGITS, FAR, TOLERANCE, Findings, Judged, place
from planner.verify.nozzle import Nearness, asked_at, check_nozzle, print_times

MOST_APPROACHES = 12  # pairs of bodies that the plan names
_SEEN = 0.1  # m: greatest distance from the print computed; the larger, the longer a body can be skipped
_ABOUT = 0.95  # relative accuracy of distances beyond FAR
_SHARE = 0.2  # accuracy of a least distance, relative to its difference from the required one
_PARTS = 16  # instants per sample
_FIRST = 512 * _PARTS  # instants between the first evaluations


@dataclass(frozen=True)
class Swept:
    """Least distances of pairs (p) along a trajectory: distance (p) [m], and `at` (p), the time of each [samples].

    points (p)   nearest point of the print, in its tree's order; -1 for pairs of bodies
    nearest (n)  least distance of all pairs at each sample [m], FAR at most; interpolated between evaluations
    looks        number of distances evaluated
    """

    distance: Array
    at: Array
    points: Ints
    nearest: Array
    looks: int


@dataclass(frozen=True)
class PrintPair:
    """A body (index) that can come near part and print, its required distance [m], swing (see Pair), convex solid."""

    a: int
    need: float
    swing: Array
    solid: ConvexSolid


def print_pairs(bodies: CellBodies, need: float, body: PrintBody) -> tuple[PrintPair, ...]:
    """Pairs of part and print with links and, where the part moves, with fixtures; hollow meshes are left out.

    Links of the robot that holds the part are left out if all of its free joints carry them, since they move with the
    part, or if they are too near to the part in every posture: they are built that way.
    """
    part = part_thing(bodies, body.tree)
    found = []
    for i, thing in enumerate(bodies.things):
        if thing.kind not in (ARM, HOLDER, FIXTURE):
            continue
        holds = thing.kind == HOLDER
        swing = bodies.swing(part, thing.joints) if holds else bodies.swing(thing) + bodies.swing(part)
        solid = thing.solid.filled if isinstance(thing.solid, Mesh) else thing.solid
        if swing.any() and solid is not None:
            found.append(PrintPair(i, need, swing, solid))
    return _without_joined(bodies, tuple(found), body)


def _without_joined(bodies: CellBodies, found: tuple[PrintPair, ...], body: PrintBody) -> tuple[PrintPair, ...]:
    """The pairs without links of the robot that holds the part that are too near to the bare part in all of many
    postures, as in `pairs` for bodies of one robot."""
    if not any(bodies.things[pair.a].kind == HOLDER for pair in found):
        return found
    q = many_postures(bodies.cell)
    now, poses = np.zeros(len(q)), bodies.poses(q)
    looks, kept = _Sweep(bodies, found, q, body, now), []
    for pair in found:
        need = pair.need
        if bodies.things[pair.a].kind == HOLDER:
            most = float(looks.from_print(pair, poses, np.arange(len(q)), now)[0].max())
            need = need if most >= need else min(need, BUILT)
            if most < need:
                continue
        kept.append(replace(pair, need=need))
    return tuple(kept)


def sweep(bodies: CellBodies, pairs: Sequence[Pair | PrintPair], q: Array, body: PrintBody, now: Array) -> Swept:
    """Least distances of pairs along postures q (n, nq); now (n): printed so far at each sample, see `print_times`."""
    if not pairs:
        return Swept(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64), np.full(len(q), FAR), 0)
    return _Sweep(bodies, pairs, q, body, now).done()


def part_thing(bodies: CellBodies, tree: PointTree) -> CheckedBody:
    """Part and print, points of a tree in the part frame, as a body with its carrier."""
    cell = bodies.cell
    robot = cell.holder_robot
    if robot is None:
        carrier, joints, T = 0, 0, cell.T_world_holder
    else:
        joints = robot.model.njoints - 1
        carrier = len(cell.arm) + joints
        T = robot.model.frames[link_frame(robot.model, robot.tip)].placement.homogeneous @ cell.T_plate_part
    centre, reach = T[:3, :3] @ tree.centre[0] + T[:3, 3], float(tree.reach[0])
    return CheckedBody("part", CARRIED, carrier, joints, None, T, None, T, centre, reach)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Apart:
    """How near bodies of the cell and the print come to each other.

    rows        samples that this holds for: while one nozzle is in use
    hits        pairs of bodies
    near_print  bodies that can come near the print
    swept       least distances of hits, then of near_print
    """

    rows: slice
    bodies: CellBodies
    hits: tuple[Pair, ...]
    near_print: tuple[PrintPair, ...]
    swept: Swept


def sweep_cell(problem: Problem, cell: Cell, toolpath: Toolpath, t: Trajectory, body: PrintBody) -> tuple[Apart, ...]:
    """Least distances between robots, fixtures and print along a trajectory; body: as for `verify`.

    One result for each stretch with one nozzle in use."""
    spec, now = problem.collision, print_times(toolpath, t)
    alone = body.without_bodies  # the pairs have bodies that stand with the print as exact solids
    known: dict[int, tuple[CellBodies, tuple[Pair, ...], tuple[PrintPair, ...]]] = {}
    found = []
    for own, rows in by_nozzle(cell, t.events, t.t):
        if own.in_use not in known:
            bodies = CellBodies.of(own)
            hits, near_print = pairs(bodies, spec.nozzle, spec.arm), print_pairs(bodies, spec.arm, alone)
            known[own.in_use] = bodies, hits, near_print
        bodies, hits, near_print = known[own.in_use]
        swept = sweep(bodies, (*hits, *near_print), np.ascontiguousarray(t.q[rows]), alone, now[rows])
        found.append(Apart(rows, bodies, hits, near_print, swept))
    return tuple(found)


def keep_apart(
    judged: Judged, near: tuple[Nearness, Nearness], apart: Sequence[Apart]
) -> tuple[Findings, tuple[Approach, ...]]:
    """The checks of nozzle, head, links, fixtures and print, and the pairs of bodies that come nearest.

    near: the results of `by_the_tip` and `beyond`; apart: of `sweep_cell`. Distances are found up to FAR;
    `clearance_min_mm` is the least of all outside the tip's zone (see `nozzle`).
    """
    cell, t, body, spec = judged.cell, judged.trajectory, judged.body, judged.problem.collision
    rule, beyond = near
    robots: tuple[Approach, ...] = ()
    prints: tuple[Approach, ...] = ()
    for each in apart:
        found = _approaches(each, body.without_bodies)
        robots, prints = (*robots, *found[: len(each.hits)]), (*prints, *found[len(each.hits) :])
    swept_nearest = np.concatenate([each.swept.nearest for each in apart])
    checks = (
        check_nozzle(judged, near),
        _check(
            "arm clear of part and print", prints, spec.arm, t, "; ".join(filter(None, (_unknown(cell), _hollow(cell))))
        ),
        _check("robots clear of each other and of fixtures", robots, spec.arm, t, _unknown(cell)),
    )
    nozzle = []
    asked = (beyond, spec.nozzle), (rule, asked_at(judged, rule))
    for one, need in asked if rule.least < 0.0 else asked[:1]:
        if one.point >= 0 and one.least + need < FAR:
            names = judged.cell_at(one.at).head[one.body].name, body.name_of(one.point)
            nozzle.append(Approach(*names, one.least + need, need, one.at))
    distances = {
        "nozzle_clearance_min_mm": min(FAR, beyond.least + spec.nozzle),
        "arm_clearance_min_mm": min((approach.distance for approach in prints), default=FAR),
        "robot_clearance_min_mm": min((approach.distance for approach in robots), default=FAR),
    }
    metrics = {name: distance * 1e3 for name, distance in distances.items()}
    metrics["clearance_min_mm"] = min(distances.values()) * 1e3
    series = {"clearance_mm": np.clip(np.minimum(beyond.margin + spec.nozzle, swept_nearest), None, FAR) * 1e3}
    close = [approach for approach in (*nozzle, *robots, *prints) if approach.distance < FAR]
    nearest = tuple(sorted(_once(close), key=_spare)[:MOST_APPROACHES])
    return Findings(checks, metrics, series), nearest


def check_start(problem: Problem, cell: Cell) -> None:
    """Raise InputError if bodies are too near to each other in the start posture, with any nozzle in use, or if nozzles
    touch each other: no plan from there could pass."""
    for k in range(max(len(cell.nozzles), 1)):
        bodies = CellBodies.of(cell.with_nozzle(k))
        _check_nozzles_apart(problem, bodies)
        _check_start(problem, bodies)


def _check_nozzles_apart(problem: Problem, bodies: CellBodies) -> None:
    """Raise InputError if nozzles that are on the flange together touch each other."""
    poses, distances = bodies.poses(bodies.cell.home[None])[0], Distances(bodies)
    heads = [
        i for i, thing in enumerate(bodies.things) if thing.kind == HEAD and thing.name.startswith(f"{NOZZLE}{OF}")
    ]
    for i, j in itertools.combinations(heads, 2):
        one, other = (bodies.things[k].name.removeprefix(f"{NOZZLE}{OF}") for k in (i, j))
        if one != other and distances.of(Pair(i, j, 0.0, np.empty(0)), poses) <= 0.0:
            hint = "move tip_mm and axis apart, or set mounted: one if nozzles are exchanged"
            raise problem.error(f"cell.nozzles.{other}", f"it touches the nozzle {one}", hint)


def _check_start(problem: Problem, bodies: CellBodies) -> None:
    spec = problem.collision
    found = all_at_home(bodies, pairs(bodies, spec.nozzle, spec.arm), spec.nozzle)
    poses, distances = bodies.poses(bodies.cell.home[None])[0], Distances(bodies)
    apart = [distances.of(pair, poses) for pair in found]
    lacking = [distance - pair.need for distance, pair in zip(apart, found, strict=True)]
    if not lacking or min(lacking) >= -DIGITS:
        return
    k = int(np.argmin(lacking))
    a, b = (bodies.name(bodies.things[i]) for i in (found[k].a, found[k].b))
    if apart[k] <= 0.0:
        reason = f"{a} and {b} are {-apart[k] * 1e3:.1f} mm inside each other in the start posture"
    else:
        reason = f"{a} and {b} are only {apart[k] * 1e3:.1f} mm apart in the start posture"
    key = "nozzle_mm" if HEAD in (bodies.things[found[k].a].kind, bodies.things[found[k].b].kind) else "arm_mm"
    hint = f"{found[k].need * 1e3:g} mm are required (collision.{key}): change the posture, or check the placement"
    raise problem.error("cell.home_deg", reason, hint)


class _Sweep:
    """The search for the least distances: its prepared input, and the results so far."""

    def __init__(
        self, bodies: CellBodies, pairs: Sequence[Pair | PrintPair], q: Array, body: PrintBody, now: Array
    ) -> None:
        self.bodies, self.pairs, self.q, self.tree, self.now = bodies, pairs, q, body.tree, now
        self.turned = np.zeros(q.shape)  # filled in place: for a large print it takes much of the memory
        np.subtract(q[1:], q[:-1], out=self.turned[1:])
        np.abs(self.turned, out=self.turned)
        np.cumsum(self.turned, axis=0, out=self.turned)
        self.coal, self.room = Distances(bodies), search_room()
        self.part = part_thing(bodies, body.tree)
        p = len(pairs)
        self.need, self.swing = np.array([pair.need for pair in pairs]), np.array([pair.swing for pair in pairs])
        self.printed = np.array([isinstance(pair, PrintPair) for pair in pairs])
        things = bodies.things
        first = [things[pair.a] for pair in pairs]
        second = [things[pair.b] if isinstance(pair, Pair) else self.part for pair in pairs]
        self.balls = [
            (
                np.array([thing.carrier for thing in side]),
                np.array([thing.centre for thing in side]),
                np.array([thing.reach for thing in side]),
            )
            for side in (first, second)
        ]
        self.solids: dict[int, Packed] = {
            pair.a: packed([Body(things[pair.a].name, pair.solid, things[pair.a].T_carrier_solid)])
            for pair in pairs
            if isinstance(pair, PrintPair)
        }
        self.least, self.at, self.points = np.full(p, FAR), np.zeros(p), np.full(p, -1, dtype=np.int64)
        self.nearest = np.full(len(q), FAR)
        self.looks = 0

    def done(self) -> Swept:
        """Halve intervals until none can hide a distance below its target."""
        end = (len(self.q) - 1) * _PARTS
        knots = np.unique(np.append(np.arange(0, end, _FIRST), end))
        p, k = len(self.pairs), len(knots)
        pair = np.repeat(np.arange(p), k)
        value = self._distances(pair, np.tile(knots, p)).reshape(p, k)
        self.nearest = np.minimum(FAR, np.interp(np.arange(len(self.q)), knots / _PARTS, value.min(axis=0)))
        pair = np.repeat(np.arange(p), k - 1)
        a, b = np.tile(knots[:-1], p), np.tile(knots[1:], p)
        da, db = value[:, :-1].ravel(), value[:, 1:].ravel()
        while len(pair):
            open_ = (self._bound(pair, a, b, da, db) < self._target()[pair]) & (b - a > 1)
            pair, a, b, da, db = pair[open_], a[open_], b[open_], da[open_], db[open_]
            middle = (a + b) // 2
            dm = self._distances(pair, middle)
            np.minimum.at(self.nearest, middle // _PARTS, dm)
            pair, a, b = np.tile(pair, 2), np.concatenate([a, middle]), np.concatenate([middle, b])
            da, db = np.concatenate([da, dm]), np.concatenate([dm, db])
        return Swept(self.least, self.at, self.points, self.nearest, self.looks)

    def _target(self) -> Array:
        """Targets (p) [m]: a distance of a pair matters only if it is below this."""
        found = self.least - np.maximum(TOLERANCE, _SHARE * np.abs(self.least - self.need))
        return np.where(self.least >= self.need, np.maximum(found, self.need - TOLERANCE), found)

    def _bound(self, pair: Ints, a: Ints, b: Ints, da: Array, db: Array) -> Array:
        """Lower bounds of pairs' distances between instants a and b, where they are da and db."""
        turned = self._at(self.turned, b) - self._at(self.turned, a)
        moved = (turned * self.swing[pair]).sum(axis=1)
        both = 0.5 * (da + db - moved)
        grown = self.printed[pair] & (
            self._printed(b) > self._printed(a)
        )  # whatever is printed in between is there at b
        return np.where(grown, db - moved, both)

    def _at(self, values: Array, instant: Ints) -> Array:
        """Values (n, ...) of samples at instants."""
        k, part = np.divmod(instant, _PARTS)
        share = (part / _PARTS)[:, None]
        return (1.0 - share) * values[k] + share * values[np.minimum(k + 1, len(values) - 1)]

    def _printed(self, instant: Ints) -> Array:
        """How much is printed at instants: as much as at the next sample."""
        return self.now[-(-instant // _PARTS)]

    def _distances(self, pair: Ints, instant: Ints) -> Array:
        """Distances of pairs at instants, or lower bounds of those beyond FAR; keeps the least."""
        out = np.empty(len(pair))
        order = np.argsort(instant, kind="stable")
        for rows in np.array_split(order, max(1, len(order) // 100_000)):
            times, which = np.unique(instant[rows], return_inverse=True)
            poses = self.bodies.poses(self._at(self.q, times))
            out[rows] = self._apart(pair[rows], which, poses)
            near = rows[out[rows] < FAR]
            of = which[out[rows] < FAR]
            for k in np.unique(pair[near]).tolist():
                own = pair[near] == k
                out[near[own]] = self._of_pair(k, instant[near[own]], poses, of[own])
        return out

    def _apart(self, pair: Ints, which: Ints, poses: Array) -> Array:
        """Distances of the bounding spheres of each pair, with carriers at poses[which]."""
        middle, reach = [], np.zeros(len(pair))
        for carrier, centre, size in self.balls:
            T = poses[which, carrier[pair]]
            middle.append(np.einsum("nij,nj->ni", T[:, :3, :3], centre[pair]) + T[:, :3, 3])
            reach += size[pair]
        return np.asarray(np.linalg.norm(middle[0] - middle[1], axis=1) - reach)

    def _of_pair(self, k: int, instant: Ints, poses: Array, which: Ints) -> Array:
        """Distances of one pair at instants (n), in increasing order, with carriers at poses[which]."""
        pair = self.pairs[k]
        self.looks += len(instant)
        if isinstance(pair, Pair):
            distance = self.coal.along(pair, poses[which])
            point = np.full(len(distance), -1)
        else:
            distance, point = self.from_print(pair, poses, which, self._printed(instant))
        best = int(np.argmin(distance))
        if distance[best] < self.least[k]:
            self.least[k], self.at[k], self.points[k] = distance[best], instant[best] / _PARTS, point[best]
        return distance

    def from_print(self, pair: PrintPair, poses: Array, which: Ints, now: Array) -> tuple[Array, Ints]:
        """Distances (n) of a body from the print at times now (n), and the nearest points (n) or -1.

        Distances are capped at _SEEN; beyond FAR their accuracy is _ABOUT.
        """
        thing, solid, tree = self.bodies.things[pair.a], self.solids[pair.a], self.tree
        T_world_part = poses[which, self.part.carrier] @ self.part.T_carrier_solid
        T_carrier_part = np.linalg.inv(poses[which, thing.carrier]) @ T_world_part
        T_solid_part = solid.T_solid_frame[0] @ T_carrier_part
        distance, point = np.empty(len(now)), np.empty(len(now), dtype=np.int64)
        alone = SolidNumbers(solid.kind[0], solid.size[0], solid.planes)
        least_distances(tree.arrays, alone, T_solid_part, now, FAR, _SEEN, _ABOUT, self.room, distance, point)
        return distance, point


def _spare(approach: Approach) -> float:
    """Distance in excess of the required one [m]."""
    return approach.distance - approach.need


def _once(approaches: list[Approach]) -> list[Approach]:
    """The worst approach for each pair of names."""
    worst: dict[frozenset[str], Approach] = {}
    for each in sorted(approaches, key=_spare):
        worst.setdefault(frozenset((each.a, each.b)), each)
    return list(worst.values())


def _approaches(apart: Apart, body: PrintBody) -> tuple[Approach, ...]:
    """The approach of each pair."""
    bodies, swept, out = apart.bodies, apart.swept, []
    found: tuple[Pair | PrintPair, ...] = (*apart.hits, *apart.near_print)
    for k, pair in enumerate(found):
        point = int(swept.points[k])
        if isinstance(pair, Pair):
            other = bodies.name(bodies.things[pair.b])
        else:
            other = body.name_of(point) if point >= 0 else ""
        a = bodies.name(bodies.things[pair.a])
        out.append(
            Approach(a, other, float(swept.distance[k]), pair.need, apart.rows.start + round(float(swept.at[k])))
        )
    return tuple(out)


def _check(name: str, found: tuple[Approach, ...], need: float, t: Trajectory, unknown: str) -> Check:
    """The check of the pair with the least distance in excess of its required one."""
    worst = min(found, key=_spare, default=None)
    if worst is None or worst.distance >= FAR:
        words = [f"nothing within {FAR * 1e3:g} mm"] if found else []
        where = "; ".join([*words, *([unknown] if unknown else [])]) or "there are no such bodies"
        return Check(name, FAR * 1e3, need * 1e3, "mm", True, where, least=True)
    where = f"{worst.a} and {worst.b}, {place(t, worst.sample)}" + (f"; {unknown}" if unknown else "")
    ok = worst.distance >= worst.need - DIGITS
    return Check(name, worst.distance * 1e3, worst.need * 1e3, "mm", ok, where, least=True, sample=worst.sample)


def _unknown(cell: Cell) -> str:
    """Which robots have no bodies, and which joints of the others carry none, in words; empty if all have them."""
    robots = [robot for robot in (cell.arm_robot, cell.holder_robot) if robot is not None]
    names = []
    for robot in robots:
        bare = [name for name, bodies in zip(robot.joint_names, robot.bodies[1:], strict=True) if not bodies]
        if not any(robot.bodies):
            names.append(robot.name)
        elif bare:
            names.append(f"what {', '.join(bare)} of {robot.name} carry" + ("" if len(bare) > 1 else "s"))
    return f"not checked: {' and '.join(names)}, without bodies" if names else ""


def _hollow(cell: Cell) -> str:
    """Which fixtures are not checked against a moving print as they do not fill their hulls; empty if there is none."""
    meshes = [body for body in cell.fixtures if isinstance(body.solid, Mesh) and body.solid.filled is None]
    names = " and ".join(body.name for body in meshes)
    return f"not checked: print and {names}, hollow" if meshes and len(cell.holder) else ""
