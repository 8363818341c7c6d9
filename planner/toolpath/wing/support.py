"""The support of a wing: level layers from the bed up, and curved ones between them and its lower surface."""

from __future__ import annotations

import numpy as np

from planner.base.arrays import Array, true_runs
from planner.problem import Problem
from planner.problem.layers import AerofoilLayersSpec, SupportSpec
from planner.toolpath.wing.section import AerofoilSection, parallels
from planner.toolpath.wing.strips import CurvedStrip, FlatStrip, Strip

_SAMPLES = 4000  # of the section's underside, where level layers end
_APART = 0.5  # layer heights in x by which level layers stay clear of the ends of curved ones
_ROUNDING = 1e-9  # m


def check_support(problem: Problem, spec: AerofoilLayersSpec, support: SupportSpec, floor: float) -> None:
    """Raise InputError for a support that does not fit under the wing, whose lowest point is at `floor` [m].

    It must reach from the bed to the whole wing, and no farther.
    """
    curved = 0 if spec.source.method == "planar" else support.curved  # level wings have none
    field, least = "layers.support", 1e3 * curved * spec.height
    if floor * 1e3 < least - _ROUNDING:
        raise problem.error(
            f"{field}.curved",
            f"the wing is {floor * 1e3:.2f} mm above the bed, less than its curved layers are high, {least:g}",
            f"fewer layers, or z of layers.source.origin_mm greater by {least - floor * 1e3 + 0.005:.2f}",
        )
    if support.length < spec.source.chord:
        reason = f"{support.length * 1e3:g} mm is less than the chord"
        raise problem.error(f"{field}.length_mm", reason, f"at least {spec.source.chord * 1e3:g}")
    if support.height > spec.source.origin[2]:
        reason = f"{support.height * 1e3:g} mm is above the leading edge: the nozzle would meet the support"
        raise problem.error(f"{field}.height_mm", reason, f"at most {spec.source.origin[2] * 1e3:g}")


def curved_layers(section: AerofoilSection, spec: AerofoilLayersSpec, support: SupportSpec) -> list[list[CurvedStrip]]:
    """The pieces of each curved layer, in print order; the top of the last one is the wing's lower surface."""
    height = spec.height
    layers = []
    for depth in range(support.curved - 1, -1, -1):
        tip, base = -depth * height, -(depth + 1) * height
        ends = parallels(section.lower, section.upper, tip, 0.0, spec.source.tilt)
        layers.append([CurvedStrip(section.lower, tip, base, first, last) for first, last in ends])
    return layers


def level_layers(
    section: AerofoilSection, spec: AerofoilLayersSpec, support: SupportSpec, shortest: float
) -> list[list[FlatStrip]]:
    """The pieces of each level layer, in print order, none shorter than `shortest` [m].

    Under the wing they stay below the curved layers; next to it they reach the support's height.
    """
    height, ends = spec.height, level_ends(spec, support)
    under = _underside(section, spec, support)
    layers = []
    for layer in range(level_count(spec, support)):
        top = (layer + 1) * height
        pieces = [FlatStrip(a, b, top, top - height) for a, b in below(under, top, ends)]
        layers.append([piece for piece in pieces if piece.length >= shortest])
    return [pieces for pieces in layers if pieces]


def level_count(spec: AerofoilLayersSpec, support: SupportSpec) -> int:
    """Number of level layers."""
    return int(support.height / spec.height + _ROUNDING)


def level_ends(spec: AerofoilLayersSpec, support: SupportSpec) -> tuple[float, float]:
    """Least and greatest x of the level layers [m]."""
    middle = spec.source.origin[0] + 0.5 * spec.source.chord
    return middle - 0.5 * support.length, middle + 0.5 * support.length


def below(under: Array, top: float, ends: tuple[float, float]) -> list[tuple[float, float]]:
    """Intervals of x between `ends` with room for a level layer up to `top` below points `under` (n, 2), by x [m]."""
    low, high = ends
    beside = [low, under[0, 0] - _ROUNDING, under[-1, 0] + _ROUNDING, high]
    x = np.unique(np.clip(np.concatenate([beside, under[:, 0]]), low, high))
    room = np.interp(x, under[:, 0], under[:, 1], left=np.inf, right=np.inf) >= top - _ROUNDING
    return [(float(x[a]), float(x[b - 1])) for a, b in true_runs(room)]


def _underside(section: AerofoilSection, spec: AerofoilLayersSpec, support: SupportSpec) -> Array:
    """Points (n, 2), sorted by x, above which there is wing or curved support."""
    depth = support.curved * spec.height
    side = section.lower
    ends = parallels(side, section.upper, -depth, 0.0, spec.source.tilt)
    t = np.linspace(ends[0][0], ends[-1][1], _SAMPLES) if ends else side.grid
    return widened(side.points(t) - depth * side.inward(t), spec, support)


def widened(points: Array, spec: AerofoilLayersSpec, support: SupportSpec) -> Array:
    """Points (n, 2) from nose to tail, sorted by x, extended at both ends by the height allowed for level layers there.

    Level layers stay slightly clear of curved ones, and rise from them no more steeply than these tilt: a nozzle at the
    rim tilts with the curved layers, and would collide with a wall.
    """
    tops = spec.height * np.arange(1, level_count(spec, support) + 1)
    sides = []
    for (x, z), outwards in ((points[0], -1.0), (points[-1], 1.0)):
        rise = np.concatenate([[0.0], tops[tops > z] - z])
        run = _APART * spec.height + rise / np.tan(spec.source.tilt)
        sides.append(np.column_stack([x + outwards * run, z + rise]))
    points = np.vstack([sides[0], points, sides[1]])
    return points[np.argsort(points[:, 0], kind="stable")]


def strips_of(
    section: AerofoilSection, spec: AerofoilLayersSpec, support: SupportSpec, shortest: float
) -> list[list[Strip]]:
    """The pieces of all layers of the support, in print order."""
    level: list[list[Strip]] = [list(pieces) for pieces in level_layers(section, spec, support, shortest)]
    curved: list[list[Strip]] = [
        [piece for piece in pieces if piece.length >= shortest] for pieces in curved_layers(section, spec, support)
    ]
    return level + [pieces for pieces in curved if pieces]
