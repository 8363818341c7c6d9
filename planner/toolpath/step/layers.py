"""Layers of beads over faces: each along the faces' normals above the one before, and the body as it grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.readonly import Array, Ints
from planner.toolpath.bead import Bead
from planner.toolpath.laying import arc_length
from planner.toolpath.step.body import FaceBody
from planner.toolpath.step.curves import FaceCurve
from planner.toolpath.transport import roll_zeros

_CLOSED = 1e-6  # m between the ends of a closed curve


@dataclass(frozen=True)
class Track:
    """Where a bead runs: arc lengths s (n) [m] of its samples, and the faces (n), uv (n, 2) of a body beneath them."""

    layer: int
    s: Array
    body: FaceBody
    face: Ints
    uv: Array


@dataclass(frozen=True)
class FaceLayers:
    """The body, and the layers on it, each `height` [m] above the one before along the normals.

    tracks   of all beads in print order
    solid    how many layers count as there; beneath the layer that is printed the body has grown everywhere
    """

    body: FaceBody
    height: float
    tracks: tuple[Track, ...]
    solid: int = 0

    def before(self, bead: int) -> FaceLayers:
        """The surface when the first `bead` beads have been printed: the last one's layer lies on it."""
        return replace(self, solid=self.tracks[bead - 1].layer if bead > 0 else 0)

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from the body with its solid layers; negative inside."""
        return self.body.signed_distance(points) - self.solid * self.height

    def normals(self, points: Array) -> Array:
        """Outward unit normals (n, 3) of the layer through points (n, 3)."""
        return self.body.normals(points)

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """Outward unit normals (n, 3) of the true faces where perpendiculars from tips (n, 3) meet them, found from the
        places of the bead's samples around arc lengths s (n)."""
        track = self.tracks[bead]
        after = np.clip(np.searchsorted(track.s, s), 1, len(track.s) - 1)
        around = np.stack([after - 1, after], axis=1)
        return track.body.followed(tips, track.face[around], track.uv[around]).normals


def laid(
    curves: Sequence[tuple[FaceBody, FaceCurve, str]], count: int, layer_height: float, width: float, height: float
) -> tuple[list[Bead], list[Track]]:
    """Beads `width` and `height` [m] along curves, `count` layers of them: each begins where the one before ended."""
    placed = []
    row = list(curves)
    for layer in range(count):
        placed += [(layer, *one) for one in row]
        row = [(body, curve.reversed(), name) for body, curve, name in reversed(row)]
    zeros = roll_zeros([curve.places.normals for _, _, curve, _ in placed])
    beads, tracks = [], []
    for (layer, body, curve, name), zero in zip(placed, zeros, strict=True):
        rise = (layer + 1) * layer_height
        points = curve.places.points + rise * curve.places.normals
        s = arc_length(points)
        beads.append(
            Bead(
                name=name,
                layer=layer,
                s=s,
                points=points,
                normals=curve.places.normals,
                roll_zero=zero,
                source=curve.source.points + rise * curve.source.normals,
                width=np.full(len(points), width),
                height=np.full(len(points), height),
                closed=bool(np.linalg.norm(points[-1] - points[0]) < _CLOSED),
            )
        )
        tracks.append(Track(layer, s, body, curve.places.face, curve.places.uv))
    return beads, tracks
