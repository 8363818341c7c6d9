"""Options shared by the commands that plan: the problem, its changes, strategy, processes; and all of `solve`'s."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from planner.base.command_line import Command, number_within, one_of
from planner.base.distribution import MOST_JOBS
from planner.problem import shipped_problems
from planner.problem.settings import STRATEGY_NAMES

if TYPE_CHECKING:
    from planner.plan.robustness import Tolerance

DEFAULT_DT = 0.004
MIN_DT, MAX_DT = 0.0005, 0.02  # s: finer samples drown in rounding, coarser ones hide what a joint does


def add_problem(parser: argparse.ArgumentParser, optional: bool = False) -> None:
    """Add the argument that names the problem."""
    parser.add_argument(
        "problem",
        nargs="?" if optional else None,
        metavar="PROBLEM",
        help="problem file (.yaml), or the name of a shipped one (solve --list)",
    )


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add `--set`."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a field of the problem, e.g. layers.count=1; repeatable",
    )


def add_strategy(parser: argparse.ArgumentParser) -> None:
    """Add `--strategy`."""
    parser.add_argument(
        "--strategy",
        type=one_of(STRATEGY_NAMES),
        metavar="NAME",
        help=f"instead of the problem's own: {', '.join(STRATEGY_NAMES)}",
    )


def add_spread(parser: argparse.ArgumentParser) -> None:
    """Add `--jobs` and `--scheduler`."""
    parser.add_argument(
        "--jobs", type=_jobs, default=1, metavar="N", help="processes that share the work (default 1: this one alone)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="dask scheduler whose workers do the work instead, e.g. tcp://192.168.0.10:8786",
    )


def solve_command() -> Command:
    """The parser of `python -m planner.solve`."""
    parser = Command(
        "solve",
        "Plan a curved-layer print: from one YAML file to a verified robot program.",
        {
            "--list": "the problems that ship, and what each is",
            "cylinder_logo": "plan one of them; results in out/cylinder_logo; start with report.html",
            "my_part.yaml --strategy ladder": "a problem of your own, with another strategy",
            "my_part.yaml --set process.speed_mm_s=30 --set layers.count=2": "with fields changed for this run",
            "my_part.yaml --tolerance 2mm,1deg": "a plan that also holds for a slightly displaced part",
            "my_part.yaml --from-bead 120": "the rest of an interrupted print",
        },
        {
            0: "verified plan written",
            2: "wrong input; nothing written",
            3: "no verified plan: the report says where and why, no robot code",
            130: "interrupted; nothing written",
        },
    )
    add_problem(parser, optional=True)
    add_strategy(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="where the results go (default out/<problem>, resumed out/<problem>_from_<K>)",
    )
    add_set(parser)
    parser.add_argument(
        "--tolerance",
        type=_tolerance,
        metavar="SHIFT,TURN",
        help="the plan must also hold for a part displaced by up to this much, e.g. 2mm,1deg",
    )
    parser.add_argument(
        "--from-bead",
        type=int,
        default=0,
        metavar="K",
        help="resume an interrupted print: bead K (as the report counts, from 0) and all after it",
    )
    add_spread(parser)
    parser.add_argument(
        "--dt", type=_sample_time, default=DEFAULT_DT, metavar="S", help="seconds between samples (default 0.004)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    parser.add_argument("--list", action="store_true", help="list the shipped problems, one per line, and exit")
    return parser


def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the arguments, or the process's own if None; exits with code 2 and a message if they are wrong."""
    parser = solve_command()
    options: argparse.Namespace = parser.parse_args(arguments)
    if options.problem is None and not options.list:
        parser.error(f"which problem? A file, or one of: {', '.join(shipped_problems())}")
    return options


def _jobs(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= MOST_JOBS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to {MOST_JOBS}")
    return int(text)


def _sample_time(text: str) -> float:
    return number_within(text, MIN_DT, MAX_DT, "a time in s")


def _tolerance(text: str) -> Tolerance:
    from planner.plan.robustness import parse_tolerance

    try:
        return parse_tolerance(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
