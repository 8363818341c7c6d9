"""From a drawing or a pattern to plane curves that fit a body, and their layers on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from planner.errors import Complaint
from planner.facets import read_facets
from planner.problem import Problem
from planner.problem.curves import CurvesSpec, ProjectedCurvesSpec
from planner.problem.drawings import (
    OnPartSpec,
    PatternSpec,
    ProjectedDrawingSpec,
    ProjectedPatternSpec,
    SvgSpec,
)
from planner.problem.faces import StepSpec
from planner.problem.part import MeshSpec, PartSpec
from planner.readonly import Array
from planner.toolpath.bead import Toolpath
from planner.toolpath.laying import densify
from planner.toolpath.nurbs import nurbs_paths
from planner.toolpath.ordering import reverse, shorten_travel
from planner.toolpath.paths import check_length, check_size, length, seam_on_smooth_part
from planner.toolpath.rounding import PlaneCurve, round_corners
from planner.toolpath.step.files import read_step
from planner.toolpath.step.top import FaceTop, NotSmooth, UpperFaces
from planner.toolpath.substrate.analytic import exact_body
from planner.toolpath.substrate.bodies import Body, MeshTop, Part, TooRough, reach_beside
from planner.toolpath.substrate.facet_tree import FacetTree
from planner.toolpath.substrate.layers import Substrate
from planner.toolpath.substrate.patterns import NoPattern, pattern
from planner.toolpath.svg import PlanePath, read_svg

STEEPEST = 75.0  # deg from the horizontal: beyond, a hair's breadth aside is a long way down, and the nozzle lies flat
REACH = 2.0  # bead widths beside a curve within which the surface counts
_SWING = 0.9  # of the corner tolerance, by which a rounded curve leaves a straight line between corners
RESERVE = 1.02  # the stretch varies within a tolerance
_EDGES = 1e-3  # m between points of faces' edges
_FOLDED = 0.2  # of the way from the body to a layer that folds: nearer to folding it is no layer


def project_curves(
    problem: Problem, spec: ProjectedDrawingSpec | ProjectedPatternSpec | ProjectedCurvesSpec
) -> Toolpath:
    """Round the corners of plane paths, order them and lay their layers on the part.

    Raises InputError for paths that miss the part or leave it, and for a part that nothing can be laid on.
    """
    process, source, part = problem.process, spec.source, problem.part
    if part is None:
        raise problem.error("part", "is missing", f"the body to project onto: {' or '.join(spec.bodies)}")
    paths = [placed(path, spec) for path in paths_of(problem, source)]
    outline = [densify(path.points) for path in paths]
    body = _body(problem, part, paths, outline)
    substrate = Substrate(body, spec.height, spec.offset == "z")

    curves = []
    for path, dense in zip(paths, outline, strict=True):
        check_length(problem, path, _size_key(source))
        start = seam_on_smooth_part(path) if path.closed else path
        share = _share(problem, substrate, spec.count, path.name, dense)
        curve = round_corners(start, process.corner_tolerance, share)
        hint = f"choose a smaller tolerance, or a greater {_size_key(source)}"
        check_size(problem, path.name, length(path.points), length(curve.points), hint)
        _check_there(problem, body, path.name, curve.points)
        curves.append(curve)
    rows = [shorten_travel(curves)]
    while len(rows) < spec.count:  # the next layer starts where this one ended
        rows.append([reverse(curve) for curve in reversed(rows[-1])])
    if spec.facing is not None and isinstance(body, MeshTop):
        substrate = substrate.facing(rows, spec.facing, body.facets)
    return _laid(substrate, rows, process.bead.width, process.bead.height)


def _laid(substrate: Substrate, rows: Sequence[Sequence[PlaneCurve]], width: float, height: float) -> Toolpath:
    beads = substrate.lay(rows, width, height)
    grown = replace(substrate, layers=tuple(bead.layer for bead in beads))
    body = substrate.body
    return Toolpath(tuple(beads), grown, body.shape(), solid=body.facets.corners if isinstance(body, MeshTop) else None)


def _size_key(source: SvgSpec | PatternSpec | CurvesSpec) -> str:
    if isinstance(source, CurvesSpec):
        return "layers.source.curves"
    return "layers.source.width_mm" if isinstance(source, SvgSpec) else "layers.source.size_mm"


def paths_of(problem: Problem, source: SvgSpec | PatternSpec | CurvesSpec) -> tuple[PlanePath, ...]:
    """The plane paths of a source. Raises InputError for one that gives none."""
    process = problem.process
    if isinstance(source, CurvesSpec):
        return nurbs_paths(problem, source)
    if isinstance(source, SvgSpec):
        return read_svg(source.svg, source.width, process.chord_tolerance, partial(problem.error, "layers.source.svg"))
    try:
        beside = process.bead.width + 2.0 * _SWING * process.corner_tolerance
        return pattern(source, beside, process.chord_tolerance)
    except NoPattern as error:
        raise problem.error("layers.source.cell_mm", str(error), "change cell_mm or size_mm") from None


def placed(path: PlanePath, spec: OnPartSpec) -> PlanePath:
    """A path turned and moved to its place above the part."""
    c, s = np.cos(spec.turn), np.sin(spec.turn)
    points = path.points @ np.array([[c, s], [-s, c]]) + np.asarray(spec.centre)
    if path.closed:
        points[-1] = points[0]
    return replace(path, points=points)


def _body(problem: Problem, part: PartSpec, paths: Sequence[PlanePath], outline: Sequence[Array]) -> Body:
    """The body, once it is known that all paths fall onto it."""
    exact = exact_body(part)
    if exact is not None:
        _check_all(problem, exact, paths, outline)
        return exact
    if part.step is not None:
        return _step_body(problem, part.step, paths, outline)
    if part.mesh is None:
        raise problem.error("part", f"a {part.body} is nothing to project onto")
    facets = top_facets(part.mesh, partial(problem.error, "part.mesh.file"))
    _check_all(problem, facets, paths, outline)
    near = np.vstack(outline)
    reach = reach_beside(facets, near, REACH * problem.process.bead.width)
    return smooth_top(facets, near, reach, partial(problem.error, "part.mesh.file"))


def top_facets(spec: MeshSpec, where: Complaint) -> FacetTree:
    """The facets of a mesh, some of which face upwards, else InputError; for `where` see read_facets."""
    facets = FacetTree.of(read_facets(spec, where))
    if facets.normals[:, 2].max() <= 0.0:
        raise where(f"no facet of {spec.file.name} faces upwards", hint="turn it with rpy_deg")
    return facets


def smooth_top(facets: FacetTree, curves: Array, reach: float, where: Complaint, part: Part | None = None) -> MeshTop:
    """The mesh with a smooth surface near curves (n, 2), else InputError; for `reach` and `part` see MeshTop.near."""
    try:
        return MeshTop.near(facets, curves, reach, part)
    except TooRough as error:
        x, y = error.place * 1e3
        raise where(
            f"the smooth surface through the facets is {error.gap * 1e3:.3f} mm off them at x {x:.1f}, y {y:.1f} mm",
            "there is an edge under the curves, or facets are too large: keep off the edge, or export a finer mesh",
        ) from None


def _step_body(problem: Problem, spec: StepSpec, paths: Sequence[PlanePath], outline: Sequence[Array]) -> Body:
    """The upper faces of a STEP file with a smooth surface on them, once it is known that all paths fall onto them."""
    complain = partial(problem.error, "part.step.file")
    upper = UpperFaces.of(read_step(spec, _EDGES, complain))
    if upper is None:
        raise complain(f"no face of {spec.file.name} looks upwards", hint="turn it with part.step.rpy_deg")
    _check_all(problem, upper, paths, outline)
    try:
        return FaceTop.near(upper, np.vstack(outline), REACH * problem.process.bead.width)
    except NotSmooth as error:
        x, y = error.place * 1e3
        raise complain(
            f"the faces are {error.gap * 1e3:.3f} mm off any smooth surface at x {x:.1f}, y {y:.1f} mm",
            "there is an edge or a step under the curves: keep off it",
        ) from None


def _check_all(
    problem: Problem, body: Body | FacetTree | UpperFaces, paths: Sequence[PlanePath], outline: Sequence[Array]
) -> None:
    if not any(np.isfinite(body.upward(points)).any() for points in outline):
        raise problem.error(
            "layers.centre_mm", "no curve falls onto the part", "the middle of the curves, x and y of the part frame"
        )
    for path, points in zip(paths, outline, strict=True):
        _check_there(problem, body, path.name, points)


def _check_there(problem: Problem, body: FacetTree | UpperFaces | Body, name: str, plane: Array) -> None:
    """Raise InputError where a curve leaves the part, or where this is too steep."""
    up = body.upward(plane)
    off = ~(up >= np.cos(np.radians(STEEPEST)))
    if not off.any():
        return
    i = int(np.argmax(off))
    x, y = plane[i] * 1e3
    what = "leaves the part" if np.isnan(up[i]) else f"comes to a wall of {np.degrees(np.arccos(up[i])):.0f} degrees"
    raise problem.error(
        "layers.source",
        f"path {name!r} {what} at x {x:.1f}, y {y:.1f} mm",
        f"make it smaller or move it (layers.centre_mm); the part may lean by {STEEPEST:g} degrees",
    )


def _share(problem: Problem, substrate: Substrate, count: int, name: str, dense: Array) -> Callable[[Array], Array]:
    """How much shorter a line is in the plane than on the part, at least over the layers, at points (n, 2) of a path.

    Raises InputError for layers that would fold.
    """
    last = count - 1
    reserve = substrate.stretch(dense, last)[1]
    if reserve.min() < _FOLDED:
        x, y = dense[int(np.argmin(reserve))] * 1e3
        raise problem.error(
            "layers.count",
            f"the part is bent inwards too tightly under path {name!r} at x {x:.1f}, y {y:.1f} mm: layers would fold",
            "fewer or thinner layers, or layers.offset: z",
        )
    tree, values = cKDTree(dense), np.maximum(substrate.stretch(dense, 0)[0], substrate.stretch(dense, last)[0])
    return lambda plane: np.asarray(1.0 / (RESERVE * values[tree.query(plane)[1]]))
