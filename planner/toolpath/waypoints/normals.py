"""Smooths noisy normals of waypoints within a bound: joints would follow the noise, with no gain for the print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solveh_banded

from planner.base.arrays import Array
from planner.base.geometry import angles_between, arc_lengths
from planner.toolpath.waypoints.reader import Waypoints

REACH = 3e-3  # m, roughly, to either side over which a normal is averaged; waves of 30 mm or more stay
NOISY = np.radians(0.02)  # noise of half the normals above which joints feel it; exact ones have far less
UNASKED = np.radians(3.0)  # how far noisy normals are turned at most by default
_TIMES_NOISE = 15.0  # × their median deviation: the same bound, if this is less; some deviate by far more
_FEWEST_STEPS, _MOST_STEPS = 0.7, 40.0  # usual steps of the path: bounds on the averaging length
_LEAST_STEP = 1.0 / 400.0  # of the averaging length: closer waypoints count as this far apart
_ROUNDS = 40  # rounds in which normals that were turned too far are held more firmly
_FIRMER = 1.3  # least factor for those
_NONE = 1e-12  # rad, and length of a mean of normals: counts as zero
_LEAST_BOUND = 1e-9  # rad: less is no smoothing
_ORDER = 3  # of the derivative that is minimised
_NOISE_ORDER = 12  # of the differences that reveal noise: for a smooth curve they all but vanish
_SAME_PLACE = 0.5  # usual steps between the ends of a closed path
_ROUND = 6.0  # reaches by which a closed path is continued at both ends


def calm_normals(
    paths: Sequence[Waypoints], asked: float | None, unasked: float = UNASKED
) -> tuple[tuple[Waypoints, ...], str]:
    """Paths with normals smoothed by at most `asked` [rad]; and a note on that, if any were.

    If `asked` is None and normals are noisy, they are smoothed by at most `unasked` [rad], or a multiple of the noise.
    """
    bound, why, instead = asked, "", ""
    if asked is None:
        off = noise_of_normals(paths)
        bound = min(unasked, _TIMES_NOISE * off) if off > NOISY else 0.0
        why = f" since they are noisy (half of them by more than {np.degrees(off):.2g} degrees)"
        instead = "; smooth_normals_deg: 0 takes them as they are"
    if not bound or bound < _LEAST_BOUND:
        return tuple(paths), ""
    smooth = [_smooth_path(path, bound) for path in paths]
    turned = np.degrees(np.concatenate([angles for _, angles in smooth]))
    if not turned.any():
        return tuple(paths), ""
    most, mean = turned.max(), turned.mean()
    told = f"normals smoothed{why}, by {most:.3f} degrees at most and {mean:.3f} on average{instead}"
    return tuple(replace(path, normals=normals) for path, (normals, _) in zip(paths, smooth, strict=True)), told


def noise_of_normals(paths: Sequence[Waypoints]) -> float:
    """Median deviation of the normals from a smooth course [rad]; 0 if paths are too short to tell."""
    off = np.concatenate([jitter(path.normals, arc_lengths(path.points)) for path in paths])
    return float(np.median(off)) if len(off) else 0.0


def jitter(normals: Array, s: Array) -> Array:
    """How far unit normals (n, 3) at arc lengths s (n) [m] deviate from a smooth course (n - 12) [rad].

    These are divided differences of order 12, weighted so that independent noise keeps its size. None for fewer than
    thirteen normals.
    """
    if len(s) <= _NOISE_ORDER:
        return np.zeros(0)
    places = np.stack([s[k : len(s) - _NOISE_ORDER + k] for k in range(_NOISE_ORDER + 1)], axis=1)
    places = places / (places[:, -1:] - places[:, :1])
    weight = 1.0 / (places[:, :, None] - places[:, None, :] + np.eye(_NOISE_ORDER + 1)).prod(axis=2)
    weight = weight / np.linalg.norm(weight, axis=1)[:, None]
    around = np.stack([normals[k : len(s) - _NOISE_ORDER + k] for k in range(_NOISE_ORDER + 1)], axis=1)
    return np.asarray(np.linalg.norm((weight[:, :, None] * around).sum(axis=1), axis=1))


def _smooth_path(path: Waypoints, bound: float) -> tuple[Array, Array]:
    """As `smooth_normals`; a closed path has no ends."""
    s, normals = arc_lengths(path.points), path.normals
    usual = float(np.median(np.diff(s)))
    gap = float(np.linalg.norm(path.points[0] - path.points[-1]))
    m = int(np.searchsorted(s, _ROUND * REACH))
    if gap > _SAME_PLACE * usual or not 0 < m < len(s) - 1:
        return smooth_normals(normals, s, bound)
    before, after = slice(-m - 1, -1), slice(1, m + 1)
    s = np.concatenate([s[before] - s[-1], s, s[-1] + s[after]])
    smooth, turned = smooth_normals(np.vstack([normals[before], normals, normals[after]]), s, bound)
    return smooth[m:-m], turned[m:-m]


def smooth_normals(normals: Array, s: Array, bound: float) -> tuple[Array, Array]:
    """Smooth unit normals (n, 3) at arc lengths s (n) [m]; none is turned by more than `bound` [rad].

    Third derivatives along the path are weighed against the change of the normals: waves shorter than about six times
    REACH vanish. A normal that would turn too far is held back, ever more firmly until it does not. Returns the normals
    and the angles (n) [rad] by which they were turned.
    """
    n = len(normals)
    if n <= _ORDER:
        return normals, np.zeros(n)
    step = np.diff(s)
    usual = float(np.median(step))
    step = np.maximum(step / np.clip(REACH, _FEWEST_STEPS * usual, _MOST_STEPS * usual), _LEAST_STEP)
    bands = _third_derivative_bands(step)
    hold = 0.5 * (np.append(step, step[-1]) + np.insert(step, 0, step[0]))
    smooth, turned = normals, np.zeros(n)
    for _ in range(_ROUNDS):
        system = bands.copy()
        system[0] += hold
        smooth = solveh_banded(system, hold[:, None] * normals, lower=True)
        smooth = smooth / np.maximum(np.linalg.norm(smooth, axis=1), _NONE)[:, None]
        turned = angles_between(smooth, normals)
        far = turned > bound
        if not far.any():
            return smooth, turned
        hold = np.where(far, hold * np.maximum(turned / bound, _FIRMER) ** 2, hold)
    # a few are still slightly beyond the bound: all are turned back towards the file's in proportion
    share = bound / turned.max()
    back, ahead = np.sin((1.0 - share) * turned), np.sin(share * turned)
    still = turned <= _NONE
    smooth = np.where(still[:, None], normals, back[:, None] * normals + ahead[:, None] * smooth)
    smooth = smooth / np.linalg.norm(smooth, axis=1)[:, None]
    return smooth, angles_between(smooth, normals)


def _third_derivative_bands(step: Array) -> Array:
    """Lower bands (4, n) of the matrix for the integral of a curve's squared third derivative, by divided differences.

    step (n - 1): between the curve's points
    """
    n = len(step) + 1
    at = np.concatenate([[0.0], np.cumsum(step)])
    four = np.stack([at[k : k + n - _ORDER] for k in range(_ORDER + 1)], axis=1)
    apart = four[:, :, None] - four[:, None, :] + np.eye(_ORDER + 1)
    factor = math.factorial(_ORDER) / apart.prod(axis=2)
    weight = (four[:, -1] - four[:, 0]) / _ORDER
    bands = np.zeros((_ORDER + 1, n))
    for a in range(_ORDER + 1):
        for b in range(a + 1):
            bands[a - b, b : b + n - _ORDER] += weight * factor[:, a] * factor[:, b]
    return bands
