"""A small plan, its first run on a simulated robot and what that teaches, for tests of `learn`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from solved import small_plan

from benchmarks.learn import ROBOTS, recorded, write_log
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.progress import Stages
from planner.feedback.learn_fit import (
    Lessons,
    RunErrors,
    errors_of,
    next_lessons,
)
from planner.feedback.learn_telling import write_lessons
from planner.feedback.learn_track import recorded_way
from planner.feedback.recordings import read_log
from planner.motion.as_run import Corrections
from planner.plan import Plan, Trajectory
from planner.planning.pipeline import with_asked
from planner.problem.as_run import AsRunSpec
from planner.verify.as_run import as_run

MOST = 1e-3
WRONG = partial(InputError, field="corrections")


@cache
def first_run() -> tuple[Array, Array]:
    """Time and joints of the first run of the small plan's program on a simulated IRC5."""
    return recorded(small_plan(), ROBOTS["as fitted"])


def log_of(plan: Plan, folder: Path, noise: float = 0.0, **changes: Any) -> Path:
    time, q = first_run()
    return write_log(plan, changes.get("time", time), changes.get("q", q), noise, 1, folder / "run.csv")


def lessons_of(plan: Plan, folder: Path) -> tuple[RunErrors, Lessons]:
    way = recorded_way(plan, read_log(log_of(plan, folder), plan.cell), "rapid")
    errors = errors_of(plan.trajectory, way)
    return errors, next_lessons(plan.trajectory, errors, None, MOST)


def with_corrections(plan: Plan, corrections: Corrections, folder: Path, most: float = MOST) -> Plan:
    """The plan whose program is corrected, with its file of corrections in a folder."""
    k = len(corrections.s)
    lessons = Lessons(corrections, np.zeros((k, 3)), np.zeros((k, 3)), np.ones(k))
    n = len(plan.trajectory)
    nothing = RunErrors(np.zeros((n, 3)), np.zeros(n, dtype=bool), np.full(n, np.nan), 0.0)
    write_lessons(lessons, plan, nothing, folder / "corrections.csv")
    spec = AsRunSpec.model_construct(corrections=folder / "corrections.csv", most=most)
    problem = plan.problem.model_copy(update={"as_run": spec})
    return with_asked(replace(plan, problem=problem), Stages())


@cache
def corrected() -> Plan:
    """The small plan with what its first run taught, and a file that stays."""
    folder = Path(KEPT.name)
    return with_corrections(small_plan(), lessons_of(small_plan(), folder)[1].corrections, folder)


KEPT = tempfile.TemporaryDirectory()


def failed(plan: Plan, asked: Trajectory | None) -> set[str]:
    found = as_run(plan.problem, plan.cell, plan.toolpath, plan.trajectory, asked)
    return {check.name for check in found.checks if not check.ok}


def corrections_by(t: Trajectory, shift: Callable[[Array], Array]) -> Corrections:
    """Corrections every millimetre or so of all beads, by arc length."""
    beads, places, shifts = [], [], []
    for bead in np.unique(t.bead[t.deposit]):
        s = t.s[t.deposit & (t.bead == bead)][::6]
        beads.append(np.full(len(s), bead))
        places.append(s)
        shifts.append(shift(s))
    return Corrections(np.concatenate(beads).astype(np.int64), np.concatenate(places), np.concatenate(shifts))


def toy_errors(t: Trajectory, executed: Array) -> RunErrors:
    return RunErrors(np.where(t.deposit[:, None], executed, 0.0), t.deposit, np.full(len(t), np.nan), 0.0)
