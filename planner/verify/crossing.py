"""Beads of one layer that cross on the surface: there material is laid twice, and the nozzle passes through it.

Found from the executed motion alone, seen along the normals of the surface printed on. Onstein et al. (section 2.2)
require that a path does not intersect itself, since extrusion is hard to stop and start. A bead that merely touches
another, as at the seam of a closed one, does not cross it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.plan import Check
from planner.problem.layers import FaceLayersSpec
from planner.verify.checks import EVERYWHERE, Findings, Judged, place
from planner.verify.interlayer import LaidPlaces, laid_places

CROSSINGS = "beads cross nowhere"
_GOES_ON = 0.5  # × a bead's width: a line that crosses another continues this far past it
_OTHER_SHEET = 0.5  # cosine between normals; below it, lines lie on different sides of a fold


def crossing(judged: Judged) -> Findings:
    """The check that no beads of a layer cross, or just the number of crossings, as the problem asks. By default, the
    check for prints on faces, and nothing for others."""
    asked = judged.problem.process.crossings
    if asked is None and isinstance(judged.problem.layers, FaceLayersSpec):
        asked = "refused"
    if asked is None:
        return Findings()
    places = laid_places(judged)
    one, other = crossings_of(places)
    count, where, at = len(one), EVERYWHERE, -1
    if count:
        first = int(np.argmax(places.sample[one] >= 0))
        at = int(places.sample[one[first]])
        x, y, z = places.tip[one[first]] * 1e3
        where = f"first {place(judged.trajectory, at)}, over bead {places.bead[other[first]]}, at {x:.1f} {y:.1f} {z:.1f} mm"
    metrics = {"bead_crossings": float(count)}
    if asked == "told":
        return Findings((), metrics)
    return Findings((Check(CROSSINGS, float(count), 0.0, "places", count == 0, where, sample=at),), metrics)


def crossings_of(places: LaidPlaces) -> tuple[Ints, Ints]:
    """Places (k) just before a bead crosses another one of its layer, or itself, and those (k) on the line laid
    earlier; in order of time."""
    a = np.flatnonzero(np.diff(places.run) == 0)
    step = places.tip[a + 1] - places.tip[a]
    size = np.linalg.norm(step, axis=1)
    a, size = a[size > 0.0], size[size > 0.0]
    if len(a) < 2:
        return a[:0], a[:0]
    middle = 0.5 * (places.tip[a] + places.tip[a + 1])
    pairs = cKDTree(middle).query_pairs(float(size.max()), output_type="ndarray")
    i, j = a[pairs.max(axis=1)], a[pairs.min(axis=1)]
    beside = (places.run[i] == places.run[j]) & (i - j <= 1)
    same = (places.layer[i] == places.layer[j]) & ~beside
    same &= (places.normal[i] * places.normal[j]).sum(axis=1) > _OTHER_SHEET
    i, j = i[same], j[same]
    meet, share_i, share_j = _meet(places, i, j)
    i, j, share_i, share_j = i[meet], j[meet], share_i[meet], share_j[meet]
    on = _goes_on(places, i, share_i) & _goes_on(places, j, share_j)
    i, j = i[on], j[on]
    order = np.lexsort((j, i))
    return i[order], j[order]


def _meet(places: LaidPlaces, i: Ints, j: Ints) -> tuple[Flags, Array, Array]:
    """Whether segments from places i (k) and j (k) to the next cross, seen along the normal, and where (shares, k)."""
    normal = places.normal[i] + places.normal[j]
    p, q = places.tip[i], places.tip[j]
    u, v = places.tip[i + 1] - p, places.tip[j + 1] - q

    def turn(x: Array, y: Array) -> Array:
        return np.asarray((np.cross(x, y) * normal).sum(axis=1))

    slant = turn(u, v)
    parallel = np.abs(slant) <= 1e-9 * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    slant = np.where(parallel, 1.0, slant)
    share_i, share_j = turn(q - p, v) / slant, turn(q - p, u) / slant
    inside = (share_i >= 0.0) & (share_i < 1.0) & (share_j >= 0.0) & (share_j < 1.0)
    return np.asarray(inside & ~parallel), share_i, share_j


def _goes_on(places: LaidPlaces, at: Ints, share: Array) -> Flags:
    """Whether lines continue far enough both ways where they cross, at a fraction of the segment from places (k) on."""
    step = np.append(np.linalg.norm(np.diff(places.tip, axis=0), axis=1), 0.0)
    gone = np.append(0.0, np.cumsum(step)[:-1])
    begins = np.append(True, np.diff(places.run) != 0)
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], len(places.run)) - 1
    run = np.cumsum(begins) - 1
    here = gone[at] + share * step[at]
    room = _GOES_ON * places.width[at]
    return np.asarray((here - gone[starts][run[at]] > room) & (gone[ends][run[at]] - here > room))
