"""The two tables of results, and what is read from them: who is fastest, and who verifies."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from benchmarks import usage
from benchmarks.peers.judge import PATH_COLUMNS
from benchmarks.rows import Row, Value, key_of, line_of, read_rows
from benchmarks.summary import ALONE, CHOSEN, OURS, PATHS, PLANS, Measure, race, results_of

ROWS_FILE, PATHS_FILE, TABLE_FILE = "rows.csv", "paths.csv", "table.md"
KEY = ("problem", "strategy", "planner", "commit", "machine")
EXTRA = (*PATH_COLUMNS, "said")


def done(folder: Path) -> set[tuple[str, str]]:
    """Cases and planners, by the names they are asked for, that have a row of this commit and machine already."""
    if not (folder / ROWS_FILE).exists():
        return set()
    commit, machine = usage.commit(), usage.machine()
    asked = {CHOSEN: OURS, ALONE: f"{OURS}_alone"}
    rows = [row for row in read_rows(folder / ROWS_FILE) if (row["commit"], row["machine"]) == (commit, machine)]
    return {(str(row["problem"]), asked.get(str(row["strategy"]), str(row["strategy"]))) for row in rows}


def append_path(file: Path, row: Row, extra: Row) -> None:
    """Append what the joints are at the waypoints to its table."""
    head = "" if file.exists() else line_of((*KEY, *EXTRA))
    with file.open("a", encoding="utf-8") as stream:
        stream.write(head + line_of([*(row[name] for name in KEY), *(extra[name] for name in EXTRA)]))


def read(folder: Path) -> list[Row]:
    """The rows of this commit and machine, each with its columns of the second table (as texts)."""
    with (folder / PATHS_FILE).open(encoding="utf-8", newline="") as stream:
        extra = {tuple(each[name] for name in KEY): each for each in csv.DictReader(stream)}
    commit, machine = usage.commit(), usage.machine()
    rows = [row for row in read_rows(folder / ROWS_FILE) if (row["commit"], row["machine"]) == (commit, machine)]
    last = {key_of(row): row for row in rows}
    return [row | _of(extra.get(tuple(str(row[name]) for name in KEY))) for row in last.values()]


def _of(extra: dict[str, str] | None) -> dict[str, Value]:
    return {name: (extra or {}).get(name, "") for name in EXTRA}


def line(row: Row, extra: Row) -> str:
    """A row in one line, for whoever waits."""
    speed = f"{row['waypoints_per_s']:.0f} waypoints/s" if row["waypoints_per_s"] != "" else "no speed"
    verdict = "verified" if row["verified"] else "holds its path" if extra["holds"] is True else "not verified"
    reason = f": {row['reason'] or extra['said']}"[:160] if not row["verified"] else ""
    return f"{row['problem']}, {row['planner']} {row['strategy']}: {speed}, {verdict}{reason}"


HEAD = (
    "case", "planner", "joint paths/s", "verified plans/s", "MB", "holds its path", "verified", "off mm", "between mm",
    "σ min", "joint step", "margin", "at speed", "deposition s", "why not",
)  # fmt: skip


def table(rows: Sequence[Row]) -> str:
    """Markdown: a line for each run, then for each case the fastest peer that verifies and how much faster we are."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    return "\n".join([*lines, "", *_ratios(rows), ""])


def _is_ours(row: Row) -> bool:
    return str(row["planner"]).startswith(OURS)


def _cells(row: Row) -> list[str]:
    def number(name: str, digits: str) -> str:
        return format(float(row[name]), digits) if row[name] != "" else ""

    def rate(measure: Measure) -> str:
        value = measure.of(row)
        return "" if value is None else measure.form(value)

    who = f"{row['planner']}, {row['strategy']}" if _is_ours(row) else str(row["planner"])
    share = f"{100.0 * float(row['at_speed_fraction']):.1f} %" if row["at_speed_fraction"] != "" else ""
    why = str(row["reason"] if not row["verified"] else "")
    return [
        str(row["problem"]),
        who,
        rate(PATHS),
        rate(PLANS) if row["seconds_verify"] != "" else "",
        number("peak_mb", ".0f"),
        str(row["holds"]) if row["holds"] != "" else "",
        "yes" if row["verified"] else "no",
        number("off_waypoints_mm", ".2g"),
        number("off_between_mm", ".2g"),
        number("path_sigma_min", ".3f"),
        number("path_joint_step_max_rad", ".3f"),
        number("path_limit_margin_rad", ".3f"),
        share,
        number("deposition_time_s", ".1f"),
        (why[:140] + (f" (it says: {row['said']})" if row["said"] else "")).replace("|", "/"),
    ]


def _ratios(rows: Sequence[Row]) -> list[str]:
    """For each case the fastest peer that verifies, and that holds its path, and how much faster we are."""
    out = []
    for case in dict.fromkeys(row["problem"] for row in rows):
        here = [row for row in rows if row["problem"] == case and row["found"] and row["seconds_verify"] != ""]
        mine = next((row for row in here if row["strategy"] == ALONE), None)
        words = []
        for which, ones in (
            ("verifies", [row for row in here if not _is_ours(row) and row["verified"]]),
            ("holds its path", [row for row in here if not _is_ours(row) and row["holds"] == "yes"]),
        ):
            words.append(_ratio(mine, ones, which))
        out.append(f"- {case}: {'; '.join(words)}.")
    return out


def _ratio(mine: Row | None, ones: Sequence[Row], which: str) -> str:
    if mine is None or not ones:
        return f"no peer {which}"
    ours, *peers = results_of([mine, *ones])
    plans, joints = (race(ours, peers, measure) for measure in (PLANS, PATHS))
    if plans is None or joints is None:
        return "ours is not verified"
    best = plans.peer.rows[0]
    return (
        f"the fastest peer that {which} is {plans.peer.planner}: Beadwise has {joints.ratio:.1f} × the joint paths/s of "
        f"the fastest at these ({joints.peer.strategy}), and {plans.ratio:.2f} × the verified plans/s; "
        f"σ min {_both(mine, best, 'path_sigma_min')}, at speed {_both(mine, best, 'at_speed_fraction')}"
    )


def _both(mine: Row, best: Row, name: str) -> str:
    return f"{float(mine[name]):.3f} against {float(best[name]):.3f}"
