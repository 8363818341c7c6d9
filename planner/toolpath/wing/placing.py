"""Sections of a wing at their places in the part frame, and what every way of laying its layers has in common."""

from __future__ import annotations

from functools import partial

import numpy as np

from planner.problem import Problem
from planner.problem.wing import AerofoilLayersSpec, AerofoilSpec, TipSpec
from planner.toolpath.wing.aerofoil_files import naca_section, read_section
from planner.toolpath.wing.section import Section, TooUneven, section_through

# Layer heights by which the other side is farther away where a layer ends: in the lower half enough to tell the halves
# apart; in the upper half so that no bead is squeezed into less than half its height above the steps of the lower one.
CLEAR_LOWER, CLEAR_UPPER = 0.1, 0.5
SHORTEST = 3.0  # bead widths: a shorter piece of a layer is left out
_PIVOT = 0.25  # of the chord, about which a section is turned


def root_section(problem: Problem, source: AerofoilSpec) -> Section:
    """The section where the span begins. Raises InputError for one that cannot be read or is no smooth curve."""
    return _section(problem, source, "layers.source", source.chord, source.origin[0], source.origin[2])


def tip_section(problem: Problem, source: AerofoilSpec, tip: TipSpec) -> Section:
    """The section where the span ends. Raises InputError as above."""
    named: AerofoilSpec | TipSpec = source if tip.aerofoil is None and tip.naca is None else tip
    field = "layers.source" if named is source else "layers.source.tip"
    x, z = source.origin[0] + tip.sweep, source.origin[2]
    return _section(problem, named, field, tip.chord, x, z, tip.washout)


def _section(
    problem: Problem,
    named: AerofoilSpec | TipSpec,
    section: str,
    chord: float,
    x: float,
    z: float,
    washout: float = 0.0,
) -> Section:
    """The section that `named` names, its leading edge at x, z [m] before it is turned nose down by `washout` [rad]."""
    if named.aerofoil is not None:
        field = f"{section}.aerofoil"
        points = read_section(named.aerofoil, partial(problem.error, field))
    else:
        field = f"{section}.naca"
        points = naca_section(named.naca or "")
    nose = int(np.argmin(np.linalg.norm(points, axis=1)))
    pivot = np.array([_PIVOT, 0.0])
    turn = np.array([[np.cos(washout), -np.sin(washout)], [np.sin(washout), np.cos(washout)]])
    placed = chord * ((points - pivot) @ turn.T + pivot) + np.array([x, z])
    try:
        return section_through(placed, nose)
    except TooUneven as error:
        x, z = points[error.point]
        reason = f"no smooth curve goes through its points: it swings out beside x = {x:.5f}, z = {z:.5f} of the chord"
        raise problem.error(field, reason, "leave out points, or set more where the section bends") from None


def check_floor(problem: Problem, spec: AerofoilLayersSpec, floor: float) -> None:
    """The wing's lowest place, at z = `floor` [m], must not be below the bed. Raises InputError."""
    if floor < 0.0:
        raise problem.error(
            "layers.source.origin_mm",
            f"the lower surface reaches {-floor * 1e3:.2f} mm below the part frame's xy plane, on which the part stands",
            f"its z at least {(spec.source.origin[2] - floor) * 1e3 + 0.005:.2f}",
        )


def check_span(problem: Problem, spec: AerofoilLayersSpec) -> None:
    """A wing must be long enough to be filled. Raises InputError."""
    least = SHORTEST * problem.process.bead.width
    if spec.source.span < least:
        raise problem.error(
            "layers.source.span_mm",
            f"a wing of {spec.source.span * 1e3:g} mm is too short to be filled",
            f"at least three bead widths, {least * 1e3:g}",
        )


def too_small(problem: Problem) -> Exception:
    """The InputError of a wing without a single layer."""
    return problem.error(
        "layers.height_mm", "the section is too small for a single layer", "choose a smaller height, or tilt_deg"
    )
