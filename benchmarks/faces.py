"""Every STEP and IGES file in a folder is read as faces, or refused with a reason: none crashes.

python -m benchmarks.faces FOLDER --csv OUT.csv

With --cover the largest face is covered as well, with one layer of rows in the cell of curved_plate, spaced by a twentieth
of the extent of all faces. Exit code 1 for a crash.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.command import parser_of
from benchmarks.files_tried import Found, try_all
from planner.base.command_line import exit_code
from planner.base.errors import InputError
from planner.problem import load_problem
from planner.problem.part import StepSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.step.files import Face, read_faces

SUFFIXES = (".step", ".stp", ".igs", ".iges")
APART = 2.5e-3  # m between points of edges, where only reading is of interest
SHARE = 0.05  # of the extent: spacing of rows
WIDEST = 10.0  # mm


def extent(faces: Sequence[Face]) -> float:
    """The largest side of the box around the faces' edges [m]."""
    points = np.vstack([face.points(loop) for face in faces for loop in face.loops])
    return float(np.ptp(points, axis=0).max())


def read(path: Path, cover: bool) -> Found:
    """Read a file, and cover its largest face where that is wanted. Raises InputError where either is impossible."""
    problem = load_problem("curved_plate", (f"part.step.file={path}", "layers.source.faces=all"))
    part = problem.part
    spec = part.step if part is not None else None
    if not isinstance(spec, StepSpec):
        raise InputError("the problem has no part.step")
    faces, notes = read_faces(spec, APART, partial(problem.error, "part.step.file"))
    size = extent(faces)
    figures: dict[str, float] = {"faces": len(faces), "extent_mm": round(size * 1e3, 2)}
    if not cover:
        return "read", figures, "; ".join(notes)
    spacing = min(WIDEST, SHARE * size * 1e3)
    chosen = max(faces, key=lambda face: extent((face,))).number
    changes = (
        f"part.step.file={path}",
        f"layers.source={{faces: [{chosen}], spacing_mm: {spacing:.4g}, path: rows}}",
        f"layers.height_mm={0.25 * spacing:.4g}",
        f"process.bead={{width_mm: {spacing:.4g}, height_mm: {0.25 * spacing:.4g}}}",
        f"process.corner_tolerance_mm={0.1 * spacing:.4g}",
    )
    toolpath = build_toolpath(load_problem("curved_plate", changes))
    return "made", figures | {"length_m": round(toolpath.length, 3)}, "; ".join(toolpath.notes)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("faces", __doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--cover", action="store_true", help="cover the face of the largest extent")
    parser.add_argument("--csv", type=Path, metavar="FILE.csv", help="write a table")
    options = parser.parse_args(arguments)
    trial = partial(read, cover=options.cover)
    return exit_code(
        lambda: try_all(options.folder, SUFFIXES, trial, options.csv), lambda text: print(text, file=sys.stderr)
    )


if __name__ == "__main__":
    sys.exit(main())
