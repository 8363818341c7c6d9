"""The relay between a program's socket and the board, without sockets or clocks: bytes and times in, effects out."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from planner.base.gcode_lines import commands_in
from planner.link import messages as say
from planner.link.messages import Framer, Garbage
from planner.link.orders import (
    CONTINUE,
    JAM,
    PAUSE,
    REPRIME,
    STOP,
    ContinueOrder,
    Order,
    PauseOrder,
    ReprimeOrder,
    RobotMoves,
    RobotStands,
    StopOrder,
)
from planner.link.program_lines import Position, ProgramLines

# ----------------------------------------------------------------------------------------------------
# Patience: how long the board may take over a line before it counts as lost.

ACK_TIME = 5.0  # s; a board answers within milliseconds, a busy one within a few tenths of a second
HEAT_TIME = 900.0  # s; a heavy bed takes a quarter of an hour to heat up
QUEUED = 40  # moves in RepRapFirmware's queue; a line that waits for standstill waits for all of them
LONGEST_MOVE = 600.0  # s; cap on the time that a move claims to take
_WORD = re.compile(r"([A-Z])(-?[0-9]+(?:\.[0-9]*)?|-?\.[0-9]+)")
_WAITING = {"G4", "M109", "M190", "M191", "M116", "M400"}  # acknowledged only when complete


class Patience:
    """How long each line may wait for its acknowledgement [s], depending on the lines sent before."""

    def __init__(self) -> None:
        self._feed = 0.0  # mm/min: the last F
        self._moves: deque[float] = deque(maxlen=QUEUED)

    @property
    def feed(self) -> float:
        """The last F [mm/min]; 0 if there was none."""
        return self._feed

    def of(self, gcode: str) -> float:
        """The longest time to wait for the acknowledgement of the next line [s]."""
        code = gcode.split(" ", 1)[0]
        if any(command.split(" ", 1)[0] in _WAITING for command in commands_in(gcode)):
            return HEAT_TIME
        if code in ("G0", "G1"):
            words = {letter: float(value) for letter, value in _WORD.findall(gcode[len(code) :])}
            self._feed = words.get("F", self._feed)
            takes = 60.0 * abs(words.get("E", 0.0)) / self._feed if self._feed > 0.0 else 0.0
            self._moves.append(min(takes, LONGEST_MOVE))
            # a full queue accepts the line once its oldest move is done
            return ACK_TIME + max(self._moves)
        return ACK_TIME + sum(self._moves)


# ----------------------------------------------------------------------------------------------------
# Effects: what the caller carries out, in order.


class RelaySide(Enum):
    """The two ends of the relay."""

    __hash__ = object.__hash__  # an enumeration's own hash is slow, and sides are looked up for every line

    CONTROLLER = "controller"
    BOARD = "board"


@dataclass(frozen=True)
class Write:
    """Bytes to send to a side."""

    side: RelaySide
    data: bytes


@dataclass(frozen=True)
class LogNote:
    """A record for the log: what happened, to which line (0: none), and the text."""

    what: str
    n: int
    text: str


@dataclass(frozen=True)
class StopRobot:
    """Stop the robot at once by every other means available."""

    reason: str


@dataclass(frozen=True)
class PauseRobot:
    """Stop the robot where it is, with its program keeping its place; `RobotStands` is awaited."""


@dataclass(frozen=True)
class MoveRobot:
    """Let the robot continue from there; `RobotMoves` is awaited."""


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended: with all lines done (no reason), or stopped, and where the print stands.

    sent  lines that went to the board; it may have executed the last one without having acknowledged it
    safe  the board acknowledged all lines that make it safe, or there were none
    """

    reason: str | None
    position: Position
    sent: int
    safe: bool


Effect = Write | LogNote | StopRobot | PauseRobot | MoveRobot | RunOutcome


# ----------------------------------------------------------------------------------------------------
# The relay.
#
# A line goes to the board once, in order, one at a time: RepRapFirmware silently drops a line whose checksum is wrong
# and answers the next with a bare `ok`, so with several lines under way, a lost one could not be detected. Any
# irregularity ends the run: the controller is told to stop, the board gets the lines that make it safe, and the
# position of the print is part of the outcome.

