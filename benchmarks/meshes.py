"""Every mesh in a folder as a substrate and as a volume: verified, refused with a reason, or silently lost.

python -m benchmarks.meshes FOLDER

A row for each mesh and kind: as a substrate it carries a zig-zag over most of its top, as a volume it is filled with beads.
The amounts requested by a pattern and laid are counted here; `silent` is the share that is neither laid nor reported.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.command import parser_of
from benchmarks.mesh_runs import COLUMNS, KINDS, MeshJob, Row
from benchmarks.own_process import in_own_process
from benchmarks.run import some_seconds
from planner.base.command_line import exit_code
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.problem.mesh_files import SUFFIXES

OUT = Path("out/benchmarks/meshes.csv")
SILENT = 0.06  # of what was asked for: beads at walls, corners and between layers leave that much open
_LONGEST = 110  # characters of a reason in the summary


def jobs_of(options: argparse.Namespace) -> list[MeshJob]:
    """A job for each mesh and kind. Raises InputError where there is no folder, or no mesh in it."""
    folder: Path = options.folder
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder)
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not files:
        raise InputError("holds no meshes", file=folder, hint=f"they end in {', '.join(SUFFIXES)}")
    return [
        MeshJob(
            str(file.resolve()), file.relative_to(folder).as_posix(), kind, options.cell, options.size,
            options.leave_out, not options.toolpath, options.cover,
        )
        for file in files
        for kind in options.kind or KINDS
    ]  # fmt: skip


def rows_of(jobs: Sequence[MeshJob], limit: float | None) -> Iterator[Row]:
    """The row of each job, planned in a process of its own."""
    for job in jobs:
        ended = in_own_process("benchmarks.mesh_runs", [json.dumps(asdict(job))], limit)
        none: Row = dict.fromkeys(COLUMNS) | {"file": job.name, "as": job.kind}
        yield none | {"verdict": "ended", "reason": ended.reason} if ended.reason else json.loads(ended.text)


def lost(row: Row) -> bool:
    """Whether more is missing than is told."""
    return isinstance(row["silent"], float) and row["silent"] > SILENT


def summary(rows: Sequence[Row]) -> list[str]:
    """How many came to what, and the reasons of those without a verified plan, the most frequent first."""
    out = []
    for kind in sorted({str(row["as"]).partition(",")[0] for row in rows}):
        own = [row for row in rows if str(row["as"]).startswith(kind)]
        counts = Counter(str(row["verdict"]) for row in own)
        told = ", ".join(f"{count} {verdict}" for verdict, count in counts.most_common())
        out.append(f"{kind}: {len(own)} meshes: {told}; {sum(map(lost, own))} with silent loss")
        reasons = Counter(str(row["reason"]).partition(": ")[2][:_LONGEST] for row in own if row["reason"])
        out += [f"  {count} x {reason}" for reason, count in reasons.most_common(12)]
        speeds = sorted(
            float(row["at_speed"]) for row in own if row["at_speed"] is not None and row["verdict"] == "verified"
        )
        if speeds:
            out.append(
                f"  at speed: median {speeds[len(speeds) // 2]:.1%}, lowest tenth {speeds[len(speeds) // 10]:.1%}"
            )
    return out


def parser() -> argparse.ArgumentParser:
    """The parser of the command."""
    command = parser_of("meshes", __doc__)
    command.add_argument("folder", type=Path, metavar="FOLDER", help="where the meshes are, at any depth")
    command.add_argument(
        "--cell", default="hemisphere_honeycomb", metavar="PROBLEM", help="whose cell and process are used"
    )
    command.add_argument("--kind", choices=KINDS, action="append", help="only as this kind; repeatable")
    command.add_argument(
        "--size", type=float, default=40.0, metavar="MM", help="length of a mesh's longest side; default: 40"
    )
    command.add_argument(
        "--leave-out", type=float, default=1.0, metavar="SHARE", help="leave_out_share of the problem; default: 1"
    )
    command.add_argument(
        "--cover", type=float, default=0.7, metavar="SHARE", help="of a substrate's sides, by the pattern; default: 0.7"
    )
    command.add_argument("--toolpath", action="store_true", help="only lay beads, do not plan the robot's motion")
    command.add_argument("--limit", type=some_seconds, metavar="SECONDS", help="end a run that takes longer")
    command.add_argument("--out", type=Path, default=OUT, metavar="FILE.csv", help=f"default: {OUT}")
    return command


def run(options: argparse.Namespace) -> int:
    """Plan every mesh and write its row; returns the exit code."""
    jobs = jobs_of(options)
    rows: list[Row] = []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, COLUMNS)
        table.writeheader()
        for row in rows_of(jobs, options.limit):
            rows.append(row)
            table.writerow(row)
            stream.flush()
            print(f"{row['file']} as {row['as']}: {row['verdict']} {row['reason'] or ''}", file=sys.stderr)
    print("\n".join(summary(rows)))
    return EXIT_VERIFIED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 even where meshes gave no plan, for that is what the rows are for."""
    options = parser().parse_args(arguments)
    return exit_code(lambda: run(options), lambda text: print(text, file=sys.stderr), f"rows are in {options.out}")


if __name__ == "__main__":
    sys.exit(main())
