"""Runs the relay on two sockets: greets the board, reads, writes, keeps time, logs, and carries out the effects."""

from __future__ import annotations

import json
import os
import selectors
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from planner.base.errors import InputError, OutputError
from planner.link.connections import PIECE, Address, LinkError, connect, part, password
from planner.link.messages import LONGEST_LINE, Framer, Ok, Trouble, from_board, to_board_plain
from planner.link.orders import Order, StopOrder
from planner.link.relay import (
    FAILED,
    Effect,
    LogNote,
    MoveRobot,
    PauseRobot,
    Relay,
    RelaySide,
    RunOutcome,
    RunStatus,
    StopRobot,
    Write,
)

# ----------------------------------------------------------------------------------------------------
# The log: one JSON object per line, written at once.


class Log:
    """Records with UTC and a monotonic clock [ms]. Each is passed to the operating system before it takes effect, so
    that a crash of this program loses none; `close` waits until they are on the disk.

    first  records to begin with
    seen   is called with the same records, once they are written
    """

    def __init__(
        self,
        path: Path,
        seen: Callable[[Sequence[LogNote]], None] = lambda notes: None,
        first: Sequence[LogNote] = (),
    ) -> None:
        """Raises OutputError if the file already exists, or cannot be written."""
        self.path, self._seen = path, seen
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError:
            raise OutputError(f"{path} is there already, and stays as it is: name another with --log") from None
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from None
        try:
            self.write(first)
        except OSError as error:  # a full disk still creates the file
            os.close(self._file)
            path.unlink(missing_ok=True)
            raise OutputError(f"cannot write {path}: {error.strerror}") from None

    def write(self, notes: Sequence[LogNote]) -> None:
        """Append records; OSError if they cannot be written."""
        now, clock = datetime.now(UTC).isoformat(timespec="milliseconds"), round(1e3 * time.monotonic(), 3)
        begin = f'{{"utc": "{now}", "ms": {clock}, '  # by hand for speed: each line of the program makes three records
        texts = [f'{begin}"what": "{note.what}", "n": {note.n}, "text": {json.dumps(note.text)}}}\n' for note in notes]
        left = memoryview("".join(texts).encode("ascii"))
        while left:
            left = left[os.write(self._file, left) :]
        self._seen(notes)

    def close(self) -> None:
        """Flush to the disk, and close."""
        os.fsync(self._file)
        os.close(self._file)


# ----------------------------------------------------------------------------------------------------
# The board's greeting, over RepRapFirmware's telnet.

PASSWORD = "BEADWISE_HEAD_PASSWORD"
SETTLE_TIME = 0.7  # s; the board discards what arrives in the first moments, and then requests a password if it has one
ANSWER_TIME = 5.0  # s
QUIET_TIME = 0.1  # s of silence, after which the board's answer is complete
PROBE = "M115"  # queries the firmware
MOST_READ = 16 * 1024  # bytes of greeting


def open_board(address: Address) -> tuple[socket.socket, list[str]]:
    """A connection to a board that answers, and its greeting.

    Raises InputError for a wrong password or host, LinkError if what answers is no board.
    """
    with ExitStack() as unless_agreed:
        made = unless_agreed.enter_context(connect(address, "the board"))
        try:
            greeting = _agree(made, address)
        except OSError as error:
            raise LinkError(f"the board at {address}: {error.strerror or error}") from None
        unless_agreed.pop_all()
        return made, greeting


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
    own_words: list[str] = []
    framer, end = Framer(), time.monotonic() + ANSWER_TIME
    while time.monotonic() < end:
        lines, garbage = framer.lines(_read(made, end - time.monotonic(), until=b"\n"))
        for text in lines:
            message = from_board(text)
            if isinstance(message, Ok):
                if _read(made, QUIET_TIME):
                    raise LinkError(f"the board at {address} says more than it was asked")
                return own_words
            if isinstance(message, Trouble):
                raise LinkError(f"the board at {address} reports {text!r}")
            own_words.append(text)
        if garbage is not None or len(own_words) > LONGEST_LINE:
            raise LinkError(f"what answers at {address} is no board of RepRapFirmware")
    raise LinkError(f"the board at {address} does not answer {PROBE}")


