"""NURBS curves as plane paths."""

from __future__ import annotations

from planner.problem import Problem
from planner.problem.curves import CurvesSpec
from planner.toolpath.nurbs.flatten import Curve, Cusp, flatten
from planner.toolpath.svg import PlanePath


def nurbs_paths(problem: Problem, source: CurvesSpec) -> tuple[PlanePath, ...]:
    """The curves in the order of the file, as polylines in metres. Raises InputError for one that has a cusp."""
    paths = []
    for i, spec in enumerate(source.curves):
        try:
            paths.append(flatten(Curve.of(spec), f"curve {i + 1}"))
        except Cusp as error:
            x, y = error.place * 1e3
            raise problem.error(
                f"layers.source.curves.{i}",
                f"curve {i + 1} turns back on itself at x {x:.2f}, y {y:.2f} mm",
                "no bead follows a cusp: move its control points, or make two curves of it",
            ) from None
    return tuple(paths)
