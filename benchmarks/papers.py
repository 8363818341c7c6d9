"""The figures of the four papers next to those of the problems that rebuild their prints.

python -m benchmarks.papers                            the problems' own figures, and their toolpaths
python -m benchmarks.papers --paper onstein --solve    the same for one paper, with each problem planned and verified

A figure that differs has its reason. Exit code 3 if one differs without a reason, or a plan is not verified.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from rich.console import Console
from rich.table import Table
from ruamel.yaml import YAML

from benchmarks.command import told
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.cell.cell import build_cell
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.drawings import ProjectedCurvesSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath

CLOSE = 1e-6  # by which a figure may be off and be the same

Figure = float | str | tuple[float, ...]


class Rebuilt:
    """A problem that rebuilds a print of a paper; its toolpath is built when somebody asks for it."""

    def __init__(self, name: str) -> None:
        self.problem: Problem = load_problem(name)
        self._file = YAML(typ="safe").load(self.problem.file.read_text(encoding="utf-8"))

    @cached_property
    def toolpath(self) -> Toolpath:
        """What is printed."""
        return build_toolpath(self.problem)

    @property
    def part_at_mm(self) -> tuple[float, ...]:
        """Where the part frame stands, with all free axes at 0 [mm]."""
        return tuple((1e3 * build_cell(self.problem).T_world_holder[:3, 3]).tolist())

    def said(self, key: str) -> Figure:
        """What the problem's file says at a dotted key, in the key's own unit. Raises KeyError where it says nothing."""
        value = self._file
        for part in key.split("."):
            value = value[part]
        return (
            value if isinstance(value, str) else tuple(map(float, value)) if isinstance(value, list) else float(value)
        )


@dataclass(frozen=True)
class PaperFigure:
    """A figure of a paper, and where a problem has its own: a key of its file, or what finds it.

    differs: why they are not the same, where they are not
    """

    problem: str
    what: str
    paper: Figure
    of: str | Callable[[Rebuilt], Figure]
    differs: str = ""

    def here(self, rebuilt: Rebuilt) -> Figure:
        """The problem's own figure, in the paper's unit."""
        return rebuilt.said(self.of) if isinstance(self.of, str) else self.of(rebuilt)

    def holds(self, found: Figure) -> bool:
        """Whether that is the paper's, or it is told why not."""
        return self.differs != "" or is_same(self.paper, found)


def is_same(paper: Figure, found: Figure) -> bool:
    """Whether two figures are the same."""
    if isinstance(paper, str) or isinstance(found, str):
        return paper == found
    a, b = np.atleast_1d(np.asarray(paper)), np.atleast_1d(np.asarray(found))
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=CLOSE, atol=CLOSE))


def pollard() -> tuple[PaperFigure, ...]:
    """Pollard et al. (2018), and the program that its authors published."""
    logo, dome, core, tapered = "cylinder_logo", "hemisphere_honeycomb", "aerofoil_core", "aerofoil_core_tapered"
    bed = (560.0, -93.0, 290.0)
    return (
        PaperFigure(logo, "arm", "irb140", "cell.arm"),
        PaperFigure(logo, "positioner", "irbp_a250", "cell.positioner.robot"),
        PaperFigure(logo, "nozzle's tip from the flange, mm", (-44.51, 9.9, 113.95), "cell.nozzle.tip_mm"),
        PaperFigure(logo, "nozzle's bore, mm", 0.6, "cell.nozzle.diameter_mm"),
        PaperFigure(logo, "start posture, °", (30.0, 20.0, 30.0, 90.0, -80.0, 60.0), "cell.home_deg"),
        PaperFigure(logo, "turntable's origin, mm", (633.5, 9.87, 380.0), lambda r: r.part_at_mm),
        PaperFigure(logo, "cylinder's radius, mm", 34.0, "part.cylinder.radius_mm"),
        PaperFigure(logo, "cylinder's height, mm", 100.0, "part.cylinder.height_mm"),
        PaperFigure(logo, "its centre from the axis, mm", (31.4, 37.0), "part.cylinder.centre_mm"),
        PaperFigure(logo, "layers", 10.0, "layers.count"),
        PaperFigure(logo, "height of a layer, mm", 0.5, "layers.height_mm"),
        PaperFigure(logo, "speed in deposition, mm/s", "25 to 50", "process.speed_mm_s", "within"),
        PaperFigure(logo, "speed in travel, mm/s", 200.0, "process.travel_speed_mm_s"),
        PaperFigure(logo, "logo's width, mm", 80.0, "layers.source.width_mm", "a logo of our own"),
        PaperFigure(dome, "bed, mm", bed, "cell.bed_mm"),
        PaperFigure(dome, "height of a layer, mm", 0.5, "layers.height_mm"),
        PaperFigure(dome, "layers lie above each other along", "normal", "layers.offset"),
        PaperFigure("hemisphere_logo", "bed, mm", bed, "cell.bed_mm"),
        PaperFigure(core, "bed, mm", bed, "cell.bed_mm"),
        PaperFigure(core, "span and chord of the core, mm", (70.0, 100.0), "layers.source.size_mm"),
        PaperFigure(tapered, "heights of layers", "varying", "layers.heights"),
        PaperFigure(tapered, "span and chord of the core, mm", (100.0, 88.0), "layers.source.size_mm"),
    )


