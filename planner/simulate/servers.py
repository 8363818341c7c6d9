"""The simulators' sockets: the board's telnet, and the connection for a program's G-code."""

from __future__ import annotations

import copy
import math
import re
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence

from planner.base.errors import InputError
from planner.simulate.board import Board, Fault, Faults, Record, Reply

# ----------------------------------------------------------------------------------------------------
# Shared: listening, and reading lines of bounded length.

HOST = "127.0.0.1"
BLOCK = 4096  # bytes read at once


def bound_socket(host: str, port: int, kind: socket.SocketKind = socket.SOCK_STREAM) -> socket.socket:
    """A socket bound to an address, any free port for 0. Raises InputError if that is impossible."""
    out = socket.socket(socket.AF_INET, kind)
    try:
        out.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        out.bind((host, port))
    except OSError as error:
        out.close()
        raise InputError(f"cannot listen on {host}:{port}: {error.strerror or error}", field="--port") from error
    return out


# A page in a browser may post anything to any port of this computer, and a line-based protocol would interpret the
# lines of the body as its own. An HTTP request begins with a method and a path, unlike any G-code or FTP command.
_HTTP = re.compile(rb"[A-Z]{3,10} [/*]")
LONGEST_METHOD = 12  # bytes up to the path
TURNED_AWAY = "a request of HTTP was turned away"


def is_http(opening: bytes) -> bool:
    """Whether a connection begins like a browser's."""
    return _HTTP.match(opening) is not None


