"""Curved layers that fill a closed mesh between two surfaces: walls and infill.

The two surfaces are level planes, meshes, or the body's own top; each layer lies on the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
import shapely
import shapely.affinity

from planner.base.arrays import Array
from planner.base.errors import Complaint
from planner.problem import Problem
from planner.problem.layers import GuideSpec, VolumeLayersSpec
from planner.problem.mesh_files import read_facets, with_area
from planner.problem.mesh_repair import Mended, count_of, facing_alike, mend
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Told, Toolpath
from planner.toolpath.ordering import in_order
from planner.toolpath.plane_paths import PlaneCurve, densify, length, make_bead, round_corners, with_seam
from planner.toolpath.substrate.mesh_surface import FacetTree, HeightField
from planner.toolpath.substrate.mesh_top import MeshTop, TooRoughMesh, reach_beside
from planner.toolpath.svg.outlines import PlanePath
from planner.toolpath.task import roll_zeros
from planner.toolpath.volume.sections import Heights, Morph, MorphedLayers, NotClosed, Solid, TooFine, polygons
from planner.toolpath.workload import check_length

_GUIDE_GRID = 120  # places along each side of the rectangle around the body at which its surfaces are sampled
_REACH = 2.0  # bead widths beside the body within which its surfaces count

_FARTHEST = 3.0  # line spacings: if the next line's end is farther away, the zig-zag ends
_BESIDE = 0.1  # bead widths by which the link between two lines may leave the region: the wall bead absorbs it
_FAR_OFF = 0.1  # of the wanted length: a greater error makes the outermost lines move inwards
_SPECK = 0.1  # bead widths: a line shorter than this only touches the region
_TRIES = 3  # line spacings that are tried
_HAIR = 1e-6  # m: the outermost lines lie this far inside; otherwise chance decides whether they are found

_TILT_GRID = 120  # places along each side of the rectangle around the body at which the tilt is checked
_CUT = 1e-3  # m: longest edge of the facets that are bent with the layers; 1.3 um off them at a radius of 100 mm
_SHORTEST = 3.0  # bead widths: a shorter path is left out
_REACHED = 0.75  # bead widths from a wall's centre line: farther places are left out; right-angled corners are not
_SEEN = 0.05  # squared bead widths: smaller places do not count
_OPEN = 0.005  # of the volume: less is not reported
_HELD = 0.95  # of the volume: this much or more counts as requested
_NAMED = 5  # most layer numbers that a note lists
_RESERVE = 1.02  # the stretch varies within a tolerance
_BELOW = 1e-5  # m by which a body may reach below the bed: rounding
_MOST_LAYERS = 2000
_COUNTS = 8  # numbers of layers that are tried
_CLOSED_UNASKED = 0.05  # greatest share of the surface that closing holes may take without being requested
_MOST_CLOSED = 0.4  # of the surface: if closing takes more, it is hardly a body


def stack_of(
    problem: Problem, spec: VolumeLayersSpec, solid: Solid, tree: FacetTree
) -> tuple[Morph, MeshTop | None, tuple[str, ...], float]:
    """The stack of layers between a body's surfaces, the mesh at which it begins, if any, notes on meshes, a gap [m].

    The gap is the reported deviation of smooth surfaces from their facets. tree: of the body's facets

    Raises InputError for surfaces that are not one above the other, or have edges.
    """
    low, high = solid.vertices[:, :2].min(axis=0), solid.vertices[:, :2].max(axis=0)
    axes = [np.linspace(a, b, _GUIDE_GRID) for a, b in zip(low, high, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    plane = plane[tree.top(plane)[1] >= 0]
    if len(plane) == 0:
        reason = f"{spec.source.mesh.name} is narrower, seen from above, than a {_GUIDE_GRID}th of its length: nothing fits in"
        raise problem.error("layers.source.mesh", reason, "is it in another unit?")
    reach = _REACH * problem.process.bead.width
    lowest = GuideSpec.model_construct(z=float(solid.vertices[:, 2].min()), mesh=None)
    lower, base = _heights(problem, spec.lower or lowest, "layers.lower", plane, reach)
    guides: list[tuple[str, MeshTop | None]] = [("layers.lower.mesh", base)]
    if spec.upper is None:
        complain, highest = partial(problem.error, "layers.source.mesh"), float(solid.vertices[:, 2].max())
        level = np.ceil(highest * 1e5 - 1e-3) * 1e-2  # mm, rounded up to hundredths
        instead = (
            f"layers.upper: {{z_mm: {level:g}}} for layers that end level, or the mesh of a smooth surface "
            "above the body's top"
        )
        top = _smooth(tree, plane, reach, spec.source.smooth, spec.source.mesh.name, complain, instead)
        upper = _over(top)
        guides.append(("layers.source.mesh", top))
    else:
        upper, guide = _heights(problem, spec.upper, "layers.upper", plane, reach)
        guides.append(("layers.upper.mesh", guide))
    room = float((upper(plane) - lower(plane)).max())
    if room <= 0.0:
        field = "layers.upper" if spec.upper is not None else "layers.lower"
        reason = f"the upper surface is nowhere above the lower one: {room * 1e3:.3f} mm at most"
        raise problem.error(field, reason, "the upper surface must lie above the lower one, within the body's outline")
    between = partial(Morph.between, lower, upper)
    bounds = (spec.thinnest, room, low - reach, high + reach)
    if spec.transition == "linear":
        morph = between(spec.height, *bounds)
    else:
        morph = _harmonic(problem, spec, lambda height: between(height, *bounds).harmonic(), plane)
    meshes = [(field, top) for field, top in guides if top is not None]
    told = tuple(f"{field}: {top.words}" for field, top in meshes if top.words)
    return morph, base, told, max((top.told_gap for _, top in meshes), default=0.0)


def _harmonic(problem: Problem, spec: VolumeLayersSpec, stack: Callable[[float], Morph], plane: Array) -> Morph:
    """The fewest layers of a harmonic field with none higher than requested; `stack` makes them by even height [m].

    plane (n, 2): places within the body. Raises InputError if some layers would be lower than allowed.
    """
    height = spec.height
    for _ in range(_COUNTS):
        morph = stack(height)
        layers = [morph.layer(level).at(plane)[0][:, 2] for level in range(1, int(morph.count) + 1)]
        least, most = min(each.min() for each in layers), max(each.max() for each in layers)
        if most <= spec.height * _RESERVE:
            break
        height = max(height * spec.height / most, _RESERVE * spec.thinnest)
    if least < spec.thinnest / _RESERVE or most > spec.height * _RESERVE:
        reason = f"layers of the harmonic field would be {least * 1e3:.3f} to {most * 1e3:.3f} mm high"
        lower = f"{np.floor(min(least, 0.9 * spec.thinnest) * 1e5) * 1e-2:g}"
        hint = f"a lower layers.least_height_mm, such as {lower}, or layers.transition: linear"
        raise problem.error("layers.transition", reason, hint)
    return morph


def _heights(
    problem: Problem, guide: GuideSpec, field: str, plane: Array, reach: float
) -> tuple[Heights, MeshTop | None]:
    """The heights of a given surface, which must cover plane (n, 2), and its mesh if it is one."""
    if guide.mesh is None:
        z = guide.z or 0.0
        return (lambda places: np.full(len(places), z)), None
    complain = partial(problem.error, f"{field}.mesh.file")
    facets = FacetTree.of(*facing_alike(read_facets(guide.mesh, complain)))
    found = facets.top(plane)[1] >= 0
    if not found.all():
        x, y = plane[int(np.argmin(found))] * 1e3
        raise complain(
            f"{guide.mesh.file.name} does not reach over the whole body: nothing at x {x:.1f}, y {y:.1f} mm",
            f"a larger surface, or move it by {field}.mesh.origin_mm",
        )
    top = _smooth(facets, plane, reach, guide.mesh.smooth, guide.mesh.file.name, complain, "a surface without them")
    return _over(top), top


def _over(top: MeshTop) -> Heights:
    return lambda places: top.surface.at(places)[0][:, 2]


def _smooth(
    facets: FacetTree, plane: Array, reach: float, bound: float | None, name: str, complain: Complaint, instead: str
) -> MeshTop:
    try:
        return MeshTop.near(facets, plane, reach_beside(facets, plane, reach), bound=bound)
    except TooRoughMesh as error:
        raise complain(
            error.said(f"the facets on top of {name}"),
            f"there is an edge or a wall, or facets are too large: {instead}{error.words}",
        ) from None


def walls(region: shapely.MultiPolygon, width: float, count: int, chord: float, name: str) -> list[PlanePath]:
    """Closed paths of `count` beads along all outlines, side by side from the outside in; chord: of outlines [m]."""
    found: list[PlanePath] = []
    for number in range(count):
        inside = _inset(region, (number + 0.5) * width)
        for polygon in inside.geoms:
            for ring in (polygon.exterior, *polygon.interiors):
                points = np.asarray(ring.simplify(chord).coords)[:, :2]
                found.append(PlanePath(f"{name} wall {len(found) + 1}", points, True))
    return found


def zigzag(
    region: shapely.MultiPolygon, width: float, beside: int, density: float, angle: float, name: str
) -> list[PlanePath]:
    """Lines that fill a share `density` of the region inside `beside` beads along the outlines, joined end to end.

    angle: of the lines against x [rad]. The outermost lines lie half a bead from the outermost walls.
    """
    inside = shapely.affinity.rotate(_inset(region, (beside + 0.5) * width), -angle, (0.0, 0.0), use_radians=True)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    found: list[PlanePath] = []
    for polygon in inside.geoms:
        for chain in _filling(polygon, width, density):
            found.append(PlanePath(f"{name} infill {len(found) + 1}", chain @ turn, False))
    return found


def _inset(region: shapely.MultiPolygon, by: float) -> shapely.MultiPolygon:
    return polygons(region.buffer(-by, join_style="mitre"))


def _filling(polygon: shapely.Polygon, width: float, density: float) -> list[Array]:
    """Zig-zags (k, 2) whose length, turns included, comes closest to that share; they consist of whole lines.

    The outermost lines lie at the polygon's ends or, if that misses the share, as in round ones, half a spacing inside.
    """
    wanted = density * polygon.buffer(0.5 * width, join_style="mitre").area / width
    best: list[Array] = []
    least = np.inf
    for aside in (0.0, 0.5):
        apart = width / density
        for _ in range(_TRIES):
            chains = list(_chains(polygon, width, max(apart, width), aside))
            total = sum(length(chain) for chain in chains)
            if abs(total - wanted) < least:
                best, least = chains, abs(total - wanted)
            apart *= total / wanted
            if apart <= 0.0:
                break
        if least <= _FAR_OFF * wanted:
            break
    return best


def _chains(polygon: shapely.Polygon, width: float, apart: float, aside: float) -> Iterator[Array]:
    """Zig-zags (k, 2) along x through a polygon, their lines about `apart` [m] apart; see _zigzag_rows."""
    rows = _zigzag_rows(polygon, apart, _SPECK * width, aside)
    near = shapely.prepared.prep(polygon.buffer(_BESIDE * width))
    while any(rows):
        first = next(i for i, row in enumerate(rows) if row)
        line = rows[first].pop(0)
        chain = [line]
        for row in rows[first + 1 :]:
            ways = [
                (float(np.hypot(*(end[0] - chain[-1][1]))), k, end)
                for k, piece in enumerate(row)
                for end in (piece, piece[::-1])
            ]
            size, k, following = min(ways, key=lambda way: way[0], default=(np.inf, -1, chain[-1]))
            if size > _FARTHEST * apart or not near.covers(shapely.LineString([chain[-1][1], following[0]])):
                break
            row.pop(k)
            chain.append(following)
        yield np.vstack(chain)


def _zigzag_rows(polygon: shapely.Polygon, apart: float, least: float, aside: float) -> list[list[Array]]:
    """Lines (2, 2) within a polygon, row by row upwards, each from left to right; longer than `least` [m].

    The outermost are `aside` spacings away from its ends.
    """
    left, low, right, high = polygon.bounds
    count = max(round((high - low) / apart - 2.0 * aside), 1 if aside == 0.0 else 0) + 1
    inside = max(_HAIR, aside * (high - low) / (count - 1.0 + 2.0 * aside))
    rows = []
    for y in np.linspace(low + inside, high - inside, count):
        across = shapely.LineString([(left - apart, y), (right + apart, y)]).intersection(polygon)
        pieces = [np.asarray(part.coords) for part in shapely.get_parts(across) if part.length > least]
        rows.append(sorted(pieces, key=lambda piece: float(piece[0, 0])))
    return rows


@dataclass(frozen=True)
class _RoundedPath:
    """A rounded path, and its material if that differs from the layers'."""

    curve: PlaneCurve
    material: str


