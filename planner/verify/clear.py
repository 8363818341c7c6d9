"""The checks that everything in the cell keeps apart, and where it comes nearest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.cell import Cell
from planner.plan import Approach, CellView, Check, Trajectory
from planner.print_body import PrintBody
from planner.problem import Problem
from planner.readonly import Array
from planner.solids import triangles_of
from planner.toolpath.bead import Toolpath
from planner.verify.bodies import HEAD, CellBodies, Distances, Pair, all_at_home, pairs
from planner.verify.checks import DIGITS, place
from planner.verify.collision import FAR, PrintPair, Swept, print_pairs, sweep
from planner.verify.nozzle import Nearness, check_nozzle, print_times

MOST_APPROACHES = 12


@dataclass(frozen=True)
class Apart:
    """How near all in the cell and the print come: pairs of bodies, then those with the print, and what was found."""

    hits: tuple[Pair, ...]
    near_print: tuple[PrintPair, ...]
    swept: Swept


def sweep_cell(problem: Problem, cell: Cell, toolpath: Toolpath, t: Trajectory, body: PrintBody) -> Apart:
    """The least distances of robots, fixtures and print from each other; body: as for `verify`."""
    spec = problem.collision
    bodies = CellBodies.of(cell)
    hits, near_print = pairs(bodies, spec.nozzle, spec.arm), print_pairs(bodies, spec.arm)
    alone = body.without_bodies  # whatever else stands there is known exactly
    return Apart(hits, near_print, sweep(bodies, (*hits, *near_print), t.q, alone, print_times(toolpath, t)))


def keep_apart(
    problem: Problem,
    cell: Cell,
    t: Trajectory,
    body: PrintBody,
    near: tuple[Nearness, Nearness],
    apart: Apart,
    checks: list[Check],
    metrics: dict[str, float],
    series: dict[str, Array],
) -> tuple[tuple[Approach, ...], CellView]:
    """Append the checks of nozzle, head, links, fixtures and print; returns the pairs of bodies that come nearest, and
    the bodies of the cell.

    near: the results of `by_the_tip` and `beyond`; apart: of `sweep_cell`. Distances are found up to FAR;
    `clearance_min_mm` is the least of all beyond the tip's zone (see `nozzle`).
    """
    spec = problem.collision
    rule, beyond = near
    checks.append(check_nozzle(problem, cell, t, body, rule))
    bodies = CellBodies.of(cell)
    hits, near_print, swept = apart.hits, apart.near_print, apart.swept
    found = _approaches(bodies, (*hits, *near_print), swept, body.without_bodies)
    robots, prints = found[: len(hits)], found[len(hits) :]
    checks.append(_check("arm clear of part and print", prints, spec.arm, t, _unknown(cell)))
    checks.append(_check("robots clear of each other and of fixtures", robots, spec.arm, t, _unknown(cell)))
    nozzle = []
    for each in (rule, beyond) if rule.least < 0.0 else (beyond,):  # by the rule it is no plain distance
        if each.point >= 0 and each.least + spec.nozzle < FAR:
            names = cell.head[each.body].name, body.name_of(each.point)
            nozzle.append(Approach(*names, each.least + spec.nozzle, spec.nozzle, each.at))
    distances = {
        "nozzle_clearance_min_mm": min(FAR, beyond.least + spec.nozzle),
        "arm_clearance_min_mm": min((each.distance for each in prints), default=FAR),
        "robot_clearance_min_mm": min((each.distance for each in robots), default=FAR),
    }
    metrics |= {name: distance * 1e3 for name, distance in distances.items()}
    metrics["clearance_min_mm"] = min(distances.values()) * 1e3
    series["clearance_mm"] = np.clip(np.minimum(beyond.margin + spec.nozzle, swept.nearest), None, FAR) * 1e3
    close = [each for each in (*nozzle, *robots, *prints) if each.distance < FAR]
    nearest = tuple(sorted(_once(close), key=_spare)[:MOST_APPROACHES])
    return nearest, _view(bodies)


def cell_view(cell: Cell) -> CellView:
    """All bodies of a cell by the names that approaches have, where they are with all joints at 0."""
    return _view(CellBodies.of(cell))


def _view(bodies: CellBodies) -> CellView:
    rest = bodies.poses(np.zeros((1, len(bodies.cell.joint_names))))[0]
    surfaces = [triangles_of(thing.solid) for thing in bodies.things]
    placed = [rest[thing.carrier] @ thing.T_carrier_solid for thing in bodies.things]
    return CellView(
        names=tuple(bodies.name(thing) for thing in bodies.things),
        kinds=tuple(thing.kind for thing in bodies.things),
        vertices=tuple(vertices @ T[:3, :3].T + T[:3, 3] for T, (vertices, _) in zip(placed, surfaces, strict=True)),
        triangles=tuple(triangles for _, triangles in surfaces),
        joints=np.array([bodies.moved_by(thing) for thing in bodies.things], dtype=np.int64).reshape(-1, 2),
    )


def check_start(problem: Problem, cell: Cell) -> None:
    """Raise InputError where the start posture lacks distance: no plan from there could hold."""
    spec = problem.collision
    bodies = CellBodies.of(cell)
    found = all_at_home(bodies, pairs(bodies, spec.nozzle, spec.arm), spec.nozzle)
    poses, distances = bodies.poses(cell.home[None])[0], Distances(bodies)
    apart = [distances.of(pair, poses) for pair in found]
    lacking = [distance - pair.need for distance, pair in zip(apart, found, strict=True)]
    if not lacking or min(lacking) >= -DIGITS:
        return
    k = int(np.argmin(lacking))
    a, b = (bodies.name(bodies.things[i]) for i in (found[k].a, found[k].b))
    if apart[k] <= 0.0:
        reason = f"{a} and {b} are {-apart[k] * 1e3:.1f} mm into each other in the start posture"
    else:
        reason = f"{a} and {b} are only {apart[k] * 1e3:.1f} mm apart in the start posture"
    key = "nozzle_mm" if HEAD in (bodies.things[found[k].a].kind, bodies.things[found[k].b].kind) else "arm_mm"
    hint = f"{found[k].need * 1e3:g} mm are asked for (collision.{key}): another posture, or check where things stand"
    raise problem.error("cell.home_deg", reason, hint)


def _spare(approach: Approach) -> float:
    return approach.distance - approach.need


def _once(approaches: list[Approach]) -> list[Approach]:
    """The worst of those with the same two names."""
    worst: dict[frozenset[str], Approach] = {}
    for each in sorted(approaches, key=_spare):
        worst.setdefault(frozenset((each.a, each.b)), each)
    return list(worst.values())


def _approaches(
    bodies: CellBodies, found: tuple[Pair | PrintPair, ...], swept: Swept, body: PrintBody
) -> tuple[Approach, ...]:
    """Of each pair."""
    out = []
    for k, pair in enumerate(found):
        point = int(swept.points[k])
        if isinstance(pair, Pair):
            other = bodies.name(bodies.things[pair.b])
        else:
            other = body.name_of(point) if point >= 0 else ""
        a = bodies.name(bodies.things[pair.a])
        out.append(Approach(a, other, float(swept.distance[k]), pair.need, round(float(swept.at[k]))))
    return tuple(out)


def _check(name: str, found: tuple[Approach, ...], need: float, t: Trajectory, unknown: str) -> Check:
    """The check of the pair that lacks most, or is nearest to it."""
    worst = min(found, key=_spare, default=None)
    if worst is None or worst.distance >= FAR:
        words = [f"nothing within {FAR * 1e3:g} mm"] if found else []
        where = "; ".join([*words, *([unknown] if unknown else [])]) or "there are no such bodies"
        return Check(name, FAR * 1e3, need * 1e3, "mm", True, where, least=True)
    where = f"{worst.a} and {worst.b}, {place(t, worst.sample)}" + (f"; {unknown}" if unknown else "")
    ok = worst.distance >= worst.need - DIGITS
    return Check(name, worst.distance * 1e3, worst.need * 1e3, "mm", ok, where, least=True, sample=worst.sample)


def _unknown(cell: Cell) -> str:
    """Which robots have no bodies; empty if all have some."""
    robots = [robot for robot in (cell.arm_robot, cell.holder_robot) if robot is not None]
    names = [robot.name for robot in robots if not any(robot.bodies)]
    return f"not checked: {' and '.join(names)}, without bodies" if names else ""
