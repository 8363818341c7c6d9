"""A wing in layers parallel to its lower and its upper surface (Arigela et al.): from the problem to its beads.

The lower half is printed from its surface up to where both sides are equally near, which is the chord line of a
symmetric section; the upper half from there to its surface. A layer's tip curve is the section's own spline, offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planner.problem import Problem
from planner.problem.wing import AerofoilLayersSpec, SupportSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.wing.aerofoil_files import naca_section, read_section
from planner.toolpath.wing.section import Section, TooUneven, parallels, section_through
from planner.toolpath.wing.strips import CurvedStrip, FlatStrip, LayeredSolid, Strip
from planner.toolpath.wing.support import check_support, strips_of
from planner.toolpath.wing.zigzag import Filling, fill

Array = NDArray[np.float64]

# Layer heights by which the other side is farther away where a layer ends: in the lower half enough to tell the halves
# apart; in the upper half so that no bead is squeezed into less than half its height above the steps of the lower one.
_CLEAR_LOWER, _CLEAR_UPPER = 0.1, 0.5
_SHORTEST = 3.0  # bead widths: a shorter piece of a layer is left out


@dataclass(frozen=True)
class Job:
    """One layer: the strips that it fills, along their curves or along the span, and its material, if that has a name."""

    name: str
    pieces: Sequence[Strip]
    along: bool
    filling: Filling
    material: str = ""


def wing(problem: Problem, spec: AerofoilLayersSpec) -> Toolpath:
    """Lay the beads of a wing. Raises InputError for a section that cannot be read or printed."""
    section = _section(problem, spec)
    process, origin = problem.process, spec.source.origin
    span = (origin[1], origin[1] + spec.source.span)
    floor = float(section.lower.points(section.lower.grid)[:, 1].min())
    if floor < 0.0:
        raise problem.error(
            "layers.source.origin_mm",
            f"the lower surface reaches {-floor * 1e3:.2f} mm below the part frame's xy plane, on which the part stands",
            f"its z at least {(origin[2] - floor) * 1e3 + 0.005:.2f}",
        )
    _check_span(problem, spec)
    shortest = _SHORTEST * process.bead.width
    halves = _layers(section, spec, shortest)
    if not halves:
        raise problem.error(
            "layers.height_mm", "the section is too small for a single layer", "choose a smaller height, or tilt_deg"
        )
    solid = Filling(process.bead.width, process.bead.height, process.corner_tolerance, process.run_in)
    # the outer layers run along the curve, and so does every second one from each surface inwards
    jobs = [Job("layer", pieces, depth % 2 == 0, solid) for pieces, depth in halves]
    ground: list[Strip] = []
    if spec.support is None:
        ground += _mould(section, spec, floor)
    else:
        check_support(problem, spec, spec.support, floor)
        jobs = _support(section, spec, spec.support, shortest, solid) + jobs
    beads: list[Bead] = []
    strips, levels = ground, [-1] * len(ground)
    for layer, job in enumerate(jobs[: spec.count]):
        start = beads[-1].points[-1] if beads else None
        for number, piece in enumerate(_nearest_first(job.pieces, start), 1):
            name = f"{job.name} {layer + 1}" + (f" piece {number}" if len(job.pieces) > 1 else "")
            start = beads[-1].points[-1] if beads else None
            bead = fill(piece, job.along, span, job.filling, name, layer, start)
            beads.append(replace(bead, material=job.material))
            strips.append(piece)
            levels.append(layer)
    laid = tuple(range(len(strips) - len(beads), len(strips)))
    return Toolpath(tuple(beads), LayeredSolid(tuple(strips), tuple(levels), laid, span, 0, {}))


def _nearest_first(pieces: Sequence[Strip], start: Array | None) -> Sequence[Strip]:
    """The pieces of a layer from the end of the chord on that is nearer to `start` (3)."""
    ends = [float(piece.tips(np.array([0.5 * piece.length]))[0][0, 0]) for piece in pieces]
    order = np.argsort(ends)
    if start is not None and abs(ends[order[-1]] - start[0]) < abs(ends[order[0]] - start[0]):
        order = order[::-1]
    return [pieces[i] for i in order]


def _support(
    section: Section, spec: AerofoilLayersSpec, support: SupportSpec, shortest: float, solid: Filling
) -> list[Job]:
    """The layers of a printed support: level ones in turn along and across, curved ones along the curve at last."""
    loose = replace(solid, spacing=1.0 / support.infill)
    layers = strips_of(section, spec, support, shortest)
    return [
        Job(
            "support",
            pieces,
            (len(layers) - k) % 2 == 1,
            loose if isinstance(pieces[0], FlatStrip) else solid,
            support.material or "",
        )
        for k, pieces in enumerate(layers)
    ]


def _section(problem: Problem, spec: AerofoilLayersSpec) -> Section:
    """The section at its place in the part frame."""
    source = spec.source
    if source.aerofoil is not None:
        field = "layers.source.aerofoil"
        points = read_section(source.aerofoil, partial(problem.error, field))
    else:
        field = "layers.source.naca"
        points = naca_section(source.naca or "")
    nose = int(np.argmin(np.linalg.norm(points, axis=1)))
    try:
        return section_through(source.chord * points + np.array([source.origin[0], source.origin[2]]), nose)
    except TooUneven as error:
        x, z = points[error.point]
        reason = f"no smooth curve goes through its points: it swings out beside x = {x:.5f}, z = {z:.5f} of the chord"
        raise problem.error(field, reason, "leave out points, or set more where the section bends") from None


def _layers(section: Section, spec: AerofoilLayersSpec, shortest: float) -> list[tuple[list[CurvedStrip], int]]:
    """The pieces of each layer in print order, and how many layers lie between it and its surface."""
    height, tilt = spec.height, spec.source.tilt
    lower: list[tuple[list[CurvedStrip], int]] = []
    upper: list[tuple[list[CurvedStrip], int]] = []
    for found, side, other, rise, clear in (
        (lower, section.lower, section.upper, 1, _CLEAR_LOWER),
        (upper, section.upper, section.lower, 0, _CLEAR_UPPER),
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


def _mould(section: Section, spec: AerofoilLayersSpec, floor: float) -> list[CurvedStrip]:
    """What the first layer lies on where no support is printed: a shell down to the bed under the lower surface."""
    ends = parallels(section.lower, section.upper, 0.0, 0.0, spec.source.tilt)
    return [CurvedStrip(section.lower, 0.0, -floor, first, last) for first, last in ends]


def _check_span(problem: Problem, spec: AerofoilLayersSpec) -> None:
    least = _SHORTEST * problem.process.bead.width
    if spec.source.span < least:
        raise problem.error(
            "layers.source.span_mm",
            f"a wing of {spec.source.span * 1e3:g} mm is too short to be filled",
            f"at least three bead widths, {least * 1e3:g}",
        )