def fill_mesh(problem: Problem, spec: VolumeLayersSpec) -> Toolpath:
    """Slice a closed mesh into layers that morph from its lower surface into its upper one, and fill each of them.

    Raises InputError for a mesh that is not closed, surfaces that are not one above the other, layers that are too
    steep, and where nothing is long enough to be printed.
    """
    complain = partial(problem.error, "layers.source.mesh")
    name = spec.source.mesh.name
    corners = read_facets(spec.source.file, complain, lines=True)
    mended = _mended(corners, name, spec.source.holes, problem.process.bead.width, complain)
    solid = _solid(spec, mended.corners, name, complain)
    morph, base, told, off = stack_of(problem, spec, solid, FacetTree.of(with_area(mended.corners)))
    longest = max(_CUT, float(np.ptp(solid.vertices[:, :2], axis=0).max()) / 400.0)
    try:
        fine = solid.finer(longest)
    except TooFine as error:
        raise complain(f"{name} takes {error} to be cut finely", "a mesh of fewer facets") from None
    regions = _regions(problem, spec, morph, fine)
    _check_tilt(problem, spec, morph, regions)
    rows, short = _layer_rows(problem, spec, morph, regions)
    if not any(rows):
        reason = (
            f"nothing in {name} is long enough to be printed with a bead {problem.process.bead.width * 1e3:g} mm wide"
        )
        raise problem.error("process.bead.width_mm", reason, "a narrower bead, or a larger part")
    lost = _lost(problem, spec, regions, rows, short)
    lost.check(problem, name, spec.source.crumbs)
    beads = _lay(morph, rows, problem.process.bead.width, problem.process.bead.height / spec.height)
    surface = MorphedLayers(morph, base, tuple(regions), tuple(bead.layer for bead in beads))
    shape, beneath = (None, None) if base is None else (base.shape(), base.facets.corners)
    notes = ((f"{name}: {mended.words}",) if mended.words else ()) + _notes(name, morph, rows, beads, lost) + told
    notes += _in_the_air(spec, name, float(solid.vertices[:, 2].min()))
    notes += _begun_anew(name, regions, problem.process.bead.width)
    figures = Told(lost.share, lost.open, lost.held, off)
    return Toolpath(tuple(beads), surface, shape, notes, beneath, left_out=lost.drawn_in(morph), told=figures)