def _read(made: socket.socket, seconds: float, until: bytes | None = None) -> bytes:
    """Read for some time, or until a given byte arrives."""
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


# ----------------------------------------------------------------------------------------------------
# The run: the relay on two sockets.

MOST_UNREAD = 4096  # bytes that a side may leave unread before it counts as lost
LINGER_TIME = 1.0  # s for the last words to arrive
LOOK_TIME = 0.25  # s between updates of the progress
INTERRUPTIONS = {  # names of signals → why they end the run
    "SIGINT": "interrupted from the keyboard",
    "SIGTERM": "this program was told to end",
    "SIGHUP": "the terminal was closed",
}


class Requests:
    """Orders from other threads and from signals; they wake the thread that waits on the sockets."""

    def __init__(self) -> None:
        self._orders: deque[Order] = deque()
        self.waker, self._wake = socket.socketpair()
        self.waker.setblocking(False)
        self._wake.setblocking(False)

    def ask(self, order: Order) -> None:
        """Queue an order for the run."""
        self._orders.append(order)
        try:
            self._wake.send(b"!")
        except OSError:
            return  # the run is already awake, or over

    def taken(self) -> list[Order]:
        """The orders queued since the last call."""
        try:
            self.waker.recv(PIECE)
        except BlockingIOError:
            return []
        return [self._orders.popleft() for _ in range(len(self._orders))]

    def close(self) -> None:
        """Close both ends; nobody listens any more."""
        self.waker.close()
        self._wake.close()


@contextmanager
def signals_as(requests: Requests) -> Iterator[None]:
    """Turn Ctrl-C and other termination signals into stop orders, so that nothing is cut off halfway."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signal handlers
        return
    reasons = {getattr(signal, name): why for name, why in INTERRUPTIONS.items() if hasattr(signal, name)}
    before = {
        number: signal.signal(number, lambda n, _: requests.ask(StopOrder(reasons[signal.Signals(n)])))
        for number in reasons
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class RobotHand(Protocol):
    """Stops and starts the robot by other means than the program's socket, without waiting."""

    def stop(self, reason: str) -> None:
        """Stop the robot for good."""

    def pause(self) -> None:
        """Stop the robot so that it can continue."""

    def go_on(self) -> None:
        """Let the robot continue."""


