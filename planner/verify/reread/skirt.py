"""Whether skirt lines around the first layer lie where the problem requires them.

The executed tip is measured: its distance from the middle lines of the first layer's beads, and its height.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.plan import Check
from planner.verify.checks import EVERYWHERE, Judged, drawn_name
from planner.verify.reread.places import AXIS, OFF_LEVEL, Places, between, by_number, worst_of

AROUND = "lines around the first layer"
_CHORD = 3e-5  # m: thinned-out outlines may be off by this much
_LOOKS = 200  # places of the layer that lines must go around
_ARC = 1e-3  # × a line's distance from the layer: chords may lie this far off its arcs


def skirt(judged: Judged, places: Places, own: Flags) -> list[Check]:
    """The check of the lines, which are places `own` (n); none without a skirt, or if the print is resumed."""
    spec, lowest = judged.problem.process.skirt, judged.toolpath.beads[0].layer
    there = ~own & (places.layer == lowest)
    if spec is None or judged.trajectory.first_bead or not there.any():
        return []
    lines, layer = places.some(own), places.some(there)
    width = float(np.median(judged.toolpath.beads[int(layer.bead[0])].width))
    covers = 0.5 * np.array([bead.width.max() for bead in judged.toolpath.beads])[layer.bead]
    away = np.full(len(lines.tip), np.inf)  # from the edges of beads, plus half a line's width
    for reach in np.unique(covers) if own.any() else ():
        nearest = cKDTree(layer.tip[covers == reach]).query(lines.tip)[0]
        away = np.minimum(away, nearest + (0.5 * width - reach))
    step = spec.gap + width  # to the first line
    number = np.clip(np.rint((away - step) / width), 0, spec.loops - 1)
    missing = spec.loops - len(np.unique(number))
    if missing:
        return [Check(AROUND, float(missing), 0.0, "missing", False, EVERYWHERE)]
    outside = ~_within(lines, number, spec.loops, layer.few(_LOOKS))
    if outside.any():
        return [Check(AROUND, float(outside.mean()), 0.0, "of the layer outside", False, EVERYWHERE)]
    seen = np.hypot(away, 0.5 * between(judged)) - away  # the nearest place is not the nearest point
    off = np.maximum(np.abs(away - step - number * width) - seen - _ARC * away, 0.0)
    off = np.maximum(off, np.abs(lines.tip[:, 2] - float(np.median(layer.tip[:, 2]))))
    off = np.maximum(off, _open(judged, lines))
    off[np.arccos(np.clip(lines.up[:, 2], -1.0, 1.0)) > judged.problem.process.cones.tilt + AXIS] = np.inf
    limit = judged.problem.process.corner_tolerance + _CHORD + OFF_LEVEL
    return [worst_of(judged, lines, AROUND, off * 1e3, limit * 1e3, "mm")]


def _within(lines: Places, number: Array, loops: int, layer: Places) -> Flags:
    """Whether places (m) of the layer are inside every loop; number (n): the loop of each place of the lines."""
    round_them = np.zeros((loops, len(layer.tip)), dtype=bool)
    for _, at in by_number(lines.bead):
        away = lines.tip[np.append(at, at[0]), :2] - layer.tip[:, None, :2]
        turn = np.diff(np.unwrap(np.arctan2(away[..., 1], away[..., 0]), axis=1), axis=1).sum(axis=1)
        round_them[int(np.median(number[at]))] |= np.abs(turn) > np.pi
    return np.asarray(round_them.all(axis=0))


def _open(judged: Judged, lines: Places) -> Array:
    """Gap (n) [m] between the end of a line, in pieces or not, and its start; 0 at all places but ends."""
    ends = {bead: (at[0], at[-1]) for bead, at in by_number(lines.bead)}
    names = {bead: drawn_name(judged.toolpath.beads[bead]) for bead in ends}
    gap = np.zeros(len(lines.tip))
    for _, pieces in groupby(sorted(ends), names.__getitem__):
        own = list(pieces)
        first, last = ends[own[0]][0], ends[own[-1]][1]
        left = float(np.linalg.norm(lines.tip[first] - lines.tip[last]))
        gap[last] = max(left - 2.0 * between(judged), 0.0)  # the first and last places may be that far from the ends
    return gap