def _mended(corners: Array, name: str, asked: float | None, width: float, complain: Complaint) -> Mended:
    """Facets (n, 3, 3) of a body with holes closed up to a width `asked` [m] or, if that is None, up to a bead's width.

    Raises InputError for wider holes, for too much closing without a request, and for a one-sided surface.
    """
    widest = width if asked is None else asked
    with suppress(NotClosed):
        Solid.of(corners)
        return Mended(corners)
    mended = mend(corners, widest)
    if mended.twisted is not None:
        x, y, z = mended.twisted * 1e3
        raise complain(
            f"{name} has facets that face opposite ways beside the edge at x {x:.2f}, y {y:.2f}, z {z:.2f} mm, and turning "
            "them does not help: that part of the surface has only one side",
            "mend it in a CAD or mesh program: which side is inside must be known",
        )
    if not mended.open and asked is None and mended.share > _CLOSED_UNASKED:
        raise complain(
            f"{name} is not closed: {mended.share:.1%} of its surface would be closed holes, more than "
            f"{_CLOSED_UNASKED:.0%}",
            _closing(corners, max(hole.width for hole in mended.closed)),
        )
    if not mended.open:
        return mended
    first = mended.open[0]
    x, y, z = first.place * 1e3
    count = count_of(len(mended.open), "hole")
    raise complain(
        f"{name} is not closed: {count} wider than {widest * 1e3:g} mm, "
        f"{'' if len(mended.open) == 1 else 'the widest '}{first.width * 1e3:.2f} mm around x {x:.2f}, y {y:.2f}, z {z:.2f} mm",
        _closing(corners, first.width),
    )


