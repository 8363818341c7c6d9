"""How a RAPID program drives the extruder beyond switching an output: styles `socket` and `demand`."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Indices
from planner.base.errors import InputError
from planner.export.board import select
from planner.export.extruder import cutter_starts, orders
from planner.export.in_step import laid_filament
from planner.export.moves import Moves, deposits, samples_of_rest
from planner.export.moves import cuts as cuts_of
from planner.plan.plan import filament_areas, materials_of

if TYPE_CHECKING:
    from planner.plan import Event, Plan, Trajectory

# ----------------------------------------------------------------------------------------------------
# Filament for beads, apart from primes, retracts and purges.


def event_samples(trajectory: Trajectory) -> Indices:
    """Samples at which the extruder starts or stops moving filament other than for beads: lines begin or end there."""
    edges = [_samples(trajectory, event) for event in trajectory.events if event.amount != 0.0]
    return np.unique(np.array(edges, dtype=np.intp))


def _samples(t: Trajectory, event: Event) -> tuple[int, int]:
    """First and last sample between which an event moves its filament."""
    since = int(np.searchsorted(t.t, event.start, side="right")) - 1
    until = int(np.searchsorted(t.t, event.start + event.duration))
    return max(since, 0), min(until, len(t) - 1)


# ----------------------------------------------------------------------------------------------------
# Style `demand`: the flow on an analog output, as in Pollard et al.

PERCENT = 0.01  # share of the largest flow laid that is one step of the demand
OUTPUT_DECIMALS = 4  # of the output's value


@dataclass(frozen=True)
class FlowDemand:
    """Flow demanded by moves (m).

    percent  (m,) of the largest flow laid, more where pressure is built up; 0 where no material is laid
    top      output at that largest flow, in the output's own unit
    """

    percent: NDArray[np.intp]
    top: float

    def value(self, percent: int) -> float:
        """The output at a percentage of the largest flow laid."""
        return round(self.top * PERCENT * percent, OUTPUT_DECIMALS)


def flow(plan: Plan) -> Array:
    """Volume flow of filament (n - 1) [m^3/s] that the motor feeds in each sample, for beads alone."""
    t = plan.trajectory
    area = np.broadcast_to(np.asarray(filament_areas(plan.problem, t.events, t.t)), t.t.shape)
    out: Array = np.maximum(np.diff(laid_filament(t)) / t.dt * area[1:], 0.0)
    return out


def demand_of(plan: Plan, moves: Moves) -> FlowDemand:
    """Demand of each move: its mean flow. InputError if the largest one is beyond the output's range."""
    t, program = plan.trajectory, plan.problem.program
    volume = np.concatenate([[0.0], np.cumsum(flow(plan)) * t.dt])
    a, b = moves.start, moves.sample
    mean = np.where(moves.laid, (volume[b] - volume[a]) / (t.t[b] - t.t[a]), 0.0)
    largest = float(mean.max(initial=0.0))
    base = largest
    if plan.problem.process.extruder.lag > 0.0:  # building up pressure feeds many times as fast as laying material
        laid = np.where(moves.laid, (t.extruded[b] - t.extruded[a]) / (t.t[b] - t.t[a]), 0.0)
        base = min(largest, float(laid.max(initial=0.0)))
    top = largest * 1e9 * program.demand_scale
    if top > program.demand_most:
        asked = f"{largest * 1e9:.3g} mm3/s requires {top:.4g}, and the output only goes up to {program.demand_most:g}"
        hint = f"set program.demand_scale to at most {program.demand_most / (largest * 1e9):.3g}"
        raise InputError(asked, field="program.demand_scale", hint=hint, file=plan.problem.file)
    percent = np.round(mean / base / PERCENT) if base > 0.0 else np.zeros(len(mean))
    top = base * 1e9 * program.demand_scale
    most = np.floor(program.demand_most / max(PERCENT * top, 1e-300) * (1.0 + 1e-9))  # rounding must not exceed it
    return FlowDemand(np.minimum(percent, most).astype(np.intp), top)


# ----------------------------------------------------------------------------------------------------
# Style `socket`: the lines of G-code that the program sends to the extruder's board, each at its place.
#
# As in Tawfik et al.: one line for every segment between two targets, sent before the robot starts on it, with the
# segment's filament and a rate that takes as long as the robot does; and lines for the extruder's actions at rest.

SHORTEST = 0.02  # [s] that a line lasts, as in export/extruder.py: a board that gets more than 50 lines/s may stutter
LONGEST_LINE = 60  # characters: with number and line end it fits into a RAPID string
RELATIVE = "M83"
HEATS = ("M109", "M116", "M190")  # lines that the board acknowledges only when all is hot
FILAMENT_DECIMALS = 5  # of filament [mm]
LEAST_RATE = 1e-3  # [mm/min]; the least that is written
COLUMNS = "n,bead,layer,t_s,text"


