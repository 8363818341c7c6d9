"""How well robots are identified: known limits, controllers and extruders, recorded with noise, at several rates.

python -m benchmarks.identify [--seeds 2] [--quick]

Each robot moves as its test program requests. Its true limits are drawn for each seed: speed 0.7 to 1 of its file's,
acceleration 0.5 to 1.5, jerk 0.25 to 0.8, servo lag and delay as named. `worst` is over all joints and seeds, of reported
limits; `not told` counts those that the recording does not show, such as a speed that is not reached.

A second table has controllers that follow a program: an IRB 140's tip along corners with zones of 0.5, 2 and 5 mm, and
along lines of short moves to and fro. A third has extruders, whose test line is weighed or inspected.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.controller import program_of
from benchmarks.recordings import TrueRobot, executed_run, line_table, recorded, write_recording
from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING
from planner.export.player.model import ABB, MotionModel
from planner.export.player.play import play
from planner.feedback.identify_delay import fit_delay
from planner.feedback.identify_extruder import LENGTH, FlowLine, fit_flow, line_of, read_table
from planner.feedback.identify_findings import PathFindings, findings
from planner.feedback.identify_fit import QUANTITIES, fit_joints
from planner.feedback.identify_match import match
from planner.feedback.identify_path import follow
from planner.feedback.identify_program import AskedMoves, asked_moves, free_spaces, greatest_lengths
from planner.feedback.identify_run import path_of_program
from planner.feedback.recordings import read_log
from planner.problem import load_problem

COLUMNS = ("robot", "samples/s", "noise °", "recorded", *(f"{what}: median, worst %" for what in QUANTITIES), "not told",
           "delay and lag: worst ms")  # fmt: skip
UR = ("cell.arm=ur10e", "cell.limits={}", "cell.home_deg=[0, -90, 90, -90, -90, 0]")


@dataclass(frozen=True)
class IdentifyCase:
    """A robot, how it is recorded, and whether commands are in the recording.

    lag, delay [s] of the servo;  braking: share of the acceleration;  jitter [s]: by which stamps are late, evenly spread
    mean [s]   of a moving mean that smooths profiles without a limited jerk; the true jerk is acceleration over that
    """

    title: str
    problem: str
    overrides: tuple[str, ...]
    rate: float
    noise_deg: float
    commands: bool = False
    lag: float = 0.0
    delay: float = 0.0
    braking: float = 1.0
    jitter: float = 0.0
    mean: float = 0.0


LOGO = ("cylinder_logo", ())
CASES = (
    IdentifyCase("IRB 140 and A250", *LOGO, 250.0, 0.01),
    IdentifyCase("IRB 140 and A250", *LOGO, 125.0, 0.01),
    IdentifyCase("IRB 140 and A250", *LOGO, 500.0, 0.01),
    IdentifyCase("the same, noisier", *LOGO, 250.0, 0.03),
    IdentifyCase("the same, braking at 0.7", *LOGO, 250.0, 0.01, braking=0.7),
    IdentifyCase("the same, lagging by 20 ms", *LOGO, 250.0, 0.01, lag=0.02),
    IdentifyCase("the same, stamps late by up to 4 ms", *LOGO, 125.0, 0.01, jitter=4e-3),
    IdentifyCase("the same, smoothing by a mean over 40 ms", *LOGO, 250.0, 0.01, mean=0.04),
    IdentifyCase("the same, lagging by 15 ms as well", *LOGO, 250.0, 0.01, mean=0.04, lag=0.015),
    IdentifyCase("the same, with its commands", *LOGO, 250.0, 0.01, commands=True, lag=0.015, delay=0.033),
    IdentifyCase("UR10e", "peer_cap", UR, 500.0, 0.01, commands=True, lag=0.004, delay=0.006),
    IdentifyCase("UR10e", "peer_cap", UR, 125.0, 0.01),
    IdentifyCase("IRB 6640", "peer_cap", ("cell.arm=irb6640", "cell.limits={}"), 250.0, 0.01, lag=0.01),
)


@dataclass(frozen=True)
class CaseErrors:
    """Relative errors of what is told by quantity (3 lists), how many limits are not told, errors of delays [s]."""

    limits: tuple[list[float], list[float], list[float]]
    untold: int
    delays: list[float]


def truth_of(cell: Cell, case: IdentifyCase, seed: int) -> TrueRobot:
    """A robot of a case's cell, drawn anew for each seed."""
    random, limits, n = np.random.default_rng(seed), cell.limits, len(cell.joint_names)
    acceleration = limits.acceleration * random.uniform(0.5, 1.5, n)
    return TrueRobot(
        limits.velocity * random.uniform(0.7, 1.0, n),
        acceleration,
        limits.jerk * random.uniform(0.25, 0.8, n),
        None if case.braking == 1.0 else case.braking * acceleration,
        case.delay,
        case.lag,
        case.mean,
    )


