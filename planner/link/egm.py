"""Sends a plan's joints to a controller every 4 ms by externally guided motion (EGM), as an alternative to a program.

python -m planner.link.egm OUT_DIR
"""

from __future__ import annotations

import argparse
import socket
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from planner.command import Command, exit_code
from planner.errors import EXIT_VERIFIED, InputError
from planner.link.egm_follow import SILENCE, EgmStopped, Follower, Heard
from planner.link.egm_plan import ARM_AXES, PERIOD, JointPlan, read_plan
from planner.readonly import Array

HOST, PORT = "127.0.0.1", 6510  # ABB's port
JOINING = 120.0  # s in which the controller's first word must come
LONGEST = 4096  # bytes of a datagram
TOLD_EVERY = 0.1  # share of the plan


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = egm_command().parse_args(arguments)

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    return exit_code(lambda: _run(options, say), say, "the robot was brought to rest")


def egm_command() -> Command:
    """The parser of `python -m planner.link.egm`."""
    parser = Command(
        "link.egm",
        "Answer a controller's EGM messages with the joints of a plan, 250 times a second.",
        {"out/my_part --host 192.168.125.2": "wait there for the controller, then guide it"},
        {0: "finished", 2: "wrong input", 3: "stopped before the end", 130: "interrupted"},
    )
    parser.add_argument("folder", type=Path, metavar="OUT_DIR", help="results of planner.solve")
    parser.add_argument("--host", default=HOST, help=f"own address that the controller sends to (default {HOST})")
    parser.add_argument("--port", type=int, default=PORT, help=f"own UDP port (default {PORT})")
    return parser


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    messages = egm_messages()
    plan = read_plan(options.folder)
    with listening(options.host, options.port) as here:
        say(f"waiting for the controller on {options.host}:{here.getsockname()[1]} (UDP)")
        follow(plan, here, messages, say)
    say("finished")
    return EXIT_VERIFIED


def egm_messages() -> ModuleType:
    """ABB's messages. Raises InputError where the package that has them is missing."""
    try:
        from abb_robot_client._egm_protobuf import egm_pb2
    except ImportError as error:
        raise InputError("EGM needs the package abb_robot_client", hint="pip install beadwise[link]") from error
    return egm_pb2


def listening(host: str, port: int) -> socket.socket:
    """A UDP socket at an address. Raises InputError where that cannot be had."""
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        out.bind((host, port))
    except (OSError, OverflowError) as error:
        out.close()
        raise InputError(f"cannot listen on {host}:{port}: {error}", field="--port") from error
    return out


def follow(plan: JointPlan, here: socket.socket, messages: ModuleType, say: Callable[[str], None]) -> Follower:
    """Guide the robot through the plan. Raises EgmStopped where it ended before; an interrupt brings it to rest."""
    follower = Follower(plan)
    try:
        _loop(follower, here, messages, say)
    except KeyboardInterrupt:
        follower.stop()
        _loop(follower, here, messages, lambda text: None)
        raise
    return follower


def _loop(follower: Follower, here: socket.socket, messages: ModuleType, say: Callable[[str], None]) -> None:
    numbers, told = 0, 0.0
    peer: tuple[str, int] | None = None
    began = heard_at = time.monotonic()
    while not follower.over:
        data, peer = _newest(here, peer)
        now = time.monotonic()
        if not data:
            limit = SILENCE if follower.begun else JOINING
            if now - heard_at > limit:
                raise EgmStopped(f"the controller has said nothing for {limit:g} s")
            continue
        heard_at = now
        reference = follower.answer(heard(data, messages))
        if reference is None:
            if now - began > JOINING:
                raise EgmStopped(f"the controller did not run within {JOINING:g} s")
            continue
        numbers += 1
        if peer is not None:
            here.sendto(correction(reference, numbers, messages), peer)
        if follower.sample >= told * (follower.total - 1):
            say(f"{follower.sample * PERIOD:.1f} s of {(follower.total - 1) * PERIOD:.1f} s")
            told = follower.sample / (follower.total - 1) + TOLD_EVERY


def _newest(here: socket.socket, peer: tuple[str, int] | None) -> tuple[bytes, tuple[str, int] | None]:
    """The newest datagram of the controller, which is whoever spoke first; empty where none comes for a while."""
    newest = b""
    here.settimeout(0.05)
    try:
        while True:
            data, address = here.recvfrom(LONGEST)
            peer = peer or address
            if address == peer:
                newest = data
            here.settimeout(0.0)
    except (TimeoutError, BlockingIOError):
        return newest, peer
    except ConnectionError:  # the other side's port was closed: Linux tells by an error of the next call
        return newest, peer


def heard(data: bytes, messages: ModuleType) -> Heard:
    """A controller's message. Raises EgmStopped for what is none."""
    from google.protobuf.message import DecodeError

    message = messages.EgmRobot()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise EgmStopped("the controller sent what is no EGM message") from error
    joints = [*message.feedBack.joints.joints, *message.feedBack.externalJoints.joints]
    running = (
        message.mciState.state == messages.EgmMCIState.MCI_RUNNING
        and message.motorState.state == messages.EgmMotorState.MOTORS_ON
        and message.rapidExecState.state == messages.EgmRapidCtrlExecState.RAPID_RUNNING
    )
    return Heard(np.radians(np.array(joints, np.float64)), running, 1e-3 * message.header.tm)


def correction(reference: Array, number: int, messages: ModuleType) -> bytes:
    """The message that carries a reference [rad]."""
    message = messages.EgmSensor()
    message.header.seqno = number
    message.header.tm = int(time.monotonic() * 1e3) & 0xFFFFFFFF
    message.header.mtype = messages.EgmHeader.MSGTYPE_CORRECTION
    degrees = np.degrees(reference).tolist()
    message.planned.joints.joints.extend(degrees[:ARM_AXES])
    message.planned.externalJoints.joints.extend(degrees[ARM_AXES:])
    return bytes(message.SerializeToString())


if __name__ == "__main__":
    sys.exit(main())
