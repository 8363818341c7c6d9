"""`beadwise identify write` makes a program that shows a robot's limits, `identify read` finds them in its recording.

python -m planner.feedback.identify write cylinder_logo
python -m planner.feedback.identify read run.csv cylinder_logo
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from planner.base.command_line import Command, exit_code, one_of
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError, OutputError, nearest_name
from planner.base.rapid_names import LONGEST_NAME
from planner.base.results import results_folder
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import obstacles_of
from planner.feedback.identify_delay import JointDelay, fit_delay
from planner.feedback.identify_extruder import (
    SHORTEST,
    fit_flow,
    flow_lines,
    line_of,
    line_text,
    problem_text,
    process_values,
    read_asked_line,
    read_table,
    usual_length,
    waypoints_text,
)
from planner.feedback.identify_findings import deviation_words, findings, joint_lines, path_lines
from planner.feedback.identify_fit import FLOOR, QUANTITIES, IdentifiedLimit, JointFit, fit_joints
from planner.feedback.identify_match import MatchedLog, match
from planner.feedback.identify_path import off_commands
from planner.feedback.identify_profile import move_profile
from planner.feedback.identify_program import (
    TEST_LANGUAGES,
    AskedMoves,
    FreeSpace,
    asked_limits,
    asked_moves,
    asked_name,
    asked_text,
    common_space,
    free_spaces,
    greatest_lengths,
    language_of,
    moves_enough,
    program_files,
    read_asked,
    start_posture,
)
from planner.feedback.identify_robot_file import (
    check_targets,
    controller_values,
    robots_of,
    usable,
    write_controller,
    write_measured,
)
from planner.feedback.identify_run import planned_run, recorded_run
from planner.feedback.recordings import add_recording, read_log
from planner.planning.solve_command import main as solve_main
from planner.problem import Problem, load_problem
from planner.problem.rewrite import Value, write_changed
from planner.toolpath.build import build_toolpath

BY = "identify"  # the command under which a results folder lists the files
UNEXPLAINED = 3.0  # × the noise at rest: a residual above this is reported


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    say = partial(print, file=sys.stderr)
    words = " ".join(given[:2]) if given[:1] == ["extruder"] else "".join(given[:1])
    if words in ACTIONS:
        parser, run = ACTIONS[words]
        options = parser().parse_args(given[len(words.split()) :])
        return exit_code(lambda: run(options), say)
    about = "\n".join(f"  {name:<15} {make().description}" for name, (make, _) in ACTIONS.items())
    if given and given[-1] in ("-h", "--help"):
        print(
            f"usage: beadwise identify {'|'.join(ACTIONS)} …\n\n{about}\n\nbeadwise identify write --help tells more."
        )
        return EXIT_VERIFIED
    near = nearest_name(words, ACTIONS) if given else None
    hint = f" (did you mean {near}?)" if near else ""
    say(f"error: say whether to write a test program, or to read its recording{hint}\n{about}")
    return EXIT_INPUT


# ----------------------------------------------------------------------------------------------------
# Writing a test program.


def identify_write_command() -> Command:
    """The parser of `python -m planner.feedback.identify write`."""
    parser = Command(
        "feedback.identify write",
        "Write a program that moves each joint alone, within the space that is free, so that a recording shows its limits.",
        {
            "cylinder_logo": "around home; results in out/cylinder_logo_identify",
            'my_part.yaml --start "0, -40, 40, 0, 30, 0" --most 60': "around another posture, each joint by 60 degrees",
            "my_part.yaml --language joint_trajectory": "as a message of ROS",
        },
        {0: "written", 2: "wrong input, or a start posture that is not clear; nothing written", 130: "interrupted"},
    )
    _add_cell(parser)
    parser.add_argument(
        "--language",
        type=one_of(TEST_LANGUAGES),
        metavar="NAME",
        help=f"instead of the controller's own: {', '.join(TEST_LANGUAGES)}",
    )
    parser.add_argument(
        "--start",
        type=_numbers,
        metavar="VALUES",
        help="posture around which joints move: one value per joint in degrees, or mm if it slides (default: home)",
    )
    parser.add_argument(
        "--most",
        type=_lengths,
        metavar="VALUES",
        help="how far each joint may go: one value for all, or one per joint (default: 180 degrees, 1000 mm)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: out/<problem>_identify")
    return parser


def _write(options: argparse.Namespace) -> int:
    problem = load_problem(options.problem)
    cell = build_cell(problem)
    language = language_of(problem, cell, options.language)
    start, most = start_posture(cell, options.start), greatest_lengths(cell, options.most)
    target = options.out or Path("out") / f"{problem.name}_identify"
    with results_folder(target, BY) as fresh:
        toolpath = build_toolpath(problem)
        # whichever of several nozzles is mounted on the flange
        cells = [cell.with_nozzle(k) for k in range(len(cell.nozzles))] or [cell]
        found = [free_spaces(each, obstacles_of(problem, each, toolpath), start, most) for each in cells]
        spaces = [common_space(each) for each in zip(*found, strict=True)]
        asked = asked_moves(problem, cell, start, spaces, language)
        files = program_files(cell, asked, problem.program.mover(second_arm=False))
        files[asked_name(problem.name)] = asked_text(asked)
        for name, text in files.items():
            (fresh / name).write_text(text, encoding="utf-8", newline="\n")
    print("\n".join([*_space_lines(cell, asked, spaces), *(str(target / name) for name in files)]))
    return EXIT_VERIFIED


def _space_lines(cell: Cell, asked: AskedMoves, spaces: Sequence[FreeSpace]) -> list[str]:
    out = [f"{'joint':<14} {'from':>9} {'to':>9}        moves  ends"]
    for j, (name, space) in enumerate(zip(cell.joint_names, spaces, strict=True)):
        unit, scale = ("mm", 1e3) if j in asked.sliding else ("deg", float(np.degrees(1.0)))
        count = sum(move.joint == j for move in asked.moves)
        ends = "; ".join(dict.fromkeys(space.bounds))
        ends = ends if moves_enough(cell, j, space) else f"left out, too little space: {ends}"
        out.append(f"{name:<14} {space.low * scale:>9.1f} {space.high * scale:>9.1f} {unit:<4} {count:>8}  {ends}")
    duration = asked.rests.sum() + sum(
        move_profile(abs(move.end - move.start), asked_limits(asked, cell, move)).total for move in asked.moves
    )
    return [*out, f"{len(asked.moves)} moves, about {duration / 60:.1f} min by the limits in the robots' files"]


# ----------------------------------------------------------------------------------------------------
# Reading its recording.


def identify_read_command() -> Command:
    """The parser of `python -m planner.feedback.identify read`."""
    parser = Command(
        "feedback.identify read",
        "Find limits of speed, acceleration and jerk, and the controller's delay, in the recording of a test program, and "
        "write them into copies of the robots' files; with --plan, how the robot has followed a plan's program.",
        {
            "run.csv cylinder_logo": "writes irb140_measured.yaml and irbp_a250_measured.yaml here",
            "run.csv my_part.yaml --plan out/my_part": "how the robot followed the program of a plan",
            'run.csv my_part.yaml --columns "t_ms, J1_deg, J2_deg, J3_deg, J4_deg, J5_deg, J6_deg"': "a file without a header",
        },
        {
            0: "limits found and written",
            2: "wrong input, or a recording of something else; nothing written",
            3: "the recording shows no limit; nothing written",
            130: "interrupted",
        },
    )
    parser.add_argument(
        "log",
        type=Path,
        metavar="LOG",
        help="the recording: CSV with time and joints, or a ROS bag (see the documentation)",
    )
    _add_cell(parser)
    parser.add_argument(
        "--asked",
        type=Path,
        metavar="FILE",
        help="what the program asked (default: <problem>_asked.json beside LOG, or in out/<problem>_identify)",
    )
    add_recording(parser)
    parser.add_argument(
        "--plan",
        metavar="PLAN",
        help="the recording is of this plan's own program, not of a test program: a folder of results, or a saved plan",
    )
    parser.add_argument("--out", type=Path, default=Path(), metavar="DIR", help="folder of the copies (default: here)")
    return parser


def _read(options: argparse.Namespace) -> int:
    problem = load_problem(options.problem)
    cell = build_cell(problem)
    if options.plan is not None:
        return _read_run(options, problem, cell)
    robots = robots_of(problem, cell)
    check_targets(robots, options.out)
    file = _asked_file(options.asked, options.log, f"{problem.name}_identify", asked_name(problem.name))
    asked = read_asked(file, problem, cell)
    log = match(read_log(options.log, cell, options.columns, options.topic), asked)
    limits = cell.limits
    log, fits = fit_joints(log, asked, (limits.velocity, limits.acceleration, limits.jerk))
    delays = {fit.joint: delay for fit in fits if (delay := fit_delay(log, asked, fit.joint)) is not None}
    told = [*_limit_lines(cell, fits), *_note_lines(problem, cell, fits), *_delay_lines(delays), *_off_lines(log, cell)]
    print("\n".join([*log.remarks, *told]))
    if not any(usable(found) for fit in fits for found in fit.limits):
        print("the recording shows no limit of the robots' own: nothing written")
        return EXIT_NOT_VERIFIED
    written = write_measured(robots, fits, delays, options.log, options.out)
    print("\n".join([*map(str, written), "name them in the problem: cell.arm, cell.positioner.robot, cell.base.robot"]))
    return EXIT_VERIFIED


def _read_run(options: argparse.Namespace, problem: Problem, cell: Cell) -> int:
    """Report how the robot followed a plan's program; returns the exit code."""
    arm = robots_of(problem, cell)[0]
    check_targets([arm], options.out)
    run = planned_run(options.plan, problem, cell)
    recorded = recorded_run(read_log(options.log, cell, options.columns, options.topic), run, cell)
    found = findings(run.path, recorded.followed)
    lines = path_lines(found, recorded, cell)
    print("\n".join([*recorded.remarks, f"compared with {run.words}", *lines]))
    if not controller_values(found):
        print("the recording shows nothing that forecasts use: no robot file written")
        return EXIT_VERIFIED
    about = [line for line in lines if not line.startswith("  ")]
    print(f"{write_controller(arm, found, about, options.log, options.out)}\nname it in the problem: cell.arm")
    return EXIT_VERIFIED