def asked_of(case: IdentifyCase) -> tuple[Cell, AskedMoves]:
    """The cell of a case, and the moves of its test program in an empty room."""
    problem = load_problem(case.problem, case.overrides)
    cell = build_cell(problem)
    spaces = free_spaces(cell, NOTHING, cell.home, greatest_lengths(cell, None))
    # controllers that make the profile themselves: what they are told does not hide what they can do
    return cell, asked_moves(problem, cell, cell.home, spaces, "rapid")


def measure(case: IdentifyCase, seeds: int, folder: Path) -> CaseErrors:
    """Errors of a case over seeds."""
    cell, asked = asked_of(case)
    found = CaseErrors(([], [], []), 0, [])
    untold = 0
    names = [f"{name}_deg" for name in cell.joint_names]
    head = ["t_s", *names, *([f"target_{name}" for name in names] if case.commands else [])]
    for seed in range(seeds):
        truth = truth_of(cell, case, seed)
        made = recorded(asked, truth, case.rate, np.radians(case.noise_deg), seed)
        if case.jitter:
            late = np.random.default_rng(seed).uniform(0.0, case.jitter, len(made.time))
            made = type(made)(made.time + late, made.executed, made.commanded)
        file = write_recording(folder / "run.csv", made, head, commanded=case.commands)
        limits = cell.limits
        log, fits = fit_joints(
            match(read_log(file, cell), asked), asked, (limits.velocity, limits.acceleration, limits.jerk)
        )
        slower = min(1.0, case.braking)
        for fit in fits:
            jerk = slower * truth.acceleration / case.mean if case.mean else truth.jerk
            true = (truth.speed, slower * truth.acceleration, jerk)
            for errors, limit, values in zip(found.limits, fit.limits, true, strict=True):
                if limit.told:
                    errors.append(limit.value / float(values[fit.joint]) - 1.0)
                untold += not limit.told
            delay = fit_delay(log, asked, fit.joint)
            if delay is not None:
                found.delays.extend(
                    [delay.delay - truth.delay, delay.lag - truth.lag, delay.total - truth.delay - truth.lag]
                )
    return CaseErrors(found.limits, untold, found.delays)


def row_of(case: IdentifyCase, errors: CaseErrors) -> list[str]:
    """A row of the table."""
    words = []
    for each in errors.limits:
        size = 100.0 * np.abs(np.array(each))
        words.append(f"{np.median(size):.2f}, {size.max():.2f}" if len(size) else "")
    told = sum(map(len, errors.limits))
    delay = f"{1e3 * np.abs(errors.delays).max():.2f}" if errors.delays else ""
    what = "executed and commanded" if case.commands else "executed"
    return [
        case.title,
        f"{case.rate:g}",
        f"{case.noise_deg:g}",
        what,
        *words,
        f"{errors.untold} of {told + errors.untold}",
        delay,
    ]


# ----------------------------------------------------------------------------------------------------
# Controllers that follow a program, and extruders.

PATH_COLUMNS = ("controller", "mm/s", "zones cut by: true, found", "lag, ms: true, found", "braking, ms: true, found",
                "look-ahead, moves: true, found")  # fmt: skip
FLOW_COLUMNS = ("extruder lag, s", "weighed: s, ±; flow", "looked at: s, ±; flow")
ZONES = np.tile([0.5e-3, 2e-3, 5e-3, 5e-3], 6)
ZIGZAG = np.array([[0.0, 0.009 * k, 0.03 * (k % 2)] for k in range(1, 25)])
SHORT = (0.8e-3, 1.5e-3)  # m: lengths of moves along lines of 60 mm
FEW = replace(ABB, name="ABB's, 3 moves ahead", ahead_moves=3, move_time=0.0)
MODELS = ((ABB, 0.04), (ABB, 0.1), (ABB, 0.25), (replace(ABB, name="ABB's, lag 30 ms", lag=0.03), 0.1), (FEW, 0.15))
FLOW = 0.92  # share of what was asked
SCALE, PIXEL = 0.02e-6, 0.02e-3  # kg, m: noise of masses of 5 mm, and of widths each millimetre
DENSITY = 1240.0  # kg/m³


