"""A print planner for robot arms: from one YAML file to a verified plan and its robot program.

    from planner import load, solve, write

    plan = solve(load("cylinder_logo", "layers.count=1"))
    print(plan.summary())
    write(plan, "out/cylinder_logo")

`load` reads a problem, `solve` makes a `Plan` of a `Problem` with one of `STRATEGIES`, `write` writes its files.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from planner.garbage import put_off
from planner.interrupts import end_quietly

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.planning import load, solve, write
    from planner.problem import Problem
    from planner.resolve import STRATEGIES

__all__ = ["STRATEGIES", "Plan", "Problem", "load", "solve", "write"]

# Public name → module that holds it. Read when first asked for: every command imports this package, and is quick.
_HOMES = {
    "STRATEGIES": "planner.resolve",
    "Plan": "planner.plan",
    "Problem": "planner.problem",
    "load": "planner.planning",
    "solve": "planner.planning",
    "write": "planner.planning",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """Keeps public names from the modules below it: `planner.solve` is the function, though a command is named so."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

end_quietly()
put_off()
