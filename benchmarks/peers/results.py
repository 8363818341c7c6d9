"""The two tables of results, and what is read from them: who is fastest, and who verifies."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from benchmarks import usage
from benchmarks.peers.judge import PATH_COLUMNS
from benchmarks.rows import Row, Value, key_of, line_of, read_rows

ROWS, PATHS, TABLE = "rows.csv", "paths.csv", "table.md"
KEY = ("problem", "strategy", "planner", "commit", "machine")
EXTRA = (*PATH_COLUMNS, "said")
OURS = "beadwise"
PATHS_ALONE = ("resolve",)
VERIFIED = ("resolve", "timing", "travel", "verify")  # what is common to all: peers are given cell and toolpath
BESIDE, ALONE = "sqp", "sqp, no bodies"


def done(folder: Path) -> set[tuple[str, str]]:
    """Cases and planners, by the names they are asked for, that have a row of this commit and machine already."""
    if not (folder / ROWS).exists():
        return set()
    commit, machine = usage.commit(), usage.machine()
    asked = {BESIDE: OURS, ALONE: f"{OURS}_alone"}
    rows = [row for row in read_rows(folder / ROWS) if (row["commit"], row["machine"]) == (commit, machine)]
    return {(str(row["problem"]), asked.get(str(row["strategy"]), str(row["strategy"]))) for row in rows}


def append_path(file: Path, row: Row, extra: Row) -> None:
    """Append what the joints are at the waypoints to its table."""
    head = "" if file.exists() else line_of((*KEY, *EXTRA))
    with file.open("a", encoding="utf-8") as stream:
        stream.write(head + line_of([*(row[name] for name in KEY), *(extra[name] for name in EXTRA)]))


def read(folder: Path) -> list[Row]:
    """The rows of this commit and machine, each with its columns of the second table (as texts)."""
    with (folder / PATHS).open(encoding="utf-8", newline="") as stream:
        extra = {tuple(each[name] for name in KEY): each for each in csv.DictReader(stream)}
    commit, machine = usage.commit(), usage.machine()
    rows = [row for row in read_rows(folder / ROWS) if (row["commit"], row["machine"]) == (commit, machine)]
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
    "σ min", "joint step", "margin", "at speed", "print s", "why not",
)  # fmt: skip


def table(rows: Sequence[Row]) -> str:
    """Markdown: a line for each run, then for each case the fastest peer that verifies and how much faster we are."""
    lines = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    lines += ["| " + " | ".join(_cells(row)) + " |" for row in rows]
    return "\n".join([*lines, "", *_ratios(rows), ""])


def per_s(row: Row, stages: Sequence[str]) -> float:
    """Waypoints per second of some stages; those that a row lacks count nothing."""
    return float(row["waypoints"]) / sum(float(row[f"seconds_{stage}"] or 0.0) for stage in stages)


def _cells(row: Row) -> list[str]:
    def number(name: str, digits: str) -> str:
        return format(float(row[name]), digits) if row[name] != "" else ""

    who = f"{row['planner']}, {row['strategy']}" if row["planner"] == OURS else str(row["planner"])
    share = f"{100.0 * float(row['at_speed_fraction']):.1f} %" if row["at_speed_fraction"] != "" else ""
    why = str(row["reason"] if not row["verified"] else "")
    return [
        str(row["problem"]),
        who,
        format(per_s(row, PATHS_ALONE), ".0f") if row["waypoints"] != "" else "",
        format(per_s(row, VERIFIED), ".0f") if row["waypoints"] != "" and row["seconds_verify"] != "" else "",
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
            ("verifies", [row for row in here if row["planner"] != OURS and row["verified"]]),
            ("holds its path", [row for row in here if row["planner"] != OURS and row["holds"] == "yes"]),
        ):
            if mine is None or not ones:
                words.append(f"no peer {which}")
                continue
            best = max(ones, key=lambda row: per_s(row, VERIFIED))
            paths = per_s(mine, PATHS_ALONE) / per_s(best, PATHS_ALONE)
            whole = per_s(mine, VERIFIED) / per_s(best, VERIFIED)
            words.append(
                f"the fastest peer that {which} is {best['planner']}: Beadwise has {paths:.1f} × its joint paths/s, and"
                f" {whole:.2f} × its verified plans/s; σ min {_both(mine, best, 'path_sigma_min', '.3f')}, at speed"
                f" {_both(mine, best, 'at_speed_fraction', '.3f')}"
            )
        out.append(f"- {case}: {'; '.join(words)}.")
    return out


def _both(mine: Row, best: Row, name: str, digits: str) -> str:
    return f"{float(mine[name]):{digits}} against {float(best[name]):{digits}}"
