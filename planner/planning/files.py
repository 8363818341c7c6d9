"""A plan's files, which reflect the plan as it is when they are written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.base.arguments import as_one_of, as_path, kind_of
from planner.base.errors import InputError
from planner.base.freed import given_back
from planner.base.processes import in_background, spare_core
from planner.base.progress import Stages
from planner.base.results import results_folder
from planner.export.write import (
    ProgramDiffers,
    forecast_words,
    write_part,
    write_plan,
    write_robot_code,
    write_trajectory,
)
from planner.plan import Check, Plan
from planner.plan.seal import INPUTS, changed_since, sealed
from planner.planning.estimate import WORTH_A_FORK, WORTH_HALVES
from planner.report.html import write_report
from planner.verify.as_run import as_run
from planner.verify.drawing import cell_view
from planner.verify.verdict import verify

RESULTS_BY = "solve"  # the files' owner, in manifests
REPEATED = "programs repeat the plan"  # the check of a plan with a program that, read back, does not
AS_PLANNED = "as it was planned"  # the check of a plan whose inputs have changed since
BOUNDS = ("bound_deposition_time_s", "bound_any_path_s", "bound_gap_fraction")  # metrics that planning alone computes


def write(plan: Plan, folder: str | Path) -> Plan:
    """Write a plan's files into a folder, as the command does, replacing those of an earlier plan: all or none of them.

    These are plan.json, trajectory.csv, report.html and report_part.stl for any plan, and robot code only for a
    verified one. A plan that was changed since it was verified is verified again: what is written is judged as it is.

    Args:
        plan: The plan, as `solve` returns it.
        folder: Where the files go.

    Returns:
        The plan with the times that this took.

    Raises:
        InputError: If arrays of the plan's motion have changed their type or columns.
        OutputError: If the folder cannot be written.
    """
    as_one_of(plan, Plan, "plan", "what solve gives")
    with results_folder(as_path(folder, "folder"), RESULTS_BY) as fresh:
        return write_files(plan, fresh)


def write_files(plan: Plan, folder: Path, stages: Stages | None = None, second_process: bool = False) -> Plan:
    """Write a plan's files into a folder, robot code only if the plan is verified; returns it with all timings.

    Robot code, which is read back and compared, takes as long as everything else: a second process may write it
    meanwhile. If a program differs from the plan, none is written, and a separate check fails.
    """
    stages = stages or Stages()
    with given_back(plan.toolpath.waypoints >= WORTH_HALVES):
        plan = as_it_is(plan, stages)
    with stages.stage("export"):
        try:
            _write_all(plan, folder, second_process)
        except ProgramDiffers as error:
            differs = Check(REPEATED, 1.0, 0.0, "programs that do not", False, str(error))
            plan = sealed(replace(plan, checks=(*plan.checks, differs)))
            _write_all(plan, folder, second_process)
    seconds = {**plan.timing_s, **stages.seconds}
    plan = replace(plan, timing_s={**seconds, "total": sum(seconds.values())})
    write_plan(plan, folder)
    return plan


def _write_all(plan: Plan, folder: Path, second_process: bool) -> None:
    """Write tables and report, and for a verified plan the programs. Raises ProgramDiffers before writing one."""
    if not plan.verified:
        _write_tables(plan, folder, tuple)
    elif second_process and plan.toolpath.waypoints >= WORTH_A_FORK and spare_core():
        with in_background(write_robot_code, plan, folder) as wait:
            _write_tables(plan, folder, lambda: _written(wait, folder))
    else:
        _write_tables(plan, folder, lambda: _written(lambda: write_robot_code(plan, folder), folder))


def as_it_is(plan: Plan, stages: Stages | None = None) -> Plan:
    """The plan with a verdict on its present contents: its own if nothing has changed since, else a new verification's.

    A separate check fails if problem, cell or toolpath are no longer those that were planned for, or if anything has
    changed in a plan with a tolerance, which only `solve` can judge. Raises InputError for a motion with an array whose
    type or number of columns has changed.
    """
    changed = changed_since(plan)
    if not changed:
        return plan
    _check_arrays(plan)
    stages = stages or Stages()
    with stages.stage("verify"):
        report = verify(plan.problem, plan.cell, plan.toolpath, plan.trajectory)
        asks = as_run(plan.problem, plan.cell, plan.toolpath, plan.trajectory, plan.asked)
    other = [name for name in changed if name in INPUTS] + ([] if plan.headroom is None else ["tolerance"])
    metrics = {name: value for name, value in plan.metrics.items() if name not in BOUNDS}
    unlike = [Check(AS_PLANNED, float(len(other)), 0.0, "parts", False, f"changed since: {', '.join(other)}")]
    return sealed(
        replace(
            plan,
            checks=(*report.checks, *asks.checks, *(unlike if other else ())),
            metrics=metrics | report.metrics | dict(asks.metrics),
            series=report.series,
            approaches=report.approaches,
            view=cell_view(plan.cell),
            dips=(),
            advice=(),
            roll_maps=(),
        )
    )


def _check_arrays(plan: Plan) -> None:
    """Raise InputError for an array of a motion whose type or number of columns has changed.

    With `deposit` as 0 and 1, for example, it would select the first two rows.
    """
    for name, motion in (("trajectory", plan.trajectory), ("asked", plan.asked)):
        if motion is not None and (odd := motion.odd_array(len(plan.joint_names))):
            value = getattr(motion, odd)
            what = f"{value.dtype} of shape {value.shape}" if isinstance(value, np.ndarray) else kind_of(value)
            raise InputError(f"is {what}", field=f"{name}.{odd}", hint="keep its type and columns")


def _written(programs: Callable[[], object], folder: Path) -> tuple[str, ...]:
    """Write the programs; returns, in words, what controllers will make of them."""
    programs()
    return forecast_words(folder)


def _write_tables(plan: Plan, folder: Path, forecast: Callable[[], Sequence[str]]) -> None:
    write_trajectory(plan, folder)
    write_part(plan, folder)
    write_report(plan, folder / "report.html", forecast)
