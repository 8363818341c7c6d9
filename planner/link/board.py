"""Coming to terms with the extruder's board before a run: RepRapFirmware's telnet."""

from __future__ import annotations

import socket
import time
from contextlib import ExitStack

from planner.errors import InputError
from planner.link.framing import LONGEST_LINE, Framer
from planner.link.messages import Ok, Trouble, from_board, to_board_plain
from planner.link.secret import password
from planner.link.sockets import PIECE, Address, LinkError, connect

PASSWORD = "BEADWISE_HEAD_PASSWORD"
SETTLE_TIME = (
    0.7  # s; what comes in the first moments is discarded by the board, and a password is asked for after them
)
ANSWER_TIME = 5.0  # s
QUIET_TIME = 0.1  # s without a word, after which the board has said all
PROBE = "M115"  # which firmware it has
MOST_READ = 16 * 1024  # bytes of greeting


def open_board(address: Address) -> tuple[socket.socket, list[str]]:
    """A connection to a board that answers, and what it said of itself.

    Raises InputError for a wrong password or host, LinkError for a board that does not answer as one.
    """
    with ExitStack() as unless_agreed:
        made = unless_agreed.enter_context(connect(address, "the board"))
        try:
            said = _agree(made, address)
        except OSError as error:
            raise LinkError(f"the board at {address}: {error.strerror or error}") from None
        unless_agreed.pop_all()
        return made, said


def _agree(made: socket.socket, address: Address) -> list[str]:
    greeting = _read(made, SETTLE_TIME)
    if b"password" in greeting.lower():
        secret = password(PASSWORD, f"the board at {address}")
        made.sendall(secret.reveal().encode("utf-8") + b"\n")
        answer = _read(made, ANSWER_TIME, until=b"\n")
        if b"success" not in answer:
            raise InputError(f"the board at {address} does not take the password", hint=f"see {PASSWORD}")
        _read(made, QUIET_TIME)
    made.sendall(to_board_plain(PROBE))
    said: list[str] = []
    framer, end = Framer(), time.monotonic() + ANSWER_TIME
    while time.monotonic() < end:
        lines, garbage = framer.lines(_read(made, end - time.monotonic(), until=b"\n"))
        for text in lines:
            message = from_board(text)
            if isinstance(message, Ok):
                if _read(made, QUIET_TIME):
                    raise LinkError(f"the board at {address} says more than it was asked")
                return said
            if isinstance(message, Trouble):
                raise LinkError(f"the board at {address} reports {text!r}")
            said.append(text)
        if garbage is not None or len(said) > LONGEST_LINE:
            raise LinkError(f"what answers at {address} is no board of RepRapFirmware")
    raise LinkError(f"the board at {address} does not answer {PROBE}")


def _read(made: socket.socket, seconds: float, until: bytes | None = None) -> bytes:
    """What comes within a time, or until a byte that ends it."""
    out, end = b"", time.monotonic() + seconds
    while len(out) < MOST_READ and (left := end - time.monotonic()) > 0.0:
        made.settimeout(left)
        try:
            piece = made.recv(PIECE)
        except TimeoutError:
            break
        if not piece:
            raise LinkError("the board closed the connection")
        out += piece
        if until is not None and until in piece:
            break
    return out
