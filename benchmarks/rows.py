"""The one table of all benchmarks: its columns, a row for each run whatever its outcome, and the file that holds the rows.

A file is CSV with a header; a row is one line, appended whole. A killed run can leave an incomplete last line: it is not
read, and is cut off before the next row is written.
"""

from __future__ import annotations

import csv
import io
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks import usage
from benchmarks.usage import Usage
from planner.base.errors import InputError, OutputError
from planner.base.progress import STAGES
from planner.plan.measures import METRICS

if TYPE_CHECKING:
    from planner.cell.cell import Limits
    from planner.plan import Check, Plan, Trajectory
    from planner.toolpath.bead import Bead

Value = str | float | int | bool
Row = dict[str, Value]

PLANNING = ("load", "toolpath", "obstacles", "resolve", "timing", "travel", "verify")  # what waypoints_per_s counts
NUMBERS = (
    "waypoints_per_s", *(f"seconds_{stage}" for stage in STAGES), "seconds_total", "cpu_s", "peak_mb",
    *(name for name in METRICS if name != "waypoints"), "joint_step_max_rad", "limit_margin_rad",
)  # fmt: skip
COLUMNS = (
    "problem", "set", "strategy", "repeat", "planner", "found", "verified", "reason", "waypoints", *NUMBERS,
    "versions", "commit", "date", "machine",
)  # fmt: skip
WHOLE = ("repeat", "waypoints")
BOOLEAN = ("found", "verified")
KEY = ("problem", "set", "strategy", "repeat", "planner", "commit", "machine")  # two rows of one key are one run twice
EMPTY = ""  # not known, or of no meaning here
BETWEEN = "; "  # of settings in a cell
_YES, _NO = "yes", "no"
_DIGITS = 9
_LONGEST_REASON = 500  # characters


@dataclass(frozen=True)
class Run:
    """What is to be run: a problem with settings by one strategy of one planner, for the how-manieth time (from 0).

    change: what is switched off in the strategy, see `benchmarks.ideas`
    """

    problem: str
    strategy: str
    settings: tuple[str, ...] = ()
    repeat: int = 0
    planner: str = "beadwise"
    change: str = ""

    @property
    def label(self) -> str:
        """What stands in the column `strategy`."""
        return f"{self.strategy}: {self.change}" if self.change else self.strategy

    @property
    def key(self) -> tuple[str, ...]:
        """What tells it from other runs of one commit on one machine; see `key_of`."""
        return (self.problem, BETWEEN.join(self.settings), self.label, str(self.repeat), self.planner)

    @property
    def words(self) -> str:
        """For messages: `peer_cap sqp process.speed_mm_s=30 #1`."""
        return " ".join([self.problem, self.label, *self.settings, f"#{self.repeat}"])


def make_row(run: Run, used: Usage | None = None, **values: Value) -> Row:
    """A row with all columns: those of the run, of this machine and commit, and the values given; others stay empty.

    Raises ValueError for a value that no column has.
    """
    given: Row = {
        "problem": run.problem, "set": BETWEEN.join(run.settings), "strategy": run.label, "repeat": run.repeat,
        "planner": run.planner, "found": False, "verified": False,
        "date": time.strftime("%Y-%m-%dT%H:%M:%S"), "machine": usage.machine(),
    }  # fmt: skip
    if used is not None:
        given |= {"cpu_s": used.cpu_s, "peak_mb": used.peak_mb}
    given |= values
    if "commit" not in given:  # git looks at all sources for it
        given["commit"] = usage.commit()
    if unknown := set(given) - set(COLUMNS):
        raise ValueError(f"no columns of the table: {', '.join(sorted(unknown))}")
    given["reason"] = " ".join(str(given.get("reason", EMPTY)).split())[:_LONGEST_REASON]
    return {name: given.get(name, EMPTY) for name in COLUMNS}


def row_of_plan(run: Run, plan: Plan, seconds: Mapping[str, float], used: Usage) -> Row:
    """The row of a plan; seconds: by stage, see `times`."""
    return make_row(
        run, used, found=True, versions=words_of(plan.versions),
        **judged(plan.checks, plan.metrics), **times(seconds, int(plan.metrics["waypoints"])),
        **at_waypoints(plan.beads, plan.trajectory, plan.cell.limits),
    )  # fmt: skip


def row_without_plan(run: Run, reason: str, seconds: Mapping[str, float], used: Usage | None = None) -> Row:
    """The row of a run that gave none: refused, crashed, stopped or killed, as `reason` says."""
    return make_row(run, used, reason=reason, **times(seconds, None))


def judged(checks: Sequence[Check], metrics: Mapping[str, float]) -> Row:
    """What the verifier says: whether all checks hold, else which do not, and its metrics."""
    failed = [
        f"{check.name} {check.worst:.4g} {check.unit} (limit {check.limit:.4g})" for check in checks if not check.ok
    ]
    row: Row = {"verified": not failed, "reason": ", ".join(failed)}
    return row | {name: int(value) if name in WHOLE else float(value) for name, value in metrics.items()}


def times(seconds: Mapping[str, float], waypoints: int | None) -> Row:
    """Seconds by stage and together, and the waypoints per second of what plans (PLANNING), where there is a plan.

    Other stages than STAGES do not count: they write files, or plan another strategy.
    """
    own = {stage: float(seconds[stage]) for stage in STAGES if stage in seconds}
    row: Row = {f"seconds_{stage}": value for stage, value in own.items()}
    if own:
        row["seconds_total"] = sum(own.values())
    planning = sum(value for stage, value in own.items() if stage in PLANNING)
    return row if waypoints is None else row | {"waypoints_per_s": waypoints / planning}


