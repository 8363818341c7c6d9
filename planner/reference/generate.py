"""The references that are made from the code.

python -m planner.reference all
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from planner.base.command_line import exit_code
from planner.base.errors import EXIT_VERIFIED, OutputError
from planner.reference.command import FILES, reference_command
from planner.reference.fields import problem_page, robot_page
from planner.reference.pages import commands_page, metrics_page
from planner.reference.schema import problem_schema, robot_schema

TEXTS: dict[str, Callable[[], str]] = {
    "schema": problem_schema,
    "robot-schema": robot_schema,
    "problem": problem_page,
    "robot": robot_page,
    "metrics": metrics_page,
    "commands": commands_page,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = reference_command().parse_args(arguments)
    return exit_code(lambda: _run(options), lambda text: print(text, file=sys.stderr))


def _run(options: argparse.Namespace) -> int:
    if options.what != "all":
        sys.stdout.write(TEXTS[options.what]())
        return EXIT_VERIFIED
    for name, file in FILES.items():
        path = options.out / file
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(TEXTS[name](), encoding="utf-8", newline="\n")
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from error
        print(path)
    return EXIT_VERIFIED
