"""The command line of the link: a program goes to the controller, its lines to the board; both are monitored."""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from rich.console import Console

from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_INTERRUPTED, EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError
from planner.base.web.options import add_page_options, tell_address
from planner.link.as_written import PLAN, add_edited, program_as_written, read_json
from planner.link.connections import (
    CONNECT_TIME,
    Address,
    LinkError,
    Secret,
    connect,
    parse_address,
    part,
    password,
)
from planner.link.ftp import HOME as FTP_HOME
from planner.link.ftp import PORT as FTP_PORT
from planner.link.ftp import Ftp
from planner.link.logged import outcome_of, plan_in
from planner.link.messages import stop as stop_words
from planner.link.orders import listen_at_terminal
from planner.link.program_lines import ProgramLines, lines_file, read_program_lines
from planner.link.relay import LogNote, Relay, RelaySide, RunOutcome
from planner.link.robot import (
    RobotWatch,
    bring,
    check_ready,
    check_together,
    program_files,
    programs_of,
    start,
    stop_robot,
)
from planner.link.run import INTERRUPTIONS, Log, RelayRun, Requests, open_board, signals_as
from planner.link.rws import DIALECTS, USER, Rws
from planner.link.telling import RunProgress, Show, ending, for_the_log, going_on

# ----------------------------------------------------------------------------------------------------
# The command.

PASSWORD, HEAD_PASSWORD = "BEADWISE_RWS_PASSWORD", "BEADWISE_HEAD_PASSWORD"
SOCKET_PORT = 1025  # of the program, unless the problem sets another
BOARD_PORT = 23  # telnet
DEMO_PACE = 20.0  # × the speed of the real print
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
    from planner.link import demo  # here, as importing the planner takes seconds

    options.program = options.program or demo.demo_program(say)
    options.secret = Secret(demo.PASSWORD)
    arms = len(programs_of(program_files(options.program)))
    with demo.simulated(options.pace, arms=arms) as (options.controller, options.socket, options.head):
        code = _run(options, say)
        if code == EXIT_VERIFIED and not options.dry_run:
            with closing(_rws(options, options.secret)) as rws:
                demo.show_steps(rws, options.program, say)
        return code


def _run(options: argparse.Namespace, say: Callable[[str], None]) -> int:
    files = program_files(options.program)
    lines = read_program_lines(options.program)
    check_together(options.program, files, len(lines))
    folder = options.program.parent
    written = [*(name for name in files if (folder / name).is_file()), lines_file(options.program).name]
    program_as_written(folder, written, options.edited, say)
    problem = _problem_of(files[options.program.name])
    plan = read_json(folder / PLAN)
    planned = going_on(plan, problem)
    if options.where is not None:
        outcome = outcome_of(lines, options.where)
        # the folder may have received another plan since the run
        for text in ending(lines, outcome, going_on(plan_in(options.where) or plan, problem)):
            say(text)
        return _code(outcome)
    secret = options.secret or password(PASSWORD, f"{options.user} at {options.controller}")
    with ExitStack() as stack:
        rws = stack.enter_context(closing(_rws(options, secret)))
        check_ready(rws)
        board, greeting = open_board(options.head)
        stack.enter_context(board)
        if options.dry_run and options.upload == "ftp":
            with _way(options, secret):
                say("FTP is ready")
        say(f"controller and board are ready: {lines.module}, {len(lines)} lines")
        if options.dry_run:
            return EXIT_VERIFIED
        requests = stack.enter_context(closing(Requests()))
        hub = stack.enter_context(_hub(options, lines, problem, requests, say))
        greeted = [for_the_log(plan), *(LogNote("board", 0, text) for text in greeting)]
        log = stack.enter_context(closing(Log(options.log or _log_path(options.program), hub.log, greeted)))
        with _way(options, secret) as way:
            bring(rws, files, hub.say, way)
        with _stopping(rws, options.socket) as started:
            program = stack.enter_context(connect(options.socket, "the program on the controller", JOIN_TIME))
            relay = Relay(lines, time.monotonic(), options.cold, hub.attended)
            if hub.typing:
                listen_at_terminal(lambda: relay.status.may, requests.ask, say)
            console = None if options.quiet else Console(stderr=True)
            with signals_as(requests), Show(lines, console, hub.show) as show:
                robot = RobotWatch(rws, requests.ask, lambda: relay.ended)
                sockets = {RelaySide.CONTROLLER: program, RelaySide.BOARD: board}
                outcome = RelayRun(relay, sockets, requests, log, robot, show).run()
                trouble = robot.close()
                started.over = True
        if options.unload:
            _unload(rws, programs_of(files), say)
        texts = [*ending(lines, outcome, planned), *_besides(outcome, trouble), f"log: {log.path}"]
        for text in texts:
            say(text)
        hub.end(outcome.reason is None, texts)
        return _code(outcome)