def _closing(corners: Array, width: float) -> str:
    """A hint on how to make a body of facets with holes up to `width` [m]."""
    enough = np.ceil(width * 1e5 + 0.5) * 1e-5
    mended = mend(corners, enough)
    by_hand = "mend it in a CAD or mesh program: what is inside must be known"
    with suppress(NotClosed):
        if mended.share <= _MOST_CLOSED and Solid.of(mended.corners).volume > 0.0:
            return f"layers.source.close_holes_mm: {enough * 1e3:.2f} closes what is open; or {by_hand}"
    if mended.share > _MOST_CLOSED:
        return (
            f"a surface is not a body: print on it as part.mesh, or give it a thickness in a CAD program; or {by_hand}"
        )
    return by_hand


def _solid(spec: VolumeLayersSpec, corners: Array, name: str, complain: Complaint) -> Solid:
    solid = Solid.of(corners)
    if solid.volume <= 0.0:
        raise complain(f"{name} is inside out: its facets face inwards", "flip its normals in a CAD program")
    lowest = float(solid.vertices[:, 2].min())
    if lowest < -_BELOW:
        raise complain(
            f"{name} reaches {-lowest * 1e3:.3f} mm below the bed",
            f"z = 0 is the bed, on which {_on_bed(spec, lowest)} stands it",
        )
    return solid


