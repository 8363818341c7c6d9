"""Simulator of a robot controller, without sockets: files, loaded modules, the running program, and its motion."""

from __future__ import annotations

import bisect
import re
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.gcode_lines import commands_in
from planner.cell.cell import Cell
from planner.export.arcs import LinesAndArcs
from planner.export.fit import to_matrix
from planner.export.player.play import play
from planner.export.player.played import Played
from planner.export.program import RobotProgram
from planner.export.rapid.reader import read_rapid_stretches
from planner.simulate.board import Fault, Faults
from planner.simulate.servers import LATEST, TIMEOUT, Ended, ProgramSocket, bound_socket

# ----------------------------------------------------------------------------------------------------
# Motion of a program over time, from speeds only.

ORDER = OUTPUT, SEND, SETTLE = "output", "send", "settle"
# lines that the board acknowledges only when complete
SLOW = ("G4", "M109", "M116", "M190")


@dataclass(frozen=True)
class MotionEvent:
    """An action of a program at a time [s], during a move.

    Sets an output (`signal=0`, `signal=1`); sends a line; or waits, at the end of a rest, for all acknowledgements.
    """

    time: float
    move: int
    kind: str
    text: str = ""


class ProgramMotion(Protocol):
    """A program's motion. Times [s] are relative to its first move."""

    @property
    def duration(self) -> float:
        """Time of the whole motion [s]."""
        ...

    @property
    def happenings(self) -> tuple[MotionEvent, ...]:
        """In order of time."""

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""


@dataclass(frozen=True)
class OwnClock:
    """Motion at the programmed speeds, without acceleration: each move takes as long as its slowest component. A
    station axis, which may be prismatic or revolute, takes the lesser of its two times.

    ends (m,) of the moves, without their waits; starts (m,); first (3,) target; way (m - 1) from each to the next
    """

    starts: Array
    ends: Array
    first: Array
    way: LinesAndArcs
    duration: float
    happenings: tuple[MotionEvent, ...]

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""
        i = min(int(np.searchsorted(self.ends, time)), len(self.ends) - 1)
        lasts = self.ends[i] - self.starts[i]
        share = 1.0 if lasts <= 0.0 else float(np.clip((time - self.starts[i]) / lasts, 0.0, 1.0))
        return i, self.first if i == 0 else self.way.take(np.array([i - 1])).at(np.array([share]))[0]


def own_clock(program: RobotProgram) -> OwnClock:
    """The motion of a program, from its own speeds and lengths."""
    way = program.segments
    step = way.length
    same = np.abs(np.einsum("ij,ij->i", program.quat[1:], program.quat[:-1])).clip(0.0, 1.0)
    turn = 2.0 * np.arccos(same)
    axes = np.nan_to_num(np.abs(np.diff(program.external, axis=0))).max(axis=1, initial=0.0)
    tip, reorient, slide, rotate = program.speed[1:].T
    # without a cell it is unknown which axes slide (their mm were read as degrees), and where a second arm's flange is
    if program.second is None:
        beside = np.minimum(axes / rotate, 1e-3 * np.degrees(axes) / slide)
    else:
        beside = axes / program.second[2:, 1]
    # the first move leads to where the robot already stands
    lasts = np.concatenate([[0.0], np.maximum(np.maximum(step / tip, turn / reorient), beside)])
    after = np.cumsum(lasts + program.wait)
    starts = np.concatenate([[0.0], after[:-1]])
    ends = starts + lasts
    length = np.concatenate([[0.0], step])
    happenings = (*_outputs(program, starts, lasts, length), *lines(program, ends, after))
    return OwnClock(starts, ends, program.position[0], way, float(after[-1]), in_order(happenings))


def in_order(happenings: Iterable[MotionEvent]) -> tuple[MotionEvent, ...]:
    """Sort by time and move; within a move, outputs come before lines, and lines before the waits for them."""
    return tuple(sorted(happenings, key=lambda each: (each.time, each.move, ORDER.index(each.kind))))


