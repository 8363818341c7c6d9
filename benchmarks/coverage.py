"""How paths over a face compare: the paper's two kinds of face at 10 mm, its three orders of samples, and our rows.

python -m benchmarks.coverage [--spacing MM] [--speed MM_PER_S] [--tolerance MM]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.faces import BLADE, CURVED_PLATE, FormulaFace, sampled
from planner.toolpath.coverage import measures
from planner.toolpath.coverage.measures import Line
from planner.toolpath.coverage.registry import ORDERS
from planner.toolpath.coverage.rows import REACH, cover

FACES = {"curved plate": CURVED_PLATE, "propeller blade": BLADE}
COLUMNS = (
    "face",
    "path",
    "samples",
    "once",
    "crosses",
    "strokes",
    "length m",
    "turns",
    "turned °",
    "time s",
    "far",
    "CPU s",
)
CLOSER = 0.95  # each time, of the spacing of samples, until nothing is farther from the path than REACH
LOOKS = 400  # points along u and along v to which the distance is measured


def looked_at(face: FormulaFace) -> np.ndarray:
    """Points (n, 3) all over an untrimmed face."""
    low, high = face.loops[0].min(axis=0), face.loops[0].max(axis=0)
    u, v = np.meshgrid(*(np.linspace(low[i], high[i], LOOKS) for i in range(2)))
    return face.points(np.stack([u.ravel(), v.ravel()], axis=1))


def measured(lines: Sequence[Line], points: np.ndarray, spacing: float, speed: float, tolerance: float) -> list[str]:
    """What is said of every path, from `crosses` on."""
    turns, turned = measures.turns(lines, spacing)
    return [
        "yes" if len(measures.crossings(lines)) else "no",
        str(len(lines)),
        f"{measures.length(lines):.2f}",
        str(turns),
        f"{np.degrees(turned):.0f}",
        f"{measures.seconds(lines, speed, tolerance):.1f}",
        f"{measures.farthest(lines, points) / spacing:.2f}",
    ]


def rows_of(name: str, face: FormulaFace, spacing: float, speed: float, tolerance: float) -> list[list[str]]:
    """Lines of the table for one face."""
    points = looked_at(face)
    out = []
    surface = sampled(face, spacing)
    for path, order_of in ORDERS.items():
        start = time.process_time()
        order = order_of(surface)
        cpu = f"{time.process_time() - start:.2f}"
        once = "yes" if measures.visits_each_once(order, len(surface.points)) else "NO"
        figures = measured([measures.laid(surface, order)], points, spacing, speed, tolerance)
        out.append([name, path, str(len(surface.points)), once, *figures, cpu])
    closer, reached = spacing, np.inf
    while reached > REACH * spacing:
        closer *= CLOSER
        surface = sampled(face, closer)
        line = measures.laid(surface, ORDERS["weighted_greedy"](surface))
        reached = measures.farthest([line], points)
    figures = measured([line], points, spacing, speed, tolerance)
    path = f"weighted_greedy at {1e3 * closer:.1f} mm"
    out.append([name, path, str(len(surface.points)), "yes", *figures, ""])
    start = time.process_time()
    strokes = cover([face], spacing, speed)
    cpu = f"{time.process_time() - start:.2f}"
    lines = [Line(stroke.points, stroke.normals, stroke.closed) for stroke in strokes]
    out.append([name, "rows", "", "", *measured(lines, points, spacing, speed, tolerance), cpu])
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage", description=__doc__.split("\n")[0])
    parser.add_argument("--spacing", type=float, default=10.0, metavar="MM", help="of samples and rows (10)")
    parser.add_argument("--speed", type=float, default=40.0, metavar="MM_PER_S", help="of the print (40)")
    parser.add_argument("--tolerance", type=float, default=0.1, metavar="MM", help="of corners (0.1)")
    options = parser.parse_args(arguments)
    table = Table(*COLUMNS)
    for name, face in FACES.items():
        for row in rows_of(name, face, options.spacing / 1e3, options.speed / 1e3, options.tolerance / 1e3):
            table.add_row(*row)
    console = Console(width=150)
    console.print(table)
    console.print(
        "far: the greatest distance of a point of the face from the path, in spacings; rows promise "
        f"{REACH}. time: estimated from length and corners, no arm asked. CPU of a first call holds compilation."
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
