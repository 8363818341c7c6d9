"""Read a problem and everything it names, without planning it: report what it says, and what is wrong with it.

python -m planner.check cylinder_logo.yaml
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planner.base.command_line import Command, exit_code
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, Complaint, InputError
from planner.planning.options import add_problem, add_set
from planner.problem import Problem, load_problem
from planner.problem.drawings import ProjectedLayersSpec, WrappedLayersSpec
from planner.problem.layers import GcodeLayersSpec, WaypointLayersSpec
from planner.problem.rewrite import paths_in

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.toolpath.bead import Toolpath
    from planner.toolpath.workload import Workload

# Numba, Pinocchio and file readers take most of a second to import, so they are imported only once the problem itself
# is right.


QUICK_WAYPOINTS = 50_000  # of a layer: rounded in some 3 s
QUICK_BYTES = 20_000_000  # of G-code and waypoints: read in some 4 s


@dataclass(frozen=True)
class Examination:
    """What was found: the cell and the toolpath, if they could be made, and all mistakes.

    first_layer  whether the toolpath is that of the first layer alone
    work         what there is to plan in all layers, if that is known
    """

    cell: Cell | None
    toolpath: Toolpath | None
    first_layer: bool
    mistakes: tuple[InputError, ...]
    work: Workload | None = None


def examine(problem: Problem, whole: bool = False) -> Examination:
    """Read every file that a problem names, and make its cell and, if that is quick or `whole` is set, its toolpath.

    Curves and files of points are quick; of several layers only the first one is made. Each file is checked even if
    another one has a mistake.
    """
    mistakes: list[InputError] = []
    cell = _tried(mistakes, lambda: _cell(problem))
    if cell is not None:
        _tried(mistakes, lambda: _check_cell(problem, cell))
    elif problem.cell.positioner is not None:  # mistakes in the arm are reported first
        robot = problem.cell.positioner.robot
        _tried(mistakes, lambda: _robot(problem, "cell.positioner.robot", robot))
    _tried(mistakes, lambda: _check_arrangement(problem))
    quick = is_quick(problem)
    count = getattr(problem.layers, "count", 1)  # None: all layers of a file
    first = quick and not whole and (count is None or count > 1)
    toolpath, work = None, None
    if quick and not whole:
        told = len(mistakes)
        work = _tried(mistakes, lambda: _foreseen(problem))
        quick = len(mistakes) == told and (work is None or work.waypoints <= QUICK_WAYPOINTS * work.layers)
    if quick or whole:
        toolpath = _tried(mistakes, lambda: _toolpath(one_layer(problem) if first else problem))
        if toolpath is not None and not first:
            work = _work(toolpath)
            _tried(mistakes, lambda: _check_corrections(problem, toolpath))
        if cell is not None and toolpath is not None:
            _tried(mistakes, lambda: _check_cones(problem, cell, toolpath))
    read = {"cell"}  # sections whose files have been read by now
    if quick or whole or is_quick(problem):
        read |= {"layers", "part"} | (set() if first else {"as_printed", "as_run"})
    for keys, path in paths_in(problem):
        if keys[0] not in read:
            _tried(mistakes, partial(_read, problem, ".".join(map(str, keys)), path))
    return Examination(cell, toolpath, first and toolpath is not None, tuple(mistakes), work)


def is_quick(problem: Problem) -> bool:
    """Whether one layer of a problem's toolpath can be made in a fraction of a second."""
    layers, body = problem.layers, None if problem.part is None else problem.part.body
    if isinstance(layers, WaypointLayersSpec):
        given = layers.source.waypoints
        return not isinstance(given, Path) or _bytes(given) <= QUICK_BYTES
    if isinstance(layers, GcodeLayersSpec):
        return _bytes(layers.source.gcode) <= QUICK_BYTES
    if isinstance(layers, WrappedLayersSpec):
        return True
    return isinstance(layers, ProjectedLayersSpec) and body not in ("mesh", "scan", "step")


