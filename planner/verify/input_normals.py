"""The nozzle's axis against the normals in a file of waypoints, however they were smoothed before planning.

The file is read again here. At each waypoint that the tip passes, the axis may deviate from the file's normal by as
much as smoothing may turn it plus as much as the nozzle may lean; of several waypoints at one place the first counts.
Where a corner is rounded, the tip passes beside the waypoint with a mean of the normals around it: there the axis may
also deviate by as much as these differ.
"""

from __future__ import annotations

from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Ints, read_only
from planner.base.errors import InputError
from planner.base.files import stamp_of
from planner.base.geometry import angles_between, arc_lengths
from planner.plan import Check
from planner.problem.layers import WaypointLayersSpec, WaypointsSpec
from planner.toolpath.waypoints.normals import UNASKED
from planner.toolpath.waypoints.reader import read_columns
from planner.verify.checks import DIGITS, EVERYWHERE, Findings, Judged, place

ROOM = np.radians(0.05)  # tolerance of the axis on top of what is allowed
_PASSED = 2e-5  # m: a tip that comes this near to a waypoint passes it
_CORNER = np.radians(5.0)  # turn of the path at a waypoint: smaller ones are never rounded
_WIDEST = 25.0  # × the corner tolerance: at most half the length of path that a corner averages; it reaches twice that
_SAMPLES = 4  # nearest samples of the motion tried: where passes cross, the waypoint's own is among them
_TO_SI = {"mm": 1e-3, "m": 1.0}
_OPPOSITE = 180.0  # deg
_NEXT_BEAD = 3.0  # × the median step: a longer one leads to another bead
_AROUND = 3  # waypoints on either side that decide which way a normal points
_SAME, _CREEP = 0.02, 1e-7  # × the median step, and m: a waypoint no farther than this from the last repeats it
_NAME, _METRIC = "axis near the file's normals", "file_normal_max_deg"


def file_normals(judged: Judged) -> Findings:
    """The check that the axis keeps to the file's own normals; none where no file of waypoints is printed, or where
    nothing may turn the nozzle away from its normals."""
    layers, process = judged.problem.layers, judged.problem.process
    if not isinstance(layers, WaypointLayersSpec):
        return Findings()
    smoothed = layers.source.smoothing
    if smoothed is None:
        smoothed = UNASKED if process.cones.tilt == 0.0 else 0.0
    bound = smoothed + process.cones.tilt
    if bound == 0.0:
        return Findings()
    points, normals = _as_the_file_says(layers.source)
    new = _elsewhere(points)
    points, normals = points[new], _not_the_other_way(points[new], normals[new])
    off, away, at = _off_at_waypoints(judged, points, normals)
    passed = away <= process.corner_tolerance + _PASSED  # unlike those of crumbs and of beads that are not printed
    rounded = passed & (away > _PASSED) & (_turns(points) > _CORNER)
    allowed = bound + _unlike_others(points, normals, rounded, process.corner_tolerance)
    beyond = np.where(passed, off - allowed, -np.inf)
    i = int(np.argmax(beyond))
    if not passed.any():  # the beads laid are not the file's: as far off as possible
        none = Check(_NAME, _OPPOSITE, float(np.degrees(bound)), "deg", False, EVERYWHERE, sample=-1)
        return Findings((none,), {_METRIC: _OPPOSITE})
    check = Check(
        _NAME,
        float(np.degrees(off[i])),
        float(np.degrees(allowed[i])),
        "deg",
        bool(beyond[i] <= ROOM + DIGITS),
        place(judged.trajectory, int(at[i])),
        sample=int(at[i]),
    )
    return Findings((check,), {_METRIC: float(np.degrees(off[passed].max()))})


def _as_the_file_says(spec: WaypointsSpec) -> tuple[Array, Array]:
    """Points [m] and outward unit normals (n, 3) of the file, in the part frame. Raises InputError if it is gone."""
    given = spec.waypoints
    if isinstance(given, Path):
        x, n = _read(given, spec.unit, *stamp_of(given))
    else:
        x, n = given.points, given.normals
    x, n = _TO_SI[spec.unit] * x, n / np.linalg.norm(n, axis=1)[:, None]
    if spec.up == "y":
        x, n = (np.stack([a[:, 0], -a[:, 2], a[:, 1]], axis=1) for a in (x, n))
    elif spec.up == "x":
        x, n = (np.roll(a, -1, axis=1) for a in (x, n))
    return x + np.asarray(spec.origin), n if spec.normals == "outward" else -n