def lines(program: RobotProgram, ends: Array, after: Array) -> Iterator[MotionEvent]:
    """Lines that a program sends, and its waits for the board; ends, after (m): of each move, and of its rest [s]."""
    for move in sorted(program.sends):
        texts = program.sends[move]
        arrive, leave = (0.0, 0.0) if move < 0 else (float(ends[move]), float(after[move]))
        rests = program.send_rests.get(move, (0.0,) * len(texts))
        for text, rest in zip(texts, rests, strict=True):
            yield MotionEvent(min(arrive + rest, leave), move, SEND, text)
        if any(command.startswith(SLOW) for text in texts for command in commands_in(text)):
            yield MotionEvent(leave, move, SETTLE)


def _outputs(program: RobotProgram, starts: Array, lasts: Array, length: Array) -> Iterator[MotionEvent]:
    for i in range(len(starts)):
        for trigger in program.triggers.get(i, ()):
            share = min(1.0, trigger.distance / length[i]) if length[i] > 0.0 else 0.0
            when = starts[i] + lasts[i] * (share if trigger.from_start else 1.0 - share)
            yield MotionEvent(float(when), i, OUTPUT, f"{trigger.signal}={int(trigger.value)}")


# ----------------------------------------------------------------------------------------------------
# The same, from the program player: with a cell's accelerations, corners and joint limits.


@dataclass(frozen=True)
class PlayedMotion:
    """The motion of a played program."""

    played: Played
    duration: float
    happenings: tuple[MotionEvent, ...]

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""
        moment = self.played.at(time)
        return int(moment.move), np.asarray(moment.position)


def played_motion(program: RobotProgram, cell: Cell) -> PlayedMotion:
    """The motion of a program in its cell, with joints as its controller counts them, and with its nozzle. Raises
    InputError for unreachable targets."""
    cell, T_flange_tool = cell.as_counted, np.eye(4)
    T_flange_tool[:3, :3], T_flange_tool[:3, 3] = to_matrix(program.tool[None, 3:])[0], program.tool[:3]
    off = [np.linalg.norm(nozzle.T_flange_nozzle - T_flange_tool) for nozzle in cell.nozzles]
    played = play(program, cell.with_nozzle(int(np.argmin(off)) if off else 0))
    outputs = [
        MotionEvent(each.t, each.move, OUTPUT, f"{each.text}={int(each.value)}")
        for each in played.events
        if each.kind == "output"
    ]
    leave = played.leave[played.target]
    return PlayedMotion(played, played.duration, in_order([*outputs, *lines(program, played.arrive, leave)]))


@dataclass(frozen=True)
class MotionsInTurn:
    """Motions one after another; moves are numbered consecutively."""

    motions: tuple[ProgramMotion, ...]
    moves: tuple[int, ...]

    @cached_property
    def begins(self) -> tuple[float, ...]:
        """When each begins [s]."""
        return tuple(np.cumsum([0.0, *(each.duration for each in self.motions[:-1])]).tolist())

    @property
    def duration(self) -> float:
        """Time of the whole motion [s]."""
        return sum(each.duration for each in self.motions)

    @cached_property
    def happenings(self) -> tuple[MotionEvent, ...]:
        """In order of time."""
        before = np.cumsum([0, *self.moves]).tolist()
        return tuple(
            replace(each, time=begin + each.time, move=first + each.move)
            for motion, begin, first in zip(self.motions, self.begins, before, strict=False)
            for each in motion.happenings
        )

    def at(self, time: float) -> tuple[int, Array]:
        """The move that runs at a time, and the tip in the part frame (3,) [m]."""
        k = max(bisect.bisect_right(self.begins, time) - 1, 0)
        move, tip = self.motions[k].at(time - self.begins[k])
        return sum(self.moves[:k]) + move, tip


# ----------------------------------------------------------------------------------------------------
# A running program: its motion, its outputs, and its lines over the socket.

