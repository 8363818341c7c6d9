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

ACK_TIME = 5.0  # s; a board answers within milliseconds, a busy one within some tenths of a second
HEAT_TIME = 900.0  # s; a heavy bed takes a quarter of an hour
QUEUED = 40  # moves that RepRapFirmware keeps; a line that waits for standstill waits for all of them
LONGEST_MOVE = 600.0  # s; a move that claims to take longer is not believed
_WORD = re.compile(r"([A-Z])(-?[0-9]+(?:\.[0-9]*)?|-?\.[0-9]+)")
_WAITING = {"G4", "M109", "M190", "M191", "M116", "M400"}  # answered when they are over


class Patience:
    """How long each line may wait for its ack [s], by the lines that were sent before."""

    def __init__(self) -> None:
        self._feed = 0.0  # mm/min, as F was last given
        self._moves: deque[float] = deque(maxlen=QUEUED)

    @property
    def feed(self) -> float:
        """F as it was last given [mm/min]; 0 where none was."""
        return self._feed

    def of(self, gcode: str) -> float:
        """The longest time to wait for the ack of the next line [s]."""
        code = gcode.split(" ", 1)[0]
        if any(command.split(" ", 1)[0] in _WAITING for command in commands_in(gcode)):
            return HEAT_TIME
        if code in ("G0", "G1"):
            words = {letter: float(value) for letter, value in _WORD.findall(gcode[len(code) :])}
            self._feed = words.get("F", self._feed)
            takes = 60.0 * abs(words.get("E", 0.0)) / self._feed if self._feed > 0.0 else 0.0
            self._moves.append(min(takes, LONGEST_MOVE))
            # a full queue takes the line once its oldest move is done
            return ACK_TIME + max(self._moves)
        return ACK_TIME + sum(self._moves)


# ----------------------------------------------------------------------------------------------------
# Effects: what the caller carries out, in order.


class RelaySide(Enum):
    """The two ends of the relay."""

    __hash__ = object.__hash__  # an enumeration's own is slow, and sides are looked up for every line

    CONTROLLER = "controller"
    BOARD = "board"


@dataclass(frozen=True)
class Write:
    """Bytes to send to a side."""

    side: RelaySide
    data: bytes


@dataclass(frozen=True)
class LogNote:
    """A record for the log: what happened, to which line (0: to none), and the words."""

    what: str
    n: int
    text: str


@dataclass(frozen=True)
class StopRobot:
    """The robot is to be stopped by every other way there is, at once."""

    reason: str


@dataclass(frozen=True)
class PauseRobot:
    """The robot is to stand still where it is, and its program to keep its place; `RobotStands` is awaited."""