def _asked_file(given: Path | None, recorded: Path, folder: str, name: str) -> Path:
    """The file of what was asked: the given one, else that next to the recording, else that where it was written."""
    beside = recorded.parent / name
    return given or (beside if beside.is_file() else Path("out") / folder / name)


def _limit_lines(cell: Cell, fits: Sequence[JointFit]) -> list[str]:
    """A table of joints: each limit with its standard error, next to that in the robot's file."""
    limits = cell.limits
    heads = [f"{what} [{unit}]" for what, unit in zip(QUANTITIES, ("rad/s", "rad/s²", "rad/s³"), strict=True)]
    if limits.sliding:
        heads = [f"{head[:-1]}; m if it slides]" for head in heads]
    out = [f"{'joint':<14} " + " ".join(f"{head:<34}" for head in heads).rstrip()]
    for fit in fits:
        files = (limits.velocity[fit.joint], limits.acceleration[fit.joint], limits.jerk[fit.joint])
        cells = [f"{_found_words(found, float(file)):<34}" for found, file in zip(fit.limits, files, strict=True)]
        out.append(f"{cell.joint_names[fit.joint]:<14} " + " ".join(cells).rstrip())
    return out


def _found_words(found: IdentifiedLimit, file: float) -> str:
    known = f"(file {file:.4g})"
    if not found.told:
        return f"at least {found.value:.3g} {known}"
    error = f"{found.value:.4g} ±{100.0 * found.error / found.value:.1f} %"
    return f"{error}, as asked" if found.as_asked else f"{error} {known}"


