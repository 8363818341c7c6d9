"""Waypoint files that others published, all planned on a cell of your choice: a table row for each file.

python -m benchmarks.published FOLDER --cell peer_cap
python -m benchmarks.published FOLDER --cell my_cell.yaml --pattern 'TOOL_PATH/*.txt' --layers --limit 600

The cell, the process and the settings are those of a problem; its print is replaced. Each line of a file holds
x y z nx ny nz, and may hold more: fibre curves with further columns, CSV with a header. Units, the axis that is up and the
direction of normals are found from the numbers unless they are given. Each part is put onto the middle of the bed or table;
one that is too big for the arm keeps its size, unless --scale is given. The column `set` gives all this. A file that cannot
be read, is refused or is stopped gets a row with the reason. The same command continues where it ended.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.command import parser_of
from benchmarks.rows import BETWEEN, EMPTY, Row, Run, read_rows, row_without_plan
from benchmarks.run import fill, some_seconds
from benchmarks.single import beadwise, run_apart
from benchmarks.summary import FILES_ON, OfFiles
from benchmarks.usage import commit, machine
from benchmarks.waypoint_files import Look, Meaning, as_the_file_counts, files_in, look_at, place, shrunk, together
from planner.base.command_line import exit_code
from planner.base.errors import EXIT_VERIFIED, InputError, PlannerError
from planner.cell.cell import build_cell
from planner.place.site import reach
from planner.planning.context import found_anywhere
from planner.planning.options import add_set, add_spread, add_strategy
from planner.problem import load_problem

OUT = Path("out/benchmarks/published.csv")


@dataclass(frozen=True)
class On:
    """What all files are planned on: a problem's name or path, and of it what a part is placed by [m]."""

    cell: str
    strategy: str
    bead: tuple[float, float]  # width and height
    reach: float
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Job:
    """A file to plan: its name in the table, and how it is meant; `look` where it is one of several layers."""

    file: str
    name: str
    asked: str
    on: On
    meaning: Meaning
    look: Look | None
    shrink: bool
    own_beads: bool
    lift_mm: float
    limit: float | None


def run_of(job: Job) -> Run:
    """What stands for a job in the table."""
    return Run(job.name, job.on.strategy, (job.asked,), 0, beadwise())


def planned(job: Job) -> Row:
    """The row of a file, whatever becomes of it."""
    on, file = job.on, Path(job.file)
    run = run_of(job)
    try:
        own = look_at(file)
        look = own if job.look is None else as_the_file_counts(job.look, own)
        placed = place(look, job.meaning, on.bead, on.reach, job.shrink, job.own_beads, job.lift_mm)
        with tempfile.TemporaryDirectory() as folder:
            read = shrunk(file, placed, Path(folder))
            source = json.dumps({"source": placed.source(read)})
            # JSON is YAML; what is printed is the file alone, on whatever carries the part
            width, height = placed.bead_mm or (on.bead[0] * 1e3, on.bead[1] * 1e3)
            bead = (f"process.bead.width_mm={width:g}", f"process.bead.height_mm={height:g}")
            settings = (f"layers={source}", "part=null", *bead, *on.settings)
            row = run_apart((Run(on.cell, on.strategy, settings, 0, run.planner), job.limit))
    except PlannerError as error:
        return row_without_plan(run, f"refused: {_short(str(error), job)}", {})
    said = BETWEEN.join([job.asked, *placed.words])
    reason = str(row["reason"]).replace(str(read), job.name)  # the n-th waypoint of a copy stands for a line
    return {**row, "problem": job.name, "set": said, "reason": _short(reason, job)}


def _short(reason: str, job: Job) -> str:
    """A reason with the file's name in the table for its path."""
    return reason.replace(job.file, job.name)


def jobs_of(options: argparse.Namespace) -> list[Job]:
    """A job for each file. Raises InputError for whatever is wrong with folder or cell."""
    files = files_in(options.folder, options.pattern)
    # what is set of the layers is meant for those that come from the files
    problem = load_problem(options.cell, [each for each in options.set if not each.startswith("layers.")])
    cell = build_cell(problem)
    strategy = options.strategy or problem.strategy
    settings, bead = tuple(options.set), problem.process.bead
    on = On(found_anywhere(problem), strategy, (bead.width, bead.height), reach(cell), settings)
    meaning = Meaning(options.unit, options.up, options.normals)
    looks = looks_of(files) if options.layers else {}
    words = {"unit": meaning.unit, "up": meaning.up, "normals": meaning.normals}
    asked = " ".join([
        f"{FILES_ON}{problem.name}", *(f"{key}={value}" for key, value in words.items() if value), *settings,
        *(["layers"] if options.layers else []), *(["to fit"] if options.scale else []),
        *(["own beads"] if options.own_beads else []), *([f"lift={options.lift:g}"] if options.lift else []),
    ])  # fmt: skip
    return [
        Job(
            str(file.resolve()), file.relative_to(options.folder).as_posix(), asked, on, meaning,
            looks.get(file.parent), options.scale, options.own_beads, options.lift,
            options.limit,
        )
        for file in files
    ]  # fmt: skip


