"""Beads of a wing in layers parallel to its lower and its upper surface (Arigela et al.), or in level ones.

The lower half is printed from its surface up to where both sides are equally near, which is the chord line of a
symmetric section; the upper half from there to its surface. A wing that is straight along its span is made of strips,
whose tip curves are offsets of the section's spline. A wing with a changing section, or in level layers, is made of
sheets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.arrays import Array
from planner.base.processes import of_each
from planner.problem import Problem
from planner.problem.layers import AerofoilLayersSpec, SupportSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.wing.scanlines import fill_sheet, stretch_of
from planner.toolpath.wing.section import (
    CLEAR_LOWER,
    CLEAR_UPPER,
    SHORTEST,
    AerofoilSection,
    check_floor,
    check_span,
    parallels,
    root_section,
    tip_section,
    too_small,
)
from planner.toolpath.wing.sheet_solid import SheetSolid
from planner.toolpath.wing.sheets import (
    CurvedSheet,
    FlatSheet,
    Loft,
    SpanIntervals,
    WingSheet,
    parallel_area,
    stations_of,
)
from planner.toolpath.wing.strips import CurvedStrip, Filling, FlatStrip, LayeredSolid, Strip, fill_strip
from planner.toolpath.wing.support import below, check_support, level_count, level_ends, strips_of, widened

_GAPE = 1.05  # × the mean distance between passes: greatest one; beyond it, gaps exceed a twentieth of a bead
_OUTLINE = 1500  # points of a side at one station, to which level layers are cut


@dataclass(frozen=True)
class SheetLayer:
    """A sheet to fill: its name, whether passes run across the wing, how it is filled, and its material, if named."""

    name: str
    sheet: WingSheet
    across: bool
    filling: Filling
    material: str = ""


def lofted_wing(problem: Problem, spec: AerofoilLayersSpec) -> Toolpath:
    """Lay the beads of a wing between two sections. Raises InputError for sections that cannot be read or printed."""
    source, process = spec.source, problem.process
    check_span(problem, spec)
    root = root_section(problem, source)
    tip = root if source.tip is None else tip_section(problem, source, source.tip)
    loft = Loft(root, tip, source.origin[1], source.span)
    stations = stations_of(source.origin[1], source.span)
    lowest = [float(section.lower.points(section.lower.grid)[:, 1].min()) for section in (root, tip)]
    floor = min(lowest)
    check_floor(problem, spec, floor)
    solid = Filling.of(process, spec)
    planar = source.method == "planar"
    layers = _planar(loft, spec, stations, solid) if planar else _curved(problem, loft, spec, stations, solid)
    if not any(layers):
        raise too_small(problem)

    ground: list[WingSheet] = []
    if spec.support is None:
        area = parallel_area(loft.lower, loft.upper, 0.0, 0.0, source.tilt, stations)
        ground = [CurvedSheet(loft.lower, 0.0, -floor, area)]
    else:
        check_support(problem, spec, spec.support, floor)
        _check_reach(problem, spec, spec.support, loft)
        level = _level(loft, spec, spec.support, stations)
        loose, material = replace(solid, spacing=1.0 / spec.support.infill), spec.support.material or ""
        if planar:
            level += [None] * (len(layers) - len(level))
            beside = [
                [] if sheet is None else [SheetLayer("support", sheet, k % 2 == 1, loose, material)]
                for k, sheet in enumerate(level)
            ]
            layers = [one + other for one, other in zip(beside, layers, strict=True)]
        else:
            under: list[tuple[WingSheet, Filling]] = [(sheet, loose) for sheet in level if sheet is not None]
            under += [(sheet, solid) for sheet in _curved_support(loft, spec, spec.support, stations)]
            count = len(under)
            layers = [
                [SheetLayer("support", s, (count - k) % 2 == 1, way, material)] for k, (s, way) in enumerate(under)
            ] + layers
    return _laid(problem, spec, [layer for layer in layers if layer], ground)


def _laid(
    problem: Problem, spec: AerofoilLayersSpec, layers: Sequence[Sequence[SheetLayer]], ground: list[WingSheet]
) -> Toolpath:
    """All beads in print order; each sheet begins at the corner nearest to the end of the one before."""
    beads: list[Bead] = []
    laid: list[int] = []
    sheets, levels = list(ground), [-1] * len(ground)
    layer = 0
    for jobs in layers:
        found: list[Bead] = []
        for job in jobs:
            stretch = stretch_of(job.sheet, job.across)
            if stretch.greatest > _GAPE * stretch.mean:
                raise problem.error(
                    "layers.source.tip",
                    f"passes of {job.name} {layer + 1} would be up to {100 * (stretch.greatest / stretch.mean - 1):.0f} % "
                    "farther apart in places than a bead is wide",
                    "a longer span_mm, or a tip more like the root: less washout_deg, more of its chord_mm",
                )
            start = (found or beads)[-1].points[-1] if found or beads else None
            new = fill_sheet(job.sheet, job.across, job.filling, f"{job.name} {layer + 1}", layer, start, stretch)
            laid += [len(sheets)] * len(new)
            if new:
                sheets.append(job.sheet)
                levels.append(layer)
            found += [replace(bead, material=job.material) for bead in new]
        beads += found
        layer += bool(found)
        if layer == spec.count:
            break
    if not beads:
        raise too_small(problem)
    start, span = spec.source.origin[1], spec.source.span
    return Toolpath(tuple(beads), SheetSolid(tuple(sheets), tuple(levels), tuple(laid), (start, start + span), 0))


def _curved(
    problem: Problem, loft: Loft, spec: AerofoilLayersSpec, stations: Array, solid: Filling
) -> list[list[SheetLayer]]:
    """Layers parallel to the lower side, then those parallel to the upper; passes next to a side run across.

    Raises InputError if sides lean so far towards each other that surfaces parallel to them never meet inside.
    """
    height = spec.height
    thickest = max(float(np.ptp(_outline(loft, y, 0)[:, 1]) + np.ptp(_outline(loft, y, 1)[:, 1])) for y in stations)
    halves: list[list[list[SheetLayer]]] = []
    for side, other, rise, clear in (
        (loft.lower, loft.upper, 1, CLEAR_LOWER),
        (loft.upper, loft.lower, 0, CLEAR_UPPER),
    ):
        found: list[list[SheetLayer]] = []
        while True:
            depth = len(found)
            tip, base = (depth + rise) * height, (depth + 1 - rise) * height
            area = parallel_area(side, other, tip, tip + clear * height, spec.source.tilt, stations)
            if area.empty:
                break
            if tip > thickest:
                raise problem.error(
                    "layers.source.tip",
                    "the sides lean so much towards each other that layers parallel to them leave the wing",
                    "a longer span_mm, or a tip more like the root",
                )
            found.append([SheetLayer("layer", CurvedSheet(side, tip, base, area), depth % 2 == 0, solid)])
        halves.append(found)
    return halves[0] + halves[1][::-1]


def _planar(loft: Loft, spec: AerofoilLayersSpec, stations: Array, solid: Filling) -> list[list[SheetLayer]]:
    """Level layers from the bed up, each as wide as the wing halfway up the layer; empty below the wing."""
    outlines = [np.vstack([_outline(loft, y, side) for side in (0, 1)]) for y in stations]
    top = max(float(outline[:, 1].max()) for outline in outlines)
    layers: list[list[SheetLayer]] = []
    for k in range(int(np.ceil(top / spec.height))):
        level = (k + 0.5) * spec.height
        area = SpanIntervals.of(stations, [_cut(outline, level) for outline in outlines])
        sheet = FlatSheet((k + 1) * spec.height, k * spec.height, area)
        layers.append([] if area.empty else [SheetLayer("layer", sheet, k % 2 == 0, solid)])
    return layers


def _outline(loft: Loft, y: float, side: int) -> Array:
    """Points (n, 2) of the section at y [m]: its upper side (0) from tail to nose, or its lower side (1) back."""
    u = np.linspace(0.0, 1.0, _OUTLINE)
    points = (loft.upper, loft.lower)[side].points(u, np.full(len(u), (y - loft.start) / loft.span))
    return points[:, ::2]


def _cut(outline: Array, level: float) -> list[tuple[float, float]]:
    """Intervals of x inside an outline (n, 2), closed by a straight line, at the height z = `level` [m]."""
    ahead = np.roll(outline, -1, axis=0)
    k = np.flatnonzero((outline[:, 1] > level) != (ahead[:, 1] > level))
    share = (level - outline[k, 1]) / (ahead[k, 1] - outline[k, 1])
    x = np.sort(outline[k, 0] + share * (ahead[k, 0] - outline[k, 0]))
    return list(zip(x[::2].tolist(), x[1::2].tolist(), strict=True))


def _curved_support(loft: Loft, spec: AerofoilLayersSpec, support: SupportSpec, stations: Array) -> list[WingSheet]:
    """Curved layers under the wing, in print order; the top of the last one is the wing's lower surface."""
    sheets: list[WingSheet] = []
    for depth in range(support.curved - 1, -1, -1):
        tip, base = -depth * spec.height, -(depth + 1) * spec.height
        area = parallel_area(loft.lower, loft.upper, tip, 0.0, spec.source.tilt, stations)
        if not area.empty:
            sheets.append(CurvedSheet(loft.lower, tip, base, area))
    return sheets