ACCEPT_TIMEOUT = 60.0  # s in which somebody must connect
LOOK = 0.02  # s between checks whether to pause or end
GARBAGE = b"\x80L ?\x07\n"
FINISHED = "finished"


@dataclass(frozen=True)
class RunState:
    """State of a run: time [s] of the program; move from 0; lines sent and acknowledged; reason once it has ended."""

    module: str
    lines: int
    time: float = 0.0
    move: int = 0
    tip: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sent: int = 0
    acknowledged: int = 0
    outputs: dict[str, bool] = field(default_factory=dict)
    reason: str = ""


class ProgramRun:
    """A program in a separate thread; runs once `resume` is called, until its end, `end` or a fault.

    address   where it listens for the receiver of its lines, if it has any
    """

    def __init__(
        self, module: str, motion: ProgramMotion, pace: float, address: tuple[str, int], faults: Sequence[Fault]
    ) -> None:
        self._motion, self._pace, self._address, self._faults = motion, pace, address, Faults(faults)
        self._state = RunState(module, sum(each.kind == SEND for each in motion.happenings))
        self._lock = threading.Lock()
        self._going, self._ending = threading.Event(), threading.Event()
        self.restarted = threading.Event()
        self._time, self._since = 0.0, time.monotonic()
        self._thread = threading.Thread(target=self._run, name="program", daemon=True)
        self._thread.start()

    def state(self) -> RunState:
        """Its present state."""
        with self._lock:
            return replace(self._state, outputs=dict(self._state.outputs))

    @property
    def over(self) -> bool:
        """Whether it has ended, for whatever reason."""
        return bool(self.state().reason)

    @property
    def going(self) -> bool:
        """Whether it is executing: neither paused nor over."""
        return self._going.is_set() and not self.over

    def resume(self) -> None:
        """Continue, or begin."""
        self._going.set()

    def pause(self) -> None:
        """Stand still; sockets stay open."""
        self._going.clear()

    def end(self) -> None:
        """End for good, and wait for that."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        lines: ProgramSocket | None = None
        connection: socket.socket | None = None
        try:
            while not self._going.is_set():
                self._check()
                time.sleep(LOOK / 4)
            if self._state.lines:
                connection = self._accepted()
                lines = ProgramSocket(connection)
                self._greet(lines)
            self._since = time.monotonic()
            for happening in self._motion.happenings:
                self._wait(happening.time, lines)
                self._do(happening, lines)
            self._wait(self._motion.duration, lines)
            self._settle(lines)
            if lines is not None:
                lines.say(f"E {lines.sent}")
            reason = FINISHED
        except (Ended, InputError) as ended:
            reason = str(ended)
            self._last_word(lines, reason)
        finally:
            if connection is not None:
                connection.close()
        self._note(lines)
        with self._lock:
            off = dict.fromkeys(self._state.outputs, False)
            self._state = replace(self._state, reason=reason, outputs=off)

    def _last_word(self, lines: ProgramSocket | None, reason: str) -> None:
        if lines is None or self.restarted.is_set() or reason == "connection lost":
            return
        try:
            lines.say(f"X {lines.sent} {reason}"[:80])
        except Ended:
            return  # nobody is left to be told

    def _check(self) -> None:
        if self._ending.is_set():
            raise Ended("ended at the controller")

    def _accepted(self) -> socket.socket:
        since = time.monotonic()
        with bound_socket(*self._address) as listener:
            listener.listen(1)
            listener.settimeout(LOOK)
            while time.monotonic() - since < ACCEPT_TIMEOUT:
                self._check()
                try:
                    return listener.accept()[0]
                except TimeoutError:
                    continue
        raise Ended(f"nobody connected within {ACCEPT_TIMEOUT:g} s")

    def _greet(self, lines: ProgramSocket) -> None:
        lines.say(f"H {self._state.module} {self._state.lines}")
        since = time.monotonic()
        while not lines.begun:
            if time.monotonic() - since > TIMEOUT:
                raise Ended(f"no answer for {TIMEOUT:g} s")
            self._listen(lines)

    def _listen(self, lines: ProgramSocket, most: float = LOOK) -> None:
        self._check()
        lines.listen(min(most, LOOK))
        self._note(lines)

    def _note(self, lines: ProgramSocket | None) -> None:
        move, tip = self._motion.at(self._time)
        with self._lock:
            out = (0, 0) if lines is None else (lines.sent, lines.acknowledged)
            place = (float(tip[0]), float(tip[1]), float(tip[2]))
            self._state = replace(self._state, time=self._time, move=move, tip=place, sent=out[0], acknowledged=out[1])

    def _wait(self, until: float, lines: ProgramSocket | None) -> None:
        """Let the program's time pass."""
        while True:
            now = time.monotonic()
            if self._going.is_set():
                self._time = min(until, self._time + (now - self._since) * self._pace)
            self._since = now
            left = LOOK if not self._going.is_set() else (until - self._time) / self._pace
            if left <= 0.0:
                return
            if lines is not None:
                self._listen(lines, left)
            else:
                self._check()
                time.sleep(min(left, LOOK))
                self._note(None)

    def _do(self, happening: MotionEvent, lines: ProgramSocket | None) -> None:
        if happening.kind == OUTPUT:
            signal, value = happening.text.split("=")
            with self._lock:
                self._state = replace(self._state, outputs={**self._state.outputs, signal: value == "1"})
        elif happening.kind == SETTLE:
            self._settle(lines)
        elif lines is not None:
            self._listen(lines, 0.0)
            while lines.full:
                self._need(lines, TIMEOUT)
            self._since = time.monotonic()  # the robot stood meanwhile
            self._send(happening.text, lines)
            self._note(lines)

    def _settle(self, lines: ProgramSocket | None) -> None:
        """Stand until every line is acknowledged."""
        while lines is not None and not lines.quiet:
            self._need(lines, LATEST)
        self._since = time.monotonic()

    def _need(self, lines: ProgramSocket, limit: float) -> None:
        """Wait for an acknowledgement; while paused, the time limit does not run."""
        if self._going.is_set():
            lines.need(limit)
        else:
            lines.hold()
        self._listen(lines)

    def _send(self, text: str, lines: ProgramSocket) -> None:
        n = lines.sent + 1
        if self._faults.take("skip", n):
            lines.sent += 1
        elif self._faults.take("garbage", n):
            lines.raw(GARBAGE)
            lines.sent += 1
        else:
            lines.line(text)
        if self._faults.take("drop", n):
            raise Ended("connection lost")
        if self._faults.take("restart", n):
            self.restarted.set()
            raise Ended("the controller restarted")
        if self._faults.take("stop", n):
            raise Ended("stopped at the controller")