def looks_of(files: Sequence[Path]) -> dict[Path, Look]:
    """For each folder what all its files are together; those that cannot be read do not count."""
    found: dict[Path, list[Look]] = {}
    for file in files:
        with suppress(InputError):
            found.setdefault(file.parent, []).append(look_at(file))
    return {folder: together(looks) for folder, looks in found.items()}


def left(jobs: Sequence[Job], rows: Sequence[Row], anywhere: bool) -> list[Job]:
    """The files that have no row yet of this commit, and of this machine unless it is others that plan."""

    def key(name: str, asked: str, strategy: str, planner: str) -> tuple[str, ...]:
        return name, asked, strategy, planner

    done = {
        key(str(row["problem"]), str(row["set"]).partition(BETWEEN)[0], str(row["strategy"]), str(row["planner"]))
        for row in rows
        if row["commit"] == commit() and (anywhere or row["machine"] == machine())
    }
    return [job for job in jobs if key(job.name, job.asked, job.on.strategy, beadwise()) not in done]


def summary(rows: Sequence[Row]) -> list[str]:
    """How many came to what, and the reasons of those without a verified plan, the most frequent first."""
    files = OfFiles(EMPTY, EMPTY, tuple(rows))
    waypoints = sum(int(row["waypoints"]) for row in rows if row["waypoints"] != EMPTY)
    head = f"{len(rows)} files: {len(files.verified)} verified, {files.failed} planned but not verified, {files.without_plan} not"
    return [f"{head}; {waypoints} waypoints", *(f"  {count} x {reason}" for reason, count in files.reasons[:10])]


def parser() -> argparse.ArgumentParser:
    """The parser of the command."""
    command = parser_of("published", __doc__)
    command.add_argument("folder", type=Path, metavar="FOLDER", help="where the files are, at any depth")
    command.add_argument(
        "--cell", required=True, metavar="PROBLEM", help="whose cell and process are used: file or name"
    )
    command.add_argument(
        "--pattern",
        action="append",
        default=[],
        metavar="GLOB",
        help="only these files, counted from FOLDER; repeatable",
    )
    command.add_argument(
        "--layers", action="store_true", help="files of a folder are layers of one part: placed together, planned each"
    )
    command.add_argument("--scale", action="store_true", help="shrink what is too big for the arm")
    command.add_argument(
        "--own-beads",
        action="store_true",
        help="beads as high as layers of a file lie apart, and as wide as its passes",
    )
    command.add_argument(
        "--lift",
        type=float,
        default=0.0,
        metavar="MM",
        help="raise parts by this much, as on a stub: for sideways normals",
    )
    command.add_argument("--unit", choices=("mm", "m"))
    command.add_argument("--up", choices=("x", "y", "z"), help="the files' axis that points up")
    command.add_argument("--normals", choices=("outward", "inward"), help="against the nozzle, or along it")
    add_set(command)
    add_strategy(command)
    add_spread(command)
    command.add_argument("--limit", type=some_seconds, metavar="SECONDS", help="end a plan that takes longer")
    command.add_argument("--out", type=Path, default=OUT, metavar="FILE.csv", help=f"default: {OUT}")
    return command


def run(options: argparse.Namespace) -> int:
    """Plan what is left; returns the exit code."""
    jobs = jobs_of(options)
    rows = read_rows(options.out) if options.out.exists() else []
    todo = left(jobs, rows, options.scheduler is not None)
    print(f"{len(todo)} files, {len(jobs) - len(todo)} are in {options.out} already", file=sys.stderr)
    fill(planned, todo, [run_of(job) for job in todo], options)
    names = {(job.name, job.asked) for job in jobs}
    told = [row for row in read_rows(options.out) if (row["problem"], str(row["set"]).partition(BETWEEN)[0]) in names]
    print("\n".join(summary(told)))
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 even where files gave no plan, for that is what the rows are for."""
    options = parser().parse_args(arguments)
    stays = f"what is done is in {options.out}; the same command continues"
    return exit_code(lambda: run(options), lambda text: print(text, file=sys.stderr), stays)


if __name__ == "__main__":
    sys.exit(main())
