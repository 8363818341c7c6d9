"""`python -m planner.robots`: list robots, tell all of one, or add one's own from a published URDF."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from planner.base.command_line import Command, exit_code, one_of, yaml_file
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, OutputError
from planner.cell import robots_command
from planner.cell.robot import Robot, read_robot
from planner.cell.urdf import Urdf, parse_urdf, read_urdf
from planner.planning.pipeline import write
from planner.problem.settings import LANGUAGE_NAMES
from planner.robots.files import robot_text
from planner.robots.survey import Survey, expanded, key_of, survey
from planner.robots.touching import NOTHING, Touching, touching
from planner.robots.trial import Trial, trial


def add_command() -> Command:
    """The parser of `python -m planner.robots add`."""
    parser = Command(
        "robots add",
        "Make a robot's file from its URDF: find its flange, its inverse kinematics and the links that touch as hulls "
        "only, say what is assumed, and plan a small print with it.",
        {
            "kr10r1420.urdf": "write kuka_kr10r1420.yaml here, named as the robot in the URDF, and try it",
            "gp25.xacro --out gp25.yaml": "from a xacro file, with the package xacrodoc",
            "two_arms.urdf --tip left_tool0 --no-print": "one of two arms; no print is planned",
        },
        {
            0: "written, and the print is verified, or was not asked for",
            2: "wrong input, or an arm that cannot be planned with; nothing written",
            3: "written, but no print was verified; the reason is told",
        },
    )
    parser.add_argument(
        "urdf", type=Path, metavar="URDF", help="the URDF, or a xacro file; its meshes stay where they are"
    )
    parser.add_argument("--out", type=yaml_file, metavar="FILE", help="the file to write, my_robot.yaml")
    parser.add_argument("--tip", metavar="LINK", help="the link that is the flange, if it is not found by itself")
    parser.add_argument(
        "--language", type=one_of(LANGUAGE_NAMES), metavar="NAME", help="what its controller is programmed in"
    )
    parser.add_argument("--no-print", action="store_true", help="do not plan a print")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] != ["add"]:
        return robots_command.main(given)
    options = add_command().parse_args(given[1:])
    errors = Console(stderr=True, highlight=False)
    return exit_code(lambda: _add(options, errors), partial(errors.print, markup=False, soft_wrap=True))


@dataclass(frozen=True)
class Added:
    """A robot whose file was written: what was found of it, of its bodies, and the robot as it is read."""

    found: Survey
    touch: Touching
    robot: Robot


def added(urdf: Path, file: Path | None, tip: str | None = None, language: str | None = None) -> tuple[Path, Added]:
    """Write a robot's file from its URDF, named after the robot in this folder if no name is given; returns where.

    Raises InputError for a URDF that cannot be planned with, and OutputError where the file cannot be written; then
    nothing is.
    """
    read, text = _read(urdf)
    found = survey(read, tip)
    file = file or Path(f"{key_of(found.name)}.yaml")
    if not file.parent.is_dir():
        raise OutputError(f"there is no folder {file.parent}")
    if file.exists():
        raise OutputError(f"{file} is there already, and stays as it is: --out gives another name")
    source = urdf
    if text is not None:
        # beside the xacro file, from where its meshes are found
        source = urdf.with_suffix(".urdf")
        if source.exists() and source.read_text(encoding="utf-8") != text:
            raise OutputError(
                f"{source} is there already, and is not what xacro makes: remove it, or add it in its place"
            )
    try:
        if text is not None:
            source.write_text(text, encoding="utf-8")
        # plainly first: what its bodies are like is looked at as it is read
        file.write_text(robot_text(found, NOTHING, source, file, language), encoding="utf-8")
        robot = read_robot(file)
        touch = touching(read, robot)
        file.write_text(robot_text(found, touch, source, file, language), encoding="utf-8")
        return file, Added(found, touch, read_robot(file))
    except (OSError, InputError) as error:
        file.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(f"cannot write {error.filename}: {error.strerror}") from error
        raise


def _add(options: argparse.Namespace, errors: Console) -> int:
    say = partial(errors.print, markup=False, soft_wrap=True)
    file, made = added(options.urdf, options.out, options.tip, options.language)
    for note in (*made.found.notes, *made.touch.notes):
        say(f"  {note}")
    for part in robots_command.details(file, made.robot):
        errors.print(part, markup=False, soft_wrap=True) if isinstance(part, str) else errors.print(part)
    print(file)
    if options.no_print:
        return EXIT_VERIFIED
    say("planning a spiral on a cap, first in one place, then in others …")
    return _told(trial(made.robot, file, made.found.outwards), file, say)


def _read(path: Path) -> tuple[Urdf, str | None]:
    """The URDF, and its text where xacro made it."""
    if path.suffix != ".xacro":
        return read_urdf(path), None
    if not path.is_file():
        raise InputError("there is no such file", file=path)
    text = expanded(path)
    return parse_urdf(text.encode(), path.with_suffix(".urdf")), text


def _told(made: Trial, file: Path, say: partial[None]) -> int:
    if made.plan is None:
        say(f"no print was verified: {made.reason}")
        return EXIT_NOT_VERIFIED
    problem_file = file.with_name(f"{made.name}.yaml")
    problem_file.write_text(made.text, encoding="utf-8")
    folder = file.parent / "out" / made.name
    folder.parent.mkdir(exist_ok=True)
    write(made.plan, folder)
    m, speed = made.plan.metrics, made.plan.problem.process.speed
    say(
        f"verified: {m['deposited_length_mm']:.0f} mm laid in {m['deposition_time_s']:.1f} s, "
        f"{m['at_speed_fraction']:.0%} of it at {1e3 * speed:g} mm/s; least clearance {m['clearance_min_mm']:.0f} mm, "
        f"singularity margin {m['sigma_min']:.2f}"
    )
    print(problem_file)
    print(folder / "report.html")
    return EXIT_VERIFIED
