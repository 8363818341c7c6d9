"""A player of programs: how a controller would run one, and what limits its pace."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.base.geometry import arc_lengths
from planner.export.fit import continuous, from_matrix
from planner.export.player.controller import PostureKnots, knots_of
from planner.export.player.model import PLAIN, MotionModel
from planner.export.player.pace import TIP, pace
from planner.export.player.played import TIMES, Played, ProgramEvent, laid_moves
from planner.export.program import RobotProgram

if TYPE_CHECKING:
    from planner.cell.cell import Cell

# ----------------------------------------------------------------------------------------------------
# Where something other than the programmed speed of the tip sets the pace while material is laid.

ACCELERATION = "accelerations of the joints"
SHORT = 0.05  # share of the programmed speed; a smaller shortfall is not reported


@dataclass(frozen=True)
class Limited:
    """Moves that lay material more slowly than programmed, all for the same reason.

    by       what sets the pace instead of the tip: reorientation, an axis of the station, the speed limit of a joint,
             or the joints' accelerations, which slow down before and after
    moves    how many; first: the first of them; worst: the one that falls short most
    reached  share of its programmed speed that the worst one reaches
    """

    by: str
    moves: int
    first: int
    worst: int
    reached: float

    @property
    def words(self) -> str:
        """One line for the notes of a program."""
        moves = f"{self.moves} moves on beads are" if self.moves > 1 else "1 move on a bead is"
        return f"{moves} slowed by {self.by}, the worst to {100 * self.reached:.0f} % of its speed"


def limited(program: RobotProgram, played: Played) -> tuple[Limited, ...]:
    """Why material is laid more than 5 % more slowly than programmed, most moves first; empty if it is not."""
    m = len(program.linear)
    steps = np.linalg.norm(np.diff(played.position, axis=0), axis=1)
    took = np.bincount(played.move, played.phases[:, TIMES].sum(axis=1), minlength=m)
    meant = np.bincount(played.move, steps, minlength=m) / program.speed[:, 0]
    reached = np.where(took > 0.0, meant / np.where(took > 0.0, took, 1.0), 1.0)
    late = laid_moves(played) & (reached < 1.0 - SHORT)
    # for each move, what limits the longest of its ways that is not limited by the tip
    other = np.where(played.limit != TIP, played.length, 0.0)
    reason = np.full(m, TIP)
    order = np.argsort(other, kind="stable")
    order = order[other[order] > 0.0]
    reason[played.move[order]] = played.limit[order]
    return _sorted([_group(played, late & (reason == each), each, reached) for each in np.unique(reason[late])])


def _group(played: Played, chosen: NDArray[np.bool_], reason: int, reached: NDArray[np.float64]) -> Limited:
    moves = np.flatnonzero(chosen)
    worst = int(moves[np.argmin(reached[moves])])
    by = ACCELERATION if reason == TIP else played.limits[reason]
    return Limited(by, len(moves), int(moves[0]), worst, float(reached[worst]))


def _sorted(found: list[Limited]) -> tuple[Limited, ...]:
    return tuple(sorted(found, key=lambda each: -each.moves))


# ----------------------------------------------------------------------------------------------------
# The player.
#
# The model. Lines and arcs are followed exactly in the part frame, joint moves exactly in joint space. The speed on
# each stretch is that of the slowest of the tip, reorientation and the station's axes, each as programmed, and of the
# joints with their own limits (ABB, RAPID reference: MoveL, speeddata). Speed changes as quickly as the cell's joint
# accelerations and the ramps of the controller's model allow. At `fine` targets and in waits the robot stands still;
# corners are taken within their zones at the speed at which joints can turn from one line to the next (zonedata: no
# longer than half of the neighbouring lines).
#
# The played path passes corners at their targets; `path.corner_depth` says how far inside the true path lies. Loads and
# settling are left out. Logic after a fly-by target happens as the target is passed, whereas a controller runs ahead of
# the motion by a fraction of a second.

ORDER = {"output": 0, "demand": 1, "send": 2, "wait": 3}  # of simultaneous events


def play(program: RobotProgram, cell: Cell, model: MotionModel = PLAIN) -> Played:
    """A program over time, from its start posture at t = 0 to its last target; takes time linear in its moves.

    The path is that of the cell's own nozzle, in the cell's own part frame, when the joints go where the program's tool
    and work object send them. model: of the controller; the plain one does what a program says. Raises InputError for
    targets that cannot be reached as the program says, and for axes that the cell does not have.
    """
    knots = knots_of(program, cell)
    times = pace(program, cell, knots, model)
    T = cell.T_part_nozzle(np.ascontiguousarray(knots.q))
    played = Played(
        q=knots.q,
        position=np.ascontiguousarray(T[:, :3, 3]),
        quat=continuous(from_matrix(T[:, :3, :3])),
        move=knots.move,
        leave=times.leave,
        length=times.length,
        phases=times.phases,
        limit=times.limit,
        limits=times.limits,
        target=knots.target,
        arrive=times.arrive,
        strays=knots.strays,
        events=(),
    )
    return replace(played, events=_events(program, knots, played))


def _events(program: RobotProgram, knots: PostureKnots, played: Played) -> tuple[ProgramEvent, ...]:
    """Everything that the program switches, sends and waits for, in order of time."""
    found: list[tuple[float, int, int, str, float, str]] = []
    for i, group in program.triggers.items():
        for trigger in group:
            t = _passed(knots, played, i, trigger.distance, trigger.from_start)
            found.append((t, i, ORDER["output"], "output", float(trigger.value), trigger.signal))
    for i, levels in program.demands.items():
        for distance, value in levels:
            t = _passed(knots, played, i, distance, False)
            found.append((t, i, ORDER["demand"], "demand", value, ""))
    for i, lines in program.sends.items():
        t = 0.0 if i < 0 else float(played.arrive[i])
        rested = program.send_rests.get(i, (0.0,) * len(lines))
        found += [(t + rest, i, ORDER["send"], "send", 0.0, line) for rest, line in zip(rested, lines, strict=True)]
    for i in np.flatnonzero(program.wait > 0.0).tolist():
        found.append((float(played.arrive[i]), i, ORDER["wait"], "wait", float(program.wait[i]), ""))
    found.sort(key=lambda event: event[:3])  # stable: lines at the same place keep their order
    places = played.at(np.array([event[0] for event in found])).position.tolist() if found else []
    return tuple(
        ProgramEvent(t, kind, move, (x, y, z), value, text)
        for (t, move, _, kind, value, text), (x, y, z) in zip(found, places, strict=True)
    )


def _passed(knots: PostureKnots, played: Played, i: int, distance: float, from_start: bool) -> float:
    """When the tip is at a distance [m] from the start, or from the end, of move i [s]; never outside the move."""
    last = int(knots.target[i])
    first = int(knots.target[i - 1]) if i else 0
    way = arc_lengths(knots.position[first : last + 1])
    at = float(np.clip(distance if from_start else way[-1] - distance, 0.0, way[-1]))
    if at >= way[-1] and not (from_start and distance <= 0.0):
        return float(played.arrive[i])
    part = min(int(np.searchsorted(way, at, side="right")) - 1, last - first - 1)
    u = (at - way[part]) / max(way[part + 1] - way[part], 1e-12)
    return float(played.reached(np.array([first + part]), np.array([u]))[0])
