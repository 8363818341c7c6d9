"""Simulator of an extruder's board (RepRapFirmware), without sockets: bytes in, lines out, in its own time; faults."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from planner.base.errors import InputError, nearest_name
from planner.base.gcode_lines import commands_in

# ----------------------------------------------------------------------------------------------------
# Faults on demand: `kind@line`, or `kind@line:value`.

BOARD_FAULTS = {
    "error": "answers a line with an error instead of doing it",
    "delay": "holds back a line's ok, and all after it, for VALUE seconds (default 1)",
    "jam": "the filament jams when the line is begun: nothing is accepted any more once the queue is full",
    "clog": "the filament monitor complains when the line is begun, but the line is done all the same, as on a real board",
    "drop": "closes the connection when the line's ok is due: the line is done, its ok is lost",
    "garbage": "sends bytes that mean nothing instead of a line's ok",
    "resend": "takes a line's checksum for wrong, once",
    "fatal": "says !! when the line comes, and does nothing more",
}
CONTROLLER_FAULTS = {
    "drop": "closes the program's connection after the line",
    "restart": "the controller restarts after the line: the program is lost, its network silent for a while",
    "stop": "stops by itself after the line, as for a stop button, and says so",
    "garbage": "sends bytes that mean nothing instead of the line",
    "skip": "leaves the line out and goes on with the next one",
}
STREAM_FAULTS = {
    "drop": "closes the connection after the frame",
    "mute": "says nothing more after the frame",
    "stop": "stops by itself after the frame",
    "garbage": "sends bytes that mean nothing after the frame",
}
EGM_FAULTS = {
    "mute": "says nothing more after the message",
    "stop": "the program stops after the message",
    "stray": "the first axis strays by VALUE degrees from the message on",
    "gap": "says nothing for VALUE hundredths of a second after the message",
    "garbage": "sends bytes that mean nothing instead of the message",
}
_FORM = re.compile(r"([a-z]+)@([1-9][0-9]{0,8})(?::([0-9]{1,6}(?:\.[0-9]{1,3})?))?")


@dataclass(frozen=True)
class Fault:
    """A fault of a kind at a line, counted from 1; value in the kind's unit, 1 by default."""

    kind: str
    line: int
    value: float = 1.0