def at_waypoints(beads: Sequence[Bead], trajectory: Trajectory, limits: Limits) -> Row:
    """The largest change of any joint that turns from waypoint to waypoint of a bead, and the least distance from such a
    joint's end there [rad]; beads are those that the trajectory lays, in order."""
    edges = np.flatnonzero(np.diff(trajectory.bead)) + 1
    step, margin = 0.0, math.inf
    low, high = limits.q_min[limits.turns], limits.q_max[limits.turns]
    starts, stops = [0, *edges], [*edges, len(trajectory.bead)]
    laid = [(a, b) for a, b in zip(starts, stops, strict=True) if trajectory.bead[a] >= 0]
    for a, b in laid:
        bead = beads[trajectory.bead[a] - trajectory.first_bead]
        q = _joints_at(bead.s, trajectory.s[a:b], trajectory.q[a:b, limits.turns])
        step = max(step, float(np.abs(np.diff(q, axis=0)).max(initial=0.0)))
        margin = min(margin, float(np.minimum(q - low, high - q).min(initial=math.inf)))
    return {"joint_step_max_rad": step, "limit_margin_rad": margin} if laid else {}


def _joints_at(s: NDArray[np.float64], at: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joints (m, nj) at arc lengths s (m), from those q (n, nj) at arc lengths `at` (n); only where there are any."""
    inside = s[(s >= at[0]) & (s <= at[-1])]
    return np.column_stack([np.interp(inside, at, q[:, j]) for j in range(q.shape[1])])


def words_of(versions: Mapping[str, str]) -> str:
    """Versions in one cell."""
    return ", ".join(f"{name} {version}" for name, version in versions.items())


def key_of(row: Mapping[str, Value]) -> tuple[str, ...]:
    """What tells a run from all others: the key of its `Run`, commit and machine."""
    return tuple(str(row[name]) for name in KEY)


def text_of(value: Value) -> str:
    """A value as it stands in the file: yes and no, numbers with nine digits, nothing for what is not a number."""
    if isinstance(value, bool):
        return _YES if value else _NO
    if isinstance(value, float):
        return EMPTY if math.isnan(value) else f"{value:.{_DIGITS}g}"
    return str(value)


def line_of(values: Sequence[Value]) -> str:
    """One line of the file, with its end."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow([" ".join(text_of(value).splitlines()) for value in values])
    return line.getvalue()


def check_columns(file: Path) -> None:
    """Raise InputError where rows cannot be appended to a file, which has other columns."""
    if header_of(file) not in (None, COLUMNS):
        raise InputError(
            "does not have the columns that this version writes", file=file, line=1, hint="give another file"
        )


def append_row(file: Path, row: Mapping[str, Value]) -> None:
    """Append a row in one write, after a header where the file is new, in place of a last line that was torn.

    Raises InputError where the file has other columns, OutputError where it cannot be written.
    """
    check_columns(file)
    text = line_of([row[name] for name in COLUMNS])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("ab+") as stream:
            whole = _whole(stream)
            stream.truncate(whole)
            head = "" if whole else line_of(COLUMNS)
            os.write(stream.fileno(), (head + text).encode())
            os.fsync(stream.fileno())
    except OSError as error:
        raise OutputError(f"cannot write {file}: {error.strerror}") from error


def _whole(stream: io.BufferedRandom) -> int:
    """Bytes of an open file up to the end of its last whole line."""
    stream.seek(0)
    return stream.read().rfind(b"\n") + 1


def header_of(file: Path) -> tuple[str, ...] | None:
    """The columns of a file of rows; None where there is no file, or not even a whole header in it."""
    if not file.exists():
        return None
    lines = _lines(file)
    return tuple(next(csv.reader(lines[:1]))) if lines else None


def read_rows(file: Path) -> list[Row]:
    """All whole rows of a file, in its order; columns that an older version did not write stay empty.

    Raises InputError for what is no table of runs, with the line.
    """
    if not file.exists():
        raise InputError("there is no such file", file=file, hint="python -m benchmarks.run --out writes one")
    columns = header_of(file)
    if columns is None:
        return []
    if missing := [name for name in KEY if name not in columns]:
        raise InputError(f"is no table of runs: it has no column {missing[0]!r}", file=file, line=1)
    rows = []
    for number, cells in enumerate(csv.reader(_lines(file)[1:]), 2):
        if len(cells) != len(columns):
            reason = f"has {len(cells)} cells, not {len(columns)}"
            raise InputError(reason, file=file, line=number, hint="remove the line: its run is made again")
        named = dict(zip(columns, cells, strict=True))
        rows.append({name: _value(name, named.get(name, EMPTY), file, number) for name in COLUMNS})
    return rows


def _lines(file: Path) -> list[str]:
    """The whole lines of a file."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text: {error}", file=file) from error
    return text.split("\n")[:-1]


def _value(name: str, text: str, file: Path, line: int) -> Value:
    """A cell's value by its column."""
    if text == EMPTY:
        return EMPTY
    try:
        if name in BOOLEAN:
            return {_YES: True, _NO: False}[text]
        return int(text) if name in WHOLE else float(text) if name in NUMBERS else text
    except (KeyError, ValueError) as error:
        raise InputError(f"{text!r} is no value of this column", file=file, line=line, field=name) from error
