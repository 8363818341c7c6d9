"""Helices of 1 to 80 turns on a cylinder and on a cone: the default strategy compared with `as_published`.

python -m benchmarks.helices --turns 1 5 20 80

Two arms with a tilting turntable (IRB 140 and IRB 2600 with IRBP A250), with its rotation or both its axes free. The
default should verify every one, at speed on no less of the length than `as_published`; otherwise the exit code is 1.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from planner.base.errors import Refusal
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem

TURNS = (1, 5, 20, 80)
PITCH, LEAST_PITCH, HEIGHT = 2.0, 0.5, 60.0  # mm a turn, less where the part would be higher than that
FOOT = 60.0  # mm above the table, so that the head has room beside it
SPACING = 1.5  # mm between waypoints
LESS = 1e-3  # share of the length at speed by which the default may be behind
CELLS = {
    "irb140": (
        "  arm: irb140\n  nozzle: {tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}\n"
        "  home_deg: [30, 20, 30, 90, -80, 60]\n",
        "633.5, 9.87, 320",
        34.0,
    ),
    "irb2600": (
        "  arm: irb2600\n  nozzle: {tip_mm: [0, 0, 200], axis: [0, 0, 1], diameter_mm: 0.8}\n"
        "  home_deg: [0, 0, 0, 0, 60, 0]\n",
        "1100, 0, 600",
        80.0,
    ),
}
SLOPES = {"cylinder": 0.0, "cone": 0.3}  # of the wall: mm that the radius falls by for each mm of height
FREE = {"rotation": "held_deg: {tilt: 0}, free: [rotation]", "both": "free: [tilt, rotation]"}


@dataclass(frozen=True)
class Helix:
    """A case: an arm of CELLS, a wall of SLOPES, axes of FREE, and how many turns."""

    arm: str
    wall: str
    free: str
    turns: float

    def write(self, folder: Path) -> Path:
        """Write its waypoints and its problem; the problem's file."""
        arm, origin, radius = CELLS[self.arm]
        pitch = max(min(PITCH, HEIGHT / self.turns), LEAST_PITCH)
        slope = SLOPES[self.wall]
        angle = np.linspace(0.0, 2.0 * np.pi * self.turns, int(self.turns * 2.0 * np.pi * radius / SPACING))
        z = pitch * angle / (2.0 * np.pi) + FOOT
        r = radius - slope * (z - FOOT)
        normal = np.column_stack([np.cos(angle), np.sin(angle), np.full(len(angle), slope)]) / np.hypot(1.0, slope)
        np.savetxt(folder / "helix.txt", np.column_stack([r * np.cos(angle), r * np.sin(angle), z, normal]), fmt="%.5f")
        file = folder / "helix.yaml"
        file.write_text(
            f"name: helix\ncell:\n{arm}  positioner: {{robot: irbp_a250, origin_mm: [{origin}], {FREE[self.free]}}}\n"
            "layers:\n  source: {waypoints: helix.txt}\nprocess:\n  speed_mm_s: 40\n  travel_speed_mm_s: 200\n"
            "  bead: {width_mm: 0.8, height_mm: 0.5}\n",
            encoding="utf-8",
        )
        return file


@dataclass(frozen=True)
class Outcome:
    """How a strategy ended: what to say, whether it verified, its share of the length at speed, and its seconds."""

    words: str
    verified: bool
    at_speed: float
    seconds: float


def outcome(problem: Problem, strategy: str) -> Outcome:
    """Plan and verify."""
    start = time.perf_counter()
    try:
        plan = solve(problem, strategy, baseline=False)
    except Refusal as refusal:
        return Outcome(f"refused: {refusal}", False, 0.0, time.perf_counter() - start)
    seconds, metrics = time.perf_counter() - start, plan.metrics
    missed = ", ".join(check.name for check in plan.checks if not check.ok)
    words = f"{100 * metrics['at_speed_fraction']:.2f} %, {metrics['print_time_s']:.1f} s"
    return Outcome(
        f"{words}; fails: {missed}" if missed else words, plan.verified, metrics["at_speed_fraction"], seconds
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.helices", description=__doc__.partition("\n")[0])
    parser.add_argument("--turns", type=float, nargs="+", default=list(TURNS), metavar="N", help="default: 1 5 20 80")
    parser.add_argument("--arms", nargs="+", default=list(CELLS), choices=list(CELLS))
    options = parser.parse_args(arguments)
    if min(options.turns) <= 0.0:
        parser.error("argument --turns: must be above 0")
    table = Table("arm", "wall", "free", "turns", "waypoints", "as_published", "default", "s", "", title_justify="left")
    kept = True
    for arm, wall, free, turns in itertools.product(options.arms, SLOPES, FREE, options.turns):
        with tempfile.TemporaryDirectory() as folder:
            file = Helix(arm, wall, free, turns).write(Path(folder))
            waypoints = len(file.with_suffix(".txt").read_text(encoding="utf-8").splitlines())
            problem = load_problem(file)
            published, own = outcome(problem, "as_published"), outcome(problem, "sqp")
        behind = own.at_speed < published.at_speed - LESS if published.verified else False
        verdict = "behind" if behind else "" if own.verified else "not verified"
        kept = kept and not verdict
        row = [arm, wall, free, f"{turns:g}", f"{waypoints}", published.words, own.words, f"{own.seconds:.1f}", verdict]
        table.add_row(*row)
        print(" | ".join(row), file=sys.stderr, flush=True)
    Console(width=200).print(table)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