class Faults:
    """Pending faults; each happens once."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._left = list(faults)

    def take(self, kind: str, line: int | None) -> Fault | None:
        """Remove and return the fault of a kind that is due at a line; None if there is none."""
        for fault in self._left:
            if fault.kind == kind and fault.line == line:
                self._left.remove(fault)
                return fault
        return None


def faults_of(words: Sequence[str], kinds: Iterable[str]) -> tuple[Fault, ...]:
    """Parse faults such as `delay@10:1.5`. Raises InputError for anything but a fault of these kinds."""
    known = tuple(kinds)
    out = []
    for word in words:
        match = _FORM.fullmatch(word)
        if match is None:
            raise InputError(f"{word!r} is not a fault", field="--fault", hint="KIND@LINE or KIND@LINE:VALUE")
        kind, line, value = match.groups()
        if kind not in known:
            near = nearest_name(kind, known)
            hint = f"did you mean {near}?" if near else f"one of {', '.join(known)}"
            raise InputError(f"unknown fault {kind!r}", field="--fault", hint=hint)
        out.append(Fault(kind, int(line), 1.0 if value is None else float(value)))
    return tuple(out)


# ----------------------------------------------------------------------------------------------------
# A heater and its temperature over time.

AMBIENT_C = 22.0


@dataclass(frozen=True)
class Heater:
    """Full power until the target is reached, then held; passive cooling. Temperatures in °C, times in s.

    limit          final temperature at full power; time_constant of both heating and cooling
    start, since   known temperature and its time, from which the present one is computed
    """

    limit: float
    time_constant: float
    target: float = 0.0
    start: float = AMBIENT_C
    since: float = 0.0

    def at(self, time: float) -> float:
        """Temperature at a time, not before `since`."""
        goal = max(self.target, AMBIENT_C)
        towards = self.limit if goal > self.start else AMBIENT_C
        there = towards + (self.start - towards) * math.exp(-(time - self.since) / self.time_constant)
        return min(there, goal) if goal > self.start else max(there, goal)

    def set(self, target: float, time: float) -> Heater:
        """The heater with another target from a given time."""
        return replace(self, target=target, start=self.at(time), since=time)

    def reached(self, cooling: bool) -> float:
        """When the target is reached; `since` if it would have to cool and `cooling` is not waited for."""
        goal = max(self.target, AMBIENT_C)
        if goal > self.start:
            return self.since + self.time_constant * math.log((self.limit - self.start) / (self.limit - goal))
        if not cooling or goal == self.start:
            return self.since
        near = max(goal, AMBIENT_C + 1.0)  # ambient itself is never quite reached
        return self.since + self.time_constant * max(0.0, math.log((self.start - AMBIENT_C) / (near - AMBIENT_C)))


# Typical of a 40 W cartridge in a nozzle and of a mains bed: 200 °C after 95 s, 60 °C after 118 s.
NOZZLE = Heater(limit=350.0, time_constant=120.0)
BED = Heater(limit=140.0, time_constant=300.0)


# ----------------------------------------------------------------------------------------------------
# The board.
#
# Lines that move, heat or switch wait in a queue and are acknowledged when they enter it; waits (`_WAITS`) are
# acknowledged only when complete, and no line is accepted meanwhile.

QUEUE = 4  # lines accepted and not yet done
LONGEST_LINE = 256  # bytes, RepRapFirmware's GCODE_LENGTH
MOST_WAITING = 64  # lines received and not yet accepted; the capacity of a network buffer
TOOLS = 8
DEFAULT_FEED = 50.0  # mm/s, RepRapFirmware's default before any F
_WORD = re.compile(r"([A-Z])\s*(-?(?:[0-9]+\.?[0-9]*|\.[0-9]+)|\"[^\"]*\")?")
_NUMBERED = re.compile(r"N([0-9]{1,9})\s+(.*)")
_QUEUED = {"G0", "G1", "M104", "M140", "M106", "M107"}
_WAITS = {"G4", "M109", "M116", "M190", "M400", "T"}  # a tool change also waits for moves


@dataclass(frozen=True)
class Reply:
    """A line for the other side; `ok` is the number of the line that it acknowledges, if any."""

    text: str
    ok: int | None = None


@dataclass(frozen=True)
class ReceivedLine:
    """A command of a received line: the line's number as sent, or None, its G-code without the number, the command, and
    whether it is the last one, which acknowledges the line."""

    number: int | None
    text: str
    command: str
    last: bool = True


class Record:
    """What a board has done so far.

    accepted   lines, in order, with their numbers
    filament   moved, by tool [mm]
    fans       last value of each
    warnings   all warnings and errors
    """

    def __init__(self) -> None:
        self.accepted: list[tuple[int | None, str]] = []
        self.filament: dict[int, float] = {}
        self.fans: dict[int, float] = {}
        self.warnings: list[str] = []


@dataclass(frozen=True)
class _Job:
    line: ReceivedLine
    code: str
    words: dict[str, float]
    end: float


class Board:
    """The board's state. Times [s] are its own and never decrease.

    tool  the selected tool; None, as after starting RepRapFirmware, refuses to extrude
    """

    def __init__(self, faults: Faults | None = None, tool: int | None = None) -> None:
        self.record = Record()
        self.halted = False
        self.tool = tool
        self._faults = faults or Faults()
        self._time = 0.0
        self._partial = b""
        self._overlong = False
        self._waiting: deque[ReceivedLine] = deque()
        self._queue: deque[_Job] = deque()
        self._blocked: _Job | None = None
        self._relative, self._position, self._feed = False, 0.0, DEFAULT_FEED
        self._bed: Heater = BED
        self._nozzles = [NOZZLE] * TOOLS

    @property
    def room(self) -> int:
        """Lines that it would still take; a reader that stops at 0 creates back-pressure on the network."""
        return 0 if self.halted else MOST_WAITING - len(self._waiting)

    @property
    def idle(self) -> bool:
        """Whether nothing is being done or waiting."""
        return not (self._queue or self._waiting or self._blocked)

    def disconnect(self) -> None:
        """Take note that the other side is gone: a partial line is dropped, accepted lines are completed."""
        self._partial, self._overlong = b"", False

    def receive(self, data: bytes, now: float) -> list[Reply]:
        """Take bytes; returns the replies up to now."""
        out = self.advance(now)
        *whole, self._partial = re.split(rb"[\r\n]", self._partial + data)
        for raw in whole:
            if self._overlong or len(raw) > LONGEST_LINE:
                self._overlong = False
                out.append(self._warn("Error: G-Code buffer 'telnet' length overflow"))
            elif raw.strip() and not self.halted:
                self._take(raw, out)
                self._accept(out)
        if len(self._partial) > LONGEST_LINE:
            self._partial, self._overlong = b"", True
        return out + self.advance(now)

    def advance(self, now: float) -> list[Reply]:
        """Let time pass up to now; returns the replies meanwhile."""
        out: list[Reply] = []
        while not self.halted:
            self._accept(out)
            end = self._next_end()
            if end is None or end > now:
                break
            self._time = max(self._time, end)
            self._finish(out)
        self._time = max(self._time, now)
        return out

    def next_change(self) -> float:
        """When the next line will be done, if nothing else comes in: infinity if none will."""
        end = self._next_end()
        return math.inf if end is None or self.halted else end

    def temperatures(self) -> tuple[float, float]:
        """Temperatures of the selected tool's nozzle and of the bed [°C]."""
        return self._nozzles[self.tool or 0].at(self._time), self._bed.at(self._time)

    def _next_end(self) -> float | None:
        if self._queue:
            return self._queue[0].end
        return None if self._blocked is None else self._blocked.end

    def _warn(self, text: str) -> Reply:
        self.record.warnings.append(text)
        return Reply(text)

    def _take(self, raw: bytes, out: list[Reply]) -> None:
        """Take one line: strip checksum and number, and queue its commands as waiting."""
        text = raw.decode("ascii", errors="replace").strip()
        body, star, sum_ = text.rpartition("*")
        numbered = _NUMBERED.fullmatch(body if star else text)
        number = int(numbered[1]) if numbered else None
        if star:
            right = 0
            for byte in raw.strip().rpartition(b"*")[0]:
                right ^= byte
            wrong = not sum_.strip().isdigit() or int(sum_) != right
            if wrong or self._faults.take("resend", number):
                # without a number, RepRapFirmware silently drops the line
                out += [Reply(f"Resend: {number}")] if number is not None else []
                return
        code = (numbered[2] if numbered else body if star else text).split(";")[0].strip()
        if code == "M112":
            self.halted = True
            self._queue.clear()
            self._waiting.clear()
            return
        if self._faults.take("fatal", number):
            self.halted = True
            out.append(Reply("!!"))
            return
        if len(self._waiting) >= MOST_WAITING:
            out.append(self._warn("Error: input overrun, line lost"))
            return
        commands = commands_in(code)
        self._waiting += [ReceivedLine(number, code, each, k == len(commands)) for k, each in enumerate(commands, 1)]

    def _accept(self, out: list[Reply]) -> None:
        """Accept waiting lines as far as the queue allows."""
        while self._waiting and self._blocked is None and not self.halted:
            line = self._waiting[0]
            code, words = _parsed(line.command)
            if (code in _WAITS and self._queue) or (code in _QUEUED and len(self._queue) >= QUEUE):
                return
            self._waiting.popleft()
            if self._faults.take("error", line.number):
                complaint: str | None = f"Error: {code}: failed on demand"
            elif code in _WAITS:
                complaint = self._start_wait(line, code, words)
            elif code in _QUEUED:
                complaint = self._enqueue(line, code, words, out)
            else:
                complaint = self._at_once(code, words, out)
            if complaint:
                out.append(self._warn(complaint))
            elif line.last:
                self.record.accepted.append((line.number, line.text))
            if self._blocked is None and line.last:
                out.append(_ok(line))

    def _enqueue(self, line: ReceivedLine, code: str, words: dict[str, float], out: list[Reply]) -> str | None:
        """Queue a line, or return why not."""
        if code in ("G0", "G1"):
            if {"X", "Y", "Z"} & set(words):
                return f"Error: {code}: insufficient axes homed"
            if self.tool is None and "E" in words:
                return "Error: Attempting to extrude with no tool selected"
            self._feed = words["F"] / 60.0 if words.get("F", 0.0) > 0.0 else self._feed
            amount = words.get("E", 0.0) - (0.0 if self._relative or "E" not in words else self._position)
            self._position += amount
            words = {"E": amount, "T": self.tool or 0}
            lasts = abs(amount) / self._feed
        else:
            lasts = 0.0
            if code in ("M104", "M140"):
                words = {"T": self.tool or 0, **words}
                limit = (NOZZLE if code == "M104" else BED).limit
                if not 0.0 <= words.get("S", 0.0) < limit or not 0 <= words["T"] < TOOLS:
                    return f"Error: {code}: no such temperature or tool"
        start = self._queue[-1].end if self._queue else self._time
        job = _Job(line, code, words, start + lasts)
        if self._faults.take("clog", line.number):
            out.append(self._warn(f"Error: Filament error on extruder {self.tool}: tooLittleMovement"))
        if self._faults.take("jam", line.number):
            out.append(self._warn(f"Error: Filament error on extruder {self.tool}: too little movement"))
            job = _Job(line, code, words, math.inf)
        self._queue.append(job)
        return None

    def _finish(self, out: list[Reply]) -> None:
        """Apply the effect of the line that ends now."""
        if not self._queue:
            job, self._blocked = self._blocked, None
            out += [] if job is None or not job.line.last else [_ok(job.line)]
            return
        job = self._queue.popleft()
        words = job.words
        if job.code in ("G0", "G1"):
            tool = int(words["T"])
            self.record.filament[tool] = self.record.filament.get(tool, 0.0) + words["E"]
        elif job.code == "M104":
            self._nozzles[int(words["T"])] = self._nozzles[int(words["T"])].set(words.get("S", 0.0), self._time)
        elif job.code == "M140":
            self._bed = self._bed.set(words.get("S", 0.0), self._time)
        else:
            self.record.fans[int(words.get("P", 0))] = words.get("S", 0.0) if job.code == "M106" else 0.0

    def _start_wait(self, line: ReceivedLine, code: str, words: dict[str, float]) -> str | None:
        """Begin a line that is acknowledged only when complete, or return why not."""
        if code == "T":
            if not 0 <= words["T"] < TOOLS:
                return f"Error: Tool {words['T']:g} does not exist"
            self.tool = int(words["T"])
        self._blocked = _Job(line, code, words, self._time + self._wait(code, words))
        return None

    def _wait(self, code: str, words: dict[str, float]) -> float:
        """How long a waiting line takes from now [s]; sets the heaters' targets."""
        if code in ("T", "M400"):
            return 0.0
        if code == "G4":
            return words.get("P", 0.0) * 1e-3 + words.get("S", 0.0)
        cooling = "R" in words
        target = words.get("R", words.get("S"))
        tool = int(words.get("T", self.tool or 0)) % TOOLS
        if code == "M190":
            self._bed = self._bed if target is None else self._bed.set(min(target, BED.limit - 1.0), self._time)
            return max(0.0, self._bed.reached(cooling) - self._time)
        if code == "M109" and target is not None:
            self._nozzles[tool] = self._nozzles[tool].set(min(target, NOZZLE.limit - 1.0), self._time)
        every = [self._nozzles[tool]] if code == "M109" else [self._bed, *self._nozzles]
        return max(0.0, *(heater.reached(cooling) - self._time for heater in every))

    def _at_once(self, code: str, words: dict[str, float], out: list[Reply]) -> str | None:
        """Carry out a line that neither moves nor waits, or return why not."""
        if code in ("M82", "M83"):
            self._relative = code == "M83"
        elif code == "G92":
            self._position = words.get("E", self._position)
        elif code == "M105":
            nozzle, bed = self.temperatures()
            goal = self._nozzles[self.tool or 0].target
            out.append(Reply(f"T:{nozzle:.1f} /{goal:.1f} B:{bed:.1f} /{self._bed.target:.1f}"))
        elif code == "M115":
            out.append(Reply("FIRMWARE_NAME: Beadwise board simulator FIRMWARE_VERSION: 1 ELECTRONICS: none"))
        elif code not in ("M110", "M117", ""):
            return f"Warning: {code}: Command is not supported"
        return None


def _ok(line: ReceivedLine) -> Reply:
    return Reply("ok" if line.number is None else f"ok N{line.number}", line.number or 0)


def _parsed(text: str) -> tuple[str, dict[str, float]]:
    """The code, such as `G1`, and the values of the letters after it."""
    found = _WORD.findall(text.upper())
    if not found:
        return text[:20], {}
    letter, value = found[0]
    code = "T" if letter == "T" else f"{letter}{value}"
    rest = {name: float(number) for name, number in found[1:] if number and not number.startswith('"')}
    if letter == "T":
        rest["T"] = float(value) if value and not value.startswith('"') else -1.0
    return code, rest