class LineReader:
    """Splits a byte stream into lines of at most `longest` bytes, terminated by LF."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._partial = b""

    def feed(self, data: bytes) -> list[str]:
        """The lines now complete, without their LF. Raises ValueError for anything but lines of printable ASCII."""
        *whole, self._partial = (self._partial + data).split(b"\n")
        for raw in (*whole, self._partial):
            if len(raw) > self._longest:
                raise ValueError(f"a line of more than {self._longest} bytes")
        out = []
        for raw in whole:
            text = raw.decode("ascii", errors="replace")
            if not text.isascii() or not text.isprintable():
                raise ValueError(f"not printable: {raw[:20]!r}")
            out.append(text)
        return out


# ----------------------------------------------------------------------------------------------------
# The board on TCP, as in RepRapFirmware's telnet: one connection at a time, replies end with CRLF.

DISCARDED = 0.5  # s after a connection, in which RepRapFirmware discards all input
LOOK = 0.05  # s between checks of the clock, and whether to end
GARBAGE = b"\x00\xfe\x81\x7fk~\r\n"
MOST_TRIES = 3  # passwords before the connection is closed


class BoardServer:
    """A board with its network, in a separate thread. Board time runs `pace` times as fast as wall time."""

    def __init__(
        self,
        host: str,
        port: int,
        pace: float = 1.0,
        faults: Sequence[Fault] = (),
        password: str = "",
        tool: int | None = None,
    ) -> None:
        self._faults, self._password, self._pace = Faults(faults), password, pace
        self._board = Board(self._faults, tool)
        self._lock = threading.Lock()
        self._begin = time.monotonic()
        self._listener = bound_socket(host, port)
        self._listener.listen(4)
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()
        self._ending = threading.Event()
        self._client: _Client | None = None
        self._thread = threading.Thread(target=self._serve, name="board", daemon=True)
        self._thread.start()

    def record(self) -> Record:
        """What the board has done so far."""
        with self._lock:
            return copy.deepcopy(self._board.record)

    def close(self) -> None:
        """End the thread and close all sockets."""
        self._ending.set()
        self._thread.join()

    def _now(self) -> float:
        return (time.monotonic() - self._begin) * self._pace

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector, self._listener:
            selector.register(self._listener, selectors.EVENT_READ)
            while not self._ending.is_set():
                client = self._client
                if client is not None:
                    self._register(selector, client)
                for key, _ in selector.select(self._patience()):
                    if key.fileobj is self._listener:
                        self._accept()
                    elif client is not None:
                        self._receive(client)
                with self._lock:
                    replies = self._board.advance(self._now())
                if self._client is not None:
                    self._say(self._client, replies)
                    if self._client.gone:
                        self._part(selector, self._client)
            if self._client is not None:
                self._part(selector, self._client)

    def _register(self, selector: selectors.BaseSelector, client: _Client) -> None:
        """Listen to the client while there is room for its lines."""
        wanted = self._board.room > 0
        if wanted != (client.socket in selector.get_map()):
            if wanted:
                selector.register(client.socket, selectors.EVENT_READ)
            else:
                selector.unregister(client.socket)

    def _part(self, selector: selectors.BaseSelector, client: _Client) -> None:
        if client.socket in selector.get_map():
            selector.unregister(client.socket)
        client.socket.close()
        self._client = None
        with self._lock:
            self._board.disconnect()

    def _patience(self) -> float:
        """How long nothing can happen without input [wall s]."""
        ends = [LOOK, (self._board.next_change() - self._now()) / self._pace]
        if self._client is not None and self._client.held:
            ends.append(self._client.held[0][0] - time.monotonic())
        return max(0.0, min(ends))

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.settimeout(1.0)  # for sending: a client that does not read is dropped
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._client is not None:
            connection.close()
            return
        self._client = _Client(connection, logged_in=not self._password)
        if self._password:
            self._client.send(b"Please enter your password:\r\n")

    def _receive(self, client: _Client) -> None:
        try:
            data = client.socket.recv(BLOCK)
        except OSError:
            data = b""
        if not data:
            client.gone = True
        elif client.browses(data):  # even while input is discarded, as its body may come later
            client.gone = True
            with self._lock:
                self._board.record.warnings.append(TURNED_AWAY)
        elif time.monotonic() - client.since < DISCARDED:
            return
        elif client.logged_in:
            with self._lock:
                replies = self._board.receive(data, self._now())
            self._say(client, replies)
        else:
            self._log_in(client, data)

    def _log_in(self, client: _Client, data: bytes) -> None:
        client.tried = (client.tried + data)[-BLOCK:]
        if b"\n" not in client.tried:
            return
        word, client.tried = client.tried.split(b"\n", 1)[0].strip(), b""
        client.logged_in = word == self._password.encode()
        client.tries += 1
        client.send(b"Log in successful!\r\n" if client.logged_in else b"Invalid password\r\n")
        client.gone = client.gone or (not client.logged_in and client.tries >= MOST_TRIES)

    def _say(self, client: _Client, replies: Sequence[Reply]) -> None:
        """Send replies, and those held back by a fault that are now due."""
        for reply in replies:
            line = reply.ok
            late = self._faults.take("delay", line)
            due = time.monotonic() + late.value if late else client.held[-1][0] if client.held else 0.0
            data = GARBAGE if self._faults.take("garbage", line) else reply.text.encode("ascii", "replace") + b"\r\n"
            client.held.append((math.inf if self._faults.take("drop", line) else due, data))
        while client.held and not client.gone:
            due, data = client.held[0]
            if due == math.inf:
                client.gone = True
            elif due > time.monotonic():
                return
            else:
                client.held.popleft()
                client.send(data)


class _Client:
    """A connection, and the data held back from it: (due wall time, bytes); infinity closes the connection."""

    def __init__(self, connection: socket.socket, logged_in: bool) -> None:
        self.socket, self.logged_in = connection, logged_in
        self.since = time.monotonic()
        self.held: deque[tuple[float, bytes]] = deque()
        self.tried, self.tries, self.gone = b"", 0, False
        self._opening = b""

    def browses(self, data: bytes) -> bool:
        """Whether the connection, with this data, turns out to be a browser's."""
        if len(self._opening) >= LONGEST_METHOD:
            return False
        self._opening = (self._opening + data)[:LONGEST_METHOD]
        return is_http(self._opening)

    def send(self, data: bytes) -> None:
        try:
            self.socket.sendall(data)
        except OSError:
            self.gone = True


# ----------------------------------------------------------------------------------------------------
# The controller's end of the connection for G-code: lines numbered, acknowledged, bounded.

WINDOW = 16  # lines sent and not acknowledged
TIMEOUT = 2.0  # s without an acknowledgement while one is needed
LATEST = 900.0  # s in which all lines must be acknowledged, after heating and at the end
LONGEST = 80  # characters, as for RAPID's strings
_ANSWER = re.compile(r"([GA]) (0|[1-9][0-9]{0,8})|S (.{0,76})")


class Ended(Exception):
    """The connection cannot continue; states why."""


class ProgramSocket:
    """Sends lines 1, 2, 3 … and keeps track of acknowledgements. Errors are raised as Ended."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket, self._lines = connection, LineReader(LONGEST)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.sent, self.acknowledged, self.begun = 0, 0, False
        self._last = time.monotonic()

    @property
    def full(self) -> bool:
        """Whether as many lines as allowed await acknowledgement."""
        return self.sent - self.acknowledged >= WINDOW

    @property
    def quiet(self) -> bool:
        """Whether every line was acknowledged."""
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
        """Wait up to some seconds for data, and process it."""
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

    def hold(self) -> None:
        """Restart the time without an acknowledgement."""
        self._last = time.monotonic()

    def need(self, limit: float) -> None:
        """Call while an acknowledgement is needed; raises Ended if it has taken longer than a limit [s]."""
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
