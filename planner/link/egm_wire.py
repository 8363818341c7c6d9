"""Datagrams of externally guided motion: states from one controller, whoever else sends, and references to it."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.extras import missing_extra

ARM_AXES = 6
LONGEST = 4096  # bytes of a datagram
MOST_AT_ONCE = 100  # datagrams read in one go, so that a flood does not hold up the motion
WAIT = 0.05  # s for a datagram
REORDERED = 1000  # sequence numbers by which a late message may lag; one further back starts a new motion


@dataclass(frozen=True)
class EgmState:
    """A message from the controller: joints (m) [rad] in the plan's order, whether it runs, its clock [s]."""

    joints: Array
    running: bool
    clock: float


def egm_messages() -> ModuleType:
    """ABB's message definitions. Raises InputError if their package is missing."""
    try:
        from abb_robot_client._egm_protobuf import egm_pb2
    except ImportError as error:
        raise missing_extra(error, "EGM") or error from None
    return egm_pb2


class EgmWire:
    """A UDP socket that listens to one controller: the first to send a valid message, from `only` if that is given.

    Datagrams from others, invalid messages, and messages overtaken on their way are dropped.
    remarks   what was dropped, in words, each kind once; to be taken by the caller
    """

    def __init__(self, here: socket.socket, messages: ModuleType, only: str | None = None) -> None:
        """here: a bound socket; only: the controller's numeric address."""
        self._here, self._messages, self._only = here, messages, only
        self._peer: tuple[str, int] | None = None
        self._number = self._sent = 0  # of the last message, of the last reference
        self._told: set[str] = set()
        self.remarks: list[str] = []

    @property
    def port(self) -> int:
        """The local port."""
        return int(self._here.getsockname()[1])

    def newest(self) -> EgmState | None:
        """The controller's newest message; None if none comes for a while."""
        found = None
        for data, address in self._datagrams():
            if address[0] != (self._only or address[0]) or address != (self._peer or address):
                self._remark("datagrams from {} are ignored: it is not the controller", address)
                continue
            state = self._state(data)
            if state is None:
                self._remark("{} sent something that is not an EGM message of a controller", address)
                continue
            self._peer, found = address, state[0] or found
        return found

    def release(self) -> None:
        """Forget the controller, which is gone; the next one may be another."""
        self._peer, self._number = None, 0

    def send(self, reference: Array) -> None:
        """Send a reference (m) [rad] to the controller."""
        if self._peer is None:
            return
        self._sent += 1
        try:
            self._here.sendto(self._correction(reference), self._peer)
        except ConnectionError:
            return  # its port is closed: its silence will be noticed

    def _datagrams(self) -> Iterator[tuple[bytes, tuple[str, int]]]:
        self._here.settimeout(WAIT)
        try:
            for _ in range(MOST_AT_ONCE):
                yield self._here.recvfrom(LONGEST)
                self._here.settimeout(0.0)
        except (TimeoutError, BlockingIOError):
            return
        except ConnectionError:  # the other side's port was closed: Linux reports it by an error of the next call
            return

    def _state(self, data: bytes) -> tuple[EgmState | None] | None:
        """A controller's message, with None as its state if it was overtaken; None for any other datagram."""
        from google.protobuf.message import DecodeError

        m = self._messages
        message = m.EgmRobot()
        try:
            message.ParseFromString(data)
        except DecodeError:
            return None
        joints = [*message.feedBack.joints.joints, *message.feedBack.externalJoints.joints]
        # messages to a controller have joints in the same fields
        if not joints or message.header.mtype not in (m.EgmHeader.MSGTYPE_DATA, m.EgmHeader.MSGTYPE_UNDEFINED):
            return None
        number = message.header.seqno
        if 0 < self._number - number < REORDERED:
            return (None,)
        self._number = number
        running = (
            message.mciState.state == m.EgmMCIState.MCI_RUNNING
            and message.motorState.state == m.EgmMotorState.MOTORS_ON
            and message.rapidExecState.state == m.EgmRapidCtrlExecState.RAPID_RUNNING
        )
        return (EgmState(np.radians(np.array(joints, np.float64)), running, 1e-3 * message.header.tm),)

    def _correction(self, reference: Array) -> bytes:
        message = self._messages.EgmSensor()
        message.header.seqno = self._sent
        message.header.tm = int(time.monotonic() * 1e3) & 0xFFFFFFFF
        message.header.mtype = self._messages.EgmHeader.MSGTYPE_CORRECTION
        degrees = np.degrees(reference).tolist()
        message.planned.joints.joints.extend(degrees[:ARM_AXES])
        message.planned.externalJoints.joints.extend(degrees[ARM_AXES:])
        return bytes(message.SerializeToString())

    def _remark(self, words: str, address: tuple[str, int]) -> None:
        if words not in self._told:
            self._told.add(words)
            self.remarks.append(words.format(f"{address[0]}:{address[1]}"))


@contextmanager
def egm_wire(host: str, port: int, only: str | None = None) -> Iterator[EgmWire]:
    """A wire at a local address, to the controller at the host `only` or to any.

    Raises InputError if the address cannot be bound, for an unknown host, and if ABB's messages are missing.
    """
    messages = egm_messages()
    try:
        known = None if only is None else socket.gethostbyname(only)
    except (OSError, UnicodeError) as error:
        raise InputError(f"there is no host {only}", field="--controller") from error
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        try:
            here.bind((host, port))
        except (OSError, OverflowError) as error:
            raise InputError(f"cannot listen on {host}:{port}: {error}", field="--port") from error
        yield EgmWire(here, messages, known)
