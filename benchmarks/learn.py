"""How far a simulated robot deviates from a plan, run by run, while its program learns from recordings.

python -m benchmarks.learn
python -m benchmarks.learn cylinder_logo --runs 3 --noise-deg 0.01

The robots are the controller models that play programs, and others that no model covers: joints that lag by different
times, corners cut by the full parabola in a zone, noise in the recording. The printed value is the true distance of the
executed tip from the plan, across it and on beads, without the noise.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from benchmarks.wing import ONE_NOZZLE
from planner.base.arrays import Array
from planner.base.command_line import exit_code
from planner.base.progress import Stages
from planner.export.controllers import CONTROLLERS
from planner.export.languages import LANGUAGES
from planner.export.player.executed import executed_run
from planner.export.player.play import play
from planner.feedback.learn_command import in_words, language_of, learned_plan
from planner.feedback.learn_fit import Lessons, RunErrors, errors_of, next_lessons
from planner.feedback.learn_track import RecordedWay, recorded_way, way_along
from planner.feedback.recordings import read_log
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem

RATE = 250.0  # samples a second
MOST = 1e-3  # m beside the plan
NEAR = 0.1  # mm off it
AT_SPEED = 0.98  # of the commanded speed
BESIDE, AROUND = 10, 60  # samples before and behind a corner, by which it is chosen, and which are drawn
PRINTS: dict[str, tuple[str, ...]] = {
    "cylinder_logo": ("layers.count=1",),
    "hemisphere_honeycomb": ("layers.count=1",),
    "naca0015_wing": ("layers.count=1", *ONE_NOZZLE),
    "aerofoil_core": ("layers.count=1", "layers.source.size_mm=[30, 99]"),
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
    """Time (k) [s] and executed joints (k, n) [rad, m], as the controller counts them, of a run of a plan's program."""
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
    return way_along(plan, LANGUAGES[language_of(plan)].plan(plan).cell, time, q)


@dataclass(frozen=True)
class SimulatedRun:
    """A run: how far it truly was off its plan, its executed way, the plan with its program, and the greatest correction of
    that [mm]."""

    truth: RunErrors
    way: RecordedWay
    plan: Plan
    most: float

    def figures(self, plan: Plan) -> tuple[float, ...]:
        """Off the plan: root mean square, 99 %, most [mm], share of the time within 0.1 mm; share of the time at speed; how
        long the run took [s], and the greatest correction of its program [mm]."""
        size, rows = self.truth.size * 1e3, np.flatnonzero(self.truth.known)
        speed = self.truth.speed[rows]
        told = ~np.isnan(speed)
        fast = speed[told] >= AT_SPEED * plan.commanded[plan.trajectory.bead[rows[told]]]
        rms, within = float(np.sqrt((size**2).mean())), float((size <= NEAR).mean())
        return (
            rms,
            float(np.quantile(size, 0.99)),
            float(size.max()),
            within,
            float(fast.mean()),
            float(self.way.time[-1]),
            self.most,
        )


def runs_of(plan: Plan, robot: SimulatedRobot, runs: int, noise: float) -> list[SimulatedRun]:
    """The first run of a plan's program, and those that learned from so many before; fewer where no program is safe."""
    out: list[SimulatedRun] = []
    lessons: Lessons | None = None
    now = plan
    with tempfile.TemporaryDirectory() as folder:
        for k in range(runs + 1):
            time, q = recorded(now, robot)
            way = true_way(plan, time, q)
            most = 0.0 if lessons is None else lessons.corrections.most * 1e3
            out.append(SimulatedRun(errors_of(plan.trajectory, way), way, now, most))
            if k == runs:
                break
            log = read_log(write_log(plan, time, q, noise, k, Path(folder) / "run.csv"), plan.cell)
            errors = errors_of(plan.trajectory, recorded_way(plan, log, language_of(plan)))
            wanted = next_lessons(plan.trajectory, errors, lessons, MOST)
            learned = learned_plan(plan, wanted, errors, MOST, language_of(plan), Stages())
            if learned.failed:
                print(f"no safe program: {in_words(learned.failed)}")
                break
            now, lessons = learned.plan, learned.lessons
    return out


