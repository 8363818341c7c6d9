"""NURBS curves as polylines, in the plane or in space.

Curves are evaluated in homogeneous coordinates and divided as finely as their bends need.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from planner.base.arrays import Array
from planner.base.errors import Complaint
from planner.problem.drawings import CurveSpec
from planner.toolpath.svg.outlines import PlanePath

FLATNESS = 1e-6  # m, between chords and curve: far below any tolerance, and some 200 points for a curve of 100 mm
_PIECES = 8  # of each knot span at first
_LOOKS = (0.25, 0.5, 0.75)  # shares of a piece at which its chord is checked
_FINEST = 1e-12  # × the parameter range: pieces shorter than this are divided no further
_SAME = 1e-9  # m: points nearer than this count as one
_CUSP = 1e-5  # m: a curve that turns back within this length has a point no bead can follow
_BACK = np.radians(165.0)  # turn within _CUSP that counts as turning back


class Cusp(ValueError):
    """A curve turns back on itself at `place` (2 or 3) [m]."""

    def __init__(self, place: Array) -> None:
        self.place = place
        super().__init__(f"turns back on itself at {place}")


@dataclass(frozen=True)
class NurbsCurve:
    """A rational B-spline curve with a parameter from 0 to 1.

    spline: of weight times x, y and, in space, z [m], and of the weight; knots: the distinct ones
    """

    spline: BSpline
    knots: Array

    @classmethod
    def of(cls, spec: CurveSpec) -> NurbsCurve:
        """The curve of a validated specification; without knots, they are evenly spaced and clamped."""
        points, p = np.asarray(spec.points), spec.degree
        weights = np.ones(len(points)) if spec.weights is None else np.asarray(spec.weights)
        if spec.knots is None:
            inner = np.linspace(0.0, 1.0, len(points) - p + 1)
            knots = np.concatenate([np.zeros(p), inner, np.ones(p)])
        else:
            knots = np.asarray(spec.knots)
            knots = (knots - knots[0]) / (knots[-1] - knots[0])
        spline = BSpline(knots, np.column_stack([weights[:, None] * points, weights]), p)
        return cls(spline, np.unique(knots))

    def at(self, u: Array) -> Array:
        """Points (n, 2), or (n, 3) in space, at parameters u (n) [m]."""
        rows = np.asarray(self.spline(u))
        return np.asarray(rows[:, :-1] / rows[:, -1:])


def flatten(curve: NurbsCurve, name: str) -> PlanePath:
    """The curve as a polyline whose chords deviate from it by FLATNESS at most; every knot is a vertex.

    It is closed if the curve ends where it begins. Raises Cusp if the curve turns back on itself.
    """
    steps = np.arange(_PIECES) / _PIECES
    u = np.append((curve.knots[:-1, None] + np.diff(curve.knots)[:, None] * steps).ravel(), 1.0)
    while True:
        points = curve.at(u)
        step = np.diff(u)
        off = np.max([_off_chord(points, curve.at(u[:-1] + look * step)) for look in _LOOKS], axis=0)
        bad = np.flatnonzero((off > FLATNESS) & (step > _FINEST))
        if len(bad) == 0:
            break
        u = np.insert(u, bad + 1, u[bad] + 0.5 * step[bad])
    points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > _SAME)]
    _refuse_cusp(points)
    closed = len(points) > 2 and bool(np.linalg.norm(points[-1] - points[0]) <= FLATNESS)
    if closed:
        points[-1] = points[0]
    return PlanePath(name, points, closed)


def _off_chord(points: Array, between: Array) -> Array:
    """Distances (n - 1) of points `between` from the chords of successive points (n, 2 or 3)."""
    chord = np.diff(points, axis=0)
    away = between - points[:-1]
    square = np.maximum((chord * chord).sum(axis=1), _SAME**2)
    share = np.clip((away * chord).sum(axis=1) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(away - share[:, None] * chord, axis=1))


def _refuse_cusp(points: Array) -> None:
    """Raise Cusp if a polyline (n, 2 or 3) turns by _BACK or more within _CUSP."""
    step = np.diff(points, axis=0)
    if len(step) < 2:
        return
    size = np.linalg.norm(step, axis=1)
    unit = step / size[:, None]
    apart, together = (np.linalg.norm(unit[1:] + sign * unit[:-1], axis=1) for sign in (-1.0, 1.0))
    turn = 2.0 * np.arctan2(apart, together)
    arc = np.cumsum(size)[:-1]  # of the vertices that turn
    total = np.concatenate([[0.0], np.cumsum(turn)])
    turned = total[np.searchsorted(arc, arc + _CUSP, side="right")] - total[:-1]
    if turned.max() >= _BACK:
        raise Cusp(points[1 + int(np.argmax(turned))])


def nurbs_paths(curves: Sequence[CurveSpec], where: Callable[[int], Complaint]) -> tuple[PlanePath, ...]:
    """Curves in the given order, as polylines (n, 2) or (n, 3) in metres.

    Raises InputError, made by `where(i)(reason, hint=...)`, for a curve with a cusp.
    """
    paths = []
    for i, spec in enumerate(curves):
        try:
            paths.append(flatten(NurbsCurve.of(spec), f"curve {i + 1}"))
        except Cusp as error:
            at = ", ".join(f"{axis} {value:.2f}" for axis, value in zip("xyz", error.place * 1e3, strict=False))
            raise where(i)(
                f"curve {i + 1} turns back on itself at {at} mm",
                hint="no bead follows a cusp: move its control points, or make two curves of it",
            ) from None
    return tuple(paths)
