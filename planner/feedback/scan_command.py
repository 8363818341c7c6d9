"""Corrects the rest of a print by a scan of a layer's top: the layers above are planned on the scanned surface.

python -m planner.feedback.scan cylinder_logo cloud.ply --after-layer 4
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.command_line import Command, exit_code, number_within, some_of
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.base.results import results_folder
from planner.cell.cell import Cell, build_cell
from planner.feedback.height_map import HeightMap, check_size, height_map, planned_top
from planner.feedback.planned import planned_problem
from planner.feedback.scan_fit import CloudFit, fit_cloud
from planner.feedback.scan_telling import (
    MAP,
    PICTURE,
    bound_of,
    drawn_name,
    layer_heights,
    layer_widths,
    lines_of,
    remains,
    table_of,
    write_map,
    write_picture,
    write_problem,
)
from planner.planning.options import add_set, add_strategy
from planner.planning.solve_command import main as solve_main
from planner.problem import Problem
from planner.problem.clouds import CLOUD_UNITS, read_cloud
from planner.problem.rewrite import absolute_overrides
from planner.problem.yaml_file import Override
from planner.register.fitting import FREEDOMS
from planner.toolpath.as_printed import MOST_SHARE, beads_up_to
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath

RESULTS_BY = "scan"  # the command that owns the files, in manifests
WRITTEN = ("as_printed", "as_run", "name")  # keys for which the new problem file counts, not earlier overrides
SHARE = 0.3  # × a bead's height: within this, it adheres to the bead below and is not squeezed aside from above
SMOOTHED, SMOOTHED_MOST = 5.0, 15e-3  # bead widths, but at most m: a few cells, over which a print hardly bends
FRAMES = ("part", "plate", "world")  # of clouds
UNTAUGHT = "what runs taught (as_run) is left out: it belongs to the beads as they were before this scan"
_LENGTH = 1e-3  # relative tolerance between the lengths of a plan's beads and of its problem's


@dataclass(frozen=True)
class ScannedPlan:
    """What a scan is compared with: the problem, and its toolpath as drawn, without the results of earlier scans."""

    problem: Problem
    toolpath: Toolpath


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    options = scan_command().parse_args(arguments)
    return exit_code(partial(_run, options), partial(print, file=sys.stderr))


def _run(options: argparse.Namespace) -> int:
    plan = scanned_plan(options.plan, options.set)
    layer, complain = options.after_layer, partial(InputError, field="--after-layer")
    beads_up_to([bead.layer for bead in plan.toolpath.beads], layer, complain)
    most = bound_of(plan.toolpath, layer, options.share)
    radius = options.smoothing or radius_of(plan.toolpath)
    found, fit = _measured(options, plan, radius)
    heights = layer_heights(plan.toolpath, layer)
    name = drawn_name(plan.problem)
    folder = options.out or Path("out") / f"{name}_scanned_{layer}"
    target = f"{name}_after_{layer}.yaml"
    with results_folder(folder, RESULTS_BY) as fresh:
        write_map(found, fresh / MAP)
        write_picture(found, layer, heights, most, fresh / PICTURE)
        text = write_problem(plan.problem, found, layer, most, folder)
        (fresh / target).write_text(text, encoding="utf-8")
    widths = layer_widths(plan.toolpath, layer) if plan.problem.process.section == "rounded" else None
    table = table_of(found, heights, most, widths)
    told = [*fit_lines(fit), *lines_of(found, layer), *table, remains(found, heights, most)]
    told += [] if plan.problem.as_run is None else [UNTAUGHT]
    print("\n".join([*told, f"map, picture and problem of the remaining layers: {folder / target}"]), flush=True)
    if options.map_only:
        return EXIT_VERIFIED
    kept = (each.words for each in absolute_overrides(plan.problem) if each.path[0] not in WRITTEN)
    given = [str(folder / target), *(word for each in kept for word in ("--set", each))]
    given += ["--strategy", options.strategy] if options.strategy else []
    given += ["--quiet"] if options.quiet else []
    return solve_main([*given, *(["--out", str(folder)] if options.out else [])])


def radius_of(toolpath: Toolpath) -> float:
    """Default radius over which a map is smoothed [m]."""
    return min(SMOOTHED * float(np.mean([bead.width.mean() for bead in toolpath.beads])), SMOOTHED_MOST)


def _measured(options: argparse.Namespace, plan: ScannedPlan, radius: float) -> tuple[HeightMap, CloudFit | None]:
    """The height map of a cloud, and how the cloud was first moved onto the planned top, if requested."""
    complain = partial(InputError, file=options.cloud)
    cloud = in_part_frame(read_cloud(options.cloud, options.unit), options.frame, build_cell(plan.problem))
    top = planned_top(plan.toolpath, options.after_layer)
    fit = None
    if options.fit is not None:
        check_size(top, cloud, complain)
        fit = fit_cloud(top, cloud, options.fit, complain)
        cloud = fit.points
    return height_map(top, cloud, radius, complain), fit


def in_part_frame(points: Array, frame: str, cell: Cell) -> Array:
    """Transform points (n, 3) [m] from a frame of FRAMES to the part frame: from the part frame itself (the work object
    of programs), from the plate that carries the part, or from the world if nothing moves the part. Raises InputError
    for the world if a positioner moves the part."""
    if frame == "part":
        return points
    if frame == "world" and len(cell.holder):
        hint = "scan it in the frame of its plate (--frame plate), or of the part"
        raise InputError("the world frame does not locate a part that a positioner moves", field="--frame", hint=hint)
    T = cell.T_plate_part if frame == "plate" and cell.holder_robot is not None else cell.T_world_holder
    return np.asarray((points - T[:3, 3]) @ T[:3, :3])


def scanned_plan(given: str, overrides: Sequence[str | Override] = ()) -> ScannedPlan:
    """The problem and toolpath of a saved plan, a folder of results, a problem file, or a shipped problem's name.

    Raises InputError if the problem can no longer be found, differs from what was planned, or cannot be corrected.
    """
    path = Path(given)
    problem, plan = planned_problem(given)
    planned = None if plan is None else plan.toolpath
    problem = problem.changed(overrides)
    drawn = problem.model_copy(update={"as_printed": None})
    toolpath = build_toolpath(drawn)
    if planned is not None and not overrides and problem.as_printed is None:
        was, now = planned.length, toolpath.length
        if abs(now - was) > _LENGTH * was:
            reason = f"{was * 1e3:.1f} mm of beads were planned, but its problem now has {now * 1e3:.1f}"
            raise InputError(reason, file=path, hint="plan it again, or put the problem's files back as they were")
    if any(bead.round for bead in toolpath.beads):
        raise InputError("prints struts in space, which have no top that others lie on", file=given)
    if problem.process.section == "fibre":
        raise InputError("lays fibre, whose thickness is fixed and makes up for nothing", file=given)
    return ScannedPlan(problem, toolpath)


def fit_lines(fit: CloudFit | None) -> list[str]:
    """How a cloud was moved, in words."""
    if fit is None:
        return []
    shift, turn = fit.shift * 1e3, np.degrees(fit.turn)
    moved = ", ".join(f"{value:+.3f}" for value in shift)
    turned = ", ".join(f"{value:+.3f}" for value in turn)
    out = [
        f"the cloud was moved by ({moved}) mm at its middle and turned by ({turned}) degrees; that offset is not in the map"
    ]
    return out + [f"not shown by this layer's top, and left as the cloud has it: {each}" for each in fit.unseen]


def scan_command() -> Command:
    """The parser of `python -m planner.feedback.scan`."""
    parser = Command(
        "feedback.scan",
        "Lay the rest of a print on what is really there: find how far the top of a layer is from where it was planned, in a "
        "cloud of points, and plan the layers above so that nozzle height and flow fit it.",
        {
            "cylinder_logo cloud.ply --after-layer 4": "map, picture and problem in out/cylinder_logo_scanned_4, the plan of "
            "layers 5 and above in out/cylinder_logo_after_4",
            "my_part.yaml cloud.csv --after-layer 4 --fit": "with the cloud moved onto the planned top first",
            "out/cylinder_logo cloud.npy --after-layer 4 --unit m --map-only": "the map alone, of a cloud in metres",
        },
        {
            0: "verified plan written, or with --map-only the map",
            2: "wrong input; nothing written",
            3: "no verified plan; map and report written, no robot code",
            130: "interrupted",
        },
    )
    parser.add_argument(
        "plan",
        metavar="PLAN",
        help="a plan that was saved, a folder of results, a problem file or a shipped one's name",
    )
    parser.add_argument(
        "cloud", type=Path, metavar="CLOUD", help="points of the print: .ply, .xyz, .csv, .txt, .npz, .npy"
    )
    parser.add_argument(
        "--after-layer", type=int, required=True, metavar="K", help="the layer that was printed last, counted from 1"
    )
    parser.add_argument(
        "--unit", choices=tuple(CLOUD_UNITS), help="of the cloud (default: as its header says, else mm)"
    )
    parser.add_argument(
        "--frame",
        choices=FRAMES,
        default="part",
        help="that the cloud is in: the part's, which is the work object of programs (default), its plate's, the world",
    )
    parser.add_argument(
        "--fit",
        nargs="?",
        type=some_of(FREEDOMS, 1),
        const=FREEDOMS,
        metavar="NAMES",
        help="first move the cloud onto the planned top, by 10 mm and 5 degrees at most; of x,y,z,rx,ry,rz (default all)",
    )
    parser.add_argument(
        "--share",
        type=_share,
        default=SHARE,
        metavar="S",
        help=f"of its height, by which a bead may be made higher or lower (default {SHARE})",
    )
    parser.add_argument(
        "--smoothing-mm",
        dest="smoothing",
        type=_millimetres,
        metavar="MM",
        help="radius over which the map is smoothed (default: five widths of a bead, 15 at most)",
    )
    add_set(parser)
    add_strategy(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="where map and plan go, both")
    parser.add_argument("--map-only", action="store_true", help="plan nothing")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")
    return parser


def _share(text: str) -> float:
    return number_within(text, 0.01, MOST_SHARE, "a share")


def _millimetres(text: str) -> float:
    return number_within(text, 0.1, 100.0, "a length in mm") * 1e-3