def _level(loft: Loft, spec: AerofoilLayersSpec, support: SupportSpec, stations: Array) -> list[WingSheet | None]:
    """Level layers of a support, from the bed up, below and next to its curved part; None where there is no room."""
    ends = level_ends(spec, support)
    unders = [widened(points, spec, support) for points in _undersides(loft, spec, support, stations)]
    sheets: list[WingSheet | None] = []
    for k in range(level_count(spec, support)):
        top = (k + 1) * spec.height
        area = SpanIntervals.of(stations, [below(under, top, ends) for under in unders])
        sheets.append(None if area.empty else FlatSheet(top, top - spec.height, area))
    return sheets


def _undersides(loft: Loft, spec: AerofoilLayersSpec, support: SupportSpec, stations: Array) -> list[Array]:
    """At each station, points (n, 2) from nose to tail above which there is wing or curved support."""
    if spec.source.method == "planar":
        return [_outline(loft, y, 1) for y in stations]
    depth = support.curved * spec.height
    area = parallel_area(loft.lower, loft.upper, -depth, 0.0, spec.source.tilt, stations)
    found = []
    for y, edges in zip(stations, area.edges, strict=True):
        low, high = (0.0, 1.0) if np.isnan(edges).all() else (np.nanmin(edges), np.nanmax(edges))
        u = np.linspace(low, high, _OUTLINE)
        found.append(loft.lower.parallel(u, np.full(len(u), y), -depth)[0][:, ::2])
    return found