WINDOW = 16  # lines that a controller may send ahead of the last acknowledged one
HELLO_TIME = 10.0  # s from the connection to the program's first message
SILENCE_TIME = 60.0  # s beyond three times the planned time between two lines, to tolerate a slow speed override
HOMEWARD_TIME = 300.0  # s from the last line to the end of the program, a time that the table does not state
STOP_TIME = 5.0  # s for the board to acknowledge the lines that make it safe
MOST_RESENDS = 3
MOST_REMARKS = 1000  # from the board between two acknowledgements; more means that it is out of order
SAFE = ("M106 P0 S0",)  # the cutter's output off; moves that the board has already taken are completed
FAILED = "the relay failed"  # by an error of its own
COLD = ("M104 S0", "M140 S0")  # heaters of the selected tool, and of the bed
_SWITCHES, _HEATS = ("M42", "M106"), ("M104", "M109")
ROBOT_TIME = 30.0  # s in which the robot must be observed to stand, or to move on; its watcher gives up earlier


def safe_behind(gcodes: Iterable[str], cold: bool = False) -> tuple[str, ...]:
    """Lines that make the board safe after others: all outputs off that these switch, and with `cold` all heaters."""
    outputs, heaters = dict.fromkeys(SAFE), dict.fromkeys(COLD if cold else ())
    for command in (each for gcode in gcodes if "M" in gcode for each in commands_in(gcode)):
        code, *words = command.split()
        if code in _SWITCHES:
            outputs[" ".join([code, *(word for word in words if word[0] == "P"), "S0"])] = None
        elif cold and code in _HEATS:
            heaters[" ".join(["M104", *(word for word in words if word[0] == "T"), "S0"])] = None
    return (*outputs, *heaters)


class RelayState(Enum):
    """The state of a run, in words."""

    HELLO = "waiting for the program"
    RUNNING = "running"
    PAUSING = "pausing"
    PAUSED = "paused"
    REPRIMING = "repriming"
    GOING_ON = "going on"
    STOPPING = "stopping"
    OVER = "over"


STANDING = {RelayState.PAUSING, RelayState.PAUSED, RelayState.REPRIMING, RelayState.GOING_ON}
_MAY = {
    RelayState.HELLO: {STOP},
    RelayState.RUNNING: {PAUSE, JAM, STOP},
    RelayState.PAUSING: {STOP},
    RelayState.PAUSED: {REPRIME, CONTINUE, STOP},
    RelayState.REPRIMING: {STOP},
    RelayState.GOING_ON: {STOP},
}


@dataclass(frozen=True)
class RunStatus:
    """Status of a run: its state and, if not running, why; line numbers; and the words of currently possible orders."""

    state: RelayState
    reason: str
    received: int
    sent: int
    acknowledged: int
    may: frozenset[str]


