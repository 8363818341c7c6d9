"""Sends lines to the extruder's board in time with a motion from this computer: for streaming and guided motion."""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from planner.base.errors import EXIT_NOT_VERIFIED, PlannerError
from planner.link.connections import PIECE, Address, part
from planner.link.messages import Framer, Jam, Ok, Resend, Trouble, from_board, to_board, to_board_plain
from planner.link.relay import MOST_RESENDS, SAFE, Patience, safe_behind
from planner.link.run import LINGER_TIME, open_board

# ----------------------------------------------------------------------------------------------------
# The feed, without sockets: bytes and times in, bytes out.


class FeedStopped(PlannerError):
    """The board does not continue; states why."""

    exit_code = EXIT_NOT_VERIFIED


class Feed:
    """Hands lines to a board one at a time, in order, numbered and with a checksum, as the relay does (see `relay`).

    sent, acknowledged   lines so far
    safe                 lines that make the board safe after those that were added
    """

    def __init__(self) -> None:
        self.sent = self.acknowledged = 0
        self.safe: tuple[str, ...] = SAFE
        self._waiting: deque[str] = deque()
        self._framer, self._patience = Framer(), Patience()
        self._under_way, self._resends, self._deadline = "", 0, 0.0

    @property
    def behind(self) -> int:
        """The number of lines that the board has not acknowledged."""
        return len(self._waiting) + bool(self._under_way)

    def add(self, gcode: str) -> None:
        """Queue a line that is due."""
        self._waiting.append(gcode)
        self.safe = tuple(dict.fromkeys(self.safe + safe_behind([gcode])))

    def received(self, data: bytes) -> bytes:
        """Take bytes from the board; returns what to resend. Raises FeedStopped for errors and unexpected answers."""
        out = b""
        lines, garbage = self._framer.lines(data)
        for text in lines:
            message = from_board(text)
            if isinstance(message, Trouble | Jam):  # there is nobody to clear a jam
                raise FeedStopped(f"the board reports {text!r} at line {self.sent}")
            if isinstance(message, Resend):
                out += self._again(message.n)
            elif isinstance(message, Ok):
                self._acknowledge(message.n)
        if garbage is not None:
            raise FeedStopped(f"the board sent {garbage}")
        return out

    def due(self, now: float) -> bytes:
        """What to send at a time [s] of a monotonic clock. Raises FeedStopped if an acknowledgement is late."""
        if self._under_way:
            if now > self._deadline:
                raise FeedStopped(f"the board did not acknowledge line {self.sent} in time")
            return b""
        if not self._waiting:
            return b""
        self._under_way = self._waiting.popleft()
        self.sent += 1
        self._deadline = now + self._patience.of(self._under_way)
        return to_board(self.sent, self._under_way)

    def _acknowledge(self, n: int | None) -> None:
        if not self._under_way or n not in (None, self.sent) or (n is None and self._resends):
            raise FeedStopped(f"the board acknowledged {'a line' if n is None else f'line {n}'}, which was not due")
        self._under_way, self._resends = "", 0
        self.acknowledged = self.sent

    def _again(self, n: int) -> bytes:
        self._resends += 1
        if not self._under_way or n != self.sent or self._resends > MOST_RESENDS:
            raise FeedStopped(f"the board asked for line {n} again")
        return to_board(n, self._under_way)


# ----------------------------------------------------------------------------------------------------
# On a socket.


class BoardFeed:
    """A feed on its board's connection. Call `step` often; it never waits."""

    def __init__(self, connection: socket.socket) -> None:
        self.feed = Feed()
        self._connection, self._unsent = connection, b""
        connection.setblocking(False)

    def step(self) -> None:
        """Read what has arrived, and send what is due. Raises FeedStopped."""
        try:
            while data := self._connection.recv(PIECE):
                self._unsent += self.feed.received(data)
            raise FeedStopped("the board closed the connection")
        except BlockingIOError:
            pass
        except OSError as error:
            raise FeedStopped(f"the board's connection was lost ({error.strerror or error})") from error
        self._unsent += self.feed.due(time.monotonic())
        if self._unsent:
            try:
                self._unsent = self._unsent[self._connection.send(self._unsent) :]
            except BlockingIOError:
                return
            except OSError as error:
                raise FeedStopped(f"the board's connection was lost ({error.strerror or error})") from error

    def finish(self) -> None:
        """Wait until the board has taken all lines. Raises FeedStopped."""
        while self.feed.behind or self._unsent:
            self.step()
            time.sleep(0.001)

    def make_safe(self) -> None:
        """End the feed: outputs off, including the cutter's; moves that the board has already taken are completed."""
        last_words = b"".join(to_board_plain(gcode) for gcode in self.feed.safe)
        part(self._connection, self._unsent + last_words, LINGER_TIME)


@contextmanager
def feeding(address: Address) -> Iterator[BoardFeed]:
    """A feed for the board at an address; an exception in the block makes the board safe.

    Raises InputError for a wrong password or host, LinkError if what answers is no board.
    """
    connection, _ = open_board(address)
    with connection:
        feed = BoardFeed(connection)
        with ExitStack() as unless_done:
            unless_done.callback(feed.make_safe)
            yield feed
            unless_done.pop_all()
