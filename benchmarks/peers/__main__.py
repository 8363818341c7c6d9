"""Plan the same waypoints with installable planners and with this one, judge all alike, and print a table.

make peers                                                       sets up their environment and runs everything
python -m benchmarks.peers --case peer_cap@1000 --peer pink      one of them; what is in the results already stays

Each run is a process of its own with an end of time and memory. A peer that is not installed, crashes, hangs or finds
nothing is a row with its reason. Results: rows.csv, the table of all benchmarks; paths.csv, what the joints are at the
waypoints whatever their timing; table.md.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.command import parser_of, told
from benchmarks.peers import results
from benchmarks.peers.case import CASES, given, write_case
from benchmarks.peers.judge import PATH_COLUMNS
from benchmarks.peers.one import JOINTS, ROW, WARM
from benchmarks.peers.peer_list import PEERS, Peer
from benchmarks.peers.watch import Ended, watched
from benchmarks.rows import COLUMNS, Row, Run, append_row, check_columns, make_row, times
from benchmarks.single import beadwise
from benchmarks.summary import ALONE, CHOSEN, OURS
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.base.progress import STAGES
from planner.planning.context import PlanningContext

HERE = Path(__file__).resolve().parent
STRATEGIES = {"beadwise": CHOSEN, "beadwise_alone": ALONE}  # of ours, by the names of their processes
PYTHON = Path(".venv-peers/bin/python")
OUT = Path("out/peers")
SECONDS, MEGABYTES = 60.0, 8e3


def one_peer(
    name: str, key: str, ready: PlanningContext, python: Path, folder: Path, limits: tuple[float, float]
) -> Row:
    """Plan a case with a peer and judge what comes out; the row in columns of both tables."""
    peer = PEERS[name]
    label = {"planner": name}
    if not python.is_file():
        return label | {"reason": f"not installed: there is no {python}; make peers sets it up"}
    command = [str(python), str(HERE / peer.script), str(folder), str(folder), *peer.options_for(_table(ready))]
    ended = watched(command, folder / "log.txt", *limits, env=os.environ)
    label |= {"peak_mb": ended.peak_mb}
    if ended.reason:
        return label | {"reason": ended.reason}
    facts = json.loads((folder / "facts.json").read_text(encoding="utf-8"))
    label = {"planner": _label(peer, facts["version"]), "cpu_s": facts["cpu_seconds"], "peak_mb": facts["peak_mb"]}
    label |= {"said": facts["said"], "versions": facts["version"]}
    seconds = {"resolve": float(facts["seconds"])}
    if not (folder / JOINTS).is_file():
        return label | times(seconds, None) | {"reason": f"it says: {facts['said']}"}
    row = _in_process("judge", key, folder, limits)
    seconds |= {stage: float(row.pop(f"seconds_{stage}")) for stage in STAGES if f"seconds_{stage}" in row}
    return label | times(seconds, ready.toolpath.waypoints) | row


def _in_process(what: str, key: str, folder: Path, limits: tuple[float, float]) -> Row:
    """The row that `benchmarks.peers.one` writes, or its reason for writing none."""
    ended = _one(what, key, folder, limits)
    if ended.reason:
        return {"found": what == "judge", "reason": f"{'judging it: ' if what == 'judge' else ''}{ended.reason}"}
    row: Row = json.loads((folder / ROW).read_text(encoding="utf-8"))
    return row


def _one(what: str, key: str, folder: Path, limits: tuple[float, float]) -> Ended:
    command = [sys.executable, "-m", "benchmarks.peers.one", what, key, str(folder)]
    return watched(command, folder / f"{what}.txt", *limits, env=os.environ)


def _label(peer: Peer, version: str) -> str:
    return f"{version}, {peer.words}"


def _table(ready: PlanningContext) -> bool:
    return len(ready.cell.holder) > 0


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 3 where a plan of our own is not verified."""
    parser = parser_of("peers", __doc__)
    parser.add_argument("--case", nargs="+", choices=list(CASES), default=list(CASES), metavar="CASE")
    parser.add_argument("--peer", nargs="*", choices=list(PEERS), default=list(PEERS), metavar="PEER")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder of the results ({OUT})")
    parser.add_argument("--python", type=Path, default=PYTHON, help=f"of the peers' environment ({PYTHON})")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"a run may take ({SECONDS:g})")
    parser.add_argument("--megabytes", type=float, default=MEGABYTES, help=f"a run may hold ({MEGABYTES:g})")
    options = parser.parse_args(arguments)
    limits = (options.seconds, options.megabytes)
    options.out.mkdir(parents=True, exist_ok=True)
    done = results.done(options.out)
    for key in options.case:
        with tempfile.TemporaryDirectory() as folder:
            _case(key, options, limits, Path(folder), done)
    rows = results.read(options.out)
    text = results.table(rows)
    (options.out / results.TABLE_FILE).write_text(text, encoding="utf-8")
    print(text)
    ours = [row for row in rows if str(row["planner"]).startswith(OURS)]
    return EXIT_VERIFIED if all(row["verified"] for row in ours) else EXIT_NOT_VERIFIED


def _case(
    key: str, options: argparse.Namespace, limits: tuple[float, float], folder: Path, done: set[tuple[str, str]]
) -> None:
    """Run one case with all planners that have no row yet."""
    ready: PlanningContext | None = None
    for name in (*STRATEGIES, *options.peer):
        if (key, name) in done:
            continue
        if ready is None:
            check_columns(options.out / results.ROWS_FILE)
            ready = given(CASES[key], folder)
            _one(WARM, key, folder, (math.inf, limits[1]))  # a fresh checkout compiles for longer than a run may take
        if name in PEERS and PEERS[name].table_only and not _table(ready):
            continue
        own = folder / name
        own.mkdir()
        if name in STRATEGIES:
            row = {"planner": beadwise()} | _in_process(name, key, own, limits)
        else:
            write_case(ready, own)
            row = one_peer(name, key, ready, options.python, own, limits)
        strategy = STRATEGIES.get(name, name)
        run = Run(key, strategy, CASES[key].settings, planner=str(row.pop("planner")))
        extra = {column: row.pop(column, "") for column in (*PATH_COLUMNS, "said")}
        whole = make_row(run, **{column: value for column, value in row.items() if column in COLUMNS})
        append_row(options.out / results.ROWS_FILE, whole)
        results.append_path(options.out / results.PATHS_FILE, whole, extra)
        print(results.line(whole, extra), flush=True)


if __name__ == "__main__":
    sys.exit(main())
