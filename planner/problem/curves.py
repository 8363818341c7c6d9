"""NURBS curves in a plane, projected onto the part: `layers.source.curves`."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, model_validator

from planner.problem.drawings import ProjectedLayersSpec
from planner.problem.fields import Quantity, Section, key, refusal
from planner.problem.file import describe
from planner.problem.sources import SourceSection

HIGHEST_DEGREE = 9  # drawing programs end at 11; beyond 5 nobody draws
MOST_POINTS = 5000  # of a curve
LIGHTEST, HEAVIEST = 1e-3, 1e3  # weights: beyond, a curve is nothing but its heaviest points


def _some_curves(value: Any) -> Any:
    if not isinstance(value, tuple) or not value:
        what = "an empty list" if value == () else describe(value)
        raise refusal(f"must be a list of curves, not {what}", "for example [{degree: 2, points_mm: [[0, 0], ...]}]")
    return value


def _some_points(value: Any) -> Any:
    if not isinstance(value, tuple) or not all(isinstance(point, tuple) for point in value):
        raise refusal("must be a list of points", "for example [[0, 0], [10, 5], [20, -5], [30, 0]]")
    if len(value) > MOST_POINTS:
        raise refusal(f"has {len(value)} points", f"at most {MOST_POINTS}: divide the curve")
    return value


class CurveSpec(Section):
    """A rational B-spline curve in the plane."""

    degree: Annotated[int, Quantity("", 1, HIGHEST_DEGREE, whole=True)] = key("degree", "degree of the curve")
    points: Annotated[
        tuple[Annotated[tuple[float, float], Quantity("mm", -100_000, 100_000, count=2)], ...],
        BeforeValidator(_some_points),
    ] = key("points_mm", "its control points, x and y, at least degree + 1 of them [mm]")
    weights: Annotated[tuple[float, ...], Quantity("", LIGHTEST, HEAVIEST, count=(1, MOST_POINTS))] | None = key(
        "weights", "one for each control point; default: all 1", None
    )
    knots: Annotated[tuple[float, ...], Quantity("", -1e6, 1e6, count=(1, 2 * MOST_POINTS))] | None = key(
        "knots",
        "as many as points + degree + 1, the first and the last degree + 1 of them equal; default: evenly spaced",
        None,
    )

    @model_validator(mode="after")
    def _enough_points(self) -> CurveSpec:
        least = self.degree + 1
        if len(self.points) < least:
            reason = f"a curve of degree {self.degree} has at least {least} control points, not {len(self.points)}"
            raise refusal(reason, "add points_mm, or choose a lower degree", fields=["points_mm"])
        if self.weights is not None and len(self.weights) != len(self.points):
            reason = f"{len(self.weights)} weights for {len(self.points)} control points"
            raise refusal(reason, "one weight for each of points_mm", fields=["weights"])
        return self

    @model_validator(mode="after")
    def _knots_make_one_curve(self) -> CurveSpec:
        if self.knots is None:
            return self
        knots, p = self.knots, self.degree
        needed = len(self.points) + p + 1
        if len(knots) != needed:
            hint = f"points + degree + 1 = {needed}"
            if len(knots) == needed - 2:
                hint += "; some programs leave out the first and the last one: repeat these"
            raise refusal(f"{len(knots)} knots instead of {needed}", hint, fields=["knots"])
        for i, (a, b) in enumerate(zip(knots[:-1], knots[1:], strict=True)):
            if b < a:
                reason = f"knot {i + 2} ({b:g}) is less than the one before it ({a:g})"
                raise refusal(reason, "knots never decrease", fields=["knots"])
        if not knots[0] == knots[p] < knots[-p - 1] == knots[-1]:
            reason = f"the curve does not begin at its first control point and end at its last: knots {_ends(knots, p)}"
            hint = f"repeat the first and the last knot {p + 1} times (a clamped curve)"
            raise refusal(reason, hint, fields=["knots"])
        inner = knots[p + 1 : -p - 1]
        for knot in inner:
            if inner.count(knot) > p or knot in (knots[0], knots[-1]):
                reason = f"knot {knot:g} stands in the list {knots.count(knot)} times, which breaks the curve apart"
                hint = f"at most {p} times inside, {p + 1} times at the ends; or make two curves of it"
                raise refusal(reason, hint, fields=["knots"])
        return self


def _ends(knots: tuple[float, ...], degree: int) -> str:
    first, last = (", ".join(f"{knot:g}" for knot in part) for part in (knots[: degree + 1], knots[-degree - 1 :]))
    return f"{first} ... {last}"


class CurvesSpec(SourceSection):
    """Curves that become beads, in one plane."""

    curves: Annotated[tuple[CurveSpec, ...], BeforeValidator(_some_curves)] = key(
        "curves", "NURBS curves, each with degree, points_mm and, if wanted, weights and knots"
    )


class ProjectedCurvesSpec(ProjectedLayersSpec):
    """Curves projected onto the part."""

    source: CurvesSpec = key("source", "where the curves come from")
