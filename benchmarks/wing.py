"""The wing's layers beside the figures of Arigela et al.: their number, the length of each, and the time of the print.

python -m benchmarks.wing
python -m benchmarks.wing naca0015_wing_tapered

The time is length / commanded speed: what dips and travel add stands in the summary of `python -m planner.solve`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import ConvexHull

from planner.base.errors import EXIT_VERIFIED, PlannerError
from planner.problem import Problem, load_problem
from planner.problem.layers import AerofoilLayersSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath

# Arigela et al., table 3, and their drawing of wing and support
PAPER = {
    "layer height, mm": 0.5,
    "speed, mm/s": 40.0,
    "infill of the wing, %": 100.0,
    "infill of the support, %": 50.0,
    "curved layers of the support": 2.0,
}


def own_figures(problem: Problem, toolpath: Toolpath) -> dict[str, float]:
    """The figures of PAPER as the toolpath has them; infill is that of the first layer of each."""
    wing = [bead for bead in toolpath.beads if bead.name.startswith("layer")]
    level = [b for b in toolpath.beads if not b.name.startswith("layer") and np.ptp(b.points[:, 2]) < 1e-9]
    curved = {b.layer for b in toolpath.beads if not b.name.startswith("layer")} - {b.layer for b in level}
    return {
        "layer height, mm": float(np.mean([bead.height.mean() for bead in wing])) * 1e3,
        "speed, mm/s": problem.process.speed * 1e3,
        "infill of the wing, %": _filled(wing[0]),
        "infill of the support, %": _filled(level[0]) if level else float("nan"),
        "curved layers of the support": float(len(curved)),
    }


def _filled(bead: Bead) -> float:
    """Share of its layer that a bead covers [%]: its area over that of the hull of its places, half a width wider."""
    width = float(bead.width.mean())
    hull = ConvexHull(bead.points[:, :2])
    area = hull.volume + 0.5 * width * hull.area  # in two dimensions: area and circumference
    return 100.0 * bead.length * width / (area * float((1.0 / bead.normals[:, 2]).mean()))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.wing", description=__doc__)
    parser.add_argument("problem", nargs="?", default="naca0015_wing")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    try:
        problem = load_problem(options.problem, options.set)
        toolpath = build_toolpath(problem)
    except PlannerError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if not isinstance(problem.layers, AerofoilLayersSpec):
        print(f"error: {problem.name} is no wing", file=sys.stderr)
        return 2
    console = Console(width=150)
    table = Table("", "paper", problem.name, title="Arigela et al.")
    for name, value in own_figures(problem, toolpath).items():
        table.add_row(name, f"{PAPER[name]:g}", f"{value:.4g}")
    console.print(table)
    layers = Table("layer", "beads", "length mm", "time s", title=f"{toolpath.layers} layers")
    for layer, group in groupby(toolpath.beads, key=lambda bead: bead.layer):
        beads = list(group)
        length = sum(bead.length for bead in beads)
        name = beads[0].name.partition(" piece")[0]
        layers.add_row(f"{layer + 1}: {name}", str(len(beads)), f"{length * 1e3:.1f}", _time(length, problem))
    layers.add_row("all", str(len(toolpath.beads)), f"{toolpath.length * 1e3:.1f}", _time(toolpath.length, problem))
    console.print(layers)
    return EXIT_VERIFIED


def _time(length: float, problem: Problem) -> str:
    return f"{length / problem.process.speed:.1f}"


if __name__ == "__main__":
    sys.exit(main())
