"""Commands by name: each is imported only when it is run, and Ctrl-C during the import ends it at once."""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NamedTuple, NoReturn

from planner.base.errors import EXIT_INPUT, EXIT_INTERRUPTED, EXIT_VERIFIED, nearest_name
from planner.base.extras import missing_extra
from planner.base.signals import interrupted, interrupts_answered, no_more_interruptions, terminations_interrupt
from planner.base.terminal import forgive_output


class CommandModule(NamedTuple):
    """The module of a command's `main`, and what the command does, in a few words."""

    module: str
    does: str


COMMANDS = {
    "demo": CommandModule("planner.report.demo", "show a shipped print, already planned, in the browser"),
    "solve": CommandModule("planner.planning.solve_command", "plan a print: from a problem file to a robot program"),
    "check": CommandModule("planner.planning.check_command", "read a problem and its files without planning it"),
    "new": CommandModule("planner.new.command", "make a problem file of your own"),
    "robots": CommandModule("planner.robots.command", "list the shipped robots, show one in detail, or add your own"),
    "place": CommandModule("planner.place.command", "search for the place from which a part is printed best"),
    "register": CommandModule("planner.register.command", "find where the part really is, from touched places"),
    "identify": CommandModule(
        "planner.feedback.identify_command", "find limits and delays of a robot in the recording of a test program"
    ),
    "scan": CommandModule("planner.feedback.scan_command", "replan the rest of a print on top of what a scan found"),
    "learn": CommandModule("planner.feedback.learn_command", "correct a program by what the robot did in its last run"),
    "view": CommandModule(
        "planner.view.command", "show a report in the browser, rebuilt whenever its problem is saved"
    ),
    "link": CommandModule("planner.link.command", "send a program to its controller, and watch it run"),
    "stream": CommandModule("planner.link.streaming", "send moves to a controller while it runs them"),
    "egm": CommandModule("planner.link.guided_motion", "send joints to a controller by externally guided motion"),
    "simulate": CommandModule("planner.simulate.command", "run simulators of controllers and extruder boards"),
    "completion": CommandModule("planner.base.completion", "print a script that lets a shell complete these commands"),
}


def main() -> int:
    """The console script `beadwise NAME …`; returns the exit code."""
    name, arguments = (sys.argv[1], sys.argv[2:]) if len(sys.argv) > 1 else ("--help", [])
    if name in COMMANDS:
        end(launch(name, arguments))
    forgive_output()
    if name == "--version":
        from importlib.metadata import version

        print(f"beadwise {version('beadwise')}")
        return EXIT_VERIFIED
    if name in ("--help", "-h", "help"):
        print(usage())
        return EXIT_VERIFIED
    near = nearest_name(name, COMMANDS)
    hint = f"did you mean {near}?" if near else f"commands: {', '.join(COMMANDS)}"
    print(f"error: there is no command {name!r} ({hint})", file=sys.stderr)
    return EXIT_INPUT


def usage() -> str:
    """The help of `beadwise`: a line for each command."""
    rows = [f"  {name:<10} {command.does}" for name, command in COMMANDS.items()]
    head = ["usage: beadwise COMMAND [ARGUMENTS]", "", "Plans curved-layer prints for robot arms.", "", "commands:"]
    return "\n".join(
        [*head, *rows, "", "beadwise COMMAND --help explains a command; beadwise --version prints the version."]
    )


def launch(name: str, arguments: Sequence[str] | None = None) -> int:
    """Import a command and run it with arguments (default: the process's own); returns its exit code."""
    forgive_output()
    try:
        with _importing():
            run = importlib.import_module(COMMANDS[name].module).main
    except ImportError as error:
        missing = missing_extra(error, f"beadwise {name}")
        if missing is None:
            raise
        print(f"error: {missing}", file=sys.stderr)
        return missing.exit_code
    terminations_interrupt()
    try:
        code: int = run(arguments)
    except KeyboardInterrupt:  # a second one, while the command handled the first
        code = EXIT_INTERRUPTED
    interrupts_answered()
    gc.freeze()  # no collection at exit: the system takes all memory back at once
    return code


def end(code: int) -> NoReturn:
    """End this process with its command's exit code.

    After an interruption the interpreter is not shut down: that ends threads wherever they are, and ending one inside
    a compiled function aborts the process.
    """
    no_more_interruptions()
    if interrupted():
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):  # the reader has gone, or the stream is closed
                stream.flush()
        os._exit(code)
    sys.exit(code)


@contextmanager
def _importing() -> Iterator[None]:
    """Imports take seconds, and there is nothing to clean up yet: Ctrl-C ends the process without a traceback.

    Garbage is not collected meanwhile: imports leave next to none, and looking for it takes a quarter of a second.
    """
    main_thread = threading.current_thread() is threading.main_thread()
    quiet = main_thread and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if quiet:
        signal.signal(signal.SIGINT, _end)
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
        if quiet:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(EXIT_INTERRUPTED)
