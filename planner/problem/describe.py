"""A problem in words, for its reader: what a file says, and the shipped examples."""

from __future__ import annotations

import itertools
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from planner.base.shipped import PROBLEMS
from planner.problem.cell import NozzleSpec
from planner.problem.fields import Section, described
from planner.problem.problem import Problem, load_problem
from planner.problem.yaml_file import shipped_problems

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.toolpath.bead import Toolpath

MODELINE = "# yaml-language-server:"  # for editors
_SENTENCE_END = re.compile(r"\.(?= [A-Z0-9]|$)")  # not the one of "et al." within a sentence
_GAP, _BELOW = "  ", "    "
NARROWEST = 40  # characters: if less is left next to the other columns, the text goes below them

LONGEST_LIST = 6  # values: longer lists are not written out


class Shipped(NamedTuple):
    """A shipped problem in a line: name, arm, what holds the part, what is printed on or from, and what it is."""

    name: str
    arm: str
    held_by: str
    part: str
    what: str


def shipped() -> list[Shipped]:
    """The shipped problems, sorted by name."""
    return [_of(load_problem(name)) for name in shipped_problems()]


def _of(problem: Problem) -> Shipped:
    positioner = problem.cell.positioner
    held_by = "bed" if positioner is None else str(positioner.robot)
    return Shipped(problem.name, str(problem.cell.arm), held_by, part_words(problem), title_of(problem.name))


def part_words(problem: Problem) -> str:
    """The body printed on, in a word; or the source, if that is a body of its own."""
    if problem.part is not None:
        return problem.part.body
    source = problem.layers.source
    names = ("waypoints", "gcode", "mesh", "aerofoil", "naca")
    return next(name for name in names if getattr(source, name, None) is not None)


