"""Clips and masks a drawing: of a filled shape, the outline of its visible area is left; of a line, its visible part.

Only shapes that are actually cut become chords; the rest keep their curves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.budgets import SVG_CROSSINGS, SVG_WINDINGS
from planner.toolpath.svg.document import BLACK, MAX_POINTS, OPAQUE, UNPAINTED
from planner.toolpath.svg.drawing import Outline, Region
from planner.toolpath.svg.shapes import OutlinePiece

_LEAST_OF_AREA = 3  # vertices: two points are a line, whatever its fill
_COUNTED = 100  # chords whose crossings with all others are counted
_COARSE = 1e-4  # of the drawing's size: tolerance for finding the size of what is left


def cut_outlines(outlines: Sequence[Outline], share: float) -> list[Outline]:
    """Return the visible parts of the outlines, in order.

    Curves that are cut become chords within `share` of the width of all that is left. Raises InputError for a mask
    that does not simply show or hide.
    """
    if not any(outline.cuts for outline in outlines):
        return list(outlines)
    coarse = _seen(outlines, _COARSE * float(np.ptp(extremes(outlines), axis=0).max()))
    width = float(np.ptp(extremes(coarse)[:, 0])) if coarse else 0.0
    return _seen(outlines, share * width) if width > 0.0 else coarse


def extremes(outlines: Iterable[Outline]) -> Array:
    """Points (m, 2) that have the same bounding box as the outlines."""
    return np.vstack([piece.extremes() for outline in outlines for piece in outline.pieces])


def _seen(outlines: Sequence[Outline], tolerance: float) -> list[Outline]:
    """The visible part of each shape, with chords within the tolerance (user units) where it is cut."""
    out: list[Outline] = []
    areas: dict[int, shapely.Geometry] = {}
    windows: dict[tuple[int, ...], tuple[shapely.Geometry, shapely.Geometry]] = {}
    for _, group in groupby(outlines, key=lambda outline: outline.shape):
        shape = list(group)
        cuts = shape[0].cuts
        key = tuple(id(region) for region in cuts)
        if cuts and key not in windows:
            seen = shapely.intersection_all([_let_through(region, tolerance, areas) for region in cuts])
            windows[key] = seen, shapely.buffer(seen, tolerance)
            shapely.prepare(windows[key][1])
        out += _left(shape, *windows[key], tolerance) if cuts else shape
    return out


def _left(shape: list[Outline], seen: shapely.Geometry, near: shapely.Geometry, tolerance: float) -> list[Outline]:
    """What is left of a shape inside `seen`; `near` is `seen` grown by the tolerance."""
    chords = [_chords(outline, tolerance) for outline in shape]
    area = _area(shape[0], chords, "fill-rule") if _filled(shape[0]) else shapely.Polygon()
    lines = [line for line in chords if shapely.is_empty(area) or len(line) < _LEAST_OF_AREA]
    if shapely.covers(near, area) and shapely.covers(near, _lines(chords)):
        return shape
    parts = [part for part in shapely.get_parts(shapely.intersection(area, seen)) if shapely.get_dimensions(part) == 2]
    # parts thinner than the tolerance come from edges drawn twice, with different chords
    parts = [part for part in parts if not shapely.is_empty(shapely.buffer(part, -tolerance))]
    found = [(shapely.get_coordinates(ring), True) for part in parts for ring in shapely.get_rings(part)]
    rest = shapely.line_merge(shapely.intersection(_lines(lines), seen)) if lines else area
    kept = [line for line in shapely.get_parts(rest) if lines and shapely.length(line) > tolerance]
    found += [(shapely.get_coordinates(line), False) for line in kept]
    return [
        replace(
            shape[0],
            name=f"{shape[0].element}.{k}" if len(found) > 1 else shape[0].element,
            pieces=(OutlinePiece("lines", points),),
            closed=closed,
            cuts=(),
        )
        for k, (points, closed) in enumerate(found, 1)
    ]


def _let_through(region: Region, tolerance: float, known: dict[int, shapely.Geometry]) -> shapely.Geometry:
    """The area in which a region shows everything."""
    if id(region) in known:
        return known[id(region)]
    clip = region.node.tag == "clipPath"
    seen: shapely.Geometry = shapely.Polygon()
    for _, group in groupby(region.outlines, key=lambda outline: outline.shape):
        shape = list(group)
        shows = clip or _shows(region, shape[0])
        if shows is None:
            continue
        chords = [_chords(outline, tolerance) for outline in shape]
        area = _area(shape[0], chords, "clip-rule" if clip else "fill-rule")
        for outer in shape[0].cuts:
            area = shapely.intersection(area, _let_through(outer, tolerance, known))
        seen = shapely.union(seen, area) if shows else shapely.difference(seen, area)
    if region.box is not None:
        seen = shapely.intersection(seen, shapely.polygons(region.box))
    known[id(region)] = seen
    return seen


def _shows(region: Region, outline: Outline) -> bool | None:
    """Whether a shape in a mask shows (True), hides (False) or does neither (None)."""
    paint = {name: value.strip().lower() for name, value in _paint(outline).items()}
    reason, hint = "", "apply the mask in the drawing program"
    if paint.get("stroke", "none") != "none":
        reason = "it has a stroke in a mask, which is not supported"
    elif any(paint.get(name, "1") != "1" for name in ("opacity", "fill-opacity")):
        reason = "it is partly transparent in a mask, which then neither shows nor hides it fully"
    elif not OPAQUE.fullmatch(paint.get("fill", "black")):
        reason = "its fill may be transparent in a mask, which then neither shows nor hides it fully"
    if reason:
        raise outline.node.error(reason, hint)
    if not _filled(outline):
        return None
    return region.alpha or paint.get("fill", "black").replace(" ", "") not in BLACK


def _filled(outline: Outline) -> bool:
    return _paint(outline).get("fill", "black").strip().lower() not in UNPAINTED


def _paint(outline: Outline) -> dict[str, str]:
    """The paint of an outline. Raises InputError if it is not known."""
    if "unread" in outline.paint or any("!" in value for value in outline.paint.values()):
        raise outline.node.error(
            "how it is filled is not known: a style sheet has selectors or an !important that are not supported",
            "a tag, .class or #id as selector",
        )
    return outline.paint


def _area(first: Outline, lines: list[Array], rule: str) -> shapely.Geometry:
    """The area that a shape of these subpaths fills, open ones closed; `rule` names the property with the fill rule."""
    rings = [np.vstack([line, line[:1]]) for line in lines if len(line) >= _LEAST_OF_AREA]
    if not rings:
        return shapely.Polygon()
    hint = "apply the clip path or mask in the drawing program"
    SVG_CROSSINGS.check(_crossings(rings), "where it is cut it has about", first.node.error, hint)
    faces = shapely.get_parts(shapely.polygonize([shapely.union_all(_lines(rings))]))
    looks = len(faces) * sum(len(ring) for ring in rings)
    SVG_WINDINGS.check(looks, "where it is cut it needs", first.node.error, hint)
    windings = _windings(rings, shapely.get_coordinates(shapely.point_on_surface(faces)))
    inside = windings % 2 == 1 if _paint(first).get(rule) == "evenodd" else windings != 0
    return shapely.union_all(faces[inside])


def _crossings(rings: list[Array]) -> float:
    """Estimate, from a sample, of how often the chords of rings cross or at least have overlapping boxes."""
    ends = np.vstack([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])
    low, high = ends.min(axis=1), ends.max(axis=1)
    some = np.linspace(0, len(ends) - 1, min(_COUNTED, len(ends))).astype(int)
    near = [int(((low <= high[k]) & (high >= low[k])).all(axis=1).sum()) for k in some]
    beside = 3  # itself and its two neighbours
    return max(float(np.mean(near)) - beside, 0.0) * len(ends) / 2.0


def _lines(lines: list[Array]) -> shapely.Geometry:
    """All polylines as one geometry; single points are dropped."""
    return shapely.MultiLineString([line for line in lines if len(line) > 1])


def _windings(rings: list[Array], points: Array) -> NDArray[np.int64]:
    """How often the rings together wind around each of the points (n, 2)."""
    found = np.zeros(len(points), dtype=np.int64)
    for ring in rings:
        a, b = ring[:-1], ring[1:]
        for k, (x, y) in enumerate(points):
            up, down = (a[:, 1] <= y) & (b[:, 1] > y), (a[:, 1] > y) & (b[:, 1] <= y)
            side = (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (x - a[:, 0]) * (b[:, 1] - a[:, 1])
            found[k] += int((up & (side > 0)).sum()) - int((down & (side < 0)).sum())
    return found


def _chords(outline: Outline, tolerance: float) -> Array:
    """Vertices (n, 2) of an outline."""
    counts = [piece.count(tolerance) for piece in outline.pieces]
    if sum(counts) > MAX_POINTS:
        raise outline.node.error(f"from here on there are more than {MAX_POINTS} points", "use a larger tolerance")
    parts = [piece.flat(count) for piece, count in zip(outline.pieces, counts, strict=True)]
    return np.vstack([parts[0], *(part[1:] for part in parts[1:])])
