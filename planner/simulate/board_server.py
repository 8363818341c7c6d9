"""The board on TCP, as RepRapFirmware's telnet: one connection at a time, replies ended by CRLF."""

from __future__ import annotations

import copy
import math
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence

from planner.simulate.board import Board, Record, Reply
from planner.simulate.faults import Fault, Faults
from planner.simulate.lines import BLOCK, bound_socket

DISCARDED = 0.5  # s after a connection, in which RepRapFirmware throws away what comes
LOOK = 0.05  # s between looks at the clock and at whether to end
GARBAGE = b"\x00\xfe\x81\x7fk~\r\n"
MOST_TRIES = 3  # passwords before the connection is closed


class BoardServer:
    """A board with its network, in a thread of its own. Board time runs `pace` times as fast as the wall's."""

    def __init__(
        self, host: str, port: int, pace: float = 1.0, faults: Sequence[Fault] = (), password: str = ""
    ) -> None:
        self._faults, self._password, self._pace = Faults(faults), password, pace
        self._board = Board(self._faults)
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
                        self._hear(client)
                with self._lock:
                    replies = self._board.advance(self._now())
                if self._client is not None:
                    self._say(self._client, replies)
                    if self._client.gone:
                        self._part(selector, self._client)
            if self._client is not None:
                self._part(selector, self._client)

    def _register(self, selector: selectors.BaseSelector, client: _Client) -> None:
        """Listen to the client while there is room for what it sends."""
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
        """How long nothing can happen by itself [wall s]."""
        ends = [LOOK, (self._board.next_change() - self._now()) / self._pace]
        if self._client is not None and self._client.held:
            ends.append(self._client.held[0][0] - time.monotonic())
        return max(0.0, min(ends))

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.settimeout(1.0)  # for sending: one who does not read is dropped
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._client is not None:
            connection.close()
            return
        self._client = _Client(connection, logged_in=not self._password)
        if self._password:
            self._client.send(b"Please enter your password:\r\n")

    def _hear(self, client: _Client) -> None:
        try:
            data = client.socket.recv(BLOCK)
        except OSError:
            data = b""
        if not data:
            client.gone = True
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
        """Send replies, and those that a fault held back and whose time has come."""
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
    """A connection, and what is held back from it: (wall time when due, bytes); due at infinity closes it."""

    def __init__(self, connection: socket.socket, logged_in: bool) -> None:
        self.socket, self.logged_in = connection, logged_in
        self.since = time.monotonic()
        self.held: deque[tuple[float, bytes]] = deque()
        self.tried, self.tries, self.gone = b"", 0, False

    def send(self, data: bytes) -> None:
        try:
            self.socket.sendall(data)
        except OSError:
            self.gone = True
