"""The same input in other surroundings: every file of the results must be the same, byte for byte.

python -m benchmarks.attack --only determinism
"""

from __future__ import annotations

import json
import os
import shutil
from functools import partial
from pathlib import Path

from benchmarks.attack.cases import ACCEPTED, BUGS, ESCAPED, Case, Chance, Kind, Outcome
from benchmarks.attack.prints import NAME, ON_POSITIONER, write_print
from benchmarks.attack.runs import OUT, contents, environment, finished

COUNT = 12
# What tells of the run and not of the print: how long it took.
TIMED = {"plan.json", "report.html", "manifest.json"}


def _threads(count: int) -> dict[str, str]:
    return {
        name: str(count) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")
    }


# What is different → environment and further arguments of the command.
RUNS: tuple[tuple[str, dict[str, str], tuple[str, ...]], ...] = (
    ("the same again", {}, ()),
    ("hash seed 0", {"PYTHONHASHSEED": "0"}, ()),
    ("hash seed 1", {"PYTHONHASHSEED": "1"}, ()),
    ("hash seed 4294967295", {"PYTHONHASHSEED": "4294967295"}, ()),
    ("one thread", _threads(1), ()),
    ("two threads", _threads(2), ()),
    ("one core", {}, ()),
    ("another folder, problem by its whole path", {}, ()),
    ("two jobs", {}, ("--jobs", "2")),
    ("another language and time zone", {"LC_ALL": "C", "LANG": "C", "TZ": "Pacific/Chatham"}, ()),
    ("optimised, without byte code", {"PYTHONOPTIMIZE": "1", "PYTHONDONTWRITEBYTECODE": "1"}, ()),
    ("a narrow terminal and no home", {"COLUMNS": "40", "HOME": "/nonexistent", "TERM": "dumb"}, ()),
)


def attack_surroundings(true: dict[str, bytes], folder: Path, by: Chance) -> Outcome:
    """Solve in other surroundings, and compare every file."""
    what, env, more = RUNS[by.number % len(RUNS)]
    own = folder / f"{by.getrandbits(60):x}"
    problem = write_print(own / "problem" if "folder" in what else own, **ON_POSITIONER)
    name = str(problem) if "folder" in what else problem.name
    cores = os.sched_getaffinity(0)
    try:
        if what == "one core":
            os.sched_setaffinity(0, {min(cores)})
        code, said = finished(own, [name, "--out", OUT, "--quiet", *more], environment(**env))
        other = contents(own / OUT)
    finally:
        os.sched_setaffinity(0, cores)
        shutil.rmtree(own)
    if code:
        return Outcome(what, ESCAPED, f"exit code {code}: {said[-300:]}", {BUGS: int(code == 1)})
    different = [name for name in sorted({*true, *other}) if _timeless(name, true) != _timeless(name, other)]
    return Outcome(
        what,
        ESCAPED if different else ACCEPTED,
        f"other: {', '.join(different)}" if different else f"{len(true)} files alike",
    )


def _timeless(name: str, files: dict[str, bytes]) -> object:
    """A file without what tells how long the run took."""
    data = files.get(name)
    if data is None or name not in TIMED:
        return data
    if name == "plan.json":
        return {key: value for key, value in json.loads(data).items() if key != "timing_s"}
    if name == "manifest.json":  # digests of all: of those that are timed they differ
        listed = json.loads(data)["files"]
        return {key: None if key in TIMED else value for key, value in listed.items()}
    return _untimed(data)


def _untimed(report: bytes) -> bytes:
    """A report without the table of the times that the run took."""
    head, found, tail = report.partition(b"Computing time")
    return head + tail[tail.find(b"</table>") :] if found else report


def prepared(folder: Path) -> Case:
    """The files as they are."""
    own = folder / "true"
    write_print(own, **ON_POSITIONER)
    code, said = finished(own, [f"{NAME}.yaml", "--out", OUT, "--quiet"])
    if code:
        raise RuntimeError(f"the small print: exit code {code}, {said}")
    return partial(attack_surroundings, contents(own / OUT), folder)


KINDS = {"determinism": Kind("the same input in other surroundings", COUNT, prepared)}
