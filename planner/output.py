"""The results' folder: written beside its place and moved there whole, so that nothing half-written is ever seen."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from planner.errors import OutputError
from planner.interrupts import ignored_interrupts

RESULTS = ("plan.json", "trajectory.csv", "report_part.stl", "extrusion.gcode", "report.html")
# Comments that stand in the header of programs that are ours, and of no one else's, by suffix.
MARKS = {
    ".mod": "! beadwise",
    ".script": "# beadwise",
    ".src": "; beadwise",
    ".gcode": "; beadwise",
    ".ngc": "; beadwise",
}
HEADER = 8  # lines in which the mark stands
LONGEST = 1000  # characters of a line that are looked at
COMPANIONS = {".mod": (".pgf", "_lines.csv"), ".src": (".dat",)}  # files that belong to a program, as its name goes on
LOADED = re.compile(r'Load \\Dynamic,"HOME:"\\File:="([A-Za-z][A-Za-z0-9_]{0,31}\.mod)";')
JOINTS, SWITCHES, SWITCHES_BEGIN = "_joint_trajectory.json", "_extruder.json", '{"held":'


def earlier_results(target: Path) -> list[Path]:
    """Files that an earlier run left in a folder; programs only if they say that they are ours, with what is theirs."""
    found = {target / name for name in RESULTS}
    for suffix, mark in MARKS.items():
        for program in target.glob(f"*{suffix}"):
            if any(mark in line for line in _first_lines(program)):
                found |= {program, *(program.with_name(program.stem + end) for end in COMPANIONS.get(suffix, ()))}
                found |= {target / name for name in _loaded(program)}
    for switches in target.glob(f"*{SWITCHES}"):  # JSON has no comments: they are known by each other
        joints = switches.with_name(switches.name.removesuffix(SWITCHES) + JOINTS)
        if joints.is_file() and "".join(_first_lines(switches)).startswith(SWITCHES_BEGIN):
            found |= {joints, switches}
    return sorted(path for path in found if path.is_file())


def _first_lines(path: Path) -> list[str]:
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", errors="replace") as stream:
        return [stream.readline(LONGEST) for _ in range(HEADER)]


def _loaded(program: Path) -> set[str]:
    """Names of the modules that a long program of ours loads while it runs."""
    with program.open(encoding="utf-8", errors="replace") as stream:
        return {found[1] for line in stream if (found := LOADED.search(line))}


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