def title_of(name: str) -> str:
    """The first sentence of a shipped problem's first comment: what it is, with the paper it comes from."""
    lines = (PROBLEMS / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    comment = itertools.takewhile(lambda line: line.startswith("# "), lines)
    said = " ".join(line.removeprefix("# ") for line in comment if not line.startswith(MODELINE))
    first, *_ = _SENTENCE_END.split(said, maxsplit=1)
    return f"{first}." if first.endswith(" al") else first


def print_shipped() -> None:
    """Print a line per shipped problem: on a terminal, with a heading and wrapped to its width; else plain."""
    rows = shipped()
    if not sys.stdout.isatty():
        print("\n".join(columns(rows, None)))
        return
    width = shutil.get_terminal_size().columns
    heading = Shipped("NAME", "ARM", "HELD BY", "PART", "WHAT")
    print("\n".join(columns([heading, *rows], width)))


def columns(rows: Sequence[Sequence[str]], width: int | None) -> list[str]:
    """Rows as lines of text with aligned columns.

    With a width, the last column is wrapped to it, and goes below the others if it would be too narrow.
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


def lines_of(
    problem: Problem, cell: Cell, toolpath: Toolpath | None, first_layer: bool, expected: str | None = None
) -> list[str]:
    """What `planner.check` prints about a problem without mistakes; the toolpath may be that of the first layer alone.

    expected: what there is to plan, and how much time and memory that takes, in words
    """
    rows = {
        "arm": _robot(cell.arm_robot.name, problem.cell.arm),
        "nozzle": _nozzle(problem),
        "part held by": _held_by(problem, cell),
        **({"fixtures": ", ".join(problem.cell.fixtures)} if problem.cell.fixtures else {}),
        **({} if problem.part is None else {"part": words(problem.part)}),
        "layers": words(problem.layers),
        "beads": _beads(problem, toolpath, first_layer),
        **({} if expected is None else {"planning": expected}),
        "process": _process(problem),
        "strategy": problem.strategy,
    }
    wide = max(map(len, rows)) + 2
    notes = [f"note: {note}" for note in _notes(cell, toolpath)]
    end = f"nothing wrong found; python -m planner.solve {_again(problem)} plans it"
    return [
        f"{problem.name} ({problem.file})",
        *(f"  {label:<{wide}}{text}" for label, text in rows.items()),
        *notes,
        end,
    ]


def words(section: Section) -> str:
    """A section in words: the keys that were given, in the file's units."""
    return "; ".join(_said(section))


def _said(section: Section) -> Iterator[str]:
    fields = described(type(section))
    for name in type(section).model_fields:
        value = getattr(section, name)
        if name not in section.model_fields_set or value is None:
            continue
        key, shown = fields[name].key, fields[name].shown(value)
        if isinstance(shown, Section):
            inner = words(shown)
            yield inner if key == "source" else f"{key} ({inner})" if inner else key
        else:
            yield f"{key} {_value(shown)}"


def _value(value: Any) -> str:
    if isinstance(value, Path):
        return value.name
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(value)
    if isinstance(value, tuple):
        if len(value) > LONGEST_LIST or any(isinstance(each, Section) for each in value):
            return f"({len(value)} of them)"
        return f"[{', '.join(map(_value, value))}]"
    return str(value)


def _robot(name: str, given: str | Path) -> str:
    return f"{name} ({given})"


def _nozzle(problem: Problem) -> str:
    several = problem.cell.nozzles
    if several:
        return "; ".join(f"{name}: {_one_nozzle(nozzle, name)}" for name, nozzle in several.items())
    return _one_nozzle(problem.cell.nozzle, "")


def _one_nozzle(nozzle: NozzleSpec, name: str) -> str:
    key = f"cell.nozzles.{name}" if name else "cell.nozzle"
    away = np.linalg.norm(nozzle.tip) * 1e3
    head = f"; head: {', '.join(nozzle.head)}" if nozzle.head else ""
    assumed = "" if nozzle.profile is not None else f"; its outline is assumed ({key}.profile_mm)"
    return f"bore {nozzle.diameter * 1e3:g} mm, tip {away:.1f} mm from the flange's centre{head}{assumed}"


def _held_by(problem: Problem, cell: Cell) -> str:
    spec, robot = problem.cell.positioner, cell.holder_robot
    if spec is None or robot is None:
        at = _value(tuple(1e3 * value for value in problem.cell.bed or ()))
        return f"a fixed bed; the part frame's origin at {at} mm"
    slides = dict(zip(robot.joint_names, robot.slides, strict=True))
    held = ", ".join(
        f"{name} at {at * 1e3:g} mm" if slides[name] else f"{name} at {np.degrees(at):g} deg"
        for name, at in cell.held.items()
    )
    return f"{_robot(robot.name, spec.robot)}; free: {', '.join(spec.free) or 'none'}" + (
        f"; held: {held}" if held else ""
    )


def _beads(problem: Problem, toolpath: Toolpath | None, first_layer: bool) -> str:
    if toolpath is None:
        return "not worked out here, since that takes seconds: --toolpath"
    n, length = len(toolpath.beads), toolpath.length
    speeds = [bead.commanded(problem.process.speed) for bead in toolpath.beads]
    seconds = sum(bead.length / speed for bead, speed in zip(toolpath.beads, speeds, strict=True))
    time = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"
    at = " to ".join(f"{speed * 1e3:.3g}" for speed in sorted({min(speeds), max(speeds)}))
    size = f"{n} bead{'' if n == 1 else 's'}, {length:.2f} m, {time} at {at} mm/s"
    if first_layer:
        return f"{size}, in the first layer alone (all layers: --toolpath)"
    return f"{size}, in {toolpath.layers} layer{'' if toolpath.layers == 1 else 's'}"


def _process(problem: Problem) -> str:
    process, bead = problem.process, problem.process.bead
    high = "" if np.isnan(bead.height) else f" by {bead.height * 1e3:g}"
    materials = f"; materials: {', '.join(process.materials)}" if process.materials else ""
    fibre = "; continuous fibre" if process.fibre is not None else ""
    return f"{process.speed * 1e3:g} mm/s, bead {bead.width * 1e3:g}{high} mm ({process.section}){materials}{fibre}"


def _notes(cell: Cell, toolpath: Toolpath | None) -> list[str]:
    robots = [robot for robot in (cell.arm_robot, cell.holder_robot) if robot is not None]
    by_name = {robot.name: ", ".join(robot.assumed) for robot in robots if robot.assumed}
    assumed = [f"assumed of {name}: {what}" for name, what in by_name.items()]
    return [*assumed, *(() if toolpath is None else toolpath.notes)]


def _again(problem: Problem) -> str:
    """How to name the problem on the command line: by name if it ships, else by its file."""
    return problem.name if problem.file.parent == PROBLEMS else str(problem.file)
