"""Plane curves projected along z onto a body, layer on layer (Pollard et al., section 4.1).

Parts that cannot be printed are cut, reported and drawn (`clipping.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.base.errors import Complaint, InputError
from planner.problem import Problem
from planner.problem.clouds import read_scan
from planner.problem.curve_files import read_curves
from planner.problem.drawings import (
    CurvesSpec,
    DxfSpec,
    NurbsSpec,
    OnPartSpec,
    PatternSpec,
    ProjectedCurvesSpec,
    ProjectedDrawingSpec,
    ProjectedDxfSpec,
    ProjectedNurbsSpec,
    ProjectedPatternSpec,
    SvgSpec,
)
from planner.problem.mesh_files import read_facets
from planner.problem.mesh_repair import facing_alike
from planner.problem.part import MeshSpec, PartSpec, StepSpec
from planner.toolpath.bead import Bead, Told, Toolpath
from planner.toolpath.dxf.reader import read_dxf
from planner.toolpath.nurbs import nurbs_paths
from planner.toolpath.ordering import rows_of_layers
from planner.toolpath.plane_paths import (
    PlaneCurve,
    arc_length,
    check_size,
    densify,
    length,
    round_corners,
    with_seam,
)
from planner.toolpath.step.files import read_faces
from planner.toolpath.step.top import FaceTop, NotSmooth, UpperFaces
from planner.toolpath.substrate.bodies import Facing, SubstrateBody, exact_body
from planner.toolpath.substrate.clipping import (
    FITS,
    FOLDS,
    OFF,
    SHORT,
    SHORTEST,
    STEEP,
    STEEPEST,
    Clipped,
    Cut,
    TooMuchCut,
    at_edges,
    creases,
    lost_pieces,
    off_or_steep,
    share_words,
    trim_curve,
    vanishes,
)
from planner.toolpath.substrate.curved_facets import CREASE
from planner.toolpath.substrate.falling import fallen
from planner.toolpath.substrate.mesh_surface import FacetTree
from planner.toolpath.substrate.mesh_top import FARTHEST_FROM_FACETS, MeshTop, Part, TooRoughMesh, reach_beside
from planner.toolpath.substrate.patterns import NoPattern, pattern
from planner.toolpath.substrate.scan_surface import scan_surface
from planner.toolpath.svg.outlines import PlanePath, read_svg_once
from planner.toolpath.task import roll_zeros
from planner.toolpath.workload import check_curves

_ASIDE = 1e-5  # m to either side of a plane point for finite differences of its projection

REACH = 2.0  # bead widths beside a curve within which the surface counts
_SWING = 0.9  # × the corner tolerance: how far a rounded curve leaves a straight line between corners
RESERVE = 1.02  # factor on the stretch, which varies within a tolerance
_EDGES = 1e-3  # m between points on faces' edges
_EDGE_ROUNDS = 5  # rounds of cutting paths where edges keep surfaces from being smooth
_FROM_EDGES, _LEAST_FROM_EDGES = 2.0, 1e-3  # bead widths and m from an edge at which paths are cut
_BEFORE_EDGES = 0.8  # × that: how far beside paths the surface is known
_FOLDED = 0.2  # least reserve of a layer against folding: 1 on the body, 0 where it folds
_TURNED, _ABOVE = 0.1, 1e-6  # share of the curves, and m: noise turns over single facets only, and by little


ProjectedSpec = (
    ProjectedDrawingSpec | ProjectedDxfSpec | ProjectedPatternSpec | ProjectedCurvesSpec | ProjectedNurbsSpec
)


@dataclass(frozen=True)
class Substrate:
    """A body and the layers on it, each `height` [m] above the one before: along the normal, or along z.

    layers   of all beads in print order
    solid    how many layers count as printed: beneath the layer being printed, the body has grown everywhere
    facings  normals that the nozzle follows along each bead, if not the layer's own
    """

    body: SubstrateBody
    height: float
    along_z: bool
    layers: tuple[int, ...] = ()
    solid: int = 0
    facings: tuple[Facing, ...] = ()

    def before(self, bead: int) -> Substrate:
        """The surface after the first `bead` beads: the one on which the last one's layer lies."""
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
        """The layer's normals at the tips (n, 3), or those that a bead follows instead, at arc lengths s (n)."""
        return self.facings[bead].at(s) if self.facings else self.normals(tips)

    def project(self, plane: Array, layer: int) -> tuple[Array, Array]:
        """Nozzle tip and normals (n, 3) above plane points (n, 2): layer k lies k + 1 layer heights above the body."""
        points, normals = self.body.at(plane)
        way = np.array([0.0, 0.0, 1.0]) if self.along_z else normals
        return points + (layer + 1) * self.height * way, normals

    def stretch(self, plane: Array, layer: int) -> tuple[Array, Array]:
        """How much a layer stretches short lines at plane points (n, 2), and its reserve against folding.

        Returns the greatest stretch (n), and the reserve (n): 1 on the body itself, 0 or less where the layer folds.
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
        """The same with the nozzle normal to facets along plane curves, given layer by layer."""
        facings = []
        for layer, row in enumerate(curves):
            for curve in row:
                s = arc_length(self.project(curve.points, layer)[0])
                normals = facets.normals[facets.top(curve.points)[1]]
                facings.append(Facing.along(s, normals, blend, curve.closed))
        return replace(self, facings=tuple(facings))

    def lay(self, curves: Sequence[Sequence[PlaneCurve]], width: float, height: float) -> list[Bead]:
        """Beads `width` and `height` [m] along plane curves, given layer by layer, in print order."""
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


def project_curves(problem: Problem, spec: ProjectedSpec) -> Toolpath:
    """Round the corners of plane paths, order them and lay their layers on the part.

    Raises InputError if more of the paths cannot be printed than may be left out, and for a part on which nothing can
    be laid.
    """
    try:
        substrate, clipped, curves = _plane_curves(problem, spec, spec.source.crumbs)
    except TooMuchCut as error:
        needed = None
        if error.clipped.paths:
            with suppress(InputError, TooMuchCut):
                needed = _plane_curves(problem, spec, 1.0)[1].share
        if error.rough is None:
            raise error.clipped.refusal(problem, size_key(spec.source), needed) from None
        cut = "" if needed is None else f"; layers.source.leave_out_share: {share_words(needed)} cuts the curves there"
        raise _too_rough(error.rough, partial(problem.error, _file_of(problem.part)), cut) from None
    bead, body = problem.process.bead, substrate.body
    rows = rows_of_layers(curves, spec.count, problem.process.order)
    if spec.facing is not None and isinstance(body, MeshTop):
        substrate = substrate.facing(rows, spec.facing, body.facets)
    toolpath = _laid(substrate, rows, bead.width, bead.height)
    told = replace(toolpath.told, left_out=clipped.share)
    toolpath = replace(toolpath, notes=(*toolpath.notes, *clipped.notes), told=told)
    if not clipped.cuts:
        return toolpath
    plane = np.vstack([curve.points for curve in curves])
    left_out = clipped.drawn_on(plane, substrate.project(plane, 0)[0][:, 2])
    return replace(toolpath, left_out=left_out)


def _plane_curves(
    problem: Problem,
    spec: ProjectedSpec,
    most: float,
) -> tuple[Substrate, Clipped, list[PlaneCurve]]:
    """The part, the cuts and the rounded curves left; raises TooMuchCut above a share `most` of the length."""
    process, source, part = problem.process, spec.source, problem.part
    if part is None:
        raise problem.error("part", "is missing", f"the body to project onto: {' or '.join(spec.bodies)}")
    width, least = process.bead.width, np.cos(np.radians(STEEPEST))
    paths, told = paths_and_notes(problem, source)
    plane = fallen(problem, spec, exact_body(part), [placed(path, spec) for path in paths])
    clipped = replace(Clipped.of(plane, width), told=told)
    clipped.check(most)
    check_curves(problem, [path.points for path in clipped.paths], spec.count, size_key(source))
    body, clipped = _body(problem, part, clipped, most)
    substrate = Substrate(body, spec.height, spec.offset == "z")
    clipped = clipped.without(_bends(substrate, spec.count), width)
    clipped.check(most)

    curves: list[PlaneCurve] = []
    cuts = list(clipped.cuts)
    for path in clipped.paths:
        start = with_seam(path, process.seam, lambda points: substrate.project(points, 0)[0])
        share = _share(substrate, spec.count, densify(path.points))
        curve = round_corners(start, process.corner_tolerance, share)
        if vanishes(path.points, curve.points, width):
            cuts.append(Cut(path.name, SHORT, path.points))
            continue
        hint = f"choose a smaller tolerance, or a greater {size_key(source)}"
        check_size(problem, path.name, length(path.points), length(curve.points), hint)
        up = body.upward(curve.points)
        reasons = np.where(np.isnan(up), OFF, np.where(up < least, STEEP, FITS))
        for piece in trim_curve(curve, reasons == FITS):
            if piece is curve or length(piece.points) >= SHORTEST * width:
                curves.append(piece)
            else:
                cuts.append(Cut(path.name, SHORT, piece.points))
        cuts += lost_pieces(curve, reasons)
    clipped = replace(clipped, cuts=tuple(cuts), paths=clipped.paths if curves else ())
    clipped.check(most)
    return substrate, clipped, curves


def _laid(substrate: Substrate, rows: Sequence[Sequence[PlaneCurve]], width: float, height: float) -> Toolpath:
    beads = substrate.lay(rows, width, height)
    grown = replace(substrate, layers=tuple(bead.layer for bead in beads))
    body = substrate.body
    if not isinstance(body, MeshTop):
        return Toolpath(tuple(beads), grown, body.shape(), body.faces.notes if isinstance(body, FaceTop) else ())
    notes = (f"part.mesh: {body.words}",) if body.words else ()
    return Toolpath(tuple(beads), grown, body.shape(), notes, body.facets.corners, told=Told(off=body.told_gap))


def size_key(source: SvgSpec | DxfSpec | PatternSpec | CurvesSpec | NurbsSpec) -> str:
    """The field that says how large plane curves are."""
    if isinstance(source, CurvesSpec):
        return "layers.source.curves"
    if isinstance(source, NurbsSpec):
        return "layers.source.nurbs"
    return "layers.source.width_mm" if isinstance(source, (SvgSpec, DxfSpec)) else "layers.source.size_mm"


def paths_of(
    problem: Problem, source: SvgSpec | DxfSpec | PatternSpec | CurvesSpec | NurbsSpec
) -> tuple[PlanePath, ...]:
    """The paths of `paths_and_notes`, without the notes; curves in space as seen from above."""
    paths = paths_and_notes(problem, source)[0]
    return tuple(replace(path, points=np.ascontiguousarray(path.points[:, :2])) for path in paths)


def paths_and_notes(
    problem: Problem, source: SvgSpec | DxfSpec | PatternSpec | CurvesSpec | NurbsSpec
) -> tuple[tuple[PlanePath, ...], tuple[str, ...]]:
    """The paths of a source, (n, 2) or of curves in space (n, 3), and notes on its file.

    Raises InputError for one that gives none.
    """
    process = problem.process
    if isinstance(source, CurvesSpec):
        return nurbs_paths(source.curves, lambda i: partial(problem.error, f"layers.source.curves.{i}")), ()
    if isinstance(source, NurbsSpec):
        where = partial(problem.error, "layers.source.nurbs")
        return nurbs_paths(read_curves(source.nurbs, where), lambda _: where), ()
    if isinstance(source, DxfSpec):
        return read_dxf(source, process.chord_tolerance, partial(problem.error, "layers.source.dxf"))
    if isinstance(source, SvgSpec):
        where = partial(problem.error, "layers.source.svg")
        return read_svg_once(source.svg, source.width, process.chord_tolerance, where)
    try:
        beside = process.bead.width + 2.0 * _SWING * process.corner_tolerance
        return pattern(source, beside, process.chord_tolerance), ()
    except NoPattern as error:
        raise problem.error("layers.source.cell_mm", str(error), "change cell_mm or size_mm") from None


def placed(path: PlanePath, spec: OnPartSpec) -> PlanePath:
    """A path turned about the vertical and moved in x and y to its place above the part."""
    c, s = np.cos(spec.turn), np.sin(spec.turn)
    points = path.points.copy()
    points[:, :2] = path.points[:, :2] @ np.array([[c, s], [-s, c]]) + np.asarray(spec.centre)
    if path.closed:
        points[-1] = points[0]
    return replace(path, points=points)


def _body(problem: Problem, part: PartSpec, clipped: Clipped, most: float) -> tuple[SubstrateBody, Clipped]:
    """The body, and the pieces of the paths that fall onto it where it can be printed on."""
    exact = exact_body(part)
    if exact is not None:
        return exact, _fitting(problem, exact, clipped, most)
    if part.step is not None:
        upper = _upper_faces(problem, part.step)
        there = _fitting(problem, upper, clipped, most)
        return _step_body(problem, part.step, upper, there), there
    complain = partial(problem.error, _file_of(part))
    if part.scan is not None:
        curves = [densify(path.points) for path in clipped.paths]
        points = read_scan(part.scan, complain)
        scanned = scan_surface(part.scan, points, curves, problem.process.bead.width, complain)
        there = _fitting(problem, scanned.facets, clipped, most)
        return scanned.top, replace(there, told=(*there.told, scanned.words))
    if part.mesh is None:
        raise problem.error("part", f"curves cannot be projected onto a {part.body}")
    facets = top_facets(part.mesh, complain)
    below = beneath_turned(facets, np.vstack([densify(path.points) for path in clipped.paths]))
    if below.mean() > _TURNED:
        raise complain(
            f"a body in {part.mesh.file.name} is inside out: under the curves the uppermost facets face downwards",
            "flip its normals in a mesh program: mirroring a body may turn them inwards",
        )
    return _mesh_body(problem, part.mesh.smooth, facets, _fitting(problem, facets, clipped, most), most)


def _file_of(part: PartSpec | None) -> str:
    """The field of a part's file."""
    return "part" if part is None else f"part.{part.body}.file"


