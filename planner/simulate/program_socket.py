"""The controller's end of the connection that carries a program's G-code: lines numbered, acknowledged, bounded."""

from __future__ import annotations

import re
import socket
import time

from planner.simulate.lines import BLOCK, Lines

WINDOW = 16  # lines sent and not acknowledged
TIMEOUT = 2.0  # s without an acknowledgement while one is needed
LATEST = 900.0  # s in which all lines must be taken, behind heating and at the end
LONGEST = 80  # characters, as RAPID's strings
_ANSWER = re.compile(r"([GA]) (0|[1-9][0-9]{0,8})|S (.{0,76})")


class Ended(Exception):
    """The connection cannot go on; says why."""


class ProgramSocket:
    """Sends lines 1, 2, 3 … and keeps account of what was acknowledged. Errors come as Ended."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket, self._lines = connection, Lines(LONGEST)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.sent, self.acknowledged, self.begun = 0, 0, False
        self._last = time.monotonic()

    @property
    def full(self) -> bool:
        """As many lines are out as may be."""
        return self.sent - self.acknowledged >= WINDOW

    @property
    def quiet(self) -> bool:
        """Every line was acknowledged."""
        return self.sent == self.acknowledged

    def line(self, gcode: str) -> None:
        """Send the next line."""
        self.sent += 1
        if self.sent - self.acknowledged == 1:
            self._last = time.monotonic()
        self.say(f"L {self.sent} {gcode}")

    def say(self, text: str) -> None:
        """Send any line."""
        self.raw(text.encode("ascii", "replace") + b"\n")

    def raw(self, data: bytes) -> None:
        """Send bytes as they are."""
        try:
            self._socket.settimeout(TIMEOUT)
            self._socket.sendall(data)
        except OSError as error:
            raise Ended("connection lost") from error

    def listen(self, seconds: float) -> None:
        """Take what comes within some seconds, no longer than until something has come."""
        self._socket.settimeout(max(seconds, 1e-4))
        try:
            data = self._socket.recv(BLOCK)
        except TimeoutError:
            return
        except OSError as error:
            raise Ended("connection lost") from error
        if not data:
            raise Ended("connection lost")
        try:
            for text in self._lines.feed(data):
                self._take(text)
        except ValueError as error:
            raise Ended(f"garbage: {error}") from error

    def need(self, limit: float = TIMEOUT) -> None:
        """To be asked while an acknowledgement is needed; raises Ended where it has taken longer than a limit [s]."""
        if time.monotonic() - self._last > limit:
            raise Ended(f"no acknowledgement for {limit:g} s")

    def _take(self, text: str) -> None:
        match = _ANSWER.fullmatch(text)
        if match is None:
            raise Ended(f"unknown answer {text[:20]!r}")
        word, number, reason = match.groups()
        if reason is not None:
            raise Ended(f"stopped from outside: {reason}")
        n = int(number)
        if word == "G":
            if self.begun or n != 1:
                raise Ended(f"cannot begin with line {n}")
            self.begun = True
        elif not self.begun or not self.acknowledged < n <= self.sent:
            raise Ended(f"line {n} acknowledged, which is not out")
        else:
            self.acknowledged = n
        self._last = time.monotonic()
