"""One run in a process of its own: `python -m benchmarks.peers.one judge|beadwise|beadwise_alone|warm CASE FOLDER`.

Writes row.json into the folder: for `judge` of the joints in q.csv there, else of the planner itself.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.memory import Peak
from benchmarks.peers import ours
from benchmarks.peers.case import CASES, given
from benchmarks.peers.judge import judge
from benchmarks.rows import Row
from benchmarks.usage import cpu_seconds
from planner.planning.context import PlanningContext

JOINTS, ROW = "q.csv", "row.json"
WARM = "warm"  # has everything compiled, and does nothing else


def judged_file(given: PlanningContext, folder: Path) -> Row:
    """The judge's row of the joints in a folder."""
    q = np.loadtxt(folder / JOINTS, delimiter=",", skiprows=1, ndmin=2)
    lengths = [len(task) for task in given.tasks]
    if len(q) != sum(lengths):
        return {"reason": f"joints at {len(q)} waypoints, not {sum(lengths)}"}
    return judge(given, np.split(q, np.cumsum(lengths)[:-1]))


def main() -> int:
    """The command line; returns the exit code."""
    what, key, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
    case, collision = CASES[key], what in ("beadwise", WARM)
    ready = given(case, folder)
    ours.warm(ready, collision)
    if what == WARM:
        return 0
    if what == "judge":
        row = judged_file(ready, folder)
    else:
        before = cpu_seconds()
        with Peak() as peak:
            row = ours.planned(ready, collision)
        row |= {"cpu_s": cpu_seconds() - before, "peak_mb": peak.mb}
    (folder / ROW).write_text(json.dumps(row), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
