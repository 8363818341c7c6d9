"""The command line of the link: a program to the controller, its lines to the board, both watched."""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from rich.console import Console

from planner.command import Command, exit_code
from planner.errors import EXIT_INTERRUPTED, EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.link.board import open_board
from planner.link.effects import Note, Outcome, Side
from planner.link.log import Log
from planner.link.program_lines import ProgramLines, read_program_lines
from planner.link.relay import Relay
from planner.link.robot import Robot, bring, check_ready, check_together, program_files
from planner.link.run import INTERRUPTED, Requests, run_relay, signals_as
from planner.link.rws import DIALECTS, USER, Rws
from planner.link.secret import Secret, password
from planner.link.show import Show, ending
from planner.link.sockets import LinkError, connect, parse_address

PASSWORD, HEAD_PASSWORD = "BEADWISE_RWS_PASSWORD", "BEADWISE_HEAD_PASSWORD"
SOCKET_PORT = 1025  # of the program, unless the problem says otherwise
BOARD_PORT = 23  # telnet
DEMO_PACE = 20.0  # times as fast as the print
JOIN_TIME = 30.0  # s from the start of the program until it listens
_PROBLEM = re.compile(r"! Problem ([A-Za-z0-9_.-]+)")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = _options(arguments)
    say = partial(print, file=sys.stderr)
    return exit_code(
        partial(_demo if options.demo else _run, options, say),
        say,
        interrupted="the program was not started, or was stopped",
    )


def _demo(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    from planner.link.demo import PASSWORD, demo_program, simulated  # the planner takes seconds to be imported

    options.program = options.program or demo_program(say)
    options.secret = Secret(PASSWORD)
    with simulated(options.pace) as (options.controller, options.socket, options.head):
        return _run(options, say)


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    files = program_files(options.program)
    lines = read_program_lines(options.program)
    check_together(options.program, files, len(lines))
    problem = _problem_of(files[options.program.name])
    secret = options.secret or password(PASSWORD, f"{options.user} at {options.controller}")
    with ExitStack() as stack:
        rws = stack.enter_context(closing(_rws(options, secret)))
        check_ready(rws)
        board, greeting = open_board(options.head)
        stack.enter_context(board)
        say(f"controller and board are ready: {lines.module}, {len(lines)} lines")
        if options.dry_run:
            return EXIT_VERIFIED
        log = stack.enter_context(closing(Log(options.log or _log_path(options.program))))
        log.write([Note("board", 0, text) for text in greeting])
        bring(rws, files, say)
        with _stopping(rws) as started:
            program = stack.enter_context(connect(options.socket, "the program on the controller", JOIN_TIME))
            requests = stack.enter_context(closing(Requests()))
            relay = Relay(lines, time.monotonic(), options.cold)
            with signals_as(requests), Show(lines, None if options.quiet else Console(stderr=True)) as show:
                robot = Robot(rws, requests.ask, lambda: relay.ended)
                sockets = {Side.CONTROLLER: program, Side.BOARD: board}
                outcome = run_relay(relay, sockets, requests, log, robot.stop, show)
                trouble = robot.close()
                started.over = True
        return _told(lines, outcome, trouble, problem, log, say)


class _Started:
    """Whether a program that was started is somebody's care by now, or over."""

    over = False


@contextmanager
def _stopping(rws: Rws) -> Iterator[_Started]:
    """Start the program; whatever goes wrong before it is over stops it."""
    started = _Started()
    try:
        rws.start()
        yield started
    finally:
        if not started.over:
            try:
                rws.stop()
            except LinkError as error:
                raise LinkError(f"stop the robot by hand, its program may run: {error}") from None


def _told(
    lines: ProgramLines, outcome: Outcome, trouble: str | None, problem: str, log: Log, say: Callable[[str], None]
) -> int:
    for text in ending(lines, outcome, problem):
        say(text)
    if trouble is not None and outcome.reason is not None:
        say(f"the robot was told to stop through its program only: {trouble}")
    say(f"log: {log.path}")
    if outcome.reason is None:
        return EXIT_VERIFIED
    return EXIT_INTERRUPTED if outcome.reason == INTERRUPTED else EXIT_NOT_VERIFIED


def _rws(options: argparse.Namespace, secret: Secret) -> Rws:
    return Rws(options.controller, options.rws, options.user, secret, verify=not options.insecure)


def _problem_of(module: bytes) -> str:
    """The problem's name in a program's header."""
    found = _PROBLEM.search(module[:4096].decode("ascii", "replace"))
    return "PROBLEM" if found is None else found[1]


def _log_path(program: Path) -> Path:
    """A name of its own beside the program."""
    return program.with_name(f"{program.stem}_{datetime.now(UTC):%Y%m%dT%H%M%SZ}.jsonl")


def link_command() -> Command:
    """The parser of `python -m planner.link`."""
    parser = Command(
        "link",
        "Run a program of style `socket`: bring it to the controller, start it, and relay its lines to the board.",
        {
            "--demo": "print the logo on simulators of controller and board",
            "out/my_part/MyPart.mod --controller 192.168.125.1 --head 192.168.125.5 --dry-run": "is all ready?",
            "out/my_part/MyPart.mod --controller 192.168.125.1 --head 192.168.125.5": "print",
        },
        {0: "printed, or ready (--dry-run)", 2: "wrong input", 3: "stopped, or not ready", 130: "interrupted"},
        [f"passwords come from {PASSWORD} and {HEAD_PASSWORD}, or are asked for"],
    )
    parser.add_argument(
        "program", type=Path, nargs="?", metavar="PROGRAM.mod", help="with its table of lines beside it"
    )
    parser.add_argument("--controller", metavar="HOST[:PORT]", help="its web services (80, or 443 for 2)")
    parser.add_argument("--head", metavar="HOST[:PORT]", help=f"the extruder's board (port {BOARD_PORT})")
    parser.add_argument("--socket-port", type=int, default=SOCKET_PORT, metavar="PORT", help="of the program (1025)")
    parser.add_argument("--user", default=USER, help=f"of the web services (default {USER!r})")
    parser.add_argument("--rws", type=int, choices=sorted(DIALECTS), default=1, help="1: IRC5, 2: OmniCore (default 1)")
    parser.add_argument("--insecure", action="store_true", help="do not check the controller's certificate (2 only)")
    parser.add_argument("--log", type=Path, metavar="FILE.jsonl", help="default: beside the program, named by the time")
    parser.add_argument("--cold", action="store_true", help="switch the heaters off when a run is stopped")
    parser.add_argument("--dry-run", action="store_true", help="look whether all is ready; nothing is sent or started")
    parser.add_argument("--demo", action="store_true", help="print on simulators: PROGRAM.mod, or the logo")
    parser.add_argument("--pace", type=float, default=DEMO_PACE, help=f"of the demo (default {DEMO_PACE:g})")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(secret=None)
    return parser


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = link_command()
    options: argparse.Namespace = parser.parse_args(arguments)
    if not 0.1 <= options.pace <= 100.0:
        parser.error("--pace: 0.1 to 100")
    if options.demo:
        return options
    if None in (options.program, options.controller, options.head):
        parser.error("give PROGRAM.mod, --controller and --head, or --demo")
    try:
        options.controller = parse_address(options.controller, DIALECTS[options.rws].port)
        options.head = parse_address(options.head, BOARD_PORT)
        options.socket = parse_address(f"{options.controller.host}:{options.socket_port}", SOCKET_PORT)
    except ValueError as error:
        parser.error(str(error))
    return options
