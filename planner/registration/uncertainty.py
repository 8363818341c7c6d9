"""How sure a placement is, and what that means for the height of the nozzle over every bead."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from planner.readonly import Array
from planner.registration.fitting import Fit
from planner.registration.placement import SHIFTS, TURNS, UNKNOWNS, Placement, rows
from planner.registration.unknowns import Unknowns, split
from planner.toolpath.bead import Toolpath

CONFIDENCE = 0.95
_WAYPOINTS = 1_500  # at which the height is looked at


@dataclass(frozen=True)
class Waypoints:
    """Waypoints (n) spread over all beads: points and normals (n, 3) in the part frame, bead (n), s (n) [m]."""

    points: Array
    normals: Array
    bead: NDArray[np.intp]
    s: Array

    def heights(self, unknowns: Unknowns, placement: Placement, plates: Array) -> Array:
        """How the nozzle's height over the part changes with each unknown: (n k, p), for each of k plates (k, 4, 4)."""
        out = []
        for T_world_plate in plates:
            T = np.broadcast_to(T_world_plate @ placement.T_plate_part, (len(self.points), 4, 4))
            out.append(unknowns.columns(rows(self.points, self.normals, T, unknowns.centre)))
        return np.vstack(out)


def waypoints_of(toolpath: Toolpath) -> Waypoints:
    """Waypoints of all beads, evenly thinned."""
    every = max(1, sum(len(bead.s) for bead in toolpath.beads) // _WAYPOINTS)
    beads = toolpath.beads
    picks = [np.unique(np.append(np.arange(0, len(bead.s), every), len(bead.s) - 1)) for bead in beads]
    return Waypoints(
        points=np.vstack([bead.points[k] for bead, k in zip(beads, picks, strict=True)]),
        normals=np.vstack([bead.normals[k] for bead, k in zip(beads, picks, strict=True)]),
        bead=np.repeat(np.arange(len(beads)), [len(k) for k in picks]),
        s=np.concatenate([bead.s[k] for bead, k in zip(beads, picks, strict=True)]),
    )


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors of a placement; NaN where no contact is to spare and the noise of a touch is not known.

    position (3)  of the middle of the print, along the part frame's axes [m];  angle (3) about them [rad]
    shift (3)     of the table in the world [m]
    height (n)    of the nozzle over the part at each waypoint [m];  bound (n) what it keeps at all of them at once with
                  95 % confidence (Scheffé, 1953)
    """

    position: Array
    angle: Array
    shift: Array
    height: Array
    bound: Array

    @property
    def worst(self) -> int:
        """The waypoint at which the height is least sure."""
        return int(np.argmax(self.height))


def uncertainty_of(fit: Fit, waypoints: Waypoints, plates: Array, noise: float | None) -> Uncertainty:
    """What the contacts' residuals, or a known `noise` of a touch [m], say of the placement and the nozzle's height.

    plates (k, 4, 4): what the part stands on at the angles that count; the worst of them is told.
    """
    unknowns, J = fit.touch.unknowns, fit.columns
    seen = split(J)[0]
    sigma = fit.noise if noise is None else noise
    covariance = sigma**2 * seen @ np.linalg.inv(seen.T @ J.T @ J @ seen) @ seen.T
    r = seen.shape[1]
    if noise is not None:
        factor = math.sqrt(float(chi2.ppf(CONFIDENCE, r)))
    elif fit.spare >= 1:
        factor = math.sqrt(r * float(fisher.ppf(CONFIDENCE, r, fit.spare)))
    else:
        factor = math.nan
    H = waypoints.heights(unknowns, fit.placement, plates)
    height = np.sqrt(np.einsum("ij,jk,ik->i", H, covariance, H)).reshape(len(plates), -1).max(axis=0)
    step = (np.eye(UNKNOWNS) * unknowns.scale[:, None]) @ unknowns.basis
    away = waypoints.points.mean(axis=0) - unknowns.centre
    cross = np.array([[0.0, away[2], -away[1]], [-away[2], 0.0, away[0]], [away[1], -away[0], 0.0]])

    def deviation(part: Array) -> Array:
        return np.sqrt(np.einsum("ij,jk,ik->i", part, covariance, part))

    return Uncertainty(
        position=deviation(step[:3] + cross @ step[TURNS]),
        angle=deviation(step[TURNS]),
        shift=deviation(step[SHIFTS]),
        height=height,
        bound=factor * height,
    )
