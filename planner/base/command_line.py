"""What commands share: how their help looks, what their arguments may be, and how they end."""

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

# Begins a value, also of a list such as -10,20, in which parsers of Python 3.11 see an option.
NEGATIVE = re.compile(r"-\.?[0-9]")
HELP_WIDTH = 78  # columns of a help, however wide the terminal is
CONTINUED = " \\"  # ends a line of a command that goes on in the next one
HELP_COLUMN = 26  # where the text of an option begins, so that most names stand beside theirs at 80 columns


def exit_code(
    run: Callable[[], int],
    say: Callable[[str], None],
    interrupted: str = "nothing was written",
    at_once: bool = False,
) -> int:
    """The exit code of a command; whatever ends it before its time is said, an error with what would help.

    at_once: it holds nothing but files, so that an interruption may end it wherever it is, see `ended_at_once`
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
    """Whatever ends the block once an interruption has come is one, unless it is an error of ours: code in C that was
    calling Python makes others of it."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if was_interrupted() and isinstance(error, Exception) and not isinstance(error, PlannerError):
            raise KeyboardInterrupt from error


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

    examples  what somebody may type after `python -m planner.<name>`, or `beadwise <name>` → what it does
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


def yaml_file(text: str) -> Path:
    """The type of an argument that is the path of a YAML file, which need not be there yet."""
    path = Path(text)
    if path.suffix not in (".yaml", ".yml"):
        raise argparse.ArgumentTypeError(f"{text!r} does not end in .yaml")
    return path


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """The type of an argument that is one of some names; the nearest is suggested for any other."""

    def check(text: str) -> str:
        if text in names:
            return text
        near = nearest_name(text, names)
        meant = f"did you mean {near}? " if near else ""
        raise argparse.ArgumentTypeError(f"{text!r} is unknown: {meant}choices: {', '.join(names)}")

    return check


def some_of(names: Sequence[str], least: int = 0) -> Callable[[str], tuple[str, ...]]:
    """The type of an argument that is some of the names, `least` or more, each once, with commas between them."""

    def check(text: str) -> tuple[str, ...]:
        found = tuple(name.strip() for name in text.split(",") if name.strip())
        if len(found) < least or len(set(found)) < len(found) or not set(found) <= set(names):
            raise argparse.ArgumentTypeError(f"{text!r}: each of {','.join(names)} once at most")
        return found

    return check


def number_within(text: str, low: float, high: float, what: str) -> float:
    """A number from low to high; of an option's type. Raises ArgumentTypeError, which says what it should be."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what} from {low:g} to {high:g}")
    return value