def _note_lines(problem: Problem, cell: Cell, fits: Sequence[JointFit]) -> list[str]:
    out = []
    for fit in fits:
        name = cell.joint_names[fit.joint]
        if fit.braking is not None:
            out.append(
                f"{name} brakes differently from speeding up, by {fit.braking[0]:.4g} with a jerk of "
                f"{fit.braking[1]:.4g}: the lesser values are taken, where they are shown"
            )
        for what, found in zip(QUANTITIES, fit.limits, strict=True):
            if found.spread[1] > found.spread[0]:
                out.append(
                    f"{name}: moves differ, {what} {found.spread[0]:.4g} to {found.spread[1]:.4g}; the least is taken"
                )
        if fit.averaged is not None:
            time, error = fit.averaged
            out.append(
                f"{name} smooths its profile by a mean over {1e3 * time:.3g} ±{1e3 * error:.2g} ms: from rest it reaches any "
                "acceleration in that time, and its jerk is that acceleration over that time"
            )
        if fit.either is not None:
            out.append(
                f"{name}: moves cannot tell a limited jerk from a mean over a fixed time, with which it would be "
                f"{fit.either:.4g}; the lesser is taken"
            )
        if fit.residual > UNEXPLAINED * max(fit.noise, FLOOR):
            left, unit = (1e3 * fit.residual, "mm") if fit.joint in cell.limits.sliding else (
                float(np.degrees(fit.residual)), "degrees"
            )  # fmt: skip
            out.append(f"{name}: {left:.2g} {unit} remain that no limits explain; at rest it is less")
        if fit.lag > 0.0:
            out.append(
                f"{name} follows its profile with a lag of {1e3 * fit.lag:.1f} ms, which its jerk does not include: "
                "a recording with commands would separate them better"
            )
        if name in problem.cell.limits:
            out.append(f"{name}: cell.limits of the problem stand above what the robot's file says")
    return out


