"""The sending side of a stream, without sockets: what to send when, by what the controller has said."""

from __future__ import annotations

import re

from planner.errors import EXIT_NOT_VERIFIED, PlannerError
from planner.link.stream_frames import ALIVE, LENGTH, STOP, Stream, packed

VERSION = 1
LONGEST_LINE = 80  # characters, as RAPID's strings
ALIVE_EVERY = 0.5  # s; the controller stops after 2 s of silence
AT_ONCE = 64  # frames sent before looking at what comes back
PATIENCE = 30.0  # s without a word of the controller, beside its longest move
SLOWEST = 10.0  # times as long as programmed: an operator may lower the speed that far
_WORD = re.compile(r"([BCE]) (0|[1-9][0-9]{0,8}) (0|[1-9][0-9]{0,8})|X (0|[1-9][0-9]{0,8}) (.{1,70})")


class StreamStopped(PlannerError):
    """The stream has ended before its time; says why and after how many moves."""

    exit_code = EXIT_NOT_VERIFIED


class Sender:
    """Hands out frames as far as the controller has room, and one to say that it is there where there are none.

    done, starved   moves handed to the motion, and times the robot waited within a bead (known at the end)
    """

    def __init__(self, stream: Stream, now: float) -> None:
        self.total, self.sent, self.taken, self.done, self.starved = stream.total, 0, 0, 0, 0
        self.finished = False
        self._frames = stream.frames()
        self._patience = PATIENCE + SLOWEST * stream.longest
        self._capacity: int | None = None
        self._partial = b""
        self._said, self._heard = now, now

    def hear(self, data: bytes, now: float) -> None:
        """Take what the controller sent. Raises StreamStopped where it stopped, or says what makes no sense."""
        *whole, self._partial = (self._partial + data).split(b"\n")
        if max(len(each) for each in (*whole, self._partial)) > LONGEST_LINE:
            raise self._stopped("the controller sent a line that is too long")
        for raw in whole:
            self._take(raw.decode("ascii", errors="replace"))
        self._heard = now

    def due(self, now: float) -> bytes:
        """What is to be sent now. Raises StreamStopped where the controller has been silent for too long."""
        if self.finished:
            return b""
        if now - self._heard > self._patience:
            raise self._stopped(f"the controller has said nothing for {self._patience:.0f} s")
        out = b""
        if self._capacity is not None:
            last = min(self.total, self.done + self._capacity, self.sent + AT_ONCE)
            out = b"".join(next(self._frames) for _ in range(last - self.sent))
            self.sent = max(last, self.sent)
        if not out and now - self._said >= ALIVE_EVERY:
            out = packed(self.sent, ALIVE)
        if out:
            self._said = now
        return out

    def stop(self, unsent: bytes) -> bytes:
        """What stops the robot, after what is left unsent of a frame that has partly gone."""
        return unsent[: len(unsent) % LENGTH] + packed(self.sent, STOP)

    def lost(self) -> StreamStopped:
        """The connection has ended."""
        return self._stopped("the connection to the controller is lost")

    def _take(self, text: str) -> None:
        match = _WORD.fullmatch(text)
        if match is None:
            raise self._stopped(f"the controller sent {text[:20]!r}, which means nothing")
        word, one, two, _, reason = match.groups()
        if reason is not None:
            raise self._stopped(f"the controller stopped: {reason}")
        first, second = int(one), int(two)
        if word == "B" and self._capacity is None and first == VERSION and second > 0:
            self._capacity = second
        elif word == "C" and self.taken <= first <= self.sent and self.done <= second <= first:
            self.taken, self.done = first, second
        elif word == "E" and self.sent == self.total and first == self.total - 1:
            self.done, self.starved, self.finished = self.total, second, True
        else:
            raise self._stopped(f"the controller sent {text!r}, which cannot be")

    def _stopped(self, reason: str) -> StreamStopped:
        return StreamStopped(f"{reason}; {self.done} of {self.total} moves were begun")
