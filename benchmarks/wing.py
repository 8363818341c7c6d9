"""The wing's layers compared with the figures of Arigela et al.: their number, the length of each, and the print time.

python -m benchmarks.wing
python -m benchmarks.wing naca0015_wing_tapered
python -m benchmarks.wing --flow --set layers.count=2 --set layers.support=null
python -m benchmarks.wing --cases
python -m benchmarks.wing --cases "case 2"

The time is length / commanded speed: the summary of `python -m planner.solve` gives what dips and travel add.

With --flow the print is planned twice, with its passes joined as one zig-zag and with each as its own bead. For both, the
command prints how much a motor that is only on or off lays per millimetre.

With --cases the straight wing is also planned in the paper's three conventional ways (its figures 6 to 8), with a motor that
follows the speed, and a Markdown table compares them with the curved layers; with names of cases, only these.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial import ConvexHull

from benchmarks.command import told
from planner.base.errors import EXIT_VERIFIED
from planner.plan import Plan
from planner.planning.pipeline import solve
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

WAYS = ("joined", "apart")
_FOLLOWS = "process.extruder.motor=e_axis"
_MESH = (
    "layers={{source: {{mesh: naca0015_wing.stl, rpy_deg: {}, origin_mm: {}}}, upper: {{z_mm: {}}}, height_mm: 0.5}}"
)
# The paper's table 1. It lays the support of case 3 up to the greatest thickness; here the nose overhangs.
CASES = {
    "case 1": ("layers.source.method=planar", "layers.support.curved=0", _FOLLOWS),
    "case 2": (_MESH.format("[90, 0, 0]", "[0, 8.7016, 0]", 20), _FOLLOWS),
    "case 3": (_MESH.format("[0, -90, 0]", "[8.7016, 0, -15]", 80), _FOLLOWS),
    "curved layers": (),
}


def own_figures(problem: Problem, toolpath: Toolpath) -> dict[str, float]:
    """The figures of PAPER as the toolpath has them; infill is that of the first layer of each."""
    wing = [bead for bead in toolpath.beads if bead.name.startswith("layer")]
    support = [bead for bead in toolpath.beads if not bead.name.startswith("layer")]
    level = [bead for bead in support if (bead.normals == [0.0, 0.0, 1.0]).all()]
    curved = {bead.layer for bead in support} - {bead.layer for bead in level}
    return {
        "layer height, mm": float(np.mean([bead.height.mean() for bead in wing])) * 1e3,
        "speed, mm/s": problem.process.speed * 1e3,
        "infill of the wing, %": _filled([bead for bead in wing if bead.layer == wing[0].layer]),
        "infill of the support, %": _filled([b for b in level if b.layer == level[0].layer]) if level else float("nan"),
        "curved layers of the support": float(len(curved)),
    }


# The wing with one nozzle for both materials, for what is made for one.
ONE_NOZZLE = (
    "cell.nozzle={tip_mm: [0, 0, 150], axis: [1, 0, 1], diameter_mm: 0.5}",
    "cell.nozzles={}",
    "process.materials.black_pla.nozzle=null",
    "process.materials.yellow_pla.nozzle=null",
)


def _filled(beads: Sequence[Bead]) -> float:
    """Share of its layer that beads cover [%]: their area over that of the hull of their places, half a width wider."""
    width = float(beads[0].width.mean())
    hull = ConvexHull(np.vstack([bead.points[:, :2] for bead in beads]))
    area = hull.volume + 0.5 * width * hull.area  # in two dimensions: area and circumference
    steep = float(np.mean(np.concatenate([1.0 / bead.normals[:, 2] for bead in beads])))
    return 100.0 * sum(bead.length for bead in beads) * width / (area * steep)


def even_flow(name: str, changes: Sequence[str]) -> Table:
    """What flows by the millimetre with passes joined and apart; a plan that is not verified is told, too."""
    table = Table("", *WAYS, title=f"{name}: a motor that is on or off")
    plans = [solve(load_problem(name, [*changes, f"layers.passes={way}"]), baseline=False) for way in WAYS]
    rows: list[tuple[str, Callable[[Plan], str]]] = [
        ("beads", lambda plan: f"{plan.metrics['beads']:.0f}"),
        ("millimetres with even flow, %", lambda plan: f"{100.0 * plan.metrics['even_flow_fraction']:.2f}"),
        ("worst off the ends of beads, %", lambda plan: f"{100.0 * plan.metrics['flow_error_max']:.1f}"),
        ("too much material, mm³", lambda plan: f"{plan.metrics['over_extruded_mm3']:.1f}"),
        ("at speed, %", lambda plan: f"{100.0 * plan.metrics['at_speed_fraction']:.1f}"),
        ("deposition, s", lambda plan: f"{plan.metrics['deposition_time_s']:.1f}"),
        ("print, s", lambda plan: f"{plan.metrics['print_time_s']:.1f}"),
        ("checks that fail", lambda plan: ", ".join(each.name for each in plan.checks if not each.ok) or "none"),
    ]
    for label, value in rows:
        table.add_row(label, *(value(plan) for plan in plans))
    return table


def cases(names: Sequence[str], changes: Sequence[str]) -> Iterator[str]:
    """Lines of a table of conventional ways and of the curved layers, as they are planned and verified."""
    yield "| | layers, beads | length, m | at speed | slowest, mm/s | least clearance, mm | σ | print, s | verified |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for name in names:
        plan = solve(load_problem("naca0015_wing", (*ONE_NOZZLE, *CASES[name], *changes)), baseline=False)
        m = plan.metrics
        failed = [check.name for check in plan.checks if not check.ok]
        yield (
            f"| {name} | {m['layers']:,.0f}, {m['beads']:,.0f} | {m['deposited_length_mm'] / 1e3:.1f} "
            f"| {m['at_speed_fraction']:.1%} | {m['speed_min_mm_s']:.1f} | {m['clearance_min_mm']:.1f} "
            f"| {m['sigma_min']:.3f} | {m['print_time_s']:,.0f} | {'no: ' + ', '.join(failed) if failed else 'yes'} |"
        ).replace("%", " %")


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.wing", description=__doc__)
    parser.add_argument("problem", nargs="?", default="naca0015_wing")
    parser.add_argument("--flow", action="store_true", help="plan it, and tell what flows by the millimetre")
    parser.add_argument(
        "--cases", nargs="*", choices=CASES, help="plan the straight wing in the paper's conventional ways"
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args(arguments)
    console = Console(width=150)
    if options.cases is not None:
        for line in cases(options.cases or list(CASES), options.set):
            print(line, flush=True)
        return EXIT_VERIFIED
    if options.flow:
        console.print(even_flow(options.problem, options.set))
        return EXIT_VERIFIED
    problem = load_problem(options.problem, options.set)
    toolpath = build_toolpath(problem)
    if not isinstance(problem.layers, AerofoilLayersSpec):
        print(f"error: {problem.name} is no wing", file=sys.stderr)
        return 2
    table = Table("", "paper", problem.name, title="Arigela et al.")
    for name, value in own_figures(problem, toolpath).items():
        table.add_row(name, f"{PAPER[name]:g}", f"{value:.4g}")
    console.print(table)
    layers = Table("layer", "beads", "length mm", "time s", title=f"{toolpath.layers} layers")
    for layer, group in groupby(toolpath.beads, key=lambda bead: bead.layer):
        beads = list(group)
        length = sum(bead.length for bead in beads)
        name = beads[0].name.partition(" piece")[0].partition(" pass")[0]
        layers.add_row(f"{layer + 1}: {name}", str(len(beads)), f"{length * 1e3:.1f}", _time(length, problem))
    layers.add_row("all", str(len(toolpath.beads)), f"{toolpath.length * 1e3:.1f}", _time(toolpath.length, problem))
    console.print(layers)
    return EXIT_VERIFIED


def _time(length: float, problem: Problem) -> str:
    return f"{length / problem.process.speed:.1f}"


if __name__ == "__main__":
    sys.exit(main())
