"""Predicts the workload of a problem's drawing before corners are rounded, in the time it takes to read the drawing."""

from __future__ import annotations

from planner.problem import Problem
from planner.problem.drawings import LayersSpec, ProjectedLayersSpec, WrappedDxfSpec
from planner.toolpath.plane_paths import length
from planner.toolpath.workload import Workload, balls_beside, check_curves, samples_of


def foreseen(problem: Problem) -> Workload | None:
    """Approximate workload of plane curves in all their layers; None for other sources.

    Raises InputError for a drawing that cannot be read or is too large to plan.
    """
    spec = problem.layers
    if isinstance(spec, LayersSpec | WrappedDxfSpec):
        from planner.toolpath.wrapped import drawn_paths

        paths, field = drawn_paths(problem, spec)[0], "layers.source.width_mm"
    elif isinstance(spec, ProjectedLayersSpec):
        from planner.toolpath.substrate.projection import paths_of, size_key

        paths, field = paths_of(problem, spec.source), size_key(spec.source)
    else:
        return None
    points = [path.points for path in paths]
    bead, count = problem.process.bead, spec.count
    check_curves(problem, points, count, field)
    total = count * sum(map(length, points))
    thick = min(bead.width, bead.height)
    return Workload(
        beads=count * len(points),
        layers=count,
        waypoints=count * samples_of(points, problem.process.corner_tolerance),
        length=total,
        balls=round(total / thick * balls_beside(bead.width, thick)),
    )
