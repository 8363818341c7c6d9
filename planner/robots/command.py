"""`python -m planner.robots`: list robots, describe one in full, or add one from a published URDF."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from planner.base.command_line import Command, exit_code, one_of, yaml_file
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.planning.files import write
from planner.problem.settings import LANGUAGE_NAMES
from planner.robots import listing
from planner.robots.adding import added
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
            "ur.urdf.xacro name:=ur5e ur_type:=ur5e": "from one that must be told which arm to make",
            "two_arms.urdf --tip left_tool0 --no-print": "one of two arms; no print is planned",
        },
        {
            0: "written; the print is verified, or was not requested",
            2: "wrong input, or an arm that cannot be planned with; nothing written",
            3: "written, but no print was verified; the reason is printed",
        },
    )
    parser.add_argument(
        "urdf", type=Path, metavar="URDF", help="the URDF, or a xacro file; its meshes stay where they are"
    )
    parser.add_argument(
        "arguments",
        nargs="*",
        type=_argument,
        metavar="NAME:=VALUE",
        help="arguments of a xacro file, as xacro takes them",
    )
    parser.add_argument("--out", type=yaml_file, metavar="FILE", help="the file to write, my_robot.yaml")
    parser.add_argument("--tip", metavar="LINK", help="the link that is the flange, if it is not found automatically")
    parser.add_argument(
        "--language", type=one_of(LANGUAGE_NAMES), metavar="NAME", help="what its controller is programmed in"
    )
    parser.add_argument("--no-print", action="store_true", help="do not plan a print")
    return parser


def _argument(text: str) -> tuple[str, str]:
    name, given, value = text.partition(":=")
    if not name or not given:
        raise argparse.ArgumentTypeError(f"{text!r} is not an argument of a xacro file: write name:=value")
    return name, value


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] != ["add"]:
        return listing.main(given)
    options = add_command().parse_args(given[1:])
    errors = Console(stderr=True, highlight=False)
    say = partial(errors.print, markup=False, soft_wrap=True)
    return exit_code(
        lambda: _add(options, errors),
        say,
        "the robot's file is complete if its name was printed, its trial print is not",
    )


def _add(options: argparse.Namespace, errors: Console) -> int:
    say = partial(errors.print, markup=False, soft_wrap=True)
    arguments, tried = dict(options.arguments), not options.no_print
    file, made = added(options.urdf, options.out, options.tip, options.language, arguments, tried)
    for note in (*made.found.notes, *made.touch.notes):
        say(f"  {note}")
    for part in listing.details(file, made.robot):
        errors.print(part, markup=False, soft_wrap=True) if isinstance(part, str) else errors.print(part)
    print(file)
    if options.no_print:
        return EXIT_VERIFIED
    say("planning a spiral on a cap, first in one place, then in others …")
    return _told(trial(made.robot, file, made.found.outwards), file, say)


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
