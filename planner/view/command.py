"""The command line of the live view."""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from planner.command import Command, add_set, add_strategy, exit_code, one_of
from planner.errors import EXIT_VERIFIED, InputError
from planner.problem import find_problem, load_problem, shipped_problems
from planner.problem.settings import STRATEGY_NAMES
from planner.view.run import Subject, run_view, subject_of
from planner.view.state import View

USUAL_STRATEGY = "sqp"  # while the file that would say so cannot be read


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = view_command().parse_args(arguments)
    say = partial(print, file=sys.stderr)
    return exit_code(partial(_run, options), say, interrupted="the view has ended; no results were written")


def _run(options: argparse.Namespace) -> int:
    subject = _subject(options.subject, options.set)
    view = View(panes=_panes(subject, options), solving=not subject.folder, drafts=options.drafts)
    came = asyncio.run(run_view(subject, view, options.port, partial(_ready, subject, options.browser)))
    if came == signal.SIGINT:
        raise KeyboardInterrupt
    return EXIT_VERIFIED


def _subject(given: str, overrides: Sequence[str]) -> Subject:
    """A folder of results where a folder is meant, else a problem. Raises InputError where there is neither."""
    path = Path(given)
    named = os.sep not in given and path.name in shipped_problems()
    if not path.is_dir() or named:
        return subject_of(find_problem(given), False, overrides)
    if not any((path / name).is_file() for name in ("report.html", "plan.json")):
        raise InputError(
            "is a folder without results", file=path, hint="give a problem file, or the folder that planner.solve wrote"
        )
    if overrides:
        raise InputError("a folder of results is shown as it is", field="--set", hint="give the problem file")
    return subject_of(path, True, ())


def _panes(subject: Subject, options: argparse.Namespace) -> tuple[str, ...]:
    """The strategies to begin with. Raises InputError for what is wrong with an override."""
    first = options.strategy
    if subject.folder:
        return (first or USUAL_STRATEGY,)
    try:
        own: str = load_problem(subject.path, subject.overrides).strategy
    except InputError as error:
        if error.field is not None and error.field.startswith("--set"):
            raise
        own = USUAL_STRATEGY  # the page shows what is wrong, and the view goes on when it is mended
    panes = (first or own, options.beside)
    return tuple(dict.fromkeys(strategy for strategy in panes if strategy is not None))


def _ready(subject: Subject, browser: bool, url: str) -> None:
    what = "results in" if subject.folder else "problem"
    print(f"live view of {what} {subject.path}: {url}", flush=True)
    print("Ctrl-C ends it", file=sys.stderr)
    if browser:  # which may take its time
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def view_command() -> Command:
    """The parser of `python -m planner.view`."""
    parser = Command(
        "view",
        "Show a problem's report in the browser, and solve it anew whenever its files are saved. Nothing is written: "
        "planner.solve does that.",
        {
            "my_part.yaml": "solve, show, and solve again on every save",
            "my_part.yaml --strategy ladder --beside as_published": "two strategies side by side",
            "my_part.yaml --set layers.count=1": "with a field changed",
            "out/my_part": "show what planner.solve writes there, whenever it does",
        },
        {0: "ended otherwise than by Ctrl-C", 2: "wrong input, or a port that is taken", 130: "ended by Ctrl-C"},
    )
    parser.add_argument(
        "subject",
        metavar="PROBLEM|OUT_DIR",
        help="problem file (.yaml), or the name of a shipped one (solve --list); or a folder of results",
    )
    add_strategy(parser)
    parser.add_argument(
        "--beside", type=one_of(STRATEGY_NAMES), metavar="NAME", help="another strategy, in a second pane"
    )
    add_set(parser)
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="of this computer (default: a free one)")
    parser.add_argument(
        "--no-drafts", dest="drafts", action="store_false", help="no draft of one layer first where a print is large"
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only print the address")
    return parser


def _port(text: str) -> int:
    if not text.isdecimal() or not 0 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (1 to 65535; 0 takes a free one)")
    return int(text)
