"""Arguments of the public functions that are of another kind than they may be: told by name, never a bare TypeError."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from solved import small_plan, small_problem

from planner import Plan, Toolpath, add_robot, joint_paths, load, register_strategy, show, solve, solve_all, write
from planner.base.errors import InputError
from planner.base.shipped import ROBOTS


def paths_of(*given: Any, **options: Any) -> object:
    plan = small_plan()
    return joint_paths(plan.cell, [path.task for path in plan.paths], *given, **options)


def solved(**options: Any) -> object:
    return solve(small_problem(), **({"strategy": "sqp"} | options))


ARM = ROBOTS / "irb140.urdf"
any_: Any = None
CASES: dict[str, tuple[Callable[[], object], str]] = {
    "no problem": (lambda: load(any_), "problem: must be a path, not nothing (a text or a pathlib.Path)"),
    "a number": (lambda: solve(3), "problem: must be a path, not of type int"),  # type: ignore[arg-type]
    "bytes": (lambda: load(b"peer_cap"), "problem: must be a path, not of type bytes"),  # type: ignore[arg-type]
    "a list": (lambda: solve(["peer_cap"]), "problem: must be a path, not of type list"),  # type: ignore[arg-type]
    "an empty name": (lambda: load(""), "problem: is empty"),
    "strategy": (lambda: solved(strategy=["ladder"]), "strategy: must be a str, not of type list (its name; register_"),
    "an empty strategy": (lambda: solved(strategy=""), "there is no strategy ''"),
    "dt": (lambda: solved(dt="fast"), "dt: must be a number, not of type str"),
    "a true dt": (lambda: solved(dt=True), "dt: must be a number, not of type bool"),
    "tolerance": (lambda: solved(tolerance=3), "tolerance: must be a str, not of type int (such as 2mm,1deg)"),
    "first bead": (lambda: solved(first_bead=1.5), "first_bead: must be a whole number, not of type float"),
    "terms": (lambda: solved(terms=3), "terms: must be a list of terms, not of type int"),
    "over": (lambda: solved(over=3), "over: cannot be called: it is of type int"),
    "no plan": (lambda: write(3, "out"), "plan: must be a Plan, not of type int (what solve gives)"),  # type: ignore[arg-type]
    "folder": (lambda: write(small_plan(), any_), "folder: must be a path, not nothing"),
    "save": (lambda: small_plan().save(any_), "path: must be a path, not nothing"),
    "save nowhere": (lambda: small_plan().save(""), "path: is empty"),
    "Plan.load": (lambda: Plan.load(3), "path: must be a path, not of type int"),  # type: ignore[arg-type]
    "show": (lambda: show(3), "plan: must be a Plan, not of type int"),  # type: ignore[arg-type]
    "tip": (lambda: add_robot(ARM, "a.yaml", tip=3), "tip: must be a str, not of type int"),  # type: ignore[arg-type]
    "file": (lambda: add_robot(ARM, 3), "file: must be a path, not of type int"),  # type: ignore[arg-type]
    "problems": (lambda: solve_all(any_), "problems: must be a list of problems, not nothing"),
    "done": (lambda: solve_all([], done=3), "done: cannot be called"),  # type: ignore[arg-type]
    "dt of all": (lambda: solve_all([], dt="a"), "dt: must be a number"),  # type: ignore[arg-type]
    "terms of all": (lambda: solve_all([], terms=any_), "terms: must be a list of terms, not nothing"),
    "cell": (lambda: joint_paths(any_, [], []), "cell: must be a Cell, not nothing"),
    "tasks": (lambda: joint_paths(small_plan().cell, 3, []), "tasks: must be a list of tasks"),  # type: ignore[arg-type]
    "a task": (lambda: joint_paths(small_plan().cell, [3], [0]), "tasks[0]: must be a NozzleTask, not of type int"),  # type: ignore[list-item]
    "rolls": (lambda: paths_of(None), "rolls: must be a list of one for each task, not nothing"),
    "branch": (lambda: paths_of([0.0] * 3, branches=[0, 99, 0]), "branches[1]: there is no branch 99 (0 to 7)"),
    "a branch's name": (lambda: paths_of([0.0] * 3, branches=["up"] * 3), "branches[0]: must be a whole number"),
    "strategy of one's own": (lambda: register_strategy("x", any_), "strategy: cannot be called: it is nothing"),
    "unit": (lambda: Toolpath.from_arrays(np.eye(3), [0, 0, 1], unit=1e-3), "unit: must be 'm' or 'mm', not 0.001"),  # type: ignore[arg-type]
    "masked": (
        lambda: Toolpath.from_arrays(np.ma.masked_array(np.eye(3), np.eye(3)), [0, 0, 1]),
        "points: has masked values (leave these waypoints out)",
    ),
    "scene": (lambda: small_plan().show().save(any_), "path: must be a path, not nothing"),
}


@pytest.mark.parametrize("name", CASES)
def test_what_is_of_another_kind_is_said(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, message = CASES[name]
    with pytest.raises(InputError) as error:
        call()
    assert message in str(error.value)


@pytest.mark.slow
def test_numbers_of_numpy_and_any_path_are_taken(tmp_path: Path) -> None:
    plan = solve(small_problem(), dt=np.float64(0.008), first_bead=np.int64(1), baseline=False)
    assert plan.first_bead == 1 and plan.trajectory.dt == 0.008
    assert Plan.load(str(plan.save(tmp_path / "plan.npz"))).first_bead == 1
