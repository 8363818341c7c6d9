"""Where a program is slower than it says: what else than the tip's speed sets the pace while material is laid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.export.player.laying import laid_moves
from planner.export.player.pacing import TIP
from planner.export.player.played import TIMES, Played
from planner.export.program import Program

ACCELERATION = "accelerations of the joints"
SHORT = 0.05  # of the programmed speed: less is not told


@dataclass(frozen=True)
class Limited:
    """Moves that lay material more slowly than programmed, all for one reason.

    by       what sets the pace instead of the tip: reorientation, an axis of the station, the speed limit of a joint, or
             the joints' accelerations, which slow down before and after
    moves    how many; first: the first of them; worst: the one that falls short most
    reached  by that one, of its programmed speed
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


def limited(program: Program, played: Played) -> tuple[Limited, ...]:
    """Why material is laid more slowly than programmed by more than 5 %, most moves first; nothing where it is not."""
    m = len(program.linear)
    steps = np.linalg.norm(np.diff(played.position, axis=0), axis=1)
    took = np.bincount(played.move, played.phases[:, TIMES].sum(axis=1), minlength=m)
    meant = np.bincount(played.move, steps, minlength=m) / program.speed[:, 0]
    reached = np.where(took > 0.0, meant / np.where(took > 0.0, took, 1.0), 1.0)
    late = laid_moves(played) & (reached < 1.0 - SHORT)
    # of each move, what limits the longest of its ways that the tip does not limit
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
