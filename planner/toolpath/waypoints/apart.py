"""How far apart a file's layers lie, whatever height its beads are said to have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from planner.toolpath.bead import Bead
from planner.toolpath.waypoints.surfels import OTHER_HEIGHT, dense

_LOOKED = 300  # samples at which is looked, at most
_LEAST, _MOST = 0.1, 3.0  # widths of a bead beneath a sample: nearer is its own layer, farther is not looked at
_CLEARLY = 0.2  # widths of a bead at least lie between layers: less may be a layer's own slope
_ASIDE = 0.5  # widths of a bead from straight beneath
_SHARE = 0.3  # of the samples at least have something beneath them: all but the first of two layers,
_LIKE, _MOST_UNLIKE = 0.25, 0.3  # as far as usual but for so much of that, and for so many of them


def other_height(beads: Sequence[Bead], height: float) -> float | None:
    """How far apart layers usually lie [m], if beads of that height [m] do not take them for printed on each other; None where
    they do, and where layers do not lie apart alike."""
    apart = _layers_apart(beads)
    low, high = OTHER_HEIGHT
    return apart if apart is not None and not low * height < apart < high * height else None


def _layers_apart(beads: Sequence[Bead]) -> float | None:
    """The usual distance [m], along their normals, of samples from the nearest earlier place that lies beneath them."""
    tips, normals = (np.vstack([getattr(bead, name) for bead in beads]) for name in ("points", "normals"))
    first = np.concatenate([[0], np.cumsum([len(bead.points) for bead in beads])])
    width = max(float(bead.width.max()) for bead in beads)
    places, leaning, laid = dense(tips, normals, first, _ASIDE * width)
    some = np.unique(np.linspace(0, len(tips) - 1, min(len(tips), _LOOKED)).round().astype(np.int64))
    found = cKDTree(places).query_ball_point(tips[some], _MOST * width)
    own = np.repeat(np.arange(len(some)), [len(each) for each in found])
    near = np.concatenate([np.asarray(each, dtype=np.int64) for each in found])
    way, mean = tips[some[own]] - places[near], normals[some[own]] + leaning[near]
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
    up = (way * mean).sum(axis=1)
    aside = np.linalg.norm(way - up[:, None] * mean, axis=1)
    beneath = (laid[near] < some[own]) & (up > _LEAST * width) & (aside <= _ASIDE * width)
    least = np.full(len(some), np.inf)
    np.minimum.at(least, own[beneath], up[beneath])
    least = least[np.isfinite(least)]
    if len(least) < _SHARE * len(some):
        return None
    usual = float(np.median(least))
    alike = np.mean(np.abs(least - usual) > _LIKE * usual) <= _MOST_UNLIKE
    return usual if alike and usual > _CLEARLY * width else None
