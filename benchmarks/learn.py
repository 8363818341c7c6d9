"""What a simulated robot leaves of a plan, run by run, while its program learns from recordings.

python -m benchmarks.learn
python -m benchmarks.learn cylinder_logo --runs 3 --noise-deg 0.01

Robots are the controller models that programs are played with, and others that no model knows: joints that follow late by
different times, corners cut by all of the parabola in a zone, noise in the recording. What is told is the true distance of
the executed tip from the plan, across it and on beads, without the noise.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from planner.base.progress import Stages
from planner.export.controllers import CONTROLLERS
from planner.export.languages import LANGUAGES
from planner.export.player.executed import executed_run
from planner.export.player.play import play
from planner.feedback.identify_log import read_log
from planner.feedback.learn_command import language_of, learned_plan
from planner.feedback.learn_fit import Lessons, errors_of, next_lessons
from planner.feedback.learn_track import RecordedWay, planned_way, recorded_way, track
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem

Array = NDArray[np.float64]

RATE = 250.0  # samples a second
MOST = 1e-3  # m beside the plan
PRINTS: dict[str, tuple[str, ...]] = {
    "cylinder_logo": ("layers.count=1",),
    "hemisphere_honeycomb": ("layers.count=1",),
    "naca0015_wing": ("layers.count=1",),
    "aerofoil_core": ("layers.count=1",),
    "curved_plate": (),
    "planar_gcode": (),
}


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot that does not do what it is told.

    lag      of the controller's model, to both sides of time [s]; None: as fitted
    depth    of a corner's path within its zone, as `MotionModel` has it; None: as fitted
    late     first-order lag of the servos [s], and its spread from joint to joint, as a share
    """

    lag: float | None = None
    depth: float | None = None
    late: float = 0.0
    spread: float = 0.0


ROBOTS: Mapping[str, SimulatedRobot] = {
    "as fitted": SimulatedRobot(),
    "joints late": SimulatedRobot(lag=0.015, depth=1.0, late=0.03, spread=0.2),
}


def recorded(plan: Plan, robot: SimulatedRobot) -> tuple[Array, Array]:
    """Time (k) [s] and executed joints (k, n) [rad, m] of a run of a plan's program."""
    name = language_of(plan)
    language = LANGUAGES[name]
    program = language.program(plan, language.write(plan))
    asked = language.plan(plan)
    model = CONTROLLERS[name].motion
    model = replace(model, lag=model.lag if robot.lag is None else robot.lag)
    model = replace(model, depth=model.depth if robot.depth is None else robot.depth)
    tick = 1.0 / RATE
    run = executed_run(program, play(program, asked.cell, model), model, tick)
    q = run.q
    if robot.late > 0.0:
        late = robot.late * (1.0 + robot.spread * np.linspace(-1.0, 1.0, q.shape[1]))
        still = np.repeat(q[-1:], round(10.0 * late.max() / tick), axis=0)
        q = np.vstack([q, still])
        keep = np.exp(-tick / late)
        q = q[0] + np.column_stack(
            [lfilter([1.0 - k], [1.0, -k], column) for k, column in zip(keep, (q - q[0]).T, strict=True)]
        )
    return tick * np.arange(len(q)), q


def write_log(plan: Plan, time: Array, q: Array, noise: float, seed: int, path: Path) -> Path:
    """The recording as a controller's interface writes it: degrees, or mm of joints that slide, with noise [rad]."""
    cell = plan.cell
    sliding = [j in cell.limits.sliding for j in range(q.shape[1])]
    names = [f"{name}_{'mm' if slides else 'deg'}" for name, slides in zip(cell.joint_names, sliding, strict=True)]
    scale = np.where(sliding, 1e3, np.degrees(1.0))
    noisy = q + np.random.default_rng(seed).normal(0.0, 1.0, q.shape) * np.where(sliding, 0.0, noise)
    table = np.column_stack([time, noisy * scale])
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header=",".join(["t_s", *names]), comments="")
    return path


def true_way(plan: Plan, time: Array, q: Array) -> RecordedWay:
    """What a perfect recording would show."""
    T = plan.cell.T_part_nozzle(np.ascontiguousarray(q))
    tip, axis = np.ascontiguousarray(T[:, :3, 3]), np.ascontiguousarray(T[:, :3, 2])
    place, off = track(planned_way(plan.trajectory.tip, plan.trajectory.axis), planned_way(tip, axis), 0)
    return RecordedWay(time, tip, np.zeros(len(time)), place, off, np.zeros((0, 2), dtype=np.int64), ())


def runs_of(plan: Plan, robot: SimulatedRobot, runs: int, noise: float) -> list[tuple[float, ...]]:
    """For each run: off the plan (rms, 99 %, most) [mm], share of the time at speed, time of the run [s], and the greatest
    correction [mm] that its program had."""
    out: list[tuple[float, ...]] = []
    lessons: Lessons | None = None
    now = plan
    with tempfile.TemporaryDirectory() as folder:
        for k in range(runs + 1):
            time, q = recorded(now, robot)
            truth = errors_of(plan.trajectory, true_way(plan, time, q))
            size, rows = truth.size * 1e3, np.flatnonzero(truth.known)
            speed = truth.speed[rows]
            told = ~np.isnan(speed)
            fast = speed[told] >= 0.98 * plan.commanded[plan.trajectory.bead[rows[told]]]
            rms = float(np.sqrt((size**2).mean()))
            most = 0.0 if lessons is None else lessons.corrections.most * 1e3
            out.append(
                (rms, float(np.quantile(size, 0.99)), float(size.max()), float(fast.mean()), float(time[-1]), most)
            )
            if k == runs:
                break
            log = read_log(write_log(plan, time, q, noise, k, Path(folder) / "run.csv"), plan.cell)
            errors = errors_of(plan.trajectory, recorded_way(plan, log, language_of(plan)))
            wanted = next_lessons(plan.trajectory, errors, lessons, MOST)
            learned = learned_plan(plan, wanted, errors, MOST, language_of(plan), Stages())
            if learned.failed:
                print(f"  no safe program: {learned.failed}")
                break
            now, lessons = learned.plan, learned.lessons
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learn", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(PRINTS), help="of problems that ship, or files")
    parser.add_argument("--runs", type=int, default=5, help="that programs learn from (default 5)")
    parser.add_argument("--noise-deg", type=float, default=0.001, help="of recorded joints (default 0.001)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="in place of the usual ones")
    parser.add_argument("--robot", choices=tuple(ROBOTS), help="one of them only")
    options = parser.parse_args(arguments)
    for name in options.names:
        plan = solve(load_problem(name, options.set or PRINTS.get(name, ())), baseline=False)
        for title, robot in ROBOTS.items():
            if options.robot not in (None, title):
                continue
            print(f"\n{name}, {title}, noise {options.noise_deg:g} degrees", flush=True)
            print("| run | off the plan, rms | 99 % | most | at speed | time, s | asked beside the plan, most |")
            print("|---|---|---|---|---|---|---|")
            for k, row in enumerate(runs_of(plan, robot, options.runs, np.radians(options.noise_deg)), 1):
                rms, nearly, most, fast, took, asked = row
                print(
                    f"| {k} | {rms:.3f} | {nearly:.3f} | {most:.3f} | {fast:.1%} | {took:.1f} | {asked:.3f} |",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
