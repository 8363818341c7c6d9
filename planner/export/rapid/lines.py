"""Style `socket`: the G-code lines that the program sends to the extruder's board, each at its own place.

As in Tawfik et al.: a line for every segment between two targets, sent before the robot sets out on it, with the filament
of that segment and the rate that takes as long as the robot does; and lines for what the extruder does at rest.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.errors import InputError
from planner.export.extruder.orders import orders
from planner.export.moves import Moves, deposits
from planner.export.rapid.fed import laid_filament
from planner.readonly import Indices

if TYPE_CHECKING:
    from planner.plan import Plan, Trajectory


SHORTEST = 0.02  # s that a line lasts, as in extruder.writer: a board that gets more than 50 lines/s may stutter
LONGEST_LINE = 60  # characters: with number and line end it fits into a string of RAPID
RELATIVE = "M83"
HEATS = ("M109", "M116", "M190")  # lines that the board acknowledges when all is hot,
WAITS = (*HEATS, "G4 ")  # or when they are over, which may be late
DECIMALS = 5  # of filament [mm]
LEAST_RATE = 1e-3  # mm/min, the least that is written
COLUMNS = "n,bead,layer,t_s,text"


@dataclass(frozen=True)
class Line:
    """One line: `text`, sent `after` seconds of rest behind move `move` (-1: the start), planned at time t [s].

    bead, layer  that it belongs to; bead -1 where it belongs to none
    """

    move: int
    after: float
    t: float
    bead: int
    layer: int
    text: str


def lines_of(plan: Plan, moves: Moves) -> tuple[Line, ...]:
    """All lines of a plan, in the order in which they are sent. Filament sums up to what the plan feeds, to 0.01 um.

    Raises InputError for a line of the problem's own that no string of RAPID can hold.
    """
    t = plan.trajectory
    said = [(0.0, RELATIVE, -1, 0)]
    said += _ordered(plan)
    said += _feeding(t, moves)
    arrivals = np.concatenate([[0.0], t.t[moves.sample] - t.t[0]])
    leaves = np.append(t.t[moves.start] - t.t[0], np.inf)
    found = []
    for at, text, bead, layer in sorted(said, key=lambda each: each[0]):
        place = int(np.searchsorted(arrivals, at + 0.5 * t.dt, side="right")) - 1
        if len(text) > LONGEST_LINE:
            raise InputError(
                f"{text[:LONGEST_LINE]}… is too long for a string of RAPID", hint=f"{LONGEST_LINE} characters"
            )
        after = min(max(at - arrivals[place], 0.0), leaves[place] - arrivals[place])
        found.append(Line(place - 1, float(after), at, bead, layer, text))
    return tuple(found)


def table(lines: tuple[Line, ...]) -> str:
    """CSV of the lines by their numbers from 1, for whoever relays them: bead, layer and planned time [s] of each."""
    out = io.StringIO()
    out.write(COLUMNS + "\n")
    for n, line in enumerate(lines, 1):
        out.write(f"{n},{line.bead},{line.layer},{line.t:.3f},{line.text}\n")
    return out.getvalue()


def _ordered(plan: Plan) -> list[tuple[float, str, int, int]]:
    """Lines of what the board is told besides moving filament: (time [s], text, bead, layer)."""
    t, fibre = plan.trajectory, plan.problem.process.fibre
    begin = float(t.t[0])
    cuts = {event.start: event.duration for event in t.events if event.kind == "cut"}
    found = []
    for order in orders(plan):
        at = order.start
        if fibre is not None and at in cuts:
            at += 0.5 * (cuts[at] - order.time)  # as long before the cutter moves as after it, as published
        here = min(int(np.searchsorted(t.t, at)), len(t) - 1)
        found += [(at - begin, text, int(t.bead[here]), int(t.layer[here])) for text in order.lines if text[0] != ";"]
    return found


def _layer(t: Trajectory, at: float) -> int:
    return int(t.layer[min(int(np.searchsorted(t.t, at)), len(t) - 1)])


def _feeding(t: Trajectory, moves: Moves) -> list[tuple[float, str, int, int]]:
    """`G1 E F` for every segment and event in which filament moves: (time [s], text, bead, layer)."""
    found = []
    for event in t.events:
        if event.amount != 0.0:
            text = _extrude(event.amount * 1e3, event.duration)
            found.append((event.start - float(t.t[0]), text, event.bead, _layer(t, event.start)))
    cuts, bead = _segments(t, moves)
    fed = np.round(laid_filament(t)[_whole(t)[cuts]] * 1e3, DECIMALS)
    amount = np.diff(fed)  # differences of rounded totals: rounding never adds up
    clock = t.t[cuts] - t.t[0]
    layer = t.layer[(cuts[:-1] + cuts[1:] + 1) // 2]
    for k in np.flatnonzero(np.abs(amount) > 0.5 * 10.0**-DECIMALS).tolist():
        text = _extrude(float(amount[k]), float(clock[k + 1] - clock[k]))
        found.append((float(clock[k]), text, int(bead[k]), int(layer[k])))
    return found


def _extrude(amount: float, lasts: float) -> str:
    """The line that moves filament [mm] in a time [s]."""
    return f"G1 E{amount:.{DECIMALS}f} F{max(abs(amount) / lasts * 60.0, LEAST_RATE):.3f}"


def _whole(t: Trajectory) -> Indices:
    """For every sample (n) the one whose filament counts there: a bead begins and ends up to a sample outside of those
    that deposit, and has its filament to itself."""
    own = np.arange(len(t))
    first, last = deposits(t)
    apart = np.diff(np.column_stack([first, last]).ravel())[1::2] > 2
    own[first[np.append(True, apart) & (first > 0)]] -= 1
    own[last[np.append(apart, True) & (last < len(t) - 1)]] += 1
    return own


def _segments(t: Trajectory, moves: Moves) -> tuple[Indices, NDArray[np.int64]]:
    """Samples (m + 1) between which a line lasts, and the bead (m) that it belongs to, or -1.

    They are the targets; a segment that is too short for a line of its own goes with a neighbour of the same bead.
    """
    cuts = np.unique(np.concatenate([[0, len(t) - 1], moves.start, moves.sample]))
    a, b = cuts[:-1], cuts[1:]
    bead = np.where(t.deposit[a] & t.deposit[b], np.minimum(t.bead[a], t.bead[b]), -1).astype(np.int64)
    at = t.t[cuts]
    runs = np.flatnonzero(np.append(bead[1:] != bead[:-1], True))  # the last segment of each bead
    left = at[runs[np.searchsorted(runs, np.arange(len(bead)))] + 1] - at[:-1]  # until its end
    enough, begun, keep = SHORTEST - 0.5 * t.dt, 0, [0]
    for i in range(1, len(bead)):
        if bead[i] != bead[i - 1] or (at[i] - at[begun] >= enough and left[i] >= enough):
            begun = i
            keep.append(i)
    return np.append(cuts[keep], cuts[-1]), bead[keep]