class RelayRun:
    """A relay on its two sockets.

    show  is called with the run's status, a few times a second and whenever its state has changed
    """

    def __init__(
        self,
        relay: Relay,
        sockets: Mapping[RelaySide, socket.socket],
        requests: Requests,
        log: Log,
        robot: RobotHand,
        show: Callable[[RunStatus], None],
    ) -> None:
        self._relay, self._sockets, self._requests, self._log = relay, dict(sockets), requests, log
        self._robot, self._show = robot, show
        self._unsent = {side: bytearray() for side in RelaySide}
        self._lost: deque[tuple[RelaySide, str]] = deque()  # to be reported to the relay
        self._outcome: RunOutcome | None = None
        self._log_works = True
        self._changed = False  # a socket was closed, or has or had unsent bytes

    def run(self) -> RunOutcome:
        """Relay until the run is over, one way or the other; then the sockets are closed."""
        try:
            return self._run()
        finally:
            if self._outcome is None:  # by an error of this program: the machine must not continue without it
                self._abandon()

    def _abandon(self) -> None:
        """Stop both sides without the relay."""
        try:
            self._write_log([LogNote("stop", self._relay.acknowledged, FAILED)])
            self._robot.stop(FAILED)
        finally:
            for side in list(self._sockets):
                self._unsent[side] += self._relay.last_words[side]
                self._part(side)

    def _run(self) -> RunOutcome:
        with selectors.DefaultSelector() as selector:
            for side, made in self._sockets.items():
                made.setblocking(False)
                selector.register(made, selectors.EVENT_READ, side)
            selector.register(self._requests.waker, selectors.EVENT_READ, None)
            shown, state = 0.0, None
            while self._outcome is None:
                patience = min(max(self._relay.deadline - time.monotonic(), 0.0), LOOK_TIME)
                for key, mask in selector.select(patience):
                    self._ready(key.data, mask)
                while self._lost and self._outcome is None:
                    side, reason = self._lost.popleft()
                    self._carry_out(self._relay.lost(side, reason, time.monotonic()))
                self._carry_out(self._relay.tick(time.monotonic()))
                if self._changed:
                    self._watch(selector)
                status = self._relay.status
                if status.state is not state or time.monotonic() >= shown + LOOK_TIME:
                    self._show(status)
                    shown, state = time.monotonic(), status.state
        for side in list(self._sockets):
            self._part(side)
        return self._outcome

    def _ready(self, side: RelaySide | None, mask: int) -> None:
        if self._outcome is not None:
            return
        if side is None:
            for order in self._requests.taken():
                self._carry_out(self._relay.take(order, time.monotonic()))
            return
        if mask & selectors.EVENT_WRITE:
            self._flush(side)
        if mask & selectors.EVENT_READ and side in self._sockets:
            try:
                data = self._sockets[side].recv(PIECE)
            except BlockingIOError:
                return
            except OSError as error:
                self._lose(side, error.strerror or "error")
                return
            if data:
                self._carry_out(self._relay.received(side, data, time.monotonic()))
            else:
                self._lose(side, "closed by the other end")

    def _carry_out(self, effects: list[Effect]) -> None:
        notes = [effect for effect in effects if isinstance(effect, LogNote)]
        if notes:
            self._write_log(notes)  # first, so that nothing happens without a record
        for effect in effects:
            if isinstance(effect, Write):
                self._unsent[effect.side] += effect.data
            elif isinstance(effect, StopRobot):
                self._robot.stop(effect.reason)
            elif isinstance(effect, PauseRobot):
                self._robot.pause()
            elif isinstance(effect, MoveRobot):
                self._robot.go_on()
            elif isinstance(effect, RunOutcome):
                self._outcome = effect
        for side, unsent in self._unsent.items():
            if unsent:
                self._flush(side)

    def _write_log(self, notes: list[LogNote]) -> None:
        if not self._log_works:
            return
        try:
            self._log.write(notes)
        except OSError as error:
            self._log_works = False  # first, as stopping is logged too
            self._requests.ask(StopOrder(f"the log cannot be written: {error.strerror}"))

    def _flush(self, side: RelaySide) -> None:
        unsent = self._unsent[side]
        if side not in self._sockets:
            unsent.clear()
        if not unsent:
            return
        try:
            del unsent[: self._sockets[side].send(unsent)]
            self._changed = self._changed or bool(unsent)
        except BlockingIOError:
            self._changed = True
            if len(unsent) > MOST_UNREAD:
                self._lose(side, "it does not read what it is sent")
        except OSError as error:
            self._lose(side, error.strerror or "error")

    def _lose(self, side: RelaySide, reason: str) -> None:
        if side in self._sockets:
            self._sockets.pop(side).close()
            self._unsent[side].clear()
            self._changed = True
            self._lost.append((side, reason))

    def _watch(self, selector: selectors.BaseSelector) -> None:
        """Select for writing only where bytes are unsent, and unregister closed sockets."""
        for key in list(selector.get_map().values()):
            if key.data is None:
                continue
            if key.data not in self._sockets:
                selector.unregister(key.fileobj)
                continue
            wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._unsent[key.data] else 0)
            if wanted != key.events:
                selector.modify(key.fileobj, wanted, key.data)
        self._changed = any(self._unsent.values())

    def _part(self, side: RelaySide) -> None:
        """Close a connection so that the last words still arrive."""
        with self._sockets.pop(side) as made:
            part(made, self._unsent[side], LINGER_TIME)