def arigela() -> tuple[PaperFigure, ...]:
    """Arigela et al."""
    wing, tapered = "naca0015_wing", "naca0015_wing_tapered"
    return (
        PaperFigure(wing, "arm", "irb1600_12", "cell.arm"),
        PaperFigure(wing, "chord, mm", 80.0, "layers.source.chord_mm"),
        PaperFigure(wing, "span, mm", 20.0, "layers.source.span_mm"),
        PaperFigure(wing, "leading edge, mm", (15.0, 0.0, 8.7016), "layers.source.origin_mm"),
        PaperFigure(wing, "height of a layer, mm", 0.5, "layers.height_mm"),
        PaperFigure(wing, "nozzle's bore, mm", 0.5, "cell.nozzles.tBlack.diameter_mm"),
        PaperFigure(wing, "speed of the tip, mm/s", 40.0, "process.speed_mm_s"),
        PaperFigure(wing, "lean of the layers at most, °", 45.0, "layers.source.tilt_deg"),
        PaperFigure(wing, "support's length, mm", 110.0, "layers.support.length_mm"),
        PaperFigure(wing, "support's height, mm", 8.5, "layers.support.height_mm"),
        PaperFigure(wing, "support's infill", 0.5, "layers.support.infill"),
        PaperFigure(wing, "curved layers of the support", 2.0, "layers.support.curved"),
        PaperFigure(wing, "motor of the extruder", "on_off", "process.extruder.motor"),
        PaperFigure(wing, "nozzle, °C", 195.0, "process.start.nozzle_c"),
        PaperFigure(wing, "bed, °C", 70.0, "process.start.bed_c"),
        PaperFigure(tapered, "chord at the root, mm", 80.0, "layers.source.chord_mm"),
        PaperFigure(tapered, "span, mm", 20.0, "layers.source.span_mm"),
    )


def tawfik() -> tuple[PaperFigure, ...]:
    """Tawfik et al."""
    bent = ("fibre_plane", "fibre_bowl")
    every = (*bent, "fibre_corrugated")
    bowed = "such chords would leave a bent surface by more than the tow is thick"
    return (
        *(PaperFigure(name, "arm that prints", "irb1200_09", "cell.arm") for name in every),
        *(PaperFigure(name, "arm that holds", "irb1200_09", "cell.positioner.robot") for name in every),
        *(PaperFigure(name, "NURBS", "degree 2, 4 points", _curves) for name in bent),
        *(PaperFigure(name, "feed, mm/min", 300.0, lambda r: 6e4 * r.problem.process.speed) for name in every),
        *(PaperFigure(name, "nozzle, °C", 280.0, "process.start.nozzle_c") for name in every),
        *(PaperFigure(name, "heating", "wait", "process.start.heat") for name in every),
        *(PaperFigure(name, "lines of G-code through", "socket", "program.style") for name in every),
        *(PaperFigure(name, "tangent and chord, °", 45.0, "program.tangent_deg") for name in every),
        PaperFigure("fibre_plane", "chord off the curve, mm", 1.0, "program.chord_mm"),
        *(PaperFigure(name, "chord off the curve, mm", 1.0, _chord, bowed) for name in every[1:]),
        *(PaperFigure(name, "rest at the cut, s", 3.0, "process.fibre.cut_wait_s") for name in every),
    )


