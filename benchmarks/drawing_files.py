"""Every DXF and SVG file in a folder becomes beads on a plane, or is refused with a reason: none crashes.

python -m benchmarks.drawing_files FOLDER --width 60 --csv OUT.csv

One layer, `--width` mm wide; with --width 0, as large as the DXF file says. Exit code 1 for a crash.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.command import parser_of
from benchmarks.files_tried import Found, try_all
from planner.base.command_line import exit_code
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath

SUFFIXES = (".dxf", ".svg")
WIDTH = 60.0  # mm


def laid(path: Path, width: float) -> Found:
    """Lay a drawing on a plane. Raises InputError where that is impossible."""
    kind = path.suffix.lower()[1:]
    size = f", width_mm: {width:g}" if width > 0.0 else ""
    layers = f"layers={{source: {{{kind}: '{path}'{size}}}, project: z, count: 1, height_mm: 0.5}}"
    toolpath = build_toolpath(load_problem("cylinder_logo", ("part={plane: {size_mm: [1000, 1000]}}", layers)))
    figures = {"beads": len(toolpath.beads), "length_mm": round(toolpath.length * 1e3, 1)}
    return "made", figures, "; ".join(toolpath.notes)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("drawing_files", __doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--width", type=float, default=WIDTH, metavar="MM", help="of a drawing; 0: as drawn")
    parser.add_argument("--csv", type=Path, metavar="FILE.csv", help="write a table")
    options = parser.parse_args(arguments)
    trial = partial(laid, width=options.width)
    return exit_code(
        lambda: try_all(options.folder, SUFFIXES, trial, options.csv), lambda text: print(text, file=sys.stderr)
    )


if __name__ == "__main__":
    sys.exit(main())
