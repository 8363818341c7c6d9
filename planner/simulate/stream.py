"""The controller's side of a stream of moves: takes frames into a bounded buffer and runs them in real time.

The protocol is documented in planner/link/BeadwiseStream.mod; this is a second, independent implementation.
"""

from __future__ import annotations

import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array
from planner.simulate.board import Fault, Faults
from planner.simulate.servers import bound_socket

VERSION = 3
ANY_PLAN = "any"  # in place of the checksum of a module's plan, as no robot is moved
FRAME = 116  # bytes
MESSAGE = 8  # frames read at once: RAPID's rawbytes hold 1024 bytes
CAPACITY = 256  # frames
SILENCE = 2.0  # s
STARVING = 0.5  # s: longest wait for moves within a bead
AHEAD = 4  # moves handed to the motion beyond the current one
LOOK = 0.005  # s
_FIELDS = struct.Struct("<I4B3f4f4b6f4f2fH2x3f2f")


class StreamEnded(Exception):
    """The stream cannot continue; states why."""


@dataclass(frozen=True)
class Frame:
    """A frame as received. numbers: place, orientation, axes, speeds, wait, zone (19), in the frame's own units.

    via: intermediate point of an arc; flow: from the start of the move, and from its end
    """

    number: int
    kind: int
    flags: int
    tool: int
    numbers: tuple[float, ...]
    conf: tuple[int, ...]
    left: int
    via: tuple[float, ...]
    flow: tuple[float, float]


@dataclass(frozen=True)
class StreamState:
    """State of a stream: frames, moves done, greatest fill, waits within beads, motion time [s], and why it ended."""

    frames: tuple[Frame, ...] = ()
    done: int = 0
    fullest: int = 0
    starved: int = 0
    moved: float = 0.0
    reason: str = ""


def frame_of(data: bytes) -> Frame:
    """Parse a frame. Raises StreamEnded for a wrong checksum."""
    words = np.frombuffer(data, "<u2").astype(np.int64)
    body, sums = words[:-2], words[-2:]
    running = np.cumsum(body)
    # the second checksum adds running sums that are themselves modulo 65535
    if running[-1] % 65535 != sums[0] or int(np.sum(running % 65535)) % 65535 != sums[1]:
        raise StreamEnded("wrong checksum")
    number, kind, flags, tool, _, *rest = _FIELDS.unpack(data[:-4])
    numbers, conf, left = (*rest[:7], *rest[11:23]), tuple(rest[7:11]), rest[23]
    return Frame(number, kind, flags, tool, numbers, conf, left, tuple(rest[24:27]), (rest[27], rest[28]))


class Buffer:
    """The server without its network: frames in, moves out, in program time."""

    def __init__(self, capacity: int = CAPACITY, pace: float = 1.0) -> None:
        self.state = StreamState()
        self._capacity, self._pace = capacity, pace
        self._held: deque[Frame] = deque()
        self._frames: list[Frame] = []
        self._running: deque[float] = deque()  # ends of moves handed to the motion
        self._free, self._resting = 0.0, True
        self._last: Array | None = None
        self._hungry_since: float | None = None
        self.finished = False

    def take(self, frame: Frame) -> None:
        """Take one frame. Raises StreamEnded for a stop, and for an unexpected frame."""
        if frame.kind == 6:
            return
        if frame.kind == 5:
            raise StreamEnded("the PC asked for it")
        if frame.number != len(self._frames) + 1 or frame.kind not in (1, 2, 3, 4, 7) or frame.tool > 7:
            raise StreamEnded("a frame out of order")
        if len(self._held) >= self._capacity:
            raise StreamEnded("more frames than fit")
        self._frames.append(frame)
        self._held.append(frame)
        self.state = replace(self.state, fullest=max(self.state.fullest, len(self._held)))

    @property
    def taken(self) -> int:
        """Number of frames received so far."""
        return len(self._frames)

    def advance(self, now: float) -> bool:
        """Hand over moves possible by now [wall s]; returns whether there were any. Raises StreamEnded if starved."""
        handed = False
        while not self.finished and self._may_hand(now):
            self._hand(self._held.popleft(), now)
            handed = True
        return handed

    def record(self) -> StreamState:
        """The state, with all frames."""
        return replace(self.state, frames=tuple(self._frames))

    def _may_hand(self, now: float) -> bool:
        while self._running and self._running[0] <= now:
            self._running.popleft()
        if not self._held:
            if not self._resting and not self._running:
                if self._hungry_since is None:
                    self._hungry_since = now
                    self.state = replace(self.state, starved=self.state.starved + 1)
                elif now - self._hungry_since > STARVING:
                    raise StreamEnded("no frames within a bead")
            return False
        self._hungry_since = None
        if len(self._running) > AHEAD or (self._resting and self._running):
            return False
        first = self._held[0]
        return not self._resting or len(self._held) >= min(first.left, self._capacity)

    def _hand(self, frame: Frame, now: float) -> None:
        if frame.kind == 4:
            self.finished = True
            return
        lasts = self._lasts(frame)
        self._free = max(self._free, now) + lasts / self._pace
        self._running.append(self._free)
        self._resting = frame.numbers[18] == 0.0
        self.state = replace(self.state, done=self.state.done + 1, moved=self.state.moved + lasts)

    def _lasts(self, frame: Frame) -> float:
        """Time of a move and its wait [s] at its speeds; the first target after a joint frame is where that leads.

        Frames do not state which axes slide: they take the lesser of both times.
        """
        new = None if frame.kind == 3 else np.array(frame.numbers)
        old, self._last = self._last, new
        if old is None or new is None:
            return frame.numbers[17]
        tip, turning, sliding, rotating = new[13:17]
        angle = np.degrees(2.0 * np.arccos(min(1.0, abs(float(old[3:7] @ new[3:7])))))
        axes = float(np.abs(old[7:13] - new[7:13]).max()) / max(sliding, rotating)
        step = float(np.linalg.norm(new[:3] - old[:3]))
        if frame.kind == 7:
            step = _arc_length(old[:3], np.array(frame.via), new[:3])
        return max(step / tip, angle / turning, axes) + frame.numbers[17]


