"""One run of the table: a problem, planned and verified after a warm-up, its row written as JSON.

python -m benchmarks.single FILE RUN      RUN: the fields of a `Run` as JSON; benchmarks.run starts it like this

Kernels are compiled or loaded from their cache before the measurement: the same strategy first plans the same problem's
first beads, cut short. A run in which a kernel is still compiled is measured once more.
"""

from __future__ import annotations

import json
import sys
import tempfile
import traceback
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path

from benchmarks.ideas import changed
from benchmarks.named import load_named
from benchmarks.own_process import end_with_parent, in_own_process
from benchmarks.rows import Row, Run, row_of_plan, row_without_plan
from benchmarks.usage import Usage, cpu_seconds, peak_mb
from planner.base.compiled import counting_compiled
from planner.base.errors import PlannerError, Refusal
from planner.base.progress import Stages
from planner.planning.pipeline import solve, try_out
from planner.problem import Problem
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath

WARM_BEADS, WARM_POINTS = 2, 60  # of the print to warm up with: travel between beads belongs to it
Job = tuple[Run, float | None]  # and after how many seconds it is ended, if ever


def beadwise() -> str:
    """What stands in the column `planner` of our rows."""
    return f"beadwise {version('beadwise')}"


def warm_up(problem: Problem, strategy: str) -> None:
    """Have all kernels loaded that the problem needs; what cannot be planned of it is told when it is measured."""
    with suppress(PlannerError):
        try_out(problem, _short(build_toolpath(problem)), strategy)


def forget_files() -> None:
    """Have the verifier read anew what it remembers of files, one of them for half a minute."""
    for name, module in list(sys.modules.items()):
        if name.startswith("planner.verify"):
            for each in vars(module).values():
                if hasattr(each, "cache_clear"):
                    each.cache_clear()


def _short(toolpath: Toolpath) -> Toolpath:
    """The first beads of a print, cut short."""
    return replace(toolpath, beads=tuple(_cut(bead) for bead in toolpath.beads[:WARM_BEADS]))


def _cut(bead: Bead) -> Bead:
    if len(bead.s) <= WARM_POINTS:
        return bead
    arrays = ("s", "points", "normals", "roll_zero", "width", "height")
    return replace(bead, closed=False, **{name: getattr(bead, name)[:WARM_POINTS] for name in arrays})


def measured(run: Run, warm: bool = True) -> Row:
    """The row of a run, whatever becomes of it: planned in this process, after a warm-up."""
    stages, before = Stages(), cpu_seconds()

    def used() -> Usage:
        return Usage(cpu_seconds() - before, peak_mb())

    try:
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            if warm or run.change:
                problem = load_named(run.problem, run.settings, Path(folder))
                stack.enter_context(changed(run.change, problem))
                warm_up(problem, run.strategy)
            for _ in range(2):
                forget_files()
                before, stages = cpu_seconds(), Stages()
                with counting_compiled() as compiled:
                    with stages.stage("load"):
                        problem = load_named(run.problem, run.settings, Path(folder))
                    plan = solve(problem, run.strategy, stages=stages, second_process=True, baseline=False)
                if not compiled():
                    break
        return row_of_plan(run, plan, stages.seconds, used())
    except Refusal as refusal:
        return row_without_plan(run, f"no plan: {refusal}", stages.seconds, used())
    except PlannerError as error:
        return row_without_plan(run, f"refused: {error}", stages.seconds, used())
    except Exception as error:  # whatever it is, it is a row, and the other runs go on
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"crashed: {error!r} in {Path(place.filename).name}, line {place.lineno}"
        return row_without_plan(run, reason, stages.seconds, used())


def run_apart(job: Job) -> Row:
    """The row of a run in a process of its own; one that is ended at its limit, or killed, is a row too."""
    run, limit = job
    ended = in_own_process("benchmarks.single", [json.dumps(asdict(run))], limit)
    if ended.reason:
        return row_without_plan(run, ended.reason, {})
    row: Row = json.loads(ended.text)
    return row | {"peak_mb": max(float(row["peak_mb"]), ended.peak_mb)}


def main(arguments: Sequence[str]) -> int:
    """What `run_apart` starts; returns the exit code."""
    end_with_parent()
    file, text = arguments
    fields = json.loads(text)
    row = measured(Run(**{**fields, "settings": tuple(fields["settings"])}))
    Path(file).write_text(json.dumps(row), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
