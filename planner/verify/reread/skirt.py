"""Whether lines around the first layer lie where the problem asks for them.

What is measured is the executed tip: how far from the middle lines of the first layer's beads it is, and how high.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Flags
from planner.plan import Check
from planner.problem.by_layer import SkirtSpec
from planner.verify.checks import EVERYWHERE, Judged, drawn_name
from planner.verify.reread.places import AXIS, OFF_LEVEL, Places, between, by_number, worst_of

AROUND = "lines around the first layer"
_CHORD = 3e-5  # m that outlines may be off, once they are thinned out
_ARC = 1e-3  # of a line's distance from the layer, by which its arcs may be chords


def skirt(judged: Judged, places: Places, own: Flags) -> list[Check]:
    """The check of the lines, which are places `own` (n); none where none are asked for, or the first layer was begun before."""
    spec, lowest = judged.problem.process.skirt, judged.toolpath.beads[0].layer
    there = ~own & (places.layer == lowest)
    if spec is None or judged.trajectory.first_bead or not there.any():
        return []
    if not own.any():
        return [Check(AROUND, float(spec.loops), 0.0, "missing", False, EVERYWHERE)]
    return [_check(judged, spec, places.some(own), places.some(there))]


def _check(judged: Judged, spec: SkirtSpec, lines: Places, layer: Places) -> Check:
    """Distances are those of the lines that are asked for, each of which goes all round."""
    process, width = judged.problem.process, float(judged.toolpath.beads[int(layer.bead[0])].width[0])
    away = cKDTree(layer.tip).query(lines.tip)[0]
    step = spec.gap + width  # from the layer's middle line to the first line's
    number = np.clip(np.rint((away - step) / width), 0, spec.loops - 1)
    seen = np.hypot(away, 0.5 * between(judged)) - away  # the nearest place is not the nearest point
    off = np.maximum(np.abs(away - step - number * width) - seen - _ARC * away, 0.0)
    off = np.maximum(off, np.abs(lines.tip[:, 2] - float(np.median(layer.tip[:, 2]))))
    off[np.arccos(np.clip(lines.up[:, 2], -1.0, 1.0)) > process.cones.tilt + AXIS] = np.inf
    if len(np.unique(number)) < spec.loops or _open(judged, lines):
        off[:] = np.inf
    limit = process.corner_tolerance + _CHORD + OFF_LEVEL
    return worst_of(judged, lines, AROUND, off * 1e3, limit * 1e3, "mm")


def _open(judged: Judged, lines: Places) -> bool:
    """Whether a line does not come back to where it began, in pieces or not."""
    tips = {bead: lines.tip[at] for bead, at in by_number(lines.bead)}
    names = {bead: drawn_name(judged.toolpath.beads[bead]) for bead in tips}
    for _, pieces in groupby(sorted(tips), names.__getitem__):
        own = list(pieces)
        if np.linalg.norm(tips[own[0]][0] - tips[own[-1]][-1]) > between(judged) + OFF_LEVEL:
            return True
    return False