def _delay_lines(delays: Mapping[int, JointDelay]) -> list[str]:
    """The delay that all joints share, and its range over the joints."""
    if not delays:
        return ["no commanded joints in the recording: the controller's delay is not shown"]
    found = list(delays.values())
    weights = np.array([1.0 / max(each.total_error, 1e-6) ** 2 for each in found])
    totals = np.array([each.total for each in found])
    mean, lag = (float(np.average(values, weights=weights)) for values in (totals, [each.lag for each in found]))
    error = max(float(weights.sum() ** -0.5), float(totals.std(ddof=1)) if len(found) > 1 else 0.0)
    return [
        f"joints follow their commands {1e3 * mean:.2f} ±{1e3 * error:.2f} ms late ({1e3 * totals.min():.2f} to "
        f"{1e3 * totals.max():.2f}): {1e3 * (mean - lag):.1f} ms of delay, then a lag of {1e3 * lag:.1f} ms"
    ]


def _off_lines(log: MatchedLog, cell: Cell) -> list[str]:
    """How far joints and tip deviate from the path of their commands, whatever the delay; nothing without commands."""
    if log.commanded is None:
        return []
    part = slice(int(log.rests[0, 0]), int(log.rests[-1, 1]) + 1)
    tip, joints = off_commands(log.time[part], log.executed[part], log.commanded[part], cell)
    return [f"off the path of the commands: tip {deviation_words(tip)}", *joint_lines(joints, cell)]


# ----------------------------------------------------------------------------------------------------
# Arguments.


def _add_cell(parser: Command) -> None:
    parser.add_argument(
        "problem", metavar="CELL", help="problem file (.yaml) with the cell, or the name of a shipped one"
    )


def _numbers(
    text: str, what: str = "list of numbers", count: int | None = None, low: float = -math.inf, high: float = math.inf
) -> tuple[float, ...]:
    """Numbers between low and high, exactly `count` of them if given."""
    try:
        values = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        values = ()
    if not values or count not in (None, len(values)) or not all(low < value < high for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is no {what}")
    return values


_place = partial(_numbers, what="place: three numbers", count=3)
_bead = partial(_numbers, what="bead: width and height in mm", count=2, low=0.0, high=100.0)


def _lengths(text: str) -> tuple[float, ...]:
    values = _numbers(text)
    if min(values) < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: not below 0")
    return values


# ----------------------------------------------------------------------------------------------------
# The extruder's test line.


def extruder_write_command() -> Command:
    """The parser of `python -m planner.feedback.identify extruder write`."""
    parser = Command(
        "feedback.identify extruder write",
        "Plan a line whose flow steps while the nozzle keeps its speed, to be cut and weighed, or looked at from above.",
        {
            "peer_cap": "in out/peer_cap_line, 240 mm along x around the part frame's origin",
            'my_part.yaml --from "50, 0, 0.5" --to "50, 180, 0.5"': "between two places of the nozzle's tip in the part frame",
        },
        {
            0: "verified plan of the line written",
            2: "wrong input; nothing written",
            3: "no verified plan",
            130: "interrupted",
        },
    )
    parser.add_argument(
        "problem", metavar="CELL", help="problem file (.yaml) with cell and process, or a shipped one's name"
    )
    for name, which in (("--from", "begins"), ("--to", "ends")):
        parser.add_argument(
            name,
            type=_place,
            metavar="X,Y,Z",
            dest=f"line_{which}",
            help=f"where the nozzle's tip {which} in the part frame [mm] (default: 240 mm or more along x around its origin, a bead's height up)",
        )
    parser.add_argument(
        "--normal", type=_place, default=(0.0, 0.0, 1.0), metavar="X,Y,Z", help="out of the bed (default: 0,0,1)"
    )
    parser.add_argument(
        "--bead", type=_bead, metavar="W,H", help="width and height of the bead [mm] (default: those of the problem)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: out/<problem>_line")
    return parser


def _write_line(options: argparse.Namespace) -> int:
    """Write and plan a test line; returns the exit code."""
    problem = load_problem(options.problem)
    bead = None if options.bead is None else (1e-3 * options.bead[0], 1e-3 * options.bead[1])
    usual = problem.process.bead
    width, height = bead or (usual.width, usual.height)
    half = 0.5 * usual_length(width)
    begin, end = (
        np.array(given) * 1e-3 if given is not None else np.array([side * half, 0.0, height])
        for given, side in ((options.line_begins, -1.0), (options.line_ends, 1.0))
    )
    normal, length = np.array(options.normal), float(np.linalg.norm(end - begin))
    line = line_of(problem, length, bead)
    if length < SHORTEST:
        reason = f"the line is {1e3 * length:.3g} mm long"
        raise InputError(
            reason, field="--to", hint=f"at least {1e3 * SHORTEST:g} mm, so that the flow settles between steps"
        )
    if not np.linalg.norm(normal) > 0.0 or abs(normal @ (end - begin)) > 1e-3 * length * float(np.linalg.norm(normal)):
        raise InputError("is not across the line", field="--normal", hint="out of the bed, for example 0,0,1")
    name = f"{problem.name[: LONGEST_NAME - 5]}_line"
    folder = options.out or Path("out") / f"{problem.name}_line"
    with results_folder(folder, BY) as fresh:
        files = {
            f"{name}.txt": waypoints_text(line, begin, end, normal / np.linalg.norm(normal)),
            f"{name}.yaml": problem_text(problem, line, name, folder),
            f"{name}_asked.json": line_text(line),
        }
        for file, text in files.items():
            (fresh / file).write_text(text, encoding="utf-8", newline="\n")
    steps = ", ".join(f"{1e3 * at:g}" for at in line.ends[1:-1])
    print(
        f"a line of {1e3 * length:g} mm at {1e3 * line.speed:g} mm/s, whose flow steps at {steps} mm\n{folder / f'{name}_asked.json'}"
    )
    return solve_main([str(folder / f"{name}.yaml"), "--out", str(folder / "plan"), "--quiet"])


def extruder_read_command() -> Command:
    """The parser of `python -m planner.feedback.identify extruder read`."""
    parser = Command(
        "feedback.identify extruder read",
        "Find the extruder's lag and how much it lays in a table of a test line: from_mm, to_mm, mass_mg of segments, or s_mm, "
        "width_mm along it.",
        {
            "line.csv peer_cap --density 1.24": "prints what to put into the problem file",
            "line.csv my_part.yaml --write my_part_measured.yaml": "writes a copy of it",
        },
        {
            0: "found",
            2: "wrong input; nothing written",
            3: "the table shows nothing; nothing written",
            130: "interrupted",
        },
    )
    parser.add_argument("table", type=Path, metavar="TABLE", help="CSV file with places along the line in mm")
    parser.add_argument(
        "problem", metavar="CELL", help="problem file (.yaml) for which the line was written, or a shipped one's name"
    )
    parser.add_argument(
        "--density",
        type=_positive,
        metavar="G_CM3",
        help="of the material; without it masses do not show how much is laid",
    )
    parser.add_argument(
        "--asked",
        type=Path,
        metavar="FILE",
        help="what the line asked (default: beside TABLE, or in out/<problem>_line)",
    )
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="write a copy of the problem file with what was measured"
    )
    return parser