@dataclass(frozen=True)
class SocketLine:
    """One line: `text`, sent `after` seconds of rest after move `move` (-1: the start), planned at time t [s].

    bead, layer  that it belongs to; bead -1 if it belongs to none
    """

    move: int
    after: float
    t: float
    bead: int
    layer: int
    text: str


def lines_of(plan: Plan, moves: Moves) -> tuple[SocketLine, ...]:
    """All lines of a plan, in sending order. Their filament adds up to what the plan feeds, to 0.01 um.

    Raises InputError for a line from the problem that is too long for a RAPID string.
    """
    t = plan.trajectory
    due = [*((0.0, text, -1, 0) for text in first_lines(plan)), *_ordered(plan), *_feeding(t, moves)]
    arrivals = np.concatenate([[0.0], t.t[moves.sample] - t.t[0]])
    leaves = np.append(t.t[moves.start] - t.t[0], np.inf)
    found = []
    for at, text, bead, layer in sorted(due, key=lambda each: each[0]):
        place = int(np.searchsorted(arrivals, at + 0.5 * t.dt, side="right")) - 1
        if len(text) > LONGEST_LINE:
            raise InputError(
                f"{text[:LONGEST_LINE]}… is too long for a RAPID string", hint=f"at most {LONGEST_LINE} characters"
            )
        after = min(max(at - arrivals[place], 0.0), leaves[place] - arrivals[place])
        found.append(SocketLine(place - 1, float(after), at, bead, layer, text))
    return tuple(found)


def first_lines(plan: Plan) -> tuple[str, ...]:
    """The first lines sent to the board: relative filament, and its tool if materials have no names."""
    board = plan.problem.program.board
    return (RELATIVE, *(() if materials_of(plan.problem) else (select(board.firmware, board.first_tool),)))


def table(lines: tuple[SocketLine, ...]) -> str:
    """CSV of the lines, numbered from 1, for the relay: bead, layer and planned time [s] of each."""
    out = io.StringIO()
    out.write(COLUMNS + "\n")
    for n, line in enumerate(lines, 1):
        out.write(f"{n},{line.bead},{line.layer},{line.t:.3f},{line.text}\n")
    return out.getvalue()


def _ordered(plan: Plan) -> list[tuple[float, str, int, int]]:
    """Lines for the board other than moving filament: (time [s], text, bead, layer)."""
    t, fibre = plan.trajectory, plan.problem.process.fibre
    begin = float(t.t[0])
    cuts = {} if fibre is None else {cutter_starts(event, fibre): event for event in cuts_of(t)}
    found = []
    for order in orders(plan):
        at = order.start
        if at in cuts:  # counted from the sample at rest, like the program's wait
            at += float(t.t[samples_of_rest(t, cuts[at])[0]]) - cuts[at].start
        here = min(int(np.searchsorted(t.t, at)), len(t) - 1)
        found += [(at - begin, text, int(t.bead[here]), int(t.layer[here])) for text in order.lines if text[0] != ";"]
    return found


def _layer(t: Trajectory, at: float) -> int:
    return int(t.layer[min(int(np.searchsorted(t.t, at)), len(t) - 1)])


