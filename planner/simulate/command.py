"""The command line of the simulators.

python -m planner.simulate controller|board|stream|egm
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

from planner.base.command_line import NEGATIVE, Command, exit_code
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.cell.cell import build_cell
from planner.export.program import RobotProgram
from planner.problem import load_problem
from planner.simulate.board import BOARD_FAULTS, CONTROLLER_FAULTS, EGM_FAULTS, STREAM_FAULTS, faults_of
from planner.simulate.controller import OTHER_PROGRAM, Controller, ProgramMotion, own_clock, played_motion
from planner.simulate.egm import ARM_AXES, EgmRobot
from planner.simulate.ftp import FTP_FAULTS, FtpAccess, FtpServer
from planner.simulate.rws import RWS_FAULTS, Access, RwsServer
from planner.simulate.servers import HOST, BoardServer
from planner.simulate.stream import StreamServer

RWS_PORT, BOARD_PORT, PROGRAM_PORT = 8080, 8023, 1025  # the real ones, 80 and 23, require administrator rights
STREAM_PORT, EGM_PORT = 1026, 6510
LOOK = 0.1  # s between checks whether it is over
RWS_PASSWORD, BOARD_PASSWORD = "BEADWISE_RWS_PASSWORD", "BEADWISE_HEAD_PASSWORD"  # names in the environment
FASTEST = 1000.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a simulator until Ctrl-C; returns the exit code."""
    options = simulate_command().parse_args(arguments)
    return exit_code(lambda: _run(options), lambda text: print(text, file=sys.stderr), "the simulator has ended")


def simulate_command() -> Command:
    """The parser of `python -m planner.simulate`."""
    parser = Command(
        "simulate",
        "Simulate a robot's controller (web services and program socket; or one that takes a stream of "
        "moves; or one that is guided by EGM), or an extruder's board.",
        {
            "controller": f"web services on port {RWS_PORT}, programs on port {PROGRAM_PORT} of this computer",
            "board --pace 20": f"a board on port {BOARD_PORT}, twenty times as fast as a real one",
            "board --help": "the options of one of them, and the faults that it can simulate",
        },
        {0: "over", 2: "wrong input", 130: "ended by Ctrl-C"},
        [
            f"passwords come from {RWS_PASSWORD} and {BOARD_PASSWORD}; without them the controller's is ABB's default "
            "and the board has none"
        ],
    )
    kinds = parser.add_subparsers(dest="kind", required=True, parser_class=argparse.ArgumentParser)
    ends = (
        ("controller", RWS_PORT, CONTROLLER_FAULTS),
        ("board", BOARD_PORT, BOARD_FAULTS),
        ("stream", STREAM_PORT, STREAM_FAULTS),
        ("egm", EGM_PORT, EGM_FAULTS),
    )
    for kind, port, faults in ends:
        one = kinds.add_parser(
            kind,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            epilog=_told("a line", faults)
            + (
                "\n" + _told("a request", RWS_FAULTS) + "\n" + _told("a command of FTP", FTP_FAULTS)
                if kind == "controller"
                else ""
            ),
        )
        one._negative_number_matcher = NEGATIVE
        to = "speak to" if kind == "egm" else "listen on"
        one.add_argument("--host", default=HOST, help=f"address to {to} (default {HOST}: this computer only)")
        one.add_argument("--port", type=_port, default=port, help=f"port to {to} (default {port})")
        one.add_argument("--pace", type=_pace, default=1.0, help="how many times as fast as real time (default 1)")
        one.add_argument("--fault", action="append", default=[], metavar="KIND@LINE[:VALUE]", help="repeatable")
        if kind == "controller":
            one.add_argument("--program-port", type=_port, default=PROGRAM_PORT, help="of the program's socket")
            one.add_argument("--arms", type=int, choices=(1, 2), default=1, help="2: a MultiMove system (default 1)")
            one.add_argument(
                "--problem", metavar="YAML", help="problem with the cell, whose joint limits then count too"
            )
            one.add_argument("--rws", type=int, choices=(1, 2), default=1, help="version of Robot Web Services")
            one.add_argument("--certificate", type=Path, metavar="PEM", help="for https, with --key")
            one.add_argument("--key", type=Path, metavar="PEM")
            one.add_argument(
                "--lenient", action="store_true", help="accept whatever can be understood, documented or not"
            )
            one.add_argument(
                "--web-fault", action="append", default=[], metavar="KIND@REQUEST[:VALUE]", help="repeatable"
            )
            one.add_argument("--ftp-port", type=_port, metavar="PORT", help="also listen for FTP on this port")
            one.add_argument(
                "--ftp-fault", action="append", default=[], metavar="KIND@COMMAND[:VALUE]", help="repeatable"
            )
        if kind == "egm":
            one.add_argument(
                "--start", type=_joints, required=True, metavar="DEG,DEG,…", help="joints at which it starts"
            )
    return parser