@dataclass(frozen=True)
class _Hub:
    """Where a run is shown besides the terminal: on a page, if there is one; and whether the terminal takes input."""

    say: Callable[[str], None]
    show: Callable[[RunProgress], None]
    log: Callable[[Iterable[LogNote]], None]
    end: Callable[[bool, Sequence[str]], None]
    typing: bool
    attended: bool


@contextmanager
def _hub(
    options: argparse.Namespace, lines: ProgramLines, problem: str, requests: Requests, say: Callable[[str], None]
) -> Iterator[_Hub]:
    typing = sys.stdin is not None and sys.stdin.isatty()
    if not options.page:
        yield _Hub(say, lambda now: None, lambda notes: None, lambda done, texts: None, typing, typing)
        return
    from planner.link.page import DONE, STOPPED, hub_page  # needs the packages that serve it

    with hub_page(lines, problem, options.page_port, requests.ask) as page:

        def say_both(text: str) -> None:
            say(text)
            page.say(text)

        tell_address("page of the run", page.address, page.address_once() if options.browser else None)

        def end(done: bool, texts: Sequence[str]) -> None:
            page.end(DONE if done else STOPPED, texts)

        yield _Hub(say_both, page.show, page.log, end, typing, True)


@contextmanager
def _way(options: argparse.Namespace, secret: Secret) -> Iterator[Ftp | None]:
    """How files reach the controller: over FTP if requested, else None for its web services."""
    if options.upload != "ftp":
        yield None
        return
    address = Address(options.controller.host, options.ftp_port)
    with closing(Ftp(address, options.user, secret, options.ftp_folder)) as way:
        yield way


def _unload(rws: Rws, tasks: Iterable[str], say: Callable[[str], None]) -> None:
    try:
        with rws.mastership():
            for task in tasks:
                rws.unload(task)
    except (LinkError, InputError) as error:
        say(f"the program stays loaded: {error}")


class _Started:
    """Whether the run of a started program is over, so that it need not be stopped."""

    over = False


@contextmanager
def _stopping(rws: Rws, program: Address) -> Iterator[_Started]:
    """Start the program; if anything goes wrong before it is over, stop it over the web services or its own socket."""
    started = _Started()
    try:
        start(rws)
        yield started
    finally:
        if not started.over and (wrong := stop_robot(rws)) is not None:
            _turn_away(program)
            error = sys.exc_info()[1]
            first = f", after: {error}" if isinstance(error, LinkError | InputError) else ""
            raise LinkError(f"stop the robot by hand, its program may run: {wrong}{first}") from None


def _turn_away(program: Address) -> None:
    """End a program that waits for the link and cannot be stopped in another way, by connecting and leaving."""
    with suppress(LinkError, InputError), connect(program, "the program on the controller") as made:
        part(made, stop_words("the link has failed"), CONNECT_TIME)


def _besides(outcome: RunOutcome, trouble: str | None) -> list[str]:
    if trouble is None or outcome.reason is None:
        return []
    return [f"the robot was told to stop through its program only: {trouble}"]


def _code(outcome: RunOutcome) -> int:
    if outcome.reason is None:
        return EXIT_VERIFIED
    return EXIT_INTERRUPTED if outcome.reason in INTERRUPTIONS.values() else EXIT_NOT_VERIFIED


def _rws(options: argparse.Namespace, secret: Secret) -> Rws:
    return Rws(
        options.controller, options.rws, options.user, secret, verify=options.certificate or not options.insecure
    )


def _problem_of(module: bytes) -> str:
    """The problem's name in a program's header."""
    found = _PROBLEM.search(module[:4096].decode("ascii", "replace"))
    return "PROBLEM" if found is None else found[1]


def _log_path(program: Path) -> Path:
    """A new file name next to the program."""
    return program.with_name(f"{program.stem}_{datetime.now(UTC):%Y%m%dT%H%M%SZ}.jsonl")


