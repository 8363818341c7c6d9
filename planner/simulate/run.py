"""A program that runs: its motion in the program's time, its outputs, and its lines over the socket."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from planner.errors import InputError
from planner.simulate.faults import Fault, Faults
from planner.simulate.lines import bound_socket
from planner.simulate.motion import OUTPUT, SEND, SETTLE, Happening, Motion
from planner.simulate.program_socket import LATEST, TIMEOUT, Ended, ProgramSocket

ACCEPT_TIMEOUT = 60.0  # s in which somebody must connect
LOOK = 0.02  # s between looks at whether to pause or end
GARBAGE = b"\x80L ?\x07\n"
FINISHED = "finished"


@dataclass(frozen=True)
class RunState:
    """Where a run is. time [s] of the program; move from 0; lines out and acknowledged; reason once it has ended."""

    module: str
    lines: int
    time: float = 0.0
    move: int = 0
    tip: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sent: int = 0
    acknowledged: int = 0
    outputs: dict[str, bool] = field(default_factory=dict)
    reason: str = ""


class Run:
    """A program in a thread of its own; runs once `resume` is called, until its end, `end` or a fault.

    address   where it listens for who takes its lines, if it has any
    """

    def __init__(
        self, module: str, motion: Motion, pace: float, address: tuple[str, int], faults: Sequence[Fault]
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
        """Where it is now."""
        with self._lock:
            return replace(self._state, outputs=dict(self._state.outputs))

    @property
    def over(self) -> bool:
        return bool(self.state().reason)

    @property
    def going(self) -> bool:
        return self._going.is_set() and not self.over

    def resume(self) -> None:
        """Go on, or begin."""
        self._going.set()

    def pause(self) -> None:
        """Stand still; sockets stay as they are."""
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
            return  # nobody is left who could be told

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

    def _do(self, happening: Happening, lines: ProgramSocket | None) -> None:
        if happening.kind == OUTPUT:
            signal, value = happening.text.split("=")
            with self._lock:
                self._state = replace(self._state, outputs={**self._state.outputs, signal: value == "1"})
        elif happening.kind == SETTLE:
            self._settle(lines)
        elif lines is not None:
            self._listen(lines, 0.0)
            while lines.full:
                lines.need()
                self._listen(lines)
            self._since = time.monotonic()  # the robot stood meanwhile
            self._send(happening.text, lines)
            self._note(lines)

    def _settle(self, lines: ProgramSocket | None) -> None:
        """Stand until every line was taken."""
        while lines is not None and not lines.quiet:
            lines.need(LATEST)
            self._listen(lines)
        self._since = time.monotonic()

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
