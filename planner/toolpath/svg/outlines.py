"""Reads the outlines of an SVG drawing as plane paths in metres; refuses, by name, elements it cannot print exactly."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem.mesh_repair import count_of
from planner.toolpath.svg.cuts import cut_outlines, extremes
from planner.toolpath.svg.document import MAX_POINTS, read_document
from planner.toolpath.svg.drawing import Drawing, Outline
from planner.toolpath.twins import without_twins

SAME_POINT = 0.01  # of the flatness: closer points are one, or rounding in the file would make false corners
_AT_EDGE = 0.002  # of the page: a place this close to its edge is on it


@dataclass(frozen=True)
class PlanePath:
    """One uninterrupted line of the drawing.

    points (n, 2) metres, x to the right and y up, origin at the drawing's centre; no repeated consecutive points
    closed        the last point is the first one again (both are kept)
    """

    name: str
    points: Array
    closed: bool


def read_svg(
    path: Path, width: float, flatness: float, where: Callable[..., InputError] | None = None
) -> tuple[PlanePath, ...]:
    """Read the outlines of a drawing, scaled so that their bounding box is `width` metres wide, in drawing order.

    Outlines are printed: colours, dashes, opacity, markers and filters are ignored, and the page's edge cuts nothing
    off. Clip paths and masks do: a filled shape is printed as the outline of what they leave of it, a line as what they
    leave. Single points are left out, and so are shapes with neither fill nor stroke, unless all are so. The origin is
    the centre of the bounding box, and y points up. Curves become chords whose error is at most `flatness` metres;
    every vertex of the drawing stays a vertex (except that points closer than 1 % of `flatness` are one); straight
    lines are not divided. Each subpath becomes a path of its own.

    `where(reason, hint=...)` makes the InputError for a fault of the file as a whole, naming the field that refers to
    it. Raises InputError, with line and element, for anything that cannot be read or printed exactly.
    """
    return _read(path, width, flatness, where)[0]


def _read(
    path: Path, width: float, flatness: float, where: Callable[..., InputError] | None
) -> tuple[tuple[PlanePath, ...], list[str]]:
    """The paths of a drawing, and notes on what is left out."""
    complain = partial(InputError, file=path) if where is None else where
    for name, value in (("width", width), ("flatness", flatness)):
        if not (math.isfinite(value) and value > 0):
            raise complain(f"the {name} of the drawing must be positive, not {value:g} m")
    share = (1 - SAME_POINT) * flatness / width
    drawing = Drawing(read_document(path, complain))
    drawn = drawing.outlines()
    seen = [outline for outline in drawn if not outline.invisible] or drawn
    outlines = cut_outlines(seen, share)
    if not outlines:
        raise complain(f"{path.name} draws nothing", hint="no visible path or basic shape is in it")
    corners = extremes(outlines)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if high[0] - low[0] <= 1e-9 * max(1.0, float(np.abs(corners).max())):
        raise complain(f"{path.name} has no width, so it cannot be made {1e3 * width:g} mm wide")
    scale = width / float(high[0] - low[0])
    centre, to_metres, same = (low + high) / 2, np.array([scale, -scale]), SAME_POINT * flatness

    paths, room, names, dots = [], MAX_POINTS, Counter[str](), drawing.dots
    for outline in outlines:
        counts = [piece.count(share * width / scale) for piece in outline.pieces]
        room -= sum(counts) + 1
        if room < 0:
            raise outline.node.error(f"from here on there are more than {MAX_POINTS} points", "use a larger tolerance")
        parts = [piece.flat(count) for piece, count in zip(outline.pieces, counts, strict=True)]
        points = (np.vstack([parts[0][:1], *(part[1:] for part in parts)]) - centre) * to_metres
        closed = outline.closed or bool(np.hypot(*(points[-1] - points[0])) <= same)
        if closed:
            points[-1] = points[0]
        points = distinct(points, same)
        if len(points) < (3 if closed else 2):
            dots += 1
            continue
        points.flags.writeable = False
        names[outline.name] += 1
        copy = f" ({names[outline.name]})" if names[outline.name] > 1 else ""
        paths.append(PlanePath(outline.name + copy, points, closed))
    if not paths:
        raise complain(f"{path.name} draws nothing but points", hint="draw it larger: layers.source.width_mm")
    told = []
    if len(seen) < len(drawn):
        unseen = len({outline.shape for outline in drawn}) - len({outline.shape for outline in seen})
        told.append(f"{count_of(unseen, 'shape')} with neither fill nor stroke, hence invisible, left out")
    off, frames = _about_page(drawing.page, outlines)
    if off:
        told.append(f"{count_of(off, 'shape')} outside of the page, printed and counted in the width like all others")
    if frames:
        told.append(f"{count_of(frames, 'shape')} along the edges of the page, like a background, printed as a frame")
    if dots:
        told.append(f"{count_of(dots, 'single point')} left out")
    return tuple(paths), told


def _about_page(page: Array | None, outlines: Sequence[Outline]) -> tuple[int, int]:
    """How many shapes lie outside the page, and how many run around it from corner to corner."""
    if page is None:
        return 0, 0
    spans: dict[int, list[Array]] = defaultdict(list)
    for outline in outlines:
        spans[outline.shape] += [each.extremes() if each.kind == "arc" else each.points for each in outline.pieces]
    whole = [np.vstack(points) for points in spans.values()]
    off = [bool((each.max(axis=0) < page[0]).any() or (each.min(axis=0) > page[1]).any()) for each in whole]
    near = _AT_EDGE * np.ptp(page, axis=0)
    at_corners = [bool((np.abs(each[:, None] - page).min(axis=1) <= near).all()) for each in whole]
    around = [bool((np.ptp(each, axis=0) > near).all()) and len(each) > 4 for each in whole]
    return sum(off), sum(a and b for a, b in zip(at_corners, around, strict=True))


def read_svg_once(
    path: Path, width: float, flatness: float, where: Callable[..., InputError] | None = None
) -> tuple[tuple[PlanePath, ...], tuple[str, ...]]:
    """As `read_svg`, without paths that lie on another; and notes on what was left out."""
    read, told = _read(path, width, flatness, where)
    paths, twins = without_twins(read, flatness)
    if twins:
        told.append(f"{count_of(twins, 'path')} drawn twice left out")
    return tuple(paths), tuple(f"layers.source.svg: {each}" for each in told)


def distinct(points: Array, same: float) -> Array:
    """Return the points without those within `same` of the one kept before; the first and the last stay."""
    if (np.hypot(*np.diff(points, axis=0).T) > same).all():
        return points
    kept = [0]
    for i, point in enumerate(points.tolist()):  # each decision depends on the one before
        if math.dist(point, points[kept[-1]]) > same:
            kept.append(i)
    while len(kept) > 1 and math.dist(points[kept[-1]], points[-1]) <= same:
        kept.pop()
    if math.dist(points[kept[-1]], points[-1]) > same:
        kept.append(len(points) - 1)
    return points[kept]