# ----------------------------------------------------------------------------------------------------
# The controller: files, loaded modules, the running program, and what is allowed when.

LARGEST_FILE = 64 << 20  # bytes
MOST_FILES = 1000
RESTART_TIME = 2.0  # wall s for which a restarting controller does not answer
TASK = "T_ROB1"
TASKS = (TASK, "T_ROB2")  # of a MultiMove system with two arms
_PLAIN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
_HOME = re.compile(r"(?i)(?:\$home/|home/|home:/?)")
_MODULE = re.compile(r"(?im)^\s*MODULE\s+([A-Za-z]\w{0,31})")
_MAIN = re.compile(r"(?im)^\s*PROC\s+main\s*\(")
_LISTED = re.compile(r"<Module>\s*([^<\s]{1,64})\s*</Module>")
# loaded on a controller in use: somebody else's program
OTHER_PROGRAM = {"MainModule": "MODULE MainModule\n    PROC main()\n    ENDPROC\nENDMODULE\n"}

Reader = Callable[[Mapping[str, str]], tuple[RobotProgram, ...]]


class Denied(Exception):
    """The controller refuses a request; carries the HTTP status for it."""

    def __init__(self, status: int, reason: str) -> None:
        self.status, self.reason = status, reason
        super().__init__(reason)


