"""The command line of the simulators.

python -m planner.simulate controller|board|stream
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from planner.command import exit_code
from planner.errors import EXIT_VERIFIED, InputError
from planner.simulate.board_server import BoardServer
from planner.simulate.controller import Controller
from planner.simulate.faults import BOARD_FAULTS, CONTROLLER_FAULTS, STREAM_FAULTS, faults_of
from planner.simulate.lines import HOST
from planner.simulate.rws import Access, RwsServer
from planner.simulate.stream import StreamServer

RWS_PORT, BOARD_PORT, PROGRAM_PORT = 8080, 8023, 1025  # the real ones, 80 and 23, ask for an administrator's rights
STREAM_PORT = 1026
RWS_PASSWORD, BOARD_PASSWORD = "BEADWISE_RWS_PASSWORD", "BEADWISE_HEAD_PASSWORD"  # names in the environment
FASTEST = 1000.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a simulator until Ctrl-C; returns the exit code."""
    options = _options(arguments)
    return exit_code(lambda: _run(options), lambda text: print(text, file=sys.stderr), "the simulator has ended")


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m planner.simulate",
        description="Simulate a robot's controller (web services and program socket, or a stream of moves), or an "
        "extruder's board.",
        epilog=f"passwords come from {RWS_PASSWORD} and {BOARD_PASSWORD}; without, the controller's is ABB's default "
        "and the board has none",
    )
    kinds = parser.add_subparsers(dest="kind", required=True)
    ends = (
        ("controller", RWS_PORT, CONTROLLER_FAULTS),
        ("board", BOARD_PORT, BOARD_FAULTS),
        ("stream", STREAM_PORT, STREAM_FAULTS),
    )
    for kind, port, faults in ends:
        one = kinds.add_parser(
            kind,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            epilog="faults, once each at a line:\n" + "\n".join(f"  {name:8} {what}" for name, what in faults.items()),
        )
        one.add_argument("--host", default=HOST, help=f"address to listen on (default {HOST}: this computer only)")
        one.add_argument("--port", type=_port, default=port, help=f"port to listen on (default {port}, 0: any free)")
        one.add_argument("--pace", type=_pace, default=1.0, help="how many times as fast as real time (default 1)")
        one.add_argument("--fault", action="append", default=[], metavar="KIND@LINE[:VALUE]", help="repeatable")
        if kind == "controller":
            one.add_argument("--program-port", type=_port, default=PROGRAM_PORT, help="of the program's socket")
            one.add_argument("--rws", type=int, choices=(1, 2), default=1, help="version of Robot Web Services")
            one.add_argument("--certificate", type=Path, metavar="PEM", help="for https, with --key")
            one.add_argument("--key", type=Path, metavar="PEM")
    return parser.parse_args(arguments)


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
    if options.kind == "board":
        faults = faults_of(options.fault, BOARD_FAULTS)
        password = os.environ.get(BOARD_PASSWORD, "")
        board = BoardServer(options.host, options.port, options.pace, faults, password)
        _wait(f"board on {board.address[0]}:{board.address[1]}", board.close)
        return EXIT_VERIFIED
    if options.kind == "stream":
        stream = StreamServer(options.host, options.port, options.pace, faults_of(options.fault, STREAM_FAULTS))
        _wait(f"controller that takes a stream on {stream.address[0]}:{stream.address[1]}", stream.close)
        return EXIT_VERIFIED
    if (options.certificate is None) != (options.key is None):
        raise InputError("a certificate needs its key, and the other way round", field="--certificate")
    faults = faults_of(options.fault, CONTROLLER_FAULTS)
    controller = Controller((options.host, options.program_port), options.pace, faults)
    password = os.environ.get(RWS_PASSWORD, Access.password)
    access = Access(password=password, version=options.rws, certificate=options.certificate, key=options.key)
    try:
        rws = RwsServer(options.host, options.port, controller, access)
        where = f"controller on {rws.address[0]}:{rws.address[1]}, its programs on port {options.program_port}"
        _wait(where, rws.close)
    finally:
        controller.close()
    return EXIT_VERIFIED


def _wait(what: str, close: Callable[[], None]) -> None:
    print(f"simulated {what}; Ctrl-C ends it", flush=True)
    try:
        threading.Event().wait()
    finally:
        close()


if __name__ == "__main__":
    sys.exit(main())