class Relay:
    """The state of one run. Each method takes an event and the time [s] of a monotonic clock, and returns effects.

    After a RunOutcome nothing more is done.
    """

    def __init__(self, program: ProgramLines, now: float, cold: bool = False, attended: bool = False) -> None:
        """cold: heaters go off when it stops; attended: a jam only pauses the run, as somebody can continue it."""
        self._program, self._attended = program, attended
        self._safe = safe_behind((line.text for line in program.lines), cold)
        self._framers = {side: Framer() for side in RelaySide}
        self._gone: set[RelaySide] = set()
        self._state = RelayState.HELLO
        self._waiting: deque[say.Line] = deque()  # received, and not yet sent to the board
        self._received = self._sent = self._acknowledged = 0
        self._under_way = False  # the board has not answered the last line sent
        self._in_doubt = False  # an error occurred since, so an acknowledgement of that line means nothing
        self._ended = False  # the program said that it has ended
        self._unanswered = 0  # unanswered lines besides the program's: for repriming, and for making the board safe
        self._resends = self._remarks = 0
        self._reason: str | None = None  # why it stops, or stopped
        self._halt = ""  # why it pauses
        self._ack_by = now  # deadline of the line under way
        self._patience = Patience()
        self.deadline = now + HELLO_TIME

    @property
    def acknowledged(self) -> int:
        """The last line that the board acknowledged."""
        return self._acknowledged

    @property
    def last_words(self) -> dict[RelaySide, bytes]:
        """Bytes that stop the program and make the board safe, whatever the state of the run."""
        board = b"".join(say.to_board_plain(gcode) for gcode in self._safe)
        return {RelaySide.CONTROLLER: say.stop(FAILED), RelaySide.BOARD: board}

    @property
    def ended(self) -> bool:
        """Whether the program said that it has ended, so that a standing robot means nothing."""
        return self._ended

    def received(self, side: RelaySide, data: bytes, now: float) -> list[Effect]:
        """Take bytes from a side."""
        if self._deaf(side):
            return []
        out: list[Effect] = []
        lines, garbage = self._framers[side].lines(data)
        for text in lines:
            try:
                out += (self._controller_said if side is RelaySide.CONTROLLER else self._board_said)(text, now)
            except Garbage as error:
                out += self._not_understood(side, error, now)
            if self._deaf(side):
                return out
        if garbage is not None:
            out += self._not_understood(side, garbage, now)
        return out

    def lost(self, side: RelaySide, reason: str, now: float) -> list[Effect]:
        """Take note of a side's lost connection."""
        if self._deaf(side):
            return []
        self._gone.add(side)
        if side is RelaySide.CONTROLLER and self._ended and self._state is RelayState.RUNNING:
            return [LogNote("closed", 0, side.value)]  # the controller is done; the board may not be
        out: list[Effect] = [LogNote("lost", 0, f"{side.value}: {reason}")]
        return out + self._stop(f"the {side.value}'s connection was lost ({reason})", now)

    def tick(self, now: float) -> list[Effect]:
        """Take note of the time; to be called once the deadline has passed."""
        if now < self.deadline or self._state is RelayState.OVER:
            return []
        if self._state is RelayState.HELLO:
            return self._stop(f"the program said nothing for {HELLO_TIME:g} s", now)
        if self._state is RelayState.STOPPING:
            return [
                LogNote("unanswered", 0, "the board did not acknowledge the commands that make it safe"),
                *self._over(),
            ]
        if self._state is RelayState.REPRIMING:
            return self._stop("the board did not acknowledge the repriming in time", now)
        if self._state in (RelayState.PAUSING, RelayState.GOING_ON):
            seen = "stand" if self._state is RelayState.PAUSING else "go on"
            return self._stop(f"the robot was not seen to {seen} in time", now)
        if self._under_way:
            return self._stop(f"the board did not acknowledge line {self._sent} in time", now)
        return self._stop(f"the controller sent nothing after line {self._received} in time", now)

    def stop(self, reason: str, now: float) -> list[Effect]:
        """End the run."""
        return [] if self._state is RelayState.OVER else self._stop(reason, now)

    def take(self, order: Order, now: float) -> list[Effect]:
        """Carry out an order, or take note of the robot's state; orders that are not possible now have no effect."""
        state, may = self._state, self._may
        match order:
            case StopOrder(reason):
                return self.stop(reason, now)
            case PauseOrder(reason) if PAUSE in may:
                return self._pause(reason, now)
            case ReprimeOrder() if REPRIME in may:
                return self._reprime(order, now)
            case ContinueOrder() if CONTINUE in may:
                self._state, self.deadline = RelayState.GOING_ON, now + ROBOT_TIME
                return [LogNote("continue", self._acknowledged, ""), MoveRobot()]
            case RobotStands() if state is RelayState.PAUSING:
                self._rest()
                return [LogNote("stands", self._acknowledged, "")]
            case RobotMoves() if state is RelayState.GOING_ON:
                self._state, self._halt = RelayState.RUNNING, ""
                self._await_line(now)
                self.deadline = self._ack_by if self._under_way else self.deadline
                return [LogNote("moves", self._acknowledged, ""), *self._pump(now)]
        return []

    @property
    def status(self) -> RunStatus:
        """The status of the run."""
        reason = self._halt if self._reason is None else self._reason
        return RunStatus(self._state, reason, self._received, self._sent, self._acknowledged, frozenset(self._may))

    @property
    def _may(self) -> set[str]:
        may = _MAY.get(self._state, set())
        if self._ended:  # the robot stands, and the board runs dry
            return may & {STOP}
        return may - ({REPRIME} if self._under_way or not self._acknowledged else set())

    def _pause(self, reason: str, now: float) -> list[Effect]:
        self._state, self._halt, self.deadline = RelayState.PAUSING, reason, now + ROBOT_TIME
        return [LogNote("pause", self._acknowledged, reason), PauseRobot()]

    def _rest(self) -> None:
        """The robot stands: await nothing but the board's answer to a line under way."""
        self._state, self.deadline = RelayState.PAUSED, self._ack_by if self._under_way else math.inf

    def _reprime(self, order: ReprimeOrder, now: float) -> list[Effect]:
        """Feed, wait for the end, and restore the feed rate that the program has set."""
        feed = self._patience.feed
        fed = f"G1 E{1e3 * order.length:.3f} F{6e4 * order.speed:.3f}"
        texts = (fed, "M400", *([f"G1 F{feed:g}"] if feed > 0.0 else []))
        for text in (fed, *texts[2:]):
            self._patience.of(text)
        self._state, self._unanswered = RelayState.REPRIMING, len(texts)
        self.deadline = now + self._patience.of("")  # until all moves are over
        notes = [LogNote("reprime", self._acknowledged, text) for text in texts]
        return [*notes, *(Write(RelaySide.BOARD, say.to_board_plain(text)) for text in texts)]

    def _deaf(self, side: RelaySide) -> bool:
        """Whether a side is no longer listened to."""
        return self._state is RelayState.OVER or side in self._gone

    def _not_understood(self, side: RelaySide, error: Garbage, now: float) -> list[Effect]:
        """Stop, and ignore whatever follows garbage."""
        self._gone.add(side)
        return [LogNote("garbage", 0, f"{side.value}: {error}"), *self._stop(f"the {side.value} sent {error}", now)]

    def _controller_said(self, text: str, now: float) -> list[Effect]:
        if self._state is RelayState.STOPPING:
            return [LogNote("ignored", 0, text)] if text.startswith("X ") else []
        message = say.from_controller(text)
        if isinstance(message, say.Stopped):
            stopped = self._stop(f"the controller stopped: {message.reason}", now)
            return [LogNote("stopped", message.n, message.reason), *stopped]
        if isinstance(message, say.Hello):
            return self._hello(message, now)
        if self._state is RelayState.HELLO or self._ended:
            when = "before its hello" if self._state is RelayState.HELLO else "after its end"
            return self._stop(f"the controller sent {text!r} {when}", now)
        if isinstance(message, say.End):
            return self._end(message, now)
        wrong = self._wrong(message)
        if wrong is not None:
            return self._stop(wrong, now)
        self._received = message.n
        self._waiting.append(message)
        return [LogNote("received", message.n, message.gcode), *self._pump(now)]

    def _wrong(self, line: say.Line) -> str | None:
        """What is wrong with a line of the program, in words."""
        due = self._received + 1
        if line.n != due or line.n > len(self._program):
            return f"the controller sent line {line.n} where line {due} of {len(self._program)} was due"
        if line.gcode != self._program[line.n].text:
            return (
                f"line {line.n} is {line.gcode!r} from the controller, but {self._program[line.n].text!r} in the table"
            )
        if line.n - self._acknowledged > WINDOW:
            return f"the controller sent line {line.n} when only {self._acknowledged} were acknowledged"
        return None

    def _hello(self, hello: say.Hello, now: float) -> list[Effect]:
        if self._state is not RelayState.HELLO:
            return self._stop("the program started again in the middle of its run", now)
        program = self._program
        if hello.module != program.module or hello.lines != len(program):
            running = f"{hello.module} with {hello.lines} lines"
            return self._stop(f"the controller runs {running}, not {program.module} with {len(program)}", now)
        self._state = RelayState.RUNNING
        self._await_line(now)
        return [LogNote("hello", 0, hello.module), Write(RelaySide.CONTROLLER, say.go(1))]

    def _end(self, end: say.End, now: float) -> list[Effect]:
        if not end.n == self._received == len(self._program):
            sent = f"the controller ended after line {end.n}, and had sent {self._received} of {len(self._program)}"
            return self._stop(sent, now)
        if self._state in (RelayState.PAUSED, RelayState.REPRIMING):
            return self._stop("the controller ended its program though it was paused", now)
        self._state, self._halt = RelayState.RUNNING, ""  # a pause under way came too late
        self._ended = True
        out: list[Effect] = [LogNote("end", end.n, "")]
        return out + (self._over() if self._acknowledged == end.n else self._pump(now))

    def _board_said(self, text: str, now: float) -> list[Effect]:
        message = say.from_board(text)
        if isinstance(message, say.Remark):
            self._remarks += 1
            if self._remarks > MOST_REMARKS:
                raise Garbage(f"more than {MOST_REMARKS} lines that acknowledge nothing")
            return [LogNote("board", 0, text)]
        if isinstance(message, say.Jam):
            self._remarks += 1
            if self._attended and self._state in {RelayState.RUNNING, *STANDING} and not self._ended:
                return self._jam(message.text, now)
        if isinstance(message, say.Trouble | say.Jam):
            self._in_doubt = True
            return [LogNote("error", self._sent, text), *self._stop(f"the board reports {text!r}", now)]
        if isinstance(message, say.Resend):
            return self._again(message.n, now)
        self._remarks = 0
        return self._ok(message.n, now)

    def _jam(self, text: str, now: float) -> list[Effect]:
        """The filament does not move although the board accepts its lines: the robot must not continue without it."""
        out: list[Effect] = [LogNote("jam", self._sent, text)]
        reason = f"the board reports {text!r}"
        if self._state in (RelayState.RUNNING, RelayState.GOING_ON):
            return out + self._pause(reason, now)
        if self._remarks > MOST_REMARKS:
            raise Garbage(f"more than {MOST_REMARKS} lines that acknowledge nothing")
        self._halt = reason
        return out

    def _ok(self, n: int | None, now: float) -> list[Effect]:
        if not self._under_way and n is None and self._unanswered:
            self._unanswered -= 1
            if self._unanswered:
                return []
            if self._state is RelayState.STOPPING:
                return self._over()
            self._rest()
            return [LogNote("reprimed", self._acknowledged, "")]
        if not self._under_way or n not in (None, self._sent):
            self._in_doubt = True
            what = "a line" if n is None else f"line {n}"
            due = f"line {self._sent} was due" if self._under_way else "none was due"
            return self._stop(f"the board acknowledged {what} where {due}", now)
        if n is None and self._resends:
            return self._stop(f"the board's bare ok after it asked for line {self._sent} again may be for either", now)
        self._under_way, self._resends = False, 0
        if self._in_doubt:
            return [LogNote("answered", self._sent, "")]
        self._acknowledged = self._sent
        out: list[Effect] = [LogNote("acknowledged", self._sent, "")]
        if self._state is RelayState.STOPPING:
            return out
        if RelaySide.CONTROLLER not in self._gone:
            out.append(Write(RelaySide.CONTROLLER, say.acknowledged(self._sent)))
        if self._ended and self._acknowledged == len(self._program):
            return out + self._over()
        if self._state is RelayState.PAUSED:
            self._rest()
        elif self._state is RelayState.RUNNING:
            self._await_line(now)
        return out + self._pump(now)

    def _again(self, n: int, now: float) -> list[Effect]:
        """The board rejected a line because of its checksum: only then may it be resent."""
        if self._state is RelayState.STOPPING or not self._under_way or n != self._sent:
            return self._stop(f"the board asked for line {n} again, which was not the last one sent", now)
        self._resends += 1
        if self._resends > MOST_RESENDS:
            return self._stop(f"the board asked for line {n} more than {MOST_RESENDS} times", now)
        return [LogNote("resent", n, ""), Write(RelaySide.BOARD, say.to_board(n, self._program[n].text))]

    def _pump(self, now: float) -> list[Effect]:
        """Send the next line to the board, if none is under way."""
        if self._under_way or not self._waiting or self._state is not RelayState.RUNNING:
            return []
        line = self._waiting.popleft()
        self._sent, self._under_way = line.n, True
        self.deadline = self._ack_by = now + self._patience.of(line.gcode)
        return [LogNote("sent", line.n, ""), Write(RelaySide.BOARD, say.to_board(line.n, line.gcode))]

    def _await_line(self, now: float) -> None:
        """Set the deadline of the controller's next line, generously after its planned time."""
        n, total = self._received, len(self._program)
        if n == total:
            self.deadline = now + HOMEWARD_TIME
        else:
            planned = self._program[n + 1].t - (self._program[n].t if n else 0.0)
            self.deadline = now + SILENCE_TIME + 3.0 * planned

    def _stop(self, reason: str, now: float) -> list[Effect]:
        out: list[Effect] = []
        if self._state is not RelayState.STOPPING:
            self._state, self._reason, self.deadline = RelayState.STOPPING, reason, now + STOP_TIME
            out += [
                LogNote("stop", self._acknowledged, reason),
                Write(RelaySide.CONTROLLER, say.stop(reason)),
                StopRobot(reason),
            ]
            out += [Write(RelaySide.BOARD, say.to_board_plain(gcode)) for gcode in self._safe]
            out += [LogNote("safe", 0, gcode) for gcode in self._safe]
            self._unanswered += len(self._safe)
        else:
            out.append(LogNote("also", 0, reason))
        return out + (self._over() if RelaySide.BOARD in self._gone else [])

    def _over(self) -> list[Effect]:
        self._state = RelayState.OVER
        asked = self._received + (1 if self._ended else 0)
        position = self._program.position(self._acknowledged, asked)
        return [RunOutcome(self._reason, position, self._sent, not self._unanswered)]