def _on_bed(spec: VolumeLayersSpec, lowest: float) -> str:
    """The origin that puts the body on the bed, if its lowest place is now at z = `lowest` [m]."""
    x, y, z = spec.source.origin
    return f"layers.source.origin_mm: [{x * 1e3:g}, {y * 1e3:g}, {round((z - lowest) * 1e3, 4):g}]"


def _in_the_air(spec: VolumeLayersSpec, name: str, lowest: float) -> tuple[str, ...]:
    """A note on a body that begins above the bed, if nothing says what it stands on."""
    if spec.lower is not None or lowest <= _BELOW:
        return ()
    return (
        f"{name}: begins {lowest * 1e3:.3f} mm above the bed (z = 0), and layers.lower names nothing beneath it; "
        f"{_on_bed(spec, lowest)} stands it on the bed",
    )


def _regions(problem: Problem, spec: VolumeLayersSpec, morph: Morph, fine: Solid) -> list[shapely.MultiPolygon]:
    """The region of each layer in the plane: the body's section halfway up the layer. None is empty."""
    levels = morph.levels(fine.vertices)
    count = int(np.floor(levels.max() + 0.5))
    if count > _MOST_LAYERS:
        reason = f"the body takes {count} layers"
        raise problem.error("layers.height_mm", reason, f"{_MOST_LAYERS} at most: choose higher layers")
    found = [fine.section(levels, layer + 0.5) for layer in range(count)]
    regions = [region for region in found if not region.is_empty]
    empty = [layer for layer, region in enumerate(found[: len(regions)]) if region.is_empty]
    if empty and not found[0].is_empty:
        raise problem.error(
            "layers.source.mesh",
            f"{spec.source.mesh.name} has nothing in layer {empty[0] + 1}: what is above hangs in the air",
            "move its bodies onto each other in a CAD or mesh program, or print them separately",
        )
    if not regions or empty:
        field = "layers.lower" if spec.lower is not None else "layers.height_mm"
        reason = "no layer lies within the body" if not regions else "the lowest layers lie below the body"
        raise problem.error(field, reason, "a lower surface where the body begins, or thinner layers")
    return regions


