"""What every source of plane paths needs: lengths, where a closed one begins, and whether it is large enough."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from planner.problem import Problem
from planner.readonly import Array

if TYPE_CHECKING:
    from planner.toolpath.svg import PlanePath


_SHRUNK = 0.5  # share of its length that a path must keep when its corners are rounded
_KINK = np.radians(10.0)  # a turn above this at one vertex counts as a corner when a seam is looked for


def seam_on_smooth_part(path: PlanePath) -> PlanePath:
    """Start a closed path as far from its corners as it can, so that run-in and run-out are smooth."""
    loop = path.points[:-1]
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.points, axis=0).T))])
    corners = arc[:-1][np.abs(turn) > _KINK]
    if len(corners) == 0:
        return path
    gaps = np.diff(np.concatenate([corners, [corners[0] + arc[-1]]]))
    start = float(np.mod(corners[np.argmax(gaps)] + 0.5 * gaps.max(), arc[-1]))
    k = int(np.searchsorted(arc, start, side="right"))
    t = (start - arc[k - 1]) / (arc[k] - arc[k - 1])
    seam = path.points[k - 1] + t * (path.points[k] - path.points[k - 1])
    around = np.vstack([seam[None], path.points[k:-1], path.points[:k], seam[None]])
    step = np.hypot(*np.diff(around, axis=0).T)
    keep = np.concatenate([[True], step > 1e-12])  # a seam on a vertex stands there twice
    points = around[keep]
    points[-1] = seam
    return replace(path, points=points)


def length(points: Array) -> float:
    """Length of a polyline (n, d) [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def check_length(problem: Problem, path: PlanePath, size_key: str = "layers.source.width_mm") -> None:
    """A path must be a line: at least as long as its bead is wide."""
    drawn, width = length(path.points), problem.process.bead.width
    if drawn < width:
        raise problem.error(
            size_key,
            f"path {path.name!r} is only {drawn * 1e3:.3f} mm long at this size",
            f"at least as long as the bead is wide, {width * 1e3:g} mm",
        )


def check_size(problem: Problem, name: str, drawn: float, rounded: float, hint: str) -> None:
    """A path must not vanish in the corner tolerance; lengths drawn and rounded [m]."""
    if rounded < _SHRUNK * drawn:
        raise problem.error(
            "process.corner_tolerance_mm",
            f"rounding its corners shrinks path {name!r} from {drawn * 1e3:.2f} to {rounded * 1e3:.2f} mm",
            hint,
        )