@lru_cache(maxsize=2)
def _read(path: Path, unit: str, changed: int, size: int) -> tuple[Array, Array]:
    """The file's columns; `changed` and `size` identify its version."""
    values = read_columns(path, unit, partial(InputError, file=path)).values
    points, normals = (np.stack([values[name] for name in names], axis=1) for names in ("xyz", ("nx", "ny", "nz")))
    return read_only(points), read_only(normals)


def _off_at_waypoints(judged: Judged, points: Array, normals: Array) -> tuple[Array, Array, Ints]:
    """Angle (n) [rad] between the axis and the normals at waypoints (n, 3), the distance (n) [m] at which the tip
    passes them, and the sample (n). Of passes about equally near, the one whose axis fits best."""
    t, motion, tip = judged.trajectory, judged.motion, judged.drawn_tip
    laid = np.flatnonzero(t.deposit)
    if not len(laid):
        none = np.full(len(points), np.inf)
        return none, none, np.zeros(len(points), dtype=np.int64)
    _, near = cKDTree(tip[laid]).query(points, k=min(_SAMPLES, len(laid)))
    best, away, at = np.full(len(points), np.inf), np.full(len(points), np.inf), np.zeros(len(points), dtype=np.int64)
    for k in near.reshape(len(points), -1).T:
        for other in (np.maximum(k - 1, 0), np.minimum(k + 1, len(laid) - 1)):
            i, j = laid[k], laid[other]
            j = np.where(t.bead[i] == t.bead[j], j, i)
            way = tip[j] - tip[i]
            share = ((points - tip[i]) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-30)
            share = np.clip(share, 0.0, 1.0)[:, None]
            distance = np.linalg.norm(tip[i] + share * way - points, axis=1)
            off = angles_between(-(motion.axis[i] + share * (motion.axis[j] - motion.axis[i])), normals)
            nearer = (distance < away - _PASSED) | ((distance < away + _PASSED) & (off < best))
            best, away, at = (
                np.where(nearer, new, old) for new, old in ((off, best), (np.minimum(distance, away), away), (i, at))
            )
    return best, away, at


def _elsewhere(points: Array) -> Ints:
    """Indices of the points (n, 3) that do not repeat the last distinct one before them."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moving = step[step > _CREEP]
    same = max(_SAME * float(np.median(moving)), _CREEP) if len(moving) else _CREEP
    new, before = np.append(True, step > same), 0
    for i in np.flatnonzero(~new).tolist():  # several tiny steps may add up to a real one
        before = i - 1 if new[i - 1] else before
        new[i] = np.linalg.norm(points[i] - points[before]) > same
    return np.flatnonzero(new)


def _not_the_other_way(points: Array, normals: Array) -> Array:
    """Normals (n, 3) at points (n, 3); single ones that oppose most neighbours on their bead are reversed."""
    n = len(normals)
    away, others = np.zeros(n), np.zeros(n)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    bead = np.concatenate([[0], np.cumsum(step > _NEXT_BEAD * np.median(step))]) if n > 1 else np.zeros(n)
    for k in range(1, min(_AROUND, n - 1) + 1):
        same = bead[k:] == bead[:-k]
        against = same & ((normals[k:] * normals[:-k]).sum(axis=1) < 0.0)
        for at in (slice(k, None), slice(None, -k)):
            away[at] += against
            others[at] += same
    return np.where((2.0 * away > others)[:, None], -normals, normals)


def _turns(points: Array) -> Array:
    """Turn (n) [rad] of the path at points (n, 3); 0 at both ends."""
    way = np.diff(points, axis=0)
    return np.concatenate([[0.0], angles_between(way[1:], way[:-1]), [0.0]])[: len(points)]


def _unlike_others(points: Array, normals: Array, rounded: NDArray[np.bool_], tolerance: float) -> Array:
    """Near rounded corners, the greatest angle (n) [rad] of a normal to those averaged with it; elsewhere 0."""
    out = np.zeros(len(points))
    if not rounded.any():
        return out
    s, reach = arc_lengths(points), _WIDEST * tolerance
    near = np.flatnonzero(_distance_to(s[rounded], s) <= 2.0 * reach)
    for way in (-1, 1):
        i, k = near, 0
        while len(i):
            k += way
            i = i[(i + k >= 0) & (i + k < len(s))]
            i = i[np.abs(s[i + k] - s[i]) <= reach]
            out[i] = np.maximum(out[i], angles_between(normals[i + k], normals[i]))
    return out


def _distance_to(places: Array, s: Array) -> Array:
    """Distance (n) of arc lengths s (n) from the nearest of some sorted places."""
    after = np.searchsorted(places, s)
    return np.minimum(
        np.abs(s - places[np.maximum(after - 1, 0)]), np.abs(s - places[np.minimum(after, len(places) - 1)])
    )
