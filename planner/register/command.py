"""Where the part really is: its placement, from touched places or a scan, written into a copy of the problem.

python -m planner.register contacts.csv fibre_bowl
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from planner.base.command_line import Command, exit_code, some_of
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, OutputError
from planner.planning.options import add_problem
from planner.problem import Problem, load_problem
from planner.problem.clouds import CLOUD_UNITS
from planner.problem.rewrite import Value, write_changed
from planner.register.finding import (
    Ask,
    Scene,
    as_published,
    freedoms_of,
    plan_contacts,
    register,
    scene_of,
    suggest_next,
)
from planner.register.fitting import FREEDOMS
from planner.register.places import APART
from planner.register.scans import SCANS, is_scan, register_scan
from planner.register.telling import (
    KINDS,
    changes_of,
    lines_of,
    place_words,
    published_lines,
    verdict,
    write_picture,
)

TOLERANCE_MM = 0.1  # a fifth of the thinnest layers of shipped problems
MOST_SUGGESTED = 100


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = _options(arguments)
    run = partial(_run if options.contacts is not None else _suggest, options)
    return exit_code(run, partial(print, file=sys.stderr))


def _run(options: argparse.Namespace) -> int:
    problem = load_problem(options.problem)
    target = options.out or Path(f"{problem.file.stem}_registered.yaml")
    _check_target(target)
    scene = scene_of(problem, options.nozzle)
    if options.published:
        return _published(options, scene, target)
    ask = _ask(options)
    scan = is_scan(options.contacts)
    found = (
        register_scan(scene, options.contacts, ask, options.unit) if scan else register(scene, options.contacts, ask)
    )
    fit = found.fit
    changes = changes_of(problem, fit.placement, scene.start, freedoms_of(problem, ask))
    lines = lines_of(found, changes, None if scan else suggest_next(found))
    good, sentence = verdict(found, options.tolerance)
    _write(problem, changes, target)
    print("\n".join([*lines, sentence, f"written to {target}"]))
    if options.report is not None:
        write_picture(found, options.tolerance, sentence, lines, options.report)
    return EXIT_VERIFIED if good else EXIT_NOT_VERIFIED


def _published(options: argparse.Namespace, scene: Scene, target: Path) -> int:
    """Place table and cylinder by the published equation."""
    found = as_published(scene, options.contacts, options.ball_mm * 1e-3)
    changes = changes_of(scene.problem, found.placement, scene.start, ("x", "y"))
    _write(scene.problem, changes, target)
    print("\n".join([*published_lines(found, changes), f"written to {target}"]))
    return EXIT_VERIFIED if found.off <= options.tolerance else EXIT_NOT_VERIFIED


def _write(problem: Problem, changes: Mapping[str, Value], target: Path) -> None:
    """Write the new problem; remove it and raise InputError if it is not valid, such as with a part that is nowhere."""
    write_changed(problem, changes, target)
    try:
        load_problem(target)
    except InputError:
        target.unlink()
        raise


def _suggest(options: argparse.Namespace) -> int:
    """Print where to touch first."""
    scene = scene_of(load_problem(options.problem), options.nozzle)
    places, chosen = plan_contacts(scene, _ask(options), options.suggest)
    print("\n".join(f"{i}: {place_words(scene, places, k, scene.start)}" for i, k in enumerate(chosen, 1)))
    if len(chosen) < options.suggest:
        few = f"{len(chosen)} of {options.suggest}: no other place in reach is {APART * 1e3:g} mm from all of these"
        print(few, file=sys.stderr)
    return EXIT_VERIFIED


def _check_target(target: Path) -> None:
    """Before anything is computed, raise OutputError for a target that exists: nothing is overwritten."""
    if target.exists():
        raise OutputError(f"{target} is there already, and stays as it is: name another with --out")


def _ask(options: argparse.Namespace) -> Ask:
    return Ask(
        free=options.free, table=options.table, size=options.size, ball=options.ball_mm * 1e-3, noise=options.noise
    )


def register_command() -> Command:
    """The parser of `python -m planner.register`."""
    parser = Command(
        "register",
        "Find where the part is from places that the nozzle touched, or from a scan, and write a problem file that says so.",
        {
            "my_part.yaml --suggest 8": "where to touch first",
            "contacts.csv my_part.yaml": "place the part; writes my_part_registered.yaml",
            "scan.ply my_part.yaml": "the same from a scan, thousands of points in the world",
            "contacts.csv my_part.yaml --free x,y,z --report fit.html": "only shifts, with a figure of the residuals",
        },
        {
            0: "placed, and the nozzle's height keeps the tolerance",
            2: "wrong input; nothing written",
            3: "placed and written, but the nozzle's height may not keep the tolerance",
            130: "interrupted",
        },
    )
    parser.add_argument(
        "contacts",
        nargs="?",
        type=Path,
        metavar="CONTACTS.csv",
        help=f"readings of the touched places; or a scan, a cloud of points in the world ({', '.join(SCANS)})",
    )
    add_problem(parser)
    parser.add_argument("--out", type=Path, metavar="NEW.yaml", help="default: <problem>_registered.yaml, here")
    parser.add_argument(
        "--report", type=_picture, metavar="FILE", help="a figure, .html or .png, of residuals and certainty"
    )
    parser.add_argument(
        "--tolerance-mm",
        metavar="MM",
        dest="tolerance",
        type=_millimetres,
        default=TOLERANCE_MM * 1e-3,
        help=f"of the nozzle's height over the part (default {TOLERANCE_MM})",
    )
    parser.add_argument(
        "--free",
        type=some_of(FREEDOMS),
        metavar="NAMES",
        help="freedoms of the part, of x,y,z,rx,ry,rz (default all; of a cylinder x,y)",
    )
    parser.add_argument("--table", action="store_true", help="find the table's axis, too: touch at several angles")
    parser.add_argument(
        "--published",
        action="store_true",
        help="a cylinder on a turntable by Pollard et al., eq. (1): contacts from one side, with the nozzle's direction",
    )
    parser.add_argument("--size", action="store_true", help="find the radius of a cylinder or a sphere, too")
    parser.add_argument(
        "--nozzle", metavar="NAME", default="", help="which of several nozzles touches (default: the first)"
    )
    parser.add_argument(
        "--ball-mm", metavar="MM", type=float, default=0.0, help="radius of what touches, at the tip (default 0)"
    )
    parser.add_argument(
        "--noise-mm", metavar="MM", dest="noise", type=_millimetres, help="of one touch, if known (standard deviation)"
    )
    parser.add_argument("--unit", choices=CLOUD_UNITS, help="of a scan (default: as its header says, else mm)")
    parser.add_argument("--suggest", type=int, metavar="N", help="without contacts: where to touch first, N places")
    return parser


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = register_command()
    options: argparse.Namespace = parser.parse_args(arguments)
    if (options.contacts is None) != (options.suggest is not None):
        parser.error("give CONTACTS.csv and PROBLEM, or --suggest N and PROBLEM")
    if options.published and (
        options.contacts is None or options.free or options.table or options.size or options.report
    ):
        parser.error(
            "--published finds the table and the cylinder on it: leave out --free, --table, --size and --report"
        )
    scan = options.contacts is not None and is_scan(options.contacts)
    if scan and (options.published or options.table or options.ball_mm or options.nozzle):
        parser.error(
            "a scan shows the part at one angle and touches nothing: leave out --published, --table, --ball-mm and --nozzle"
        )
    if options.unit and not scan:
        parser.error(f"--unit is for a scan: {', '.join(SCANS)}")
    if options.suggest is not None and not 1 <= options.suggest <= MOST_SUGGESTED:
        parser.error(f"--suggest: 1 to {MOST_SUGGESTED}")
    if not 0.0 <= options.ball_mm <= 50.0:
        parser.error("--ball-mm: 0 to 50")
    return options


def _millimetres(text: str) -> float:
    """A positive length in mm as metres."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= 100.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a length between 0 and 100 mm")
    return value * 1e-3


def _picture(text: str) -> Path:
    path = Path(text)
    if path.suffix not in KINDS:
        raise argparse.ArgumentTypeError(f"{text!r} ends neither in {' nor in '.join(KINDS)}")
    return path
