"""The problems that ship, as columns of text: what each is, read off its file."""

from __future__ import annotations

import itertools
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

from planner.problem import Problem, load_problem, shipped_problems
from planner.problem.file import PROBLEMS

MODELINE = "# yaml-language-server:"  # for editors
_SENTENCE_END = re.compile(r"\.(?= [A-Z0-9]|$)")  # not the one of "et al." within a sentence
_GAP, _BELOW = "  ", "    "
NARROWEST = 40  # characters: where less is left beside the other columns, the text stands below them


class Shipped(NamedTuple):
    """One line: the name, the arm, what holds the part, what is printed on or from, and a sentence with its source."""

    name: str
    arm: str
    held_by: str
    part: str
    what: str


def shipped() -> list[Shipped]:
    """What ships, in order of names."""
    return [_of(load_problem(name)) for name in shipped_problems()]


def _of(problem: Problem) -> Shipped:
    positioner = problem.cell.positioner
    held_by = "bed" if positioner is None else str(positioner.robot)
    return Shipped(problem.name, str(problem.cell.arm), held_by, part_words(problem), title_of(problem.name))


def part_words(problem: Problem) -> str:
    """What is printed on, in a word; what it is printed from where that is a body of its own."""
    if problem.part is not None:
        return problem.part.body
    source = problem.layers.source
    names = ("waypoints", "gcode", "mesh", "aerofoil", "naca")
    return next(name for name in names if getattr(source, name, None) is not None)


def title_of(name: str) -> str:
    """The first sentence of a shipped problem's first comment: what it is, with the paper that it is from."""
    lines = (PROBLEMS / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    comment = itertools.takewhile(lambda line: line.startswith("# "), lines)
    said = " ".join(line.removeprefix("# ") for line in comment if not line.startswith(MODELINE))
    first, *_ = _SENTENCE_END.split(said, maxsplit=1)
    return f"{first}." if first.endswith(" al") else first


def print_shipped() -> None:
    """Print one line for each: to a terminal with a heading, wrapped to its width; else plain, the name first."""
    rows = shipped()
    if not sys.stdout.isatty():
        print("\n".join(columns(rows, None)))
        return
    width = shutil.get_terminal_size().columns
    heading = Shipped("NAME", "ARM", "HELD BY", "PART", "WHAT")
    print("\n".join(columns([heading, *rows], width)))


def columns(rows: Sequence[Sequence[str]], width: int | None) -> list[str]:
    """Lines of text with the columns below each other.

    With a width the last column is wrapped to it, below the others where it would be narrow.
    """
    widths = [max(map(len, column)) for column in zip(*(row[:-1] for row in rows), strict=True)]
    indent = sum(widths) + len(_GAP) * len(widths)
    below = width is not None and width - indent < NARROWEST
    lines = []
    for row in rows:
        first = "".join(cell.ljust(size) + _GAP for cell, size in zip(row[:-1], widths, strict=True))
        start = len(_BELOW) if below else indent
        texts = [row[-1]] if width is None else textwrap.wrap(row[-1], max(width - start, NARROWEST))
        begun = [first, *(_BELOW + text for text in texts)] if below else [first + "".join(texts[:1])]
        lines += begun if below else [*begun, *(" " * start + text for text in texts[1:])]
    return [line.rstrip() for line in lines]
