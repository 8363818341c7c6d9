"""Shared by all commands: the layout of their help, types of arguments, and exit codes."""

from __future__ import annotations

import argparse
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from planner.base.errors import EXIT_INTERRUPTED, PlannerError, Refusal, nearest_name
from planner.base.extras import missing_extra
from planner.base.signals import ended_at_once
from planner.base.signals import interrupted as was_interrupted

# Start of a negative value, or of a list such as -10,20: Python 3.11's argparse would take the latter for an option.
NEGATIVE = re.compile(r"-\.?[0-9]")
HELP_WIDTH = 78  # columns of a help, however wide the terminal is
CONTINUED = " \\"  # ends a line of a command that continues on the next one
HELP_COLUMN = 26  # where help texts begin: most option names then fit on the same line, in 80 columns


def exit_code(
    run: Callable[[], int],
    say: Callable[[str], None],
    interrupted: str = "nothing was written",
    at_once: bool = False,
) -> int:
    """Run a command and return its exit code; interruptions and errors are reported, with hints where there are any.

    at_once: the command holds nothing but files, so an interruption may end it anywhere, see `ended_at_once`
    """
    try:
        with _InterruptionsAsSuch(), ended_at_once(f"interrupted: {interrupted}") if at_once else nullcontext():
            return run()
    except KeyboardInterrupt:
        say(f"interrupted: {interrupted}")
        return EXIT_INTERRUPTED
    except ImportError as error:
        missing = missing_extra(error, "this command")
        if missing is None:
            raise
        say(f"error: {missing}")
        return missing.exit_code
    except PlannerError as error:
        say(f"error: {error}")
        for hint in error.hints if isinstance(error, Refusal) else ():
            say(f"try: {hint}")
        return error.exit_code


class _InterruptionsAsSuch:
    """After an interruption, turns any exception but our own errors back into KeyboardInterrupt: C code that called
    Python may have replaced it."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if was_interrupted() and isinstance(error, Exception) and not isinstance(error, PlannerError):
            raise KeyboardInterrupt from error


class _Help(argparse.HelpFormatter):
    """Wraps paragraphs, but leaves indented lines (examples and exit codes) as they are."""

    def __init__(self, prog: str, width: int | None = None) -> None:
        wide = min(HELP_WIDTH, shutil.get_terminal_size().columns - 2) if width is None else width
        super().__init__(prog, max_help_position=HELP_COLUMN, width=wide)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = text.splitlines()
        return "\n".join(line if line.startswith(" ") else textwrap.fill(line, width) for line in lines)


class Command(argparse.ArgumentParser):
    """The parser of a command: description, options, examples and exit codes in one style, and `--version`.

    examples  arguments after `python -m planner.<name>` or `beadwise <name>` → what they do
    codes     exit code → when it is returned
    notes     closing paragraphs
    """

    def __init__(
        self,
        name: str,
        description: str,
        examples: Mapping[str, str],
        codes: Mapping[int, str],
        notes: Sequence[str] = (),
    ) -> None:
        prog = (
            f"beadwise {name.rpartition('.')[2]}"
            if Path(sys.argv[0]).name == "beadwise"
            else f"python -m planner.{name}"
        )
        self.examples = {f"{prog} {given}".rstrip(): what for given, what in examples.items()}
        self.codes, self.notes = codes, notes
        shown = [_lines(typed, 2, CONTINUED) + "\n" + _lines(what, 6) for typed, what in self.examples.items()]
        ends = [_lines(f"{code:<4} {when}", 2, later=7) for code, when in codes.items()]
        epilog = "\n".join(["examples:", *shown, "", "exit codes:", *ends, *(f"\n{note}" for note in notes)])
        super().__init__(prog=prog, description=description, epilog=epilog, formatter_class=_Help)
        told = f"beadwise {version('beadwise')}"
        self._negative_number_matcher = NEGATIVE
        self.add_argument("--version", action="version", version=told, help="print the version and exit")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in argparse; an unknown option is reported with the one that was probably meant."""
        options, unknown = self.parse_known_args(args, namespace)
        if unknown:
            known = [name for action in self._actions for name in action.option_strings]
            near = nearest_name(unknown[0].partition("=")[0], known) if unknown[0].startswith("-") else None
            hint = f" (did you mean {near}?)" if near else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return options

    def page(self) -> str:
        """The help, HELP_WIDTH columns wide whatever the terminal's width."""
        formatter, self.formatter_class = self.formatter_class, partial(_Help, width=HELP_WIDTH)
        try:
            return self.format_help()
        finally:
            self.formatter_class = formatter

    def error(self, message: str) -> NoReturn:
        """As in argparse, with a pointer to --help."""
        super().error(f"{message}; --help lists arguments and options")


def _lines(text: str, indent: int, glue: str = "", later: int = 6) -> str:
    """Text wrapped and indented, lines after the first by `later`; `glue` ends lines that continue."""
    wide = HELP_WIDTH - len(glue)
    return f"{glue}\n".join(
        textwrap.wrap(text, wide, initial_indent=" " * indent, subsequent_indent=" " * later, break_on_hyphens=False)
    )


def yaml_file(text: str) -> Path:
    """Argument type: the path of a YAML file, which need not exist yet."""
    path = Path(text)
    if path.suffix not in (".yaml", ".yml"):
        raise argparse.ArgumentTypeError(f"{text!r} does not end in .yaml")
    return path


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """Argument type: one of some names; the nearest is suggested for any other."""

    def check(text: str) -> str:
        if text in names:
            return text
        near = nearest_name(text, names)
        meant = f"did you mean {near}? " if near else ""
        raise argparse.ArgumentTypeError(f"{text!r} is unknown: {meant}choices: {', '.join(names)}")

    return check


def some_of(names: Sequence[str], least: int = 0) -> Callable[[str], tuple[str, ...]]:
    """Argument type: `least` or more of the names, each at most once, separated by commas."""

    def check(text: str) -> tuple[str, ...]:
        found = tuple(name.strip() for name in text.split(",") if name.strip())
        if len(found) < least or len(set(found)) < len(found) or not set(found) <= set(names):
            raise argparse.ArgumentTypeError(f"{text!r}: give each of {','.join(names)} at most once")
        return found

    return check


def number_within(text: str, low: float, high: float, what: str) -> float:
    """An option's number from low to high. Raises ArgumentTypeError, which says what it should be."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what} from {low:g} to {high:g}")
    return value
