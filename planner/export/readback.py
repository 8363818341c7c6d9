"""Whether a program, read back and played, does what its plan does: where it goes, how fast, and what it switches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from planner.errors import InputError
from planner.export.compare import Agreement, compare
from planner.export.moves import deposits
from planner.export.player import Played, play
from planner.export.player.laying import laid_spans, laid_targets
from planner.export.program import Program
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.plan import Plan


# of the time in which material is laid: wide, for it is a model's, which small prints full of corners stretch by 5 per
# cent; shipped problems stay within half a per cent (`python -m benchmarks.programs`)
LATE = 0.1
# m by which corners may be cut, as far as `Agreement` lets paths differ: in beads beyond the tolerance, and in travel
ROUNDING, TRAVEL = 0.03e-3, 1e-3


@dataclass(frozen=True)
class Readback:
    """What a played program does otherwise than its plan.

    agreement  of the played nozzle, as the cell's joints carry it, with the plan
    laid       time in which the program lays material over that in which the plan does; worst: of the bead that differs
               most
    corner     how far the nozzle passes inside of a target at which material is laid, at most [m]
    swing      how far it passes inside of any other target, at most [m]
    stops      targets within beads at which the robot comes to rest without waiting
    strays     targets whose configuration the robot does not have when it comes there
    """

    agreement: Agreement
    laid: float
    worst: float
    corner: float
    swing: float
    stops: int
    strays: tuple[int, ...]

    def complaints(self) -> list[str]:
        """Every difference beyond what rounding and thinning may cause, in words."""
        found = self.agreement.complaints()
        if not abs(self.laid - 1.0) <= LATE:
            found.append(f"time of deposition is {self.laid:.4g} of the plan's (limit {LATE:g} from 1)")
        for where, cut, limit in (
            ("in a bead", self.corner, self.agreement.chord + ROUNDING),
            ("in travel", self.swing, TRAVEL),
        ):
            if not cut <= limit:
                found.append(f"a corner {where} is cut by {cut:.3g} m (limit {limit:.3g})")
        if self.stops:
            found.append(f"the robot stops at {self.stops} targets within beads")
        if self.strays:
            found.append(
                f"{len(self.strays)} targets are not reached in their configuration, first move {self.strays[0]}"
            )
        return found


def readback(plan: Plan, program: Program) -> list[str]:
    """What a program that was read back does otherwise than its plan, in words; none if it does the same."""
    try:
        played = play(program, plan.cell)
    except InputError as error:
        return [*compare(plan, program).complaints(), f"cannot be played: {error.reason}"]
    return judge(plan, program, played).complaints()


def judge(plan: Plan, program: Program, played: Played) -> Readback:
    """A program against its plan, as it was played in the plan's cell."""
    nozzle = replace(program, position=played.position[played.target], quat=played.quat[played.target])
    spans = laid_spans(played)
    first, last = deposits(plan.trajectory)
    planned = plan.trajectory.t[last] - plan.trajectory.t[first]
    laid, worst = float("inf"), float("inf")
    if len(spans) == len(planned):
        took = spans[:, 1] - spans[:, 0]
        ratio = took / planned
        laid, worst = float(took.sum() / planned.sum()), float(ratio[np.argmax(np.abs(ratio - 1.0))])
    inside, edges = laid_targets(played)
    cut = _cut(program, played)
    return Readback(
        agreement=compare(plan, nozzle),
        laid=laid,
        worst=worst,
        corner=float(cut[inside | edges].max(initial=0.0)),
        swing=float(cut[~(inside | edges)].max(initial=0.0)),
        stops=int(np.count_nonzero(inside & program.fine & (program.wait == 0.0))),
        strays=played.strays,
    )


def _cut(program: Program, played: Played) -> Array:
    """How far the parabola within a target's zone passes inside of the target (m) [m]; 0 where the robot rests."""
    steps = np.diff(played.position, axis=0)
    size = np.linalg.norm(steps, axis=1)
    unit = steps / np.where(size > 0.0, size, 1.0)[:, None]
    moves = np.bincount(played.move, size, minlength=len(program.zone))
    knot = played.target[:-1]  # the last one is an end
    reach = np.minimum(program.zone[:-1], 0.5 * np.minimum(moves[:-1], moves[1:]))
    # the middle of a parabola whose tangents reach so far to both sides
    cut = 0.25 * reach * np.linalg.norm(unit[knot] - unit[knot - 1], axis=1)
    return np.append(np.where(program.fine[:-1], 0.0, cut), 0.0)
