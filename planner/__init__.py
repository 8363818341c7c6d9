"""A print planner for robot arms: from one YAML file to a verified plan and its robot program.

    from planner import load, solve, write

    plan = solve(load("cylinder_logo", layers__count=1))
    print(plan.summary())
    write(plan, "out/cylinder_logo")

`load` reads a problem, `solve` makes a `Plan` of a `Problem` with one of `STRATEGIES`, `write` writes its files.
`solve_all` solves many.
`Toolpath.from_arrays` makes waypoints of arrays, which `load(..., toolpath=...)` has printed.
`register_strategy` has a strategy of one's own stand beside them.
`add_robot` makes a robot's file from its URDF or its model in Pinocchio. `OwnTerm` says how a term of one's own joins what the refinement weighs.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from planner.cell.cell import Cell
    from planner.plan import Plan
    from planner.planning.batch import Solved, solve_all
    from planner.planning.files import write
    from planner.planning.pipeline import load, solve
    from planner.problem import Problem
    from planner.report import plots
    from planner.report.inline import show
    from planner.resolve.joint_path import JointPath
    from planner.resolve.own_strategies import OwnStrategy, joint_paths, register_strategy
    from planner.resolve.own_terms import OwnTerm, PathSamples, SamplePrice, check_term, random_samples
    from planner.resolve.strategies import STRATEGIES
    from planner.robots.adding import add_robot
    from planner.toolpath.bead import Toolpath
    from planner.toolpath.task import NozzleTask

__all__ = [
    "STRATEGIES", "Cell", "JointPath", "NozzleTask", "OwnStrategy", "OwnTerm", "PathSamples", "Plan", "Problem", "SamplePrice",
    "Solved", "Toolpath", "add_robot", "check_term", "joint_paths", "load", "plots", "random_samples", "register_strategy",
    "show", "solve", "solve_all", "write",
]  # fmt: skip

# Public name → module that holds it. Read when first asked for: every command imports this package, and is quick.
_HOMES = {
    "STRATEGIES": "planner.resolve.strategies",
    "Cell": "planner.cell.cell",
    "JointPath": "planner.resolve.joint_path",
    "NozzleTask": "planner.toolpath.task",
    "OwnStrategy": "planner.resolve.own_strategies",
    "OwnTerm": "planner.resolve.own_terms",
    "PathSamples": "planner.resolve.own_terms",
    "Plan": "planner.plan",
    "Problem": "planner.problem",
    "SamplePrice": "planner.resolve.own_terms",
    "Solved": "planner.planning.batch",
    "Toolpath": "planner.toolpath.bead",
    "add_robot": "planner.robots.adding",
    "check_term": "planner.resolve.own_terms",
    "joint_paths": "planner.resolve.own_strategies",
    "load": "planner.planning.pipeline",
    "plots": "planner.report",
    "random_samples": "planner.resolve.own_terms",
    "register_strategy": "planner.resolve.own_strategies",
    "show": "planner.report.inline",
    "solve": "planner.planning.pipeline",
    "solve_all": "planner.planning.batch",
    "write": "planner.planning.files",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "plots":
        return importlib.import_module("planner.report.plots")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