def _begun_anew(name: str, regions: Sequence[shapely.MultiPolygon], width: float) -> tuple[str, ...]:
    """A note on parts of layers, wide enough for a bead [m], that lie over no part of the layer beneath."""
    found: list[tuple[int, shapely.Geometry]] = []
    for layer, (below, region) in enumerate(pairwise(regions), 1):
        parts = shapely.get_parts(region)
        alone = parts[~shapely.intersects(below, parts)]
        found += [(layer, part) for part in alone if not _inset(shapely.MultiPolygon([part]), 0.5 * width).is_empty]
    if not found:
        return ()
    layer, first = found[0]
    x, y = shapely.get_coordinates(shapely.point_on_surface(first))[0] * 1e3
    what = "1 place" if len(found) == 1 else f"{len(found)} places, the first"
    return (
        f"{name}: nothing is beneath {what} in layer {layer + 1} at x {x:.1f}, y {y:.1f} mm, where the body begins "
        "again: what supports it must be part of the mesh",
    )


def _check_tilt(
    problem: Problem, spec: VolumeLayersSpec, morph: Morph, regions: Sequence[shapely.MultiPolygon]
) -> None:
    """Raise InputError where a layer is steeper than allowed."""
    low, high = morph.lower.span
    axes = [np.linspace(a, b, _TILT_GRID) for a, b in zip(low, high, strict=True)]
    plane = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    for layer, region in enumerate(regions):
        there = plane[shapely.contains_xy(region, plane[:, 0], plane[:, 1])]
        if len(there) == 0:
            continue
        tilt = np.arccos(np.clip(morph.field(layer + 1).at(there)[1][:, 2], -1.0, 1.0))
        worst = int(np.argmax(tilt))
        if tilt[worst] > spec.tilt:
            x, y = there[worst] * 1e3
            raise problem.error(
                "layers.tilt_deg",
                f"layer {layer + 1} tilts by {np.degrees(tilt[worst]):.1f} degrees at x {x:.1f}, y {y:.1f} mm, "
                f"more than {np.degrees(spec.tilt):g}",
                "a greater tilt_deg, or flatter surfaces in layers.lower and layers.upper",
            )


def _foreseen(spec: VolumeLayersSpec, regions: Sequence[shapely.MultiPolygon], width: float) -> float:
    """Approximate length of walls and infill [m]."""
    walls_of = sum(min(spec.perimeters * region.length, region.area / width) for region in regions)
    return float(walls_of + spec.infill.density * sum(region.area / width for region in regions))


def _layer_rows(
    problem: Problem, spec: VolumeLayersSpec, morph: Morph, regions: Sequence[shapely.MultiPolygon]
) -> tuple[list[list[_RoundedPath]], list[list[PlanePath]]]:
    """The rounded paths of each layer in print order, none where it is too narrow, and those that are too short."""
    process = problem.process
    width, shortest = process.bead.width, _SHORTEST * process.bead.width
    check_length(problem, _foreseen(spec, regions, width), len(regions))
    lines_of = spec.infill.material or ""
    apart = lines_of not in ("", spec.material or next(iter(process.materials), ""))
    rows: list[list[_RoundedPath]] = []
    short: list[list[PlanePath]] = []
    before: list[_RoundedPath] = []
    for layer, region in enumerate(regions):
        surface = morph.field(layer + 1)
        name = f"layer {layer + 1}"
        angle = spec.infill.angle + (0.5 * np.pi if layer % 2 else 0.0)
        outlines = walls(region, width, spec.perimeters, process.chord_tolerance, name)
        lines = zigzag(region, width, spec.perimeters, spec.infill.density, angle, name)
        own = {path.name: lines_of for path in lines}
        groups = [outlines, lines]
        if process.order:
            groups = [[*outlines, *lines]]
        elif apart and layer % 2:  # so that the material changes once per layer
            groups.reverse()
        row: list[_RoundedPath] = []
        short.append([])
        for paths in groups:
            short[-1] += [path for path in paths if length(path.points) < shortest]
            long = [path for path in paths if length(path.points) >= shortest]
            curves = [_rounded(path, surface, process) for path in long]
            start = before[-1].curve.points[-1] if before else None
            row += [_RoundedPath(curve, own.get(curve.name, "")) for curve in in_order(curves, process.order, start)]
            before = row or before
        rows.append(row)
    return rows, short


