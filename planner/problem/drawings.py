"""Plane curves, wrapped around the part or projected onto it: drawings, patterns and NURBS curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BeforeValidator, model_validator

from planner.problem.fields import PATH, UNIT_VECTOR, Quantity, Section, Thickness, Vector, key, one_of, refusal
from planner.problem.part import Unit, unit_key
from planner.problem.process import MaterialName, material_key
from planner.problem.yaml_file import describe

# Keys of layers.source that name a source: only one may be given.
SOURCE_NAMES = ("svg", "dxf", "pattern", "curves", "nurbs", "waypoints", "gcode", "mesh", "aerofoil", "naca", "faces")

BLEND_MM = 6  # two facets of the published dome; measured in benchmarks.orientation
PatternName = Literal["honeycomb", "zigzag", "squares", "concentric"]
PATTERN_NAMES: tuple[str, ...] = get_args(PatternName)

ProjectName = Literal["z", "normal", "direction"]
PROJECT_NAMES: tuple[str, ...] = get_args(ProjectName)

HIGHEST_DEGREE = 25  # as in Open CASCADE; CAD programs that approximate curves write 14
FARTHEST_MM = 100_000.0  # of a control point's coordinates
MOST_POINTS = 5000  # of a curve
LIGHTEST, HEAVIEST = 1e-3, 1e3  # weights: beyond these, only its heaviest points shape a curve


Crumbs = Annotated[float, Quantity("", 0, 1)]


def crumbs_key(what: str) -> Crumbs:
    """The field for how much of a source may be left out."""
    field: Crumbs = key(
        "leave_out_share", f"share of {what} that may be left out; with more, the print is refused", 0.01
    )
    return field


_CURVES = "the length (off the part, at its walls and edges, or too short for a bead)"


class SourceSection(Section):
    """A source of toolpaths; refused if another source is named as well."""

    @model_validator(mode="before")
    @classmethod
    def _one_source(cls, value: Any) -> Any:
        given = [name for name in SOURCE_NAMES if isinstance(value, dict) and name in value]
        if len(given) > 1:
            raise refusal(f"both {given[0]} and {given[1]} are given", "give one of them", fields=given)
        return value


NARROWEST_MM, WIDEST_MM = 0.1, 15_000.0  # of a drawing


class SvgSpec(SourceSection):
    """A drawing whose lines become beads."""

    svg: Annotated[Path, PATH] = key("svg", "the drawing, path relative to the problem file's folder")
    width: Annotated[float, Quantity("mm", NARROWEST_MM, WIDEST_MM)] = key(
        "width_mm", "width of the drawing on the part [mm]"
    )
    crumbs: Crumbs = crumbs_key(_CURVES)


def _some_names(value: Any) -> Any:
    if value is not None and (not isinstance(value, tuple) or not all(isinstance(name, str) for name in value)):
        raise refusal(f"must be a list of names, not {describe(value)}", "for example [outline, ribs]")
    if value == ():
        raise refusal("names no layer", "leave it out for all layers that are on")
    return value


class DxfSpec(SourceSection):
    """A drawing in a DXF file whose lines become beads."""

    dxf: Annotated[Path, PATH] = key("dxf", "the drawing (DXF), path relative to the problem file's folder")
    unit: Unit | None = unit_key()
    width: Annotated[float, Quantity("mm", NARROWEST_MM, WIDEST_MM)] | None = key(
        "width_mm", "width of the drawing on the part [mm]; default: as it is drawn", None
    )
    layers: Annotated[tuple[str, ...] | None, BeforeValidator(_some_names)] = key(
        "layers", "names of the drawing's layers to print; default: all that are on", None
    )
    join: Annotated[float, Quantity("mm", 0, 10)] = key(
        "join_mm", "lines of a layer whose ends are no farther apart are joined [mm]", 0.01
    )
    crumbs: Crumbs = crumbs_key(_CURVES)


class PatternSpec(SourceSection):
    """A plane pattern whose lines become beads."""

    pattern: Annotated[PatternName, one_of(PATTERN_NAMES)] = key("pattern", f"one of {', '.join(PATTERN_NAMES)}")
    cell: Annotated[float, Quantity("mm", 0.1, 1000)] = key(
        "cell_mm", "width of a cell from wall to wall, or distance between lines [mm]"
    )
    size: Annotated[tuple[float, float], Quantity("mm", 0.1, 15_000, count=2)] = key(
        "size_mm", "greatest extent of the pattern, in x and y [mm]"
    )
    outline: Annotated[Literal["rectangle", "ellipse"], one_of(("rectangle", "ellipse"))] = key(
        "outline", "shape of the area it covers: rectangle or ellipse", "rectangle"
    )
    crumbs: Crumbs = crumbs_key(_CURVES)


class WrappedLayersSpec(Section):
    """Layers of a drawing wrapped around the part."""

    bodies: ClassVar[tuple[str, ...]] = ("cylinder",)  # bodies they can be laid on

    wrap: Annotated[Literal["cylinder"], one_of(("cylinder",))] = key("wrap", "the surface they are laid on")
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")
    material: MaterialName | None = material_key("all beads")


class LayersSpec(WrappedLayersSpec):
    """A drawing (SVG) wrapped around the part."""

    source: SvgSpec = key("source", "where the curves come from")


class WrappedDxfSpec(WrappedLayersSpec):
    """A drawing (DXF) wrapped around the part."""

    source: DxfSpec = key("source", "where the curves come from")


class OnPartSpec(Section):
    """How plane curves are placed above the part."""

    centre: Annotated[tuple[float, float], Quantity("mm", -100_000, 100_000, count=2)] = key(
        "centre_mm", "where the middle of the curves lies, x and y of the part frame [mm]", (0, 0)
    )
    turn: Annotated[float, Quantity("deg", -360, 360)] = key(
        "turn_deg", "by how much the curves are turned about the vertical [deg]", 0
    )


class ProjectedLayersSpec(OnPartSpec):
    """Layers of plane curves projected onto the part."""

    bodies: ClassVar[tuple[str, ...]] = ("sphere", "ellipsoid", "plane", "corrugation", "mesh", "scan", "step")
    exact: ClassVar[tuple[str, ...]] = ("sphere", "ellipsoid", "plane", "corrugation")  # for projections other than z

    project: Annotated[ProjectName, one_of(PROJECT_NAMES)] = key(
        "project",
        "how curves are projected onto the part: along z, along its normals (each point to the nearest place), or in a "
        "direction",
    )
    direction: Annotated[Vector, Quantity("", -1000, 1000, count=3), UNIT_VECTOR] | None = key(
        "direction", "direction of the projection, with project: direction; not upwards; default: none", None
    )
    offset: Annotated[Literal["normal", "z"], one_of(("normal", "z"))] = key(
        "offset", "where the next layer lies: along the surface's normal, or along z", "normal"
    )
    count: Annotated[int, Quantity("", 1, 10_000, whole=True)] = key("count", "number of layers")
    height: Thickness = key("height_mm", "height of a layer [mm]")
    material: MaterialName | None = material_key("all beads")
    normals: Annotated[Literal["smooth", "facets"], one_of(("smooth", "facets"))] = key(
        "normals",
        "what the nozzle is normal to: a smooth surface through the facets of a mesh, or the facets themselves, "
        "between which it turns over blend_mm",
        "smooth",
    )
    blend: Annotated[float, Quantity("mm", 0.1, 100)] | None = key(
        "blend_mm",
        f"length along a bead over which the nozzle turns from one facet's normal to the next's [mm]; "
        f"default: {BLEND_MM} with normals: facets",
        None,
    )

    @model_validator(mode="after")
    def _one_way_to_fall(self) -> ProjectedLayersSpec:
        if (self.project == "direction") != (self.direction is not None):
            reason = (
                "project is direction, but no direction is given"
                if self.direction is None
                else f"project is {self.project}"
            )
            hint = "give direction, for example [0.3, 0, -1]" if self.direction is None else "leave out direction"
            raise refusal(reason, hint, fields=["direction", "project"])
        if self.direction is not None and self.direction[2] > 0.0:
            raise refusal(
                "points upwards, but the part is seen from above", "give a direction into the part", item="direction"
            )
        return self

    @model_validator(mode="after")
    def _blend_between_facets(self) -> ProjectedLayersSpec:
        if self.blend is not None and self.normals == "smooth":
            raise refusal("normals are smooth", "leave out blend_mm, or set normals: facets", item="blend_mm")
        return self

    @property
    def facing(self) -> float | None:
        """Length over which the nozzle turns from facet to facet [m]; None if it follows the smooth surface."""
        if self.normals == "smooth":
            return None
        return BLEND_MM * 1e-3 if self.blend is None else self.blend


class ProjectedDrawingSpec(ProjectedLayersSpec):
    """A drawing projected onto the part."""

    source: SvgSpec = key("source", "where the curves come from")


class ProjectedDxfSpec(ProjectedLayersSpec):
    """A drawing (DXF) projected onto the part."""

    source: DxfSpec = key("source", "where the curves come from")


class ProjectedPatternSpec(ProjectedLayersSpec):
    """A pattern projected onto the part."""

    source: PatternSpec = key("source", "where the curves come from")


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
    """A rational B-spline curve in the plane, or in space."""

    degree: Annotated[int, Quantity("", 1, HIGHEST_DEGREE, whole=True)] = key("degree", "degree of the curve")
    points: Annotated[
        tuple[Annotated[tuple[float, ...], Quantity("mm", -FARTHEST_MM, FARTHEST_MM, count=(2, 3))], ...],
        BeforeValidator(_some_points),
    ] = key("points_mm", "its control points, x and y or x, y and z, at least degree + 1 of them [mm]")
    weights: Annotated[tuple[float, ...], Quantity("", LIGHTEST, HEAVIEST, count=(1, MOST_POINTS))] | None = key(
        "weights", "one for each control point; default: all 1", None
    )
    knots: Annotated[tuple[float, ...], Quantity("", -1e6, 1e6, count=(1, 2 * MOST_POINTS))] | None = key(
        "knots",
        "points + degree + 1 of them, the first degree + 1 equal, and the last; default: evenly spaced",
        None,
    )

    @model_validator(mode="after")
    def _alike_points(self) -> CurveSpec:
        odd = next((i for i, point in enumerate(self.points) if len(point) != len(self.points[0])), None)
        if odd is not None:
            reason = f"point {odd + 1} has {len(self.points[odd])} numbers, but point 1 has {len(self.points[0])}"
            raise refusal(reason, "x and y for all, or x, y and z", fields=["points_mm"])
        return self

    @model_validator(mode="after")
    def _enough_points(self) -> CurveSpec:
        least = self.degree + 1
        if len(self.points) < least:
            reason = f"a curve of degree {self.degree} needs at least {least} control points, not {len(self.points)}"
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
                reason = f"knot {knot:g} appears {knots.count(knot)} times in the list, which breaks the curve apart"
                hint = f"at most {p} times inside, {p + 1} times at the ends; or make two curves of it"
                raise refusal(reason, hint, fields=["knots"])
        return self


def _ends(knots: tuple[float, ...], degree: int) -> str:
    first, last = (", ".join(f"{knot:g}" for knot in part) for part in (knots[: degree + 1], knots[-degree - 1 :]))
    return f"{first} ... {last}"


SomeCurves = Annotated[tuple[CurveSpec, ...], BeforeValidator(_some_curves)]


class CurvesSpec(SourceSection):
    """Curves that become beads, in one plane or in space."""

    curves: SomeCurves = key("curves", "NURBS curves, each with degree, points_mm and, if wanted, weights and knots")
    crumbs: Crumbs = crumbs_key(_CURVES)


class CurveListSpec(Section):
    """The contents of a file of NURBS curves."""

    curves: SomeCurves = key("curves", "NURBS curves, each with degree, points_mm and, if wanted, weights and knots")


class NurbsSpec(SourceSection):
    """Curves in a file that become beads, in one plane or in space."""

    nurbs: Annotated[Path, PATH] = key(
        "nurbs",
        "file of curves, path relative to the problem file's folder: JSON with a list `curves` of NURBS curves; or "
        "STEP or IGES, whose lines, arcs and splines that bound no face are taken",
    )
    crumbs: Crumbs = crumbs_key(_CURVES)


class ProjectedCurvesSpec(ProjectedLayersSpec):
    """Curves projected onto the part."""

    source: CurvesSpec = key("source", "where the curves come from")


class ProjectedNurbsSpec(ProjectedLayersSpec):
    """Curves of a file projected onto the part."""

    source: NurbsSpec = key("source", "where the curves come from")