def _told(where: str, faults: Mapping[str, str]) -> str:
    return f"faults, each once at {where}:\n" + "\n".join(f"  {name:8} {what}" for name, what in faults.items())


def _joints(text: str) -> tuple[float, ...]:
    try:
        joints = tuple(float(word) for word in text.split(","))
    except ValueError:
        joints = ()
    if not ARM_AXES <= len(joints) <= 2 * ARM_AXES or not all(math.isfinite(value) for value in joints):
        raise argparse.ArgumentTypeError(f"{text!r} is not six joints and up to six axes of a station, in degrees")
    return joints


def _port(text: str) -> int:
    if not text.isdigit() or not 0 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port")
    return int(text)


def _pace(text: str) -> float:
    try:
        pace = float(text)
    except ValueError:
        pace = 0.0
    if not 0.0 < pace <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number between 0 and {FASTEST:g}")
    return pace


def _run(options: argparse.Namespace) -> int:
    kinds = {"controller": _controller, "board": _board, "stream": _stream, "egm": _egm}
    kinds[options.kind](options)
    return EXIT_VERIFIED


def _board(options: argparse.Namespace) -> None:
    faults = faults_of(options.fault, BOARD_FAULTS)
    board = BoardServer(options.host, options.port, options.pace, faults, os.environ.get(BOARD_PASSWORD, ""))
    with closing(board):
        _wait(f"board on {board.address[0]}:{board.address[1]}")


def _stream(options: argparse.Namespace) -> None:
    faults = faults_of(options.fault, STREAM_FAULTS)
    with closing(StreamServer(options.host, options.port, options.pace, faults)) as server:
        where = f"{server.address[0]}:{server.address[1]}"
        _wait(f"controller that takes a stream on {where}", lambda: server.state().reason)


def _egm(options: argparse.Namespace) -> None:
    faults = faults_of(options.fault, EGM_FAULTS)
    with closing(EgmRobot((options.host, options.port), options.start, options.pace, faults)) as robot:
        _wait(f"robot, guided from {options.host}:{options.port}", lambda: robot.reason)


def _controller(options: argparse.Namespace) -> None:
    if (options.certificate is None) != (options.key is None):
        raise InputError("a certificate needs its key, and vice versa", field="--certificate")
    faults = faults_of(options.fault, CONTROLLER_FAULTS)
    move: Callable[[RobotProgram], ProgramMotion] = own_clock
    if options.problem is not None:
        move = partial(played_motion, cell=build_cell(load_problem(options.problem)))
    password = os.environ.get(RWS_PASSWORD, Access.password)
    access = Access(
        password=password,
        version=options.rws,
        certificate=options.certificate,
        key=options.key,
        strict=not options.lenient,
    )
    loaded = {} if options.lenient else OTHER_PROGRAM
    with ExitStack() as stack:
        controller = Controller(
            (options.host, options.program_port), options.pace, faults, None, move, loaded, options.arms
        )
        stack.enter_context(closing(controller))
        web_faults = faults_of(options.web_fault, RWS_FAULTS)
        rws = stack.enter_context(closing(RwsServer(options.host, options.port, controller, access, web_faults)))
        what = f"controller on {rws.address[0]}:{rws.address[1]}, its programs on port {options.program_port}"
        if options.ftp_port is not None:
            ftp_faults, who = faults_of(options.ftp_fault, FTP_FAULTS), FtpAccess(password=password)
            ftp = stack.enter_context(closing(FtpServer(options.host, options.ftp_port, controller, who, ftp_faults)))
            what += f", FTP on port {ftp.address[1]}"
        _wait(what)


def _wait(what: str, over: Callable[[], str] = str) -> None:
    """Wait until Ctrl-C, or until `over` returns why it is over."""
    print(f"simulated {what}; Ctrl-C ends it", flush=True)
    while not over():
        time.sleep(LOOK)
    print(over(), flush=True)
