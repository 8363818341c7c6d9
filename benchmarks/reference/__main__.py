"""Write the references that are made from the code: JSON schemas, and pages of every key, metric and command.

python -m benchmarks.reference all      all of them below docs/, as they are committed
python -m benchmarks.reference schema   print the JSON schema of the problem file
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.command import parser_of, told
from benchmarks.reference.fields import problem_page, robot_page
from benchmarks.reference.pages import commands_page, metrics_page
from benchmarks.reference.schema import problem_schema, robot_schema
from planner.base.errors import OutputError

# What can be made: its file below docs/, and its text.
MADE: dict[str, tuple[str, Callable[[], str]]] = {
    "schema": ("problem.schema.json", problem_schema),
    "robot-schema": ("robot.schema.json", robot_schema),
    "problem": ("reference/problem_file.md", problem_page),
    "robot": ("reference/robot_file.md", robot_page),
    "metrics": ("reference/metrics.md", metrics_page),
    "commands": ("reference/commands.md", commands_page),
}


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("reference", __doc__)
    parser.add_argument("what", choices=("all", *MADE), metavar="WHAT", help=f"all, or one of {', '.join(MADE)}")
    parser.add_argument("--out", type=Path, default=Path("docs"), metavar="DIR", help="where all goes (default docs)")
    options = parser.parse_args(arguments)
    if options.what != "all":
        sys.stdout.write(MADE[options.what][1]())
        return 0
    for file, make in MADE.values():
        path = options.out / file
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(make(), encoding="utf-8", newline="\n")
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}") from error
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
