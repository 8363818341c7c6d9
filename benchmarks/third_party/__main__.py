"""Write programs in every language, let parsers and interpreters of other people read them, and print what they say.

make third-party                                               sets up their environment and runs everything
python -m benchmarks.third_party [PROBLEM ...] [--set layers.count=1]

An interpreter's time, filament and path stand beside the plan's. Files stay in out/third_party. The exit code is 3 where
a tool refuses a file, is not installed, or counts other filament than planned.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from benchmarks.third_party.tools import PYTHON, TOOLS, Answer
from benchmarks.third_party.written import Planned, Written, written
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.planning.pipeline import solve
from planner.problem import load_problem

CASES: dict[str, tuple[str, ...]] = {
    "cylinder_logo": ("layers.count=1",),
    "peer_cap": (),
    "saddle_ring": (),
    # one command a line, for boards that take no more
    "fibre_plane": (
        "process.fibre.cut_code=[M106 P0 S1, G4 P500, M106 P0 S0, G4 P500]",
        "process.start.heat_wait_s=60",
    ),
}
OUT = Path("out/third_party")
COLUMNS = ("problem", "language", "files", "tool and version", "accepted", "it says", "time", "filament", "path")
FILAMENT = 0.01  # mm that an interpreter may count otherwise than planned: a few of its steps


def agrees(answer: Answer, planned: Planned) -> bool:
    """Whether a tool ran, takes the program, and counts its filament as planned."""
    off = 0.0 if answer.filament is None else abs(answer.filament - planned.filament)
    return bool(answer.accepted) and off <= FILAMENT


def answers(program: Written, python: Path) -> Iterator[tuple[str, str, Answer]]:
    """The files, the tool, and its answer, of all tools that read a program; one without an answer where none does."""
    found = False
    for tool in TOOLS:
        if tool.reads(program):
            found = True
            given = tool.answer(python, program)
            files = program.of(*tool.endings)
            name = files[0].name + (f" and {len(files) - 1} more" if len(files) > 1 else "")
            yield name, f"{tool.name} {given.version}".strip(), given
    if not found:
        why = program.reason and f"not written: {program.reason}"
        yield ", ".join(file.name for file in program.files), "", Answer("", None, why or "no parser to be had")


def cells(answer: Answer, planned: Planned) -> list[str]:
    """Accepted, what it says, and its figures beside those of the plan."""

    def beside(value: float | None, plan: float, unit: str) -> str:
        return "" if value is None else f"{value:.3f} {unit} ({value - plan:+.3f})"

    return [
        "" if answer.accepted is None else "yes" if answer.accepted else "no",
        answer.said,
        beside(answer.time, planned.time, "s"),
        beside(answer.filament, planned.filament, "mm"),
        beside(answer.path, planned.path, "mm"),
    ]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.third_party", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("problems", nargs="*", metavar="PROBLEM", help=f"default: {', '.join(CASES)}")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--python", type=Path, default=PYTHON, help="the parsers' own (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=OUT, metavar="FOLDER", help="default: %(default)s")
    options = parser.parse_args(arguments)
    title = "Other people's parsers; figures beside the plan's (differences)"
    table = Table(*COLUMNS, title=title, title_justify="left")
    code = EXIT_VERIFIED
    for name in options.problems or CASES:
        plan = solve(load_problem(name, [*CASES.get(name, ()), *options.set]))
        planned = Planned.of(plan)
        for program in written(plan, options.out / plan.name):
            for files, tool, answer in answers(program, options.python):
                table.add_row(plan.name, program.language, files, tool, *cells(answer, planned))
                if tool and not agrees(answer, planned):
                    code = EXIT_NOT_VERIFIED
    Console(width=240).print(table)
    return code


if __name__ == "__main__":
    sys.exit(main())