@dataclass(frozen=True)
class MoveRobot:
    """The robot is to go on from there; `RobotMoves` is awaited."""


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended: with all lines done (no reason), or stopped, and where the print stands.

    sent  lines that went to the board; it may have carried out the last one without having said so
    safe  the board answered all that makes it safe, or had no reason to
    """

    reason: str | None
    position: Position
    sent: int
    safe: bool


Effect = Write | LogNote | StopRobot | PauseRobot | MoveRobot | RunOutcome


# ----------------------------------------------------------------------------------------------------
# The relay.
#
# A line goes to the board once, in order, one at a time: RepRapFirmware drops a line whose checksum is wrong without a
# word and answers the next with a bare `ok`, so with several under way a lost one could not be told. Whatever is not as
# it should be ends the run: the controller is told to stop, the board gets what makes it safe, and where the print
# stands is part of the outcome.

WINDOW = 16  # lines that a controller may send ahead of what was acknowledged
HELLO_TIME = 10.0  # s from the connection to the program's first word
SILENCE_TIME = 60.0  # s beyond three times what the program plans between two lines, so that a slow override is borne
HOMEWARD_TIME = 300.0  # s from the last line to the end of the program, which the table does not know
STOP_TIME = 5.0  # s that the board has to answer what makes it safe
MOST_RESENDS = 3
MOST_REMARKS = 1000  # of the board between two acks; more is a board that has lost its mind
SAFE = ("M106 P0 S0",)  # the cutter's output off; moves that the board has taken run dry
FAILED = "the relay failed"  # by a mistake of its own
COLD = ("M104 S0", "M140 S0")  # of the tool that is selected, and of the bed
_SWITCHES, _HEATS = ("M42", "M106"), ("M104", "M109")
ROBOT_TIME = 30.0  # s in which the robot must be seen to stand, or to go on; who watches it gives up before


def safe_behind(gcodes: Iterable[str], cold: bool = False) -> tuple[str, ...]:
    """What makes the board safe behind some lines: all outputs off that they switch, with `cold` also all heaters."""
    outputs, heaters = dict.fromkeys(SAFE), dict.fromkeys(COLD if cold else ())
    for command in (each for gcode in gcodes if "M" in gcode for each in commands_in(gcode)):
        code, *words = command.split()
        if code in _SWITCHES:
            outputs[" ".join([code, *(word for word in words if word[0] == "P"), "S0"])] = None
        elif cold and code in _HEATS:
            heaters[" ".join(["M104", *(word for word in words if word[0] == "T"), "S0"])] = None
    return (*outputs, *heaters)


class RelayState(Enum):
    """What a run is at, in words."""

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
    """Where a run is: its state and, where it is not running, why; lines; and what a user may ask for now (orders' words)."""

    state: RelayState
    reason: str
    received: int
    sent: int
    acknowledged: int
    may: frozenset[str]


class Relay:
    """The state of one run. Each method takes what happened and the time [s] of a steady clock, and returns effects.

    After an Outcome nothing more is done.
    """

    def __init__(self, program: ProgramLines, now: float, cold: bool = False, attended: bool = False) -> None:
        """cold: heaters go off where it stops; attended: somebody can continue what a jam pauses, else that stops it."""
        self._program, self._attended = program, attended
        self._safe = safe_behind((line.text for line in program.lines), cold)
        self._framers = {side: Framer() for side in RelaySide}
        self._gone: set[RelaySide] = set()
        self._state = RelayState.HELLO
        self._waiting: deque[say.Line] = deque()  # came, and not yet sent to the board
        self._received = self._sent = self._acknowledged = 0
        self._under_way = False  # the board has not answered the line that was sent last
        self._in_doubt = False  # it was wrong since, so that an ack of that line means nothing
        self._ended = False  # the program said that it is through
        self._unanswered = 0  # lines beside the program's that the board has not answered: of repriming, and safe ones
        self._resends = self._remarks = 0
        self._reason: str | None = None  # why it stops, or stopped
        self._halt = ""  # why it pauses
        self._ack_by = now  # when the line that is under way must be answered
        self._patience = Patience()
        self.deadline = now + HELLO_TIME

    @property
    def acknowledged(self) -> int:
        """The last line that the board took."""
        return self._acknowledged

    @property
    def last_words(self) -> dict[RelaySide, bytes]:
        """What stops the program and makes the board safe, whatever state the run is in."""
        board = b"".join(say.to_board_plain(gcode) for gcode in self._safe)
        return {RelaySide.CONTROLLER: say.stop(FAILED), RelaySide.BOARD: board}

    @property
    def ended(self) -> bool:
        """The program said that it is through, so that the robot's standing still means nothing."""
        return self._ended

    def received(self, side: RelaySide, data: bytes, now: float) -> list[Effect]:
        """Bytes came from a side."""
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
        """A side's connection is no more."""
        if self._deaf(side):
            return []
        self._gone.add(side)
        if side is RelaySide.CONTROLLER and self._ended and self._state is RelayState.RUNNING:
            return [LogNote("closed", 0, side.value)]  # its part is done; the board's may not be
        out: list[Effect] = [LogNote("lost", 0, f"{side.value}: {reason}")]
        return out + self._stop(f"the {side.value}'s connection was lost ({reason})", now)

    def tick(self, now: float) -> list[Effect]:
        """Time has passed; to be called when the deadline is over."""
        if now < self.deadline or self._state is RelayState.OVER:
            return []
        if self._state is RelayState.HELLO:
            return self._stop(f"the program said nothing for {HELLO_TIME:g} s", now)
        if self._state is RelayState.STOPPING:
            return [LogNote("unanswered", 0, "the board did not answer what makes it safe"), *self._over()]
        if self._state is RelayState.REPRIMING:
            return self._stop("the board did not acknowledge the repriming in time", now)
        if self._state in (RelayState.PAUSING, RelayState.GOING_ON):
            seen = "stand" if self._state is RelayState.PAUSING else "go on"
            return self._stop(f"the robot was not seen to {seen} in time", now)
        if self._under_way:
            return self._stop(f"the board did not acknowledge line {self._sent} in time", now)
        return self._stop(f"the controller sent nothing after line {self._received} in time", now)

    def stop(self, reason: str, now: float) -> list[Effect]:
        """The run is to end."""
        return [] if self._state is RelayState.OVER else self._stop(reason, now)

    def take(self, order: Order, now: float) -> list[Effect]:
        """Carry out an order, or take note of the robot; what cannot be now has no effect."""
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
        """Where the run is."""
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
        """The robot stands: nothing is awaited but the board's answer to a line that is under way."""
        self._state, self.deadline = RelayState.PAUSED, self._ack_by if self._under_way else math.inf

    def _reprime(self, order: ReprimeOrder, now: float) -> list[Effect]:
        """Feed, wait for it, and give the feed rate back that the program has set."""
        feed = self._patience.feed
        fed = f"G1 E{1e3 * order.length:.3f} F{6e4 * order.speed:.3f}"
        texts = (fed, "M400", *([f"G1 F{feed:g}"] if feed > 0.0 else []))
        for text in (fed, *texts[2:]):
            self._patience.of(text)
        self._state, self._unanswered = RelayState.REPRIMING, len(texts)
        self.deadline = now + self._patience.of("")  # until all that moves is over
        notes = [LogNote("reprime", self._acknowledged, text) for text in texts]
        return [*notes, *(Write(RelaySide.BOARD, say.to_board_plain(text)) for text in texts)]

    def _deaf(self, side: RelaySide) -> bool:
        """Nothing that a side says counts any more."""
        return self._state is RelayState.OVER or side in self._gone

    def _not_understood(self, side: RelaySide, error: Garbage, now: float) -> list[Effect]:
        """Nothing that follows garbage is listened to."""
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
        self._state, self._halt = RelayState.RUNNING, ""  # a pause that was under way came too late
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
        """The filament does not follow, though the board takes its lines: the robot must not go on without."""
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
            return self._stop(f"the board's bare ok after it asked for line {self._sent} again may be of either", now)
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
        """The board did not take a line, for its checksum was wrong: only then may it be sent again."""
        if self._state is RelayState.STOPPING or not self._under_way or n != self._sent:
            return self._stop(f"the board asked for line {n} again, which it was not sent last", now)
        self._resends += 1
        if self._resends > MOST_RESENDS:
            return self._stop(f"the board asked for line {n} more than {MOST_RESENDS} times", now)
        return [LogNote("resent", n, ""), Write(RelaySide.BOARD, say.to_board(n, self._program[n].text))]

    def _pump(self, now: float) -> list[Effect]:
        """The next line to the board, if it has none under way."""
        if self._under_way or not self._waiting or self._state is not RelayState.RUNNING:
            return []
        line = self._waiting.popleft()
        self._sent, self._under_way = line.n, True
        self.deadline = self._ack_by = now + self._patience.of(line.gcode)
        return [LogNote("sent", line.n, ""), Write(RelaySide.BOARD, say.to_board(line.n, line.gcode))]

    def _await_line(self, now: float) -> None:
        """The controller's next line is due when the program plans it, or much later."""
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
