"""The spacing of a file's waypoints, passes and layers, in its own unit, and the unit that it suggests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints
from planner.base.geometry import arc_lengths, subdivided
from planner.problem.layers import WaypointsSpec
from planner.toolpath.waypoints.reader import SPLIT

_TOGETHER = 2  # waypoints: no more of them are a crumb, where steps are uneven
_PLACES, _PER_STEP = 4000, 3.0  # along all of the path, and in a usual step, at most: what may be a neighbour
_LOOKED_AT = 400  # waypoints, about, whose neighbours are looked for
_NEIGHBOURS = 192  # of each: what is nearest is mostly its own pass
_OWN_PASS = 4.0  # times the distance of two places, that the way along the path between them is shorter on one pass
_ABOVE, _BESIDE = 0.8, 0.4  # of the distance, along the normal: a pass of another layer, and of the same one
_SEEN = 0.3  # of the waypoints that have such a neighbour at least; else there is no such distance

# What is usual of toolpaths that are printed [mm]: largest side of a part, distance of waypoints, of passes, and of layers.
_USUAL = {"side": (5.0, 1500.0), "step": (0.02, 25.0), "beside": (0.1, 20.0), "above": (0.05, 10.0)}


@dataclass(frozen=True)
class Spacing:
    """Usual distances in the file's unit: of waypoints along the path, of passes beside each other, and of layers; NaN where
    there is none. split: a step longer than this begins a new bead; None: the reader's own rule leaves next to none alone."""

    step: float
    beside: float
    above: float
    split: float | None


def spacing_of(points: Array, normals: Array) -> Spacing:
    """The distances of waypoints (n, 3) with unit normals (n, 3), n at least 1."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moving = steps[steps > 0.0]
    step = float(np.median(moving)) if len(moving) else np.nan
    split = _split(steps)
    longest = SPLIT * step if split is None else split
    printed = np.where(steps <= longest, steps, 0.0)
    spacing = max(float(printed.sum()) / _PLACES, step / _PER_STEP) if len(moving) else 1.0
    beside, above = _neighbours(*_denser(points, normals, np.ceil(printed / spacing)))
    return Spacing(step, beside, above, split)


def _denser(points: Array, normals: Array, parts: Array) -> tuple[Array, Array]:
    """Places along the path, so that nearest ones are not those of waypoints that stand far apart: so many (n - 1) in each
    step, one at least."""
    k, share = subdivided(np.maximum(parts, 1.0).astype(np.int64))
    share = share[:, None]
    dense = [np.vstack([rows[k] + share * (rows[k + 1] - rows[k]), rows[-1:]]) for rows in (points, normals)]
    return dense[0], dense[1]


def _neighbours(points: Array, normals: Array) -> tuple[float, float]:
    """Median distances of the nearest places of other passes beside and above or below."""
    s = arc_lengths(points)
    some = np.unique(np.linspace(0, len(points) - 1, min(len(points), _LOOKED_AT)).round().astype(np.int64))
    away, near = cKDTree(points).query(points[some], k=min(_NEIGHBOURS, len(points)))
    away, near = away.reshape(len(some), -1), near.reshape(len(some), -1)
    other = (np.abs(s[near] - s[some][:, None]) > _OWN_PASS * away) & (away > 0.0)
    along = np.abs(((points[near] - points[some][:, None]) * normals[some][:, None]).sum(axis=2))
    found = []
    for kind in (along < _BESIDE * away, along > _ABOVE * away):
        nearest = np.where(other & kind, away, np.inf).min(axis=1)
        seen = nearest[np.isfinite(nearest)]
        found.append(float(np.median(seen)) if len(seen) >= _SEEN * len(some) else np.nan)
    return found[0], found[1]


def _split(steps: Array) -> float | None:
    """Where steps are so uneven that the reader's rule would leave more waypoints alone than it leaves out: the least step that
    leaves none alone, nor two."""
    if len(steps) < 2:
        return None
    usual = float(np.median(steps))
    crumbs = int((_together(steps, SPLIT * usual) <= _TOGETHER).sum())
    printed = float(steps[steps <= SPLIT * usual].sum())
    if crumbs * usual <= WaypointsSpec.model_fields["crumbs"].default * printed:
        return None
    choices = np.unique(steps)
    low, high = 0, len(choices) - 1  # at the longest nothing is split
    while low < high:
        middle = (low + high) // 2
        if _together(steps, float(choices[middle])).min() > _TOGETHER:
            high = middle
        else:
            low = middle + 1
    return float(choices[high])


def _together(steps: Array, split: float) -> Ints:
    """How many waypoints each part of a path has, if longer steps than this were none of it."""
    return np.diff(np.flatnonzero(np.concatenate([[True], steps > split, [True]])))


def unit_of(side: float, spacing: Spacing) -> str:
    """mm or m: in which of them a largest side and distances are nearer to what is usual; mm where both are."""
    values = {"side": side, "step": spacing.step, "beside": spacing.beside, "above": spacing.above}
    known = {name: value for name, value in values.items() if np.isfinite(value) and value > 0.0}

    def unusual(to_mm: float) -> float:
        """Factors by which what is known is beyond its range, multiplied, as a logarithm."""
        out = 0.0
        for name, value in known.items():
            low, high = _USUAL[name]
            out += max(0.0, float(np.log(low / (to_mm * value))), float(np.log(to_mm * value / high)))
        return out

    return "mm" if unusual(1.0) <= unusual(1e3) else "m"