def _chord(rebuilt: Rebuilt) -> float:
    """How far the program's moves may leave the curve [mm]."""
    return 1e3 * rebuilt.problem.program.chord


def _curves(rebuilt: Rebuilt) -> str:
    """Degrees and numbers of control points of the curves."""
    layers = rebuilt.problem.layers
    if not isinstance(layers, ProjectedCurvesSpec):
        return "none"
    return " and ".join(sorted({f"degree {each.degree}, {len(each.points)} points" for each in layers.source.curves}))


def onstein() -> tuple[PaperFigure, ...]:
    """Onstein et al. (2020)."""
    faces = ("curved_plate", "propeller_blade")
    every = (*faces, "shoehorn")
    seams = "over four faces one bead would cross itself"
    return (
        *(PaperFigure(name, "arm", "irb140", "cell.arm") for name in every),
        *(PaperFigure(name, "samples, d_u* = d_v*, mm", 10.0, "layers.source.spacing_mm") for name in every),
        *(PaperFigure(name, "path", "weighted_greedy", "layers.source.path") for name in every),
        *(PaperFigure(name, "beads", 1.0, lambda r: float(len(r.toolpath.beads))) for name in faces),
        PaperFigure("shoehorn", "beads", 1.0, lambda r: float(len(r.toolpath.beads)), seams),
    )


PAPERS = {"pollard": pollard, "arigela": arigela, "tawfik": tawfik, "onstein": onstein}


def shown(figure: Figure) -> str:
    """A figure in words."""
    if isinstance(figure, str):
        return figure
    return ", ".join(f"{x:.6g}" for x in np.atleast_1d(np.asarray(figure)).tolist())


def planned(name: str) -> tuple[list[str], bool]:
    """A row of what verification says of a problem's plan, and whether that holds."""
    start = time.perf_counter()
    plan = solve(load_problem(name), second_process=True, baseline=False)
    m = plan.metrics
    failed = ", ".join(check.name for check in plan.checks if not check.ok)
    return [
        name,
        f"{len(plan.checks)} checks hold" if plan.verified else f"not verified: {failed}",
        f"{m['layers']:.0f}, {m['beads']:.0f}",
        f"{m['deposited_length_mm'] * 1e-3:.2f}",
        f"{m['at_speed_fraction']:.2%}",
        f"{m['print_time_s']:.0f}",
        f"{time.perf_counter() - start:.0f}",
    ], plan.verified


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.papers", description=__doc__.split("\n")[0])
    parser.add_argument("--paper", nargs="+", choices=list(PAPERS), default=list(PAPERS))
    parser.add_argument("--solve", action="store_true", help="plan and verify each problem, too")
    options = parser.parse_args(arguments)
    console, good = Console(width=150), True
    for paper in options.paper:
        figures = PAPERS[paper]()
        rebuilt = {figure.problem: Rebuilt(figure.problem) for figure in figures}
        table = Table("problem", "figure", "paper", "here", "", title=paper.capitalize(), title_justify="left")
        for figure in figures:
            found = figure.here(rebuilt[figure.problem])
            good = good and figure.holds(found)
            note = "same" if is_same(figure.paper, found) else figure.differs or "DIFFERS"
            table.add_row(figure.problem, figure.what, shown(figure.paper), shown(found), note)
        console.print(table)
        if options.solve:
            table = Table("problem", "verified", "layers, beads", "length m", "at speed", "print s", "planned in s")
            for name in rebuilt:
                row, verified = planned(name)
                table.add_row(*row)
                good = good and verified
            console.print(table)
    return EXIT_VERIFIED if good else EXIT_NOT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
