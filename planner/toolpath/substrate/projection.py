"""Plane curves projected along z onto a body, layer on layer (Pollard et al., section 4.1).

Curves that leave their region are cut there, together with the input paths they stand for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.base.errors import Complaint
from planner.base.geometry import arc_lengths
from planner.problem import Problem
from planner.problem.drawings import (
    CurvesSpec,
    OnPartSpec,
    PatternSpec,
    ProjectedCurvesSpec,
    ProjectedDrawingSpec,
    ProjectedPatternSpec,
    SvgSpec,
)
from planner.problem.mesh_files import read_facets
from planner.problem.part import MeshSpec, PartSpec, StepSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.nurbs import nurbs_paths
from planner.toolpath.ordering import reverse, shorten_travel
from planner.toolpath.plane_paths import (
    PlaneCurve,
    arc_length,
    check_length,
    check_size,
    densify,
    length,
    round_corners,
    seam_on_smooth_part,
)
from planner.toolpath.step.files import read_step
from planner.toolpath.step.top import FaceTop, NotSmooth, UpperFaces
from planner.toolpath.substrate.bodies import Facing, SubstrateBody, exact_body
from planner.toolpath.substrate.mesh_surface import FacetTree
from planner.toolpath.substrate.mesh_top import MeshTop, Part, TooRoughMesh, reach_beside
from planner.toolpath.substrate.patterns import NoPattern, pattern
from planner.toolpath.svg.outlines import PlanePath, read_svg
from planner.toolpath.task import roll_zeros

_ASIDE = 1e-5  # m, to either side, for the slope of what a plane point is mapped to

_SAME = 1e-9  # m: vertices nearer than this to a cut are the cut

STEEPEST = 75.0  # deg from the horizontal: beyond, a hair's breadth aside is a long way down, and the nozzle lies flat
REACH = 2.0  # bead widths beside a curve within which the surface counts
_SWING = 0.9  # of the corner tolerance, by which a rounded curve leaves a straight line between corners
RESERVE = 1.02  # the stretch varies within a tolerance
_EDGES = 1e-3  # m between points of faces' edges
_FOLDED = 0.2  # of the way from the body to a layer that folds: nearer to folding it is no layer


@dataclass(frozen=True)
class Substrate:
    """A body and the layers on it, each `height` [m] above the one before: along the normal, or along z.

    layers   of all beads in print order
    solid    how many layers count as there; beneath the layer that is printed the body has grown everywhere
    facings  what the nozzle is normal to along each bead, where that is not the layer itself
    """

    body: SubstrateBody
    height: float
    along_z: bool
    layers: tuple[int, ...] = ()
    solid: int = 0
    facings: tuple[Facing, ...] = ()

    def before(self, bead: int) -> Substrate:
        """The surface when the first `bead` beads have been printed: the last one's layer lies on it."""
        return replace(self, solid=self.layers[bead - 1] if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the body with its solid layers; negative inside."""
        rise = self.solid * self.height
        if self.along_z:
            return self.body.signed_distance(points - [0.0, 0.0, rise])
        return self.body.signed_distance(points) - rise

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the layer through points (n, 3)."""
        if self.along_z:
            normals = self.body.at(points[:, :2])[1]
            beside = np.isnan(normals[:, 0])
            if beside.any():
                normals[beside] = self.body.normals(points[beside])
            return normals
        return self.body.normals(points)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """The layer's at the tips (n, 3), or those that a bead follows instead, at arc lengths s (n)."""
        return self.facings[bead].at(s) if self.facings else self.normals(tips)

    def project(self, plane: Array, layer: int) -> tuple[Array, Array]:
        """Nozzle tip and normals (n, 3) above plane points (n, 2): layer k's runs k + 1 layer heights above the body."""
        points, normals = self.body.at(plane)
        way = np.array([0.0, 0.0, 1.0]) if self.along_z else normals
        return points + (layer + 1) * self.height * way, normals

    def stretch(self, plane: Array, layer: int) -> tuple[Array, Array]:
        """How much a layer stretches short lines at plane points (n, 2), and its reserve against folding.

        Returns the greatest stretch (n), and by how much less the layer is bent than would fold it (n): 1 on the body
        itself, 0 or less where it is folded.
        """
        steps = np.array([[_ASIDE, 0.0], [0.0, _ASIDE]])
        slope = [
            (self.project(plane + d, layer)[0] - self.project(plane - d, layer)[0]) / (2.0 * _ASIDE) for d in steps
        ]
        E, F, G = ((slope[i] * slope[j]).sum(axis=1) for i, j in ((0, 0), (0, 1), (1, 1)))
        greatest = np.sqrt(0.5 * (E + G) + np.sqrt(0.25 * (E - G) ** 2 + F**2))
        normals = self.body.at(plane)[1]
        area = (np.cross(slope[0], slope[1]) * normals).sum(axis=1)
        return greatest, area * normals[:, 2]

    def facing(self, curves: Sequence[Sequence[PlaneCurve]], blend: float, facets: FacetTree) -> Substrate:
        """The same where the nozzle is normal to facets along plane curves, those of one layer after another."""
        facings = []
        for layer, row in enumerate(curves):
            for curve in row:
                s = arc_length(self.project(curve.points, layer)[0])
                normals = facets.normals[facets.top(curve.points)[1]]
                facings.append(Facing.along(s, normals, blend, curve.closed))
        return replace(self, facings=tuple(facings))

    def lay(self, curves: Sequence[Sequence[PlaneCurve]], width: float, height: float) -> list[Bead]:
        """Beads `width` and `height` [m] along plane curves, those of one layer after another, in print order."""
        placed = [
            (layer, curve, *self.project(curve.points, layer)) for layer, row in enumerate(curves) for curve in row
        ]
        arcs = [arc_length(points) for _, _, points, _ in placed]
        axes = [normals for _, _, _, normals in placed]
        if self.facings:
            axes = [facing.at(s) for facing, s in zip(self.facings, arcs, strict=True)]
        return [
            Bead(
                name=curve.name,
                layer=layer,
                s=s,
                points=points,
                normals=axis,
                roll_zero=zero,
                source=self.project(densify(curve.source), layer)[0],
                width=np.full(len(points), width),
                height=height * (normals[:, 2] if self.along_z else np.ones(len(points))),
                closed=curve.closed,
            )
            for (layer, curve, points, normals), s, axis, zero in zip(placed, arcs, axes, roll_zeros(axes), strict=True)
        ]


def trim_path(path: PlanePath, dense: Array, keep: Flags) -> list[PlanePath]:
    """The pieces of a polyline where its dense points (n, 2) are kept (n); closed if all of a closed one are."""
    if keep.all():
        return [path]
    arc = arc_lengths(dense)
    return [
        PlanePath(path.name, _between(path.points, *ends), False)
        for ends in (_unrolled(arc, *run) for run in _runs(keep, path.closed))
        if ends[1] - ends[0] > _SAME
    ]


def trim_curve(curve: PlaneCurve, keep: Flags) -> list[PlaneCurve]:
    """The pieces of a rounded curve whose samples are kept (n), from sample to sample; at least two samples each."""
    if keep.all():
        return [curve]
    last = len(keep) - 1
    total = length(curve.source)
    pieces = []
    for first, end in _runs(keep, curve.closed):
        if end == first:
            continue
        index = np.arange(first, end + 1)
        index = np.where(index > last, index - last, index)  # past the seam of a closed curve
        source = _between(curve.source, first * total / last, end * total / last)
        pieces.append(replace(curve, points=curve.points[index], source=source, closed=False))
    return pieces


def _runs(keep: Flags, closed: bool) -> list[tuple[int, int]]:
    """First and last place of each run of kept places (n), not all of them; past n - 1 where it crosses the seam."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(np.int8), [0]])))
    runs = [(int(first), int(end) - 1) for first, end in change.reshape(-1, 2)]
    if closed and len(runs) > 1 and runs[0][0] == 0 and runs[-1][1] == len(keep) - 1:
        runs = [*runs[1:-1], (runs[-1][0], len(keep) - 1 + runs[0][1])]
    return runs


def _unrolled(arc: Array, first: int, end: int) -> tuple[float, float]:
    """Arc lengths of the places `first` and `end`, the latter past the seam where it is no place of its own."""
    last = len(arc) - 1
    return float(arc[first]), float(arc[end]) if end <= last else float(arc[-1] + arc[end - last])


def _between(points: Array, low: float, high: float) -> Array:
    """A polyline (n, 2) from one arc length to another [m], which may lie a round further on a closed one."""
    arc = arc_lengths(points)
    if high > arc[-1] + _SAME:
        points, arc = np.vstack([points, points[1:]]), np.concatenate([arc, arc[-1] + arc[1:]])
    inner = points[(arc > low + _SAME) & (arc < high - _SAME)]
    ends = np.column_stack([np.interp([low, high], arc, points[:, k]) for k in range(2)])
    return np.vstack([ends[:1], inner, ends[1:]])


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
    if not isinstance(body, MeshTop):
        return Toolpath(tuple(beads), grown, body.shape())
    notes = (f"part.mesh: {body.words}",) if body.words else ()
    return Toolpath(tuple(beads), grown, body.shape(), notes, body.facets.corners)


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


def _body(problem: Problem, part: PartSpec, paths: Sequence[PlanePath], outline: Sequence[Array]) -> SubstrateBody:
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
    return smooth_top(facets, near, reach, part.mesh.smooth, partial(problem.error, "part.mesh.file"))


def top_facets(spec: MeshSpec, where: Complaint) -> FacetTree:
    """The facets of a mesh, some of which face upwards, else InputError; for `where` see read_facets."""
    facets = FacetTree.of(read_facets(spec, where))
    if facets.normals[:, 2].max() <= 0.0:
        raise where(f"no facet of {spec.file.name} faces upwards", hint="turn it with rpy_deg")
    return facets


def smooth_top(
    facets: FacetTree, curves: Array, reach: float, bound: float | None, where: Complaint, part: Part | None = None
) -> MeshTop:
    """The mesh with a smooth surface near curves (n, 2), else InputError; for the others see MeshTop.near."""
    try:
        return MeshTop.near(facets, curves, reach, part, bound)
    except TooRoughMesh as error:
        x, y = error.place * 1e3
        raise where(
            f"the smooth surface through the facets is {error.gap * 1e3:.3f} mm off them at x {x:.1f}, y {y:.1f} mm",
            f"there is an edge under the curves, or facets are too large: keep off the edge, or export a finer mesh"
            f"{error.words}",
        ) from None


def _step_body(problem: Problem, spec: StepSpec, paths: Sequence[PlanePath], outline: Sequence[Array]) -> SubstrateBody:
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
    problem: Problem, body: SubstrateBody | FacetTree | UpperFaces, paths: Sequence[PlanePath], outline: Sequence[Array]
) -> None:
    if not any(np.isfinite(body.upward(points)).any() for points in outline):
        raise problem.error(
            "layers.centre_mm", "no curve falls onto the part", "the middle of the curves, x and y of the part frame"
        )
    for path, points in zip(paths, outline, strict=True):
        _check_there(problem, body, path.name, points)


def _check_there(problem: Problem, body: FacetTree | UpperFaces | SubstrateBody, name: str, plane: Array) -> None:
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