def seen_from_above(facets: FacetTree) -> Array:
    """Corners (n, 2) of the facets that face upwards."""
    return np.asarray(facets.corners[facets.normals[:, 2] > 0.0][:, :, :2].reshape(-1, 2))


def beneath_turned(facets: FacetTree, plane: Array) -> Flags:
    """Whether the highest facet that faces upwards at x, y (n, 2) lies beneath one that faces downwards."""
    low, high = plane.min(axis=0), plane.max(axis=0)
    down = facets.corners[facets.normals[:, 2] < 0.0]
    over = (down[:, :, :2].max(axis=1) >= low).all(axis=1) & (down[:, :, :2].min(axis=1) <= high).all(axis=1)
    if not over.any():
        return np.zeros(len(plane), dtype=bool)
    turned = FacetTree.of(np.ascontiguousarray(down[over][:, ::-1]))
    return np.asarray(turned.top(plane)[0] > facets.top(plane)[0] + _ABOVE)


def nothing_falls(problem: Problem, what: str, curves: Array, body: Array | None) -> InputError:
    """The InputError for curves (n, 2) that all miss the body they are to fall onto; body: places (m, 2), if known."""
    field, reason, spec = "layers.centre_mm", f"no curve falls onto the {what}", problem.layers
    if body is None or not isinstance(spec, OnPartSpec):
        return problem.error(field, reason, "set the middle of the curves, x and y in the part frame")
    spans = [np.array([points.min(axis=0), points.max(axis=0)]) * 1e3 for points in (curves, body)]
    here, there = ("x {:.1f} to {:.1f}, y {:.1f} to {:.1f} mm".format(*span.T.ravel()) for span in spans)
    x, y = np.asarray(spec.centre) * 1e3 + spans[1].mean(axis=0) - spans[0].mean(axis=0)
    hint = f"{field}: [{x:.1f}, {y:.1f}] brings their middle to that of the {what}"
    return problem.error(field, f"{reason}: they lie at {here}, the {what} at {there}", hint)


