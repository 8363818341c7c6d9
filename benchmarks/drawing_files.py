"""Every DXF and SVG file of a folder becomes beads on a plane, or is refused with the reason: none crashes.

python -m benchmarks.drawing_files FOLDER --width 60 --csv OUT.csv

One layer, `--width` mm wide, or with --width 0 as large as a DXF file says. Exit code 1 for a crash.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
import traceback
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from planner.base.errors import InputError
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath

SUFFIXES = (".dxf", ".svg")
EXIT_CRASHED = 1
WIDTH = 60.0  # mm


@dataclass(frozen=True)
class Row:
    """What became of a file."""

    file: str
    verdict: str
    beads: int = 0
    length_mm: float = 0.0
    seconds: float = 0.0
    told: str = ""


def tried(path: Path, width: float) -> Row:
    """Lay a drawing on a plane, and say what became of it."""
    start = time.perf_counter()
    kind = path.suffix.lower()[1:]
    size = f", width_mm: {width:g}" if width > 0.0 else ""
    layers = f"layers={{source: {{{kind}: '{path}'{size}}}, project: z, count: 1, height_mm: 0.5}}"
    try:
        toolpath = build_toolpath(load_problem("cylinder_logo", ("part={plane: {size_mm: [1000, 1000]}}", layers)))
        beads, told = len(toolpath.beads), "; ".join(toolpath.notes)
        seconds = round(time.perf_counter() - start, 2)
        return Row(path.name, "made", beads, round(toolpath.length * 1e3, 1), seconds, told)
    except InputError as error:
        return Row(
            path.name, "refused", seconds=round(time.perf_counter() - start, 2), told=" ".join(str(error).split())
        )
    except Exception:
        told = traceback.format_exc().strip().replace("\n", " | ")
        return Row(path.name, "crashed", seconds=round(time.perf_counter() - start, 2), told=told)


def main() -> int:
    """Print what became of each file of a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--width", type=float, default=WIDTH, help="of a drawing [mm]; 0: as drawn")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    rows = []
    for path in sorted(given.folder.iterdir()):
        if path.suffix.lower() in SUFFIXES:
            row = tried(path, given.width)
            rows.append(row)
            print(
                f"{row.file:44} {row.verdict:8} {row.beads:5} beads {row.length_mm:10} mm {row.seconds:6} s  {row.told}",
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