def _read_line(options: argparse.Namespace) -> int:
    """Read the table of a test line; returns the exit code."""
    problem = load_problem(options.problem)
    if options.write is not None and options.write.exists():
        raise OutputError(f"{options.write} is there already, and stays as it is: choose another name")
    name = f"{problem.name[: LONGEST_NAME - 5]}_line_asked.json"
    line = read_asked_line(_asked_file(options.asked, options.table, f"{problem.name}_line", name), problem)
    density = None if options.density is None else 1e3 * options.density
    found = fit_flow(read_table(options.table, line), line, density)
    values = process_values(found, line, problem)
    print("\n".join(flow_lines(found)))
    if not values:
        print("the table shows nothing that could be written")
        return EXIT_NOT_VERIFIED
    if options.write is None:
        print(_section(values))
        return EXIT_VERIFIED
    write_changed(problem, values, options.write)
    print(options.write)
    return EXIT_VERIFIED


def _section(values: dict[str, Value]) -> str:
    """The lines of the problem file."""
    out = ["process:"]
    for field, value in values.items():
        if field == "process.filament_diameter_mm":
            out.append(f"  filament_diameter_mm: {value:g}   # as the extruder feeds it")
        elif field == "layers.source.filament_diameter_mm":
            out += ["layers:", "  source:", f"    filament_diameter_mm: {value:g}   # as E of the file counts it"]
        else:
            lag = value["lag_s"] if isinstance(value, dict) else value
            out.append(f"  extruder: {{lag_s: {lag:g}}}")
    return "\n".join(out)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < 30.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no density in g/cm3")
    return value


ACTIONS: dict[str, tuple[Callable[[], Command], Callable[[argparse.Namespace], int]]] = {
    "write": (identify_write_command, _write),
    "read": (identify_read_command, _read),
    "extruder write": (extruder_write_command, _write_line),
    "extruder read": (extruder_read_command, _read_line),
}
