"""Every shipped problem, solved by the command itself: time, errors, and the spacing of its layers.

python -m benchmarks.parts
python -m benchmarks.parts naca0015_wing aerofoil_core --pictures docs/pictures

The tip rule is the nozzle's least distance from part and print where the requirement grows with the distance from the tip
(2 mm is required); clearance is the least distance between any two bodies beyond the tip.

Spacing is measured on the planned lines alone: from places on a layer to the nearest lines of the layer beneath, along
the mean of both normals. On parallel curves this is exact up to the square of the angle between them. Where no line is
nearly beneath, as at trimmed edges and over loose infill, nothing is measured.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from benchmarks.command import told
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED
from planner.problem import load_problem, shipped_problems
from planner.report.picture import draw_picture
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath

BENEATH = 0.35  # bead widths aside: a line no farther off lies beneath
NEARLY = 0.02  # of the nominal spacing
AWAY = 3.0  # bead widths from the ends of a bead and of the layer beneath: its edges are trimmed
COLUMNS = (
    "problem", "cell", "beads", "layers", "length mm", "command s", "verified", "at speed", "axis deg", "position mm",
    "spacing: median", "within 2 %", "print s", "tip rule mm", "clearance mm",
)  # fmt: skip


@dataclass(frozen=True)
class Spacing:
    """Distance of layers over their nominal height: the median, and the share of places within 2 %; places counted."""

    median: float
    within: float
    places: int


def spacing(toolpath: Toolpath) -> Spacing | None:
    """How far layers lie above those beneath, over what they should; None where no layer lies above another."""
    layers: dict[int, list[Bead]] = {}
    for bead in toolpath.beads:
        layers.setdefault(bead.layer, []).append(bead)
    ratios = [np.zeros(0)]
    for layer, beads in layers.items():
        if layer - 1 in layers:
            ratios.append(_ratios(layers[layer - 1], beads))
    every = np.concatenate(ratios)
    if not len(every):
        return None
    return Spacing(float(np.median(every)), float((np.abs(every - 1.0) <= NEARLY).mean()), len(every))


def _ratios(beneath: Sequence[Bead], above: Sequence[Bead]) -> Array:
    """Distances (n,) over nominal ones, at the places of the beads above with a line nearly beneath."""
    x0, n0 = (np.vstack([getattr(bead, name) for bead in beneath]) for name in ("points", "normals"))
    inner = np.concatenate([_inner(bead) for bead in beneath])
    tree = cKDTree(x0)
    found = []
    for bead in above:
        x, n, height = (a[_inner(bead)] for a in (bead.points, bead.normals, bead.height))
        if not len(x):
            continue
        _, k = tree.query(x - height[:, None] * n)
        mean = 0.5 * (n + n0[k])
        apart = ((x - x0[k]) * mean).sum(axis=1)
        aside = np.linalg.norm(x - x0[k] - apart[:, None] * mean, axis=1)
        near = (aside <= BENEATH * bead.width[0]) & inner[k]
        found.append(apart[near] / height[near])
    return np.concatenate([np.zeros(0), *found])


def _inner(bead: Bead) -> NDArray[np.bool_]:
    """Places (n,) of a bead away from its ends."""
    edge = 0.0 if bead.closed else AWAY * float(bead.width[0])
    return (bead.s >= edge) & (bead.s <= bead.length - edge)


def row(name: str, pictures: Path | None) -> tuple[list[str], bool]:
    """One line of the table, and whether the plan is verified."""
    problem = load_problem(name)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / problem.name
        start = time.monotonic()
        command = [sys.executable, "-m", "planner.solve", name, "--quiet", "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = time.monotonic() - start
        if not (out / "plan.json").is_file():
            return [name, problem.cell.arm, *[""] * 3, f"{seconds:.1f}", done.stderr.strip()], False
        plan = json.loads((out / "plan.json").read_text(encoding="utf-8"))
        if pictures is not None and (out / "trajectory.csv").is_file():
            draw_picture(out, pictures / f"{problem.name}.png")
    return [name, problem.cell.arm, *_figures(plan, seconds, spacing(build_toolpath(problem)))], bool(plan["verified"])


def _figures(plan: dict[str, Any], seconds: float, layers: Spacing | None) -> list[str]:
    m = plan["metrics"]
    if not m:
        return ["", "", "", f"{seconds:.1f}", "no plan"]
    rule = next(check["worst"] for check in plan["checks"] if check["name"] == "nozzle clear of part and print")
    return [
        f"{m['beads']:.0f}",
        f"{m['layers']:.0f}",
        f"{m['deposited_length_mm']:.0f}",
        f"{seconds:.1f}",
        "yes" if plan["verified"] else "no",
        f"{m['at_speed_fraction']:.1%}",
        f"{m['axis_error_max_deg']:.3f}",
        f"{m['position_error_max_mm']:.4f}",
        "" if layers is None else f"{layers.median:.4f}",
        "" if layers is None else f"{layers.within:.1%} of {layers.places}",
        f"{m['print_time_s']:.0f}",
        f"{rule:.2f}",
        f"{m['clearance_min_mm']:.1f}",
    ]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 if every plan is verified."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.parts", description=__doc__)
    parser.add_argument("problems", nargs="*", help="default: every problem that ships")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw each plan there")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS, title=f"{os.cpu_count()} cores, {platform.machine()}")
    verified = True
    for name in options.problems or shipped_problems():
        cells, good = row(name, options.pictures)
        table.add_row(*cells)
        verified &= good
    Console(width=190).print(table)
    return EXIT_VERIFIED if verified else 3


if __name__ == "__main__":
    sys.exit(main())
