"""Files that a problem names, read whole up to a size; and the results' folder.

Results are written beside their place and moved there whole, so that nothing half-written is ever seen.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

from planner.base.errors import Complaint, InputError, OutputError
from planner.base.processes import ignored_interrupts

RESULTS = ("plan.json", "trajectory.csv", "report_part.stl", "extrusion.gcode", "report.html")
# Comments that stand in the header of programs that are ours, and of no one else's, by suffix.
MARKS = {
    ".mod": "! beadwise",
    ".script": "# beadwise",
    ".src": "; beadwise",
    ".gcode": "; beadwise",
    ".ngc": "; beadwise",
    ".ls": '"beadwise print"',
    ".JBI": "///COMM beadwise print",
    ".pjx": "<!-- beadwise: ",
    ".dtx": "<!-- beadwise: ",
    ".pgx": "<!-- beadwise: ",
    ".as": "; beadwise",
    ".prg": "' beadwise",
}
HEADER = 8  # lines in which the mark stands
BEHIND = {".JBI": 100_000}  # likewise, of files whose positions come before it
LONGEST = 1000  # characters of a line that are looked at
COMPANIONS = {".mod": (".pgf", "_lines.csv"), ".src": (".dat",)}  # files that belong to a program, as its name goes on
LOADED = re.compile(r'Load \\Dynamic,"HOME:"\\File:="([A-Za-z][A-Za-z0-9_]{0,31}\.mod)";')
JOINTS, SWITCHES, SWITCHES_BEGIN = "_joint_trajectory.json", "_extruder.json", '{"held":'


def read_bytes(path: Path, largest: int, complain: Complaint, hint: str | None = None) -> bytes:
    """The file's content; `complain` makes the InputError for one that is missing, unreadable, or above `largest` bytes.

    hint: what to do about a file that is too large.
    """
    try:
        if not path.is_file():
            raise complain(f"there is no file {path}")
        with path.open("rb") as stream:
            data = stream.read(largest + 1)
    except OSError as error:
        raise complain(f"cannot read {path}: {error.strerror}") from error
    if len(data) > largest:
        raise complain(f"{path.name} is larger than {largest // 10**6} MB", hint=hint)
    return data


def read_lines(path: Path, largest: int, complain: Complaint) -> list[str]:
    """The lines of a text file as `read_bytes` reads it, commas taken as blanks; InputError where it is not UTF-8."""
    return [line.replace(",", " ") for line in read_text(path, largest, complain)]


def read_text(path: Path, largest: int, complain: Complaint) -> list[str]:
    """The lines of a text file as `read_bytes` reads it, as they are; InputError where it is not UTF-8."""
    data = read_bytes(path, largest, complain)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise InputError("is not UTF-8 text", file=path, line=line, hint="save it as plain text") from None
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def earlier_results(target: Path) -> list[Path]:
    """Files that an earlier run left in a folder; programs only if they say that they are ours, with what is theirs."""
    found = {target / name for name in RESULTS}
    for suffix, mark in MARKS.items():
        for program in target.glob(f"*{suffix}"):
            if any(mark in line for line in _first_lines(program, BEHIND.get(suffix, HEADER))):
                found |= {program, *(program.with_name(program.stem + end) for end in COMPANIONS.get(suffix, ()))}
                found |= {target / name for name in _loaded(program)}
    for switches in target.glob(f"*{SWITCHES}"):  # JSON has no comments: they are known by each other
        joints = switches.with_name(switches.name.removesuffix(SWITCHES) + JOINTS)
        if joints.is_file() and "".join(_first_lines(switches)).startswith(SWITCHES_BEGIN):
            found |= {joints, switches}
    return sorted(path for path in found if path.is_file())


def _first_lines(path: Path, count: int = HEADER) -> list[str]:
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", errors="replace") as stream:
        return list(islice(iter(lambda: stream.readline(LONGEST), ""), count))


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
