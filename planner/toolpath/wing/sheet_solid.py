"""The solid that the sheets of a wing make up while it is printed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags
from planner.toolpath.wing.sheets import WingPlaces, WingSheet

_Piece = tuple[Array, Array, Array]  # places, outward normals and grain (n, 3)

_ACROSS, _ALONG, _DOWN = 4e-4, 1e-3, 2.5e-4  # m between places on a skin: across, along the span, down an edge
_SURE = 1.5e-3  # m above a face: more than the distance of places on a skin, so no other face is as near
_AHEAD = 1e-4  # m along the span, over which the direction of edges is measured
_NUDGE = 1e-6  # m by which a place on a skin is moved out to see whether something else is there


@dataclass(frozen=True)
class _Skin:
    """Places (n, 3) on the bare faces of sheets, and their outward unit normals (n, 3).

    grain   (n, 3) unit vectors towards the next places along the span, between which a face and its edges are straight
    """

    points: Array
    normals: Array
    grain: Array
    tree: cKDTree


@dataclass(frozen=True)
class SheetSolid:
    """The surface on which layers lie: everything printed before the current layer, on the bed z = 0.

    Between places on its skin that surface is treated as flat, which it is within some micrometres; past an edge it may
    be taken to be a fifth of a millimetre closer than it is.

    sheets, levels   all sheets, and the layer of each in print order, never decreasing; -1: there from the start
    laid             the sheet that each bead fills
    span             least and greatest y of the solid [m]
    level            the layers before this one are there
    skins            of the sheets that are there, by level; filled in on request
    """

    sheets: tuple[WingSheet, ...]
    levels: tuple[int, ...]
    laid: tuple[int, ...]
    span: tuple[float, float]
    level: int
    skins: dict[int, _Skin] = field(default_factory=dict, compare=False)

    def before(self, bead: int) -> SheetSolid:
        """The solid after the first `bead` beads, without the layer of the last of them."""
        return replace(self, level=self.levels[self.laid[max(bead - 1, 0)]])

    def signed_distance(self, points: Array) -> Array:
        """Distance (n,) of points (n, 3) from sheets and bed; negative inside."""
        bed = points[:, 2]
        skin = self._skin(self.level)
        if len(skin.points) == 0:
            return np.asarray(bed.copy())
        within = self._within(points)
        _, k = skin.tree.query(within)
        away, normals, grain = within - skin.points[k], skin.normals[k], skin.grain[k]
        out = (away * normals).sum(axis=1)
        aside = away - out[:, None] * normals
        step = (aside * grain).sum(axis=1)
        along = np.maximum(np.abs(step) - 0.5 * _ALONG / grain[:, 1], 0.0)
        past = np.maximum(np.linalg.norm(aside - step[:, None] * grain, axis=1) - 0.5 * _ACROSS, 0.0)
        # well above a face a point is outside; past an edge, or close by, the nearest place does not decide the side
        unsure = np.flatnonzero((along + past > 0.0) | (out < _SURE))
        inside = np.zeros(len(points), dtype=bool)
        inside[unsure] = self._covered(within[unsure])
        across = np.where(inside, -1.0, 1.0) * np.sqrt(out**2 + along**2 + past**2)
        beyond = np.maximum(self.span[0] - points[:, 1], points[:, 1] - self.span[1])
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(beyond, 0.0))
        return np.asarray(np.minimum(outside + np.minimum(np.maximum(across, beyond), 0.0), bed))

    def normals_on(self, bead: int, s: Array, tips: Array) -> Array:
        """True outward unit normals (n, 3) of a bead's layer at the places nearest to tips (n, 3)."""
        return self.sheets[self.laid[bead]].normals(tips)

    def normals(self, points: Array) -> Array:
        """Unit directions (n, 3) in which the distance from sheets grows; upwards next to the bed and inside."""
        out = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        skin = self._skin(self.level)
        if len(skin.points) == 0:
            return out
        within = self._within(points)
        away = points - skin.points[skin.tree.query(within)[1]]
        away[:, 1] = points[:, 1] - within[:, 1]
        away[self._covered(within)] = [0.0, 0.0, 0.0]
        size = np.linalg.norm(away, axis=1)
        free = (size > _NUDGE) & (size <= points[:, 2])
        out[free] = away[free] / size[free, None]
        return out

    def _within(self, points: Array) -> Array:
        """Points (n, 3) moved along y into the span."""
        return np.column_stack([points[:, 0], np.clip(points[:, 1], *self.span), points[:, 2]])

    def _covered(self, points: Array) -> Flags:
        """Which points (n, 3) lie in a sheet that is there."""
        skin = self._skin(self.level)
        low, high = skin.tree.mins, skin.tree.maxes
        near = np.flatnonzero(((points >= low) & (points <= high))[:, ::2].all(axis=1))
        covered = np.zeros(len(points), dtype=bool)
        if len(near):
            covered[near] = _inside(self._there(self.level), points[near])
        return covered

    def _there(self, level: int) -> list[WingSheet]:
        return [sheet for sheet, at in zip(self.sheets, self.levels, strict=True) if at < level]

    def _skin(self, level: int) -> _Skin:
        if level not in self.skins:
            there = self._there(level)
            new = (
                there if level == 0 else [s for s, at in zip(self.sheets, self.levels, strict=True) if at == level - 1]
            )
            pieces = [piece for sheet in new for piece in _faces(sheet, self.span)]
            free = [_bare(piece, there) for piece in pieces]
            if level > 0:
                before = self._skin(level - 1)
                free.append(_bare((before.points, before.normals, before.grain), new))
            points, normals, grain = (np.vstack([np.zeros((0, 3)), *(piece[i] for piece in free)]) for i in range(3))
            self.skins[level] = _Skin(points, normals, grain, cKDTree(points))
        return self.skins[level]


