"""From waypoints on faces to a smooth curve on them: points and normals exactly the faces' own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.readonly import Array, ReadOnlyArrays
from planner.toolpath.interpolation import calm_path, interpolate
from planner.toolpath.step.body import FaceBody, Places

_STEP = 2e-3  # m between the places on the faces that the curve is laid through
_FEWEST = 12  # steps of a curve
_AHEAD = 0.25  # of a step between waypoints, by which a curve may leave the faces' rim


@dataclass(frozen=True)
class FaceCurve(ReadOnlyArrays):
    """A curve on faces, sampled uniformly in its parameter: places, and those of the input path before rounding."""

    places: Places
    source: Places

    def reversed(self) -> FaceCurve:
        """The same curve, run backwards."""
        return FaceCurve(*(Places(*(value[::-1] for value in vars(p).values())) for p in (self.places, self.source)))


def pieces_on_faces(body: FaceBody, waypoints: Array) -> list[Array]:
    """Places (n, 3) along straight lines or smooth curves through waypoints (m, 3), cut where these leave the faces."""
    if len(waypoints) < 2:
        return []
    path, chord = calm_path(waypoints)
    step = np.diff(chord)
    pieces = np.maximum(np.ceil(step / _STEP), 1.0).astype(int)
    index = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    c = np.append(chord[index] + step[index] * (within / pieces[index]), chord[-1])
    at = body.beneath(np.asarray(path(c)[:, :3]))
    there = body.inside(at.face, at.uv)
    if not there.all():
        there[~there] = body.rim_distance(at.face[~there], at.points[~there]) <= _AHEAD * float(np.median(step))
    owner = np.append(index, len(pieces) - 1)
    whole = np.ones(len(pieces), dtype=bool)
    whole[owner[~there]] = False  # a step with a place beside the faces is left out
    out = []
    starts = np.concatenate([[0], np.cumsum(pieces)])
    k = 0
    while k < len(pieces):
        if not whole[k]:
            k += 1
            continue
        first = k
        while k < len(pieces) and whole[k]:
            k += 1
        out.append(at.points[starts[first] : starts[k] + 1])
    return out


def spread(points: Array) -> Array:
    """Fewer places (k, 3) on the smooth curve through places (n, 3) that lie close together."""
    path, chord = calm_path(points)
    return np.asarray(path(np.linspace(0.0, chord[-1], max(int(np.ceil(chord[-1] / _STEP)), _FEWEST) + 1))[:, :3])


def lay(body: FaceBody, points: Array, tolerance: float, apart: float, ends: float) -> FaceCurve:
    """The smooth curve through places (n, 3) on faces: corners rounded within `tolerance`, all of it on the faces.

    apart: greatest distance of the source's points; ends: of samples at the ends [m]. Raises TooRough (interpolation)
    where no smooth curve keeps the tolerance.
    """
    at = body.beneath(points)
    curve = interpolate(at.points, at.normals, tolerance, apart, ends)
    return FaceCurve(body.beneath(curve.points), body.beneath(curve.source))