def _fitting(problem: Problem, body: SubstrateBody | FacetTree | UpperFaces, clipped: Clipped, most: float) -> Clipped:
    """The pieces of the paths that fall onto a body where it is not too steep."""
    if not any(np.isfinite(body.upward(densify(path.points))).any() for path in clipped.paths):
        seen = None
        if isinstance(body, FacetTree):
            seen = seen_from_above(body)
        elif isinstance(body, UpperFaces):
            seen = body.samples.points[:, :2]
        raise nothing_falls(problem, "part", np.vstack([path.points for path in clipped.paths]), seen)
    there = clipped.without(off_or_steep(body.upward), problem.process.bead.width)
    there.check(most)
    return there


def _mesh_body(
    problem: Problem, smooth: float | None, facets: FacetTree, clipped: Clipped, most: float
) -> tuple[MeshTop, Clipped]:
    """The mesh with a smooth surface near paths, at most `smooth` [m] off it, and the paths, cut at edges if needed.

    most: greatest share of their length that may be cut
    """
    width = problem.process.bead.width
    beside = max(_FROM_EDGES * width, _LEAST_FROM_EDGES)

    def laid(outline: Sequence[Array], cut: bool) -> MeshTop:
        near = np.vstack(outline)
        reach = reach_beside(facets, near, REACH * width)
        if not cut:
            return MeshTop.near(facets, near, reach, bound=smooth)
        tree = cKDTree(near)  # beyond an edge there is another surface
        return MeshTop.near(
            facets, near, min(reach, _BEFORE_EDGES * beside), lambda grid: _within(tree, grid, beside), smooth
        )

    outline = [densify(path.points) for path in clipped.paths]
    try:
        return laid(outline, False), clipped
    except TooRoughMesh as error:
        refused, last = error, error
    sharp = creases(outline, lambda plane: facets.normals[facets.top(plane)[1]], CREASE)
    for attempt in range(_EDGE_ROUNDS):
        first = attempt == 0 and len(sharp) > 0
        places = sharp if first else np.vstack(outline)[last.gaps > FARTHEST_FROM_FACETS]
        clipped = clipped.without(at_edges(places, beside), width)
        if not clipped.paths:
            break
        if clipped.share > most:
            raise TooMuchCut(clipped, refused)
        outline = [densify(path.points) for path in clipped.paths]
        try:
            return laid(outline, True), clipped
        except TooRoughMesh as error:
            last = error
    raise _too_rough(refused, partial(problem.error, _file_of(problem.part)))