def _bare(piece: _Piece, sheets: list[WingSheet]) -> _Piece:
    """The places of a face that lie on no sheet."""
    points, normals, grain = piece
    bare = ~_inside(sheets, points + _NUDGE * normals)
    return points[bare], normals[bare], grain[bare]


def _inside(sheets: list[WingSheet], points: Array) -> Flags:
    """Which points (n, 3) lie in any of the sheets."""
    places, covered = WingPlaces(points), np.zeros(len(points), dtype=bool)
    for sheet in sheets:
        covered |= sheet.covers(places)
    return covered


def _faces(sheet: WingSheet, span: tuple[float, float]) -> list[_Piece]:
    """Places on the top, the bottom and the edges of a sheet, with their outward normals and grain."""
    y = np.linspace(*span, int(np.ceil((span[1] - span[0]) / _ALONG)) + 1)
    ahead = np.where(y + _AHEAD > span[1], y - _AHEAD, y + _AHEAD)
    rows, ends = [], []
    for at, edges, beside, further in zip(y, sheet.area.at(y), ahead, sheet.area.at(ahead), strict=True):
        for (low, high), (low_further, high_further) in zip(edges, further, strict=True):
            if np.isnan(low):
                continue
            if np.isnan(low_further):
                low_further, high_further = low, high
            length = abs(float(np.diff(sheet.unrolled(np.array([low, high]), np.array([at, at])))[0]))
            share = np.linspace(0.0, 1.0, int(np.ceil(length / _ACROSS)) + 1)
            c, c_further = low + share * (high - low), low_further + share * (high_further - low_further)
            rows.append(np.column_stack([c, np.full(len(c), at), c_further, np.full(len(c), beside)]))
            ends.append(np.where(share == 1.0, 1.0, np.where(share == 0.0, -1.0, 0.0)))
    if not rows:
        return []
    places, which = np.vstack(rows), np.concatenate(ends)
    tips, normals = sheet.tips(places[:, 0], places[:, 1])
    grain = sheet.tips(places[:, 2], places[:, 3])[0] - tips
    grain -= (grain * normals).sum(axis=1)[:, None] * normals
    grain *= (np.sign(grain[:, 1]) / np.linalg.norm(grain, axis=1))[:, None]
    pieces = [(tips, normals, grain), (tips - sheet.height * normals, -normals, grain)]
    for side in (-1.0, 1.0):
        k = np.flatnonzero(which == side)
        beside_it = np.clip(k - int(side), 0, len(tips) - 1)
        out = tips[k] - tips[beside_it]
        out -= (out * normals[k]).sum(axis=1)[:, None] * normals[k] + (out * grain[k]).sum(axis=1)[:, None] * grain[k]
        out /= np.maximum(np.linalg.norm(out, axis=1), _NUDGE)[:, None]
        down = np.linspace(0.0, sheet.height, int(np.ceil(sheet.height / _DOWN)) + 1)
        below = tips[k, None] - down[:, None] * normals[k, None]
        pieces.append((below.reshape(-1, 3), np.repeat(out, len(down), axis=0), np.repeat(grain[k], len(down), axis=0)))
    return pieces