def _arc_length(start: Array, via: Array, end: Array) -> float:
    """Length of the arc through three points, from its inscribed angle."""
    a, b, chord = via - start, end - via, end - start
    sine = float(np.linalg.norm(np.cross(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b)))
    turned = float(np.arctan2(sine, float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))))
    return float(np.linalg.norm(chord)) * (turned / sine if sine > 1e-9 else 1.0)


class StreamServer:
    """A buffer on TCP, in a separate thread, for one stream.

    latency   delay of its messages [wall s]
    reading   time to read a message [wall s], in which it does nothing else; at_most: frames per message
    """

    def __init__(
        self,
        host: str,
        port: int,
        pace: float = 1.0,
        faults: Sequence[Fault] = (),
        capacity: int = CAPACITY,
        latency: float = 0.0,
        reading: float = 0.0,
        at_most: int = MESSAGE,
    ) -> None:
        self._buffer, self._capacity, self._faults = Buffer(capacity, pace), capacity, Faults(faults)
        self._latency, self._reading, self._at_most = latency, reading, at_most
        self._words: deque[tuple[float, bytes]] = deque()
        self._lock, self._ending, self._mute = threading.Lock(), threading.Event(), False
        self._listener = bound_socket(host, port)
        self._listener.listen(1)
        self.address: tuple[str, int] = self._listener.getsockname()
        self._thread = threading.Thread(target=self._serve, name="stream", daemon=True)
        self._thread.start()

    def state(self) -> StreamState:
        """State of the stream."""
        with self._lock:
            return self._buffer.record()

    def close(self) -> None:
        """End the thread and close all sockets."""
        self._ending.set()
        self._thread.join()

    def _serve(self) -> None:
        connection = self._accepted()
        if connection is None:
            return
        with connection:
            reason = ""
            try:
                self._run(connection)
                self._say(f"E {self._buffer.state.done} {self._buffer.state.starved}")
                reason = "finished"
            except StreamEnded as stopped:
                reason = str(stopped)
                self._say(f"X {self._buffer.state.done} {reason}")
            with self._lock:
                self._buffer.state = replace(self._buffer.state, reason=reason)
            time.sleep(self._latency)
            self._flush(connection)

    def _accepted(self) -> socket.socket | None:
        with self._listener:
            self._listener.settimeout(LOOK * 4)
            while not self._ending.is_set():
                try:
                    connection = self._listener.accept()[0]
                except TimeoutError:
                    continue
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                connection.settimeout(1.0)
                return connection
        return None

    def _run(self, connection: socket.socket) -> None:
        partial, received_at = b"", time.monotonic()
        self._say(f"B {VERSION} {self._capacity} {ANY_PLAN}")
        with selectors.DefaultSelector() as selector:
            selector.register(connection, selectors.EVENT_READ)
            while not self._buffer.finished:
                if self._ending.is_set():
                    raise StreamEnded("ended at the controller")
                if selector.select(LOOK):
                    try:
                        data = connection.recv(self._at_most * FRAME - len(partial))
                    except OSError as error:
                        raise StreamEnded("connection lost") from error
                    if not data:
                        raise StreamEnded("connection lost")
                    time.sleep(self._reading)
                    partial, received_at = self._take(partial + data), time.monotonic()
                if time.monotonic() - received_at > SILENCE:
                    raise StreamEnded("silence of the PC")
                with self._lock:
                    handed = self._buffer.advance(time.monotonic())
                if handed and not self._buffer.finished:
                    self._credit()
                self._flush(connection)

    def _take(self, data: bytes) -> bytes:
        """Take all whole frames; returns the bytes left over."""
        whole = len(data) // FRAME * FRAME
        before = self._buffer.taken
        with self._lock:
            for k in range(0, whole, FRAME):
                self._buffer.take(frame_of(data[k : k + FRAME]))
        for number in range(before + 1, self._buffer.taken + 1):
            self._fault(number)
        if whole:
            self._credit()
        return data[whole:]

    def _fault(self, number: int) -> None:
        if self._faults.take("stop", number):
            raise StreamEnded("stopped at the controller")
        if self._faults.take("drop", number):
            self._mute = True
            raise StreamEnded("connection lost")
        if self._faults.take("mute", number):
            self._mute = True
        if self._faults.take("garbage", number):
            self._words.append((time.monotonic() + self._latency, b"C \xff\xfe 12\n"))

    def _credit(self) -> None:
        self._say(f"C {self._buffer.taken} {self._buffer.state.done}")

    def _say(self, text: str) -> None:
        if not self._mute:
            self._words.append((time.monotonic() + self._latency, text.encode() + b"\n"))

    def _flush(self, connection: socket.socket) -> None:
        """Send the messages that are due."""
        try:
            while self._words and self._words[0][0] <= time.monotonic():
                connection.sendall(self._words.popleft()[1])
        except OSError:
            self._words.clear()
