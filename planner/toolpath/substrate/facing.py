"""Nozzle directions from facets (Pollard et al., section 4.1): normals that jump where a bead passes from one to the next.

No arm can jump. Here the normal turns over a stated length around each edge: what a bead sees of its facets' normals is
averaged with a kernel of that length along the bead, a B-spline of degree 5, so that joints accelerate smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from planner.readonly import Array

_KNOTS = 6
_SHARE = BSpline.basis_element(np.arange(_KNOTS + 1.0)).antiderivative()  # of a jump that is behind, over its length


@dataclass(frozen=True)
class Facing:
    """Unit normals along a bead: `first` (3), and at arc lengths `places` (k) [m] jumps (k, 3), each spread over `blend` [m]."""

    first: Array
    places: Array
    jumps: Array
    blend: float

    @classmethod
    def along(cls, s: Array, normals: Array, blend: float, closed: bool) -> Facing:
        """From the facets' normals (n, 3) at arc lengths s (n) of a bead."""
        if closed:  # a round before and a round after
            s = np.concatenate([s[:-1] - s[-1], s, s[-1] + s[1:]])
            normals = np.vstack([normals[:-1], normals, normals[1:]])
        jumps = np.diff(normals, axis=0)
        at = np.flatnonzero(np.abs(jumps).max(axis=1) > 0.0)
        return cls(normals[0], 0.5 * (s[at] + s[at + 1]), jumps[at], blend)

    def at(self, s: Array) -> Array:
        """Unit normals (n, 3) at arc lengths s (n) [m]."""
        order = np.argsort(s, kind="stable")
        ahead = s[order]
        begun, done = np.searchsorted(ahead, [self.places - 0.5 * self.blend, self.places + 0.5 * self.blend])
        out = np.zeros((len(s) + 1, 3))
        np.add.at(out, done, self.jumps)
        out = self.first + np.cumsum(out, axis=0)[:-1]
        for place, jump, i, j in zip(self.places, self.jumps, begun, done, strict=True):
            behind = _SHARE(_KNOTS * ((ahead[i:j] - place) / self.blend + 0.5))
            out[i:j] += behind[:, None] * jump
        normals = np.empty_like(out)
        normals[order] = out / np.linalg.norm(out, axis=1)[:, None]
        return normals
