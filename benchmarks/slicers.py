"""G-code of slicers, read as a source: a row for each file in a folder, compared with an independent count.

python -m benchmarks.slicers FOLDER
python -m benchmarks.slicers FOLDER --set process.bead.width_mm=0.4 --out out/slicers.csv --beads

Each file replaces the G-code in the problem planar_gcode, and is read, sorted into layers and sized as for a plan. --beads
rounds its corners and lays the beads as well, which takes a second per metre. `printed_m` is the length of all beads before
their corners are rounded, and `specks_m` and `left_out_m` are lengths not printed. `difference_pct` is how far printed and
specks together are off `counted_m`, the count of benchmarks.slicer_count. `filament_m` is the filament for all of it, and
`filament_pct` is how far that is off `said_m`, if the file gives it: prime lines in its start code are in `said_m` only. A
refused file has its reason in the last column.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from benchmarks.slicer_count import count, said
from benchmarks.usage import peak_mb
from planner.base.command_line import exit_code
from planner.base.errors import EXIT_VERIFIED, InputError, PlannerError
from planner.problem import Problem, load_problem
from planner.problem.layers import GcodeLayersSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.gcode.layers import check_sizes
from planner.toolpath.gcode.reader import GcodeFile, read_gcode
from planner.toolpath.gcode.threads import choose

Row = dict[str, object]
OUT = Path("out/benchmarks/slicers.csv")
SUFFIXES = (".gcode", ".gco", ".g", ".nc", ".3mf")
COLUMNS = (
    "file", "slicer", "megabytes", "read_s", "layers", "beads", "printed_m", "specks_m", "left_out_m", "counted_m",
    "difference_pct", "filament_m", "said_m", "filament_pct", "notes", "refused",
)  # fmt: skip
AGREES = 0.5  # % by which both may differ
PRIMED = 2.0  # % of the filament that a start code's prime line may take


def row_of(file: Path, name: str, settings: Sequence[str], lay: bool) -> Row:
    """The row of a file, whatever becomes of it."""
    row: Row = {"file": name, "megabytes": f"{file.stat().st_size / 1e6:.2f}"}
    try:
        problem = load_problem(
            "planar_gcode", [f"layers.source.gcode={file}", "layers.source.origin_mm=[0, 0, 0]", *settings]
        )
        spec = problem.layers
        if not isinstance(spec, GcodeLayersSpec):
            raise InputError("--set must leave layers.source a file of G-code")
        started = time.perf_counter()
        read = read_gcode(file, problem.process.chord_tolerance, partial(problem.error, "layers.source.gcode"))
        row |= {"slicer": read.slicer or "?", "read_s": f"{time.perf_counter() - started:.2f}"}
        row |= _chosen(problem, spec, read, file)
        if lay:
            build_toolpath(problem)
    except PlannerError as error:
        row["refused"] = str(error).replace(str(file), name)
    return row


def _chosen(problem: Problem, spec: GcodeLayersSpec, read: GcodeFile, file: Path) -> Row:
    """What is printed of a file, and how that agrees with the count."""
    chosen = choose(problem, spec, read)
    check_sizes(problem, spec, read, chosen)
    printed, above = (sum(step.thread.length for step in steps) for steps in (chosen.steps, chosen.above))
    left_out = sum(thread.length for thread in read.threads if thread.share in spec.source.leave_out)
    specks = sum(thread.length for thread in read.threads) - left_out - printed - above
    counted = count(file).lengths
    there = 1e-3 * sum(length for owner, length in counted.items() if owner not in spec.source.leave_out)
    pushed, told = sum(float(thread.filament.sum()) for thread in read.threads), said(file)
    return {
        "filament_m": "" if read.volume else f"{pushed:.3f}",
        "said_m": f"{1e-3 * told:.3f}" if told else "",
        "filament_pct": f"{100.0 * (pushed / (1e-3 * told) - 1.0):.3f}" if told and not read.volume else "",
        "layers": chosen.steps[-1].layer + 1,
        "beads": len(chosen.steps),
        "printed_m": f"{printed:.3f}",
        "specks_m": f"{specks:.3f}",
        "left_out_m": f"{left_out:.3f}",
        "counted_m": f"{there:.3f}",
        "difference_pct": f"{100.0 * ((printed + above + specks) / there - 1.0):.3f}" if there else "",
        "notes": " | ".join(note.removeprefix(f"{file.name}: ") for note in chosen.notes),
    }


def summary(rows: Sequence[Row]) -> list[str]:
    """A line for each slicer."""
    by_slicer: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_slicer[str(row.get("slicer", "?"))].append(row)
    lines = []
    for slicer, own in sorted(by_slicer.items()):
        read = [row for row in own if "refused" not in row]
        off = [abs(float(str(row["difference_pct"]))) for row in read if row["difference_pct"]]
        agree = sum(each <= AGREES for each in off)
        most = f", {max(off):.3f} % off at most" if off else ""
        pushed = [abs(float(str(row["filament_pct"]))) for row in read if row["filament_pct"]]
        alike = sum(each <= PRIMED for each in pushed)
        lines.append(
            f"{slicer}: {len(own)} files, {len(read)} read, {agree} within {AGREES} % of the count{most}; "
            f"{alike} of {len(pushed)} within {PRIMED:g} % of the filament that they say"
        )
    return lines


def parser() -> argparse.ArgumentParser:
    """The options of the command."""
    command = argparse.ArgumentParser(prog="python -m benchmarks.slicers", description=(__doc__ or "").splitlines()[0])
    command.add_argument("folder", type=Path, metavar="FOLDER")
    command.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="a value of the problem instead"
    )
    command.add_argument("--beads", action="store_true", help="round corners and lay the beads as well")
    command.add_argument("--out", type=Path, default=OUT, metavar="FILE.csv", help=f"default: {OUT}")
    return command


def run(options: argparse.Namespace) -> int:
    """Read all files of a folder; returns the exit code."""
    files = sorted(path for path in options.folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not files:
        raise InputError(f"there is no G-code in {options.folder}", hint=f"files {', '.join(SUFFIXES)}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    console = Console(stderr=True)
    with options.out.open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, COLUMNS, restval="")
        table.writeheader()
        for file in files:
            row = row_of(file.resolve(), file.relative_to(options.folder).as_posix(), options.set, options.beads)
            rows.append(row)
            table.writerow(row)
            stream.flush()
            said = row.get("refused") or f"{row['printed_m']} m, {row['difference_pct']} % off"
            console.print(f"{row['file']}: {said}", highlight=False, markup=False, soft_wrap=True)
    for line in (*summary(rows), f"memory: {peak_mb():.0f} MB at most"):
        print(line)
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 even where files are refused, for that is what the rows are for."""
    options = parser().parse_args(arguments)
    return exit_code(lambda: run(options), lambda text: print(text, file=sys.stderr))


if __name__ == "__main__":
    sys.exit(main())