def to_and_fro(move: float, *more: float) -> tuple[Array, list[int]]:
    """Targets of lines of 60 mm to and fro, each in moves of one length [m], and those at which the robot rests."""
    y, points, stops = 0.0, [], []
    for k, step in enumerate((move, *more)):
        side = -1.0 if k % 2 else 1.0
        for _ in range(round(0.06 / step)):
            y += side * step
            points.append([0.0, y, 0.0])
        stops.append(len(points) - 1)
    return np.array(points), stops


def followed(
    model: MotionModel, speed: float, points: Array, zone: Array | float, rests: Sequence[int]
) -> PathFindings:
    """What a recording of an arm of a model shows, along points (m, 3) from where it stands [m]."""
    cell = build_cell(load_problem("planar_gcode"))
    home = np.tile(cell.home, (len(points) + 1, 1))
    position = cell.T_part_nozzle(home[:1])[0, :3, 3] + np.vstack([np.zeros(3), points])
    program = program_of(cell, home, position, speed, zone, rests)
    program = replace(program, wait=np.where(program.fine, 0.3, 0.0))
    t, q = executed_run(program, play(program, cell, model), model)
    path = path_of_program(program, cell)
    return findings(path, follow(path, t, q, cell))


def path_row(model: MotionModel, speed: float) -> list[str]:
    """A row of the second table."""
    corners = followed(model, speed, ZIGZAG, ZONES, ())
    points, rests = to_and_fro(*SHORT)
    lines = followed(model, speed, points, 1e-3, rests)
    depth, lag, ahead = corners.depth, corners.lag, lines.ahead
    brakes = "; ".join(
        f"{1e3 * model.ramp * each.speed ** (1 / 3):.0f}, {1e3 * each.time:.0f} ±{1e3 * each.error:.0f} "
        f"from {1e3 * each.speed:.0f} mm/s"
        for each in lines.brakes
    )
    return [
        model.name,
        f"{1e3 * speed:g}",
        f"{model.depth:.2f}, {depth.value:.2f} ±{depth.error:.2f}" if depth.told else "not shown",
        f"{1e3 * model.lag:.1f}, {1e3 * lag.value:.1f} ±{1e3 * lag.error:.1f}" if lag.told else "not shown",
        brakes or "not shown",
        f"{model.ahead_moves}, "
        + (
            f"{ahead.value:.1f} ±{ahead.error:.1f}"
            if ahead.told
            else f"at least {ahead.value:.0f}"
            if ahead.reason == "at least"
            else "not shown"
        ),
    ]


def flow_row(line: FlowLine, lag: float, folder: Path) -> tuple[list[str], list[float]]:
    """A row of the third table, and errors of the lag [s]."""
    words, errors = [], []
    for density, noise in ((DENSITY, SCALE), (None, PIXEL)):
        file = line_table(folder / "line.csv", line, lag, FLOW, density=density, noise=noise)
        found = fit_flow(read_table(file, line), line, density)
        words.append(f"{found.lag:.4f}, ±{found.lag_error:.4f}; {found.flow:.4f} ±{found.flow_error:.4f}")
        errors.append(found.lag - lag)
    return [f"{lag:g}", *words], errors


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 1 where a limit is 10 % off, or a delay 4 ms."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identify", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2, help="robots for each case (default 2)")
    parser.add_argument("--quick", action="store_true", help="the first case alone")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS)
    good = True
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES[:1] if options.quick else CASES:
            errors = measure(case, options.seeds, Path(folder))
            table.add_row(*row_of(case, errors))
            good &= all(abs(error) < 0.1 for each in errors.limits for error in each)
            good &= all(abs(error) < 4e-3 for error in errors.delays)
            print(f"{case.title}, {case.rate:g}/s: done", file=sys.stderr)
        paths, flows = Table(*PATH_COLUMNS), Table(*FLOW_COLUMNS)
        for model, speed in MODELS[:1] if options.quick else MODELS:
            paths.add_row(*path_row(model, speed))
        line = line_of(load_problem("peer_cap"), LENGTH)
        for lag in (0.06,) if options.quick else (0.02, 0.06, 0.15, 0.4):
            row, off = flow_row(line, lag, Path(folder))
            flows.add_row(*row)
            good &= all(abs(error) < 4e-3 for error in off)
    for each in (table, paths, flows):
        Console(width=200).print(each)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
