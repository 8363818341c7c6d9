"""What commands share: how they end; and the options of `python -m planner.solve`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from planner.errors import EXIT_INTERRUPTED, PlannerError, Refusal
from planner.interrupts import end_in_order
from planner.problem import shipped_problems
from planner.problem.settings import STRATEGY_NAMES
from planner.tolerance import Tolerance, parse_tolerance

DEFAULT_DT = 0.004
MIN_DT, MAX_DT = 0.0005, 0.02  # s; finer drowns in rounding, coarser hides what a joint does


def exit_code(run: Callable[[], int], say: Callable[[str], None], interrupted: str = "nothing was written") -> int:
    """The exit code of a command; whatever ends it before its time is said, an error with what would help."""
    try:
        end_in_order()
        return run()
    except KeyboardInterrupt:
        say(f"interrupted: {interrupted}")
        return EXIT_INTERRUPTED
    except PlannerError as error:
        say(f"error: {error}")
        for hint in error.hints if isinstance(error, Refusal) else ():
            say(f"try: {hint}")
        return error.exit_code


def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the arguments, of the process if there are none; ends it with exit code 2 and a message if they are wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m planner.solve",
        description="Plan a curved-layer print: from one YAML file to a verified robot program.",
        epilog="exit codes: 0 verified plan written, 2 wrong input, 3 no verified plan (report only), 130 interrupted",
    )
    parser.add_argument("problem", nargs="?", metavar="PROBLEM.yaml", help="problem file, or the name of a shipped one")
    parser.add_argument("--strategy", choices=STRATEGY_NAMES, help="instead of the problem's own")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="where the results go (default out/<problem>, resumed out/<problem>_from_<K>)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a field, e.g. layers.count=1; repeatable",
    )
    parser.add_argument(
        "--tolerance",
        type=_tolerance,
        metavar="SHIFT,TURN",
        help="the plan must hold where the part stands elsewhere by as much as this, e.g. 2mm,1deg",
    )
    parser.add_argument(
        "--from-bead",
        type=int,
        default=0,
        metavar="K",
        help="resume an interrupted print: bead K (as the report counts, from 0) and all after it",
    )
    parser.add_argument("--dt", type=_sample_time, default=DEFAULT_DT, help="seconds between samples (default 0.004)")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    parser.add_argument("--list", action="store_true", help="name the problems that ship, and stop")
    options = parser.parse_args(arguments)
    if options.problem is None and not options.list:
        parser.error(f"which problem? A file, or one of: {', '.join(shipped_problems())}")
    return options


def _sample_time(text: str) -> float:
    try:
        dt = float(text)
    except ValueError:
        dt = math.nan
    if not MIN_DT <= dt <= MAX_DT:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time between {MIN_DT} and {MAX_DT} s")
    return dt


def _tolerance(text: str) -> Tolerance:
    try:
        return parse_tolerance(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
