"""A print planner for robot arms: from one YAML file to a verified plan and its robot program.

    from planner import load, solve, write

    plan = solve(load("cylinder_logo", layers__count=1))
    print(plan.summary())
    write(plan, "out/cylinder_logo")

`load` reads a problem, `solve` plans a `Problem` with one of the `STRATEGIES` and returns a `Plan`, `write` writes its
files. `solve_all` solves many problems.
`Toolpath.from_arrays` makes waypoints from arrays, to be printed with `load(..., toolpath=...)`.
`register_strategy` adds a strategy of your own to `STRATEGIES`.
`add_robot` makes a robot file from a URDF or a Pinocchio model. `OwnTerm` describes a cost term of your own that is
added to those of the refinement.
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

# Public name → module that holds it, imported on first access: every command imports this package, and has to be quick.
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