def _within(tree: cKDTree, plane: Array, beside: float) -> Flags:
    return np.asarray(tree.query(plane)[0] <= _BEFORE_EDGES * beside)


def top_facets(spec: MeshSpec, where: Complaint) -> FacetTree:
    """The facets of a mesh, turned to agree with their neighbours; InputError if none faces upwards.

    For `where` see read_facets.
    """
    facets = FacetTree.of(*facing_alike(read_facets(spec, where)))
    if facets.normals[:, 2].max() <= 0.0:
        raise where(
            f"no facet of {spec.file.name} faces upwards",
            hint="turn it with rpy_deg, or flip its facets in a mesh program",
        )
    return facets


def smooth_top(
    facets: FacetTree, curves: Array, reach: float, bound: float | None, where: Complaint, part: Part | None = None
) -> MeshTop:
    """The mesh with a smooth surface near curves (n, 2), else InputError; for the other arguments see MeshTop.near."""
    try:
        return MeshTop.near(facets, curves, reach, part, bound)
    except TooRoughMesh as error:
        raise _too_rough(error, where) from None


def _too_rough(error: TooRoughMesh, where: Complaint, more: str = "") -> Exception:
    return where(
        error.said("the facets"),
        "there is an edge under the curves, or facets are too large: keep off the edge, or export a finer mesh"
        f"{error.words}{more}",
    )


