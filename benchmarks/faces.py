"""Every STEP and IGES file of a folder is read as faces, or refused with the reason: none crashes.

python -m benchmarks.faces FOLDER --csv OUT.csv

With --cover the largest face is covered as well, with one layer of rows in the cell of curved_plate, a twentieth of all
faces' extent apart. Exit code 1 for a crash.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
import traceback
from dataclasses import astuple, dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np

from planner.base.errors import InputError
from planner.problem import load_problem
from planner.problem.part import StepSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.step.files import Face, read_faces

SUFFIXES = (".step", ".stp", ".igs", ".iges")
EXIT_CRASHED = 1
APART = 2.5e-3  # m between points of edges, where only reading is of interest
SHARE = 0.05  # of the extent: spacing of rows
WIDEST = 10.0  # mm


@dataclass(frozen=True)
class Row:
    """What became of a file; lengths in mm and m."""

    file: str
    verdict: str
    faces: int = 0
    extent_mm: float = 0.0
    length_m: float = 0.0
    seconds: float = 0.0
    told: str = ""


def extent(faces: tuple[Face, ...]) -> float:
    """The largest side of the box around the faces' edges [m]."""
    points = np.vstack([face.points(loop) for face in faces for loop in face.loops])
    return float(np.ptp(points, axis=0).max())


def tried(path: Path, cover: bool) -> Row:
    """Read a file, cover its largest face where that is wanted, and say what became of it."""
    start = time.perf_counter()
    row = partial(Row, path.name)
    try:
        problem = load_problem("curved_plate", (f"part.step.file={path}", "layers.source.faces=all"))
        part = problem.part
        spec = part.step if part is not None else None
        if not isinstance(spec, StepSpec):
            raise InputError("the problem has no part.step")
        faces, notes = read_faces(spec, APART, partial(problem.error, "part.step.file"))
        size = extent(faces)
        told = "; ".join(notes)
        row = partial(row, faces=len(faces), extent_mm=round(size * 1e3, 2))
        if not cover:
            return row(verdict="read", seconds=round(time.perf_counter() - start, 2), told=told)
        spacing = min(WIDEST, SHARE * size * 1e3)
        chosen = max(faces, key=lambda face: extent((face,))).number
        bead = f"process.bead={{width_mm: {spacing:.4g}, height_mm: {0.25 * spacing:.4g}}}"
        changes = (
            f"part.step.file={path}",
            f"layers.source={{faces: [{chosen}], spacing_mm: {spacing:.4g}, path: rows}}",
            f"layers.height_mm={0.25 * spacing:.4g}",
            bead,
            f"process.corner_tolerance_mm={0.1 * spacing:.4g}",
        )
        toolpath = build_toolpath(load_problem("curved_plate", changes))
        told = "; ".join(toolpath.notes)
        seconds = round(time.perf_counter() - start, 2)
        return row(verdict="made", length_m=round(toolpath.length, 3), seconds=seconds, told=told)
    except InputError as error:
        told = " ".join(str(error).split())
        return row(verdict="refused", seconds=round(time.perf_counter() - start, 2), told=told)
    except Exception:
        told = traceback.format_exc().strip().replace("\n", " | ")
        return row(verdict="crashed", seconds=round(time.perf_counter() - start, 2), told=told)


def main() -> int:
    """Print what became of each file of a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cover", action="store_true", help="cover the face of the largest extent")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    rows = []
    for path in sorted(given.folder.iterdir()):
        if path.suffix.lower() in SUFFIXES:
            rows.append(tried(path, given.cover))
            row = rows[-1]
            print(
                f"{row.file:44} {row.verdict:8} {row.faces:5} faces {row.extent_mm:9} mm {row.length_m:8} m "
                f"{row.seconds:6} s  {row.told}",
                flush=True,
            )
    print({verdict: sum(row.verdict == verdict for row in rows) for verdict in sorted({row.verdict for row in rows})})
    if given.csv is not None:
        with given.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([field.name for field in fields(Row)])
            writer.writerows(astuple(row) for row in rows)
    return EXIT_CRASHED if any(row.verdict == "crashed" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
