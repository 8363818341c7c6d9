"""How much time and memory planning will take, reported before it begins; prints that do not fit in memory are refused.

The model is linear in the amount of work. Its rates were fitted to the runs of `benchmarks/results` by the default
strategy on two cores; `python -m benchmarks.budgets --model` compares it with them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath

from planner.problem import Problem
from planner.toolpath.workload import Workload, fewer

# seconds: what any run takes, and for each waypoint, sample, bead, and ball that represents the print
_SECONDS, _PER_WAYPOINT, _PER_SAMPLE, _PER_BEAD, _PER_BALL = 0.8, 4.6e-5, 3.6e-5, 2.2e-2, 1.15e-5
# bytes: the same; most memory of a sample on a bead is counted with its waypoints, that of a sample at rest separately
_BYTES, _WAYPOINT, _SAMPLE, _BALL, _AT_REST = 430e6, 3.3e3, 0.16e3, 0.6e3, 2.0e3
_TRAVEL = 0.4  # s of the print between two beads
_AROUND = 5.0  # s of the print from home and back
TOLD_FROM = 20.0  # s from which the estimate is reported: users want to know of such waits
WORTH_A_FORK = 5_000  # waypoints from which independent work (baseline, programs) is worth a copy of the process
WORTH_HALVES = 40_000  # waypoints from which half of a stage is worth one: most stages use all cores by threads anyway
# Control groups (of containers and cluster jobs), versions 2 and 1, by controller name: where their files are, and the
# file with the limit, which is a number of bytes, or a word if there is none.
_GROUPS = {
    "": (Path("/sys/fs/cgroup"), "memory.max"),
    "memory": (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),
}
_MINE = Path("/proc/self/cgroup")  # names the groups of this process


@dataclass(frozen=True)
class Estimate:
    """Approximate time [s] and memory [bytes] that planning takes."""

    seconds: float
    bytes: float

    @property
    def words(self) -> str:
        """The estimate in words, for the user."""
        minutes = self.seconds / 60.0
        time = f"{self.seconds:.0f} s" if minutes < 2.0 else f"{minutes:.0f} min"
        return f"about {time} and {self.bytes / 1e9:.1f} GB on two free cores"


def estimate(work: Workload, speed: float, dt: float, resting: float = 0.0) -> Estimate:
    """Estimate what planning takes; speed of the print [m/s], dt between samples [s], resting: its time at rest [s]."""
    moving, at_rest = (work.length / speed + _TRAVEL * work.beads + _AROUND) / dt, resting / dt
    return Estimate(
        _SECONDS
        + _PER_WAYPOINT * work.waypoints
        + _PER_SAMPLE * (moving + at_rest)
        + _PER_BEAD * work.beads
        + _PER_BALL * work.balls,
        _BYTES + _WAYPOINT * work.waypoints + _SAMPLE * moving + _AT_REST * at_rest + _BALL * work.balls,
    )


def check_memory(problem: Problem, work: Workload, expected: Estimate) -> None:
    """Raise InputError for a print that needs more memory than there is, saying what would fit."""
    there = memory()
    if expected.bytes <= there:
        return
    share = (there - _BYTES) / (expected.bytes - _BYTES)
    complain = partial(problem.error, "layers")
    reason = f"{work.waypoints:,} waypoints in {work.beads:,} beads need about {expected.bytes / 1e9:.1f} GB"
    fits = fewer(work, share) if share > 0.0 else "nothing"
    raise complain(f"{reason}, but only {there / 1e9:.1f} GB are available", f"what would fit: {fits}, or a greater dt")


def memory() -> float:
    """Available memory [bytes]: the least of the machine's and of the limits of its container, cluster job and process.

    Infinite if none of these is known.
    """
    return min(_limits(), default=float("inf"))


def _limits() -> Iterator[float]:
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        yield float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    for path in _limits_of_groups():
        try:
            text = path.read_text(encoding="ascii").strip()
        except OSError:
            continue
        if text.isdigit():
            yield float(text)
    if sys.platform != "win32":
        import resource

        for kind in (resource.RLIMIT_DATA, resource.RLIMIT_AS):  # they limit requests, which exceed usage
            soft, _ = resource.getrlimit(kind)
            if soft != resource.RLIM_INFINITY:
                yield float(soft)


def _limits_of_groups() -> Iterator[Path]:
    """Files with the limits of this process's control groups and of those that enclose them.

    A container sees its own group as the outermost one; a cluster job's is nested in others.
    """
    for root, name in _GROUPS.values():
        yield root / name
    lines: list[str] = []
    with suppress(OSError):
        lines = _MINE.read_text(encoding="utf-8", errors="replace").splitlines()
    for line in lines:  # number:controllers:/path
        _, controllers, path = [*line.split(":", 2), "", "", ""][:3]
        for controller in controllers.split(","):
            if controller in _GROUPS:
                root, name = _GROUPS[controller]
                own = PurePosixPath(path.lstrip("/"))
                for group in (own, *own.parents):
                    yield root / group / name
