"""A wing in layers parallel to its lower and its upper surface (Arigela et al.): from the problem to its beads.

The lower half is printed from its surface up to where both sides are equally near, which is the chord line of a
symmetric section; the upper half from there to its surface. A layer's tip curve is the section's own spline, offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.problem import Problem
from planner.problem.wing import AerofoilLayersSpec, SupportSpec
from planner.readonly import Array
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.wing.lofted import lofted_wing
from planner.toolpath.wing.placing import (
    CLEAR_LOWER,
    CLEAR_UPPER,
    SHORTEST,
    check_floor,
    check_span,
    root_section,
    too_small,
)
from planner.toolpath.wing.section import Section, parallels
from planner.toolpath.wing.strips import CurvedStrip, FlatStrip, LayeredSolid, Strip
from planner.toolpath.wing.support import check_support, strips_of
from planner.toolpath.wing.zigzag import Filling, fill


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


def _layers(section: Section, spec: AerofoilLayersSpec, shortest: float) -> list[tuple[list[CurvedStrip], int]]:
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


def _mould(section: Section, spec: AerofoilLayersSpec, floor: float) -> list[CurvedStrip]:
    """What the first layer lies on where no support is printed: a shell down to the bed under the lower surface."""
    ends = parallels(section.lower, section.upper, 0.0, 0.0, spec.source.tilt)
    return [CurvedStrip(section.lower, 0.0, -floor, first, last) for first, last in ends]