def link_command() -> Command:
    """The parser of `python -m planner.link`."""
    parser = Command(
        "link",
        "Run a program of style `socket`: bring it to the controller, start it, and relay its lines to the board.",
        {
            "--demo": "print the logo on simulators of controller and board",
            "--demo --page": "the same with a page in the browser",
            "out/my_part/MyPart.mod --controller 192.168.125.1 --head 192.168.125.5 --dry-run": "is everything ready?",
            "out/my_part/MyPart.mod --controller 192.168.125.1 --head 192.168.125.5": "print",
            "out/my_part/MyPart.mod --where out/my_part/MyPart_20261127T181500Z.jsonl": "where did it stop?",
        },
        {0: "printed, or ready (--dry-run)", 2: "wrong input", 3: "stopped, or not ready", 130: "interrupted"},
        [
            f"passwords come from {PASSWORD} and {HEAD_PASSWORD}, or are asked for",
            "while it runs, type at the terminal: pause, jam, reprime [MM [MM_S]], continue, stop, or their first letters",
        ],
    )
    parser.add_argument(
        "program", type=Path, nargs="?", metavar="PROGRAM.mod", help="with its table of lines beside it"
    )
    parser.add_argument(
        "--controller", metavar="HOST[:PORT]", help="its web services (default port 80, or 443 with --rws 2)"
    )
    parser.add_argument("--head", metavar="HOST[:PORT]", help=f"the extruder's board (port {BOARD_PORT})")
    parser.add_argument(
        "--socket-port", type=int, default=SOCKET_PORT, metavar="PORT", help="of the program's socket (default 1025)"
    )
    parser.add_argument("--user", default=USER, help=f"user of the web services (default {USER!r})")
    parser.add_argument("--rws", type=int, choices=sorted(DIALECTS), default=1, help="1: IRC5, 2: OmniCore (default 1)")
    parser.add_argument("--insecure", action="store_true", help="do not check the controller's certificate (2 only)")
    parser.add_argument(
        "--certificate", type=Path, metavar="PEM", help="certificate to check the controller's with (2 only)"
    )
    parser.add_argument("--upload", choices=("rws", "ftp"), default="rws", help="how files are uploaded (default rws)")
    parser.add_argument("--ftp-port", type=int, default=FTP_PORT, metavar="PORT", help=f"of FTP (default {FTP_PORT})")
    parser.add_argument(
        "--ftp-folder", default=FTP_HOME, metavar="FOLDER", help=f"the controller's HOME there (default {FTP_HOME})"
    )
    add_edited(parser)
    parser.add_argument("--unload", action="store_true", help="unload the program when it is over")
    parser.add_argument(
        "--log", type=Path, metavar="FILE.jsonl", help="default: beside the program, named after the time"
    )
    parser.add_argument(
        "--where", type=Path, metavar="FILE.jsonl", help="only report where a run stopped, by its log, and how to go on"
    )
    parser.add_argument("--cold", action="store_true", help="switch the heaters off when a run is stopped")
    parser.add_argument(
        "--dry-run", action="store_true", help="check whether everything is ready; nothing is sent or started"
    )
    parser.add_argument("--demo", action="store_true", help="print on simulators: PROGRAM.mod, or the logo")
    parser.add_argument(
        "--pace", type=float, default=DEMO_PACE, help=f"speed of the demo, 1: real time (default {DEMO_PACE:g})"
    )
    parser.add_argument("--page", action="store_true", help="show the run in the browser, with buttons to pause it")
    add_page_options(parser, "--page-port")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(secret=None)
    return parser


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = link_command()
    options: argparse.Namespace = parser.parse_args(arguments)
    if not 0.1 <= options.pace <= 100.0:
        parser.error("--pace: 0.1 to 100")
    if options.demo or (options.where is not None and options.program is not None):
        return options
    if None in (options.program, options.controller, options.head):
        parser.error("give PROGRAM.mod, --controller and --head; or --demo; or PROGRAM.mod and --where")
    if options.certificate is not None and not options.certificate.is_file():
        parser.error(f"--certificate: there is no file {options.certificate}")
    try:
        options.controller = parse_address(options.controller, DIALECTS[options.rws].port)
        options.head = parse_address(options.head, BOARD_PORT)
        options.socket = parse_address(f"{options.controller.host}:{options.socket_port}", SOCKET_PORT)
    except ValueError as error:
        parser.error(str(error))
    return options
