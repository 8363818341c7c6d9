"""Files in a folder, tried one after another: a line and a row for each, and exit code 1 if one crashed."""

from __future__ import annotations

import csv
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from planner.base.errors import EXIT_VERIFIED, InputError

EXIT_CRASHED = 1
CRASHED, REFUSED = "crashed", "refused"

Found = tuple[str, dict[str, Any], str]  # verdict, figures by name, and what is told


@dataclass(frozen=True)
class Tried:
    """What became of a file: made or read, refused, or crashed; its figures, and the reason or what is told of it."""

    file: str
    verdict: str
    figures: dict[str, Any]
    seconds: float
    told: str


def tried(path: Path, trial: Callable[[Path], Found]) -> Tried:
    """Try a file; a mistake in it is refused, and whatever else is raised is a crash."""
    start = time.perf_counter()
    figures: dict[str, Any] = {}
    try:
        verdict, figures, told = trial(path)
    except InputError as error:
        verdict, told = REFUSED, " ".join(str(error).split())
    except Exception:  # whatever it is, it is a row, and the other files go on
        verdict, told = CRASHED, traceback.format_exc().strip().replace("\n", " | ")
    return Tried(path.name, verdict, figures, round(time.perf_counter() - start, 2), told)


def try_all(folder: Path, suffixes: Sequence[str], trial: Callable[[Path], Found], table: Path | None) -> int:
    """Try every file of a folder, write a table (CSV) if one is asked for; returns the exit code.

    Raises InputError where there is no folder, or no such file in it.
    """
    if not folder.is_dir():
        raise InputError("there is no such folder", file=folder)
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    if not files:
        raise InputError("holds no such files", file=folder, hint=f"they end in {', '.join(suffixes)}")
    rows = []
    for path in files:
        rows.append(row := tried(path, trial))
        figures = ", ".join(f"{value} {name.replace('_', ' ')}" for name, value in row.figures.items())
        print(f"{row.file:44} {row.verdict:8} {figures:40} {row.seconds:6} s  {row.told}", flush=True)
    print(", ".join(f"{count} {verdict}" for verdict, count in sorted(Counter(row.verdict for row in rows).items())))
    if table is not None:
        _write(rows, table)
    return EXIT_CRASHED if any(row.verdict == CRASHED for row in rows) else EXIT_VERIFIED


def _write(rows: Sequence[Tried], table: Path) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row.figures))
    table.parent.mkdir(parents=True, exist_ok=True)
    with table.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ["file", "verdict", *names, "seconds", "told"])
        writer.writeheader()
        for row in rows:
            flat = asdict(row)
            writer.writerow({key: flat[key] for key in ("file", "verdict", "seconds", "told")} | row.figures)
