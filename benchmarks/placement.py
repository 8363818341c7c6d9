"""What another place for the part would gain: shipped problems as they are, and at the best place found.

python -m benchmarks.placement
python -m benchmarks.placement peer_cap curved_plate --maps docs

Each problem is searched, solved and verified by `python -m planner.place` itself, with its defaults. For long prints whose
layers repeat, only the first layer is used, as the table says.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from planner.base.distribution import crew
from planner.base.errors import EXIT_VERIFIED
from planner.base.progress import Stages
from planner.cell.cell import build_cell
from planner.place.command import METRICS, best_of, draw_map, outcomes, words
from planner.place.site import StudyRequest, axes_of, place_of, site_of
from planner.place.study import PlaceOutcome, crew_of, study
from planner.problem import load_problem

PROBLEMS = {
    "hemisphere_honeycomb": ["layers.count=1"],
    "peer_cap": [],
    "peer_cylinder": [],
    "planar_gcode": [],
    "fibre_plane": [],
    "cylinder_logo": ["layers.count=1"],
    "curved_plate": [],
    "aerofoil_core": ["layers.count=1", "layers.source.size_mm=[30, 99]"],
}
SOLVED = 3  # places


def rows(name: str, overrides: list[str], maps: Path | None) -> list[list[str]]:
    """Two lines of the table: as the problem stands, and the best verified place."""
    start = time.process_time()
    problem = load_problem(name, overrides)
    cell, asked = build_cell(problem), StudyRequest(name, tuple(overrides))
    site = site_of(asked, problem, cell, axes_of(problem, cell, place_of(problem), None, []))
    with crew() as over:
        alone = crew_of(asked, site, over, beside=False)
        found = study(site, alone, SOLVED, Stages().counted)
        searched = time.process_time() - start
        if maps is not None:
            draw_map(found, f"{name}: where it can be printed, and how well", maps / f"placement_{name}.png")
        solved = outcomes(found, alone, lambda: None)
    best = best_of(solved) or solved[0]
    names = [axis.name for axis in site.axes]
    gain = best.metrics["sigma_min"] / solved[0].metrics["sigma_min"] - 1.0 if solved[0].metrics else 0.0
    title = " ".join([name, *overrides])
    return [
        [title, *_cells(solved[0], names), "", ""],
        ["", *_cells(best, names), f"{gain:+.0%}", f"{searched:.0f}"],
    ]


def _cells(outcome: PlaceOutcome, names: Sequence[str]) -> list[str]:
    if outcome.failure is not None:
        return [words(outcome.place, names), outcome.failure, *[""] * len(METRICS)]
    figures = [f"{outcome.metrics[key] * scale:.{digits}f}" for key, _, scale, digits in METRICS]
    return [words(outcome.place, names), f"{outcome.score:.2f}", *figures]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.placement", description=__doc__)
    parser.add_argument("problems", nargs="*", help=f"default: {', '.join(PROBLEMS)}")
    parser.add_argument("--maps", type=Path, metavar="DIR", help="draw each map there")
    options = parser.parse_args(arguments)
    table = Table("problem", "place", "score", *(heading for _, heading, _, _ in METRICS), "sigma gained", "search s")
    for name in options.problems or PROBLEMS:
        for cells in rows(name, PROBLEMS.get(name, []), options.maps):
            table.add_row(*cells)
        print(f"{name}: done", file=sys.stderr)
    Console(width=190).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
