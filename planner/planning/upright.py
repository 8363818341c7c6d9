"""Prints that no posture can lay: if the nozzle's axis is given, its collisions are known without a search.

A search checks some places of a path, where struts just steep enough to clear the nozzle may pass although they fail at
others; and it ends at the first lack of clearance, not where the nozzle is inside the plate. Here each bead is followed
as verification follows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from planner.base.arrays import Array
from planner.base.errors import Blocked, Change, Hints
from planner.cell.cell import build_cell
from planner.cell.solids import packed
from planner.collision.print_body import TipRoom, tip_room
from planner.collision.scene import is_round
from planner.planning.clearance import may_come_nearer
from planner.planning.context import PlanningContext, context_of
from planner.problem import Problem
from planner.resolve.infeasible import TILTS, descent, into_itself, nearer_hint
from planner.resolve.joint_path import refuse_at
from planner.toolpath.bead import Bead
from planner.verify.checks import DIGITS
from planner.verify.executed import UNKNOWN, ExecutedMotion
from planner.verify.nozzle import nozzle_nearness

RAISES = (5.0, 10.0, 20.0, 40.0, 80.0)  # mm by which the part is raised on its plate
_STEP = 0.2e-3  # m between places along a bead; between them it is checked as finely as necessary
_SLENDERER = "a slimmer nozzle (cell.nozzle.profile_mm) may fit: not tried"
_LEAN = "process.cones.nozzle_normal_deg"
_PART = "cell.positioner.part_mm"


def check_upright(given: PlanningContext) -> None:
    """Raise Blocked, with the place, if an upright nozzle hits struts or bodies around the part whatever the posture.

    Beads on a surface that come close to their own print, and nozzles that may lean, are left to the search.
    """
    met = _met(given)
    if met is None:
        return
    bead, task = given.toolpath.beads[met.bead], given.tasks[met.bead - given.printed]
    i = task.first + int(np.argmin(np.abs(bead.s - met.s)))
    down = descent(task, i)
    reason = f"collision of {met.body} with {met.near}: with the given axis every posture lacks {met.lacks * 1e3:.2f} mm of clearance"
    if met.near == f"bead {met.bead}" and down > 0.0:
        reason += into_itself(down)
    raises = () if bead.round else _raises(given)
    if raises:
        reason += f"; the part would be clear {raises[0]:g} mm higher on its plate"
    nearer = nearer_hint(_asked(given.problem) - met.lacks + DIGITS, "clears the nozzle here")
    refuse_at(task, i, reason, hints=lambda: (*nearer, *(_raising(given, raises) or _leaning())), kind=Blocked)


@dataclass(frozen=True)
class _Met:
    """A body of the head and what it collides with, at an arc length of a bead [m], and how deep [m]."""

    bead: int
    s: float
    body: str
    near: str
    lacks: float


def _met(given: PlanningContext) -> _Met | None:
    """The deepest collision of an upright nozzle on the first bead that has one."""
    problem, beads, body = given.problem, given.toolpath.beads, given.body
    struts = beads[0].round
    if problem.process.cones.tilt > 0.0 or not (struts or body.bodies):
        return None
    body = body if struts else body.bodies_alone
    # bodies that are not round about the axis may be turned away
    heads = {
        name: tuple(each for each in given.cell.at(name).head if is_round(each, np.eye(4)))
        for name in {bead.material for bead in beads}
    }
    solids = {name: packed(head) for name, head in heads.items()}
    clearance = _asked(problem)
    room = tip_room(problem, given.toolpath)
    for k in range(given.first_bead, len(beads)):
        bead = beads[k]
        s, motion = _along(bead)
        now = np.minimum(k + s / bead.length, np.nextafter(k + 1.0, 0.0))
        own = TipRoom(np.full(len(s), room.slack[k]), np.full(len(s), room.graze[k]))
        found = nozzle_nearness(body.tree, solids[bead.material], motion, now, own, clearance, look=0.0)
        if found.point >= 0 and found.least < -DIGITS:
            head = heads[bead.material][found.body].name
            return _Met(k, float(s[found.at]), head, body.name_of(found.point), -float(found.least))
    return None


def _asked(problem: Problem) -> float:
    """The distance that nozzle and head must keep in any case [m]."""
    return 0.0 if may_come_nearer(problem) else problem.collision.nozzle


def _leaning() -> Hints:
    """What may help: a nozzle that leans, which can be planned, or one of another shape, which is up to the user."""
    tries = tuple((f"{_LEAN}: {deg:g}", ((_LEAN, f"{deg:g}"),)) for deg in TILTS)
    return Change(f"{_LEAN}: {TILTS[-1]:g} may let the nozzle lean clear", tries), _SLENDERER


def _raises(given: PlanningContext) -> tuple[float, ...]:
    """How far a part must be raised on its plate to be clear [mm]: the least of RAISES that suffices, and larger ones.

    None for a part on a bed.
    """
    if given.problem.cell.positioner is None:
        return ()
    for i, more in enumerate(RAISES):
        problem = given.problem.changed([f"{_PART}={_higher(given, more)}"])
        if _met(context_of(problem, build_cell(problem), given.toolpath, given.first_bead)) is None:
            return RAISES[i:]
    return ()


def _higher(given: PlanningContext, more: float) -> list[float]:
    """The part's place on its plate, so much higher [mm]."""
    table = given.problem.cell.positioner
    x, y, z = (0.0, 0.0, 0.0) if table is None else (round(1e3 * each, 6) for each in table.part)
    return [x, y, z + more]


def _raising(given: PlanningContext, raises: Sequence[float]) -> Hints:
    """A hint to raise the part on its plate, by the least of some heights [mm] or the next."""
    tries = [(f"{_PART}: {place}", ((_PART, place),)) for place in (_higher(given, each) for each in raises[:2])]
    return (Change(f"{tries[0][0]} clears the nozzle", tuple(tries)),) if tries else ()


def _along(bead: Bead) -> tuple[Array, ExecutedMotion]:
    """Arc lengths (n) along a bead [m], and the nozzle's motion relative to the print there."""
    n = max(int(np.ceil(bead.length / _STEP)), 1) + 1
    s = np.union1d(bead.s, np.linspace(0.0, bead.length, n)) if bead.round else bead.s
    tip = np.asarray(CubicSpline(bead.s, bead.points)(s))
    z, x = (
        np.column_stack([np.interp(s, bead.s, column) for column in each.T]) for each in (-bead.normals, bead.roll_zero)
    )
    z = z / np.linalg.norm(z, axis=1)[:, None]
    x = x - (x * z).sum(axis=1)[:, None] * z
    x = x / np.linalg.norm(x, axis=1)[:, None]
    rotation = np.stack([x, np.cross(z, x), z], axis=-1)
    none = np.full(len(s), np.nan)
    return s, ExecutedMotion(tip, z, rotation, np.zeros_like(tip), none, none, np.full(len(s), UNKNOWN, dtype=np.int8))