def write_picture(plan: Plan, runs: Sequence[SimulatedRun], path: Path) -> None:
    """A corner that the first run cuts, and how far runs are off, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    t, asked = plan.trajectory, runs[-1].plan.asked
    along = np.gradient(t.tip, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    turn = 1.0 - (along * np.roll(along, 2 * BESIDE, axis=0)).sum(axis=1)
    inside = t.deposit & np.roll(t.deposit, 4 * BESIDE) & np.roll(t.deposit, -4 * BESIDE)
    k = int(np.argmax(np.linalg.norm(runs[0].truth.off, axis=1) * np.roll(turn, -BESIDE) * inside))
    rows = slice(max(k - AROUND, 0), k + AROUND)
    z = t.axis[k]
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    flat = np.stack([x, np.cross(z, x)], axis=1)
    figure = Figure(figsize=(12.0, 5.0), dpi=120, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(*((t.tip[rows] - t.tip[k]) @ flat * 1e3).T, color="#9aa7b4", linewidth=5.0, label="plan")
    for run, colour, name in ((runs[0], "#d55e00", "run 1"), (runs[-1], "#0072b2", f"run {len(runs)}")):
        near = run.way.tip[np.abs(run.way.place - k) < AROUND]
        left.plot(*((near - t.tip[k]) @ flat * 1e3).T, color=colour, label=f"{name}, executed")
    if asked is not None:
        left.plot(
            *((asked.tip[rows] - t.tip[k]) @ flat * 1e3).T, "--", color="#0072b2", linewidth=0.8, label="asked for that"
        )
    left.set_xlim(-2.5, 2.5)
    left.set_ylim(-2.5, 2.5)
    left.set_aspect("equal")
    left.set_xlabel("mm")
    left.set_title(f"bead {t.bead[k]} at {t.s[k] * 1e3:.1f} mm", fontsize=10)
    left.legend(frameon=False, fontsize=9)
    for i, run in enumerate(runs):
        size = np.sort(run.truth.size) * 1e3
        right.plot(size, 1.0 - np.linspace(0.0, 1.0, len(size)), color=f"C{i}", label=f"run {i + 1}")
    right.set_yscale("log")
    right.set_ylim(1e-3, 1.0)
    right.set_xlabel("off the plan [mm]")
    right.set_ylabel("share of the time that is off by more")
    right.legend(frameon=False, fontsize=9)
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
    FigureCanvasAgg(figure).print_png(str(path), metadata={"Software": None})


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learn", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(PRINTS), help="of problems that ship, or files")
    parser.add_argument("--runs", type=int, default=5, help="that programs learn from (default 5)")
    parser.add_argument("--noise-deg", type=float, default=0.001, help="of recorded joints (default 0.001)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="in place of the usual ones")
    parser.add_argument("--robot", choices=tuple(ROBOTS), help="one of them only")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="a corner, and how far runs are off (PNG)")
    options = parser.parse_args(arguments)
    return exit_code(partial(_run, options), partial(print, file=sys.stderr))


def _run(options: argparse.Namespace) -> int:
    for name in options.names:
        plan = solve(load_problem(name, options.set or PRINTS.get(name, ())), baseline=False)
        for title, robot in ROBOTS.items():
            if options.robot not in (None, title):
                continue
            print(f"\n{name}, {title}, noise {options.noise_deg:g} degrees", flush=True)
            print(
                "| run | off the plan, rms | 99 % | most | within 0.1 mm | at speed | time, s | asked beside it, most |"
            )
            print("|---|---|---|---|---|---|---|---|")
            runs = runs_of(plan, robot, options.runs, np.radians(options.noise_deg))
            for k, run in enumerate(runs, 1):
                rms, nearly, most, within, fast, took, asked = run.figures(plan)
                print(
                    f"| {k} | {rms:.3f} | {nearly:.3f} | {most:.3f} | {within:.1%} | {fast:.1%} | {took:.1f} | {asked:.3f} |"
                )
            if options.picture is not None:
                write_picture(plan, runs, options.picture)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
