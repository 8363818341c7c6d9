"""Moves a slightly displaced cloud onto the planned top of its layer: rigid, robust, by least squares.

Points are matched to the nearest point of the top repeatedly (iterative closest point). The residuals are each point's
height above the top and its distance beside its bead: edges and lines thus show shifts along the layer, which heights
alone do not. Weights fall to 0 with the residual (Tukey). Degrees of freedom that the top does not show are left alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.errors import Complaint
from planner.feedback.height_map import PlannedTop, robust
from planner.register.fitting import Placement, looked_for, rows, split, words

FARTHEST, MOST_TURNED = 10e-3, np.radians(5.0)  # m and rad, beyond which a cloud is not this layer's
_ENOUGH = 20_000  # points: more do not improve the fit
_REACH = (12e-3, 6e-3, 3e-3, 2e-3)  # m within which points are matched, one after another
_BESIDE = 0.75  # × the bead's width, if that is more: edges, which show shifts, are half a width from its middle
_ROUNDS = 12  # iterations for each reach
_STILL = 1e-7  # m: a smaller step is the last one
_TUKEY = 4.685  # robust deviations, from which a residual has no weight
_LEAST = 0.03e-3  # m of robust deviation: no print is more exact
_FEWEST = 100  # points that must be matched
_ON_BEADS = 0.6  # share of matched points that must lie on beads in the end


@dataclass(frozen=True)
class CloudFit(ReadOnlyArrays):
    """The moved cloud: points (n, 3) [m], moved by a shift (3) [m] of its middle and a turn (3) [rad].

    unseen    freedoms that the layer's top does not show, in words: these were left unchanged
    residual  robust deviation of the matched points [m]
    """

    points: Array
    shift: Array
    turn: Array
    unseen: tuple[str, ...]
    residual: float


def fit_cloud(top: PlannedTop, cloud: Array, free: tuple[str, ...], complain: Complaint) -> CloudFit:
    """Move a cloud (n, 3) [m] onto the top of a layer in some freedoms of the part frame, as `FREEDOMS` names them.

    Raises InputError, made by `complain`, if too few points are near the top or on beads, if the top shows none of the
    freedoms, or if it would take more than FARTHEST or MOST_TURNED.
    """
    tree = cKDTree(top.points)
    beside = _BESIDE * float(np.median(top.width))
    around = cloud[np.isfinite(tree.query(cloud, distance_upper_bound=max(_REACH[0], beside))[0])]
    some = around[:: max(1, len(around) // _ENOUGH)]
    unknowns = looked_for(free, np.zeros((3, 0)), False, top.middle)
    placement = Placement(np.eye(4), np.zeros(3))
    still = np.eye(4)[None]
    hidden, spread, on_beads = np.zeros((len(free), 0)), 0.0, 0.0
    for reach in (max(each, beside) for each in _REACH):
        for _ in range(_ROUNDS):
            points = placement.seen(some, np.broadcast_to(still, (len(some), 4, 4)))
            away, near = tree.query(points, distance_upper_bound=reach)
            there = np.flatnonzero(np.isfinite(away))
            if len(there) < _FEWEST:
                raise complain(
                    f"{len(there)} of its points are within {reach * 1e3:g} mm of the layer's top: too few to fit"
                )
            points, near = points[there], near[there]
            residual, way = _off(top, points, near)
            heights, on_beads = residual[: len(points)], float((residual[len(points) :] <= 0.0).mean())
            spread = max(robust(heights), _LEAST)
            off = np.abs(residual - np.repeat([np.median(heights), 0.0], len(points)))
            weight = np.clip(1.0 - (off / (_TUKEY * spread)) ** 2, 0.0, 1.0) ** 2
            J = unknowns.columns(
                rows(np.vstack([points, points]), way, np.eye(4)[None].repeat(len(way), 0), unknowns.centre)
            )
            root = np.sqrt(weight)
            seen, hidden = split(J[weight > 0.0])
            if not seen.shape[1]:
                raise complain("its layer's top shows none of the freedoms to be fitted", hint="--fit without names")
            z = np.linalg.lstsq(root[:, None] * (J @ seen), -root * residual, rcond=None)[0]
            placement = placement.moved(unknowns.step(seen @ z), unknowns.centre)
            if np.linalg.norm(z) < _STILL:
                break
    if on_beads < _ON_BEADS:
        reason = f"is {on_beads:.0%} on the layer's beads, of what is near them: the rest leads a fit astray"
        raise complain(
            reason, hint=f"at least {_ON_BEADS:.0%}: cut away what lies between and around beads, or do without --fit"
        )
    return _judged(placement, cloud, unknowns.centre, tuple(words(unknowns, hidden)), spread, complain)


def _off(top: PlannedTop, points: Array, near: Array) -> tuple[Array, Array]:
    """Residuals (2k) [m] of points (k, 3) at their nearest places: heights, then distances beside the beads; and the
    directions (2k, 3) in which they grow."""
    way, normal = points - top.points[near], top.normals[near]
    height = (way * normal).sum(axis=1)
    across = way - height[:, None] * normal
    aside = np.linalg.norm(across, axis=1)
    beyond = np.maximum(aside - 0.5 * top.width[near], 0.0)
    side = across / np.maximum(aside, 1e-12)[:, None]
    return np.concatenate([height, beyond]), np.vstack([normal, np.where(beyond[:, None] > 0.0, side, 0.0)])


def _judged(
    placement: Placement, cloud: Array, centre: Array, unseen: tuple[str, ...], spread: float, complain: Complaint
) -> CloudFit:
    """The moved cloud. Raises InputError, made by `complain`, if it was moved too far."""
    T = np.linalg.inv(placement.T_plate_part)
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    shift = T[:3, :3] @ centre + T[:3, 3] - centre
    size, angle = float(np.linalg.norm(shift)), float(np.linalg.norm(turn))
    if size > FARTHEST or angle > MOST_TURNED:
        reason = f"is {size * 1e3:.1f} mm and {np.degrees(angle):.1f} degrees from the layer's top"
        hint = f"a fit makes up for {FARTHEST * 1e3:g} mm and {np.degrees(MOST_TURNED):g} degrees at most"
        raise complain(reason, hint=hint)
    return CloudFit(cloud @ T[:3, :3].T + T[:3, 3], shift, turn, unseen, spread)