def _check_reach(problem: Problem, spec: AerofoilLayersSpec, support: SupportSpec, loft: Loft) -> None:
    """Raise InputError for a support that is shorter than the wing, or higher than its leading edge."""
    low, high = level_ends(spec, support)
    points = [side.points(side.grid) for section in (loft.root, loft.tip) for side in (section.lower, section.upper)]
    x = np.concatenate([each[:, 0] for each in points])
    short = max(low - float(x.min()), float(x.max()) - high)
    if short > 0.0:
        reason = f"the wing's tip reaches {short * 1e3:.2f} mm beyond the support"
        raise problem.error("layers.support.length_mm", reason, f"at least {(support.length + 2 * short) * 1e3:.2f}")
    nose = min(float(section.lower.points(np.array([section.lower.first]))[0, 1]) for section in (loft.root, loft.tip))
    if support.height > nose:
        reason = f"{support.height * 1e3:g} mm is above the leading edge of the tip: the nozzle would meet the support"
        raise problem.error("layers.support.height_mm", reason, f"at most {np.floor(nose * 1e5) / 100:g}")


@dataclass(frozen=True)
class StripLayer:
    """One layer: its strips, whether passes run along their curves or the span, filling, and material, if named."""

    name: str
    pieces: Sequence[Strip]
    along: bool
    filling: Filling
    material: str = ""