def _upper_faces(problem: Problem, spec: StepSpec) -> UpperFaces:
    """The faces of a STEP or IGES file that look upwards."""
    complain = partial(problem.error, "part.step.file")
    upper = UpperFaces.of(*read_faces(spec, _EDGES, complain))
    if upper is None:
        raise complain(f"no face of {spec.file.name} looks upwards", hint="turn it with part.step.rpy_deg")
    return upper


def _step_body(problem: Problem, spec: StepSpec, upper: UpperFaces, clipped: Clipped) -> SubstrateBody:
    """The upper faces of a STEP file with a smooth surface on them."""
    outline = np.vstack([densify(path.points) for path in clipped.paths])
    try:
        return FaceTop.near(upper, outline, REACH * problem.process.bead.width)
    except NotSmooth as error:
        x, y = error.place * 1e3
        raise problem.error(
            "part.step.file",
            f"the faces are {error.gap * 1e3:.3f} mm off any smooth surface at x {x:.1f}, y {y:.1f} mm",
            "there is an edge or a step under the curves: keep off it",
        ) from None


def _bends(substrate: Substrate, count: int) -> Callable[[Array], Ints]:
    """Why places x, y (n, 2) cannot be printed on: layers fold where the part is bent inwards too tightly."""
    return lambda plane: np.where(substrate.stretch(plane, count - 1)[1] < _FOLDED, FOLDS, FITS)


def _share(substrate: Substrate, count: int, dense: Array) -> Callable[[Array], Array]:
    """Length of a line in the plane over that on the part, the least of all layers, at points (n, 2) of a path."""
    tree = cKDTree(dense)
    values = np.maximum(substrate.stretch(dense, 0)[0], substrate.stretch(dense, count - 1)[0])
    return lambda plane: np.asarray(1.0 / (RESERVE * values[tree.query(plane)[1]]))
