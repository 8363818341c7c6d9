"""Samples beads more finely where a plan leaves its path between samples because path or normal turn quickly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from planner.base.arrays import Array
from planner.toolpath.bead import Bead, Surface, Toolpath
from planner.toolpath.plane_paths import SampleDensity

_DEGREE = 5
_REASON = ": the nozzle would leave path or normal between samples"
_FINER = 3.0  # times as many samples at a place that is off
_AROUND = 6.0  # samples to either side over which they are closer together
_APART = 1.5  # × _AROUND: least distance between two such places
_MOST_PLACES = 0.25  # share of a bead's samples near such places above which the whole bead is sampled more finely
_FINER_ALL_ALONG = 2.0


def sampled_finer(toolpath: Toolpath, places: Mapping[int, Array]) -> Toolpath:
    """The toolpath with more samples on some beads (by index), around sorted arc lengths (k) [m]; a note says so."""
    beads = [
        _finer(i, bead, toolpath.surface, places[i]) if i in places else bead for i, bead in enumerate(toolpath.beads)
    ]
    note = f"{len(places)} of {len(beads)} beads sampled more finely{_REASON}"
    notes = tuple(each for each in toolpath.notes if not each.endswith(_REASON))
    return replace(toolpath, beads=tuple(beads), notes=(*notes, note))


def _finer(number: int, bead: Bead, surface: Surface, places: Array) -> Bead:
    """A bead resampled along the curve through its samples, with the surface's normals there."""
    n = len(bead.s)
    index = np.arange(n, dtype=float)
    at = _apart(np.interp(places, bead.s, index), _APART * _AROUND)
    steps = np.ones(n - 1)
    if _APART * _AROUND * len(at) > _MOST_PLACES * n:
        density = SampleDensity.of_steps(index, _FINER_ALL_ALONG * steps)
    else:
        density = SampleDensity.of_steps(index, steps).denser(at, 1.0 / (_FINER - 1.0), _AROUND)
    u = density.samples(n)
    rows = np.column_stack([bead.s, bead.points, bead.roll_zero])
    s, points, zero = np.split(np.asarray(make_interp_spline(index, rows, k=min(_DEGREE, n - 1))(u)), [1, 4], axis=1)
    s = s[:, 0]
    s[[0, -1]], points[[0, -1]] = bead.s[[0, -1]], bead.points[[0, -1]]
    normals = surface.normals_on(number, s, points)
    zero = zero - (zero * normals).sum(axis=1)[:, None] * normals
    return replace(
        bead,
        s=s,
        points=points,
        normals=normals,
        roll_zero=zero / np.linalg.norm(zero, axis=1)[:, None],
        width=np.interp(s, bead.s, bead.width),
        height=np.interp(s, bead.s, bead.height),
    )


def _apart(places: Array, least: float) -> Array:
    """Thin out sorted places: each one kept is at least `least` from the one kept before."""
    taken = [float(places[0])]
    for place in places[1:]:
        if place - taken[-1] >= least:
            taken.append(float(place))
    return np.array(taken)
