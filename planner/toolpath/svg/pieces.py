"""Lines, cubics and arcs: what every SVG command and shape comes down to, and how they become chords."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from planner.readonly import Array
from planner.toolpath.svg.document import MAX_POINTS


@dataclass(frozen=True)
class Piece:
    """A part of an outline, in user units; an affine map of its points maps the piece.

    lines: points (k, 2), vertices | cubic: points (4, 2), Bézier controls
    arc:   points (5, 2), start, end, centre c, c + u, c + v: the curve c + u cos θ + v sin θ, from θ = first over sweep
    """

    kind: Literal["lines", "cubic", "arc"]
    points: Array
    first: float = 0.0
    sweep: float = 0.0

    @property
    def ends(self) -> Array:
        """First and last point (2, 2)."""
        return self.points[:2] if self.kind == "arc" else self.points[[0, -1]]

    def at(self, t: Array) -> Array:
        """Points (n, 2) of a curve at parameters t (n,) in 0 … 1."""
        t = t[:, None]
        if self.kind == "cubic":
            a, b, c, d = self.points
            s = 1 - t
            return s * s * s * a + 3 * s * s * t * b + 3 * s * t * t * c + t * t * t * d
        angle, centre = self.first + self.sweep * t, self.points[2]
        return centre + (self.points[3] - centre) * np.cos(angle) + (self.points[4] - centre) * np.sin(angle)

    def extremes(self) -> Array:
        """Points (m, 2) that have the same bounding box as the piece."""
        if self.kind == "lines":
            return self.points
        if self.kind == "cubic":
            a, b, c = np.diff(self.points, axis=0)
            with np.errstate(all="ignore"):  # no root, or one at infinity: NaN and inf fall out below
                p, q = a - 2 * b + c, 2 * (b - a)  # B'(t) = 3 (p t² + q t + a)
                half = -0.5 * (q + np.where(q < 0, -1, 1) * np.sqrt(q * q - 4 * p * a))
                t = np.concatenate([half / p, a / half])
        else:
            u, v = self.points[3:] - self.points[2]
            angles = np.arctan2(v, u)[:, None] + np.arange(-8, 9) * np.pi
            t = (angles.ravel() - self.first) / (self.sweep or 1.0)
        return np.vstack([self.ends, self.at(t[(t > 0) & (t < 1)])])

    def count(self, tolerance: float) -> int:
        """Number of equal steps in t whose chords stay within the tolerance: error <= max |B''| h² / 8."""
        p = self.points
        if self.kind == "lines":
            return len(p) - 1
        if self.kind == "cubic":
            along = p[3] - p[0]
            t = np.clip((p[1:3] - p[0]) @ along / max(float(along @ along), 1e-300), 0, 1)
            if np.hypot(*(p[0] + t[:, None] * along - p[1:3]).T).max() <= 1e-3 * tolerance:
                return 1  # straight: a curve lies in the hull of its controls
            bend, span = 6 * float(np.hypot(*np.diff(p, n=2, axis=0).T).max()), 1.0
        else:
            bend, span = float(np.linalg.norm(p[3:] - p[2], 2)), abs(self.sweep)
        return max(1, math.ceil(min(span * math.sqrt(bend / (8 * tolerance)), 2.0 * MAX_POINTS)))

    def flat(self, count: int) -> Array:
        """Vertices of the piece: a curve's `count` chords, with its ends exactly."""
        if self.kind == "lines":
            return self.points
        points = self.at(np.linspace(0, 1, count + 1))
        points[[0, -1]] = self.ends
        return points


Subpath = tuple[tuple[Piece, ...], bool]  # and whether it is closed