def _bytes(path: Path) -> int:
    """The size of a file; 0 if it is missing, which its reader reports."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def one_layer(problem: Problem) -> Problem:
    """The problem with its first layer alone, and without settings that concern others."""
    process = problem.process.model_copy(update={"speeds": (), "layer_time": None, "pauses": (), "order": ()})
    layers = problem.layers.model_copy(update={"count": 1})
    return problem.model_copy(update={"layers": layers, "process": process, "as_printed": None, "as_run": None})


def _tried(mistakes: list[InputError], make: Callable[[], Any]) -> Any:
    """The result of `make`; None, with the mistake noted, if it fails."""
    try:
        return make()
    except InputError as error:
        if str(error) not in map(str, mistakes):
            mistakes += error.all or (error,)
        return None


def _robot(problem: Problem, field: str, robot: str | Path) -> None:
    from planner.cell.robot import load_robot

    load_robot(robot, problem, field)


def _cell(problem: Problem) -> Cell:
    from planner.cell.cell import build_cell

    return build_cell(problem)


def _check_cell(problem: Problem, cell: Cell) -> None:
    from planner.export.languages import check_languages
    from planner.verify.collision import check_start

    check_languages(problem, cell)
    check_start(problem, cell)


def _check_arrangement(problem: Problem) -> None:
    from planner.toolpath.build import check_arrangement

    check_arrangement(problem)


def _toolpath(problem: Problem) -> Toolpath:
    from planner.toolpath.build import build_toolpath
    from planner.toolpath.task import tasks_of

    toolpath = build_toolpath(problem)
    if problem.process.fibre is not None:  # which requires beads of some length
        tasks_of(problem, toolpath)
    return toolpath


def _check_corrections(problem: Problem, toolpath: Toolpath) -> None:
    if problem.as_run is not None and not problem.process.split_beads:  # pieces are known only once they are planned
        from planner.motion.as_run import corrections_of

        corrections_of(problem, toolpath)


def _foreseen(problem: Problem) -> Workload | None:
    from planner.toolpath.foreseen import foreseen

    return foreseen(problem)


def _work(toolpath: Toolpath) -> Workload:
    from planner.toolpath.workload import Workload

    return Workload.of(toolpath)


def _check_cones(problem: Problem, cell: Cell, toolpath: Toolpath) -> None:
    if problem.process.cones.bound_to_gravity:
        from planner.resolve.least_lean import check_cones
        from planner.toolpath.task import tasks_of

        check_cones(problem, cell, tasks_of(problem, toolpath))


def _read(problem: Problem, field: str, path: Path) -> None:
    """Read one file that a problem names outside its cell. Raises InputError if it cannot be read."""
    where: Complaint = partial(problem.error, field)
    if field.endswith((".waypoints", ".gcode")):
        return  # too large to be read here
    if field == "as_printed.map" and problem.as_printed is not None:
        from planner.toolpath.as_printed import read_map

        read_map(path, problem.as_printed.smoothing, where)
    elif field == "as_run.corrections":
        from planner.motion.as_run import COLUMNS, read_columns

        read_columns(path, COLUMNS, where)
    elif field.endswith(".nurbs"):
        from planner.problem.curve_files import read_curves

        read_curves(path, where)
    elif field.endswith("aerofoil"):
        from planner.toolpath.wing.section import read_section

        read_section(path, where)
    elif field.startswith("part.step"):
        from planner.problem.cad_files import check_step

        check_step(path, where)
    elif field.startswith("part.scan") and problem.part is not None and problem.part.scan is not None:
        from planner.problem.clouds import read_scan

        read_scan(problem.part.scan, where)
    elif field.endswith((".mesh", ".file")):
        from planner.problem.mesh_files import read_corners

        read_corners(path, where)
    elif field.endswith(".dxf"):
        from planner.toolpath.dxf.reader import read_drawing

        read_drawing(path, where)
    else:
        from planner.toolpath.svg.document import read_document
        from planner.toolpath.svg.drawing import Drawing

        Drawing(read_document(path, where)).outlines()


def check_command() -> Command:
    """The parser of `python -m planner.check`."""
    parser = Command(
        "check",
        "Read a problem file and all files that it names, without planning anything: report what it says, and what is "
        "wrong with it.",
        {
            "cylinder_logo": "what a problem says: cell, part, layers, length, time",
            "my_part.yaml": "whether a problem of your own can be read; lists every mistake found",
            "my_part.yaml --set process.speed_mm_s=30": "with fields changed",
            "my_part.yaml --toolpath": "lay all beads too, which takes seconds for meshes, wings and faces",
        },
        {0: "it can be read; planner.solve finds out whether it can be printed", 2: "wrong input", 130: "interrupted"},
    )
    add_problem(parser)
    add_set(parser)
    parser.add_argument("--toolpath", action="store_true", help="lay the beads of all layers, however long that takes")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = check_command().parse_args(arguments)
    return exit_code(lambda: _run(options), _complain, at_once=True)


def _complain(text: str) -> None:
    print(text, file=sys.stderr)


def _run(options: argparse.Namespace) -> int:
    try:
        problem = load_problem(options.problem, options.set)
    except InputError as error:
        return _told(error.all or (error,))
    found = examine(problem, options.toolpath)
    if found.mistakes or found.cell is None:
        return _told(found.mistakes)
    from planner.problem.describe import lines_of

    print("\n".join(lines_of(problem, found.cell, found.toolpath, found.first_layer, _expected(problem, found))))
    return EXIT_VERIFIED


def _expected(problem: Problem, found: Examination) -> str | None:
    """What there is to plan, and the time and memory that planning takes, in words."""
    work, toolpath = found.work, None if found.first_layer else found.toolpath
    if work is None:
        return None
    from planner.planning.estimate import estimate
    from planner.planning.options import DEFAULT_DT
    from planner.toolpath.speeds import mean_speed, resting_time

    process = problem.process
    if toolpath is None:
        speed, resting = process.speed, process.start.time
    else:
        speed, resting = mean_speed(process, toolpath), resting_time(process, toolpath)
    size = f"{work.waypoints:,} waypoint{'' if work.waypoints == 1 else 's'}"
    return f"{size} in all; planning them takes {estimate(work, speed, DEFAULT_DT, resting).words}"


def _told(mistakes: Sequence[InputError]) -> int:
    for mistake in mistakes:
        _complain(f"error: {mistake}")
    if len(mistakes) > 1:
        _complain(f"{len(mistakes)} mistakes")
    return EXIT_INPUT
