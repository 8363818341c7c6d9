"""Corners of a followed path: how far they are cut, and the zone share and arm lag that explain it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares

from planner.base.arrays import Array, Indices
from planner.export.player.path import lagging_both_ways
from planner.feedback.filters import smoothed, window_of
from planner.feedback.identify_path import DEVIATION_SPAN, SHOWN, CommandedPath, FollowedPath, ShownValue

TURN = np.radians(5.0)  # change of direction at a target, from which it is a corner
SIDES = 1e-3  # m: least length of the lines on both sides of a corner
CORNER_TICK = 1e-3  # s: time step of a modelled corner
CORNER_SPAN = 0.15  # s modelled before and after it: several times the lag of any arm
CLEAR_CUT = 6.0  # × the noise: cuts above this show the lag
LEFT = 0.05  # × the cut: deviation from which the line counts as left
LEAST_SAMPLES = 8  # near a corner
MODEL = 0.05  # × the cut: model error, as no controller has just parabolas and a lag
TRUE = 0.1  # relative error of lag, share and ramps: speed changes in corners are not seen, and no ramp is quite even
LEAST_CORNERS = 4


@dataclass(frozen=True)
class CutCorners:
    """Corners with zones of one radius [m]: their count, mean and greatest cut [m], scatter [m], and how far before the
    target the tip leaves its line [m]."""

    zone: float
    count: int
    mean: float
    most: float
    scatter: float
    leaves: float


@dataclass(frozen=True)
class PassedCorner:
    """How a corner was passed: zone, reach of its parabola, cut, and how far before it the line was left [m];
    directions before and after (3 each); times (g) [s] and distances from the corner along the programmed lines (g)
    [m]."""

    zone: float
    reach: float
    cut: float
    leaves: float
    comes: Array
    goes: Array
    time: Array
    way: Array

    def modelled(self, depth: float, lag: float) -> float:
        """How far it is cut [m] by a share of its parabola, smoothed by a lag [s] forwards and backwards in time."""
        s = self.way[:, None]
        lines = np.minimum(s, 0.0) * self.comes + np.maximum(s, 0.0) * self.goes
        u = np.clip(0.5 + 0.5 * s / self.reach, 0.0, 1.0)
        parabola = self.reach * (u**2 * self.goes - (1.0 - u) ** 2 * self.comes)
        places = np.where(np.abs(s) < self.reach, lines + depth * (parabola - lines), lines)
        if lag > CORNER_TICK:
            # commands before and after are weighted by exp(-|dt| / lag)
            places = lagging_both_ways(places, float(np.exp(-CORNER_TICK / lag)), moving=True)
        places = smoothed(places, window_of(DEVIATION_SPAN, CORNER_TICK))  # like recorded paths
        return float(np.linalg.norm(places, axis=1).min())


def passed_corners(path: CommandedPath, followed: FollowedPath) -> list[PassedCorner]:
    """All targets with a zone where the direction changes between two lines."""
    way = path.way
    at = way[path.target]
    out = []
    for i in range(1, len(at) - 1):
        side = 0.5 * min(at[i] - at[i - 1], at[i + 1] - at[i])
        if path.fine[i] or not path.zone[i] > 0.0 or not (path.line[i] and path.line[i + 1]) or side < 0.5 * SIDES:
            continue
        corner = path.tip[path.target[i]]
        reach = min(float(path.zone[i]), side)
        comes, goes = (
            (corner - _at(path.tip, way, at[i] - reach)) / reach,
            (_at(path.tip, way, at[i] + reach) - corner) / reach,
        )
        if np.linalg.norm(goes - comes) < TURN:
            continue
        near = np.flatnonzero(np.abs(followed.way - at[i]) <= side)
        if len(near) < LEAST_SAMPLES:
            continue
        near = np.arange(near[0], near[-1] + 1)
        cut = _nearest(followed.tip[near], corner)
        size = np.linalg.norm(followed.off[near], axis=1)
        left = near[(size > max(4.0 * followed.noise, LEFT * cut)) & (followed.way[near] <= at[i])]
        passed = _passed(followed, near, float(at[i]), min(max(3.0 * cut, reach), 0.9 * side))
        if passed is None:
            continue
        out.append(
            PassedCorner(
                zone=float(path.zone[i]),
                reach=reach,
                cut=cut,
                leaves=float(at[i] - followed.way[left[0]]) if len(left) else float("nan"),
                comes=comes,
                goes=goes,
                time=passed[0],
                way=passed[1],
            )
        )
    return out


def _nearest(tip: Array, place: Array) -> float:
    """Distance of a polyline (k, 3) from a point (3) [m]."""
    first, step = tip[:-1], np.diff(tip, axis=0)
    u = np.clip(((place - first) * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(first + u[:, None] * step - place, axis=1).min())


def _passed(followed: FollowedPath, near: Indices, at: float, width: float) -> tuple[Array, Array] | None:
    """Times (g) [s] and distances past a corner along the programmed lines (g) [m]; None if there are too few samples.

    Near the corner, where a cut path has no counterpart on the lines, a cubic joins both sides.
    """
    t, way, speed = followed.time[near], followed.way[near] - at, followed.speed[near]
    behind = np.flatnonzero(way > width)
    before = np.flatnonzero(way[: behind[0]] < -width) if len(behind) else behind
    if not len(before):
        return None
    a, b = int(before[-1]), int(behind[0])
    middle = CubicHermiteSpline(t[[a, b]], way[[a, b]], speed[[a, b]])
    grid = np.arange(t[a] - CORNER_SPAN, t[b] + CORNER_SPAN, CORNER_TICK)
    out = np.where(
        grid < t[a],
        np.where(grid < t[0], way[0] + speed[0] * (grid - t[0]), np.interp(grid, t[: a + 1], way[: a + 1])),
        np.where(grid > t[-1], way[-1] + speed[-1] * (grid - t[-1]), np.interp(grid, t[b:], way[b:])),
    )
    inside = (grid >= t[a]) & (grid <= t[b])
    out[inside] = middle(grid[inside])
    return grid, out


def _at(tip: Array, way: Array, place: float) -> Array:
    """The tip (3) at an arc length of the path [m]."""
    return np.array([np.interp(place, way, column) for column in tip.T])


def by_zone(corners: Sequence[PassedCorner]) -> tuple[CutCorners, ...]:
    """How far corners are cut, by zone radius."""
    out = []
    for zone in sorted({round(corner.zone, 6) for corner in corners}):
        own = [corner for corner in corners if round(corner.zone, 6) == zone]
        cuts = np.array([corner.cut for corner in own])
        left = np.array([corner.leaves for corner in own])
        leaves = float(np.nanmedian(left)) if np.isfinite(left).any() else float("nan")
        scatter = float(cuts.std(ddof=1)) if len(cuts) > 1 else float("nan")
        out.append(CutCorners(zone, len(own), float(cuts.mean()), float(cuts.max()), scatter, leaves))
    return tuple(out)


def corner_shape(corners: Sequence[PassedCorner], noise: float) -> tuple[ShownValue, ShownValue]:
    """The share of a zone's parabola that is cut, and the time constant of the lag that rounds corners further [s]."""
    none = float("nan")
    if len(corners) < LEAST_CORNERS:
        return (ShownValue(none, none, False, f"{len(corners)} corners, {LEAST_CORNERS} are needed"),) * 2
    cuts = np.array([corner.cut for corner in corners])
    if np.percentile(cuts, 10.0) < CLEAR_CUT * noise:
        # noise makes the nearest sample look nearer than it is
        return (ShownValue(none, none, False, "noise hides how much its corners are cut"),) * 2
    weight = 1.0 / np.hypot(noise, MODEL * cuts)

    def residuals(x: Array) -> Array:
        return (np.array([corner.modelled(float(x[0]), float(x[1]) * 1e-3) for corner in corners]) - cuts) * weight

    found = least_squares(residuals, [0.8, 15.0], bounds=([0.0, 0.0], [2.0, 300.0]), x_scale=[0.1, 2.0], diff_step=1e-3)
    scale = max(1.0, float(found.fun @ found.fun) / (len(cuts) - 2))
    errors = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * scale)
    depth, lag = found.x[0], 1e-3 * found.x[1]
    return _shown(float(depth), float(errors[0])), _shown(float(lag), 1e-3 * float(errors[1]))


def _shown(value: float, error: float) -> ShownValue:
    error = float(np.hypot(error, TRUE * value)) if error > 0.0 else error
    told = bool(0.0 < error < SHOWN * value)  # at a bound of the search there is no error
    return ShownValue(
        value,
        error,
        told,
        "" if told else "its corners do not show it: others with larger zones, or faster ones, would",
    )
