"""How long planning will take and how much memory, told before it begins; what needs more than there is, is refused.

The model is linear in what there is to plan. Its rates were fitted to the runs of `benchmarks/results` by the default strategy
on two cores; `python -m benchmarks.budgets --model` holds it against them.
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

# seconds: what a run takes in any case, for each waypoint, sample and bead, and for each ball that stands for the print
_SECONDS, _PER_WAYPOINT, _PER_SAMPLE, _PER_BEAD, _PER_BALL = 0.8, 4.6e-5, 3.6e-5, 2.2e-2, 1.15e-5
# bytes: the same; most of what a sample on a bead holds is counted with its waypoints, that of one at rest by itself
_BYTES, _WAYPOINT, _SAMPLE, _BALL, _AT_REST = 430e6, 3.3e3, 0.16e3, 0.6e3, 2.0e3
_TRAVEL = 0.4  # s of the print between two beads
_AROUND = 5.0  # s of it from home and back
TOLD_FROM = 20.0  # s: who waits so long wants to know it
WORTH_A_FORK = 5_000  # waypoints from which work that stands alone (baseline, programs) is worth a copy of the process
WORTH_HALVES = 40_000  # waypoints from which half of a stage is worth one: most stages use all cores by threads anyway
# Groups of processes, as containers and jobs of a cluster are, of version 2 and 1: by the name of their controller
# where their files stand, and which has the limit, a number of bytes, or a word where there is none.
_GROUPS = {
    "": (Path("/sys/fs/cgroup"), "memory.max"),
    "memory": (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),
}
_MINE = Path("/proc/self/cgroup")  # names the groups of this process


@dataclass(frozen=True)
class Estimate:
    """Time [s] and memory [bytes] that planning takes, about."""

    seconds: float
    bytes: float

    @property
    def words(self) -> str:
        """For the user."""
        minutes = self.seconds / 60.0
        time = f"{self.seconds:.0f} s" if minutes < 2.0 else f"{minutes:.0f} min"
        return f"about {time} and {self.bytes / 1e9:.1f} GB on two free cores"


def estimate(work: Workload, speed: float, dt: float, resting: float = 0.0) -> Estimate:
    """What planning takes, about; speed [m/s] of the print, dt [s] between samples, resting [s] besides."""
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
    """Raise InputError for what needs more memory than there is, with what would fit."""
    there = memory()
    if expected.bytes <= there:
        return
    share = (there - _BYTES) / (expected.bytes - _BYTES)
    complain = partial(problem.error, "layers")
    reason = f"{work.waypoints:,} waypoints in {work.beads:,} beads need about {expected.bytes / 1e9:.1f} GB"
    fits = fewer(work, share) if share > 0.0 else "nothing"
    raise complain(f"{reason}, and {there / 1e9:.1f} GB are there", f"what would fit: {fits}, or a greater dt")


def memory() -> float:
    """The least of what the machine has, its container and the cluster's job may use and the process may ask for [bytes];
    infinite where nobody tells."""
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

        for kind in (resource.RLIMIT_DATA, resource.RLIMIT_AS):  # what is used is less than what is asked for
            soft, _ = resource.getrlimit(kind)
            if soft != resource.RLIM_INFINITY:
                yield float(soft)


def _limits_of_groups() -> Iterator[Path]:
    """Files with limits of the groups that this process is in, and of those around them: a container sees its own as the
    outermost one, a job of a cluster is inside of others."""
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
