"""Runs that are killed at any moment, over old results and files that a user edited: all of the old ones are there, or all new.

python -m benchmarks.attack --only kills
"""

from __future__ import annotations

import contextlib
import random
import shutil
import signal
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.attack.cases import (
    ACCEPTED,
    BUGS,
    ESCAPED,
    LEFT_OVER,
    LOST_FILES,
    LOST_RESULTS,
    ORPHANS,
    ZOMBIES,
    Case,
    Kind,
    Outcome,
)
from benchmarks.attack.prints import NAME, ON_POSITIONER, write_print
from benchmarks.attack.runs import (
    LONGEST,
    OUT,
    adopt,
    children,
    contents,
    finished,
    left_over,
    orphans,
    started,
    whole,
    zombies,
)
from planner.base.errors import EXIT_INTERRUPTED
from planner.base.results import results_folder

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)
LONGER = 1.1  # the last moments are those after a run of usual length
IN_THE_END = 0.4  # of the kills come in the last part of a run, where files are written and change places
BY_COMMAND = 0.25  # of what a SIGKILL left is put right by a whole next run, else by one that comes to nothing
# What runs are asked for: a small print; so many layers that the command starts processes of its own; work that is shared.
RUNS = {"a run": (), "a run of ten layers": ("--set", "layers.count=10"), "a run with two jobs": ("--jobs", "2")}
OLD = (f"{NAME}.yaml", "--out", OUT, "--quiet")
NEW = (*OLD, "--set", "process.speed_mm_s=38")
EDITED, NOTES, COPY = "Small.mod", "notes.txt", "Small_slower.mod"


class _NothingCameOfIt(Exception):
    """What ends a next run."""


@dataclass(frozen=True)
class Setting:
    """Old results in a folder, and how long [s] each of RUNS takes that makes new ones."""

    folder: Path
    seconds: dict[str, float]


def attack_run(given: Setting, by: random.Random) -> Outcome:
    """Kill a run, and look at what is there."""
    adopt()
    number = by.choice(SIGNALS)
    share = by.uniform(0.75, LONGER) if by.random() < IN_THE_END else by.uniform(0.0, LONGER)
    asked = by.choice([*RUNS])
    own = given.folder.parent / f"{by.getrandbits(60):x}"
    shutil.copytree(given.folder, own)
    users = _edited(own / OUT)
    before = contents(own / OUT)
    what = f"{number.name} after {share:.2f} of {asked}"
    try:
        with started(own, [*NEW, *RUNS[asked]]) as process:
            time.sleep(share * given.seconds[asked])
            family = len(children(process.pid))
            process.send_signal(number)
            try:
                _, said = process.communicate(timeout=LONGEST)
            finally:
                process.kill()
        code = process.returncode
        left = orphans()
        unnoticed = zombies(process.pid)
        if number is signal.SIGKILL:
            _put_right(own, by)
        return _judged(
            own / OUT, before, users, f"{what}, {family} children", code, said.decode(errors="replace"), left, unnoticed
        )
    finally:
        shutil.rmtree(own, ignore_errors=True)


def _edited(out: Path) -> list[bytes]:
    """Make a user's files among results: an edited program, notes, and a copy of a program; what stands in them."""
    (out / EDITED).write_text((out / EDITED).read_text("ascii").replace("vel40:=[40,", "vel40:=[35,"), "ascii")
    (out / NOTES).write_text("printed with 215 C\n")
    shutil.copy(out / EDITED, out / COPY)
    return [(out / name).read_bytes() for name in (EDITED, NOTES, COPY)]


def _put_right(own: Path, by: random.Random) -> None:
    """The next run: a whole one, or one that ends before it has results."""
    if by.random() < BY_COMMAND:
        finished(own, OLD)
        return
    with contextlib.suppress(_NothingCameOfIt), results_folder(own / OUT, "solve", lambda told: None):
        raise _NothingCameOfIt


def _judged(
    out: Path, before: dict[str, bytes], users: list[bytes], what: str, code: int, said: str, left: int, unnoticed: int
) -> Outcome:
    after = contents(out)
    harm: dict[str, int] = {}
    told = [f"exit code {code}"]
    if code == 1 or "Traceback" in said:
        harm[BUGS] = 1
        told.append(said.strip()[-300:])
    elif code not in (0, EXIT_INTERRUPTED, *(-number for number in SIGNALS)):
        told.append(f"which is none of an end by a signal: {said.strip()[-300:]}")
        harm[BUGS] = 1
    if after != before and (wrong := whole(out)):
        harm[LOST_RESULTS] = 1
        told.append(f"neither old nor new: {wrong}")
    if lost := sum(text not in after.values() for text in users):
        harm[LOST_FILES] = lost
    for name, count in ((ORPHANS, left), (ZOMBIES, unnoticed), (LEFT_OVER, len(left_over(out)))):
        if count:
            harm[name] = count
    told.append("old results" if after == before else "new results")
    return Outcome(what, ESCAPED if harm else ACCEPTED, ", ".join(told), harm)


def prepared(folder: Path) -> Case:
    """Old results of the small print."""
    own = folder / "old"
    write_print(own, **ON_POSITIONER)
    seconds = {}
    for asked, more in RUNS.items():
        for _ in range(2):  # the first may have to compile what it runs
            began = time.monotonic()
            code, said = finished(own, [*NEW, *more])
            seconds[asked] = time.monotonic() - began
        if code or (wrong := whole(own / OUT)):
            raise RuntimeError(f"{asked}: exit code {code}, {said or wrong}")
    finished(own, OLD)
    return partial(attack_run, Setting(own, seconds))


KINDS = {"kills": Kind("runs that are killed over old results and a user's files", 60, prepared)}
