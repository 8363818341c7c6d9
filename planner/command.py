"""What commands share: their help, their options, how they end; and the options of `python -m planner.solve`."""

from __future__ import annotations

import argparse
import math
import shutil
import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from planner.errors import EXIT_INTERRUPTED, PlannerError, Refusal, nearest_name
from planner.garbage import look_again
from planner.interrupts import end_in_order
from planner.problem import shipped_problems
from planner.problem.settings import STRATEGY_NAMES
from planner.spread import MOST_JOBS

if TYPE_CHECKING:
    from planner.plan.tolerance import Tolerance

DEFAULT_DT = 0.004
MIN_DT, MAX_DT = 0.0005, 0.02  # s; finer drowns in rounding, coarser hides what a joint does
HELP_WIDTH = 78  # columns of a help, however wide the terminal is
CONTINUED = " \\"  # ends a line of a command that goes on in the next one
HELP_COLUMN = 26  # where the text of an option begins, so that most names stand beside theirs at 80 columns


def exit_code(run: Callable[[], int], say: Callable[[str], None], interrupted: str = "nothing was written") -> int:
    """The exit code of a command; whatever ends it before its time is said, an error with what would help."""
    try:
        end_in_order()
        look_again()
        return run()
    except KeyboardInterrupt:
        say(f"interrupted: {interrupted}")
        return EXIT_INTERRUPTED
    except PlannerError as error:
        say(f"error: {error}")
        for hint in error.hints if isinstance(error, Refusal) else ():
            say(f"try: {hint}")
        return error.exit_code


class _Help(argparse.HelpFormatter):
    """Paragraphs are wrapped, lines that are indented stay as they are: examples and exit codes."""

    def __init__(self, prog: str, width: int | None = None) -> None:
        wide = min(HELP_WIDTH, shutil.get_terminal_size().columns - 2) if width is None else width
        super().__init__(prog, max_help_position=HELP_COLUMN, width=wide)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = text.splitlines()
        return "\n".join(line if line.startswith(" ") else textwrap.fill(line, width) for line in lines)


class Command(argparse.ArgumentParser):
    """The parser of a command: description, options, examples and exit codes in one style, and `--version`.

    examples  what somebody may type after `python -m planner.<name>` → what it does
    codes     exit code → when
    notes     paragraphs below
    """

    def __init__(
        self,
        name: str,
        description: str,
        examples: Mapping[str, str],
        codes: Mapping[int, str],
        notes: Sequence[str] = (),
    ) -> None:
        prog = f"python -m planner.{name}"
        self.examples = {f"{prog} {given}".rstrip(): what for given, what in examples.items()}
        self.codes, self.notes = codes, notes
        shown = [_lines(typed, 2, CONTINUED) + "\n" + _lines(what, 6) for typed, what in self.examples.items()]
        ends = [_lines(f"{code:<4} {when}", 2, later=7) for code, when in codes.items()]
        epilog = "\n".join(["examples:", *shown, "", "exit codes:", *ends, *(f"\n{note}" for note in notes)])
        super().__init__(prog=prog, description=description, epilog=epilog, formatter_class=_Help)
        told = f"beadwise {version('beadwise')}"
        self.add_argument("--version", action="version", version=told, help="tell the version, and stop")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As every parser; an option that there is not is told with the one that was probably meant."""
        options, unknown = self.parse_known_args(args, namespace)
        if unknown:
            known = [name for action in self._actions for name in action.option_strings]
            near = nearest_name(unknown[0].partition("=")[0], known) if unknown[0].startswith("-") else None
            hint = f" (did you mean {near}?)" if near else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return options

    def page(self) -> str:
        """The help as it is printed, whatever the terminal's width."""
        formatter, self.formatter_class = self.formatter_class, partial(_Help, width=HELP_WIDTH)
        try:
            return self.format_help()
        finally:
            self.formatter_class = formatter

    def error(self, message: str) -> NoReturn:
        """As every parser, with the way to the help."""
        super().error(f"{message}; --help shows what can be given")


def _lines(text: str, indent: int, glue: str = "", later: int = 6) -> str:
    """Text in lines that are indented, the later ones as far as `later`; `glue` ends those that go on."""
    wide = HELP_WIDTH - len(glue)
    return f"{glue}\n".join(
        textwrap.wrap(text, wide, initial_indent=" " * indent, subsequent_indent=" " * later, break_on_hyphens=False)
    )


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """The type of an argument that is one of some names; the nearest is suggested for any other."""

    def check(text: str) -> str:
        if text in names:
            return text
        near = nearest_name(text, names)
        meant = f"did you mean {near}? " if near else ""
        raise argparse.ArgumentTypeError(f"{text!r} is unknown: {meant}choices: {', '.join(names)}")

    return check


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
            "cylinder_logo": "plan one of them; results in out/cylinder_logo, first of all report.html",
            "my_part.yaml --strategy ladder": "a problem of your own, with another strategy",
            "my_part.yaml --set process.speed_mm_s=30 --set layers.count=2": "with fields changed for this run",
            "my_part.yaml --tolerance 2mm,1deg": "a plan that holds where the part stands a little elsewhere",
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
        help="the plan must hold where the part stands elsewhere by as much as this, e.g. 2mm,1deg",
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
    parser.add_argument("--list", action="store_true", help="tell which problems ship, one a line, and stop")
    return parser


def options_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the arguments, of the process if there are none; ends it with exit code 2 and a message if they are wrong."""
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
    try:
        dt = float(text)
    except ValueError:
        dt = math.nan
    if not MIN_DT <= dt <= MAX_DT:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time between {MIN_DT} and {MAX_DT} s")
    return dt


def _tolerance(text: str) -> Tolerance:
    from planner.plan.tolerance import parse_tolerance  # which knows plans, and takes a second to be imported

    try:
        return parse_tolerance(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
