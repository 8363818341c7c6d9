"""The results' folder: written beside its place and moved there whole, so that nothing half-written is ever seen."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from planner.errors import OutputError
from planner.interrupts import ignored_interrupts

RESULTS = ("plan.json", "trajectory.csv", "report_part.stl", "extrusion.gcode", "report.html")
MARK = "! beadwise"  # stands in the header of the robot programs that are ours, and of no one else's


def earlier_results(target: Path) -> list[Path]:
    """Files that an earlier run left in a folder; robot programs only if their header says they are ours."""
    found = [target / name for name in RESULTS if (target / name).is_file()]
    for program in target.glob("*.mod"):
        with program.open(encoding="utf-8", errors="replace") as stream:
            ours = any(MARK in line for line in itertools.islice(stream, 5))
        if ours:
            found.append(program)
            found += [pgf for pgf in [program.with_suffix(".pgf")] if pgf.is_file()]
    return found


@contextmanager
def results_folder(target: Path, replaced: Callable[[Path], Sequence[Path]] = earlier_results) -> Iterator[Path]:
    """A fresh folder to write into; on success its files take the place of all earlier results in `target`.

    replaced: which files in `target` are earlier results, besides those that are written anew; other files there are
    left alone. On any exception nothing in `target` changes.
    Raises OutputError, before anything is computed, where `target` cannot be written.
    """
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]
    try:
        target.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=".writing-", dir=target))
    except OSError as error:
        raise OutputError(f"cannot write into {target}: {error.strerror}") from error
    try:
        yield fresh
        earlier = replaced(target)
        taken = [target / new.name for new in fresh.iterdir() if (target / new.name).is_dir()]
        if taken:
            raise OutputError(f"cannot write {taken[0]}: a folder of that name is in the way")
        with ignored_interrupts():  # the work is done by now, and files change places in a moment
            for old in earlier:
                old.unlink()
            for new in sorted(fresh.iterdir()):
                os.replace(new, target / new.name)
    except OSError as error:
        raise OutputError(f"cannot write into {target}: {error.strerror}") from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        for folder in missing:  # made here: gone again if nothing came of it
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