def lay_wing(problem: Problem, spec: AerofoilLayersSpec) -> Toolpath:
    """Lay the beads of a wing. Raises InputError for a section that cannot be read or printed."""
    if spec.source.tip is not None or spec.source.method == "planar":
        return lofted_wing(problem, spec)
    section = root_section(problem, spec.source)
    process, origin = problem.process, spec.source.origin
    span = (origin[1], origin[1] + spec.source.span)
    floor = float(section.lower.points(section.lower.grid)[:, 1].min())
    check_floor(problem, spec, floor)
    check_span(problem, spec)
    shortest = SHORTEST * process.bead.width
    halves = _layers(section, spec, shortest)
    if not halves:
        raise too_small(problem)
    solid = Filling.of(process, spec)
    # passes of the outer layers run along the curve, and so do those of every second layer from each surface inwards
    jobs = [StripLayer("layer", pieces, depth % 2 == 0, solid) for pieces, depth in halves]
    ground: list[Strip] = []
    if spec.support is None:
        ground += _mould(section, spec, floor)
    else:
        check_support(problem, spec, spec.support, floor)
        jobs = _support(section, spec, spec.support, shortest, solid) + jobs
    makers: list[tuple[Callable[[], Bead], str]] = []
    laid: list[int] = []
    strips, levels = ground, [-1] * len(ground)
    start = None
    for layer, job in enumerate(jobs[: spec.count]):
        for number, piece in enumerate(_nearest_first(job.pieces, start), 1):
            name = f"{job.name} {layer + 1}" + (f" piece {number}" if len(job.pieces) > 1 else "")
            new, start = fill_strip(piece, job.along, span, job.filling, name, layer, start)
            makers += [(make, job.material) for make in new]
            laid += [len(strips)] * len(new)
            strips.append(piece)
            levels.append(layer)
    beads = of_each(lambda each: replace(each[0](), material=each[1]), makers)
    return Toolpath(tuple(beads), LayeredSolid(tuple(strips), tuple(levels), tuple(laid), span, 0))


def _nearest_first(pieces: Sequence[Strip], start: Array | None) -> Sequence[Strip]:
    """The pieces of a layer, from the end of the chord nearer to `start` (3)."""
    ends = [float(piece.tips(np.array([0.5 * piece.length]))[0][0, 0]) for piece in pieces]
    order = np.argsort(ends)
    if start is not None and abs(ends[order[-1]] - start[0]) < abs(ends[order[0]] - start[0]):
        order = order[::-1]
    return [pieces[i] for i in order]


def _support(
    section: AerofoilSection, spec: AerofoilLayersSpec, support: SupportSpec, shortest: float, solid: Filling
) -> list[StripLayer]:
    """The layers of a printed support, their passes alternately along and across; the last layer's along its curve."""
    loose = replace(solid, spacing=1.0 / support.infill)
    layers = strips_of(section, spec, support, shortest)
    return [
        StripLayer(
            "support",
            pieces,
            (len(layers) - k) % 2 == 1,
            loose if isinstance(pieces[0], FlatStrip) else solid,
            support.material or "",
        )
        for k, pieces in enumerate(layers)
    ]


def _layers(section: AerofoilSection, spec: AerofoilLayersSpec, shortest: float) -> list[tuple[list[CurvedStrip], int]]:
    """The pieces of each layer in print order, and how many layers lie between it and its surface."""
    height, tilt = spec.height, spec.source.tilt
    lower: list[tuple[list[CurvedStrip], int]] = []
    upper: list[tuple[list[CurvedStrip], int]] = []
    for found, side, other, rise, clear in (
        (lower, section.lower, section.upper, 1, CLEAR_LOWER),
        (upper, section.upper, section.lower, 0, CLEAR_UPPER),
    ):
        while True:
            depth = len(found)
            tip, base = (depth + rise) * height, (depth + 1 - rise) * height
            ends = parallels(side, other, tip, tip + clear * height, tilt)
            pieces = [CurvedStrip(side, tip, base, first, last) for first, last in ends]
            pieces = [piece for piece in pieces if piece.length >= shortest]
            if not pieces:
                break
            found.append((pieces, depth))
    return lower + upper[::-1]


def _mould(section: AerofoilSection, spec: AerofoilLayersSpec, floor: float) -> list[CurvedStrip]:
    """The ground of the first layer if no support is printed: a shell under the lower surface, down to the bed."""
    ends = parallels(section.lower, section.upper, 0.0, 0.0, spec.source.tilt)
    return [CurvedStrip(section.lower, 0.0, -floor, first, last) for first, last in ends]
