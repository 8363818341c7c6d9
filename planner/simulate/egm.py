"""The controller's side of externally guided motion: sends its posture every 4 ms, and follows references with a lag."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.extras import missing_extra
from planner.simulate.board import Fault, Faults

PERIOD = 0.004  # s
TIME_CONSTANT = 0.03  # s of the first-order lag with which the robot follows
ARM_AXES = 6
UNANSWERED = 0.5  # wall s without a reference, after which the motion ends
LONGEST = 4096  # bytes of a datagram
MOST_AT_ONCE = 100  # datagrams read between two messages
GARBAGE = b"\xff\xfe\x00 no message"


class EgmRobot:
    """A guided robot, in a separate thread: a client of the given UDP address.

    start [deg]   joints it starts at: the arm's six axes, then the station's
    pace          factor by which it sends more often than every 4 ms; its own clock still advances by 4 ms
    """

    def __init__(
        self, address: tuple[str, int], start: Sequence[float], pace: float = 1.0, faults: Sequence[Fault] = ()
    ) -> None:
        self._messages = _egm_messages()
        self._address, self._pace, self._faults = _resolved(address), pace, Faults(faults)
        self._joints, self._goal = np.array(start, np.float64), np.array(start, np.float64)
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._references: list[Array] = []
        self._stray, self._running, self.reason = 0.0, True, ""
        self._late = 0.0  # ms by which its clock has advanced without messages
        self._thread = threading.Thread(target=self._run, name="egm", daemon=True)
        self._thread.start()

    def joints(self) -> Array:
        """Present joints (m) [deg]."""
        with self._lock:
            return self._joints.copy()

    def references(self) -> Array:
        """All received references (n, m) [deg]."""
        with self._lock:
            return np.array(self._references)

    def close(self) -> None:
        """End the thread and close the socket."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        began = answered = time.monotonic()
        number = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
            here.settimeout(PERIOD)
            while not self._ending.is_set() and time.monotonic() - answered < UNANSWERED:
                number += 1
                if self._fault(number):
                    return
                garbage = self._faults.take("garbage", number)
                try:
                    here.sendto(GARBAGE if garbage else self._message(number), self._address)
                except OSError as error:
                    self.reason = f"nothing can be sent to {self._address[0]}:{self._address[1]}: {error.strerror}"
                    return
                due = began + number * PERIOD / self._pace
                if self._receive(here, due) or not self._references:  # it waits for its partner's first one
                    answered = time.monotonic()
                self._move()
                time.sleep(max(0.0, due - time.monotonic()))
        self.reason = self.reason or ("ended" if self._ending.is_set() else "no references")

    def _fault(self, number: int) -> bool:
        """Apply faults due before a message; returns whether the motion ends."""
        if self._faults.take("mute", number):
            self.reason = "mute"
            return True
        if self._faults.take("stop", number):
            self._running = False
        stray, gap = self._faults.take("stray", number), self._faults.take("gap", number)
        self._stray = stray.value if stray else self._stray
        if gap:
            time.sleep(0.01 * gap.value)
            self._late += gap.value * 10
        return False

    def _message(self, number: int) -> bytes:
        m = self._messages
        message = m.EgmRobot()
        message.header.seqno = number
        message.header.tm = int(number * PERIOD * 1e3 + self._late)
        message.header.mtype = m.EgmHeader.MSGTYPE_DATA
        joints = self._joints.tolist()
        joints[0] += self._stray
        message.feedBack.joints.joints.extend(joints[:ARM_AXES])
        message.feedBack.externalJoints.joints.extend(joints[ARM_AXES:])
        message.motorState.state = m.EgmMotorState.MOTORS_ON
        message.mciState.state = m.EgmMCIState.MCI_RUNNING if self._running else m.EgmMCIState.MCI_STOPPED
        states = m.EgmRapidCtrlExecState
        message.rapidExecState.state = states.RAPID_RUNNING if self._running else states.RAPID_STOPPED
        return bytes(message.SerializeToString())

    def _receive(self, here: socket.socket, due: float) -> bool:
        """Take the partner's first reference before the next message is due; all other datagrams are dropped."""
        from google.protobuf.message import DecodeError

        for _ in range(MOST_AT_ONCE):
            here.settimeout(max(1e-4, due - time.monotonic()))
            try:
                data, address = here.recvfrom(LONGEST)
            except OSError:  # nothing came, or nobody is there
                return False
            if address != self._address:
                continue
            message = self._messages.EgmSensor()
            try:
                message.ParseFromString(data)
            except DecodeError:
                continue
            goal = [*message.planned.joints.joints, *message.planned.externalJoints.joints]
            if len(goal) == len(self._joints) and all(math.isfinite(value) for value in goal):
                with self._lock:
                    self._goal = np.array(goal)
                    self._references.append(self._goal)
                return True
        return False

    def _move(self) -> None:
        if self._running:
            with self._lock:
                self._joints += (1.0 - math.exp(-PERIOD / TIME_CONSTANT)) * (self._goal - self._joints)


def _resolved(address: tuple[str, int]) -> tuple[str, int]:
    """The address with a numeric host. Raises InputError for an unknown host."""
    try:
        return socket.gethostbyname(address[0]), address[1]
    except OSError as error:
        raise InputError(f"there is no host {address[0]}", field="--host", hint=error.strerror) from error


def _egm_messages() -> ModuleType:
    try:
        from abb_robot_client._egm_protobuf import egm_pb2
    except ImportError as error:
        raise missing_extra(error, "EGM") or error from None
    return egm_pb2