def _feeding(t: Trajectory, moves: Moves) -> list[tuple[float, str, int, int]]:
    """`G1 E F` for each segment and event in which filament moves: (time [s], text, bead, layer)."""
    found = []
    for event in t.events:
        if event.amount != 0.0:
            text = _extrude(event.amount * 1e3, event.duration)
            found.append((event.start - float(t.t[0]), text, event.bead, _layer(t, event.start)))
    cuts, bead = _segments(t, moves)
    fed = np.round(laid_filament(t)[_whole(t)[cuts]] * 1e3, FILAMENT_DECIMALS)
    amount = np.diff(fed)  # differences of rounded totals: rounding never adds up
    clock = t.t[cuts] - t.t[0]
    layer = t.layer[(cuts[:-1] + cuts[1:] + 1) // 2]
    for k in np.flatnonzero(np.abs(amount) > 0.5 * 10.0**-FILAMENT_DECIMALS).tolist():
        text = _extrude(float(amount[k]), float(clock[k + 1] - clock[k]))
        found.append((float(clock[k]), text, int(bead[k]), int(layer[k])))
    return found


def _extrude(amount: float, lasts: float) -> str:
    """The line that moves filament [mm] in a time [s]."""
    return f"G1 E{amount:.{FILAMENT_DECIMALS}f} F{max(abs(amount) / lasts * 60.0, LEAST_RATE):.3f}"


def _whole(t: Trajectory) -> Indices:
    """For each sample (n), the one whose total filament counts there: a bead begins and ends up to a sample outside
    those that deposit, and its filament belongs to it alone."""
    own = np.arange(len(t))
    first, last = deposits(t)
    apart = np.diff(np.column_stack([first, last]).ravel())[1::2] > 2
    own[first[np.append(True, apart) & (first > 0)]] -= 1
    own[last[np.append(apart, True) & (last < len(t) - 1)]] += 1
    return own


def _segments(t: Trajectory, moves: Moves) -> tuple[Indices, NDArray[np.int64]]:
    """Samples (m + 1) at the ends of lines, and the bead (m) that each line belongs to, or -1.

    They are the targets; a segment that is too short for a line of its own is joined to a neighbour of the same bead.
    """
    cuts = np.unique(np.concatenate([[0, len(t) - 1], moves.start, moves.sample]))
    a, b = cuts[:-1], cuts[1:]
    bead = np.where(t.deposit[a] & t.deposit[b], np.minimum(t.bead[a], t.bead[b]), -1).astype(np.int64)
    at = t.t[cuts]
    runs = np.flatnonzero(np.append(bead[1:] != bead[:-1], True))  # the last segment of each bead
    left = at[runs[np.searchsorted(runs, np.arange(len(bead)))] + 1] - at[:-1]  # time until the bead's end
    enough, begun, keep = SHORTEST - 0.5 * t.dt, 0, [0]
    for i in range(1, len(bead)):
        if bead[i] != bead[i - 1] or (at[i] - at[begun] >= enough and left[i] >= enough):
            begun = i
            keep.append(i)
    return np.append(cuts[keep], cuts[-1]), bead[keep]


# ----------------------------------------------------------------------------------------------------
# Style `socket`: procedures that pass lines to a relay, and stop the robot if nobody takes them.
#
# The controller is the server of a single connection. Lines are ASCII, end with LF, and have at most 80 characters:
# `H module lines`, answered by `G 1`; `L n gcode`, n = 1, 2, 3 …; `E n` at the end; `X n reason` if it stops by itself.
# The relay sends `A n`: every line up to n was taken; and `S reason`: stop. See docs/rapid.md.

WINDOW = 16  # lines that may be in transit
PATIENCE = 2  # [s] without an answer, after which the robot stops
JOINING = 600  # [s] that the program waits for the relay to connect
LATEST = 900  # [s] that it waits for lines that the board acknowledges when done, such as heating
FIRST_PORT, LAST_PORT = 1025, 4999  # that a problem may choose
PIECE = 38  # bytes read at once, and longest line from the relay: both together fit into a string of 80
# procedures of the server that the program calls
OPEN, LINE, SETTLE, END = "BwOpen", "BwLine", "BwSettle", "BwEnd"

_DECLARATIONS = r"""
    VAR socketdev bwServer;
    VAR socketdev bwClient;
    VAR string bwHeard:="";
    VAR num bwSent:=0;
    VAR num bwTaken:=0;
    VAR bool bwGo:=FALSE;
"""
_PROCEDURES = r"""
    PROC BwOpen()
        ! Waits for the relay that takes the extruder's lines.
        bwHeard:="";
        bwSent:=0;
        bwTaken:=0;
        bwGo:=FALSE;
        SocketClose bwClient;
        SocketClose bwServer;
        SocketCreate bwServer;
        SocketBind bwServer,"{address}",{port};
        SocketListen bwServer;
        TPWrite "Waiting for the relay at port {port}";
        SocketAccept bwServer,bwClient\Time:={joining};
        SocketSend bwClient\Str:="H {module} {lines}\0A";
        WHILE NOT bwGo DO
            BwHear {patience};
        ENDWHILE
    ERROR
        BwStop "no connection to a relay";
    ENDPROC

    PROC BwLine(num n,string gcode)
        ! Sends line n; waits while too many are on their way.
        IF n<>bwSent+1 THEN
            BwStop "lines out of order in the program";
        ENDIF
        BwHear 0;
        WHILE bwSent-bwTaken>={window} DO
            BwHear {patience};
        ENDWHILE
        SocketSend bwClient\Str:="L "+NumToStr(n,0)+" "+gcode+"\0A";
        bwSent:=n;
    ERROR
        BwStop "connection lost";
    ENDPROC

    PROC BwSettle(num patience)
        ! Waits until every line is taken.
        WHILE bwTaken<bwSent DO
            BwHear patience;
        ENDWHILE
    ENDPROC

    PROC BwHear(num patience)
        ! Takes what the relay has said; where that is nothing, waits for it, unless patience is 0 s.
        VAR num here;
        VAR num at;
        VAR string part;
        here:=SocketPeek(bwClient);
        IF here=0 AND patience=0 THEN
            RETURN;
        ENDIF
        IF patience=0 THEN
            patience:={patience};
        ENDIF
        IF here=0 THEN
            here:=1;
        ELSEIF here>{piece} THEN
            here:={piece};
        ENDIF
        SocketReceive bwClient\Str:=part\ReadNoOfBytes:=here\Time:=patience;
        ! behind all that was heard there is always one more character: no place in an empty string may be asked for
        bwHeard:=bwHeard+part+" ";
        at:=StrFind(bwHeard,1,"\0A");
        WHILE at<StrLen(bwHeard) DO
            IF at<4 THEN
                BwStop "unknown words of the relay";
            ENDIF
            BwTake StrPart(bwHeard,1,at-1);
            bwHeard:=StrPart(bwHeard,at+1,StrLen(bwHeard)-at);
            at:=StrFind(bwHeard,1,"\0A");
        ENDWHILE
        IF StrLen(bwHeard)=1 THEN
            bwHeard:="";
        ELSE
            bwHeard:=StrPart(bwHeard,1,StrLen(bwHeard)-1);
        ENDIF
        IF StrLen(bwHeard)>{piece} THEN
            BwStop "unknown words of the relay";
        ENDIF
    ERROR
        IF ERRNO=ERR_SOCK_TIMEOUT THEN
            BwStop "no answer of the relay";
        ENDIF
        BwStop "connection lost";
    ENDPROC

    PROC BwTake(string said)
        ! One line of the relay: its first letter, a blank, and a number or a reason.
        VAR num n:=-1;
        VAR bool whole;
        IF StrPart(said,1,2)="S " THEN
            BwStop "the relay asked for it";
        ENDIF
        whole:=StrToVal(StrPart(said,3,StrLen(said)-2),n);
        IF whole AND StrPart(said,1,2)="G " AND n=1 AND (NOT bwGo) THEN
            bwGo:=TRUE;
        ELSEIF whole AND StrPart(said,1,2)="A " AND n>=bwTaken AND n<=bwSent AND n=Trunc(n) THEN
            bwTaken:=n;
        ELSE
            BwStop "unknown words of the relay";
        ENDIF
    ENDPROC

    PROC BwEnd()
        ! Everything was sent: says so when all of it is taken.
        BwSettle {latest};
        SocketSend bwClient\Str:="E "+NumToStr(bwSent,0)+"\0A";
        SocketClose bwClient;
        SocketClose bwServer;
    ERROR
        BwStop "connection lost";
    ENDPROC

    PROC BwStop(string reason)
        ! Robot and extruder come to rest, both sides read why, and the program ends; it may start from main again.
        StopMove;
{outputs}
        TPWrite "Stopped after line "+NumToStr(bwSent,0)+":";
        TPWrite reason;
        IF SocketGetStatus(bwClient)=SOCKET_CONNECTED THEN
            SocketSend bwClient\Str:="X "+NumToStr(bwSent,0)+" "+reason+"\0A";
        ENDIF
        SocketClose bwClient;
        SocketClose bwServer;
        WaitRob\ZeroSpeed;
        ! the robot may have passed a trigger before it stood
{outputs}
{over}
    ERROR
        ! nobody may be there to be told
        TRYNEXT;
    ENDPROC
"""


def server_declarations() -> list[str]:
    """Variables of the server, which come before the first procedure."""
    return _DECLARATIONS.strip("\n").split("\n")


_OVER = ("        ClearPath;", "        StartMove;", "        EXIT;")
# ABB, RAPID reference, SystemStopAction and StopMove: all motion tasks stop, none continues before its program pointer
# is moved, and StopMove's hold is released when the task starts from its beginning. EXIT would leave the other task
# waiting.
_BOTH_OVER = ("        SystemStopAction\\StopBlock;",)


def server(module: str, lines: int, address: str, port: int, outputs: Iterable[str], alone: bool = True) -> list[str]:
    """Procedures of the server of a program that sends `lines` lines; `outputs` are switched off when it stops.

    alone: no other task moves in step with this one.
    """
    values = {
        "module": module,
        "lines": lines,
        "address": address,
        "port": port,
        "outputs": "\n".join(f"        SetDO {name},0;" for name in outputs),
        "over": "\n".join(_OVER if alone else _BOTH_OVER),
        "window": WINDOW,
        "patience": PATIENCE,
        "joining": JOINING,
        "latest": LATEST,
        "piece": PIECE,
    }
    return _PROCEDURES.format(**values).strip("\n").split("\n")
