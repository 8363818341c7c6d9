"""Runs the relay's core on two sockets: reads, writes, keeps time, logs, and carries out what the core wants."""

from __future__ import annotations

import selectors
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from planner.link.effects import Effect, Note, Outcome, Side, StopRobot, Write
from planner.link.log import Log
from planner.link.relay import FAILED, Relay
from planner.link.sockets import PIECE

MOST_UNREAD = 4096  # bytes that a side may leave unread before it counts as lost
LINGER_TIME = 1.0  # s that the last words have to arrive
LOOK_TIME = 0.25  # s between looks at the progress
INTERRUPTED = "interrupted from the keyboard"


class Requests:
    """Reasons to stop that come from other threads and from signals; they wake whoever waits for the sockets."""

    def __init__(self) -> None:
        self._reasons: deque[str] = deque()
        self.waker, self._wake = socket.socketpair()
        self.waker.setblocking(False)
        self._wake.setblocking(False)

    def ask(self, reason: str) -> None:
        """The run is to be stopped."""
        self._reasons.append(reason)
        try:
            self._wake.send(b"!")
        except OSError:
            return  # it is awake, or over

    def taken(self) -> list[str]:
        """What was asked for since."""
        try:
            self.waker.recv(PIECE)
        except BlockingIOError:
            return []
        return [self._reasons.popleft() for _ in range(len(self._reasons))]

    def close(self) -> None:
        """Nobody listens any more."""
        self.waker.close()
        self._wake.close()


@contextmanager
def signals_as(requests: Requests) -> Iterator[None]:
    """Ctrl-C, and what else asks this program to end, become requests to stop, so that nothing is cut off halfway."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set signal handlers
        return
    reasons = {signal.SIGINT: INTERRUPTED, signal.SIGTERM: "this program was told to end"}
    if hasattr(signal, "SIGHUP"):
        reasons[signal.SIGHUP] = "the terminal was closed"
    before = {
        number: signal.signal(number, lambda n, _: requests.ask(reasons[signal.Signals(n)])) for number in reasons
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_relay(
    relay: Relay,
    sockets: Mapping[Side, socket.socket],
    requests: Requests,
    log: Log,
    stop_robot: Callable[[str], None],
    show: Callable[[int], None],
) -> Outcome:
    """Relay until the run is over, one way or the other; the sockets are closed then.

    stop_robot  stops the robot on another way than the program's socket, without waiting for it
    show        is told the last line that was acknowledged, a few times a second
    """
    return _Runner(relay, sockets, requests, log, stop_robot, show).run()


class _Runner:
    def __init__(
        self,
        relay: Relay,
        sockets: Mapping[Side, socket.socket],
        requests: Requests,
        log: Log,
        stop_robot: Callable[[str], None],
        show: Callable[[int], None],
    ) -> None:
        self._relay, self._sockets, self._requests, self._log = relay, dict(sockets), requests, log
        self._stop_robot, self._show = stop_robot, show
        self._unsent = {side: bytearray() for side in Side}
        self._lost: deque[tuple[Side, str]] = deque()  # to be told to the relay
        self._outcome: Outcome | None = None
        self._log_works = True
        self._changed = False  # a socket is closed, or has or had no room for what is to be sent

    def run(self) -> Outcome:
        try:
            return self._run()
        finally:
            if self._outcome is None:  # by a mistake of this program's own: the machine must not go on without it
                self._abandon()

    def _abandon(self) -> None:
        """Stop both sides without the relay."""
        try:
            self._write_log([Note("stop", self._relay.acknowledged, FAILED)])
            self._stop_robot(FAILED)
        finally:
            for side in list(self._sockets):
                self._unsent[side] += self._relay.last_words[side]
                self._part(side)

    def _run(self) -> Outcome:
        with selectors.DefaultSelector() as selector:
            for side, made in self._sockets.items():
                made.setblocking(False)
                selector.register(made, selectors.EVENT_READ, side)
            selector.register(self._requests.waker, selectors.EVENT_READ, None)
            shown = 0.0
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
                if time.monotonic() >= shown + LOOK_TIME:
                    self._show(self._relay.acknowledged)
                    shown = time.monotonic()
        self._show(self._relay.acknowledged)
        for side in list(self._sockets):
            self._part(side)
        return self._outcome

    def _ready(self, side: Side | None, mask: int) -> None:
        if self._outcome is not None:
            return
        if side is None:
            for reason in self._requests.taken():
                self._carry_out(self._relay.stop(reason, time.monotonic()))
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
        notes = [effect for effect in effects if isinstance(effect, Note)]
        if notes:
            self._write_log(notes)  # before it happens, so that nothing happens without a record
        for effect in effects:
            if isinstance(effect, Write):
                self._unsent[effect.side] += effect.data
            elif isinstance(effect, StopRobot):
                self._stop_robot(effect.reason)
            elif isinstance(effect, Outcome):
                self._outcome = effect
        for side, unsent in self._unsent.items():
            if unsent:
                self._flush(side)

    def _write_log(self, notes: list[Note]) -> None:
        if not self._log_works:
            return
        try:
            self._log.write(notes)
        except OSError as error:
            self._log_works = False  # first, for stopping is noted, too
            self._requests.ask(f"the log cannot be written: {error.strerror}")

    def _flush(self, side: Side) -> None:
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

    def _lose(self, side: Side, reason: str) -> None:
        if side in self._sockets:
            self._sockets.pop(side).close()
            self._unsent[side].clear()
            self._changed = True
            self._lost.append((side, reason))

    def _watch(self, selector: selectors.BaseSelector) -> None:
        """Look out for room to write only where something waits to be written, and forget closed sockets."""
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

    def _part(self, side: Side) -> None:
        """Close a connection so that the last words still arrive: what is unread would take them with it."""
        made, end = self._sockets.pop(side), time.monotonic() + LINGER_TIME
        with made:
            try:
                made.settimeout(LINGER_TIME)
                made.sendall(self._unsent[side])
                made.shutdown(socket.SHUT_WR)
                while (left := end - time.monotonic()) > 0.0:
                    made.settimeout(left)
                    if not made.recv(PIECE):
                        return
            except OSError:
                return  # it is gone already