class Controller:
    """The controller's state; thread-safe. Files are kept in a temporary folder until `close`.

    address   where programs listen for the receiver of their lines
    read      modules (name → text) → the program, split into stretches with one tool each; raises InputError
    move      program → its motion; raises InputError for unreachable targets
    loaded    modules (name → text) of a program that is already loaded
    arms      number of arms, each in a separate task
    """

    def __init__(
        self,
        address: tuple[str, int],
        pace: float = 1.0,
        faults: Sequence[Fault] = (),
        read: Reader | None = None,
        move: Callable[[RobotProgram], ProgramMotion] = own_clock,
        loaded: Mapping[str, str] | None = None,
        arms: int = 1,
    ) -> None:
        self._address, self._pace, self._faults = address, pace, tuple(faults)
        self._read, self._move = read or read_modules, move
        self._home = Path(tempfile.mkdtemp(prefix="beadwise-controller-"))
        self._lock = threading.RLock()
        self.tasks = TASKS[:arms]
        self._tasks: dict[str, dict[str, str]] = {task: {} for task in self.tasks}
        self._tasks[TASK] = dict(loaded or {})
        self._run: ProgramRun | None = None
        self._silent_until = 0.0
        self.motors, self.mode = "motoron", "AUTO"

    def close(self) -> None:
        """End the running program, and delete the files."""
        with self._lock:
            self._end_run()
            shutil.rmtree(self._home, ignore_errors=True)

    def state(self) -> RunState | None:
        """State of the program; None if none was prepared since the start."""
        with self._lock:
            return None if self._run is None else self._run.state()

    @property
    def silent(self) -> bool:
        """Whether it is restarting and does not answer."""
        with self._lock:
            if self._run is not None and self._run.restarted.is_set():
                self._end_run()
                self._run = None
                self._tasks = {task: {} for task in self.tasks}
                self._faults = ()
                self.motors = "motoroff"
                self._silent_until = time.monotonic() + RESTART_TIME
            return time.monotonic() < self._silent_until

    @property
    def running(self) -> bool:
        """Whether a program is executing."""
        with self._lock:
            return self._run is not None and self._run.going

    def put(self, path: str, data: bytes) -> None:
        """Store a file."""
        place = self._place(path)
        with self._lock:
            if not place.exists() and len(list(self._home.iterdir())) >= MOST_FILES:
                raise Denied(507, "no room for another file")
            place.write_bytes(data)

    def get(self, path: str) -> bytes:
        """A file's bytes."""
        place = self._place(path)
        if not place.is_file():
            raise Denied(404, "no such file")
        return place.read_bytes()

    def delete(self, path: str) -> None:
        """Delete a file."""
        place = self._place(path)
        if not place.is_file():
            raise Denied(404, "no such file")
        place.unlink()

    def files(self) -> list[str]:
        """Names of all files."""
        return sorted(each.name for each in self._home.iterdir())

    def load(self, path: str, replace: bool, task: str = TASK) -> None:
        """Load a module into a task, with `replace` in place of one of the same name; the program pointer is lost."""
        with self._lock:
            self._stopped()
            name, text = self._module(path)
            if name in self._tasks[task] and not replace:
                raise Denied(400, f"module {name} is loaded already")
            self._end_run()
            self._run = None
            self._tasks[task][name] = text

    def load_program(self, path: str, replace: bool, task: str = TASK) -> None:
        """Load all modules that a .pgf in HOME names; with `replace`, in place of the task's whole program."""
        with self._lock:
            self._stopped()
            if not path.lower().endswith(".pgf"):
                raise Denied(400, "a program is loaded from its .pgf")
            listed = _LISTED.findall(self.get(path).decode("latin-1"))
            if not listed:
                raise Denied(400, "the program file names no module")
            folder = path[: len(path) - len(path.rpartition("/")[2])]
            modules = dict(self._module(folder + each) for each in listed)
            if not replace and (both := sorted(modules.keys() & self._tasks[task].keys())):
                raise Denied(400, f"module {both[0]} is loaded already")
            self._end_run()
            self._run = None
            self._tasks[task] = modules if replace else {**self._tasks[task], **modules}

    def unload_program(self, task: str = TASK) -> None:
        """Unload all modules of a task's program."""
        with self._lock:
            self._stopped()
            if not self._tasks[task]:
                raise Denied(400, "no program is loaded")
            self._end_run()
            self._run = None
            self._tasks[task] = {}

    def _module(self, path: str) -> tuple[str, str]:
        """Name and text of a module in a file."""
        try:
            text = self.get(path).decode("ascii")
        except UnicodeDecodeError as error:
            raise Denied(400, "the module is not ASCII") from error
        match = _MODULE.search(text)
        if match is None:
            raise Denied(400, "no MODULE in the file")
        return match[1], text

    def unload(self, name: str, task: str = TASK) -> None:
        """Unload a module."""
        with self._lock:
            self._stopped()
            if name not in self._tasks[task]:
                raise Denied(404, "no such module")
            self._end_run()
            self._run = None
            del self._tasks[task][name]

    def modules(self, task: str = TASK) -> list[str]:
        """Names of a task's loaded modules."""
        with self._lock:
            return list(self._tasks[task])

    def reset_pointer(self) -> None:
        """Set the program pointers of all tasks to main: the previous run is over, and its sockets are closed."""
        with self._lock:
            self._stopped()
            modules: dict[str, str] = {}
            for own in self._tasks.values():
                mains = [name for name, text in own.items() if _MAIN.search(text)]
                if len(mains) > 1:
                    raise Denied(400, f"main is ambiguous: it is in {' and in '.join(mains)}")
                modules |= own
            if not modules:
                raise Denied(400, "no program is loaded")
            try:
                programs = self._read({**self._loaded_by(modules.values()), **modules})
                motion: ProgramMotion = MotionsInTurn(
                    tuple(map(self._move, programs)), tuple(len(each.position) for each in programs)
                )
            except InputError as error:
                raise Denied(400, f"the program has errors: {error}") from error
            self._end_run()
            self._run = ProgramRun(programs[0].module, motion, self._pace, self._address, self._faults)

    def start(self) -> None:
        """Run, or continue."""
        with self._lock:
            self._stopped()
            if self.mode != "AUTO" or self.motors != "motoron":
                raise Denied(403, "not in automatic mode with motors on")
            if self._run is None or self._run.over:
                raise Denied(403, "no program pointer")
            self._run.resume()

    def stop(self) -> None:
        """Stop; the program keeps its place."""
        with self._lock:
            if self._run is not None:
                self._run.pause()

    def _stopped(self) -> None:
        if self.running:
            raise Denied(403, "a program is running")

    def _end_run(self) -> None:
        if self._run is not None:
            self._run.end()

    def _loaded_by(self, texts: Iterable[str]) -> dict[str, str]:
        """Modules in HOME that texts name, as in programs that load them while they run."""
        whole = "\n".join(texts)
        out: dict[str, str] = {}
        for path in sorted(self._home.glob("*.mod")):
            if f'"{path.name}"' in whole:
                text = path.read_text("ascii", errors="replace")
                match = _MODULE.search(text)
                out |= {} if match is None else {match[1]: text}
        return out

    def _place(self, path: str) -> Path:
        """The path of a file, for `HOME:/name` or `$HOME/name` only."""
        home = _HOME.match(path)
        name = path[home.end() :] if home else ""
        if not _PLAIN.fullmatch(name):
            raise Denied(404, "only files directly in HOME:")
        return self._home / name


def read_modules(modules: Mapping[str, str]) -> tuple[RobotProgram, ...]:
    """Read modules (name → text), one of which has the main procedure, split into stretches with one tool each."""
    return read_rapid_stretches({f"{name}.mod": text for name, text in modules.items()})
