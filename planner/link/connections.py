"""Connections to the controller's program and to the board, and their passwords."""

from __future__ import annotations

import getpass
import os
import re
import socket
import sys
import threading
import time
from collections.abc import Hashable
from dataclasses import dataclass
from types import TracebackType

from planner.base.errors import EXIT_NOT_VERIFIED, InputError, PlannerError

# ----------------------------------------------------------------------------------------------------
# Connections.

CONNECT_TIME = 5.0  # s for a connection
PIECE = 4096  # bytes read at once
LABEL = "[A-Za-z0-9_](?:[A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?"  # one part of a host name, between dots
LONGEST_HOST = 253  # characters
# A pulled cable goes unnoticed: probe the other end every second, and give up after three probes without an answer.
ASK_TIME, ASKED = 1, 3  # s, times


class LinkError(PlannerError):
    """The machine is not in the state that a run needs; nothing was started."""

    exit_code = EXIT_NOT_VERIFIED


@dataclass(frozen=True)
class Address:
    """Where something listens."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def parse_address(text: str, port: int) -> Address:
    """HOST or HOST:PORT; raises ValueError with the reason."""
    found = re.fullmatch(rf"({LABEL}(?:\.{LABEL})*\.?)(?::([0-9]{{1,5}}))?", text, re.ASCII)
    if found is None or len(found[1]) > LONGEST_HOST:
        raise ValueError(f"{text!r} is not HOST or HOST:PORT")
    chosen = port if found[2] is None else int(found[2])
    if not 1 <= chosen <= 65535:
        raise ValueError(f"{text!r}: a port is 1 to 65535")
    return Address(found[1], chosen)


def given_address(text: str, port: int, option: str) -> Address:
    """The address given by an option; InputError if it is not one."""
    try:
        return parse_address(text, port)
    except ValueError as error:
        raise InputError(str(error), field=option) from None


def connect(address: Address, what: str, patience: float = 0.0) -> socket.socket:
    """Open a connection that notices within seconds when the other end is gone.

    patience  how long to retry while nobody listens there yet [s]
    Raises InputError for an unknown host, LinkError if nobody answers.
    """
    end = time.monotonic() + patience
    while True:
        try:
            made = socket.create_connection((address.host, address.port), timeout=CONNECT_TIME)
            break
        except socket.gaierror as error:
            raise InputError(f"{what}: there is no host {address.host}", hint=error.strerror) from None
        except OSError as error:
            if time.monotonic() >= end:
                raise LinkError(f"{what} at {address} does not answer: {error.strerror or error}") from None
            time.sleep(0.05)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    timing = (("TCP_KEEPIDLE", ASK_TIME), ("TCP_KEEPINTVL", ASK_TIME), ("TCP_KEEPCNT", ASKED))
    for name, value in (*timing, ("TCP_USER_TIMEOUT", 1000 * ASK_TIME * ASKED)):
        if hasattr(socket, name):  # not every system has all of these
            made.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    return made


# ----------------------------------------------------------------------------------------------------
# Deadlines. A socket's timeout restarts with each byte, so a peer that sends one now and again could hold a request for
# ever.


def part(made: socket.socket, words: bytes | bytearray, seconds: float) -> None:
    """Send last words and read until the other end closes, so that they arrive: closing a socket with unread data would
    discard them. Returns within `seconds` in all, whatever still comes, or when the other end is gone.
    """
    end = time.monotonic() + seconds
    try:
        made.settimeout(seconds)
        made.sendall(words)
        made.shutdown(socket.SHUT_WR)
        while (left := end - time.monotonic()) > 0.0:
            made.settimeout(left)
            if not made.recv(PIECE):
                return
    except OSError:
        return  # already gone


class Cutter:
    """Ends all traffic on some sockets at a deadline, however often a byte still comes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sockets: dict[Hashable, socket.socket] = {}
        self._late = False

    def watch(self, name: Hashable, made: socket.socket) -> None:
        """Cut this socket too. It is duplicated, as TLS takes a socket away from its owner."""
        with self._lock:
            before, self._sockets[name] = self._sockets.get(name), made.dup()
            late = self._late
        if before is not None:
            before.close()
        if late:
            self.cut()

    def forget(self, name: Hashable) -> None:
        """Stop watching a socket, which is closed."""
        with self._lock:
            kept = self._sockets.pop(name, None)
        if kept is not None:
            kept.close()

    def within(self, seconds: float) -> _Within:
        """A context in which every socket is cut after `seconds`; raises TimeoutError then."""
        with self._lock:
            self._late = False
        return _Within(self, seconds)

    @property
    def late(self) -> bool:
        """Whether the last context exceeded its time."""
        return self._late

    def cut(self) -> None:
        """Shut down all sockets."""
        with self._lock:
            self._late = True
            for each in self._sockets.values():
                try:
                    each.shutdown(socket.SHUT_RDWR)
                except OSError:
                    continue  # already closed


class _Within:
    def __init__(self, cutter: Cutter, seconds: float) -> None:
        self._cutter, self._timer = cutter, threading.Timer(seconds, cutter.cut)
        self._timer.daemon = True

    def __enter__(self) -> None:
        self._timer.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._timer.cancel()
        # whatever the error was, its cause is the cut socket
        if self._cutter.late and (kind is None or issubclass(kind, Exception)):
            raise TimeoutError from None


# ----------------------------------------------------------------------------------------------------
# Passwords, from the environment or a prompt; never shown.


class Secret:
    """Text that neither `str` nor `repr` reveals."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return "Secret(…)"

    def reveal(self) -> str:
        """The text, to be passed only to where it is needed."""
        return self._text


def password(variable: str, whose: str) -> Secret:
    """The password in an environment variable, or as the user types it; InputError if neither is available."""
    found = os.environ.get(variable)
    if found is not None:
        return Secret(found)
    if not sys.stdin.isatty():
        raise InputError(f"there is no password for {whose}", hint=f"set {variable}")
    try:
        return Secret(getpass.getpass(f"password for {whose}: "))
    except EOFError:  # Ctrl-D
        raise InputError(f"no password was given for {whose}", hint=f"type it, or set {variable}") from None