def _rounded(path: PlanePath, surface: HeightField, process: ProcessSpec) -> PlaneCurve:
    """The path with its corners rounded within the tolerance on the layer's surface."""
    stretch = _RESERVE / float(surface.at(densify(path.points))[1][:, 2].min())
    start = with_seam(path, process.seam, lambda points: surface.at(points)[0])
    return round_corners(start, process.corner_tolerance, lambda points: np.full(len(points), 1.0 / stretch))


def _lay(morph: Morph, rows: Sequence[Sequence[_RoundedPath]], width: float, share: float) -> list[Bead]:
    """Beads `share` times as high as their layers, layer by layer.

    On a slope, lines that are `width` [m] apart in the plane are farther apart: beads are wider by as much.
    """
    fields = [morph.field(layer + 1) for layer in range(len(rows))]
    placed = [(layer, line, *fields[layer].at(line.curve.points)) for layer, row in enumerate(rows) for line in row]
    zeros = roll_zeros([normals for _, _, _, normals in placed])
    beads = []
    for (layer, line, points, normals), zero in zip(placed, zeros, strict=True):
        curve = line.curve
        along = np.gradient(points, axis=0)
        longer = np.linalg.norm(along, axis=1) / np.linalg.norm(along[:, :2], axis=1)
        thickness = morph.layer(layer + 1).at(curve.points)[0][:, 2]
        source, wide = fields[layer].at(densify(curve.source))[0], width / (normals[:, 2] * longer)
        high = share * thickness * normals[:, 2]
        placed_as = (points, normals, zero, source, wide, high)
        beads.append(make_bead(curve.name, layer, *placed_as, curve.closed, line.material))
    return beads


@dataclass(frozen=True)
class _Lost:
    """The unprinted parts of a body: numbers of whole layers, paths that are too short, by layer, and narrow places.

    share   of the body's volume
    open    share left open between walls that are too close together for a line of infill
    held    share that beads hold of the volume that walls and infill call for
    places  outlines (n, 2), by layer (index), of places too narrow for a bead
    """

    layers: tuple[int, ...]
    short: tuple[tuple[int, PlanePath], ...]
    places: tuple[tuple[int, Array], ...]
    share: float
    open: float
    held: float

    def check(self, problem: Problem, name: str, most: float) -> None:
        """Raise InputError where a share above `most` is lost."""
        if self.share <= most:
            return
        lost = self.places[0] if self.places else (self.short[0][0], self.short[0][1].points)
        x, y = lost[1].mean(axis=0) * 1e3
        width = problem.process.bead.width * 1e3
        needed = np.ceil(self.share * 1e3 + 0.5) * 1e-3
        raise problem.error(
            "process.bead.width_mm",
            f"{self.share:.1%} of {name} is too narrow for a bead {width:g} mm wide, first in layer {lost[0] + 1} at "
            f"x {x:.1f}, y {y:.1f} mm",
            f"a narrower bead, or a larger part; layers.source.leave_out_share: {min(needed, 1.0):.3g} leaves that out",
        )

    def drawn_in(self, morph: Morph) -> tuple[Array, ...]:
        """The same as lines (n, 3) to be drawn."""
        lines = [(layer, path.points) for layer, path in self.short] + list(self.places)
        return tuple(morph.field(layer + 1).at(points)[0] for layer, points in lines)

    @property
    def words(self) -> str:
        """What is left out, as text; empty if nothing is."""
        parts = []
        if self.layers:
            numbers = ", ".join(str(layer + 1) for layer in self.layers[:_NAMED])
            more = ", ..." if len(self.layers) > _NAMED else ""
            parts.append(f"{count_of(len(self.layers), 'layer')} too narrow for a bead (number {numbers}{more})")
        if self.short:
            total = sum(length(path.points) for _, path in self.short) * 1e3
            parts.append(f"{count_of(len(self.short), 'path')} shorter than 3 bead widths, {total:.1f} mm in all")
        if self.places:
            parts.append(f"{count_of(len(self.places), 'place')} narrower than a bead")
        return f"left out {self.share:.2%} of the volume: {'; '.join(parts)}" if parts else ""


