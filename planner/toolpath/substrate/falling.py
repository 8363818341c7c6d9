"""Curves in space, or projected onto the part in a direction other than z.

Each of their points has a foot on the surface: the nearest place (`project: normal`), or the first one that a line in a
given direction meets from outside. A surface seen from above has one place for each x and y, so the feet's x and y form
a plane curve that falls onto the same places along z: from there on all curves are treated alike. Feet are found only
on bodies that are known exactly. Lengths are metres in the part frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.base.arrays import Array
from planner.problem import Problem
from planner.problem.drawings import ProjectedLayersSpec
from planner.toolpath.substrate.bodies import SubstrateBody
from planner.toolpath.svg.outlines import PlanePath

APART = 0.1e-3  # m between points of a curve for which feet are found
OUTSIDE = 10.0  # m: lines start this far back from a curve's points, against the direction: more than the size of parts
FARTHEST = 2.0 * OUTSIDE  # m: length of a line from there
STEPS = 2000  # steps towards the surface, each as long as the distance to it
NEAR, STEEP = 1e-4, 0.1  # m from the surface, sine of the angle to it: closer and steeper, step to the tangent plane
MET = 1e-9  # m from the surface at which a line has met it
JUMP = 20.0  # × a step along a curve: feet that move farther jump from one side of the part to another


def fallen(
    problem: Problem, spec: ProjectedLayersSpec, body: SubstrateBody | None, paths: Sequence[PlanePath]
) -> list[PlanePath]:
    """Paths (n, 2) that fall along z where the given ones, (n, 2) in the plane z = 0 or (n, 3), fall as requested.

    body: the part, if it is known exactly. Raises InputError for a curve that misses it, falls onto its underside, or
    jumps from one of its places to another.
    """
    if spec.project == "z" or body is None:
        return [replace(path, points=np.ascontiguousarray(path.points[:, :2])) for path in paths]
    return [_feet_of(problem, spec, body, path) for path in paths]


def _feet_of(problem: Problem, spec: ProjectedLayersSpec, body: SubstrateBody, path: PlanePath) -> PlanePath:
    points = path.points
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    points = _dense(points)
    if spec.direction is None:
        feet = points - body.signed_distance(points)[:, None] * body.normals(points)
    else:
        feet = along(body, points, np.asarray(spec.direction))
    normals = body.normals(feet)
    missed, under = np.isnan(feet[:, 0]), normals[:, 2] <= 0.0
    for wrong, reason, hint in (
        (missed, "misses the part", "move the curve, or choose another direction"),
        (under, "falls onto the underside of the part", "turn the part, or move the curve: layers are seen from above"),
    ):
        if wrong.any():
            raise _refused(problem, path, points[np.argmax(wrong)], reason, hint)
    way, step = (np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (feet, points))
    jumps = way > JUMP * np.maximum(step, APART)
    if jumps.any():
        hint = "keep curves closer to the surface than its radius of curvature"
        raise _refused(problem, path, points[np.argmax(jumps)], "jumps from one place of the part to another", hint)
    plane = feet[:, :2]
    moved = np.append(True, np.linalg.norm(np.diff(plane, axis=0), axis=1) > MET)
    if np.count_nonzero(moved) < 2:
        raise _refused(problem, path, points[0], "falls onto a single point of the part", "turn it, or the direction")
    plane = plane[moved]
    if path.closed:
        plane[-1] = plane[0]
    return replace(path, points=np.ascontiguousarray(plane))


def along(body: SubstrateBody, points: Array, direction: Array) -> Array:
    """Where lines through points (n, 3) in a direction (3) first meet a body from outside (n, 3); NaN for a miss."""
    gone = np.full(len(points), -OUTSIDE)
    going = np.arange(len(points))
    for _ in range(STEPS):
        here = points[going] + gone[going, None] * direction
        away = body.signed_distance(here)
        on = (np.abs(away) > MET) & (gone[going] < FARTHEST - OUTSIDE)
        going, here, away = going[on], here[on], away[on]
        if not len(going):
            break
        # near the surface, step to the tangent plane; farther away, by the distance at most, which overshoots nothing
        slope = -(body.normals(here) @ direction)
        near = (np.abs(away) < NEAR) & (slope > STEEP)
        gone[going] += np.where(near, away / np.where(near, slope, 1.0), away)
    feet = points + gone[:, None] * direction
    feet[~(np.abs(body.signed_distance(feet)) <= 1e3 * MET)] = np.nan
    return feet


def _dense(points: Array) -> Array:
    """Points (m, 3) along a polyline (n, 3), no farther apart than APART, including its own."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    count = np.maximum(np.ceil(step / APART).astype(int), 1)
    first = np.repeat(np.arange(len(step)), count)
    share = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)) / count[first]
    return np.vstack([points[first] + share[:, None] * np.diff(points, axis=0)[first], points[-1:]])


def _refused(problem: Problem, path: PlanePath, place: Array, reason: str, hint: str) -> Exception:
    x, y, z = place * 1e3
    return problem.error("layers.project", f"{path.name} {reason} at x {x:.1f}, y {y:.1f}, z {z:.1f} mm", hint)