def _lost(
    problem: Problem,
    spec: VolumeLayersSpec,
    regions: Sequence[shapely.MultiPolygon],
    rows: Sequence[Sequence[_RoundedPath]],
    short: Sequence[Sequence[PlanePath]],
) -> _Lost:
    """The parts of the layers' regions that are not printed."""
    width = problem.process.bead.width
    whole = sum(region.area for region in regions)
    lost, between, wanted, laid, places = 0.0, 0.0, 0.0, 0.0, []
    for layer, (region, row) in enumerate(zip(regions, rows, strict=True)):
        narrow = region
        within = _inset(region, spec.perimeters * width)
        wanted += region.area - (1.0 - spec.infill.density) * within.area
        laid += sum(length(line.curve.points) for line in row) * width
        if row:  # what a bead's width leaves out at walls and in corners; corners are rounded anyway
            reached = _inset(region, 0.5 * width).buffer(_REACHED * width)
            narrow = polygons(region.difference(reached))
            filled = _inset(region, (spec.perimeters + 0.5) * width).buffer(_REACHED * width)
            between += polygons(within.difference(filled)).area
            lost += sum(shapely.Polygon(path.points).buffer(0.5 * width).area for path in short[layer] if path.closed)
            lines = sum(length(path.points) for path in short[layer] if not path.closed)
            lost += min(
                lines * width / spec.infill.density, within.area
            )  # each with its share of the open space next to it
        narrow = shapely.MultiPolygon([part for part in narrow.geoms if not row or part.area > _SEEN * width**2])
        lost += narrow.area
        places += [(layer, np.asarray(part.exterior.coords)) for part in narrow.geoms]
    left = tuple(layer for layer, row in enumerate(rows) if not row)
    pieces = tuple((layer, path) for layer, paths in enumerate(short) if layer not in left for path in paths)
    return _Lost(left, pieces, tuple(places), lost / whole, between / whole, laid / wanted)


def _notes(
    name: str, morph: Morph, rows: Sequence[Sequence[_RoundedPath]], beads: Sequence[Bead], lost: _Lost
) -> tuple[str, ...]:
    """Notes on the heights of layers, and on what was left out."""
    high = np.concatenate([morph.layer(bead.layer + 1).at(bead.points[:, :2])[0][:, 2] for bead in beads]) * 1e3
    count = sum(1 for row in rows if row)
    notes = [f"{name}: {count} layers, {high.min():.3f} to {high.max():.3f} mm high along z"]
    if lost.words:
        notes.append(f"{name}: {lost.words}")
    if lost.open > _OPEN:
        notes.append(f"{name}: {lost.open:.2%} of the volume stays open, between walls too close together for a line")
    if lost.held < _HELD:
        notes.append(
            f"{name}: beads hold {lost.held:.1%} of the volume that walls and infill ask for, as lines are whole and corners "
            "rounded; narrower beads hold more"
        )
    return tuple(notes)
